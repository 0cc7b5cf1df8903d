"""Proposed release areas as a layer."""

from __future__ import annotations

from collections.abc import Callable

import geopandas as gpd
import numpy as np
import rasterio.features
import shapely
from numpy.typing import NDArray
from rasterio.transform import Affine
from scipy import ndimage

from sassgis.io.vector_layer import VectorLayer
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.styles import RELEASE_AREA_STYLE, FieldInfo


def proposed_areas(
    patches: NDArray[np.int32],
    grid: Grid,
    slopes: FloatArray,
    rock: NDArray[np.bool_] | None = None,
) -> VectorLayer:
    """Patches of steep cells as polygons with what was measured on them.

    Parameters
    ----------
    patches : int32, shape of the grid
        Number of the patch, from 1; 0 elsewhere.
    grid : Grid
    slopes : float64, shape of the grid
        Degrees.
    rock : bool, shape of the grid, optional
        Cells that the ground map calls rock.
    """
    transform = Affine(grid.cell_size, 0.0, grid.west, 0.0, -grid.cell_size, grid.north)
    numbers = np.arange(1, int(patches.max(initial=0)) + 1)
    shapes = {
        int(value): shapely.geometry.shape(outline)
        for outline, value in rasterio.features.shapes(
            patches, mask=patches > 0, transform=transform, connectivity=4
        )
    }
    area = grid.cell_size**2

    def of(values: FloatArray, how: Callable[..., FloatArray]) -> FloatArray:
        return np.asarray(how(values, patches, numbers), float).reshape(numbers.size)

    columns = {
        "area_m2": of(np.full(grid.shape, area), ndimage.sum_labels),
        "surface_m2": of(area / np.cos(np.radians(slopes)), ndimage.sum_labels),
        "height_m": of(grid.values, ndimage.maximum) - of(grid.values, ndimage.minimum),
        "slope_mean_deg": of(slopes, ndimage.mean),
        "slope_max_deg": of(slopes, ndimage.maximum),
    }
    fields = {
        "name": FieldInfo("name"),
        "area_m2": FieldInfo("area in plan", "m²"),
        "surface_m2": FieldInfo("surface", "m²", "area in plan over the cosine of the slope"),
        "height_m": FieldInfo("height", "m", "highest less lowest cell"),
        "slope_mean_deg": FieldInfo("mean slope", "°"),
        "slope_max_deg": FieldInfo("largest slope", "°"),
    }
    if rock is not None:
        columns["rock_share"] = of(rock.astype(float), ndimage.mean)
        fields["rock_share"] = FieldInfo("share of rock", "", "of the cells, by the ground map")
    frame = gpd.GeoDataFrame(
        {"name": [f"cliff {n}" for n in numbers]}
        | {name: np.round(values, 3) for name, values in columns.items()},
        geometry=[shapes[int(n)] for n in numbers],
        crs=grid.crs or None,
    )
    return VectorLayer(
        "release_areas",
        "Proposed release areas",
        "Cells where the steepest morphological unit prevails. To be checked in the field.",
        frame,
        fields,
        style=RELEASE_AREA_STYLE,
    )
