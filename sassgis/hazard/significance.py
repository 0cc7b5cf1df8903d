"""Whether frequencies or shares of two samples of blocks differ by more than sampling explains."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from sassgis.grid import FloatArray
from sassgis.simulation.map_sums import pooled_freedom

#: From this many blocks on in both samples the difference is taken as normal.
_MANY = 30.0
#: False discovery rate: share of the significant places that may be chance.
_FALSE_SHARE = 0.05


class SampledRates(NamedTuple):
    """Rates or shares of a sample of blocks, of shape (n,) where they are arrays."""

    rate: FloatArray  # NaN: unknown
    variance: FloatArray  # by the sampling; NaN: unknown
    of_a_block: ArrayLike  # rate or share that one block represents, above 0
    # Degrees of freedom of the variance; infinite where the release points are given.
    freedom: float = math.inf

    def blocks(self) -> tuple[FloatArray, FloatArray]:
        """Return the independent blocks that the rates rest on, and the rate of one of them."""
        rate = np.nan_to_num(self.rate)
        spread = np.divide(
            np.nan_to_num(self.variance), rate, out=np.zeros_like(rate), where=rate > 0.0
        )
        # Blocks that arrive together, as those of a point that was drawn, count as one.
        weight = np.maximum(spread, self.of_a_block)
        return rate / weight, weight


def chance_of_difference(one: SampledRates, two: SampledRates) -> FloatArray:
    """Compute two-sided p values of differences between two independent samples, shape (n,).

    Where both rest on many blocks the difference is normal, or has Student's t distribution where
    release points were drawn (Welch 1947, Biometrika 34: 28-35). Else a rate λ with variance v
    represents at most λ²/v blocks, and given their sum those of one sample are binomial (J.
    Przyborowski and H. Wilenski, 1940, Biometrika 31: 313-323). 1 where a variance is unknown.
    """
    spread = one.variance + two.variance
    distance = np.abs(np.nan_to_num(one.rate) - np.nan_to_num(two.rate))
    errors = distance / np.sqrt(np.where(spread > 0.0, spread, np.inf))
    freedom = pooled_freedom(np.stack([one.variance, two.variance]), (one.freedom, two.freedom))
    normal = 2.0 * special.stdtr(freedom, -errors)
    out = np.where(distance == 0.0, 1.0, np.where(spread > 0.0, normal, 0.0))
    (a, weight), (b, other) = one.blocks(), two.blocks()
    few = np.minimum(a, b) < _MANY
    a, b, weight, other = a[few], b[few], weight[few], other[few]
    share = other / (weight + other)  # of blocks, in the first sample
    out[few] = np.minimum(
        1.0, 2.0 * np.minimum(_at_least(a, b, share), _at_least(b, a, 1.0 - share))
    )
    out[np.isnan(spread)] = 1.0
    return out


def _at_least(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Compute P(N >= a) of a + b blocks, each in the sample with the probability ``share``."""
    out: FloatArray = np.where(a > 0.0, special.betainc(np.maximum(a, 1e-9), b + 1.0, share), 1.0)
    return out


def beyond_sampling(one: SampledRates, two: SampledRates) -> NDArray[np.bool_]:
    """Find places at which two samples differ by more than sampling explains, shape (n,).

    Of the places that are found, a share of 5 % at most is to be expected by chance;
    between two samples of the same, there is any with this probability at most. This false
    discovery rate (Y. Benjamini and Y. Hochberg, 1995, Journal of the Royal Statistical Society B
    57: 289-300) also holds for places that depend on each other as neighbours do, which the same
    blocks reach (Y. Benjamini and D. Yekutieli, 2001, Annals of Statistics 29: 1165-1188).
    """
    # Only a comparison needs it; importing it takes a fifth of the time of a start.
    from scipy.stats import false_discovery_control

    p = chance_of_difference(one, two)
    reached = np.nan_to_num(one.rate) + np.nan_to_num(two.rate) > 0.0
    found = np.zeros(p.shape, bool)
    if reached.any():
        found[reached] = false_discovery_control(p[reached]) <= _FALSE_SHARE
    return found
