"""Angles under which stops are seen: from the release point, and from the foot of the cliff."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sassgis.grid import FloatArray, Grid
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import StopReason
from sassgis.simulation.accumulators import Progress, joined_lines, kept_stops
from sassgis.terrain.plan import Plan

#: A fall line leaves the cliff where it is flatter than this over one step (degrees; expert
#: judgement: steeper than any talus), and the step (m).
CLIFF_ANGLE_DEG = 45.0
STEP_M = 10.0


@dataclass(frozen=True, slots=True)
class ReachAngles:
    """Angles of the stops of single blocks, below the horizontal (degrees)."""

    # Shape (n,); seen from the release point: the reach angle (Heim 1932; Corominas 1996).
    reach_deg: FloatArray
    # Shape (n,); seen from the foot of the cliff on the fall line of the release point, where a
    # talus would begin: the shadow angle (Evans and Hungr 1993). NaN where there is no cliff below
    # the release point, or the block stops on it. Neither publication was checked.
    shadow_deg: FloatArray


def reach_angles(run: MapRun, planned: Plan, progress: Progress) -> ReachAngles:
    """Compute the angles of single blocks that came to rest or stopped at a barrier.

    Distances are straight lines in plan; heights are those of the terrain.
    """
    rows = kept_stops(run, progress)
    ended = np.isin(rows.rocks["reason"], (StopReason.REST, StopReason.BARRIER))
    point = rows.rocks["line"][ended]
    end = _places(run.grid, rows.x[ended], rows.y[ended])
    start = _places(run.grid, planned.points.x, planned.points.y)
    foot = np.full((len(planned.points), 3), np.nan)
    lines = joined_lines(progress.lines)
    for i in np.flatnonzero(np.isin(lines.point, point)):
        part = slice(lines.offset[i], lines.offset[i + 1])
        foot[lines.point[i]] = foot_of_cliff(run.grid, lines.x[part], lines.y[part])
    return ReachAngles(_angle_deg(start[point], end), _angle_deg(foot[point], end))


def foot_of_cliff(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """Find where a fall line leaves the cliff on which it begins: x, y, z (m); NaN for no cliff."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    at = np.arange(0.0, s[-1] + 1e-9, STEP_M)
    places = _places(grid, np.interp(at, s, x), np.interp(at, s, y))
    steep = -np.diff(places[:, 2]) > STEP_M * math.tan(math.radians(CLIFF_ANGLE_DEG))
    flat_after = np.flatnonzero(steep[:-1] & ~steep[1:]) + 1
    return places[flat_after[0]] if flat_after.size else np.full(3, np.nan)


def _places(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return x, y and the height of the cell, shape (n, 3); NaN outside."""
    return np.column_stack([x, y, grid.value_at(x, y)])


def _angle_deg(upper: FloatArray, lower: FloatArray) -> FloatArray:
    """Return the angle of falling lines below the horizontal; NaN for others."""
    distance = np.hypot(*(lower - upper)[:, :2].T)
    drop = upper[:, 2] - lower[:, 2]
    out: FloatArray = np.where(
        (distance > 0.0) & (drop > 0.0), np.degrees(np.arctan2(drop, distance)), np.nan
    )
    return out
