"""How levels, reach and energy change within the ranges of the ground classes.

All simulations release the same blocks with the same random draws. The base has the values of the
classes. Each range is tried alone at its low and its high end; a sample of points that fill all
ranges at once says what they do together. A repetition of the base with another seed says what is
chance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc, rankdata

from sassgis.hazard.assess import Rules, curves_of
from sassgis.hazard.bins import bins_of
from sassgis.hazard.curves import at_energies
from sassgis.hazard.levels import hazard_level
from sassgis.hazard.progress import Progress
from sassgis.hazard.response import RunOutcome, energy_q95_kj, outcome_of, response
from sassgis.hazard.sources import sampled_sources
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.ground_ranges import ParameterRange
from sassgis.model.languages import phrase
from sassgis.model.map_run import MapRun, ObjectCells
from sassgis.model.statistics_table import Bins

#: Names of the simulations that are no points of the sample and no ends of a range.
BASE, CHANCE, FARTHEST = "base", "another seed", "all for the longest run-out"
#: Names of two measures: quantiles of the run-out.
MEDIAN, FAR = "median run-out", "run-out (90 %)"
#: More of these makes blocks go farther, more of the others less; of dp_max it is not known.
_FARTHER = ("eta_max", "restitution", "restitution_speed_mps")


@dataclass(frozen=True, slots=True)
class Variant:
    """One simulation of the design."""

    name: str
    # What differs from the classes of the run, by class and parameter.
    values: dict[tuple[str, str], float]


def design(
    ranges: Sequence[ParameterRange], samples: int, seed: int
) -> tuple[tuple[Variant, ...], tuple[Variant, ...]]:
    """The two ends of each range alone, and points that fill all ranges (Latin hypercube).

    Returns
    -------
    ends : tuple of Variant
        Low and high end of each range in turn.
    """
    ends = tuple(
        Variant(f"{r.label} {end}", {(r.class_name, r.parameter): value})
        for r in ranges
        for end, value in (("low", r.low), ("high", r.high))
    )
    if not ranges:
        return ends, ()
    points = qmc.LatinHypercube(len(ranges), rng=np.random.default_rng(seed)).random(samples)
    filling = tuple(
        Variant(
            f"sample {i + 1}",
            {
                (r.class_name, r.parameter): r.low + float(u) * (r.high - r.low)
                for r, u in zip(ranges, row, strict=True)
            },
        )
        for i, row in enumerate(points)
    )
    return ends, filling


def farthest(ranges: Sequence[ParameterRange]) -> Variant:
    """Every range at the end at which blocks should go farther."""
    return Variant(
        FARTHEST,
        {
            (r.class_name, r.parameter): r.high if r.parameter in _FARTHER else r.low
            for r in ranges
            if r.parameter != "dp_max"
        },
    )


@dataclass(frozen=True, slots=True)
class VariantFinding(RunOutcome):
    """What one simulation found: what its blocks did, and what it says of levels and places."""

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
    # Shape (n_objects,); largest 95 % quantile of the energy on the cells of each object (kJ); NaN
    # where no block arrives.
    object_energy_kj: FloatArray

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """As plain arrays, to be saved."""
        return {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]]) -> VariantFinding:
        """What ``arrays`` gave."""
        given = {f.name: arrays[f.name] for f in fields(cls)}
        return cls(**(given | {"blocks": int(arrays["blocks"])}))  # type: ignore[arg-type]


def finding_of(
    run: MapRun, progress: Progress, rules: Rules | None, exposed: ObjectCells | None = None
) -> VariantFinding:
    """What a simulation says, with levels if there are rules.

    ``exposed`` are cells of objects in place of those of the run, at which blocks are counted.
    """
    bins = bins_of(run)
    outcome = outcome_of(progress, bins)
    cells, reach = progress.sums.cells, np.empty(0, np.int64)
    if cells.size:
        reach = progress.sums.column("reach")[np.argsort(cells)].astype(np.int64)
    blocks = max(outcome.blocks, 1)
    lines = progress.control_lines
    n_lines = len(run.control_lines)
    energy = [float(lines.distribution(i, "energy_kj").quantile(0.95)[0]) for i in range(n_lines)]
    hits = np.zeros(run.objects.n_objects if exposed is None else 0)
    for tally in progress.sources.values() if exposed is None else ():
        counts = tally.objects.counts()
        hits[counts.places] += counts.count[:, 0]
    places, level = np.empty(0, np.int64), np.empty(0, np.int64)
    if rules is not None:
        sampled = sampled_sources(run, progress, rules.frequencies)
        curves = at_energies(curves_of(sampled, bins.threshold), rules.preset.thresholds_kj)
        order = np.argsort(curves.places)
        places = curves.places[order]
        level = hazard_level(curves, rules.preset)[order].astype(np.int64)
    return VariantFinding(
        **{f.name: getattr(outcome, f.name) for f in fields(outcome)},
        reach=reach[reach > 0],
        places=places,
        level=level,
        line_energy_kj=np.array(energy, np.float64),
        line_share=np.array([lines.arrivals(i) for i in range(n_lines)], np.float64) / blocks,
        object_share=hits / blocks,
        object_energy_kj=_object_energy_kj(progress, bins, exposed or run.objects),
    )


def _object_energy_kj(progress: Progress, bins: Bins, exposed: ObjectCells) -> FloatArray:
    """As in VariantFinding: what the map of the energy shows, however few blocks arrive."""
    own = np.full(exposed.n_objects, np.nan)
    rows = progress.sums.rows_at(exposed.cell)
    if (reached := rows >= 0).any():
        energy = energy_q95_kj(progress.sums, rows[reached], bins)
        np.fmax.at(own, exposed.number[reached], energy)
    return own


@dataclass(frozen=True, slots=True)
class RangeEffect:
    """What the range of one parameter does to one measure."""

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


@dataclass(frozen=True, slots=True)
class Names:
    """What the numbers of findings belong to: levels, stations and barriers, exposed objects."""

    levels: tuple[str, ...]
    lines: tuple[str, ...]
    objects: tuple[str, ...]


def measures(
    base: VariantFinding, finding: VariantFinding, names: Names, cell_m2: float
) -> dict[str, tuple[str, float]]:
    """Numbers that are compared: name, unit and value.

    The energy on the map is the median ratio to the base over the cells that enough blocks reach.
    """
    middle, far, farther = finding.runout_m(0.5, 0.9, 0.95)
    ratio = response(base, finding)["energy_q95"].value + 1.0
    out = {
        MEDIAN: ("m", float(middle)),
        FAR: ("m", float(far)),
        "run-out (95 %)": ("m", float(farther)),
        "reached area": ("m²", finding.cells.size * cell_m2),
        "energy (95 %) on the map, over the base": ("1", ratio),
    }
    for code, name in enumerate(names.levels, start=1):
        area = int((finding.level == code).sum()) * cell_m2
        out[phrase("area of level {}", phrase(name))] = ("m²", area)
    for name, energy, share in zip(
        names.lines, finding.line_energy_kj, finding.line_share, strict=True
    ):
        out[phrase("energy (95 %) at {}", name)] = ("kJ", float(energy))
        out[phrase("share of blocks that reach {}", name)] = ("1", float(share))
    for name, energy in zip(names.objects, finding.object_energy_kj, strict=True):
        out[phrase("energy (95 %) at {}", name)] = ("kJ", float(energy))
    if finding.object_share.size:
        for name, share in zip(names.objects, finding.object_share, strict=True):
            out[phrase("share of blocks that reach {}", name)] = ("1", float(share))
    return out


def effects(
    ranges: Sequence[ParameterRange],
    base: VariantFinding,
    chance: VariantFinding,
    ends: Sequence[VariantFinding],
    filling: Sequence[tuple[Variant, VariantFinding]],
    names: Names,
    cell_m2: float,
) -> list[RangeEffect]:
    """What each range does to each measure; ``ends`` as design gave them."""

    def of(finding: VariantFinding) -> dict[str, tuple[str, float]]:
        return measures(base, finding, names, cell_m2)

    before, other = of(base), of(chance)
    at_ends = [of(f) for f in ends]
    sampled = [of(f) for _, f in filling]
    out = []
    for i, r in enumerate(ranges):
        key = (r.class_name, r.parameter)
        drawn = np.array([v.values[key] for v, _ in filling])
        for measure, (unit, value) in before.items():
            values = np.array([s[measure][1] for s in sampled])
            out.append(
                RangeEffect(
                    r, measure, unit, value, at_ends[2 * i][measure][1],
                    at_ends[2 * i + 1][measure][1], other[measure][1],
                    _rank_correlation(drawn, values),
                )
            )  # fmt: skip
    return out


def _rank_correlation(x: FloatArray, y: FloatArray) -> float:
    """Spearman's; NaN for few points or where one of the two does not change."""
    known = np.isfinite(y)
    if known.sum() < 3 or np.ptp(x[known]) == 0.0 or np.ptp(y[known]) == 0.0:
        return float("nan")
    return float(np.corrcoef(rankdata(x[known]), rankdata(y[known]))[0, 1])


