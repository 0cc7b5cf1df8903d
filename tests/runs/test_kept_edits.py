"""Edits by hand through a run: kept, drawn, told where the computed level has changed, refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import geopandas as gpd
import pytest
import shapely
from helpers.zone_slope import Case, box, two_areas

EDIT = {
    "level": "mean", "limit": None, "author": "A. Expert", "date": "2026-05-04",
    "reason": "wall of 2019 not in the model",
}  # fmt: skip
Call = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return two_areas(tmp_path_factory.mktemp("edits"), hazard={"ref_width_m": 4.0})


def write(case: Case, name: str, shape: shapely.Polygon, **changed: object) -> Path:
    columns = {key: [value] for key, value in (EDIT | changed).items() if value != "left out"}
    case.write_layer(name, [shape], columns)
    return case.folder / name


def test_an_edit_is_kept_through_new_runs(case: Case, printed) -> None:
    # Over the release area and beside it, where no block comes.
    own = box(2.0, 18.0, 12.0, 12.0)
    edits, out = write(case, "edits.gpkg", own), case.folder / "out"
    said = printed("zone", case.config, "-o", out, "--edits", edits, "--json")
    assert json.loads(said)["edits"] == 1 and json.loads(said)["edits_with_another_level"] == 0
    zones = gpd.read_file(out / "hazard.gpkg", layer="hazard_zones")
    edited = zones[zones["edited"] != ""]
    assert set(edited["hazard_level"]) == {"mean"}
    # A vertex of the outline beside it may lie within a decimetre of its edge.
    assert edited.union_all().symmetric_difference(own).area < 0.1
    assert set(edited["edited"]) == {"A. Expert, 2026-05-04: wall of 2019 not in the model"}
    federal = gpd.read_file(out / "hazard.gpkg", layer="hazard_area")
    inside = federal[federal.representative_point().within(own)]
    assert set(inside["hazard_level"]) == {"mean"}
    kept = gpd.read_file(out / "edits.gpkg", layer="edits")
    assert kept["level"].tolist() == ["mean"] and " %" in kept["computed"][0]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "wall of 2019 not in the model" in page and "area as computed" in page
    shapes = (out / "map.html").read_text(encoding="utf-8")
    assert '"kind": "edit", "name": "A. Expert, 2026-05-04: wall of 2019' in shapes

    # The layer of the result is the input of the next run; other blocks give another level there.
    case.blocks[0]["onset_frequency"], case.blocks[1]["onset_frequency"] = 1e-5, 1e-5
    case.write()
    said = printed("zone", case.config, "-o", case.folder / "again", "--edits", out / "edits.gpkg")
    assert "Edited by hand: 1 place; at 1 of them the computed level has changed" in said
    again = gpd.read_file(case.folder / "again" / "edits.gpkg", layer="edits")
    assert again["computed"][0] == kept["computed"][0] != again["computed_now"][0]
    assert again["changed_share"][0] > 0.05
    zones = gpd.read_file(case.folder / "again" / "hazard.gpkg", layer="hazard_zones")
    assert zones[zones["edited"] != ""].union_all().symmetric_difference(own).area < 0.01


def test_an_empty_layer_is_no_edit(case: Case, printed) -> None:
    empty = gpd.GeoDataFrame({key: [] for key in EDIT}, geometry=[], crs="EPSG:2056")
    empty.to_file(case.folder / "none.gpkg", driver="GPKG")
    case.set("edits.file", "none.gpkg")
    assert "edits by hand" not in printed("validate", case.config)
    case.set("edits.file", None)


@pytest.mark.parametrize(
    ("shape", "changed", "words"),
    [
        (box(-40.0, 5.0, 10.0, 10.0), {}, ["edits.gpkg", "feature 1"]),
        (box(80.0, 5.0, 30.0, 10.0), {}, ["edits.gpkg", "feature 1"]),
        (box(5.0, 5.0, 9.0, 9.0), {"level": "red"}, ["level", "'red'", "substantial"]),
        (box(5.0, 5.0, 9.0, 9.0), {"level": None}, ["level", "no value"]),
        (box(5.0, 5.0, 9.0, 9.0), {"limit": "about"}, ["limit", "'about'", "at_least"]),
        (box(5.0, 5.0, 9.0, 9.0), {"date": "in May"}, ["date", "'in May'", "2026-01-31"]),
        (box(5.0, 5.0, 9.0, 9.0), {"author": None}, ["author", "who made the edit"]),
        (box(5.0, 5.0, 9.0, 9.0), {"reason": "left out"}, ["reason"]),
    ],
)
def test_edits_that_cannot_be_used(
    case: Case, refusal, shape: shapely.Polygon, changed: dict[str, object], words: list[str]
) -> None:
    edits = write(case, "bad_edits.gpkg", shape, **changed)
    line = refusal("zone", case.config, "-o", case.folder / "bad", "--edits", edits)
    assert all(word in line.replace("bad_edits", "edits") for word in words), line
    assert not (case.folder / "bad").exists()


def test_only_a_drawn_perimeter_is_declared_as_assessed(case: Case, printed, refusal) -> None:
    drawn = box(-5.0, 20.0, 15.0, 12.0)
    case.write_layer("perimeter.gpkg", [drawn], {})
    for file, state in ((None, "to_be_clarified"), ("perimeter.gpkg", "complete")):
        case.set("hazard.assessed", file)
        out = case.folder / state
        printed("zone", case.config, "-o", out)
        area = gpd.read_file(out / "hazard.gpkg", layer="assessment_area")
        assert set(area["rf_state_rock_fall"]) == {f"assessed_and_{state}"}
    known = gpd.read_file(case.folder / "to_be_clarified" / "hazard.gpkg", layer="assessment_area")
    expected = known.union_all().intersection(drawn)
    printed("zone", case.config, "-o", case.folder / "some", "--area", "north")
    some = gpd.read_file(case.folder / "some" / "hazard.gpkg", layer="assessment_area")
    assert set(some["rf_state_rock_fall"]) == {"assessed_and_not_complete"}
    assert 0.0 < expected.area < drawn.area
    assert area.union_all().symmetric_difference(expected).area < 1e-3
    case.write_layer("perimeter.gpkg", [box(500.0, 5.0, 510.0, 10.0)], {})
    line = refusal("zone", case.config, "-o", case.folder / "far")
    assert "perimeter.gpkg: hazard.assessed" in line, line
    case.set("hazard.assessed", None)
