"""What lies in the files of a zoning: maps, GeoPackage, tables, export."""

from __future__ import annotations

import html
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from helpers.command_line import exit_code
from helpers.map_bands import read_band
from helpers.zone_slope import CELL, HOUSE, Case, box, gully, place, two_areas

LEVELS = ["residual_hazard", "slight", "mean", "substantial"]
INTENSITIES = ["low", "mean", "high"]
PERIODS = [30, 100, 300, None]


@dataclass(frozen=True)
class Result:
    """The folder of a zoning."""

    case: Case
    folder: Path

    def band(self, stem: str, name: str) -> np.ndarray:
        return read_band(self.folder, stem, name).filled(0)

    def layer(self, name: str) -> gpd.GeoDataFrame:
        return gpd.read_file(self.folder / "hazard.gpkg", layer=name)

    def table(self, name: str) -> pd.DataFrame:
        return pd.read_csv(self.folder / "tables" / f"{name}.csv")

    def intensity(self, years: int | None, layer: str = "synoptic_intensity") -> gpd.GeoDataFrame:
        zones = self.layer(layer)
        if years is None:
            return zones[zones["extreme_scenario"]]
        return zones[zones["return_period_in_years"] == years]

    @property
    def known(self) -> np.ndarray:
        with rasterio.open(self.case.folder / "dem.tif") as file:
            return ~file.read(1, masked=True).mask


def with_everything(folder: Path) -> Case:
    """Unknown terrain next to the run-out, a wall, a road and houses."""
    case = two_areas(folder, hazard={"ref_width_m": 6.0})
    heights = gully()
    heights[40:, 56:] = np.nan
    heights[33:36, 80:] = np.nan
    case.write_dem(heights)
    case.lists["barriers"] = [
        {"name": "wall", "kind": "wall", "height_m": 3.0,
         "line": [list(place(40.0, 20.0)), list(place(40.0, 34.0))]},
    ]  # fmt: skip
    houses = {"left": box(62.0, 33.0, 3.0, 4.0), "right": box(66.0, 30.0, 3.0, 6.0)}
    case.expose("houses", "building", houses, **HOUSE)
    road = shapely.LineString([place(60.0, 10.0), place(60.0, 38.0)])
    case.expose(
        "lane", "road", {"lane": road}, segment_m=20.0, value_per_m=500.0, traffic_per_day=400.0,
        speed_kmh=50.0, vehicle_length_m=4.5, persons_per_vehicle=1.5,
    )  # fmt: skip
    return case


def zoned(case: Case) -> Result:
    case.write()
    out = case.folder / "out"
    assert exit_code("zone", case.config, "-o", out, "--jobs", "1") == 0
    return Result(case, out)


@pytest.fixture(scope="module")
def rare(tmp_path_factory: pytest.TempPathFactory) -> Result:
    case = two_areas(
        tmp_path_factory.mktemp("rare"), hazard={"ref_width_m": 4.0},
        zones={"min_area_m2": 400.0, "closing_m": 12.0, "min_width_m": 10.0},
    )  # fmt: skip
    case.blocks[0]["onset_frequency"], case.blocks[1]["onset_frequency"] = 0.1, 0.004
    return zoned(case)


@pytest.fixture(scope="module")
def german(tmp_path_factory: pytest.TempPathFactory) -> Result:
    case = with_everything(tmp_path_factory.mktemp("german"))
    case.write_layer("perimeter.gpkg", [box(30.0, 0.0, 40.0, 50.0)])
    case.set("hazard.assessed", "perimeter.gpkg")
    case.sections["project"] = {
        "language": "de", "author": "A. Muster", "contact": "hier", "rights": "frei",
        "date": "2026-01-31",
    }  # fmt: skip
    return zoned(case)


@pytest.fixture(params=["rare", "german"])
def made(request: pytest.FixtureRequest) -> Result:
    found: Result = request.getfixturevalue(request.param)
    return found


def project_of(folder: Path) -> ElementTree.Element:
    """The project of QGIS."""
    with zipfile.ZipFile(folder / "project.qgz") as archive:
        return ElementTree.fromstring(archive.read("project.qgs"))


