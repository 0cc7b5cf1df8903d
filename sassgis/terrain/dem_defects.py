"""Defects in the heights of a terrain model: terraces, spikes, pits, holes.

Everything here works on plain arrays: row 0 in the north, NaN where nothing is known.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from scipy import ndimage

from sassgis.compiled.jit import kernel
from sassgis.grid import BoolArray, FloatArray

#: Steps in which heights are stored (m), the foot among them.
_STEPS_M = (100.0, 50.0, 25.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.3048, 0.25, 0.2, 0.1, 0.05, 0.01)
#: Intervals of contour lines (m).
_INTERVALS_M = (1.0, 2.0, 2.5, 5.0, 10.0, 20.0, 25.0, 50.0, 100.0)
#: Levels that heights must span before they say something of an interval.
_LEAST_LEVELS = 5
#: Neighbours are compared where the ground rises by more than this over four cells.
_NOT_LEVEL = math.tan(math.radians(10.0))
#: A bump stands out from neighbours that are less uneven than it by this factor.
_STANDS_OUT = 4.0
#: Steps to one of two opposite neighbours: (rows, columns).
_AXES = ((0, 1), (1, 0), (1, 1), (1, -1))


def height_step(values: FloatArray) -> float:
    """Return the step (m) of which all heights are multiples; 0 if there is none."""
    known = values[np.isfinite(values)]
    # Heights in single precision are off by this much.
    tolerance = 2.0 * float(np.spacing(np.float32(np.abs(known).max(initial=0.0))))
    for step in _STEPS_M:
        if step < 4.0 * tolerance:
            break
        if np.abs(known - np.rint(known / step) * step).max(initial=0.0) <= tolerance:
            return step
    return 0.0


def contour_interval(values: FloatArray) -> tuple[float, float]:
    """Find the interval (m) of contour lines that shows in the heights; 0 if none does.

    Where terrain was interpolated from contour lines, or smoothed after its heights had been
    rounded, heights crowd near the multiples of the interval. The second value is the share of the
    heights within a tenth of the interval around a multiple, in the median over the levels; 0.1
    where nothing crowds.
    """
    known = values[np.isfinite(values)]
    best = (0.0, 0.2)
    for interval in _INTERVALS_M:
        level = np.rint(known / interval).astype(np.int64)
        level -= level.min(initial=0)
        near = np.abs(known / interval - np.rint(known / interval)) < 0.05
        counts = np.bincount(level)
        inner = counts > 20
        if inner.sum() >= _LEAST_LEVELS:
            share = np.bincount(level, near, counts.size)[inner] / counts[inner]
            crowding = float(np.median(share))
            if crowding > best[1]:
                best = (interval, crowding)
    return best if best[0] else (0.0, 0.1)


def equal_neighbours(values: FloatArray, dx_m: float, dy_m: float) -> float:
    """Compute the share of neighbours of equal height across rising ground.

    Cells that were repeated to make smaller ones, and terraces, show here.
    """
    equal = compared = 0
    for axis, size in ((0, dy_m), (1, dx_m)):
        turned = np.moveaxis(values, axis, 0)
        if turned.shape[0] < 5:
            continue
        rise = np.abs(turned[4:] - turned[:-4]) / (4.0 * size)
        steep = rise > _NOT_LEVEL
        same = np.abs(turned[2:-2] - turned[3:-1]) < 1e-9
        equal += int((same & steep).sum())
        compared += int(steep.sum())
    return equal / compared if compared else 0.0


def bumps_m(values: FloatArray) -> FloatArray:
    """Measure how far each cell stands above all four lines through opposite neighbours (m).

    Positive for spikes, negative for single pits, and 0 for all others: where a neighbour is
    missing, on planes, ridges and steps, and where the neighbours are as uneven themselves (a bump
    less than four times their root mean square distance from their plane), as on a rough face.
    """
    n_rows, n_cols = values.shape

    def shifted(row: int, col: int) -> FloatArray:
        return values[1 + row : n_rows - 1 + row, 1 + col : n_cols - 1 + col]

    inner = shifted(0, 0)
    pairs = [(shifted(row, col), shifted(-row, -col)) for row, col in _AXES]
    gaps = [inner - 0.5 * (one + two) for one, two in pairs]
    low, high = np.min(gaps, axis=0), np.max(gaps, axis=0)
    bumps = np.where(low > 0.0, low, np.where(high < 0.0, high, 0.0))
    # The plane through the eight neighbours: their mean and, with the offsets -1, 0, 1, slopes.
    offsets = [*_AXES, *((-row, -col) for row, col in _AXES)]
    ring = [*(one for one, _ in pairs), *(two for _, two in pairs)]
    mean = sum(ring) / 8.0
    down = sum(row * z for (row, _), z in zip(offsets, ring, strict=True)) / 6.0
    right = sum(col * z for (_, col), z in zip(offsets, ring, strict=True)) / 6.0
    squares = sum(
        (z - mean - row * down - col * right) ** 2
        for (row, col), z in zip(offsets, ring, strict=True)
    )
    uneven = np.sqrt(squares / 8.0)
    out = np.zeros(values.shape)
    out[1:-1, 1:-1] = np.nan_to_num(np.where(np.abs(bumps) >= _STANDS_OUT * uneven, bumps, 0.0))
    return out


def inner_holes(values: FloatArray) -> BoolArray:
    """Return nodata that is surrounded by known cells, and so no part of the outside."""
    labels, _ = ndimage.label(~np.isfinite(values))
    rim = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    outside: BoolArray = np.isin(labels, np.unique(rim))
    holes: BoolArray = (labels > 0) & ~outside
    return holes


def depression_depth(values: FloatArray) -> FloatArray:
    """Compute the depth of each cell under the level at which its depression would overflow (m).

    Depressions are filled from the rim of the terrain inwards by priority flood (Barnes, Lehman and
    Mulla, 2014, Computers & Geosciences 62, 117-127; not checked against the source). Nodata
    drains.
    """
    filled = _flooded(np.ascontiguousarray(values, np.float64))
    depth: FloatArray = np.nan_to_num(filled - values)
    return depth


@kernel
def _flooded(values: FloatArray) -> FloatArray:
    n_rows, n_cols = values.shape
    filled = values.copy()
    done = np.zeros((n_rows, n_cols), np.bool_)
    heap = [(0.0, 0)]
    heap.pop()
    for row in range(n_rows):
        for col in range(n_cols):
            if np.isnan(values[row, col]):
                done[row, col] = True
                continue
            outlet = row == 0 or col == 0 or row == n_rows - 1 or col == n_cols - 1
            if not outlet:
                for i in range(row - 1, row + 2):
                    for j in range(col - 1, col + 2):
                        outlet = outlet or np.isnan(values[i, j])
            if outlet:
                done[row, col] = True
                heapq.heappush(heap, (values[row, col], row * n_cols + col))
    while len(heap) > 0:
        level, cell = heapq.heappop(heap)
        row, col = cell // n_cols, cell % n_cols
        for i in range(max(row - 1, 0), min(row + 2, n_rows)):
            for j in range(max(col - 1, 0), min(col + 2, n_cols)):
                if not done[i, j]:
                    done[i, j] = True
                    if filled[i, j] < level:
                        filled[i, j] = level
                    heapq.heappush(heap, (filled[i, j], i * n_cols + j))
    return filled
