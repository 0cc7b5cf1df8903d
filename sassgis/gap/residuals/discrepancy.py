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

from sassgis.gap.constants import FINDING_ROCKS, LAW_SHARES, LAW_TREND, LEAST_SHARE_ERROR
from sassgis.gap.residuals.rock_residuals import Residual


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

    Its share and trend have the prior of ``LAW_SHARES``; scatters and what only one place has
    (release, lateral offsets, turns, numbers of blocks) have none, and stay as they are.
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
    found = {
        kind: law
        for kind, same in by_kind.items()
        if (law := _fitted(*kind, same, [along(row) for row in same])) is not None
    }
    corrected = []
    for row in rows:
        law = found.get((row.test, row.quantity))
        if law is not None and _is_smooth(row):
            factor = 1.0 + law.share + law.trend * along(row)
            row = replace(row, predicted=row.predicted * factor)
        corrected.append(row)
    return tuple(corrected), tuple(found.values())


def _is_smooth(row: Residual) -> bool:
    return row.score is None and row.quantity in LAW_SHARES


def _fitted(
    test: str, quantity: str, rows: Sequence[Residual], along: Sequence[float]
) -> Discrepancy | None:
    """Fit share and trend to the mean gaps of all places, by their errors and the prior."""
    seen = []
    for row, at in zip(rows, along, strict=True):
        known = np.isfinite(row.gap)
        weight = known * (np.ones(known.size) if row.weight is None else row.weight)
        total = float(weight.sum())
        size = abs(float(weight @ np.where(known, row.predicted, 0.0)))
        if known.sum() < FINDING_ROCKS or not size > 0.0:
            continue
        gap = np.where(known, row.gap, 0.0)
        off = known * (gap - float(weight @ gap) / total)
        error = max(float(np.sqrt(weight**2 @ off**2)) / size, LEAST_SHARE_ERROR)
        seen.append((at, float(weight @ gap) / size, error))
    if not seen:
        return None
    at, gap, error = np.array(seen).T
    design = np.column_stack([np.ones(at.size), at]) / error[:, None]
    sd = LAW_SHARES[quantity]
    precision = design.T @ design + np.diag([sd**-2, (LAW_TREND * sd) ** -2])
    share, trend = np.linalg.solve(precision, design.T @ (gap / error)).tolist()
    return Discrepancy(test, quantity, share, trend, float(np.linalg.inv(precision)[0, 0] ** 0.5))
