"""Sum up campaigns of a site in numbers, and calibrate parameters on linear models of these.

Observed and simulated campaigns are summed up alike: means, scatters and trends over the rocks.
About the best parameters so far, campaigns are drawn, and their numbers are regressed on the
parameters. The normal prior and the errors of the observed numbers then give the next best ones in
closed form (iterated linear Bayes; Gauss and Newton with slopes from an ensemble, as Iglesias, Law
and Stuart 2013, Inverse Problems 29, 045001). A step is kept only if it brings the campaigns nearer
to the observed rocks. The same linear model gives intervals, and the parameters for a part of the
rocks. What chance does to the numbers is seen from other campaigns of the same model.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from sassgis.gap.constants import (
    ASKED_DEVIATIONS,
    FARTHEST_ERRORS,
    FIRST_RADIUS,
    FIT_LIMIT,
    LAST_SPREAD,
    LAW_OUTCOMES,
    LAW_QUANTITIES,
    LAW_SHARES,
    LAW_TREND,
    LEAST_NUMBER_ERROR,
    LEFT_AS_ERROR,
    LOOK_NUMBER,
    MOST_TURN_DEG,
    NARROWER,
    NUMBER_IMPACTS,
    NUMBER_ROCKS,
    NUMBER_SAMPLES,
    RADIUS_FARTHER,
    RADIUS_KEPT,
    RADIUS_NOT_KEPT,
    SLOPE_RIDGE,
    STEP_ATTEMPTS,
    SURE_SAMPLES,
)
from sassgis.gap.fit.distances import times_drawn
from sassgis.gap.fit.site_data import SiteData, model_rows, outcomes_of, rows_of
from sassgis.gap.forward.observation_operator import campaigns, rock_quantities
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.observations.case import ImpactRows
from sassgis.gap.residuals.impact_residuals import ImpactsInFlight
from sassgis.grid import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class ObservedNumbers:
    """Observations in the numbers with which campaigns are compared."""

    observed: FloatArray  # shape (p,)
    error: FloatArray  # standard error of each, by drawing the rocks (or groups of them) anew
    used: BoolArray  # shape (p,); numbers that the observations have
    units: int  # rocks, or groups of them
    seed: int

    def in_errors(self, numbers: FloatArray) -> FloatArray:
        """Return the numbers of the observations in standard errors, the last axis shape (p,)."""
        return (numbers / self.error)[..., self.used]


def joined(sites: Sequence[ObservedNumbers]) -> ObservedNumbers:
    """Return the numbers of several sites, one after the other."""
    observed, error, used = (
        np.concatenate([getattr(site, name) for site in sites])
        for name in ("observed", "error", "used")
    )
    units = sum(site.units for site in sites)
    return ObservedNumbers(observed, error, used, units, sites[0].seed)


@dataclass(frozen=True, slots=True)
class SiteSummary(ObservedNumbers):
    """The numbers of a site."""

    problem: SiteData
    size: FloatArray  # shape (n_rocks,); logarithm of the radius, standardised

    def of_rocks(self, weights: FloatArray) -> FloatArray:
        """Return numbers of the observed rocks with weights, shape (p,)."""
        seen = self.problem
        return self._numbers(
            seen.rows[None], seen.outcomes[:, None], [seen.observed.impacts], weights
        )

    def of_model(
        self, model: HypothesisModel, number: int, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return numbers of campaigns of a model together, shape (p,), and their rows."""
        made = self._campaigns(model, number, count)
        return self._numbers(*made), made[0]

    def of_each(self, model: HypothesisModel, number: int, count: int) -> FloatArray:
        """Return numbers of single campaigns of a model, shape (count, p), count up to DRAWS."""
        rows, outcomes, impacts = self._campaigns(model, number, count)
        each = (slice(k, k + 1) for k in range(count))
        return np.array([self._numbers(rows[k], outcomes[:, k], impacts[k]) for k in each])

    def misfits(
        self, model: HypothesisModel, number: int, count: int, weights: FloatArray
    ) -> FloatArray:
        """Return observed less simulated numbers, in errors, of weighted rocks: (n, used ones)."""
        made = self._campaigns(model, number, count)
        simulated = [self._numbers(*made, own) for own in weights]
        seen = [self.of_rocks(own) for own in weights]
        return self.in_errors(np.array(seen) - np.array(simulated))

    def _campaigns(
        self, model: HypothesisModel, number: int, count: int
    ) -> tuple[FloatArray, FloatArray, list[ImpactRows | None]]:
        problem = self.problem
        outcomes = outcomes_of(problem, model, number)
        if outcomes is None:
            outcomes = np.empty((0, count, 3))
        if not problem.turned:
            return model_rows(problem, model, number, count), outcomes, [None] * count
        made = campaigns(
            problem.case, problem.rock_lines, model,
            count=count, seed=problem.seed, number=number,
        )  # fmt: skip
        rows = rows_of(problem, [rock_quantities(problem.case, one) for one in made])
        return rows, outcomes, [one.impacts for one in made]

    def _numbers(
        self,
        rows: FloatArray,
        outcomes: FloatArray,
        recorded: Sequence[ImpactRows | None],
        weights: FloatArray | None = None,
    ) -> FloatArray:
        """Compute the numbers of rows (m, n_rocks, 2 k), outcomes (n, m, 3) and recorded turns."""
        size, impacts = self.size, self.problem.impacts
        weight = np.ones(self.problem.n_rocks) if weights is None else weights
        parts = [self._of_rows(rows, weight)]
        if impacts is not None:
            for kind in np.unique(impacts.kind).tolist():
                own = np.flatnonzero(impacts.kind == kind)
                if own.size >= NUMBER_IMPACTS:
                    chosen = impacts.take(own)
                    by_rock = weight[chosen.rock][:, None]
                    parts.append(_of_impacts(chosen, size[chosen.rock], outcomes[own], by_rock))
        if self.problem.turned:
            known = [one for one in recorded if one is not None]
            rock = np.concatenate([np.empty(0, np.int64), *(one.rock for one in known)])
            turn = np.concatenate([np.empty(0), *(one.turn_deg for one in known)])
            seen = np.isfinite(turn)
            turn = np.clip(np.where(seen, turn, 0.0), -MOST_TURN_DEG, MOST_TURN_DEG)
            columns = turn / MOST_TURN_DEG, seen * weight[rock], size[rock]
            parts.append(_moments(*(one[:, None, None] for one in columns)))
        return np.concatenate(parts)

    def _of_rows(self, rows: FloatArray, weight: FloatArray) -> FloatArray:
        """Compute mean, scatter and trend with size of each quantity, and who passed stations."""
        names = self.problem.scale.names
        k = len(names)
        values, absent = rows[..., :k], rows[..., k:]
        has = (1.0 - absent) * ~self.problem.unseen[:, :k] * weight[:, None]
        moments = _moments(values, has, self.size[:, None])
        stations = [i for i, name in enumerate(names) if name.endswith(":speed")]
        came = (absent * weight[:, None]).sum(axis=(0, 1)) / (len(rows) * weight.sum())
        return np.concatenate([moments, came[stations]])