def test_the_answer_comes_first_and_names_the_objects(german: Result) -> None:
    page = html.unescape((german.folder / "report.html").read_text(encoding="utf-8"))
    summary = page[page.index('<section class="summary">') : page.index("</section>")]
    for words in ("Gefahrenzonen", "Reichweite", "Pauschalgefälle", "exponierten Objekt", "Risiko"):
        assert words in summary, words
    assert "A. Muster · 2026-01-31 · sassgis" in page
    exposed = page[page.index("Exponierte Objekte</caption>") :].split("</table>")[0]
    assert all(f"<td>{name}</td>" in exposed for name in ("left", "right", "lane"))
    alts = re.findall(r'alt="([^"]+)"', page)
    assert len(alts) > 8 and all(re.search(r"\d", alt) for alt in alts)


def test_sheets_show_every_return_period_and_what_lies_around(german: Result) -> None:
    project = project_of(german.folder)
    sheets = {s.get("name"): s for s in project.findall("Layouts/Layout")}
    assert list(sheets) == [
        "Gefahrenstufe", "Intensität 30 Jahre", "Intensität 100 Jahre", "Intensität 300 Jahre",
        "Intensität Extremereignis", "Risiko", "Energie", "Sprunghöhe", "Trefferwahrscheinlichkeit",
    ]  # fmt: skip
    for name, sheet in sheets.items():
        (shown,) = sheet.iter("LayerSet")
        keys = [layer.text for layer in shown]
        objects = "vector_risk_lines" if name == "Risiko" else "vector_exposed_lines"
        assert keys[:2] == ["vector_barriers", "vector_release_areas"] and objects in keys
        assert ("vector_assessment_area_complete" in keys) == name.startswith(("Gef", "Intens"))
        words = " ".join(option.get("value", "") for option in sheet.iter("Option"))
        said = ("A. Muster", "2026-01-31", "sassgis", "hier", "frei", "Blockszenarien", "Massstab")
        assert [text for text in said if text not in words] == [], name
        # Another seed changes levels; how zones are drawn is no matter of risk.
        assert ("Startwert" in words) == (name == "Gefahrenstufe")
        assert ("Zonen gezeichnet" in words) == name.startswith(("Gef", "Intens"))
    sources = {m.findtext("id"): m.findtext("datasource") for m in project.iter("maplayer")}
    for name, condition in (
        ("30 Jahre", '"return_period_in_years" = 30'), ("Extremereignis", '"extreme_scenario" = 1')
    ):  # fmt: skip
        keys = [layer.text for layer in sheets[f"Intensität {name}"].iter("Layer")]
        (zones,) = [sources[key] for key in keys if "intensity" in key]
        assert zones == f"./hazard.gpkg|layername=synoptic_intensity|subset={condition}"
    themes = {t.get("name") for t in project.iter("visibility-preset")}
    assert themes == set(sheets)
    groups = [g.get("name") for g in project.find("layer-tree-group").findall("layer-tree-group")]
    assert groups.index("Ausbruch und Falllinien") < groups.index("Gefahr")


def test_no_layer_of_the_project_is_empty(german: Result) -> None:
    project = project_of(german.folder)
    sources = [layer.findtext("datasource") for layer in project.iter("maplayer")]
    vectors = [s.split("|layername=") for s in sources if "|" in s and "|subset=" not in s]
    assert len(vectors) > 8
    # That of edits by hand is there to be drawn in.
    assert [n for f, n in vectors if not len(gpd.read_file(german.folder / f, layer=n))] == [
        "edits"
    ]


def test_zones_say_where_they_end_with_the_terrain_model(german: Result) -> None:
    zones, limits = (
        gpd.read_file(german.folder / "hazard.gpkg", layer=name)
        for name in ("hazard_zones", "open_limits")
    )
    length = np.zeros(len(zones))
    length[limits["zone"] - 1] = limits.length
    assert length.sum() > 0.0 and length == pytest.approx(zones["open_m"], abs=0.06)
    # Unknown terrain as in with_everything, and what lies around the grid.
    rows, cols = gully().shape
    known = box(0, 0, cols, rows) - box(56, 40, cols - 56, rows - 40) - box(80, 33, cols - 80, 3)
    for k, line in zip(limits["zone"], limits.geometry, strict=True):
        assert known.boundary.intersection(line).length == pytest.approx(line.length)
        # Whole sides of cells, also where the outline of the zone meets one between its ends.
        beside = zones.geometry[k - 1].buffer(0.1).intersection(line)
        assert beside.length > 0.9 * line.length
        assert zones.geometry[k - 1].buffer(2.0).covers(line)  # a cell


