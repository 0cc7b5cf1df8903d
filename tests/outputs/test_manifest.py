"""The manifest tells what went in and what came out, and nothing of the machine."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sassgis
from sassgis.errors import InputError
from sassgis.files.digests import json_digest
from sassgis.outputs.manifest import plain, write_manifest
from sassgis.settings.settings import EngineSettings


def write(folder: Path, inputs: dict[str, Path]) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "inputs": inputs, "base": folder / "project", "crs": "EPSG:2056", "seed": 42,
        "vertical_datum": "LN02", "ref_widths_m": {"reach_probability": 3.0}, "preset": "",
        "settings": {"engine": EngineSettings()}, "counts": {"rocks": np.int64(500)},
        "warnings": ["two points lie outside the DEM"],
    }  # fmt: skip
    path = write_manifest(folder / "out" / "manifest.json", **facts)
    return json.loads(path.read_text(encoding="utf-8"))  # type: ignore[no-any-return]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "project").mkdir()
    (tmp_path / "data").mkdir()
    (tmp_path / "out" / "maps").mkdir(parents=True)
    (tmp_path / "out" / "maps" / "a.tif").write_bytes(b"map")
    (tmp_path / "out" / "checkpoint").mkdir()
    (tmp_path / "out" / "checkpoint" / "x.npy").write_bytes(b"state")
    (tmp_path / "out" / ".sassgis-partial").touch()
    (tmp_path / "data" / "dem.tif").write_bytes(b"dem")
    for suffix in (".shp", ".dbf", ".shx", ".prj"):
        (tmp_path / "data" / f"release{suffix}").write_bytes(suffix.encode())
    return tmp_path


def test_content(place: Path) -> None:
    content = write(place, {"dem": place / "data" / "dem.tif"})
    assert content["sassgis"] == sassgis.__version__
    digest = hashlib.sha256(b"dem").hexdigest()
    (dem,) = content["inputs"]
    assert dem == {"role": "dem", "path": "../data/dem.tif", "size": 3, "sha256": digest}
    assert content["files"] == [
        {"path": "maps/a.tif", "size": 3, "sha256": hashlib.sha256(b"map").hexdigest()}
    ]
    assert content["versions"]["numpy"] == np.__version__
    assert {"python", "platform", "numba", "geopandas", "gdal (rasterio)"} <= set(
        content["versions"]
    )
    assert (content["seed"], content["ref_widths_m"]) == (42, {"reach_probability": 3.0})
    assert (content["crs"], content["vertical_datum"]) == ("EPSG:2056", "LN02")
    assert content["counts"] == {"rocks": 500}
    assert content["warnings"] == ["two points lie outside the DEM"]
    assert content["settings"]["engine"]["gravity_mps2"] == 9.81
    # No path of the machine; equal runs have equal manifests.
    assert str(place) not in (place / "out" / "manifest.json").read_text()
    assert write(place, {"dem": place / "data" / "dem.tif"}) == content
    assert content["settings_sha256"] == json_digest(plain({"engine": EngineSettings()}))


def test_sidecars_and_the_tiles_of_a_virtual_raster_are_inputs(place: Path) -> None:
    content = write(place, {"release": place / "data" / "release.shp"})
    suffixes = [entry["path"].rsplit(".")[-1] for entry in content["inputs"]]
    assert suffixes == ["shp", "dbf", "prj", "shx"]
    (place / "data" / "tiles").mkdir()
    names = ("b.tif", "a.tif", "b.tif")
    sources = "".join(
        f'<SourceFilename relativeToVRT="1">tiles/{name}</SourceFilename>' for name in names
    )
    (place / "data" / "dem.vrt").write_text(f"<VRTDataset>{sources}</VRTDataset>")
    for name in names:
        (place / "data" / "tiles" / name).write_bytes(b"II*\0" + name.encode())
    content = write(place, {"dem": place / "data" / "dem.vrt"})
    found = {entry["path"]: entry["sha256"] for entry in content["inputs"]}
    assert list(found) == ["../data/dem.vrt", "../data/tiles/b.tif", "../data/tiles/a.tif"]
    assert found["../data/tiles/a.tif"] == hashlib.sha256(b"II*\0a.tif").hexdigest()
    assert len(content["inputs"]) == 3


def test_an_input_that_went_away(place: Path) -> None:
    with pytest.raises(InputError, match=r"\.\./data/gone\.tif: cannot be read"):
        write(place, {"dem": place / "data" / "gone.tif"})


class Colour(Enum):
    RED = 1


@dataclass(frozen=True)
class Nested:
    limit: float
    folder: Path
    colour: Colour


def test_plain_values() -> None:
    nested = Nested(math.inf, Path("a") / "b", Colour.RED)
    assert plain({"n": nested, "a": np.arange(2), "t": (1, None, True)}) == {
        "n": {"limit": "inf", "folder": "a/b", "colour": "red"},
        "a": [0, 1],
        "t": [1, None, True],
    }
    with pytest.raises(TypeError, match="object"):
        plain(object())
