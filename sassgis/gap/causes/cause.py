"""A cause of a gap in the diagnosis: its fitted parameters and its fingerprints.

Besides, what the causes share: where parameters are drawn from, ground classes on which an effect
may act, and residuals at contacts, on flights and reaches, and to the side.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.special import ndtri

from sassgis.engine.effects.registry import EFFECTS
from sassgis.gap.constants import FINGERPRINT_ROCKS, MEDIAN_OF_NORMAL, MISSTATED_SHARE
from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import ResidualTable, StepTable
from sassgis.gap.residuals.rock_residuals import mean_of_draws
from sassgis.gap.residuals.stop_residuals import side_error
from sassgis.grid import FloatArray
from sassgis.settings.blocks import EffectSection


def rounded(value: float) -> float:
    """Round to the digits that a configuration states: the model written is the one scored."""
    return float(f"{value:.6g}")


@dataclass(frozen=True, slots=True)
class Range:
    """Where a parameter may lie: between two limits, searched evenly or on a logarithmic scale."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"

    def share(self, value: float) -> float:
        """Return the share of the range at which a value lies; above 1 beyond it."""
        if self.scale == "log":
            return float(np.log(max(value, self.low) / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)


class ParameterDraws:
    """Where the parameters of a draw come from: a number in [0, 1) under each name.

    Names that are not among ``values``, those of an earlier draw, get one from ``rng``; without it
    they are in the middle.
    """

    def __init__(
        self, rng: np.random.Generator | None, values: Mapping[str, float] | None = None
    ) -> None:
        self._rng = rng
        self._given = values or {}
        self.used: dict[str, float] = {}
        #: Names under which something changes gradually; the others choose between forms.
        self.smooth: set[str] = set()

    def share(self, name: str) -> float:
        """Return a number from 0 to 1."""
        if name not in self.used:
            known = self._given.get(name)
            if known is None:
                known = 0.5 if self._rng is None else float(self._rng.random())
            self.used[name] = known
        return self.used[name]

    def _gradual(self, name: str) -> float:
        self.smooth.add(name)
        return self.share(name)

    def uniform(self, name: str, low: float, high: float) -> float:
        """Return a number between limits."""
        return rounded(low + (high - low) * self._gradual(name))

    def log(self, name: str, low: float, high: float) -> float:
        """Return a number between limits, evenly on a logarithmic scale."""
        return rounded(math.exp(math.log(low) + math.log(high / low) * self._gradual(name)))

    def normal(self, name: str, sd: float) -> float:
        """Return a number from a normal distribution about zero."""
        return rounded(sd * float(ndtri(min(max(self._gradual(name), 1e-6), 1.0 - 1e-6))))

    def within(self, name: str, limits: Range) -> float:
        """Return a number from a range."""
        draw = self.log if limits.scale == "log" else self.uniform
        return draw(name, limits.low, limits.high)

    def one_of(self, name: str, choices: Sequence[str], shares: Sequence[float]) -> str:
        """Draw one of some words."""
        edges = np.cumsum(shares) / sum(shares)
        return choices[min(int(np.searchsorted(edges, self.share(name), "right")), len(edges) - 1)]


@dataclass(frozen=True, slots=True)
class Fit:
    """Fit of an effect in the diagnosis."""

    ranges: Mapping[str, Range]  # of all forms; a parameter that is not named keeps its default
    #: How often each form is tried, relative to the others; empty if the effect has one law.
    forms: Mapping[str, float] = field(default_factory=dict)
    #: Parameters that a form draws, where it does not draw all of ``ranges``.
    parameters: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def drawn(self, name: str, draws: ParameterDraws) -> tuple[str, dict[str, float]]:
        """Draw a form ("" if there is only one law) and its parameters for the effect ``name``."""
        form = ""
        if self.forms:
            form = draws.one_of(f"{name}.form", tuple(self.forms), tuple(self.forms.values()))
        keys = self.parameters.get(form, tuple(self.ranges))
        return form, {key: draws.within(f"{name}.{key}", self.ranges[key]) for key in keys}


def usual_scatter(values: FloatArray) -> float:
    """Return the standard deviation of numbers, by only the middle half of them."""
    return float(np.median(np.abs(values - float(np.median(values))))) / MEDIAN_OF_NORMAL


@dataclass(frozen=True, slots=True)
class CausePart:
    """Part of a model set by one cause: its form, the change, and the parameters to report."""

    form: str
    change: Callable[[HypothesisModel], HypothesisModel]
    parameters: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Scores:
    """Numbers whose mean is zero where the cause is absent."""

    values: FloatArray  # shape (n_rocks,), or (1,): a z with a separate null
    size: float  # what was seen, in the unit of the statistic
    #: Of each rock to score above zero where the cause is absent; values then are 0 or 1.
    chance: FloatArray | None = None


Scoring = Callable[[Case, ResidualTable], Scores]
Placing = Callable[[Case, Sequence[HypothesisModel]], tuple[str, ...]]


class Unseen(Exception):
    """Error where what a fingerprint takes was not observed, or of too few rocks."""


@dataclass(frozen=True, slots=True)
class Trace:
    """One fingerprint of a cause."""

    name: str  # in words; results and frozen weights know it by these
    scores: Scoring  # raises Unseen where the observations cannot show it
    tables: tuple[str, ...]  # tables of observations that it takes, all of them
    #: Whether no contact can leave it: it is of masses, places or paths in time. Another law, edges
    #: of a rock or a patch of other ground leave the others as well.
    clear: bool = False


@dataclass(frozen=True, slots=True)
class Cause:
    """One row of the registry."""

    name: str  # that of the effect of the engine, if it is one
    number: int  # its random draws hang on it: a new cause takes the next one that is free
    group: str  # of causes that leave similar traces
    #: Of the observed motion in which it shows.
    phase: Literal["release", "flight", "impact", "observation"]
    draw: Callable[[Case, ParameterDraws], CausePart]  # form and parameters that are tried
    statistics: tuple[Trace, ...]  # its fingerprints
    #: Its name in a sentence, and what it does, to follow "the gap is best explained by"; empty:
    #: those of the effect of the engine.
    label: str = ""
    summary: str = ""
    #: Whether it is weighed against the other causes; the law of the contact is that of the base.
    weighed: bool = True
    #: Whether it closes some of the distance between observed and simulated rocks where it acts.
    #: Masses of fragments and instruments that contradict each other show it without.
    closes: bool = True
    #: Reaches in which fitted models have it act: the whole slope, if it says nothing else.
    place: Placing = lambda case, _: case.reaches
    #: Shares of its parameters that fingerprints measure, by statistic: they stay so.
    measured: Callable[[Mapping[str, Fingerprint]], Mapping[str, float]] = lambda _: {}

    @property
    def of_data(self) -> bool:
        """Whether it is an error of what was observed, and no part of the motion."""
        return self.phase in ("release", "observation")

    @property
    def words(self) -> tuple[str, str]:
        """Its name and its effect, for sentences."""
        if self.label:
            return self.label, self.summary
        return EFFECTS[self.name].label, EFFECTS[self.name].summary


def part_of(
    settings: type[EffectSection], form: str, values: Mapping[str, float], **others: object
) -> CausePart:
    """Return an effect with drawn values and others that are not reported."""
    effect = settings(**({"form": form} if form else {}), **others, **values)

    def change(model: HypothesisModel) -> HypothesisModel:
        return replace(model, effects=model.effects.having(effect))

    return CausePart(form or settings.name, change, values)


def fitted_alone(
    settings: type[EffectSection], fit: Fit
) -> Callable[[Case, ParameterDraws], CausePart]:
    """Return draws of an effect within its ranges only."""

    def draw(case: Case, draws: ParameterDraws) -> CausePart:
        return part_of(settings, *fit.drawn(settings.name, draws))

    return draw


#: Ground on which nothing yields and no block lies loose.
HARD = ("rock", "asphalt")


def _yielding(case: Case) -> list[str]:
    """Return classes that profiles cross, but for hard ones if there are others."""
    present = [case.table.classes[k].name for k in np.unique(case.profiles.ground).tolist()]
    return [name for name in present if name not in HARD] or present


def soft_first(case: Case) -> list[str]:
    """Return classes that are not hard, the softest first."""
    return sorted(
        _yielding(case), key=lambda name: case.table.classes[case.table.index(name)].eta_max
    )


def loose_classes(case: Case, draws: ParameterDraws) -> tuple[str, ...]:
    """Return classes with loose blocks."""
    loose = _yielding(case)
    # Meadows are commonly free of stones.
    if len(loose) > 1 and draws.share("loose_classes") < 0.6:
        loose = soft_first(case)[1:]
    return tuple(loose)


def on_its_classes(effect: str) -> Placing:
    """Return reaches with the classes that most fitted models have an effect on; else all."""

    def place(case: Case, models: Sequence[HypothesisModel]) -> tuple[str, ...]:
        effects = [model.effects.named(effect) for model in models]
        counts = Counter(name for own in effects for name in getattr(own, "classes", ()))
        classes = [name for name, n in counts.items() if 2 * n > len(models)]
        return reaches_on(case, classes) if classes else case.reaches

    return place


def reaches_between(case: Case, low: float, high: float) -> tuple[str, ...]:
    """Return reaches that a stretch of chainage touches (m)."""
    # Medians over the rocks.
    inner = np.nanmedian(case.station_s, axis=0).tolist() if case.station_names else []
    edges = [-np.inf, *inner, np.inf]
    return tuple(
        name
        for name, start, end in zip(case.reaches, edges[:-1], edges[1:], strict=True)
        if low < end and high > start
    )


def reaches_on(case: Case, classes: Sequence[str]) -> tuple[str, ...]:
    """Return reaches in which the profiles cross any of some ground classes."""
    wanted = [k for k, name in enumerate(case.table.names) if name in classes]
    found: set[str] = set()
    source = case.profiles
    for line in np.unique(case.line).tolist():
        own = slice(int(source.offset[line]), int(source.offset[line + 1]) - 1)
        ends = itertools.pairwise(source.s[own.start : own.stop + 1].tolist())
        for (low, high), ground in zip(ends, source.ground[own].tolist(), strict=True):
            if ground in wanted and high > 0.0:
                found.update(reaches_between(case, low, high))
    return tuple(name for name in case.reaches if name in found)


def contact_gaps(residuals: ResidualTable, quantity: str) -> tuple[StepTable, FloatArray]:
    """Return impacts and their z; Unseen where there are few, or few with a normal speed."""
    steps = residuals.steps
    rows = steps.of("impact", quantity)
    if min(len(rows), len(steps.of("impact", "normal_speed_mps"))) < 4 * FINGERPRINT_ROCKS:
        raise Unseen
    return rows, np.clip(rows.z, -4.0, 4.0)


def beyond_any_law(rows: StepTable, z: FloatArray) -> FloatArray:
    """Return z less a smooth function of speed and ground: what no law of the contact could do."""
    grounds = [(rows.ground == k).astype(np.float64) for k in np.unique(rows.ground).tolist()[1:]]
    speed = np.log(np.maximum(rows.vn_mps, 0.2))
    design = np.column_stack([np.ones(len(rows)), speed, rows.predicted / 10.0, *grounds])
    ridge = np.eye(design.shape[1])
    return np.asarray(z - design @ np.linalg.solve(design.T @ design + ridge, design.T @ z))


def loss_of_flights(rows: StepTable) -> tuple[StepTable, FloatArray, FloatArray]:
    """Return flights, what they lost (J/kg), and that in standard deviations; Unseen if few."""
    if len(rows) < 2 * FINGERPRINT_ROCKS:
        raise Unseen
    loss = rows.predicted - rows.observed
    return rows, loss, loss / rows.sd


def gaps_by_reach(residuals: ResidualTable, quantity: str) -> dict[str, FloatArray]:
    """Return gaps of a quantity by the name of the reach, (n_rocks,) each; Unseen without any.

    Those of the speed are relative to the prediction, so that fast reaches do not outweigh
    others.
    """
    found = {}
    for row in residuals.rows:
        if row.test == "reach" and row.phase != "release" and row.quantity == quantity:
            gap = row.gap
            if quantity == "speed_mps":
                with np.errstate(invalid="ignore", divide="ignore"):
                    gap = np.clip(gap / row.predicted, -2.0, 2.0)
            if np.isfinite(gap).sum() >= FINGERPRINT_ROCKS:
                found[row.place] = gap
    if not found:
        raise Unseen
    return found


def reach_gaps(residuals: ResidualTable, quantity: str) -> FloatArray:
    """Return the same, shape (n_rocks, n_reaches)."""
    return np.column_stack([*gaps_by_reach(residuals, quantity).values()])


def over_scatter(gaps: FloatArray, least: float) -> FloatArray:
    """Divide gaps of reaches by the scatter of the rocks there, or by ``least`` if that is more."""
    return np.asarray(gaps / np.maximum(np.nanstd(gaps, axis=0), least))


def wrong_on_one(residuals: ResidualTable, sign: float = 0.0) -> dict[str, FloatArray]:
    """Measure how wrong the speed is on each single reach, in scatters, shape (n_rocks,) each.

    Its gap less that on the others, as far as this exceeds what the others are off themselves:
    where all reaches are wrong no single one is. ``sign``: of the gap that is looked for; 0: that
    of the reach.
    """
    speed = gaps_by_reach(residuals, "speed_mps")
    if len(speed) < 2:
        raise Unseen
    own = over_scatter(np.column_stack([*speed.values()]), 0.05)
    found = {}
    for k, place in enumerate(speed):
        others = mean_of_draws(np.delete(own, k, axis=1), least=1)
        towards = sign or float(np.sign(np.nanmean(own[:, k])))
        found[place] = towards * (own[:, k] - others) - abs(float(np.nanmean(others)))
    return found


def late_by_rock(gaps: FloatArray) -> FloatArray:
    """Return the mean over reaches of gaps less that of all rocks, shape (n_rocks,)."""
    return mean_of_draws(gaps - np.nanmean(gaps, axis=0), least=1)


def standardised(values: FloatArray) -> FloatArray:
    """Return less their mean, over their scatter; zero without any."""
    spread = float(np.nanstd(values))
    return (values - np.nanmean(values)) / spread if spread > 0.0 else 0.0 * values


def sizes(residuals: ResidualTable) -> FloatArray:
    """Return sizes of the rocks, standardised, shape (n_rocks,)."""
    return standardised(np.log(residuals.run.radius_m))


def station_offsets(case: Case, residuals: ResidualTable, least: int = 2) -> FloatArray:
    """Return lateral offsets at stations (m), shape (n_rocks, n_stations), ``least`` or more."""
    if len(case.station_names) < least:
        raise Unseen
    rows = residuals.steps.of("run", "lateral_m")
    at = np.full((case.n_rocks, len(case.station_names)), np.nan)
    at[rows.rock, rows.station] = rows.observed
    return at


def usual_offset(case: Case) -> float:
    """Return the mean size of offsets (m) that errors make, were they larger than stated."""
    error = max(side_error(case), side_error(case, stop=True))
    return math.sqrt(2.0 / math.pi) * (1.0 + MISSTATED_SHARE) * error


def base_size(draws: FloatArray) -> FloatArray:
    """Return mean size of what the base makes, shape (n_rocks,); 0 in the plane of a fall line."""
    return np.nan_to_num(mean_of_draws(np.abs(draws), least=1))


def known_mean(values: FloatArray) -> float:
    """Return the mean of the known values; NaN without any."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan
