"""Sums per cell of the map, values read from them, and their sampling error.

Every block enters a cell's statistics once, with the largest energy, passing height and speed that
it had there and the time at which it first entered. All sums are whole numbers and extremes, so
that the result does not depend on the order of adding, and memory grows with the cells that are
reached, not with the number of blocks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sassgis.grid import FloatArray, IntArray
from sassgis.settings.statistics_table import (
    SUM_NAMES,
    SUMS,
    Statistic,
    probability_of,
    sums_by,
)

if TYPE_CHECKING:
    from sassgis.engine.simulate import Visits


def count_variance(
    count: IntArray, square: IntArray, rocks_per_line: int, strata: int, random_points: bool
) -> FloatArray:
    """Return the sampling variance of the number of blocks that reach a place.

    With k_l of the n blocks of line l in the place and K = Σ k_l: release points on a lattice are
    fixed, so only the blocks of each line are a sample (stratified sampling; Cochran 1977, section
    5.3): Var K = Σ k_l (n − k_l)/(n − 1). Points drawn at random make the line the unit (cluster
    sampling; ibid., section 9A.2): Var K = L/(L − 1) · (Σ k_l² − K²/L).

    Given are Σ k_l and Σ k_l² in arrays of one shape, n and L. NaN where the sample does not give
    it: one block per line, or one random line.
    """
    k = count.astype(np.float64)
    k2 = square.astype(np.float64)
    n = rocks_per_line
    if random_points:
        if strata < 2:
            return np.full(k.shape, np.nan)
        variance = strata / (strata - 1.0) * (k2 - k * k / strata)
    elif n < 2:
        return np.full(k.shape, np.nan)
    else:
        variance = (n * k - k2) / (n - 1.0)
    return np.maximum(variance, 0.0)


def blocks_of_a_point(count: IntArray, square: IntArray) -> FloatArray:
    """Return blocks that come from one more release point, drawn at random.

    With k_l blocks of point l the mean of k_l over the blocks, Σ k_l² / Σ k_l: points from which
    none comes do not count. 0 where no block comes from any.
    """
    per_point: FloatArray = np.divide(
        square, count, out=np.zeros(count.shape), where=count > 0, dtype=np.float64
    )
    return per_point


def widening(freedom: FloatArray | float, tail: float) -> FloatArray | float:
    """Return the factor by which a variance of few degrees of freedom exceeds a known one.

    The square of a quantile of Student's t over that of the normal distribution; ``tail`` is the
    probability beyond it. 1 at infinity.
    """
    if np.isinf(freedom).all():
        return 1.0
    t = special.stdtrit(np.maximum(freedom, 1.0), 1.0 - tail)
    factor: FloatArray = np.where(np.isinf(freedom), 1.0, (t / special.ndtri(1.0 - tail)) ** 2)
    return factor


def pooled_freedom(variances: FloatArray, freedom: Sequence[float]) -> FloatArray:
    """Return degrees of freedom of sums of independent variances, shape (n_samples, n).

    They are infinite for a variance of 0. After Welch (1947, Biometrika 34: 28-35) and
    Satterthwaite (1946, Biometrics Bulletin 2: 110-114).
    """
    uncertain = (variances**2 / np.maximum(freedom, 1.0)[:, None]).sum(axis=0)
    pooled = np.full(uncertain.shape, np.inf)
    np.divide(variances.sum(axis=0) ** 2, uncertain, out=pooled, where=uncertain > 0.0)
    return pooled


def gamma_interval(
    rate: FloatArray,
    variance: FloatArray,
    of_one: FloatArray | float,
    confidence: float,
    freedom: FloatArray | float = math.inf,
) -> tuple[FloatArray, FloatArray]:
    """Return limits between which rates lie, given a sample.

    The gamma interval for weighted sums of counts (Fay and Feuer 1997, Statistics in Medicine 16:
    791-801): the lower limit is a quantile of the gamma distribution with the mean λ and variance v
    of the rate, the upper one of that with mean λ + w and variance v + w², w being the rate of one
    more of what is drawn. For counts with one weight it is the exact interval of a Poisson mean.

    What is drawn are blocks, or release points with their blocks. Points are few: v is then known
    with ν degrees of freedom only, and is widened by Student's t (as Korn and Graubard 1998, Survey
    Methodology 24: 193-201, do for shares). The lower limit is that of a sample with one point more
    from which no block comes, λ (ν + 1)/(ν + 2) and w² at least: points that are alike by chance
    would have no variance.

    Parameters
    ----------
    of_one : float64
        w: rate of one block; where points were drawn, that of the blocks of a point.
    confidence : float
        Probability that the interval holds the rate, below 1.
    freedom : float64
        Degrees of freedom of the variances; infinite where only blocks were drawn.

    Returns
    -------
    lower, upper : float64
        With no block counted the lower limit is 0; with variance 0, and only blocks, it is the
        rate. NaN where the variance is.
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"a confidence of {confidence} is not between 0 and 1")
    tail = 0.5 * (1.0 - confidence)
    unknown = np.isnan(variance)
    wider = widening(freedom, tail)
    upper = _gamma_quantile(tail, rate + of_one, wider * variance + of_one**2, special.gammainccinv)
    if not np.isinf(freedom).all():
        variance = np.where(np.isinf(freedom), variance, np.maximum(variance, np.square(of_one)))
        rate = rate * (1.0 - 1.0 / (freedom + 2.0))
    lower = _gamma_quantile(tail, rate, wider * variance, special.gammaincinv)
    lower = np.where(unknown, np.nan, np.minimum(lower, rate))
    upper = np.where(unknown, np.nan, np.maximum(upper, rate))
    return lower, upper


