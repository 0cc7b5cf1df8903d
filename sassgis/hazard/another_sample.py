"""What another sample of as many blocks would make of the hazard levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sassgis.hazard.curves import at_energies
from sassgis.hazard.levels import hazard_level, limits_of_levels
from sassgis.model.grid import BoolArray, FloatArray
from sassgis.model.hazard import HazardCurves, HazardPreset

#: Beyond this many times the blocks a cell counts as one that no sample decides.
MAX_FACTOR = 2.0**20


@dataclass(frozen=True)
class LevelChances:
    """Levels that another sample of as many blocks would give the places of a sample.

    Attributes
    ----------
    level : int16, shape (n,)
        Hazard level of this sample.
    at_least : float64, shape (n, n_levels + 2)
        Column k: probability of level k or a higher one, 0 being none; the first is 1, the last 0.
        One half where the sample does not give the variance.
    """

    level: NDArray[np.int16]
    at_least: FloatArray

    @property
    def lowered(self) -> FloatArray:
        """Probability of a lower level, shape (n,)."""
        return 1.0 - self._at_least_level(0)

    @property
    def raised(self) -> FloatArray:
        """Probability of a higher level, shape (n,)."""
        return self._at_least_level(1)

    def _at_least_level(self, more: int) -> FloatArray:
        column = self.level.astype(np.int64)[:, None] + more
        return np.take_along_axis(self.at_least, column, 1)[:, 0]

    @property
    def changed(self) -> FloatArray:
        """Probability of another level, shape (n,)."""
        return self.lowered + self.raised

    @property
    def changed_share(self) -> float:
        """Area whose level would change, as a share of the area that has a level.

        An expected value. Of two samples either may be the first: as many cells are raised as are
        lowered, and so cells that this sample did not reach count like those that it did. Above 1
        where more changes than has a level; 0 without any.
        """
        lowered, raised = float(self.lowered.sum()), float(self.raised.sum())
        zoned = int((self.level > 0).sum())
        return (lowered + max(lowered, raised)) / zoned if zoned else 0.0

    def interval(self, confidence: float) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
        """Levels between which another sample would put each place.

        Parameters
        ----------
        confidence : float
            Probability of each end: that the level is not lower, and that it is not higher.

        Returns
        -------
        lowest, highest : int16, shape (n,)
            The level of this sample lies between them.
        """
        lowest = (self.at_least[:, 1:] >= confidence).sum(axis=1)
        highest = (self.at_least[:, 1:] > 1.0 - confidence).sum(axis=1)
        return (
            np.minimum(lowest, self.level).astype(np.int16),
            np.maximum(highest, self.level).astype(np.int16),
        )

    def uncertain(self, confidence: float) -> BoolArray:
        """Whether another sample might give a place another level, shape (n,)."""
        lowest, highest = self.interval(confidence)
        differ: BoolArray = lowest != highest
        return differ


def level_chances(curves: HazardCurves, preset: HazardPreset) -> LevelChances:
    """Levels that another sample of as many blocks would give.

    With one weight w of all blocks a place has n = λ/w of them, and another sample, of which n is
    all that is known, has a number N with P(N >= k) = I(k, n) at one half, the negative binomial
    (the mean of N has a gamma distribution with shape n: no more blocks are to be expected than
    there were). With several weights w = v/λ, for which λ has its variance v. The classes of
    intensity are counted on the same blocks: the most probable of those that give a level decides.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies.
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
    return LevelChances(hazard_level(few, preset), chance)


def _chance_of_rate(rate: FloatArray, weight: FloatArray, limit: float) -> FloatArray:
    """Probability that another sample gives at least a rate ``limit``."""
    out = ((rate > 0.0) & (rate >= limit * (1.0 - 1e-12))).astype(np.float64)
    out[np.isnan(weight)] = 0.5
    some = np.flatnonzero((weight > 1e-12 * limit) & (rate > 0.0))
    w = weight[some]
    blocks = np.maximum(np.ceil(limit / w - 1e-6), 1.0)
    out[some] = special.betainc(blocks, rate[some] / w, 0.5)
    return out


def rocks_factor(
    curves: HazardCurves, preset: HazardPreset, chances: LevelChances, confidence: float
) -> FloatArray:
    """About how many times the blocks it would take to decide the level of each place.

    With g times the blocks of every source, the rates being as they are, the variance falls to v/g.
    Two such samples differ with a variance of 2 v/g; taken as normal, a limit is out of reach from
    g = 2 z² v / (λ − limit)² on.

    Parameters
    ----------
    curves : HazardCurves
        With the thresholds of the preset among its energies.
    chances : LevelChances
        Of these curves.

    Returns
    -------
    float64, shape (n,)
        1 where the level is decided; infinite where the rate lies on a limit of the matrix, so that
        no sample decides; NaN where the sample does not give its variance.
    """
    few = at_energies(curves, preset.thresholds_kj)
    unsure, level = chances.uncertain(confidence), chances.level
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
