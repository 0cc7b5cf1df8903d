"""``sassgis run``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from sassgis.cli.options import (
    AREAS,
    AS_JSON,
    CONFIG,
    JOBS,
    OUT,
    OVERWRITE,
    SEED,
    cluster_options,
    who_works,
)
from sassgis.cli.progress_bar import ProgressBar, conclude

if TYPE_CHECKING:
    from sassgis.runs.run import RunResult


@click.command(
    short_help="Simulate blocks: maps, GeoPackage, QGIS project, report.",
    epilog="Example: sassgis run sassgis.toml -o result",
)
@CONFIG
@OUT
@AREAS
@SEED
@JOBS
@cluster_options
@OVERWRITE
@AS_JSON
def run(
    config: Path,
    out: Path,
    areas: tuple[str, ...],
    seed: int | None,
    jobs: int | None,
    scheduler: str | None,
    workers: int | None,
    overwrite: bool,
    as_json: bool,
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
    summary = f"{result.rocks} blocks in {result.seconds:.1f} s."
    conclude(result.warnings, summary, out, run_facts(result) if as_json else None)


def run_facts(result: RunResult) -> dict[str, object]:
    """What a run says with --json."""
    return {
        "blocks": result.rocks,
        "stopping_reasons": {r.name.lower(): count for r, count in result.reasons.items()},
        "seconds": result.seconds,
    }
