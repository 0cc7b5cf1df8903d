"""A sample of the blocks of a run once more, to see what its results hang on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sassgis.hazard.bins import bins_of
from sassgis.hazard.response import RunOutcome, ToleranceCheck, outcome_of, response
from sassgis.model.grid import IntArray
from sassgis.model.map_run import MapRun, ObjectCells, Round
from sassgis.runs.map import simulate_map
from sassgis.runs.workers import Workers
from sassgis.terrain.plan import Plan
from sassgis.terrain.release import take

#: Blocks of the sample: a thirtieth of the run, so that three of it cost a tenth, within these.
_SHARE, _FEWEST, _MOST = 1.0 / 30.0, 2_000, 20_000
_POINTS = 40


def sampled_plan(run: MapRun, planned: Plan, blocks: int, points: int) -> tuple[MapRun, Plan]:
    """Part of a run: release points evenly over the plan, and the first blocks of each.

    About so many blocks of at least so many release points, if there are.
    """
    n = len(planned.points)
    once = replace(run, rounds=(Round(),))
    released = int(replace(planned, repetitions=()).blocks_of_point(once).sum())
    # Blocks of a point for each of its rocks_per_point: one for each scenario.
    scenarios = released / (n * run.release.rocks_per_point)
    least = min(n, points)
    each = int(np.clip(round(blocks / (scenarios * least)), 1, run.release.rocks_per_point))
    wanted = int(np.clip(round(blocks / (scenarios * each)), least, n))
    which = np.unique(np.linspace(0, n - 1, wanted).round().astype(np.int64))
    return (
        replace(
            once, release=replace(run.release, rocks_per_point=each),
            stop_points_max=0, ref_width_m=0.0, objects=ObjectCells.none(), rim=(0, 0, 0, 0),
        ),
        plan_of_points(planned, which),
    )  # fmt: skip


def plan_of_points(planned: Plan, which: IntArray) -> Plan:
    """The plan with some of its release points alone; each has the same random draws."""
    return replace(
        planned,
        points=take(planned.points, which),
        starts=take(planned.starts, which),
        moved=planned.moved[which],
    )


def check_tolerance(run: MapRun, planned: Plan, jobs: int | Workers) -> ToleranceCheck | None:
    """Repeat a sample of a run at half and double its segment tolerance.

    None where the tolerance is 0 or there is nothing to simulate.
    """
    tolerance = run.terrain.segment_tolerance_m
    total = int(planned.blocks_of_point(run).sum())
    if tolerance == 0.0 or not total:
        return None
    few, points = sampled_plan(run, planned, int(np.clip(_SHARE * total, _FEWEST, _MOST)), _POINTS)

    def outcome(t: float) -> RunOutcome:
        terrain = replace(few.terrain, segment_tolerance_m=t)
        progress = simulate_map(replace(few, terrain=terrain), points, jobs=jobs)
        return outcome_of(progress, bins_of(few))

    base = outcome(tolerance)
    answers = {t: response(base, outcome(t)) for t in (0.5 * tolerance, 2.0 * tolerance)}
    return ToleranceCheck(tolerance, base.blocks, answers)
