"""Roughness as a cause: it tilts the contact in both directions, the more the smaller the rock."""

from __future__ import annotations

import numpy as np

from sassgis.engine.effects.roughness import Roughness
from sassgis.gap.causes.cause import (
    Cause,
    CausePart,
    Fit,
    ParameterDraws,
    Range,
    Scores,
    Trace,
    beyond_any_law,
    contact_gaps,
    late_by_rock,
    loose_classes,
    on_its_classes,
    over_scatter,
    part_of,
    reach_gaps,
    sizes,
    standardised,
)
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.gap.residuals.rock_residuals import per_rock

FIT = Fit(
    ranges={"obstacle_m": Range(0.05, 1.5, "log"), "wavelength_m": Range(0.8, 6.0, "log")},
    forms={"uniform": 1.0, "wave": 1.0},
    parameters={"uniform": ("obstacle_m",)},
)


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    form, values = FIT.drawn("roughness", draws)
    classes = loose_classes(case, draws) if draws.share("rough.classes") < 0.6 else ()
    return part_of(Roughness, form, values, classes=classes)


def _scatter_of_small(case: Case, residuals: ResidualTable) -> Scores:
    rows, z = contact_gaps(residuals, "normal_speed_mps")
    left = beyond_any_law(rows, z)
    small = -standardised(np.log(rows.radius_m))
    scores = per_rock((left**2 - np.mean(left**2)) * small, rows.rock, case.n_rocks)
    return Scores(scores, float(np.mean(left**2 * small)))


def _small_slow(case: Case, residuals: ResidualTable) -> Scores:
    speed = reach_gaps(residuals, "speed_mps")
    slow = late_by_rock(over_scatter(speed, 0.05)) * sizes(residuals)
    return Scores(slow, float(np.nanmean(slow)))


CAUSE = Cause(
    "roughness",
    number=6,
    group="contact",
    phase="impact",
    draw=_draw,
    statistics=(
        Trace(
            "scatter of the rebound, the more the smaller the rock", _scatter_of_small, ("impacts",)
        ),
        Trace("small rocks slow on all reaches", _small_slow, ("passages", "stations")),
    ),
    place=on_its_classes("roughness"),
)
