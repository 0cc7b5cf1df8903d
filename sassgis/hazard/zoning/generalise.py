"""From a raster of classes to zones: generalised on the raster, then drawn as a valid coverage.

Both stages only ever raise a class: no place lies in a zone of a class below that of its cell.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from sassgis.hazard.zoning.outlines import smoothed
from sassgis.hazard.zoning.planar_graph import Outlines, regions
from sassgis.model.errors import InputError
from sassgis.model.grid import BoolArray, Grid, IntArray
from sassgis.model.hazard import ZoningSettings

#: Coordinates of zones are multiples of it (m): 1 m divided by a whole number.
_PRECISION_M = 0.001


def check_cells(cell_size: float) -> None:
    """Raise InputError if cells are not at least ten times the precision of coordinates."""
    if cell_size < 10.0 * _PRECISION_M:
        raise InputError(
            "cells are too small for the precision of the zones' coordinates",
            field="terrain.dem",
            found=f"cells of {cell_size:g} m",
            expected=f"cells of {10.0 * _PRECISION_M:g} m or more",
        )


@dataclass(frozen=True, slots=True)
class Coverage:
    """Zones: polygons that do not overlap, with their class.

    Attributes
    ----------
    polygons : object, shape (n,)
        ``shapely.Polygon``; neighbours share their vertices.
    classes : int64, shape (n,)
        From 1, ascending.
    """

    polygons: NDArray[Any]
    classes: IntArray


def _disk(span: int) -> list[tuple[int, int]]:
    """Cells of a disk that spans so many cells, from the corner of its box.

    Where the span is even, its centre is a corner of cells.
    """
    centre = (span - 1) / 2.0
    return [
        (i, j)
        for i in range(span)
        for j in range(span)
        if (i - centre) ** 2 + (j - centre) ** 2 <= centre**2 + 0.25
    ]


def _square(span: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(span) for j in range(span)]


def _dilated(mask: BoolArray, shape: list[tuple[int, int]]) -> BoolArray:
    """Union of shapes set on each cell, by the corner of the shape's box; larger by the box."""
    span = max(i for i, _ in shape)
    n_rows, n_cols = mask.shape
    out = np.zeros((n_rows + span, n_cols + span), np.bool_)
    for i, j in shape:
        out[i : i + n_rows, j : j + n_cols] |= mask
    return out


def _eroded(mask: BoolArray, shape: list[tuple[int, int]]) -> BoolArray:
    """Where the shape fits into the mask, by the corner of its box; smaller by the box."""
    span = max(i for i, _ in shape)
    n_rows, n_cols = mask.shape[0] - span, mask.shape[1] - span
    out = np.ones((n_rows, n_cols), np.bool_)
    for i, j in shape:
        out &= mask[i : i + n_rows, j : j + n_cols]
    return out


def _closed(mask: BoolArray, gap: int) -> BoolArray:
    """Fill where no disk fits that is wider than the gap; beyond the raster there is nothing."""
    shape = _disk(gap + 1)
    return _eroded(_dilated(mask, shape), shape)


def _carried_on(mask: BoolArray, width: int, known: BoolArray) -> BoolArray:
    """A mask that goes on where nothing is known, as it is at the nearest cells that are known.

    Larger by the width on each side. Of known cells that are equally near, one in the mask counts.
    Beyond twice the width from the mask it may end: no disk there bears on the mask.
    """
    if known.all():
        return np.pad(mask, width, mode="edge")
    inside = np.pad(mask, width)
    outside = np.pad(known, width) & ~inside
    out = inside.copy()
    reach = 2 * width
    near = ndimage.maximum_filter(inside, 2 * reach + 1) & ~inside & ~outside
    for box in ndimage.find_objects(ndimage.label(near)[0]):
        # The nearest known cell of each of these lies within the reach, across at most.
        around = tuple(slice(max(s.start - 2 * reach, 0), s.stop + 2 * reach) for s in box)
        out[around] |= near[around] & _nearer(inside[around], outside[around])
    return out


def _nearer(inside: BoolArray, outside: BoolArray) -> BoolArray:
    """Cells that lie no farther from some cells than from others; all if there are no others."""
    if not outside.any():
        return np.ones_like(inside)
    distance = ndimage.distance_transform_edt
    nearer: BoolArray = distance(~inside) <= distance(~outside)
    return nearer


