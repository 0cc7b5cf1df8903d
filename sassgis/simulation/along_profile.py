"""Simulation along one profile; paths of single blocks, on profiles and in space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray, IntArray
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import Forest
from sassgis.settings.results import ControlLine, Histogram, StopReason
from sassgis.simulation.control_lines import ControlLineSums

#: Width of the stretches for which energy, speed and height along the profile are given (m).
STRETCH_M = 1.0


@dataclass(frozen=True, slots=True)
class ProfileInput:
    """A profile to be run."""

    name: str
    # Shape (n,); chainage and height of the vertices (m).
    s: FloatArray
    z: FloatArray
    ground: NDArray[np.int32]  # shape (n,); ground class of the segment that starts at each vertex
    table: GroundTable
    control_lines: tuple[tuple[ControlLine, float], ...]
    start: tuple[float, float]  # chainages between which blocks start (m)
    forest: Forest | None = None  # stems on the stretches of the profile


@dataclass(frozen=True, slots=True)
class ProfileResult:
    """Results of the blocks of a profile."""

    profile: ProfileInput
    rocks: NDArray[np.void]  # ROCK_DTYPE, shape (n_scenarios * n_rocks,)
    scenario: NDArray[np.int64]  # of each, its position in the configuration's blocks
    # ROCK_DTYPE; fragments and entrained blocks, and their scenarios.
    pieces: NDArray[np.void]
    piece_scenario: NDArray[np.int64]
    passage_scenario: NDArray[np.int64]  # of the rows of passages
    passages: NDArray[np.void]
    control_lines: ControlLineSums
    # Chainage and height (m) of trajectories of the first blocks of each block scenario.
    paths: tuple[tuple[FloatArray, FloatArray], ...]
    drawn: int  # how many of each scenario
    stretches: FloatArray  # shape (n + 1,); borders of the stretches of the profile (m)
    # Quantiles of "energy" (kJ), "speed" (m/s) and "height" (m) in each stretch, shape (n,).
    along: dict[str, dict[float, FloatArray]]


@dataclass(frozen=True, slots=True)
class LinePaths:
    """Paths of blocks on one line of a run on the map, for a figure."""

    area: str
    scenario: str
    # Shape (n,); chainage and height of the profile (m).
    s: FloatArray
    z: FloatArray
    # Shape (n,); where the profile runs on the map (m).
    x: FloatArray
    y: FloatArray
    ground: IntArray  # shape (n,); ground class of the segment that starts at each vertex
    ground_names: Sequence[str]
    control_lines: tuple[tuple[ControlLine, float], ...]
    paths: tuple[tuple[FloatArray, FloatArray], ...]  # s and z of the centres of the blocks (m)
    stops: FloatArray  # shape (n_blocks,); run-out of each (m)


@dataclass(frozen=True, slots=True)
class BlockPath:
    """The path of the centre of a block, and how it ended."""

    area: str
    scenario: str
    # Shape (n,); coordinates of the map and height (m); at least two points.
    x: FloatArray
    y: FloatArray
    z: FloatArray
    reason: StopReason
    runout_m: float
    time_s: float
    mass_kg: float
    # The largest on the path.
    max_energy_kj: float
    max_speed_mps: float
    max_height_m: float


def _number(result: ProfileResult, control_line: str) -> int:
    """Return the position of a station or barrier, by its name."""
    return [line.name for line, _ in result.profile.control_lines].index(control_line)


def _passages(result: ProfileResult, control_line: str, quantity: str) -> NDArray[Any]:
    own = result.passages["control_line"] == _number(result, control_line)
    values: NDArray[Any] = result.passages[quantity][own]
    return values


def passage_histogram(
    result: ProfileResult, control_line: str, quantity: str, edges: Sequence[float], unit: str
) -> Histogram:
    """Return the histogram of one quantity of the passages at a station or barrier, by its name."""
    values = _passages(result, control_line, quantity)
    counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
    return Histogram(np.asarray(edges, float), counts.astype(np.int64), unit)


def share_within(
    result: ProfileResult, control_line: str, quantity: str, low: float, high: float
) -> tuple[int, float]:
    """Count passages at a station or barrier, and their share between two limits (inclusive)."""
    values = _passages(result, control_line, quantity)
    share = float(((values >= low) & (values <= high)).mean()) if values.size else float("nan")
    return int(values.size), share


def arrivals(result: ProfileResult, control_line: str) -> int:
    """Return blocks that reached a station or barrier, by its name."""
    return result.control_lines.arrivals(_number(result, control_line))


def stretches_of(s: FloatArray) -> FloatArray:
    """Return borders of the stretches of STRETCH_M in place of the cells of a map."""
    n = max(math.ceil((s[-1] - s[0]) / STRETCH_M), 1)
    border: FloatArray = s[0] + STRETCH_M * np.arange(n + 1)
    border[-1] = s[-1]
    return border
