"""Zones: never below the raster, a valid coverage, nested over return periods."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any
from unittest import mock

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sassgis.errors import ConfigError, InputError
from sassgis.grid import Grid
from sassgis.hazard.zoning import drawing
from sassgis.hazard.zoning.coverage import Coverage, cell_polygons, within_terrain
from sassgis.hazard.zoning.drawing import drawn_zones, reach_cells
from sassgis.settings.hazard_rules import Drawing, ZoningSettings

WEST, NORTH = 2_700_000.0, 1_120_000.0
KINDS = (
    "smooth", "streaks", "salt", "chequers", "spiral", "rings", "single", "edge", "full", "empty",
    "diagonals", "random",
)  # fmt: skip


def grid_of(classes: np.ndarray, cell_size: float = 2.0) -> Grid:
    return Grid(np.zeros(classes.shape), WEST, NORTH, cell_size)


def raster(kind: str, shape: tuple[int, int], seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    n, m = shape
    i, j = np.mgrid[:n, :m]
    out = np.zeros(shape, np.int64)
    if kind == "smooth":
        noise = ndimage.gaussian_filter(rng.normal(size=shape), rng.uniform(0.7, 4.0))
        out = np.digitize(noise / (noise.std() + 1e-9), [-0.3, 0.4, 1.1])
    elif kind == "streaks":
        for _ in range(6):
            column, slope = rng.uniform(0, m), rng.normal() * 0.5
            for row in range(n):
                column += slope + rng.normal() * 0.3
                if 0 <= column < m:
                    out[row, int(column)] += 1
        out = np.minimum(out + ndimage.maximum_filter(out, 2), 3)
    elif kind == "salt":
        out = np.where(rng.random(shape) < 0.05, rng.integers(1, 4, shape), 0)
    elif kind == "chequers":
        out = np.where((i // rng.integers(1, 4) + j // rng.integers(1, 4)) % 2 == 0, 1, 2)
        out[:, m // 2 :] -= 1
    elif kind == "spiral":
        angle = np.arctan2(i - n / 2, j - m / 2) / (2 * np.pi)
        out = (((np.hypot(i - n / 2, j - m / 2) / 4 + angle) % 1.0) < 0.4).astype(np.int64)
        out[: n // 2] *= 2
    elif kind == "rings":
        out = (np.maximum(abs(i - n // 2), abs(j - m // 2)) // rng.integers(1, 4)) % 4
    elif kind == "single":
        out[rng.integers(n), rng.integers(m)] = rng.integers(1, 4)
    elif kind == "edge":
        for _ in range(5):
            out[rng.choice([0, n - 1]), rng.integers(m)] = rng.integers(1, 4)
            out[rng.integers(n), rng.choice([0, m - 1])] = rng.integers(1, 4)
    elif kind == "full":
        out[:] = 2
    elif kind == "diagonals":
        out = np.where((i + j) % 5 == 0, 1, 0) + np.where((i - j) % 7 == 0, 2, 0)
    elif kind == "random":
        out = rng.integers(0, 4, shape)
    return out.astype(np.int64)


RASTERS = st.builds(
    raster,
    st.sampled_from(KINDS),
    st.tuples(st.integers(1, 36), st.integers(1, 36)),
    st.integers(0, 10_000),
)
CELLS = st.sampled_from([0.5, 1.0, 2.0, 5.0])
#: Rasters of the same shape: a base, and what rarer return periods add to it.
SERIES = st.tuples(st.integers(1, 30), st.integers(1, 30)).flatmap(
    lambda shape: st.lists(
        st.builds(raster, st.sampled_from(KINDS), st.just(shape), st.integers(0, 10_000)),
        min_size=2,
        max_size=3,
    )
)


def cells_of(mask: np.ndarray, grid: Grid) -> Any:
    """Union of the squares of cells, built apart from the code under test."""
    i, j = np.nonzero(mask)
    size = grid.cell_size
    return shapely.union_all(
        shapely.box(
            grid.west + j * size,
            grid.north - (i + 1) * size,
            grid.west + (j + 1) * size,
            grid.north - i * size,
        )
    )


def above(zones: Coverage, k: int) -> Any:
    return shapely.union_all(zones.polygons[zones.classes >= k])


def violations(
    zones: Coverage, classes: np.ndarray, grid: Grid, smallest_m2: float = 0.0
) -> set[str]:
    """Which of the rules of a coverage of zones are broken."""
    found = set()
    polygons = zones.polygons
    if any(p.geom_type != "Polygon" for p in polygons):
        found.add("multipart")
    if any(p.is_empty for p in polygons):
        found.add("empty")
    if not shapely.is_valid(polygons).all():
        return found | {"invalid"}
    if not shapely.coverage_is_valid(polygons):
        found.add("no coverage")
    if abs(shapely.area(polygons).sum() - shapely.union_all(polygons).area) > 1e-3:
        found.add("overlap")
    coordinates = shapely.get_coordinates(polygons)
    if (coordinates != np.round(coordinates, 3)).any():
        found.add("off the grid of 1 mm")
    if (shapely.area(polygons) < smallest_m2 - 1e-6).any():
        found.add("too small")
    if any(p.buffer(-0.1).is_empty for p in polygons):
        found.add("sliver")
    for k in range(1, int(classes.max(initial=0)) + 1):
        if cells_of(classes >= k, grid).difference(above(zones, k)).area > 1e-3:
            found.add("lower than the raster")
    if set(zones.classes.tolist()) - set(np.unique(classes[classes > 0]).tolist()):
        found.add("unknown class")
    return found


def drawn(classes: np.ndarray, cell_size: float = 2.0, **rules: float) -> Coverage:
    (zones,) = drawn_zones([classes], grid_of(classes, cell_size), Drawing(**rules))
    return zones


def room_for(smallest: float, classes: np.ndarray, cell_size: float) -> float:
    """Smallest area of a zone; 0 on terrain that is itself too narrow for one."""
    return smallest if min(classes.shape) * cell_size >= 2.0 * smallest**0.5 else 0.0


def at(zones: Coverage, row: float, col: float) -> int:
    """Class of the zones at a place of a raster of cells of 2 m."""
    place = shapely.Point(WEST + 2.0 * col, NORTH - 2.0 * row)
    return int(zones.classes[shapely.covers(zones.polygons, place)].max(initial=0))


@settings(max_examples=15)
@given(RASTERS, CELLS, st.sampled_from([0.0, 100.0, 400.0]), st.sampled_from([0.0, 10.0]))
# A ring at the edge of the terrain that rounding closes.
@example(raster("streaks", (17, 6), 0), 1.0, 100.0, 10.0)
# Lines that are simplified though no gap is closed leave a sliver of the cells beside them.
@example(raster("spiral", (36, 36), 0), 2.0, 0.0, 0.0)
def test_every_rule_holds(
    classes: np.ndarray, cell_size: float, smallest: float, width: float
) -> None:
    grid = grid_of(classes, cell_size)
    rules = Drawing(width, smallest, width, 0.0, 0.0, 1.5 * cell_size)
    zones = drawn_zones([classes], grid, rules)[0]
    found = violations(zones, classes, grid, room_for(smallest, classes, cell_size))
    assert found - {"unknown class"} == set()
    # A class that no cell has comes of several rims only, and lies between others.
    assert set(zones.classes.tolist()) <= set(range(1, int(classes.max(initial=0)) + 1))


@settings(max_examples=15)
@given(RASTERS, CELLS)
def test_cells_are_drawn_as_they_are(classes: np.ndarray, cell_size: float) -> None:
    grid = grid_of(classes, cell_size)
    (zones,) = drawn_zones([classes], grid, Drawing())
    assert violations(zones, classes, grid) - {"sliver"} == set()
    for k in np.unique(classes[classes > 0]):
        own = shapely.union_all(zones.polygons[zones.classes == k])
        assert own.symmetric_difference(cells_of(classes == k, grid)).area < 1e-3
        # Regions hang together over sides of cells.
        assert (zones.classes == k).sum() == ndimage.label(classes == k)[1]
    regions = cell_polygons(classes > 0, grid)
    assert regions.size == ndimage.label(classes > 0)[1]
    assert shapely.is_valid(regions).all()
    assert shapely.is_valid(shapely.multipolygons(regions))
    assert shapely.multipolygons(regions).equals(cells_of(classes > 0, grid))
    assert not any(p.exterior.is_ccw for p in regions)
    assert all(hole.is_ccw for p in regions for hole in p.interiors)
    # In the order of the first cell of each.
    number = ndimage.label(classes > 0)[0]
    for k, region in enumerate(regions, start=1):
        i, j = np.argwhere(number == k)[0]
        assert region.covers(
            shapely.Point(WEST + (j + 0.5) * cell_size, NORTH - (i + 0.5) * cell_size)
        )


@settings(max_examples=15)
@given(RASTERS, st.sampled_from([0.5, 1.0, 3.0, 6.0]))
def test_zones_stay_within_the_tolerance_of_their_cells(
    classes: np.ndarray, tolerance: float
) -> None:
    reached = (classes > 0).astype(np.int64)
    zones = drawn(reached, tolerance_m=tolerance)
    # Smoothed once, and the arcs of what follows by a tenth of that.
    allowed = cells_of(reached > 0, grid_of(reached)).buffer(1.1 * tolerance + 0.01, quad_segs=32)
    assert above(zones, 1).difference(allowed).area < 1e-3


@settings(max_examples=10)
@given(SERIES, CELLS, st.sampled_from([0.0, 40.0]))
def test_rarer_zones_contain_more_frequent_ones(
    maps: list[np.ndarray], cell_size: float, smallest: float
) -> None:
    maps = list(np.maximum.accumulate(maps))
    grid = grid_of(maps[0], cell_size)
    rules = Drawing(4.0, smallest, 4.0, 20.0, 0.0, 1.5 * cell_size)
    series = drawn_zones(maps, grid, rules, None, [False] * (len(maps) - 1) + [True])
    for zones, raw in zip(series, maps, strict=True):
        assert (
            violations(zones, raw, grid, room_for(smallest, raw, cell_size)) - {"unknown class"}
            == set()
        )
    for frequent, rare in pairwise(series):
        for k in range(1, 4):
            inner, outer = above(frequent, k), above(rare, k)
            assert inner.difference(outer).area < 1e-6
            points = shapely.point_on_surface(frequent.polygons[frequent.classes >= k])
            assert shapely.intersects(points, outer).all()


@settings(max_examples=15)
@given(RASTERS, st.integers(0, 10_000), st.sampled_from([20.0, 100.0]))
# A small part that holds the middle of no cell.
@example(raster("smooth", (20, 11), 0), 12, 20.0)
def test_no_zone_reaches_where_the_terrain_is_unknown(
    classes: np.ndarray, seed: int, smallest: float
) -> None:
    unknown = ndimage.maximum_filter(
        np.random.default_rng(seed).random(classes.shape) < 0.02, 3, mode="constant"
    )
    classes = np.where(unknown, 0, classes)
    grid = grid_of(classes)
    rules = Drawing(6.0, smallest, 10.0, 30.0, 0.0, 3.0)
    (zones,) = drawn_zones([classes], grid, rules, ~unknown, [True])
    assert violations(zones, classes, grid) - {"unknown class", "sliver"} == set()
    beyond = above(zones, 1).difference(cells_of(~unknown, grid))
    assert beyond.area < 1e-3


@settings(max_examples=10)
@given(RASTERS, st.integers(1, 9), st.integers(1, 9))
def test_zones_do_not_depend_on_where_the_raster_begins(
    classes: np.ndarray, rows: int, cols: int
) -> None:
    classes = np.pad(classes, 40)
    rules = Drawing(6.0, 60.0, 6.0, 20.0, 0.0, 3.0)
    wide = np.pad(classes, ((rows, 2), (cols, 3)))
    moved = Grid(np.zeros(wide.shape), WEST - 2 * cols, NORTH + 2 * rows, 2.0)
    (zones,), (other,) = (
        drawn_zones([c], g, rules, None, [True])
        for c, g in ((classes, grid_of(classes)), (wide, moved))
    )
    assert shapely.equals_exact(zones.polygons, other.polygons).all()
    np.testing.assert_array_equal(zones.classes, other.classes)


@settings(max_examples=15)
@given(RASTERS, st.sampled_from([2.0 / 3.0, 0.3048, 1.52401]))
def test_cells_that_are_no_multiple_of_the_precision(classes: np.ndarray, cell_size: float) -> None:
    grid = Grid(np.zeros(classes.shape), WEST + 0.12345, NORTH - 0.98765, cell_size)
    (zones,) = drawn_zones([classes], grid, Drawing())
    # The corners themselves are rounded, by half a millimetre at most.
    assert violations(zones, classes, grid) <= {"lower than the raster", "sliver"}
    for k in range(1, int(classes.max()) + 1):
        cells = cells_of(classes >= k, grid)
        assert cells.difference(above(zones, k)).area <= 0.001 * cells.length + 1e-9
        regions = cell_polygons(classes >= k, grid)
        assert shapely.is_valid(regions).all()
        corners = shapely.get_coordinates(regions)
        np.testing.assert_array_equal(corners, np.round(corners, 3))
        apart = shapely.multipolygons(regions).symmetric_difference(cells).area
        assert apart <= 0.001 * cells.length + 1e-9


@settings(max_examples=15)
@given(RASTERS)
def test_nothing_thinner_than_the_least_width_lies_beside_a_higher_zone(
    classes: np.ndarray,
) -> None:
    zones = drawn(np.pad(classes, 8), width_m=10.0, area_m2=200.0, tolerance_m=3.0)
    for polygon, k in zip(zones.polygons, zones.classes, strict=True):
        higher = above(zones, int(k) + 1)
        if not higher.is_empty and polygon.boundary.intersection(higher).length > 0.0:
            assert not polygon.buffer(-4.5).is_empty


def block(*places: tuple[int, int, int, int, int], shape: tuple[int, int] = (60, 60)) -> np.ndarray:
    out = np.zeros(shape, np.int64)
    for top, left, bottom, right, k in places:
        out[top:bottom, left:right] = k
    return out


def test_a_ring_keeps_its_hole_and_the_island_in_it() -> None:
    classes = block((2, 2, 28, 28, 1), (7, 7, 23, 23, 0), (12, 12, 18, 18, 2))
    zones = drawn(classes, area_m2=100.0)
    assert zones.classes.tolist() == [1, 2]
    ring, island = zones.polygons
    assert ring.area == pytest.approx(4 * (26 * 26 - 16 * 16))
    assert island.area == pytest.approx(4 * 36)
    assert shapely.Polygon(ring.interiors[0]).contains(island)


@pytest.mark.parametrize(("side", "stays"), [(4, False), (5, True)])
def test_a_small_hole_rises_to_the_lowest_class_around_it(side: int, stays: bool) -> None:
    # Half of its border is class 1, half class 3.
    classes = block((2, 2, 28, 15, 1), (2, 15, 28, 28, 3), (10, 13, 10 + side, 13 + side, 0))
    zones = drawn(classes, area_m2=100.0)
    assert at(zones, 10 + side / 2, 13 + side / 2) == (0 if stays else 1)


def test_a_small_zone_joins_the_next_higher_one_beside_it() -> None:
    classes = block((5, 5, 25, 15, 2), (5, 17, 25, 27, 3), (10, 15, 14, 17, 1), (14, 15, 15, 16, 1))
    assert at(drawn(classes, area_m2=200.0), 12, 16) == 2
    # Where nothing lies between, it joins the one that is there.
    classes = block((5, 5, 25, 15, 3), (10, 15, 14, 18, 1))
    assert at(drawn(classes, area_m2=200.0), 12, 16) == 3


def test_a_small_zone_on_its_own_grows_to_the_smallest_area() -> None:
    (zone,) = drawn(block((15, 15, 16, 16, 2)), area_m2=100.0).polygons
    # By whole cells: those as near as the last one come with it.
    assert 100.0 <= zone.area < 130.0
    assert zone.centroid.distance(shapely.Point(WEST + 31.0, NORTH - 31.0)) < 0.5
    # Around what is unknown, not through it.
    classes = block((15, 14, 16, 15, 1))
    known = np.ones(classes.shape, bool)
    known[:, 15] = False
    (zone,) = drawn_zones([classes], grid_of(classes), Drawing(area_m2=100.0), known)[0].polygons
    assert 100.0 <= zone.area < 130.0 and zone.bounds[2] == WEST + 30.0
    known[:] = False
    known[15, 14] = True
    (zone,) = drawn_zones([classes], grid_of(classes), Drawing(area_m2=100.0), known)[0].polygons
    assert zone.area == 4.0


def test_a_small_zone_grows_along_the_slope_over_what_blocks_reached() -> None:
    classes = block((30, 30, 31, 31, 2))
    rows, cols = np.indices(classes.shape)
    for heights, long_side in ((-1.0 * rows, 1), (0.5 * cols, 0)):
        grid = replace(grid_of(classes), values=heights)
        (zone,) = drawn_zones([classes], grid, Drawing(area_m2=400.0))[0].polygons
        sides = np.ptp(np.reshape(zone.bounds, (2, 2)), axis=0)
        assert sides[long_side] > 2.0 * sides[1 - long_side]
    # On flat ground it goes where the next lower class is.
    classes = np.maximum(classes, block((20, 30, 60, 34, 1)))
    zone = above(drawn(classes, area_m2=200.0), 2)
    assert zone.intersection(cells_of(classes == 1, grid_of(classes))).area > 0.6 * zone.area


@settings(max_examples=8)
@given(RASTERS)
def test_small_parts_grow_where_no_gaps_are_closed(classes: np.ndarray) -> None:
    classes = np.pad(classes, 20)
    zones = drawn(classes, area_m2=100.0)
    assert violations(zones, classes, grid_of(classes), 100.0) - {"unknown class"} == set()


@pytest.mark.parametrize("gap", [7, 8, 12, 14])
def test_gaps_are_closed_beside_what_has_grown(gap: int) -> None:
    classes = block((3, 5, 57, 25, 1), (28, 25 + gap, 32, 29 + gap, 1))
    small = drawn(classes, area_m2=400.0).polygons
    wide = shapely.distance(*small) if small.size == 2 else 0.0
    closed = drawn(classes, gap_m=11.0, area_m2=400.0).polygons
    assert (closed.size == 1) == (wide < 11.0)
    assert drawn(classes, gap_m=11.0).polygons.size == 2


@pytest.mark.parametrize("gap", [3, 5, 6, 8])
def test_gaps_are_closed_up_to_the_width(gap: int) -> None:
    classes = block((3, 5, 57, 10, 1), (3, 10 + gap, 57, 32, 1))
    assert at(drawn(classes, gap_m=11.0), 30, 10 + gap / 2) == (1 if gap <= 5 else 0)


def test_a_thread_is_widened_and_a_wide_part_is_not() -> None:
    body = block((3, 3, 15, 57, 2))
    assert drawn(body, width_m=10.0).polygons[0].equals(cells_of(body > 0, grid_of(body)))
    zones = drawn(np.maximum(body, block((15, 30, 57, 31, 2))), width_m=10.0)
    across = shapely.LineString([(WEST, NORTH - 80.0), (WEST + 120.0, NORTH - 80.0)])
    assert 10.0 <= zones.polygons[0].intersection(across).length <= 13.0
    # An even number of cells that is wide enough stays as it is.
    thread = block((3, 10, 57, 15, 1))
    assert drawn(thread, width_m=10.0).polygons[0].area == pytest.approx(4 * thread.sum(), rel=1e-2)


@pytest.mark.parametrize("rim", [1, 4, 6])
def test_a_narrow_rim_is_widened_and_a_small_one_joins_the_higher_zone(rim: int) -> None:
    classes = block((18 - rim, 18 - rim, 42 + rim, 42 + rim, 1), (18, 18, 42, 42, 2))
    zones = drawn(classes, width_m=10.0)
    outer = max(rim, 5)
    assert [at(zones, 30, 42 + c) for c in (-0.5, rim / 2, outer - 0.1, outer + 0.1)] == [
        2,
        1,
        1,
        0,
    ]
    # A rim of one side only is smaller than the smallest zone.
    classes = block((18, 18, 42, 42 + rim, 1), (18, 18, 42, 42, 2))
    small = drawn(classes, width_m=10.0, area_m2=1000.0)
    assert at(small, 30, 42 + rim / 2) == 2 and at(small, 30, 42 + rim + 0.5) == 0


def test_several_narrow_rims_become_one_that_can_be_drawn() -> None:
    """Not all the highest: that would carry it across all of them."""
    classes = block((0, 0, 60, 17, 1), (0, 0, 60, 14, 2), (0, 0, 60, 11, 3))
    zones = drawn(classes, width_m=10.0)
    # Both rims of three cells make one of six.
    assert [at(zones, 30, col) for col in (5, 12.5, 15.5)] == [3, 2, 2]


def test_the_outer_limit_is_an_envelope_without_fingers() -> None:
    fingers = [(20, 2 + 12 * k, 20 + 15 + 5 * (k % 3), 7 + 12 * k, 1) for k in range(5)]
    classes = block((2, 2, 20, 57, 1), (8, 8, 14, 20, 2), (8, 30, 14, 40, 2), *fingers)
    grid = grid_of(classes)
    plain, envelope = (
        drawn_zones([classes], grid, Drawing(10.0, 0.0, 6.0, 60.0, 0.0, 3.0), None, [own])[0]
        for own in (False, True)
    )
    for zones in (plain, envelope):
        assert violations(zones, classes, grid) == set()
    # Between two fingers; and two zones of a higher class do not grow together.
    assert [at(z, 25, 10.5) for z in (plain, envelope)] == [0, 1]
    assert [at(z, 11, 25) for z in (plain, envelope)] == [1, 1]
    assert shapely.area(envelope.polygons[envelope.classes == 2]) == pytest.approx(
        shapely.area(plain.polygons[plain.classes == 2])
    )
    assert above(envelope, 1).length < 0.75 * above(plain, 1).length


@pytest.mark.parametrize("slope", [0.0, 0.25, 0.5, 1.0, 3.0])
def test_a_slanting_edge_becomes_a_straight_line(slope: float) -> None:
    i, j = np.mgrid[:60, :60]
    (zone,) = drawn((j * 1.0 >= 5 + slope * i).astype(np.int64), tolerance_m=3.0).polygons
    # Corners of the raster and the ends of the line.
    assert len(zone.exterior.coords) - 1 <= 9


def test_a_disk_becomes_round() -> None:
    i, j = np.mgrid[:80, :80]
    classes = (np.hypot(i - 40, j - 40) < 30).astype(np.int64)
    (exact,), (zone,) = (drawn(classes, tolerance_m=t).polygons for t in (0.0, 3.0))
    assert len(zone.exterior.coords) < len(exact.exterior.coords) / 2.5
    assert zone.length == pytest.approx(2 * np.pi * 61.5, rel=0.04)
    assert zone.area == pytest.approx(np.pi * 61.5**2, rel=0.05)
    assert zone.covers(exact)


def test_what_cannot_be_drawn_is_refused() -> None:
    classes = block((2, 2, 10, 10, 1))
    with pytest.raises(ValueError, match="rarer return period"):
        drawn_zones([classes, classes * 0], grid_of(classes), Drawing())
    with pytest.raises(ValueError, match="shape"):
        drawn_zones([classes], grid_of(classes[1:]), Drawing())
    with pytest.raises(ValueError, match="below 0"):
        drawn(classes - 1)
    with pytest.raises(InputError, match="too small for the precision"):
        cell_polygons(classes > 0, grid_of(classes, 0.005))
    for wrong in (
        {"scale": 0.0},
        {"min_area_m2": -1.0},
        {"closing_m": float("nan")},
        {"min_width_m": -1.0},
        {"envelope_m": -1.0},
        {"tolerance_m": -0.1},
    ):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            ZoningSettings(**wrong)


@pytest.mark.parametrize(("kind", "shape"), [("streaks", (5, 40)), ("smooth", (37, 20))])
def test_a_large_place_is_drawn_in_parts_as_it_is_at_once(
    kind: str, shape: tuple[int, int]
) -> None:
    coarse = np.maximum.accumulate([raster(kind, shape, seed) for seed in (1, 2)])
    maps = list(np.kron(coarse, np.ones((1, 4, 4), np.int64)))
    grid = grid_of(maps[0])
    rules = Drawing(1.0, 4.0, 1.0, 0.0, 0.0, 1.0)
    at_once = drawn_zones(maps, grid, rules)
    with mock.patch.multiple(drawing, _LENGTH=1, _BAND=4):
        # A large square in four parts.
        cuts = drawing.overlapping(4 * max(shape), reach_cells(rules, 2.0))
        assert len(cuts) > 1
        in_parts = drawn_zones(maps, grid, rules)
    for zones, whole, raw in zip(in_parts, at_once, maps, strict=True):
        assert violations(zones, raw, grid, 4.0) - {"unknown class"} == set()
        # Lines may lie elsewhere within the tolerance; what is just too small may be so or not.
        apart = [above(zones, k).symmetric_difference(above(whole, k)).area for k in range(1, 4)]
        assert sum(apart) <= 0.02 * sum(above(whole, k).area for k in range(1, 4))
    for k in range(1, 4):
        assert above(in_parts[0], k).difference(above(in_parts[1], k)).area < 1e-6


def test_a_missing_or_doubled_zone_would_be_noticed() -> None:
    classes = raster("smooth", (30, 30), 1)
    grid = grid_of(classes)
    zones = drawn(classes, tolerance_m=3.0)
    fewer = Coverage(zones.polygons[1:], zones.classes[1:])
    assert "lower than the raster" in violations(fewer, classes, grid)
    twice = Coverage(np.append(zones.polygons, zones.polygons[0]), np.append(zones.classes, 1))
    assert "overlap" in violations(twice, classes, grid)
    shifted = Coverage(shapely.transform(zones.polygons, lambda c: c + 3e-4), zones.classes)
    assert "off the grid of 1 mm" in violations(shifted, classes, grid)


def test_parts_that_touch_at_a_corner() -> None:
    classes = block((2, 2, 10, 10, 1), (10, 10, 20, 20, 1))
    zones = drawn(classes)
    assert len(zones.polygons) == 2
    assert violations(zones, classes, grid_of(classes)) == set()
    # A ring that closes at a corner only: its hole touches the outside there.
    classes = block((2, 2, 20, 20, 1), (7, 7, 12, 12, 0), (2, 2, 7, 7, 0))
    zones = drawn(classes)
    (ring,) = zones.polygons
    assert len(ring.interiors) == 1
    assert violations(zones, classes, grid_of(classes)) == set()


def test_a_perimeter_is_that_part_of_it_where_the_terrain_is_known() -> None:
    grid = grid_of(np.zeros((4, 6)), 2.0)
    grid.values[:, 3] = np.nan
    west, north = grid.west, grid.north
    whole = shapely.box(west - 9.0, north - 20.0, west + 30.0, north + 9.0)
    left, right = sorted(within_terrain([whole], grid), key=lambda part: part.bounds[0])
    assert left.equals(shapely.box(west, north - 8.0, west + 6.0, north))
    assert right.equals(shapely.box(west + 8.0, north - 8.0, west + 12.0, north))
    hole = shapely.box(west + 6.5, north - 4.0, west + 7.5, north - 2.0)
    assert within_terrain([hole], grid) == within_terrain([], grid) == ()
