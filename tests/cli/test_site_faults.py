"""Terrain and layers with faults of their coordinate system, before there is a configuration."""

from __future__ import annotations

import unicodedata

import geopandas as gpd
import numpy as np
import pytest
from helpers.small_slope import ROWS, Slope, heights, release_box

from sassgis.inputs.config import load_config


@pytest.mark.parametrize("command", [("cliffs", "{dem}", "-o"), ("new", "--dem", "{dem}")])
def test_commands_without_a_configuration_ask_for_their_option(
    slope: Slope, call, refusal, command
) -> None:
    slope.write_dem(heights(), crs=None)
    words = [w.format(dem=slope.folder / "dem.tif") for w in command]
    words.append(str(slope.folder / "new.gpkg"))
    err = refusal(*words)
    assert "expected its system as --crs" in err and "configuration" not in err
    assert not (slope.folder / "new.gpkg").exists()
    assert "coordinate system" not in call(*words, "--crs", "EPSG:2056")[2]


def test_a_wrong_system_is_overridden_by_option_and_by_setting(
    slope: Slope, call, printed, refusal
) -> None:
    slope.write_dem(heights(), crs="EPSG:4326")
    dem, site = slope.folder / "dem.tif", slope.folder / "site.gpkg"
    code, out, _ = call("dem", "check", dem)
    assert code == 1
    assert "--crs with --override-crs" in out
    # Nothing is said of cells of hundreds of kilometres.
    assert "cells of 2 x 2 m" in out and "taken as metres" in out and "e+" not in out
    refusal("new", site, "--dem", dem, "--crs", "EPSG:2056")
    printed("new", site, "--dem", dem, "--crs", "EPSG:2056", "--override-crs")
    slope.write_config(terrain__crs='"EPSG:2056"')
    assert "terrain.override_crs as well" in refusal("validate", slope.config)
    slope.write_config(terrain__crs='"EPSG:2056"', terrain__override_crs="true")
    printed("validate", slope.config)
    slope.write_config(terrain__override_crs="true")
    assert "terrain.crs as well" in refusal("validate", slope.config)


def test_init_takes_the_system_of_the_release_areas(slope: Slope, printed) -> None:
    slope.write_dem(heights(), crs=None)
    new, files = slope.folder / "new.toml", ("--dem", slope.folder / "dem.tif", "--release")
    out = printed("init", new, *files, slope.folder / "release.gpkg")
    assert "terrain.crs: EPSG:2056, from" in out
    assert load_config(new).terrain.crs == "EPSG:2056"
    printed("validate", new)


def test_init_writes_nothing_that_validate_would_refuse(slope: Slope, printed, refusal) -> None:
    new = slope.folder / "new.toml"
    release = gpd.read_file(slope.folder / "release.gpkg")
    release.set_crs(None, allow_override=True).to_file(slope.folder / "bare.shp")
    slope.write_dem(heights(), crs=None)
    dem = slope.folder / "dem.tif"
    # No file states a system; it can be set.
    err = refusal("init", new, "--dem", dem, "--release", slope.folder / "bare.shp")
    assert "has no coordinate system" in err and not new.exists()
    told = ("--set", "terrain.crs=EPSG:2056")
    printed("init", new, "--dem", dem, "--release", slope.folder / "bare.shp", *told)
    # Areas that lie elsewhere.
    slope.write_dem(heights())
    release.translate(1e5, 0.0).to_file(slope.folder / "far.gpkg")
    other = slope.folder / "other.toml"
    err = refusal("init", other, "--dem", dem, "--release", slope.folder / "far.gpkg")
    assert "lies outside the DEM" in err and not other.exists()


def test_a_broken_prj_is_named(slope: Slope, call, printed) -> None:
    gpd.read_file(slope.folder / "release.gpkg").to_file(slope.folder / "areas.shp")
    (slope.folder / "areas.prj").write_text("GARBAGE[")
    dem = slope.folder / "dem.tif"
    new = slope.folder / "new.toml"
    code, _, err = call("init", new, "--dem", dem, "--release", slope.folder / "areas.shp")
    assert code == 0 and "areas.prj states no coordinate system that is understood" in err
    rows = "\n".join(" ".join(f"{v:.2f}" for v in row) for row in heights())
    (slope.folder / "plain.asc").write_text(
        f"ncols 70\nnrows {ROWS}\nxllcorner 2700000\nyllcorner 1149900\ncellsize 2\n{rows}\n"
    )
    (slope.folder / "plain.prj").write_text("GARBAGE[")
    code, out, _ = call("dem", "check", slope.folder / "plain.asc")
    assert code == 1
    assert "plain.prj, which states none that is understood" in out


