"""Tiles on one lattice: what goes together, what does not, and reading of parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from sassgis.errors import InputError, InputLost
from sassgis.inputs.dem import read_dem
from sassgis.inputs.tiles import Part, gaps_between, hull, open_terrain, read_terrain
from sassgis.outputs.terrain_fetch import write_vrt
from sassgis.runs.dem_check import check_dem

HEIGHTS = 1000.0 + 0.1 * np.arange(120.0).reshape(10, 12) ** 1.5


def tile(
    folder: Path,
    name: str,
    rows: slice,
    cols: slice,
    *,
    shift: float = 0.0,
    cell: float = 2.0,
    lift: float = 0.0,
    crs: str = "EPSG:2056",
) -> Path:
    """A part of HEIGHTS as a file; ``shift`` (m) moves it to the east."""
    values = (HEIGHTS[rows, cols] + lift).astype(np.float32)
    where = from_origin(2.6e6 + cell * cols.start + shift, 1.2e6 - cell * rows.start, cell, cell)
    file = folder / name
    with rasterio.open(
        file, "w", driver="GTiff", dtype="float32", count=1, crs=crs, transform=where,
        height=values.shape[0], width=values.shape[1], nodata=-9999.0,
    ) as out:  # fmt: skip
        out.write(values, 1)
    return file


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two tiles that overlap by two columns, and one that leaves a gap."""
    tile(tmp_path, "b.tif", slice(0, 5), slice(0, 7))
    tile(tmp_path, "a.tif", slice(0, 5), slice(5, 12))
    tile(tmp_path, "c.tif", slice(5, 10), slice(6, 12))
    return tmp_path


def test_tiles_are_one_terrain(folder: Path) -> None:
    grid = read_terrain(folder)
    known = np.ones(HEIGHTS.shape, bool)
    known[5:, :6] = False
    assert (grid.west, grid.north, grid.cell_size) == (2.6e6, 1.2e6, 2.0)
    assert np.array_equal(grid.values[known], HEIGHTS.astype(np.float32)[known])
    assert np.isnan(grid.values[~known]).all()


@pytest.mark.parametrize(
    ("plan", "missing"),
    [
        ("###/###/###", ()),
        ("###/#.#/###", ((1, 1, 1, 1),)),
        ("#.#/###/###", ((0, 1, 1, 1),)),
        # A corner, as the rest is nearly a rectangle; two places side by side are one gap.
        (".##/###/###", ((0, 0, 1, 1),)),
        ("#####/#..##/#####/###.#/#####", ((1, 1, 1, 2), (3, 3, 1, 1))),
        # Along a valley nothing is missing, but for a tile that it passes over.
        ("##.../.##../..##./...##", ()),
        ("#..../#..../#####", ()),
        ("##...../.###.../..#.#../..####.", ((2, 3, 1, 1),)),
    ],
)
def test_tiles_that_are_missing(plan: str, missing: tuple[tuple[int, ...], ...]) -> None:
    rows = plan.split("/")
    places = [Part(5 * i, 7 * j, 5, 7) for i, row in enumerate(rows)
              for j, c in enumerate(row) if c == "#"]  # fmt: skip
    wanted = [Part(5 * i, 7 * j, 5 * rows, 7 * cols) for i, j, rows, cols in missing]
    assert gaps_between(places) == wanted
    # Tiles of other sizes that overlap say the same.
    more = [Part(p.row, p.col, 2, 7) for p in places]
    assert gaps_between([*places, *more]) == wanted


