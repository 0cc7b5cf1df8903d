"""The page on a terrain model: a verdict for each defect that was put in."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import rasterio
from helpers.small_slope import NORTH, WEST
from rasterio.transform import Affine, from_origin
from shapely import box

from sassgis.runs.dem_check import check_dem


def hills() -> np.ndarray:
    row, col = np.indices((60, 80))
    waves = 3.0 * np.sin(row / 9.0) + 2.0 * np.cos(col / 7.0 + row / 15.0)
    rough = np.random.default_rng(2).normal(0.0, 0.03, row.shape)
    return 900.0 - 2.0 * np.tan(np.radians(35.0)) * col + waves + rough


def write(file: Path, values: np.ndarray, **options: Any) -> Path:
    unit = options.pop("unit", None)
    profile = {
        "crs": "EPSG:2056", "transform": from_origin(WEST, NORTH, 2.0, 2.0), "dtype": "float32",
        "nodata": -9999.0,
    } | options  # fmt: skip
    with rasterio.open(
        file, "w", driver="GTiff", count=1, height=values.shape[0], width=values.shape[1], **profile
    ) as raster:
        raster.write(values.astype(profile["dtype"]), 1)
        if unit:
            raster.units = [unit]
    return file


def verdicts(file: Path) -> dict[str, str]:
    return {f.item: f.verdict for f in check_dem(file).findings}


def put(change: Callable[[np.ndarray], None]) -> np.ndarray:
    values = hills()
    change(values)
    return values


def spikes(values: np.ndarray, height: float, count: int = 1) -> None:
    values[10 : 10 + 9 * count : 9, 40] += height


def hole(values: np.ndarray, stored: float) -> None:
    values[20:24, 30:33] = stored


def dam(values: np.ndarray) -> None:
    """A valley is dammed by 6 m: what lies behind has no outlet."""
    values[20:40, 30:60] -= 6.0


def mixed(number: float) -> np.ndarray:
    """A number in a corner, on cells that were moved by a part of a cell that differs by row."""
    values, (row, col) = hills(), np.indices((60, 80))
    values[col > 60 + 0.3 * row] = number
    part = 0.5 + 0.45 * np.sin(row / 5.0)
    return values * part + np.roll(values, 1, axis=1) * (1.0 - part)


DEGREES = from_origin(8.7, 46.5, 2.6e-5, 1.8e-5)
#: What is put in: heights, how they are stored, and the verdicts that are not "good".
DEFECTS: dict[str, tuple[np.ndarray, dict[str, Any], dict[str, str]]] = {
    "nothing": (hills(), {}, {}),
    "no system": (hills(), {"crs": None}, {"coordinate system": "bad"}),
    "degrees": (
        hills(), {"crs": "EPSG:4326", "transform": DEGREES}, {"coordinate system": "bad"},
    ),
    "wrong system": (
        hills(), {"transform": DEGREES}, {"coordinate system": "bad", "steepness": "bad"},
    ),
    "feet": (hills() / 0.3048, {"unit": "ft"}, {"units": "look"}),
    "unknown unit": (hills(), {"unit": "fathom"}, {"units": "bad"}),
    # Blocks from so steep a slope would leave it.
    "heights times three": (3.3 * hills(), {}, {"extent": "look"}),
    "nodata not declared": (put(lambda v: hole(v, -32768.0)), {}, {"nodata": "bad"}),
    "zeros": (put(lambda v: hole(v, 0.0)), {}, {"nodata": "bad"}),
    "zeros in a corner, resampled": (
        mixed(0.0), {}, {"nodata": "bad", "steepness": "bad", "extent": "look"},
    ),
    # Declared, but too late: what lies beyond the Earth is nodata.
    "-9999, resampled": (
        np.where(mixed(-9999.0) < -400.0, -9999.0, mixed(-9999.0)), {},
        {"nodata": "bad", "extent": "look"},
    ),
    "hole": (put(lambda v: hole(v, -9999.0)), {}, {"nodata": "look"}),
    "cells of 8 m": (
        4.0 * hills(), {"transform": from_origin(WEST, NORTH, 8.0, 8.0)}, {"resolution": "look"},
    ),
    "cells of 25 m": (
        12.0 * hills() - 9000.0, {"transform": from_origin(WEST, NORTH, 25.0, 25.0)},
        {"resolution": "bad"},
    ),
    "rotated": (
        hills(), {"transform": Affine(1.9, 0.6, WEST, 0.6, -1.9, NORTH)}, {"resolution": "look"},
    ),
    "too flat": (0.2 * hills() + 700.0, {}, {"steepness": "look"}),
    "integers": (np.rint(hills()), {"dtype": "int16", "nodata": -9999}, {"terraces": "bad"}),
    "decimetres": (np.rint(10.0 * hills()) / 10.0, {}, {"terraces": "look"}),
    "repeated cells": (
        np.repeat(np.repeat(hills(), 2, axis=0), 2, axis=1),
        {"transform": from_origin(WEST, NORTH, 1.0, 1.0)}, {"terraces": "bad"},
    ),
    "a spike": (put(lambda v: spikes(v, 5.0)), {}, {"spikes": "look"}),
    "many spikes": (put(lambda v: spikes(v, 5.0, 5)), {}, {"spikes": "bad"}),
    "a tower": (put(lambda v: spikes(v, 30.0)), {}, {"spikes": "bad"}),
    "a pit": (
        put(lambda v: spikes(v, -5.0)), {}, {"pits": "look", "depressions": "look"},
    ),
    "no cell with known neighbours": (
        np.where(np.indices((60, 80))[0] % 2, hills(), -9999.0), {}, {"steepness": "bad"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(DEFECTS))
def test_each_defect_has_its_verdict_and_nothing_else_has_one(name: str, tmp_path: Path) -> None:
    values, options, wrong = DEFECTS[name]
    found = verdicts(write(tmp_path / "dem.tif", values, **options))
    found = {item: verdict for item, verdict in found.items() if verdict != "good"}
    if name in ("no system", "wrong system", "degrees", "no cell with known neighbours"):
        found = {item: verdict for item, verdict in found.items() if item in wrong}
    assert found == wrong


def test_numbers_and_places_are_right(tmp_path: Path) -> None:
    values = put(lambda v: spikes(v, 5.0))
    dam(values)
    report = check_dem(write(tmp_path / "dem.tif", values))
    by_item = {f.item: f.numbers for f in report.findings}
    spike = by_item["spikes"]
    assert spike["cells"] == 1 and spike["largest_m"] == pytest.approx(5.0, abs=0.5)
    assert (spike["x"], spike["y"]) == (WEST + 81.0, NORTH - 21.0)
    assert 30.0 < by_item["steepness"]["median_deg"] < 42.0
    pond = by_item["depressions"]
    # Behind the dam the ground rises by 1.4 m a cell: 6 m deep at the dam, no wider than 5 cells.
    assert 3.0 < pond["deepest_m"] < 6.5 and report.verdict == "look"
    assert WEST + 100.0 < pond["x"] < WEST + 122.0


def test_the_page_as_text_json_and_html(tmp_path: Path, call, refusal) -> None:
    file = write(tmp_path / "dem.tif", np.rint(hills()))
    code, out, err = call("dem", "check", file, "--html", tmp_path / "page.html")
    # Terrain that cannot be used is a fault to a script.
    assert code == 1 and not err
    first, *rest = out.splitlines()
    assert first == f"{file}: bad: terraces"
    assert any(line.startswith("bad   terraces") and "multiples of 1 m" in line for line in rest)
    page = (tmp_path / "page.html").read_text()
    assert "Terrain model dem.tif" in page and "multiples of 1 m" in page
    findings = json.loads(call("dem", "check", file, "--json")[1])["findings"]
    terraces = next(f for f in findings if f["item"] == "terraces")
    assert terraces["numbers"]["step_m"] == 1.0
    # A step of 1 m over two cells of 2 m.
    assert terraces["numbers"]["slope_error_deg"] == pytest.approx(np.degrees(np.arctan(0.25)))
    err = refusal("dem", "check", file, "--html", tmp_path / "page.html", code=3)
    assert "exists already" in err


def test_what_is_no_terrain_model_is_one_line(tmp_path: Path, refusal) -> None:
    (tmp_path / "dem.tif").write_text("nothing")
    for file, words in (("dem.tif", "cannot be read as a raster"), ("no.tif", "file not found")):
        assert words in refusal("dem", "check", tmp_path / file)


def test_the_cells_are_a_layer_beside_the_page(tmp_path: Path, printed) -> None:
    values = put(lambda v: spikes(v, 5.0))
    dam(values)
    hole(values, -9999.0)
    dem, layer = write(tmp_path / "dem.tif", values), tmp_path / "cells.gpkg"
    *_, hint = printed("dem", "check", dem).splitlines()
    assert hint == (
        f"In QGIS (nodata, spikes, depressions): sassgis dem check {dem} -o dem_check.gpkg"
    )
    *_, hint = printed("dem", "check", dem, "--crs", "EPSG:2056").splitlines()
    assert hint.endswith(f"dem check {dem} --crs EPSG:2056 -o dem_check.gpkg")
    assert f"Wrote {layer}" in printed("dem", "check", dem, "-o", layer)
    cells = gpd.read_file(layer, layer="dem_defects")
    assert cells.crs.to_epsg() == 2056
    by_item = dict(list(cells.groupby("item")))
    assert sorted(by_item) == ["depressions", "nodata", "spikes"]
    (spike,), (gap,) = by_item["spikes"].geometry, by_item["nodata"].geometry
    assert spike.equals(box(WEST + 80.0, NORTH - 22.0, WEST + 82.0, NORTH - 20.0))
    assert gap.equals(box(WEST + 60.0, NORTH - 48.0, WEST + 66.0, NORTH - 40.0))
    assert by_item["nodata"]["cells"].tolist() == [12]
    assert by_item["spikes"]["largest"].iloc[0] == pytest.approx(5.0, abs=0.5)


def test_a_good_model_has_no_cells_to_show(tmp_path: Path, printed) -> None:
    dem, layer = write(tmp_path / "dem.tif", hills()), tmp_path / "cells.gpkg"
    assert "In QGIS" not in printed("dem", "check", dem)
    printed("dem", "check", dem, "-o", layer)
    assert gpd.read_file(layer, layer="dem_defects").empty


def test_what_is_missing_is_a_whole_sentence(tmp_path: Path, call) -> None:
    code, said, _ = call("dem", "check", write(tmp_path / "dem.tif", hills(), crs=None))
    assert code == 1
    assert 'expected its system as --crs, such as "EPSG:2056" (or "local")' in said
