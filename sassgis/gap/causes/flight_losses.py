"""Energy that observed flights lack."""

from __future__ import annotations

from sassgis.gap.causes.cause import LEAST, Unseen
from sassgis.gap.residuals.steps import StepTable
from sassgis.model.grid import FloatArray


def loss_of_flights(rows: StepTable) -> tuple[StepTable, FloatArray, FloatArray]:
    """Flights, what they lost (J/kg), and that in standard deviations; Unseen if there are few."""
    if len(rows) < 2 * LEAST:
        raise Unseen
    loss = rows.predicted - rows.observed
    return rows, loss, loss / rows.sd
