"""Scores of predictions, distances of distributions, and how sure one can be of them.

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

*Did not happen* (a rock that never came to a station has no speed there) is information and must
not be left out: a model in which no rock arrives would escape its punishment. ``with_absence``
turns it into a coordinate of its own before any distance is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.special import betaincinv, ndtr, ndtri

from sassgis.model.grid import FloatArray, IntArray

BoolArray = NDArray[np.bool_]

#: Distances are taken in blocks of at most this many pairs, to bound the memory.
_PAIRS = 4_000_000


# ---------------------------------------------------------------------------------------------
# Scale and absence


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
    values = _matrix(observed)
    scale = np.ones(values.shape[1])
    for k, column in enumerate(values.T):
        known = column[np.isfinite(column)]
        if known.size > 1:
            spread = float(np.std(known, ddof=1))
            # Equal numbers can differ from their mean by rounding.
            if spread > 1e-12 * float(np.abs(known).max()):
                scale[k] = spread
    return scale


def with_absence(
    values: FloatArray,
    absent: BoolArray,
    centre: FloatArray,
    scale: FloatArray,
    weight: float = 1.0,
) -> FloatArray:
    """Make "did not happen" a part of the data.

    Each quantity becomes two: its standardised value, which is that of the centre where there is
    none, and ``weight`` where it is absent, 0 where not. Distances between such rows are Euclidean,
    so that the energy distance and the energy score stay proper. Both samples need the same centre
    and scale.

    Parameters
    ----------
    values : float64, shape (n, p)
    absent : bool, shape (n, p)
        Where the quantity does not exist, as against not measured (NaN and not absent).
    centre, scale : float64, shape (p,)
        Commonly mean and standard deviation of the observed.
    weight : float
        How far absence is from a value at the centre, in units of the scale.

    Returns
    -------
    float64, shape (n, 2 p)
        Already standardised: pass no scale on.
    """
    x = (_matrix(values) - centre) / scale
    flag = np.where(absent, weight, np.where(np.isfinite(x), 0.0, np.nan))
    return np.hstack([np.where(absent, 0.0, x), flag])


# ---------------------------------------------------------------------------------------------
# Energy distance


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
    a, b = _matrix(x), _matrix(y)
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
    step = max(1, _PAIRS // max(1, len(y)))
    return float(sum(cdist(x[i : i + step], y).sum() for i in range(0, len(x), step)))


def _sum_in_line(x: FloatArray, y: FloatArray) -> float:
    """In one dimension sorting replaces the pairs: O((n + m) log m)."""
    ordered = np.sort(y)
    below = np.searchsorted(ordered, x)
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    m = ordered.size
    return float((x * (2 * below - m) + sums[m] - 2.0 * sums[below]).sum())


# ---------------------------------------------------------------------------------------------
# Scores of a prediction against one observation


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
        not happen by ``with_absence`` first.
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
    members, seen = _matrix(ensemble), np.asarray(observation, np.float64).ravel()
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
    seen = _matrix(observed)
    unit = observed_scale(seen) if scale is None else scale
    return np.array(
        [
            energy_score(own, row, scale=unit, fair=fair)
            for own, row in zip(ensembles, seen, strict=True)
        ],
        np.float64,
    )


def crps(
    ensemble: FloatArray, observation: FloatArray | float, *, fair: bool = False
) -> FloatArray | float:
    """Continuous ranked probability score of ensembles, in the unit of the quantity.

    The integral of the squared difference between the ensemble's distribution and the step at the
    observation; for one simulated rock the absolute error.

    Parameters
    ----------
    ensemble : float64, shape (..., m)
        NaN for simulated rocks without a value.
    observation : float64, shape (...)
    fair : bool
        See ``energy_score``.

    Returns
    -------
    float64, shape (...)
        NaN where there is no observation, or too few simulated rocks.
    """
    members = np.sort(np.asarray(ensemble, np.float64), axis=-1)
    seen = np.asarray(observation, np.float64)
    known = np.isfinite(members)
    count = known.sum(axis=-1)
    values = np.where(known, members, 0.0)
    near = np.where(known, np.abs(members - seen[..., None]), 0.0).sum(axis=-1)
    # Sorted, value k stands above k others and below m − 1 − k: the sum over all pairs.
    rank = np.arange(members.shape[-1])
    pairs = 2.0 * (values * np.where(known, 2 * rank - count[..., None] + 1, 0)).sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        within = pairs / (count * (count - 1) if fair else count * count)
        result = near / count - 0.5 * within
    return float(result) if result.ndim == 0 else result


def brier_score(probability: FloatArray, happened: BoolArray) -> FloatArray:
    """Squared error of probabilities that something happens, such as a rock coming to a station."""
    error = np.asarray(probability, np.float64) - np.asarray(happened, np.float64)
    squared: FloatArray = error * error
    return squared


# ---------------------------------------------------------------------------------------------
# Rocks as the unit


def rock_means(values: FloatArray, rock: IntArray) -> tuple[FloatArray, IntArray]:
    """Mean of each quantity over the rows of each rock, missing ones left out.

    Parameters
    ----------
    values : float64, shape (n, k) or (n,)
    rock : int64, shape (n,)

    Returns
    -------
    means : float64, shape (n_rocks, k)
        NaN where a rock has no value.
    rocks : int64, shape (n_rocks,)
        Their numbers, rising.
    """
    data = _matrix(values)
    rocks, index = np.unique(np.asarray(rock, np.int64), return_inverse=True)
    known = np.isfinite(data)
    sums, counts = np.zeros((2, rocks.size, data.shape[1]))
    np.add.at(sums, index, np.where(known, data, 0.0))
    np.add.at(counts, index, known)
    with np.errstate(invalid="ignore"):
        return sums / counts, rocks


def bootstrap_rows(
    rock: IntArray, draws: int, rng: np.random.Generator
) -> Iterator[tuple[IntArray, IntArray]]:
    """Rows of bootstrap samples in which whole rocks are drawn with replacement.

    Parameters
    ----------
    rock : int64, shape (n,)
        Rock of each row.
    draws : int
        Number of samples.
    rng : numpy.random.Generator

    Yields
    ------
    rows : int64, shape (n_rows,)
        All rows of the drawn rocks; a rock drawn twice brings its rows twice.
    rock : int64, shape (n_rows,)
        New numbers of the rocks, under which one drawn twice counts as two.
    """
    names, index = np.unique(np.asarray(rock), return_inverse=True)
    order = np.argsort(index, kind="stable")
    size = np.bincount(index, minlength=names.size)
    start = np.concatenate([[0], np.cumsum(size)[:-1]])
    for _ in range(draws):
        drawn = rng.integers(names.size, size=names.size)
        length = size[drawn]
        new = np.repeat(np.arange(names.size, dtype=np.int64), length)
        within = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
        yield order[np.repeat(start[drawn], length) + within].astype(np.int64), new


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate with its interval.

    Attributes
    ----------
    value, low, high : float
    """

    value: float
    low: float
    high: float


