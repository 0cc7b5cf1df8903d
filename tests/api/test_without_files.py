"""Simulations from memory give what those from files give, name it the same, and write nothing."""

from __future__ import annotations

import json
import re
import tomllib
from inspect import isfunction, signature
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import rioxarray
import shapely
import xarray as xr
from affine import Affine
from helpers.zone_slope import CELL, NORTH, RARE, WEST, Case, box, plane, two_areas
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import sassgis
from sassgis.inputs.config import PHYSICS_SECTIONS, settings_hash
from sassgis.inputs.dem import read_dem
from sassgis.inputs.in_memory import as_input
from sassgis.inputs.presets import read_preset
from sassgis.runs.inputs import input_files

BLOCK = {"volume_m3": (0.5, 2.0), "onset_frequency": 0.3}
PLACE = Affine(CELL, 0.0, WEST, 0.0, -CELL, NORTH)
RELEASE = gpd.GeoDataFrame({"name": ["north"]}, geometry=[box(4, 5, 6, 8)], crs="EPSG:2056")


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Two areas, two kinds of ground, a net."""
    made = two_areas(tmp_path_factory.mktemp("case"))
    made.write_layer("ground.gpkg", [box(40.0, 0.0, 50.0, 70.0)], {"class": ["soft_meadow"]})
    bounds = box(60.0, 20.0, 0.1, 30.0).bounds
    made.write_layer("net.gpkg", [shapely.LineString([bounds[:2], bounds[2:]])])
    made.sections["ground"]["file"] = "ground.gpkg"
    made.lists["barriers"] = [
        {"name": "net", "kind": "net", "height_m": 3.0, "capacity_kj": 500.0, "file": "net.gpkg"}
    ]
    # With another simulation without the net, the zones of both would be drawn together.
    made.set("hazard.compare_barriers", False)
    return made


@pytest.fixture(scope="module")
def written(case: Case) -> Any:
    return sassgis.zone(case.config, case.folder / "out", jobs=1)


@pytest.fixture(scope="module")
def held(case: Case) -> sassgis.Config:
    """The same with everything in memory."""
    document = tomllib.loads(case.config.read_text())
    read = {name: gpd.read_file(case.folder / f"{name}.gpkg") for name in
            ("release", "ground", "net")}  # fmt: skip
    document["terrain"]["dem"] = rioxarray.open_rasterio(case.folder / "dem.tif", masked=True)
    document["release"]["file"], document["ground"]["file"] = read["release"], read["ground"]
    document["barriers"][0]["file"] = read["net"]
    return sassgis.configure(**document)


@pytest.fixture(scope="module")
def maps(held: sassgis.Config) -> xr.Dataset:
    return sassgis.simulate(held, jobs=1)


def test_maps_are_those_that_the_same_run_writes(
    case: Case, written: Any, held: sassgis.Config, maps: xr.Dataset
) -> None:
    hazard = sassgis.hazard_maps(maps)
    compared = 0
    for file in sorted((case.folder / "out" / "maps").glob("*.tif")):
        with rasterio.open(file) as raster:
            assert maps.rio.crs == raster.crs and maps.rio.transform() == raster.transform
            for i in raster.indexes:
                band = raster.tags(i)["NAME"]
                both = {**maps, **hazard}
                name = next(n for n in (f"{file.stem}_{band}", file.stem) if n in both)
                found = both[name]
                expected = raster.read(i, masked=True).astype(float).filled(np.nan)
                assert np.array_equal(found.values, expected, equal_nan=True), name
                assert raster.descriptions[i - 1].startswith(found.attrs["long_name"])
                assert found.attrs["units"] in (raster.units[i - 1], "1")
                compared += 1
                # The result of the written run names them so, too.
                assert np.array_equal(written.run.maps[name].values, expected, equal_nan=True)
    assert compared > 40 and np.nanmax(maps.reach_probability) > 0.01


def test_zones_are_those_that_the_same_run_writes(case: Case, written: Any, maps: Any) -> None:
    zones = sassgis.zones(maps)
    expected = gpd.read_file(case.folder / "out" / "hazard.gpkg", layer="hazard_zones")
    assert len(zones) > 0 and zones.crs == expected.crs
    for column in expected.columns.drop("geometry"):
        assert zones[column].tolist() == expected[column].tolist(), column
    assert zones.geom_equals(expected).all()


def test_a_dataset_can_be_kept_and_zoned_later(maps: xr.Dataset, tmp_path: Path) -> None:
    maps.to_netcdf(tmp_path / "maps.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "maps.nc", engine="scipy") as kept:
        assert sassgis.zones(kept).equals(sassgis.zones(maps))
        assert kept.energy_q95.attrs["comment"] == maps.energy_q95.attrs["comment"]


def test_onset_frequencies_may_be_changed_in_the_dataset(maps: xr.Dataset) -> None:
    often = maps.assign(onset_frequency=10.0 * maps.onset_frequency)
    before, after = (sassgis.hazard_maps(ds).frequency_rate_0 for ds in (maps, often))
    assert np.allclose(after, 10.0 * before, equal_nan=True)


def test_a_configuration_written_down_gives_the_same_blocks(
    held: sassgis.Config, maps: xr.Dataset, tmp_path: Path
) -> None:
    file = sassgis.save_config(held, tmp_path / "site" / "sassgis.toml")
    again = sassgis.load_config(file)
    for role, own in input_files(again).items():
        assert own.is_file() and own.parent == file.parent, role
    assert again.blocks == held.blocks and again.onsets == held.onsets
    assert again.engine == held.engine and again.hazard == held.hazard
    found = sassgis.simulate(again, jobs=1)
    assert found.drop_attrs().equals(maps.drop_attrs())
    with pytest.raises(sassgis.OutputError, match="exists already"):
        sassgis.save_config(held, file)
    # From a file, paths are named as seen from the new place.
    sassgis.save_config(again, tmp_path / "other" / "own.toml")
    moved = sassgis.load_config(tmp_path / "other" / "own.toml")
    assert settings_hash(moved, sections=PHYSICS_SECTIONS) == settings_hash(again)


def test_inputs_in_memory_count_by_what_they_hold(held: sassgis.Config) -> None:
    document = dict(held.given)
    changed = document["release"] | {"file": RELEASE}
    other = sassgis.configure(**document | {"release": changed})
    same = sassgis.configure(**document | {"release": dict(document["release"])})
    assert settings_hash(same) == settings_hash(held) != settings_hash(other)


def test_a_result_from_memory_names_its_inputs_in_the_manifest(tmp_path: Path) -> None:
    config = sassgis.configure(
        terrain={"dem": (plane(), PLACE, "EPSG:2056")},
        release={"file": RELEASE, "rocks_per_point": 2},
        blocks=[sassgis.BlockSettings(name="b", volume_m3=1.0)],
        ground={"classes": [sassgis.GroundClass("own", eta_max=0.5, dp_min=0.2, dp_max=0.6,
                                                mu_f=0.8, mu_0=0.5, k=0.2, d_star_m=0.3)],
                "default": "own"},
    )  # fmt: skip
    result = sassgis.run(config, tmp_path / "out", jobs=1)
    assert result.n_blocks > 10
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    named = {entry["role"]: entry["path"] for entry in manifest["inputs"]}
    assert named == {
        "dem": "terrain.dem (in memory)", "release": "release.file (GeoDataFrame)",
        "ground classes": "ground.classes (DataFrame)",
    }  # fmt: skip
    assert "terrain.dem (in memory)" in (tmp_path / "out" / "report.html").read_text()


def test_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ds = sassgis.simulate(
        (plane(), PLACE, "EPSG:2056"), RELEASE, blocks=BLOCK, ground="talus", ref_width_m=4.0,
        jobs=1,
    )  # fmt: skip
    sassgis.zones(ds)
    slope = pd.DataFrame({"s_m": [0.0, 100.0, 200.0], "z_m": [80.0, 0.0, 0.0]})
    sassgis.profile(slope, blocks=BLOCK, n_blocks=5)
    assert not list(tmp_path.rglob("*"))


def test_a_profile_gives_tables() -> None:
    slope = pd.DataFrame({"s_m": [0.0, 100.0, 250.0], "z_m": [80.0, 0.0, -2.0]})
    tables = sassgis.profile(
        slope, blocks=[{"name": "a", **BLOCK}, {"name": "b", **BLOCK}], ground="talus",
        barriers=[{"name": "net", "kind": "net", "height_m": 2.0, "chainage_m": 110.0}],
        n_blocks=30, start_m=(0.0, 10.0), seed=4,
    )  # fmt: skip
    assert len(tables.blocks) == 60 and set(tables.blocks["scenario"]) == {"a", "b"}
    assert tables.blocks["start_m"].between(0.0, 10.0).all()
    assert set(tables.passages["control_line"]) == {"net"} and len(tables.passages) > 10
    arrived = tables.along[tables.along["energy_q50_kj"].notna()]
    assert (arrived["energy_q95_kj"] >= arrived["energy_q50_kj"]).all()
    assert tables.paths.groupby("path")["s_m"].max().max() <= tables.blocks["furthest_m"].max() + 2


def test_a_profile_is_cut_from_terrain_in_memory() -> None:
    dem = (plane(), PLACE, "EPSG:2056")
    line = shapely.LineString([(WEST + 10.0, NORTH - 21.0), (WEST + 150.0, NORTH - 21.0)])
    drawn = sassgis.profile(line, dem=dem, blocks=BLOCK, n_blocks=5).along
    falls = sassgis.profile(dem=dem, point=(WEST + 10.0, NORTH - 21.0), blocks=BLOCK, n_blocks=5)
    assert drawn["to_m"].max() == pytest.approx(140.0)
    assert falls.along["to_m"].max() > 140.0


BAD = {
    "three bands": (
        {"dem": xr.DataArray(np.zeros((3, 9, 9)), dims=("band", "y", "x"))}, "one band of heights"
    ),
    "no coordinates": ({"dem": xr.DataArray(plane(), dims=("y", "x"))}, "has no coordinates"),
    "uneven": (
        {"dem": xr.DataArray(plane(), dims=("y", "x"),
                             coords={"y": np.arange(21.0) ** 2, "x": np.arange(90.0)})},
        "uneven steps of y",
    ),
    "scales by band": (
        {"dem": xr.DataArray(np.zeros((9, 9)), dims=("y", "x"), attrs={"scales": (1.0, 2.0)},
                             coords={"y": -np.arange(9.0), "x": np.arange(9.0)})},
        "dem: has scales that differ by band .*mask_and_scale=True",
    ),
    "scale in words": (
        {"dem": xr.DataArray(np.zeros((9, 9)), dims=("y", "x"), attrs={"scale_factor": "half"},
                             coords={"y": -np.arange(9.0), "x": np.arange(9.0)})},
        "dem: has a scale_factor or add_offset that is no number .*half",
    ),
    "no transform": (
        {"dem": (plane(), (2.0, 0.0, WEST), "EPSG:2056")},
        r"dem: has no affine transform \(found \(2.0, 0.0, .*expected Affine\(cell, ",
    ),
    "no system": (
        {"dem": (plane(), PLACE, None)},
        r"^dem \(in memory\): crs: has no coordinate system .*its system as crs, such as",
    ),
    "another system": (
        {"crs": "EPSG:21781"},
        r"of the file and of crs differ .*21781 as crs; .*terrain=\{\"override_crs\": True\}",
    ),
    "no areas": ({"release": None}, r"^release: missing "),
    "unknown rules": ({"rules": "xx", "ref_width_m": 4.0}, r"^rules: is not a known hazard preset"),
    "seed below 0": ({"seed": -1}, r"^seed: is out of range"),
    "a number": ({"dem": 7}, r"dem: cannot be used \(found int"),
    "a table of areas": (
        {"release": pd.DataFrame({"x": [1.0]})}, r"release .*cannot be used here .*a table"
    ),
    "a name of half a character": (
        {"release": {
            "file": RELEASE.assign(name=pd.Series(["\ud800"], dtype=object)), "name_field": "name",
        }},
        "feature 1: holds a character that cannot be shown",
    ),
    "elsewhere": (
        {"release": RELEASE.translate(1e5, 0.0)}, r"lies outside the DEM"
    ),
    "unknown class": ({"ground": "butter"}, "found 'butter'; expected one of"),
    "unknown key": ({"run": {"sed": 1}}, "run.sed: unknown key .*'seed'"),
    "unknown key of a block": ({"blocks": {"volume": 1.0}}, "unknown key .*volume_m3"),
    "blocks as a number": ({"blocks": 2}, r"blocks: cannot be used \(found 2; expected a mapping"),
    "jobs": ({"jobs": -1}, r"jobs: cannot be used \(found -1; expected a number of processor"),
    "jobs in words": ({"jobs": "2"}, r"jobs: cannot be used \(found '2'"),
    "no blocks": ({"blocks": None}, r"blocks: missing .*at least one mapping, as"),
    "reversed": ({"blocks": {"volume_m3": (2.0, 1.0)}}, "limits are reversed"),
    "width": ({"ref_width_m": 1.0}, "is narrower than a cell"),
}  # fmt: skip


def test_areas_have_the_names_of_their_column() -> None:
    areas = gpd.GeoDataFrame(
        {"name": ["north", "south"], "code": ["a", "b"]},
        geometry=[box(4, 5, 6, 8), box(14, 5, 6, 8)], crs="EPSG:2056",
    )  # fmt: skip
    dem = (plane(), PLACE, "EPSG:2056")
    for release, names in (
        (areas, ["north", "south"]),
        ({"file": areas, "name_field": "code"}, ["a", "b"]),
        # Names that do not tell areas apart name none.
        (areas.assign(name="north"), ["area 1", "area 2"]),
    ):
        ds = sassgis.simulate(
            dem, release, blocks=BLOCK, ground="talus", ref_width_m=4.0, jobs=1,
            run={"seed": 3}, output={"stop_points_max": 0},
        )  # fmt: skip
        assert ds["area"].values.tolist() == names


def test_a_dataset_draws_its_zones_in_the_colours_of_the_preset(maps: xr.Dataset) -> None:
    with pytest.raises(sassgis.InputError, match=r"^rules: is not a known hazard preset"):
        maps.sassgis.plot_zones("ch-xx")
    zones, preset = sassgis.zones(maps), read_preset("ch-so")
    axes = maps.sassgis.plot_zones(ax=Figure().subplots())
    drawn = {own.get_label(): own for own in axes.collections}
    assert set(drawn) == set(zones["hazard_level"]) and len(drawn) > 1
    for level in preset.levels:
        if level.code in drawn:
            own = drawn[level.code]
            colour = own.get_edgecolor() if level.hatched else own.get_facecolor()
            assert to_hex(colour[0]) == level.colour and bool(own.get_hatch()) == level.hatched
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    # The highest level first.
    order = [c.label for c in reversed(preset.levels)]
    assert texts == [label for label in order if label in texts] and len(texts) == len(drawn)


def test_no_parameter_of_a_public_function_takes_just_anything() -> None:
    functions = [own for own in map(sassgis.__getattr__, sassgis.__all__[1:]) if isfunction(own)]
    assert len(functions) > 12
    for own in functions:
        for parameter in signature(own).parameters.values():
            assert not re.search(r"\bAny\b", str(parameter.annotation)), (own.__name__, parameter)


def test_heights_stored_with_a_factor_are_those_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "dem.tif"
    stored = np.arange(12, dtype=np.int16).reshape(3, 4)
    with rasterio.open(
        file, "w", driver="GTiff", width=4, height=3, count=1, dtype="int16", nodata=0,
        transform=PLACE, crs="EPSG:2056",
    ) as raster:  # fmt: skip
        raster.write(stored, 1)
        raster.scales, raster.offsets = (0.5,), (1000.0,)
    expected = read_dem(file).values
    assert np.isnan(expected[0, 0]) and expected[0, 1] == 1000.5
    opened = [rioxarray.open_rasterio(file, masked=m, mask_and_scale=s) for m, s in
              ((False, False), (True, False), (True, True))]  # fmt: skip
    given = [as_input(array, "terrain.dem") for array in opened]
    for own in given:
        assert np.array_equal(read_dem(own).values, expected, equal_nan=True)
    other = as_input(opened[0].assign_attrs(add_offset=999.0), "terrain.dem")
    assert other.digest != given[0].digest


@pytest.mark.parametrize("changed,expected", BAD.values(), ids=BAD)
def test_what_cannot_be_used_is_one_line(changed: dict[str, Any], expected: str) -> None:
    dem = (plane(), PLACE, "EPSG:2056")
    plain = {"dem": dem, "release": RELEASE, "blocks": BLOCK, "ground": "talus"}
    given: dict[str, Any] = plain | {"jobs": 1} | changed
    with pytest.raises(sassgis.InputError, match=expected) as caught:
        sassgis.simulate(**given)
    assert "\n" not in str(caught.value)


def test_what_is_no_point_no_site_and_no_observation_is_one_line() -> None:
    point = (WEST + 10.0, NORTH - 21.0, 5.0)
    config = sassgis.sample_folder() / "valley" / "config.toml"
    wrong: dict[str, Any] = {
        r"point: is no point .*expected \(x, y\)": lambda: sassgis.profile(
            dem=(plane(), PLACE, "EPSG:2056"), point=point, blocks=BLOCK
        ),
        r"sites: cannot be used .*\(configuration, observations\)": lambda: sassgis.calibrate(
            "sassgis.toml"
        ),
        "observations: cannot be used .*found NoneType; expected a GeoPackage": (
            lambda: sassgis.diagnose(config, None)
        ),
    }
    for expected, call in wrong.items():
        with pytest.raises(sassgis.InputError, match=expected):
            call()


def test_settings_made_by_a_program_are_checked() -> None:
    made = sassgis.BlockSettings(name="b", volume_m3=2, shape=[1, (0.7, 0.9), 0.6])
    assert made.volume_m3 == (2.0, 2.0) and made.shape == ((1.0, 1.0), (0.7, 0.9), (0.6, 0.6))
    assert sassgis.TerrainSettings(dem="dem.tif").dem == Path("dem.tif")
    for wrong, expected in (
        ({"volume_m3": "2"}, "found '2'; expected a number, or two numbers"),
        ({"volume_m3": (1.0, 2.0, 3.0)}, "a number, or two numbers"),
        ({"volume_m3": 1.0, "volume_exponent": "steep"}, "expected a number"),
        ({"volume_m3": 1.0, "onset_unit": "per_day"}, "unknown choice"),
    ):
        with pytest.raises(sassgis.ConfigError, match=expected):
            sassgis.BlockSettings(name="b", **wrong)
    with pytest.raises(sassgis.ConfigError, match="expected a whole number"):
        sassgis.RunSettings(seed=1.5)  # type: ignore[arg-type]


def test_a_confidence_is_between_0_and_1(maps: xr.Dataset) -> None:
    with pytest.raises(sassgis.InputError, match=r"confidence: is out of range \(found 3"):
        sassgis.zones(maps, confidence=3)


def test_zones_say_what_the_dataset_lacks(maps: xr.Dataset, tmp_path: Path) -> None:
    unknown = maps.onset_frequency * np.nan
    for lacking, expected in (
        (maps.drop_vars(["arrivals", "arrivals_square"]), "no counts for zones .*ref_width_m=10"),
        (maps.assign(onset_frequency=unknown), "north / frequent has no onset frequency"),
        (maps.isel(x=slice(5, 40)), "is a part of a dataset"),
        (xr.Dataset(), "is no result of a simulation"),
        (None, "ds: is no result .*found NoneType"),
    ):
        with pytest.raises(sassgis.InputError, match=expected):
            sassgis.zones(lacking)
    text = (Path(sassgis.__file__).parent / "data" / "presets" / "ch-so.toml").read_text()
    (tmp_path / "own.toml").write_text(text.replace("from_kj = 300", "from_kj = 290"))
    with pytest.raises(sassgis.InputError, match="has no counts at 290 kJ"):
        sassgis.zones(maps, str(tmp_path / "own.toml"))


def test_one_scenario_without_a_frequency_leaves_all_open() -> None:
    ds = sassgis.simulate(
        (plane(), PLACE, "EPSG:2056"), RELEASE, blocks=RARE, ground="talus", ref_width_m=4.0,
        jobs=1,
    )  # fmt: skip
    assert np.isnan(ds.onset_frequency).all()
    assert len(sassgis.zones(ds.assign(onset_frequency=ds.onset_frequency.fillna(0.5)))) > 0
