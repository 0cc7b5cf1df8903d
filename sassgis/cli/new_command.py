"""``sassgis new``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import OVERWRITE


@click.command(
    short_help="Write empty layers and a QGIS project to draw a site in.",
    epilog="Example: sassgis new site.gpkg --dem terrain/terrain.vrt",
)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--crs", help="Projected system in metres, as EPSG:2056; default: that of --dem.")
@click.option("--dem", type=click.Path(path_type=Path), help="Terrain model to draw over.")
@OVERWRITE
def new(file: Path, crs: str | None, dem: Path | None, overwrite: bool) -> None:
    """Write an empty GeoPackage FILE to draw a site in, and a QGIS project beside it."""
    from sassgis.io.write.site_template import site_template

    project = site_template(file, crs=crs, dem=dem, overwrite=overwrite)
    click.echo(f"Wrote {file}. Draw in {project}, then: sassgis init --dem ... --release {file}")
