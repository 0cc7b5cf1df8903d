"""Runs along one profile, from a table or the terrain; terrain without a coordinate system."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Literal

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from bedrina_1986 import passage_histogram, share_within
from helpers.samples import copy_sample

from sassgis.errors import ConfigError, InputError
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import profile_from_csv
from sassgis.runs.profile_run import run_profile, simulate_profile
from sassgis.runs.run import run
from sassgis.settings.results import ContactKind
from sassgis.simulation.path_sample import arrivals


@pytest.fixture(scope="module")
def bedrina(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_sample("bedrina", tmp_path_factory.mktemp("bedrina")).parent / "config_after.toml"


def test_a_profile_from_a_table_leaves_all_its_files(bedrina: Path, tmp_path: Path) -> None:
    done = run_profile(bedrina, tmp_path / "out", rocks=40)
    result = done.found
    found = {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*.*")}
    assert {
        "report.html",
        "manifest.json",
        "tables/rocks.csv",
        "tables/contacts.csv",
        "figures/profile.png",
    } <= found
    assert {f"figures/{n}_along.png" for n in ("energy", "speed", "height")} <= found
    rocks = pd.read_csv(tmp_path / "out" / "tables" / "rocks.csv")
    assert len(rocks) == 40 and not rocks.duplicated(["scenario", "rock"]).any()
    passages = pd.read_csv(tmp_path / "out" / "tables" / "passages.csv")
    assert set(passages["scenario"]) <= set(rocks["scenario"])
    for control_line in ("camera 2", "2", "3", "1"):
        assert (passages["control_line"].astype(str) == control_line).sum() == arrivals(
            result, control_line
        )
    counts = json.loads((tmp_path / "out" / "manifest.json").read_text())["counts"]
    assert counts["rocks"] == 40
    in_short = dict(done.report.summary)
    reached = f"{arrivals(result, '2')} of 40 blocks arrive; energy: 95 % of them below "
    assert str(in_short["2 (net, 5 m)"]).startswith(reached)
    # That of a net which stops blocks, not beyond it.
    stops = f"longest {math.ceil(result.rocks['runout_m'].max())} m (chainage)"
    assert str(in_short["Run-out"]).endswith(stops)
    # To be copied into a configuration: no spaces between thousands.
    assert "<td>1986</td>" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_scenarios_with_names_that_begin_alike_draw_apart(bedrina: Path) -> None:
    config = load_config(bedrina)
    twins = tuple(replace(config.blocks[0], name=f"blocks of {n}") for n in ("one", "two"))
    result = simulate_profile(replace(config, blocks=twins), profile_from_csv(config), rocks=30)
    one, two = (result.rocks[result.scenario == k] for k in (0, 1))
    assert (one["mass_kg"] != two["mass_kg"]).all()
    # As many paths as stops of the same rocks on the picture.
    assert len(result.paths) == 2 * result.drawn == 60


@pytest.mark.parametrize("readings", ["1986", "hazard"])
def test_contacts_lose_energy_and_flights_between_them_do_not(
    bedrina: Path, readings: Literal["1986", "hazard"]
) -> None:
    config = load_config(bedrina, {"engine.readings": readings})
    result = simulate_profile(config, profile_from_csv(config), rocks=40)
    rows, rocks = result.contacts, result.rocks
    hit = rows["kind"] == ContactKind.IMPACT
    # Soft landings are none of the impacts that a block counts.
    assert hit.sum() >= rocks["impacts"].sum() > 0
    lost = 1.0 - rows["energy_out_kj"][hit] / rows["energy_in_kj"][hit]
    assert (lost > -1e-9).all() and (lost < 1.0).all()
    # Of two impacts one after the other: what the second has is what the first left and the fall.
    one, two = rows[:-1], rows[1:]
    flown = hit[:-1] & hit[1:] & (one["rock"] == two["rock"])
    mass = rocks["mass_kg"][one["rock"][flown]]
    fall = 1e-3 * config.engine.gravity_mps2 * mass * (one["z_m"] - two["z_m"])[flown]
    gained = (two["energy_in_kj"] - one["energy_out_kj"])[flown]
    assert flown.sum() > 100
    np.testing.assert_allclose(gained, fall, rtol=1e-9, atol=1e-9)


def test_shares_and_histograms_count_the_passages(bedrina: Path) -> None:
    result = simulate_profile(load_config(bedrina), profile_from_csv(load_config(bedrina)))
    histogram = passage_histogram(result, "camera 2", "speed_mps", (0.0, 15.0, 100.0), "m/s")
    n, share = share_within(result, "camera 2", "speed_mps", 0.0, np.nextafter(15.0, 0.0))
    assert histogram.counts.sum() == n == arrivals(result, "camera 2") == 100
    assert histogram.counts[0] == round(share * n)


@pytest.mark.battery
def test_a_profile_from_the_terrain_meets_the_stations_of_the_map(small, tmp_path: Path) -> None:
    points = gpd.read_file(small.folder / "result.gpkg", layer="release_points")
    x, y = points.geometry.iloc[0].coords[0]
    result = run_profile(small.config, tmp_path / "out", point=(x, y), rocks=20).found
    names = [g.name for g, _ in result.profile.control_lines]
    assert "upper talus" in names
    assert result.profile.s[0] == 0.0 and result.profile.z[0] > result.profile.z[-1] + 100.0
    assert (tmp_path / "out" / "report.html").is_file()
    assert result.rocks.size == 2 * 20


def test_a_point_off_the_terrain_is_refused(small, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"point: no fall line starts here .*2700000 to 2701200"):
        run_profile(small.config, tmp_path / "out", point=(0.0, 0.0))
    assert not (tmp_path / "out").exists()


def line_file(folder: Path, *lines: shapely.LineString) -> Path:
    frame = gpd.GeoDataFrame(geometry=list(lines), crs="EPSG:2056")
    frame.to_file(folder / "drawn.gpkg", driver="GPKG")
    return folder / "drawn.gpkg"


def test_a_drawn_line_gives_the_heights_of_the_terrain_under_it(small, tmp_path: Path) -> None:
    areas = gpd.read_file(small.folder / "result.gpkg", layer="fall_lines")
    fall_line = max(areas.geometry, key=lambda g: g.length)
    ends = shapely.LineString([fall_line.coords[0], fall_line.coords[-1]])
    result = run_profile(
        small.config, tmp_path / "out", line_file=line_file(tmp_path, ends), rocks=5
    )
    profile = result.found.profile
    assert profile.name.endswith("drawn") and profile.s[-1] == pytest.approx(ends.length)
    assert "upper talus" in [g.name for g, _ in profile.control_lines]
    with rasterio.open(small.config.parent / "dem.tif") as raster:
        grid = raster.read(1)
        places = [ends.interpolate(s).coords[0] for s in profile.s]
        nearest = [grid[raster.index(x, y)] for x, y in places]
    # Bilinear between the centres of cells of 2 m, on slopes up to walls.
    assert np.median(np.abs(profile.z - nearest)) < 1.0
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert "profile" in {entry["role"] for entry in manifest["inputs"]}


def test_a_drawn_line_must_be_one_and_over_the_terrain(small, tmp_path: Path) -> None:
    across = shapely.LineString([(2_700_100, 1_120_500), (2_800_000, 1_120_500)])
    inside = shapely.LineString([(2_700_100, 1_120_500), (2_700_300, 1_120_500)])
    to_edge = shapely.LineString([(2_700_000, 1_120_500), (2_700_300, 1_120_500)])
    for lines, words in (
        ((across,), "lies outside"),
        ((to_edge,), r"found x 2700000 to .*expected within x 2700001 to .*half a cell"),
        ((inside, inside), "several lines"),
        ((shapely.LineString([(2_700_100, 1_120_500), (2_700_100.5, 1_120_500)]),), "no profile"),
    ):
        with pytest.raises(InputError, match=rf"--line: .*{words}"):
            run_profile(small.config, tmp_path / "out", line_file=line_file(tmp_path, *lines))


def test_a_line_that_is_drawn_uphill_is_refused(small, tmp_path: Path) -> None:
    areas = gpd.read_file(small.folder / "result.gpkg", layer="fall_lines")
    fall_line = max(areas.geometry, key=lambda g: g.length)
    below = fall_line.interpolate(100.0)  # It ends on the other side of the valley.
    up = shapely.LineString([below, fall_line.coords[0]])
    with pytest.raises(InputError, match=r"drawn\.gpkg: .*no block starts .*drawn downwards: its"):
        run_profile(small.config, tmp_path / "out", line_file=line_file(tmp_path, up), rocks=5)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("heights", "says"),
    [
        ("0,100\n300,99", "found a slope of 0 degrees at the start; expected a start on a steeper"),
        ("0,100\n30,70\n300,140", "ends 41.0 m above the start: drawn uphill?"),
    ],
)
def test_a_profile_on_which_nothing_starts_or_that_rises(
    bedrina: Path, tmp_path: Path, call, heights: str, says: str
) -> None:
    table = tmp_path / "steep.csv"
    table.write_text(f"s_m,z_m\n{heights}\n")
    code, out, err = call("profile", bedrina, "--csv", table, "-o", tmp_path / "out", "--rocks", 5)
    assert says in err and (code, out == "") == ((2, True) if "expected" in says else (0, False))


def test_a_station_off_the_profile_is_refused(bedrina: Path, tmp_path: Path) -> None:
    table = tmp_path / "short.csv"
    table.write_text("s_m,z_m\n0,100\n30,70\n")
    with pytest.raises(ConfigError, match=r"camera 2.*chainage_m.*found 62.*0 to 30 m"):
        run_profile(bedrina, tmp_path / "out", csv_file=table)


@pytest.mark.battery
def test_local_coordinates_run_from_end_to_end(make_valley, tmp_path: Path) -> None:
    config = make_valley()
    folder = config.parent
    with rasterio.open(folder / "dem.tif") as raster:
        profile, values = raster.profile, raster.read()
    profile.update(crs=None)
    (folder / "dem.tif").unlink()
    with rasterio.open(folder / "dem.tif", "w", **profile) as raster:
        raster.write(values)
    for file in folder.glob("*.gpkg"):
        frame = gpd.read_file(file)
        file.unlink()
        frame.set_crs(None, allow_override=True).to_file(file, driver="GPKG")
    text = config.read_text()
    config.write_text(text.replace('dem = "dem.tif"', 'dem = "dem.tif"\ncrs = "local"'))
    result = run(config, tmp_path / "out", jobs=1)
    assert result.run.grid.crs == "" and result.n_blocks > 200
    with rasterio.open(tmp_path / "out" / "maps" / "energy.tif") as raster:
        assert raster.crs is None or not raster.crs.is_projected
        assert raster.bounds == pytest.approx(result.run.grid.bounds)
    assert len(gpd.read_file(tmp_path / "out" / "result.gpkg", layer="stops")) == result.n_blocks


def test_equal_seeds_give_equal_profiles_and_others_do_not(bedrina: Path) -> None:
    config = load_config(bedrina)
    profile = profile_from_csv(config)
    first, again, other = (
        simulate_profile(replace(config, run=replace(config.run, seed=s)), profile, rocks=10)
        for s in (1, 1, 2)
    )
    assert first.rocks.tobytes() == again.rocks.tobytes()
    assert (first.rocks["mass_kg"] != other.rocks["mass_kg"]).all()


def test_the_wind_acts_on_a_profile(bedrina: Path) -> None:
    config = load_config(bedrina)
    profile = profile_from_csv(config)
    means = []
    for acceleration in (-2.0, 0.0, 2.0):
        blown = load_config(bedrina, {"effects.wind": {"acceleration_mps2": acceleration}})
        means.append(simulate_profile(blown, profile, rocks=60).rocks["max_speed_mps"].mean())
    assert means[0] < means[1] < means[2]
    assert means[1] == simulate_profile(config, profile, rocks=60).rocks["max_speed_mps"].mean()
