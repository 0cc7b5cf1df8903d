"""Loads on a barrier at a line by residual frequency, and where they exceed measurements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray
from sassgis.hazard.curves import Arrivals, hazard_curves, source_variance
from sassgis.hazard.sources import Sampled
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.hazard_rules import Source, SourceCounts
from sassgis.settings.languages import joined, phrase
from sassgis.settings.results import short
from sassgis.settings.statistics_table import built_in_rows
from sassgis.simulation.control_lines import QUANTITIES, Distribution


def arrivals(sampled: Sequence[Sampled], control_line: int, quantity: str) -> Arrivals:
    """Compute the frequency of a quantity at a line, all sources weighted by their frequency.

    The line is a position among the stations and barriers, the quantity one of
    control_lines.QUANTITIES.
    """
    edges = QUANTITIES[quantity][1]
    found = [one.control_lines.distribution(control_line, quantity) for one in sampled]
    counts = [_at_edges(own) for own in found]
    sources = [one.source for one in sampled]
    curves = hazard_curves(sources, counts, edges, _variance)
    count, square = (
        np.array([getattr(own, part)[0] for own in counts], np.float64)
        for part in ("count", "square")
    )
    alike = np.divide(count**2, square, out=np.zeros_like(count), where=square > 0.0)
    largest = max((own.largest for own in found if own.count), default=math.nan)
    rocks = np.rint(alike.sum(axis=0)).astype(np.int64)
    return Arrivals(edges, curves.rate.sum(axis=0), rocks, largest, curves)


def _at_edges(own: Distribution) -> SourceCounts:
    """Return blocks at or above each edge of the bins, as those of one place."""
    above = np.cumsum(own.histogram.counts[::-1])[::-1]
    count, square = (np.append(values, 0)[None] for values in (above, own.squares))
    return SourceCounts(np.zeros(1, np.int64), count, square)


def _variance(source: Source, counts: SourceCounts) -> FloatArray:
    """Return the variance of a source's rates; of given points at most that of single blocks."""
    if source.random_points:
        return source_variance(source, counts)
    variance: FloatArray = source.rate_per_rock**2 * counts.square.astype(np.float64)
    return variance


def value_at_rate(curve: Arrivals, rate: float) -> float:
    """Find the smallest value that is exceeded no more often than ``rate`` (per year).

    Within a bin the blocks are taken as spread evenly; no value lies above the largest seen. NaN
    where blocks arrive less often than that at all.
    """
    if curve.rate[0] <= rate:
        return float("nan")
    # The bin at whose lower edge the rate is still above the wanted one.
    i = int(np.flatnonzero(curve.rate > rate)[-1])
    step = curve.rate[i] - curve.rate[i + 1]
    share = (curve.rate[i] - rate) / step if step > 0.0 else 1.0
    value = curve.edges[i] + share * (curve.edges[i + 1] - curve.edges[i])
    return float(min(value, curve.largest))


def value_limits(curve: Arrivals, rate: float, confidence: float) -> tuple[float, float]:
    """Return limits of ``value_at_rate``, given the sample; NaN where there is none.

    The lower one is 0 where blocks may come less often, the upper one NaN where more energy or
    height than any block had may be that frequent.
    """
    if not np.isfinite(value_at_rate(curve, rate)):
        return float("nan"), float("nan")
    low, high = curve.limits(confidence)
    least = value_at_rate(low, rate)
    beyond = high.rate[curve.rate <= 0.0].max(initial=0.0)
    most = float("nan") if beyond > rate else value_at_rate(high, rate)
    return (least if np.isfinite(least) else 0.0), most


def rocks_beyond(curve: Arrivals, rate: float) -> int:
    """Count simulated blocks above the bin of the value that is exceeded at ``rate``."""
    if curve.rate[0] <= rate:
        return int(curve.rocks[0])
    return int(curve.rocks[int(np.flatnonzero(curve.rate > rate)[-1]) + 1])


@cache
def net_classes() -> tuple[tuple[str, float], ...]:
    """Read name and maximum energy (kJ) of the classes, rising: sassgis/data/net_classes.csv."""
    return tuple(
        (row["class"], float(row["maximum_energy_kj"] or "inf"))
        for row in built_in_rows("net_classes")
    )


