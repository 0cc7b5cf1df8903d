"""The wheel holds what the package needs, and the demo runs from it outside the checkout."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio
from helpers.installed import Installed, done_in

pytestmark = [pytest.mark.e2e, pytest.mark.battery]


def test_the_package_is_whole_and_nothing_else_is_in_the_wheel(
    wheel: Path, repository: Path
) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    package = repository / "sassgis"
    expected = {
        f"sassgis/{p.relative_to(package).as_posix()}"
        for p in package.rglob("*")
        if p.is_file() and "__pycache__" not in p.parts
    }
    assert "sassgis/py.typed" in expected
    assert expected <= names
    rest = {n for n in names - expected if not n.startswith("sassgis/data/sample_dem/")}
    assert {Path(n).parts[0].rpartition(".")[2] for n in rest} == {"dist-info"}


def test_the_installed_package_is_the_one_that_is_used(installed: Installed, demo: Path) -> None:
    done = done_in(demo.parent, installed.python, "-c", "import sassgis; print(sassgis.__file__)")
    assert Path(done.stdout.strip()).is_relative_to(installed.folder)


def test_the_wheel_gives_the_files_of_the_sample(installed: Installed, tmp_path: Path) -> None:
    done_in(tmp_path, installed.sassgis, "sample")
    done_in(tmp_path, installed.sassgis, "validate", "sample_dem/valley/config.toml")


def test_the_demo_is_whole(demo: Path) -> None:
    for pattern in (
        "maps/*.tif", "maps/*.qml", "*.gpkg", "tables/*.csv", "figures/*.png", "*.qgz",
        "report.html", "manifest.json",
    ):  # fmt: skip
        found = list(demo.glob(pattern))
        assert found and all(p.stat().st_size for p in found), pattern
    names = {p.name for p in demo.glob("maps/*.tif")} | {p.name for p in demo.glob("*.gpkg")}
    assert {"hazard_level.tif", "hazard.gpkg", "result.gpkg"} <= names


def test_every_raster_of_the_demo_has_values_and_a_coordinate_system(demo: Path) -> None:
    for path in demo.rglob("*.tif"):
        with rasterio.open(path) as raster:
            assert raster.crs is not None, path
            values = raster.read(1, masked=True).compressed()
        assert np.isfinite(values).any(), path


def test_the_layers_that_the_demo_is_for_have_rows(demo: Path) -> None:
    filled = set()
    for path in demo.glob("*.gpkg"):
        for name, _ in pyogrio.list_layers(path):
            if pyogrio.read_info(path, layer=name)["features"]:
                filled.add(name)
    assert filled >= {
        "hazard_zones", "risk_objects", "risk_lines", "hazard_area", "release_areas", "barriers",
    }  # fmt: skip
