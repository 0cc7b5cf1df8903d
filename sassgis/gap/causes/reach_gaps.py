"""Runs that start again at each station: what they lack there, rock by rock."""

from __future__ import annotations

import numpy as np

from sassgis.gap.causes.cause import LEAST, Unseen
from sassgis.gap.residuals.residuals import mean_of_draws
from sassgis.gap.residuals.table import ResidualTable
from sassgis.model.grid import FloatArray


def reach_gaps(residuals: ResidualTable, quantity: str) -> FloatArray:
    """Gaps of a quantity, shape (n_rocks, n_reaches), where enough rocks have one; Unseen without.

    Reaches without are left out.
    """
    return np.column_stack([*_by_reach(residuals, quantity, relative=False).values()])


def _by_reach(residuals: ResidualTable, quantity: str, *, relative: bool) -> dict[str, FloatArray]:
    """Gaps of a quantity by the name of the reach, of those where enough rocks have one."""
    own = [
        r
        for r in residuals.rows
        if r.test == "reach" and r.phase != "release" and r.quantity == quantity
    ]
    with np.errstate(invalid="ignore", divide="ignore"):
        found = {
            r.place: np.clip(r.gap / r.predicted, -2.0, 2.0) if relative else r.gap for r in own
        }
    found = {place: gap for place, gap in found.items() if np.isfinite(gap).sum() >= LEAST}
    if not found:
        raise Unseen
    return found


def speed_by_reach(residuals: ResidualTable) -> dict[str, FloatArray]:
    """Gaps of the speed by the name of the reach, shape (n_rocks,) each; Unseen without any.

    Relative to what is predicted, so that fast reaches do not outweigh the others.
    """
    return _by_reach(residuals, "speed_mps", relative=True)


def speed_gaps(residuals: ResidualTable) -> FloatArray:
    """The same, shape (n_rocks, n_reaches)."""
    return np.column_stack([*speed_by_reach(residuals).values()])


def over_scatter(gaps: FloatArray, least: float) -> FloatArray:
    """Gaps in units of the scatter of the rocks on each reach, or of ``least`` if that is less.

    Of one reach, shape (n_rocks,), or of several.
    """
    scaled: FloatArray = gaps / np.maximum(np.nanstd(gaps, axis=0), least)
    return scaled


def wrong_on_one(residuals: ResidualTable, sign: float = 0.0) -> dict[str, FloatArray]:
    """How much the speed is wrong on each reach alone, in scatters, shape (n_rocks,) each.

    Its gap less that on the others, as far as this exceeds what the others are off themselves:
    where all reaches are wrong none is wrong alone. ``sign`` is that of the gap that is looked for;
    0: that which the reach has.
    """
    speed = speed_by_reach(residuals)
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