def summary_of(problem: SiteData) -> SiteSummary:
    """Sum up what was observed at a site."""
    radius = np.log(problem.case.radius_m)
    spread = float(radius.std())
    size = (radius - radius.mean()) / spread if spread > 1e-6 else np.zeros(radius.size)
    none = np.empty(0)
    blank = SiteSummary(
        observed=none, error=none, used=none > 0.0, units=problem.units, seed=problem.seed,
        problem=problem, size=size,
    )  # fmt: skip
    observed = blank.of_rocks(np.ones(problem.n_rocks))
    drawn = np.array([blank.of_rocks(weights) for weights in rocks_drawn_anew(problem)])
    known = np.isfinite(drawn)
    used = np.isfinite(observed) & (known.mean(axis=0) > 0.8)
    if not problem.sideways:
        used &= _of_ground(problem, used.size) & (known.mean(axis=0) > SURE_SAMPLES)
    filled = np.where(known, drawn, observed)
    error = np.maximum(np.std(np.where(used, filled, 0.0), axis=0), LEAST_NUMBER_ERROR)
    return replace(blank, observed=observed, error=error, used=used)


def _of_ground(problem: SiteData, p: int) -> BoolArray:
    """Return numbers that only ground changes: no offsets; of impacts means and size trends."""
    names = problem.scale.names
    of_rows = 3 * [not name.endswith(":aside") for name in names]
    of_rows += [True] * sum(name.endswith(":speed") for name in names)
    of_impacts = 2 * ([True] * 3 + [False] * 3)
    return np.array(of_rows + of_impacts * len(_classes_of(names, p)), np.bool_)


def _classes_of(names: Sequence[str], p: int) -> range:
    """Return where the numbers of impacts begin, class by class: twelve after those of the rows."""
    first = 3 * len(names) + sum(name.endswith(":speed") for name in names)
    return range(first, p - _OF_CLASS + 1, _OF_CLASS)


