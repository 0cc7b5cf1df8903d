"""A run leaves all its files, and they agree with each other."""

from __future__ import annotations

import json
import sqlite3
import zipfile

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio

from sassgis.files.digests import content_digest
from sassgis.inputs.config import load_config
from sassgis.runs.run import run
from sassgis.settings.results import StopReason

MAPS = (
    "reach_probability", "passages", "energy", "passing_height", "speed", "arrival_time", "stops",
    "terrain",
)  # fmt: skip


def test_every_file_is_there_and_in_the_manifest(small) -> None:
    manifest = json.loads((small.folder / "manifest.json").read_text())
    listed = {f["path"]: f for f in manifest["files"]}
    found = {p.relative_to(small.folder).as_posix() for p in small.folder.rglob("*") if p.is_file()}
    assert found == {*listed, "manifest.json"}
    wanted = {
        "result.gpkg",
        "project.qgz",
        "report.html",
        "tables/rocks.csv",
        "tables/passages.csv",
    }
    wanted |= {f"maps/{m}.{suffix}" for m in MAPS for suffix in ("tif", "qml")}
    wanted |= {f"figures/{n}.png" for n in ("map_energy", "runout", "profile_furthest")}
    assert wanted <= found
    for path, entry in listed.items():
        assert content_digest(small.folder / path) == entry["sha256"]
    assert zipfile.ZipFile(small.folder / "project.qgz").testzip() is None
    assert not list(small.folder.parent.glob("*.partial"))
    # The same site elsewhere gives the same settings.
    assert manifest["settings"]["terrain"]["dem"] == "dem.tif"
    assert str(small.config.parent) not in json.dumps(manifest)


def test_counts_add_up(small) -> None:
    counts = json.loads((small.folder / "manifest.json").read_text())["counts"]
    assert counts["rocks"] == small.result.n_blocks > 200
    assert sum(counts[f"rocks_{r.name.lower()}"] for r in StopReason) == counts["rocks"]
    assert counts["rocks"] + counts["rocks_not_simulated"] == counts["release_points"] * 6
    assert counts["fall_lines"] == counts["release_points"]


def test_reach_times_rocks_is_passages(small) -> None:
    reach = small.band("reach_probability", "reach")
    passages = small.band("passages", "passages")
    known = np.isfinite(passages)
    assert known.sum() > 5000 and np.array_equal(known, np.isfinite(reach))
    started = small.result.n_blocks - small.result.reasons.get(StopReason.NEVER_STARTED, 0)
    assert np.allclose(reach[known] * started, passages[known], rtol=1e-6)
    assert passages[known].min() >= 1 and reach[known].max() <= 1.0


def test_maps_and_report_say_that_quantiles_of_few_blocks_are_low(small) -> None:
    low = "fewer than 20 blocks arrive, the 95 % quantile is mostly too low (with 2 to 4 blocks"
    words = dict.fromkeys(("energy", "passing_height", "speed"), low)
    words["arrival_time"] = "fewer than 20 blocks arrive, the 5 % quantile is mostly too late"
    for stem, text in words.items():
        with rasterio.open(small.folder / "maps" / f"{stem}.tif") as data:
            assert text in data.tags()["NOTE"]
    passages = small.band("passages", "passages")
    few = (passages < 20).sum() / np.isfinite(passages).sum()
    report = (small.folder / "report.html").read_text(encoding="utf-8")
    says = f"Fewer than 20 blocks arrive in {100 * few:.0f} % of the reached cells."
    assert report.count(low) >= 2 and report.count(says) == 2


def test_no_more_rocks_stop_in_a_cell_than_come_to_it(small) -> None:
    stops = np.nan_to_num(small.band("stops", "stops"))
    passages = np.nan_to_num(small.band("passages", "passages"))
    rocks = pd.read_csv(small.folder / "tables" / "rocks.csv")
    assert (stops <= passages).all()
    assert stops.sum() == rocks["reason"].isin(("rest", "barrier")).sum() > 0


