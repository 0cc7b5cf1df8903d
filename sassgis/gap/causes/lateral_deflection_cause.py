"""Lateral deflection as a cause: turns at impacts, and offsets that grow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.roughness import Roughness
from sassgis.gap.causes.cause import (
    Cause,
    CausePart,
    Fit,
    ParameterDraws,
    Range,
    Scores,
    Trace,
    Unseen,
    base_size,
    known_mean,
    rounded,
    station_offsets,
    usual_offset,
)
from sassgis.gap.constants import (
    EDGES_GROWTH,
    EDGES_TURN_DEG,
    FINGERPRINT_ROCKS,
    MISSTATED_SHARE,
    STRAIGHT_GROWTH,
)
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.gap.residuals.rock_residuals import mean_of_draws, per_rock

FIT = Fit(
    ranges={
        "angle_deg": Range(1.0, 35.0, "log"),
        "hop_m": Range(4.0, 15.0, "log"),
        "width_percent": Range(3.0, 60.0, "log"),
    },
    forms={"kicks": 0.65, "constant": 0.35},
    parameters={"kicks": ("angle_deg", "hop_m"), "constant": ("width_percent",)},
)


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    form, values = FIT.drawn("lateral_deflection", draws)
    uneven_deg = values.get("angle_deg") or draws.log("lateral.kicks", 0.3, 6.0)
    # Ground that deflects rocks laterally is not even along their path either.
    lean = math.tan(math.radians(min(uneven_deg, 25.0) * draws.uniform("lateral.lean", 0, 0.6)))
    bumps = Roughness(obstacle_m=rounded(min(float(np.median(case.radius_m)) * lean, 1.0)))

    def change(model: HypothesisModel) -> HypothesisModel:
        if case.terrain is None:
            return model
        deflection = LateralDeflection(form, **values)  # type: ignore[arg-type]
        changed = replace(model, effects=model.effects.having(deflection))
        if model.effects.get(Roughness) is None and draws.share("lateral.uneven") < 0.6:
            changed = replace(changed, effects=changed.effects.having(bumps))
        return changed

    return CausePart(form, change, values)


def _turn(case: Case, residuals: ResidualTable) -> Scores:
    rows = residuals.steps.of("impact", "turn_deg")
    if len(rows) < FINGERPRINT_ROCKS:
        raise Unseen
    size = np.abs(rows.observed - rows.predicted)
    usual = (1.0 + MISSTATED_SHARE) * rows.sd * math.sqrt(2.0 / math.pi) + 0.5
    usual = usual + np.maximum(residuals.configured_paths.turn_after(rows.out_mps), EDGES_TURN_DEG)
    return Scores(per_rock(size - usual, rows.rock, case.n_rocks), float(size.mean()))


def _growth(case: Case, residuals: ResidualTable) -> Scores:
    """Score the growth below the first station beyond the simulated one and that of edges."""
    at = station_offsets(case, residuals, least=1)
    stops = residuals.steps.of("stop", "lateral_m")
    end = np.full((2, case.n_rocks), np.nan)
    end[:, stops.rock] = stops.observed, stops.way_m
    if at.shape[1] < 2 and not len(stops):
        raise Unseen
    growth = np.abs(np.column_stack([at[:, 1:], end[0]]) - at[:, :1])
    run = residuals.configured_paths
    below = np.concatenate([run.at.lateral_m[:, :, 1:], run.ends.lateral_m[:, :, None]], axis=2)
    # A replicate that stopped above a station is at neither.
    made = below - run.at.lateral_m[:, :, :1]
    usual = np.column_stack([base_size(made[:, :, k]) for k in range(made.shape[2])])
    way = np.column_stack([case.station_s[:, 1:], end[1]]) - case.station_s[:, :1]
    if case.terrain is None:
        usual = usual + STRAIGHT_GROWTH * way
    usual = np.maximum(usual, EDGES_GROWTH * way) + usual_offset(case)
    return Scores(mean_of_draws(growth - usual, least=1), known_mean(growth))


CAUSE = Cause(
    "lateral_deflection",
    number=0,
    group="sideways",
    phase="impact",
    draw=_draw,
    statistics=(
        Trace("turn of the heading at impacts", _turn, ("impacts",), clear=True),
        Trace(
            "growth of the lateral offset below the first station",
            _growth,
            ("passages", "stations"),
            clear=True,
        ),
    ),
)
