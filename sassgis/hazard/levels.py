"""Intensity classes and hazard levels from hazard curves, and how sure they are.

Codes: 0 is "not reached"; intensity 1 and level 1 are the weakest of the preset.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sassgis.hazard.curves import at_energies, meets
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.hazard import HazardCurves, HazardPreset

#: Beyond this many times the blocks a cell counts as one that no sample decides.
MAX_FACTOR = 2.0**20


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
        blocks arrive that often at all. None: the extreme event, whatever is not rarer than the
        preset's ``rarest_years``.

    Returns
    -------
    int16, shape (n,)
        0 where blocks arrive less often, else the class's position in the preset plus 1.
    """
    rate = at_energies(curves, preset.thresholds_kj).rate
    met = _counts(rate, preset) if years is None else meets(rate, years)
    codes = np.where(met, np.arange(1, rate.shape[1] + 1, dtype=np.int16), np.int16(0))
    strongest: NDArray[np.int16] = codes.max(axis=1, initial=0)
    return strongest


def _counts(rate: FloatArray, preset: HazardPreset) -> NDArray[np.bool_]:
    """Whether a rate is high enough for any level."""
    some: NDArray[np.bool_] = rate > 0.0
    return some if preset.rarest_years is None else some & meets(rate, preset.rarest_years)


def levels_of_rates(rate: FloatArray, preset: HazardPreset) -> NDArray[np.int16]:
    """Level of each field of the matrix that the rates of a place meet.

    Parameters
    ----------
    rate : float64, shape (n, n_intensities)
        λ(E >= lower limit of each class of intensity) per year.

    Returns
    -------
    int16, shape (n, n_intensities)
        Level of the field (class i, class of return period of T = 1/λ_i); 0 where λ_i is 0, or T is
        beyond the preset's ``rarest_years``. The limit of a class of return period belongs to it
        (T <= 30).
    """
    out = np.zeros(rate.shape, np.int16)
    for i, row in enumerate(preset.matrix):
        beyond = np.zeros(rate.shape[0], np.int64)
        for limit in preset.return_periods:
            beyond += ~meets(rate[:, i], limit)
        out[:, i] = np.where(_counts(rate[:, i], preset), np.asarray(row)[beyond] + 1, 0)
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
        0 where no block arrives, or too rarely for any level, else the level's position in the
        preset plus 1.
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
        gives the level. -1 where there is none.
    """
    columns = np.array([curves.column(e) for e in preset.thresholds_kj], np.int64)
    levels = levels_of_rates(curves.rate[:, columns], preset)
    # argmax takes the first of equal levels, which is the weakest class.
    return np.where(levels.max(axis=1, initial=0) > 0, columns[levels.argmax(axis=1)], -1)


# ---------------------------------------------------------------------------------------------
# What another sample of as many blocks would say


def limits_of_levels(preset: HazardPreset) -> FloatArray:
    """Least rate of each class of intensity that gives each level or a higher one.

    Returns
    -------
    float64, shape (n_levels, n_intensities)
        Per year; infinite where the class never gives it, 0 where any block does.
    """
    last = 0.0 if preset.rarest_years is None else 1.0 / preset.rarest_years
    rates = np.array([*(1.0 / t for t in preset.return_periods), last])
    matrix = np.asarray(preset.matrix)
    return np.array(
        [np.where(matrix >= k, rates, np.inf).min(axis=1) for k in range(len(preset.levels))]
    )


def chance_of_at_least(curves: HazardCurves, preset: HazardPreset) -> FloatArray:
    """Probability that another sample of as many blocks gives a place each level or a higher one.

    With one weight w of all blocks a place has n = λ/w of them, and another sample, of which n is
    all that is known, has a number N with P(N >= k) = I(k, n) at one half, the negative binomial
    (the mean of N has a gamma distribution with shape n: no more blocks are to be expected than
    there were). With several weights w = v/λ, for which λ has its variance v. The classes of
    intensity are counted on the same blocks: the most probable of those that give a level decides.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies.

    Returns
    -------
    float64, shape (n, n_levels + 2)
        Column k: of level k, 0 being none; the first is 1, the last 0. One half where the sample
        does not give the variance.
    """
    few = at_energies(curves, preset.thresholds_kj)
    limits = limits_of_levels(preset)
    known = few.rate > 0.0
    weight = np.divide(few.variance, few.rate, out=np.zeros_like(few.rate), where=known)
    chance = np.zeros((few.rate.shape[0], len(limits) + 2))
    chance[:, 0] = 1.0
    for k, of_class in enumerate(limits, start=1):
        for i in np.flatnonzero(np.isfinite(of_class)).tolist():
            own = _chance_of_rate(few.rate[:, i], weight[:, i], float(of_class[i]))
            np.maximum(chance[:, k], own, out=chance[:, k])
    # A level that is reached is reached by the lower ones too, whatever the rounding.
    chance[:, ::-1] = np.maximum.accumulate(chance[:, ::-1], axis=1)
    return chance


def _chance_of_rate(rate: FloatArray, weight: FloatArray, limit: float) -> FloatArray:
    """Probability that another sample gives at least a rate ``limit``."""
    out = ((rate > 0.0) & (rate >= limit * (1.0 - 1e-12))).astype(np.float64)
    out[np.isnan(weight)] = 0.5
    some = np.flatnonzero((weight > 1e-12 * limit) & (rate > 0.0))
    w = weight[some]
    blocks = np.maximum(np.ceil(limit / w - 1e-6), 1.0)
    out[some] = special.betainc(blocks, rate[some] / w, 0.5)
    return out


def change_chance(curves: HazardCurves, preset: HazardPreset) -> FloatArray:
    """Probability that another sample of as many blocks gives a place another level, shape (n,)."""
    chance = chance_of_at_least(curves, preset)
    level = hazard_level(curves, preset).astype(np.int64)[:, None]
    own = np.take_along_axis(chance, level, 1) - np.take_along_axis(chance, level + 1, 1)
    out: FloatArray = 1.0 - own[:, 0]
    return out


def changed_share(curves: HazardCurves, preset: HazardPreset) -> float:
    """Area whose level another sample would change, as a share of the area that has a level.

    An expected value. Of two samples either may be the first: as many cells are raised as are
    lowered, and so cells that this sample did not reach count like those that it did.

    Returns
    -------
    float
        Above 1 where more changes than has a level; 0 without any.
    """
    chance = chance_of_at_least(curves, preset)
    level = hazard_level(curves, preset).astype(np.int64)[:, None]
    lowered = float((1.0 - np.take_along_axis(chance, level, 1)).sum())
    raised = float(np.take_along_axis(chance, level + 1, 1).sum())
    zoned = int((level > 0).sum())
    return (lowered + max(lowered, raised)) / zoned if zoned else 0.0


def level_interval(
    curves: HazardCurves, preset: HazardPreset, confidence: float = 0.95
) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Levels between which another sample of as many blocks would put a place.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies.
    confidence : float
        Probability of each end: that the level is not lower, and that it is not higher.

    Returns
    -------
    lowest, highest : int16, shape (n,)
        The level of this sample lies between them.
    """
    chance = chance_of_at_least(curves, preset)
    level = hazard_level(curves, preset)
    lowest = (chance[:, 1:] >= confidence).sum(axis=1)
    highest = (chance[:, 1:] > 1.0 - confidence).sum(axis=1)
    return (
        np.minimum(lowest, level).astype(np.int16),
        np.maximum(highest, level).astype(np.int16),
    )


