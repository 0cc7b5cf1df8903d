"""Tables and layers of risk keep every digit, and say what their columns mean."""

from __future__ import annotations

import csv
import math
from dataclasses import replace

import geopandas as gpd
import pytest
from helpers.worked_example import COUNTS, ENERGIES, HOUSE, ROAD, SOURCES, counts, vulnerability
from shapely import LineString, Point, box

from sassgis.hazard.risk import ADDITIVE, assess_risk, object_rows, source_rows, total_rows
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.layers.risk_objects import risk_frames, risk_vectors
from sassgis.settings.exposure import ExposedObject, PlacedObjects
from sassgis.settings.hazard_rules import SourceCounts

PLAYGROUND = ExposedObject("playground", "people", persons=10.0, presence=0.1)
PLACED = PlacedObjects(
    (HOUSE, ROAD, PLAYGROUND), (box(0, 0, 10, 10), LineString([(0, -20), (50, -20)]), Point(5, 30))
)


@pytest.fixture(scope="module")
def table():
    third = counts([0, 1, 2], [[20, 8, 2], [40, 10, 0], [7, 3, 1]])
    return assess_risk(
        PLACED.objects, SOURCES, (third, COUNTS[1]), ENERGIES, ENERGIES, vulnerability()
    )


def test_tables_without_hits_have_their_columns(table):
    none = [SourceCounts.none(3)] * 2
    empty = assess_risk(PLACED.objects, SOURCES, none, ENERGIES, ENERGIES, vulnerability())
    frames = risk_frames(empty, "CHF")
    assert len(frames["risk_sources"]) == 0
    filled = risk_frames(table, "CHF")
    rows = (object_rows(table), source_rows(table), total_rows(table))
    for name, own in zip(("risk_objects", "risk_sources", "risk_total"), rows, strict=True):
        assert list(filled[name].columns) == list(frames[name].columns) == [*own[0], "currency"]


def test_written_totals_are_the_sums_of_written_rows(table, tmp_path):
    read = {}
    for name, frame in risk_frames(table, "EUR").items():
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
        with (tmp_path / f"{name}.csv").open() as lines:
            read[name] = list(csv.DictReader(lines))
    total = {(row["scope"], row["name"]): row for row in read["risk_total"]}
    for q in ADDITIVE:
        column = f"{q}_per_year"
        everything = math.fsum(float(row[column]) for row in read["risk_objects"])
        assert float(total["all", "all objects"][column]) == everything
        for source in SOURCES:
            own = [r for r in read["risk_sources"] if r["scenario"] == source.scenario]
            added = math.fsum(float(row[column]) for row in own)
            assert float(total["source", source.label][column]) == added
    assert {row["currency"] for row in read["risk_objects"]} == {"EUR"}


def test_layers_of_the_geopackage(table, tmp_path):
    layers = risk_vectors(table, PLACED, "", "CHF")
    assert [v.name for v in layers] == ["risk_objects", "risk_lines", "risk_points"]
    path = write_geopackage(tmp_path / "r.gpkg", layers)
    for vector, k in zip(layers, (0, 1, 2), strict=True):
        back = gpd.read_file(path, layer=vector.name)
        assert len(back) == 1
        assert back["name"][0] == PLACED.objects[k].name
        assert back["loss_per_year"][0] == table.of_object("loss")[k]
        assert back["deaths_per_year_se"][0] == table.standard_error("deaths")[k]
        assert back["hits_mean_per_year"][0] == pytest.approx(table.hits[:, k, 1].sum())
        assert set(vector.fields) == set(vector.columns) - {"fid"}
        assert vector.fields["loss_per_year"].label == "loss (CHF/year)"


def shown(layer, value):
    """Label of the class of a value."""
    (entry,) = [c for c in layer.style.classes if c.lower <= value < c.upper]
    return entry.label


def test_colours_by_risk_and_none_apart(table):
    houses, roads, people = risk_vectors(table, PLACED, "", "CHF")
    assert houses.style.column == people.style.column == "individual_risk_per_year"
    assert roads.style.column == "deaths_per_year"
    assert shown(houses, 0.0) == "none"
    assert shown(houses, 1e-9) == "below 1e-6 per year"
    assert shown(houses, 1e-5) == "1e-5 to 1e-4 per year"
    assert shown(houses, 1.77e-4) == "1e-4 to 1e-3 per year"
    assert shown(houses, 0.5) == "1e-3 per year and more"
    assert len({c.symbol.colour for c in houses.style.classes}) == len(houses.style.classes)


def test_without_people_the_loss_is_shown():
    pipe = replace(ROAD, name="pipe", parent="", kind="line", traffic=None)
    placed = PlacedObjects((pipe,), (LineString([(0, 0), (9, 0)]),))
    own = assess_risk(
        (pipe,), SOURCES[:1], [counts([0], [[40, 10, 4]])], ENERGIES, ENERGIES, vulnerability()
    )
    (layer,) = risk_vectors(own, placed, "", "CHF")
    assert layer.style.column == "loss_per_year"
    assert shown(layer, 30.0) == "10 to 100 CHF/year"


def test_other_places_than_those_of_the_table_are_refused(table):
    with pytest.raises(ValueError, match="not those of the objects"):
        risk_vectors(table, PlacedObjects((HOUSE,), (box(0, 0, 1, 1),)), "", "CHF")
