"""An emulator of the scores of simulated campaigns, cheap enough to be searched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from sassgis.model.grid import FloatArray

#: Limits of the correlation lengths, in shares of the ranges.
_LENGTHS = (0.15, 20.0)
#: Standard deviation of the logarithm of a correlation length about 1, beforehand.
_PRIOR = 1.0
#: Limits of the variances of parabola, bumps and sampling noise, over the variance of the scores.
_PARABOLA, _BUMPS, _NOISE = (1e-3, 100.0), (1e-3, 100.0), (1e-5, 2.0)
#: Scores are capped at this many times the distance from the best to this quantile of draws that
#: are spread evenly.
_CAP, _GOOD = 2.0, 0.75
#: Draws from which the correlations are fitted, at most.
_FITTED_ON = 240


@dataclass(frozen=True, slots=True)
class Correlations:
    """Covariance of the scores of two draws.

    A parabola over all parameters, which holds far from the draws as well, and bumps about it
    (Matérn 5/2).

    Attributes
    ----------
    lengths : float64, shape (d,)
        Of the bumps, in shares of the ranges.
    parabola, bumps, noise : float
        Variances.
    """

    lengths: FloatArray
    parabola: float
    bumps: float
    noise: float

    def between(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Covariance between points, shape (len(a), len(b))."""
        flat = 1.0 + _centred(a) @ _centred(b).T
        one, other = a / self.lengths, b / self.lengths
        square = (one**2).sum(axis=1)[:, None] + (other**2).sum(axis=1) - 2.0 * one @ other.T
        root = np.sqrt(5.0 * np.maximum(square, 0.0))
        covariance: FloatArray = self.parabola * flat**2 + self.bumps * (
            1.0 + root + root**2 / 3.0
        ) * np.exp(-root)
        return covariance

    def gradient(self, share: FloatArray, points: FloatArray, weights: FloatArray) -> FloatArray:
        """Gradient at one point of the weighted sum of the covariances with others, shape (d,)."""
        centred = _centred(points)
        flat = 1.0 + centred @ _centred(share)
        apart = (share - points) / self.lengths
        root = np.sqrt(5.0 * (apart**2).sum(axis=1))
        bumps = -(5.0 / 3.0) * self.bumps * (1.0 + root) * np.exp(-root) * weights
        slope: FloatArray = (bumps @ apart) / self.lengths
        return slope + 4.0 * self.parabola * (flat * weights) @ centred


def _centred(shares: FloatArray) -> FloatArray:
    """From -1 to 1."""
    return 2.0 * shares - 1.0


@dataclass(frozen=True, slots=True)
class Emulator:
    """Gaussian process through noisy scores of single rocks.

    Its covariance is fitted to the sum over the rocks and shared by all of them. A prediction is
    then a linear function of the scores: the emulator of any weighted sum of rocks is the weighted
    sum of their emulators, so that rocks can be resampled or left out without a new fit.

    Attributes
    ----------
    points : float64, shape (n, d)
        Where scores were made, as shares of the ranges.
    correlations : Correlations
    centre : float64, shape (n_rocks,)
        Score of each rock far from all draws.
    weights : float64, shape (n, n_rocks)
    noise : float
        Standard deviation that the sampling of campaigns gives the sum over the rocks.
    factor : float64, shape (n, n)
        Lower Cholesky factor of the covariance of the draws.
    """

    points: FloatArray
    correlations: Correlations
    centre: FloatArray
    weights: FloatArray
    noise: float
    factor: FloatArray

    def rocks(self, shares: FloatArray) -> FloatArray:
        """Scores of single rocks, shape (m, n_rocks)."""
        return self.centre + self.correlations.between(shares, self.points) @ self.weights

    def weighted(
        self, rock_weights: FloatArray, rng: np.random.Generator | None = None
    ) -> WeightedSum:
        """The weighted sum over the rocks; with ``rng`` as other campaigns might have given it."""
        weights = self.weights @ rock_weights
        if rng is not None:
            other = self.noise * rng.standard_normal(len(self.points))
            weights = weights + cho_solve((self.factor, True), other)
        return WeightedSum(
            self.points, self.correlations, float(self.centre @ rock_weights), weights
        )


