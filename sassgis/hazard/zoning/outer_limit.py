"""How far the lowest level reaches: by a frequency that is averaged over neighbouring paths."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from sassgis.hazard.curves import meets
from sassgis.model.grid import BoolArray, Grid
from sassgis.model.hazard import HazardCurves, HazardPreset

#: Standard deviations beyond which neighbours do not count.
_TRUNCATED = 2.5


def cells_within_limit(
    curves: HazardCurves, preset: HazardPreset, grid: Grid, width_m: float
) -> BoolArray:
    """Places around which blocks arrive at least as often as the rarest event of a preset.

    The frequency is the mean around a place, weighted by a normal density that has the standard
    deviation of a disk of this width along each axis. So the limit is not that of the paths of
    single blocks. Only places that a block reached are within it: a limit that no block crosses is
    not moved.

    Parameters
    ----------
    curves : HazardCurves
        Of cells of the grid.
    width_m : float
        0: no place is.

    Returns
    -------
    bool, shape (n,)
        Of the places of ``curves``.
    """
    if preset.rarest_years is None or width_m == 0.0 or not curves.places.size:
        return np.zeros(curves.places.size, np.bool_)
    row, col = np.divmod(curves.places, grid.shape[1])
    row, col = row - row.min(), col - col.min()
    rate = np.zeros((int(row.max()) + 1, int(col.max()) + 1))
    rate[row, col] = curves.rate[:, 0]
    # The sum of each cell is made in the same order wherever the raster begins.
    mean = ndimage.gaussian_filter(
        rate, width_m / 4.0 / grid.cell_size, mode="constant", truncate=_TRUNCATED
    )
    reached: BoolArray = curves.rate[:, 0] > 0.0
    return reached & meets(mean[row, col], preset.rarest_years)
