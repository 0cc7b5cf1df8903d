"""Simulation along one profile, and paths of single blocks, on profiles and in space."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.ellipse import inertia
from sassgis.engine.simulate import Simulated, moving_axes
from sassgis.engine.state import END, FLIGHT, IMPACT, ROLLING, trajectory
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import Forest, MapRun
from sassgis.settings.results import (
    CONTACT_DTYPE,
    ContactKind,
    ControlLine,
    ReleasePoints,
    StopReason,
    TraceSet,
)
from sassgis.settings.settings import EngineSettings
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.loop import blocks_on_lines, follow_blocks, on_known_ground, traced
from sassgis.terrain.flatten import chainage_to_xy, profiles
from sassgis.terrain.prepare import Plan, PreparedLines, control_line_crossings, prepare_lines
from sassgis.terrain.release import take

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
    # CONTACT_DTYPE; contacts of the blocks that are drawn, and their scenarios.
    contacts: NDArray[np.void]
    contact_scenario: NDArray[np.int64]
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
    # Shape (n,); times since the release (s), coordinates of the map and height (m); at least two
    # points.
    t: FloatArray
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
    contacts: NDArray[np.void] = field(kw_only=True)  # CONTACT_DTYPE
    # Shape (n_contacts, 2); where they are on the map (m).
    contact_xy: FloatArray = field(kw_only=True)


def line_number(result: ProfileResult, control_line: str) -> int:
    """Return the position of a station or barrier, by its name."""
    return [line.name for line, _ in result.profile.control_lines].index(control_line)


def arrivals(result: ProfileResult, control_line: str) -> int:
    """Return blocks that reached a station or barrier, by its name."""
    return result.control_lines.arrivals(line_number(result, control_line))


def stretches_of(s: FloatArray) -> FloatArray:
    """Return borders of the stretches of STRETCH_M in place of the cells of a map."""
    n = max(math.ceil((s[-1] - s[0]) / STRETCH_M), 1)
    border: FloatArray = s[0] + STRETCH_M * np.arange(n + 1)
    border[-1] = s[-1]
    return border


LOG_EVENTS = 2000
#: Most paths on one line.
_PATHS = 100
#: Time between two points of a flight (s): a chord is then within 2 cm of the parabola.
_STEP_S = 0.1
_FACTS = ("runout_m", "time_s", "mass_kg", "max_energy_kj", "max_speed_mps", "max_height_m")


def paths_on_line(
    run: MapRun, planned: Plan, line: int, scenario: int, rock: int
) -> LinePaths | None:
    """Return paths of blocks on one line of a run, in the repetition of one of them.

    With followed paths only that of the block itself. None if it is too short for a profile.
    Line, scenario and rock are numbers as in Progress.furthest.
    """
    which = np.array([line])
    if run.followed:
        result = _followed_again(run, take(planned.points, which), scenario, rock)
        chainage, x, y = _in_plan(run.heights, result.event_logs[0])
        if chainage.size < 2:
            return None
        only = np.zeros(1, np.int64)
        path = TraceSet(
            np.array([0, chainage.size], np.int64), x, y, chainage, only, only.astype(np.uint8)
        )
        flat = profiles(run.heights, path, run.ground, run.terrain.segment_tolerance_m)
        crossed = control_line_crossings(run.control_lines, path)
    else:
        repetition = rock // run.release.rocks_per_point
        blocks = min(_PATHS, run.release.rocks_per_point)
        path, prepared, found = _on_lines_again(run, planned, which, scenario, blocks, repetition)
        if found is None:
            return None
        result, flat, crossed = found, prepared.flat, prepared.crossings
    s, z = flat.vertices(0)
    return LinePaths(
        area=planned.points.area_names[planned.points.area[line]],
        scenario=run.blocks[scenario].name,
        s=s,
        z=z,
        x=np.interp(s, path.s, path.x),
        y=np.interp(s, path.s, path.y),
        ground=flat.ground.astype(np.int64),
        ground_names=run.table.names,
        control_lines=tuple(
            (crossed.control_lines[g], float(c))
            for c, g in zip(crossed.chainage, crossed.control_line, strict=True)
        ),
        paths=tuple(trajectory(log, run.engine.gravity_mps2)[1:] for log in result.event_logs),
        stops=result.rocks["runout_m"],
    )


def _even_points(run: MapRun, planned: Plan, most: int) -> IntArray:
    """Choose numbers of release points, at most so many, evenly among those with blocks."""
    points = np.arange(len(planned.points), dtype=np.int64)
    if run.followed:
        points = points[on_known_ground(run, planned.points)]
    chosen = np.linspace(0, points.size - 1, min(most, points.size)).round()
    return points[np.unique(chosen.astype(np.int64))]


def _followed_again(
    run: MapRun, points: ReleasePoints, scenario: int, rock: int, blocks: int = 1
) -> Simulated:
    """Follow some blocks of each release point of an area from one on, with their event logs."""
    repetition, number = divmod(rock, run.release.rocks_per_point)
    return follow_blocks(
        run, points, scenario, repetition, rocks_per_point=blocks, first_rock=number,
        log_events=LOG_EVENTS,
    )  # fmt: skip


def _on_lines_again(
    run: MapRun,
    planned: Plan,
    which: IntArray,
    scenario: int,
    rocks: int,
    again: int = 0,
    first: int = 0,
) -> tuple[TraceSet, PreparedLines, Simulated | None]:
    """Simulate some blocks of release points on their lines, with event logs; None: too short."""
    traces = traced(run, planned, which)
    prepared = prepare_lines(run, traces)
    result = None
    if len(prepared):
        result = blocks_on_lines(
            run, planned, which, prepared, scenario, again, rocks_per_line=rocks,
            first_rock=first, log_events=LOG_EVENTS,
        )  # fmt: skip
    return traces, prepared, result


def _in_plan(grid: Grid, log: NDArray[np.void]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return chainage and coordinates of a path that was followed, where its block moves on (m)."""
    # A block that slides back a little stays on its path.
    ahead = np.flatnonzero(np.diff(log["x_m"], prepend=-np.inf) > 0.0)
    return (
        log["x_m"][ahead],
        grid.west + log["u"][ahead] * grid.cell_size,
        grid.north - log["v"][ahead] * grid.cell_size,
    )


