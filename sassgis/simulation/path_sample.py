"""Some blocks of a run once more, to see their paths: in a profile, and in space."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.simulate import Simulated
from sassgis.engine.state import trajectory
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.map_run import MapRun
from sassgis.settings.profiles import ReleasePoints, TraceSet
from sassgis.settings.results import StopReason
from sassgis.simulation.along_profile import BlockPath, LinePaths
from sassgis.simulation.loop import blocks_on_lines, follow_blocks, on_known_ground, traced
from sassgis.terrain.flatten import chainage_to_xy, profiles
from sassgis.terrain.plan import Plan
from sassgis.terrain.prepare import PreparedLines, control_line_crossings, prepare_lines
from sassgis.terrain.release import take

LOG_EVENTS = 2000
#: Most paths on one line, and release points of which one is shown each.
_PATHS, _SHOWN = 100, 40
#: Time between two points of a flight (s): a chord is then within 2 cm of the parabola.
_STEP_S = 0.1
_FACTS = ("runout_m", "time_s", "mass_kg", "max_energy_kj", "max_speed_mps", "max_height_m")


def paths_on_line(
    run: MapRun, planned: Plan, line: int, scenario: int, rock: int
) -> LinePaths | None:
    """Return paths of blocks on one line of a run, in the repetition of one of them.

    Where paths are followed only that of the one block. None if it is too short for a profile.
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
        paths=tuple(trajectory(log, run.engine.gravity_mps2) for log in result.event_logs),
        stops=result.rocks["runout_m"],
    )


def some_paths(run: MapRun, planned: Plan) -> list[LinePaths]:
    """Return paths of the first block of some release points, evenly chosen; not the shortest."""
    out = []
    for number, point in enumerate(_even_points(run, planned, _SHOWN)):
        scenarios = planned.scenarios[planned.points.area[point]]
        scenario = scenarios[number % len(scenarios)]
        out.append(paths_on_line(run, planned, int(point), scenario, 0))
    return [shown for shown in out if shown is not None]


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
    # A block that slides back a little does so on its path.
    ahead = np.flatnonzero(np.diff(log["x_m"], prepend=-np.inf) > 0.0)
    return (
        log["x_m"][ahead],
        grid.west + log["u"][ahead] * grid.cell_size,
        grid.north - log["v"][ahead] * grid.cell_size,
    )


def sample_paths(run: MapRun, planned: Plan, most: int) -> tuple[BlockPath, ...]:
    """Return paths of the first blocks of release points evenly over the plan, at most so many.

    They are blocks of the run, of its first repetition, simulated again. Of each point and scenario
    there are several only where all points have one. Those that never start are left out.
    """
    each = max([1, *map(len, planned.scenarios)])
    which = _even_points(run, planned, most // each)
    rocks = min(run.release.rocks_per_point, most // max(which.size * each, 1))
    area = planned.points.area[which]
    paths: list[BlockPath] = []
    for number in np.unique(area).tolist():
        own = which[area == number]
        # Logs have room for many events: few at a time.
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
    for row, log in zip(result.rocks, result.event_logs, strict=True):
        s, z = trajectory(log, run.engine.gravity_mps2, _STEP_S)
        if prepared is None:
            chainage, east, north = _in_plan(run.heights, log)
            if chainage.size < 2:
                continue
            x, y = np.interp(s, chainage, east), np.interp(s, chainage, north)
        else:
            if s.size < 2:
                continue
            line = np.full(s.size, row["line"], np.int64)
            length = prepared.length_m[int(row["line"])]
            x, y = chainage_to_xy(prepared.lines, line, np.clip(s, 0.0, length))
        facts = [float(row[fact]) for fact in _FACTS]
        reason = StopReason(int(row["reason"]))
        yield BlockPath(name, run.blocks[scenario].name, x, y, z, reason, *facts)
