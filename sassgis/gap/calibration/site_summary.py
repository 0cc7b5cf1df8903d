"""What campaigns of a site show, as numbers: means, scatters and trends over its rocks.

Observed and simulated campaigns are summed up alike. Which model brings these numbers to what was
observed is then a question of linear algebra (``linear_fit``), and what chance does to them is seen
from other campaigns of the same model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sassgis.gap.calibration.problem import CalibrationProblem, model_rows, outcomes_of, rows_of
from sassgis.gap.inference.intervals import times_drawn
from sassgis.gap.observations.campaign import ImpactRows
from sassgis.gap.replicas.campaigns import campaigns, rock_quantities
from sassgis.gap.replicas.hypothesis_model import HypothesisModel
from sassgis.gap.residuals.one_step import ImpactsInFlight
from sassgis.model.grid import BoolArray, FloatArray

#: Rocks, and impacts on a class of ground, that a number must rest on.
_FEWEST, _FEWEST_IMPACTS = 3.0, 15
#: Bootstrap samples, and the least standard error of a number, in scatters of the rocks.
_SAMPLES, _LEAST = 150, 0.03
#: Ground alone is calibrated on numbers that this share of the samples have: of fewer rocks than
#: about eight the errors are not known.
_SURE = 0.99
#: Larger turns at impacts count as this: slow rocks turn anywhere.
_MOST_TURN_DEG = 45.0


@dataclass(frozen=True, slots=True)
class ObservedNumbers:
    """What was observed, in numbers that campaigns are compared with."""

    observed: FloatArray  # shape (p,)
    error: FloatArray  # standard error of each, by drawing the rocks (or groups of them) anew
    used: BoolArray  # shape (p,); numbers that the observations have
    units: int  # rocks, or groups of them
    seed: int

    def in_errors(self, numbers: FloatArray) -> FloatArray:
        """Numbers that the observations have, in standard errors, the last axis shape (p,)."""
        return (numbers / self.error)[..., self.used]


def joined(sites: Sequence[ObservedNumbers]) -> ObservedNumbers:
    """The numbers of several sites, one after the other."""
    observed, error, used = (
        np.concatenate([getattr(site, name) for site in sites])
        for name in ("observed", "error", "used")
    )
    units = sum(site.units for site in sites)
    return ObservedNumbers(observed, error, used, units, sites[0].seed)


@dataclass(frozen=True, slots=True)
class SiteSummary(ObservedNumbers):
    """The numbers of a site."""

    problem: CalibrationProblem
    size: FloatArray  # shape (n_rocks,); logarithm of the radius, standardised

    def of_rocks(self, weights: FloatArray) -> FloatArray:
        """Numbers of the observed rocks with weights, shape (p,)."""
        seen = self.problem
        return self._numbers(
            seen.rows[None], seen.outcomes[:, None], [seen.observed.impacts], weights
        )

    def of_model(
        self, model: HypothesisModel, number: int, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Numbers of campaigns of a model together, shape (p,), and their rows."""
        made = self._campaigns(model, number, count)
        return self._numbers(*made), made[0]

    def of_each(self, model: HypothesisModel, number: int, count: int) -> FloatArray:
        """Numbers of single campaigns of a model, shape (count, p), count up to DRAWS."""
        rows, outcomes, impacts = self._campaigns(model, number, count)
        each = (slice(k, k + 1) for k in range(count))
        return np.array([self._numbers(rows[k], outcomes[:, k], impacts[k]) for k in each])

    def misfits(
        self, model: HypothesisModel, number: int, count: int, weights: FloatArray
    ) -> FloatArray:
        """Observed less simulated numbers of rocks with weights, in standard errors.

        What rocks differ in by themselves, as their release points, is the same in both. From
        ``weights`` of shape (n, n_rocks), shape (n, number of used ones).
        """
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
        """Of rows of rocks, shape (m, n_rocks, 2 k), outcomes of observed impacts, shape (n, m, 3).

        And of the turns at the impacts of each campaign, as they were recorded.
        """
        size, impacts = self.size, self.problem.impacts
        weight = np.ones(self.problem.n_rocks) if weights is None else weights
        parts = [self._of_rows(rows, weight)]
        if impacts is not None:
            for kind in np.unique(impacts.kind).tolist():
                own = np.flatnonzero(impacts.kind == kind)
                if own.size >= _FEWEST_IMPACTS:
                    chosen = impacts.take(own)
                    by_rock = weight[chosen.rock][:, None]
                    parts.append(_of_impacts(chosen, size[chosen.rock], outcomes[own], by_rock))
        if self.problem.turned:
            known = [one for one in recorded if one is not None]
            rock = np.concatenate([np.empty(0, np.int64), *(one.rock for one in known)])
            turn = np.concatenate([np.empty(0), *(one.turn_deg for one in known)])
            seen = np.isfinite(turn)
            turn = np.clip(np.where(seen, turn, 0.0), -_MOST_TURN_DEG, _MOST_TURN_DEG)
            columns = turn / _MOST_TURN_DEG, seen * weight[rock], size[rock]
            parts.append(_moments(*(one[:, None, None] for one in columns)))
        return np.concatenate(parts)

    def _of_rows(self, rows: FloatArray, weight: FloatArray) -> FloatArray:
        """Mean, scatter and trend with the size of each quantity, and who passed each station."""
        names = self.problem.scale.names
        k = len(names)
        values, absent = rows[..., :k], rows[..., k:]
        has = (1.0 - absent) * ~self.problem.unseen[:, :k] * weight[:, None]
        moments = _moments(values, has, self.size[:, None])
        stations = [i for i, name in enumerate(names) if name.endswith(":speed")]
        came = (absent * weight[:, None]).sum(axis=(0, 1)) / (len(rows) * weight.sum())
        return np.concatenate([moments, came[stations]])


