"""The terrain as a layer."""

from __future__ import annotations

from sassgis.io.write.layers.maps import described_band, described_raster
from sassgis.model.grid import Grid
from sassgis.model.results import RasterLayer
from sassgis.model.styles import HILLSHADE


def terrain_layer(grid: Grid) -> RasterLayer:
    """The heights, to be shown as relief."""
    heights = grid.vertical_datum or "datum not stated"
    bands = [described_band("terrain", "height", grid.values)]
    return described_raster("terrain", bands, (), HILLSHADE, heights=heights)
