"""Heights of the DEM at any points."""

from __future__ import annotations

import numpy as np

from sassgis.compiled.jit import kernel
from sassgis.grid import FloatArray, Grid
from sassgis.terrain.cell_geometry import cell_index, height_at


def heights_at(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """Compute heights of the DEM as it is (m), bilinear between cell centres, as profiles do.

    NaN outside the DEM, over nodata and where a coordinate is missing.
    """
    xs, ys = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    u, v = (np.ascontiguousarray(own.ravel()) for own in grid.uv(xs, ys))
    heights: FloatArray = _heights(u, v, grid.values).reshape(xs.shape)
    return heights


@kernel
def _heights(u: FloatArray, v: FloatArray, values: FloatArray) -> FloatArray:
    out = np.full(u.size, np.nan)
    for i in range(u.size):
        if not (np.isfinite(u[i]) and np.isfinite(v[i])):
            continue
        cell = cell_index(u[i], v[i], values.shape[0], values.shape[1])
        if cell >= 0:
            row, col = cell // values.shape[1], cell % values.shape[1]
            out[i] = height_at(values, u[i], v[i], row, col)
    return out
