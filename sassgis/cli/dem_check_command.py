"""``sassgis dem check``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from sassgis.cli.options import OVERWRITE


@click.command("check")
@click.argument("dem", type=click.Path(path_type=Path))
@click.option("--crs", help="Coordinate system, where DEM states none.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, with all numbers.")
@click.option("--html", type=click.Path(path_type=Path), help="Write the page as HTML too.")
@OVERWRITE
def check(dem: Path, crs: str | None, as_json: bool, html: Path | None, overwrite: bool) -> None:
    """Judge the terrain model DEM, a raster or a folder of tiles: a verdict for each item."""
    from sassgis.runs.dem_check import check_dem, write_dem_page

    report = check_dem(dem, crs)
    if as_json:
        click.echo(json.dumps(report.as_dict(), indent=1, ensure_ascii=False))
    else:
        for line in report.lines():
            click.echo(line)
    if html is not None:
        write_dem_page(html, report, overwrite)
