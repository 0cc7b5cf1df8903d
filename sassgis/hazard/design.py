"""What a barrier at a line must take: energies and passing heights by residual frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.hazard.control_lines import QUANTITIES, ControlLineSums
from sassgis.model.grid import FloatArray
from sassgis.model.hazard import Source


@dataclass(frozen=True, slots=True)
class Arrivals:
    """How often blocks reach a line with at least some energy, height or the like.

    Attributes
    ----------
    edges : float64, shape (n + 1,)
        Of the bins in which the quantity was counted.
    rate : float64, shape (n + 1,)
        Frequency at or above each edge, per year; 0 at the last.
    rocks : int64, shape (n + 1,)
        Simulated blocks behind it.
    largest : float
        Largest value of any block; NaN if none arrived.
    """

    edges: FloatArray
    rate: FloatArray
    rocks: np.ndarray
    largest: float


def arrivals(
    sources: Sequence[Source],
    control_lines: Sequence[ControlLineSums],
    control_line: int,
    quantity: str,
) -> Arrivals:
    """Frequency curve of one quantity at one line, all sources weighted by their frequency.

    Parameters
    ----------
    control_lines : sequence of ControlLineSums
        Of each source.
    control_line : int
        Position among the stations and barriers.
    quantity : str
        One of sassgis.hazard.control_lines.QUANTITIES.
    """
    edges = QUANTITIES[quantity][1]
    rate = np.zeros(edges.size)
    rocks = np.zeros(edges.size, np.int64)
    largest = -np.inf
    for source, sums in zip(sources, control_lines, strict=True):
        own = sums.distribution(control_line, quantity)
        above = np.append(np.cumsum(own.histogram.counts[::-1])[::-1], 0)
        rate += source.rate_per_rock * above
        rocks += above
        if own.count:
            largest = max(largest, own.largest)
    return Arrivals(edges, rate, rocks, largest if np.isfinite(largest) else float("nan"))


def value_at_rate(curve: Arrivals, rate: float) -> float:
    """The smallest value that is exceeded no more often than ``rate`` (per year).

    Within a bin the blocks are taken as spread evenly; no value lies above the largest seen.

    Returns
    -------
    float
        NaN where blocks arrive less often than that at all: there is no such value.
    """
    if curve.rate[0] <= rate:
        return float("nan")
    # The bin at whose lower edge the rate is still above the wanted one.
    i = int(np.flatnonzero(curve.rate > rate)[-1])
    step = curve.rate[i] - curve.rate[i + 1]
    share = (curve.rate[i] - rate) / step if step > 0.0 else 1.0
    value = curve.edges[i] + share * (curve.edges[i + 1] - curve.edges[i])
    return float(min(value, curve.largest))


def quantile(curve: Arrivals, probability: float) -> float:
    """Quantile of the blocks that arrive, weighted by their frequency; NaN where none arrives."""
    return value_at_rate(curve, (1.0 - probability) * float(curve.rate[0]))


def rocks_beyond(curve: Arrivals, rate: float) -> int:
    """Simulated blocks above the value that is exceeded at ``rate``: few mean a poor estimate.

    Counted from the upper edge of the bin that holds the value.
    """
    if curve.rate[0] <= rate:
        return int(curve.rocks[0])
    return int(curve.rocks[int(np.flatnonzero(curve.rate > rate)[-1]) + 1])
