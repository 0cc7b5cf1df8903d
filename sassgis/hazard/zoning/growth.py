"""Growth of a zone that is too small to be drawn: along the slope, over what blocks reached."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from sassgis.grid import BoolArray, Bounds, ClassMap, FloatArray, Grid

#: Length of a step across the slope, in steps along it: zones of single paths are long and narrow.
_ACROSS_SLOPE = 3.0
#: A step from a cell to others in (rows, columns): to the eight around it, and a knight's move.
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))


@dataclass(frozen=True, slots=True)
class Ground:
    """Cells around zones of one class: terrain, classes, and where the terrain is known."""

    grid: Grid
    classes: ClassMap
    known: BoolArray
    of_class: int
    averaged_m: float  # width over which heights are averaged to find the slope

    def around(self, bounds: Bounds, distance_m: float) -> Ground:
        """Return the cells within a distance of a box."""
        west, south, east, north = bounds
        size, (n_rows, n_cols) = self.grid.cell_size, self.grid.shape
        top = math.floor((self.grid.north - north - distance_m) / size)
        bottom = math.ceil((self.grid.north - south + distance_m) / size)
        left = math.floor((west - distance_m - self.grid.west) / size)
        right = math.ceil((east + distance_m - self.grid.west) / size)
        rows = slice(max(top, 0), min(bottom, n_rows))
        cols = slice(max(left, 0), min(right, n_cols))
        return replace(
            self,
            grid=self.grid.part(rows, cols),
            classes=self.classes[rows, cols],
            known=self.known[rows, cols],
        )

    def distance_from(self, zone: shapely.Polygon) -> FloatArray:
        """Return the least sum of steps from a zone to each cell, in cells along the slope.

        Steps over cells of the next lower class are the shortest. Infinite where the terrain is
        not known.
        """
        n_rows, n_cols = self.grid.shape
        cells = np.arange(n_rows * n_cols).reshape(n_rows, n_cols)
        x, y = self.grid.cell_centres(cells)
        shapely.prepare(zone)
        inside = shapely.intersects_xy(zone, x, y)
        if not inside.any():
            # A part without a cell centre, cut off by the edge of the terrain.
            apart = np.where(self.known, shapely.distance(zone, shapely.points(x, y)), np.inf)
            inside = apart == apart.min()
        lower = np.clip(self.of_class - self.classes, 1, None) * np.where(self.known, 1.0, np.inf)
        down = self._downslope()
        begin, end, length = [], [], []
        for step in _STEPS:
            one, other = _pairs(cells, step)
            along = (down[:, one] + down[:, other]) / 2.0
            # (rows, columns) of the step, along and across the mean direction of the slope.
            ahead = step[0] * along[0] + step[1] * along[1]
            steepness = np.hypot(*along)
            across = np.sqrt(np.maximum(step[0] ** 2 + step[1] ** 2 - ahead**2, 0.0))
            weight = 1.0 + (_ACROSS_SLOPE - 1.0) * steepness
            mean = (lower.ravel()[one] + lower.ravel()[other]) / 2.0
            length.append(np.hypot(ahead, weight * across) * mean)
            begin.append(one)
            end.append(other)
        lengths = np.concatenate(length)
        steps = np.isfinite(lengths)
        links = np.concatenate(begin)[steps], np.concatenate(end)[steps]
        graph = coo_array((lengths[steps], links), shape=(cells.size, cells.size)).tocsr()
        found = dijkstra(graph, directed=False, indices=cells[inside], min_only=True)
        return np.asarray(found).reshape(cells.shape)

    def _downslope(self) -> FloatArray:
        """Return the direction downslope in rows and columns, length 1 (0 on flat ground)."""
        sigma = 0.5 * self.averaged_m / self.grid.cell_size
        known = np.isfinite(self.grid.values)
        weight = ndimage.gaussian_filter(known.astype(float), sigma, mode="constant")
        heights = np.where(known, self.grid.values, 0.0)
        mean = ndimage.gaussian_filter(heights, sigma, mode="constant") / np.maximum(weight, 1e-9)
        slope = -np.stack([ndimage.correlate1d(mean, [-0.5, 0.0, 0.5], a) for a in (0, 1)])
        steepness = np.hypot(*slope)
        rising = (steepness > 1e-6 * self.grid.cell_size) & (weight > 1e-3)
        return (slope * np.where(rising, 1.0 / np.maximum(steepness, 1e-12), 0.0)).reshape(2, -1)


def _pairs(cells: np.ndarray, step: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return flat indices of all cells that a step joins: where it begins, and where it ends."""
    down, right = step
    left, rest = max(-right, 0), max(right, 0)
    n_rows, n_cols = cells.shape
    begin = cells[: n_rows - down, left : n_cols - rest]
    end = cells[down:, left + right : n_cols - rest + right]
    return begin.ravel(), end.ravel()