@dataclass(frozen=True, slots=True)
class SensitivityMaps:
    """What the cells say; all arrays in the order of ``cells``."""

    cells: IntArray  # flat indices of all cells that any simulation reaches, ascending
    reached: FloatArray  # share of the sample in which blocks reach the cell
    reached_base: NDArray[np.bool_]
    # In the base, and over the sample and the ends; 0: none.
    level: IntArray
    level_lowest: IntArray
    level_highest: IntArray
    # Share of the sample with a higher and with a lower level than the base.
    higher: FloatArray
    lower: FloatArray
    # Shape (3, n); quantiles 10, 50 and 90 % of the energy (95 %) over that of the base, over the
    # sample; NaN where too few blocks reach the cell in half of it.
    energy_ratio: FloatArray
    # Position of the range whose ends change the energy most, plus 1; 0 where none does more than
    # another seed, or where too few blocks arrive.
    strongest: IntArray


def sensitivity_maps(
    base: VariantFinding,
    chance: VariantFinding,
    ends: Sequence[VariantFinding],
    filling: Sequence[VariantFinding],
) -> SensitivityMaps:
    """Maps of what the simulations of a design say together."""
    everything = [base, *ends, *filling]
    cells = np.unique(np.concatenate([p for f in everything for p in (f.cells, f.places)]))
    levels = [on_cells(f.level, f.places, cells, 0) for f in everything]
    level = levels[0]
    of_sample = np.array(levels[1 + len(ends) :]).reshape(len(filling), cells.size)
    count = max(len(filling), 1)
    reached = np.zeros(cells.size)
    for f in filling:
        reached[np.searchsorted(cells, f.cells)] += 1.0
    return SensitivityMaps(
        cells,
        reached / count,
        np.isin(cells, base.cells),
        level,
        np.min(levels, axis=0),
        np.max(levels, axis=0),
        (of_sample > level).sum(axis=0) / count,
        (of_sample < level).sum(axis=0) / count,
        _energy_ratios(base, filling, cells),
        _strongest(base, chance, ends, cells),
    )


