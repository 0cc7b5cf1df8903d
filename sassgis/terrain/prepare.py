"""From release points to the profiles on which blocks are simulated: traced, flattened, usable.

Every run goes through here: maps, single profiles from the terrain, and diagnoses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.compiled import rng
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.map_run import FallLines, MapRun, Round
from sassgis.settings.results import (
    ControlLine,
    ControlLineCrossings,
    ProfileSet,
    ReleasePoints,
    TraceSet,
)
from sassgis.terrain.fall_lines import fall_line_surface
from sassgis.terrain.flatten import crossings, profiles
from sassgis.terrain.release import release_points
from sassgis.terrain.surface import Surface, evaluate

#: On fall lines shorter than this no block is simulated (m).
SHORTEST_LINE_M = 1.0


def moved_uphill(
    points: ReleasePoints, surface: Surface, distance_m: float, inside: NDArray[np.bool_]
) -> tuple[ReleasePoints, FloatArray]:
    """Move release points up the slope, so that blocks can start on both sides of them.

    A lattice point represents a square of the release area; its blocks start on the fall line
    within half the spacing above and below it. Those ``inside`` are moved by ``distance_m``, or not
    where the ground is level or unknown. Returns the points, and how far each has been moved (m).
    """
    height, gx, gy = evaluate(surface, points.x, points.y)
    slope = np.hypot(gx, gy)
    can = np.isfinite(height) & np.isfinite(slope) & (slope > 1e-6) & inside
    step = np.where(can, distance_m, 0.0)
    unit = np.where(can, slope, 1.0)
    x = points.x + np.where(can, gx / unit, 0.0) * step
    y = points.y + np.where(can, gy / unit, 0.0) * step
    above, _, _ = evaluate(surface, x, y)
    known = np.isfinite(above)
    moved = np.where(known, step, 0.0)
    start = replace(points, x=np.where(known, x, points.x), y=np.where(known, y, points.y))
    return start, moved


def usable(traces: TraceSet, least_m: float) -> NDArray[np.bool_]:
    """Find the lines that are long enough to simulate blocks on, shape (n,)."""
    last = traces.s[np.maximum(traces.offset[1:] - 1, 0)]
    counts = np.diff(traces.offset)
    return (counts >= 2) & (last >= least_m)


def take_lines(traces: TraceSet, which: NDArray[np.bool_]) -> TraceSet:
    """Select some of the lines."""
    counts = np.diff(traces.offset)
    keep = np.repeat(which, counts)
    return TraceSet(
        offset=np.concatenate([[0], np.cumsum(counts[which])]).astype(np.int64),
        x=traces.x[keep],
        y=traces.y[keep],
        s=traces.s[keep],
        point=traces.point[which],
        end=traces.end[which],
    )


def take_profiles(profiles: ProfileSet, which: NDArray[np.bool_]) -> ProfileSet:
    """Select some of the profiles."""
    vertices = np.diff(profiles.offset)
    stretches = np.diff(profiles.cell_offset)
    keep_v = np.repeat(which, vertices)
    on_map = profiles.on_map
    return ProfileSet(
        offset=np.concatenate([[0], np.cumsum(vertices[which])]).astype(np.int64),
        s=profiles.s[keep_v],
        z=profiles.z[keep_v],
        ground=profiles.ground[keep_v],
        cell_offset=np.concatenate([[0], np.cumsum(stretches[which])]).astype(np.int64),
        cell_s=profiles.cell_s[np.repeat(which, stretches + 1)],
        cell=profiles.cell[np.repeat(which, stretches)],
        on_map=None if on_map is None else on_map[np.repeat(which, stretches + 1)],
    )


def with_lead_in(profiles: ProfileSet, length_m: float) -> ProfileSet:
    """Let the ground go on behind the start at the slope of the first segment.

    A block that rebounds uphill from the first metres would otherwise be lost from the profile.
    Ground that rises down the line is continued level. No cell of the map belongs to the lead-in,
    which is one more vertex in front, at a chainage of ``-length_m`` (plan length) from the first.
    """
    n = len(profiles)
    first = profiles.offset[:-1]
    fall = (profiles.z[first] - profiles.z[first + 1]) / (profiles.s[first + 1] - profiles.s[first])
    new_s = profiles.s[first] - length_m
    new_z = profiles.z[first] + length_m * np.maximum(fall, 0.0)
    first_cell_s = profiles.cell_offset[:-1] + np.arange(n)
    on_map = profiles.on_map
    if on_map is not None:
        on_map = np.insert(on_map, first_cell_s, on_map[first_cell_s], axis=0)
    return ProfileSet(
        offset=profiles.offset + np.arange(n + 1),
        s=np.insert(profiles.s, first, new_s),
        z=np.insert(profiles.z, first, new_z),
        ground=np.insert(profiles.ground, first, profiles.ground[first]),
        cell_offset=profiles.cell_offset + np.arange(n + 1),
        cell_s=np.insert(profiles.cell_s, first_cell_s, new_s),
        cell=np.insert(profiles.cell, profiles.cell_offset[:-1], -1),
        on_map=on_map,
    )


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan of a simulation before anything is simulated."""

    points: ReleasePoints  # as placed in the release areas
    starts: ReleasePoints  # where their fall lines begin
    moved: FloatArray  # shape (n,); how far up the slope from the points (m)
    surface: Surface
    scenarios: tuple[tuple[int, ...], ...]  # positions in ``blocks`` of the scenarios of each area
    # Of each area, where they are not those of the run for all; else empty.
    repetitions: tuple[int, ...] = ()

    def blocks_of_point(self, run: MapRun) -> IntArray:
        """Return blocks that are released at each point, shape (n,)."""
        rounds = [self.blocks_of_round(run, own) for own in run.rounds]
        if self.repetitions:
            once = self.blocks_of_round(run, Round())
            rounds = [once * np.array(self.repetitions, np.int64)[self.points.area]]
        blocks: IntArray = np.sum(rounds, axis=0, dtype=np.int64)
        return blocks

    def blocks_of_round(self, run: MapRun, own: Round) -> IntArray:
        """Return blocks of a repetition at each point, shape (n,)."""
        repeated = np.zeros(len(self.points), np.int64)
        for area, scenarios in enumerate(self.scenarios):
            of = self.points.area == area
            for k in scenarios:
                repeated[of] += own.repetitions >> (
                    0 if own.halvings is None else own.halvings[of, k].astype(np.int64)
                )
        return repeated * run.release.rocks_per_point


