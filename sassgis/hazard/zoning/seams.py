"""Areas of classes of a large place from those of its parts, which overlap.

Operations on polygons take more than twice as long on a line that is twice as long: a valley of
50 km is drawn in half of the time in parts of 4 km.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, pairwise
from typing import Any

import numpy as np
import shapely

from sassgis.grid import FloatArray
from sassgis.hazard.zoning.coverage import classes_of, faces_of, polygons_of

#: Length of a part at least, and of the stretch in which a seam is looked for (cells).
_LENGTH, _BAND = 800, 40
#: Places for a seam that are looked at.
_CHOICES = 81
_FAR = 1e9

#: Of each map, the area of each class with those above it.
Stacks = Sequence[Sequence[Any]]


def overlapping(n_cells: int, reach: int) -> list[slice]:
    """Cut a row of cells into stretches, each with the reach of drawing beyond its seams."""
    beyond = reach + _BAND // 2
    count = max(1, round(n_cells / max(_LENGTH, 8 * beyond)))
    ends = [n_cells * i // count for i in range(count + 1)]
    return [slice(max(0, a - beyond), min(n_cells, b + beyond)) for a, b in pairwise(ends)]


def joined_at_seams(
    parts: Sequence[Stacks], middles: FloatArray, cell_size: float, axis: int
) -> list[list[Any]]:
    """Join areas of a place from the stacks of its parts, which lie along an axis.

    Lines differ a little where parts overlap, as a line with fewer vertices depends on where its
    ring begins: a seam lies where the areas differ along the shortest length. ``middles`` are those
    of the overlaps on the axis, ascending. Axis 0: seams run from north to south, parts from west
    to east; 1: the other way.
    """
    half = _BAND / 2 * cell_size
    seams = [
        _seam(before, after, middle, half, axis)
        for (before, after), middle in zip(pairwise(parts), middles.tolist(), strict=True)
    ]
    bounds = list(pairwise([-_FAR, *seams, _FAR]))
    return [
        [
            shapely.multipolygons(
                np.concatenate(
                    [_within(a, *own, axis) for a, own in zip(of_class, bounds, strict=True)]
                )
            )
            for of_class in zip(*of_map, strict=True)
        ]
        for of_map in zip(*parts, strict=True)
    ]


def _seam(before: Stacks, after: Stacks, middle: float, half: float, axis: int) -> float:
    """Find where the areas of two parts differ least; among equals nearest to the middle."""
    low, high = middle - half, middle + half
    at = np.round(np.linspace(low, high, _CHOICES), 3)
    ends = np.full((at.size, 2, 2), [[-_FAR], [_FAR]])
    ends[:, :, axis] = at[:, None]
    lines = shapely.multilinestrings(np.asarray(shapely.linestrings(ends)))
    differ = np.zeros(at.size)
    for pair in zip(chain(*before), chain(*after), strict=True):
        one, other = (shapely.multipolygons(_within(area, low, high, axis)) for area in pair)
        faces = faces_of([one, other])
        apart = faces[classes_of(faces, [one]) != classes_of(faces, [other])]
        pieces = shapely.get_parts(shapely.intersection(lines, shapely.coverage_union_all(apart)))
        place = shapely.bounds(pieces).reshape(-1, 4)[:, axis]
        nearest = np.abs(place[:, None] - at).argmin(axis=1)
        differ += np.bincount(nearest, shapely.length(pieces), at.size)
    # Less than a centimetre is no difference.
    return float(at[np.lexsort((np.abs(at - middle), np.round(differ, 2)))[0]])


def _within(area: Any, low: float, high: float, axis: int) -> Any:
    """Return polygons of an area between two coordinates on an axis."""
    ends = np.array([[-_FAR, -_FAR], [_FAR, _FAR]])
    ends[:, axis] = low, high
    box = shapely.box(*ends.ravel())
    parts = polygons_of(area)
    bounds = shapely.bounds(parts).reshape(-1, 4)
    first, last = bounds[:, axis], bounds[:, axis + 2]
    inside = (first >= low) & (last <= high)
    cut = parts[~inside & (first < high) & (last > low)]
    return np.concatenate([parts[inside], polygons_of(shapely.intersection(cut, box))])
