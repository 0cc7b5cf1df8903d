"""``sassgis gap template``."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(
    short_help="Write empty tables of observations.",
    epilog="Example: sassgis gap template observed",
)
@click.argument("path", type=click.Path(path_type=Path))
def template(path: Path) -> None:
    """Write empty tables of observations: a .gpkg, or a folder of CSV files."""
    from sassgis.io.write.observation_template import observations_template

    click.echo(f"Wrote {observations_template(path)}. Leave out what you did not measure.")
