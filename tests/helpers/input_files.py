"""Fixtures that write small input files."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine

LV95 = "EPSG:2056"
WEST, NORTH = 2_700_000.0, 1_150_000.0
ONE_BLOCK = '[[blocks]]\nname = "large"\naxis_1_m = 0.5\naxis_2_m = 0.5\naxis_3_m = 0.5\n'
#: The least that a run on a map must say.
MAP_RUN = f'[terrain]\ndem = "dem.tif"\n[release]\nfile = "release.gpkg"\n{ONE_BLOCK}'


def at(x0: float, y0: float, x1: float, y1: float) -> shapely.Polygon:
    """Rectangle in metres from the north-western corner of the DEM, y downwards."""
    return shapely.box(WEST + x0, NORTH - y1, WEST + x1, NORTH - y0)


@pytest.fixture
def make_dem(tmp_path: Path) -> Callable[..., Path]:
    """Write a GeoTIFF (or another raster, by suffix of the name)."""

    def make(
        values: Any,
        name: str = "dem.tif",
        *,
        crs: str | None = LV95,
        transform: Affine | None = None,
        nodata: float | None = None,
        dtype: str = "float64",
        unit: str | None = None,
        scale: float | None = None,
        offset: float | None = None,
        **options: Any,
    ) -> Path:
        bands = np.atleast_3d(np.asarray(values, dtype).T).T if np.ndim(values) == 2 else values
        bands = np.asarray(bands, dtype)
        path = tmp_path / name
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            count=bands.shape[0],
            height=bands.shape[1],
            width=bands.shape[2],
            dtype=dtype,
            crs=crs,
            transform=transform or Affine(10.0, 0.0, WEST, 0.0, -10.0, NORTH),
            nodata=nodata,
            **options,
        ) as out:
            out.write(bands)
            if unit is not None:
                out.units = [unit] * bands.shape[0]
            if scale is not None:
                out.scales = [scale] * bands.shape[0]
            if offset is not None:
                out.offsets = [offset] * bands.shape[0]
        return path

    return make


@pytest.fixture
def make_layer(tmp_path: Path) -> Callable[..., Path]:
    """Write features to a vector file; the suffix of the name says which kind."""

    def make(
        shapes: Sequence[Any],
        file: str = "release.gpkg",
        *,
        crs: str | None = LV95,
        to: str | None = None,
        layer: str | None = None,
        **columns: Sequence[Any],
    ) -> Path:
        frame = gpd.GeoDataFrame(dict(columns), geometry=list(shapes), crs=crs)
        if to is not None:
            frame = frame.to_crs(to)
        path = tmp_path / file
        options = {} if layer is None else {"layer": layer}
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="'crs' was not provided")
            frame.to_file(path, engine="pyogrio", **options)
        return path

    return make