def test_what_the_readers_notice_is_said_by_a_run(slope: Slope, call) -> None:
    """The command line keeps its log quiet, and collects what is in it all the same."""
    slope.write_release(release_box(col=-2.0))
    code, _, err = call("run", slope.config, "-o", slope.folder / "out", "--jobs", "1")
    assert code == 0 and "of it lies outside the DEM; no block starts there" in err
    report = (slope.folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "of it lies outside the DEM; no block starts there" in report


def test_one_name_in_two_unicode_forms(slope: Slope, printed, refusal) -> None:
    """A Mac writes ö as o and dots: areas, scenarios, classes, columns and layers are the same."""

    def as_mac(text: str) -> str:
        return unicodedata.normalize("NFD", text)

    ground_class, site = "Geröll", slope.folder / "site.gpkg"
    for layer, columns in (
        ("Fläche", {as_mac("Höhe"): [as_mac("Rötiflue")], "block": ["blöcke"]}),
        (as_mac("Böden"), {"class": [as_mac(ground_class)]}),
    ):
        gpd.GeoDataFrame(columns, geometry=[release_box()], crs=2056).to_file(site, layer=layer)
    (slope.folder / "onset.csv").write_text(
        f"area,scenario,frequency,unit\nRötiflue,{as_mac('blöcke')},0.1,per_year\n"
    )
    table = "eta_max,dp_min,dp_max,mu_f,mu_0,k,d_star_m,restitution,restitution_speed_mps"
    (slope.folder / "classes.csv").write_text(
        f"name,{table},rolling_threshold\n{ground_class},.5,0,.1,.8,.5,.2,.4,.3,9,.1\n"
    )
    written = {
        "release__file": '"site.gpkg"', "release__layer": as_mac('"Fläche"'),
        "release__name_field": '"Höhe"', "release__scenario_field": '"block"',
        "ground__file": '"site.gpkg"', "ground__layer": '"Böden"',
        "ground__classes": '"classes.csv"', "blocks__name": as_mac('"blöcke"'),
        "hazard__frequencies": '"onset.csv"', "hazard__ref_width_m": "10",
    }  # fmt: skip
    slope.write_config(**written)
    out = printed("validate", slope.config)
    assert "ready for      zone" in out and f"ground         {ground_class}" in out
    words = ("run", slope.config, "-o", slope.folder / "out", "--area", as_mac("Rötiflue"))
    printed(*words)
    # Two areas of one name are no two areas.
    names = ["Rötiflue", as_mac("Rötiflue")]
    frame = gpd.GeoDataFrame({"name": names}, geometry=[release_box()] * 2, crs=2056)
    frame.to_file(slope.folder / "release.gpkg")
    slope.write_config()
    assert "name is used twice" in refusal("validate", slope.config)


def test_the_encoding_of_a_shapefile(slope: Slope, printed, refusal) -> None:
    areas = gpd.GeoDataFrame({"name": ["Rötiflue"]}, geometry=[release_box()], crs=2056)
    areas.to_file(slope.folder / "areas.shp", encoding="UTF-8")
    slope.write_config(release__file='"areas.shp"')
    stated = slope.folder / "areas.cpg"
    stated.write_text("ISO-8859-1")
    assert "areas.cpg: states another encoding" in refusal("validate", slope.config)
    stated.unlink()
    assert "release area   Rötiflue" in printed("validate", slope.config)


def test_wrong_columns_of_a_survey_are_not_offered_again(slope: Slope, refusal) -> None:
    survey = slope.folder / "blocks.csv"
    survey.write_text("volume,who\n1,a\n")
    err = refusal("frequency", survey, "--complete-from", "0.1", "--years", "10")
    assert "missing column (found volume, who; expected volume_m3, or from_m3" in err


def test_a_map_of_zones_is_no_terrain(slope: Slope, call) -> None:
    slope.write_dem(np.repeat([0.0, 1.0, 2.0, 4.0, 4.0], ROWS // 5)[:, None] * np.ones((1, 70)))
    code, out, _ = call("dem", "check", slope.folder / "dem.tif")
    assert code == 1
    assert "a map of classes, such as zones" in out and "hillshade" not in out


def test_classes_of_the_paper_say_what_it_leaves_open(slope: Slope, printed) -> None:
    slope.write_config(engine__readings='"1986"')
    out = printed("validate", slope.config)
    assert "debris, on 100.0 % of the cells: from a paper, what it leaves open chosen" in out
