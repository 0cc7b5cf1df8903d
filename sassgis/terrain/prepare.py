"""From release points to the profiles on which blocks are simulated: traced, flattened, usable.

Every run goes through here: maps, single profiles from the terrain, and diagnoses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.compiled import rng
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.map_run import FallLines, MapRun
from sassgis.settings.profiles import ControlLineCrossings, ProfileSet, TraceSet
from sassgis.settings.results import ControlLine
from sassgis.terrain.flatten import crossings, profiles
from sassgis.terrain.stretch import SHORTEST_LINE_M, take_lines, take_profiles, usable, with_lead_in

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
        control_line_crossings(run.control_lines, lines),
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
        offset.astype(np.int64),
        np.ascontiguousarray(xy[:, 0]),
        np.ascontiguousarray(xy[:, 1]),
        points[traces.point],
        np.where(counts >= 1, traces.s[final], 0.0),
        np.nan_to_num(drop),
        traces.end,
    )
