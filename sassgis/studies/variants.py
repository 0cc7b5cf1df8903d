"""Variants of values: the same blocks once more, for each of a list of variants.

A variant has other values of the ground classes, or another seed; all release the same blocks with
the same random draws. Their results make one table of answers, and maps. A sensitivity tries
each range of values alone, at its low and its high end, and points that fill all ranges at once; a
spread draws classes as they lie between sites, and a band is the middle 80 % of the draws.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from sassgis.compiled import rng
from sassgis.grid import FloatArray, IntArray
from sassgis.hazard.assess import Rules, curves_of
from sassgis.hazard.curves import at_energies
from sassgis.hazard.levels import hazard_level
from sassgis.hazard.sources import line_parts, sampled_sources
from sassgis.settings.ground import LIMITS, ParameterRange
from sassgis.settings.languages import phrase
from sassgis.settings.map_run import MapRun, ObjectCells
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.control_lines import LineParts, weighted_distribution
from sassgis.simulation.response import RunOutcome, energy_q95_kj, outcome_of, response

#: Names of the simulations that are no points of a sample, no ends of a range and no draws.
BASE, CHANCE, FARTHEST = "base", "another seed", "all for the longest run-out"
#: Names of some measures: quantiles of the run-out, and the median ratio of the energies to the
#: base over the cells that enough blocks reach.
MEDIAN, FAR, FARTHER = "median run-out", "run-out (90 %)", "run-out (95 %)"
ENERGY_RATIO = "energy (95 %) on the map, over the base"
#: More of these makes blocks go farther, more of the others less; of dp_max it is not known.
_FARTHER = ("eta_max", "restitution", "restitution_speed_mps")
#: Limits of a band.
LOW, HIGH = 0.1, 0.9
#: A class that is known of fewer sites is known weakly: a spread between two has one degree of
#: freedom.
_ENOUGH_SITES = 3
#: With fewer draws the limits of a band are hardly inside of the smallest and the largest.
_ENOUGH_DRAWS = 10
#: Values of cells that are held at a time, over all draws.
_AT_ONCE = 2**24


# ---------------------------------------------------------------------------------------------
# Variants


class Variant(NamedTuple):
    """One simulation: what differs from the run."""

    name: str
    values: Mapping[tuple[str, str], float] = {}  # by class and parameter
    seed: int | None = None  # None: that of the run


def ends_of(ranges: Sequence[ParameterRange]) -> list[Variant]:
    """Return low and high end of each range in turn, all other values as they are."""
    return [
        Variant(f"{r.label} {end}", {(r.class_name, r.parameter): value})
        for r in ranges
        for end, value in (("low", r.low), ("high", r.high))
    ]


def filling(ranges: Sequence[ParameterRange], samples: int, seed: int) -> list[Variant]:
    """Return points that fill all ranges at once (Latin hypercube)."""
    # Takes its time and memory, and a run without draws needs none of it; as below.
    from scipy.stats import qmc

    points = qmc.LatinHypercube(len(ranges), rng=np.random.default_rng(seed)).random(samples)
    return [
        Variant(
            f"sample {number}",
            {
                (r.class_name, r.parameter): r.low + float(u) * (r.high - r.low)
                for r, u in zip(ranges, row, strict=True)
            },
        )
        for number, row in enumerate(points, start=1)
    ]


def farthest(ranges: Sequence[ParameterRange]) -> Variant:
    """Return every range at the end at which blocks should go farther."""
    values = {
        (r.class_name, r.parameter): r.high if r.parameter in _FARTHER else r.low
        for r in ranges
        if r.parameter != "dp_max"
    }
    return Variant(FARTHEST, values)


def draw_of(ranges: Sequence[ParameterRange], seed: int, number: int) -> Variant:
    """Return a draw of classes: normal about their values with the spread between sites.

    Values without meaning (LIMITS) are not drawn: the distribution is truncated there. Draw
    ``number`` is a function of only the seed and the names, whatever else is drawn.
    """
    values = {}
    for r in ranges:
        group = r.together.removeprefix("-")
        word = rng.word_of(f"{r.class_name}\n{group or r.parameter}\n{bool(group)}")
        key = rng.combined(rng.combined(np.array([word]), seed), number)
        share = float(rng.shares(key)[0])
        if r.together.startswith("-"):
            share = 1.0 - share
        low, high = ((limit - r.value) / r.sd for limit in LIMITS[r.parameter])
        normal = float(ndtri(ndtr(low) + share * (ndtr(high) - ndtr(low))))
        # Where the distribution is cut, rounding may lead beyond.
        drawn = np.clip(r.value + r.sd * normal, *LIMITS[r.parameter])
        values[r.class_name, r.parameter] = float(drawn)
    return Variant(f"draw {number + 1}", values)


# ---------------------------------------------------------------------------------------------
# What a variant finds


@dataclass(frozen=True, slots=True)
class VariantFinding(RunOutcome):
    """Result of one simulation: its blocks, and its levels and places."""

    reach: IntArray  # shape (n_cells,); blocks that reach each of ``cells``
    # Shape (n_places,); cells with a hazard level, ascending, and their level; none without onset
    # frequencies.
    places: IntArray
    level: IntArray
    # Shape (n_lines,); 95 % quantile of the energy at stations and barriers (kJ); NaN where no
    # block arrives.
    line_energy_kj: FloatArray
    # Share of the blocks that arrive at each station and barrier, and at each object; the latter
    # empty where blocks are not counted at objects.
    line_share: FloatArray
    object_share: FloatArray
    # Shape (n_objects,); largest 95 % quantile of the energy on the cells of each object (kJ),
    # however few blocks arrive; NaN where none does.
    object_energy_kj: FloatArray


def finding_of(
    run: MapRun, progress: Progress, rules: Rules | None, exposed: ObjectCells | None = None
) -> VariantFinding:
    """Return the finding of a simulation, with levels if there are rules.

    ``exposed`` are cells of objects in place of those of the run, at which blocks are counted.
    """
    bins = bins_of(run)
    outcome = outcome_of(progress, bins)
    sums, lines, objects = progress.sums, progress.control_lines, exposed or run.objects
    reach = np.empty(0, np.int64)
    if sums.cells.size:
        reach = sums.column("reach")[np.argsort(sums.cells)].astype(np.int64)
    blocks = max(outcome.blocks, 1)
    hits = np.zeros(run.objects.n_objects if exposed is None else 0)
    for tally in progress.sources.values() if exposed is None else ():
        counts = tally.objects.counts()
        hits[counts.places] += counts.count[:, 0]
    at_objects = np.full(objects.n_objects, np.nan)
    rows = sums.rows_at(objects.cell)
    if (met := rows >= 0).any():
        np.fmax.at(at_objects, objects.number[met], energy_q95_kj(sums, rows[met], bins))
    places, level = np.empty(0, np.int64), np.empty(0, np.int64)
    parts: LineParts = [(1.0, lines)]
    if rules is not None:
        sampled = sampled_sources(run, progress, rules.frequencies)
        parts = line_parts(sampled)
        curves = at_energies(curves_of(sampled, bins.threshold), rules.preset.thresholds_kj)
        order = np.argsort(curves.places)
        places = curves.places[order]
        level = hazard_level(curves, rules.preset)[order].astype(np.int64)
    numbers = range(len(run.control_lines))
    energy = [weighted_distribution(parts, i, "energy_kj").quantile(0.95)[0] for i in numbers]
    return VariantFinding(
        outcome.runout, outcome.cells, outcome.energy_kj,
        reach=reach[reach > 0], places=places, level=level,
        line_energy_kj=np.array(energy, np.float64),
        line_share=np.array([lines.arrivals(i) for i in numbers], np.float64) / blocks,
        object_share=hits / blocks, object_energy_kj=at_objects,
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------
# The table of answers


#: Names to the numbers of findings: of levels, of stations and barriers, of exposed objects.
Names = tuple[Sequence[str], Sequence[str], Sequence[str]]


class Answers(NamedTuple):
    """Answers of simulations, the base first: a row for each, a column for each measure."""

    variants: tuple[Variant, ...]
    units: Mapping[str, str]  # of each measure, by its name
    values: FloatArray  # shape (n_variants, n_measures)


def answers(
    base: VariantFinding,
    simulations: Iterable[tuple[Variant, VariantFinding]],
    names: Names,
    cell_m2: float,
) -> Answers:
    """Put together what the base and the ``simulations`` say."""
    variants = [Variant(BASE)]
    rows = [_measures(base, base, names, cell_m2)]
    for variant, finding in simulations:
        variants.append(variant)
        rows.append(_measures(base, finding, names, cell_m2))
    values = np.array([[value for _, value in row.values()] for row in rows], np.float64)
    return Answers(tuple(variants), {name: unit for name, (unit, _) in rows[0].items()}, values)


def _measures(
    base: VariantFinding, own: VariantFinding, names: Names, cell_m2: float
) -> dict[str, tuple[str, float]]:
    """Return the unit and value of each measure."""
    middle, far, farther = own.runout_m(0.5, 0.9, 0.95)
    out = {
        MEDIAN: ("m", middle),
        FAR: ("m", far),
        FARTHER: ("m", farther),
        "reached area": ("m²", own.cells.size * cell_m2),
        ENERGY_RATIO: ("1", response(base, own)["energy_q95"].value + 1.0),
    }
    levels, lines, objects = names
    for code, name in enumerate(levels, start=1):
        area = int((own.level == code).sum()) * cell_m2
        out[phrase("area of level {}", phrase(name))] = ("m²", area)
    energy, share = "energy (95 %) at {}", "share of blocks that reach {}"
    for i, name in enumerate(lines):
        out[phrase(energy, name)] = ("kJ", own.line_energy_kj[i])
        out[phrase(share, name)] = ("1", own.line_share[i])
    if own.object_energy_kj.size:
        for name, value in zip(objects, own.object_energy_kj, strict=True):
            out[phrase(energy, name)] = ("kJ", value)
    if own.object_share.size:
        for name, value in zip(objects, own.object_share, strict=True):
            out[phrase(share, name)] = ("1", value)
    return out


@dataclass(frozen=True, slots=True)
class RangeEffect:
    """Effect of the range of one parameter on one measure."""

    range: ParameterRange
    measure: str
    unit: str
    # With the values of the classes, at the two ends of the range, and with another seed.
    base: float
    low: float
    high: float
    chance: float
    # Rank correlation of parameter and measure over the sample that fills all ranges.
    correlation: float

    @property
    def largest_change(self) -> float:
        """Larger change from the base of the two, as a share of it; NaN where that is 0."""
        if not self.base > 0.0:
            return float("nan")
        return float(max(abs(self.low / self.base - 1.0), abs(self.high / self.base - 1.0)))

    @property
    def beyond_chance(self) -> bool:
        """Whether an end changes more than twice what another seed does."""
        change = max(abs(self.low - self.base), abs(self.high - self.base))
        return bool(change > 2.0 * abs(self.chance - self.base))


def parts_of_design(rows: Any, n_ranges: int) -> tuple[Any, Any, Any, Any]:
    """Return base, another seed, ends and filling from the rows of a sensitivity, in its order."""
    last = 3 + 2 * n_ranges
    return rows[0], rows[1], rows[3:last], rows[last:]


def effects(ranges: Sequence[ParameterRange], table: Answers) -> list[RangeEffect]:
    """Compute the effect of each range on each measure from the answers of a sensitivity."""
    base, chance, ends, filled = parts_of_design(table.values, len(ranges))
    *_, points = parts_of_design(table.variants, len(ranges))
    out = []
    for i, r in enumerate(ranges):
        drawn = np.array([point.values[r.class_name, r.parameter] for point in points])
        for j, (measure, unit) in enumerate(table.units.items()):
            low, high = ends[2 * i : 2 * i + 2, j]
            correlation = _rank_correlation(drawn, filled[:, j])
            numbers = map(float, (base[j], low, high, chance[j], correlation))
            out.append(RangeEffect(r, measure, unit, *numbers))
    return out


def _rank_correlation(x: FloatArray, y: FloatArray) -> float:
    """Compute Spearman's correlation; NaN for few points or where one of the two is constant."""
    known = np.isfinite(y)
    if known.sum() < 3 or np.ptp(x[known]) == 0.0 or np.ptp(y[known]) == 0.0:
        return float("nan")
    from scipy.stats import rankdata

    return float(np.corrcoef(rankdata(x[known]), rankdata(y[known]))[0, 1])


