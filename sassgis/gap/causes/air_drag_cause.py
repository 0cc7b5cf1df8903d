"""Air drag as a cause: energy lost on every free flight, in proportion to path over size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.gap.causes.cause import (
    CLEAR,
    LEAST,
    Cause,
    CausePart,
    Scores,
    Trace,
    Unseen,
    part_of,
)
from sassgis.gap.causes.flight_losses import loss_of_flights
from sassgis.gap.causes.parameter_draws import Fit, ParameterDraws, Range
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residuals import per_rock
from sassgis.gap.residuals.table import ResidualTable

FIT = Fit({"drag_coefficient": Range(0.3, 2.0, "log")}, {"constant": 1.0, "sphericity": 1.0})
#: Density of air (kg/m³), and the drag coefficient beyond which it is not air that brakes a rock.
_AIR_KGM3, MOST_DRAG = 1.2, 2.0
#: Errors of the comparison itself, as a drag coefficient: what is more than that can be seen.
_LEAST_DRAG = 0.8
#: A flight that kept its length to this share was free of anything but air.
_FREE = 0.15


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    part = part_of(AirDrag, *FIT.drawn("air_drag", draws))
    density = {"air_density_kgm3": AirDrag().air_density_kgm3}
    return replace(part, parameters={**part.parameters, **density})


def _on_every_flight(case: Case, residuals: ResidualTable) -> Scores:
    rows, loss, usual = loss_of_flights(residuals.steps.of("flight", "energy_jpkg"))
    mean = 0.5 * (rows.observed + rows.predicted)
    # 3 ρ C v² L/(8 ρ_s r) per unit mass, for C = 1.
    pull = 0.75 * _AIR_KGM3 / (2700.0 * rows.radius_m) * mean * rows.way_m
    free = np.abs(rows.reach - 1.0) < _FREE
    kept = free & (np.abs(usual - np.median(usual[free] if free.any() else usual)) < 2.5)
    weight = pull / rows.sd**2
    scale = max(float((weight * pull)[kept].sum()), 1e-12)
    drag = float((weight * loss)[kept].sum()) / scale
    if kept.sum() < 2 * LEAST or drag > MOST_DRAG:
        raise Unseen
    left = weight * (loss - _LEAST_DRAG * pull)
    own = np.where(kept, rows.rock, -1)
    return Scores(per_rock(np.where(kept, left, np.nan), own, case.n_rocks), drag)


CAUSE = Cause(
    "air_drag",
    number=5,
    group="along the way",
    phase="flight",
    draw=_draw,
    shown_by="energy lost on every free flight, in proportion to path over size; C_d between 0.8 "
    "and 2: less is within the errors of the comparison, more is not air",
    statistics=(
        Trace(
            "energy lost in flight, over path and size, on every flight",
            _on_every_flight,
            ("impacts",),
            CLEAR,
        ),
    ),
)