def bootstrap_interval(
    statistic: Callable[[IntArray], float],
    rock: IntArray,
    *,
    draws: int,
    rng: np.random.Generator,
    level: float = 0.95,
    method: Literal["percentile", "basic", "bca"] = "bca",
) -> Interval:
    """Interval of a statistic by resampling rocks.

    Parameters
    ----------
    statistic : callable
        Takes rows (int64; repeated ones count as often) and returns a number.
    rock : int64, shape (n,)
        Rock of each row.
    draws : int
    rng : numpy.random.Generator
    level : float
        Nominal coverage.
    method : {"percentile", "basic", "bca"}
        ``bca`` corrects the percentiles for bias and skewness by a jackknife over rocks (B. Efron,
        1987, Better bootstrap confidence intervals, J. Am. Stat. Assoc. 82, 171-185).

    Returns
    -------
    Interval
        Limits are NaN if there are fewer than two rocks. With fewer than about twenty the interval
        is too narrow: the coverage of 95 % intervals is then nearer to 90 %.
    """
    rocks = np.asarray(rock)
    everything = np.arange(rocks.size, dtype=np.int64)
    value = float(statistic(everything))
    names = np.unique(rocks)
    if names.size < 2:
        return Interval(value, float("nan"), float("nan"))
    drawn = np.array([statistic(rows) for rows, _ in bootstrap_rows(rocks, draws, rng)], float)
    drawn = drawn[np.isfinite(drawn)]
    if not drawn.size or not np.isfinite(value):
        return Interval(value, float("nan"), float("nan"))
    tail = np.array([0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    if method == "bca":
        tail = _bca_tails(statistic, rocks, names, value, drawn, tail)
    low, high = np.quantile(drawn, tail).tolist()
    if method == "basic":
        low, high = 2.0 * value - high, 2.0 * value - low
    return Interval(value, low, high)


def _bca_tails(
    statistic: Callable[[IntArray], float],
    rocks: IntArray,
    names: IntArray,
    value: float,
    drawn: FloatArray,
    tail: FloatArray,
) -> FloatArray:
    share = (np.sum(drawn < value) + 0.5 * np.sum(drawn == value)) / drawn.size
    if not 0.0 < share < 1.0:
        return tail
    bias = ndtri(share)
    left = np.array([statistic(np.flatnonzero(rocks != name)) for name in names.tolist()], float)
    away = np.mean(left[np.isfinite(left)]) - left[np.isfinite(left)]
    spread = float(np.sum(away**2))
    skew = float(np.sum(away**3)) / (6.0 * spread**1.5) if spread > 0.0 else 0.0
    z = bias + ndtri(tail)
    corrected: FloatArray = ndtr(bias + z / (1.0 - skew * z))
    return corrected


# ---------------------------------------------------------------------------------------------
# Many comparisons


def t_statistics(values: FloatArray) -> FloatArray:
    """Mean over its standard error, column by column, missing entries left out.

    Parameters
    ----------
    values : float64, shape (n, k)
        One row per rock (see ``rock_means``).

    Returns
    -------
    float64, shape (k,)
        NaN with fewer than three rocks; infinite for equal values other than zero.
    """
    data = _matrix(values)
    known = np.isfinite(data)
    count = known.sum(axis=0)
    filled = np.where(known, data, 0.0)
    return _t(filled.sum(axis=0), (filled**2).sum(axis=0), count)


def _t(sums: FloatArray, squares: FloatArray, count: FloatArray | IntArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums / count
        variance = np.maximum(squares / count - mean**2, 0.0) * count / (count - 1)
        # What is left of equal values is rounding.
        variance = np.where(variance < 1e-14 * mean**2, 0.0, variance)
        t = mean / np.sqrt(variance / count)
    t = np.where(sums == 0.0, 0.0, t)
    return np.where(count >= 3, t, np.nan)


def max_t_adjusted(
    statistic: FloatArray, null: FloatArray, *, step_down: bool = True
) -> FloatArray:
    """P-values adjusted for the number of comparisons, by the largest statistic under the null.

    P. H. Westfall and S. S. Young (1993, Resampling-based multiple testing): the chance of even one
    false finding is kept below the level, and what the comparisons have in common is used.

    Parameters
    ----------
    statistic : float64, shape (k,)
        The larger, the stronger (take absolute values for two sides); NaN where there is none.
    null : float64, shape (draws, k)
        The same from data in which there is nothing to find. NaN never wins.
    step_down : bool
        Compare each statistic with the largest of those not stronger than itself only, which finds
        more at the same level.

    Returns
    -------
    float64, shape (k,)
        At least 1 / (draws + 1); NaN where the statistic is.
    """
    observed = np.asarray(statistic, np.float64)
    p = np.full(observed.shape, np.nan)
    use = np.flatnonzero(np.isfinite(observed) | np.isposinf(observed))
    if not use.size:
        return p
    order = use[np.argsort(-observed[use], kind="stable")]
    drawn = np.where(np.isnan(null), -np.inf, null)[:, order]
    if step_down:
        largest = np.maximum.accumulate(drawn[:, ::-1], axis=1)[:, ::-1]
    else:
        largest = np.repeat(drawn.max(axis=1, keepdims=True), order.size, axis=1)
    reached = (largest >= observed[order]).sum(axis=0)
    p[order] = np.maximum.accumulate((reached + 1.0) / (len(null) + 1.0))
    return p


def mean_gap_tests(
    values: FloatArray,
    *,
    draws: int,
    rng: np.random.Generator,
    method: Literal["sign_flip", "bootstrap"] = "sign_flip",
    step_down: bool = True,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Which mean gaps differ from zero, adjusted for the number of them.

    Parameters
    ----------
    values : float64, shape (n, k)
        Observed minus predicted, one row per rock; NaN where not measured.
    draws : int
    rng : numpy.random.Generator
    method : {"sign_flip", "bootstrap"}
        ``sign_flip``: under the null the signs of all entries of a rock may be flipped together;
        exact if gaps are symmetric about zero. ``bootstrap``: rocks are drawn from the values less
        their means; for skewed gaps of many rocks.
    step_down : bool
        See ``max_t_adjusted``.

    Returns
    -------
    t, p, p_adjusted : float64, shape (k,)
        Two-sided. NaN with fewer than three rocks.
    """
    data = _matrix(values)
    n = len(data)
    known = np.isfinite(data)
    filled = np.where(known, data, 0.0)
    t = t_statistics(data)
    null = np.empty((draws, data.shape[1]))
    step = max(1, _PAIRS // max(1, n))
    count = known.sum(axis=0)
    squares = (filled**2).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        centred = np.where(known, data - filled.sum(axis=0) / count, 0.0)
    for first in range(0, draws, step):
        rows = min(step, draws - first)
        if method == "sign_flip":
            signs = rng.choice((-1.0, 1.0), size=(rows, n))
            null[first : first + rows] = _t(signs @ filled, squares, count)
        else:
            times = rng.multinomial(n, np.full(n, 1.0 / n), size=rows).astype(np.float64)
            null[first : first + rows] = _t(times @ centred, times @ centred**2, times @ known)
    # A draw that repeats the data must not miss it by rounding.
    size = np.abs(null) * (1.0 + 1e-12)
    reached = (np.where(np.isnan(size), -np.inf, size) >= np.abs(t)).sum(axis=0)
    p = np.where(np.isnan(t), np.nan, (reached + 1.0) / (draws + 1.0))
    return t, p, max_t_adjusted(np.abs(t), size, step_down=step_down)


def benjamini_hochberg(p: FloatArray) -> FloatArray:
    """P-values adjusted so that the share of false ones among the findings stays below the level.

    Y. Benjamini and Y. Hochberg (1995, Controlling the false discovery rate, J. R. Stat. Soc. B
    57, 289-300); for independent or positively dependent comparisons.

    Parameters
    ----------
    p : float64, shape (k,)
        NaN is left out and stays.

    Returns
    -------
    float64, shape (k,)
    """
    values = np.asarray(p, np.float64)
    adjusted = np.full(values.shape, np.nan)
    use = np.flatnonzero(np.isfinite(values))
    order = use[np.argsort(values[use], kind="stable")]
    raised = values[order] * use.size / np.arange(1, use.size + 1)
    adjusted[order] = np.minimum(np.minimum.accumulate(raised[::-1])[::-1], 1.0)
    return adjusted


def two_sample_test(
    x: FloatArray,
    y: FloatArray,
    *,
    draws: int,
    rng: np.random.Generator,
    scale: FloatArray | None = None,
) -> tuple[float, float]:
    """Permutation test of the energy distance between two samples of independent rows.

    Parameters
    ----------
    x, y : float64, shapes (n, p), (m, p)
        One row per rock.
    draws : int
    rng : numpy.random.Generator
    scale : float64, shape (p,), optional
        Default: that of the pooled rows, which permutations do not change.

    Returns
    -------
    distance, p : float
    """
    a, b = _matrix(x), _matrix(y)
    pooled = np.vstack([a, b])
    unit = observed_scale(pooled) if scale is None else scale
    distance = energy_distance(a, b, scale=unit)
    if np.isfinite(pooled).all():
        far = cdist(pooled / unit, pooled / unit)
        n, m = len(a), len(b)
        reached = 0
        for _ in range(draws):
            # The three means come from one matrix: e' D e with e = 1/n on one side, −1/m else.
            side = np.full(n + m, -1.0 / m)
            side[rng.permutation(n + m)[:n]] = 1.0 / n
            reached += bool(-side @ far @ side >= distance * (1.0 - 1e-12))
    else:
        reached = 0
        for _ in range(draws):
            order = rng.permutation(len(pooled))
            drawn = energy_distance(pooled[order[: len(a)]], pooled[order[len(a) :]], scale=unit)
            reached += bool(drawn >= distance * (1.0 - 1e-12))
    return distance, (reached + 1.0) / (draws + 1.0)


# ---------------------------------------------------------------------------------------------
# Shares


def share_interval(
    hits: int,
    trials: int,
    *,
    level: float = 0.95,
    method: Literal["wilson", "clopper_pearson"] = "wilson",
) -> Interval:
    """Interval of a share of independent trials.

    Parameters
    ----------
    hits, trials : int
    level : float
    method : {"wilson", "clopper_pearson"}
        E. B. Wilson (1927, J. Am. Stat. Assoc. 22, 209-212): right on the average. C. J. Clopper
        and E. S. Pearson (1934, Biometrika 26, 404-413): never too narrow.

    Returns
    -------
    Interval
        NaN, 0, 1 without trials.

    Raises
    ------
    ValueError
        If there are more hits than trials or either is negative.
    """
    if not 0 <= hits <= trials:
        raise ValueError(f"{hits} hits in {trials} trials")
    if trials == 0:
        return Interval(float("nan"), 0.0, 1.0)
    share = hits / trials
    if method == "wilson":
        z = float(ndtri(0.5 * (1.0 + level)))
        shrink = 1.0 + z * z / trials
        middle = (share + 0.5 * z * z / trials) / shrink
        half = z / shrink * np.sqrt(share * (1.0 - share) / trials + 0.25 * (z / trials) ** 2)
        low = 0.0 if hits == 0 else float(middle - half)
        high = 1.0 if hits == trials else float(middle + half)
        return Interval(share, low, high)
    tail = 0.5 * (1.0 - level)
    low = 0.0 if hits == 0 else float(betaincinv(hits, trials - hits + 1, tail))
    high = 1.0 if hits == trials else float(betaincinv(hits + 1, trials - hits, 1.0 - tail))
    return Interval(share, low, high)


def _matrix(values: FloatArray) -> FloatArray:
    """Rows by quantities; a single quantity may come as a vector."""
    array = np.asarray(values, np.float64)
    return array[:, None] if array.ndim == 1 else array
