"""``sassgis dem fetch``."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(
    short_help="List and fetch tiles of swissALTI3D over polygons.",
    epilog="Example: sassgis dem fetch area.gpkg -o terrain",
)
@click.argument("polygon", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", "out", type=click.Path(path_type=Path),
    help="Folder for the tiles; without it they are listed only.",
)  # fmt: skip
@click.option(
    "--resolution", type=click.Choice(["0.5", "2"]), default="2", show_default=True,
    help="Size of the cells (m).",
)  # fmt: skip
@click.option("--layer", help="Layer of the polygons, where the file has several.")
@click.option("--most", type=click.IntRange(1), default=100, show_default=True, help="Tiles.")
@click.option("--server", help="Address of another STAC interface.")
@click.option("--collection", help="Another collection of it.")
@click.option(
    "--timeout", type=click.FloatRange(0.1), default=30.0, show_default=True,
    help="Longest wait for an answer (s).",
)  # fmt: skip
def fetch(
    polygon: Path,
    out: Path | None,
    resolution: str,
    layer: str | None,
    most: int,
    server: str | None,
    collection: str | None,
    timeout: float,
) -> None:
    """List the tiles of swissALTI3D over the polygons of a file, and fetch them into a folder."""
    from sassgis.io.read.stac import COLLECTION, SERVER
    from sassgis.runs.dem_fetch import fetch_terrain, offered_tiles

    offers = offered_tiles(
        polygon, float(resolution), layer=layer, server=server or SERVER,
        collection=collection or COLLECTION, timeout_s=timeout,
    )  # fmt: skip
    if out is None:
        for offer in offers:
            click.echo(f"{offer.date}  {offer.name}  {offer.href}")
        click.echo(f"{len(offers)} tiles. Nothing was fetched; -o FOLDER does it.")
        return
    vrt = fetch_terrain(offers, out, timeout_s=timeout, most=most, say=click.echo)
    click.echo(f"Wrote {vrt} over {len(offers)} tiles. Now: sassgis dem check {vrt}")
