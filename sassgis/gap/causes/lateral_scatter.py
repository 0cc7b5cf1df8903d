"""Lateral offsets: those that causes make besides what they are named for, and those observed."""

from __future__ import annotations

import math

import numpy as np

from sassgis.gap.causes.cause import MISSTATED, Unseen
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.free_run import side_error
from sassgis.gap.residuals.residuals import mean_of_draws
from sassgis.gap.residuals.table import ResidualTable
from sassgis.model.grid import FloatArray

#: Mean turn at a contact (deg), and growth of offsets over the way, that edges of blocks and uneven
#: ground make anywhere: no effect of its own. Published standard deviations are 5 to 20° and 10 to
#: 20 % of the way (docs/effects.md); rigid bodies of the check turn by 7 to 12°.
EDGES_TURN_DEG, EDGES_GROWTH = 10.0, 0.15
#: How far paths leave their fall line by flying straight, where they are still near it (m per m).
STRAIGHT = 0.02


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