def test_a_gap_is_told_of_a_folder_and_of_a_virtual_raster(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    says = "no tile covers (x 2600000 to 2600012, y 1199980 to 1199990): no height is known there"
    vrt = write_vrt(folder / "all.vrt", open_terrain(folder))
    for given in (folder, vrt):
        for read in (open_terrain, read_terrain):
            caplog.clear()
            read(given)
            assert caplog.messages == [f"{given}: {says}"]
        nodata = next(f for f in check_dem(given).findings if f.item == "nodata")
        assert nodata.verdict == "look" and nodata.found.endswith(says)
        assert "coordinate system" not in check_dem(given).sentence
    caplog.clear()
    read_terrain(folder / "a.tif")
    assert not caplog.messages


def test_a_part_is_a_part_of_the_whole(folder: Path) -> None:
    terrain = open_terrain(folder)
    whole = terrain.read(terrain.whole)
    part = terrain.read(Part(3, 4, 5, 6))
    assert np.array_equal(part.values, whole.values[3:8, 4:10], equal_nan=True)
    assert (part.west, part.north) == (2.6e6 + 8.0, 1.2e6 - 6.0)
    beyond = terrain.read(Part(-2, -1, 4, 4))
    assert np.isnan(beyond.values[:2]).all() and np.isnan(beyond.values[:, 0]).all()
    assert np.array_equal(beyond.values[2:, 1:], whole.values[:2, :3])
    assert terrain.outline().bounds == whole.bounds


@pytest.mark.parametrize("held", [Part(2, 3, 5, 6), Part(-3, -3, 20, 20)])
def test_heights_in_memory_are_those_of_the_files(folder: Path, held: Part) -> None:
    terrain = open_terrain(folder)
    holding = terrain.holding(held)
    for part in (Part(3, 4, 2, 3), Part(0, 0, 10, 12), Part(5, 5, 9, 9), Part(-9, 0, 4, 4)):
        assert np.array_equal(holding.read(part).values, terrain.read(part).values, equal_nan=True)
    for file in folder.iterdir():
        file.unlink()
    assert np.isfinite(holding.read(Part(3, 4, 2, 3)).values).all()
    assert holding.holding(Part(3, 4, 1, 1)) is holding


def test_a_rotated_or_stretched_raster_is_cut_after_resampling(tmp_path: Path) -> None:
    file = tmp_path / "wide.tif"
    with rasterio.open(
        file, "w", driver="GTiff", dtype="float32", count=1, crs="EPSG:2056", height=10, width=12,
        transform=from_origin(2.6e6, 1.2e6, 4.0, 2.0),
    ) as out:  # fmt: skip
        out.write(HEIGHTS.astype(np.float32), 1)
    grid = read_dem(file)
    part = open_terrain(file).read(Part(1, 2, 5, 9))
    assert grid.cell_size == 2.0
    assert np.array_equal(part.values, grid.values[1:6, 2:11], equal_nan=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shift": 0.7}, "do not lie on one lattice"),
        ({"cell": 2.5}, "cells of different sizes"),
        ({"lift": 3.0}, "heights differ"),
        ({"crs": "EPSG:21781"}, "different coordinate systems"),
    ],
)
def test_tiles_that_do_not_go_together_are_refused(
    folder: Path, change: dict[str, object], words: str
) -> None:
    tile(folder, "d.tif", slice(0, 4), slice(0, 4), **change)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=words) as error:
        open_terrain(folder)
    assert "d.tif" in str(error.value)
    for file in folder.iterdir():
        file.unlink()
    with pytest.raises(InputError, match="holds no tile"):
        open_terrain(folder)


def test_small_differences_are_told(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    tile(folder, "d.tif", slice(0, 4), slice(0, 4), lift=0.1)
    terrain = open_terrain(folder)
    assert "heights differ by 0.1 m (median)" in caplog.text
    # The tile that counts does not depend on the order of reading.
    first = next(t for t in terrain.tiles if t.place.row == 0 and t.place.col == 0)
    assert terrain.read(Part(0, 0, 4, 4)).values[0, 0] == pytest.approx(1000.0, abs=1e-3)
    assert first.dem.file.name == "b.tif"


def test_cells_keep_their_place_in_a_larger_part() -> None:
    small, other = Part(5, 7, 3, 4), Part(2, 1, 2, 2)
    large = hull([small, other])
    assert large == Part(2, 1, 6, 10)
    inside, cells = small.cells_in(large, np.arange(12))
    assert inside.all()
    assert cells.tolist() == [(r + 3) * 10 + c + 6 for r in range(3) for c in range(4)]
    # Of a place that holds a part of them, those that lie there.
    inside, cells = small.cells_in(Part(6, 9, 9, 9), np.arange(12))
    assert np.flatnonzero(inside).tolist() == [6, 7, 10, 11] and cells.tolist() == [0, 1, 9, 10]
    assert small.common(other) is None
    assert small.grown(1, 2, 3, 4) == Part(4, 3, 7, 10)


def test_a_tile_that_goes_missing_concerns_all_areas(folder: Path) -> None:
    """No area would be to blame: it is no InputError, for which an area is skipped."""
    terrain = open_terrain(folder)
    (folder / "a.tif").unlink()
    with pytest.raises(InputLost, match=r"a\.tif: was there .*, and is gone"):
        terrain.read(terrain.whole)
    assert np.isfinite(terrain.read(Part(0, 0, 3, 3)).values).all()
