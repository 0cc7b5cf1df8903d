"""Zones as polygons that share their borders exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.grid import BoolArray, IntArray
from sassgis.hazard.zoning.cell_outlines import PRECISION_M

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

    Again and again, as several may lie side by side. What is no wider than the rounding of
    coordinates joins the highest wider one that it borders, also a lower one; a thread that came to
    a class only over such a bridge goes back to that of its neighbours.
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