def net_class(energy_kj: float) -> str:
    """Find the lowest class of nets whose maximum energy is not below an energy; "" of NaN."""
    if np.isnan(energy_kj):
        return ""
    return next(name for name, most in net_classes() if energy_kj <= most)


#: What is compared: its name in the table of measurements, in words, and its unit.
_COMPARED = (
    ("speed_mps", "speeds", "m/s"),
    ("height_m", "passing heights", "m"),
    ("rotation_hz", "rotations", "Hz"),
)
#: Below this share of the cells an excess concerns single cells: no warning.
_LEAST_SHARE = 0.01


@cache
def measured_motion() -> tuple[dict[str, float], ...]:
    """Read the largest measured values, by rising volume: sassgis/data/measured_motion.csv."""
    names = ("volume_to_m3", *(name for name, _, _ in _COMPARED))
    return tuple(
        {name: float(row[name]) for name in names} for row in built_in_rows("measured_motion")
    )


def measured_at(volume_m3: float) -> dict[str, float]:
    """Return measurements on blocks of a volume's (m³) size class; the largest class beyond it."""
    rows = measured_motion()
    return next((row for row in rows if volume_m3 <= row["volume_to_m3"]), rows[-1])


def size_warnings(blocks: tuple[BlockPopulation, ...]) -> list[str]:
    """Warn of scenarios with blocks larger than any whose motion was measured."""
    known = measured_motion()[-2]["volume_to_m3"]
    beyond = [f"{own.name} ({own.volume_limits_m3[1]:.3g} m³)" for own in blocks
              if own.volume_limits_m3[1] > known]  # fmt: skip
    if not beyond:
        return []
    text = (
        "No block above {} m³ was measured in motion. Speeds and heights of larger blocks are "
        "extrapolated: {}."
    )
    return [phrase(text, short(known), ", ".join(beyond))]


def motion_warnings(
    blocks: tuple[BlockPopulation, ...], maps: Mapping[str, NDArray[np.floating[Any]]]
) -> list[str]:
    """Warn where maps exceed measurements on blocks as large as the largest of a run.

    ``maps`` are 95 % values in cells by name of a measured quantity; NaN where no block arrives.
    """
    known = measured_at(max(own.volume_limits_m3[1] for own in blocks))
    out: list[str] = []
    for name, words, unit in _COMPARED:
        if name not in maps:
            continue
        values, limit = maps[name][np.isfinite(maps[name])], known[name]
        share = float(np.mean(values > limit)) if values.size else 0.0
        if share >= _LEAST_SHARE:
            out.append(
                phrase(
                    "On {} % of the reached area, 95 % {} exceed {} {}, the largest value "
                    "measured on blocks of this size. They reach {} {} ({} % more). Check the "
                    "ground classes.",
                    f"{100.0 * share:.0f}", phrase(words), short(limit), unit,
                    short(float(values.max())), unit,
                    f"{100.0 * (float(values.max()) / limit - 1.0):.0f}",
                )
            )  # fmt: skip
    return out


def words_at_line(sampled: Sequence[Sampled], line: int) -> str:
    """State how far 95 % values at a station or barrier exceed measurements; else empty.

    The size is that of the 95 % quantile of the mass, at the default density of a
    block.
    """
    curves = {name: arrivals(sampled, line, name) for name, _, _ in _COMPARED}
    mass = _q95(arrivals(sampled, line, "mass_kg"))
    known = measured_at(mass / BlockPopulation().density_kgm3[0])
    found = []
    for name, words, unit in _COMPARED:
        value, limit = _q95(curves[name]), known[name]
        if value > limit:
            over = f"{100.0 * (value / limit - 1.0):.0f}"
            text = "{} {} {}, {} % above the largest measured value"
            found.append(phrase(text, phrase(words), short(value), unit, over))
    return joined("; ", found)


def _q95(curve: Arrivals) -> float:
    return value_at_rate(curve, 0.05 * float(curve.rate[0]))
