"""Copies of a wall, net or station, moved up and down the slope: where else it could stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from sassgis.grid import FloatArray, Grid
from sassgis.settings.results import ControlLine

#: Distances in plan by which lines are moved (m); downslope is positive.
MOVES_M = tuple(float(m) for m in range(-60, 61, 20) if m)
#: Copies of all lines together at most: each is one more station that every path is cut with.
MOST_COPIES = 90


@dataclass(frozen=True, slots=True)
class MovedLine:
    """A copy of a line."""

    of: int  # position of the line itself among the lines
    moved_m: float  # distance in plan, downslope positive (m)
    trace: FloatArray  # shape (n, 2); x and y of its vertices (m)

    def as_station(self, name: str) -> tuple[ControlLine, FloatArray]:
        """Return a station there: it records blocks and stops none."""
        return ControlLine(f"{name} {self.moved_m:+g} m", "station"), self.trace


def moved_lines(
    grid: Grid, lines: Sequence[tuple[ControlLine, FloatArray]]
) -> tuple[MovedLine, ...]:
    """Copy each line by MOVES_M along the mean fall of the ground below it.

    Those that leave the terrain are left out; none are made where the ground is level, or where
    there would be more than MOST_COPIES.
    """
    if len(lines) * len(MOVES_M) > MOST_COPIES:
        return ()
    return tuple(
        copy
        for number, (_, trace) in enumerate(lines)
        for copy in _copies(grid, number, np.asarray(trace, np.float64))
    )


def mean_height_m(grid: Grid, trace: FloatArray) -> float:
    """Return the mean height of the ground below a line (m); NaN where it leaves the terrain."""
    return float(grid.value_at(*_points(grid, trace).T).mean())


def _copies(grid: Grid, number: int, trace: FloatArray) -> list[MovedLine]:
    points = _points(grid, trace)
    reach = max(2.0 * grid.cell_size, 10.0)
    aside = reach * np.eye(2)
    fall = [grid.value_at(*(points - d).T) - grid.value_at(*(points + d).T) for d in aside]
    known = np.isfinite(fall).all(axis=0)
    down = np.array([f[known].mean() if known.any() else 0.0 for f in fall])
    if not np.hypot(*down) > 0.0:
        return []
    down /= np.hypot(*down)
    copies = [MovedLine(number, m, trace + m * down) for m in MOVES_M]
    return [c for c in copies if np.isfinite(mean_height_m(grid, c.trace))]


def _points(grid: Grid, trace: FloatArray) -> FloatArray:
    """Return points on a line, a cell apart at most."""
    dense = shapely.segmentize(shapely.LineString(trace), grid.cell_size)
    points: FloatArray = shapely.get_coordinates(dense)
    return points
