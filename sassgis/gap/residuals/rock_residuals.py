"""Observed against predicted, rock by rock, and tests of many mean gaps at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from sassgis.gap.constants import MOST_NUMBERS
from sassgis.grid import FloatArray, IntArray


def _as_matrix(values: FloatArray) -> FloatArray:
    """Return rows by quantities; a single quantity may come as a vector."""
    array = np.asarray(values, np.float64)
    return array[:, None] if array.ndim == 1 else array


def rock_means(values: FloatArray, rock: IntArray) -> tuple[FloatArray, IntArray]:
    """Return means over the rows of each rock, NaN without, (n_rocks, k), and the rocks."""
    data = _as_matrix(values)
    rocks, index = np.unique(np.asarray(rock, np.int64), return_inverse=True)
    known = np.isfinite(data)
    sums, counts = np.zeros((2, rocks.size, data.shape[1]))
    np.add.at(sums, index, np.where(known, data, 0.0))
    np.add.at(counts, index, known)
    with np.errstate(invalid="ignore"):
        return sums / counts, rocks


def t_statistics(values: FloatArray) -> FloatArray:
    """Return mean over standard error of columns of rocks, (k,); NaN of fewer than three."""
    data = _as_matrix(values)
    known = np.isfinite(data)
    count = known.sum(axis=0)
    filled = np.where(known, data, 0.0)
    return _t(filled.sum(axis=0), (filled**2).sum(axis=0), count)


def sureness(values: FloatArray) -> float:
    """Return mean over standard error of the values of rocks, (n,); 0 of fewer than three."""
    return float(np.nan_to_num(t_statistics(values)[0]))


def _t(sums: FloatArray, squares: FloatArray, count: IntArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums / count
        variance = np.maximum(squares / count - mean**2, 0.0) * count / (count - 1)
        # What remains of equal values is rounding.
        variance = np.where(variance < 1e-14 * mean**2, 0.0, variance)
        t = mean / np.sqrt(variance / count)
    t = np.where(sums == 0.0, 0.0, t)
    return np.where(count >= 3, t, np.nan)


def max_t_adjusted(statistic: FloatArray, null: FloatArray) -> FloatArray:
    """Adjust p-values for the number of comparisons by the largest statistic under the null, (k,).

    P. H. Westfall and S. S. Young (1993, Resampling-based multiple testing): the chance of even one
    false finding is kept below the level, and what the comparisons have in common is used. Each
    statistic is compared with the largest of those that are not stronger than itself (step-down).

    ``statistic``: the larger, the stronger, (k,), NaN where there is none; ``null``: the same from
    data in which there is nothing to find, (draws, k), NaN never wins.
    """
    observed = np.asarray(statistic, np.float64)
    p = np.full(observed.shape, np.nan)
    use = np.flatnonzero(np.isfinite(observed) | np.isposinf(observed))
    if not use.size:
        return p
    order = use[np.argsort(-observed[use], kind="stable")]
    drawn = np.where(np.isnan(null), -np.inf, null)[:, order]
    largest = np.maximum.accumulate(drawn[:, ::-1], axis=1)[:, ::-1]
    reached = (largest >= observed[order]).sum(axis=0)
    p[order] = np.maximum.accumulate((reached + 1.0) / (len(null) + 1.0))
    return p


def holm_adjusted(p: FloatArray) -> FloatArray:
    """Return p-values, shape (k,), adjusted for their number, whatever their dependence.

    S. Holm (1979, A simple sequentially rejective multiple test procedure, Scand. J. Stat. 6,
    65-70).
    """
    adjusted = np.empty(p.size)
    order = np.argsort(p, kind="stable")
    steps = np.minimum(p[order] * np.arange(p.size, 0, -1), 1.0)
    adjusted[order] = np.maximum.accumulate(steps)
    return adjusted


def mean_gap_tests(
    values: FloatArray, *, draws: int, rng: np.random.Generator, unit: IntArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return t, two-sided p, and p adjusted for their number, of mean gaps, (k,); NaN of few rocks.

    Under the null the signs of all entries of a unit may be flipped together: exact if gaps are
    symmetric about zero. Of our own making: ``scipy.stats.permutation_test`` flips signs as well,
    but knows no missing entries and no maximum over columns, which draws the same flips for all.
    ``values``: observed minus predicted, one row per rock, (n, k); ``unit``: of each rock, from 0.
    """
    data = _as_matrix(values)
    n = len(data)
    unit = np.arange(n) if unit is None else unit
    known = np.isfinite(data)
    filled = np.where(known, data, 0.0)
    t = t_statistics(data)
    null = np.empty((draws, data.shape[1]))
    step = max(1, MOST_NUMBERS // max(1, n))
    count = known.sum(axis=0)
    squares = (filled**2).sum(axis=0)
    for first in range(0, draws, step):
        rows = min(step, draws - first)
        signs = rng.choice((-1.0, 1.0), size=(rows, int(unit.max(initial=-1)) + 1))[:, unit]
        null[first : first + rows] = _t(signs @ filled, squares, count)
    # A draw that repeats the data must not miss it by rounding.
    size = np.abs(null) * (1.0 + 1e-12)
    reached = (np.where(np.isnan(size), -np.inf, size) >= np.abs(t)).sum(axis=0)
    p = np.where(np.isnan(t), np.nan, (reached + 1.0) / (draws + 1.0))
    return t, p, max_t_adjusted(np.abs(t), size)


def false_discovery_adjusted(p: FloatArray) -> FloatArray:
    """Adjust p-values so that the share of false findings stays below the level, (k,); NaN stays.

    Y. Benjamini and Y. Hochberg (1995, Controlling the false discovery rate, J. R. Stat. Soc. B 57,
    289-300); for independent or positively dependent comparisons.
    """
    adjusted = np.array(p, np.float64)
    known = np.isfinite(adjusted)
    if known.any():
        adjusted[known] = stats.false_discovery_control(adjusted[known])
    return adjusted


#: Units by the end of the name of a quantity.
_UNITS = {"_mps": "m/s", "_mps2": "m/s²", "_hz": "1/s", "_m": "m", "_deg": "°", "_radps": "rad/s"}


@dataclass(frozen=True, slots=True)
class Residual:
    """One quantity at one place, of all rocks; arrays of shape (n_rocks,)."""

    # As in ``sassgis.gap.diagnosis.GapFinding``.
    place: str
    phase: str
    quantity: str
    test: str
    # NaN for rocks without one.
    observed: FloatArray
    predicted: FloatArray
    # Chainages between which the place lies (m).
    s0_m: float
    s1_m: float
    score: FloatArray | None = None  # tested for a mean of zero; default: observed less predicted
    #: Of the rocks in the means, for quantities measured more closely on some of them.
    weight: FloatArray | None = None
    steps: int = 0  # single values that the means of the rocks are of; 0 for one a rock

    @property
    def gap(self) -> FloatArray:
        """Observed less predicted, shape (n_rocks,)."""
        return self.observed - self.predicted

    @property
    def unit(self) -> str:
        """Unit of the quantity."""
        name = self.quantity.removesuffix("_spread")
        return next((u for end, u in _UNITS.items() if name.endswith(end)), "1")

    def tested(self) -> FloatArray:
        """Return values whose mean over rocks is zero if there is no gap, shape (n_rocks,)."""
        values = self.gap if self.score is None else self.score
        values = np.where(np.isfinite(self.gap), values, np.nan)
        if self.weight is None:
            return values
        known = np.isfinite(values)
        mean = np.mean(self.weight[known]) if known.any() else 1.0
        return values * self.weight / mean


def per_rock(values: FloatArray, rock: IntArray, n_rocks: int) -> FloatArray:
    """Return the mean of the rows of each rock, shape (n_rocks,); NaN for rocks without any."""
    result = np.full(n_rocks, np.nan)
    own = rock >= 0
    if own.any():
        means, rocks = rock_means(values[own], rock[own])
        result[rocks] = means[:, 0]
    return result


def rows_per_rock(values: FloatArray, rock: IntArray, n_rocks: int) -> FloatArray:
    """Return the number of rows of each rock that have a value, shape (n_rocks,).

    It is the weight of a rock in means over single steps: a rock that springs far makes few steps,
    so that the mean over rocks of their means would count the far ones too much.
    """
    own = (rock >= 0) & np.isfinite(values)
    return np.bincount(rock[own], minlength=n_rocks).astype(np.float64)


def mean_of_draws(draws: FloatArray, least: int = 2) -> FloatArray:
    """Return the mean over the last axis, missing ones left out; NaN where there are too few."""
    known = np.isfinite(draws)
    count = known.sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(known, draws, 0.0).sum(axis=-1) / count
    return np.where(count >= least, mean, np.nan)


def spread(observed: FloatArray, draws: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return distances of observations (n,) from the mean of draws (n, m), expected ones, a score.

    The score is |PIT − ½| less its mean under the model: above zero if the observed scatter more.
    The PIT, the share of draws below the observation, is uniform if the model is right.
    """
    known = np.isfinite(draws)
    count = known.sum(axis=-1).astype(float)
    centre = mean_of_draws(draws, least=3)
    with np.errstate(invalid="ignore", divide="ignore"):
        away = np.where(known, np.abs(draws - centre[:, None]), 0.0).sum(axis=-1) / count
        # A draw pulls the mean towards itself, an observation does not.
        expected = away * np.sqrt((count + 1.0) / (count - 1.0))
        below = (known & (draws < observed[:, None])).sum(axis=-1)
        equal = (known & (draws == observed[:, None])).sum(axis=-1)
        pit = (below + 0.5 * equal + 0.5) / (count + 1.0)
        half = np.floor(count / 2.0)
        # Mean of |(r + ½)/(m + 1) − ½| over the equally likely ranks r = 0 … m.
        usual = (
            np.where(count % 2 == 0, half * (half + 1.0), (half + 1.0) ** 2) / (count + 1.0) ** 2
        )
        score = np.abs(pit - 0.5) - usual
    few = count < 3
    return (
        np.where(few, np.nan, np.abs(observed - centre)),
        np.where(few, np.nan, expected),
        np.where(few | ~np.isfinite(observed), np.nan, score),
    )


def only_above(score: FloatArray) -> FloatArray:
    """Return scores of a scatter known from above only: less than that is no gap."""
    known = score[np.isfinite(score)]
    return score if known.size and known.mean() > 0.0 else np.where(np.isfinite(score), 0.0, score)


def beyond(gap: FloatArray, tolerance: float) -> FloatArray:
    """Return gaps, shape (n,), moved together towards zero by a tolerance of their mean."""
    known = gap[np.isfinite(gap)]
    mean = float(known.mean()) if known.size else 0.0
    left: FloatArray = gap - np.clip(mean, -tolerance, tolerance)
    return left