#: Numbers of the impacts on a class: mean, scatter, trends with size and normal speed of three.
_OF_CLASS = 12


def law_changes(summary: SiteSummary) -> FloatArray:
    """Return changes of the numbers by one standard deviation of each discrepancy of the law.

    Shape (p used, d), in standard errors. Means of a quantity change at all stations by a share,
    and by one that grows down the slope; speeds and spins after impacts on all classes alike, and
    with the normal speed. Scatters and trends with the size of rocks do not (``LAW_SHARES``).
    """
    scale = summary.problem.scale
    p = summary.error.size
    kinds = [name.rpartition(":")[2] for name in scale.names]
    sizes = np.array([LAW_SHARES.get(LAW_QUANTITIES.get(kind, ""), 0.0) for kind in kinds])
    sizes *= np.abs(scale.centre) / scale.scale if scale.names else 0.0
    columns = []
    for kind in dict.fromkeys(kinds):
        own = np.flatnonzero([name == kind for name in kinds])
        if not sizes[own].any():
            continue
        for values in (np.ones(own.size), LAW_TREND * np.linspace(-1.0, 1.0, own.size)):
            columns.append(np.zeros(p))
            columns[-1][own] = sizes[own] * values
    trends = _OF_CLASS - len(LAW_OUTCOMES)
    for j, sd in enumerate(LAW_OUTCOMES):
        for place, size in ((j, sd), (trends + j, LAW_TREND * sd)):
            columns.append(np.zeros(p))
            columns[-1][[start + place for start in _classes_of(scale.names, p)]] = size
    return summary.in_errors(np.array(columns)).T


def rocks_drawn_anew(problem: SiteData) -> FloatArray:
    """Count how often samples of rocks or groups hold each rock, shape (n, n_rocks)."""
    return times_drawn(problem.unit, np.random.default_rng([problem.seed, 11]), NUMBER_SAMPLES)


def _of_impacts(
    impacts: ImpactsInFlight, size: FloatArray, outcomes: FloatArray, weight: FloatArray
) -> FloatArray:
    """Return the same of speeds and spin after impacts, and their trend with the normal speed."""
    known = np.isfinite(outcomes)
    values, has = np.where(known, outcomes, 0.0), known * weight[..., None]
    speed = np.log(np.maximum(-impacts.impacts.vn_in_mps, 0.2))
    speed = (speed - speed.mean()) / max(float(speed.std()), 1e-6)
    trend = _moments(values, has, speed[:, None, None])[6:]
    return np.concatenate([_moments(values, has, size[:, None, None]), trend])


def _moments(values: FloatArray, has: FloatArray, by: FloatArray) -> FloatArray:
    """Return means, logarithms of scatters, covariances with ``by``, of the last axis; or NaN."""
    total = has.sum(axis=(0, 1))
    few, total = total < NUMBER_ROCKS, np.maximum(total, 1e-9)
    mean = (values * has).sum(axis=(0, 1)) / total
    off = (values - mean) * has
    spread = np.sqrt(np.maximum((off * (values - mean)).sum(axis=(0, 1)) / total, 1e-4))
    found = np.concatenate([mean, np.log(spread), (off * by).sum(axis=(0, 1)) / total])
    found[np.tile(few, 3)] = np.nan
    return found


