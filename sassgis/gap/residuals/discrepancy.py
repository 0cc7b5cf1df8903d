"""The discrepancy of the law of motion: what any law leaves, smooth down the slope.

A law differs from nature by a share of each quantity that is the same for all rocks, on all ground
and in all steps, and changes little down the slope (M. C. Kennedy and A. O'Hagan, 2001, Bayesian
calibration of computer models, J. R. Stat. Soc. B 63, 425-464; J. Brynjarsdóttir and A. O'Hagan,
2014, Learning about physical parameters: the importance of model discrepancy, Inverse Problems 30,
114007: structured, with a prior). A cause shows by what such a share cannot be: a place, a ground,
a size, a flatness, a scatter, a single flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sassgis.gap.constants import (
    FINDING_ROCKS,
    LAW_SCORES,
    LAW_SHARES,
    LAW_TREND,
    LEAST_SHARE_ERROR,
)
from sassgis.gap.residuals.rock_residuals import Residual
from sassgis.grid import FloatArray


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """By how much the law of a model is off in one quantity, as a share of it."""

    test: str  # as in ``GapFinding``
    quantity: str
    share: float  # observed over predicted, less 1, in the middle of the slope
    trend: float  # change of that from the middle to the ends
    error: float  # standard error of ``share``


def without_discrepancy(
    rows: Sequence[Residual],
) -> tuple[tuple[Residual, ...], tuple[Discrepancy, ...]]:
    """Return residuals beyond the discrepancy of the law, and that discrepancy.

    Its share and trend have the prior of ``LAW_SHARES``, and what is tested of scatters that of
    ``LAW_SCORES``. What only one place has (release, lateral offsets, turns, numbers of blocks) has
    none, and stays as it is.
    """
    ends = [s for row in rows for s in (row.s0_m, row.s1_m) if np.isfinite(s)]
    low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)

    def along(row: Residual) -> float:
        """Return how far down the slope a place lies, -1 to 1; 0 where it is no stretch."""
        at = (row.s0_m + row.s1_m - low - high) / max(high - low, 1.0)
        return float(at) if np.isfinite(at) else 0.0

    by_kind: dict[tuple[str, str], list[Residual]] = {}
    for row in filter(_is_smooth, rows):
        by_kind.setdefault((row.test, row.quantity), []).append(row)
    found: dict[tuple[str, str], Discrepancy] = {}
    shifts: dict[tuple[str, str], tuple[float, float, float] | None] = {}
    for kind, same in by_kind.items():
        places, sd = [along(row) for row in same], LAW_SHARES[kind[1]]
        fitted = _fitted([_share(row.gap, row, row.predicted) for row in same], places, sd)
        if fitted is not None:
            found[kind] = Discrepancy(*kind, *fitted)
        scores = [_share(row.tested(), row, None) for row in same if row.score is not None]
        shifts[kind] = _fitted(scores, places, LAW_SCORES) if scores else None
    corrected = []
    for row in rows:
        law = found.get((row.test, row.quantity)) if _is_smooth(row) else None
        shift = shifts.get((row.test, row.quantity)) if _is_smooth(row) else None
        if law is not None:
            factor = 1.0 + law.share + law.trend * along(row)
            row = replace(row, predicted=row.predicted * factor)
        if row.score is not None and shift is not None:
            row = replace(row, score=row.score - shift[0] - shift[1] * along(row))
        corrected.append(row)
    return tuple(corrected), tuple(found.values())


def _is_smooth(row: Residual) -> bool:
    return row.quantity in LAW_SHARES and row.phase != "release"


def _share(
    values: FloatArray, row: Residual, unit: FloatArray | None
) -> tuple[float, float] | None:
    """Return the mean of values of rocks over that of a unit, and its error; None of few rocks."""
    known = np.isfinite(values) & np.isfinite(row.gap)
    weight = known * (np.ones(known.size) if row.weight is None else row.weight)
    total = float(weight.sum())
    size = total if unit is None else abs(float(weight @ np.where(known, unit, 0.0)))
    if known.sum() < FINDING_ROCKS or not size > 0.0:
        return None
    filled = np.where(known, values, 0.0)
    off = known * (filled - float(weight @ filled) / total)
    error = max(float(np.sqrt(weight**2 @ off**2)) / size, LEAST_SHARE_ERROR)
    return float(weight @ filled) / size, error


def _fitted(
    seen: Sequence[tuple[float, float] | None], along: Sequence[float], sd: float
) -> tuple[float, float, float] | None:
    """Fit a level and a trend to means of places, by their errors and the prior; its error."""
    known = [(at, *own) for at, own in zip(along, seen, strict=True) if own is not None]
    if not known:
        return None
    at, mean, error = np.array(known).T
    design = np.column_stack([np.ones(at.size), at]) / error[:, None]
    precision = design.T @ design + np.diag([sd**-2, (LAW_TREND * sd) ** -2])
    level, trend = np.linalg.solve(precision, design.T @ (mean / error)).tolist()
    return level, trend, float(np.linalg.inv(precision)[0, 0] ** 0.5)
