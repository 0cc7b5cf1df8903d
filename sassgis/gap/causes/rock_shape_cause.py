"""Shape of the rocks as a cause: flat rocks are slower after impacts, and stop early."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from sassgis.engine.effects.rock_shape import RockShape
from sassgis.gap.causes.cause import (
    Cause,
    Fit,
    Range,
    Scores,
    Trace,
    Unseen,
    beyond_any_law,
    contact_gaps,
    fitted_alone,
    late_by_rock,
    over_scatter,
    reach_gaps,
    standardised,
)
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.gap.residuals.rock_residuals import per_rock

FIT = Fit(
    ranges={"strength": Range(0.08, 3.0, "log")},
    forms={"flat_landing": 0.85, "mean_inertia": 0.15},
    parameters={"mean_inertia": ()},
)


def _rebound(case: Case, residuals: ResidualTable) -> Scores:
    rows, z = contact_gaps(residuals, "tangential_speed_mps")
    left = beyond_any_law(rows, z) * standardised(rows.flatness)
    return Scores(per_rock(left, rows.rock, case.n_rocks), float(left.mean()))


def _slow_and_early(case: Case, residuals: ResidualTable) -> Scores:
    """Return nothing from stops only: flat rocks also start or break otherwise."""
    gaps = [reach_gaps(residuals, "speed_mps")]
    with suppress(Unseen):
        gaps.append(reach_gaps(residuals, "runout_m"))
    both = np.column_stack([over_scatter(own, 1e-3) for own in gaps])
    axes = residuals.run.axes_m.mean(axis=1)
    flat = -standardised(axes[:, 2] / np.sqrt(axes[:, 0] * axes[:, 1]))
    late = late_by_rock(both)
    return Scores(-late * flat, float(-np.nanmean(late * flat)))


CAUSE = Cause(
    "rock_shape",
    number=7,
    group="contact",
    phase="impact",
    draw=fitted_alone(RockShape, FIT),
    statistics=(
        Trace("rebound against the flatness of the rock", _rebound, ("rocks", "impacts")),
        Trace(
            "flat rocks slow and early to stop", _slow_and_early, ("rocks", "passages", "stations")
        ),
    ),
)
