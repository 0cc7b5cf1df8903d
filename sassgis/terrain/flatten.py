"""Flattening: fall lines unrolled into a vertical plane, and back onto the map.

As in D. Bozzolo and R. Pamini (1986, Simulation of rock falls down a valley side, Acta
Mechanica 63, 113-130, fig. 1a), the trace of the fall line on the terrain is turned into a common
vertical plane (chainage = plan length along the line, height = height of the DEM) and replaced by
straight segments.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import kernel, lean
from sassgis.errors import InputError
from sassgis.grid import BoolArray, FloatArray, Grid, IntArray
from sassgis.settings.results import ProfileSet, TraceSet
from sassgis.terrain.cells import (
    SHORTEST_STRETCH,
    cell_index,
    cell_stretches,
    exact,
    grown,
    height_at,
    most_steps,
    next_crossing,
    next_line,
)

# Height samples closer than this (cells) are not kept apart.
_SAMPLE_GAP = 1e-3
# Chainages this far (m) beyond an end of the line are rounding.
_END_SLACK = 1e-6
# Crossings closer than this (m) on a line are one crossing at a vertex.
_SAME_CROSSING = 1e-6


def profiles(
    grid: Grid, traces: TraceSet, ground: NDArray[np.int32], segment_tolerance_m: float
) -> ProfileSet:
    """Flatten fall lines into profiles of straight segments.

    Heights are those of the DEM as it is, not smoothed, bilinear between cell centres, sampled
    wherever the line crosses a border or a middle line of a cell, and at its points. The samples
    are then thinned (U. Ramer, 1972; D. H. Douglas and T. K. Peucker, 1973, with the vertical
    distance) so that no sample is farther from the segments than the tolerance (m). Where the
    ground class of the cells changes, a vertex is always kept. Each profile depends only on its
    line; a line of a single point gives a single vertex and no stretch. Raises InputError if the
    ground classes are not on the grid.
    """
    if ground.shape != grid.shape:
        raise InputError(
            "ground classes do not lie on the grid of the DEM",
            field="ground",
            found=f"shape {ground.shape}",
            expected=f"shape {grid.shape}",
        )
    u, v = grid.uv(traces.x, traces.y)
    offset, s, z, classes = _flatten(
        traces.offset,
        traces.s,
        u,
        v,
        grid.values,
        np.ascontiguousarray(ground, np.int32),
        _SAMPLE_GAP * grid.cell_size,
        float(segment_tolerance_m),
    )
    cell_offset, cell_s, cell, on_map = cell_stretches(grid, traces)
    return ProfileSet(
        offset=offset,
        s=s,
        z=z,
        ground=classes,
        cell_offset=cell_offset,
        cell_s=cell_s,
        cell=cell,
        on_map=on_map,
    )


def chainage_to_xy(
    traces: TraceSet, line: IntArray | int, s: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Return coordinates (m) of chainages (m) on their lines; NaN for one that is not on its line.

    ``line`` and ``s`` are broadcast; IndexError if there is no such line.
    """
    lines, chainages = np.broadcast_arrays(np.asarray(line, np.int64), np.asarray(s, np.float64))
    shape = lines.shape
    flat = np.ascontiguousarray(lines.ravel())
    if flat.size and (int(flat.min()) < 0 or int(flat.max()) >= len(traces)):
        raise IndexError(f"lines are numbered 0 to {len(traces) - 1}")
    x, y = _to_map(
        traces.offset, traces.s, traces.x, traces.y, flat, np.ascontiguousarray(chainages.ravel())
    )
    return x.reshape(shape), y.reshape(shape)


