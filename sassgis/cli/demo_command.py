"""``sassgis demo``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import AS_JSON, JOBS, OUT, OVERWRITE
from sassgis.cli.zone_command import zoned


@click.command(epilog="Example: sassgis demo -o demo_out")
@OUT
@JOBS
@OVERWRITE
@AS_JSON
def demo(out: Path, jobs: int | None, overwrite: bool, as_json: bool) -> None:
    """Make the zones of the sample valley, a synthetic terrain."""
    from sassgis.runs.samples import sample_folder

    zoned(sample_folder() / "valley" / "config.toml", out, (), None, jobs, overwrite, as_json)
