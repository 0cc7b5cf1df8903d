"""``sassgis gap diagnose``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import CONFIG, JOBS, OUT, OVERWRITE
from sassgis.cli.progress_bar import ProgressBar


@click.command(
    short_help="Where simulation and observations differ, and why.",
    epilog="Example: sassgis gap diagnose sassgis.toml --observations observed -o diagnosis",
)
@CONFIG
@click.option(
    "--observations",
    required=True,
    type=click.Path(path_type=Path),
    help="A GeoPackage, or a folder of CSV files.",
)
@OUT
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=1, show_default=True)
@JOBS
@click.option(
    "--draws",
    type=click.IntRange(8, 1000),
    help="Parameter sets of each hypothesis; more take longer and separate effects better.",
)
@click.option(
    "--ground-range",
    type=click.FloatRange(0.1, 10.0),
    default=1.0,
    show_default=True,
    help="Factor on how far the ground may be calibrated; above 1 where its classes are guesses.",
)
@click.option("--map", "with_map", is_flag=True, help="Run the map with the calibrated model, too.")
@OVERWRITE
def diagnose(
    config: Path,
    observations: Path,
    out: Path,
    seed: int,
    jobs: int | None,
    draws: int | None,
    ground_range: float,
    with_map: bool,
    overwrite: bool,
) -> None:
    """Say where simulation and OBSERVATIONS differ, which effect causes it, and how far it helps.

    The same command goes on after an interruption.
    """
    from sassgis.report.gap_answer import verdict_sentence
    from sassgis.runs.diagnose import MAP_NAME
    from sassgis.runs.diagnose import diagnose as run_diagnosis
    from sassgis.runs.hypothesis_fits import DRAWS

    with ProgressBar() as progress:
        result = run_diagnosis(
            config,
            observations,
            out,
            jobs=jobs,
            seed=seed,
            overwrite=overwrite,
            draws=draws or DRAWS,
            ground_range=ground_range,
            on_progress=progress.step,
            say=progress.say,
        )
    for warning in result.warnings:
        click.echo(f"Note: {warning.removeprefix('warning: ')}", err=True)
    click.echo(result.first_sentence)
    click.echo(verdict_sentence(result))
    click.echo(f"Open {out / 'report.html'} in a browser, {out / 'gap.gpkg'} in QGIS.")
    if with_map:
        from sassgis.runs.gap_map_change import map_change

        with ProgressBar() as progress:
            change = map_change(
                config, out / "model" / "config.toml", out / MAP_NAME, jobs, say=progress.say
            )
        for line in change.lines():
            click.echo(line)
