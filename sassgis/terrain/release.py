"""Release points: where fall lines start, also in parts narrower than the lattice."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, depth_first_order
from shapely.geometry.base import BaseGeometry

from sassgis.compiled import rng
from sassgis.errors import InputError
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.results import ReleasePoints
from sassgis.settings.settings import ReleaseSettings

#: Half of the width (spacings) below which a part is narrow: a band of exactly one spacing is, as
#: the lattice may lie on both of its borders.
_HALF_WIDTH = 0.51
#: Narrow parts start so far (spacings) next to the wide ones: rounding makes no slivers.
_APART = 0.01
#: Shortest narrow part (spacings): tips and steps of an outline are left to the lattice.
_LENGTH = 2.0
#: Longest edge of the outlines that are triangulated (spacings).
_EDGE = 0.25


def release_rims(shapes: Sequence[BaseGeometry], grid: Grid) -> IntArray:
    """Return the cells of release areas, and for each the nearest on the lower rim of its area.

    Flat indices, shape (2, n). The lower rim are the cells around a polygon that are lower than
    most of its cells next to them; lines, points and polygons without it have no cells here.
    """
    found = [np.empty((2, 0), np.int64)]
    for part in shapely.get_parts(list(shapes)):
        if part.geom_type == "Polygon" and (own := _rim_of(part, grid)) is not None:
            found.append(own)
    return np.concatenate(found, axis=1)


def _rim_of(polygon: BaseGeometry, grid: Grid) -> IntArray | None:
    west, south, east, north = polygon.bounds
    n_rows, n_cols = grid.shape
    top, bottom = ((grid.north - y) / grid.cell_size for y in (north, south))
    left, right = ((x - grid.west) / grid.cell_size for x in (west, east))
    rows = np.arange(max(int(top) - 2, 0), min(int(bottom) + 3, n_rows))
    cols = np.arange(max(int(left) - 2, 0), min(int(right) + 3, n_cols))
    if not (rows.size and cols.size):
        return None
    cells = rows[:, None] * n_cols + cols
    inside = shapely.contains_xy(polygon, *grid.cell_centres(cells))
    heights = grid.values[np.ix_(rows, cols)]
    inside &= np.isfinite(heights)
    if not inside.any():
        return None
    beside, higher = np.zeros((2, *inside.shape), np.int64)
    wide, high = np.pad(inside, 1), np.pad(heights, 1, constant_values=np.nan)
    for i, j in np.ndindex(3, 3):
        part = slice(i, i + rows.size), slice(j, j + cols.size)
        beside += wide[part]
        higher += wide[part] & (high[part] > heights)
    lower = ~inside & (beside > 0) & (3 * higher >= 2 * beside)
    if not lower.any():
        return None
    row, col = ndimage.distance_transform_edt(~lower, return_distances=False, return_indices=True)
    return np.stack([cells[inside], cells[row[inside], col[inside]]])


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


MAX_POINTS = 50_000_000
_BATCH = 4096
_MAX_BATCHES = 5000


def release_points(
    areas: Sequence[tuple[str, BaseGeometry]], release: ReleaseSettings, seed: int = 0
) -> ReleasePoints:
    """Place release points in, along or at release areas.

    Polygons are filled, lines get a point every ``spacing_m`` from their start, points are taken as
    they are. What one area gives never depends on which others are in the run. Placed on a grid,
    points of polygons are those of points_in_polygon. Random ones are as many as area / spacing²,
    uniform, drawn from the seed and the name of the area.

    Names of the areas, which are the identity of the points, must be distinct, and coordinates be
    in the system of the DEM (m). Raises InputError if a name occurs twice, a geometry is missing,
    empty or invalid, or the points are too many.
    """
    names = tuple(name for name, _ in areas)
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError(
                "two release areas have the same name",
                field="name",
                found=repr(name),
                expected="distinct names",
            )
    shapes = [_checked(name, geometry) for name, geometry in areas]
    _check_number(sum(points_expected(shape, release.spacing_m) for shape in shapes))
    placed = [
        _points_of(name, shape, release, seed) for name, shape in zip(names, shapes, strict=True)
    ]
    coordinates = np.concatenate([np.empty((0, 2)), *(places for places, _ in placed)])
    counts = [len(places) for places, _ in placed]
    return ReleasePoints(
        x=np.ascontiguousarray(coordinates[:, 0]),
        y=np.ascontiguousarray(coordinates[:, 1]),
        area=np.repeat(np.arange(len(areas), dtype=np.int64), counts),
        key=np.concatenate([np.empty(0, np.uint64), *map(point_keys, names, counts)]),
        area_names=names,
        sides=np.concatenate([np.empty((0, 2, 2)), *(sides for _, sides in placed)]),
    )


def points_expected(geometry: BaseGeometry, spacing_m: float) -> float:
    """Estimate how many release points a geometry gets, before any is placed."""
    return sum(max(1.0, points_by_size(part, spacing_m)) for part in _simple_parts(geometry))


def points_by_size(geometry: BaseGeometry, spacing_m: float) -> float:
    """Count the release points by the size of a geometry: area / spacing² and so on."""

    def of(part: BaseGeometry) -> float:
        return part.area / spacing_m / spacing_m or part.length / spacing_m or 1.0

    return sum(of(part) for part in _simple_parts(geometry))


def _check_number(points: float) -> None:
    if not points <= MAX_POINTS:
        raise InputError(
            "the release spacing is too fine for the release areas",
            field="release.spacing_m",
            found=f"{points:.3g} points",
            expected=f"at most {MAX_POINTS}",
        )


def take(points: ReleasePoints, which: IntArray | slice) -> ReleasePoints:
    """Return the release points at some positions; area numbers and names stay as they are."""
    names = ("x", "y", "area", "key", *(() if points.sides is None else ("sides",)))
    return replace(points, **{name: getattr(points, name)[which] for name in names})


def point_keys(name: str, count: int) -> NDArray[np.uint64]:
    """Return identities of the first ``count`` points of an area.

    The SHA-256 of the name starts a SplitMix64 sequence (G. L. Steele, D. Lea, C. H. Flood, 2014,
    Fast splittable pseudorandom number generators, OOPSLA '14), so key ``i`` depends on the name
    and ``i`` only.
    """
    base = rng.word_of(f"release point\x00{name}")
    return rng.combined(np.full(count, base), np.arange(count))


def points_in_polygon(polygon: shapely.Polygon, spacing_m: float) -> tuple[FloatArray, FloatArray]:
    """Fill a polygon with points: on a lattice, and along the parts too narrow for it.

    The lattice has coordinates that are whole multiples of the spacing; its points come first, from
    north to south and west to east. Parts narrower than the spacing have as many as their area /
    spacing², wherever the lattice lies (narrow_parts). A polygon that would have none has its
    representative point. Returns places (m), shape (n, 2), and their sides as in ReleasePoints.
    """
    west, south, east, north = shapely.bounds(polygon)
    # A narrow polygon across the lattice has far more of its points around it than in it.
    _check_number(max(east - west, spacing_m) * max(north - south, spacing_m) / spacing_m**2)
    cols = np.arange(np.ceil(west / spacing_m), np.floor(east / spacing_m) + 1.0)
    rows = np.arange(np.floor(north / spacing_m), np.ceil(south / spacing_m) - 1.0, -1.0)
    x, y = (part.ravel() for part in np.meshgrid(cols * spacing_m, rows * spacing_m))
    shapely.prepare(polygon)
    inside = shapely.contains_xy(polygon, x, y)
    narrow = narrow_parts(polygon, spacing_m)
    places = np.column_stack([x[inside], y[inside]])
    along, sides = np.empty((0, 2)), np.empty((0, 2, 2))
    if narrow:
        tree = shapely.STRtree(shapely.get_parts([shapely.MultiPoint(places)]))
        places = np.delete(places, tree.query(narrow, predicate="intersects")[1], axis=0)
        count = round(sum(part.area for part in narrow) / spacing_m**2)
        along, sides = points_along(polygon, narrow, count or int(not len(places)), spacing_m)
    elif not len(places):
        places = np.array(shapely.get_coordinates(shapely.point_on_surface(polygon)), np.float64)
    squares = np.broadcast_to(square(spacing_m), (len(places), 2, 2))
    return np.concatenate([places, along]), np.concatenate([squares, sides])


def points_along_line(line: BaseGeometry, spacing_m: float) -> FloatArray:
    """Return points on a line, every ``spacing_m`` from its start, shape (n, 2)."""
    # The small allowance keeps the end point of a line of, say, 30 m at a spacing of 0.3 m.
    count = int(np.floor(shapely.length(line) / spacing_m + 1e-9)) + 1
    along = np.minimum(np.arange(count) * spacing_m, shapely.length(line))
    placed = shapely.line_interpolate_point(np.full(count, line, np.object_), along)
    return np.array(shapely.get_coordinates(placed), np.float64)


def random_points_in_polygon(
    name: str, polygon: BaseGeometry, spacing_m: float, seed: int
) -> FloatArray:
    """Draw uniform points in a polygon, area / spacing² of them, one or more, shape (n, 2).

    Seed and name of the release area decide the draws. Raises InputError if the polygon is so thin
    that no draw hits it.
    """
    count = max(1, round(float(shapely.area(polygon)) / spacing_m**2))
    digest = hashlib.sha256(f"release area\x00{seed}\x00{name}".encode()).digest()
    random = np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "little")))
    west, south, east, north = shapely.bounds(polygon)
    shapely.prepare(polygon)
    found: list[FloatArray] = []
    missing = count
    misses = 0
    while missing > 0:
        draw = random.random((_BATCH, 2))
        x, y = west + draw[:, 0] * (east - west), south + draw[:, 1] * (north - south)
        inside = np.flatnonzero(shapely.contains_xy(polygon, x, y))[:missing]
        found.append(np.column_stack([x[inside], y[inside]]))
        missing -= inside.size
        misses = 0 if inside.size else misses + 1
        if misses > _MAX_BATCHES:
            raise InputError(
                "release area too thin for random placement",
                field=f"release area {name!r}",
                found=f"area {float(shapely.area(polygon)):g} m²",
                expected="a wider polygon, or placement grid",
            )
    return np.concatenate(found)


def _checked(name: str, geometry: BaseGeometry | None) -> BaseGeometry:
    """Return the geometry without heights, or a clear error."""
    field = f"release area {name!r}"
    if geometry is None or shapely.is_empty(geometry):
        raise InputError("the geometry is empty", field=field, expected="a polygon, line or point")
    if not shapely.is_valid(geometry):
        raise InputError(
            "the geometry is invalid", field=field, found=shapely.is_valid_reason(geometry)
        )
    flat: BaseGeometry = shapely.force_2d(geometry)
    return flat


def _points_of(
    name: str, geometry: BaseGeometry, release: ReleaseSettings, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Place all release points of one area and their sides, part by part."""
    spacing = release.spacing_m
    parts = _simple_parts(geometry)
    polygons = [part for part in parts if isinstance(part, shapely.Polygon)]
    placed: list[tuple[FloatArray, FloatArray]] = []
    if polygons and release.placement == "random":
        whole = shapely.MultiPolygon(polygons)
        placed.append(_alone(random_points_in_polygon(name, whole, spacing, seed)))
    for part in parts:
        if isinstance(part, shapely.Polygon):
            if release.placement == "grid":
                placed.append(points_in_polygon(part, spacing))
        elif part.geom_type in ("LineString", "LinearRing"):
            placed.append(_alone(points_along_line(part, spacing)))
        else:
            placed.append(_alone(np.array(shapely.get_coordinates(part), np.float64)))
    places, sides = zip(*placed, strict=True)
    return np.concatenate(places), np.concatenate(sides)


def _alone(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points that represent no area."""
    return places, np.zeros((len(places), 2, 2))


def _simple_parts(geometry: BaseGeometry) -> list[BaseGeometry]:
    """Return polygons, lines and points of a geometry, however nested."""
    if hasattr(geometry, "geoms"):
        return [part for member in geometry.geoms for part in _simple_parts(member)]
    return [geometry]


def meeting(shapes: Sequence[BaseGeometry | FloatArray], grid: Grid) -> tuple[int, ...]:
    """Find which shapes, of which lines may be coordinates, meet the rectangle of a grid."""
    box = shapely.box(*grid.bounds)
    return tuple(
        i
        for i, shape in enumerate(shapes)
        if (shapely.LineString(shape) if isinstance(shape, np.ndarray) else shape).intersects(box)
    )


def wkb_hex(geometry: BaseGeometry) -> str:
    """Return the geometry as text, the same on every machine."""
    return str(shapely.to_wkb(geometry, hex=True, byte_order=1))
