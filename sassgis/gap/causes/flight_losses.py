"""Energy that observed flights lack."""

from __future__ import annotations

from sassgis.gap.causes.cause import LEAST
from sassgis.gap.residuals.steps import StepTable
from sassgis.model.grid import FloatArray


def loss_of_flights(rows: StepTable) -> tuple[StepTable, FloatArray, FloatArray] | None:
    """Flights, what they lost (J/kg), and that in standard deviations; None if there are few."""
    if len(rows) < 2 * LEAST:
        return None
    loss = rows.predicted - rows.observed
    return rows, loss, loss / rows.sd
