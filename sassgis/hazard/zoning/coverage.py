"""Zones as polygons that share their borders exactly, from regions of cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csgraph, csr_array

from sassgis.errors import InputError
from sassgis.grid import BoolArray, Grid, IntArray

#: Coordinates of zones are multiples of it (m).
_DECIMALS = 3
PRECISION_M = 10.0**-_DECIMALS


def check_cells(cell_size: float) -> None:
    """Raise InputError if cells are not at least ten times the precision of coordinates."""
    if cell_size < 10.0 * PRECISION_M:
        raise InputError(
            "cells are too small for the precision of the zones' coordinates",
            field="terrain.dem",
            found=f"cells of {cell_size:g} m",
            expected=f"cells of {10.0 * PRECISION_M:g} m or more",
        )


def within_terrain(polygons: Sequence[Any], grid: Grid) -> tuple[Any, ...]:
    """Return the parts of polygons where the terrain is known; empty without any."""
    if not polygons:
        return ()
    known = shapely.union_all(cell_polygons(np.isfinite(grid.values), grid))
    parts = shapely.get_parts(shapely.union_all(list(polygons)).intersection(known))
    return tuple(parts[shapely.area(parts) > 0.0])


def cell_polygons(cells: BoolArray, grid: Grid) -> NDArray[Any]:
    """Return regions of cells that share sides as Polygons, shape (n,).

    They are in the order of the first cell of each; shells run clockwise, holes the other way.
    Raises InputError if cells are not at least ten times the precision of the coordinates.
    """
    check_cells(grid.cell_size)
    row, col, region, down = _corners(cells)
    if not row.size:
        return np.empty(0, object)
    # Each corner has a side along its row and one along its column. The other end of the first is
    # the next or the one before, as corners are row by row.
    beside = np.arange(row.size) ^ 1
    pairs = np.lexsort((down, row, col)).reshape(-1, 2)
    above_below = np.empty_like(beside)
    above_below[pairs] = pairs[:, ::-1]
    ring = csgraph.connected_components(_graph(above_below, beside))[1]
    first = np.unique(ring, return_index=True)[1]
    first = first[np.lexsort((first, region[first]))]
    # Every second corner of each ring; where a ring ends, the next one begins.
    first = beside[first]
    onward = beside[above_below]
    before = np.empty_like(onward)
    before[onward] = np.arange(row.size)
    onward[before[first][:-1]] = first[1:]
    order = csgraph.depth_first_order(_graph(onward), first[0], return_predecessors=False)
    place = np.stack((order, above_below[order]), axis=1).ravel()
    at = np.stack((col, -row), axis=1)[place] * grid.cell_size + [grid.west, grid.north]
    starts = np.zeros(row.size, np.int64)
    starts[first] = 1
    rings = shapely.linearrings(
        np.round(at, _DECIMALS), indices=np.repeat(np.cumsum(starts[order]) - 1, 2)
    )
    # The first corner of a region is one of its shell, which so is the first of its rings.
    polygons = shapely.polygons(rings, indices=region[first] - 1)
    return np.asarray(shapely.orient_polygons(polygons, exterior_cw=True), object)


#: Whether the middle of four cells is a corner, by which of them are filled (1, 2, 4, 8).
_IS_CORNER = np.array([n.bit_count() in (1, 3) or n in (6, 9) for n in range(16)])


def _corners(cells: BoolArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Return row, column, region (from 1) and direction (1: down) of corners of regions."""
    filled = np.pad(cells, 1)
    region = ndimage.label(filled)[0]
    # Corners are where one or three of the four cells around are filled, or two opposite ones.
    bits = filled.astype(np.int8)
    of_four = bits[:-1, :-1] + 2 * bits[:-1, 1:] + 4 * bits[1:, :-1] + 8 * bits[1:, 1:]
    i, j = np.nonzero(_IS_CORNER[of_four])
    # By whether a cell is south and whether it is east of the point.
    around = {(s, e): region[i + s, j + e] for s in (0, 1) for e in (0, 1)}
    highest = np.max(list(around.values()), axis=0)
    count = sum((a > 0).astype(np.int8) for a in around.values())
    found = []
    for (south, east), own in around.items():
        opposite, neighbour = around[1 - south, 1 - east], around[1 - south, east]
        alone = ((count == 1) & (own > 0)) | ((count == 3) & (own == 0))
        # Where two cells meet at a point each has a separate corner if they are of two regions.
        # If they are of one, each of the two empty cells has: so a shell and a hole touch there,
        # or two holes, in place of one ring that touches itself.
        met = (count == 2) & ((own > 0) == (opposite > 0))
        other = around[south, 1 - east]
        alone |= met & np.where(own > 0, own != opposite, neighbour == other)
        of = np.where(own > 0, own, highest)[alone]
        sides = np.full(of.size, south), np.full(of.size, east)
        found.append((i[alone], j[alone], of, *sides))
    row, col, of, down, right = np.concatenate(found, axis=1).astype(np.int64)
    order = np.lexsort((right, col, row))
    return row[order], col[order], of[order], down[order]


def _graph(*linked: IntArray) -> csr_array:
    """Return corners, each linked to one of each of ``linked``."""
    size, ends = linked[0].size, np.concatenate(linked)
    links = np.tile(np.arange(size), len(linked)), ends
    return csr_array((np.ones(ends.size, np.int8), links), shape=(size, size))


#: Places that are nowhere wider than this (m) are no separate zones.
_THREAD_M = 0.2


@dataclass(frozen=True, slots=True)
class Coverage:
    """Zones: polygons that do not overlap, with their class."""

    polygons: NDArray[Any]  # shape (n,); ``shapely.Polygon``; neighbours share their vertices
    classes: IntArray  # shape (n,); from 1, ascending