@dataclass(frozen=True, slots=True)
class SpreadBand:
    """A measure of the result: with the values of the classes, and over the draws."""

    measure: str
    unit: str
    base: float
    low: float  # 10 % quantile
    middle: float
    high: float  # 90 % quantile


def spread_bands(table: Answers) -> tuple[SpreadBand, ...]:
    """Return bands of all measures over the draws; an energy where no block arrives is 0."""
    bands = []
    for (measure, unit), column in zip(table.units.items(), table.values.T, strict=True):
        base, *drawn = np.nan_to_num(column) if unit == "kJ" else column
        known = np.array(drawn)[np.isfinite(drawn)]
        limits = np.quantile(known, (LOW, 0.5, HIGH)) if known.size else np.full(3, np.nan)
        bands.append(SpreadBand(measure, unit, *map(float, (base, *limits))))
    return tuple(bands)


# ---------------------------------------------------------------------------------------------
# Maps


def _on_cells(
    findings: Iterable[VariantFinding],
    cells: IntArray,
    of: Callable[[VariantFinding], tuple[IntArray, NDArray[Any]]],
    kind: type = float,
    empty: float = 0,
) -> NDArray[Any]:
    """Return the values of findings in cells, shape (n_findings, n_cells); ``empty`` where none."""
    rows: list[NDArray[Any]] = []
    for finding in findings:
        places, values = of(finding)
        _, at, own = np.intersect1d(cells, places, assume_unique=True, return_indices=True)
        rows.append(np.full(cells.size, empty, kind))
        rows[-1][at] = values[own]
    return np.array(rows, kind).reshape(-1, cells.size)


