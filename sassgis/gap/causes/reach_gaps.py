"""Runs that start again at each station: what they lack there, rock by rock."""

from __future__ import annotations

import numpy as np

from sassgis.gap.causes.cause import LEAST, Unseen
from sassgis.gap.residuals.residuals import mean_of_draws
from sassgis.gap.residuals.table import ResidualTable
from sassgis.model.grid import FloatArray


def gaps_by_reach(residuals: ResidualTable, quantity: str) -> dict[str, FloatArray]:
    """Gaps of a quantity by the name of the reach, shape (n_rocks,) each; Unseen without any.

    Reaches where too few rocks have one are left out. Gaps of the speed are relative to what is
    predicted, so that fast reaches do not outweigh the others.
    """
    found = {}
    for row in residuals.rows:
        if row.test == "reach" and row.phase != "release" and row.quantity == quantity:
            gap = row.gap
            if quantity == "speed_mps":
                with np.errstate(invalid="ignore", divide="ignore"):
                    gap = np.clip(gap / row.predicted, -2.0, 2.0)
            if np.isfinite(gap).sum() >= LEAST:
                found[row.place] = gap
    if not found:
        raise Unseen
    return found


def reach_gaps(residuals: ResidualTable, quantity: str) -> FloatArray:
    """The same, shape (n_rocks, n_reaches)."""
    return np.column_stack([*gaps_by_reach(residuals, quantity).values()])


def speed_gaps(residuals: ResidualTable) -> FloatArray:
    """The same of the speed."""
    return reach_gaps(residuals, "speed_mps")


def over_scatter(gaps: FloatArray, least: float) -> FloatArray:
    """Gaps in units of the scatter of the rocks on each reach, or of ``least`` if that is less.

    Of one reach, shape (n_rocks,), or of several.
    """
    return np.asarray(gaps / np.maximum(np.nanstd(gaps, axis=0), least))


def wrong_on_one(residuals: ResidualTable, sign: float = 0.0) -> dict[str, FloatArray]:
    """How much the speed is wrong on each reach alone, in scatters, shape (n_rocks,) each.

    Its gap less that on the others, as far as this exceeds what the others are off themselves:
    where all reaches are wrong none is wrong alone. ``sign`` is that of the gap that is looked for;
    0: that which the reach has.
    """
    speed = gaps_by_reach(residuals, "speed_mps")
    if len(speed) < 2:
        raise Unseen
    own = over_scatter(np.column_stack([*speed.values()]), 0.05)
    found = {}
    for k, place in enumerate(speed):
        others = mean_of_draws(np.delete(own, k, axis=1), least=1)
        towards = sign or float(np.sign(np.nanmean(own[:, k])))
        found[place] = towards * (own[:, k] - others) - abs(float(np.nanmean(others)))
    return found


def late_by_rock(gaps: FloatArray) -> FloatArray:
    """Mean over reaches of gaps less that of all rocks, shape (n_rocks,)."""
    return mean_of_draws(gaps - np.nanmean(gaps, axis=0), least=1)


def standardised(values: FloatArray) -> FloatArray:
    """Less their mean, over their scatter; zero without any."""
    spread = float(np.nanstd(values))
    return (values - np.nanmean(values)) / spread if spread > 0.0 else 0.0 * values


def sizes(residuals: ResidualTable) -> FloatArray:
    """Sizes of the rocks, standardised, shape (n_rocks,)."""
    return standardised(np.log(residuals.run.radius_m))
