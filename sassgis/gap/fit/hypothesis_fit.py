"""Draw hypotheses, the base model with causes, and calibrate them with and without rocks left out.

A hypothesis is a set of ranges from which its parameters are drawn. Every draw has separate
calibration of the ground, of the scatter of rolling friction, and of the lateral tilt and the
drift of followed paths, so that an effect has to explain what calibration cannot.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from sassgis.gap.causes.all_causes import CAUSES, FAMILIES
from sassgis.gap.causes.cause import ParameterDraws, rounded
from sassgis.gap.constants import (
    AS_GOOD_FACTOR,
    AS_GOOD_MORE,
    CHOSEN_COUNT,
    CHOSEN_NUMBER,
    DRAW_COUNT,
    FIT_ROUNDS,
    GROUND_BOUNDS,
    GROUND_WIDTHS,
    LOOK_COUNT,
    NAMING_DRAWS,
    PARAMETER_SAMPLES,
    ROTATION_FACTORS,
    ROTATION_NOISES,
    SIDEWAYS_FACTORS,
)
from sassgis.gap.diagnosis import Range
from sassgis.gap.fit.distances import Interval, RockDistances, bootstrap_interval
from sassgis.gap.fit.linear_fit import FitBudget, LinearFit, Seen, SiteSummary, Trial, fit_linearly
from sassgis.gap.fit.parameters import TradeOff, fitted_names, trade_offs
from sassgis.gap.fit.site_data import SiteData, model_rows, scores_of
from sassgis.gap.forward.released_rocks import HypothesisModel, MeasurementError, moving_effects
from sassgis.gap.observations.case import Case, classes_met
from sassgis.grid import BoolArray, FloatArray, IntArray
from sassgis.settings.ground import GroundTable, with_values
from sassgis.settings.schema import highest
from sassgis.settings.settings import EngineSettings

#: Answers besides the families.
NONE, UNKNOWN, CONTACT_LAW = "none", "unknown", "contact_law"


@dataclass(frozen=True, slots=True)
class Draw:
    """One set of parameters of a hypothesis."""

    form: str  # functional form
    model: HypothesisModel
    parameters: Mapping[str, float]  # calibrated ones by name, as they are reported
    parameter_draws: Mapping[str, float]  # to make the same draw again, or one near it


def draw(case: Case, families: tuple[str, ...], parameter_draws: ParameterDraws) -> Draw:
    """Return the base model, its ground calibrated anew, with effects (also the contact law)."""
    table, ground = _calibrated(case, parameter_draws)
    engine = _engine_keys(case, parameter_draws)
    error: dict[str, float] = {}
    turning = {}
    if case.learned is not None:
        error |= {"spin_scale": case.learned.spin_scale, "spin_noise": case.learned.spin_noise}
    if np.isfinite(case.observations.passages.rotation_hz).any():
        scale = parameter_draws.log("rotation_factor", *ROTATION_FACTORS)
        noise = parameter_draws.log("rotation_noise", *ROTATION_NOISES)
        turning = {"rotation_factor": scale, "rotation_noise": noise}
        error |= {"rotation_scale": scale, "rotation_noise": noise}
    model = HypothesisModel(
        table,
        moving_effects(case),
        measurement=MeasurementError(**error),
        **engine,  # type: ignore[arg-type]
    )
    parameters = {**ground, **engine, **turning}
    forms = []
    for family in sorted(families):
        part = CAUSES[family].draw(case, parameter_draws)
        forms.append(part.form)
        model = part.change(model)
        parameters.update(part.parameters)
    # A law of the contact shifts what was calibrated.
    for label in ground:
        name, _, key = label.rpartition(".")
        parameters[label] = getattr(model.table.classes[table.index(name)], key)
    form = " + ".join(forms) or "calibrated ground"
    return Draw(form, model, parameters, dict(parameter_draws.used))


def _engine_keys(case: Case, parameter_draws: ParameterDraws) -> dict[str, float]:
    """List the free keys of ``[engine]`` as configured, no higher than they may be."""
    drawn = {}
    if case.terrain is not None:
        for key in ("side_tilt_deg", "drift_deg"):
            middle = max(float(getattr(case.engine, key)), 1.0)
            drawn[key] = parameter_draws.log(key, *(factor * middle for factor in SIDEWAYS_FACTORS))
    if rolling := case.engine.resolved().rolling_friction_sd:
        key = "rolling_friction_sd"
        drawn[key] = parameter_draws.uniform(key, 0.0, 2.0 * rolling)
    return {key: min(value, highest(EngineSettings, key)) for key, value in drawn.items()}


def _calibrated(
    case: Case, parameter_draws: ParameterDraws
) -> tuple[GroundTable, dict[str, float]]:
    """Return ground classes with shifted parameters; classes that no rock meets stay."""
    met = case.met or classes_met(case)
    names = [name for name in fitted_names(None, [case.engine]) if name in GROUND_WIDTHS]
    values = {}
    for ground in case.table.classes:
        for name in names if ground.name in met else ():
            width = GROUND_WIDTHS[name] * case.ground_range
            low, high = GROUND_BOUNDS[name]
            shift = parameter_draws.uniform(f"{ground.name}.{name}", -width, width)
            shifted = float(getattr(ground, name)) + shift
            values[ground.name, name] = rounded(min(max(shifted, low), high))
    return with_values(case.table, values), {".".join(key): v for key, v in values.items()}


def families_to_try(case: Case) -> tuple[str, ...]:
    """Return families that are not switched on in the configuration already."""
    on = set(case.effects.names)
    return tuple(name for name in FAMILIES if name not in on)


def families_of(effect: str) -> tuple[str, ...]:
    """Return families of a hypothesis; none for calibrated ground only."""
    return () if effect == NONE else tuple(effect.split("+"))


@dataclass(frozen=True, slots=True)
class Space:
    """Parameters of a hypothesis."""

    effect: str  # "none", or families joined by "+"
    labels: tuple[str, ...]  # those that change something gradually
    choices: Mapping[str, float]  # shares that choose between forms, or are known: they stay
    of_ground: BoolArray  # shape (d,); parameters that belong to a ground class

    def start(self, shares: Mapping[str, float]) -> FloatArray:
        """Return the standard normal parameters from shares; those without one in the middle."""
        found: FloatArray = ndtri(np.array([shares.get(name, 0.5) for name in self.labels]))
        return np.clip(found, -2.0, 2.0)

    def shares(self, at: FloatArray) -> dict[str, float]:
        """Return all shares of standard normal parameters."""
        own = np.clip(ndtr(at), 0.0, 1.0 - 1e-9).tolist()
        return {**self.choices, **dict(zip(self.labels, own, strict=True))}


def space_of(
    case: Case, effect: str, shares: Mapping[str, float], held: Mapping[str, float]
) -> Space:
    """List a hypothesis's parameters, with the choices of some shares, and those that are held."""
    rng = np.random.default_rng(0)
    names: dict[str, bool] = {}
    for _ in range(NAMING_DRAWS):
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


