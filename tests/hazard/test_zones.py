"""Zones: never below the raster, a valid coverage, nested over return periods."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sassgis.hazard.zoning.generalise import (
    Coverage,
    coverage,
    generalised,
    generalised_series,
    nested_coverages,
)
from sassgis.hazard.zoning.planar_graph import regions
from sassgis.model.errors import ConfigError, InputError
from sassgis.model.grid import Grid
from sassgis.model.hazard import ZoningSettings

pytestmark = pytest.mark.kernels

WEST, NORTH = 2_700_000.0, 1_120_000.0
KINDS = (
    "smooth",
    "streaks",
    "salt",
    "chequers",
    "spiral",
    "rings",
    "single",
    "edge",
    "full",
    "empty",
    "diagonals",
    "random",
)


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


@settings(max_examples=80, deadline=None)
@given(RASTERS, CELLS, st.sampled_from([0.0, 9.0, 100.0]))
def test_every_rule_holds_after_generalisation(
    classes: np.ndarray, cell_size: float, smallest: float
) -> None:
    grid = grid_of(classes, cell_size)
    rules = ZoningSettings(min_area_m2=smallest)
    coarse = generalised(classes, cell_size, rules)
    zones = coverage(coarse, grid, rules)
    # Where the raster itself is smaller than the smallest zone, nothing can be as large.
    limit = min(smallest, classes.size * cell_size**2)
    too_small = limit < smallest
    assert violations(zones, coarse, grid, 0.0 if too_small else smallest) == set()
    assert (coarse >= classes).all()
    assert violations(zones, classes, grid) - {"unknown class"} == set()


@settings(max_examples=50, deadline=None)
@given(RASTERS, CELLS)
def test_every_rule_holds_on_any_raster(classes: np.ndarray, cell_size: float) -> None:
    grid = grid_of(classes, cell_size)
    assert violations(coverage(classes, grid), classes, grid) == set()


@settings(max_examples=40, deadline=None)
@given(RASTERS, st.sampled_from([0.0, 1.0, 2.0, 3.7]))
def test_zones_stay_within_the_tolerance_of_their_cells(
    classes: np.ndarray, tolerance: float
) -> None:
    grid = grid_of(classes)
    zones = coverage(classes, grid, ZoningSettings(tolerance_m=tolerance))
    for k in range(1, int(classes.max()) + 1):
        allowed = cells_of(classes >= k, grid).buffer(tolerance + 1e-6, quad_segs=32)
        # The buffer's arcs are cut by its chords: up to a thousandth of the tolerance.
        assert above(zones, k).difference(allowed.buffer(0.002 * tolerance)).area < 1e-3


@settings(max_examples=40, deadline=None)
@given(SERIES, CELLS, st.sampled_from([0.0, 40.0]))
def test_rarer_zones_contain_more_frequent_ones(
    maps: list[np.ndarray], cell_size: float, smallest: float
) -> None:
    maps = list(np.maximum.accumulate(maps))
    grid = grid_of(maps[0], cell_size)
    rules = ZoningSettings(min_area_m2=smallest)
    coarse = generalised_series(maps, cell_size, rules)
    series = nested_coverages(coarse, grid, rules)
    for zones, classes, raw in zip(series, coarse, maps, strict=True):
        limit = smallest if classes.size * cell_size**2 >= smallest else 0.0
        assert violations(zones, classes, grid, limit) == set()
        assert (classes >= raw).all()
    for frequent, rare in pairwise(series):
        for k in range(1, 4):
            inner, outer = above(frequent, k), above(rare, k)
            assert inner.difference(outer).area < 1e-6
            points = shapely.point_on_surface(frequent.polygons[frequent.classes >= k])
            assert shapely.intersects(points, outer).all()


@settings(max_examples=40, deadline=None)
@given(
    RASTERS,
    st.sampled_from([20.0, 100.0]),
    st.sampled_from([0.0, 4.0, 6.0, 8.0]),
    st.sampled_from([0.0, 4.0, 6.0, 10.0]),
)
def test_generalisation_is_done_once_and_knows_no_direction(
    classes: np.ndarray, smallest: float, closing: float, width: float
) -> None:
    rules = ZoningSettings(min_area_m2=smallest, closing_m=closing, min_width_m=width)
    out = generalised(classes, 2.0, rules)
    np.testing.assert_array_equal(generalised(out, 2.0, rules), out)
    for turned in (np.flipud, np.fliplr, np.transpose):
        np.testing.assert_array_equal(
            generalised(np.ascontiguousarray(turned(classes)), 2.0, rules), turned(out)
        )


@settings(max_examples=40, deadline=None)
@given(RASTERS, st.integers(0, 10_000), st.sampled_from([20.0, 100.0]))
def test_nothing_grows_where_the_terrain_is_unknown(
    classes: np.ndarray, seed: int, smallest: float
) -> None:
    unknown = ndimage.maximum_filter(
        np.random.default_rng(seed).random(classes.shape) < 0.02, 3, mode="constant"
    )
    classes = np.where(unknown, 0, classes)
    rules = ZoningSettings(min_area_m2=smallest)
    out = generalised(classes, 2.0, rules, known=~unknown)
    assert (out >= classes).all()
    assert (out[unknown] == 0).all()
    np.testing.assert_array_equal(generalised(out, 2.0, rules, known=~unknown), out)
    grid = grid_of(classes)
    assert violations(coverage(out, grid, rules), out, grid) == set()


@settings(max_examples=40, deadline=None)
@given(RASTERS, st.integers(1, 9), st.integers(1, 9))
def test_zones_do_not_depend_on_where_the_raster_begins(
    classes: np.ndarray, rows: int, cols: int
) -> None:
    grid = grid_of(classes)
    zones = coverage(classes, grid)
    again = coverage(classes, grid)
    wide = np.pad(classes, ((rows, 2), (cols, 3)))
    moved = Grid(np.zeros(wide.shape), WEST - 2 * cols, NORTH + 2 * rows, 2.0)
    padded = coverage(wide, moved)
    for other in (again, padded):
        assert shapely.equals_exact(zones.polygons, other.polygons).all()
        np.testing.assert_array_equal(zones.classes, other.classes)


@settings(max_examples=40, deadline=None)
@given(RASTERS, st.sampled_from([2.0 / 3.0, 0.3048, 1.52401]))
def test_cells_that_are_no_multiple_of_the_precision(classes: np.ndarray, cell_size: float) -> None:
    grid = Grid(np.zeros(classes.shape), WEST + 0.12345, NORTH - 0.98765, cell_size)
    found = violations(coverage(classes, grid), classes, grid)
    # The corners themselves are rounded, by half a millimetre at most.
    assert found <= {"lower than the raster"}
    for k in range(1, int(classes.max()) + 1):
        cells = cells_of(classes >= k, grid)
        zones = above(coverage(classes, grid), k)
        assert cells.difference(zones).area <= 0.001 * cells.length + 1e-9


@settings(max_examples=40, deadline=None)
@given(RASTERS)
def test_components_are_those_of_scipy(classes: np.ndarray) -> None:
    part = regions(classes)
    labels, n = part.of_cell, part.cells.size
    expected = 0
    for k in np.unique(classes):
        own, count = ndimage.label(classes == k)
        expected += count
        pairs = {(a, b) for a, b in zip(labels[own > 0], own[own > 0], strict=True)}
        assert len(pairs) == count
    assert n == expected
    first = np.unique(labels.ravel(), return_index=True)[1]
    assert (np.diff(first) > 0).all()


def test_a_missing_or_doubled_zone_would_be_noticed() -> None:
    classes = generalised(raster("smooth", (30, 30), 1), 2.0)
    grid = grid_of(classes)
    zones = coverage(classes, grid)
    fewer = Coverage(zones.polygons[1:], zones.classes[1:])
    assert "lower than the raster" in violations(fewer, classes, grid)
    twice = Coverage(np.append(zones.polygons, zones.polygons[0]), np.append(zones.classes, 1))
    assert "overlap" in violations(twice, classes, grid)
    shifted = Coverage(shapely.transform(zones.polygons, lambda c: c + 3e-4), zones.classes)
    assert "off the grid of 1 mm" in violations(shifted, classes, grid)


def block(*places: tuple[int, int, int, int, int], shape: tuple[int, int] = (30, 30)) -> np.ndarray:
    out = np.zeros(shape, np.int64)
    for top, left, bottom, right, k in places:
        out[top:bottom, left:right] = k
    return out


def test_a_ring_keeps_its_hole_and_the_island_in_it() -> None:
    classes = block((2, 2, 28, 28, 1), (7, 7, 23, 23, 0), (12, 12, 18, 18, 2))
    rules = ZoningSettings(100.0, closing_m=0.0, min_width_m=0.0)
    coarse = generalised(classes, 2.0, rules)
    np.testing.assert_array_equal(coarse, classes)
    zones = coverage(coarse, grid_of(classes))
    assert zones.classes.tolist() == [1, 2]
    ring, island = zones.polygons
    assert len(ring.interiors) == 1
    assert ring.area == pytest.approx(4 * (26 * 26 - 16 * 16))
    assert island.area == pytest.approx(4 * 36)
    assert shapely.Polygon(ring.interiors[0]).contains(island)


def test_a_small_hole_is_filled_and_a_large_one_is_not() -> None:
    rules = ZoningSettings(100.0, closing_m=0.0, min_width_m=0.0)
    for side, stays in ((4, False), (5, True)):
        classes = block((2, 2, 28, 28, 2), (10, 10, 10 + side, 10 + side, 0))
        coarse = generalised(classes, 2.0, rules)
        assert bool((coarse[10 : 10 + side, 10 : 10 + side] == 0).all()) is stays
        assert bool((coarse == np.maximum(classes, block((2, 2, 28, 28, 2)))).all()) is not stays


def test_a_hole_rises_to_the_lowest_class_that_encloses_it() -> None:
    # Half of its border is class 1, half class 3.
    classes = block((2, 2, 28, 15, 1), (2, 15, 28, 28, 3), (13, 13, 17, 17, 0))
    coarse = generalised(classes, 2.0, ZoningSettings(closing_m=0.0, min_width_m=0.0))
    assert (coarse[13:17, 13:17] == 1).all()


def test_a_zone_that_the_edge_cuts_slantwise_does_not_grow_along_it() -> None:
    rows, columns = np.indices((60, 160))
    classes = ((columns - 2 * rows >= 0) & (columns - 2 * rows < 30)).astype(np.int64)
    for turned in (classes, classes[::-1], classes.T):
        out = generalised(turned, 2.0)
        assert out.sum() < 1.1 * turned.sum()
        # Nor along the edge of what is known.
        known = np.pad(np.ones(turned.shape, bool), 20)
        same = generalised(np.pad(turned, 20), 2.0, known=known)
        np.testing.assert_array_equal(same[20:-20, 20:-20], out)
        assert same.sum() == out.sum()


def test_a_small_zone_joins_the_higher_class_with_the_longest_border() -> None:
    rules = ZoningSettings(closing_m=0.0, min_width_m=0.0)
    classes = block((5, 5, 25, 15, 2), (5, 17, 25, 27, 3), (10, 15, 14, 17, 1), (14, 15, 15, 16, 1))
    coarse = generalised(classes, 2.0, rules)
    # Five sides touch class 2, four class 3.
    assert (coarse[classes == 1] == 2).all()
    assert (coarse[classes != 1] == classes[classes != 1]).all()


def test_a_small_zone_on_its_own_grows_to_the_smallest_area() -> None:
    classes = block((15, 15, 16, 16, 2))
    coarse = generalised(classes, 2.0, ZoningSettings(100.0, min_width_m=6.0))
    assert set(np.unique(coarse)) == {0, 2}
    assert 25 <= (coarse > 0).sum() <= 25 + 8
    rows, cols = np.nonzero(coarse)
    assert rows.max() - rows.min() == cols.max() - cols.min()
    (zone,) = coverage(coarse, grid_of(classes)).polygons
    assert zone.area >= 100.0


def test_a_small_zone_grows_around_what_is_unknown_and_not_through_it() -> None:
    classes = block((15, 14, 16, 15, 1))
    known = np.ones(classes.shape, bool)
    known[:, 15] = False
    coarse = generalised(classes, 2.0, known=known)
    assert (coarse[:, 15:] == 0).all()
    assert (coarse > 0).sum() >= 25
    known[:] = False
    known[15, 14] = True
    np.testing.assert_array_equal(generalised(classes, 2.0, known=known), classes)


def test_gaps_between_fall_lines_are_closed_up_to_the_width() -> None:
    for gap, closes in ((5, True), (6, False)):
        classes = block((3, 5, 27, 10, 1), (3, 10 + gap, 27, 22, 1))
        coarse = generalised(classes, 2.0)
        assert bool(coarse[10:20, 10 : 10 + gap].all()) is closes
    for gap in range(1, 8):
        for closing in range(8):
            classes = block((3, 5, 27, 10, 1), (3, 10 + gap, 27, 25, 1))
            rules = ZoningSettings(closing_m=2.0 * closing + 0.5)
            coarse = generalised(classes, 2.0, rules)
            filled = coarse[12:18, 10 : 10 + gap]
            assert filled.all() if gap <= closing else not filled.any(), (gap, closing)


def test_a_thread_is_widened_and_a_wide_part_is_not() -> None:
    rules = ZoningSettings(closing_m=0.0, min_area_m2=0.0, min_width_m=6.0)
    body = block((3, 3, 12, 27, 2))
    np.testing.assert_array_equal(generalised(body, 2.0, rules), body)
    thread = np.maximum(body, block((12, 15, 27, 16, 2)))
    coarse = generalised(thread, 2.0, rules)
    assert (coarse[14:27, 14:17] == 2).all()
    assert (coarse[14:, :14] == 0).all()
    assert (coarse[14:, 17:] == 0).all()
    assert (coarse[:12] == body[:12]).all()
    # Never less than asked for, in whole cells alike on either side.
    for asked, cells in ((0.0, 1), (2.0, 1), (2.1, 3), (6.0, 3), (7.0, 5), (10.0, 5)):
        rules = ZoningSettings(closing_m=0.0, min_area_m2=0.0, min_width_m=asked)
        assert (generalised(thread, 2.0, rules)[20] > 0).sum() == cells, asked


def test_a_part_of_an_even_number_of_cells_is_wide_enough() -> None:
    rules = ZoningSettings(closing_m=0.0, min_area_m2=0.0, min_width_m=10.0)
    thread = block((3, 10, 27, 12, 1))
    np.testing.assert_array_equal(generalised(thread, 5.0, rules), thread)


def test_a_narrow_rim_joins_the_higher_zone_and_a_wide_one_stays() -> None:
    rules = ZoningSettings(closing_m=0.0, min_area_m2=0.0, min_width_m=10.0)
    for rim, stays in ((1, False), (4, False), (5, True)):
        classes = block((8 - rim, 8 - rim, 22 + rim, 22 + rim, 1), (8, 8, 22, 22, 2))
        coarse = generalised(classes, 2.0, rules)
        assert (coarse == (classes if stays else 2 * (classes > 0)))[6:24, 10:20].all(), rim


def test_several_narrow_rims_become_one_that_can_be_drawn() -> None:
    """Not all the highest: that would carry it across all of them."""
    rules = ZoningSettings(closing_m=0.0, min_area_m2=0.0, min_width_m=10.0)
    classes = block((0, 0, 30, 17, 1), (0, 0, 30, 14, 2), (0, 0, 30, 11, 3))
    coarse = generalised(classes, 2.0, rules)
    # Both rims of three cells make one of six.
    assert [np.unique(coarse[:, a:b]).tolist() for a, b in ((0, 11), (11, 17))] == [[3], [2]]


@settings(max_examples=40, deadline=None)
@given(RASTERS)
def test_nothing_thinner_than_the_least_width_is_left(classes: np.ndarray) -> None:
    """A disk of three cells fits into every zone beside a higher one."""
    rules = ZoningSettings(closing_m=0.0, min_area_m2=60.0, min_width_m=6.0)
    padded = np.pad(classes, 4)
    out = generalised(padded, 2.0, rules)
    cross = ndimage.generate_binary_structure(2, 1)
    for k in range(1, int(out.max()) + 1):
        parts, n = ndimage.label(out == k, cross)
        for label in range(1, n + 1):
            part = parts == label
            around = out[ndimage.binary_dilation(part, cross) & ~part]
            if around.max(initial=0) > k:
                assert ndimage.binary_opening(part, cross).any()


def test_parts_that_touch_at_a_corner() -> None:
    classes = block((2, 2, 10, 10, 1), (10, 10, 20, 20, 1))
    zones = coverage(classes, grid_of(classes))
    assert len(zones.polygons) == 2
    assert violations(zones, classes, grid_of(classes)) == set()
    # A ring that closes at a corner only: its hole touches the outside there.
    classes = block((2, 2, 20, 20, 1), (7, 7, 12, 12, 0), (2, 2, 7, 7, 0))
    zones = coverage(classes, grid_of(classes))
    (ring,) = zones.polygons
    assert len(ring.interiors) == 1
    assert violations(zones, classes, grid_of(classes)) == set()


def test_a_slanting_edge_becomes_a_straight_line() -> None:
    i, j = np.mgrid[:60, :60]
    for slope in (0.0, 0.25, 0.5, 1.0, 3.0):
        classes = (j * 1.0 >= 5 + slope * i).astype(np.int64)
        (zone,) = coverage(classes, grid_of(classes)).polygons
        # Corners of the raster and the ends of the line.
        assert len(zone.exterior.coords) - 1 <= 7, slope


def test_a_disk_becomes_round() -> None:
    i, j = np.mgrid[:80, :80]
    classes = (np.hypot(i - 40, j - 40) < 30).astype(np.int64)
    grid = grid_of(classes)
    (exact,) = coverage(classes, grid, ZoningSettings(tolerance_m=0.0)).polygons
    (zone,) = coverage(classes, grid, ZoningSettings(tolerance_m=3.0)).polygons
    # No cell is cut, and nothing is added beyond the shortest line around them.
    assert zone.equals(exact.convex_hull)
    assert len(zone.exterior.coords) < len(exact.exterior.coords) / 2.5
    assert exact.length / zone.length > 1.2
    assert zone.length == pytest.approx(2 * np.pi * 60, rel=0.03)
    assert zone.area == pytest.approx(np.pi * 60**2, rel=0.05)
    assert zone.covers(exact)


def test_maps_that_rise_in_opposite_directions_are_smoothed_each_its_own_way() -> None:
    i, j = np.mgrid[:20, :20]
    frequent = (j > i).astype(np.int64)
    rare = np.where(j > i, 1, 3)
    grid = grid_of(frequent)
    series = nested_coverages([frequent, rare], grid)
    for zones, classes in zip(series, (frequent, rare), strict=True):
        assert violations(zones, classes, grid) == set()
        # A straight line, and the corners of the raster.
        assert all(len(p.exterior.coords) - 1 <= 7 for p in zones.polygons)


def test_what_cannot_be_drawn_is_refused() -> None:
    classes = block((2, 2, 10, 10, 1))
    with pytest.raises(ValueError, match="rarer return period"):
        nested_coverages([classes, classes * 0], grid_of(classes))
    with pytest.raises(ValueError, match="shape"):
        coverage(classes, grid_of(classes[1:]))
    with pytest.raises(ValueError, match="below 0"):
        coverage(classes - 1, grid_of(classes))
    with pytest.raises(ValueError, match="below 0"):
        generalised(classes - 1, 2.0)
    with pytest.raises(InputError, match="too small for the precision"):
        coverage(classes, grid_of(classes, 0.005))
    for wrong in (
        {"min_area_m2": -1.0},
        {"closing_m": float("nan")},
        {"min_width_m": -1.0},
        {"tolerance_m": -0.1},
    ):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            ZoningSettings(**wrong)
