"""``sassgis run``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import (
    AREAS,
    CONFIG,
    JOBS,
    OUT,
    OVERWRITE,
    SEED,
    cluster_options,
    who_works,
)
from sassgis.cli.progress_bar import ProgressBar, conclude


@click.command()
@CONFIG
@OUT
@AREAS
@SEED
@JOBS
@cluster_options
@OVERWRITE
def run(
    config: Path,
    out: Path,
    areas: tuple[str, ...],
    seed: int | None,
    jobs: int | None,
    scheduler: str | None,
    workers: int | None,
    overwrite: bool,
) -> None:
    """Simulate CONFIG on the map: maps, GeoPackage, QGIS project, figures, report."""
    from sassgis.runs.run import run as run_map

    with who_works(jobs, scheduler, workers) as working, ProgressBar() as progress:
        result = run_map(
            config,
            out,
            areas=areas or None,
            seed=seed,
            jobs=working,
            overwrite=overwrite,
            on_progress=progress.step,
            say=progress.say,
        )
    conclude(result.warnings, f"{result.rocks} blocks in {result.seconds:.1f} s.", out)
