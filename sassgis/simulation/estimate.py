"""Estimate of a run on the map before anything is simulated: blocks, memory, time, files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sassgis.engine.simulate_paths import room_at_first
from sassgis.grid import FloatArray
from sassgis.settings.hazard_rules import BlockBudget
from sassgis.settings.map_run import Config, MapRun
from sassgis.settings.process import memory_bytes, require_memory
from sassgis.settings.results import ROCK_DTYPE, short
from sassgis.settings.statistics_table import STATISTICS, SUMS, Bins, bins_for, bins_of
from sassgis.simulation.loop import CHUNK_POINTS
from sassgis.simulation.path_sample import STRETCH_M
from sassgis.terrain.release import points_expected

# Rough numbers; compare benchmarks/memory.py and, for the rates, docs/studies/speed.md.
#: Bytes of the program, of a cell with all its maps, and of a release point.
BASE, _PER_CELL, _PER_POINT = 900 << 20, 100, 1500
#: Copies of the row of a block, and bytes of a stop that is kept and written.
_ROWS, _PER_STOP = 3, 1000
#: Blocks simulated in a second on one core, on followed paths and on fall lines.
RATES = {True: 8500, False: 21_000}
#: Rate of `zone`, which counts the blocks of a window around each cell; seconds for zones, maps and
#: figures, in all and per cell: the sample valley.
_ZONE_RATE, _DRAWING_S, _DRAWING_PER_CELL_S = 1400, 5.0, 1e-4
#: Bytes of a cell in a band of a map.
_IN_MAP = 4


@dataclass(frozen=True, slots=True)
class RunEstimate:
    """Estimate of a run's blocks, memory, time and files."""

    blocks: int
    points: int
    cells: int
    # Memory (bytes) by the key of the configuration that it depends on, but for what grows with the
    # cells that blocks come to.
    need: Mapping[str, int]
    per_reached: int  # bytes of each cell that blocks come to
    cores: int
    seconds: float  # for blocks as on the slope of docs/studies/speed.md
    map_bytes: int  # of the maps of the blocks, not compressed
    more: int  # largest factor on the blocks of a zoning
    # Least and most seconds of `zone`, with the drawing; None without the settings for it.
    zone_seconds: tuple[float, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the estimate for programs."""
        return {
            "blocks": self.blocks,
            "release_points": self.points,
            "cells": self.cells,
            "memory_bytes": sum(self.need.values()),
            "memory_free_bytes": memory_bytes(),
            "memory_bytes_per_reached_cell": self.per_reached,
            "cores": self.cores,
            "seconds": self.seconds,
            "map_bytes": self.map_bytes,
            "times_as_many_blocks_for_zones": self.more,
            "seconds_of_zone": self.zone_seconds,
        }

    def lines(self) -> list[str]:
        """Return the estimate for people, line by line."""
        free = memory_bytes()
        more = f" (zone: up to {self.more} times as many)" if self.more > 1 else ""
        room = "" if free is None else f"; {free / 1e9:.3g} GB are free"
        return [
            f"estimate       {self.blocks} blocks{more}, {self.points} release points, "
            f"{self.cells} cells",
            f"               memory {short(sum(self.need.values()) / 1e9)} GB plus "
            f"{self.per_reached / 1e3:.1f} kB per reached cell{room}",
            f"               time of run {_spoken(self.seconds)}{self._time_of_zone()}, on "
            f"{self.cores} {'core' if self.cores == 1 else 'cores'}; several times longer on long "
            "slopes, with effects or on slow machines",
            f"               maps {short(self.map_bytes / 1e6)} MB uncompressed; a table of blocks "
            f"would have {self.blocks} rows",
        ]

    def _time_of_zone(self) -> str:
        if self.zone_seconds is None:
            return ""
        least, most = map(_spoken, self.zone_seconds)
        span = f"{least} to {most}, by the number of blocks that the levels need"
        return f"; of zone, drawing included, {least if least == most else span}"


def _spoken(seconds: float) -> str:
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{math.ceil(seconds)} s"


def estimate_of(run: MapRun, jobs: int, points: int | None = None, more: int = 1) -> RunEstimate:
    """Estimate the time and memory of a run on so many threads.

    Without ``points`` it has about as many release points as there will be; ``more`` as in
    RunEstimate.
    """
    # Above any possible number, and still a whole number.
    expected = [min(points_expected(a.geometry, run.release.spacing_m), 1e30) for a in run.areas]
    scenarios = [len(area.scenarios) for area in run.areas]
    each = run.release.rocks_per_point
    share = sum(n * k for n, k in zip(expected, scenarios, strict=True)) / max(sum(expected), 1.0)
    n = round(sum(expected)) if points is None else points
    blocks = round(n * share * each) * run.repetitions
    cells = run.grid.values.size
    # Chunks at work, and results that wait to be added up.
    chunk = min(CHUNK_POINTS, max(expected, default=0.0))
    held = min(3.0 * jobs, max(1.0, n / CHUNK_POINTS))
    at_work = min(jobs, held)
    row = ROCK_DTYPE.itemsize * _ROWS
    windows = _windows_bytes(run)
    numbers = 4 * run.followed + 4 * (windows > 0)
    need = {
        "terrain.dem": BASE + cells * (_PER_CELL + round(at_work * numbers)),
        "release.spacing_m": n * _PER_POINT,
        "release.rocks_per_point": round(held * chunk * each * row * max(scenarios, default=0)),
        "output.stop_points_max": min(run.stop_points_max, blocks) * _PER_STOP,
    }
    if windows:
        need["hazard.ref_width_m"] = windows
    bands = 1 + sum(len(row.bands) for row in STATISTICS)
    return RunEstimate(
        blocks=blocks, points=n, cells=cells, need=need, per_reached=reached_bytes(bins_of(run)),
        cores=jobs, seconds=blocks / (RATES[run.followed] * jobs),
        map_bytes=bands * cells * _IN_MAP, more=more,
    )  # fmt: skip


def for_zones(estimate: RunEstimate, repeats: int, budget: BlockBudget | None) -> RunEstimate:
    """Return the estimate of a zoning that simulates so many times, within a budget of blocks."""
    pace = _ZONE_RATE * estimate.cores
    least = most = repeats * estimate.blocks / pace
    more = repeats
    if budget is not None:
        most = max(least, min(budget.seconds, repeats * budget.blocks / pace))
        more = math.ceil(repeats * budget.blocks / max(estimate.blocks, 1))
    drawing = _DRAWING_S + estimate.cells * _DRAWING_PER_CELL_S
    return replace(estimate, more=more, zone_seconds=(least + drawing, most + drawing))


def _windows_bytes(run: MapRun) -> int:
    """Estimate the bytes of the list of windows around each cell of a chunk, made at once."""
    if run.window is None:
        return 0
    steps = math.ceil(math.pi * (run.window.radius + 1.0) ** 2)
    room = room_at_first(steps)
    while 3 * room < steps:
        room *= 2
    return 8 * steps * room


def reached_bytes(bins: Bins) -> int:
    """Return bytes of a cell that blocks come to: sums and counts, and copies of them at work."""
    sums = sum(
        np.dtype(s.dtype).itemsize * (bins.edges[s.name].size - 1 if s.name in bins.edges else 1)
        for s in SUMS
    )
    return 10 * 8 * bins.threshold.size + 3 * sums


def require_profile(config: Config, s: FloatArray, z: FloatArray, rocks: int) -> Bins:
    """Return the bins of a run down a profile; InputError if it does not fit into the memory."""
    bins = bins_for(float(np.ptp(z)), config.blocks, config.engine)
    stretches = round(min(float(np.ptp(s)) / STRETCH_M, 1e15))
    blocks = rocks * len(config.blocks)
    need = {
        "profile.file": stretches * reached_bytes(bins),
        "profile.rocks": blocks * ROCK_DTYPE.itemsize * _ROWS,
    }
    require_memory(need, config.file)
    return bins
