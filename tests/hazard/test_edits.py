"""Edits by hand over computed zones: which level holds, who made it, and what has changed since."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from sassgis.grid import Grid
from sassgis.hazard.zoning.applied_edits import (
    AppliedEdit,
    share_of,
    shares_of_text,
    shares_text,
    with_edits,
)
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.settings.hazard_rules import Edit, EditLimit

CODES = ("residual_hazard", "slight", "mean", "substantial")


def box(west: float, south: float, east: float, north: float) -> shapely.Polygon:
    return shapely.box(1e6 + west, 2e5 + south, 1e6 + east, 2e5 + north)


#: Two zones of 100 m by 100 m beside each other: slight in the west, substantial in the east.
ZONES = Coverage(
    np.array([box(0, 0, 100, 100), box(100, 0, 200, 100)], object), np.array([2, 4], np.int64)
)


def edit(shape: shapely.Polygon, level: int, limit: EditLimit = "", computed: str = "") -> Edit:
    return Edit(shape, level, limit, "A. Expert", "2026-05-04", "deposits found here", computed)


def level_at(zones: Coverage, x: float, y: float) -> int:
    inside = shapely.contains_xy(zones.polygons, 1e6 + x, 2e5 + y)
    return int(zones.classes[inside].max(initial=0))


@pytest.mark.parametrize(
    ("level", "limit", "west", "east"),
    [
        (3, "", 3, 3),
        (0, "", 0, 0),
        (3, "at_least", 3, 4),
        (3, "at_most", 2, 3),
        (0, "at_most", 0, 0),
    ],
)
def test_which_level_holds(level: int, limit: EditLimit, west: int, east: int) -> None:
    across = edit(box(50, 40, 150, 60), level, limit)
    zones, made_by, (applied,) = with_edits(ZONES, [across], CODES)
    assert [level_at(zones, x, 50) for x in (75, 125)] == [west, east]
    # Elsewhere nothing is touched.
    elsewhere = [(25, 50), (175, 50), (75, 80), (125, 20)]
    assert [level_at(zones, x, y) for x, y in elsewhere] == [2, 4, 2, 4]
    assert shapely.coverage_is_valid(zones.polygons)
    kept = np.concatenate([zones.polygons, [across.geometry]])
    assert shapely.union_all(kept).area == pytest.approx(20_000.0)
    # What the edit set is a zone of its own that says so.
    assert set(made_by.tolist()) <= {-1, 0}
    own = shapely.union_all(zones.polygons[made_by == 0])
    acted = 1000.0 * ((west != 2 or limit == "") + (east != 4 or limit == ""))
    assert own.area == pytest.approx(acted if level else 0.0)
    assert applied.now == pytest.approx({"substantial": 0.5, "slight": 0.5})


def test_later_edits_lie_over_earlier_ones_and_reach_beyond_the_zones() -> None:
    first, second = edit(box(150, 0, 250, 100), 1), edit(box(180, 0, 300, 100), 3)
    zones, made_by, applied = with_edits(ZONES, [first, second], CODES)
    assert [level_at(zones, x, 50) for x in (140, 165, 190, 280)] == [4, 1, 3, 3]
    assert sorted(set(made_by.tolist())) == [-1, 0, 1]
    # Shares are of what was computed, not of what another edit has made of it.
    assert applied[1].now == pytest.approx({"substantial": 1 / 6, "not_in_danger": 5 / 6})


def test_without_edits_zones_are_the_same() -> None:
    zones, made_by, applied = with_edits(ZONES, [], CODES)
    assert zones is ZONES and (made_by == -1).all() and applied == ()


def test_what_was_computed_since_is_told_from_the_share_on_that_matters() -> None:
    now = {"substantial": 0.52, "slight": 0.48}
    for then, changed, told in (
        ("", np.nan, False),
        ("substantial 50 %, slight 50 %", 0.02, False),
        ("slight 100 %", 0.52, True),
        ("substantial 30 %", 0.70, True),
    ):
        own = AppliedEdit(edit(box(0, 0, 1, 1), 1), now, shares_of_text(then))
        assert own.changed == pytest.approx(changed, nan_ok=True)
        assert own.has_changed is told
    # Two samples of blocks are no change.
    own = AppliedEdit(edit(box(0, 0, 1, 1), 1), now, {"slight": 1.0}, by_chance=0.3)
    assert own.changed == pytest.approx(0.52) and not own.has_changed


def test_shares_as_text_and_back() -> None:
    shares = {"mean": 0.62, "residual_hazard": 0.38}
    assert shares_text(shares) == "mean 62 %, residual_hazard 38 %"
    assert shares_of_text(shares_text(shares)) == pytest.approx(shares)
    assert shares_of_text("mean 62 %") == pytest.approx({"mean": 0.62, "not_in_danger": 0.38})
    assert shares_of_text("nobody knows") == {}


def test_an_edit_narrower_than_a_cell_has_the_values_of_the_cells_below_it() -> None:
    grid = Grid(np.zeros((10, 10)), 1e6, 2e5 + 100.0, 10.0)
    cells, values = np.array([40, 41, 42, 95]), np.array([0.2, 0.4, 0.0, 0.7])
    # 4 m high, between the centres of two rows; 10, 10 and 5 m over the first three cells.
    strip = box(0, 50.5, 25, 54.5)
    assert share_of(strip, grid, cells, values) == pytest.approx((10 * 0.2 + 10 * 0.4) / 25)
    assert share_of(box(0, 0, 100, 100), grid, cells, values) == pytest.approx(0.013)
