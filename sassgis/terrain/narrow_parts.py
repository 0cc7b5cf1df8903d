"""Release points in parts of a polygon that are narrower than the spacing of the lattice.

A lattice has many points in such a part or none, as it happens to lie. Along the part, places of
equal areas do not depend on that: the triangles of a constrained Delaunay triangulation lie one
behind the other along a narrow part, and their areas add up to the place of each point.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, depth_first_order

from sassgis.grid import FloatArray, IntArray

#: Half of the width (spacings) below which a part is narrow: a band of exactly one spacing is, as
#: the lattice may lie on both of its borders.
_HALF_WIDTH = 0.51
#: Narrow parts start so far (spacings) next to the wide ones: rounding makes no slivers.
_APART = 0.01
#: Shortest narrow part (spacings): tips and steps of an outline are left to the lattice.
_LENGTH = 2.0
#: Longest edge of the outlines that are triangulated (spacings).
_EDGE = 0.25


def narrow_parts(polygon: shapely.Polygon, spacing_m: float) -> list[shapely.Polygon]:
    """Return parts of a polygon that are narrower than the spacing and longer than two spacings."""
    half = _HALF_WIDTH * spacing_m
    wide = polygon.buffer(-half, join_style="mitre")
    wide = wide.buffer(half + _APART * spacing_m, join_style="mitre")
    return [
        part
        for part in shapely.get_parts(polygon.difference(wide))
        if part.geom_type == "Polygon" and part.length > 2.0 * _LENGTH * spacing_m
    ]


def points_along(
    polygon: shapely.Polygon, parts: Sequence[shapely.Polygon], count: int, spacing_m: float
) -> tuple[FloatArray, FloatArray]:
    """Place so many points along the narrow parts of a polygon, each for an equal area of them.

    Returns places on the middle line (m), shape (count, 2), and their sides as in ReleasePoints:
    about the area of a point, or the square of the lattice where that is bent or in several parts.
    """
    walks = [_walk(part, _EDGE * spacing_m) for part in parts]
    area = np.cumsum(np.concatenate([own for own, _ in walks]))
    middle = np.concatenate([own for _, own in walks])
    of_point = area[-1] / max(count, 1)
    first, place, last = (
        middle[np.minimum(np.searchsorted(area, (np.arange(count) + k) * of_point), area.size - 1)]
        for k in (0.0, 0.5, 1.0)
    )
    along = last - first
    near = polygon.buffer(0.5 * spacing_m)
    shapely.prepare(near)
    # A jump to another part, or a bend.
    ends = np.stack([place - 0.5 * along, place + 0.5 * along], axis=1)
    straight = shapely.covers(near, shapely.linestrings(ends))
    length = np.hypot(*along.T)
    straight &= length > spacing_m
    width = np.minimum(of_point / np.where(straight, length, 1.0), spacing_m)
    across = np.column_stack([along[:, 1], -along[:, 0]])
    across *= (width / np.where(straight, length, 1.0))[:, None]
    sides = np.where(straight[:, None, None], np.stack([along, across], axis=1), square(spacing_m))
    return place, sides


def square(side_m: float) -> FloatArray:
    """Return sides of a square, as in ReleasePoints, shape (2, 2)."""
    return np.array([[side_m, 0.0], [0.0, -side_m]])


def _walk(part: shapely.Polygon, edge_m: float) -> tuple[FloatArray, FloatArray]:
    """Return areas of the triangles of a part, end to end, and where the walk enters each."""
    mesh = shapely.get_parts(
        shapely.constrained_delaunay_triangles(shapely.segmentize(part, edge_m))
    )
    corner = shapely.get_coordinates(mesh).reshape(len(mesh), 4, 2)[:, :3]
    known, number = np.unique(corner.reshape(-1, 2), axis=0, return_inverse=True)
    corners = number.reshape(-1, 3)
    graph = _neighbours(corners, len(known))
    end = breadth_first_order(graph, 0, directed=False, return_predecessors=False)[-1]
    order, before = depth_first_order(graph, end, directed=False)
    order, before = order.astype(np.int64), before.astype(np.int64)
    middle = corner.mean(axis=1)
    later = order[1:]
    shared = (corners[later][:, :, None] == corners[before[later]][:, None, :]).any(axis=2)
    middle[later] = 0.5 * (corner[later] * shared[:, :, None]).sum(axis=1)
    return shapely.area(mesh)[order], middle[order]


def _neighbours(corners: IntArray, n_vertices: int) -> csr_array:
    """Find the triangles that share an edge; a row of three vertices each."""
    ends = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edge = ends[:, 0] * n_vertices + ends[:, 1]
    owner = np.repeat(np.arange(len(corners)), 3)
    order = np.argsort(edge, kind="stable")
    both = np.flatnonzero(edge[order][1:] == edge[order][:-1])
    pairs = owner[order[both]], owner[order[both + 1]]
    return coo_array((np.ones(both.size), pairs), shape=(len(corners), len(corners))).tocsr()