def sample_paths(run: MapRun, planned: Plan, most: int) -> tuple[BlockPath, ...]:
    """Return paths of the first blocks of release points evenly over the plan, at most so many.

    They are blocks of the run, of its first repetition, simulated again. A point and scenario has
    several only if all points have one. Blocks that never start are left out.
    """
    each = max([1, *map(len, planned.scenarios)])
    which = _even_points(run, planned, most // each)
    rocks = min(run.release.rocks_per_point, most // max(which.size * each, 1))
    area = planned.points.area[which]
    paths: list[BlockPath] = []
    for number in np.unique(area).tolist():
        own = which[area == number]
        # Event logs need much memory: few blocks at a time.
        for first in range(0, rocks, _PATHS):
            numbers = range(first, min(first + _PATHS, rocks))
            step = _PATHS // len(numbers)
            for some in np.split(own, range(step, own.size, step)):
                for k in planned.scenarios[number]:
                    paths += _paths(run, planned, some, k, numbers)
    return tuple(paths)


def _paths(
    run: MapRun, planned: Plan, which: IntArray, scenario: int, numbers: range
) -> Iterator[BlockPath]:
    """Yield paths of some blocks of each of some release points of one area."""
    prepared: PreparedLines | None = None
    result: Simulated | None
    if run.followed:
        points = take(planned.points, which)
        result = _followed_again(run, points, scenario, numbers[0], len(numbers))
    else:
        _, prepared, result = _on_lines_again(
            run, planned, which, scenario, len(numbers), first=numbers[0]
        )
    if result is None:
        return
    name = planned.points.area_names[int(planned.points.area[which[0]])]
    contacts = contacts_of(result.event_logs, result.rocks, run.engine)
    for row, log, met in zip(result.rocks, result.event_logs, contacts, strict=True):
        t, s, z = trajectory(log, run.engine.gravity_mps2, _STEP_S)
        if prepared is None:
            chainage, east, north = _in_plan(run.heights, log)
            if chainage.size < 2:
                continue
            x, y = np.interp(s, chainage, east), np.interp(s, chainage, north)
            at = [np.interp(met["chainage_m"], chainage, way) for way in (east, north)]
        else:
            if s.size < 2:
                continue
            line = np.full(max(s.size, met.size), row["line"], np.int64)
            length = prepared.length_m[int(row["line"])]
            x, y = chainage_to_xy(prepared.lines, line[: s.size], np.clip(s, 0.0, length))
            places = np.clip(met["chainage_m"], 0.0, length)
            at = [*chainage_to_xy(prepared.lines, line[: places.size], places)]
        facts = [float(row[fact]) for fact in _FACTS]
        reason = StopReason(int(row["reason"]))
        scenario_name, xy = run.blocks[scenario].name, np.column_stack(at)
        yield BlockPath(
            name, scenario_name, t, x, y, z, reason, *facts, contacts=met, contact_xy=xy
        )


_KINDS = {IMPACT: ContactKind.IMPACT, ROLLING: ContactKind.ROLLING}


def contacts_of(
    logs: Sequence[NDArray[np.void]], rocks: NDArray[np.void], engine: EngineSettings
) -> list[NDArray[np.void]]:
    """Return for each block a row for each contact: its state as it begins and as it ends.

    Parameters
    ----------
    logs : of EVENT_DTYPE, shape (n_events,) each
    rocks : ROCK_DTYPE, shape (n_blocks,)
        The blocks to which the logs belong.
    engine : EngineSettings
        With the outline as which they moved; without effects that change their inertia.

    Returns
    -------
    list of CONTACT_DTYPE, shape (n_contacts,) each
        Velocities along the ground (downhill positive) and normal to it (away from it positive).
        Rolling and sliding end where the ground bends or the block leaves it.
    """
    stated = np.column_stack([rocks[f"{axis}_m"] for axis in "abc"])
    turning = [inertia(a, b) for a, b, _ in moving_axes(stated, engine).tolist()]
    return [_contacts(*each) for each in zip(logs, rocks, turning, strict=True)]


def _contacts(log: NDArray[np.void], rock: np.void, turning: float) -> NDArray[np.void]:
    """Return the contacts of a block of a moment of inertia per unit mass (m²)."""
    phase = log["phase"]
    first = np.flatnonzero((phase[:-1] != FLIGHT) & (phase[:-1] != END))
    begin, end = log[first], log[first + 1]
    out = np.zeros(first.size, CONTACT_DTYPE)
    out["rock"], out["contact"] = rock["rock"], np.arange(1, first.size + 1)
    out["kind"] = [_KINDS.get(int(own), ContactKind.SLIDING) for own in begin["phase"]]
    out["t_s"], out["duration_s"] = begin["t_s"], end["t_s"] - begin["t_s"]
    out["chainage_m"], out["z_m"] = begin["x_m"], begin["z_m"]
    downhill = np.where(begin["ux"] < 0.0, -1.0, 1.0)
    tx, tz = downhill * begin["ux"], downhill * begin["uz"]
    out["slope_deg"] = np.degrees(np.arctan2(-tz, tx))
    for side, state in (("in", begin), ("out", end)):
        vx, vz, spin = state["vx_mps"], state["vz_mps"], state["omega_radps"]
        out[f"vt_{side}_mps"] = vx * tx + vz * tz
        out[f"vn_{side}_mps"] = vz * tx - vx * tz
        out[f"rotation_{side}_hz"] = spin / (2.0 * np.pi)
        out[f"energy_{side}_kj"] = 0.5e-3 * rock["mass_kg"] * (vx**2 + vz**2 + turning * spin**2)
    return out
