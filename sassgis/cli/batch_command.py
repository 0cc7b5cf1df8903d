"""``sassgis batch``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import JOBS, OUT, SEED, cluster_options, who_works
from sassgis.cli.progress_bar import ProgressBar, conclude


@click.command(
    short_help="Zone many release areas, each alone and all on one map.",
    epilog="Example: sassgis batch releases -c sassgis.toml --dem terrain -o batch",
)
@click.argument("releases", type=click.Path(path_type=Path))
@OUT
@click.option(
    "-c",
    "--config",
    type=click.Path(path_type=Path),
    help="Everything but the release areas; default: the only TOML file beside them.",
)
@click.option(
    "--dem",
    type=click.Path(path_type=Path),
    help="In place of terrain.dem: a raster, a VRT, or a folder of tiles.",
)
@SEED
@JOBS
@cluster_options
@click.option(
    "--overwrite", is_flag=True, help="Replace areas of other settings or inputs, or changed ones."
)
@click.option(
    "--mosaic-only", is_flag=True, help="No maps, zones and report of each area by itself."
)
@click.option(
    "--memory",
    "memory_gb",
    type=click.FloatRange(min=1.0),
    metavar="GB",
    help="Memory for all processes together; a mosaic that needs more is made block by block.",
)
def batch(
    releases: Path,
    out: Path,
    config: Path | None,
    dem: Path | None,
    seed: int | None,
    jobs: int | None,
    scheduler: str | None,
    workers: int | None,
    overwrite: bool,
    mosaic_only: bool,
    memory_gb: float | None,
) -> None:
    """Zone each release area of RELEASES alone, and all of them on one map.

    RELEASES is a vector file, a folder of vector files, or a configuration. The same command goes
    on after an interruption, and runs nothing again that is there.
    """
    from sassgis.io.staging import alone
    from sassgis.runs.batch import batch as run_batch

    with (
        alone(out),
        who_works(jobs, scheduler, workers) as working,
        ProgressBar() as progress,
    ):
        result = run_batch(
            releases,
            out,
            config=config,
            dem=dem,
            seed=seed,
            jobs=working,
            overwrite=overwrite,
            mosaic_only=mosaic_only,
            memory_gb=memory_gb,
            on_progress=progress.step,
            say=progress.say,
        )
    done = int((result.summary["status"] == "done").sum())
    summary = f"{done} of {len(result.summary)} areas done: {out / 'summary.csv'}"
    conclude(result.warnings, summary, out / "mosaic")