@dataclass(frozen=True, slots=True)
class WeightedSum:
    """The emulator of a weighted sum of the scores of rocks; attributes as there."""

    points: FloatArray
    correlations: Correlations
    centre: float
    weights: FloatArray

    def value(self, shares: FloatArray) -> FloatArray:
        """Sum at some points, shape (m,)."""
        return self.centre + self.correlations.between(shares, self.points) @ self.weights

    def gradient(self, share: FloatArray) -> FloatArray:
        """Gradient at one point, shape (d,)."""
        return self.correlations.gradient(share, self.points, self.weights)


def fit(points: FloatArray, scores: FloatArray, first: int) -> Emulator:
    """Fit an emulator.

    Parameters
    ----------
    points : float64, shape (n, d)
    scores : float64, shape (n, n_rocks)
    first : int
        Draws that were spread evenly; the others lie where the best may be.

    Returns
    -------
    Emulator
    """
    total = scores.sum(axis=1)
    order = np.argsort(total, kind="stable")
    least = total[order[0]]
    # Beyond the cap all are equally bad, and so is what was never tried: no cliff far from the best
    # draws bends the surface near them. What single rocks lose or gain there shrinks in proportion.
    cap = least + _CAP * (np.quantile(total[:first], _GOOD) - least)
    usual = scores[order[: len(order) // 2 + 1]].mean(axis=0)
    room = max(cap - float(usual.sum()), 1e-12)
    over = np.maximum(total - float(usual.sum()), room)
    capped = usual + (scores - usual) * (room / over)[:, None]
    far = min(int((total < cap).sum()), total.size - 1)
    base = usual + room / scores.shape[1]
    few = order[np.linspace(0, min(far, len(order) - 1), min(far + 1, _FITTED_ON)).astype(int)]
    sums = (capped[few] - base).sum(axis=1)
    found = _correlations(points[few], sums)
    k = found.between(points, points)
    k[np.diag_indices_from(k)] += found.noise
    factor, _ = cho_factor(k, lower=True)
    weights = cho_solve((factor, True), capped - base)
    noise = float(np.sqrt(found.noise) * sums.std())
    return Emulator(points, found, base, weights, noise, factor)


def _correlations(points: FloatArray, total: FloatArray) -> Correlations:
    """Those of the highest marginal likelihood, in units of the variance of the sums."""
    n, d = points.shape
    y = total / max(float(total.std()), 1e-12)
    square = (points[:, None] - points) ** 2
    centred = _centred(points)
    flat = (1.0 + centred @ centred.T) ** 2
    limits = [_LENGTHS] * d + [_PARABOLA, _BUMPS, _NOISE]

    def negative_log_posterior(x: FloatArray) -> tuple[float, FloatArray]:
        parabola, bumps, noise = np.exp(x[d:])
        scaled = square * np.exp(-2.0 * x[:d])
        root = np.sqrt(5.0 * scaled.sum(axis=2))
        decay = bumps * np.exp(-root)
        bump = (1.0 + root + root**2 / 3.0) * decay
        factor = cho_factor(parabola * flat + bump + noise * np.eye(n), lower=True)
        inverse = cho_solve(factor, np.eye(n))
        solved = inverse @ y
        apart = inverse - np.outer(solved, solved)
        by_length = np.einsum("ij,ijk->k", apart * (5.0 / 3.0) * (1.0 + root) * decay, scaled)
        by_variance = [
            parabola * float((apart * flat).sum()),
            float((apart * bump).sum()),
            noise * float(np.trace(apart)),
        ]
        slope = 0.5 * np.append(by_length, by_variance)
        # Long correlations are expected where nothing speaks against them.
        slope[:d] += x[:d] / _PRIOR**2
        value = (
            0.5 * float(y @ solved)
            + float(np.log(np.diag(factor[0])).sum())
            + 0.5 * float((x[:d] ** 2).sum()) / _PRIOR**2
        )
        return value, slope

    first = np.append(np.zeros(d), np.log([0.3, 0.3, 0.1]))
    found = minimize(
        negative_log_posterior, first, jac=True, method="L-BFGS-B", bounds=np.log(limits)
    )
    parabola, bumps, noise = np.exp(found.x[d:]).tolist()
    return Correlations(np.exp(found.x[:d]), parabola, bumps, noise)
