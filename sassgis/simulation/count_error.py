"""How well numbers of blocks are known from a sample: their variance, and intervals that hold."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from sassgis.grid import FloatArray, IntArray


def count_variance(
    count: IntArray, square: IntArray, rocks_per_line: int, strata: int, random_points: bool
) -> FloatArray:
    """Return the sampling variance of the number of blocks that reach a place.

    With k_l of the n blocks of line l in the place and K = Σ k_l: release points on a lattice are
    fixed, so only the blocks of each line are a sample (stratified sampling; Cochran 1977, section
    5.3): Var K = Σ k_l (n − k_l)/(n − 1). Points drawn at random make the line the unit (cluster
    sampling; ibid., section 9A.2): Var K = L/(L − 1) · (Σ k_l² − K²/L).

    Given are Σ k_l and Σ k_l² in arrays of one shape, n and L. NaN where the sample does not give
    it: one block per line, or one random line.
    """
    k = count.astype(np.float64)
    k2 = square.astype(np.float64)
    n = rocks_per_line
    if random_points:
        if strata < 2:
            return np.full(k.shape, np.nan)
        variance = strata / (strata - 1.0) * (k2 - k * k / strata)
    elif n < 2:
        return np.full(k.shape, np.nan)
    else:
        variance = (n * k - k2) / (n - 1.0)
    return np.maximum(variance, 0.0)


def blocks_of_a_point(count: IntArray, square: IntArray) -> FloatArray:
    """Return blocks that come from one more release point, drawn at random.

    With k_l blocks of point l the mean of k_l over the blocks, Σ k_l² / Σ k_l: points from which
    none comes do not count. 0 where no block comes from any.
    """
    per_point: FloatArray = np.divide(
        square, count, out=np.zeros(count.shape), where=count > 0, dtype=np.float64
    )
    return per_point


def widening(freedom: FloatArray | float, tail: float) -> FloatArray | float:
    """Return by how much a variance with some degrees of freedom counts more than a known one.

    The square of a quantile of Student's t over that of the normal distribution; ``tail`` is the
    probability beyond it. 1 at infinity.
    """
    if np.isinf(freedom).all():
        return 1.0
    t = special.stdtrit(np.maximum(freedom, 1.0), 1.0 - tail)
    factor: FloatArray = np.where(np.isinf(freedom), 1.0, (t / special.ndtri(1.0 - tail)) ** 2)
    return factor


def pooled_freedom(variances: FloatArray, freedom: Sequence[float]) -> FloatArray:
    """Return degrees of freedom of sums of independent variances, shape (n_samples, n).

    They are infinite for a variance of 0. After Welch (1947, Biometrika 34: 28-35) and
    Satterthwaite (1946, Biometrics Bulletin 2: 110-114).
    """
    unsure = (variances**2 / np.maximum(freedom, 1.0)[:, None]).sum(axis=0)
    pooled = np.full(unsure.shape, np.inf)
    np.divide(variances.sum(axis=0) ** 2, unsure, out=pooled, where=unsure > 0.0)
    return pooled


def gamma_interval(
    rate: FloatArray,
    variance: FloatArray,
    of_one: FloatArray | float,
    confidence: float,
    freedom: FloatArray | float = math.inf,
) -> tuple[FloatArray, FloatArray]:
    """Return limits between which rates lie, given a sample.

    The gamma interval for weighted sums of counts (Fay and Feuer 1997, Statistics in Medicine 16:
    791-801): the lower limit is a quantile of the gamma distribution with the mean λ and variance v
    of the rate, the upper one of that with mean λ + w and variance v + w², w being the rate of one
    more of what is drawn. For counts with one weight it is the exact interval of a Poisson mean.

    What is drawn are blocks, or release points with their blocks. Points are few: v is then known
    with ν degrees of freedom only, and is widened by Student's t (as Korn and Graubard 1998, Survey
    Methodology 24: 193-201, do for shares). The lower limit is that of a sample with one point more
    from which no block comes, λ (ν + 1)/(ν + 2) and w² at least: points that are alike by chance
    would have no variance.

    Parameters
    ----------
    of_one : float64
        w: rate of one block; where points were drawn, that of the blocks of a point.
    confidence : float
        Probability that the interval holds the rate, below 1.
    freedom : float64
        Degrees of freedom of the variances; infinite where only blocks were drawn.

    Returns
    -------
    lower, upper : float64
        With no block counted the lower limit is 0; with variance 0, and only blocks, it is the
        rate. NaN where the variance is.
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"a confidence of {confidence} is not between 0 and 1")
    tail = 0.5 * (1.0 - confidence)
    unknown = np.isnan(variance)
    wider = widening(freedom, tail)
    upper = _gamma_quantile(tail, rate + of_one, wider * variance + of_one**2, special.gammainccinv)
    if not np.isinf(freedom).all():
        variance = np.where(np.isinf(freedom), variance, np.maximum(variance, np.square(of_one)))
        rate = rate * (1.0 - 1.0 / (freedom + 2.0))
    lower = _gamma_quantile(tail, rate, wider * variance, special.gammaincinv)
    lower = np.where(unknown, np.nan, np.minimum(lower, rate))
    upper = np.where(unknown, np.nan, np.maximum(upper, rate))
    return lower, upper


def _gamma_quantile(
    tail: float, mean: FloatArray, variance: FloatArray, inverse: np.ufunc
) -> FloatArray:
    """Return quantile of the gamma distribution; the mean where the variance is 0."""
    out = np.array(np.broadcast_to(mean, np.broadcast_shapes(mean.shape, variance.shape)))
    spread = np.broadcast_to(variance, out.shape)
    # Spreads below a hundred millionth of the mean count as 0.
    some = (out > 0.0) & (spread > 1e-16 * out**2)
    scale = spread[some] / out[some]
    # Many places have the same counts.
    shapes, of = np.unique(out[some] / scale, return_inverse=True)
    out[some] = inverse(shapes, tail)[of] * scale
    return out
