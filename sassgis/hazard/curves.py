"""Hazard curves: how often blocks reach each place with at least some energy.

Each simulated block has an annual frequency, its source's onset frequency over the blocks that
were simulated. The rate of a place is the sum over the blocks that arrived there; their energies
make the curve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sassgis.grid import FloatArray, IntArray
from sassgis.settings.hazard_rules import DrawnPoints, HazardCurves, Source, SourceCounts
from sassgis.simulation.map_sums import (
    blocks_of_a_point,
    count_variance,
    gamma_interval,
    widening,
)

#: Rates are sums of rounded numbers: a rate short of 1/T by less than this share meets T.
_ROUNDING = 1e-12


def source_rate(source: Source, counts: SourceCounts) -> FloatArray:
    """Compute the annual frequency λ(E >= e) of blocks of one source at places, (n, n_energies)."""
    rate: FloatArray = source.rate_per_rock * counts.count.astype(np.float64)
    return rate


def source_variance(source: Source, counts: SourceCounts) -> FloatArray:
    """Compute the sampling variance of ``source_rate`` (1/year²).

    NaN where the sample cannot give it (one block per line, one random line); 0 where no block was
    counted.
    """
    variance = count_variance(
        counts.count, counts.square, source.rocks_per_line, source.lines, source.random_points
    )
    return np.where(counts.count > 0, source.rate_per_rock**2 * variance, 0.0)


def _drawn_points(source: Source, counts: SourceCounts) -> DrawnPoints | None:
    """Return the variance that comes from a source's release points; None where they are given."""
    if not source.random_points:
        return None
    each = blocks_of_a_point(counts.count, counts.square)
    # Energies above the largest of a block have the counts of the last one reached.
    last = np.maximum((counts.count > 0).sum(axis=1) - 1, 0)
    each = np.where(counts.count > 0, each, np.take_along_axis(each, last[:, None], 1))
    return DrawnPoints(source.rate_per_rock * each, np.full(each.shape, source.freedom))


def hazard_curves(
    sources: Sequence[Source],
    counts: Sequence[SourceCounts],
    energies_kj: ArrayLike,
    variance_of: Callable[[Source, SourceCounts], FloatArray] = source_variance,
) -> HazardCurves:
    """Add up the hazard curves of all places that any source reaches.

    λ(E >= e, x) = Σ over sources of onset frequency · reach probability(x) · P(E >= e | reach).
    Sums are made over the scenarios of each area first, and then over the areas in the order in
    which they first appear: the rate of two areas is exactly the sum of the single rates.

    Sources are independent samples: their variances add up. The scenarios of an area with random
    release points start from the same points: their standard errors add up, an upper bound.

    The rate of one block is the largest among the scenarios of the areas from which any block
    arrived: where a rare scenario arrives, a frequent one with few blocks may arrive as well.

    ``energies_kj`` are those of the columns of the counts, ascending from 0 (kJ).
    """
    energies = np.asarray(energies_kj, np.float64)
    if energies.ndim != 1 or energies.size == 0 or energies[0] != 0.0:
        raise ValueError("the first energy of the curves is 0 kJ")
    if np.any(np.diff(energies) <= 0.0):
        raise ValueError("energies of the curves do not rise")
    largest = {s.area: max(t.rate_of_a_rock for t in sources if t.area == s.area) for s in sources}
    areas: dict[str, list[tuple[Source, SourceCounts]]] = {}
    for source, own in zip(sources, counts, strict=True):
        if own.count.shape != (own.places.size, energies.size):
            raise ValueError(f"counts of {source.label} do not fit the energies")
        areas.setdefault(source.area, []).append((source, own))

    def of_source(source: Source, own: SourceCounts) -> HazardCurves:
        per_rock = np.where(own.count[:, 0] > 0, largest[source.area], 0.0)
        rate, variance = source_rate(source, own), variance_of(source, own)
        points = _drawn_points(source, own)
        return HazardCurves(own.places, energies, rate, variance, per_rock, points)

    def of_area(area: str) -> HazardCurves:
        own = areas[area]
        together = any(source.random_points for source, _ in own)
        parts = (of_source(*part) for part in own)
        return _joined(parts, [c.places for _, c in own], energies, together, together)

    places = [_all_places([c.places for _, c in own]) for own in areas.values()]
    drawn = any(source.random_points for source in sources)
    return _joined(map(of_area, areas), places, energies, drawn, False)


def _all_places(parts: Sequence[IntArray]) -> IntArray:
    """Return the places of any of the parts, ascending."""
    if len(parts) == 1:
        return parts[0]
    return np.unique(np.concatenate([np.empty(0, np.int64), *parts]))


