"""Batches: bad areas, resuming, and a mosaic that equals one run of all areas."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from helpers.changed_arrays import change_arrays
from helpers.cut_valley import GOOD, Stopped, Valley

from sassgis.batches import batch as runs_batch
from sassgis.batches import batch_window
from sassgis.batches.batch import batch, find_areas
from sassgis.errors import ConfigError, InputError, OutputError
from sassgis.files.saved_arrays import unfit
from sassgis.inputs.config import load_config
from sassgis.runs.run import zone

# Maps hold everything that is counted; these hold what is made of it.
TABLES = ("zones", "zone_sources", "sources", "design", "risk_objects", "risk_sources")


def on_grid(file: Path, band: str, like: Path) -> np.ndarray:
    """A band of a map on the cells of another map, 0 where it holds nothing."""
    with rasterio.open(like) as target:
        out = np.zeros(target.shape)
        corner, cell = target.transform, target.res[0]
    with rasterio.open(file) as raster:
        index = [raster.tags(i)["NAME"] for i in raster.indexes].index(band) + 1
        values = raster.read(index, masked=True).astype(float).filled(0.0)
        row = round((corner.f - raster.transform.f) / cell)
        col = round((raster.transform.c - corner.c) / cell)
    out[row : row + values.shape[0], col : col + values.shape[1]] = values
    return out


def test_a_bad_area_is_reported_and_skipped(done: Stopped) -> None:
    summary = done.result.summary.set_index("area")
    assert list(summary.index) == ["Mitte", "Mitte bis", "Nord", "crossed"]
    assert summary.loc[list(GOOD), "status"].tolist() == ["done"] * 3
    assert summary.loc["crossed", "status"].startswith("skipped: ")
    assert "is not valid" in summary.loc["crossed", "status"]
    assert summary.loc["crossed", ["points", "rocks", "seconds"]].isna().all()
    assert (summary.loc[list(GOOD), ["points", "rocks", "furthest_m", "seconds"]] > 0).all(
        axis=None
    )
    assert any("crossed is skipped" in w for w in done.result.warnings)
    read = pd.read_csv(done.folder / "summary.csv")
    assert read["status"].tolist() == done.result.summary["status"].tolist()


def test_what_was_done_before_a_stop_is_kept(done: Stopped) -> None:
    assert done.first["status"].tolist() == ["done", "not run", "not run", "not run"]
    # The time is that of the call in which it ran.
    assert done.result.summary["seconds"][0] == done.first["seconds"][0]


def test_each_area_runs_on_a_part_of_the_terrain(done: Stopped) -> None:
    for name in ("mitte", "mitte_bis", "nord"):
        record = json.loads((done.folder / "areas" / name / "area.json").read_text())
        assert record["n_rows"] * record["n_cols"] < 450 * 600
    assert (done.folder / "areas" / "mitte" / "report.html").is_file()


@pytest.fixture(scope="module")
def joint(valley: Valley, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One run of the same areas on the whole terrain model, in the order of the batch."""
    folder = tmp_path_factory.mktemp("joint")
    release = folder / "release.gpkg"
    frame = gpd.read_file(valley.releases).set_index("name").loc[list(GOOD)].reset_index()
    frame.to_file(release, driver="GPKG")
    config = load_config(valley.config, {"release.file": str(release)})
    zone(config, folder / "out", jobs=1)
    return folder / "out"


def test_the_mosaic_is_one_run_of_all_areas_to_the_last_bit(done: Stopped, joint: Path) -> None:
    assert_same_result(done.folder / "mosaic", joint)


