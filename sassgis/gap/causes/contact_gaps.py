"""What is left of impacts after the law of the contact, and what flights between them lack."""

from __future__ import annotations

import numpy as np

from sassgis.gap.causes.cause import LEAST, Unseen
from sassgis.gap.residuals.steps import StepTable
from sassgis.gap.residuals.table import ResidualTable
from sassgis.model.grid import FloatArray


def contact_gaps(residuals: ResidualTable, quantity: str) -> tuple[StepTable, FloatArray]:
    """Impacts and their z; Unseen where there are few, or few with a normal speed."""
    steps = residuals.steps
    rows = steps.of("impact", quantity)
    if min(len(rows), len(steps.of("impact", "normal_speed_mps"))) < 4 * LEAST:
        raise Unseen
    return rows, np.clip(rows.z, -4.0, 4.0)


def beyond_any_law(rows: StepTable, z: FloatArray) -> FloatArray:
    """Z less a smooth function of speed and ground: what no law of the contact could do."""
    grounds = [(rows.ground == k).astype(np.float64) for k in np.unique(rows.ground).tolist()[1:]]
    speed = np.log(np.maximum(rows.vn_mps, 0.2))
    design = np.column_stack([np.ones(len(rows)), speed, rows.predicted / 10.0, *grounds])
    ridge = np.eye(design.shape[1])
    return np.asarray(z - design @ np.linalg.solve(design.T @ design + ridge, design.T @ z))


def loss_of_flights(rows: StepTable) -> tuple[StepTable, FloatArray, FloatArray]:
    """Flights, what they lost (J/kg), and that in standard deviations; Unseen if there are few."""
    if len(rows) < 2 * LEAST:
        raise Unseen
    loss = rows.predicted - rows.observed
    return rows, loss, loss / rows.sd
