"""Outlines of cells."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import rasterio.features
import shapely
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import Affine

from sassgis.model.grid import Grid

# rasterio silences this for its arrays while it reads them; another thread may undo that meanwhile.
warnings.filterwarnings("ignore", category=NotGeoreferencedWarning, module="rasterio.features")


def cell_outlines(numbers: NDArray[Any], grid: Grid) -> Iterator[tuple[Any, int]]:
    """Patches of cells with the same number above 0: outline with the corners of cells, number.

    Cells that touch at a corner only are patches of their own.
    """
    transform = Affine(grid.cell_size, 0.0, grid.west, 0.0, -grid.cell_size, grid.north)
    for outline, value in rasterio.features.shapes(
        numbers, mask=numbers > 0, transform=transform, connectivity=4
    ):
        yield shapely.geometry.shape(outline), int(value)


def footprints(
    probability: NDArray[np.float32], grid: Grid, levels: Sequence[float]
) -> dict[float, Any]:
    """Areas where the reach probability is at least each of some levels, ascending.

    The probability has the shape of the grid and is NaN where no block arrives. Level 0 means every
    cell that a block reaches. Levels that no cell has are left out.
    """
    outlines = {}
    for level in sorted(levels):
        reached = (np.nan_to_num(probability, nan=-1.0) >= max(level, 1e-300)).astype(np.uint8)
        if parts := [part for part, _ in cell_outlines(reached, grid)]:
            outlines[float(level)] = shapely.MultiPolygon(list(shapely.get_parts(parts)))
    return outlines
