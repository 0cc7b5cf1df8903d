"""Whether frequencies or shares of two samples of blocks differ by more than sampling explains."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special, stats

from sassgis.grid import FloatArray
from sassgis.simulation.count_error import pooled_freedom

#: From this many blocks on in both samples the difference is taken as normal.
_MANY = 30.0


def chance_of_difference(
    rates: tuple[FloatArray, FloatArray],
    variances: tuple[FloatArray, FloatArray],
    of_a_block: tuple[ArrayLike, ArrayLike],
    freedom: tuple[float, float] = (math.inf, math.inf),
) -> FloatArray:
    """Return two-sided p values of differences between two independent samples.

    Where both rest on many blocks the difference is normal, or has Student's t distribution where
    release points were drawn (Welch 1947, Biometrika 34: 28-35). Else a rate λ with variance v
    stands for at most λ²/v blocks, and given their sum those of one sample are binomial (J.
    Przyborowski and H. Wilenski, 1940, Biometrika 31: 313-323).

    Parameters
    ----------
    rates, variances : pairs of float64, shape (n,)
        Rates or shares of both samples, and their sampling variances; NaN: unknown.
    of_a_block : pair of float, or float64 of shape (n,)
        Rate or share that one block stands for, above 0.
    freedom : pair of float
        Degrees of freedom of the variances; infinite where the release points are given.

    Returns
    -------
    float64, shape (n,)
        1 where a variance is unknown.
    """
    one, two = (np.nan_to_num(r) for r in rates)
    spread = variances[0] + variances[1]
    counts, weights = [], []
    for own, variance, weight in zip((one, two), variances, of_a_block, strict=True):
        alone = np.divide(np.nan_to_num(variance), own, out=np.zeros_like(own), where=own > 0.0)
        # Blocks that arrive together, as those of a point that was drawn, count as one.
        weights.append(np.maximum(alone, weight))
        counts.append(own / weights[-1])
    distance = np.abs(one - two)
    errors = distance / np.sqrt(np.where(spread > 0.0, spread, np.inf))
    normal = 2.0 * special.stdtr(pooled_freedom(np.stack(variances), freedom), -errors)
    out = np.where(one == two, 1.0, np.where(spread > 0.0, normal, 0.0))
    few = np.minimum(*counts) < _MANY
    share = weights[1][few] / (weights[0][few] + weights[1][few])  # of blocks, in the first sample
    a, b = (c[few] for c in counts)
    out[few] = np.minimum(
        1.0, 2.0 * np.minimum(_at_least(a, b, share), _at_least(b, a, 1.0 - share))
    )
    out[np.isnan(spread)] = 1.0
    return out


def _at_least(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Compute P(N >= a) of a + b blocks, each in the sample with the probability ``share``."""
    out: FloatArray = np.where(a > 0.0, special.betainc(np.maximum(a, 1e-9), b + 1.0, share), 1.0)
    return out


def beyond_sampling(
    rates: tuple[FloatArray, FloatArray],
    variances: tuple[FloatArray, FloatArray],
    of_a_block: tuple[ArrayLike, ArrayLike],
    freedom: tuple[float, float] = (math.inf, math.inf),
    false_share: float = 0.05,
) -> NDArray[np.bool_]:
    """Return places at which two samples differ by more than sampling explains, shape (n,).

    Of the places that are found, a share of ``false_share`` at most is to be expected by chance;
    between two samples of the same, there is any with this probability at most. This false
    discovery rate (Y. Benjamini and Y. Hochberg, 1995, Journal of the Royal Statistical Society B
    57: 289-300) also holds for places that depend on each other as neighbours do, which the same
    blocks reach (Y. Benjamini and D. Yekutieli, 2001, Annals of Statistics 29: 1165-1188).

    Parameters are those of :func:`chance_of_difference`.
    """
    p = chance_of_difference(rates, variances, of_a_block, freedom)
    reached = np.nan_to_num(rates[0]) + np.nan_to_num(rates[1]) > 0.0
    found = np.zeros(p.shape, bool)
    if reached.any():
        found[reached] = stats.false_discovery_control(p[reached]) <= false_share
    return found
