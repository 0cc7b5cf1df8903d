"""Maps of a result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio


def read_band(folder: Path, stem: str, name: str) -> np.ma.MaskedArray:
    """A band by its name, without the cells that it says nothing of."""
    with rasterio.open(folder / "maps" / f"{stem}.tif") as raster:
        index = [raster.tags(i)["NAME"] for i in raster.indexes].index(name) + 1
        return raster.read(index, masked=True)
