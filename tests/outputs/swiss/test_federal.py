"""Layers have the attributes, codes and limits of the federal model, and refuse what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from helpers import made_zones as made
from helpers.made_up_result import preset
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import LineString, Polygon, box

from sassgis.errors import InputError
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.swiss import federal_model
from sassgis.settings.hazard_rules import HazardLevel, Provenance

LV95: dict[str, Any] = {"crs": "EPSG:2056", "federal": True, "canton": "TI"}
ZONE = box(made.E, made.N, made.E + 100, made.N + 100)
INSIDE = (2_600_000.0, 1_100_000.0, 2_601_000.0, 1_101_000.0)

#: As the text of the model lists them; typed anew, not taken from the module.
BASIC = ["data_responsibility", "comments"]
INTENSITY = [
    *BASIC, "intensity_class", "process_cantonal_term", "return_period_in_years", "extreme_scenario"
]  # fmt: skip
COLUMNS = {
    "assessment_area": [
        "data_responsibility", "fl_state_flooding", "df_state_debris_flow",
        "be_state_bank_erosion", "pl_state_permanent_landslide", "sl_state_spontaneous_landslide",
        "hd_state_hillslope_debris_flow", "rf_state_rock_fall", "rs_state_rock_slide_rock_aval",
        "if_state_ice_fall", "sh_state_sinkhole", "su_state_subsidence",
        "fa_state_flowing_avalanche", "pa_state_powder_avalanche", "gs_state_gliding_snow",
        "comments",
    ],
    "synoptic_intensity": [
        *INTENSITY, "subproc_synoptic_intensity", "sources_in_subprocesses_compl"
    ],
    "intensity_by_source": [
        *INTENSITY, "process_source", "subproc_intensity_by_source", "subscenario_probability",
        "scenario_description",
    ],
    "hazard_area": [
        *BASIC, "main_process", "hazard_level", "subprocesses_complete", "sources_complete"
    ],
    "indicative_hazard_area": [
        *BASIC, "indicative_process", "hazard_indication", "method", "hazard_area_existing"
    ],
}  # fmt: skip


def test_columns_are_those_of_the_model() -> None:
    layers = {layer.name: layer for layer in made.some_layers()}
    assert list(layers) == list(federal_model.FEDERAL_CLASSES)
    for name, columns in COLUMNS.items():
        assert layers[name].columns == ["fid", *columns]
    assert all(set(layer.fields) == set(layer.columns) - {"fid"} for layer in layers.values())
    assert all("166.1" in layer.description for layer in layers.values())


def test_values_and_types_survive_the_geopackage(tmp_path: Path) -> None:
    path = write_geopackage(tmp_path / "hazard.gpkg", made.some_layers())
    types = pyogrio.read_info(path, layer="synoptic_intensity")
    kinds = dict(zip(types["fields"], types["dtypes"], strict=True))
    assert kinds["return_period_in_years"] == "int32"
    assert kinds["extreme_scenario"] == "bool"
    frame = pyogrio.read_dataframe(path, layer="synoptic_intensity")
    # The rarest comes first, so that it is drawn under the others.
    assert frame["extreme_scenario"].tolist() == [True, True, False, False, False]
    assert frame["return_period_in_years"].tolist()[2:] == [300, 300, 30]
    assert frame["return_period_in_years"].isna().tolist()[:2] == [True, True]
    assert set(frame["subproc_synoptic_intensity"]) == {"r_rock_fall"}
    states = pyogrio.read_dataframe(path, layer="assessment_area", read_geometry=False)
    others = [c for c in states if "_state_" in c and c != "rf_state_rock_fall"]
    assert others and set(states.loc[0, others]) == {"not_assessed"}
    assert states.loc[0, "rf_state_rock_fall"] == "assessed_and_to_be_clarified"


def test_parts_become_features_of_their_own_on_whole_millimetres() -> None:
    frame = levels([made.PARTS, ZONE], ["slight", "mean"]).frame
    assert frame["hazard_level"].tolist() == ["slight", "slight", "mean"]
    assert set(frame.geom_type) == {"Polygon"}
    corners = shapely.get_coordinates(frame.geometry.to_numpy())
    assert np.array_equal(corners, np.round(corners, 3))
    assert {made.N + 50.0} <= set(corners[:, 1])


def test_neighbours_stay_without_gaps_and_overlaps_on_the_millimetre_grid() -> None:
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0))
    x, y = x + rng.uniform(-0.3, 0.3, x.shape), y + rng.uniform(-0.3, 0.3, x.shape)
    cells = [
        Polygon(
            [
                (made.E + x[i, j], made.N + y[i, j])
                for i, j in ((r, c), (r, c + 1), (r + 1, c + 1), (r + 1, c))
            ]
        )
        for r in range(5)
        for c in range(5)
    ]
    assert shapely.coverage_is_valid(cells)
    frame = levels(cells, ["mean"] * 25).frame
    assert len(frame) == 25
    assert shapely.coverage_is_valid(frame.geometry.to_numpy())


def test_what_vanishes_on_the_grid_is_left_out_and_what_folds_is_mended() -> None:
    sliver = box(made.E, made.N, made.E + 50, made.N + 0.0003)
    assert federal_model.surface_parts(sliver, where="a") == []
    # Its neck is narrower than the grid: rounding would make it touch itself.
    neck = made.at(
        (0, 0), (10, 0), (10, 10), (5.0002, 10), (5.0002, 5), (4.9998, 5), (4.9998, 10), (0, 10)
    )
    parts = federal_model.surface_parts(neck, where="a")
    assert parts and all(part.is_valid for part in parts)
    (part,) = federal_model.surface_parts(shapely.force_3d(ZONE, 700.0), where="a")
    assert not part.has_z
    assert sum(part.area for part in parts) == pytest.approx(neck.area, abs=0.02)


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        (LineString([(made.E, made.N), (made.E + 1, made.N)]), "LineString"),
        (None, "nothing"),
        (made.at((0, 0), (10, 10), (10, 0), (0, 10)), "not valid"),
        (Polygon([(made.E, made.N), (np.inf, made.N), (made.E, made.N + 1)]), "no number"),
        (box(2_459_999.0, made.N, made.E, made.N + 1), "outside the extent"),
        (box(made.E, made.N, made.E + 1, 1_310_000.1), "outside the extent"),
    ],
)
def test_unusable_geometry_is_refused(geometry: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        levels([geometry], ["mean"])


def intensity(years: float | None, extreme: Any = False, code: str = "low", **more: Any) -> Any:
    _, values = made.intensity_row(ZONE, years, extreme, code)
    return made.layer("synoptic_intensity", [(ZONE, {**values, **more})], **LV95)


def levels(polygons: list[Any], codes: list[Any], **values: Any) -> Any:
    return made.layer("hazard_area", made.level_rows(polygons, codes, **values), **LV95)


def of_source(*given: Any) -> Any:
    return made.layer("intensity_by_source", [made.source_row("a", ZONE, *given)], **LV95)


def indicated(**values: Any) -> Any:
    return made.layer("indicative_hazard_area", [(ZONE, values)], **LV95)


def assessed(canton: str = "TI", **values: Any) -> Any:
    return made.layer("assessment_area", [(ZONE, values)], **{**LV95, "canton": canton})


NOT_IN_THE_MODEL = [
    *((lambda y=y: intensity(y), r"return_period_in_years.*1 to 10000")
      for y in (0, -3, 0.5, 30.5, 10_001, np.inf, "30", True)),
    *((lambda y=y: intensity(y), "unless the scenario is extreme") for y in (None, float("nan"))),
    (lambda: intensity(300, extreme=True), r"extreme_scenario.*too frequent.*300 years"),
    *((lambda c=c: intensity(30, code=c), r"intensity_class.*existing_impact")
      for c in ("Low", "", None, "strong", 3)),
    *((lambda c=c: levels([ZONE], [c]), r"hazard_area\.hazard_level.*residual_hazard")
      for c in ("Low", "", None, 3)),
    *((lambda y=y, e=e: intensity(y, e, "existing_impact"), r"in detail.*existing_impact")
      for y, e in ((300, False), (None, True))),
    (lambda: of_source(0.5), r"scenario_description.*missing"),
    (lambda: intensity(30, process_cantonal_term="x" * 51), r"51 characters.*at most 50"),
    (lambda: indicated(method="x" * 401), r"401 characters.*at most 400"),
    (lambda: of_source(0.5, "x" * 401), r"401 characters.*at most 400"),
    *((lambda p=p: of_source(p), r"subscenario_probability.*0 to 1") for p in (-0.01, 1.01, "0.5")),
    (lambda: assessed("XX"), "data_responsibility"),
    (lambda: assessed(rf_state_rock_fall="done"), "rf_state_rock_fall"),
    (lambda: levels([ZONE], ["mean"], sources_complete="yes"), "sources_complete"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "words"), NOT_IN_THE_MODEL)
def test_values_that_the_model_does_not_have(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


def test_values_that_the_model_has() -> None:
    for years in (1, 30, 30.0, 10_000):
        assert intensity(years).frame["return_period_in_years"].tolist() == [years]
    for years in (None, float("nan"), 301):
        assert intensity(years, extreme=True).frame["extreme_scenario"].tolist() == [True]
    for code in federal_model.CODES["hazard_level"]:
        assert levels([ZONE], [code]).frame["hazard_level"].tolist() == [code]
    for code in federal_model.CODES["intensity_class"]:
        assert intensity(301, code=code).frame["intensity_class"].tolist() == [code]
    assert of_source().frame["subscenario_probability"].tolist() == [1.0]
    term = "x" * 50
    assert intensity(30, process_cantonal_term=term).frame.loc[0, "process_cantonal_term"] == term
    assert len(federal_model.CODES["canton"]) == len(set(federal_model.CODES["canton"])) == 27


def test_federal_layers_need_federal_coordinates() -> None:
    for crs in ("EPSG:32632", None, ""):
        with pytest.raises(InputError, match="EPSG:2056"):
            made.layer("hazard_area", [], crs=crs, federal=True, canton=None)


def test_abroad_the_layers_are_the_same_but_claim_nothing() -> None:
    zone = box(680_000, 5_150_000, 680_100, 5_150_100)
    abroad: dict[str, Any] = {"crs": "EPSG:32632", "federal": False, "canton": None}
    layer = made.layer("hazard_area", made.level_rows([zone], ["H4"]), **abroad)
    assert layer.columns == ["fid", *COLUMNS["hazard_area"]]
    assert "166.1" not in layer.description and layer.frame.crs.to_epsg() == 32632
    assert all("166.1" not in info.description for info in layer.fields.values())
    assert "166.1" not in federal_model.federal_note(
        False
    ) and "166.1" in federal_model.federal_note(True)
    # What holds everywhere still holds.
    with pytest.raises(InputError, match="unless the scenario is extreme"):
        made.layer("synoptic_intensity", [made.intensity_row(zone, None)], **abroad)


def test_where_the_model_holds() -> None:
    lv95 = pyproj.CRS.from_epsg(2056)
    assert federal_model.in_federal_extent(lv95, INSIDE)
    assert federal_model.in_federal_extent(lv95.to_wkt("WKT1_ESRI"), INSIDE)
    assert federal_model.in_federal_extent("EPSG:2056+5728", INSIDE)
    assert not federal_model.in_federal_extent("EPSG:21781", INSIDE)
    assert not federal_model.in_federal_extent(
        "EPSG:21781", (600_000.0, 100_000.0, 601_000.0, 101_000.0)
    )
    assert not federal_model.in_federal_extent("", INSIDE) and not federal_model.in_federal_extent(
        None, INSIDE
    )
    assert federal_model.in_federal_extent(
        lv95, (2_460_000.0, 1_045_000.0, 2_870_000.0, 1_310_000.0)
    )
    assert not federal_model.in_federal_extent(lv95, (2_459_999.0, *INSIDE[1:]))
    assert not federal_model.in_federal_extent(lv95, (*INSIDE[:3], 1_310_001.0))
    assert not federal_model.in_federal_extent(lv95, (np.nan,) * 4)
    assert not federal_model.is_lv95("EPSG:4326")


@given(st.lists(st.text(alphabet="ab~2 ", min_size=1, max_size=14), max_size=12))
def test_short_names_differ(names: list[str]) -> None:
    names = [name for name in names if name.strip()]
    short = federal_model.unique_short_names(names, longest=6)
    plain = {" ".join(name.split()) for name in names}
    assert list(short) == list(dict.fromkeys(names))
    assert len(set(short.values())) == len(short)
    assert all(0 < len(text) <= 6 for text in short.values())
    if len(plain) == len(short):
        assert all(short[n] == n for n in short if len(n) <= 6 and n == " ".join(n.split()))


def test_long_texts_are_cut() -> None:
    short = federal_model.unique_short_names(["x" * 60 + e for e in "ab"])
    assert list(short.values()) == ["x" * 50, "x" * 48 + "~2"]
    with pytest.raises(InputError, match="no name"):
        federal_model.unique_short_names([" "])
    assert federal_model.shortened("a  b\nc", 5) == "a b c"
    assert federal_model.shortened("one two three", 10) == "one two…"
    assert len(federal_model.shortened("x" * 500)) == 400


def test_legend_has_the_colours_of_the_levels_and_a_hatch_for_residual() -> None:
    style = levels([], []).style
    assert {c.value for c in style.classes} == {level.code for level in preset().levels}
    hatched = {c.value: c.symbol.hatch for c in style.classes}
    assert hatched["residual_hazard"] == "diagonal" and hatched["mean"] == ""
    level_colours = {c.symbol.colour for c in style.classes} - {"#ffffff"}
    intensity_colours = {c.symbol.colour for c in intensity(30).style.classes}
    assert not level_colours & intensity_colours
    own = HazardLevel("residual_hazard", "pericolo residuo", "#abcdef", True, Provenance("x", True))
    (entry,) = made.layer("hazard_area", [], legend=[own], **LV95).style.classes
    assert (entry.label, entry.symbol.colour) == ("pericolo residuo", "#abcdef")
