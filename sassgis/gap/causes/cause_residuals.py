"""Residuals in which causes leave traces: at contacts, on flights and reaches, and to the side."""

from __future__ import annotations

import math

import numpy as np

from sassgis.gap.causes.cause import LEAST, MISSTATED, Unseen
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.free_run import side_error
from sassgis.gap.residuals.residuals import mean_of_draws
from sassgis.gap.residuals.steps import StepTable
from sassgis.gap.residuals.table import ResidualTable
from sassgis.model.grid import FloatArray

#: Mean turn at a contact (deg), and growth of offsets over the way, that edges of blocks and uneven
#: ground make anywhere: no effect of its own. Published standard deviations are 5 to 20° and 10 to
#: 20 % of the way (docs/effects.md); rigid bodies of the check turn by 7 to 12°.
EDGES_TURN_DEG, EDGES_GROWTH = 10.0, 0.15
#: How far paths leave their fall line by flying straight, where they are still near it (m per m).
STRAIGHT = 0.02


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


def station_offsets(case: Case, residuals: ResidualTable, least: int = 2) -> FloatArray:
    """Observed lateral offsets at stations (m), shape (n_rocks, n_stations), ``least`` or more."""
    if len(case.station_names) < least:
        raise Unseen
    rows = residuals.steps.of("run", "lateral_m")
    at = np.full((case.n_rocks, len(case.station_names)), np.nan)
    at[rows.rock, rows.station] = rows.observed
    return at


def usual_offset(case: Case) -> float:
    """Mean size of offsets (m) that errors make, were they larger than stated."""
    error = max(side_error(case), side_error(case, stop=True))
    return math.sqrt(2.0 / math.pi) * (1.0 + MISSTATED) * error


def base_size(draws: FloatArray) -> FloatArray:
    """Mean size of what the base makes, shape (n_rocks,); 0 in the plane of a fall line."""
    return np.nan_to_num(mean_of_draws(np.abs(draws), least=1))


def known_mean(values: FloatArray) -> float:
    """Mean of what is known; NaN where nothing is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan
