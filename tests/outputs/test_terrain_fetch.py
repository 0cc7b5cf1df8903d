"""Tiles from a STAC interface on this machine: listed, fetched, resumed, put together."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import geopandas as gpd
import numpy as np
import pyproj
import pytest
import rasterio
import shapely
from helpers.stac_server import COLLECTION, StacServer, serving
from rasterio.io import MemoryFile
from rasterio.transform import from_origin

from sassgis.files.atomic_output import WRITTEN_NAME
from sassgis.inputs.dem import read_dem
from sassgis.inputs.tiles import open_terrain, read_terrain

#: Kilometre squares of the made-up tiles: 100 x 100 cells of 2 m stand for each.
SIDE, CELL = 200.0, 2.0
EAST, NORTH = 2_700_000.0, 1_150_000.0
TO_DEGREES = pyproj.Transformer.from_crs("EPSG:2056", "EPSG:4326", always_xy=True)


def heights(row: int, col: int) -> np.ndarray:
    y, x = np.indices((100, 100)) * CELL
    return (1000.0 + 0.5 * (x + SIDE * col) - 0.3 * (y + SIDE * row)).astype(np.float32)


def square(row: int, col: int) -> tuple[float, float, float, float]:
    west, north = EAST + SIDE * col, NORTH - SIDE * row
    return west, north - SIDE, west + SIDE, north


@cache
def geotiff(row: int, col: int, lift: float = 0.0) -> bytes:
    west, _, _, north = square(row, col)
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=100, height=100, count=1, dtype="float32", crs="EPSG:2056",
            nodata=-9999.0, transform=from_origin(west, north, CELL, CELL),
        ) as raster:  # fmt: skip
            raster.write(heights(row, col) + np.float32(lift), 1)
        return bytes(memory.getbuffer())


def name(row: int, col: int, year: int = 2020) -> str:
    return f"swissalti3d_{year}_{2700 + col}-{1150 - row}_2_2056_5728.tif"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[StacServer]:
    """Six tiles on three pages, one of them in an older edition too."""
    monkeypatch.setenv("no_proxy", "*")
    made = StacServer()
    for row in range(2):
        for col in range(3):
            box = TO_DEGREES.transform_bounds(*square(row, col))
            made.offer(name(row, col), geotiff(row, col), box, "2020-05-01", old_style=row == 1)
    old = TO_DEGREES.transform_bounds(*square(0, 0))
    made.offer(name(0, 0, 2017), geotiff(0, 0, 50.0), old, "2017-05-01")
    with serving(made) as running:
        yield running


@pytest.fixture
def polygon(tmp_path: Path) -> Path:
    """Over three tiles, drawn in another system; the rectangle around it meets one more."""
    shape = shapely.box(EAST + 50.0, NORTH - 350.0, EAST + 390.0, NORTH - 50.0)
    shape -= shapely.box(EAST + 180.0, NORTH - 220.0, EAST + 400.0, NORTH)
    frame = gpd.GeoDataFrame(geometry=[shape], crs="EPSG:2056").to_crs("EPSG:21781")
    frame.to_file(tmp_path / "area.gpkg")
    return tmp_path / "area.gpkg"


@pytest.fixture
def fetch(server: StacServer, polygon: Path) -> tuple[object, ...]:
    return ("dem", "fetch", polygon, "--server", server.api, "--timeout", "10")


WANTED = [(0, 0), (1, 0), (1, 1)]


def test_without_a_folder_the_tiles_are_listed_only(fetch, server: StacServer, printed) -> None:
    out = printed(*fetch)
    *lines, last = out.splitlines()
    assert sorted(line.split()[1] for line in lines) == sorted(name(*place) for place in WANTED)
    assert all(line.startswith("2020-05-01") for line in lines)
    assert last.startswith("3 tiles listed.")
    # Five items meet the rectangle, two on a page.
    assert server.asked == {f"/api/stac/v1/collections/{COLLECTION}/items": 3}


def test_tiles_become_one_terrain(fetch, printed, server: StacServer, tmp_path: Path) -> None:
    folder = tmp_path / "terrain"
    printed(*fetch, "-o", folder)
    assert sorted(p.name for p in folder.iterdir()) == sorted(
        [*(name(*place) for place in WANTED), "terrain.vrt", "sources.json", WRITTEN_NAME]
    )
    want = np.block([[heights(r, c) for c in range(2)] for r in range(2)])
    want[:100, 100:] = np.nan
    for grid in (read_dem(folder / "terrain.vrt"), read_terrain(folder)):
        assert np.array_equal(grid.values, want, equal_nan=True)
        assert (grid.west, grid.north, grid.cell_size) == (EAST, NORTH, CELL)
    with rasterio.open(folder / "terrain.vrt") as raster:
        assert raster.crs.to_epsg() == 2056 and raster.dtypes == ("float32",)
    # Moved as a whole.
    folder.rename(tmp_path / "moved")
    assert open_terrain(tmp_path / "moved" / "terrain.vrt").whole.n_rows == 200
    sources = json.loads((tmp_path / "moved" / "sources.json").read_text())
    assert {s["file"] for s in sources} == {name(*place) for place in WANTED}
    assert all(s["href"].startswith(server.url) and s["checksum"] for s in sources)


def test_what_is_there_is_kept_and_what_has_changed_is_not_replaced(
    fetch, printed, refusal, server: StacServer, tmp_path: Path
) -> None:
    """Somebody may have mended a tile by hand."""
    folder = tmp_path / "terrain"
    printed(*fetch, "-o", folder)
    server.asked.clear()
    changed = folder / name(1, 1)
    changed.write_bytes(changed.read_bytes()[:-10])
    before = {p: p.read_bytes() for p in folder.iterdir()}
    err = refusal(*fetch, "-o", folder, code=3)
    assert f"{changed}: is not the tile that the server offers" in err
    assert {p: p.read_bytes() for p in folder.iterdir()} == before
    changed.unlink()
    out = printed(*fetch, "-o", folder)
    assert out.count("is there") == 2
    assert {p for p in server.asked if p.startswith("/files/")} == {f"/files/{name(1, 1)}"}
    assert changed.read_bytes() == server.files[name(1, 1)]


def test_files_of_the_user_are_not_replaced(fetch, refusal, tmp_path: Path) -> None:
    for own in ("sources.json", "terrain.vrt"):
        (tmp_path / own).write_text("mine")
        err = refusal(*fetch, "-o", tmp_path, code=3)
        assert f"{tmp_path / own}: has changed since sassgis wrote it, or is not" in err
        assert (tmp_path / own).read_text() == "mine"
        (tmp_path / own).unlink()


def test_after_too_many_breaks_the_same_command_goes_on(
    fetch, printed, refusal, server: StacServer, tmp_path: Path
) -> None:
    folder, tile = tmp_path / "terrain", name(1, 0)
    server.cut[tile] = 5
    err = refusal(*fetch, "-o", folder)
    assert tile in err and "breaks off" in err and "the same command" in err
    assert not list(folder.glob("*.part")) and not (folder / "terrain.vrt").exists()
    printed(*fetch, "-o", folder)
    assert (folder / tile).read_bytes() == server.files[tile]
    assert server.asked[f"/files/{name(0, 0)}"] == 1


@pytest.mark.parametrize("stated", [True, False])
def test_a_damaged_tile_is_never_kept(
    stated: bool, fetch, refusal, server: StacServer, tmp_path: Path
) -> None:
    tile = name(0, 0)
    server.files[tile] = server.files[tile][: len(server.files[tile]) // 2]
    if not stated:
        for item in server.items:
            for asset in item["assets"].values():
                asset.pop("file:checksum", None)
    err = refusal(*fetch, "-o", tmp_path / "t")
    assert tile in err and "damaged" in err and ("sha256" in err) == stated
    assert not (tmp_path / "t" / tile).exists() and not list((tmp_path / "t").glob("*.part"))


def test_a_slow_answer(fetch, printed, refusal, server: StacServer, tmp_path: Path) -> None:
    server.slow[name(0, 0)] = 1.0
    assert "timed out" in refusal(*fetch, "-o", tmp_path / "t", "--timeout", "0.2")
    printed(*fetch, "-o", tmp_path / "t")


def test_offline_is_one_line(polygon: Path, refusal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("no_proxy", "*")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    err = refusal("dem", "fetch", polygon, "--server", f"http://127.0.0.1:{port}")
    assert "no answer from 127.0.0.1" in err and "connection to the internet" in err
    assert "is no web address" in refusal("dem", "fetch", polygon, "--server", "file:///etc")


def test_other_errors_are_one_line(fetch, refusal, server: StacServer, tmp_path: Path) -> None:
    cases = [
        (("--resolution", "0.5"), "offers no tile of this resolution"),
        (("-o", tmp_path / "t", "--most", "2"), "too many tiles"),
        (("--collection", "nothing"), "HTTP 404"),
    ]
    for arguments, words in cases:
        err = refusal(*fetch, *arguments)
        assert words in err, err
    assert not (tmp_path / "t").exists()
    del server.files[name(1, 1)]
    err = refusal(*fetch, "-o", tmp_path / "t")
    assert "HTTP 404" in err and "of 3" in err
    server.page = 10**6
    server.items = []
    assert "offers no tile here" in refusal(*fetch)


@pytest.mark.parametrize(
    "href",
    ["{server}/files/..%2F..%2Fevil.tif", "file:///etc/passwd.tif", "{server}/files/a b.tif"],
)
def test_names_and_addresses_of_the_server_are_not_trusted(
    href: str, fetch, refusal, server: StacServer, tmp_path: Path
) -> None:
    for item in server.items:
        for asset in item["assets"].values():
            asset["href"] = href
    err = refusal(*fetch, "-o", tmp_path / "t")
    assert "offers no tile" in err or "is no web address" in err
    assert not list(tmp_path.glob("**/*.tif"))


@pytest.mark.parametrize("body", ["<html>", "[" * 100_000, "[]", '{"features": 1}'])
def test_answers_that_are_no_page(
    body: str, fetch, server: StacServer, monkeypatch: pytest.MonkeyPatch, refusal
) -> None:
    def answered(handler, query, first) -> None:
        handler.send_response(200)
        handler.end_headers()
        handler.wfile.write(body.encode())

    monkeypatch.setattr(server, "_list", answered)
    assert "does not answer as a STAC interface" in refusal(*fetch)