def test_values_at_objects_lie_within_their_intervals(german: Result) -> None:
    table = pd.read_csv(german.folder / "tables" / "risk_objects.csv")
    names = [name for name in table if f"{name}_high" in table]
    assert len(names) > 2
    for name in names:
        known = table[table[name].notna()]
        assert (known[f"{name}_low"] <= known[name]).all(), name
        assert not (known[f"{name}_high"] < known[name]).any(), name


ENGLISH = re.compile(r"\b(?:the|of|and|with|which|from|blocks?|are|is|height|zones|years?)\b")


def test_no_word_of_sheets_and_report_is_left_in_english(german: Result) -> None:
    page = html.unescape((german.folder / "report.html").read_text(encoding="utf-8"))
    seen = re.sub(r"<style>.*?</style>", "", page, flags=re.S)
    # Sources of values stay in the words of their publications.
    seen = re.sub(r"Bodenklassen</caption>.*?</table>", "", seen, flags=re.S)
    lines = [*re.sub(r"<[^>]+>", "\n", seen).splitlines(), *re.findall(r'alt="([^"]+)"', page)]
    assert [line.strip() for line in lines if ENGLISH.search(line)] == []
    project = project_of(german.folder)
    texts = [item.get("labelText", "").split("[%")[0] for item in project.iter("LayoutItem")]
    texts += [entry.get("label", "") for entry in project.iter("category")]
    texts += [entry.get("name", "") for entry in project.iter("layer-tree-group")]
    assert [text for text in texts if ENGLISH.search(text)] == []


def parts(zones: gpd.GeoDataFrame) -> np.ndarray:
    return shapely.get_parts(np.array(zones.geometry))


def test_zones_are_valid_coverages(made: Result) -> None:
    layers = [made.layer("hazard_zones"), made.layer("hazard_area")]
    layers += [made.intensity(years) for years in PERIODS]
    for area in ("north", "south"):
        by_period = [made.intensity(years, "intensity_by_source") for years in PERIODS]
        layers += [zones[zones["process_source"] == area] for zones in by_period]
        assert any(len(layer) for layer in layers[-len(PERIODS) :])
    assert sum(len(layer) > 0 for layer in layers) > 8
    for layer in layers:
        polygons = parts(layer)
        assert shapely.is_valid(polygons).all()
        assert (shapely.area(polygons) > 0.0).all()
        assert shapely.coverage_is_valid(polygons)
        assert shapely.union_all(polygons).area == pytest.approx(
            shapely.area(polygons).sum(), rel=1e-12
        )


def test_zones_stay_on_known_terrain(made: Result) -> None:
    known = made.known
    rows, cols = np.nonzero(~known)
    x, y = place(cols, rows)
    unknown = shapely.union_all(shapely.box(x, y - CELL, x + CELL, y))
    west, north = place(0, 0)
    east, south = place(known.shape[1], known.shape[0])
    terrain = shapely.box(west, south, east, north).difference(unknown)
    for name in ("hazard_zones", "synoptic_intensity", "indicative_hazard_area"):
        zones = shapely.union_all(parts(made.layer(name)))
        outside = zones.difference(terrain).area
        assert outside == pytest.approx(0.0, abs=1e-6), name
    assessed = shapely.union_all(parts(made.layer("assessment_area")))
    if (drawn := made.case.folder / "perimeter.gpkg").exists():
        terrain = terrain.intersection(shapely.union_all(parts(gpd.read_file(drawn))))
    assert assessed.symmetric_difference(terrain).area == pytest.approx(0.0, abs=1e-6)


def test_the_federal_model_is_cut_at_the_perimeter(german: Result) -> None:
    drawn = shapely.union_all(parts(gpd.read_file(german.case.folder / "perimeter.gpkg")))
    zones, cut = (
        shapely.union_all(parts(german.layer(n))) for n in ("hazard_zones", "hazard_area")
    )
    wanted = zones.intersection(drawn)
    assert 0.0 < wanted.area < zones.area
    # Coordinates are rounded to 1 mm.
    assert cut.symmetric_difference(wanted).area < 0.5
    for name in ("synoptic_intensity", "intensity_by_source"):
        beyond = shapely.union_all(parts(german.layer(name))).difference(drawn)
        assert beyond.area < 0.5, name
    indicated = german.layer("indicative_hazard_area")
    assert shapely.union_all(parts(indicated)).symmetric_difference(zones).area < 0.5
    existing = indicated[indicated["hazard_area_existing"].astype(bool)]
    assert shapely.union_all(parts(existing)).symmetric_difference(wanted).area < 0.5


