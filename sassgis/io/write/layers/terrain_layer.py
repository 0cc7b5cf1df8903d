"""The terrain as a layer."""

from __future__ import annotations

import numpy as np

from sassgis.model.grid import Grid
from sassgis.model.results import Band, RasterLayer
from sassgis.model.styles import HILLSHADE


def terrain_layer(grid: Grid) -> RasterLayer:
    """The heights, to be shown as relief."""
    return RasterLayer(
        "terrain",
        "Relief",
        f"Terrain model of the run. Heights: {grid.vertical_datum or 'datum not stated'}.",
        (Band("height", "Height of the terrain", "m", grid.values.astype(np.float32)),),
        (),
        HILLSHADE,
    )
