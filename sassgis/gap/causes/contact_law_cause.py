"""Another law of the contact: the same shift for all sizes. It belongs to the base."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sassgis.gap.causes.cause import SHIFT, Cause, CausePart, Scores, Scoring, Trace
from sassgis.gap.causes.contact_gaps import contact_gaps
from sassgis.gap.causes.parameter_draws import ParameterDraws, rounded
from sassgis.gap.causes.reach_gaps import over_scatter, reach_gaps, speed_gaps
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import HypothesisModel
from sassgis.gap.residuals.residuals import mean_of_draws, per_rock
from sassgis.gap.residuals.table import ResidualTable
from sassgis.model.ground import GroundTable

#: Those that any ground has shown (``calibration.parameters.RANGES``).
_BOUNDS = {"eta_max": (0.1, 1.0), "mu_f": (0.1, 1.5), "restitution": (0.0, 0.9)}


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    """Freedom of the contact beyond calibration: one shift for all classes, in wide ranges.

    Classes keep the differences between them. The restitution counts only where the engine reads
    it; from the highest speeds on it hardly falls with the normal speed.
    """
    shifts = {
        "eta_max": draws.uniform("law.eta_max", -0.5, 0.5),
        "mu_f": draws.uniform("law.mu_f", -0.5, 0.7),
    }
    speed = math.nan
    if case.engine.resolved().eta_max_rule == "restitution":
        shifts["restitution"] = draws.uniform("law.restitution", -0.5, 0.9)
        speed = draws.log("law.restitution_speed", 2.0, 200.0)
    used = set(np.unique(case.profiles.ground).tolist())

    def change(model: HypothesisModel) -> HypothesisModel:
        classes = []
        for k, ground in enumerate(model.table.classes):
            values = {
                name: rounded(min(max(float(getattr(ground, name)) + shift, low), high))
                for name, shift in shifts.items()
                for low, high in (_BOUNDS[name],)
            }
            if math.isfinite(speed):
                values["restitution_speed_mps"] = speed
            classes.append(replace(ground, **values) if k in used else ground)  # type: ignore[arg-type]
        return replace(model, table=GroundTable(tuple(classes)))

    values = {f"shift_of_{name}": shift for name, shift in shifts.items()}
    if math.isfinite(speed):
        values["restitution_speed_mps"] = speed
    return CausePart("shifted contact", change, values)


def _after_impacts(quantity: str) -> Scoring:
    def scores(case: Case, residuals: ResidualTable) -> Scores:
        rows, z = contact_gaps(residuals, quantity)
        mean = float(z.mean())
        shifted = math.copysign(1.0, mean) * z - SHIFT
        return Scores(per_rock(shifted, rows.rock, case.n_rocks), mean)

    return scores


def _speed_on_reaches(case: Case, residuals: ResidualTable) -> Scores:
    speed = speed_gaps(residuals)
    mean, shift = mean_of_draws(over_scatter(speed, 0.05), least=1), float(np.nanmean(speed))
    return Scores(math.copysign(1.0, shift) * mean - SHIFT, shift)


def _height_on_reaches(case: Case, residuals: ResidualTable) -> Scores:
    height = reach_gaps(residuals, "height_m")
    own = over_scatter(height, 0.05)
    shift = float(np.nanmean(own))
    return Scores(math.copysign(1.0, shift) * mean_of_draws(own, least=1) - SHIFT, shift)


CAUSE = Cause(
    "contact_law",
    number=10,
    group="contact",
    phase="impact",
    label="another law of the contact",
    summary="another law of the contact: the same shift of rebound and slip for all sizes",
    weighed=False,
    draw=_draw,
    shown_by="the same shift of rebound, slip, spin, speed or height for all sizes",
    statistics=(
        *(
            Trace(f"shift of the {name} after impacts", _after_impacts(quantity), ("impacts",))
            for name, quantity in (
                ("normal speed", "normal_speed_mps"),
                ("tangential speed", "tangential_speed_mps"),
                ("spin", "spin_out_radps"),
            )
        ),
        Trace(
            "shift of the speed on reaches, for all sizes",
            _speed_on_reaches,
            ("passages", "stations"),
        ),
        Trace(
            "shift of the height on reaches, for all sizes",
            _height_on_reaches,
            ("passages", "stations"),
        ),
    ),
)