def on_cells(values: NDArray[Any], places: IntArray, cells: IntArray, empty: float) -> NDArray[Any]:
    """Values of some places on others; ``empty`` where they have none."""
    out = np.full(cells.size, empty, values.dtype)
    both, at, own = np.intersect1d(cells, places, assume_unique=True, return_indices=True)
    if both.size:
        out[at] = values[own]
    return out


def _log_ratio(base: VariantFinding, other: VariantFinding, cells: IntArray) -> FloatArray:
    """Logarithm of the ratio of the energies; NaN where too few blocks arrive in one of them."""
    before, after = (on_cells(f.energy_kj, f.cells, cells, np.nan) for f in (base, other))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio: FloatArray = np.log(after / before)
    return np.where(np.isfinite(ratio), ratio, np.nan)


def _energy_ratios(
    base: VariantFinding, filling: Sequence[VariantFinding], cells: IntArray
) -> FloatArray:
    out = np.full((3, cells.size), np.nan)
    if not filling:
        return out
    ratios = np.array([_log_ratio(base, f, cells).astype(np.float32) for f in filling])
    enough = np.isfinite(ratios).sum(axis=0) >= 0.5 * len(filling)
    out[:, enough] = np.exp(np.nanquantile(ratios[:, enough], (0.1, 0.5, 0.9), axis=0))
    return out


def _strongest(
    base: VariantFinding, chance: VariantFinding, ends: Sequence[VariantFinding], cells: IntArray
) -> IntArray:
    best = np.zeros(cells.size)
    which = np.zeros(cells.size, np.int64)
    for i, finding in enumerate(ends):
        change = np.nan_to_num(np.abs(_log_ratio(base, finding, cells)))
        which = np.where(change > best, i // 2 + 1, which)
        best = np.maximum(best, change)
    noise = np.abs(_log_ratio(base, chance, cells))
    noise = noise[np.isfinite(noise)]
    limit = float(np.quantile(noise, 0.95)) if noise.size else np.inf
    return np.where(best > limit, which, 0)
