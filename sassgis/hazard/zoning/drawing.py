"""From a raster of classes to zones as they are drawn on a map.

Everything here only raises a class: no place lies in a zone of a class below that of its cell.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from sassgis.grid import BoolArray, ClassMap, FloatArray, Grid, IntArray
from sassgis.hazard.zoning.coverage import (
    PRECISION_M,
    Coverage,
    cell_polygons,
    check_cells,
    classes_of,
    faces_of,
    joined_coverages,
    polygons_of,
    without_small,
    without_threads,
)
from sassgis.hazard.zoning.growth import Ground
from sassgis.settings.hazard_rules import Drawing

#: Least length of a part, and length of the stretch in which a seam is searched (cells).
_LENGTH, _BAND = 800, 40
#: Number of places that are tried for a seam.
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
    # Less than a centimetre counts as no difference.
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


#: A disk does not reach into the corners of a wide part, which are not narrow for that: a right
#: angle is filled by a disk that is larger by this factor.
_CORNER = 1.45
#: A disk that is larger by this factor crosses the border that it would touch. Lines that nearly
#: coincide take twice as long to cut.
_ACROSS = 1.01
#: Narrow parts are widened in steps of this share of the least width.
_STEP = 8
_FITS = 0.999
#: Narrow parts below this share of the square of the least width are corners and chords of disks.
_SPECK = 0.01
#: A small part grows by no more than this times the side of a square of the smallest area.
_FARTHEST = 2.0
#: Areas this near to each other touch, along a border if it is at least so long.
_TOUCHING_M, _SHARED_M = 0.01, 0.1
#: Shares of the tolerance within which areas that were closed, and those that are done, are drawn
#: with fewer vertices.
_CLOSED_WITHIN, _DONE_WITHIN = 0.05, 0.1
#: Of a short outline the average goes over no more than this share.
_RING_SHARE = 0.05
#: Standard deviation of the average along an outline, as a share of the gap that is closed.
_ALONG = 0.5


def _grown(area: Any, distance_m: float, chords: int = 6) -> Any:
    """Return an area grown by a distance (each of several by itself), or shrunk by it."""
    # Six chords to a quarter of a circle keep within a hundredth of the distance.
    if distance_m >= 0.0:
        return shapely.buffer(area, distance_m, quad_segs=chords)
    # Parts that shrink do not meet: of one with many GEOS looks at each next to all others.
    parts = shapely.buffer(shapely.get_parts(area), distance_m, quad_segs=chords)
    return shapely.multipolygons(shapely.get_parts(parts))


def _simplified(area: Any, tolerance_m: float) -> Any:
    """Return an area without vertices nearer to the line than this (Douglas and Peucker 1973)."""
    # Where simplified lines would cross, the vertices that prevent it are kept: finding them takes
    # several times as long.
    found = shapely.simplify(area, tolerance_m, preserve_topology=False)
    return found if shapely.is_valid(found) else shapely.simplify(area, tolerance_m)


def _smooth(area: Any, tolerance_m: float) -> Any:
    """Return an area in fewer, longer lines, none of which cuts into it."""
    if tolerance_m == 0.0:
        return area
    # Grown by half of the tolerance, and then simplified by less than that: the new line stays
    # outside, and within the tolerance.
    half = tolerance_m / 2.0
    # Two chords to a quarter of a circle come as near as 0.92 of the distance.
    return _simplified(_grown(area, half, 2), 0.9 * half)


def _closed(area: Any, gap_m: float) -> Any:
    """Return an area with the gaps into which no disk fits that is as wide."""
    return _grown(_grown(area, gap_m / 2.0), -gap_m / 2.0)


def _rounded(area: Any, length_m: float) -> Any:
    """Return an area with its outline averaged along itself where that lies outside of it.

    Weights are Gaussian, with a standard deviation of ``length_m`` along the outline. Closing with
    a disk leaves arcs of it; this turns them into lines without a radius.
    """
    parts = polygons_of(area)
    rings, part = shapely.get_rings(parts, return_index=True)
    smooth = shapely.polygons([_averaged(ring, length_m) for ring in rings])
    is_shell = np.diff(part, prepend=-1) > 0
    smooth = shapely.make_valid(smooth)
    shells = shapely.union_all(smooth[is_shell])
    # Holes become smaller only.
    holes = shapely.intersection(smooth[~is_shell], shapely.polygons(rings[~is_shell]))
    return shapely.union(area, shapely.difference(shells, shapely.union_all(holes)))


def _averaged(ring: Any, length_m: float) -> Any:
    """Return a closed line with each point averaged along it."""
    corners = shapely.get_coordinates(ring)
    at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    total = at[-1]
    # Four points to a standard deviation; a short ring has some at least.
    count = max(int(4.0 * total / length_m), 12)
    even = np.arange(count) * (total / count)
    places = np.stack([np.interp(even, at, axis) for axis in corners.T], axis=1)
    sigma = min(length_m, _RING_SHARE * total) * count / total
    places = ndimage.gaussian_filter1d(places, sigma, axis=0, mode="wrap")
    return shapely.linearrings(places)


def _narrow(
    areas: NDArray[Any], width_m: float, corner: float = _ACROSS
) -> tuple[NDArray[Any], IntArray]:
    """Return the parts of polygons that are narrower than a disk, and the polygon of each."""
    # A part of exactly this width is not narrow.
    half = _FITS * width_m / 2.0
    # One by one, as they are: GEOS would look at each next to all others.
    wide = _grown(shapely.buffer(areas, -half, quad_segs=6), corner * half)
    parts, of = shapely.get_parts(shapely.difference(areas, wide), return_index=True)
    large = shapely.area(parts) > _SPECK * width_m**2
    return parts[large], of[large]


def _widened(area: Any, width_m: float) -> Any:
    """Return an area whose narrow parts have grown until a disk fits."""
    near = grown = area
    for _ in range(_STEP // 2):
        narrow, _ = _narrow(polygons_of(near), width_m, _CORNER)
        shapely.prepare(grown)
        narrow = narrow[shapely.intersects(grown, narrow)]
        if not narrow.size:
            break
        grown = _simplified(shapely.union_all(_grown(narrow, width_m / _STEP)), 0.02 * width_m)
        area = shapely.union(area, grown)
        # Only next to what has grown may another part be narrow still.
        near = shapely.intersection(area, _grown(grown, 2.0 * width_m, 2))
    return area


def _enlarged(area: Any, smallest_m2: float, known: Any, ground: Ground) -> Any:
    """Grow the small parts of an area along the slope until they have the smallest area."""
    parts = polygons_of(area)
    small = parts[shapely.area(parts) < smallest_m2]
    return shapely.union_all([_enlarged_part(p, smallest_m2, known, ground) for p in small])


def _enlarged_part(part: Any, smallest_m2: float, known: Any, ground: Ground) -> Any:
    size = ground.grid.cell_size
    # In a corner of the known terrain parts grow farther than on open ground, but not without end.
    ground = ground.around(part.bounds, _FARTHEST * math.sqrt(smallest_m2))
    distance = ground.distance_from(part)

    def grown(most: float) -> Any:
        cells = shapely.union_all([part, *cell_polygons(distance <= most, ground.grid)])
        return _on_terrain(_smooth(cells, size), known, [part])

    # It must still have that area after coordinates are rounded.
    enough = smallest_m2 + PRECISION_M * shapely.length(part)
    steps = np.unique(distance[np.isfinite(distance)]).tolist()
    first = bisect_left(range(len(steps) - 1), enough, key=lambda i: grown(steps[i]).area)
    return grown(steps[first])


def _filled(area: Any, smallest_m2: float) -> Any:
    """Return an area without holes smaller than an area."""
    parts = polygons_of(area)
    rings, part = shapely.get_rings(parts, return_index=True)
    holes = shapely.polygons(rings[np.diff(part, prepend=-1) == 0])
    small = holes[shapely.area(holes) < smallest_m2]
    return shapely.union(area, shapely.union_all(small)) if small.size else area


def _superlevel(
    cells: Any,
    inside: Sequence[Any],
    rules: Drawing,
    gap_m: float,
    known: Any,
    ground: Ground,
) -> Any:
    """Return area of a class and those above it: its cells, smoothed, and what must lie within."""
    must = [cells, *inside]
    area = _smooth(cells, rules.tolerance_m)
    if rules.width_m > 0.0:
        area = _widened(area, rules.width_m)
    # What lies inside is wide enough already, and so are both together.
    area = _with(area, inside)
    if area.is_empty:
        return area
    if gap_m > 0.0:
        area = _rounded(_closed(area, gap_m), _ALONG * gap_m)
        area = _simplified(area, _CLOSED_WITHIN * rules.tolerance_m)
    if rules.area_m2 > 0.0:
        area = _on_terrain(area, known, must)
        grown = _enlarged(area, rules.area_m2, known, ground)
        area = shapely.union(area, grown)
        if gap_m > 0.0 and not grown.is_empty:
            # There are gaps only where a disk that touches what has grown touches more.
            near = polygons_of(shapely.intersection(area, _grown(grown, 2.2 * gap_m, 2)))
            area = shapely.union(area, _closed(shapely.multipolygons(near), gap_m))
        # A hole no larger than the gap has the shape of the disk, not of the ground.
        area = _filled(area, max(rules.area_m2, gap_m**2))
    return _on_terrain(_with(_smooth(area, _DONE_WITHIN * rules.tolerance_m), must), known, must)


def _with(area: Any, others: Sequence[Any]) -> Any:
    """Return an area with others, many parts of which it holds already."""
    for other in others:
        # One by one: in a union of all, GEOS cuts a large part again for each group of others.
        shapely.prepare(area)
        parts = polygons_of(other)
        parts = parts[~shapely.covers(area, parts)]
        if parts.size:
            area = shapely.union(area, shapely.multipolygons(parts))
    return area


def _on_terrain(area: Any, known: Any, must: Sequence[Any]) -> Any:
    """Return the parts of an area on known terrain in which something lies that must be in it."""
    if shapely.covers(known, area):
        return area
    parts = polygons_of(shapely.intersection(area, known))
    shapely.prepare(must)
    holds = shapely.intersects(np.array(must)[:, None], parts).any(axis=0)
    return shapely.multipolygons(parts[holds])


def _strips(higher: Any, own: BoolArray, grid: Grid, rules: Drawing) -> Any:
    """Return strips of the least width along a higher area where cells of a class lie beside it.

    Only strips at least as large as the smallest zone.
    """
    width = rules.width_m
    shapely.prepare(higher)
    cells = cell_polygons(own, grid)
    cells = cells[shapely.dwithin(higher, cells, 0.5 * width)]
    if not cells.size:
        return shapely.Polygon()
    near = shapely.union_all(_grown(cells, width))
    beside = shapely.difference(_grown(higher, width), higher)
    strips = polygons_of(shapely.intersection(beside, near))
    return shapely.multipolygons(strips[shapely.area(strips) >= rules.area_m2])


def _with_rims(higher: Any, lower: Any, rules: Drawing) -> Any:
    """Return a higher area with narrow and small parts of the lower one that lie next to it."""
    # Narrow ends that do not touch the higher area keep their class.
    parts = polygons_of(shapely.difference(lower, higher))
    is_small = shapely.area(parts) < rules.area_m2
    small, wide = parts[is_small], parts[~is_small]
    if rules.width_m > 0.0:
        narrow, of = _narrow(wide, rules.width_m)
        joins = _is_beside(higher, narrow)
        cut, of = np.unique(of[joins], return_inverse=True)
        wide[cut] = shapely.difference(wide[cut], shapely.multipolygons(narrow[joins], indices=of))
    left = polygons_of(wide)
    stay = [left[shapely.area(left) >= rules.area_m2], small[~_is_beside(higher, small)]]
    rest = shapely.multipolygons(np.concatenate(stay))
    # Without what stays: to join the many others one by one takes longer. Of faces, as a difference
    # on rounded coordinates fails where rounding closes a ring.
    faces = faces_of([lower, rest])
    found = polygons_of(shapely.coverage_union_all(faces[classes_of(faces, [lower, rest]) == 1]))
    # Parts joined by less than the precision count as separate, and may then hold nothing of the
    # area.
    within = shapely.point_on_surface(polygons_of(higher))
    _, holds = shapely.STRtree(found).query(within, predicate="intersects")
    return shapely.multipolygons(found[np.unique(holds)])


def _is_beside(area: Any, parts: NDArray[Any]) -> BoolArray:
    """Return whether parts share a border with an area, not only a point."""
    place, ring = shapely.get_coordinates(shapely.get_rings(parts), return_index=True)
    begin, end = place[:-1], place[1:]
    border = shapely.boundary(area)
    shapely.prepare(border)
    # A side of a part lies on the border of the area, or ends there.
    shared = shapely.dwithin(border, shapely.points((begin + end) / 2.0), _TOUCHING_M)
    length = np.where(shared & (ring[:-1] == ring[1:]), np.hypot(*(end - begin).T), 0.0)
    part = np.repeat(np.arange(parts.size), shapely.get_num_interior_rings(parts) + 1)[ring[:-1]]
    return np.asarray(np.bincount(part, length, parts.size) > _SHARED_M)


def reach_cells(rules: Drawing, cell_size: float) -> int:
    """Return the distance (cells) within which drawing a zone looks at others and adds to it."""
    grown = rules.width_m + _FARTHEST * math.sqrt(rules.area_m2) + rules.tolerance_m
    # The average along an outline moves it by less than the gap, and looks along it twice as far.
    return math.ceil(2.0 * (grown + max(rules.gap_m, rules.envelope_m)) / cell_size) + 2


def drawn_zones(
    maps: Sequence[ClassMap],
    grid: Grid,
    rules: Drawing,
    known: BoolArray | None = None,
    enveloped: Sequence[bool] = (),
) -> list[Coverage]:
    """Draw the zones of maps of which none is above the next, from frequent to rare.

    Parameters
    ----------
    maps : sequence of int, shape (n_rows, n_cols)
        Classes of the cells; 0 where nothing arrives.
    grid : Grid
        Where the cells lie; small zones grow along the slope of its heights.
    known : bool, shape (n_rows, n_cols), optional
        Where the terrain is known; no zone reaches beyond it.
    enveloped : sequence of bool, optional
        Whether the outer limit of each map is an envelope (``rules.envelope_m``); default: none is.

    Returns
    -------
    list of Coverage
        One per map: a valid coverage whose zones contain their cells. {class >= k} of a map
        contains that of the one before.

    Raises
    ------
    ValueError
        If a map does not fit the grid, is below the one before, or has a class below 0.
    InputError
        If cells are not at least ten times the precision of the coordinates.

    Notes
    -----
    Lines are those of mathematical morphology with disks (Serra 1982), on polygons. For each class,
    from the highest, the area of the cells of it and the higher ones is smoothed outwards, narrow
    parts are widened, what the higher class and the map before have and strips along the higher
    class are added, gaps are closed and the outline averaged along itself, small parts enlarged
    along the slope, gaps next to them closed, and small holes filled. Then, from the lowest class,
    narrow and small parts next to a higher class join that.
    """
    maps = [np.asarray(m, np.int16) for m in maps]
    for m in maps:
        if m.shape != grid.shape:
            raise ValueError(f"classes of shape {m.shape} on a grid of {grid.shape}")
        if m.size and m.min() < 0:
            raise ValueError("a class is below 0")
    if any((rare < frequent).any() for frequent, rare in pairwise(maps)):
        raise ValueError("a rarer return period is below a more frequent one")
    check_cells(grid.cell_size)
    if not maps or not maps[-1].any():
        return [Coverage(np.empty(0, object), np.empty(0, np.int64)) for _ in maps]
    own = np.ones(grid.shape, np.bool_) if known is None else known
    envelopes = enveloped or [False] * len(maps)
    places = [
        _nested(_stacks(place, rules, envelopes, int(maps[-1].max())), rules.area_m2)
        for place in _places(_Place(maps, grid, own), reach_cells(rules, grid.cell_size))
    ]
    return [joined_coverages(of_map) for of_map in zip(*places, strict=True)]


@dataclass(frozen=True, slots=True)
class _Place:
    """Maps, and the terrain on which they lie."""

    maps: Sequence[ClassMap]
    grid: Grid
    known: BoolArray

    def part(self, rows: slice, cols: slice) -> _Place:
        maps = [m[rows, cols] for m in self.maps]
        return _Place(maps, self.grid.part(rows, cols), self.known[rows, cols])


def _places(whole: _Place, reach: int) -> Iterator[_Place]:
    """Yield each place whose zones are independent of those of another."""
    # Those between which there is more than the reach.
    near = ndimage.distance_transform_edt(np.max(whole.maps, axis=0) == 0) <= reach / 2 + 1
    place_of, _ = ndimage.label(near, np.ones((3, 3)))
    boxes = enumerate(ndimage.find_objects(place_of), start=1)
    parts = [(box, place_of[box] == number) for number, box in boxes]
    # Drawing takes much memory by itself.
    del near, place_of
    for box, mine in parts:
        place = whole.part(*box)
        alone = all(not m[~mine].any() for m in place.maps)
        yield place if alone else replace(place, maps=[np.where(mine, m, 0) for m in place.maps])


def _stacks(
    place: _Place, rules: Drawing, enveloped: Sequence[bool], n_classes: int
) -> list[list[Any]]:
    """Return for each map the area of each class with those above it; a large place in parts."""
    n_rows, n_cols = place.grid.shape
    along_rows, size = n_rows >= n_cols, place.grid.cell_size
    cuts = overlapping(max(n_rows, n_cols), reach_cells(rules, size))
    if len(cuts) == 1:
        return _stacks_at_once(place, rules, enveloped, n_classes)
    boxes = [(c, slice(0, n_cols)) if along_rows else (slice(0, n_rows), c) for c in cuts]
    parts = [_stacks(place.part(*box), rules, enveloped, n_classes) for box in boxes]
    middles = np.array([(a.stop + b.start) / 2.0 for a, b in pairwise(cuts)]) * size
    if along_rows:
        return joined_at_seams(parts[::-1], place.grid.north - middles[::-1], size, axis=1)
    return joined_at_seams(parts, place.grid.west + middles, size, axis=0)


def _stacks_at_once(
    place: _Place, rules: Drawing, enveloped: Sequence[bool], n_classes: int
) -> list[list[Any]]:
    terrain = shapely.multipolygons(cell_polygons(place.known, place.grid))
    stacks: list[list[Any]] = []
    # Of each drawing: several may be at work, and what GEOS notes of a geometry is for one thread.
    below: Sequence[Any] = [shapely.Polygon()] * n_classes
    for m, envelope in zip(place.maps, enveloped, strict=True):
        below = _stack(replace(place, maps=[m]), rules, envelope, below, terrain)
        stacks.append([*below])
    return stacks


def _raised(place: _Place, gaps: Sequence[float], smallest_m2: float) -> ClassMap:
    """Return classes of a map's cells, raised where what is drawn is of that class anyway."""
    # Between cells that lie near each other on all sides, and in small holes, lines would be drawn
    # that closing gaps and filling holes takes away. They are avoided here.
    (classes,), size = place.maps, place.grid.cell_size
    out = classes.copy()
    for k, gap in enumerate(gaps, start=1):
        own = classes >= k
        # A disk meets each cell around that of its middle, up to a diagonal of its radius.
        radius = gap / 2.0 / size
        near = max(math.ceil(radius / math.sqrt(2.0)) - 1, 0)
        met = ndimage.maximum_filter(own, 2 * near + 1, mode="constant")
        closed = ndimage.minimum_filter(met, 2 * math.ceil(radius) + 1, mode="constant")
        own |= closed & place.known
        hole, count = ndimage.label(~own)
        small = np.bincount(hole.ravel(), minlength=count + 1) * size**2 < smallest_m2
        outside = ~place.known
        outside[[0, -1], :] = outside[:, [0, -1]] = True
        small[hole[outside]] = False
        small[0] = False
        np.maximum(out, k, out=out, where=own | small[hole])
    return out