def summary_of(problem: CalibrationProblem) -> SiteSummary:
    """Sum up what was observed at a site."""
    radius = np.log(problem.case.radius_m)
    spread = float(radius.std())
    size = (radius - radius.mean()) / spread if spread > 1e-6 else np.zeros(radius.size)
    none = np.empty(0)
    blank = SiteSummary(none, none, none > 0.0, problem.units, problem.seed, problem, size)
    observed = blank.of_rocks(np.ones(problem.n_rocks))
    drawn = np.array([blank.of_rocks(weights) for weights in rocks_drawn_anew(problem)])
    known = np.isfinite(drawn)
    used = np.isfinite(observed) & (known.mean(axis=0) > 0.8)
    if not problem.sideways:
        used &= _of_ground(problem, used.size) & (known.mean(axis=0) > _SURE)
    filled = np.where(known, drawn, observed)
    error = np.maximum(np.std(np.where(used, filled, 0.0), axis=0), _LEAST)
    return replace(blank, observed=observed, error=error, used=used)


def _of_ground(problem: CalibrationProblem, p: int) -> BoolArray:
    """Numbers that only ground changes: no offsets from fall lines.

    Of impacts neither scatters nor trends with the normal speed: errors of the states before widen
    what is computed from them, as the observed states after are not.
    """
    names = problem.scale.names
    of_rows = 3 * [not name.endswith(":aside") for name in names]
    of_rows += [True] * sum(name.endswith(":speed") for name in names)
    of_impacts = 2 * ([True] * 3 + [False] * 3)
    return np.array(of_rows + of_impacts * ((p - len(of_rows)) // len(of_impacts)), np.bool_)


def rocks_drawn_anew(problem: CalibrationProblem) -> FloatArray:
    """How often each rock is drawn in samples of the rocks, or of groups, shape (n, n_rocks)."""
    return times_drawn(problem.unit, np.random.default_rng([problem.seed, 11]), _SAMPLES)


def _of_impacts(
    impacts: ImpactsInFlight, size: FloatArray, outcomes: FloatArray, weight: FloatArray
) -> FloatArray:
    """The same of speeds and spin after impacts, and their trend with the normal speed."""
    known = np.isfinite(outcomes)
    values, has = np.where(known, outcomes, 0.0), known * weight[..., None]
    speed = np.log(np.maximum(-impacts.impacts.vn_in_mps, 0.2))
    speed = (speed - speed.mean()) / max(float(speed.std()), 1e-6)
    trend = _moments(values, has, speed[:, None, None])[6:]
    return np.concatenate([_moments(values, has, size[:, None, None]), trend])


def _moments(values: FloatArray, has: FloatArray, by: FloatArray) -> FloatArray:
    """Means, logarithms of scatters, and covariances with ``by``, of the last axis; NaN of few."""
    total = has.sum(axis=(0, 1))
    few, total = total < _FEWEST, np.maximum(total, 1e-9)
    mean = (values * has).sum(axis=(0, 1)) / total
    off = (values - mean) * has
    spread = np.sqrt(np.maximum((off * (values - mean)).sum(axis=(0, 1)) / total, 1e-4))
    found = np.concatenate([mean, np.log(spread), (off * by).sum(axis=(0, 1)) / total])
    found[np.tile(few, 3)] = np.nan
    return found
