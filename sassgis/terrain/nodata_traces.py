"""Numbers for nodata that were taken for heights, also where resampling mixed them with heights.

What remains of them are areas far below all that lies next to them, and rims of nodata that are
steeper than terrain. Neither is looked for by its value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from sassgis.grid import BoolArray, FloatArray, IntArray

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
