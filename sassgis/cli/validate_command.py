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
    """Read CONFIG and every file that it names; say what they hold and what they are ready for."""
    from sassgis.io.read.check_inputs import check_inputs
    from sassgis.io.read.config import load_config
    from sassgis.io.read.readiness import readiness

    settings = load_config(config)
    report = check_inputs(settings)
    rules: list[str] = []
    stated = any(o.frequency is not None for o in settings.onsets.values())
    if stated or settings.hazard.frequencies is not None or settings.objects:
        from sassgis.runs.inputs import check_rules

        rules = check_rules(settings, report.terrain)
    ready = readiness(settings)
    if as_json:
        missing = {own.task: own.missing for own in ready}
        print_json({**report.as_dict(), "zoning": rules, "missing": missing})
        return
    for line in (*report.lines(), *rules, *(own.line for own in ready)):
        click.echo(line)