def xy_to_chainage(
    traces: TraceSet, line: IntArray | int, x: FloatArray | float, y: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Return the chainage of a line's point nearest to points of the map, and the distance (m).

    ``line``, ``x`` and ``y`` are broadcast. Of two points that are equally near the chainage is the
    smaller one. The distance is positive to the right of the line in its direction.
    """
    lines, xs, ys = np.broadcast_arrays(
        np.asarray(line, np.int64), np.asarray(x, np.float64), np.asarray(y, np.float64)
    )
    flat = (np.ascontiguousarray(one.ravel()) for one in (lines, xs, ys))
    s, aside = _nearest(traces.offset, traces.s, traces.x, traces.y, *flat)
    return s.reshape(xs.shape), aside.reshape(xs.shape)


def crossings(traces: TraceSet, control_line_line: FloatArray) -> tuple[IntArray, FloatArray]:
    """Find where a polyline on the map, shape (k, 2), is crossed by fall lines.

    Returns the line of each crossing, rising, and its chainage (m), rising within a line. A line
    that runs along a segment of the polyline does not cross that segment. Raises InputError if the
    polyline has fewer than two vertices.
    """
    control_line = np.ascontiguousarray(control_line_line, np.float64)
    if (
        control_line.ndim != 2
        or control_line.shape[1] != 2
        or control_line.shape[0] < 2
        or not np.isfinite(control_line).all()
    ):
        raise InputError(
            "not a polyline",
            field="control_line",
            found=f"shape {control_line.shape}",
            expected="two or more points with x and y",
        )
    line, s = _cross(
        traces.offset, traces.s, traces.x, traces.y, control_line[:, 0], control_line[:, 1]
    )
    order = np.lexsort((s, line))
    line, s = line[order], s[order]
    again = np.zeros(line.size, np.bool_)
    again[1:] = (np.diff(line) == 0) & (np.diff(s) < _SAME_CROSSING)
    return line[~again], s[~again]


@kernel
def _flatten(
    offset: IntArray,
    s: FloatArray,
    u: FloatArray,
    v: FloatArray,
    heights: FloatArray,
    ground: NDArray[np.int32],
    gap: float,
    tolerance: float,
) -> tuple[IntArray, FloatArray, FloatArray, NDArray[np.int32]]:
    n = offset.size - 1
    out_offset = np.zeros(n + 1, np.int64)
    out_s = np.empty(max(16, s.size))
    out_z = np.empty(out_s.size)
    out_class = np.empty(out_s.size, np.int32)
    samples = _room_for_samples(0)
    count = 0
    for i in range(n):
        own = slice(offset[i], offset[i + 1])
        # A change of the class on the way makes a second sample of a step.
        most = 2 * most_steps(u[own], v[own], 2.0) + 2
        if most > samples.s.size:
            samples = _room_for_samples(2 * most)
        size = _sample(s[own], u[own], v[own], heights, ground, gap, samples)
        keep = _kept(samples.s[:size], samples.z[:size], samples.fixed[:size], tolerance)
        if count + size > out_s.size:
            out_s = grown(out_s, count + size)
            out_z = grown(out_z, count + size)
            out_class = grown(out_class, count + size)
        for k in range(size):
            if keep[k]:
                out_s[count], out_z[count] = samples.s[k], samples.z[k]
                out_class[count] = samples.ground[k]
                count += 1
        out_offset[i + 1] = count
    return out_offset, out_s[:count].copy(), out_z[:count].copy(), out_class[:count].copy()


class _Samples(NamedTuple):
    """Samples of a line."""

    s: FloatArray  # chainage (m)
    z: FloatArray  # height (m)
    ground: NDArray[np.int32]  # class from here on
    fixed: BoolArray  # whether it must stay a vertex


@kernel
def _room_for_samples(n: int) -> _Samples:
    return _Samples(np.empty(n), np.empty(n), np.empty(n, np.int32), np.empty(n, np.bool_))


@lean
def _sample(
    s: FloatArray,
    u: FloatArray,
    v: FloatArray,
    heights: FloatArray,
    ground: NDArray[np.int32],
    gap: float,
    out: _Samples,
) -> int:
    """Fill in the samples of a line; returns their number."""
    # The line is walked over a grid of half cells: whole numbers of 2u are borders of cells and
    # middle lines in turn, and between them the bilinear height has no kink.
    n_rows, n_cols = heights.shape
    size = 1
    cell = cell_index(u[0], v[0], n_rows, n_cols)
    row, col = cell // n_cols, cell % n_cols
    inside = cell >= 0
    out.s[0] = s[0]
    out.z[0] = height_at(heights, u[0], v[0], row, col) if inside else np.nan
    out.ground[0] = ground[row, col] if inside else -1
    out.fixed[0] = True
    first = True
    for k in range(s.size - 1):
        u0, v0, u1, v1 = 2.0 * u[k], 2.0 * v[k], 2.0 * u[k + 1], 2.0 * v[k + 1]
        length = s[k + 1] - s[k]
        line_u, line_v = next_line(u0, u1), next_line(v0, v1)
        t = 0.0
        while t < 1.0:
            t_next, line_u, line_v = next_crossing(u0, u1, line_u, v0, v1, line_v)
            if (t_next - t) * length <= SHORTEST_STRETCH:
                t = t_next
                continue
            middle = 0.5 * (t + t_next)
            cell = cell_index(
                0.5 * (u0 + exact(middle * (u1 - u0))), 0.5 * (v0 + exact(middle * (v1 - v0))),
                n_rows, n_cols
            )  # fmt: skip
            row, col = cell // n_cols, cell % n_cols
            inside = cell >= 0
            new_class = np.int32(ground[row, col] if inside else -1)
            if first:
                out.ground[0] = new_class
                first = False
            if new_class != out.ground[size - 1]:
                begin = s[k] + t * length
                if begin - out.s[size - 1] > SHORTEST_STRETCH:
                    if out.fixed[size - 1] or begin - out.s[size - 1] > gap:
                        size += 1
                    out.s[size - 1] = begin
                    out.z[size - 1] = np.nan
                    if inside:
                        at_u, at_v = u0 + exact(t * (u1 - u0)), v0 + exact(t * (v1 - v0))
                        out.z[size - 1] = height_at(heights, 0.5 * at_u, 0.5 * at_v, row, col)
                out.ground[size - 1] = new_class
                out.fixed[size - 1] = True
            end = s[k] + t_next * length
            if end - out.s[size - 1] > gap:
                out.s[size] = end
                out.z[size] = np.nan
                if inside:
                    at_u, at_v = u0 + exact(t_next * (u1 - u0)), v0 + exact(t_next * (v1 - v0))
                    out.z[size] = height_at(heights, 0.5 * at_u, 0.5 * at_v, row, col)
                out.ground[size] = new_class
                out.fixed[size] = False
                size += 1
            t = t_next
    if s.size > 1:
        last = s.size - 1
        # The last sample is the end of the line, which may lie within the gap behind it.
        if out.s[size - 1] < s[last]:
            if out.fixed[size - 1]:
                out.ground[size] = out.ground[size - 1]
                size += 1
            out.s[size - 1] = s[last]
            out.z[size - 1] = height_at(heights, u[last], v[last], row, col) if inside else np.nan
        out.fixed[size - 1] = True
    return size


@kernel
def _kept(
    s: FloatArray, z: FloatArray, fixed: NDArray[np.bool_], tolerance: float
) -> NDArray[np.bool_]:
    """Return samples to keep so that all others are within the tolerance of the segments."""
    keep = fixed.copy()
    begin = 0
    # Each split adds at most one waiting stretch.
    waiting = np.empty((s.size + 1, 2), np.int64)
    # Heights of a plane differ from a straight line by rounding: that must not keep a vertex.
    limit = tolerance + 1e-9
    for stop in range(1, s.size):
        if not fixed[stop]:
            continue
        waiting[0, 0], waiting[0, 1] = begin, stop
        size = 1
        while size > 0:
            size -= 1
            a, b = waiting[size, 0], waiting[size, 1]
            slope = (z[b] - z[a]) / (s[b] - s[a])
            worst, where = limit, -1
            for k in range(a + 1, b):
                distance = abs(z[k] - z[a] - slope * (s[k] - s[a]))
                if distance > worst:
                    worst, where = distance, k
            if where >= 0:
                keep[where] = True
                waiting[size, 0], waiting[size, 1] = a, where
                waiting[size + 1, 0], waiting[size + 1, 1] = where, b
                size += 2
        begin = stop
    return keep


@kernel
def _to_map(
    offset: IntArray,
    s: FloatArray,
    x: FloatArray,
    y: FloatArray,
    line: IntArray,
    chainage: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    out_x = np.full(line.size, np.nan)
    out_y = np.full(line.size, np.nan)
    for i in range(line.size):
        first, last = offset[line[i]], offset[line[i] + 1] - 1
        where = chainage[i]
        if not (where >= s[first] - _END_SLACK and where <= s[last] + _END_SLACK):
            continue
        low, high = first, last
        while high - low > 1:
            middle = (low + high) // 2
            if s[middle] <= where:
                low = middle
            else:
                high = middle
        if high == low:
            out_x[i], out_y[i] = x[low], y[low]
        else:
            share = min(1.0, max(0.0, (where - s[low]) / (s[high] - s[low])))
            out_x[i] = x[low] + share * (x[high] - x[low])
            out_y[i] = y[low] + share * (y[high] - y[low])
    return out_x, out_y


@kernel
def _nearest(
    offset: IntArray,
    s: FloatArray,
    x: FloatArray,
    y: FloatArray,
    line: IntArray,
    px: FloatArray,
    py: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    out_s = np.empty(px.size)
    out_d = np.empty(px.size)
    for i in range(px.size):
        first, last = offset[line[i]], offset[line[i] + 1] - 1
        out_s[i] = s[first]
        out_d[i] = np.hypot(px[i] - x[first], py[i] - y[first])
        best = np.inf
        for k in range(first, last):
            dx, dy = x[k + 1] - x[k], y[k + 1] - y[k]
            ex, ey = px[i] - x[k], py[i] - y[k]
            share = min(1.0, max(0.0, (ex * dx + ey * dy) / (dx * dx + dy * dy)))
            distance = np.hypot(ex - share * dx, ey - share * dy)
            if distance < best:
                best = distance
                out_s[i] = s[k] + share * (s[k + 1] - s[k])
                out_d[i] = distance if dx * ey - dy * ex <= 0.0 else -distance
    return out_s, out_d


@kernel
def _cross(
    offset: IntArray, s: FloatArray, x: FloatArray, y: FloatArray, gx: FloatArray, gy: FloatArray
) -> tuple[IntArray, FloatArray]:
    lines = np.empty(64, np.int64)
    chainages = np.empty(64)
    count = 0
    west, east, south, north = gx.min(), gx.max(), gy.min(), gy.max()
    for i in range(offset.size - 1):
        for k in range(offset[i], offset[i + 1] - 1):
            x0, y0, x1, y1 = x[k], y[k], x[k + 1], y[k + 1]
            if (
                max(x0, x1) < west
                or min(x0, x1) > east
                or max(y0, y1) < south
                or min(y0, y1) > north
            ):
                continue
            dx, dy = x1 - x0, y1 - y0
            for g in range(gx.size - 1):
                ex, ey = gx[g + 1] - gx[g], gy[g + 1] - gy[g]
                cross = dx * ey - dy * ex
                if cross == 0.0:
                    continue
                fx, fy = gx[g] - x0, gy[g] - y0
                on_line = (fx * ey - fy * ex) / cross
                on_control_line = (fx * dy - fy * dx) / cross
                # Both ends belong to a segment: crossings at a vertex are found twice, not never.
                if 0.0 <= on_line <= 1.0 and 0.0 <= on_control_line <= 1.0:
                    if count == lines.size:
                        lines = grown(lines, count + 1)
                        chainages = grown(chainages, count + 1)
                    lines[count] = i
                    chainages[count] = s[k] + on_line * (s[k + 1] - s[k])
                    count += 1
    return lines[:count].copy(), chainages[:count].copy()
