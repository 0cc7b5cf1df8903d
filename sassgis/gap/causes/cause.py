"""A cause of a gap as the diagnosis knows it: what it fits, and what the cause leaves behind."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sassgis.engine.effects.registry import EFFECTS
from sassgis.gap.causes.parameter_draws import Fit, ParameterDraws
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import HypothesisModel
from sassgis.gap.residuals.table import ResidualTable
from sassgis.model.effects import EffectSection
from sassgis.model.grid import FloatArray

#: A fingerprint rests on at least this many rocks or groups.
LEAST = 5
#: Sureness of a gain from which a cause is seen by what it closes. Ten causes are tried at a site:
#: of those that are absent one of a hundred has this (docs/studies/gap_weights.md).
SHOWS = 5.0
#: z from which a fingerprint that no contact could leave is seen by itself.
PRINTED = 3.0
#: Stated errors of measurement may be wrong by this share of themselves.
MISSTATED = 0.5
#: Shift, in standard deviations, up to which a comparison may be off by itself.
SHIFT = 0.15
#: Median of the size of a standard normal number.
MEDIAN_OF_NORMAL = 0.6745


def usual_scatter(values: FloatArray) -> float:
    """Standard deviation of numbers, by the middle half of them alone."""
    return float(np.median(np.abs(values - float(np.median(values))))) / MEDIAN_OF_NORMAL


@dataclass(frozen=True, slots=True)
class CausePart:
    """What one cause sets of a model: its form, the change, and the parameters to report."""

    form: str
    change: Callable[[HypothesisModel], HypothesisModel]
    parameters: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Scores:
    """Numbers whose mean is zero where the cause is absent."""

    values: FloatArray  # shape (n_rocks,), or (1,): a z that has its own null
    size: float  # what was seen, in the unit of the statistic
    #: Of each rock to score above zero where the cause is absent; values then are 0 or 1.
    chance: FloatArray | None = None


Scoring = Callable[[Case, ResidualTable], Scores]
Placing = Callable[[Case, Sequence[HypothesisModel]], tuple[str, ...]]


class Unseen(Exception):
    """What a fingerprint takes was not observed, or of too few rocks."""


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
    shown_by: str  # its fingerprints in a sentence, for docs/gap.md
    statistics: tuple[Trace, ...]  # its fingerprints
    #: Its name in a sentence, and what it does, to follow "the gap is best explained by"; empty:
    #: those of the effect of the engine.
    label: str = ""
    summary: str = ""
    #: Whether it is weighed against the other causes; the law of the contact is that of the base.
    weighed: bool = True
    #: Whether it closes some of the distance between observed and simulated rocks where it acts.
    #: Masses of pieces and instruments that contradict each other show it without.
    closes: bool = True
    #: Reaches in which fitted models have it act: the whole slope, if it says nothing else.
    place: Placing = lambda case, _: case.reaches
    #: Shares of its parameters that fingerprints measure, z by statistic and value: they stay so.
    measured: Callable[[Mapping[str, tuple[float, float]]], Mapping[str, float]] = lambda _: {}

    @property
    def of_data(self) -> bool:
        """Whether it is an error of what was observed, and no part of the motion."""
        return self.phase in ("release", "observation")

    @property
    def words(self) -> tuple[str, str]:
        """Its name in a sentence, and what it does."""
        if self.label:
            return self.label, self.summary
        return EFFECTS[self.name].label, EFFECTS[self.name].summary


def part_of(
    settings: type[EffectSection], form: str, values: Mapping[str, float], **others: object
) -> CausePart:
    """An effect with drawn values and others that are not reported."""
    effect = settings(**({"form": form} if form else {}), **others, **values)

    def change(model: HypothesisModel) -> HypothesisModel:
        return replace(model, effects=model.effects.having(effect))

    return CausePart(form or settings.name, change, values)


def fitted_alone(
    settings: type[EffectSection], fit: Fit
) -> Callable[[Case, ParameterDraws], CausePart]:
    """Draws of an effect of which nothing but the ranges is to be said."""

    def draw(case: Case, draws: ParameterDraws) -> CausePart:
        return part_of(settings, *fit.drawn(settings.name, draws))

    return draw
