"""Tests of many mean gaps at once; one row per rock."""

from __future__ import annotations

import numpy as np
from scipy import stats

from sassgis.model.grid import FloatArray, IntArray

#: Draws are made in blocks of at most this many numbers, to bound the memory.
_MOST = 4_000_000


def _as_matrix(values: FloatArray) -> FloatArray:
    """Rows by quantities; a single quantity may come as a vector."""
    array = np.asarray(values, np.float64)
    return array[:, None] if array.ndim == 1 else array


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
    data = _as_matrix(values)
    rocks, index = np.unique(np.asarray(rock, np.int64), return_inverse=True)
    known = np.isfinite(data)
    sums, counts = np.zeros((2, rocks.size, data.shape[1]))
    np.add.at(sums, index, np.where(known, data, 0.0))
    np.add.at(counts, index, known)
    with np.errstate(invalid="ignore"):
        return sums / counts, rocks


def t_statistics(values: FloatArray) -> FloatArray:
    """Mean over its standard error, column by column, missing entries left out; shape (k,).

    NaN with fewer than three rocks; infinite for equal values other than zero. ``values``: one row
    per rock (see ``rock_means``), shape (n, k).
    """
    data = _as_matrix(values)
    known = np.isfinite(data)
    count = known.sum(axis=0)
    filled = np.where(known, data, 0.0)
    return _t(filled.sum(axis=0), (filled**2).sum(axis=0), count)


def _t(sums: FloatArray, squares: FloatArray, count: IntArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums / count
        variance = np.maximum(squares / count - mean**2, 0.0) * count / (count - 1)
        # What is left of equal values is rounding.
        variance = np.where(variance < 1e-14 * mean**2, 0.0, variance)
        t = mean / np.sqrt(variance / count)
    t = np.where(sums == 0.0, 0.0, t)
    return np.where(count >= 3, t, np.nan)


def max_t_adjusted(statistic: FloatArray, null: FloatArray) -> FloatArray:
    """P-values adjusted for the number of comparisons, by the largest statistic under the null.

    P. H. Westfall and S. S. Young (1993, Resampling-based multiple testing): the chance of even one
    false finding is kept below the level, and what the comparisons have in common is used. Each
    statistic is compared with the largest of those that are not stronger than itself (step-down).

    Parameters
    ----------
    statistic : float64, shape (k,)
        The larger, the stronger (take absolute values for two sides); NaN where there is none.
    null : float64, shape (draws, k)
        The same from data in which there is nothing to find. NaN never wins.

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
    largest = np.maximum.accumulate(drawn[:, ::-1], axis=1)[:, ::-1]
    reached = (largest >= observed[order]).sum(axis=0)
    p[order] = np.maximum.accumulate((reached + 1.0) / (len(null) + 1.0))
    return p


def holm_adjusted(p: FloatArray) -> FloatArray:
    """P-values, shape (k,), adjusted for their number, whatever their dependence.

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
    """Which mean gaps differ from zero, adjusted for the number of them.

    Under the null the signs of all entries of a unit may be flipped together: exact if gaps are
    symmetric about zero. Of our own making: ``scipy.stats.permutation_test`` flips signs as well,
    but knows no missing entries and no maximum over columns, which draws the same flips for all.

    Parameters
    ----------
    values : float64, shape (n, k)
        Observed minus predicted, one row per rock; NaN where not measured.
    unit : int64, shape (n,), optional
        Unit of each rock, from 0; default: each is one of its own.

    Returns
    -------
    t, p, p_adjusted : float64, shape (k,)
        Two-sided. NaN with fewer than three rocks.
    """
    data = _as_matrix(values)
    n = len(data)
    unit = np.arange(n) if unit is None else unit
    known = np.isfinite(data)
    filled = np.where(known, data, 0.0)
    t = t_statistics(data)
    null = np.empty((draws, data.shape[1]))
    step = max(1, _MOST // max(1, n))
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
    """P-values adjusted so that the share of false ones among the findings stays below the level.

    Y. Benjamini and Y. Hochberg (1995, Controlling the false discovery rate, J. R. Stat. Soc. B
    57, 289-300), by ``scipy.stats.false_discovery_control``; for independent or positively
    dependent comparisons. Shape (k,); NaN is left out and stays.
    """
    adjusted = np.array(p, np.float64)
    known = np.isfinite(adjusted)
    if known.any():
        adjusted[known] = stats.false_discovery_control(adjusted[known])
    return adjusted
