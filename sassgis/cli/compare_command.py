"""``sassgis compare``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import OUT, OVERWRITE


@click.command(epilog="Example: sassgis compare zones_before zones_after -o change")
@click.argument("before", type=click.Path(path_type=Path))
@click.argument("after", type=click.Path(path_type=Path))
@OUT
@OVERWRITE
def compare(before: Path, after: Path, out: Path, overwrite: bool) -> None:
    """Say what changes from the result BEFORE to the result AFTER."""
    from sassgis.runs.compare import compare as compare_results

    change = compare_results(before, after, out, overwrite=overwrite)
    for note in change.notes:
        click.echo(f"Note: {note}", err=True)
    for line in change.lines():
        click.echo(line)
    click.echo(f"Open {out / 'project.qgz'} in QGIS, {out / 'report.html'} in a browser.")
