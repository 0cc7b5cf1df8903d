"""The forest of ``[effects.trees]`` on the cells of the terrain."""

from __future__ import annotations

from functools import partial

import numpy as np
import rasterio
from affine import Affine
from rasterio.errors import RasterioError
from rasterio.features import rasterize
from rasterio.warp import Resampling, reproject

from sassgis.io.read.csv_table import number
from sassgis.io.read.dem import open_raster
from sassgis.io.read.vector_features import read_features
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.in_memory import Input
from sassgis.model.settings import ForestPlace

_HECTARE_M2 = 1e4
#: Represents local coordinates, which have no system: the warper will not work without one, and as
#: source and target are then set equal, any plane system in metres leaves them what they are.
_ANY_PLANE = "EPSG:2056"


def read_forest(
    trees: ForestPlace, grid: Grid, whole: Grid | None = None
) -> tuple[FloatArray, FloatArray]:
    """Stems and diameters of each cell.

    Parameters
    ----------
    whole : Grid, optional
        The terrain model of which ``grid`` is a part: what the file holds must meet this one.

    Returns
    -------
    stems_per_m2, diameter_m : float64, shape (n_rows * n_cols,)
        0 where no forest stands.
    """
    stems = np.full(grid.shape, trees.stems_per_ha or 0.0)
    diameter = np.full(grid.shape, trees.dbh_cm or 0.0)
    if trees.file is not None:
        stems, diameter = _from_polygons(trees, trees.file, grid, whole or grid)
    if trees.stems_raster is not None:
        stems = _from_raster(trees.stems_raster, grid, "effects.trees.stems_raster")
    if trees.dbh_raster is not None:
        diameter = _from_raster(trees.dbh_raster, grid, "effects.trees.dbh_raster")
    nothing = (stems <= 0.0) | (diameter <= 0.0)
    stems = np.where(nothing, 0.0, stems) / _HECTARE_M2
    return stems.ravel(), np.where(nothing, 0.0, diameter).ravel() / 100.0


def _from_polygons(
    trees: ForestPlace, file: Input, grid: Grid, whole: Grid
) -> tuple[FloatArray, FloatArray]:
    features = read_features(
        file,
        whole,
        "effects.trees",
        layer=trees.layer,
        fields={"stems_field": trees.stems_field, "dbh_field": trees.dbh_field},
        kinds=("polygon",),
    )
    west, _, _, north = grid.bounds
    maps = []
    for field, default in (
        (trees.stems_field, trees.stems_per_ha),
        (trees.dbh_field, trees.dbh_cm),
    ):
        shapes = []
        for feature in features:
            value = default
            if field is not None and feature.text(field) is not None:
                value = number(feature.attributes[field], feature.label(), field, file)
            if value is None or value < 0.0:
                raise InputError(
                    f"{feature.label()} has no number that can be used",
                    file=file,
                    field=field,
                    found=value,
                    expected="0 or more",
                )
            shapes.append((feature.geometry, value))
        maps.append(
            np.asarray(
                rasterize(
                    shapes,
                    out_shape=grid.shape,
                    fill=0.0,
                    transform=Affine(grid.cell_size, 0.0, west, 0.0, -grid.cell_size, north),
                    dtype=np.float64,
                )
            )
        )
    return maps[0], maps[1]


def _from_raster(file: Input, grid: Grid, field: str) -> FloatArray:
    """Values at the nearest cell; 0 where the raster has none."""
    wrong = partial(InputError, file=file, field=field)
    west, _, _, north = grid.bounds
    out = np.full(grid.shape, np.nan)
    with open_raster(file, field) as raster:
        if grid.crs and raster.crs is None:
            raise wrong("states no coordinate system", expected="one")
        crs = raster.crs or _ANY_PLANE
        try:
            reproject(
                rasterio.band(raster, 1),
                out,
                src_crs=crs,
                dst_crs=grid.crs or crs,
                dst_transform=Affine(grid.cell_size, 0.0, west, 0.0, -grid.cell_size, north),
                # Not 0: the warper shifts valid zeros by a hair where that means no value.
                dst_nodata=np.nan,
                resampling=Resampling.nearest,
            )
        except RasterioError as error:
            raise wrong("cannot be read to the end", found=str(error)) from None
    out = np.where(np.isnan(out), 0.0, out)
    if not np.isfinite(out).all() or (out < 0.0).any():
        raise wrong("holds numbers that cannot be used", expected="0 or more")
    return out
