"""Calibration of a hypothesis on the observed rocks, with and without the rocks to be left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sassgis.gap.calibration.calibrator import Calibrated, Space
from sassgis.gap.calibration.identifiability import TradeOff, trade_offs
from sassgis.gap.calibration.parameters import CalibrationRange, ClassParameter
from sassgis.gap.calibration.problem import CalibrationProblem, model_rows, scores_of
from sassgis.gap.causes.parameter_draws import ParameterDraws
from sassgis.gap.diagnosis import Range
from sassgis.gap.inference.intervals import Interval, bootstrap_interval
from sassgis.gap.observations.case import Case
from sassgis.gap.which.hypotheses import NONE, Draw, draw
from sassgis.model.grid import FloatArray, IntArray

#: Campaigns of each draw: a few, so that the scatter of one model is known rock by rock.
COUNT = 4
#: Campaigns of each model that is chosen, and the number that they have: the same for all
#: hypotheses, so that what differs between these is not luck.
FRESH, CHOSEN = 6, 3900
#: Draws of which the names of the parameters are taken.
_NAMED_BY = 64
#: Samples of which the values of parameters are computed.
_SAMPLES = 200
_SHARES = CalibrationRange(0.0, 1.0, False, "")


def families_of(effect: str) -> tuple[str, ...]:
    """Families of a hypothesis; none of the calibrated ground alone."""
    return () if effect == NONE else tuple(effect.split("+"))


def space_of(case: Case, effect: str) -> Space:
    """Parameters of a hypothesis: those of the ground first, and whatever its forms draw."""
    rng = np.random.default_rng(0)
    names: dict[str, None] = {}
    for _ in range(_NAMED_BY):
        names |= dict.fromkeys(draw(case, families_of(effect), ParameterDraws(rng)).parameter_draws)
    parameters = []
    for label in names:
        ground, _, name = label.rpartition(".")
        parameters.append(ClassParameter(ground, name, _SHARES, 0.5))
    of_ground = np.array([p.class_name in case.table.names for p in parameters])
    return Space(tuple(parameters), (np.arange(len(parameters)),), of_ground)


@dataclass(frozen=True, slots=True)
class HypothesisDraw:
    """A draw of a hypothesis.

    Attributes
    ----------
    effect : str
        "none", or families joined by "+".
    labels : tuple of str
        Of the parameters.
    shares : tuple of float
    number : int
        Of its campaigns.
    """

    effect: str
    labels: tuple[str, ...]
    shares: tuple[float, ...]
    number: int

    def of(self, case: Case) -> Draw:
        """The draw itself."""
        rng = np.random.default_rng([41, self.number])
        given = dict(zip(self.labels, np.clip(self.shares, 0.0, 1.0 - 1e-9).tolist(), strict=True))
        return draw(case, families_of(self.effect), ParameterDraws(rng, given))


def score_hypothesis(problem: CalibrationProblem, task: HypothesisDraw) -> FloatArray:
    """Score of each rock."""
    return scores_of(problem, task.of(problem.case).model, task.number, COUNT)


@dataclass(frozen=True, slots=True)
class Chosen:
    """A chosen model with its campaigns.

    Attributes
    ----------
    draw : Draw
    rows : float64, shape (FRESH, n_rocks, 2 k)
    scores : float64, shape (n_rocks,)
    """

    draw: Draw
    rows: FloatArray
    scores: FloatArray


def run_chosen(problem: CalibrationProblem, task: HypothesisDraw) -> Chosen:
    """Campaigns of a model that was chosen, and the scores of the rocks in it."""
    made = task.of(problem.case)
    rows = model_rows(problem, made.model, task.number, FRESH)
    return Chosen(made, rows, scores_of(problem, made.model, task.number, FRESH, rows))


@dataclass(frozen=True, slots=True)
class FittedHypothesis:
    """A hypothesis, calibrated without each part of the rocks, and last on all.

    Attributes
    ----------
    effect : str
    labels : tuple of str
    found : Calibrated or None
        None where nothing is scored.
    models : tuple of Chosen, length n_parts + 1
    """

    effect: str
    labels: tuple[str, ...]
    found: Calibrated | None
    models: tuple[Chosen, ...]

    @property
    def handed_over(self) -> Chosen:
        """The model of all rocks."""
        return self.models[-1]

    def held_out_rows(self, part: IntArray) -> FloatArray:
        """Replicas of each rock by the model that it has no weight in, as rows."""
        rows = self.handed_over.rows.copy()
        for k, own in enumerate(self.models[:-1]):
            rows[:, part == k] = own.rows[:, part == k]
        return rows

    def held_out_scores(self, part: IntArray) -> FloatArray:
        """Score of each rock by the model that it has no weight in."""
        scores = self.handed_over.scores.copy()
        for k, own in enumerate(self.models[:-1]):
            scores[part == k] = own.scores[part == k]
        return scores

    def samples(self, case: Case, most: int) -> list[Draw]:
        """Draws of the posterior; the one that is handed over where there is none."""
        if self.found is None:
            return [self.handed_over.draw]
        samples = self.found.posterior.samples
        step = max(1, len(samples) // most)
        return [
            HypothesisDraw(self.effect, self.labels, tuple(shares), CHOSEN).of(case)
            for shares in samples[::step][:most].tolist()
        ]

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
    def trade_offs(self) -> tuple[TradeOff, ...]:
        """Parameters that make up for each other."""
        if self.found is None:
            return ()
        return trade_offs([f.parameter for f in self.found.fitted], self.found.posterior)


def chosen_draws(
    problem: CalibrationProblem, effect: str, space: Space, found: Calibrated | None
) -> list[HypothesisDraw]:
    """The best draw without each part of the rocks, and last of all rocks."""
    if found is None:
        shares = [space.prior.centre] * (problem.n_parts + 1)
    else:
        left_out = [found.without([problem], part) for part in range(problem.n_parts)]
        shares = [*left_out, found.posterior.best]
    labels = tuple(p.label for p in space.parameters)
    return [HypothesisDraw(effect, labels, tuple(u.tolist()), CHOSEN) for u in shares]


def in_range(problem: CalibrationProblem, ground_range: float) -> CalibrationProblem:
    """The problem with another range of the ground."""
    return replace(problem, case=replace(problem.case, ground_range=ground_range))


def gain_of(
    base: FloatArray,
    effect: FloatArray,
    group: IntArray,
    rng: np.random.Generator,
    draws: int = 999,
) -> Interval:
    """Mean gain of score over rocks, with its bootstrap interval over groups of rocks."""
    gain = base - effect
    known = np.isfinite(gain)
    if not known.any():
        return Interval(float("nan"), float("nan"), float("nan"))
    return bootstrap_interval(
        lambda rows: float(gain[known][rows].mean()),
        group[known],
        draws=draws,
        rng=rng,
        method="percentile",
    )
