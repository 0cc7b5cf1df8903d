"""Terrain from a STAC interface: fetched, put together."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from sassgis.io.atomic_output import write_new, writing
from sassgis.io.read.stac import TileOffer
from sassgis.io.read.tiles import open_tiles
from sassgis.io.write.tile_download import fetch_tile, write_vrt
from sassgis.model.errors import InputError

VRT, SOURCES = "terrain.vrt", "sources.json"


def fetch_terrain(
    offers: Sequence[TileOffer],
    folder: Path,
    *,
    timeout_s: float,
    most: int,
    say: Callable[[str], None],
) -> Path:
    """Fetch tiles into a folder and put them together.

    Tiles that are there are kept; a download that was interrupted goes on. The virtual raster is
    written last, when all tiles are whole. The folder is made if missing; more than ``most`` tiles
    are refused; ``say`` is called with a line for each.

    Returns the path of ``terrain.vrt``. Beside it ``sources.json`` says where each tile comes from.
    """
    if len(offers) > most:
        raise InputError(
            "too many tiles", field="--most", found=f"{len(offers)} tiles",
            expected=f"{most} or fewer: a smaller polygon, a coarser --resolution, or more --most",
        )  # fmt: skip
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for number, offer in enumerate(offers, start=1):
        try:
            fetched = fetch_tile(offer, folder, timeout_s)
        except InputError as error:
            problem = (
                f"tile {number} of {len(offers)}: {error.problem}; the same command goes on from "
                "there"
            )
            raise InputError(**error.parts(problem=problem)) from None
        say(f"{number}/{len(offers)} {offer.name} {'fetched' if fetched else 'is there'}")
    terrain = open_tiles([folder / o.name for o in offers], folder)
    facts = [
        {"file": o.name, "href": o.href, "date": o.date, "checksum": o.checksum} for o in offers
    ]
    write_new(folder / SOURCES, json.dumps(facts, indent=1) + "\n", overwrite=True)
    return write_vrt(folder / VRT, terrain)
