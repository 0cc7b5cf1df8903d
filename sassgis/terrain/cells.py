"""Cells of the grid: heights between their centres, and the cells that a line passes."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import kernel, lean
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.results import TraceSet

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


Scalar = TypeVar("Scalar", bound=np.generic)


def cell_stretches(
    grid: Grid, traces: TraceSet
) -> tuple[IntArray, FloatArray, IntArray, FloatArray]:
    """Walk each fall line through the grid cells that it passes, in order.

    The borders are computed, not sampled: each segment is walked from grid line to grid line
    (J. Amanatides and A. Woo, 1987, A fast voxel traversal algorithm for ray tracing,
    Eurographics '87). Stretches shorter than a nanometre are dropped.

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
    u, v = grid.uv(traces.x, traces.y)
    return _stretches(traces.offset, traces.s, u, v, n_rows, n_cols)


@kernel
def grown(values: NDArray[Scalar], size: int) -> NDArray[Scalar]:
    """Return a copy with room for at least ``size`` rows, doubling."""
    bigger = np.empty((max(size, 2 * values.shape[0]), *values.shape[1:]), values.dtype)
    # One by one: numba takes a second to compile the message of a slice of another shape.
    for i in range(values.size):
        bigger.flat[i] = values.flat[i]
    return bigger


@lean
def next_share(start: float, target: float, line: float) -> float:
    """Return the share of the way from start to target at which ``line`` is met; 2 if it is not."""
    if target > start:
        return (line - start) / (target - start) if line <= target else 2.0
    if target < start:
        return (line - start) / (target - start) if line >= target else 2.0
    return 2.0


@lean
def next_crossing(
    u0: float, u1: float, line_u: float, v0: float, v1: float, line_v: float
) -> tuple[float, float, float]:
    """Find the share of a segment at which it next meets a line (1: its end), and later lines."""
    t_u, t_v = next_share(u0, u1, line_u), next_share(v0, v1, line_v)
    t_next = min(1.0, t_u, t_v)
    if t_u <= t_next:
        line_u += 1.0 if u1 > u0 else -1.0
    if t_v <= t_next:
        line_v += 1.0 if v1 > v0 else -1.0
    return t_next, line_u, line_v


@lean
def _set_border(borders: FloatArray, i: int, s: float, u: float, v: float) -> None:
    borders[i, 0] = s
    borders[i, 1] = u
    borders[i, 2] = v


@lean
def most_steps(u: FloatArray, v: FloatArray, per_cell: float) -> int:
    """Count the most steps of a walk over points (cells) from grid line to grid line."""
    n = 0
    for k in range(u.size - 1):
        n += int(per_cell * abs(u[k + 1] - u[k])) + int(per_cell * abs(v[k + 1] - v[k])) + 3
    return n


@kernel
def _stretches(
    offset: IntArray, s: FloatArray, u: FloatArray, v: FloatArray, n_rows: int, n_cols: int
) -> tuple[IntArray, FloatArray, IntArray, FloatArray]:
    n = offset.size - 1
    cell_offset = np.zeros(n + 1, np.int64)
    most = most_steps(u, v, 1.0)
    # Chainage, u and v of each border.
    borders = np.empty((most + n, 3), np.float64)
    cells = np.empty(most, np.int64)
    count = 0
    for i in range(n):
        count = _stretches_of_line(
            offset[i], offset[i + 1] - 1, s, u, v, n_rows, n_cols, borders, cells, count, i
        )
        cell_offset[i + 1] = count
    kept = borders[: count + n]
    return cell_offset, kept[:, 0].copy(), cells[:count].copy(), kept[:, 1:].copy()


@lean
def _stretches_of_line(
    first: int,
    last: int,
    s: FloatArray,
    u: FloatArray,
    v: FloatArray,
    n_rows: int,
    n_cols: int,
    borders: FloatArray,
    cells: IntArray,
    count: int,
    i: int,
) -> int:
    """Add the stretches of line ``i``, from its first to its last point; returns their number."""
    _set_border(borders, count + i, s[first], u[first], v[first])
    begin = count
    for k in range(first, last):
        u0, v0, u1, v1 = u[k], v[k], u[k + 1], v[k + 1]
        length = s[k + 1] - s[k]
        line_u, line_v = next_line(u0, u1), next_line(v0, v1)
        t = 0.0
        while t < 1.0:
            t_next, line_u, line_v = next_crossing(u0, u1, line_u, v0, v1, line_v)
            if (t_next - t) * length > SHORTEST_STRETCH:
                middle = 0.5 * (t + t_next)
                cell = cell_index(u0 + middle * (u1 - u0), v0 + middle * (v1 - v0), n_rows, n_cols)
                end = s[k] + t_next * length
                u_end, v_end = u0 + t_next * (u1 - u0), v0 + t_next * (v1 - v0)
                if count == begin or cells[count - 1] != cell:
                    cells[count] = cell
                    count += 1
                _set_border(borders, count + i, end, u_end, v_end)
            t = t_next
    # The last border is the end of the line itself, whatever was dropped along it.
    if count > begin:
        _set_border(borders, count + i, s[last], u[last], v[last])
    return count


def heights_at(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """Compute heights of the DEM as it is (m), bilinear between cell centres, as profiles do.

    NaN outside the DEM, over nodata and where a coordinate is missing.
    """
    xs, ys = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    u, v = (np.ascontiguousarray(own.ravel()) for own in grid.uv(xs, ys))
    heights: FloatArray = _heights(u, v, grid.values).reshape(xs.shape)
    return heights


@kernel
def _heights(u: FloatArray, v: FloatArray, values: FloatArray) -> FloatArray:
    out = np.full(u.size, np.nan)
    for i in range(u.size):
        if not (np.isfinite(u[i]) and np.isfinite(v[i])):
            continue
        cell = cell_index(u[i], v[i], values.shape[0], values.shape[1])
        if cell >= 0:
            row, col = cell // values.shape[1], cell % values.shape[1]
            out[i] = height_at(values, u[i], v[i], row, col)
    return out
