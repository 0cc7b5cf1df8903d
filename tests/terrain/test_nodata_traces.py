"""Numbers for nodata among heights, as resampling leaves them, and terrain that only looks so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from rasterio.enums import Resampling
from rasterio.warp import reproject

from sassgis.inputs.dem_raw import read_raw_dem
from sassgis.terrain.dem_defects import nodata_traces

N = 150
ROW, COL = np.indices((N, N)).astype(float)
#: Where nothing is known.
UNKNOWN = {
    "corner": COL + 0.3 * ROW < 45,
    "the most part": COL + 0.3 * ROW < 115,
    "side": COL < 20,
    "hole": (abs(COL - 75) < 15) & (abs(ROW - 60) < 12),
    "small hole": (abs(COL - 75) < 2) & (abs(ROW - 60) < 2),
    "holes": (abs(COL % 50 - 25) < 6) & (abs(ROW % 50 - 25) < 6),
    "frame": np.minimum.reduce([ROW, COL, N - 1 - ROW, N - 1 - COL]) < 5,
}
AREAS = ("corner", "the most part", "side")
#: Methods, and cells before and after (m).
RESAMPLED = (
    ("nearest", (10.0, 10.0)), ("bilinear", (5.0, 2.0)), ("bilinear", (25.0, 25.0)),
    ("cubic", (2.0, 2.0)), ("cubic", (1.0, 0.5)), ("lanczos", (1.0, 0.5)), ("lanczos", (5.0, 2.0)),
    ("average", (2.0, 2.0)), ("average", (25.0, 25.0)),
)  # fmt: skip


def mountain(cell_m: float, lowest_m: float = 500.0) -> np.ndarray:
    rough = np.random.default_rng(1).normal(0.0, 0.2, (N, N))
    return lowest_m + (N - ROW) * cell_m * 0.5 + 8.0 * np.sin(COL / 20.0) + rough


def resampled(values: np.ndarray, cells: tuple[float, float], method: str) -> np.ndarray:
    """Brought onto turned cells within the raster, by a program that knows of no nodata."""
    before, after = cells
    size = int(0.9 * N * before / after)
    across, along = (after * f(np.radians(3.0)) for f in (np.cos, np.sin))
    turned = Affine(across, -along, 0.05 * N * before, -along, -across, 0.97 * N * before)
    out = np.full((size, size), np.nan)
    reproject(
        values, out, src_crs="EPSG:2056", dst_crs="EPSG:2056",
        src_transform=Affine(before, 0.0, 0.0, 0.0, -before, N * before),
        dst_transform=turned,
        resampling=Resampling[method], dst_nodata=np.nan,
    )  # fmt: skip
    return out


@pytest.mark.parametrize(("method", "cells"), RESAMPLED)
def test_what_is_mixed_is_found_whatever_the_number_and_the_place(
    method: str, cells: tuple[float, float]
) -> None:
    """Also where the number is declared afterwards, and only the mixed cells are left."""
    clean = resampled(mountain(cells[0]), cells, method)
    for place, unknown in UNKNOWN.items():
        for number in (0.0, -9999.0, 32767.0):
            values = resampled(np.where(unknown, number, mountain(cells[0])), cells, method)
            if number:
                # What is no height at all is left out, or refused, by what reads it.
                values[(values < -500.0) | (values > 9000.0)] = np.nan
            wrong = np.abs(values - clean) > 150.0
            traces = nodata_traces(values, cells[1])
            found, case = traces.cells, f"{place}, {number:g}"
            assert wrong.sum() < 8 or found.sum() > 0, case
            if number == 0.0:
                # Of rims at least those cells that lie low.
                assert found[wrong].mean() > (0.8 if place in AREAS else 0.15), case
                assert traces.below_m > 150.0, case
                assert not (found & (np.abs(values - clean) < 25.0)).any(), case
    assert not nodata_traces(clean, cells[1]).cells.any()


@pytest.mark.parametrize("lowest_m", [150.0, 1500.0])
def test_low_and_high_ground(lowest_m: float) -> None:
    for place, unknown in UNKNOWN.items():
        values = np.where(unknown, 0.0, mountain(2.0, lowest_m))
        found = nodata_traces(resampled(values, (2.0, 2.0), "bilinear"), 2.0)
        assert found.cells.any(), place


def real_places(cell_m: float) -> dict[str, np.ndarray]:
    """Lakes, sea, pits and walls as they occur."""
    noise = np.random.default_rng(3).normal(0.0, 0.2, (N, N))
    hills = 600.0 + (N - ROW) * cell_m * 0.6 + 10.0 * np.sin(COL / 15.0) + noise
    level = float(np.quantile(hills, 0.3))
    lake = np.maximum(hills, level)
    pit = (abs(COL - 75) < 20) & (abs(ROW - 75) < 15)
    quarry = {
        f"quarry of {deep} m": np.where(pit, hills[pit].min() - deep, hills) for deep in (20, 60)
    }
    inland = (COL - 50.0 - 5.0 * np.sin(ROW / 15.0)).clip(0.0)
    sea = {
        f"sea below cliffs of {high} m": np.where(
            inland > 0.0, high + 0.3 * cell_m * inland + noise, 0.0
        )
        for high in (10, 60, 120)
    }
    benches = hills.copy()
    for k in range(5):
        within = (abs(COL - 75) < 50 - 8 * k) & (abs(ROW - 75) < 45 - 7 * k)
        benches[within] = hills[75, 75] - 25.0 * (k + 1)
    steep = 3000.0 - (ROW - 40.0) * cell_m * np.tan(np.radians(70.0))
    face = np.where(ROW < 40, 3000.0, np.maximum(steep, 2000.0 - 0.3 * cell_m * (ROW - 40.0)))
    face += 15.0 * noise
    holes = np.where(np.random.default_rng(4).random((N, N)) < 0.02, np.nan, face)
    holes[:, :10] = np.nan
    tower = np.where((abs(COL - 75) < 5) & (abs(ROW - 75) < 5), hills + 300.0, hills)
    return {
        "hills": hills, "lake": lake, "lake of nodata": np.where(hills < level, np.nan, hills),
        **quarry, **sea, "open pit": benches, "north face": face, "north face with holes": holes,
        "tower": tower,
        "gorge": np.where(abs(COL - 75 - 5 * np.sin(ROW / 30)) < 6, hills - 60.0, hills),
        "plateau": np.where(np.hypot(COL - 75, ROW - 75) < 40, 1000.0, 880.0) + noise,
    }  # fmt: skip


@pytest.mark.parametrize("cell_m", [0.5, 2.0, 5.0, 25.0])
def test_terrain_is_not_taken_for_nodata(cell_m: float) -> None:
    alarms = [
        name for name, z in real_places(cell_m).items() if nodata_traces(z, cell_m).cells.any()
    ]
    assert not alarms


REAL = (
    "tirol_avaGar/avaGar.asc", "tirol_avaKot/avaKot.asc", "tirol_avaMalRegional/avaMal.tif",
    "tschamut2014/terrain.asc", "authume_quarry_p1/derived_dtm_0p5m_local.tif",
    "chant_sura_2020/terrain_rf16_contact_extended.asc",
)  # fmt: skip


@pytest.mark.parametrize("file", REAL)
def test_measured_terrain_is_not_taken_for_nodata(shared_data: Path, file: str) -> None:
    if not (shared_data / file).is_file():
        pytest.skip(f"no {file} in {shared_data}")
    dem = read_raw_dem(shared_data / file)
    assert not nodata_traces(dem.values, min(dem.dx_m, dem.dy_m)).cells.any()
    # A hole of zeros in it is.
    n_rows, n_cols = dem.values.shape
    rows, cols = slice(n_rows // 3, 2 * n_rows // 3), slice(n_cols // 3, 2 * n_cols // 3)
    raised = dem.values + 1000.0
    raised[rows, cols] = np.where(np.isnan(raised[rows, cols]), np.nan, 0.0)
    assert nodata_traces(raised, min(dem.dx_m, dem.dy_m)).cells[rows, cols].any()
