from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import shapely
import shapely.affinity

from sassgis.errors import InputError
from sassgis.settings.results import ReleasePoints
from sassgis.settings.settings import ReleaseSettings
from sassgis.terrain.release import MAX_POINTS, point_keys, points_expected, release_points, take

pytestmark = pytest.mark.kernels

FIVE = ReleaseSettings(spacing_m=5.0)
SQUARE = shapely.box(1001.0, 2001.0, 1019.0, 2011.0)
LEFT = shapely.Polygon([(0, 0), (31, 3), (17, 29), (2, 22)])


def test_lattice_lies_on_multiples_of_the_spacing_within_the_polygon() -> None:
    points = release_points([("a", SQUARE)], FIVE)
    assert sorted(zip(points.x, points.y, strict=True)) == [
        (x, y) for x in (1005.0, 1010.0, 1015.0) for y in (2005.0, 2010.0)
    ]
    # A part between the points of the lattice gets its representative point.
    tiny = shapely.box(1101.0, 2001.0, 1102.0, 2002.0)
    points = release_points([("a", shapely.MultiPolygon([SQUARE, tiny]))], FIVE)
    assert len(points) == 7 and shapely.contains_xy(tiny, points.x[-1], points.y[-1])
    assert len(release_points([], FIVE)) == 0


@pytest.mark.parametrize("placement", ["grid", "random"])
def test_points_of_an_area_do_not_depend_on_the_others(placement: str) -> None:
    settings = ReleaseSettings(spacing_m=3.0, placement=placement)
    alone = release_points([("b", LEFT)], settings, seed=5)
    both = release_points([("a", SQUARE), ("b", LEFT)], settings, seed=5)
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
    assert [int(k) for k in point_keys("cliff", 2)] == [4207823814202407420, 4647717136730258016]


def test_random_placement_is_uniform_and_depends_on_seed_and_name() -> None:
    def placed(name: str, seed: int) -> ReleasePoints:
        settings = ReleaseSettings(spacing_m=0.5, placement="random")
        return release_points([(name, LEFT)], settings, seed=seed)

    first = placed("a", 1)
    assert len(first) == round(LEFT.area / 0.25)
    assert shapely.contains_xy(LEFT, first.x, first.y).all()
    # The mean of n uniform points misses the centroid by about width / sqrt(12 n).
    assert abs(first.x.mean() - LEFT.centroid.x) < 4 * 31 / np.sqrt(12 * len(first))
    assert abs(first.y.mean() - LEFT.centroid.y) < 4 * 29 / np.sqrt(12 * len(first))
    assert np.array_equal(placed("a", 1).x, first.x)
    for name, seed in (("a", 2), ("b", 1)):
        assert not np.any(placed(name, seed).x == first.x)


def test_lines_and_points() -> None:
    line = shapely.LineString([(0, 0), (10, 0), (10, 7)])
    points = release_points([("l", line)], FIVE)
    assert np.allclose(np.c_[points.x, points.y], [(0, 0), (5, 0), (10, 0), (10, 5)])
    given = shapely.MultiPoint([(3, 4), (1, 2)])
    points = release_points([("p", given)], FIVE)
    assert np.array_equal(np.c_[points.x, points.y], [(3, 4), (1, 2)])


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


def test_bad_inputs_are_named() -> None:
    with pytest.raises(InputError, match="same name"):
        release_points([("a", SQUARE), ("a", LEFT)], FIVE)
    with pytest.raises(InputError, match=r"'a'.*empty"):
        release_points([("a", shapely.Polygon())], FIVE)
    bow = shapely.Polygon([(0, 0), (10, 10), (10, 0), (0, 10)])
    with pytest.raises(InputError, match="Self-intersection"):
        release_points([("a", bow)], FIVE)


# ---------------------------------------------------------------------------------------------
# Parts that are narrower than the lattice

WEST, SOUTH = 2_700_020.0, 1_119_965.0