@pytest.mark.battery
@pytest.mark.parametrize("path", ["followed", "fall_line"])
def test_effects_reach_the_mosaic_as_well(valley: Valley, tmp_path: Path, path: str) -> None:
    """Random paths, fragments, and a forest that one area never meets."""
    inputs = tmp_path / "inputs"
    shutil.copytree(valley.config.parent, inputs)
    good = gpd.read_file(valley.releases).set_index("name").loc[["Mitte", "Nord"]].reset_index()
    good.to_file(inputs / "two.gpkg", driver="GPKG")
    _west, south, east, north = good[good["name"] == "Nord"].total_bounds
    stand = shapely.box(east, south + 30.0, east + 150.0, north)
    gpd.GeoDataFrame(geometry=[stand], crs=good.crs).to_file(inputs / "stand.gpkg", driver="GPKG")
    config = inputs / valley.config.name
    text = config.read_text()
    config.write_text(text.replace("[terrain]\n", f'[terrain]\npath = "{path}"\n'))
    with config.open("a") as text:
        if path == "followed":
            text.write("[effects.lateral_deflection]\nangle_deg = 8.0\n")
        text.write("[effects.fragmentation]\n")
        text.write("[effects.wind]\n")
        text.write('[effects.trees]\nfile = "stand.gpkg"\nstems_per_ha = 300.0\ndbh_cm = 30.0\n')
    batch(inputs / "two.gpkg", tmp_path / "out", config=config, dem=inputs / "tiles")
    together = load_config(config, {"release.file": str(inputs / "two.gpkg")})
    whole = zone(together, tmp_path / "joint")
    assert whole.run.progress.pieces > 30
    own = json.loads((tmp_path / "out" / "areas" / "mitte" / "area.json").read_text())
    # Parts for followed paths are wider than the fall lines.
    assert path == "followed" or own["north"] < south + 30.0
    assert_same_result(tmp_path / "out" / "mosaic", tmp_path / "joint")
    told = [
        json.loads((tmp_path / f / "manifest.json").read_text()) for f in ("out/mosaic", "joint")
    ]
    assert told[0]["counts"]["fragments"] == told[1]["counts"]["fragments"]
    assert all("trees file" in str(t["inputs"]) for t in told)