def _joined(
    parts: Iterable[HazardCurves],
    of_parts: Sequence[IntArray],
    energies: FloatArray,
    drawn: bool,
    together: bool,
) -> HazardCurves:
    """Return the sum of curves at some places each; ``together`` if they share their chance.

    They are made and added one by one: all at once would take several times the memory. ``drawn``
    is whether the release points of any were drawn at random.
    """
    if len(of_parts) == 1:
        return next(iter(parts))
    places = _all_places(of_parts)
    rate = np.zeros((places.size, energies.size))
    variance = np.zeros_like(rate)
    per_rock = np.zeros(places.size)
    # Of independent samples the degrees of freedom are those of Welch (1947, Biometrika 34: 28-35)
    # and Satterthwaite (1946, Biometrics Bulletin 2: 110-114), and one point more is one of any of
    # them; the scenarios of an area share their points.
    shape = rate.shape if drawn else (0, 0)
    of_a_point, uncertain, freedom = np.zeros(shape), np.zeros(shape), np.full(shape, np.inf)
    for part in parts:
        rows = np.searchsorted(places, part.places)
        rate[rows] += part.rate
        if together:
            variance[rows] = (np.sqrt(variance[rows]) + np.sqrt(part.variance)) ** 2
        else:
            variance[rows] += part.variance
        per_rock[rows] = np.maximum(per_rock[rows], part.rate_of_a_rock)
        if drawn:
            add = np.add if together else np.maximum
            more = part.rate_of_one if part.drawn is None else part.drawn.rate_of_a_point
            of_a_point[rows] = add(of_a_point[rows], more)
            own = np.broadcast_to(np.maximum(part.freedom, 1.0), part.variance.shape)
            freedom[rows] = np.minimum(freedom[rows], own)
            uncertain[rows] += part.variance**2 / own
    if drawn and not together:
        freedom = np.divide(variance**2, uncertain, out=freedom, where=uncertain > 0.0)
    points = DrawnPoints(of_a_point, freedom) if drawn else None
    return HazardCurves(places, energies, rate, variance, per_rock, points)


def at_energies(curves: HazardCurves, energies_kj: Sequence[float]) -> HazardCurves:
    """Return the curves at some of their energies (kJ); ValueError if one is not among them."""
    return curves.part(slice(None), [curves.column(e) for e in energies_kj])


# ---------------------------------------------------------------------------------------------
# Return periods


def return_period(rate: ArrayLike) -> FloatArray:
    """Return period T = 1/λ (years); infinite where the rate is 0."""
    values = np.asarray(rate, np.float64)
    out = np.full(values.shape, np.inf)
    np.divide(1.0, values, out=out, where=values > 0.0)
    return out


def meets(rate: ArrayLike, years: float | FloatArray) -> NDArray[np.bool_]:
    """Return whether a rate (1/year) is at least 1/T, but for rounding; False for NaN."""
    met: NDArray[np.bool_] = np.asarray(rate, np.float64) * years >= 1.0 - _ROUNDING
    return met


def energy_at(curves: HazardCurves, years: float | FloatArray) -> FloatArray:
    """Compute the energy (kJ) that is reached or exceeded once in T (years), shape (n,).

    The largest energy e with λ(E >= e) >= 1/T. Between two energies of the curve both logarithms
    are taken as linear, with two exceptions: from 0 kJ to the next energy, the energy itself is
    linear (0 has no logarithm); and up to an energy that no block has, the rate itself is linear
    (as if the blocks were spread evenly between the two energies). Beyond the last energy of the
    curve the last one is given. NaN where blocks arrive less often than once in T.
    """
    energies = curves.energies_kj
    periods = np.broadcast_to(np.asarray(years, np.float64), curves.places.shape)
    met = meets(curves.rate, periods[:, None])
    # The last column that meets T; curves fall, so all before it do as well.
    last = np.where(met.any(axis=1), energies.size - 1 - np.argmax(met[:, ::-1], axis=1), -1)
    out = np.where(last < 0, np.nan, energies[last])
    rows = np.flatnonzero((last >= 0) & (last < energies.size - 1))
    at = last[rows]
    here, next_ = curves.rate[rows, at], curves.rate[rows, at + 1]
    wanted = 1.0 / periods[rows]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(
            next_ > 0.0,
            np.log(here / wanted) / np.log(here / np.where(next_ > 0.0, next_, wanted)),
            (here - wanted) / here,
        )
    share = np.clip(np.nan_to_num(share, nan=0.0), 0.0, 1.0)
    low, high = energies[at], energies[at + 1]
    ratio = high / np.where(low > 0.0, low, high)
    out[rows] = np.where(low > 0.0, low * ratio**share, high * share)
    return out


# ---------------------------------------------------------------------------------------------
# How well the rates are known


def rate_interval(curves: HazardCurves, confidence: float = 0.95) -> tuple[FloatArray, FloatArray]:
    """Compute limits (1/year) between which the rates lie, each of shape (n, n_energies).

    By ``map_sums.gamma_interval``, for the sampling error only: errors of the model, its parameters
    and the onset frequency are not included. ``confidence`` is below 1.
    """
    return gamma_interval(
        curves.rate, curves.variance, curves.rate_of_one, confidence, curves.freedom
    )


def wide_variance(curves: HazardCurves) -> FloatArray:
    """Return variances widened as those of 95 % limits, which hold for few drawn points."""
    return curves.variance * widening(curves.freedom, 0.025)


@dataclass(frozen=True, slots=True)
class Arrivals:
    """How often blocks reach a line with at least some energy, height or the like."""

    edges: FloatArray  # shape (n + 1,); of the bins in which the quantity was counted
    rate: FloatArray  # shape (n + 1,); frequency at or above each edge, per year; 0 at the last
    # Shape (n + 1,); simulated blocks behind it; with unequal weights or few points the number of
    # equal blocks that has the same variance.
    rocks: np.ndarray
    largest: float  # largest value of any block; NaN if none arrived
    # The rate with its variance by the sampling; the line is the place, the edges are the energies.
    curves: HazardCurves

    def limits(self, confidence: float) -> tuple[Arrivals, Arrivals]:
        """Return curves between which this one lies, given the sample."""
        ends = (end.sum(axis=0) for end in rate_interval(self.curves, confidence))
        low, high = (replace(self, rate=np.minimum.accumulate(rate)) for rate in ends)
        # No block exceeded the largest value.
        return low, replace(high, largest=float("inf"))