def placed_points(run: MapRun) -> ReleasePoints:
    """Place the release points of a run; errors are those of release.release_points."""
    return release_points([(a.name, a.geometry) for a in run.areas], run.release, run.seed)


def plan(run: MapRun) -> Plan:
    """Place the release points and prepare the surface; errors are those of placed_points."""
    points = placed_points(run)
    surface = fall_line_surface(run.grid, run.terrain)
    polygonal = np.array([a.geometry.area > 0.0 for a in run.areas], bool)
    distance = 0.5 * run.release.spacing_m if run.release.placement == "grid" else 0.0
    starts, moved = moved_uphill(points, surface, distance, polygonal[points.area])
    names = {b.name: i for i, b in enumerate(run.blocks)}
    return Plan(
        points,
        starts,
        moved,
        surface,
        tuple(tuple(names[s] for s in a.scenarios) for a in run.areas),
    )


#: Plan length of the ground behind the start (m).
LEAD_IN_M = 20.0
_SIMPLIFIED = 0.1


@dataclass(frozen=True, slots=True)
class PreparedLines:
    """Lines on which blocks can be simulated."""

    # Shape (n_traced,); which of the traced lines are long enough; all else refers only to these.
    good: NDArray[np.bool_]
    lines: TraceSet
    flat: ProfileSet  # their profiles
    profiles: ProfileSet  # the same with LEAD_IN_M of ground behind the start
    crossings: ControlLineCrossings  # where they cross stations and barriers

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def length_m(self) -> FloatArray:
        """Chainage of the last vertex of each profile (m)."""
        last: FloatArray = self.profiles.s[self.profiles.offset[1:] - 1]
        return last

    def starts(self, moved_m: FloatArray) -> FloatArray:
        """Return chainages between which blocks start, (n, 2); ``moved_m`` as in Plan, by line."""
        return np.column_stack([np.zeros(len(self)), np.minimum(2.0 * moved_m, self.length_m)])


