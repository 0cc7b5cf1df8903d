"""Hazard curves: how often blocks reach each place with at least some energy.

Each simulated block has an annual frequency, its source's onset frequency over the blocks that
were simulated. The rate of a place is the sum over the blocks that arrived there; their energies
make the curve.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from sassgis.hazard.map_sums import count_variance
from sassgis.model.grid import FloatArray
from sassgis.model.hazard import HazardCurves, Source, SourceCounts

#: Rates are sums of rounded numbers: a rate short of 1/T by less than this share meets T.
_ROUNDING = 1e-12


def source_rate(source: Source, counts: SourceCounts) -> FloatArray:
    """Annual frequency λ(E >= e) with which blocks of one source reach places, (n, n_energies).

    It is the onset frequency times the share of the blocks that arrived.
    """
    rate: FloatArray = source.rate_per_rock * counts.count.astype(np.float64)
    return rate


def source_variance(source: Source, counts: SourceCounts) -> FloatArray:
    """Sampling variance of ``source_rate`` (1/year²), by ``map_sums.count_variance``.

    NaN where blocks were counted but the sample does not give it (one block per line, one random
    line); 0 where none was, as in the places that the source does not reach at all.
    """
    variance = count_variance(
        counts.count,
        counts.square,
        source.rocks_per_line,
        source.rocks // max(source.rocks_per_line, 1),
        source.random_points,
    )
    return np.where(counts.count > 0, source.rate_per_rock**2 * variance, 0.0)


def hazard_curves(
    sources: Sequence[Source], counts: Sequence[SourceCounts], energies_kj: ArrayLike
) -> HazardCurves:
    """Hazard curves of all places that any source reaches.

    λ(E >= e, x) = Σ over sources of onset frequency · reach probability(x) · P(E >= e | reach).
    Sums are made over the scenarios of each area first, and then over the areas in the order in
    which they first appear. So the rate of two areas is exactly the sum of the rates of each alone.

    Sources are independent samples, and their variances add up. Not so the scenarios of an area
    whose release points were drawn at random: they start from the same points, and where one is by
    chance too often, the others are too. There the standard errors are added, which is the most
    that they can reach.

    The rate of one block is the largest of the scenarios of those areas from which any block
    arrived: none of a few blocks of a frequent scenario says little against it where a rare one
    arrives.

    ``energies_kj`` are those of the columns of the counts, ascending from 0 (kJ).
    """
    energies = np.asarray(energies_kj, np.float64)
    if energies.ndim != 1 or energies.size == 0 or energies[0] != 0.0:
        raise ValueError("the first energy of the curves is 0 kJ")
    if np.any(np.diff(energies) <= 0.0):
        raise ValueError("energies of the curves do not rise")
    largest = {s.area: max(t.rate_of_a_rock for t in sources if t.area == s.area) for s in sources}
    same_points = {s.area for s in sources if s.random_points}
    areas: dict[str, list[HazardCurves]] = {}
    for source, own in zip(sources, counts, strict=True):
        if own.count.shape != (own.places.size, energies.size):
            raise ValueError(f"counts of {source.label} do not fit the energies")
        per_rock = np.where(own.count[:, 0] > 0, largest[source.area], 0.0)
        areas.setdefault(source.area, []).append(
            HazardCurves(
                own.places,
                energies,
                source_rate(source, own),
                source_variance(source, own),
                per_rock,
            )
        )
    joined = [_joined(parts, energies, area in same_points) for area, parts in areas.items()]
    return _joined(joined, energies, False)


def _joined(parts: Sequence[HazardCurves], energies: FloatArray, together: bool) -> HazardCurves:
    """Sum of curves, added one after the other; ``together`` if they share their chance."""
    if len(parts) == 1:
        return parts[0]
    places = (
        np.unique(np.concatenate([p.places for p in parts])) if parts else np.empty(0, np.int64)
    )
    rate = np.zeros((places.size, energies.size))
    variance = np.zeros_like(rate)
    per_rock = np.zeros(places.size)
    for part in parts:
        rows = np.searchsorted(places, part.places)
        rate[rows] += part.rate
        if together:
            variance[rows] = (np.sqrt(variance[rows]) + np.sqrt(part.variance)) ** 2
        else:
            variance[rows] += part.variance
        per_rock[rows] = np.maximum(per_rock[rows], part.rate_of_a_rock)
    return HazardCurves(places, energies, rate, variance, per_rock)


def at_energies(curves: HazardCurves, energies_kj: Sequence[float]) -> HazardCurves:
    """The curves at some of their energies alone, which ascend from 0 (kJ).

    Raises
    ------
    ValueError
        An energy is none of the curves'.
    """
    columns = [curves.column(e) for e in energies_kj]
    return HazardCurves(
        curves.places,
        curves.energies_kj[columns],
        curves.rate[:, columns],
        curves.variance[:, columns],
        curves.rate_of_a_rock,
    )


# ---------------------------------------------------------------------------------------------
# Return periods


def return_period(rate: ArrayLike) -> FloatArray:
    """Return period T = 1/λ (years); infinite where the rate is 0."""
    values = np.asarray(rate, np.float64)
    out = np.full(values.shape, np.inf)
    np.divide(1.0, values, out=out, where=values > 0.0)
    return out


def meets(rate: ArrayLike, years: float | FloatArray) -> NDArray[np.bool_]:
    """Whether a rate (1/year) is at least 1/T, apart from rounding; NaN does not meet anything."""
    met: NDArray[np.bool_] = np.asarray(rate, np.float64) * years >= 1.0 - _ROUNDING
    return met


def energy_at(curves: HazardCurves, years: float | FloatArray) -> FloatArray:
    """Energy (kJ) that is reached or exceeded once in a return period T (years), shape (n,).

    The largest energy e with λ(E >= e) >= 1/T. Between two energies of the curve both logarithms
    are taken as linear, with two exceptions: from 0 kJ to the next energy, the energy itself is
    linear (0 has no logarithm); and up to an energy that no block has, the rate itself is linear
    (as if the blocks were spread evenly between the two energies). Beyond the last energy of the
    curve nothing is known: the last one is given there. NaN where blocks arrive less often than
    once in T.
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
    """Limits (1/year) between which the rates lie, given the sample; shape (n, n_energies) each.

    The gamma interval for weighted sums of counts (Fay and Feuer 1997, Statistics in Medicine 16:
    791-801): the lower limit is a quantile of the gamma distribution with the mean λ and variance v
    of the rate, the upper one of that with mean λ + w and variance v + w², w being the rate of one
    block more. For counts with one weight it is the exact interval of a Poisson mean. It states
    what another sample of blocks would change, and nothing of the model, its parameters or the
    onset frequency. ``confidence`` is the probability that the interval holds the rate, below 1.

    With no block counted the lower limit is 0; with variance 0 it is the rate. NaN where the
    variance is.
    """
    return gamma_interval(curves.rate, curves.variance, curves.rate_of_a_rock[:, None], confidence)


