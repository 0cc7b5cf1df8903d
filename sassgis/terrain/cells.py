"""Exact passage of lines through grid cells, and heights between cell centres."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sassgis.model.grid import FloatArray, Grid, IntArray
from sassgis.model.jit import kernel
from sassgis.model.profiles import TraceSet

Scalar = TypeVar("Scalar", bound=np.generic)

# Stretches shorter than this (m) are rounding, not ground that a block passes.
SHORTEST_STRETCH = 1e-9


def cell_stretches(
    grid: Grid, traces: TraceSet
) -> tuple[IntArray, FloatArray, IntArray, FloatArray]:
    """Grid cells that each fall line passes, in order, with exact border chainages.

    The borders are computed, not sampled: each segment is walked from grid line to grid line
    (J. Amanatides and A. Woo, 1987, A fast voxel traversal algorithm for ray tracing,
    Eurographics '87). Stretches shorter than a nanometre are dropped.

    Parameters
    ----------
    grid : Grid
    traces : TraceSet

    Returns
    -------
    cell_offset : int64, shape (n + 1,)
    cell_s : float64, shape (cell_offset[-1] + n,)
        Borders (m); line ``i`` starts at ``cell_offset[i] + i``.
    cell : int64, shape (cell_offset[-1],)
        Flat cell indices, -1 outside the grid; laid out as in ProfileSet.
    on_map : float64, shape (cell_offset[-1] + n, 2)
        Borders in columns and rows of the grid.
    """
    n_rows, n_cols = grid.shape
    u = (traces.x - grid.west) / grid.cell_size
    v = (grid.north - traces.y) / grid.cell_size
    return _stretches(traces.offset, traces.s, u, v, n_rows, n_cols)


# Positions are counted in cells from a corner of the grid. Shifts of position are made whole
# multiples of 2^-28 of a cell (7 nm on cells of 2 m), so that adding them is exact: the lines and
# heights on a part of a DEM, counted from another corner, are the same to the last bit.
_STEPS_PER_CELL = 2.0**28


@kernel
def exact(shift: float) -> float:
    """A shift of position, in cells, that adds to positions without rounding."""
    return float(np.floor(shift * _STEPS_PER_CELL + 0.5) / _STEPS_PER_CELL)


@kernel
def grown(values: NDArray[Scalar], size: int) -> NDArray[Scalar]:
    """A copy with room for at least ``size`` rows, doubling."""
    bigger = np.empty((max(size, 2 * values.shape[0]), *values.shape[1:]), values.dtype)
    bigger[: values.shape[0]] = values
    return bigger


@kernel
def next_line(position: float, target: float) -> float:
    """First whole number strictly ahead of ``position`` towards ``target``."""
    if target > position:
        return float(np.floor(position)) + 1.0
    return float(np.ceil(position)) - 1.0


@kernel
def next_share(start: float, target: float, line: float) -> float:
    """Share of the distance from start to target at which ``line`` is met; 2 if it is not."""
    if target > start:
        return (line - start) / (target - start) if line <= target else 2.0
    if target < start:
        return (line - start) / (target - start) if line >= target else 2.0
    return 2.0


@kernel
def cell_index(u: float, v: float, n_rows: int, n_cols: int) -> int:
    """Flat index of the cell at (u, v); -1 outside."""
    if u >= 0.0 and v >= 0.0 and u < n_cols and v < n_rows:
        return int(v) * n_cols + int(u)
    return -1


@kernel
def _set_border(borders: FloatArray, i: int, s: float, u: float, v: float) -> None:
    borders[i, 0] = s
    borders[i, 1] = u
    borders[i, 2] = v


@kernel
def _stretches(
    offset: IntArray, s: FloatArray, u: FloatArray, v: FloatArray, n_rows: int, n_cols: int
) -> tuple[IntArray, FloatArray, IntArray, FloatArray]:
    n = offset.size - 1
    cell_offset = np.zeros(n + 1, np.int64)
    # Chainage, u and v of each border.
    borders = np.empty((max(16, 4 * s.size), 3), np.float64)
    cells = np.empty(max(16, 4 * s.size), np.int64)
    count = 0
    for i in range(n):
        first, last = offset[i], offset[i + 1] - 1
        if count + i + 1 >= borders.shape[0]:
            borders = grown(borders, count + i + 2)
        _set_border(borders, count + i, s[first], u[first], v[first])
        begin = count
        for k in range(first, last):
            u0, v0, u1, v1 = u[k], v[k], u[k + 1], v[k + 1]
            length = s[k + 1] - s[k]
            line_u, line_v = next_line(u0, u1), next_line(v0, v1)
            t = 0.0
            while t < 1.0:
                t_u, t_v = next_share(u0, u1, line_u), next_share(v0, v1, line_v)
                t_next = min(1.0, t_u, t_v)
                if t_u <= t_next:
                    line_u += 1.0 if u1 > u0 else -1.0
                if t_v <= t_next:
                    line_v += 1.0 if v1 > v0 else -1.0
                if (t_next - t) * length > SHORTEST_STRETCH:
                    middle = 0.5 * (t + t_next)
                    cell = cell_index(
                        u0 + middle * (u1 - u0), v0 + middle * (v1 - v0), n_rows, n_cols
                    )
                    end = s[k] + t_next * length
                    u_end, v_end = u0 + t_next * (u1 - u0), v0 + t_next * (v1 - v0)
                    if count > begin and cells[count - 1] == cell:
                        _set_border(borders, count + i, end, u_end, v_end)
                    else:
                        if count + 1 >= cells.size:
                            cells = grown(cells, count + 2)
                        if count + i + 2 >= borders.shape[0]:
                            borders = grown(borders, count + i + 3)
                        cells[count] = cell
                        count += 1
                        _set_border(borders, count + i, end, u_end, v_end)
                t = t_next
        # The last border is the end of the line itself, whatever was dropped along it.
        if count > begin:
            _set_border(borders, count + i, s[last], u[last], v[last])
        cell_offset[i + 1] = count
    kept = borders[: count + n]
    return cell_offset, kept[:, 0].copy(), cells[:count].copy(), kept[:, 1:].copy()


@kernel
def _known(heights: FloatArray, row: int, col: int) -> bool:
    return (
        row >= 0
        and col >= 0
        and row < heights.shape[0]
        and col < heights.shape[1]
        and np.isfinite(heights[row, col])
    )


@kernel
def height_at(heights: FloatArray, u: float, v: float, row: int, col: int) -> float:
    """Height at (u, v), bilinear between the centres of the four cells around.

    The point belongs to cell (row, col) or to its border. A missing neighbour is replaced by the
    height that continues the slope across the cell, so that planes stay planes up to the edge.
    NaN if the cell itself has no height.
    """
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