def draw_of(case: Case, effect: str, shares: Mapping[str, float]) -> Draw:
    """Return draw of a hypothesis that some shares of its parameters make; others in the middle."""
    return draw(case, families_of(effect), ParameterDraws(None, shares))


def see(summary: SiteSummary, task: HypothesisDraw) -> Seen:
    """Return numbers of a draw, and the distance of its campaigns from the observed rocks."""
    problem = summary.problem
    numbers, rows = summary.of_model(
        draw_of(problem.case, task.effect, task.shares).model, task.number, task.count
    )
    distance = np.nan
    if problem.scale.names:
        distance = RockDistances.of(problem.rows, rows).value()
    return Seen(numbers, distance)


@dataclass(frozen=True, slots=True)
class Chosen:
    """A chosen model with its campaigns."""

    draw: Draw
    rows: FloatArray  # shape (FRESH, n_rocks, 2 k)
    scores: FloatArray  # shape (n_rocks,)


def run_chosen(summary: SiteSummary, task: HypothesisDraw) -> Chosen:
    """Return campaigns of a model that was chosen, and the scores of the rocks in it."""
    problem = summary.problem
    made = draw_of(problem.case, task.effect, task.shares)
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
        """Return replicas of each rock by the model that it has no weight in, as rows."""
        own = [self.models[k].rows[:, rock] for rock, k in enumerate(part.tolist())]
        return np.stack(own, axis=1)

    def held_out_scores(self, part: IntArray) -> FloatArray:
        """Return the score of each rock by the model that it has no weight in."""
        return np.array([self.models[k].scores[rock] for rock, k in enumerate(part.tolist())])

    def samples(self, case: Case, most: int) -> list[Draw]:
        """Return draws of the posterior; the one that is handed over where there is none."""
        if self.found is None:
            return [self.handed_over.draw]
        rng = np.random.default_rng([most, 43])
        drawn = rng.multivariate_normal(self.found.best, self.found.covariance, size=most)
        return [draw_of(case, self.effect, self.space.shares(at)) for at in drawn]

    def intervals(self, case: Case) -> Mapping[str, Range]:
        """Return 95 % intervals of the reported parameters; they include recommended values."""
        chosen = self.handed_over.draw.parameters
        found = [chosen, *(one.parameters for one in self.samples(case, PARAMETER_SAMPLES))]
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
RunTasks = Callable[[Callable[[SiteSummary, Any], Any], Sequence[Any]], Iterable[Any]]


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
    tasks = [HypothesisDraw(effect, space.shares(one), CHOSEN_NUMBER, CHOSEN_COUNT) for one in at]
    return FittedHypothesis(space, found, tuple(run(run_chosen, tasks)))