@pytest.mark.battery
def test_a_part_that_paths_leave_is_made_wider(
    valley: Valley, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a rim so wide that paths meet it, an area begins anew and ends as it did without."""
    areas = gpd.read_file(valley.releases)
    areas[areas["name"] == "Nord"].to_file(tmp_path / "one.gpkg", driver="GPKG")
    said: list[str] = []
    own = partial(
        batch, tmp_path / "one.gpkg", config=valley.config, dem=valley.tiles, jobs=1,
        say=said.append,
    )  # fmt: skip
    own(tmp_path / "narrow")
    rim_cells = batch_window.rim_cells
    monkeypatch.setattr(batch_window, "rim_cells", lambda run, width: rim_cells(run, width) + 420)
    own(tmp_path / "wide")
    assert any("Repeating on a wider one" in text for text in said), said
    wide, narrow = (tmp_path / f / "areas" / "nord" for f in ("wide", "narrow"))
    cells = [json.loads((f / "area.json").read_text()) for f in (wide, narrow)]
    assert cells[0]["n_rows"] * cells[0]["n_cols"] > cells[1]["n_rows"] * cells[1]["n_cols"]
    for name in ("energy", "stops", "passing_height"):
        file = wide / "maps" / f"{name}.tif"
        with rasterio.open(file) as raster:
            bands = [raster.tags(i)["NAME"] for i in raster.indexes]
        for band in bands:
            own = on_grid(file, band, file)
            assert own.any()
            assert np.array_equal(own, on_grid(narrow / "maps" / file.name, band, file)), name


def assert_same_result(mosaic: Path, joint: Path) -> None:
    for file in sorted((joint / "maps").glob("*.tif")):
        with rasterio.open(file) as raster:
            bands = [raster.tags(i)["NAME"] for i in raster.indexes]
        own = mosaic / "maps" / file.name
        for band in bands if file.stem != "terrain" else ():
            assert np.array_equal(on_grid(own, band, file), on_grid(file, band, file)), file.stem
    for table in TABLES:
        ours, theirs = (f / "tables" / f"{table}.csv" for f in (mosaic, joint))
        assert ours.read_bytes() == theirs.read_bytes(), table
    for layer in ("release_areas", "release_points", "fall_lines", "stops", "barriers"):
        ours, theirs = (gpd.read_file(f / "result.gpkg", layer=layer) for f in (mosaic, joint))
        assert ours.equals(theirs), layer


def test_nothing_is_run_again_or_replaced_unasked(
    done: Stopped, valley: Valley, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifests = sorted(done.folder.rglob("manifest.json"))
    assert len(manifests) == 4
    before = [m.stat().st_mtime_ns for m in manifests]
    # Several processes look at what is there.
    monkeypatch.setattr(runs_batch, "_AREAS_PER_CORE", 0)
    own = partial(batch, valley.releases, done.folder, dem=valley.tiles, jobs=2, mosaic_only=True)
    again = own()
    assert again.summary.equals(done.result.summary) and again.found is None
    with pytest.raises(OutputError, match="made from other settings, inputs or versions"):
        own(seed=7)
    assert [m.stat().st_mtime_ns for m in manifests] == before
    assert pd.read_csv(done.folder / "summary.csv")["status"][0] == "done"


def scaled(folder: Path) -> None:
    change_arrays(folder / "simulation.npz", lambda a: a["sums.energy_max"].__ifloordiv__(100))


def fewer(folder: Path) -> None:
    file = folder / "area.json"
    record = json.loads(file.read_text())
    file.write_text(
        json.dumps(record | {"frequencies": dict.fromkeys(record["frequencies"], 1e-06)})
    )


@pytest.mark.battery
@pytest.mark.parametrize(
    ("change", "file"),
    [(fewer, "area.json"), (scaled, "simulation.npz")],
)
def test_an_area_that_was_changed_is_refused_until_it_is_moved_away(
    done: Stopped, valley: Valley, tmp_path: Path, change: Callable[[Path], None], file: str
) -> None:
    out = tmp_path / "out"
    shutil.copytree(done.folder, out)
    own = out / "areas" / "mitte"
    change(own)
    said: list[str] = []
    again = partial(
        batch, valley.releases, out, dem=valley.tiles, jobs=1, mosaic_only=True, say=said.append
    )
    with pytest.raises(OutputError, match=rf"{own}: exists and .* or has changed; .*--overwrite"):
        again()
    line = f"Saved state {own / file} is not used: damaged, or changed since it was saved"
    assert said == [line]
    # It is nobody's to delete but the user's.
    with pytest.raises(OutputError, match=rf"{own / file}: .*--overwrite deletes only"):
        again(overwrite=True)
    own.rename(tmp_path / "mine")
    said.clear()
    again(overwrite=True)
    assert "2 of 4 areas are complete" in said
    assert {f.name: f.read_bytes() for f in own.glob("*.npz")} == {
        f.name: f.read_bytes() for f in (done.folder / "areas" / "mitte").glob("*.npz")
    }


def test_what_areas_at_work_together_tell_of_saved_states_is_heard(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def run(_setting, _candidate, place) -> None:
        place.tell("Simulating")
        place.tell(unfit(Path("state.npz")))

    monkeypatch.setattr(runs_batch, "run_area", run)
    *_, told = runs_batch.one_at_work((None, Path()), SimpleNamespace(stem="a"))
    assert told == (unfit(Path("state.npz")),)


def test_no_area_at_all_and_a_folder_with_something_else_are_errors(
    valley: Valley, tmp_path: Path
) -> None:
    frame = gpd.read_file(valley.releases)
    bad = tmp_path / "bad.gpkg"
    frame[frame["name"] == "crossed"].to_file(bad, driver="GPKG")
    with pytest.raises(InputError, match=r"no release area could be run; the first: .*not valid"):
        batch(bad, tmp_path / "out", config=valley.config)
    assert "skipped" in (tmp_path / "out" / "summary.csv").read_text()
    with pytest.raises(OutputError, match="not of a batch"):
        batch(valley.releases, tmp_path)
    assert {f.name for f in tmp_path.iterdir()} == {"bad.gpkg", "out"}
    with pytest.raises(ConfigError, match="no configuration is given"):
        batch(bad, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_two_areas_of_one_name_are_both_skipped(valley: Valley, tmp_path: Path) -> None:
    frame = gpd.read_file(valley.releases)
    twice = pd.concat([frame, frame[frame["name"] == "Nord"]])
    twice.to_file(tmp_path / "twice.gpkg", driver="GPKG")
    config = load_config(valley.config, {"release.file": str(tmp_path / "twice.gpkg")})
    found = find_areas(config)
    assert [c.name for c in found if c.problem] == ["Nord", "Nord"]
    assert "used 2 times" in found[-2].problem
    assert len({c.stem for c in found}) == len(found) == 5


def test_files_of_a_folder_name_areas_that_have_no_name(valley: Valley, tmp_path: Path) -> None:
    frame = gpd.read_file(valley.releases)[["scenario", "geometry"]]
    frame.iloc[:1].to_file(tmp_path / "Wand.gpkg", driver="GPKG")
    frame.iloc[2:4].to_file(tmp_path / "Rinne.gpkg", driver="GPKG")
    (tmp_path / "broken.gpkg").write_text("nothing")
    config = load_config(valley.config, {"release.file": str(tmp_path)})
    found = find_areas(config)
    assert [c.name for c in found] == ["Rinne 1", "Rinne 2", "Wand", "broken"]
    assert [bool(c.problem) for c in found] == [False, False, False, True]
    # What the configuration names for another purpose is no release area.
    own = load_config(valley.config, {"release.file": str(valley.config.parent)})
    assert {c.release.file for c in find_areas(own)} >= {valley.releases}
    assert not any("buildings" in str(c.release.file) for c in find_areas(own))
    (tmp_path / "Wand.gpkg").rename(tmp_path / "Wald.gpkg")
    trees = {"file": str(tmp_path / "Wald.gpkg"), "stems_per_ha": 300.0, "dbh_cm": 30.0}
    wooded = load_config(valley.config, {"release.file": str(tmp_path), "effects.trees": trees})
    assert [c.name for c in find_areas(wooded)] == ["Rinne 1", "Rinne 2", "broken"]
    stems = {"single_trees": str(tmp_path / "Wald.gpkg")}
    more = {"effects.trees": stems, "edits.file": str(tmp_path / "broken.gpkg")}
    edited = load_config(valley.config, {"release.file": str(tmp_path), **more})
    assert [c.name for c in find_areas(edited)] == ["Rinne 1", "Rinne 2"]


def test_the_command_tells_bad_input_in_one_line(tmp_path: Path, refusal) -> None:
    assert "file not found" in refusal("batch", tmp_path / "no.gpkg", "-o", tmp_path / "out")


@pytest.mark.battery
def test_a_shared_file_that_changes_meanwhile_is_told(valley: Valley, tmp_path: Path) -> None:
    """Each area keeps the digest of what it was made from."""
    inputs = tmp_path / "inputs"
    shutil.copytree(valley.config.parent, inputs)
    areas = gpd.read_file(valley.releases).set_index("name").loc[["Mitte", "Nord"]].reset_index()
    areas.to_file(inputs / "two.gpkg", driver="GPKG")
    ground = inputs / "ground.gpkg"

    def edit(text: str) -> None:
        if text.startswith("Area 2"):
            frame = gpd.read_file(ground)
            frame.geometry = frame.geometry.translate(5.0, 0.0)
            frame.to_file(ground, driver="GPKG")

    said: list[str] = []
    own = partial(
        batch, inputs / "two.gpkg", tmp_path / "out", config=inputs / valley.config.name,
        dem=inputs / "tiles", jobs=1, mosaic_only=True, overwrite=True,
    )  # fmt: skip
    meanwhile = "A file that all release areas share has changed while the batch ran"
    assert any(w.startswith(meanwhile) for w in own(say=edit).warnings)
    assert not any(w.startswith(meanwhile) for w in own(say=said.append).warnings)
    # The second was made from what the file holds now.
    assert "1 of 2 areas are complete" in said
