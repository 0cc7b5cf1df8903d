"""The table of the statistics per cell: one row for each map of the simulated blocks.

All that is kept for the maps follows from the rows: the sums in the kernel, how those of chunks,
release areas and saved states are joined, the bands of each raster, and the tables in docs/maps.md.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.map_run import MapRun
from sassgis.settings.settings import ENERGY_CLASSES_KJ, EngineSettings

#: What the kernel records of each block in each cell that it enters, in the order of its columns:
#: largest kinetic energy (kJ), passing height (m) and speed (m/s) there, and the time since the
#: release at which it first enters (s). A block and its fragments are one entry.
QUANTITIES = ("energy", "height", "speed", "arrival")

#: Probabilities of the quantiles that are mapped, but for times.
PROBABILITIES = (0.50, 0.90, 0.95, 0.99)
#: Of fewer blocks none is expected beyond the quantile that is shown, and it is one of them.
FEW_BLOCKS = 20

Reducer = Literal["count", "sum", "max", "min", "histogram"]

#: What makes one of the sums of two parts, and the type of their array.
_REDUCERS: dict[Reducer, tuple[np.ufunc, type[np.generic]]] = {
    "count": (np.add, np.int64),
    "sum": (np.add, np.int64),
    "max": (np.maximum, np.float64),
    "min": (np.minimum, np.float64),
    "histogram": (np.add, np.uint32),
}


@dataclass(frozen=True, slots=True)
class CellSum:
    """Sum of one quantity in each cell.

    Whole numbers and extremes only, so that the order of adding does not matter.
    """

    name: str
    reducer: Reducer  # "sum" is in thousandths of the quantity's unit, rounded for each block
    quantity: str = ""  # one of QUANTITIES; empty for counts

    @property
    def join(self) -> np.ufunc:
        """Function that joins the sums of two parts."""
        return _REDUCERS[self.reducer][0]

    @property
    def dtype(self) -> type[np.generic]:
        """Type of its array."""
        return _REDUCERS[self.reducer][1]

    @property
    def empty(self) -> float:
        """Value where no block arrives."""
        return np.inf if self.reducer == "min" else 0.0


@dataclass(frozen=True, slots=True)
class Statistic:
    """A row of the table: one map."""

    stem: str  # file name without suffix
    title: str  # name in the legend: quantity, what the first band is, unit
    # Of the bands; the quantity in words.
    unit: str
    label: str
    # The first is the one shown. With a quantity: "q95" (any per cent), "mean", "max", "min";
    # without: "reach", "standard_error", "lower", "upper", "passages", "stops".
    bands: tuple[str, ...]
    # What the numbers mean. ``{rocks}``, ``{width}``, ``{once}``, ``{error}``, ``{few}`` and
    # ``{late}`` are filled in.
    note: str
    meaning: str  # what one number means, for the table of maps in docs/maps.md
    # Class limits for the legend. They start at 0, as nothing that is mapped is negative: no class
    # without cells, and not the palest colour of a ramp, which would be lost on the relief.
    breaks: tuple[float, ...]
    ramp: str  # name of a matplotlib colour map
    quantity: str = ""  # one of QUANTITIES; empty for counts of blocks
    # Edges of the histogram on a terrain, from the value that no block exceeds there. Those of a
    # larger terrain begin with those of a smaller one.
    edges: Callable[[float], FloatArray] | None = None
    # The same for the table of resolutions in docs/maps.md.
    bins: str = ""
    resolution: str = ""

    def description(self, band: str) -> str:
        """Return a band in words."""
        short = self.title.split(",")[0]
        if probability_of(band) is not None:
            return f"{self.label}, {band[1:]} % quantile of the blocks that reach the cell"
        return {
            "mean": f"{short}, mean of the blocks",
            "max": f"{short}, largest",
            "min": f"{short}, smallest",
            "standard_error": f"Sampling standard error of the {self.label.lower()}",
            "lower": f"Lower limit of the {self.label.lower()} by the sampling (95 %)",
            "upper": f"Upper limit of the {self.label.lower()} by the sampling (95 %)",
        }.get(band, self.label)

    def sums(self) -> tuple[CellSum, ...]:
        """Return the sums from which its bands are made."""
        return tuple(s for band in self.bands for s in self._sums_of(band))

    def _sums_of(self, band: str) -> tuple[CellSum, ...]:
        if probability_of(band) is not None:
            return (CellSum(self.quantity, "histogram", self.quantity),)
        reducers: dict[str, Reducer] = {"mean": "sum", "max": "max", "min": "min"}
        if band in reducers:
            own = reducers[band]
            return (CellSum(f"{self.quantity}_{own}", own, self.quantity),)
        if band == "stops":
            return (CellSum("stops", "count"),)
        squares = band in ("standard_error", "lower", "upper")
        return tuple(CellSum(n, "count") for n in ("reach", *["reach_square"] * squares))


def probability_of(band: str) -> float | None:
    """Return the probability of a quantile's band, as 0.95 for "q95"; None for any other band."""
    return int(band[1:]) / 100 if band[0] == "q" and band[1:].isdigit() else None


