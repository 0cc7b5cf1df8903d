"""``sassgis validate``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import CONFIG


@click.command()
@CONFIG
def validate(config: Path) -> None:
    """Read CONFIG and every file that it names; say what they hold and what they are ready for."""
    from sassgis.io.read.check_inputs import check_inputs
    from sassgis.io.read.config import load_config
    from sassgis.io.read.readiness import readiness

    settings = load_config(config)
    report = check_inputs(settings)
    for line in report.lines():
        click.echo(line)
    stated = any(o.frequency is not None for o in settings.onsets.values())
    if stated or settings.hazard.frequencies is not None or settings.objects:
        from sassgis.runs.inputs import check_rules

        for line in check_rules(settings, report.terrain):
            click.echo(line)
    for own in readiness(settings):
        click.echo(own.line)