def uncertain(
    curves: HazardCurves, preset: HazardPreset, confidence: float = 0.95
) -> NDArray[np.bool_]:
    """Whether another sample of blocks might give a place another level, shape (n,)."""
    lowest, highest = level_interval(curves, preset, confidence)
    differ: NDArray[np.bool_] = lowest != highest
    return differ


def rocks_factor(
    curves: HazardCurves, preset: HazardPreset, confidence: float = 0.95
) -> FloatArray:
    """About how many times the blocks it would take to decide the level of each place.

    With g times the blocks of every source, the rates being as they are, the variance falls to v/g.
    Two such samples differ with a variance of 2 v/g; taken as normal, a limit is out of reach from
    g = 2 z² v / (λ − limit)² on.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies.

    Returns
    -------
    float64, shape (n,)
        1 where the level is decided; infinite where the rate lies on a limit of the matrix, so that
        no sample decides; NaN where the sample does not give its variance.
    """
    few = at_energies(curves, preset.thresholds_kj)
    unsure = uncertain(few, preset, confidence)
    level = hazard_level(few, preset)
    limits = np.vstack(
        [np.zeros(few.rate.shape[1]), limits_of_levels(preset), np.full(few.rate.shape[1], np.inf)]
    )
    spread = 2.0 * special.ndtri(confidence) ** 2 * few.variance
    with np.errstate(divide="ignore", invalid="ignore"):
        below = few.rate - limits[level]
        above = limits[level + 1] - few.rate
        # Kept by any class that gives the level; a higher one must be given by none.
        kept = np.where(below >= 0.0, spread / below**2, np.inf).min(axis=1)
        out_of_reach = np.where(np.isinf(above), 0.0, spread / above**2).max(axis=1)
    needed = np.maximum(np.where(level > 0, kept, 0.0), out_of_reach)
    needed = np.where(needed > MAX_FACTOR, np.inf, np.maximum(needed, 1.0))
    out = np.where(unsure, needed, 1.0)
    out[unsure & np.isnan(few.variance).any(axis=1)] = np.nan
    return out
