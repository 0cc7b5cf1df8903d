"""Release areas proposed from a terrain of known units."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pyogrio
import pytest
import shapely
from helpers.small_slope import CELL, NORTH, WEST, Slope

from sassgis.inputs.config import load_config
from sassgis.inputs.site_layers import start_keys
from sassgis.inputs.tiles import read_terrain
from sassgis.inputs.vectors import read_release
from sassgis.outputs.config_template import short_template

ROWS, COLS = 60, 160
#: Columns of the cliff, and of an outcrop on the slope.
CLIFF, OUTCROP = (100, 112), (40, 60)


def heights() -> np.ndarray:
    """A plain, a slope of 34 degrees, a cliff of 62 degrees and the slope again, with dents."""
    rng = np.random.default_rng(5)
    angles = np.repeat([5.0, 34.0, 62.0, 34.0], [30, 70, 12, 48]) + rng.normal(0.0, 2.0, COLS)
    drop = np.concatenate([[0.0], np.cumsum(CELL * np.tan(np.radians(angles)))[:-1]])
    return 1800.0 - drop[None, :] + rng.normal(0.0, 0.05, (ROWS, COLS))


def strip(first: int, last: int, north: int = 0, south: int = ROWS) -> shapely.Polygon:
    return shapely.box(
        WEST + CELL * first, NORTH - CELL * south, WEST + CELL * last, NORTH - CELL * north
    )


@pytest.fixture
def dem(tmp_path: Path) -> Path:
    Slope(tmp_path).write_dem(heights())
    return tmp_path / "dem.tif"


def test_the_cliff_is_proposed_and_goes_straight_into_a_run(dem: Path, printed) -> None:
    out = dem.parent / "release.gpkg"
    said = printed("cliffs", dem, "-o", out)
    assert "proposed        1 areas" in said and "WARNING" not in said
    proposed = gpd.read_file(out, layer="release_areas")
    cliff = strip(*CLIFF)
    overlap = proposed.geometry[0].intersection(cliff).area
    assert overlap > 0.8 * cliff.area and overlap > 0.9 * proposed.geometry[0].area
    row = proposed.iloc[0]
    assert row["area_m2"] == pytest.approx(proposed.geometry[0].area)
    assert row["slope_mean_deg"] == pytest.approx(62.0, abs=3.0)
    assert row["surface_m2"] == pytest.approx(row["area_m2"] / np.cos(np.radians(62.0)), rel=0.1)
    assert row["height_m"] == pytest.approx(11 * CELL * np.tan(np.radians(62.0)), rel=0.2)
    facts = pyogrio.read_dataframe(out, layer="run_metadata").set_index("key")["value"]
    assert 40.0 < float(facts["threshold_deg"]) < 55.0 and "mean 6" in facts["cliffs"]

    config = dem.parent / "sassgis.toml"
    config.write_text(short_template(start_keys(dem.parent, dem, out)))
    settings = load_config(config)
    areas = read_release(settings.release, read_terrain(dem), settings.block_names)
    assert [a.name for a in areas] == ["cliff 1"]


def test_mapped_rock_on_the_slope_is_proposed_too(dem: Path, printed) -> None:
    ground = dem.parent / "ground.gpkg"
    shapes = [strip(*OUTCROP, 20, 40), strip(5, 15)]
    gpd.GeoDataFrame({"class": ["rock", "rock"]}, geometry=shapes, crs="EPSG:2056").to_file(ground)
    out = dem.parent / "release.gpkg"
    printed("cliffs", dem, "-o", out, "--ground", ground)
    proposed = gpd.read_file(out, layer="release_areas")
    # The rock in the plain is no source.
    assert proposed["rock_share"].round().tolist() == [0.0, 1.0]
    outcrop = proposed.geometry[1]
    assert outcrop.intersection(shapes[0]).area == pytest.approx(shapes[0].area, rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--threshold", "80"], ["dem.tif", "no release area", "80.0 degrees"]),
        (["--min-area", "1e6"], ["dem.tif", "no release area"]),
        (["--ground", "no.gpkg"], ["no.gpkg", "not found"]),
    ],
)
def test_errors_are_one_line_and_leave_nothing(dem: Path, refusal, arguments, words) -> None:
    out = dem.parent / "release.gpkg"
    err = refusal("cliffs", dem, "-o", out, *arguments)
    assert all(word in err for word in words), err
    assert [p.name for p in dem.parent.iterdir()] == ["dem.tif"]


def test_a_low_threshold_is_warned_of(dem: Path, printed) -> None:
    said = printed("cliffs", dem, "-o", dem.parent / "r.gpkg", "--threshold", "30")
    assert "may be debris" in said
