"""Defects of a terrain model: terraces, spikes, pits, holes, and nodata read as heights.

Everything here works on plain arrays: row 0 in the north, NaN where nothing is known.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from sassgis.compiled.jit import kernel
from sassgis.grid import BoolArray, FloatArray, IntArray

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


# The limits are expert judgement of ours; docs/starting.md states them.
#: Neighbours that differ by this (m), or in slope by this (degrees) if that is more, are a wall.
_WALL_M, _WALL_DEG = 25.0, 80.0
#: Far below is this (m), or that slope if that is more, within so many cells.
_FAR_M, _WITHIN = 150.0, 3
#: Walls are looked for at this height and so many times it: interpolation overshoots near a wall,
#: which makes lower ones.
_HIGHER = (1.0, 2.0, 4.0, 8.0)
#: Fewer cells amid walls are ledges, and part of them.
_LEDGE = 9
#: An area begins so many cells from the ground: interpolation overshoots between them.
_OVERSHOT = 6
#: An area is far below if this share of its rim is, and no more than that looks down a wall.
_BELOW, _ABOVE = 0.8, 0.2
#: Cells that lie behind its walls, for each of its rim. Fewer are a tower in the midst of ground.
_BEHIND = 10
#: A rim of nodata is false if so many of its cells and this share of it lie below walls (or above
#: them), or this share far below.
_RIM_CELLS, _RIM_SHARE, _FAR_SHARE = 4, 0.5, 0.1

_AROUND = np.ones((3, 3), np.bool_)

TRACES_ADVICE = (
    "probably a number for nodata that was taken for heights and mixed with them by resampling: "
    "declare it before resampling (rio edit-info FILE --nodata NUMBER), or mask these cells"
)


@dataclass(frozen=True, slots=True)
class NodataTraces:
    """Cells whose heights come from a number for nodata, by itself or mixed with heights."""

    cells: BoolArray  # of the shape of the heights
    below_m: float  # how far they lie below the ground next to them (medians); 0 of none

    @property
    def words(self) -> str:
        """Description of the traces in words."""
        side = "below" if self.below_m > 0.0 else "above"
        count, by = int(self.cells.sum()), abs(self.below_m)
        return f"{count} cells lie about {by:.0f} m {side} the ground beside them"


def nodata_traces(values: FloatArray, cell_m: float) -> NodataTraces:
    """Find what numbers for nodata have left in heights (m), which are NaN where nothing is known.

    Found are areas that walls part from all else and that lie far below what is behind the walls;
    cells of walls far below all nearby ground, as of small holes and at the edge of the model; and
    rims of nodata of which the most part is a wall, all up or all down.
    """
    slope = math.tan(math.radians(_WALL_DEG)) * cell_m
    wall_m, far_m = max(_WALL_M, slope), max(_FAR_M, _WITHIN * slope)
    false, known = np.zeros(values.shape, np.bool_), np.isfinite(values)
    low, high = _walls(values, wall_m)
    if not (low | high).any():
        return NodataTraces(false, 0.0)
    for side, sign in ((low, 1.0), (high, -1.0)):
        false |= _rims(sign * values, known, side, far_m)
    for factor in _HIGHER:
        sides = _walls(values, factor * wall_m)
        false |= _parted(values, sides[0] | sides[1], far_m)
    return NodataTraces(false, _gap_m(values, false, low | high) if false.any() else 0.0)


def _gap_m(values: FloatArray, false: BoolArray, walls: BoolArray) -> float:
    """Measure how far false cells lie below the calm ground behind their walls (m)."""
    clusters, _ = ndimage.label(walls, _AROUND)
    met = np.unique(clusters[ndimage.binary_dilation(false, _AROUND)])
    behind = ndimage.binary_dilation(np.isin(clusters, met[met > 0]), _AROUND)
    ground = values[behind & ~walls & ~false]
    ground = ground[np.isfinite(ground)]
    if not ground.size:
        ground = values[np.isfinite(values)]
    return float(np.median(ground) - np.median(values[false]))


def _parted(values: FloatArray, walls: BoolArray, far_m: float) -> BoolArray:
    """Return cells that walls part from all other ground, far below it."""
    if not walls.any():
        return walls
    known = np.isfinite(values)
    areas, _ = ndimage.label(known & ~walls)
    calm = (np.bincount(areas.ravel()) >= _LEDGE)[areas] & (areas > 0)
    walls = known & ~calm
    clusters, n_clusters = ndimage.label(walls, _AROUND)
    beside = np.flatnonzero(calm & ndimage.binary_dilation(walls, _AROUND))
    cluster = ndimage.maximum_filter(clusters, 3).ravel()[beside]
    lowest = np.full(n_clusters + 1, np.inf)
    np.minimum.at(lowest, cluster, values.ravel()[beside])
    lowest[np.isinf(lowest)] = -np.inf
    false: BoolArray = walls & (values <= lowest[clusters] - far_m)
    return false | _areas_below(values, calm, beside, cluster, far_m)


def _walls(values: FloatArray, wall_m: float) -> tuple[BoolArray, BoolArray]:
    """Return cells with a neighbour that is higher by a wall, and those with one that is lower."""
    low, high = np.zeros(values.shape, np.bool_), np.zeros(values.shape, np.bool_)
    for axis in (0, 1):
        step = np.diff(np.moveaxis(values, axis, 0), axis=0)
        up, down = step >= wall_m, step <= -wall_m
        for side, first, second in ((low, up, down), (high, down, up)):
            turned = np.moveaxis(side, axis, 0)
            turned[:-1] |= first
            turned[1:] |= second
    return low, high


def _areas_below(
    values: FloatArray, calm: BoolArray, beside: IntArray, cluster: IntArray, far_m: float
) -> BoolArray:
    """Return areas of calm cells, parted by walls from all else, that lie far below it."""
    areas, n_areas = ndimage.label(calm)
    area = areas.ravel()[beside]
    above, below = _relief(values, beside, _OVERSHOT)
    rim = np.bincount(area, minlength=n_areas + 1)
    false = np.bincount(area, above >= far_m, n_areas + 1) >= _BELOW * rim
    # Beside a false area interpolation overshoots by a part of the step.
    down = below >= np.maximum(far_m, 0.5 * above)
    false &= np.bincount(area, down, n_areas + 1) <= _ABOVE * rim
    false &= rim > 0
    # Cells of the other areas at the walls of each.
    size = np.bincount(areas.ravel(), minlength=n_areas + 1)
    walls, own = np.unique(np.stack([cluster, area]), axis=1)
    others = np.bincount(walls, size[own])[walls] - size[own]
    false &= np.bincount(own, others, n_areas + 1) >= _BEHIND * rim
    cells: BoolArray = false[areas]
    return cells


def _relief(values: FloatArray, cells: IntArray, within: int) -> tuple[FloatArray, FloatArray]:
    """Measure how far the ground within some cells of others (flat indices) rises and falls (m)."""
    row, col = np.divmod(cells, values.shape[1])
    own = values.ravel()[cells]
    above, below = np.zeros(cells.size), np.zeros(cells.size)
    for down in range(-within, within + 1):
        for right in range(-within, within + 1):
            r = np.clip(row + down, 0, values.shape[0] - 1)
            c = np.clip(col + right, 0, values.shape[1] - 1)
            gap = values[r, c] - own
            np.fmax(above, gap, out=above)
            np.fmax(below, -gap, out=below)
    return above, below


def _rims(values: FloatArray, known: BoolArray, low: BoolArray, far_m: float) -> BoolArray:
    """Find cells of nodata rims that lie ``low`` next to a wall if most do, or many far below."""
    holes, n_holes = ndimage.label(~known, _AROUND)
    rim = known & ndimage.binary_dilation(~known, _AROUND)
    cells = np.flatnonzero(rim & low)
    hole = ndimage.maximum_filter(holes, 3)
    length = np.bincount(hole[rim], minlength=n_holes + 1)
    own = hole.ravel()[cells]
    steep = np.bincount(own, minlength=n_holes + 1)
    far = np.bincount(own, _relief(values, cells, _WITHIN)[0] >= far_m, n_holes + 1)
    false = (steep >= _RIM_CELLS) & (steep >= _RIM_SHARE * length)
    false |= (far >= _RIM_CELLS) & (far >= _FAR_SHARE * length)
    found = np.zeros(values.shape, np.bool_)
    found.flat[cells[false[own]]] = True
    return found