def _stack(
    place: _Place, rules: Drawing, envelope: bool, within: Sequence[Any], known: Any
) -> list[Any]:
    """Return the area of each class with those above it, which contains that of ``within``."""
    stack: list[Any] = []
    higher: Any = shapely.Polygon()
    gaps = [rules.gap_m] * len(within)
    if envelope:
        gaps[0] = max(rules.gap_m, rules.envelope_m)
    raised = _raised(place, gaps, rules.area_m2)
    for k in range(len(within), 0, -1):
        cells = shapely.multipolygons(cell_polygons(raised >= k, place.grid))
        inside = [higher, within[k - 1]]
        if rules.width_m > 0.0 and not higher.is_empty:
            inside.append(_strips(higher, raised == k, place.grid, rules))
        ground = Ground(place.grid, raised, place.known, k, rules.width_m)
        higher = _superlevel(cells, inside, rules, gaps[k - 1], known, ground)
        stack.insert(0, higher)
    for k in range(1, len(stack)):
        stack[k] = _with_rims(stack[k], stack[k - 1], rules)
    return stack


def _nested(stacks: Sequence[Sequence[Any]], smallest_m2: float) -> list[Coverage]:
    """Return maps on common lines, each of which contains the one before."""
    faces = faces_of([area for stack in stacks for area in stack])
    below = np.zeros(faces.size, np.int64)
    out = []
    for stack in stacks:
        classes = np.maximum(below, classes_of(faces, stack))
        below = np.maximum(below, without_threads(faces, classes))
        # What is cut off between this map and the one before may be small again.
        zones, below = without_small(faces, below, smallest_m2)
        out.append(zones)
    return out