def _level(found: VariantFinding) -> tuple[IntArray, NDArray[Any]]:
    return found.places, found.level


def _share(found: VariantFinding) -> tuple[IntArray, NDArray[Any]]:
    return found.cells, found.reach / max(found.blocks, 1)


#: Flat indices of all cells that any simulation reaches, ascending; in their order bands of maps,
#: by the stem of the map and the name of the band.
CellMaps = tuple[IntArray, Mapping[str, Mapping[str, NDArray[Any]]]]


def sensitivity_maps(findings: Sequence[VariantFinding], n_ranges: int) -> CellMaps:
    """Return maps of what the simulations of a sensitivity say together.

    Shares are those of the sample that fills all ranges; the lowest and the highest level are those
    over sample and ends. ``strongest`` is the position of the range whose ends change the energy
    most, plus 1; 0 where none does more than another seed, or where too few blocks arrive.
    """
    base, chance, ends, filled = parts_of_design(findings, n_ranges)
    shown = [base, *ends, *filled]
    cells = np.unique(np.concatenate([p for f in shown for p in (f.cells, f.places)]))
    first = 1 + len(ends)  # of the sample
    count = max(len(filled), 1)
    level = _on_cells(shown, cells, _level, np.int64)
    reached = _on_cells(shown, cells, _share) > 0.0
    energy = _on_cells(
        [*shown, chance], cells, lambda found: (found.cells, found.energy_kj), empty=np.nan
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.log(energy / energy[0])
    change[~np.isfinite(change)] = np.nan
    low, middle, high = _energy_ratios(change[first:-1].astype(np.float32))
    return cells, {
        "level_could_be": {
            "highest": level.max(axis=0), "base": level[0], "lowest": level.min(axis=0)
        },
        "level_higher": {
            "higher": (level[first:] > level[0]).sum(axis=0) / count,
            "lower": (level[first:] < level[0]).sum(axis=0) / count,
        },
        "reach_share": {"share": reached[first:].sum(axis=0) / count, "base": reached[0]},
        "energy_ratio": {"q90": high, "q50": middle, "q10": low},
        "strongest_parameter": {"strongest": _strongest(change[1:first], change[-1])},
    }  # fmt: skip


def _energy_ratios(change: FloatArray) -> FloatArray:
    """Return quantiles of 10, 50 and 90 %; NaN where half of the rows or more are unknown."""
    out = np.full((3, change.shape[1]), np.nan)
    enough = np.isfinite(change).sum(axis=0) >= 0.5 * len(change)
    if len(change):
        out[:, enough] = np.exp(np.nanquantile(change[:, enough], (0.1, 0.5, 0.9), axis=0))
    return out


def _strongest(change: FloatArray, chance: FloatArray) -> IntArray:
    noise = np.abs(chance[np.isfinite(chance)])
    limit = float(np.quantile(noise, 0.95)) if noise.size else np.inf
    size = np.nan_to_num(np.abs(change))
    which: IntArray = np.where(size.max(axis=0) > limit, size.argmax(axis=0) // 2 + 1, 0)
    return which


#: Gives the findings of all draws, in their order, as often as it is called: of a large map not all
#: can be held at a time.
Draws = Callable[[], Iterable[VariantFinding]]


def spread_maps(base: VariantFinding, draws: Draws, at_once: int = _AT_ONCE) -> CellMaps:
    """Map the base's level, and limits of the bands by cell, a part of the cells at a time.

    A level is no number between two: its limits are those of the draws next to the quantile, to the
    outer side.
    """
    cells, count = np.union1d(base.cells, base.places), 0
    for own in draws():
        cells, count = np.union1d(cells, np.union1d(own.cells, own.places)), count + 1
    limits = []
    # One part at least.
    borders = [*range(0, max(cells.size, 1), max(at_once // count, 1)), cells.size]
    for part in (cells[first:last] for first, last in pairwise(borders)):
        reach = _on_cells(draws(), part, _share, np.float32).astype(np.float64)
        level = _on_cells(draws(), part, _level, np.int8)
        low = np.quantile(level, LOW, axis=0, method="lower")
        high = np.quantile(level, HIGH, axis=0, method="higher")
        limits.append((*np.quantile(reach, (LOW, HIGH), axis=0), low, high))
    reach_low, reach_high, *levels = (np.concatenate(own) for own in zip(*limits, strict=True))
    low, high = (own.astype(np.int64) for own in levels)
    (level,) = _on_cells([base], cells, _level, np.int64)
    return cells, {
        "ground_level": {"base": level, "low": low, "high": high},
        "ground_reach": {"low": reach_low, "high": reach_high},
    }


# ---------------------------------------------------------------------------------------------
# The spread of a result


def level_areas(maps: CellMaps, cell_m2: float) -> dict[str, float]:
    """Return areas by what may become of the hazard level (m²).

    These are the ``zoned`` cells with a level; those of them whose level is ``higher`` or ``lower``
    at a limit of the band; and those ``beyond``, which have one only at the upper limit.
    """
    level, low, high = (maps[1]["ground_level"][name] for name in ("base", "low", "high"))
    zoned, higher = level > 0, high > level
    which = {
        "zoned": zoned, "higher": zoned & higher, "lower": low < level, "beyond": ~zoned & higher
    }  # fmt: skip
    return {name: float(cells.sum()) * cell_m2 for name, cells in which.items()}


@dataclass(frozen=True, slots=True)
class GroundSpread:
    """Bands of a result by the spread of its ground classes."""

    draws: int
    # Drawn values of the classes that blocks meet in any simulation.
    ranges: tuple[ParameterRange, ...]
    bands: tuple[SpreadBand, ...]
    areas: Mapping[str, float] | None  # from level_areas; None without hazard levels

    def band(self, measure: str) -> SpreadBand:
        """Return the band of a measure by its name."""
        return next(b for b in self.bands if b.measure == measure)

    @property
    def assumed(self) -> int:
        """Drawn values of which no site is known."""
        return sum(r.sites == 0 for r in self.ranges)

    @property
    def weak(self) -> int:
        """Drawn values that are known of few sites."""
        return sum(0 < r.sites < _ENOUGH_SITES for r in self.ranges)

    @property
    def few_draws(self) -> bool:
        """Whether the limits of the bands are hardly more than extremes."""
        return self.draws < _ENOUGH_DRAWS
