"""Air drag as a cause: speed lost on every free flight, in proportion to path over size."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.gap.causes.cause import (
    Cause,
    CausePart,
    Fit,
    ParameterDraws,
    Range,
    Scores,
    Trace,
    Unseen,
    loss_of_flights,
    part_of,
)
from sassgis.gap.constants import (
    AIR_KGM3,
    CONTACT_LASTS_S,
    DENSITY_KGM3,
    DRAG_ASIDE,
    FINGERPRINT_ROCKS,
    FREE_FLIGHT_SHARE,
    LEAST_DRAG,
    LEAST_DRAG_IN_TIME,
    MISSTATED_SHARE,
    MOST_DRAG,
    PRINTED_Z,
)
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import ResidualTable, StepTable
from sassgis.gap.residuals.rock_residuals import per_rock
from sassgis.grid import FloatArray

FIT = Fit({"drag_coefficient": Range(0.3, 2.0, "log")}, {"constant": 1.0, "sphericity": 1.0})


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    part = part_of(AirDrag, *FIT.drawn("air_drag", draws))
    density = {"air_density_kgm3": AirDrag().air_density_kgm3}
    return replace(part, parameters={**part.parameters, **density})


def _pull(case: Case, rows: StepTable) -> FloatArray:
    """Return ρ A/(2 m) of the rock of each row: what air takes for C_d = 1 (1/m)."""
    mass = case.mass_kg[rows.rock]
    usual = 4.0 / 3.0 * np.pi * rows.radius_m**3 * DENSITY_KGM3
    pull = 0.5 * AIR_KGM3 * np.pi * rows.radius_m**2
    return np.asarray(pull / np.where(np.isfinite(mass), mass, usual))


def _against_the_motion(case: Case, residuals: ResidualTable) -> Scores:
    """Score level speed lost on flights in time: no scale or time base of a film makes it."""
    rows, lighter, across = (
        residuals.steps.of("air", f"{name}_mps2") for name in ("ahead", "lighter", "across")
    )
    if np.unique(rows.rock).size < 2 * FINGERPRINT_ROCKS:
        raise Unseen
    drag, error = _drag_of(case, rows)
    # Gravity is no better known than the film shows it.
    error = math.hypot(error, _drag_of(case, lighter)[0] - drag)
    aside, beside = _drag_of(case, across)
    if PRINTED_Z * error > MOST_DRAG - LEAST_DRAG_IN_TIME:
        # Nothing that air may do is seen of rocks so large or slow.
        raise Unseen
    if drag > MOST_DRAG + 2.0 * error or abs(aside) > DRAG_ASIDE * max(drag, 0.0) + 3.0 * beside:
        # Wind, or lift of a rock that turns.
        raise Unseen
    return Scores(np.array([(drag - LEAST_DRAG_IN_TIME) / error]), drag)


def _drag_of(case: Case, rows: StepTable) -> tuple[float, float]:
    """Return the drag coefficient that makes accelerations of flights, and its standard error."""
    pull = _pull(case, rows) * rows.speed2
    weight = pull / rows.sd**2
    scale = float((weight * pull).sum())
    drag = -float((weight * rows.observed).sum()) / scale
    # Rocks of one group share what is not drag; errors of measurement may be smaller than stated.
    away = np.bincount(case.group[rows.rock], weight * (-rows.observed - drag * pull))
    least = (1.0 - MISSTATED_SHARE) ** 2 * scale
    return drag, math.sqrt(max(float((away**2).sum()), least)) / scale


def _on_every_flight(case: Case, residuals: ResidualTable) -> Scores:
    """Score energy lost on free flights, less what contacts take that last.

    A flight is counted from where a contact begins, with the velocity at its end. What gravity
    gives meanwhile looks like a loss, but one that knows no size of the rock.
    """
    rows, _, usual = loss_of_flights(residuals.steps.of("flight", "energy_jpkg"))
    free = (np.abs(rows.reach - 1.0) < FREE_FLIGHT_SHARE) & np.isfinite(rows.way_m)
    kept = free & (np.abs(usual - np.median(usual[free] if free.any() else usual)) < 2.5)
    if kept.sum() < 2 * FINGERPRINT_ROCKS:
        raise Unseen
    rows = rows.where(kept)
    speed2 = rows.observed + rows.predicted
    # In standard deviations: what air takes for C_d = 1, and contacts of a second.
    pull = _pull(case, rows) * speed2 * rows.way_m / rows.sd
    fall = np.maximum(rows.fell_jpkg, 0.0) * np.sqrt(np.maximum(speed2, 0.0))
    fall = fall / (rows.way_m * rows.sd)
    (lasts_s, _), _ = nnls(np.column_stack([fall, pull]), usual[kept])
    loss = usual[kept] - min(float(lasts_s), CONTACT_LASTS_S) * fall
    # What goes along with the time of the contacts says nothing of the air.
    weight = pull - fall * (pull @ fall) / (fall @ fall) if lasts_s > 0.0 else pull
    drag = float(weight @ loss) / max(float(weight @ pull), 1e-12)
    if drag > MOST_DRAG:
        raise Unseen
    return Scores(per_rock(weight * (loss - LEAST_DRAG * pull), rows.rock, case.n_rocks), drag)


CAUSE = Cause(
    "air_drag",
    number=5,
    group="along the way",
    phase="flight",
    draw=_draw,
    statistics=(
        Trace(
            "level speed lost in flight, over speed squared and size",
            _against_the_motion,
            ("trajectories",),
            clear=True,
        ),
        Trace(
            "energy lost in flight, over path and size, on every flight",
            _on_every_flight,
            ("impacts",),
            clear=True,
        ),
    ),
)
