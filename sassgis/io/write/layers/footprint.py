"""Outlines of the cells that blocks reach."""

from __future__ import annotations

from collections.abc import Sequence

import geopandas as gpd
import numpy as np
import rasterio.features
import shapely
from numpy.typing import NDArray
from rasterio.transform import Affine

from sassgis.model.grid import Grid


def footprints(
    probability: NDArray[np.float32], grid: Grid, levels: Sequence[float]
) -> gpd.GeoDataFrame:
    """Areas where the reach probability is at least each of some levels.

    Parameters
    ----------
    probability : float32, shape of the grid
        NaN where no block arrives.
    grid : Grid
    levels : sequence of float
        0 means every cell that a block reaches.

    Returns
    -------
    GeoDataFrame
        A row per level that is reached: columns ``level``, ``area_m2`` and the outline, with the
        corners of the cells. Cells that touch at a corner only are parts of their own.
    """
    transform = Affine(grid.cell_size, 0.0, grid.west, 0.0, -grid.cell_size, grid.north)
    rows = []
    for level in sorted(levels):
        mask = np.nan_to_num(probability, nan=-1.0) >= max(level, 1e-300)
        if not mask.any():
            continue
        parts = [
            shapely.geometry.shape(geometry)
            for geometry, _ in rasterio.features.shapes(
                mask.astype(np.uint8), mask=mask, transform=transform, connectivity=4
            )
        ]
        outline = shapely.MultiPolygon(list(shapely.get_parts(parts)))
        rows.append({"level": float(level), "area_m2": outline.area, "geometry": outline})
    return gpd.GeoDataFrame(
        {
            "level": np.array([r["level"] for r in rows], float),
            "area_m2": np.array([r["area_m2"] for r in rows], float),
        },
        geometry=[r["geometry"] for r in rows],
        crs=grid.crs or None,
    )
