"""The ground as a block feels it: terrain finer than a block is roughness, not slope."""

from __future__ import annotations

from sassgis.model.grid import Grid
from sassgis.terrain.surface import smoothed

#: Standard deviation of the Gaussian over the diameter of the block: that of a mean over the disk
#: which the block covers. Waves as long as the diameter keep 29 % of their height, half as long
#: 0.7 %, four times as long 93 %.
SD_PER_DIAMETER = 0.25


def block_scale_grid(grid: Grid, scale_m: float) -> Grid:
    """Heights without what is smaller than a block.

    A block that bridges a bump does not feel its flanks as slopes; the slope variation of the
    ground class represents them. Planes stay as they are.

    Parameters
    ----------
    scale_m : float
        Diameter of the block (m). With cells as wide as that or wider the grid holds no such
        detail, and is returned itself.

    Returns
    -------
    Grid
        NaN where ``grid`` is NaN, and nowhere else.
    """
    return grid if scale_m <= grid.cell_size else smoothed(grid, SD_PER_DIAMETER * scale_m)
