"""A whole run of the sample valley, opened in the real QGIS."""

from __future__ import annotations

import json
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely
from matplotlib.colors import to_rgb

from sassgis.model.styles import RASTER_OPACITY
from sassgis.runs.run import RunResult, run

SYSTEM_PYTHON = Path("/usr/bin/python3")
PROBE = Path(__file__).with_name("probe.py")
pytestmark = pytest.mark.qgis


def ask(project: Path, picture: Path, *more: str) -> dict[str, Any]:
    done = subprocess.run(
        [str(SYSTEM_PYTHON), str(PROBE), str(project), str(picture), *more],
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
        env={"QT_QPA_PLATFORM": "offscreen", "HOME": str(picture.parent), "LC_ALL": "C.UTF-8"},
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def valley(qgis: None, repository: Path, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    folder = tmp_path_factory.mktemp("valley")
    inputs = folder / "inputs"
    shutil.copytree(repository / "sample_dem" / "valley", inputs)
    config = inputs / "config.toml"
    text = config.read_text(encoding="utf-8")
    for old, new in (
        ("spacing_m = 3.0", "spacing_m = 6.0"),
        ("rocks_per_point = 50", "rocks_per_point = 10"),
    ):
        assert old in text
        text = text.replace(old, new)
    config.write_text(text, encoding="utf-8")
    return run(config, folder / "result")


@pytest.fixture(scope="module")
def cells(valley: RunResult) -> dict[str, tuple[float, float, float]]:
    """Places on the map of energy by class, away from lines and areas: x, y, value (kJ)."""
    with rasterio.open(valley.folder / "maps" / "energy.tif") as source:
        values = source.read(1, masked=True).filled(np.nan)
        transform = source.transform
    lines = [shapely.LineString(course) for _, course in valley.run.control_lines]
    over = shapely.union_all([*lines, *(a.geometry for a in valley.run.areas)]).buffer(25.0)
    out = {}
    for name, low, high in (("low", 0.0, 30.0), ("mean", 30.0, 300.0), ("high", 300.0, np.inf)):
        rows, cols = np.nonzero((values >= max(low, 1e-6)) & (values < high))
        x, y = rasterio.transform.xy(transform, rows, cols)
        free = ~shapely.intersects_xy(over, x, y)
        assert free.any(), f"no cell of the class {name}"
        i = np.flatnonzero(free)[0]
        out[name] = (float(x[i]), float(y[i]), float(values[rows[i], cols[i]]))
    return out


@pytest.fixture(scope="module")
def seen(
    valley: RunResult, cells: dict[str, tuple[float, float, float]], tmp_path_factory: Any
) -> dict[str, Any]:
    places = [w for x, y, _ in cells.values() for w in ("--at", f"{x},{y}")]
    picture = tmp_path_factory.mktemp("picture") / "map.png"
    report = ask(valley.folder / "project.qgz", picture, *places)
    report["colour"] = {
        name: tuple(bytes.fromhex(colour[1:]))
        for name, colour in zip(cells, report["at"].values(), strict=True)
    }
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
    assert vectors["Stopping points"] == valley.rocks
    assert vectors["Stations"] == 2 and vectors["Walls and nets"] == 2
    # What is drawn first lies in the view that opens.
    west, south, east, north = seen["extent"]
    for area in valley.run.areas:
        x, y = area.geometry.centroid.coords[0]
        assert west < x < east and south < y < north


def test_the_legend_is_in_order(seen: dict[str, Any]) -> None:
    assert [g["group"] for g in seen["tree"]] == [
        "Stations and measures",
        "Release and fall lines",
        "Exposed objects",
        "Footprint",
        "Maps",
        "Terrain",
    ]
    maps = next(g for g in seen["tree"] if g["group"] == "Maps")
    assert maps["exclusive"] is True
    shown = [entry["layer"] for entry in maps["layers"] if entry["visible"]]
    assert shown == ["Kinetic energy, 95 % quantile (kJ)"]


def test_maps_have_classes_that_can_occur(seen: dict[str, Any]) -> None:
    energy = layer(seen, "Kinetic energy")["renderer"]
    assert [i["label"] for i in energy["items"]] == ["0 – 30 kJ", "30 – 300 kJ", "≥ 300 kJ"]
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
    assert barriers["labels"] == "name"
    assert barriers["aliases"]["energy_kj_q95"] == "kinetic energy, 95 % (kJ)"
    assert [c["label"] for c in barriers["renderer"]["classes"]] == ["wall", "net"]
    assert layer(seen, "Stations")["labels"] == "name"
    assert layer(seen, "Release areas")["labels"] == "name"
    assert layer(seen, "Buildings and people")["labels"] == "name"
    ends = [c["value"] for c in layer(seen, "Stopping points")["renderer"]["classes"]]
    assert "rest" in ends and "barrier" in ends


def test_the_picture_has_the_colours_of_the_legend(
    seen: dict[str, Any], cells: dict[str, tuple[float, float, float]]
) -> None:
    items = layer(seen, "Kinetic energy")["renderer"]["items"]
    for (name, (_, _, value)), item in zip(cells.items(), items, strict=True):
        wanted = 255.0 * np.array(to_rgb(item["colour"]))
        gap = np.abs(wanted - np.array(seen["colour"][name]))
        assert gap.max() <= 255.0 * (1.0 - RASTER_OPACITY) + 2.0, f"{name}, {value:g} kJ"
    assert seen["blank_share"] < 0.05
