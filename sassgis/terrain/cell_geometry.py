"""Places on a grid of cells, and heights between their centres, for compiled code."""

from __future__ import annotations

import numpy as np

from sassgis.compiled.jit import kernel, lean
from sassgis.grid import FloatArray

#: Stretches shorter than this (m) are rounding, not ground that a block passes.
SHORTEST_STRETCH = 1e-9

# Positions are counted in cells from a corner of the grid. Shifts of position are made whole
# multiples of 2^-28 of a cell (7 nm on cells of 2 m), so that adding them is exact: the lines and
# heights on a part of a DEM, counted from another corner, are the same to the last bit.
_STEPS_PER_CELL = 2.0**28


@kernel
def exact(shift: float) -> float:
    """Return a shift of position, in cells, that adds to positions without rounding."""
    return float(np.floor(shift * _STEPS_PER_CELL + 0.5) / _STEPS_PER_CELL)


def exact_positions(positions: FloatArray) -> FloatArray:
    """Return positions in cells that lie a whole number of the shortest shifts from the corner."""
    whole = np.floor(positions)
    # What exact does, for all at once.
    return whole + np.floor((positions - whole) * _STEPS_PER_CELL + 0.5) / _STEPS_PER_CELL


@kernel
def next_line(position: float, target: float) -> float:
    """Return the first whole number strictly ahead of ``position`` towards ``target``."""
    if target > position:
        return float(np.floor(position)) + 1.0
    return float(np.ceil(position)) - 1.0


@kernel
def cell_index(u: float, v: float, n_rows: int, n_cols: int) -> int:
    """Return flat index of the cell at (u, v); -1 outside."""
    if u >= 0.0 and v >= 0.0 and u < n_cols and v < n_rows:
        return int(v) * n_cols + int(u)
    return -1


@lean
def _known(heights: FloatArray, row: int, col: int) -> bool:
    return (
        row >= 0
        and col >= 0
        and row < heights.shape[0]
        and col < heights.shape[1]
        and np.isfinite(heights[row, col])
    )


@lean
def height_at(heights: FloatArray, u: float, v: float, row: int, col: int) -> float:
    """Return the height at (u, v), bilinear between the centres of the four cells around.

    The point belongs to cell (row, col) or to its border. A missing neighbour is replaced by the
    height that continues the slope across the cell: planes stay planes up to the edge. NaN if the
    cell itself has no height.
    """
    n_rows, n_cols = heights.shape
    if 0 < row < n_rows - 1 and 0 < col < n_cols - 1:
        # Nearly always all four are known, and there is nothing to be asked.
        du, dv = u - (col + 0.5), v - (row + 0.5)
        to_col = 1 if du >= 0.0 else -1
        to_row = 1 if dv >= 0.0 else -1
        own = heights[row, col]
        across = heights[row, col + to_col] - own
        down = heights[row + to_row, col] - own
        twist = heights[row + to_row, col + to_col] - own - across - down
        fu, fv = abs(du), abs(dv)
        z = own + across * fu + down * fv + twist * fu * fv
        if not np.isnan(z):
            return float(z)
    return _height_at_edge(heights, u, v, row, col)


@lean
def _height_at_edge(heights: FloatArray, u: float, v: float, row: int, col: int) -> float:
    """Compute height_at where a neighbour may be missing."""
    if not _known(heights, row, col):
        return np.nan
    own = heights[row, col]
    du, dv = u - (col + 0.5), v - (row + 0.5)
    to_col = 1 if du >= 0.0 else -1
    to_row = 1 if dv >= 0.0 else -1
    if _known(heights, row, col + to_col):
        across = heights[row, col + to_col] - own
    elif _known(heights, row, col - to_col):
        across = own - heights[row, col - to_col]
    else:
        across = 0.0
    if _known(heights, row + to_row, col):
        down = heights[row + to_row, col] - own
    elif _known(heights, row - to_row, col):
        down = own - heights[row - to_row, col]
    else:
        down = 0.0
    if _known(heights, row + to_row, col + to_col):
        twist = heights[row + to_row, col + to_col] - own - across - down
    else:
        twist = 0.0
    fu, fv = abs(du), abs(dv)
    return float(own + across * fu + down * fv + twist * fu * fv)
