"""Loads on exposed objects: energies and heights of all blocks that reach each, pooled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from sassgis.grid import FloatArray
from sassgis.hazard.curves import energy_at, hazard_curves, rate_interval, wide_variance
from sassgis.settings.hazard_rules import HazardCurves, Source, SourceCounts
from sassgis.settings.map_run import ObjectCells
from sassgis.simulation.map_sums import MapSums, quantiles

#: Quantile of energy and height that is stated for all blocks that reach an object.
_Q95 = 0.95


@dataclass(frozen=True, slots=True)
class ObjectEstimate:
    """Values of objects with an interval by the sampling of blocks, shape (n_objects,) each.

    NaN where nothing arrives, or not as often; a limit is NaN where the sample has none.
    """

    value: FloatArray
    low: FloatArray
    high: FloatArray

    def of(self, number: int) -> tuple[float, float, float]:
        """Return the value and limits of one object."""
        return float(self.value[number]), float(self.low[number]), float(self.high[number])

    def columns(self, name: str) -> dict[str, FloatArray]:
        """Return values and limits by the name of the values."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


@dataclass(frozen=True, slots=True)
class ObjectValues:
    """Energies and heights of the blocks that reach each object."""

    arrivals: ObjectEstimate  # blocks per year; without frequencies, the blocks themselves
    # 95 % quantiles. Energy: each block counts once with its largest value on the object, by its
    # frequency. Height: each simulated block counts once in each cell.
    energy_q95_kj: ObjectEstimate
    height_q95_m: ObjectEstimate
    # Exceeded once in a return period (years); empty without frequencies.
    energy_kj: Mapping[float, ObjectEstimate] = field(default_factory=dict)

    def stretch_of(self, stretches: Sequence[int]) -> int:
        """Return the stretch of a road whose values stand for it: that with the most energy.

        The energy is that of the longest return period; without frequencies the 95 % quantile.
        """
        energy = self.energy_q95_kj
        if self.energy_kj:
            energy = self.energy_kj[max(self.energy_kj)]
        return max(stretches, key=lambda i: float(np.nan_to_num(energy.value[i], nan=-1.0)))


def object_values(
    objects: ObjectCells,
    sources: Sequence[Source],
    counts: Sequence[SourceCounts],
    energies_kj: FloatArray,
    sums: MapSums | None,
    height_edges: FloatArray,
    *,
    return_periods: Sequence[float] = (),
    confidence: float = 0.95,
) -> ObjectValues:
    """Compute energies and heights of the blocks that reach each object.

    ``counts`` of the sources are those at the objects. ``sums`` are of the cells of all blocks,
    with histograms of the passing height of these edges (m); without, no height is stated. Return
    periods are in years, ``confidence`` is that of the intervals.
    """
    curves = hazard_curves(sources, counts, energies_kj)
    lower, upper = rate_interval(curves, confidence)
    # Quantiles of rising means rise, but for rounding.
    ends = [replace(curves, rate=np.minimum.accumulate(rate, axis=1)) for rate in (lower, upper)]
    n = objects.n_objects

    def placed(*values: FloatArray) -> ObjectEstimate:
        out = np.full((3, n), np.nan)
        out[:, curves.places] = values
        return ObjectEstimate(*out)

    def energy(years: FloatArray) -> ObjectEstimate:
        low, high = (energy_at(end, years) for end in ends)
        value = energy_at(curves, years)
        # With the lowest frequency blocks may come less often; beyond the last energy of the
        # curves nothing is known.
        unknown = ends[1].rate[:, -1] * years >= 1.0
        low = np.where(np.isnan(low), 0.0, low)
        high = np.where(unknown, np.nan, high)
        # Where no block has the next energy of the curve the interpolation differs.
        low, high = np.minimum(low, value), np.maximum(high, value)
        return placed(value, *(np.where(np.isnan(value), np.nan, v) for v in (low, high)))

    rate = curves.rate[:, 0]
    # Blocks with a frequency of 0 have no energy at any return period.
    few = (1.0 - _Q95) * rate
    of_few = np.divide(1.0, few, out=np.full(rate.shape, np.nan), where=few > 0.0)
    return ObjectValues(
        placed(rate, lower[:, 0], upper[:, 0]),
        energy(of_few),
        _heights(objects, curves, sums, height_edges, confidence),
        {t: energy(np.full(rate.shape, t)) for t in return_periods},
    )


def _heights(
    objects: ObjectCells,
    curves: HazardCurves,
    sums: MapSums | None,
    edges: FloatArray,
    confidence: float,
) -> ObjectEstimate:
    """Compute the 95 % quantile of the passing height in the cells of each object."""
    # Limits are order statistics (binomial, taken as normal) of as many independent blocks as give
    # the rate of the object its variance, but no more than arrive: where nearly all arrive, the
    # variance is that of the few others.
    n = objects.n_objects
    pooled = np.zeros((n, edges.size - 1), np.int64)
    largest = np.zeros(n)
    if sums is not None and sums.cells.size:
        rows = sums.rows_at(objects.cell)
        of, rows = objects.number[rows >= 0], rows[rows >= 0]
        np.add.at(pooled, of, sums.column("height")[rows].astype(np.int64))
        np.maximum.at(largest, of, sums.column("height_max")[rows])
    blocks = np.zeros(n)
    rate = curves.rate[:, 0]
    spread = np.maximum(wide_variance(curves)[:, 0], rate * curves.rate_of_one[:, 0])
    blocks[curves.places] = np.divide(
        rate**2, spread, out=np.zeros_like(spread), where=spread > 0.0
    )
    out = np.full((3, n), np.nan)
    z = special.ndtri(0.5 + 0.5 * confidence)
    for number in np.flatnonzero(pooled.any(axis=1)).tolist():
        room = z * np.sqrt(_Q95 * (1.0 - _Q95) / max(blocks[number], 1.0))
        levels = (_Q95, max(_Q95 - room, 0.0), min(_Q95 + room, 1.0))
        own = slice(number, number + 1)
        out[:, number] = quantiles(pooled[own], edges, levels, largest[own])[:, 0]
    return ObjectEstimate(*out)