def test_areas_in_tables_are_those_of_the_layers(made: Result) -> None:
    zones, table = made.layer("hazard_zones"), made.table("zones")
    assert len(zones) == len(table)
    assert np.allclose(table["area_m2"], zones.geometry.area, atol=0.06)
    assert np.allclose(zones["area_m2"], zones.geometry.area, atol=0.06)
    # Every zone once in the federal layer.
    federal = made.layer("hazard_area")
    for code in LEVELS:
        own = zones[zones["hazard_level"] == code].geometry.area.sum()
        same = federal[federal["hazard_level"] == code].geometry.area.sum()
        if made.case.sections["hazard"].get("assessed") != "perimeter.gpkg":
            assert own == pytest.approx(same, rel=1e-9)
    # Cells of zones: every reached cell lies in one of them.
    assert table["cells"].sum() == (made.band("hazard_level", "level") > 0).sum()
    report = html.unescape((made.folder / "report.html").read_text(encoding="utf-8"))
    text = re.sub("[,'’\u202f]", "", re.sub(r"<[^>]+>", " ", report))
    for code in LEVELS:
        area = zones[zones["hazard_level"] == code].geometry.area.sum()
        if area:
            assert re.search(rf"\b{round(area)}\b", text), (code, area)


def test_shares_of_sources_add_up(made: Result) -> None:
    shares = made.table("zone_sources")
    zones = made.table("zones")
    total = shares.groupby("zone")["share"].sum()
    assert np.allclose(total, 1.0, atol=1e-9)
    assert set(total.index) == set(zones.loc[zones["cells"] > 0, "zone"])
    largest = shares.loc[shares.groupby("zone")["share"].idxmax()].set_index("zone")
    governed = zones.set_index("zone").loc[largest.index]
    assert (governed["governing_area"] == largest["area"]).all()
    assert (governed["governing_scenario"] == largest["scenario"]).all()
    sources = made.table("sources")
    assert set(zip(sources["area"], sources["scenario"], strict=True)) == {
        (a, b["name"]) for a in ("north", "south") for b in made.case.blocks
    }
    one_rock = sources["onset_per_year"] / sources["rocks"]
    assert np.allclose(sources["per_year_of_one_rock"], one_rock, rtol=1e-5)


def test_what_the_wall_changes_adds_up(made: Result) -> None:
    if "barriers" not in made.case.lists:
        assert not (made.folder / "tables" / "level_changes.csv").exists()
        return
    table = made.table("level_changes").set_index("level_without")
    for layer, axis in (("hazard_zones", 0), ("hazard_zones_without", 1)):
        zones = made.layer(layer)
        for code, found in zip(LEVELS, table.sum(axis=axis).to_numpy()[1:], strict=True):
            wanted = zones[zones["hazard_level"] == code].geometry.area.sum()
            assert found == pytest.approx(wanted, abs=0.5), (layer, code)
    changes = made.layer("level_changes")
    order = {c: i for i, c in enumerate(["not_in_danger", *LEVELS])}
    lower = changes["level_after"].map(order) < changes["level_before"].map(order)
    assert (lower == (changes["change"] == "lower")).all() and lower.any()
    assert changes.geometry.area.sum() == pytest.approx(table.to_numpy().sum(), abs=2.0)


def test_export_in_switzerland(made: Result, tmp_path: Path, printed) -> None:
    out = printed("export", made.folder, "-o", tmp_path / "z.xtf", "--canton", "TI")
    text = (tmp_path / "z.xtf").read_text(encoding="utf-8")
    zones = 0
    for name in ("assessment_area", "synoptic_intensity", "intensity_by_source", "hazard_area"):
        assert f"{name} {len(made.layer(name))}" in out
        zones += len(made.layer(name))
    assert len(re.findall(r'<[^>]* TID="', text)) >= zones