def _narrow(mask: BoolArray, width: int, known: BoolArray) -> BoolArray:
    """Cells of parts that are too narrow for a disk."""
    if width == 1:
        return np.zeros_like(mask)
    shape = _disk(width)
    # Beyond what is known a part goes on as it is at the edge. Cut off there, its acute corners
    # would be narrow however far they grew, and they would grow along the whole edge.
    wide = _dilated(_eroded(_carried_on(mask, width, known), shape), shape)
    # A disk does not reach into the corners of a wide part: they are not narrow for that.
    slack = (width // 2 + 1) // 2
    near = _dilated(wide, _square(2 * slack + 1))[slack:-slack, slack:-slack]
    return mask & ~near[width:-width, width:-width]


def _widened(mask: BoolArray, width: int, known: BoolArray) -> BoolArray:
    """Let parts that are too narrow for a disk grow by a cell on each side until one fits.

    Step by step, so that they do not grow through terrain that is unknown.
    """
    for _ in range(width):
        narrow = _narrow(mask, width, known)
        if not narrow.any():
            break
        mask = mask | (_dilated(narrow, _disk(3))[1:-1, 1:-1] & known)
    return mask


def _without_rims(classes: IntArray, width: int, known: BoolArray) -> IntArray:
    """Raise parts of a class that are narrow and beside a higher one to that one.

    From the lowest class up: several narrow rims beside each other become one that is wide enough,
    and not all the highest.
    """
    out = classes.copy()
    for k in range(1, int(classes.max())):
        narrow = _narrow(out == k, width, known)
        if narrow.any():
            part = regions(narrow.astype(np.int64))
            raised = _joining(part.of_cell, out, part.cells.size)
            out = np.where(narrow, np.maximum(raised[part.of_cell], out), out)
    return out


def _with_each(
    classes: IntArray, known: BoolArray, enlarged: Callable[[BoolArray], BoolArray]
) -> IntArray:
    """Enlarge {class >= k} for every class k, where the terrain is known."""
    out = classes.copy()
    for k in range(1, int(classes.max()) + 1):
        region = classes >= k
        if region.any():
            out[enlarged(region) & known & ~region] = k
    return out


def _without_small_holes(classes: IntArray, smallest: int, known: BoolArray) -> IntArray:
    """Raise holes in {class >= k} that are smaller than the smallest area to k, for every k.

    A hole hangs together over sides of cells and does not touch the edge of what is known.
    """
    out = classes.copy()
    # What lies outside of the cells next to a class hangs together up to the edge.
    boxes = ndimage.find_objects(out)
    for k in range(1, len(boxes) + 1):
        above = [box for box in boxes[k - 1 :] if box is not None]
        around = tuple(
            slice(max(min(s.start for s in sides) - 1, 0), max(s.stop for s in sides) + 1)
            for sides in zip(*above, strict=True)
        )
        own = out[around]
        part = regions((own >= k).astype(np.int64))
        is_open = np.zeros(part.cells.size, np.bool_)
        is_open[part.of_cell[~known[around]]] = True
        for side in (part.of_cell[[0, -1], :], part.of_cell[:, [0, -1]]):
            is_open[side] = True
        hole = (part.klass == 0) & (part.cells < smallest) & ~is_open
        np.maximum(own, k, out=own, where=hole[part.of_cell])
    return out


def _borders(of_cell: IntArray, classes: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """(region, class of its neighbour, sides of cells) for neighbours of a higher class."""
    lower, higher = [], []
    for a, b in (
        ((slice(None), slice(0, -1)), (slice(None), slice(1, None))),
        ((slice(0, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        for one, other in ((a, b), (b, a)):
            rises = classes[other] > classes[one]
            lower.append(of_cell[one][rises])
            higher.append(classes[other][rises])
    region = np.concatenate(lower)
    neighbour = np.concatenate(higher)
    base = int(classes.max()) + 1
    key, sides = np.unique(region * base + neighbour, return_counts=True)
    return key // base, key % base, sides.astype(np.int64)


def _joining(of_cell: IntArray, classes: IntArray, n: int) -> IntArray:
    """Higher class with which each of n regions shares the longest border; 0: touches none.

    Of equally long borders that with the lower class counts.
    """
    raised = np.zeros(n, np.int64)
    region, neighbour, sides = _borders(of_cell, classes)
    order = np.lexsort((-neighbour, sides))
    raised[region[order]] = neighbour[order]
    return raised


def _without_small_regions(classes: IntArray, smallest: int, known: BoolArray) -> IntArray:
    """Raise small regions to a higher class that they touch, or let them grow."""
    part = regions(classes)
    small = (part.klass > 0) & (part.cells < smallest)
    if not small.any():
        return classes
    raised = _joining(part.of_cell, classes, part.cells.size)
    joins = small & (raised > 0)
    out = np.where(joins[part.of_cell], raised[part.of_cell], classes)
    if joins.any():
        # What has changed is judged anew before anything grows.
        return out
    number = np.zeros(part.cells.size, np.int64)
    number[small] = np.arange(1, int(small.sum()) + 1)
    boxes = ndimage.find_objects(number[part.of_cell])
    for label, box in zip(np.flatnonzero(small), boxes, strict=True):
        _grow(out, classes, part.of_cell, int(label), box, smallest, known)
    return out


def _grow(
    out: IntArray,
    classes: IntArray,
    of_cell: IntArray,
    label: int,
    box: tuple[slice, slice],
    smallest: int,
    known: BoolArray,
) -> None:
    """Raise the cells nearest to a small region until it has the smallest area, in ``out``.

    All cells at the same distance go together. A region that cannot grow enough, as nodata is all
    around it, stays as it is.
    """
    reach = math.ceil(1.2 * math.sqrt(smallest)) + 1
    while True:
        window = tuple(
            slice(max(s.start - reach, 0), min(s.stop + reach, n))
            for s, n in zip(box, classes.shape, strict=True)
        )
        own = of_cell[window] == label
        k = int(classes[window][own][0])
        open_to = known[window] | (classes[window] >= k)
        distance2 = np.rint(ndimage.distance_transform_edt(~own) ** 2).astype(np.int64)
        distance2[~open_to] = np.iinfo(np.int64).max
        limits = np.unique(distance2[open_to])
        # Fewer cells are never enough; more are needed where nodata cuts some off.
        at_least = int(np.searchsorted(limits, np.sort(distance2[open_to])[:smallest][-1]))
        for limit in limits[at_least:]:
            grown = distance2 <= limit
            labels = regions(grown.astype(np.int64)).of_cell
            grown = labels == labels[own][0]
            if int(grown.sum()) >= smallest:
                # What would be lowered by it is higher already, and is left.
                out[window] = np.where(grown, np.maximum(out[window], k), out[window])
                return
        if reach >= smallest:
            return
        reach = min(2 * reach, smallest)


def generalised(
    classes: IntArray,
    cell_size: float,
    settings: ZoningSettings | None = None,
    at_least: IntArray | None = None,
    known: BoolArray | None = None,
) -> IntArray:
    """Close gaps, fill small holes and let small regions join or grow, on the raster.

    Parameters
    ----------
    classes : int, shape (n_rows, n_cols)
        0 where nothing arrives.
    cell_size : float
        Side of a cell (m).
    at_least : int, shape (n_rows, n_cols), optional
        Classes below which no cell may lie: the generalised map of a more frequent return period.
    known : bool, shape (n_rows, n_cols), optional
        Where the terrain is known; nothing grows elsewhere.

    Returns
    -------
    int64, shape (n_rows, n_cols)
        Nowhere below ``classes`` or ``at_least``. Another pass changes nothing.

    Notes
    -----
    The rules are applied in turn until none of them changes anything:

    1. For each class k, parts of {class >= k} narrower than ``min_width_m`` are widened.
    2. Gaps of {class >= k} no wider than ``closing_m`` are closed. Both by mathematical morphology
       with disks (Serra 1982).
    3. Holes in {class >= k} smaller than ``min_area_m2`` are raised to k.
    4. Parts of one class narrower than ``min_width_m`` join the higher class with which they share
       the longest border, from the lowest class up.
    5. Regions of one class smaller than ``min_area_m2`` join the higher class with which they share
       the longest border; those that touch none grow by the nearest cells.
    """
    settings = settings or ZoningSettings()
    out = np.array(classes, np.int64)
    if at_least is not None:
        out = np.maximum(out, np.asarray(at_least, np.int64))
    if out.size == 0 or not out.any():
        return out
    if out.min() < 0:
        raise ValueError("a class is below 0")
    is_known = np.ones(out.shape, np.bool_) if known is None else np.asarray(known, np.bool_)
    smallest = settings.smallest_cells(cell_size)
    gap = settings.closing_cells(cell_size)
    width = settings.width_cells(cell_size)
    while True:
        before = out
        out = _with_each(out, is_known, lambda region: _widened(region, width, is_known))
        out = _with_each(out, is_known, lambda region: _closed(region, gap))
        out = _without_small_holes(out, smallest, is_known)
        out = _without_rims(out, width, is_known)
        out = _without_small_regions(out, smallest, is_known)
        if np.array_equal(out, before):
            return out


def generalised_series(
    class_maps: Sequence[IntArray],
    cell_size: float,
    settings: ZoningSettings | None = None,
    known: BoolArray | None = None,
) -> list[IntArray]:
    """Generalise maps from the most frequent return period to the rarest, each above the last.

    Parameters
    ----------
    class_maps : sequence of int, shape (n_rows, n_cols)
    cell_size, settings, known
        As in `generalised`.
    """
    out: list[IntArray] = []
    for classes in class_maps:
        out.append(generalised(classes, cell_size, settings, out[-1] if out else None, known))
    return out


def _polygons(outlines: Outlines, grid: Grid) -> Coverage:
    """Polygons of outlines: each outer ring with the holes of the same region."""
    rings = outlines.rings()
    of_label = outlines.klass
    hole = rings.double_area < 0
    order = np.lexsort((hole, rings.label, of_label[rings.label]))
    label = rings.label[order]
    length = np.diff(rings.start)[order]
    start = np.concatenate(([0], np.cumsum(length)))
    vertex = np.repeat(rings.start[:-1][order] - start[:-1], length) + np.arange(start[-1])
    per_metre = round(1.0 / _PRECISION_M)

    def snapped(metres: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(np.rint(metres * per_metre) / per_metre)

    coordinates = np.column_stack(
        (
            snapped(grid.west + rings.col[vertex] * grid.cell_size),
            snapped(grid.north - rings.row[vertex] * grid.cell_size),
        )
    )
    is_outer = ~hole[order]
    first = np.append(np.flatnonzero(is_outer), label.size)
    polygons = shapely.from_ragged_array(shapely.GeometryType.POLYGON, coordinates, (start, first))
    return Coverage(np.asarray(polygons, object), of_label[label[is_outer]])


def nested_coverages(
    class_maps: Sequence[IntArray],
    grid: Grid,
    settings: ZoningSettings | None = None,
    known: BoolArray | None = None,
) -> list[Coverage]:
    """Draw the zones of several return periods, from the most frequent to the rarest.

    Parameters
    ----------
    class_maps : sequence of int, shape (n_rows, n_cols)
        Generalised classes (`generalised_series`), each nowhere below the one before.
    grid : Grid
        Where the cells lie; its values are not used.
    known : bool, shape (n_rows, n_cols), optional
        Where the terrain is known; no boundary is smoothed beyond it.

    Returns
    -------
    list of Coverage
        One per map: a valid coverage whose zones contain their cells. {class >= k} of a rarer map
        contains that of a more frequent one.

    Raises
    ------
    ValueError
        If a map does not fit the grid, is not above the one before, or has a class below 0.
    InputError
        If cells are not at least ten times the precision of the coordinates.
    """
    settings = settings or ZoningSettings()
    maps = [np.asarray(m, np.int64) for m in class_maps]
    for m in maps:
        if m.shape != grid.shape:
            raise ValueError(f"classes of shape {m.shape} on a grid of {grid.shape}")
        if m.size and m.min() < 0:
            raise ValueError("a class is below 0")
    if any((rare < frequent).any() for frequent, rare in pairwise(maps)):
        raise ValueError("a rarer return period is below a more frequent one")
    check_cells(grid.cell_size)
    if not maps or maps[0].size == 0:
        return [Coverage(np.empty(0, object), np.empty(0, np.int64)) for _ in maps]
    smallest = settings.smallest_cells(grid.cell_size)
    tolerance = settings.tolerance_cells(grid.cell_size)
    has_lid = known is not None and not known.all()
    # Around the raster goes on what is in no zone: cells cut off at its edge are no small region.
    rim = math.ceil(math.sqrt(smallest)) + 1
    maps = [np.pad(m, rim) for m in maps]
    known = np.pad(np.ones(grid.shape, np.bool_) if known is None else known, rim)
    grid = replace(
        grid,
        values=np.zeros(maps[0].shape),
        west=grid.west - rim * grid.cell_size,
        north=grid.north + rim * grid.cell_size,
    )
    lid: Outlines | None = None
    if has_lid:
        # The known terrain as it is, high enough for any class.
        highest = int(maps[-1].max())
        lid = smoothed(np.where(known | (maps[-1] > 0), highest, 0), 1, 0.0)
    drawn: list[Outlines] = []
    # The rarest goes first and has the most freedom; the others stay inside it, one by one.
    for classes in reversed(maps):
        lid = smoothed(classes, smallest, tolerance, lid)
        drawn.append(lid)
    return [_polygons(outlines, grid) for outlines in reversed(drawn)]


def coverage(classes: IntArray, grid: Grid, settings: ZoningSettings | None = None) -> Coverage:
    """Draw the zones of one map; see `nested_coverages`."""
    return nested_coverages([classes], grid, settings)[0]