def _energy_steps(largest_kj: float) -> int:
    return max(int(np.ceil(20.0 * np.log10(max(largest_kj, 1.0) / 30.0))), 20)


def _energy_edges(largest_kj: float) -> FloatArray:
    steps = np.arange(-60, _energy_steps(largest_kj) + 1)
    return np.concatenate([[0.0], 30.0 * 10.0 ** (steps / 20.0)])


def _height_edges(largest_m: float) -> FloatArray:
    steps = max(int(np.ceil(np.log(max(largest_m, 4.0) / 2.0) / np.log(1.06))), 1)
    return np.concatenate([np.arange(0.0, 2.0, 0.1), 2.0 * 1.06 ** np.arange(steps + 1)])


def _speed_edges(largest_mps: float) -> FloatArray:
    fast = np.arange(20.0, max(largest_mps, 22.0) + 1.0, 1.0)
    return np.concatenate([np.arange(0.0, 20.0, 0.5), fast])


def _arrival_edges(_: float) -> FloatArray:
    """Return edges up to half an hour (s)."""
    steps = int(np.ceil(np.log(180.0) / np.log(1.05)))
    return np.concatenate([np.arange(0.0, 10.0, 0.5), 10.0 * 1.05 ** np.arange(steps + 1)])


#: Classes of maps of energies (kJ), and their colours.
ENERGY_BREAKS, ENERGY_RAMP = (0.0, *ENERGY_CLASSES_KJ), "YlOrRdBk"

STATISTICS = (
    Statistic(
        stem="reach_probability", title="Reach probability", unit="1", label="Reach probability",
        bands=("reach", "standard_error", "lower", "upper"),
        note="Of the {rocks} blocks that started, the share that reaches the cell. {width} {error} "
        "The limits are those of the gamma interval of weighted counts.",
        meaning="share of the simulated blocks that started that reach the cell",
        breaks=(0.0, 0.0001, 0.001, 0.01, 0.03, 0.1, 0.3), ramp="plasma_r",
    ),
    Statistic(
        stem="passages", title="Arriving blocks", unit="blocks", label="Blocks that reach the cell",
        bands=("passages",), note="Number of blocks that reach the cell. {width}",
        meaning="number of blocks that reach the cell", breaks=(0, 10, 100, 1000, 10000),
        ramp="BuPu",
    ),
    Statistic(
        stem="energy", title="Kinetic energy, 95 % quantile (kJ)", quantity="energy", unit="kJ",
        label="Kinetic energy (translation + rotation)",
        bands=("q95", "q50", "q90", "q99", "mean", "max"),
        note="Translation and rotation. {once} {width} Quantiles come from a histogram: 20 bins a "
        "decade, exact to 12 % of the value, with edges at 30 and 300 kJ. Mean and maximum are "
        "exact. {few}",
        meaning="kinetic energy (translation and rotation, kJ) of the blocks *that reach the cell*",
        breaks=ENERGY_BREAKS, ramp=ENERGY_RAMP, edges=_energy_edges,
        bins="20 a decade from 0.03 kJ; 30 and 300 kJ are edges", resolution="12 % of the value",
    ),
    Statistic(
        stem="passing_height", title="Passing height, 95 % quantile (m)", quantity="height",
        unit="m", label="Passing height above the resting position",
        bands=("q95", "q50", "q90", "q99", "max"),
        note="Vertical distance from the ground to the centre, less the resting height. "
        "{once} Quantiles from a histogram of 0.1 m bins up to 2 m, 6 % beyond. {few}",
        meaning="height of the centre above ground, vertical, less the resting height (m)",
        breaks=(0.0, 0.5, 1.0, 2.0, 4.0, 8.0), ramp="YlGnBu", edges=_height_edges,
        bins="0.1 m up to 2 m, then steps of 6 %", resolution="0.1 m, 6 %",
    ),
    Statistic(
        stem="speed", title="Speed, 95 % quantile (m/s)", quantity="speed", unit="m/s",
        label="Speed of the centre", bands=("q95", "q50", "q90", "q99", "max"),
        note="Speed of the centre. {once} Quantiles from a histogram of 0.5 m/s bins up to "
        "20 m/s, 1 m/s beyond. {few}",
        meaning="speed of the centre (m/s)", breaks=(0.0, 5.0, 10.0, 15.0, 20.0, 30.0), ramp="RdPu",
        edges=_speed_edges, bins="0.5 m/s up to 20 m/s, then 1 m/s", resolution="0.5 m/s, 1 m/s",
    ),
    Statistic(
        stem="arrival_time", title="Time of arrival, 5 % quantile (s)", quantity="arrival",
        unit="s", label="Time from the release to the first entry into the cell",
        bands=("q5", "q50", "min"),
        note="Time from the release of a block to its first entry into the cell, for warning "
        "times. Denominator: the blocks that reach the cell. A block and its fragments count once, "
        "with the earliest time. {width} Quantiles from a histogram of 0.5 s bins up to 10 s, 5 % "
        "beyond; the smallest time is exact. {late}",
        meaning="time from the release to the first entry into the cell (s), of the blocks "
        "*that reach the cell*; a block and its fragments count once, with the earliest time",
        breaks=(0.0, 5.0, 10.0, 20.0, 40.0, 80.0), ramp="viridis_r", edges=_arrival_edges,
        bins="0.5 s up to 10 s, then steps of 5 % up to half an hour", resolution="0.5 s, 5 %",
    ),
    Statistic(
        stem="stops", title="Deposited blocks", unit="blocks", label="Blocks that stop in the cell",
        bands=("stops",),
        note="Number of blocks that come to rest in the cell or are stopped there by a barrier, "
            "without blocks that never started.",
        meaning="number of blocks that stop in the cell, at rest or at a barrier; not those that "
        "never started",
        breaks=(0, 3, 10, 30, 100), ramp="plasma_r",
    ),
)  # fmt: skip

