"""Which release area of many governs which hazard zones, and where do several meet?

    python pipelines/batch_release_zones.py RELEASES -o OUT [--config CONFIG] [--dem DEM]

Runs ``sassgis batch`` and adds two tables beside its summary: ``OUT/shares.csv`` has a row per
hazard level and release area, with the zones of the mosaic that the area governs and their size;
``OUT/overlaps.csv`` has the size of the map reached by one area, by two, by three ... areas.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import rasterio

from sassgis.batches.batch import batch
from sassgis.errors import SassgisError
from sassgis.outputs.frames import write_table


def shares(mosaic: Path) -> pd.DataFrame:
    """Zones of each hazard level by the area that governs them."""
    zones = gpd.read_file(mosaic / "hazard.gpkg", layer="hazard_zones", ignore_geometry=True)
    named = zones.rename(columns={"governing_area": "area"})
    out = named.groupby(["hazard_level", "area"])["area_m2"].agg(zones="size", area_m2="sum")
    return out.reset_index()


def overlaps(folder: Path, areas: list[str]) -> pd.DataFrame:
    """Size of the map by the number of areas whose blocks reach it."""
    with rasterio.open(folder / "mosaic" / "maps" / "passages.tif") as mosaic:
        count = np.zeros(mosaic.shape, np.int64)
        corner, cell = (mosaic.transform.c, mosaic.transform.f), mosaic.res[0]
    for area in areas:
        with rasterio.open(folder / area / "maps" / "passages.tif") as raster:
            row = round((corner[1] - raster.transform.f) / cell)
            col = round((raster.transform.c - corner[0]) / cell)
            reached = raster.read(1, masked=True).filled(0) > 0
        count[row : row + reached.shape[0], col : col + reached.shape[1]] += reached
    number, cells = np.unique(count[count > 0], return_counts=True)
    return pd.DataFrame({"areas": number, "area_m2": cells * cell * cell})


def main(argv: list[str] | None = None) -> None:
    """Run the batch and write both tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("releases", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--config", type=Path, default=None)
    parser.add_argument("--dem", type=Path, default=None)
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--overwrite", action="store_true")
    given = parser.parse_args(argv)
    result = batch(
        given.releases, given.output, config=given.config, dem=given.dem, jobs=given.jobs,
        overwrite=given.overwrite, say=print,
    )  # fmt: skip
    done = result.summary[result.summary["status"] == "done"]
    by_level = shares(given.output / "mosaic")
    met = overlaps(given.output, done["folder"].tolist())
    write_table(given.output / "shares.csv", [by_level])
    write_table(given.output / "overlaps.csv", [met])
    for table in (done.drop(columns=["file", "folder", "status"]), by_level, met):
        print(table.to_string(index=False))
    for warning in result.warnings:
        print(f"Note: {warning}")


if __name__ == "__main__":
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None