def gamma_interval(
    rate: FloatArray, variance: FloatArray, of_a_rock: FloatArray | float, confidence: float
) -> tuple[FloatArray, FloatArray]:
    """The interval of ``rate_interval`` from rates, their variance, and that of one block."""
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"a confidence of {confidence} is not between 0 and 1")
    tail = 0.5 * (1.0 - confidence)
    unknown = np.isnan(variance)
    lower = _gamma_quantile(tail, rate, variance, special.gammaincinv)
    upper = _gamma_quantile(tail, rate + of_a_rock, variance + of_a_rock**2, special.gammainccinv)
    lower = np.where(unknown, np.nan, np.minimum(lower, rate))
    upper = np.where(unknown, np.nan, np.maximum(upper, rate))
    return lower, upper


def _gamma_quantile(
    tail: float, mean: FloatArray, variance: FloatArray, inverse: np.ufunc
) -> FloatArray:
    """Quantile of the gamma distribution with a mean and variance; the mean where that is 0.

    Spreads below a hundred millionth of the mean count as 0.
    """
    out = np.array(np.broadcast_to(mean, np.broadcast_shapes(mean.shape, variance.shape)))
    spread = np.broadcast_to(variance, out.shape)
    some = (out > 0.0) & (spread > 1e-16 * out**2)
    scale = spread[some] / out[some]
    # Many places have the same counts.
    shapes, of = np.unique(out[some] / scale, return_inverse=True)
    out[some] = inverse(shapes, tail)[of] * scale
    return out