#: All that is kept per cell, each once.
SUMS = tuple(dict.fromkeys(s for row in STATISTICS for s in row.sums()))
SUM_NAMES = tuple(s.name for s in SUMS)


def sums_by(reducer: Reducer) -> tuple[CellSum, ...]:
    """Return the sums of one kind, in the order of the kernel's columns."""
    return tuple(s for s in SUMS if s.reducer == reducer)


def wider(name: str, counts: NDArray[Any], bins: Bins) -> NDArray[Any]:
    """Return a sum per cell with as many bins as the histograms of a larger terrain have."""
    if name not in bins.edges:
        return counts
    out = np.zeros((counts.shape[0], bins.edges[name].size - 1), counts.dtype)
    out[:, : counts.shape[1]] = counts
    return out


@dataclass(frozen=True, slots=True)
class Bins:
    """Edges of the histograms; what lies beyond goes into the first or last bin."""

    # Mapping of str to float64, shape (n_bins + 1,); by the name of the histogram.
    edges: Mapping[str, FloatArray]
    # Shape (n,); energies whose exceedance is counted for the hazard curves, ascending from 0 (kJ).
    threshold: FloatArray


def default_bins(
    largest_energy_kj: float = 1e6,
    largest_height_m: float = 100.0,
    largest_speed_mps: float = 80.0,
    thresholds_kj: Sequence[float] = (),
) -> Bins:
    """Return edges of the histograms behind map quantiles, and energies of hazard curves.

    Hazard curves: 0, four energies a decade from 0.95 kJ with 30 and 300 kJ among them, and the
    thresholds given. The energies of a larger terrain begin with those of a smaller one.
    """
    # In the order of QUANTITIES; of times none is needed.
    values = (largest_energy_kj, largest_height_m, largest_speed_mps, math.inf)
    largest = dict(zip(QUANTITIES, values, strict=True))
    edges = {s.quantity: s.edges(largest[s.quantity]) for s in STATISTICS if s.edges is not None}
    # Beyond the last threshold as well, or a larger terrain had steps between the last and it.
    most = max([30.0, *thresholds_kj])
    steps = max(_energy_steps(largest_energy_kj) // 5, math.ceil(4.0 * math.log10(most / 30.0)))
    regular = 30.0 * 10.0 ** (np.arange(-6, steps + 1) / 4.0)
    regular[[6, 10]] = 30.0, 300.0
    given = np.array([t for t in thresholds_kj if not np.isclose(t, regular, rtol=1e-9).any()])
    return Bins(edges, np.unique(np.concatenate([[0.0], regular, given])))


def bins_of(run: MapRun) -> Bins:
    """Return bins of a run on the map."""
    relief = float(np.nanmax(run.grid.values) - np.nanmin(run.grid.values))
    return bins_for(relief, run.blocks, run.engine, run.thresholds_kj)


def bins_for(
    relief_m: float,
    blocks: Sequence[BlockPopulation],
    engine: EngineSettings,
    thresholds_kj: Sequence[float] = (),
) -> Bins:
    """Make bins for blocks that fall through a relief, between highest and lowest place (m).

    Their initial drop and speed count too; ``thresholds_kj`` as in default_bins.
    """
    g = engine.gravity_mps2
    drop = relief_m + max(b.drop_m[1] for b in blocks)
    speed = max(b.speed_mps[1] for b in blocks)
    mass = max(b.mass_limits_kg[1] for b in blocks)
    energy = 1e-3 * mass * (g * drop + 0.5 * speed * speed)
    fastest = float(np.sqrt(2.0 * g * drop + speed * speed))
    return default_bins(2.0 * energy, min(drop, 300.0), min(fastest, 150.0), tuple(thresholds_kj))


def built_in_rows(name: str) -> Iterator[dict[str, str]]:
    """Return rows of ``sassgis/data/<name>.csv`` by column, as text."""
    file = resources.files("sassgis") / "data" / f"{name}.csv"
    return csv.DictReader(file.read_text(encoding="utf-8").splitlines())
