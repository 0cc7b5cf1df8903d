"""The change from one result to another, counted by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from sassgis.errors import InputError
from sassgis.grid import Grid
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.settings.exposure import ExposedObject, PlacedObjects
from sassgis.settings.results import RUNOUT_COUNTS, Band, RasterClass, RasterLayer
from sassgis.studies.result_change import (
    ENERGY_MEAN,
    REACH_MEAN,
    difference,
    levels_differ,
    result_change,
)
from sassgis.studies.stored_result import StoredResult, objects_within, on_common_cells

NO_OBJECTS: Any = ((), np.empty(0, np.int64), np.empty(0, np.int64))
SHAPE = (6, 8)
CELL = 2.0
LEVELS = (RasterClass(1, "low", "#ffff00"), RasterClass(2, "high", "#ff0000"))


def manifest(**changed: Any) -> dict[str, Any]:
    return {
        "sassgis": "1.0", "seed": 1, "preset": "own", "versions": {"numpy": "2"},
        "ref_widths_m": {"reach_probability": CELL, "hazard": 10.0},
        "inputs": [{"role": "dem", "path": "dem.tif", "sha256": "a" * 64}],
        "settings": {"terrain": {"dem": "/here/dem.tif"}, "blocks": [{"name": "big", "n": 1}]},
        "counts": {"rocks": 101, "rocks_never_started": 1},
        **changed,
    }  # fmt: skip


def with_runouts(*metres: int) -> dict[str, Any]:
    counts = manifest()["counts"] | dict(zip(RUNOUT_COUNTS, metres, strict=True))
    return manifest(counts=counts)


def layer(stem: str, classes: tuple[RasterClass, ...] = (), **bands: np.ndarray) -> RasterLayer:
    made = tuple(Band(n, n, "", v.astype(np.float32)) for n, v in bands.items())
    return RasterLayer(stem, stem, "", made, (), "", classes)


def stored(reach: np.ndarray, *, error: float = 0.0, **changed: Any) -> StoredResult:
    """A result whose other maps follow from the reach probability."""
    error_map = np.where(np.isfinite(reach), error, np.nan)
    level = np.where(np.isfinite(reach), np.where(reach > 0.25, 2.0, 1.0), np.nan)
    maps = {
        "reach_probability": layer("reach_probability", reach=reach, standard_error=error_map),
        "energy": layer("energy", q95=1000.0 * reach),
        "hazard_level": layer("hazard_level", LEVELS, level=level),
    }
    grid = Grid(np.zeros(reach.shape), 100.0, 200.0, CELL)
    return replace(StoredResult(Path("result"), manifest(), grid, maps), **changed)


def block(col: int, value: float = 0.5) -> np.ndarray:
    """Two columns of three cells each, from a column on."""
    out = np.full(SHAPE, np.nan)
    out[1:4, col : col + 2] = value
    return out


def test_difference_counts_unreached_cells_as_zero() -> None:
    before = np.array([0.2, np.nan, 0.5, np.nan])
    after = np.array([0.1, 0.3, np.nan, np.nan])
    assert np.allclose(difference(before, after), [-0.1, 0.3, -0.5, np.nan], equal_nan=True)


def test_a_known_shift_gives_the_known_table() -> None:
    """Six cells of 4 m², moved by one column: three left, three new, three in both."""
    found = result_change(stored(block(2)), stored(block(3, 0.25)), NO_OBJECTS)
    area = found.row("map", "area reached")
    assert (area.before, area.after) == (24.0, 24.0)
    alone = found.row("map", "area reached in one result only")
    assert (alone.before, alone.after) == (12.0, 12.0)
    reach = found.row("map", REACH_MEAN)
    assert reach.before == pytest.approx(6 * 0.5 / 9) and reach.after == pytest.approx(6 * 0.25 / 9)
    energy = found.row("map", ENERGY_MEAN)
    assert (energy.before, energy.after, energy.change) == (500.0, 250.0, -250.0)
    # High and left, high and lower, new and low.
    assert (found.lower_m2, found.higher_m2) == (24.0, 12.0)
    assert found.row("run-out", "blocks that started (weighted)").after == 100


@given(st.integers(0, 6), st.integers(0, 6), st.floats(0.01, 1.0), st.floats(0.01, 1.0))
def test_change_is_antisymmetric(a: int, b: int, p: float, q: float) -> None:
    one, two = stored(block(a, p)), stored(block(b, q))
    there, back = result_change(one, two, NO_OBJECTS), result_change(two, one, NO_OBJECTS)
    for forth, reverse in zip(there.rows, back.rows, strict=True):
        assert forth.before == reverse.after or np.isnan(forth.before)
        assert forth.change == -reverse.change or np.isnan(forth.change)
    assert (there.higher_m2, there.lower_m2) == (back.lower_m2, back.higher_m2)
    assert there.certain_m2 == back.certain_m2


def test_nothing_changes_from_a_result_to_itself() -> None:
    one = stored(block(2), error=0.1)
    found = result_change(one, one, NO_OBJECTS)
    alone = "area reached in one result only"
    assert all(r.change == 0.0 for r in found.rows if r.quantity != alone)
    assert found.row("map", alone).before == 0.0 and found.differences == ()
    assert (found.higher_m2, found.lower_m2, found.certain_m2) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("error", "certain"), [(0.05, 24.0), (0.1, 0.0), (np.nan, 0.0)])
def test_a_change_within_the_sampling_error_is_not_certain(error: float, certain: float) -> None:
    # A share of 0.5 stands for 100 or 25 blocks, one of 0.1 for 4 or one that count for five of
    # them. NaN: cannot be estimated.
    found = result_change(
        stored(block(2), error=error), stored(block(2, 0.1), error=error), NO_OBJECTS
    )
    assert found.certain_m2 == certain
    assert found.beyond_sampling.startswith("No significant") is (certain == 0.0)


def test_zones_runouts_and_control_lines() -> None:
    box = shapely.box(0.0, 0.0, 10.0, 10.0)
    line = {"rocks": 20, "energy_kj_q95": 5.0, "speed_mps_q95": 3.0, "height_m_q95": 1.0}
    one = stored(
        block(2), zones=Coverage(np.array([box]), np.array([1])),
        manifest=with_runouts(50, 95, 99, 100), control_lines={"road": line},
    )  # fmt: skip
    two = stored(
        block(2), zones=Coverage(np.array([box, box]), np.array([1, 2])),
        manifest=with_runouts(57, 102, 106, 107), control_lines={"new": line},
    )  # fmt: skip
    found = result_change(one, two, NO_OBJECTS)
    assert [(r.name, r.before, r.after) for r in found.of("zones")] == [
        ("high", 0.0, 100.0),
        ("low", 100.0, 100.0),
    ]
    assert [r.change for r in found.of("run-out")] == [0.0, 7.0, 7.0, 7.0, 7.0]
    assert found.row("run-out", "run-out, 95 % quantile").before == 95.0
    share = found.row("control line", "share of blocks that arrive", "road")
    assert share.before == 0.2 and np.isnan(share.after)
    assert found.row("control line", "energy (95 % quantile)", "new").after == 5.0


def test_objects_have_the_largest_values_and_the_risk() -> None:
    one, two = stored(block(2)), stored(block(3, 0.25))
    two = replace(two, risk={"house": {"deaths_per_year": 1e-4, "loss_per_year": 3.0}})
    cells = np.array([8 + 2, 8 + 4, 0])
    found = result_change(one, two, (("road", "house"), cells, np.array([0, 0, 1])))
    reach = found.row("object", "reach probability, largest of the cells", "road")
    assert (reach.before, reach.after) == (0.5, 0.25)
    level = found.row("object", "hazard level", "road")
    assert (level.before, level.after) == (2.0, 1.0)
    nowhere = found.row("object", "reach probability, largest of the cells", "house")
    assert (nowhere.before, nowhere.after) == (0.0, 0.0)
    deaths = found.row("object", "deaths", "house")
    assert np.isnan(deaths.before) and deaths.after == 1e-4 and deaths.unit == "1/year"
    wanted = "road: energy (95 % quantile), largest of the cells 500 kJ before, 250 kJ after"
    assert found.lines()[-2].startswith(wanted)
    assert found.reached == (("road",), ("road",))  # in different cells


# --- levels that cannot be compared ---------------------------------------------------------


def test_levels_of_other_presets_and_widths_are_not_compared() -> None:
    one = stored(block(2))
    maps = dict(one.maps)
    level = one.band("hazard_level", "level")
    maps["hazard_level"] = layer("hazard_level", LEVELS[:1], level=level)
    wide = replace(one, manifest=manifest(ref_widths_m={"hazard": 5.0}))
    without = replace(one, maps={k: v for k, v in one.maps.items() if k != "hazard_level"})
    for other, words in (
        (replace(one, maps=maps), "different levels"),
        (wide, "10 m and 5 m"),
        (without, "one of the results has none"),
    ):
        assert words in levels_differ(one, other)
        found = result_change(one, other, NO_OBJECTS)
        assert np.isnan(found.higher_m2) and words in found.notes[0]
    assert result_change(without, without, NO_OBJECTS).notes == ()


def named(labels: tuple[str, str], codes: tuple[str, ...] = (), preset: str = "a") -> StoredResult:
    one = stored(block(2), level_codes=codes, manifest=manifest(preset=preset))
    classes = tuple(replace(c, label=text) for c, text in zip(LEVELS, labels, strict=True))
    level = layer("hazard_level", classes, level=one.band("hazard_level", "level"))
    return replace(one, maps={**one.maps, "hazard_level": level})


ENGLISH, GERMAN = ("low", "high"), ("gering", "hoch")


@pytest.mark.parametrize(
    ("other", "same"),
    [
        (named(GERMAN, ("slight", "substantial")), True),
        (named(GERMAN, ("slight", "substantial"), "b"), True),
        (named(GERMAN, ("slight", "mean")), False),
        # Of a level without a zone the code is not known.
        (named(GERMAN, ("slight", "hoch")), True),
        (named(GERMAN, ("slight", "hoch"), "b"), False),
        (named(ENGLISH, ("slight", "high"), "b"), True),
        (named(GERMAN), True),
        (named(GERMAN, preset="b"), False),
    ],
)
def test_levels_are_compared_in_whatever_language(other: StoredResult, same: bool) -> None:
    one = named(ENGLISH, ("slight", "substantial"))
    assert (not levels_differ(one, other), not levels_differ(other, one)) == (same, same)
    assert np.isfinite(result_change(one, other, NO_OBJECTS).higher_m2) == same


# --- manifests ------------------------------------------------------------------------------


def test_settings_inputs_and_versions_that_differ() -> None:
    # Inputs count by content, not by where they lie.
    moved = {"terrain": {"dem": "/there/dem.tif"}, "blocks": [{"name": "big", "n": 2}]}
    other = [{"role": "dem", "path": "new.tif", "sha256": "b" * 64}]
    changed = manifest(settings=moved, inputs=other, seed=2, versions={"numpy": "3"})
    one = stored(block(2))
    found = result_change(one, replace(one, manifest=changed), NO_OBJECTS)
    assert [tuple(difference) for difference in found.differences] == [
        ("seed", "seed", "1", "2"),
        ("setting", "blocks.big.n", "1", "2"),
        ("input", "dem", "dem.tif (aaaaaaaa)", "new.tif (bbbbbbbb)"),
        ("library", "numpy", "2", "3"),
    ]


# --- cells ----------------------------------------------------------------------------------


def shifted(result: StoredResult, **place: Any) -> StoredResult:
    return replace(result, grid=replace(result.grid, **place))


def test_results_meet_on_their_common_cells() -> None:
    """Two columns further east and one row further south; the values move along."""
    reach = np.arange(48.0).reshape(SHAPE) / 100.0
    box = shapely.box(100.0, 188.0, 116.0, 200.0)
    one = stored(reach, zones=Coverage(np.array([box]), np.array([1])))
    two = shifted(one, west=104.0, north=198.0)
    a, b = on_common_cells(one, two)
    assert a.grid.shape == b.grid.shape == (5, 6)
    assert a.grid.bounds == b.grid.bounds == (104.0, 188.0, 116.0, 198.0)
    assert np.allclose(a.band("reach_probability", "reach"), reach[1:, 2:])
    assert np.allclose(b.band("reach_probability", "reach"), reach[:-1, :-2])
    assert a.zones is not None and a.zones.polygons[0].area == 120.0


def test_objects_that_reach_beyond_the_common_part_are_left_out() -> None:
    grid = stored(block(2)).grid
    line = [ExposedObject(f"road {i}", "line", parent="road") for i in range(2)]
    placed = PlacedObjects(
        (*line, ExposedObject("house", "building"), ExposedObject("barn", "building")),
        (
            shapely.LineString([(101.0, 190.0), (110.0, 190.0)]),
            shapely.LineString([(110.0, 190.0), (117.0, 190.0)]),
            shapely.box(100.0, 188.0, 102.0, 190.0),
            shapely.box(90.0, 190.0, 95.0, 195.0),
        ),
    )
    assert [o.name for o in objects_within(placed, grid).objects] == ["house"]
    assert len(objects_within(PlacedObjects((), ()), grid)) == 0


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ({"west": 101.0}, "borders of the cells.*0.5 and 0 of a cell"),
        ({"cell_size": 1.0}, "cell size.*found 1 m.*expected 2 m"),
        ({"west": 500.0}, "differ in the place"),
        ({"crs": pyproj.CRS("EPSG:2056").to_wkt()}, "coordinate system.*LV95.*local coordinates"),
    ],
)
def test_cells_that_do_not_coincide_are_refused(place: dict[str, Any], words: str) -> None:
    one = stored(block(2))
    with pytest.raises(InputError, match=words):
        on_common_cells(one, shifted(one, **place))
