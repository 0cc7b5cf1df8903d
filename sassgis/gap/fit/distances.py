"""Score ensembles, take distances of rocks from models, and give intervals of estimates.

Rocks are the unit of resampling everywhere: what one rock did at five stations is one draw from
nature, not five.

Missing entries
---------------
Which quantities were observed differs from rock to rock. Two kinds of gaps are kept apart.

*Not measured* is NaN. Whatever is compared is compared in the quantities that are there, and a
score over ``k`` of ``p`` quantities is stretched by sqrt(p / k), so that a rock with few of them
weighs as much as one with many (the partial distance of J. K. Dixon, 1979, Pattern recognition
with partly missing data, IEEE Trans. Syst. Man Cybern. 9, 617-621). It is assumed that why
something was not measured has nothing to do with its value.

*Did not happen* (a rock that never reached a station has no speed there) is information and must
not be left out: a model in which no rock arrives would escape its punishment. A coordinate of its
own represents it before any distance is taken (``sassgis.gap.fit.site_data.Scale``).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial.distance import cdist

from sassgis.gap.constants import FOLDS
from sassgis.grid import FloatArray, IntArray


def _rows_by_rock(rock: IntArray) -> list[IntArray]:
    _, counts = np.unique(rock, return_counts=True)
    return np.split(np.argsort(rock, kind="stable"), np.cumsum(counts)[:-1])


def bootstrap_rows(rock: IntArray, draws: int, rng: np.random.Generator) -> Iterator[IntArray]:
    """Yield rows of samples of whole rocks, drawn with replacement; ``rock``: of each row, (n,)."""
    rows = _rows_by_rock(rock)
    for _ in range(draws):
        yield np.concatenate([rows[k] for k in rng.integers(len(rows), size=len(rows))])


def times_drawn(unit: IntArray, rng: np.random.Generator, samples: int) -> FloatArray:
    """Count how often samples of units (numbered from 0) hold each rock, (samples, n_rocks)."""
    n = int(unit.max()) + 1
    times = rng.multinomial(n, np.full(n, 1.0 / n), size=samples)
    return np.asarray(times[:, unit], np.float64)


def folds_of(group: IntArray, seed: int) -> IntArray:
    """Return the part of each rock for cross-validation; a single group is split, (n_rocks,)."""
    rng = np.random.default_rng([seed, 21])
    groups, unit = np.unique(group, return_inverse=True)
    if groups.size == 1:
        unit = np.arange(group.size)
    size = np.bincount(unit)
    order = rng.permutation(size.size)
    # The largest first, each into the part that has the fewest rocks so far.
    order = order[np.argsort(-size[order], kind="stable")]
    part_of, filled = np.empty(size.size, np.int64), np.zeros(min(FOLDS, size.size), np.int64)
    for k in order.tolist():
        part_of[k] = int(np.argmin(filled))
        filled[part_of[k]] += size[k]
    return part_of[unit]


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate with its interval."""

    value: float
    low: float
    high: float


def quantiles_of(values: FloatArray, shares: Sequence[float]) -> FloatArray:
    """Compute ``numpy.quantile`` of few values, in a tenth of its time; NaN of none."""
    known = np.sort(values)
    if not known.size:
        return np.full(len(shares), np.nan)
    return np.interp(np.multiply(shares, known.size - 1), np.arange(known.size), known)


def bootstrap_interval(
    statistic: Callable[[IntArray], float],
    rock: IntArray,
    *,
    draws: int,
    rng: np.random.Generator,
    method: Literal["percentile", "BCa"] = "BCa",
) -> Interval:
    """Return 95 % interval of a statistic by resampling rocks (``scipy.stats.bootstrap``).

    Rock numbers are resampled; each brings all its rows.

    Parameters
    ----------
    statistic : callable
        Takes rows (int64; repeated ones count as often) and returns a number.
    rock : int64, shape (n,)
        Rock of each row.
    method : {"percentile", "BCa"}
        ``BCa`` corrects the percentiles for bias and skewness by a jackknife over rocks (B. Efron,
        1987, Better bootstrap confidence intervals, J. Am. Stat. Assoc. 82, 171-185).

    Returns
    -------
    Interval
        Limits are NaN if there are fewer than two rocks. With fewer than about twenty the interval
        is too narrow: the coverage of 95 % intervals is then nearer to 90 %.
    """
    value = float(statistic(np.arange(np.size(rock), dtype=np.int64)))
    rows = _rows_by_rock(rock)
    if len(rows) < 2:
        return Interval(value, math.nan, math.nan)
    with warnings.catch_warnings():
        # A statistic without scatter has no limits: NaN says so.
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        found = stats.bootstrap(
            (np.arange(len(rows)),),
            lambda drawn: statistic(np.concatenate([rows[i] for i in drawn])),
            n_resamples=draws,
            vectorized=False,
            method=method,
            rng=rng,
        ).confidence_interval
    return Interval(value, float(found.low), float(found.high))


