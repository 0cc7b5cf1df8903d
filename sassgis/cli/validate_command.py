"""``sassgis validate``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import AS_JSON, CONFIG
from sassgis.cli.progress_bar import print_json


@click.command(
    short_help="Read all inputs; say what they are ready for.",
    epilog="Example: sassgis validate sassgis.toml",
)
@CONFIG
@AS_JSON
def validate(config: Path, as_json: bool) -> None:
    """Check CONFIG and every file that it names; say what they are ready for and what it takes."""
    from sassgis.io.read.config import load_config
    from sassgis.runs.check_inputs import check_inputs

    report = check_inputs(load_config(config))
    if as_json:
        print_json(report.as_dict())
        return
    for line in report.lines():
        click.echo(line)
