"""``sassgis demo``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import JOBS, OUT, OVERWRITE
from sassgis.cli.zone_command import zoned


@click.command()
@OUT
@JOBS
@OVERWRITE
def demo(out: Path, jobs: int | None, overwrite: bool) -> None:
    """Make the zones of the sample valley, a synthetic terrain."""
    from sassgis.runs.samples import sample_folder

    zoned(sample_folder() / "valley" / "config.toml", out, (), None, jobs, overwrite)
