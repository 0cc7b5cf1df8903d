"""Small terrains with known fall lines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sassgis.grid import FloatArray, Grid
from sassgis.settings.results import ReleasePoints, TraceSet

Heights = Callable[[FloatArray, FloatArray], FloatArray]


def grid_of(
    heights: Heights,
    n_cols: int = 100,
    n_rows: int = 100,
    cell: float = 2.0,
    west: float = 1000.0,
    north: float = 2000.0,
) -> Grid:
    """A grid of the heights at its cell centres, in coordinates from its middle."""
    x = (np.arange(n_cols) + 0.5 - n_cols / 2) * cell
    y = (n_rows / 2 - np.arange(n_rows) - 0.5) * cell
    xx, yy = np.meshgrid(x, y)
    return Grid(np.asarray(heights(xx, yy), np.float64), west, north, cell)


def middle(grid: Grid) -> tuple[float, float]:
    west, south, east, north = grid.bounds
    return 0.5 * (west + east), 0.5 * (south + north)


def points_at(x: object, y: object) -> ReleasePoints:
    xs, ys = np.atleast_1d(np.asarray(x, np.float64)), np.atleast_1d(np.asarray(y, np.float64))
    keys = np.arange(xs.size, dtype=np.uint64)
    return ReleasePoints(xs, ys, np.zeros(xs.size, np.int64), keys, ("a",))


def polyline(*lines: Any) -> TraceSet:
    """Traces through given points."""
    xy = [np.asarray(one, np.float64) for one in lines]
    s = [np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(one, axis=0).T))]) for one in xy]
    n = len(xy)
    return TraceSet(
        offset=np.cumsum([0, *map(len, xy)]),
        x=np.concatenate(xy)[:, 0].copy(),
        y=np.concatenate(xy)[:, 1].copy(),
        s=np.concatenate(s),
        point=np.arange(n, dtype=np.int64),
        end=np.zeros(n, np.uint8),
    )


def folded(x: FloatArray, y: FloatArray) -> FloatArray:
    """A slope to the east with a gully askew and a bench."""
    gully = 4.0 * np.exp(-(((y - 0.3 * x - 10.0) / 12.0) ** 2))
    return 1000.0 - 0.75 * np.minimum(x, 60.0) - gully - 0.05 * np.maximum(x - 60.0, 0.0)


def rough(x: FloatArray, y: FloatArray) -> FloatArray:
    """A slope of about 35° with gullies and bumps."""
    return (
        1000.0
        + 0.7 * y
        + 4.0 * np.sin(x / 9.0)
        + 2.0 * np.sin(x / 5.0 + y / 11.0)
        + 1.0 * np.cos(y / 6.0)
    )
