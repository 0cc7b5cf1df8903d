"""Soft ground as a cause: rebound lost with the normal speed, on only one ground."""

from __future__ import annotations

import numpy as np

from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.gap.causes.cause import (
    HARD,
    Cause,
    CausePart,
    Fit,
    ParameterDraws,
    Range,
    Scores,
    Trace,
    Unseen,
    contact_gaps,
    on_its_classes,
    over_scatter,
    part_of,
    reach_gaps,
    sizes,
    soft_first,
)
from sassgis.gap.constants import FINGERPRINT_ROCKS
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.gap.residuals.rock_residuals import mean_of_draws, per_rock, t_statistics

FIT = Fit(
    ranges={
        "reference_speed_mps": Range(0.4, 12.0, "log"),
        "depth_scale": Range(1.0, 80.0, "log"),
        "drag_coefficient": Range(0.5, 6.0, "log"),
        "friction": Range(0.05, 0.6),
    },
    forms={"velocity_scaled": 1.0, "scar": 1.0, "slip": 1.0},
    parameters={
        "velocity_scaled": ("reference_speed_mps",),
        "scar": ("depth_scale", "drag_coefficient"),
        "slip": ("friction",),
    },
)


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    form, values = FIT.drawn("soft_ground", draws)
    softest = soft_first(case)
    soft = softest[: 1 + int(draws.share("soft_classes") * len(softest))]
    return part_of(SoftGround, form, values, classes=tuple(soft))


def _on_one_ground(case: Case, residuals: ResidualTable) -> Scores:
    """Return the yielding ground on which the loss is surest."""
    rows, z = contact_gaps(residuals, "normal_speed_mps")
    lost = []
    for k in np.unique(rows.ground).tolist():
        on = rows.ground == k
        if k < 0 or case.table.names[k] in HARD or on.sum() < 3 * FINGERPRINT_ROCKS or on.all():
            continue
        fast = np.log(np.maximum(rows.vn_mps, 0.2))
        score = -(z - float(np.mean(z[~on]))) * np.exp(fast - fast[on].mean())
        own = np.where(on, rows.rock, -1)
        values = per_rock(np.where(on, score, np.nan), own, case.n_rocks) - 0.3
        lost.append(Scores(values, float(score[on].mean())))
    if not lost:
        raise Unseen
    return max(lost, key=lambda one: float(np.nan_to_num(t_statistics(one.values)[0])))


def _large_stop_early(case: Case, residuals: ResidualTable) -> Scores:
    foot = reach_gaps(residuals, "runout_m")
    late = mean_of_draws(over_scatter(foot, 1.0), least=1)
    late = (late - np.nanmean(late)) * sizes(residuals)
    return Scores(-late, float(-np.nanmean(late)))


CAUSE = Cause(
    "soft_ground",
    number=2,
    group="contact",
    phase="impact",
    draw=_draw,
    shown_by="lost rebound on one yielding ground alone; large rocks that stop early at the foot",
    statistics=(
        Trace(
            "rebound lost with the normal speed, on one ground alone", _on_one_ground, ("impacts",)
        ),
        Trace(
            "large rocks stop early at the foot",
            _large_stop_early,
            ("passages", "stations", "deposits"),
        ),
    ),
    place=on_its_classes("soft_ground"),
)
