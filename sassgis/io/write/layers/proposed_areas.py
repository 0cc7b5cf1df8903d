"""Proposed release areas as a layer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sassgis.io.vector_layer import VectorLayer, described_layer
from sassgis.io.write.layers.footprint import cell_outlines
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.styles import RELEASE_AREA_STYLE


def proposed_areas(
    patches: NDArray[np.int32],
    grid: Grid,
    slopes: FloatArray,
    rock: NDArray[np.bool_] | None = None,
) -> VectorLayer:
    """Patches of steep cells as polygons with what was measured on them.

    All have the shape of the grid: numbers of patches (from 1; 0 elsewhere), slopes (degrees),
    cells that the ground map calls rock.
    """
    numbers = np.arange(1, int(patches.max(initial=0)) + 1)
    shapes = {number: outline for outline, number in cell_outlines(patches, grid)}
    area = grid.cell_size**2

    def of(values: FloatArray, how: Callable[..., FloatArray]) -> FloatArray:
        return np.asarray(how(values, patches, numbers), float).reshape(numbers.size)

    measured = {
        "area_m2": of(np.full(grid.shape, area), ndimage.sum_labels),
        "surface_m2": of(area / np.cos(np.radians(slopes)), ndimage.sum_labels),
        "height_m": of(grid.values, ndimage.maximum) - of(grid.values, ndimage.minimum),
        "slope_mean_deg": of(slopes, ndimage.mean),
        "slope_max_deg": of(slopes, ndimage.maximum),
    }
    if rock is not None:
        measured["rock_share"] = of(rock.astype(float), ndimage.mean)
    columns: dict[str, Any] = {"name": [f"cliff {n}" for n in numbers]}
    columns |= {name: np.round(values, 3) for name, values in measured.items()}
    outlines, style = [shapes[int(n)] for n in numbers], RELEASE_AREA_STYLE
    return described_layer("release_areas.proposed", columns, outlines, grid.crs, style)
