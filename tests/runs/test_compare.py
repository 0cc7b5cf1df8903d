"""Two results of the same slope, compared from the command line."""

from __future__ import annotations

import html
import json
import re
import shutil
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from helpers.command_line import exit_code
from helpers.in_qgis import in_qgis
from helpers.zone_slope import HOUSE, Case, box, place, two_areas

PROBE = Path(__file__).parents[1] / "outputs" / "qgis" / "probe.py"


def zone(case: Case, out: Path) -> Path:
    assert exit_code("zone", case.config, "-o", out, "--jobs", "1") == 0
    return out


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Without a wall, and with one that stops every block of the northern area."""
    folder = tmp_path_factory.mktemp("results")
    case = two_areas(folder, hazard={"ref_width_m": 6.0, "compare_barriers": False})
    case.expose("houses", "building", {"left": box(62.0, 33.0, 3.0, 4.0)}, **HOUSE)
    pipe = {"pipe": shapely.LineString([place(60.0, 10.0), place(60.0, 60.0)])}
    case.expose("pipes", "line", pipe, segment_m=20.0, value_per_m=500.0)
    case.lists["stations"] = [
        {"name": "foot", "line": [list(place(58.0, 2.0)), list(place(58.0, 68.0))]}
    ]
    case.sections["project"] = {"language": "de"}  # zones and maps name the levels alike
    case.write()
    before = zone(case, folder / "before")
    case.lists["barriers"] = [
        {"name": "wall", "kind": "wall", "height_m": 60.0,
         "line": [list(place(40.0, 2.0)), list(place(40.0, 68.0))]},
    ]  # fmt: skip
    case.write()
    return before, zone(case, folder / "after")


@pytest.fixture(scope="module")
def compared(results: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("compared") / "out"
    assert exit_code("compare", *results, "-o", out) == 0
    return out


def bands(file: Path) -> dict[str, np.ndarray]:
    with rasterio.open(file) as raster:
        return {
            raster.tags(i)["NAME"]: raster.read(i, masked=True).astype(float).filled(np.nan)
            for i in raster.indexes
        }


def numbers(folder: Path) -> pd.DataFrame:
    table = pd.read_csv(folder / "tables" / "changes.csv", keep_default_na=True)
    return table.fillna({"name": ""}).set_index(["part", "name", "quantity"])


def test_maps_of_the_change_are_the_difference(results: Any, compared: Path) -> None:
    maps = {"reach_probability": "reach", "energy": "q95", "passing_height": "q95"}
    for stem, band in maps.items():
        old, new = (bands(r / "maps" / f"{stem}.tif")[band] for r in results)
        change = bands(compared / "maps" / f"{stem}_change.tif")
        wanted = np.where(
            np.isfinite(old) | np.isfinite(new), np.nan_to_num(new) - np.nan_to_num(old), np.nan
        )
        assert np.allclose(change["change"], wanted, equal_nan=True, atol=1e-4)
        assert np.array_equal(change["before"], old, equal_nan=True)
        assert np.array_equal(change["after"], new, equal_nan=True)
        assert (compared / "maps" / f"{stem}_change.qml").is_file()
    assert np.nanmin(change["change"]) < 0.0, "a wall keeps blocks back"


def test_levels_and_zones_say_the_same(results: Any, compared: Path) -> None:
    old, new = (np.nan_to_num(bands(r / "maps" / "hazard_level.tif")["level"]) for r in results)
    change = bands(compared / "maps" / "hazard_level_change.tif")["change"]
    kinds = [change == k for k in (1, 2, 3)]
    assert np.array_equal(kinds[0], new < old) and np.array_equal(kinds[2], new > old)
    assert np.array_equal(kinds[1], (new == old) & (old > 0))
    layer = gpd.read_file(compared / "changes.gpkg", layer="level_changes")
    zones = [gpd.read_file(r / "hazard.gpkg", layer="hazard_zones") for r in results]
    table = numbers(compared)
    for column, own, when in (
        ("level_before", zones[0], "before"),
        ("level_after", zones[1], "after"),
    ):
        area = layer.assign(a=layer.area).groupby(column)["a"].sum()
        for code, group in own.groupby("hazard_level"):
            assert area[code] == pytest.approx(group.area.sum(), rel=1e-6)
            label = group["label"].iloc[0]
            stated = table.loc[("zones", label, "area of zones"), when]
            assert stated == pytest.approx(group.area.sum(), rel=1e-5)
    matrix = pd.read_csv(compared / "tables" / "level_changes.csv", index_col=0)
    # Each entry is rounded to a tenth of a square metre.
    pieces = layer.assign(a=layer.area).groupby(["level_before", "level_after"])["a"].sum()
    told = np.sort(matrix.to_numpy().ravel())[-len(pieces) :]
    assert told == pytest.approx(np.sort(pieces.to_numpy()), abs=0.05 + 1e-6)
    assert np.count_nonzero(matrix.to_numpy()) <= len(pieces)
    union = shapely.union_all([*zones[0].geometry, *zones[1].geometry])
    assert layer.area.sum() == pytest.approx(union.area, rel=1e-6)


def test_the_wall_is_what_differs(compared: Path) -> None:
    table = pd.read_csv(compared / "tables" / "differences.csv")
    assert set(table["kind"]) == {"setting"}
    assert table["name"].str.startswith("barriers").all()
    numbers_ = numbers(compared)
    share = numbers_.loc[("control line", "foot", "share of blocks that arrive")]
    assert share["before"] > 0.5 and share["after"] == 0.0
    reach = numbers_.loc[("object", "left", "reach probability, largest of the cells")]
    assert reach["before"] > 0.0 and reach["after"] == 0.0
    assert numbers_.loc[("object", "left", "loss"), "unit"] == "CHF/year"
    assert numbers_.loc[("object", "left", "deaths"), "change"] < 0.0
    assert not table.isna()["after"].all()


def test_a_line_counts_as_a_whole(results: Any, compared: Path) -> None:
    table = numbers(compared)
    names = {name for part, name, _ in table.index if part == "object"}
    assert names == {"left", "pipe"}
    for when, result in zip(("before", "after"), results, strict=True):
        rows = pd.read_csv(result / "tables" / "risk_objects.csv")
        stretches = rows[rows["part_of"] == "pipe"]
        assert len(stretches) == 5
        energy = table.loc[("object", "pipe", "energy (95 % quantile)"), when]
        # The stretch of the report: that with the most energy once in the longest period.
        worst = stretches.loc[stretches["energy_300y_kj"].fillna(-1.0).idxmax()]
        assert energy == pytest.approx(np.nan_to_num(worst["energy_q95_kj"]), rel=1e-3)
        stated = table.loc[("object", "pipe", "loss"), when]
        assert stated == pytest.approx(stretches["loss_per_year"].sum(), rel=1e-5)
        reach = bands(result / "maps" / "reach_probability.tif")["reach"]
        # The line runs along the border of two columns of cells.
        largest = np.nan_to_num(reach[10:60, 59:61]).max()
        reach_of = ("object", "pipe", "reach probability, largest of the cells")
        assert table.loc[reach_of, when] <= largest + 1e-6
    assert table.loc[reach_of, "before"] > 0.0


def test_the_report_says_first_what_changed(compared: Path) -> None:
    text = (compared / "report.html").read_text(encoding="utf-8")
    words = html.unescape(re.sub(r"<style>.*?</style>|<[^>]+>", " ", text, flags=re.S))
    words = " ".join(words.split())
    order = [
        words.index(w)
        for w in ("Abbildung 1", "Fläche der Zellen, die Blöcke erreichen", "Wie sicher das ist")
    ]
    assert order == sorted(order)
    assert "barriers.wall.height_m" in words
    assert words.rindex("Vorher und nachher") < words.rindex("Bei exponierten Objekten")
    # The folders are called before and after.
    assert not re.findall(r"\b(?:[Tt]he|of|and|blocks|is|by|year)\b", words)
    listed = {f["path"] for f in json.loads((compared / "manifest.json").read_text())["files"]}
    found = {
        p.relative_to(compared).as_posix()
        for p in compared.rglob("*")
        if p.is_file() and p.name != "manifest.json"
    }
    assert listed == found


def test_a_result_and_itself(results: Any, tmp_path: Path, call) -> None:
    code, out, err = call("compare", results[0], results[0], "-o", tmp_path / "out")
    assert (code, err) == (0, "") and "(+0 %)" in out
    table = numbers(tmp_path / "out").drop(("map", "", "area reached in one result only"))
    assert (table["change"].dropna() == 0.0).all() and len(table) > 20
    assert np.nanmax(np.abs(bands(tmp_path / "out/maps/energy_change.tif")["change"])) == 0.0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Nichts ändert sich." in page
    layer = gpd.read_file(tmp_path / "out" / "changes.gpkg", layer="level_changes")
    assert set(layer["change"]) == {"same"}


def test_a_run_and_a_zoning(results: Any, tmp_path: Path, call) -> None:
    """Blocks are compared, levels are not."""
    run = tmp_path / "run"
    shutil.copytree(results[1], run)
    for file in run.glob("maps/hazard_level*"):
        file.unlink()
    (run / "hazard.gpkg").unlink()
    code, _, err = call("compare", results[0], run, "-o", tmp_path / "out")
    assert code == 0 and "levels are not compared" in err
    assert not (tmp_path / "out" / "changes.gpkg").exists()
    assert not (tmp_path / "out" / "maps" / "hazard_level_change.tif").exists()
    assert (tmp_path / "out" / "project.qgz").is_file()


def test_bad_folders_are_one_line(results: Any, tmp_path: Path, refusal) -> None:
    broken = tmp_path / "broken"

    def refused() -> str:
        return str(refusal("compare", broken, results[0], "-o", tmp_path / "out"))

    assert "not a result" in refused()
    (broken / "maps").mkdir(parents=True)
    assert "not a result" in refused()
    for manifest, words in (("{", "cannot be read"), ("[]", "is no manifest")):
        (broken / "manifest.json").write_text(manifest)
        assert words in refused()
    shutil.copy(results[0] / "manifest.json", broken)
    assert "no maps to compare" in refused()
    (broken / "maps" / "reach_probability.tif").write_text("no raster")
    assert "cannot be read as a raster" in refused()
    assert not list(tmp_path.glob("out*"))


def test_results_changed_by_hand_are_one_line(results: Any, tmp_path: Path, refusal) -> None:
    changed = shutil.copytree(results[1], tmp_path / "changed")

    def refused() -> str:
        return str(refusal("compare", results[0], changed, "-o", tmp_path / "out"))

    for file, layer, column in (
        ("result.gpkg", "stations", "rocks"),
        ("hazard.gpkg", "hazard_zones", "label"),
    ):
        whole = (changed / file).read_bytes()
        frame = gpd.read_file(changed / file, layer=layer)
        frame.drop(columns=column).to_file(changed / file, layer=layer, driver="GPKG")
        assert f"{file}: layer {layer}, {column}: a column is missing" in refused()
        (changed / file).write_bytes(whole)
    frame.loc[0, "geometry"] = None
    frame.to_file(changed / file, layer=layer, driver="GPKG")
    assert "layer hazard_zones: a geometry is missing" in refused()
    manifest = changed / "manifest.json"
    for counts, said in (("many", "counts.rocks"), (None, "counts: is no table")):
        content = json.loads(manifest.read_text())
        content["counts"] = counts and {"rocks": counts}
        manifest.write_text(json.dumps(content))
        assert said in refused()


@pytest.mark.qgis
def test_qgis_opens_the_comparison(compared: Path, tmp_path: Path, qgis: None) -> None:
    picture = tmp_path / "p.png"
    seen = json.loads(in_qgis(PROBE, compared / "project.qgz", picture, home=tmp_path))
    assert seen["opened"] and not seen["error"] and not seen["render_errors"]
    assert all(entry["valid"] for entry in seen["layers"]) and len(seen["layers"]) == 6
    by_name = {entry["name"]: entry for entry in seen["layers"]}
    level = by_name["Änderung der Gefahrenstufe"]["renderer"]
    # In the language of the project.
    labels = [i["label"] for i in level["items"]]
    assert labels == ["Höhere Stufe", "Gleiche Stufe", "Tiefere Stufe"]
    classes = by_name["Änderung der Gefahrenzonen"]["renderer"]["classes"]
    assert {"lower", "same", "higher"} <= {c["value"] for c in classes}
    assert seen["blank_share"] < 0.9


def test_a_moved_line_is_named(results: Any, tmp_path: Path, call) -> None:
    moved = tmp_path / "moved"
    shutil.copytree(results[1], moved)
    stations = gpd.read_file(moved / "result.gpkg", layer="stations")
    stations.geometry = stations.geometry.translate(1.0)
    stations.to_file(moved / "result.gpkg", layer="stations")
    _, _, err = call("compare", results[1], moved, "-o", tmp_path / "out")
    assert "loads are those of two places: foot" in err
    assert "two places" not in call("compare", *results, "-o", tmp_path / "same")[2]
