"""An edit of any part of an input is one of the input, wherever it lies."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import rasterio
from affine import Affine
from helpers.input_files import LV95, NORTH, WEST, at
from helpers.one_line import one_line
from helpers.open_geopackage import moved_in_gis

from sassgis.errors import InputError
from sassgis.files.input_parts import file_digest, files_of
from sassgis.grid import Grid
from sassgis.inputs.dem import read_dem
from sassgis.inputs.vector_features import read_features
from sassgis.outputs.manifest import write_manifest

HEIGHTS = 1000.0 - np.arange(60.0).reshape(6, 10)
PLACE = Affine(10.0, 0.0, WEST, 0.0, -10.0, NORTH)
#: A raster or layer by its suffix, and files that GDAL reads with it.
BESIDE = {
    ".tif": (".tif.aux.xml", ".tif.msk", ".tif.MSK", ".tif.ovr", ".tif.msk.ovr", ".tif.ovr.msk",
             ".tif.aux", ".aux", ".tfw", ".TFW", ".tifw", ".wld", ".tab", ".tif.msk.aux.xml"),
    ".flt": (".hdr", ".HDR", ".prj", ".flt.aux.xml", ".flt.msk"),
    ".bil": (".hdr", ".prj", ".blw"),
    ".asc": (".prj", ".asc.aux.xml"),
    ".img": (".ige", ".rrd", ".img.aux.xml"),
    ".shp": (".dbf", ".DBF", ".shx", ".prj", ".cpg"),
    ".gpkg": (".gpkg-wal", ".gpkg-journal"),
}  # fmt: skip


def written(file: Path, values: Any = HEIGHTS, driver: str = "GTiff", **options: Any) -> Path:
    """A raster, or a mask for one."""
    mask = file.suffix.lower() == ".msk"
    with rasterio.open(
        file, "w", driver=driver, height=6, width=10, count=1, transform=PLACE, crs=LV95,
        dtype="uint8" if mask else "float32", **options,
    ) as out:  # fmt: skip
        out.write(np.asarray(values, out.dtypes[0]), 1)
        if mask:
            out.update_tags(INTERNAL_MASK_FLAGS_1=2)
    return file


def listed(file: Path, folder: Path) -> dict[str, str]:
    """Digests by name in the manifest of a result."""
    import json

    folder.mkdir(exist_ok=True)
    manifest = write_manifest(
        folder / "manifest.json", inputs={"it": file}, base=file.parent, crs="",
        vertical_datum="", seed=1, ref_widths_m={}, preset="", settings={}, counts={},
        warnings=(),
    )  # fmt: skip
    entries = json.loads(manifest.read_text())["inputs"]
    return {entry["path"]: entry["sha256"] for entry in entries}


@pytest.mark.parametrize(("suffix", "beside"), [(s, b) for s, all_ in BESIDE.items() for b in all_])
def test_every_part_counts_and_is_named(tmp_path: Path, suffix: str, beside: str) -> None:
    main, part = tmp_path / f"dem{suffix}", tmp_path / f"dem{beside}"
    main.write_bytes(b"main")
    # What lies beside a mask belongs to it.
    if ".msk." in beside or ".ovr." in beside:
        part.with_name(part.name.removesuffix(".aux.xml")).write_bytes(b"first")
        layer = main.with_name(f"{main.name}{'.msk' if '.msk.' in beside else '.ovr'}")
        layer.write_bytes(b"mask")
    alone = file_digest(main)
    seen = set()
    for content in (b"one", b"two"):
        part.write_bytes(content)
        seen.add(file_digest(main))
        wanted = hashlib.sha256(content).hexdigest()
        assert listed(main, tmp_path / "result")[part.name] == wanted
    assert len(seen) == 2 and alone not in seen


@pytest.mark.parametrize("beside", ["areas.gpkg-shm", "areas.dbf", "areas2.gpkg-wal"])
def test_what_is_no_part_does_not_count(tmp_path: Path, beside: str) -> None:
    main = tmp_path / "areas.gpkg"
    main.write_bytes(b"main")
    # What a GIS leaves as long as nothing is edited.
    (tmp_path / "areas.gpkg-wal").write_bytes(b"")
    alone = file_digest(main)
    (tmp_path / beside).write_bytes(b"other")
    assert file_digest(main) == alone and files_of(main) == [main]


def test_parts_of_tiles_count_in_a_mosaic_and_in_a_folder(tmp_path: Path) -> None:
    tiles = tmp_path / "tiles"
    tiles.mkdir()
    tile = written(tiles / "a.tif")
    mosaic = tmp_path / "all.vrt"
    mosaic.write_text(
        '<VRTDataset rasterXSize="10" rasterYSize="6"><VRTRasterBand dataType="Float32" band="1">'
        '<SimpleSource><SourceFilename relativeToVRT="1">tiles/a.tif</SourceFilename>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    (tiles / "lists.tif").write_text(mosaic.read_text().replace("tiles/a.tif", "../far.tif"))
    written(tmp_path / "far.tif")
    before = [file_digest(one) for one in (mosaic, tiles)]
    written(tiles / "a.tif.msk", np.zeros((6, 10)))
    after = [file_digest(one) for one in (mosaic, tiles)]
    assert before[0] != after[0] and before[1] != after[1]
    assert [f.name for f in files_of(mosaic)] == ["all.vrt", "a.tif", "a.tif.msk"]
    # A tile of a folder may show one that lies elsewhere.
    written(tmp_path / "far.tif", HEIGHTS + 1.0)
    assert file_digest(tiles) != after[1]
    assert tile in files_of(tiles)


def test_tables_of_a_folder_are_known_by_their_names(tmp_path: Path) -> None:
    (tmp_path / "deposits.csv").write_text("rock_id\n1\n")
    before = file_digest(tmp_path)
    (tmp_path / "deposits.csv").rename(tmp_path / "passages.csv")
    assert file_digest(tmp_path) != before


def test_an_edit_in_an_open_gis_is_another_input(tmp_path, make_layer):
    """Also in a process that has read the layer before, as a notebook does."""
    file = make_layer([at(10, 10, 40, 30)])
    grid = Grid(np.zeros((20, 20)), WEST, NORTH, 10.0, pyproj.CRS.from_user_input(LV95).to_wkt())

    def area() -> float:
        return float(read_features(file, grid, "release")[0].geometry.area)

    assert area() == 600.0
    first, entries = file_digest(file), listed(file, tmp_path / "a")
    for moved, m2 in ((at(10, 10, 40, 20), 300.0), (at(50, 50, 100, 100), 2500.0)):
        with moved_in_gis(file, moved):
            own = file.read_bytes()
            assert area() == m2
            assert file_digest(file) != first
            assert set(listed(file, tmp_path / "a")) == {file.name, f"{file.name}-wal"}
            assert file.read_bytes() == own
        assert area() == m2
    assert listed(file, tmp_path / "a") != entries


def test_a_raster_that_names_its_heights_elsewhere_is_refused(tmp_path: Path) -> None:
    """GDAL would read them, and no digest would tell them from others."""
    written(tmp_path / "dem.img", driver="HFA", USE_SPILL="YES")
    assert np.array_equal(read_dem(tmp_path / "dem.img").values, HEIGHTS)
    (tmp_path / "dem.img").rename(tmp_path / "other.img")
    with one_line(InputError, "other.img", match=r"dem\.ige.*other\.ige"):
        read_dem(tmp_path / "other.img")
    (tmp_path / "dem.ige").rename(tmp_path / "other.ige")
    assert np.array_equal(read_dem(tmp_path / "other.img").values, HEIGHTS)


@pytest.mark.parametrize("beside", ["dem.prj", "dem.tif.msk", "dem.tfw"])
def test_a_pipe_beside_an_input_is_not_waited_for(tmp_path: Path, beside: str) -> None:
    file = written(tmp_path / "dem.tif")
    os.mkfifo(tmp_path / beside)
    with one_line(InputError, beside, match="a pipe or a device"):
        read_dem(file)
    with one_line(InputError, beside, match="a pipe or a device"):
        file_digest(file)