def prepare_lines(run: MapRun, traces: TraceSet) -> PreparedLines:
    """Flatten traced lines, keep those that are usable, and find what they cross."""
    flat = profiles(run.heights, traces, run.ground, run.terrain.segment_tolerance_m)
    good = usable(traces, SHORTEST_LINE_M) & (np.diff(flat.offset) >= 2)
    lines, kept = take_lines(traces, good), take_profiles(flat, good)
    return PreparedLines(
        good,
        lines,
        kept,
        with_lead_in(kept, LEAD_IN_M),
        control_line_crossings(run.all_lines, lines),
    )


def control_line_crossings(
    control_lines: Sequence[tuple[ControlLine, FloatArray]], traces: TraceSet
) -> ControlLineCrossings:
    """Find where lines cross stations and barriers, by rising chainage."""
    found = [crossings(traces, trace) for _, trace in control_lines]
    line = np.concatenate([np.empty(0, np.int64), *(f[0] for f in found)])
    chainage = np.concatenate([np.empty(0), *(f[1] for f in found)])
    control_line = np.repeat(np.arange(len(found), dtype=np.int64), [f[0].size for f in found])
    order = np.lexsort((control_line, chainage, line))
    counts = np.bincount(line, minlength=len(traces)).astype(np.int64)
    return ControlLineCrossings(
        tuple(g for g, _ in control_lines),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        chainage[order],
        control_line[order],
    )


def draw_keys(
    point_keys: NDArray[np.uint64], scenario: str, repetition: int | IntArray = 0
) -> NDArray[np.uint64]:
    """Return release points' identities for the draws of a block scenario in a repetition."""
    out: NDArray[np.uint64] = rng.combined(rng.combined(point_keys, 0), rng.word_of(scenario))
    again = np.asarray(repetition)
    return out if not again.any() else np.where(again > 0, rng.combined(out, again), out)


def drawn_lines(traces: TraceSet, grid: Grid, points: IntArray) -> FallLines:
    """Thin lines of some release points (their numbers in the plan) for drawing.

    They lie within a tenth of a cell of the traced ones.
    """
    counts = np.diff(traces.offset)
    some = counts >= 2
    index = np.repeat(np.arange(len(traces)), counts)
    kept = some[index]
    lines = shapely.simplify(
        shapely.linestrings(
            traces.x[kept], traces.y[kept], indices=np.cumsum(some)[index[kept]] - 1
        ),
        _SIMPLIFIED * grid.cell_size,
        preserve_topology=False,
    )
    xy, owner = shapely.get_coordinates(lines, return_index=True)
    owner = np.flatnonzero(some)[owner]
    # Lines of one point stay as they are.
    single = ~kept
    xy = np.concatenate([xy, np.column_stack([traces.x[single], traces.y[single]])])
    owner = np.concatenate([owner, index[single]])
    order = np.argsort(owner, kind="stable")
    xy, owner = xy[order], owner[order]
    offset = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(traces)))])
    first, final = traces.offset[:-1], np.maximum(traces.offset[1:] - 1, 0)
    heights = grid.values.ravel()
    cells = [grid.cell_of(traces.x[k], traces.y[k]) for k in (first, final)]
    known = (cells[0] >= 0) & (cells[1] >= 0)
    drop = np.where(known, heights[cells[0]] - heights[cells[1]], 0.0)
    return FallLines(
        offset=offset.astype(np.int64),
        x=np.ascontiguousarray(xy[:, 0]),
        y=np.ascontiguousarray(xy[:, 1]),
        point=points[traces.point],
        length_m=np.where(counts >= 1, traces.s[final], 0.0),
        drop_m=np.nan_to_num(drop),
        end=traces.end,
    )
