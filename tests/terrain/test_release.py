from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from sassgis.model.errors import InputError
from sassgis.model.settings import ReleaseSettings
from sassgis.terrain.release import (
    MAX_POINTS,
    point_keys,
    points_expected,
    release_points,
    take,
)

pytestmark = pytest.mark.kernels

FIVE = ReleaseSettings(spacing_m=5.0)
SQUARE = shapely.box(1001.0, 2001.0, 1019.0, 2011.0)
LEFT = shapely.Polygon([(0, 0), (31, 3), (17, 29), (2, 22)])


def test_lattice_lies_on_multiples_of_the_spacing_within_the_polygon() -> None:
    points = release_points([("a", SQUARE)], FIVE)
    assert sorted(zip(points.x, points.y, strict=True)) == [
        (x, y) for x in (1005.0, 1010.0, 1015.0) for y in (2005.0, 2010.0)
    ]


@pytest.mark.parametrize("placement", ["grid", "random"])
def test_points_of_an_area_do_not_depend_on_the_others(placement: str) -> None:
    alone = release_points(
        [("b", LEFT)], ReleaseSettings(spacing_m=3.0, placement=placement), seed=5
    )
    both = release_points(
        [("a", SQUARE), ("b", LEFT)], ReleaseSettings(spacing_m=3.0, placement=placement), seed=5
    )
    own = take(both, np.flatnonzero(both.area == 1))
    assert np.array_equal(own.x, alone.x)
    assert np.array_equal(own.y, alone.y)
    assert np.array_equal(own.key, alone.key)
    assert both.area_names == ("a", "b")


def test_keys_are_distinct_and_fixed() -> None:
    keys = np.concatenate([point_keys(name, 5000) for name in ("a", "b", "cliff", "Ä")])
    assert np.unique(keys).size == keys.size
    assert np.array_equal(point_keys("a", 10), point_keys("a", 100)[:10])
    # Written down once: a change would change every result that users have on file.
    assert [int(k) for k in point_keys("cliff", 2)] == [
        4207823814202407420,
        4647717136730258016,
    ]


def test_small_polygon_gets_its_representative_point() -> None:
    tiny = shapely.box(1001.0, 2001.0, 1002.0, 2002.0)
    points = release_points([("a", tiny)], FIVE)
    assert len(points) == 1
    assert shapely.contains_xy(tiny, points.x[0], points.y[0])


def test_random_placement_is_uniform_and_depends_on_seed_and_name() -> None:
    first = release_points(
        [("a", LEFT)], ReleaseSettings(spacing_m=0.5, placement="random"), seed=1
    )
    assert len(first) == round(LEFT.area / 0.25)
    assert shapely.contains_xy(LEFT, first.x, first.y).all()
    # The mean of n uniform points misses the centroid by about width / sqrt(12 n).
    assert abs(first.x.mean() - LEFT.centroid.x) < 4 * 31 / np.sqrt(12 * len(first))
    assert abs(first.y.mean() - LEFT.centroid.y) < 4 * 29 / np.sqrt(12 * len(first))
    for name, seed in (("a", 2), ("b", 1)):
        other = release_points(
            [(name, LEFT)], ReleaseSettings(spacing_m=0.5, placement="random"), seed=seed
        )
        assert not np.any(other.x == first.x)
    again = release_points(
        [("a", LEFT)], ReleaseSettings(spacing_m=0.5, placement="random"), seed=1
    )
    assert np.array_equal(again.x, first.x)


def test_lines_and_points() -> None:
    line = shapely.LineString([(0, 0), (10, 0), (10, 7)])
    points = release_points([("l", line)], FIVE)
    assert np.allclose(np.c_[points.x, points.y], [(0, 0), (5, 0), (10, 0), (10, 5)])
    given = shapely.MultiPoint([(3, 4), (1, 2)])
    points = release_points([("p", given)], FIVE)
    assert np.array_equal(np.c_[points.x, points.y], [(3, 4), (1, 2)])


def test_parts_of_a_multipolygon_all_get_points() -> None:
    parts = shapely.MultiPolygon([SQUARE, shapely.box(1101.0, 2001.0, 1102.0, 2002.0)])
    points = release_points([("a", parts)], FIVE)
    assert len(points) == 7


@pytest.mark.parametrize(
    ("shape", "placement", "found"),
    [
        (SQUARE, "grid", f"{SQUARE.area / 1e-18:.3g} points"),
        (SQUARE, "random", f"{SQUARE.area / 1e-18:.3g} points"),
        (SQUARE.exterior, "grid", f"{SQUARE.length / 1e-9:.3g} points"),
        # Thin and aslant: few points in it, too many in the rectangle around it.
        (shapely.LineString([(0, 0), (1e-4, 1e-4)]).buffer(1e-13), "grid", "1e+10 points"),
    ],
)
def test_too_many_points_are_not_begun(shape: object, placement: str, found: str) -> None:
    with pytest.raises(InputError, match="too fine") as refused:
        release_points([("a", shape)], ReleaseSettings(spacing_m=1e-9, placement=placement))  # type: ignore[arg-type, list-item]
    assert refused.value.field == "release.spacing_m" and refused.value.found == found
    # Areas count together.
    half = 1.3 * math.sqrt(SQUARE.area / MAX_POINTS)
    assert points_expected(SQUARE, half) < MAX_POINTS
    with pytest.raises(InputError, match="too fine"):
        release_points([("a", SQUARE), ("b", SQUARE)], ReleaseSettings(spacing_m=half))


def test_nothing_gives_nothing() -> None:
    assert len(release_points([], FIVE)) == 0


def test_bad_inputs_are_named() -> None:
    with pytest.raises(InputError, match="same name"):
        release_points([("a", SQUARE), ("a", LEFT)], FIVE)
    with pytest.raises(InputError, match=r"'a'.*empty"):
        release_points([("a", shapely.Polygon())], FIVE)
    bow = shapely.Polygon([(0, 0), (10, 10), (10, 0), (0, 10)])
    with pytest.raises(InputError, match="Self-intersection"):
        release_points([("a", bow)], FIVE)
