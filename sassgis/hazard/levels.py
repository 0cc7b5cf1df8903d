"""Intensity classes and hazard levels from hazard curves, and how far the lowest level reaches.

Codes: 0 is "not reached"; intensity 1 and level 1 are the weakest of the preset.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sassgis.grid import BoolArray, FloatArray, Grid, IntArray
from sassgis.hazard.curves import at_energies, meets
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset

#: Standard deviations beyond which neighbours do not count.
_TRUNCATED = 2.5


class CellWindow(NamedTuple):
    """A part of a grid around some cells."""

    rows: slice
    cols: slice
    cells: IntArray  # flat indices in the part

    def map_of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return a map of the part with the values of the cells, 0 elsewhere."""
        shape = self.rows.stop - self.rows.start, self.cols.stop - self.cols.start
        out = np.zeros(shape, values.dtype)
        out.ravel()[self.cells] = values
        return out


def intensity_class(
    curves: HazardCurves, preset: HazardPreset, years: float | None
) -> NDArray[np.int16]:
    """Find the strongest intensity class reached at least once in a return period T (years).

    A class is met if λ(E >= its lower limit) >= 1/T, the lowest class if blocks arrive that often
    at all. Without ``years`` it is that of the extreme event: whatever is not rarer than the
    preset's ``rarest_years``. 0 where blocks arrive less often, else the class's position plus 1.
    """
    rate = at_energies(curves, preset.thresholds_kj).rate
    met = _counts(rate, preset) if years is None else meets(rate, years)
    codes = np.where(met, np.arange(1, rate.shape[1] + 1, dtype=np.int16), np.int16(0))
    strongest: NDArray[np.int16] = codes.max(axis=1, initial=0)
    return strongest


def _counts(rate: FloatArray, preset: HazardPreset) -> NDArray[np.bool_]:
    """Return whether a rate is high enough for any level."""
    some: NDArray[np.bool_] = rate > 0.0
    return some if preset.rarest_years is None else some & meets(rate, preset.rarest_years)


def levels_of_rates(rate: FloatArray, preset: HazardPreset) -> NDArray[np.int16]:
    """Find the level of each matrix field that a place's rates meet, shape (n, n_intensities).

    Rates are λ(E >= lower limit of each class of intensity) per year, in the same shape. The field
    is that of class i and the class of return period of T = 1/λ_i, whose limit belongs to it (T <=
    30); the level is 0 where λ_i is 0, or T is beyond the preset's ``rarest_years``.
    """
    out = np.zeros(rate.shape, np.int16)
    for i, row in enumerate(preset.matrix):
        beyond = np.zeros(rate.shape[0], np.int64)
        for limit in preset.return_periods:
            beyond += ~meets(rate[:, i], limit)
        out[:, i] = np.where(_counts(rate[:, i], preset), np.asarray(row)[beyond] + 1, 0)
    return out


def hazard_level(curves: HazardCurves, preset: HazardPreset) -> NDArray[np.int16]:
    """Find the hazard level of each place: the highest of the matrix that its curve crosses.

    Along the curve the rate falls as the energy rises, so within a class of intensity its lower
    limit has the highest level: only the thresholds decide, which are among the energies. 0 where
    no block arrives, or too rarely for any level, else the level's position in the preset plus 1.
    """
    rate = at_energies(curves, preset.thresholds_kj).rate
    highest: NDArray[np.int16] = levels_of_rates(rate, preset).max(axis=1, initial=0)
    return highest


def deciding_energy(curves: HazardCurves, preset: HazardPreset) -> IntArray:
    """Return the column of the energy that gave each place its level; -1 where there is none.

    It is the lower limit of the weakest class of intensity that gives the level.
    """
    columns = np.array([curves.column(e) for e in preset.thresholds_kj], np.int64)
    levels = levels_of_rates(curves.rate[:, columns], preset)
    # argmax takes the first of equal levels, which is the weakest class.
    return np.where(levels.max(axis=1, initial=0) > 0, columns[levels.argmax(axis=1)], -1)


def limits_of_levels(preset: HazardPreset) -> FloatArray:
    """Compute the least rate (1/year) of each class that gives each level or a higher one.

    Infinite where the class never gives it, 0 where any block does; shape (n_levels,
    n_intensities).
    """
    last = 0.0 if preset.rarest_years is None else 1.0 / preset.rarest_years
    rates = np.array([*(1.0 / t for t in preset.return_periods), last])
    matrix = np.asarray(preset.matrix)
    return np.array(
        [np.where(matrix >= k, rates, np.inf).min(axis=1) for k in range(len(preset.levels))]
    )


def window_of(cells: IntArray, shape: tuple[int, int], margin: int = 0) -> CellWindow:
    """Return the rows and columns of a grid around some cells, and the cells' indices there."""
    row, col = np.divmod(cells if cells.size else np.zeros(1, np.int64), shape[1])

    def around(own: IntArray, n: int) -> slice:
        return slice(max(int(own.min()) - margin, 0), min(int(own.max()) + margin + 1, n))

    rows, cols = around(row, shape[0]), around(col, shape[1])
    flat = (row - rows.start) * (cols.stop - cols.start) + col - cols.start
    return CellWindow(rows, cols, flat[: cells.size])


def cells_within_limit(
    curves: HazardCurves, preset: HazardPreset, grid: Grid, width_m: float
) -> BoolArray:
    """Find places around which blocks arrive at least as often as the rarest event of a preset.

    The frequency is the mean around a place, weighted by a normal density that has the standard
    deviation of a disk of this width along each axis. So the limit is not that of the paths of
    single blocks. Only places that a block reached are within it. With a width of 0 no place is.
    """
    if preset.rarest_years is None or width_m == 0.0 or not curves.places.size:
        return np.zeros(curves.places.size, np.bool_)
    window = window_of(curves.places, grid.shape)
    # The sum of each cell is made in the same order wherever the raster begins.
    mean = ndimage.gaussian_filter(
        window.map_of(curves.rate[:, 0]),
        width_m / 4.0 / grid.cell_size,
        mode="constant",
        truncate=_TRUNCATED,
    )
    reached: BoolArray = curves.rate[:, 0] > 0.0
    return reached & meets(mean.ravel()[window.cells], preset.rarest_years)