def polygons_of(area: Any) -> NDArray[Any]:
    """Return the polygons of a geometry, without its lines and points."""
    parts = shapely.get_parts(area)
    return np.asarray(parts[shapely.get_type_id(parts) == shapely.GeometryType.POLYGON], object)


def faces_of(areas: Sequence[Any]) -> NDArray[Any]:
    """Return polygons into which the borders of areas divide the plane, on coordinates of 1 mm."""
    lines = shapely.unary_union(shapely.boundary(np.asarray(areas)), grid_size=PRECISION_M)
    faces = shapely.polygonize([lines])
    # Of a valley of 50 km they take a tenth of all memory; parts are copies.
    del lines
    return np.asarray(shapely.get_parts(faces), object)


def classes_of(faces: NDArray[Any], stack: Sequence[Any]) -> IntArray:
    """Return the number of the last area of a stack that holds each face; 0 for none."""
    inside = shapely.point_on_surface(faces)
    x, y = shapely.get_x(inside), shapely.get_y(inside)
    out = np.zeros(faces.size, np.int64)
    for k, area in enumerate(stack, start=1):
        shapely.prepare(area)
        out[shapely.contains_xy(area, x, y)] = k
    return out


def without_threads(faces: NDArray[Any], classes: IntArray) -> IntArray:
    """Return classes of faces; one that is nowhere 0.2 m wide joins the next higher beside it.

    This is repeated, as several may lie side by side. A face no wider than the rounding of
    coordinates joins the highest wider face that it borders, also a lower one. A thread that got
    its class only over such a face returns to the class of its neighbours.
    """
    out = classes.copy()
    threads = np.flatnonzero(_nowhere_wider(faces, _THREAD_M))
    thread, face = shapely.STRtree(faces).query(faces[threads], predicate="touches")
    # The borders of both have a line in common.
    shared = shapely.relate_pattern(faces[threads[thread]], faces[face], "****1****")
    thread, face = threads[thread[shared]], face[shared]
    while True:
        higher = out[face] > out[thread]
        if not higher.any():
            break
        joined = np.full(out.size, np.iinfo(np.int64).max)
        np.minimum.at(joined, thread[higher], out[face][higher])
        out = np.where(joined < np.iinfo(np.int64).max, joined, out)
    rounding = _nowhere_wider(faces, 2.0 * PRECISION_M)
    wide = ~rounding[face]
    thread, face = thread[wide], face[wide]
    highest = _highest_beside(out, thread, face)
    out = np.where((highest >= classes) & (highest < out), highest, out)
    highest = _highest_beside(out, thread, face)
    return np.where(rounding & (highest >= 0), highest, out)


def _highest_beside(classes: IntArray, thread: IntArray, face: IntArray) -> IntArray:
    """Return highest class of the faces next to each thread; -1 elsewhere."""
    highest = np.full(classes.size, -1)
    np.maximum.at(highest, thread, classes[face])
    return highest


def _nowhere_wider(faces: NDArray[Any], width_m: float) -> BoolArray:
    """Return whether no disk as wide fits into a polygon."""
    half = width_m / 2.0
    # All of such a polygon lies within half a width of its border: along the sides, or in a
    # sector of a half disk at most around a vertex.
    corners = shapely.get_num_coordinates(faces)
    found = shapely.area(faces) <= half * (shapely.length(faces) + corners * np.pi / 2.0 * half)
    found[found] = shapely.is_empty(shapely.buffer(faces[found], -half))
    return found


def without_small(
    faces: NDArray[Any], classes: IntArray, smallest_m2: float
) -> tuple[Coverage, IntArray]:
    """Return zones of faces and their classes; a small zone joins the next higher beside it."""
    while True:
        zones = dissolved(faces, classes)
        is_small = shapely.area(zones.polygons) < smallest_m2
        small, own = zones.polygons[is_small], zones.classes[is_small]
        zone, face = shapely.STRtree(faces).query(small, predicate="touches")
        border = shapely.length(shapely.intersection(small[zone], faces[face]))
        beside = (border > PRECISION_M) & (classes[face] > own[zone])
        if not beside.any():
            return zones, classes
        joined = np.full(small.size, np.iinfo(np.int64).max)
        np.minimum.at(joined, zone[beside], classes[face[beside]])
        inside = shapely.point_on_surface(faces)
        zone, face = shapely.STRtree(inside).query(small, predicate="contains")
        raised = joined[zone] < np.iinfo(np.int64).max
        classes = classes.copy()
        classes[face[raised]] = joined[zone[raised]]


def joined_coverages(parts: Sequence[Coverage]) -> Coverage:
    """Return zones of several places: those of the lowest class first, then from north and west."""
    classes = np.concatenate([np.empty(0, np.int64), *(p.classes for p in parts)])
    polygons = np.concatenate([np.empty(0, object), *(p.polygons for p in parts)])
    west, south, east, north = shapely.bounds(polygons).reshape(-1, 4).T
    order = np.lexsort((shapely.area(polygons), east, south, west, -north, classes))
    return Coverage(polygons[order], classes[order])


def dissolved(faces: NDArray[Any], classes: IntArray) -> Coverage:
    """Join faces of the same class that share a border into zones; those of class 0 are none."""
    zones = []
    for k in np.unique(classes[classes > 0]).tolist():
        own = polygons_of(shapely.coverage_union_all(faces[classes == k]))
        zones.append(Coverage(own, np.full(own.size, k, np.int64)))
    return joined_coverages(zones)
