"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path

import click

OUT = click.option(
    "-o", "--output", "out", required=True, type=click.Path(path_type=Path), help="Folder to write."
)
CONFIG = click.argument("config", type=click.Path(path_type=Path))
OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace a result that is there.")
SEED = click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), help="In place of run.seed of the configuration."
)
AREAS = click.option(
    "--area", "areas", multiple=True, help="Only this release area; may be given several times."
)
JOBS = click.option("--jobs", type=click.IntRange(0), help="Processor cores; 0: all.")