def mean_interval(values: FloatArray) -> Interval:
    """Return Student's 95 % interval of the mean of independent values; NaN of fewer than two."""
    if values.size < 2:
        return Interval(math.nan, math.nan, math.nan)
    mean = float(values.mean())
    error = float(values.std(ddof=1)) / math.sqrt(values.size)
    half = float(stats.t.ppf(0.975, values.size - 1)) * error
    return Interval(mean, mean - half, mean + half)


def energy_scores(observed: FloatArray, replicas: NDArray[np.floating]) -> FloatArray:
    """Return energy score of each observation against its replicas: E|Y − y| − ½ E|Y − Y'|, (n,).

    Strictly proper: it is smallest, in the mean, for the distribution that nature draws from (T.
    Gneiting and A. E. Raftery, 2007, Strictly proper scoring rules, prediction, and estimation, J.
    Am. Stat. Assoc. 102, 359-378, equation 22). In one dimension it is the CRPS. Pairs of a replica
    with itself are left out, so that the expected score does not depend on their number (C. A. T.
    Ferro, 2014, Fair scores for ensemble forecasts, Q. J. R. Meteorol. Soc. 140, 1917-1923).

    ``observed``: shape (n, p), in units that count alike, NaN where not measured: distances are
    stretched. ``replicas``: shape (m, n, p); one that lacks an observed quantity is left out. NaN
    where nothing was measured or fewer than two replicas remain.
    """
    known = np.isfinite(observed)
    seen = np.where(known, observed, 0.0)
    members = np.asarray(replicas, np.float64)
    has = np.isfinite(members) | ~known
    members = np.where(known & has, members, 0.0)
    whole = np.asarray(has.all(axis=2), np.bool_)
    count = whole.sum(axis=0)
    near = (np.sqrt(((members - seen) ** 2).sum(axis=2)) * whole).sum(axis=0)
    apart = np.zeros(len(seen))
    for i in range(len(members) - 1):
        between = np.sqrt(((members[i] - members[i + 1 :]) ** 2).sum(axis=2))
        apart += (between * (whole[i] & whole[i + 1 :])).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        stretch = np.sqrt(observed.shape[1] / known.sum(axis=1))
        scores = stretch * (near / count - apart / (count * (count - 1)))
    return np.where((count > 1) & known.any(axis=1), scores, np.nan)


@dataclass(frozen=True, slots=True)
class RockDistances:
    """Energy distance between the observed rocks and those of a model, from pairs of rocks.

    2 E|X − Y| − E|X − X'| − E|Y − Y'| (G. J. Székely and M. L. Rizzo, 2013, Energy statistics,
    J. Stat. Plan. Inference 143, 1249-1272). Only pairs of different rocks count, so that the
    distance is zero in the mean if each observed rock is one more draw of its replicas, whatever
    the rocks differ in.
    """

    #: 2 |x_i − y_j| − |x_i − x_j| − |y_i − y_j|, means over replicas, zero on the diagonal; shape
    #: (n_rocks, n_rocks).
    pairs: FloatArray
    #: The same distance where each of the replicas represents the observations, shape (m,).
    floors: FloatArray

    @classmethod
    def of(cls, observed: FloatArray, replicas: FloatArray) -> RockDistances:
        """Compute distances of rows of rocks, shapes (n_rocks, p) and (m, n_rocks, p), m >= 2."""
        m, n = replicas.shape[:2]
        across = np.mean([cdist(observed, one) for one in replicas], axis=0)
        among = np.zeros((n, n))
        between = np.zeros((m, m))
        for i in range(m):
            for j in range(i + 1):
                own = cdist(replicas[i], replicas[j])
                np.fill_diagonal(own, 0.0)
                among += own if i == j else own + own.T
                between[i, j] = between[j, i] = own.sum() / (n * (n - 1))
        pairs = across + across.T - cdist(observed, observed) - among / m**2
        np.fill_diagonal(pairs, 0.0)
        floors = []
        for k in range(m):
            # One replica from all the others.
            rest = np.delete(np.arange(m), k)
            within = between[np.ix_(rest, rest)].mean()
            floors.append(float(2.0 * between[k, rest].mean() - between[k, k] - within))
        return cls(pairs, np.array(floors))

    def value(self, weights: FloatArray | None = None) -> float:
        """Return the distance, unbiased; with weights of the rocks."""
        n = len(self.pairs)
        own = np.full(n, 1.0 / n) if weights is None else weights / weights.sum()
        return float(own @ self.pairs @ own / (1.0 - own @ own))

    def drawn(self, weights: FloatArray) -> FloatArray:
        """Return distances in samples of the rocks, from weights of shape (samples, n_rocks)."""
        return np.array([self.value(own) for own in weights])

    @property
    def floor(self) -> float:
        """Distance by chance: the mean distance of a replica from the others, near zero."""
        return float(self.floors.mean())

    @property
    def above_chance(self) -> bool:
        """Whether the gap exceeds the 95 % quantile of that of replicas."""
        return bool(self.value() > self.floor + 1.645 * self.floors.std(ddof=1))
