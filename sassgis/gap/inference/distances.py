"""The score of an ensemble against one observation, and the distance of rocks from a model.

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
own stands for it before any distance is taken (``sassgis.gap.calibration.problem.Scale``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from sassgis.model.grid import FloatArray


def energy_scores(observed: FloatArray, replicas: NDArray[np.floating]) -> FloatArray:
    """Energy score of each observation against its own replicas: E|Y − y| − ½ E|Y − Y'|.

    Strictly proper: it is smallest, in the mean, for the distribution that nature draws from
    (T. Gneiting and A. E. Raftery, 2007, Strictly proper scoring rules, prediction, and estimation,
    J. Am. Stat. Assoc. 102, 359-378, equation 22). In one dimension it is the CRPS. Pairs of a
    replica with itself are left out, so that the expected score does not depend on their number
    (C. A. T. Ferro, 2014, Fair scores for ensemble forecasts, Q. J. R. Meteorol. Soc. 140,
    1917-1923).

    Parameters
    ----------
    observed : float64, shape (n, p)
        In units that count alike; NaN where not measured: left out, distances are stretched.
    replicas : float, shape (m, n, p)
        One that lacks a quantity of the observation is left out: encode what did not happen as a
        coordinate of its own first.

    Returns
    -------
    float64, shape (n,)
        NaN where nothing was measured or fewer than two replicas are left.
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
    #: The same distance where each of the replicas stands in for what was observed, shape (m,).
    floors: FloatArray

    @classmethod
    def of(cls, observed: FloatArray, replicas: FloatArray) -> RockDistances:
        """Distances of rows of rocks, shapes (n_rocks, p) and (m, n_rocks, p), m of two or more."""
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
        """The distance, unbiased; with weights of the rocks."""
        n = len(self.pairs)
        own = np.full(n, 1.0 / n) if weights is None else weights / weights.sum()
        return float(own @ self.pairs @ own / (1.0 - own @ own))

    def drawn(self, weights: FloatArray) -> FloatArray:
        """Distances in samples of the rocks, from weights of shape (samples, n_rocks)."""
        return np.array([self.value(own) for own in weights])

    @property
    def floor(self) -> float:
        """What chance leaves: the mean distance of a replica from the others, near zero."""
        return float(self.floors.mean())

    @property
    def above_chance(self) -> bool:
        """Whether the gap exceeds the 95 % quantile of that of replicas."""
        return bool(self.value() > self.floor + 1.645 * self.floors.std(ddof=1))
