"""Regions of cells as polygons with the borders of the cells."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csgraph, csr_array

from sassgis.errors import InputError
from sassgis.grid import BoolArray, Grid, IntArray

#: Coordinates of zones are multiples of it (m).
_DECIMALS = 3
PRECISION_M = 10.0**-_DECIMALS


def check_cells(cell_size: float) -> None:
    """Raise InputError if cells are not at least ten times the precision of coordinates."""
    if cell_size < 10.0 * PRECISION_M:
        raise InputError(
            "cells are too small for the precision of the zones' coordinates",
            field="terrain.dem",
            found=f"cells of {cell_size:g} m",
            expected=f"cells of {10.0 * PRECISION_M:g} m or more",
        )


def cell_polygons(cells: BoolArray, grid: Grid) -> NDArray[Any]:
    """Return regions of cells that hang together over sides, as they are: Polygons, shape (n,).

    They are in the order of the first cell of each; shells run clockwise, holes the other way.
    Raises InputError if cells are not at least ten times the precision of the coordinates.
    """
    check_cells(grid.cell_size)
    row, col, region, down = _corners(cells)
    if not row.size:
        return np.empty(0, object)
    # Each corner has a side along its row and one along its column. The other end of the first is
    # the next or the one before, as corners are row by row.
    beside = np.arange(row.size) ^ 1
    pairs = np.lexsort((down, row, col)).reshape(-1, 2)
    above_below = np.empty_like(beside)
    above_below[pairs] = pairs[:, ::-1]
    ring = csgraph.connected_components(_graph(above_below, beside))[1]
    first = np.unique(ring, return_index=True)[1]
    first = first[np.lexsort((first, region[first]))]
    # Every second corner of each ring; where a ring ends, the next one begins.
    first = beside[first]
    onward = beside[above_below]
    before = np.empty_like(onward)
    before[onward] = np.arange(row.size)
    onward[before[first][:-1]] = first[1:]
    order = csgraph.depth_first_order(_graph(onward), first[0], return_predecessors=False)
    place = np.stack((order, above_below[order]), axis=1).ravel()
    at = np.stack((col, -row), axis=1)[place] * grid.cell_size + [grid.west, grid.north]
    starts = np.zeros(row.size, np.int64)
    starts[first] = 1
    rings = shapely.linearrings(
        np.round(at, _DECIMALS), indices=np.repeat(np.cumsum(starts[order]) - 1, 2)
    )
    # The first corner of a region is one of its shell, which so is the first of its rings.
    polygons = shapely.polygons(rings, indices=region[first] - 1)
    return np.asarray(shapely.orient_polygons(polygons, exterior_cw=True), object)


def _corners(cells: BoolArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Return row, column, region (from 1) and direction (1: down) of corners of regions."""
    region = ndimage.label(np.pad(cells, 1))[0]
    # By whether a cell is south and whether it is east of the point.
    around = {(s, e): region[s : region.shape[0] - 1 + s, e : region.shape[1] - 1 + e]
              for s in (0, 1) for e in (0, 1)}  # fmt: skip
    count = sum((a > 0).astype(np.int8) for a in around.values())
    found = []
    for (south, east), own in around.items():
        opposite, neighbour = around[1 - south, 1 - east], around[1 - south, east]
        alone = ((count == 1) & (own > 0)) | ((count == 3) & (own == 0))
        # Where two cells meet at a point each has a separate corner if they are of two regions.
        # If they are of one, each of the two empty cells has: so a shell and a hole touch there,
        # or two holes, in place of one ring that touches itself.
        met = (count == 2) & ((own > 0) == (opposite > 0))
        other = around[south, 1 - east]
        alone |= met & np.where(own > 0, own != opposite, neighbour == other)
        i, j = np.nonzero(alone)
        of = np.where(own[i, j] > 0, own[i, j], np.max([a[i, j] for a in around.values()], axis=0))
        found.append((i, j, of, np.full(i.size, south), np.full(i.size, east)))
    row, col, of, down, right = np.concatenate(found, axis=1).astype(np.int64)
    order = np.lexsort((right, col, row))
    return row[order], col[order], of[order], down[order]


def _graph(*linked: IntArray) -> csr_array:
    """Return corners, each linked to one of each of ``linked``."""
    size, ends = linked[0].size, np.concatenate(linked)
    links = np.tile(np.arange(size), len(linked)), ends
    return csr_array((np.ones(ends.size, np.int8), links), shape=(size, size))