class Seen(NamedTuple):
    """What the campaigns of a draw show."""

    numbers: FloatArray  # shape (p,)
    distance: float  # energy distance from the observed rocks, or their mean energy score


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
    as many campaigns as a step, lies where the parameters may be, and the slopes are only its.
    """

    rounds: int
    draws: int
    count: int
    looked: int
    limit: float = FIT_LIMIT
    last: int = 0

    @property
    def tried(self) -> int:
        """Draws of all rounds."""
        return self.rounds * self.draws + self.last

    @property
    def trials(self) -> int:
        """Draws and steps together, at most."""
        return 1 + self.rounds * (1 + STEP_ATTEMPTS) + self.tried


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
        return self.asked | (np.sqrt(np.diag(self.covariance)) < NARROWER)

    @property
    def asked(self) -> BoolArray:
        """Parameters that the rocks do not leave at their values before, shape (d,)."""
        return np.abs(self.best) > ASKED_DEVIATIONS * np.sqrt(np.diag(self.covariance))

    def step(self, observed: FloatArray) -> FloatArray:
        """Step from the best parameters to those for some observed numbers, in standard errors."""
        weighted = self.slopes.T / self.variance
        precision = weighted @ self.slopes + np.eye(self.best.size)
        pull = weighted @ bounded(observed - self.level) - self.best
        return np.asarray(np.linalg.solve(precision, pull), np.float64)

    def given(self, fixed: BoolArray) -> FloatArray:
        """Find the best parameters if some keep their values and the others make up for it."""
        found = np.where(fixed, 0.0, self.best)
        free = ~fixed
        if fixed.any() and free.any():
            across = self.covariance[np.ix_(free, fixed)]
            within = self.covariance[np.ix_(fixed, fixed)]
            found[free] = self.best[free] - across @ np.linalg.solve(within, self.best[fixed])
        return np.clip(found, -FIT_LIMIT, FIT_LIMIT)


def fit_linearly(
    summary: ObservedNumbers, start: FloatArray, run: RunTrials, budget: FitBudget
) -> LinearFit:
    """Calibrate standard normal parameters to a site, or to joined ones, from ``start``, (d,)."""
    rng, limit = np.random.default_rng([summary.seed, 13]), budget.limit
    normal = qmc.MultivariateNormalQMC(np.zeros(start.size), np.eye(start.size), rng=rng)
    points, numbers = list[FloatArray](), list[FloatArray]()

    def look(at: FloatArray) -> float:
        (seen,) = run([Trial(LOOK_NUMBER, at, budget.looked)])
        points.append(at)
        numbers.append(seen.numbers)
        return _loss(summary, at, seen)

    best = start.copy()
    least = look(best)
    radius, tried = FIRST_RADIUS, LOOK_NUMBER
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
        for _ in range(STEP_ATTEMPTS):
            fit = _linear_model(summary, np.array(points), np.array(numbers), best)
            step = fit.step(summary.in_errors(summary.observed))
            size = float(np.sqrt(np.mean(step**2)))
            at = np.clip(best + step * min(1.0, radius / max(size, 1e-9)), -limit, limit)
            if (loss := look(at)) < least:
                best, least = at, loss
                radius *= RADIUS_FARTHER if size > radius else RADIUS_KEPT
                break
            radius *= RADIUS_NOT_KEPT
    fit = _linear_model(summary, np.array(points), np.array(numbers), best)
    if not budget.last:
        return fit
    spread = LAST_SPREAD * np.linalg.cholesky(fit.covariance)
    new = np.clip(best + _next(normal, budget.last) @ spread.T, -limit, limit)
    # All have the same luck: what does not act has no slope.
    made = run([Trial(tried + 1, at, budget.looked) for at in new])
    return _linear_model(summary, new, np.array([own for own, _ in made]), best, np.ones(len(new)))


def bounded(off: FloatArray) -> FloatArray:
    """Return observed less simulated numbers as they count, in standard errors."""
    return np.asarray(np.clip(np.nan_to_num(off), -FARTHEST_ERRORS, FARTHEST_ERRORS), np.float64)


def _next(normal: qmc.MultivariateNormalQMC, n: int) -> FloatArray:
    with warnings.catch_warnings():
        # Whole powers of two are better balanced, which does not matter here.
        warnings.filterwarnings("ignore", "The balance properties", UserWarning)
        return np.asarray(normal.random(n), np.float64)


def _loss(summary: ObservedNumbers, at: FloatArray, seen: Seen) -> float:
    """Return the distance from the observed rocks, and what the prior has against the parameters.

    For a small shift of a quantity the energy distance is near the loss of logarithmic likelihood
    by rock, so that the prior counts by the number of rocks, or of the groups of them. Where only
    impacts were observed the distance is that of their numbers.
    """
    numbers, distance = seen
    if np.isfinite(distance):
        return float(distance + 0.5 * (at @ at) / summary.units)
    off = summary.in_errors(numbers) - summary.in_errors(summary.observed)
    off = np.clip(np.nan_to_num(off, nan=FARTHEST_ERRORS), -FARTHEST_ERRORS, FARTHEST_ERRORS)
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
    ridge = np.diag([1e-6, *[SLOPE_RIDGE] * d])
    weighted = design.T * weight
    found = np.linalg.solve(weighted @ design + ridge, weighted @ seen)
    left = seen - design @ found
    freedom = max(float(weight.sum()) - min(d, 0.5 * float(weight.sum())), 3.0)
    variance = 1.0 + LEFT_AS_ERROR * (weight[:, None] * left**2).sum(axis=0) / freedom
    # A number that hardly any draw shows says nothing.
    variance = np.where(known.mean(axis=0) > 0.5, variance, 1e6)
    slopes = found[1:].T
    precision = (slopes.T / variance) @ slopes + np.eye(d)
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    return LinearFit(best, covariance, found[0], slopes, variance, left)
