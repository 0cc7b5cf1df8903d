"""``sassgis cliffs``."""

from __future__ import annotations

from pathlib import Path

import click

from sassgis.cli.options import OVERWRITE


@click.command(
    short_help="Propose release areas from the slopes of a terrain model.",
    epilog="Example: sassgis cliffs terrain/terrain.vrt -o release.gpkg",
)
@click.argument("dem", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", "out", required=True, type=click.Path(path_type=Path), help="GeoPackage."
)
@click.option("--crs", help="Coordinate system, where DEM states none.")
@click.option(
    "--ground",
    type=click.Path(path_type=Path),
    help="Polygons of ground classes: mapped rock counts from a gentler slope on.",
)
@click.option("--layer", help="Layer of the ground polygons, where the file has several.")
@click.option("--class-field", default="class", show_default=True, help="Attribute with the class.")
@click.option("--rock", default="rock", show_default=True, help="Ground class that is rock.")
@click.option(
    "--threshold",
    type=click.FloatRange(1.0, 89.0),
    help="Slope of cliffs (degrees); default: from which cliffs prevail.",
)
@click.option(
    "--min-area",
    type=click.FloatRange(0.0),
    default=50.0,
    show_default=True,
    help="Smallest area in plan (m2).",
)
@OVERWRITE
def cliffs(
    dem: Path,
    out: Path,
    crs: str | None,
    ground: Path | None,
    layer: str | None,
    class_field: str,
    rock: str,
    threshold: float | None,
    min_area: float,
    overwrite: bool,
) -> None:
    """Propose release areas from the slopes of DEM; to be checked in the field."""
    from sassgis.runs.propose_release import propose_release

    proposal = propose_release(
        dem, out, crs=crs, ground=ground, class_field=class_field, layer=layer, rock=rock,
        threshold_deg=threshold, min_area_m2=min_area, overwrite=overwrite,
    )  # fmt: skip
    for line in proposal.lines():
        click.echo(line)
    click.echo(f"Wrote {out}. Check it, then: sassgis init --dem {dem} --release {out}")
