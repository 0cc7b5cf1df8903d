"""``sassgis profile``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import CONFIG, OUT, OVERWRITE, SEED


@click.command(
    short_help="Simulate one profile: paths, stations, run-out, energy.",
    epilog="Example: sassgis profile sassgis.toml --point 2700300 1120500 -o one_line",
)
@CONFIG
@OUT
@click.option(
    "--csv", "csv_file", type=click.Path(path_type=Path), help="Profile: s_m, z_m, ground."
)
@click.option(
    "--point",
    type=(float, float),
    metavar="X Y",
    help="Cut the profile from the terrain, from here.",
)
@click.option(
    "--line",
    "line_file",
    type=click.Path(path_type=Path),
    help="Cut it from the terrain under the line of this vector file, drawn downwards.",
)
@click.option("--rocks", type=click.IntRange(1), help="Blocks per block scenario.")
@SEED
@OVERWRITE
def profile(
    config: Path,
    out: Path,
    csv_file: Path | None,
    point: tuple[float, float] | None,
    line_file: Path | None,
    rocks: int | None,
    seed: int | None,
    overwrite: bool,
) -> None:
    """Simulate one profile: trajectories, stations, run-out, energy along the slope."""
    from sassgis.model.errors import ConfigError
    from sassgis.runs.profile_run import run_profile

    if sum(given is not None for given in (csv_file, point, line_file)) > 1:
        raise ConfigError("--csv, --point and --line exclude each other", expected="one of them")
    result = run_profile(
        config,
        out,
        csv_file=csv_file,
        point=point,
        line_file=line_file,
        rocks=rocks,
        seed=seed,
        overwrite=overwrite,
    )
    click.echo(f"{result.found.rocks.size} blocks. Open {out / 'report.html'} in a browser.")
