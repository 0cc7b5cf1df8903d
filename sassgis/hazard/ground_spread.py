"""What the spread of ground classes between sites does to a result: draws of classes, and bands.

All draws release the same blocks with the same random draws as the run with the values of the
classes: what differs is the ground. A band is the middle 80 % of the draws.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from sassgis.hazard.sensitivity import Names, Variant, VariantFinding, measures, on_cells
from sassgis.model import rng
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.ground import LIMITS
from sassgis.model.ground_ranges import ParameterRange

#: Limits of a band.
LOW, HIGH = 0.1, 0.9
#: A class that is known of fewer sites is told weakly: a spread between two has one degree of
#: freedom.
_ENOUGH_SITES = 3
#: With fewer draws the limits of a band are hardly inside of the smallest and the largest.
_ENOUGH_DRAWS = 10
#: Values of cells that are held at a time, over all draws.
_AT_ONCE = 2**24


def draw_of(ranges: Sequence[ParameterRange], seed: int, number: int) -> Variant:
    """A draw of classes: normal about their values with the spread between sites.

    Values without meaning (LIMITS) are not drawn: the distribution is truncated there. Draw
    ``number`` is a function of the seed and the names alone, whatever else is drawn.
    """
    values = {}
    for r in ranges:
        group = r.together.removeprefix("-")
        word = rng.word_of(f"{r.class_name}\n{group or r.parameter}\n{bool(group)}")
        key = np.array([word])
        share = float(rng.shares(rng.combined(rng.combined(key, seed), number))[0])
        if r.together.startswith("-"):
            share = 1.0 - share
        low, high = ((limit - r.value) / r.sd for limit in LIMITS[r.parameter])
        normal = float(ndtri(ndtr(low) + share * (ndtr(high) - ndtr(low))))
        # Where the distribution is cut, rounding may lead beyond.
        drawn = np.clip(r.value + r.sd * normal, *LIMITS[r.parameter])
        values[r.class_name, r.parameter] = float(drawn)
    return Variant(f"draw {number + 1}", values)


@dataclass(frozen=True, slots=True)
class SpreadBand:
    """A measure of the result: with the values of the classes, and over the draws."""

    measure: str
    unit: str
    base: float
    low: float  # 10 % quantile
    middle: float
    high: float  # 90 % quantile


@dataclass(frozen=True, slots=True)
class SpreadMaps:
    """What the cells say; all arrays in the order of ``cells``, limits are those of the band."""

    cells: IntArray  # flat indices of all cells that any simulation reaches, ascending
    reach_low: FloatArray  # reach probability
    reach_high: FloatArray
    level: IntArray  # with the values of the classes; 0: none
    level_low: IntArray
    level_high: IntArray


@dataclass(frozen=True, slots=True)
class LevelAreas:
    """Cells by what may become of their level (m²)."""

    zoned: float  # those with a level
    higher: float  # of them, at the upper limit of the band
    lower: float  # of them, at the lower limit
    beyond: float  # those without one that have one at the upper limit


@dataclass(frozen=True, slots=True)
class GroundSpread:
    """Bands of a result by the spread of its ground classes."""

    draws: int
    # Drawn values of the classes that blocks meet in any simulation.
    ranges: tuple[ParameterRange, ...]
    bands: tuple[SpreadBand, ...]
    areas: LevelAreas | None  # None without hazard levels

    def band(self, measure: str) -> SpreadBand:
        """The band of a measure by its name."""
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


#: Gives the findings of all draws, in their order, as often as it is called.
Draws = Callable[[], Iterable[VariantFinding]]


def spread_bands(
    base: VariantFinding, draws: Draws, names: Names, cell_m2: float
) -> tuple[SpreadBand, ...]:
    """Bands of all measures; an energy where no block arrives is 0."""
    found = [measures(base, own, names, cell_m2) for own in draws()]
    bands = []
    for measure, (unit, value) in measures(base, base, names, cell_m2).items():
        values = np.array([value, *(own[measure][1] for own in found)])
        if unit == "kJ":
            values = np.nan_to_num(values)
        known = values[1:][np.isfinite(values[1:])]
        low, middle, high = (
            np.quantile(known, (LOW, 0.5, HIGH)) if known.size else np.full(3, np.nan)
        )
        bands.append(
            SpreadBand(measure, unit, float(values[0]), float(low), float(middle), float(high))
        )
    return tuple(bands)


def spread_maps(base: VariantFinding, draws: Draws, at_once: int = _AT_ONCE) -> SpreadMaps:
    """Limits of the bands cell by cell, a part of the cells at a time.

    A level is no number between two: its limits are those of the draws next to the quantile, to the
    outer side.
    """
    cells, count = np.union1d(base.cells, base.places), 0
    for own in draws():
        cells, count = np.union1d(cells, np.union1d(own.cells, own.places)), count + 1
    level = on_cells(base.level, base.places, cells, 0)
    parts = [_limits(draws, count, part) for part in _parts(cells, max(at_once // count, 1))]
    reach, levels = (np.concatenate(own, axis=1) for own in zip(*parts, strict=True))
    return SpreadMaps(cells, reach[0], reach[1], level, levels[0], levels[1])


def _parts(cells: IntArray, size: int) -> Iterator[IntArray]:
    """The cells in parts of a size; one part at least."""
    limits = [*range(0, max(cells.size, 1), size), cells.size]
    return (cells[first:last] for first, last in pairwise(limits))


def _limits(draws: Draws, count: int, cells: IntArray) -> tuple[FloatArray, IntArray]:
    """Limits of reach probability and level on some cells; shapes (2, n)."""
    reach, level = np.zeros((count, cells.size), np.float32), np.zeros((count, cells.size), np.int8)
    for k, own in enumerate(draws()):
        share = own.reach / max(own.blocks, 1)
        for values, places, rows in ((share, own.cells, reach), (own.level, own.places, level)):
            rows[k] = on_cells(values, places, cells, 0)
    shares = np.quantile(reach.astype(np.float64), (LOW, HIGH), axis=0)
    low = np.quantile(level, LOW, axis=0, method="lower")
    high = np.quantile(level, HIGH, axis=0, method="higher")
    return shares, np.array([low, high], np.int64)


def level_areas(maps: SpreadMaps, cell_m2: float) -> LevelAreas:
    """Areas by what may become of the level."""

    def area(which: NDArray[np.bool_]) -> float:
        return float(which.sum()) * cell_m2

    zoned, higher = maps.level > 0, maps.level_high > maps.level
    return LevelAreas(
        area(zoned), area(zoned & higher), area(maps.level_low < maps.level), area(~zoned & higher)
    )