def test_the_largest_values_on_the_map_are_those_of_the_rocks(small) -> None:
    rocks = pd.read_csv(small.folder / "tables" / "rocks.csv")
    for stem, column in (
        ("energy", "max_energy_kj"), ("passing_height", "max_height_m"), ("speed", "max_speed_mps")
    ):  # fmt: skip
        largest = np.nanmax(small.band(stem, "max"))
        assert largest == pytest.approx(rocks[column].max(), rel=1e-6)


def test_every_rock_is_once_in_the_table(small) -> None:
    rocks = pd.read_csv(small.folder / "tables" / "rocks.csv")
    assert len(rocks) == small.result.n_blocks
    assert not rocks.duplicated(["scenario", "line", "rock"]).any()
    per_area = gpd.read_file(small.folder / "result.gpkg", layer="release_areas")
    assert rocks.groupby("area").size().to_dict() == dict(
        zip(per_area["name"], per_area["rocks"], strict=True)
    )
    for reason, count in small.result.reasons.items():
        assert (rocks["reason"] == reason.name.lower()).sum() == count
    furthest = small.result.progress.furthest
    assert furthest is not None and furthest[0] == pytest.approx(rocks["runout_m"].max())


def test_rocks_end_where_their_cell_counts_a_stop(small) -> None:
    rocks = pd.read_csv(small.folder / "tables" / "rocks.csv")
    rest = rocks[rocks["reason"] == "rest"]
    grid = small.result.run.grid
    cells = grid.cell_of(rest["x_m"].to_numpy(), rest["y_m"].to_numpy())
    stops = np.nan_to_num(small.band("stops", "stops")).ravel()
    # A rock at rest on the border of two cells may count in either.
    assert (stops[cells] > 0).mean() > 0.98


def test_passages_agree_with_the_stations(small) -> None:
    rows = pd.read_csv(small.folder / "tables" / "passages.csv")
    assert not rows.duplicated(["scenario", "control_line", "line", "rock"]).any()
    for layer in ("stations", "barriers"):
        for control_line in gpd.read_file(small.folder / "result.gpkg", layer=layer).itertuples():
            own = rows[rows["control_line"] == control_line.name]
            assert len(own) == control_line.rocks
            if len(own):
                energy = own["energy_trans_kj"] + own["energy_rot_kj"]
                assert control_line.energy_kj_max == pytest.approx(energy.max(), rel=1e-4)
                assert control_line.energy_kj_mean == pytest.approx(energy.mean(), rel=1e-4)
                assert control_line.speed_mps_max == pytest.approx(own["speed_mps"].max(), rel=1e-4)
    assert len(rows) > 200


def test_the_footprint_is_the_area_of_the_cells_reached(small) -> None:
    frame = gpd.read_file(small.folder / "result.gpkg", layer="footprint")
    reach = small.band("reach_probability", "reach")
    cell = small.result.run.grid.cell_size
    for row in frame.itertuples():
        with np.errstate(invalid="ignore"):
            cells = (reach > 0).sum() if row.level == 0.0 else (reach >= row.level).sum()
        assert row.area_m2 == pytest.approx(cells * cell**2, rel=1e-6)


@pytest.mark.battery
def test_parquet_holds_the_same_as_csv(small, tmp_path) -> None:
    overrides = {"output.rock_table": "parquet", "output.passage_table": "parquet"}
    run(load_config(small.config, overrides), tmp_path / "out", jobs=1)
    for name in ("rocks", "passages"):
        mine = pd.read_parquet(tmp_path / "out" / "tables" / f"{name}.parquet")
        theirs = pd.read_csv(small.folder / "tables" / f"{name}.csv")
        pd.testing.assert_frame_equal(mine, theirs, check_dtype=False, rtol=0, atol=0)


@pytest.mark.battery
def test_stop_points_max_is_a_maximum(make_valley, tmp_path) -> None:
    config = load_config(make_valley(), {"output.stop_points_max": 50})
    result = run(config, tmp_path / "out", jobs=1)
    stops = gpd.read_file(tmp_path / "out" / "result.gpkg", layer="stops")
    assert 25 <= len(stops) <= 50 < result.n_blocks
    with sqlite3.connect(tmp_path / "out" / "result.gpkg") as base:
        notes = base.execute("select description from gpkg_contents where table_name='stops'")
        assert f"{len(stops)} of {result.n_blocks} blocks" in notes.fetchone()[0]
