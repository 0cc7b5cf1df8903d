"""``sassgis dem check``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import AS_JSON, OVERWRITE
from sassgis.cli.progress_bar import print_json


@click.command(
    "check",
    short_help="Judge a terrain model, on one page.",
    epilog="Example: sassgis dem check terrain/terrain.vrt",
)
@click.argument("dem", type=click.Path(path_type=Path))
@click.option("--crs", help="Coordinate system, where DEM states none.")
@AS_JSON
@click.option("--html", type=click.Path(path_type=Path), help="Write the page as HTML too.")
@OVERWRITE
def check(dem: Path, crs: str | None, as_json: bool, html: Path | None, overwrite: bool) -> None:
    """Judge the terrain model DEM, a raster or a folder of tiles: a verdict for each item."""
    from sassgis.runs.dem_check import check_dem, write_dem_page

    report = check_dem(dem, crs)
    if as_json:
        print_json(report.as_dict())
    else:
        for line in report.lines():
            click.echo(line)
    if html is not None:
        write_dem_page(html, report, overwrite)
