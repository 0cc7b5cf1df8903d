"""The stretch of a fall line on which its blocks start, and the ground behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray
from sassgis.settings.profiles import ProfileSet, ReleasePoints, TraceSet
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
