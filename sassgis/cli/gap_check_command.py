"""``sassgis gap check``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import JOBS, OUT, cluster_options, who_works
from sassgis.cli.progress_bar import ProgressBar


@click.command(
    "check",
    short_help="Score the diagnosis on synthetic sites.",
    epilog="Example: sassgis gap check --quick -o check",
)
@OUT
@click.option("--worlds", type=click.IntRange(1), default=150, show_default=True)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**63 - 1),
    default=2026,
    show_default=True,
    help="Of the battery.",
)
@JOBS
@cluster_options
@click.option("--quick", is_flag=True, help="Six small sites, to see whether everything runs.")
@click.option(
    "--development", is_flag=True, help="Allow a battery on which the thresholds were chosen."
)
def check_diagnosis(
    out: Path,
    worlds: int,
    seed: int,
    jobs: int | None,
    scheduler: str | None,
    workers: int | None,
    quick: bool,
    development: bool,
) -> None:
    """Let the diagnosis answer on synthetic sites with blinded labels, and score it.

    The same command goes on after an interruption.
    """
    from sassgis.gap.check.check_scores import (
        acceptance,
    )
    from sassgis.runs.gap_check import check

    with who_works(jobs, scheduler, workers) as working, ProgressBar() as progress:
        result = check(
            out,
            worlds=worlds,
            seed=seed,
            jobs=working,
            quick=quick,
            development=development,
            on_progress=progress.step,
            say=progress.say,
        )
    for warning in result.warnings:
        click.echo(f"Note: {warning}", err=True)
    for row in acceptance(result.scores):
        form = ".0%" if row["is_share"] else ".2f"
        reached = f"{row['reached']:{form}}" if row["met"] is not None else "-"
        counts = f"{row['hits']} of {row['worlds']}; " if row["is_share"] else ""
        click.echo(
            f"{row['measure']}: {reached} "
            f"({counts}required: {row['asked_is']} {row['asked']:{form}})"
        )
    click.echo(f"Open {out / 'report.html'} in a browser.")
