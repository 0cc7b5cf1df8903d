"""``sassgis zone``."""

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
from sassgis.cli.run_command import run_facts

if TYPE_CHECKING:
    from sassgis.runs.workers import Jobs


@click.command(
    short_help="Simulate blocks, and make hazard zones; risk.",
    epilog="Example: sassgis zone sassgis.toml -o zones",
)
@CONFIG
@OUT
@AREAS
@SEED
@JOBS
@cluster_options
@OVERWRITE
@AS_JSON
def zone(
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
    """Simulate CONFIG and make hazard zones: all that run writes, levels, intensities, risk."""
    with who_works(jobs, scheduler, workers) as working:
        zoned(config, out, areas, seed, working, overwrite, as_json)


def zoned(
    config: Path,
    out: Path,
    areas: tuple[str, ...],
    seed: int | None,
    jobs: Jobs,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Make hazard zones and report the result."""
    from sassgis.runs.zone import zone as make_zones

    with ProgressBar() as progress:
        result = make_zones(
            config,
            out,
            areas=areas or None,
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            on_progress=progress.step,
            say=progress.say,
        )
    hazard = result.found.hazard
    summary = (
        f"{result.run.rocks} blocks, {hazard.levels.polygons.size} zones, "
        f"{100 * hazard.uncertain_share:.1f} % of the reached cells statistically uncertain."
    )
    facts = {
        **run_facts(result.run),
        "zones": int(hazard.levels.polygons.size),
        "uncertain_share": float(hazard.uncertain_share),
    }
    conclude(result.run.warnings, summary, out, facts if as_json else None)
