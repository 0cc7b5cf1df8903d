"""Tools to make terrain: repeatable noise, soft edges, and the files it is written to.

The noise hashes lattice coordinates with integer arithmetic. It therefore gives the same ground on
every machine and with every version of numpy, which a random generator does not promise.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pyogrio
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

FloatArray = NDArray[np.float64]

CRS = "EPSG:2056"
NODATA = -9999.0

# Standard deviation of the lattice noise below, found by sampling; divides it to unit deviation.
_NOISE_DEVIATION = 0.216


def _hash(ix: NDArray[np.int64], iy: NDArray[np.int64], seed: int) -> FloatArray:
    """A number in [0, 1) for each lattice node (finaliser of SplitMix64, Steele et al. 2014)."""
    key = (
        ix.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        + iy.astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
        + np.full(ix.shape, seed, np.uint64) * np.uint64(0x165667B19E3779F9)
    )
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        key = (key ^ (key >> np.uint64(shift))) * np.uint64(factor)
    key ^= key >> np.uint64(31)
    numbers: FloatArray = (key >> np.uint64(11)).astype(np.float64) * 2.0**-53
    return numbers


def noise(x: FloatArray, y: FloatArray | float, wavelength: float, seed: int) -> FloatArray:
    """Smooth noise of one scale: zero mean, about unit standard deviation (Perlin 1985, 2002).

    Parameters
    ----------
    x, y : float64, any shape that broadcasts
        Coordinates (m).
    wavelength : float
        Spacing of the lattice (m).
    seed : int
        Which noise.
    """
    px, py = np.broadcast_arrays(np.asarray(x) / wavelength, np.asarray(y) / wavelength)
    # Gradient noise is zero on its lattice; turned and moved, the zeros form no rows with the axes.
    turn = 0.6435 + 0.7 * seed
    qx = px * np.cos(turn) - py * np.sin(turn) + 0.37 + 17.13 * seed
    qy = px * np.sin(turn) + py * np.cos(turn) + 0.61 + 5.71 * seed
    ix, iy = np.floor(qx).astype(np.int64), np.floor(qy).astype(np.int64)
    fx, fy = qx - ix, qy - iy

    def ramp(dx: int, dy: int) -> FloatArray:
        angle = 2.0 * np.pi * _hash(ix + dx, iy + dy, seed)
        rise: FloatArray = np.cos(angle) * (fx - dx) + np.sin(angle) * (fy - dy)
        return rise

    wx = fx**3 * (fx * (6.0 * fx - 15.0) + 10.0)
    wy = fy**3 * (fy * (6.0 * fy - 15.0) + 10.0)
    south = ramp(0, 0) * (1.0 - wx) + ramp(1, 0) * wx
    north = ramp(0, 1) * (1.0 - wx) + ramp(1, 1) * wx
    values: FloatArray = (south * (1.0 - wy) + north * wy) / _NOISE_DEVIATION
    return values


def scatter(n: int, seed: int) -> FloatArray:
    """``n`` rows of four repeatable numbers in [0, 1): shape (n, 4)."""
    rows, columns = np.meshgrid(np.arange(n), np.arange(4), indexing="ij")
    return _hash(rows.astype(np.int64), columns.astype(np.int64), seed)


def ease(value: FloatArray, low: float | FloatArray, high: float | FloatArray) -> FloatArray:
    """0 below ``low``, 1 above ``high``, a smooth step between."""
    t = np.clip((value - low) / (np.asarray(high) - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def soft_min(a: FloatArray, b: FloatArray, width: float) -> FloatArray:
    """The lower of two surfaces with the crease rounded over ``width`` (m)."""
    share = np.clip(0.5 + 0.5 * (b - a) / width, 0.0, 1.0)
    return b + (a - b) * share - width * share * (1.0 - share)


def soft_max(a: FloatArray, b: FloatArray, width: float) -> FloatArray:
    """The upper of two surfaces with the crease rounded over ``width`` (m)."""
    return -soft_min(-a, -b, width)


def cell_centres(
    west: float, south: float, width_m: float, height_m: float, cell: float
) -> tuple[FloatArray, FloatArray]:
    """Coordinates x and y of the cell centres, shape (n_rows, n_cols) each, row 0 in the north."""
    n_cols, n_rows = round(width_m / cell), round(height_m / cell)
    x = west + (np.arange(n_cols) + 0.5) * cell
    y = south + height_m - (np.arange(n_rows) + 0.5) * cell
    return np.meshgrid(x, y)[0], np.meshgrid(x, y)[1]


def write_dem(
    path: Path, z: FloatArray, west: float, north: float, cell: float, heights: str
) -> None:
    """Write heights rounded to the centimetre as a compressed float32 GeoTIFF."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=z.shape[1],
        height=z.shape[0],
        count=1,
        dtype="float32",
        crs=CRS,
        transform=from_origin(west, north, cell, cell),
        nodata=NODATA,
        compress="deflate",
        predictor=3,
        zlevel=9,
        tiled=True,
    ) as raster:
        raster.write(np.round(z, 2).astype(np.float32), 1)
        raster.set_band_description(1, f"height (m, {heights}), made by a script, not surveyed")


def write_vectors(path: Path, layer: str, rows: list[dict[str, Any]]) -> None:
    """Write rows (attributes and a ``geometry``) as one layer of a new GeoPackage, on 1 mm."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    frame = gpd.GeoDataFrame(rows, geometry="geometry", crs=CRS)
    frame["geometry"] = frame.geometry.set_precision(0.001)
    # A fixed date keeps the files the same from one run to the next.
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": "2000-01-01T00:00:00.000Z"})
    try:
        pyogrio.write_dataframe(frame, path, layer=layer, driver="GPKG", promote_to_multi=False)
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})