def band(angle_deg: float, beside_m: float, width_m: float, length_m: float = 160.0) -> Any:
    """A band at some angle and some way beside the lattice."""
    line = shapely.LineString([(0.0, 0.0), (length_m, 0.0)])
    turned = shapely.affinity.rotate(line, angle_deg, origin=(0.0, 0.0))
    whole = turned.buffer(width_m / 2, cap_style="flat")
    return shapely.affinity.translate(whole, WEST + 0.3 * beside_m, SOUTH + beside_m)


@pytest.mark.parametrize("width", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("angle", [0.0, 7.0, 45.0, 90.0])
def test_points_of_a_narrow_area_go_with_its_size(angle: float, width: float) -> None:
    for beside in np.arange(0.0, 5.0, 1.3):
        area = band(angle, beside, width)
        points = release_points([("a", area)], FIVE)
        assert len(points) == round(160.0 * width / 25.0)
        assert shapely.contains_xy(area, points.x, points.y).all()
        assert points.sides is not None
        along = np.hypot(*np.diff(np.column_stack([points.x, points.y]), axis=0).T)
        of_point = 160.0 / len(points)
        # Triangles are up to a quarter of the spacing long.
        assert np.abs(along - of_point).max() < 2.6
        # What the points represent fills the band and hardly more.
        at = np.column_stack([points.x, points.y])[:, None] + np.einsum(
            "km,nmi->nki", np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2.0, points.sides
        )
        covered = shapely.union_all(shapely.polygons(at))
        assert covered.intersection(area).area > 0.8 * area.area
        assert covered.area < 1.15 * area.area


def test_an_arm_counts_by_its_area_beside_a_wide_part() -> None:
    for beside in (0.0, 2.6):
        wide = shapely.box(WEST, SOUTH, WEST + 48.0, SOUTH + 48.0)
        arm = shapely.box(WEST + 47.0, SOUTH + 9.0 + beside, WEST + 148.0, SOUTH + 11.0 + beside)
        both = release_points([("a", shapely.union(wide, arm))], FIVE)
        alone = release_points([("a", wide)], FIVE)
        # The lattice stays, with its random draws.
        for name in ("x", "y", "key"):
            assert np.array_equal(getattr(both, name)[: len(alone)], getattr(alone, name))
        assert len(both) == len(alone) + 8
        assert (both.x[len(alone) :] > WEST + 48.0).all()


def test_branches_and_rings_get_points_all_along() -> None:
    cross = shapely.union_all([shapely.box(0, 0, 200, 2), shapely.box(99, -100, 101, 100)])
    ring = shapely.Point(0, 0).buffer(60.0).difference(shapely.Point(0, 0).buffer(58.0))
    for shape in (cross, ring):
        points = release_points([("a", shape)], FIVE)
        assert len(points) == round(shape.area / 25.0)
        # 2 m wide: a point represents 12.5 m.
        reached = shapely.union_all(shapely.points(points.x, points.y).tolist()).buffer(12.5)
        assert shape.difference(reached).area < 0.06 * shape.area


@pytest.mark.parametrize("beside", [0.0, 1.0, 2.5])
def test_a_band_as_wide_as_the_spacing_may_lie_on_the_lattice(beside: float) -> None:
    area = shapely.box(WEST, SOUTH + beside, WEST + 100.0, SOUTH + beside + 5.0)
    assert len(release_points([("a", area)], FIVE)) == 20


def test_only_points_of_polygons_on_a_lattice_represent_an_area() -> None:
    mixed = shapely.GeometryCollection([SQUARE, shapely.LineString([(0, 0), (10, 0)])])
    points = release_points([("a", mixed), ("b", shapely.Point(3, 4))], FIVE)
    assert points.sides is not None
    assert points.sides.any(axis=(1, 2)).tolist() == [True] * 6 + [False] * 4
    assert not release_points(
        [("a", SQUARE)], ReleaseSettings(spacing_m=5.0, placement="random")
    ).sides.any()  # type: ignore[union-attr]