def _keeping_configured(
    space: Space, found: LinearFit, trials: Callable[[Sequence[Trial]], list[Seen]]
) -> FloatArray:
    """Find the best parameters with the ground as configured where the rocks ask for no more."""
    back = found.given(space.of_ground & ~found.asked)
    distances = [
        seen.distance for seen in trials([Trial(0, at, LOOK_COUNT) for at in (found.best, back)])
    ]
    # Below zero is chance.
    enough = AS_GOOD_FACTOR * max(distances[0], 0.0) + AS_GOOD_MORE
    return back if distances[1] <= enough else found.best


def gain_of(
    base: FloatArray, effect: FloatArray, group: IntArray, rng: np.random.Generator
) -> Interval:
    """Return mean gain of score over rocks, with its bootstrap interval over groups of rocks."""
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


class HypothesisFits:
    """Hypotheses that are calibrated when they are asked for.

    Another law of the contact begins where calibrated ground has ended, and a cause where its base
    has: a model with more parameters is not worse for want of draws.
    """

    def __init__(self, summary: SiteSummary, run: RunTasks, draws: int) -> None:
        self.summary, self.run = summary, run
        self.fits: dict[str, FittedHypothesis] = {}
        self._budget = FitBudget(FIT_ROUNDS, draws, DRAW_COUNT, LOOK_COUNT)

    @property
    def problem(self) -> SiteData:
        """The site."""
        return self.summary.problem

    def add(
        self,
        effect: str,
        start: Mapping[str, float] | None = None,
        held: Mapping[str, float] | None = None,
    ) -> FittedHypothesis:
        """Calibrate a hypothesis that is not calibrated yet; others as for fit_hypothesis."""
        if effect not in self.fits:
            if start is None:
                start = self.add(NONE).shares if effect == CONTACT_LAW else {}
            self.fits[effect] = fit_hypothesis(
                self.summary, effect, self.run, self._budget, start, held or {}
            )
        return self.fits[effect]

    def rows(self, effect: str) -> FloatArray:
        """Return rows of every rock by the model it had no weight in."""
        return self.fits[effect].held_out_rows(self.problem.part)

    def scores(self, effect: str) -> FloatArray:
        """Return scores of every rock by the model it had no weight in."""
        return self.fits[effect].held_out_scores(self.problem.part)

    def model(self, effect: str) -> Draw:
        """Return the draw that is handed over."""
        return self.fits[effect].handed_over.draw
