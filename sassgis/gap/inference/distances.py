"""Distances of distributions, and scores of an ensemble against one observation.

Rocks are the unit of resampling everywhere: what one rock did at five stations is one draw from
nature, not five.

Missing entries
---------------
Which quantities were observed differs from rock to rock. Two kinds of gaps are kept apart.

*Not measured* is NaN. Whatever is compared is compared in the quantities that are there, and a
distance over ``k`` of ``p`` quantities is stretched by sqrt(p / k), so that a rock with few of
them weighs as much as one with many (the partial distance of J. K. Dixon, 1979, Pattern recognition
with partly missing data, IEEE Trans. Syst. Man Cybern. 9, 617-621). It is assumed that why
something was not measured has nothing to do with its value.

*Did not happen* (a rock that never reached a station has no speed there) is information and must
not be left out: a model in which no rock arrives would escape its punishment. A coordinate of its
own stands for it before any distance is taken (``sassgis.gap.which.ensemble.Scale``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from sassgis.model.grid import FloatArray

BoolArray = NDArray[np.bool_]

#: Distances are taken in blocks of at most this many pairs, to bound the memory.
PAIRS = 4_000_000


def observed_scale(observed: FloatArray) -> FloatArray:
    """Unit of each quantity: its sample standard deviation among the observed rows.

    Parameters
    ----------
    observed : float64, shape (n, p)
        NaN where not measured.

    Returns
    -------
    float64, shape (p,)
        1 where fewer than two values, or no scatter, leave no scale: the quantity then counts in
        its own unit.
    """
    values = as_matrix(observed)
    scale = np.ones(values.shape[1])
    for k, column in enumerate(values.T):
        known = column[np.isfinite(column)]
        if known.size > 1:
            spread = float(np.std(known, ddof=1))
            # Equal numbers can differ from their mean by rounding.
            if spread > 1e-12 * float(np.abs(known).max()):
                scale[k] = spread
    return scale


def energy_distance(
    x: FloatArray,
    y: FloatArray,
    *,
    scale: FloatArray | None = None,
    unbiased: bool = False,
) -> float:
    """Energy distance between two samples: 2 E|X − Y| − E|X − X'| − E|Y − Y'|.

    Zero if and only if the distributions are equal (G. J. Székely and M. L. Rizzo, 2013, Energy
    statistics, J. Stat. Plan. Inference 143, 1249-1272). It is the squared form, in units of the
    standardised quantities; some libraries return its root.

    With missing entries it is the mean, over the rows of ``x``, of the energy distance in the
    quantities that this row has, between all rows of ``x`` and all rows of ``y`` that have them
    too, with distances stretched as the module says. Each part is an energy distance by itself, so
    the mean is never negative (unless unbiased), and zero where the distributions agree. Quantities
    that no row of ``y`` has are left out.

    Parameters
    ----------
    x : float64, shape (n, p) or (n,)
        The observed sample; NaN where not measured.
    y : float64, shape (m, p) or (m,)
        The simulated sample.
    scale : float64, shape (p,), optional
        Divides the quantities; default: ``observed_scale(x)``.
    unbiased : bool
        Leave the pairs of a row with itself out. Without, a finite sample is at a distance above
        zero from its own distribution, about E|X − X'| (1/n + 1/m).

    Returns
    -------
    float
        NaN if the samples have no quantity in common.
    """
    a, b = as_matrix(x), as_matrix(y)
    if a.shape[1] != b.shape[1]:
        raise ValueError(f"samples of {a.shape[1]} and {b.shape[1]} quantities")
    unit = observed_scale(a) if scale is None else np.asarray(scale, np.float64)
    a, b = a / unit, b / unit
    p = a.shape[1]
    has_a, has_b = np.isfinite(a), np.isfinite(b)
    # A quantity without a counterpart says nothing about the distance.
    common = has_a & has_b.any(axis=0)
    patterns, count = np.unique(common, axis=0, return_counts=True)
    total, weight = 0.0, 0.0
    least = 2 if unbiased else 1
    for pattern, n_rows in zip(patterns, count.tolist(), strict=True):
        own = a[has_a[:, pattern].all(axis=1)][:, pattern]
        other = b[has_b[:, pattern].all(axis=1)][:, pattern]
        if not pattern.any() or len(own) < least or len(other) < least:
            continue
        stretch = np.sqrt(p / pattern.sum())
        part = (
            2.0 * _sum_of_distances(own, other) / (len(own) * len(other))
            - _mean_within(own, unbiased)
            - _mean_within(other, unbiased)
        )
        total += n_rows * stretch * (part if unbiased else max(part, 0.0))
        weight += n_rows
    return total / weight if weight else float("nan")


def _mean_within(x: FloatArray, unbiased: bool) -> float:
    n = len(x)
    return _sum_of_distances(x, x) / (n * (n - 1) if unbiased else n * n)


def _sum_of_distances(x: FloatArray, y: FloatArray) -> float:
    """Sum of the Euclidean distances of all pairs of rows."""
    if x.shape[1] == 1:
        return _sum_in_line(x[:, 0], y[:, 0])
    step = max(1, PAIRS // max(1, len(y)))
    return float(sum(cdist(x[i : i + step], y).sum() for i in range(0, len(x), step)))


def _sum_in_line(x: FloatArray, y: FloatArray) -> float:
    """In one dimension sorting replaces the pairs: O((n + m) log m)."""
    ordered = np.sort(y)
    below = np.searchsorted(ordered, x)
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    m = ordered.size
    return float((x * (2 * below - m) + sums[m] - 2.0 * sums[below]).sum())


def energy_score(
    ensemble: FloatArray,
    observation: FloatArray,
    *,
    scale: FloatArray | None = None,
    fair: bool = True,
) -> float:
    """Energy score of an ensemble against one observation: E|Y − y| − ½ E|Y − Y'|.

    Strictly proper: it is smallest, in the mean, for the distribution that nature draws from
    (T. Gneiting and A. E. Raftery, 2007, Strictly proper scoring rules, prediction, and estimation,
    J. Am. Stat. Assoc. 102, 359-378). In one dimension it is the CRPS.

    Parameters
    ----------
    ensemble : float64, shape (m, p)
        Simulated rocks. Those that lack a quantity of the observation are left out: encode what did
        not happen as a coordinate of its own first.
    observation : float64, shape (p,)
        NaN where not measured; these quantities are left out, and distances stretched as the module
        says.
    scale : float64, shape (p,), optional
        Divides the quantities; default 1. It must not depend on this observation alone.
    fair : bool
        Whether pairs of a simulated rock with itself are left out, so that the expected score does
        not depend on the size of the ensemble (C. A. T. Ferro, 2014, Fair scores for ensemble
        forecasts, Q. J. R. Meteorol. Soc. 140, 1917-1923).

    Returns
    -------
    float
        NaN if nothing was measured or fewer than two (fair) or one simulated rocks are left.
    """
    members, seen = as_matrix(ensemble), np.asarray(observation, np.float64).ravel()
    if members.shape[1] != seen.size:
        raise ValueError(f"ensemble of {members.shape[1]} quantities, {seen.size} observed")
    if scale is not None:
        members, seen = members / scale, seen / scale
    known = np.isfinite(seen)
    members = members[:, known]
    members = members[np.isfinite(members).all(axis=1)]
    if not known.any() or len(members) < (2 if fair else 1):
        return float("nan")
    near = _sum_of_distances(members, seen[None, known]) / len(members)
    stretch = np.sqrt(seen.size / known.sum())
    return float(stretch * (near - 0.5 * _mean_within(members, fair)))


def energy_scores(
    ensembles: FloatArray,
    observed: FloatArray,
    *,
    scale: FloatArray | None = None,
    fair: bool = True,
) -> FloatArray:
    """Energy score of each observation against its own ensemble.

    Parameters
    ----------
    ensembles : float64, shape (n, m, p)
    observed : float64, shape (n, p)
    scale : float64, shape (p,), optional
        Default: ``observed_scale(observed)``.
    fair : bool

    Returns
    -------
    float64, shape (n,)
    """
    seen = as_matrix(observed)
    unit = observed_scale(seen) if scale is None else scale
    return np.array(
        [
            energy_score(own, row, scale=unit, fair=fair)
            for own, row in zip(ensembles, seen, strict=True)
        ],
        np.float64,
    )


def as_matrix(values: FloatArray) -> FloatArray:
    """Rows by quantities; a single quantity may come as a vector."""
    array = np.asarray(values, np.float64)
    return array[:, None] if array.ndim == 1 else array
