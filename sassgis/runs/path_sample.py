"""Some blocks of a run once more, to see their paths in space."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sassgis.engine.event_log import trajectory
from sassgis.engine.simulate import Simulated, simulate
from sassgis.hazard.block_paths import BlockPath
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.map_run import MapRun
from sassgis.model.results import StopReason
from sassgis.runs.map import LOG_EVENTS, follow_one, on_known_ground, path_in_plan
from sassgis.terrain.fall_lines import trace
from sassgis.terrain.flatten import chainage_to_xy
from sassgis.terrain.plan import Plan
from sassgis.terrain.prepare import draw_keys, prepare_lines
from sassgis.terrain.release import take

#: Time between two points of a flight (s): a chord is then within 2 cm of the parabola.
_STEP_S = 0.1
_FACTS = ("runout_m", "time_s", "mass_kg", "max_energy_kj", "max_speed_mps", "max_height_m")


def sample_paths(run: MapRun, planned: Plan, most: int) -> tuple[BlockPath, ...]:
    """Paths of the first block of release points that lie evenly over the plan.

    They are blocks of the run, simulated again. Those that never start are left out.

    Parameters
    ----------
    most : int
        Most paths, of all block scenarios together.
    """
    n = len(planned.points)
    points = min(n, most // max([1, *map(len, planned.scenarios)]))
    if not points:
        return ()
    which = np.unique(np.linspace(0, n - 1, points).round().astype(np.int64))
    area = planned.points.area[which]
    paths: list[BlockPath] = []
    for number in np.unique(area).tolist():
        own = which[area == number]
        for k in planned.scenarios[number]:
            found = (_followed if run.followed else _on_lines)(run, planned, own, k)
            paths += found
    return tuple(paths)


def _followed(run: MapRun, planned: Plan, which: IntArray, scenario: int) -> Iterator[BlockPath]:
    points = take(planned.points, which)
    points = take(points, np.flatnonzero(on_known_ground(run, points)))
    if not len(points):
        return
    name = points.area_names[int(points.area[0])]
    result = follow_one(run, points, scenario)
    for i, log in enumerate(result.event_logs):
        chainage, east, north = path_in_plan(run.heights, log)
        if chainage.size < 2:
            continue
        s, z = trajectory(log, run.engine.gravity_mps2, _STEP_S)
        x, y = np.interp(s, chainage, east), np.interp(s, chainage, north)
        yield _path(name, run.blocks[scenario].name, (x, y, z), result, i)


def _on_lines(run: MapRun, planned: Plan, which: IntArray, scenario: int) -> Iterator[BlockPath]:
    starts = take(planned.starts, which)
    traces = trace(run.grid, planned.surface, starts, run.fall_lines)
    prepared = prepare_lines(run, traces)
    lines, good = prepared.lines, prepared.good
    if not len(lines):
        return
    blocks = run.blocks[scenario]
    result = simulate(
        prepared.profiles, run.table, blocks, run.engine, seed=run.seed, rocks_per_line=1,
        line_keys=draw_keys(starts.key, blocks.name)[good],
        starts=prepared.starts(planned.moved[which][lines.point]),
        control_lines=prepared.crossings, log_events=LOG_EVENTS, effects=run.effects,
        forest=run.forest,
    )  # fmt: skip
    name = planned.points.area_names[int(starts.area[0])]
    for i, log in enumerate(result.event_logs):
        s, z = trajectory(log, run.engine.gravity_mps2, _STEP_S)
        if s.size > 1:
            line = np.full(s.size, i, np.int64)
            x, y = chainage_to_xy(lines, line, np.clip(s, 0.0, prepared.length_m[i]))
            yield _path(name, blocks.name, (x, y, z), result, i)


def _path(
    area: str,
    scenario: str,
    places: tuple[FloatArray, FloatArray, FloatArray],
    result: Simulated,
    number: int,
) -> BlockPath:
    row = result.rocks[number]
    facts = [float(row[name]) for name in _FACTS]
    return BlockPath(area, scenario, *places, StopReason(int(row["reason"])), *facts)
