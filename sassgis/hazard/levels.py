"""Intensity classes and hazard levels from hazard curves, and how sure they are.

Codes: 0 is "not reached"; intensity 1 and level 1 are the weakest of the preset.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sassgis.hazard.curves import at_energies, meets, rate_interval
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.hazard import HazardCurves, HazardPreset

#: Beyond this many times the blocks a cell counts as one that no sample decides.
MAX_FACTOR = 2.0**20
_STEPS = 10  # halvings of the logarithm of MAX_FACTOR: the factor is found to 1.4 %


def intensity_class(
    curves: HazardCurves, preset: HazardPreset, years: float | None
) -> NDArray[np.int16]:
    """Strongest class of intensity that is reached at least once in a return period.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies.
    years : float or None
        Return period T: a class is met if λ(E >= its lower limit) >= 1/T, the lowest class if
        blocks arrive that often at all. None: the extreme event, whatever arrived at all.

    Returns
    -------
    int16, shape (n,)
        0 where blocks arrive less often, else the class's position in the preset plus 1.
    """
    rate = at_energies(curves, preset.thresholds_kj).rate
    met = rate > 0.0 if years is None else meets(rate, years)
    codes = np.where(met, np.arange(1, rate.shape[1] + 1, dtype=np.int16), np.int16(0))
    strongest: NDArray[np.int16] = codes.max(axis=1, initial=0)
    return strongest


def levels_of_rates(rate: FloatArray, preset: HazardPreset) -> NDArray[np.int16]:
    """Level of each field of the matrix that the rates of a place meet.

    Parameters
    ----------
    rate : float64, shape (n, n_intensities)
        λ(E >= lower limit of each class of intensity) per year.

    Returns
    -------
    int16, shape (n, n_intensities)
        Level of the field (class i, class of return period of T = 1/λ_i); 0 where λ_i is 0. The
        limit of a class of return period belongs to it (T <= 30).
    """
    out = np.zeros(rate.shape, np.int16)
    for i, row in enumerate(preset.matrix):
        beyond = np.zeros(rate.shape[0], np.int64)
        for limit in preset.return_periods:
            beyond += ~meets(rate[:, i], limit)
        out[:, i] = np.where(rate[:, i] > 0.0, np.asarray(row)[beyond] + 1, 0)
    return out


def hazard_level(curves: HazardCurves, preset: HazardPreset) -> NDArray[np.int16]:
    """Hazard level of each place: the highest level of the matrix that its curve crosses.

    Along the curve the rate falls as the energy rises, so within a class of intensity its lower
    limit has the highest level: the thresholds alone decide.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies.

    Returns
    -------
    int16, shape (n,)
        0 where no block arrives, else the level's position in the preset plus 1.
    """
    rate = at_energies(curves, preset.thresholds_kj).rate
    highest: NDArray[np.int16] = levels_of_rates(rate, preset).max(axis=1, initial=0)
    return highest


def deciding_energy(curves: HazardCurves, preset: HazardPreset) -> IntArray:
    """Threshold of energy that gave each place its level.

    Returns
    -------
    int64, shape (n,)
        Column among ``curves.energies_kj``: the lower limit of the weakest class of intensity that
        gives the level. -1 where no block arrives.
    """
    columns = np.array([curves.column(e) for e in preset.thresholds_kj], np.int64)
    levels = levels_of_rates(curves.rate[:, columns], preset)
    # argmax takes the first of equal levels, which is the weakest class.
    return np.where(levels.max(axis=1, initial=0) > 0, columns[levels.argmax(axis=1)], -1)


# ---------------------------------------------------------------------------------------------
# How sure the level is


def level_interval(
    curves: HazardCurves, preset: HazardPreset, confidence: float = 0.95
) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Levels at the lower and at the upper limits of the rates.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies.
    confidence : float
        Of the interval of the rate at each threshold (``curves.rate_interval``).

    Returns
    -------
    lowest, highest : int16, shape (n,)
        The level lies between them. A place that blocks reach is never "not reached" at its lower
        limits. Where the sample does not give the variance, the rate may be anything above 0.
    """
    few = at_energies(curves, preset.thresholds_kj)
    lower, upper = rate_interval(few, confidence)
    return levels_of_interval(few.rate, lower, upper, preset)


def levels_of_interval(
    rate: FloatArray, lower: FloatArray, upper: FloatArray, preset: HazardPreset
) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Levels of places whose rates lie between limits, as ``level_interval``.

    Parameters
    ----------
    rate, lower, upper : float64, shape (n, n_intensities)
        Rates at the thresholds and their limits; limits that are NaN are unknown.
    """
    arrived = rate > 0.0
    least = np.finfo(np.float64).tiny
    lower = np.where(arrived, np.maximum(np.nan_to_num(lower, nan=0.0), least), 0.0)
    upper = np.where(np.isnan(upper), np.inf, upper)
    lowest = levels_of_rates(lower, preset).max(axis=1, initial=0)
    highest = levels_of_rates(upper, preset).max(axis=1, initial=0)
    return lowest, np.where(arrived.any(axis=1), highest, 0).astype(np.int16)


def uncertain(
    curves: HazardCurves, preset: HazardPreset, confidence: float = 0.95
) -> NDArray[np.bool_]:
    """Whether another sample of blocks might give a place another level, shape (n,)."""
    lowest, highest = level_interval(curves, preset, confidence)
    differ: NDArray[np.bool_] = lowest != highest
    return differ


def rocks_factor(
    curves: HazardCurves,
    preset: HazardPreset,
    confidence: float = 0.95,
    unsure: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """How many times the blocks it would take to decide the level of each place.

    With g times the blocks of every source, the rates being as they are, the variance falls to v/g
    and the rate of one block to w/g; the factor is the least g for which both ends of the interval
    give the same level.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies.
    unsure : bool, shape (n,), optional
        What ``uncertain`` gives, where that is known already.

    Returns
    -------
    float64, shape (n,)
        1 where the level is decided; infinite where the rate lies on a limit of the matrix, so that
        no sample decides; NaN where the sample does not give its variance. Rounded up by 1.4 %.
    """
    few = at_energies(curves, preset.thresholds_kj)
    unsure = uncertain(few, preset, confidence) if unsure is None else unsure
    out = np.ones(unsure.size)
    untold = np.isnan(few.variance).any(axis=1)
    out[unsure & untold] = np.nan
    rows = np.flatnonzero(unsure & ~untold)

    def still(of: IntArray, factor: FloatArray) -> NDArray[np.bool_]:
        more = HazardCurves(
            few.places[of],
            few.energies_kj,
            few.rate[of],
            few.variance[of] / factor[:, None],
            few.rate_of_a_rock[of] / factor,
        )
        return uncertain(more, preset, confidence)

    never = still(rows, np.full(rows.size, MAX_FACTOR))
    out[rows[never]] = np.inf
    rows = rows[~never]
    low = np.zeros(rows.size)
    high = np.full(rows.size, np.log2(MAX_FACTOR))
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        more_needed = still(rows, 2.0**middle)
        low = np.where(more_needed, middle, low)
        high = np.where(more_needed, high, middle)
    out[rows] = 2.0**high
    return out
