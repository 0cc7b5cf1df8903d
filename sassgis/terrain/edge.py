"""Where a terrain model ends too early for blocks, by the energy line from where they start."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.grid import BoolArray, FloatArray, Grid, IntArray

#: Energy lines that leave a terrain model sink at this angle: few blocks go farther than that.
#: Expert judgement of ours, between shadow angles (22 to 28) and reach angles (28 to 35 degrees).
ANGLE_DEG = 28.0
#: Most starts and cells of the edge between which lines are drawn, and samples of the longest.
_STARTS, _CELLS, _SAMPLES = 200, 500, 200


@dataclass(frozen=True, slots=True)
class BeyondEdge:
    """How far an energy line goes on beyond the edge of a terrain model."""

    start: int  # from which start
    side: str  # where it leaves: "north", "east", "south", "west" or "inner" (unknown heights)
    x: float  # on the edge
    y: float
    height_m: float  # of the line above the ground there
    distance_m: float  # to where it meets the ground, if that goes on level

    @property
    def where(self) -> str:
        """The side in words."""
        return "heights are missing" if self.side == "inner" else f"{self.side} edge"


def edge_cells(known: BoolArray) -> BoolArray:
    """Return cells with a height next to one without, or at the border of the grid."""
    beside = np.pad(known, 1)
    inside = beside[:-2, 1:-1] & beside[2:, 1:-1] & beside[1:-1, :-2] & beside[1:-1, 2:]
    out: BoolArray = known & ~inside
    return out


def edge_sides(grid: Grid) -> tuple[IntArray, NDArray[np.object_]]:
    """Return cells (flat, ascending) at the edge of the terrain, and their sides there (lines)."""
    beside = np.pad(np.isfinite(grid.values), 1)
    cells = np.flatnonzero(edge_cells(beside[1:-1, 1:-1]))
    row, col = np.divmod(cells, grid.shape[1])
    west, north = grid.west + col * grid.cell_size, grid.north - row * grid.cell_size
    east, south = west + grid.cell_size, north - grid.cell_size
    found, lines = [], []
    for drow, dcol, *ends in (
        (-1, 0, west, north, east, north), (1, 0, west, south, east, south),
        (0, -1, west, north, west, south), (0, 1, east, north, east, south),
    ):  # fmt: skip
        beyond = np.flatnonzero(~beside[row + 1 + drow, col + 1 + dcol])
        found.append(cells[beyond])
        lines.append(np.stack([end[beyond] for end in ends], axis=1).reshape(-1, 2, 2))
    cell = np.concatenate(found).astype(np.int64)
    order = np.argsort(cell, kind="stable")
    return cell[order], np.array(shapely.linestrings(np.concatenate(lines)[order]), np.object_)


def beyond_edge(grid: Grid, x: FloatArray, y: FloatArray) -> list[BeyondEdge]:
    """Find where energy lines from some starts leave the terrain, the farthest of each side.

    A line sinks at an angle from the ground at its start (Heim 1932: Fahrböschung) and ends where
    the terrain rises above it. A part of the starts (x, y) with a height and of the edge is looked
    at, evenly chosen, with the highest starts among them.
    """
    known = np.isfinite(grid.values)
    rows, cols = np.nonzero(edge_cells(known))
    some = np.unique(np.linspace(0, max(rows.size - 1, 0), _CELLS).round().astype(np.int64))
    rows, cols = rows[some[: rows.size]], cols[some[: rows.size]]
    starts = _chosen(grid, x, y)
    if not (starts.size and rows.size):
        return []
    slope = math.tan(math.radians(ANGLE_DEG))
    there = np.stack(grid.cell_centres(rows * grid.shape[1] + cols), axis=1)
    ground = grid.values[rows, cols]
    found: dict[str, BeyondEdge] = {}
    for start in starts.tolist():
        here = np.array([x[start], y[start]])
        top = float(grid.values.ravel()[grid.cell_of(here[:1], here[1:])[0]])
        far = np.hypot(*(there - here).T)
        above = top - slope * far - ground
        for k in np.flatnonzero(above > 0.0).tolist():
            side = _side(int(rows[k]), int(cols[k]), grid.shape)
            distance = float(above[k] / slope)
            if side in found and found[side].distance_m >= distance:
                continue
            if _is_free(grid, here, there[k], top, slope):
                place = float(there[k, 0]), float(there[k, 1])
                found[side] = BeyondEdge(start, side, *place, float(above[k]), distance)
    return sorted(found.values(), key=lambda own: -own.distance_m)


def _chosen(grid: Grid, x: FloatArray, y: FloatArray) -> IntArray:
    """Choose some of the starts with a height, by their number: evenly, and the highest."""
    z = grid.value_at(x, y)
    known = np.flatnonzero(np.isfinite(z))
    half = _STARTS // 2
    even = np.unique(np.linspace(0, max(known.size - 1, 0), half).round().astype(int))
    highest = np.argsort(-z[known], kind="stable")[:half]
    out: IntArray = known[np.union1d(even[: known.size], highest)] if known.size else known
    return out


def _is_free(grid: Grid, start: FloatArray, end: FloatArray, top: float, slope: float) -> bool:
    """Return whether the terrain stays below a line that sinks from a height at the start."""
    far = float(np.hypot(*(end - start)))
    n = min(max(math.ceil(far / grid.cell_size), 2), _SAMPLES)
    share = np.linspace(0.0, 1.0, n)[1:-1]
    cells = grid.cell_of(*(start[i] + share * (end[i] - start[i]) for i in (0, 1)))
    heights = grid.values.ravel()[cells]
    # Where heights are missing nothing is in the way.
    return not bool((heights > top - slope * share * far).any())


def _side(row: int, col: int, shape: tuple[int, int]) -> str:
    """Return the side of the grid on which a cell of the edge lies."""
    sides = {"north": row, "west": col, "south": shape[0] - 1 - row, "east": shape[1] - 1 - col}
    return next((name for name, gap in sides.items() if gap == 0), "inner")