def _gamma_quantile(
    tail: float, mean: FloatArray, variance: FloatArray, inverse: np.ufunc
) -> FloatArray:
    """Return quantile of the gamma distribution; the mean where the variance is 0."""
    out = np.array(np.broadcast_to(mean, np.broadcast_shapes(mean.shape, variance.shape)))
    spread = np.broadcast_to(variance, out.shape)
    # Spreads below a hundred millionth of the mean count as 0.
    some = (out > 0.0) & (spread > 1e-16 * out**2)
    scale = spread[some] / out[some]
    # Many places have the same counts.
    shapes, of = np.unique(out[some] / scale, return_inverse=True)
    out[some] = inverse(shapes, tail)[of] * scale
    return out


#: Rows that are processed at a time: they stay in the processor's cache and need no new memory.
_ROWS = 2048
# Bytes up to which there is room for all cells at once: nothing is moved as more cells are reached,
# and zeros that nobody has written to take no memory.
_ROOM_AT_ONCE = 2**30
#: Type of the bins of a histogram as long as no cell has more blocks than it can count.
_FEW = np.uint16


class MapSums:
    """Growing sums over the cells that blocks reach; ``n_cells`` are those of the whole grid."""

    def __init__(self, n_cells: int) -> None:
        self._row = np.full(n_cells, -1, np.int32)
        self._cells: IntArray = np.empty(0, np.int64)
        self._used = 0
        self._sums: dict[str, NDArray[Any]] = {}

    @property
    def cells(self) -> IntArray:
        """Return flat indices of the cells with sums, in the order of their first block."""
        return self._cells[: self._used]

    def column(self, name: str) -> NDArray[Any]:
        """Return one of the sums, rows as ``cells``."""
        return self._sums[name][: self._used]

    def rows_at(self, cells: IntArray) -> IntArray:
        """Return rows of some cells; -1 of those without sums."""
        return self._row[cells].astype(np.int64)

    def add(
        self,
        cells: IntArray,
        sums: Mapping[str, NDArray[Any]],
        visits: Visits | None = None,
        n_bins: Mapping[str, int] | None = None,
        weight: int = 1,
    ) -> None:
        """Join the sums of some cells, each of which is named once, by name as in the table.

        Visits of these cells are what the histograms of ``sums`` do not have, with bins for each in
        their order; ``weight`` is how many times a visit counts.
        """
        reached = np.flatnonzero((sums["reach"] > 0) | (sums["stops"] > 0))
        shapes = {name: own.shape[1:] for name, own in sums.items()}
        shapes |= {name: (n,) for name, n in (n_bins or {}).items()}
        rows = self._rows_of(cells[reached], shapes)
        self._widen_for(rows, sums["reach"][reached])
        for kept in SUMS:
            if kept.name not in sums and kept.name in shapes:
                continue
            own, more = self._sums[kept.name], sums[kept.name]
            for first in range(0, rows.size, _ROWS):
                part = slice(first, first + _ROWS)
                own[rows[part]] = kept.join(own[rows[part]], more[reached[part]])
        if visits is not None:
            row = np.full(cells.size, -1, np.int32)
            row[reached] = rows
            visits.add_to(tuple(self._sums[name] for name in n_bins or ()), row, weight)

    def _widen_for(self, rows: IntArray, more: NDArray[Any]) -> None:
        """Widen the type of the bins where rows have more blocks than it can count."""
        most = (self._sums["reach"][rows] + more).max(initial=0)
        for kept in sums_by("histogram"):
            own = self._sums[kept.name]
            if own.dtype == _FEW and most > np.iinfo(_FEW).max:
                own, room = own[: self._used], own.shape[0]
                self._sums[kept.name] = _enlarged(own.astype(kept.dtype), room, kept.empty)

    def _rows_of(self, cells: IntArray, shapes: Mapping[str, tuple[int, ...]]) -> IntArray:
        """Return rows of the cells, made where there were none; ``shapes`` of a row of each sum."""
        fresh = cells[self._row[cells] < 0]
        end = self._used + fresh.size
        if end > self._cells.size or not self._sums:
            room = max(end, int(1.5 * self._cells.size), 1024)
            per_cell = sum(np.dtype(s.dtype).itemsize * math.prod(shapes[s.name]) for s in SUMS)
            if per_cell * self._row.size <= _ROOM_AT_ONCE:
                room = self._row.size
            self._cells = np.concatenate([self._cells, np.zeros(room - self._cells.size, np.int64)])
            for kept in SUMS:
                dtype = _FEW if kept.reducer == "histogram" else kept.dtype
                own = self._sums.get(kept.name, np.empty((0, *shapes[kept.name]), dtype))
                self._sums[kept.name] = _enlarged(own, room, kept.empty)
        self._cells[self._used : end] = fresh
        self._row[fresh] = np.arange(self._used, end, dtype=np.int32)
        self._used = end
        return self.rows_at(cells)

    def part(self, cells: IntArray) -> MapSums:
        """Return the sums of some of the cells."""
        rows = np.unique(self.rows_at(cells))
        rows = rows[rows >= 0]
        out = MapSums(self._row.size)
        if rows.size:
            out.add(self.cells[rows], {name: self.column(name)[rows] for name in self._sums})
        return out

    def free_histograms(self) -> None:
        """Free the histograms, most of the memory; nothing can be added any more."""
        for kept in sums_by("histogram"):
            self._sums.pop(kept.name, None)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the state needed to go on later, as plain arrays."""
        return {"cells": self.cells, **{n: self.column(n) for n in self._sums}}

    @classmethod
    def from_state(cls, n_cells: int, state: Mapping[str, NDArray[Any]]) -> MapSums:
        """Return the sums that ``state`` returned."""
        sums = cls(n_cells)
        if len(state) > 1:
            sums.add(np.asarray(state["cells"], np.int64), {n: state[n] for n in SUM_NAMES})
        return sums


def _enlarged(array: NDArray[Any], room: int, empty: float) -> NDArray[Any]:
    # Zeros that nobody has written to take no memory.
    out = np.zeros((room, *array.shape[1:]), array.dtype)
    out[: array.shape[0]] = array
    if empty != 0:
        out[array.shape[0] :] = empty
    return out


def weighted_counts(
    count: IntArray, square: IntArray, weight: int, rocks_per_line: int
) -> tuple[IntArray, IntArray]:
    """Count blocks, and their squares by stratum, of blocks that count ``weight`` times each.

    The square is the one with which count_variance returns the variance of the weighted number: it
    adds up over blocks of several weights, and is no sum of squares then.
    """
    if weight == 1:
        return count, square
    apart = rocks_per_line * weight * (weight - 1)
    return weight * count, weight * weight * square - apart * count


def weighted_sums(
    sums: Mapping[str, NDArray[Any]], weight: int, rocks_per_line: int
) -> Mapping[str, NDArray[Any]]:
    """Return sums of the table, of blocks that count ``weight`` times each."""
    if weight == 1:
        return sums
    out = {
        s.name: sums[s.name] if s.reducer in ("max", "min") else weight * sums[s.name]
        for s in SUMS
        if s.name in sums
    }
    _, out["reach_square"] = weighted_counts(
        sums["reach"].astype(np.int64), sums["reach_square"].astype(np.int64), weight,
        rocks_per_line,
    )  # fmt: skip
    return out


def quantiles(
    counts: NDArray[np.integer],
    edges: FloatArray,
    probabilities: tuple[float, ...],
    largest: FloatArray | None = None,
    smallest: FloatArray | None = None,
) -> FloatArray:
    """Return quantiles of values that were counted in bins, shape (n_probabilities, n).

    Counts have the shape (n, n_bins). Within a bin the values are taken as spread evenly; no
    quantile exceeds the largest value seen in its row or falls below the smallest. NaN where
    nothing was counted.
    """
    out = np.full((len(probabilities), counts.shape[0]), np.nan)
    for first in range(0, counts.shape[0], _ROWS):
        below = np.cumsum(counts[first : first + _ROWS], axis=1, dtype=np.int64)
        some = np.flatnonzero(below[:, -1] > 0)
        below, rows = below[some], first + some
        total = below[:, -1]
        # All rows as one rising sequence: each begins above the largest value of the one before.
        start = np.arange(rows.size) * (total.max(initial=0) + 1)
        rising = (below + start[:, None]).ravel()
        for i, p in enumerate(probabilities):
            wanted = p * total
            bin_ = np.searchsorted(rising, np.ceil(wanted).astype(np.int64) + start)
            bin_ = np.minimum(bin_ - np.arange(rows.size) * counts.shape[1], counts.shape[1] - 1)
            inside = counts[rows, bin_].astype(np.float64)
            before = below[np.arange(rows.size), bin_] - inside
            share = np.where(inside > 0, (wanted - before) / np.maximum(inside, 1.0), 0.0)
            value = edges[bin_] + np.clip(share, 0.0, 1.0) * (edges[bin_ + 1] - edges[bin_])
            if largest is not None:
                value = np.minimum(value, largest[rows])
            if smallest is not None:
                value = np.maximum(value, smallest[rows])
            out[i, rows] = value
    return out


@dataclass(frozen=True, slots=True)
class Sample:
    """How many blocks stand behind a map."""

    started: int  # all blocks released that started: the denominator of the reach probability
    rocks_per_line: int
    lines: int  # lines times block scenarios: the strata of the sample
    random_points: bool  # whether the release points were themselves drawn at random


def reach_probability(
    reach: IntArray, reach_square: IntArray, sample: Sample
) -> tuple[FloatArray, FloatArray]:
    """Return the share of started blocks that reach each cell, and its sampling error.

    With k_l of n blocks of line l in the cell and N blocks that started, P = Σ k_l / N, of Σ k_l
    and Σ k_l²; the error is the root of ``count_variance`` over N, NaN where that is.
    """
    variance = count_variance(
        reach, reach_square, sample.rocks_per_line, sample.lines, sample.random_points
    )
    started = max(sample.started, 1)
    return reach.astype(np.float64) / started, np.sqrt(variance) / started


def reach_limits(
    reach: IntArray, reach_square: IntArray, sample: Sample
) -> tuple[FloatArray, FloatArray]:
    """Return limits of a 95 % gamma_interval of the reach probability; NaN where its error is."""
    started = max(sample.started, 1)
    share, error = reach_probability(reach, reach_square, sample)
    of_one = np.full(share.shape, 1.0 / started)
    freedom = math.inf
    if sample.random_points:
        of_one = np.maximum(of_one, blocks_of_a_point(reach, reach_square) / started)
        freedom = sample.lines - 1.0
    low, high = gamma_interval(share, error**2, of_one, 0.95, freedom)
    return low, np.minimum(high, 1.0)


def band_values(
    row: Statistic, sums: MapSums, sample: Sample, edges: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Return values of the bands of a map, in its order, given edges of histograms by quantity.

    Rows are those of ``sums.cells``; NaN where no block arrived, or none stopped.
    """
    reach = sums.column("reach").astype(np.int64)
    shares = {b: p for b in row.bands if (p := probability_of(b)) is not None}
    extremes = {
        b: sums.column(f"{row.quantity}_{b}").astype(np.float64)
        for b in row.bands
        if b in ("min", "max")
    }
    out: dict[str, FloatArray] = dict(extremes)
    if shares:
        found = quantiles(
            sums.column(row.quantity), edges[row.quantity], tuple(shares.values()),
            extremes.get("max"), extremes.get("min"),
        )  # fmt: skip
        out |= dict(zip(shares, found, strict=True))
    if "mean" in row.bands:
        total = sums.column(f"{row.quantity}_sum").astype(np.float64) * 1e-3
        out["mean"] = total / np.maximum(reach, 1)
    if "reach" in row.bands:
        square = sums.column("reach_square").astype(np.int64)
        out["reach"], out["standard_error"] = reach_probability(reach, square, sample)
        out["lower"], out["upper"] = reach_limits(reach, square, sample)
    if "passages" in row.bands:
        out["passages"] = reach.astype(np.float64)
    if "stops" in row.bands:
        stops = sums.column("stops").astype(np.float64)
        return {"stops": np.where(stops > 0, stops, np.nan)}
    return {b: np.where(reach > 0, out[b], np.nan) for b in row.bands}
