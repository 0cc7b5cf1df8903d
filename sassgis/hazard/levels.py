"""Intensity classes and hazard levels from hazard curves, and how far the lowest level reaches.

Codes: 0 is "not reached"; intensity 1 and level 1 are the weakest of the preset.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sassgis.grid import BoolArray, FloatArray, Grid, IntArray
from sassgis.hazard.curves import at_energies, meets
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset

#: Standard deviations beyond which neighbours do not count.
_TRUNCATED = 2.5


def intensity_class(
    curves: HazardCurves, preset: HazardPreset, years: float | None
) -> NDArray[np.int16]:
    """Find the strongest intensity class reached at least once in a return period T (years).

    A class is met if λ(E >= its lower limit) >= 1/T, the lowest class if blocks arrive that often
    at all. Without ``years`` it is that of the extreme event: whatever is not rarer than the
    preset's ``rarest_years``. The thresholds of the preset are among the energies of the curves.

    0 where blocks arrive less often, else the class's position in the preset plus 1; shape (n,).
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
    is that of class i and the class of return period of T = 1/λ_i; the level is 0 where λ_i is 0,
    or T is beyond the preset's ``rarest_years``. The limit of a class of return period belongs to
    it (T <= 30).
    """
    out = np.zeros(rate.shape, np.int16)
    for i, row in enumerate(preset.matrix):
        beyond = np.zeros(rate.shape[0], np.int64)
        for limit in preset.return_periods:
            beyond += ~meets(rate[:, i], limit)
        out[:, i] = np.where(_counts(rate[:, i], preset), np.asarray(row)[beyond] + 1, 0)
    return out


def hazard_level(curves: HazardCurves, preset: HazardPreset) -> NDArray[np.int16]:
    """Return hazard level of each place: the highest level of the matrix that its curve crosses.

    Along the curve the rate falls as the energy rises, so within a class of intensity its lower
    limit has the highest level: only the thresholds decide, which are among the energies. 0 where
    no block arrives, or too rarely for any level, else the level's position in the preset plus 1.
    """
    rate = at_energies(curves, preset.thresholds_kj).rate
    highest: NDArray[np.int16] = levels_of_rates(rate, preset).max(axis=1, initial=0)
    return highest


def deciding_energy(curves: HazardCurves, preset: HazardPreset) -> IntArray:
    """Return the threshold of energy that gave each place its level.

    It is a column of ``curves.energies_kj``.

    It is the lower limit of the weakest class of intensity that gives the level. -1 where there is
    none.
    """
    columns = np.array([curves.column(e) for e in preset.thresholds_kj], np.int64)
    levels = levels_of_rates(curves.rate[:, columns], preset)
    # argmax takes the first of equal levels, which is the weakest class.
    return np.where(levels.max(axis=1, initial=0) > 0, columns[levels.argmax(axis=1)], -1)


def limits_of_levels(preset: HazardPreset) -> FloatArray:
    """Find the least rate (1/year) of each intensity class that gives each level or a higher one.

    Infinite where the class never gives it, 0 where any block does; shape (n_levels,
    n_intensities).
    """
    last = 0.0 if preset.rarest_years is None else 1.0 / preset.rarest_years
    rates = np.array([*(1.0 / t for t in preset.return_periods), last])
    matrix = np.asarray(preset.matrix)
    return np.array(
        [np.where(matrix >= k, rates, np.inf).min(axis=1) for k in range(len(preset.levels))]
    )


def cells_within_limit(
    curves: HazardCurves, preset: HazardPreset, grid: Grid, width_m: float
) -> BoolArray:
    """Return places around which blocks arrive at least as often as the rarest event of a preset.

    The frequency is the mean around a place, weighted by a normal density that has the standard
    deviation of a disk of this width along each axis. So the limit is not that of the paths of
    single blocks. Only places that a block reached are within it: a limit that no block crosses is
    not moved. With a width of 0 no place is.
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
