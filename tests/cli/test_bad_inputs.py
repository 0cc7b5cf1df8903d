"""Bad input: one clear line that names file and field, no traceback, nothing half written."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
from helpers.small_slope import Slope, heights, release_box
from rasterio.transform import from_origin

from sassgis.errors import InputError

OWN = "own,{},0.1,0.2,0.5,0.4,1,0.1,0,9,0.1,me,estimate"
CLASSES = (
    "name,eta_max,dp_min,dp_max,mu_f,mu_0,k,d_star_m,restitution,restitution_speed_mps,"
    "rolling_threshold,source,trust\n"
)


def hole(slope: Slope) -> None:
    values = heights()
    values[10:25, :12] = np.nan
    slope.write_dem(values)


def config(**changes: str) -> Callable[[Slope], None]:
    return lambda slope: slope.write_config(**changes)


def dem(**options: object) -> Callable[[Slope], None]:
    return lambda slope: slope.write_dem(heights(), **options)


def classes(row: str) -> Callable[[Slope], None]:
    def spoil(slope: Slope) -> None:
        (slope.folder / "classes.csv").write_text(CLASSES + row + "\n")
        slope.write_config(ground__classes='"classes.csv"', ground__default='"own"')

    return spoil


def removed(name: str) -> Callable[[Slope], None]:
    return lambda slope: (slope.folder / name).unlink()


def written(text: str, name: str = "config.toml", key: str = "") -> Callable[[Slope], None]:
    """A file of that content; a text for the configuration stands below what is there."""

    def spoil(slope: Slope) -> None:
        if key:
            slope.write_config(**{key: f'"{name}"'})
        file = slope.folder / name
        before = slope.config.read_bytes() if file == slope.config else b""
        file.write_bytes(before + text.encode())

    return spoil


def areas(name: str) -> Callable[[Slope], None]:
    def spoil(slope: Slope) -> None:
        frame = gpd.read_file(slope.folder / "release.gpkg")
        frame["name"] = name
        frame.to_file(slope.folder / "release.gpkg", driver="GPKG")

    return spoil


def pipe(name: str) -> Callable[[Slope], None]:
    def spoil(slope: Slope) -> None:
        (slope.folder / name).unlink()
        os.mkfifo(slope.folder / name)

    return spoil


def folder(slope: Slope) -> None:
    slope.config.unlink()
    slope.config.mkdir()


#: A station in each of so many sections.
STATIONS = "".join(f'[[stations]]\nname = "{i % 20_000}"\nchainage_m = 1\n' for i in range(20_001))
#: Bytes of a file elsewhere as heights.
RAW = (
    '<VRTDataset rasterXSize="9" rasterYSize="9"><GeoTransform>0,1,0,9,0,-1</GeoTransform>'
    '<VRTRasterBand dataType="Byte" band="1" subClass="VRTRawRasterBand"><SourceFilename>'
    "/etc/services</SourceFilename></VRTRasterBand></VRTDataset>"
)
DEGREES = from_origin(8.7, 46.5, 2e-5, 2e-5)

#: Name: what spoils the slope, the file (or key) that the line must name, words that it must hold.
BAD = {
    "geographic CRS": (dem(crs="EPSG:4326", transform=DEGREES), "dem.tif", ["degrees"]),
    "no CRS": (dem(crs=None), "dem.tif", ["terrain.crs", "coordinate system"]),
    "nodata under the release": (hole, "release.gpkg", ["area a", "nodata"]),
    "release outside": (
        lambda slope: slope.write_release(release_box(col=500.0)),
        "release.gpkg", ["area a", "outside the DEM", "2700000"],
    ),
    "unknown ground": (
        config(ground__default='"debri"'), "config.toml", ["ground.default", "debri"]
    ),
    "eta negative": (classes(OWN.format(-0.1)), "classes.csv", ["eta_max", "-0.1"]),
    "axes reversed": (config(blocks__axis_1_m="[0.9, 0.5]"), "config.toml", ["axis_1_m", "0.9"]),
    "axes zero": (config(blocks__axis_2_m="0.0"), "config.toml", ["axis_2_m", "above 0"]),
    "no configuration": (removed("config.toml"), "config.toml", ["file not found"]),
    "no DEM": (removed("dem.tif"), "dem.tif", ["terrain.dem", "file not found", "expected"]),
    "no release": (removed("release.gpkg"), "release.gpkg", ["release.file", "not found"]),
    "DEM is made of another file": (written(RAW, "dem.tif"), "dem.tif", ["VRTRawRasterBand"]),
    "DEM is a pipe": (pipe("dem.tif"), "dem.tif", ["terrain.dem", "no file", "pipe"]),
    "release is a pipe": (pipe("release.gpkg"), "release.gpkg", ["release.file", "pipe"]),
    "configuration is a pipe": (pipe("config.toml"), "config.toml", ["no file", "pipe"]),
    "configuration is a folder": (folder, "config.toml", ["no file", "folder"]),
    "configuration without end": (
        written("#" * 3_000_000), "config.toml", ["too large", "3 MB", "2 MB"]
    ),
    "nested lists": (
        written("[project]\nname = " + "[" * 20_000 + "]" * 20_000), "config.toml", ["nested"]
    ),
    "nested tables": (
        written("[project]\nname = " + "{a = " * 9000 + "1" + "}" * 9000), "config.toml", ["nested"]
    ),
    "a number of many digits": (
        config(release__spacing_m="9" * 100_000), "config.toml", ["thousands of digits"]
    ),
    "a huge exponent": (config(release__spacing_m="1e999999"), "config.toml", ["spacing_m", "inf"]),
    "no such day": (config(project__date='"2026-02-30"'), "config.toml", ["project.date"]),
    "many stations": (written(STATIONS), "config.toml", ["used twice", "'0'"]),
    "NUL in a title": (
        config(project__name='"a\\u0000b"'), "config.toml", ["project.name", r"\\x00"]
    ),
    "NUL in a path": (config(terrain__dem='"a\\u0000b"'), "config.toml", ["dem", r"\\x00"]),
    "a path of 300 characters": (
        config(release__file=f'"{"n" * 300}"'), "config.toml", ["release.file", "too long"]
    ),
    "a path of a home that is none": (config(terrain__dem='"~n0b0dy/x"'), "~n0b0dy", ["not found"]),
    "an area of 5,000 characters": (
        areas("n" * 5000),
        "release.gpkg", ["layer release, name", "feature 1", "5000 characters", "1000"],
    ),
    "NUL in a class": (
        classes(OWN.format(0.5).replace("own", "a\0b")), "classes.csv", ["row 2", r"\\x00"]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_one_line_and_no_result(slope: Slope, refusal, name: str) -> None:
    spoil, file, words = BAD[name]
    spoil(slope)
    out = slope.folder / "result"
    line = refusal("run", slope.config, "-o", out)
    assert file in line
    for word in words:
        assert re.search(word, line, re.IGNORECASE), (word, line)
    assert not out.exists() and not list(slope.folder.glob("*.partial"))
    # The check beforehand says the same.
    assert refusal("validate", slope.config) == line


@pytest.mark.parametrize("name", ["no DEM", "axes reversed"])
def test_debug_shows_the_traceback(slope: Slope, call, name: str) -> None:
    BAD[name][0](slope)
    for arguments in (("--debug", "validate", slope.config), ("validate", slope.config, "--debug")):
        code, _, err = call(*arguments)
        assert code == 2 and "Traceback (most recent call last)" in err
        assert err.splitlines()[-1].startswith("Error: ")


def test_a_flat_release_area_draws_a_warning_and_gives_an_honest_result(
    slope: Slope, call, printed
) -> None:
    slope.write_release(release_box(col=60.0))
    out = printed("validate", slope.config)
    assert "WARNING" in out and "area a" in out and "0.0 degrees" in out
    code, _, err = call("run", slope.config, "-o", slope.folder / "result")
    assert code == 0
    assert "degrees" in err and ("never started" in err or "not simulated" in err)


def test_a_result_that_is_there_is_not_replaced(slope: Slope, refusal) -> None:
    out = slope.folder / "mine"
    out.mkdir()
    (out / "letter.txt").write_text("dear")
    for more in ((), ("--overwrite",)):
        assert str(out) in refusal("run", slope.config, "-o", out, *more, code=3)
    assert [p.name for p in out.iterdir()] == ["letter.txt"]
    before = slope.config.read_text()
    assert f"{slope.config}: exists" in refusal("init", slope.config, code=3)
    assert slope.config.read_text() == before
    refusal("init", slope.config / "folder.toml", code=3)


def test_usage_errors_are_one_line_too(slope: Slope, refusal) -> None:
    for arguments in (
        ("run", slope.config), ("rn",), ("run", slope.config, "-o", "x", "--jobs", "-1"),
        ("run", slope.config, "-o", "x", "--seed", "a"),
        ("run", slope.config, "-o", "x", "--jobs", "1", "--workers", "2"),
        ("zone", slope.config, "-o", "x", "--workers", "1", "--scheduler", "tcp://127.0.0.1:9"),
        ("profile", slope.config, "-o", "x", "--csv", "a", "--point", "1", "2"),
        ("profile", slope.config, "-o", "x", "--line", "a", "--point", "1", "2"),
        ("init", slope.folder / "new.toml", "--set", "release.spacing=5"),
    ):  # fmt: skip
        refusal(*arguments)
    err = refusal("run", slope.config, "-o", slope.folder / "x", "--area", "area b")
    assert "area b" in err and "area a" in err


@pytest.mark.parametrize("more", [(), ("--overwrite",)])
def test_the_root_of_the_disk_is_no_result(slope: Slope, refusal, more: tuple[str, ...]) -> None:
    for command, code in ((("run", slope.config, "-o"), 3), (("demo", "-o"), 3), (("new",), 2)):
        assert refusal(*command, "/", *more, code=code).startswith("Error: /: ")


@pytest.mark.parametrize(
    ("option", "exit_code"), [("validate", 2), ("dem check", 2), ("batch", 2), ("init", 3)]
)
def test_a_path_that_no_system_takes(refusal, option: str, exit_code: int, tmp_path: Path) -> None:
    """A file that is read, or one that is written."""
    more = ["-o", "x"] if option == "batch" else []
    err = refusal(*option.split(), tmp_path / ("n" * 300), *more, code=exit_code)
    assert re.search("(name|path is) too long", err)


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are Unicode there")
def test_a_name_that_is_not_utf_8(slope: Slope, refusal, monkeypatch: pytest.MonkeyPatch) -> None:
    """GDAL, SQLite, XML and JSON take no such name: said before anything is computed."""
    odd = slope.folder / os.fsdecode(b"caf\xe9")
    odd.mkdir()
    for file in ("config.toml", "dem.tif", "release.gpkg"):
        shutil.copy(slope.folder / file, odd)
    before = sorted(slope.folder.rglob("*"))
    for command in (
        ("zone", odd / "config.toml", "-o", slope.folder / "out"),
        ("dem", "check", odd / "dem.tif"),
    ):
        assert "is not UTF-8" in refusal(*command)
    for command in (
        ("zone", slope.config, "-o", odd / "out"),
        ("gap", "template", odd / "observed.gpkg"),
    ):
        assert "is not UTF-8" in refusal(*command, code=3)
    monkeypatch.chdir(odd)
    assert "is not UTF-8" in refusal("validate", "config.toml")
    assert sorted(slope.folder.rglob("*")) == before


def test_a_message_is_short_and_steers_no_terminal() -> None:
    error = InputError("a\x1b[2J", file="f" * 9000, found="\u202e\n" + "b" * 9000, expected="c")
    text = str(error)
    assert len(text) < 1500 and text.isprintable() and text.endswith("expected c)")
