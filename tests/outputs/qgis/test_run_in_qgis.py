"""A whole run of the sample valley, opened in the real QGIS."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.in_qgis import in_qgis
from matplotlib.colors import to_rgb

from sassgis.runs.run import RunResult, run

PROBE = Path(__file__).with_name("probe.py")
pytestmark = pytest.mark.qgis


@pytest.fixture(scope="module")
def valley(
    qgis: None, make_valley: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory
) -> RunResult:
    return run(make_valley(rocks_per_point=3), tmp_path_factory.mktemp("valley") / "result")


@pytest.fixture(scope="module")
def seen(valley: RunResult, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    picture = tmp_path_factory.mktemp("picture") / "map.png"
    out = in_qgis(PROBE, valley.folder / "project.qgz", picture, home=picture.parent)
    report: dict[str, Any] = json.loads(out)
    assert picture.stat().st_size > 10_000
    return report


def layer(report: dict[str, Any], start: str) -> dict[str, Any]:
    (found,) = [entry for entry in report["layers"] if entry["name"].startswith(start)]
    return found  # type: ignore[no-any-return]


def test_every_layer_opens_in_its_place(valley: RunResult, seen: dict[str, Any]) -> None:
    assert seen["opened"] and not seen["error"] and not seen["render_errors"]
    assert seen["title"] == "Sample valley"
    assert (seen["crs"], seen["crs_valid"], seen["absolute_paths"]) == ("EPSG:2056", True, False)
    assert all(entry["valid"] for entry in seen["layers"])
    assert {entry["crs"] for entry in seen["layers"]} == {"EPSG:2056"}
    vectors = {e["name"]: e["features"] for e in seen["layers"] if e["kind"] == "vector"}
    assert vectors["Release areas"] == len(valley.run.areas)
    assert vectors["Release points"] == len(valley.planned.points)
    assert vectors["Fall lines"] == len(valley.planned.points)
    assert vectors["Deposits"] == valley.n_blocks
    assert vectors["Stations"] == 2 and vectors["Walls and nets"] == 2
    # What is drawn first lies in the view that opens.
    west, south, east, north = seen["extent"]
    for area in valley.run.areas:
        x, y = area.geometry.centroid.coords[0]
        assert west < x < east and south < y < north


def test_maps_have_classes_that_can_occur(seen: dict[str, Any]) -> None:
    energy = layer(seen, "Kinetic energy")["renderer"]
    assert [i["label"] for i in energy["items"]] == [
        "0 – 30 kJ", "30 – 100 kJ", "100 – 300 kJ", "300 – 1000 kJ", "1000 – 3000 kJ", "≥ 3000 kJ"
    ]  # fmt: skip
    for entry in seen["layers"]:
        if entry["kind"] == "vector" or entry["renderer"]["type"] == "hillshade":
            continue
        items = entry["renderer"]["items"]
        assert entry["renderer"]["type"] == "singlebandpseudocolor"
        assert not any(item["label"].startswith("<") for item in items), entry["name"]
        light = [float(np.dot(to_rgb(i["colour"]), (0.3, 0.59, 0.11))) for i in items]
        # Darker means more, and the palest class can be told from the relief.
        assert all(a > b for a, b in pairwise(light)), entry["name"]
        red, green, blue = to_rgb(items[0]["colour"])
        assert max(red, green, blue) - min(red, green, blue) > 0.1, entry["name"]
    assert layer(seen, "Relief")["renderer"]["type"] == "hillshade"


def test_columns_and_signs_explain_themselves(seen: dict[str, Any]) -> None:
    for entry in seen["layers"]:
        if entry["kind"] == "vector":
            bare = [c for c, alias in entry["aliases"].items() if c != "fid" and not alias]
            assert not bare, f"{entry['name']}: {bare}"
    barriers = layer(seen, "Walls and nets")
    assert barriers["aliases"]["energy_kj_q95"] == "kinetic energy, 95 % (kJ)"
    assert [c["label"] for c in barriers["renderer"]["classes"]] == ["wall", "net"]
    for start in ("Walls and nets", "Stations", "Release areas", "Buildings and people"):
        assert layer(seen, start)["labels"] == "name"
    ends = [c["value"] for c in layer(seen, "Deposits")["renderer"]["classes"]]
    assert "rest" in ends and "barrier" in ends
