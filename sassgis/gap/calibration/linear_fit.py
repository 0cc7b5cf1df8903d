"""Calibration of many parameters at once, from linear models of what campaigns show.

About the best parameters so far, campaigns are drawn, and the numbers that sum them up are
regressed on the parameters. The normal prior and the errors of the observed numbers then give the
next best ones in closed form (iterated linear Bayes; Gauss and Newton with slopes from an ensemble,
as Iglesias, Law and Stuart 2013, Inverse Problems 29, 045001). A step is kept only if it brings the
campaigns nearer to the observed rocks. The same linear model gives intervals, and the parameters
for a part of the rocks.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from sassgis.gap.calibration.site_summary import ObservedNumbers
from sassgis.model.grid import BoolArray, FloatArray

#: Parameters are standard normal before any rock is seen, and kept within this.
_LIMIT = 2.5
#: Radius of the first draws about the start, and attempts at a step. What the radius is multiplied
#: with after a step as long as itself, after a shorter one, and after one that is not kept.
_RADIUS, _ATTEMPTS = 1.2, 2
_FARTHER, _KEPT, _NOT_KEPT = 1.3, 0.85, 0.6
#: Standard deviation of the last draws, over that of what is left.
_SPREAD = 1.3
#: Number of the campaigns in which steps are compared: the same luck for all.
_LOOK = 1
#: Prior precision of the slopes, and the part of what the linear model leaves that counts as error:
#: the rest is the chance of single campaigns, which the regression averages.
_RIDGE, _LEFT = 0.5, 0.5
#: Numbers that are off by more standard errors count no more than this.
_FARTHEST = 5.0
#: A parameter is identified if its standard deviation is below this share of that before; the rocks
#: ask for another value where the one before is off by so many standard deviations (80 %).
_NARROWER, _ASKED = 0.7, 1.28

#: Numbers of a draw, shape (p,), and the energy distance of its campaigns from the observed rocks,
#: or their mean energy score.
Seen = tuple[FloatArray, float]


@dataclass(frozen=True, slots=True)
class Trial:
    """Parameters to be tried: number, standard normal values, shape (d,), campaigns."""

    number: int
    at: FloatArray
    count: int


#: Makes campaigns of trials.
RunTrials = Callable[[Sequence[Trial]], Sequence[Seen]]


@dataclass(frozen=True, slots=True)
class FitBudget:
    """Rounds, draws of each, campaigns of a draw, and of a step that is looked at.

    Parameters are kept within ``limit`` standard deviations. A ``last`` round of so many draws, of
    as many campaigns as a step, lies where the parameters may be, and the slopes are its alone.
    """

    rounds: int
    draws: int
    count: int
    looked: int
    limit: float = _LIMIT
    last: int = 0

    @property
    def tried(self) -> int:
        """Draws of all rounds."""
        return self.rounds * self.draws + self.last

    @property
    def trials(self) -> int:
        """Draws and steps together, at most."""
        return 1 + self.rounds * (1 + _ATTEMPTS) + self.tried


@dataclass(frozen=True, slots=True)
class LinearFit:
    """Best parameters, and the linear model about them, of numbers in standard errors."""

    best: FloatArray  # shape (d,); standard normal
    covariance: FloatArray  # shape (d, d); of the posterior
    level: FloatArray  # shape (p,); numbers at the best parameters
    slopes: FloatArray  # shape (p, d); of the numbers
    variance: FloatArray  # shape (p,); of the numbers about the model
    left: FloatArray  # shape (n, p); what the model leaves of the numbers of the draws

    @property
    def identified(self) -> BoolArray:
        """Parameters of which the rocks say something by themselves, shape (d,)."""
        return self.asked | (np.sqrt(np.diag(self.covariance)) < _NARROWER)

    @property
    def asked(self) -> BoolArray:
        """Parameters that the rocks do not leave at their values before, shape (d,)."""
        return np.abs(self.best) > _ASKED * np.sqrt(np.diag(self.covariance))

    def step(self, observed: FloatArray) -> FloatArray:
        """From the best parameters to those for some observed numbers, in standard errors."""
        weighted = self.slopes.T / self.variance
        precision = weighted @ self.slopes + np.eye(self.best.size)
        pull = weighted @ bounded(observed - self.level) - self.best
        return np.asarray(np.linalg.solve(precision, pull), np.float64)

    def given(self, fixed: BoolArray) -> FloatArray:
        """Best parameters if some are at their values before, and the others make up for it."""
        found = np.where(fixed, 0.0, self.best)
        free = ~fixed
        if fixed.any() and free.any():
            across = self.covariance[np.ix_(free, fixed)]
            within = self.covariance[np.ix_(fixed, fixed)]
            found[free] = self.best[free] - across @ np.linalg.solve(within, self.best[fixed])
        return np.clip(found, -_LIMIT, _LIMIT)


def fit_linearly(
    summary: ObservedNumbers, start: FloatArray, run: RunTrials, budget: FitBudget
) -> LinearFit:
    """Calibrate standard normal parameters to a site, or to several sites joined.

    ``start``: where to begin, shape (d,); before any rock is seen all are zero.
    """
    rng, limit = np.random.default_rng([summary.seed, 13]), budget.limit
    normal = qmc.MultivariateNormalQMC(np.zeros(start.size), np.eye(start.size), rng=rng)
    points, numbers = list[FloatArray](), list[FloatArray]()

    def look(at: FloatArray) -> float:
        (seen,) = run([Trial(_LOOK, at, budget.looked)])
        points.append(at)
        numbers.append(seen[0])
        return _loss(summary, at, seen)

    best = start.copy()
    least = look(best)
    radius, tried = _RADIUS, _LOOK
    for _ in range(budget.rounds):
        new = np.clip(best + radius * _next(normal, budget.draws), -limit, limit)
        made = run([Trial(tried + 1 + k, at, budget.count) for k, at in enumerate(new)])
        tried += budget.draws
        points += list(new)
        numbers += [own for own, _ in made]
        losses = [_loss(summary, at, own) for at, own in zip(new, made, strict=True)]
        nearest = new[int(np.argmin(losses))]
        if (loss := look(nearest)) < least:
            best, least = nearest, loss
        for _ in range(_ATTEMPTS):
            fit = _linear_model(summary, np.array(points), np.array(numbers), best)
            step = fit.step(summary.in_errors(summary.observed))
            size = float(np.sqrt(np.mean(step**2)))
            at = np.clip(best + step * min(1.0, radius / max(size, 1e-9)), -limit, limit)
            if (loss := look(at)) < least:
                best, least = at, loss
                radius *= _FARTHER if size > radius else _KEPT
                break
            radius *= _NOT_KEPT
    fit = _linear_model(summary, np.array(points), np.array(numbers), best)
    if not budget.last:
        return fit
    spread = _SPREAD * np.linalg.cholesky(fit.covariance)
    new = np.clip(best + _next(normal, budget.last) @ spread.T, -limit, limit)
    # All have the same luck: what does not act has no slope.
    made = run([Trial(tried + 1, at, budget.looked) for at in new])
    return _linear_model(summary, new, np.array([own for own, _ in made]), best, np.ones(len(new)))


def bounded(off: FloatArray) -> FloatArray:
    """Observed less simulated numbers as they count, in standard errors."""
    return np.asarray(np.clip(np.nan_to_num(off), -_FARTHEST, _FARTHEST), np.float64)


def _next(normal: qmc.MultivariateNormalQMC, n: int) -> FloatArray:
    with warnings.catch_warnings():
        # Whole powers of two are better balanced, which does not matter here.
        warnings.filterwarnings("ignore", "The balance properties", UserWarning)
        return np.asarray(normal.random(n), np.float64)


def _loss(summary: ObservedNumbers, at: FloatArray, seen: Seen) -> float:
    """Distance from the observed rocks, and what the prior has against the parameters.

    For a small shift of a quantity the energy distance is near the loss of logarithmic likelihood
    by rock, so that the prior counts by the number of rocks, or of the groups of them. Where only
    impacts were observed the distance is that of their numbers.
    """
    numbers, distance = seen
    if np.isfinite(distance):
        return float(distance + 0.5 * (at @ at) / summary.units)
    off = summary.in_errors(numbers) - summary.in_errors(summary.observed)
    off = np.clip(np.nan_to_num(off, nan=_FARTHEST), -_FARTHEST, _FARTHEST)
    return float(np.mean(off**2) + (at @ at) / max(off.size, 1))


def _linear_model(
    summary: ObservedNumbers,
    points: FloatArray,
    numbers: FloatArray,
    best: FloatArray,
    weight: FloatArray | None = None,
) -> LinearFit:
    """Regress the numbers on the parameters; without weights the nearest draws count most."""
    seen = summary.in_errors(numbers)
    known = np.isfinite(seen)
    count = np.maximum(known.sum(axis=0), 1)
    # What a draw does not show is taken to be as usual.
    seen = np.where(known, seen, np.where(known, seen, 0.0).sum(axis=0) / count)
    if weight is None:
        near = np.sqrt(np.mean((points - best) ** 2, axis=1))
        weight = np.exp(-0.5 * (near / max(float(np.median(near)), 1e-6)) ** 2)
    design = np.column_stack([np.ones(len(points)), points - best])
    d = best.size
    ridge = np.diag([1e-6, *[_RIDGE] * d])
    weighted = design.T * weight
    found = np.linalg.solve(weighted @ design + ridge, weighted @ seen)
    left = seen - design @ found
    freedom = max(float(weight.sum()) - min(d, 0.5 * float(weight.sum())), 3.0)
    variance = 1.0 + _LEFT * (weight[:, None] * left**2).sum(axis=0) / freedom
    # A number that hardly any draw shows says nothing.
    variance = np.where(known.mean(axis=0) > 0.5, variance, 1e6)
    slopes = found[1:].T
    precision = (slopes.T / variance) @ slopes + np.eye(d)
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    return LinearFit(best, covariance, found[0], slopes, variance, left)
