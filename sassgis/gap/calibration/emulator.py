"""A smooth stand-in for the scores of simulated campaigns, cheap enough to be searched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from sassgis.model.grid import FloatArray

#: Limits of the correlation lengths, in shares of the ranges.
_LENGTHS = (0.2, 20.0)
#: Standard deviation of the logarithm of a correlation length about 1, beforehand.
_PRIOR = 1.0
#: Limits of the variance and of the sampling noise, over the variance of the scores.
_VARIANCE, _NOISE = (0.05, 100.0), (1e-4, 2.0)
#: Scores are capped at this many times the distance from the best to the median draw.
_CAP = 2.0
#: Draws from which the correlations are fitted, at most.
_FITTED_ON = 240


@dataclass(frozen=True, slots=True)
class Emulator:
    """Gaussian process (Matérn 5/2) through noisy scores of single rocks.

    Its correlations are fitted to the sum over the rocks and shared by all of them. A prediction is
    then a linear function of the scores: the emulator of any weighted sum of rocks is the weighted
    sum of their emulators, so that rocks can be resampled or left out without a new fit.

    Attributes
    ----------
    points : float64, shape (n, d)
        Where scores were made, as shares of the ranges.
    lengths : float64, shape (d,)
    centre : float64, shape (n_rocks,)
        Mean score of each rock.
    weights : float64, shape (n, n_rocks)
    """

    points: FloatArray
    lengths: FloatArray
    centre: FloatArray
    weights: FloatArray

    def rocks(self, shares: FloatArray) -> FloatArray:
        """Scores of single rocks, shape (m, n_rocks)."""
        made: FloatArray = self.centre + matern(shares, self.points, self.lengths) @ self.weights
        return made

    def weighted(self, rock_weights: FloatArray) -> WeightedSum:
        """The weighted sum over the rocks."""
        return WeightedSum(
            self.points,
            self.lengths,
            float(self.centre @ rock_weights),
            self.weights @ rock_weights,
        )


@dataclass(frozen=True, slots=True)
class WeightedSum:
    """The emulator of a weighted sum of the scores of rocks; attributes as there."""

    points: FloatArray
    lengths: FloatArray
    centre: float
    weights: FloatArray

    def value(self, shares: FloatArray) -> FloatArray:
        """Sum at some points, shape (m,)."""
        made: FloatArray = self.centre + matern(shares, self.points, self.lengths) @ self.weights
        return made

    def gradient(self, share: FloatArray) -> FloatArray:
        """Gradient at one point, shape (d,)."""
        apart = (share - self.points) / self.lengths
        root = np.sqrt(5.0 * (apart**2).sum(axis=1))
        slope = -(5.0 / 3.0) * (1.0 + root) * np.exp(-root) * self.weights
        made: FloatArray = (slope @ apart) / self.lengths
        return made


def matern(a: FloatArray, b: FloatArray, lengths: FloatArray) -> FloatArray:
    """Matérn correlation of smoothness 5/2 between points, shape (len(a), len(b))."""
    one, other = a / lengths, b / lengths
    square = (one**2).sum(axis=1)[:, None] + (other**2).sum(axis=1) - 2.0 * one @ other.T
    root = np.sqrt(5.0 * np.maximum(square, 0.0))
    correlation: FloatArray = (1.0 + root + root**2 / 3.0) * np.exp(-root)
    return correlation


def fit(points: FloatArray, scores: FloatArray) -> Emulator:
    """Fit an emulator.

    Parameters
    ----------
    points : float64, shape (n, d)
    scores : float64, shape (n, n_rocks)

    Returns
    -------
    Emulator
    """
    total = scores.sum(axis=1)
    order = np.argsort(total, kind="stable")
    least, middle = total[order[0]], total[order[len(order) // 2]]
    # Beyond the cap all are equally bad, and so is what was never tried: no cliff far from the best
    # draws bends the surface near them. What single rocks lose or gain there shrinks in proportion.
    cap = least + _CAP * (middle - least)
    usual = scores[order[: len(order) // 2 + 1]].mean(axis=0)
    room = max(cap - float(usual.sum()), 1e-12)
    over = np.maximum(total - float(usual.sum()), room)
    capped = usual + (scores - usual) * (room / over)[:, None]
    far = min(int((total < cap).sum()), total.size - 1)
    base = usual + room / scores.shape[1]
    few = order[np.linspace(0, min(far, len(order) - 1), min(far + 1, _FITTED_ON)).astype(int)]
    lengths, noise = _correlations(points[few], (capped[few] - base).sum(axis=1))
    k = matern(points, points, lengths)
    k[np.diag_indices_from(k)] += noise
    weights = cho_solve(cho_factor(k, lower=True), capped - base)
    return Emulator(points, lengths, base, weights)


def _correlations(points: FloatArray, total: FloatArray) -> tuple[FloatArray, float]:
    """Correlation lengths, and the noise over the variance, of the highest marginal likelihood."""
    n, d = points.shape
    y = total / max(float(total.std()), 1e-12)
    square = (points[:, None] - points) ** 2
    limits = [tuple(np.log(_LENGTHS))] * d + [tuple(np.log(_VARIANCE)), tuple(np.log(_NOISE))]

    def surprise(x: FloatArray) -> tuple[float, FloatArray]:
        variance, noise = np.exp(x[d:])
        scaled = square * np.exp(-2.0 * x[:d])
        root = np.sqrt(5.0 * scaled.sum(axis=2))
        decay = variance * np.exp(-root)
        k = (1.0 + root + root**2 / 3.0) * decay
        factor = cho_factor(k + noise * np.eye(n), lower=True)
        inverse = cho_solve(factor, np.eye(n))
        solved = inverse @ y
        apart = inverse - np.outer(solved, solved)
        by_length = 0.5 * np.einsum("ij,ijk->k", apart * (5.0 / 3.0) * (1.0 + root) * decay, scaled)
        slope = np.append(
            by_length, [0.5 * float((apart * k).sum()), 0.5 * noise * float(np.trace(apart))]
        )
        # Long correlations are expected where nothing speaks against them.
        slope[:d] += x[:d] / _PRIOR**2
        value = (
            0.5 * float(y @ solved)
            + float(np.log(np.diag(factor[0])).sum())
            + 0.5 * float((x[:d] ** 2).sum()) / _PRIOR**2
        )
        return value, slope

    first = np.append(np.zeros(d), [0.0, np.log(0.1)])
    found = minimize(surprise, first, jac=True, method="L-BFGS-B", bounds=limits)
    return np.exp(found.x[:d]), float(np.exp(found.x[d + 1] - found.x[d]))
