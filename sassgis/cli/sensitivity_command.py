"""``sassgis sensitivity``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import AREAS, CONFIG, JOBS, OUT, OVERWRITE, SEED
from sassgis.cli.progress_bar import ProgressBar, conclude


@click.command(
    short_help="Vary the ground classes within their ranges.",
    epilog="Example: sassgis sensitivity sassgis.toml -o sensitivity",
)
@CONFIG
@OUT
@click.option(
    "--samples",
    type=click.IntRange(4, 10_000),
    default=32,
    show_default=True,
    help="Simulations that fill all ranges at once.",
)
@click.option(
    "--rocks",
    type=click.IntRange(2, 1_000_000),
    help="Blocks of each release point in each simulation; default: a fifth of the configured.",
)
@click.option(
    "--ranges",
    type=click.Path(path_type=Path),
    help="Own ranges (CSV: class, parameter, kind, low, high), before the built-in ones.",
)
@AREAS
@SEED
@JOBS
@OVERWRITE
def sensitivity(
    config: Path,
    out: Path,
    samples: int,
    rocks: int | None,
    ranges: Path | None,
    areas: tuple[str, ...],
    seed: int | None,
    jobs: int | None,
    overwrite: bool,
) -> None:
    """Show how levels, reach and energy of CONFIG answer to the ranges of its ground classes."""
    from sassgis.runs.sensitivity_run import sensitivity as vary

    with ProgressBar() as progress:
        result = vary(
            config,
            out,
            samples=samples,
            rocks=rocks,
            ranges=ranges,
            areas=areas or None,
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            on_progress=progress.step,
            say=progress.say,
        )
    conclude(
        result.warnings, f"{result.simulations} simulations of {len(result.ranges)} ranges.", out
    )
