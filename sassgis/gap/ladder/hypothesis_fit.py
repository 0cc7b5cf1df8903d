"""Calibration of a hypothesis on the observed rocks, with and without the rocks to be left out."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from sassgis.gap.calibration.identifiability import TradeOff, trade_offs
from sassgis.gap.calibration.linear_fit import FitBudget, LinearFit, Seen, Trial, fit_linearly
from sassgis.gap.calibration.problem import model_rows, scores_of
from sassgis.gap.calibration.site_summary import SiteSummary
from sassgis.gap.causes.parameter_draws import ParameterDraws
from sassgis.gap.diagnosis import Range
from sassgis.gap.inference.distances import RockDistances
from sassgis.gap.inference.intervals import Interval, bootstrap_interval
from sassgis.gap.observations.case import Case
from sassgis.gap.which.hypotheses import NONE, Draw, draw
from sassgis.model.grid import BoolArray, FloatArray, IntArray

#: Campaigns of each model that is chosen, and the number that they have: the same for all
#: hypotheses, so that what differs between these is not luck.
FRESH, CHOSEN = 6, 3900
#: Campaigns of a draw, and of a step that is looked at.
COUNT, LOOKED = 2, 5
#: Draws of which the names of the parameters are taken.
_NAMED_BY = 64
#: Samples of which the values of parameters are computed.
_SAMPLES = 200
#: By how much the distance may be larger with the ground back at its configured values.
_AS_GOOD = (1.1, 0.01)


def families_of(effect: str) -> tuple[str, ...]:
    """Families of a hypothesis; none of the calibrated ground alone."""
    return () if effect == NONE else tuple(effect.split("+"))


@dataclass(frozen=True, slots=True)
class Space:
    """Parameters of a hypothesis."""

    effect: str  # "none", or families joined by "+"
    labels: tuple[str, ...]  # those that change something gradually
    choices: Mapping[str, float]  # shares that choose between forms, or are known: they stay
    of_ground: BoolArray  # shape (d,); parameters that belong to a ground class

    def start(self, shares: Mapping[str, float]) -> FloatArray:
        """Standard normal parameters from shares; those without one in the middle."""
        found: FloatArray = ndtri(np.array([shares.get(name, 0.5) for name in self.labels]))
        return np.clip(found, -2.0, 2.0)

    def shares(self, at: FloatArray) -> dict[str, float]:
        """All shares of standard normal parameters."""
        own = np.clip(ndtr(at), 0.0, 1.0 - 1e-9).tolist()
        return {**self.choices, **dict(zip(self.labels, own, strict=True))}


def space_of(
    case: Case, effect: str, shares: Mapping[str, float], held: Mapping[str, float]
) -> Space:
    """Parameters of a hypothesis, with the choices of some shares, and those that are held."""
    rng = np.random.default_rng(0)
    names: dict[str, bool] = {}
    for _ in range(_NAMED_BY):
        own = ParameterDraws(rng)
        draw(case, families_of(effect), own)
        names |= {name: name in own.smooth for name in own.used}
    labels = tuple(name for name, smooth in names.items() if smooth and name not in held)
    known = {**shares, **held}
    choices = {name: known.get(name, 0.5) for name in names if name not in labels}
    ground = np.array([name.rpartition(".")[0] in case.table.names for name in labels])
    return Space(effect, labels, choices, ground)


@dataclass(frozen=True, slots=True)
class HypothesisDraw:
    """A draw of a hypothesis: shares of its parameters, number and count of its campaigns."""

    effect: str
    shares: Mapping[str, float]
    number: int
    count: int

    def of(self, case: Case) -> Draw:
        """The draw itself."""
        return draw_of(case, self.effect, self.shares)


def draw_of(case: Case, effect: str, shares: Mapping[str, float]) -> Draw:
    """The draw of a hypothesis that some shares of its parameters make; others in the middle."""
    return draw(case, families_of(effect), ParameterDraws(None, shares))


def see(summary: SiteSummary, task: HypothesisDraw) -> Seen:
    """Numbers of a draw, and the distance of its campaigns from the observed rocks."""
    problem = summary.problem
    numbers, rows = summary.of_model(task.of(problem.case).model, task.number, task.count)
    distance = np.nan
    if problem.scale.names:
        distance = RockDistances.of(problem.rows, rows).value()
    return numbers, distance


@dataclass(frozen=True, slots=True)
class Chosen:
    """A chosen model with its campaigns."""

    draw: Draw
    rows: FloatArray  # shape (FRESH, n_rocks, 2 k)
    scores: FloatArray  # shape (n_rocks,)


def run_chosen(summary: SiteSummary, task: HypothesisDraw) -> Chosen:
    """Campaigns of a model that was chosen, and the scores of the rocks in it."""
    problem = summary.problem
    made = task.of(problem.case)
    rows = model_rows(problem, made.model, task.number, task.count)
    return Chosen(made, rows, scores_of(problem, made.model, task.number, rows))


@dataclass(frozen=True, slots=True)
class FittedHypothesis:
    """A hypothesis, calibrated without each part of the rocks, and last on all."""

    space: Space
    found: LinearFit | None  # None where nothing is compared
    models: tuple[Chosen, ...]  # n_parts + 1 of them

    @property
    def effect(self) -> str:
        """Families joined by "+", or "none"."""
        return self.space.effect

    @property
    def handed_over(self) -> Chosen:
        """The model of all rocks."""
        return self.models[-1]

    @property
    def shares(self) -> Mapping[str, float]:
        """Shares of the best parameters."""
        return self.handed_over.draw.parameter_draws

    def held_out_rows(self, part: IntArray) -> FloatArray:
        """Replicas of each rock by the model that it has no weight in, as rows."""
        own = [self.models[k].rows[:, rock] for rock, k in enumerate(part.tolist())]
        return np.stack(own, axis=1)

    def held_out_scores(self, part: IntArray) -> FloatArray:
        """Score of each rock by the model that it has no weight in."""
        return np.array([self.models[k].scores[rock] for rock, k in enumerate(part.tolist())])

    def samples(self, case: Case, most: int) -> list[Draw]:
        """Draws of the posterior; the one that is handed over where there is none."""
        if self.found is None:
            return [self.handed_over.draw]
        rng = np.random.default_rng([most, 43])
        drawn = rng.multivariate_normal(self.found.best, self.found.covariance, size=most)
        return [draw_of(case, self.effect, self.space.shares(at)) for at in drawn]

    def intervals(self, case: Case) -> Mapping[str, Range]:
        """95 % intervals of the parameters as they are reported; what is handed over is within."""
        chosen = self.handed_over.draw.parameters
        found = [chosen, *(one.parameters for one in self.samples(case, _SAMPLES))]
        out = {}
        for name, value in chosen.items():
            low, high = np.quantile([f[name] for f in found if name in f], [0.025, 0.975])
            out[name] = (min(float(low), value), max(float(high), value))
        return out

    @property
    def identified(self) -> frozenset[str]:
        """Parameters of which the rocks say something by themselves."""
        if self.found is None:
            return frozenset()
        return frozenset(itertools.compress(self.space.labels, self.found.identified.tolist()))

    @property
    def trade_offs(self) -> tuple[TradeOff, ...]:
        """Pairs of parameters that make up for each other, the strongest first."""
        if self.found is None:
            return ()
        return trade_offs(self.space.labels, self.found.covariance)


#: Results of a function of (summary, task), in the order of the tasks.
RunTasks = Callable[
    [Callable[[SiteSummary, HypothesisDraw], Any], Sequence[HypothesisDraw]], Iterable[Any]
]


def fit_hypothesis(
    summary: SiteSummary,
    effect: str,
    run: RunTasks,
    budget: FitBudget,
    start: Mapping[str, float],
    held: Mapping[str, float],
) -> FittedHypothesis:
    """Calibrate a hypothesis from where a simpler one, or a draw, has brought its parameters.

    ``start``: shares by name, of others the middle; ``held``: those of parameters that are known.
    """
    problem = summary.problem
    space = space_of(problem.case, effect, start, held)

    def trials(asked: Sequence[Trial]) -> list[Seen]:
        tasks = [HypothesisDraw(effect, space.shares(t.at), t.number, t.count) for t in asked]
        return list(run(see, tasks))

    at = [space.start(start)] * (problem.n_parts + 1)
    found = None
    if problem.scored:
        found = fit_linearly(summary, at[0], trials, budget)
        whole = found.step(summary.in_errors(summary.observed))
        without = [(problem.part != k).astype(float) for k in range(problem.n_parts)]
        at = [
            found.best + found.step(summary.in_errors(summary.of_rocks(own))) - whole
            for own in without
        ]
        at.append(_keeping_configured(space, found, trials))
    tasks = [HypothesisDraw(effect, space.shares(one), CHOSEN, FRESH) for one in at]
    return FittedHypothesis(space, found, tuple(run(run_chosen, tasks)))


def _keeping_configured(
    space: Space, found: LinearFit, trials: Callable[[Sequence[Trial]], list[Seen]]
) -> FloatArray:
    """Best parameters with the ground as configured where the rocks do not ask for more."""
    back = found.given(space.of_ground & ~found.asked)
    distances = [d for _, d in trials([Trial(0, at, LOOKED) for at in (found.best, back)])]
    factor, more = _AS_GOOD
    # Below zero is chance.
    return back if distances[1] <= factor * max(distances[0], 0.0) + more else found.best


def gain_of(
    base: FloatArray, effect: FloatArray, group: IntArray, rng: np.random.Generator
) -> Interval:
    """Mean gain of score over rocks, with its bootstrap interval over groups of rocks."""
    gain = base - effect
    known = np.isfinite(gain)
    if not known.any():
        return Interval(float("nan"), float("nan"), float("nan"))
    return bootstrap_interval(
        lambda rows: float(gain[known][rows].mean()),
        group[known],
        draws=999,
        rng=rng,
        method="percentile",
    )
