"""A picture that lies under the zones on map sheets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj

from sassgis.io.read.dem import open_raster
from sassgis.model.crs import crs_name, same_crs
from sassgis.model.errors import InputError
from sassgis.model.grid import Grid
from sassgis.model.results import Band, RasterClass, RasterLayer
from sassgis.model.styles import PICTURE

_STEM = "base_map"
#: Of the layer in a project.
BASE_MAP_KEY = f"raster_{_STEM}"


def read_base_map(file: Path | None, grid: Grid) -> RasterLayer | None:
    """How a base map is shown: in colours, by its palette, or in grey; None without a file.

    InputError if it cannot be read, or is in other coordinates than the terrain model.
    """
    if file is None:
        return None
    field = "project.base_map"
    with open_raster(file, field) as dataset:
        own = dataset.crs
        if bool(own) != bool(grid.crs) or (
            own and not same_crs(pyproj.CRS.from_wkt(own.to_wkt()), pyproj.CRS.from_wkt(grid.crs))
        ):
            raise InputError(
                "is not in the coordinates of the terrain model", file=file, field=field,
                found=crs_name(own.to_wkt()) if own else "no coordinate system",
                expected=crs_name(grid.crs) if grid.crs else "local coordinates",
            )  # fmt: skip
        palette = {}
        if dataset.count < 3 and dataset.colorinterp[0].name == "palette":
            palette = dataset.colormap(1)
        # Nothing is drawn from the values here: the project shows the file.
        bands = (Band("", "", "", np.empty((0, 0), np.float32)),) * dataset.count
    classes = (
        RasterClass(value, "", "#{:02x}{:02x}{:02x}".format(*colour[:3]))
        for value, colour in palette.items()
    )
    return RasterLayer(_STEM, "Base map", "", bands, (), PICTURE, tuple(classes))
