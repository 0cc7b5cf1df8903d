"""Fall lines: where a block's path leads down the terrain.

On descending ground a fall line follows the steepest descent of a smooth surface through the DEM,
at any point and in any direction, not from cell to cell. Where the ground is nearly flat or rises
ahead, the direction of steepest descent says little about a block that arrives with speed: there
the line keeps its heading, so that it runs out over a valley floor and up the other side, until
the ground ahead descends again. What a block really does on that line is left to the engine.

A line that follows the descent does so until the slope falls below the flat slope (tangent m_f) or
the descent turns away from the heading by more than 60°. From there it coasts:

    d psi / d s = (psi_d - psi) q min(1, q) a(cos(psi_d - psi)) / L,    q = m / m_f,

with heading psi, direction of steepest descent psi_d, slope m (tangent), turning length L, and a
smooth step ``a`` from 0 (descent across or backwards) to 1 (within 60° of the heading). It
follows again once the slope is m_f or more and the heading has come within 5° of the descent.
These are equations of the line, free of the step with which they are solved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.compiled.jit import kernel, lean
from sassgis.grid import BoolArray, FloatArray, Grid, IntArray
from sassgis.settings.results import ControlLine, LineEnd, ReleasePoints, TraceSet
from sassgis.settings.settings import TerrainSettings
from sassgis.terrain.cells import exact, exact_positions, grown, height_at, next_share
from sassgis.terrain.surface import Surface, shape_at, slope_at, smoothed, standing
from sassgis.terrain.surface import surface as spline

_VALID = -1
_ENERGY_LINE = int(LineEnd.ENERGY_LINE)
_MAX_LENGTH = int(LineEnd.MAX_LENGTH)
_CLOSED_LOOP = int(LineEnd.CLOSED_LOOP)

# L above: on ground of the flat slope a coasting line turns towards the descent over this length;
# over four times as much on ground half as steep, half as much on ground twice as steep. It is
# about the radius v² / (g sin) on which gravity bends the path of a body that moves across a slope
# of 8° at 8 m/s. That slope, the default, is well below the 20° or so on which blocks still roll
# on, so that whatever arrives there arrives with speed, and above most floors and debris fans.
_TURNING_LENGTH_M = 50.0
# Where the terrain rises above a line from the release point at the angle of the energy line, over
# the plan length of the fall line, it ends: one overall friction angle from source to stop is the
# idea of A. Heim (1932, Bergsturz und Menschenleben). Over this first part that is not tested: a
# release point on the gentle shoulder above a cliff is not cut off before the cliff.
_ENERGY_LINE_FREE_M = 25.0
# All in cells or radians. On two alpine DEMs of 5 m, smoothed by 5 m, steps about three times as
# fine move nine lines in ten by less than an eighth of a cell anywhere on their path; those that
# move more pass a divide or a pit so closely that any change of the terrain would move them.
_STEP = 1.0
_SHORTEST_STEP = 1.0 / 128.0
_POINT_DISTANCE = 1.0
_TURN_PER_STEP = 0.2
_TURN_PER_POINT = 0.1
_RATE_PER_STEP = 0.4
_COS_STEP = math.cos(2.0 * _TURN_PER_STEP)
_COS_POINT = math.cos(_TURN_PER_POINT)
# A line that comes this near to itself, after at least this length of path, has closed.
_LOOP_DISTANCE = 0.5
_LOOP_WAY = 4.0
# Ends lie this much inside the last valid cell: rounding of map coordinates cannot push them out.
_INSIDE = 1e-6
_ALIGNED = 0.5
_AGREED = math.cos(math.radians(5.0))
# Gradients (m per cell) below this are rounding of a level surface.
_LEVEL = 1e-10


def fall_line_surface(grid: Grid, settings: TerrainSettings) -> Surface:
    """Smooth and interpolate the terrain on which fall lines are traced."""
    return spline(smoothed(grid, settings.smoothing_m))


def trace(
    grid: Grid, surface: Surface, points: ReleasePoints, settings: TerrainSettings
) -> TraceSet:
    """Trace the fall lines of release points.

    Each line depends on only its release point, so that tracing the points in chunks, in any
    order or in threads, gives the same lines to the last bit.

    A line ends, and says so by its LineEnd, where

    - LEFT_DEM, NODATA: the next cell lies outside the DEM, or has no height. The line ends at the
      last valid point (a millionth of a cell before the border). A release point there gives a
      line of that single point.
    - ENERGY_LINE: the terrain rises above the energy line of the release point: a block cannot be
      expected beyond. It starts from the height of the DEM at the release point, or of the smoothed
      surface if that is higher, and is compared with the smoothed surface.
    - MAX_LENGTH: the plan length is used up.
    - CLOSED_LOOP: the line comes back to itself. A release point on exactly level ground, which
      has no direction to leave in, gives a line of a single point and this reason.

    Parameters
    ----------
    grid : Grid
        The DEM as it is.
    surface : Surface
        The surface traced on, on the same grid; see fall_line_surface.
    points : ReleasePoints
        All or a part of the release points; each has a line, with points about every half cell,
        closer where the line turns.
    """
    cell = grid.cell_size
    u, v = (exact_positions(own) for own in grid.uv(points.x, points.y))
    offset, lines, end = _trace_all(
        surface.coefficients,
        surface.valid,
        grid.values,
        u,
        v,
        np.tan(np.radians(settings.flat_slope_deg)) * cell,
        _TURNING_LENGTH_M / cell,
        np.tan(np.radians(settings.energy_line_angle_deg)) * cell,
        _ENERGY_LINE_FREE_M / cell,
        settings.max_line_length_m / cell,
    )
    x = grid.west + lines[:, 0] * cell
    y = grid.north - lines[:, 1] * cell
    # Release points keep their coordinates to the last bit.
    x[offset[:-1]] = points.x
    y[offset[:-1]] = points.y
    return TraceSet(
        offset=offset,
        x=x,
        y=y,
        s=lines[:, 2] * cell,
        point=np.arange(len(points), dtype=np.int64),
        end=end,
    )


@kernel
def _trace_all(
    coefficients: FloatArray,
    valid: BoolArray,
    heights: FloatArray,
    u: FloatArray,
    v: FloatArray,
    flat: float,
    turning: float,
    energy: float,
    free: float,
    max_length: float,
) -> tuple[IntArray, FloatArray, NDArray[np.uint8]]:
    """Return lines of all release points; lengths in cells, slopes in metres per cell."""
    n = u.size
    offset = np.zeros(n + 1, np.int64)
    end = np.zeros(n, np.uint8)
    lines = np.empty((max(64, 256 * n), 3))
    count = 0
    line = np.empty((1024, 3))
    for i in range(n):
        line, size, reason = _trace_line(
            coefficients, valid, heights, u[i], v[i], flat, turning, energy, free, max_length, line
        )
        if count + size > lines.shape[0]:
            lines = grown(lines, count + size)
        for k in range(size):
            for j in range(3):
                lines[count + k, j] = line[k, j]
        count += size
        offset[i + 1] = count
        end[i] = reason
    return offset, lines[:count].copy(), end


@kernel
def _trace_line(
    coefficients: FloatArray,
    valid: BoolArray,
    heights: FloatArray,
    u: float,
    v: float,
    flat: float,
    turning: float,
    energy: float,
    free: float,
    max_length: float,
    line: FloatArray,
) -> tuple[FloatArray, int, int]:
    """Trace a line into a buffer of rows (u, v, s); returns it, its fill and the LineEnd."""
    line[0, 0], line[0, 1], line[0, 2] = u, v, 0.0
    size = 1
    reason = standing(valid, u, v)
    if reason != _VALID:
        return line, size, reason
    z, gu, gv, huu, huv, hvv = shape_at(coefficients, u, v)
    top = max(z, height_at(heights, u, v, int(v), int(u)))
    slope = _length(gu, gv)
    if slope <= _LEVEL:
        return line, size, _CLOSED_LOOP
    hu, hv = _downhill(gu, gv)
    out_hu, out_hv = hu, hv
    since_out = 0.0
    longest = _STEP
    attached = slope >= flat
    while True:
        s_old = line[size - 1, 2] + _length(u - line[size - 1, 0], v - line[size - 1, 1])
        # How fast the direction of descent changes along and across it (per cell).
        bend = _bend(gu, gv, huu, huv, hvv, slope)
        step = min(longest, _POINT_DISTANCE - since_out)
        limit = step
        following = attached
        ku, kv = hu, hv
        if following:
            step = max(min(step, _RATE_PER_STEP / (bend + 1e-300)), _SHORTEST_STEP)
            step = min(step, max_length - s_old)
            ku, kv, following = _descend(coefficients, u, v, gu, gv, hu, hv, step, flat)
            nu, nv = ku, kv
            # Where the descent is lost decides the heading of what follows: find the place.
            if not following and step > 2.0 * _SHORTEST_STEP:
                longest = 0.5 * step
                continue
        if not following:
            rate = _turn_rate(gu, gv, hu, hv, slope, flat, turning)
            turn = abs(_angle(gu, gv, hu, hv))
            step = min(_coasting_step(limit, rate, turn, bend), max_length - s_old)
            ku, kv, nu, nv = _coast(coefficients, u, v, gu, gv, hu, hv, step, flat, turning)
        u_new, v_new = u + exact(step * ku), v + exact(step * kv)
        share, reason = _way_open(valid, u, v, u_new, v_new)
        z_new, gu_new, gv_new, huu, huv, hvv = shape_at(coefficients, u_new, v_new)
        slope_new = _length(gu_new, gv_new)
        attached_new = False
        if slope_new >= flat:
            near = _ALIGNED if following else _AGREED
            au, av = _downhill(gu_new, gv_new)
            if au * nu + av * nv >= near:
                nu, nv, attached_new = au, av, True
        # Too long a step if the direction turned much or the descent was lost: again, shorter.
        lost = nu * hu + nv * hv < _COS_STEP or not attached_new
        if following and lost and reason == _VALID and step > 2.0 * _SHORTEST_STEP:
            longest = 0.5 * step
            _, _, _, huu, huv, hvv = shape_at(coefficients, u, v)
            continue
        longest = min(_STEP, 2.0 * longest)

        s_new = line[size - 1, 2] + _length(u_new - line[size - 1, 0], v_new - line[size - 1, 1])
        if s_new >= max_length - _INSIDE and reason == _VALID:
            reason = _MAX_LENGTH
        excess, excess_new = z - top + energy * s_old, z_new - top + energy * s_new
        if excess_new > 0.0 and s_new > free:
            cut = 0.0 if excess > 0.0 else excess / (excess - excess_new)
            if s_new > s_old:
                cut = max(cut, min(1.0, (free - s_old) / (s_new - s_old)))
            if cut <= share:
                share, reason = cut, _ENERGY_LINE
        if reason != _VALID:
            u_new, v_new = u + exact(share * (u_new - u)), v + exact(share * (v_new - v))
        moved = share * step
        since_out += moved
        if (
            reason != _VALID
            or since_out >= _POINT_DISTANCE - 1e-9
            or nu * out_hu + nv * out_hv < _COS_POINT
        ):
            gap = _length(u_new - line[size - 1, 0], v_new - line[size - 1, 1])
            if gap > 10.0 * _INSIDE:
                if size == line.shape[0]:
                    line = grown(line, size + 1)
                line[size, 0], line[size, 1] = u_new, v_new
                line[size, 2] = line[size - 1, 2] + gap
                size += 1
                if reason == _VALID and _closes(line, size):
                    reason = _CLOSED_LOOP
            since_out = 0.0
            out_hu, out_hv = nu, nv
        if reason != _VALID:
            return line, size, reason
        u, v, z, gu, gv, slope, hu, hv = u_new, v_new, z_new, gu_new, gv_new, slope_new, nu, nv
        attached = attached_new


@lean
def _coasting_step(limit: float, rate: float, turn: float, bend: float) -> float:
    """Return the length of a step off the descent (cells) in which the heading turns little."""
    step = min(limit, 0.25, _TURN_PER_STEP / (rate * turn + 1e-300))
    step = min(step, _RATE_PER_STEP / (np.sqrt(rate * min(bend, 1e12)) + 1e-300))
    return float(max(step, _SHORTEST_STEP))


@lean
def _length(a: float, b: float) -> float:
    """Return the length of a vector, without hypot's guard against overflow, which takes long."""
    return float(np.sqrt(a * a + b * b))


@lean
def _downhill(gu: float, gv: float) -> tuple[float, float]:
    """Return unit vector of steepest descent; (0, 0) on level ground."""
    size = _length(gu, gv)
    if size <= _LEVEL:
        return 0.0, 0.0
    return -gu / size, -gv / size


@lean
def _along(gu: float, gv: float, hu: float, hv: float) -> float:
    """Return the cosine of the angle between descent and heading; -1 on level ground."""
    au, av = _downhill(gu, gv)
    if au == 0.0 and av == 0.0:
        return -1.0
    return au * hu + av * hv


@lean
def _angle(gu: float, gv: float, hu: float, hv: float) -> float:
    """Return the angle from the heading to the descent (rad); 0 on level ground."""
    au, av = _downhill(gu, gv)
    if au == 0.0 and av == 0.0:
        return 0.0
    return float(np.arctan2(hu * av - hv * au, hu * au + hv * av))


@lean
def _bend(gu: float, gv: float, huu: float, huv: float, hvv: float, slope: float) -> float:
    """Return the change of the direction of descent per cell, along plus across (rad per cell)."""
    if slope <= _LEVEL:
        return 1e12
    tu, tv = gu / slope, gv / slope
    across = tv * tv * huu - 2.0 * tu * tv * huv + tu * tu * hvv
    along = tu * tv * (hvv - huu) + (tu * tu - tv * tv) * huv
    return (abs(across) + abs(along)) / slope


@lean
def _turn_rate(
    gu: float, gv: float, hu: float, hv: float, slope: float, flat: float, turning: float
) -> float:
    """Return the rate at which a coasting heading turns towards the descent (per cell)."""
    cosine = min(1.0, max(0.0, _along(gu, gv, hu, hv) / _ALIGNED))
    agreement = cosine * cosine * (3.0 - 2.0 * cosine)
    steepness = slope / flat if flat > 0.0 else 1.0
    return agreement * steepness * min(1.0, steepness) / turning


@lean
def _descend(
    coefficients: FloatArray,
    u: float,
    v: float,
    gu: float,
    gv: float,
    hu: float,
    hv: float,
    step: float,
    flat: float,
) -> tuple[float, float, bool]:
    """Return the mean direction of a Runge-Kutta step down the slope, and whether it holds.

    It does not hold if the step meets flat ground or a descent that turns away.
    """
    au, av = _downhill(gu, gv)
    ku, kv = au, av
    sum_u, sum_v = au, av
    for stage in range(3):
        reach = step if stage == 2 else 0.5 * step
        gu, gv = slope_at(coefficients, u + exact(reach * ku), v + exact(reach * kv))
        ku, kv = _downhill(gu, gv)
        if _length(gu, gv) < flat or ku * hu + kv * hv < _ALIGNED:
            return hu, hv, False
        weight = 1.0 if stage == 2 else 2.0
        sum_u += weight * ku
        sum_v += weight * kv
    return sum_u / 6.0, sum_v / 6.0, True


@lean
def _coast(
    coefficients: FloatArray,
    u: float,
    v: float,
    gu: float,
    gv: float,
    hu: float,
    hv: float,
    step: float,
    flat: float,
    turning: float,
) -> tuple[float, float, float, float]:
    """Return midpoint step with a heading that turns at a rate: mean direction, new heading.

    The heading relaxes exponentially towards the descent, which is stable for any rate.
    """
    rate = _turn_rate(gu, gv, hu, hv, _length(gu, gv), flat, turning)
    angle = _angle(gu, gv, hu, hv)
    mu, mv = _turned(hu, hv, -angle * np.expm1(-0.5 * rate * step))
    half = 0.5 * step
    gu, gv = slope_at(coefficients, u + exact(half * mu), v + exact(half * mv))
    rate = _turn_rate(gu, gv, hu, hv, _length(gu, gv), flat, turning)
    angle = _angle(gu, gv, hu, hv)
    mu, mv = _turned(hu, hv, -angle * np.expm1(-0.5 * rate * step))
    nu, nv = _turned(hu, hv, -angle * np.expm1(-rate * step))
    return mu, mv, nu, nv


@lean
def _turned(hu: float, hv: float, angle: float) -> tuple[float, float]:
    """Return the unit vector turned by an angle, and made a unit vector again."""
    c, s = np.cos(angle), np.sin(angle)
    tu, tv = c * hu - s * hv, s * hu + c * hv
    size = _length(tu, tv)
    return tu / size, tv / size


@lean
def _way_open(valid: BoolArray, u0: float, v0: float, u1: float, v1: float) -> tuple[float, int]:
    """Return the share of a step (below a cell) that runs over valid cells, and what stops it."""
    if int(np.floor(u0)) == int(np.floor(u1)) and int(np.floor(v0)) == int(np.floor(v1)):
        return 1.0, _VALID
    # A start on a border belongs to the cell east or south of it: going back, it leaves at once.
    t_u = next_share(u0, u1, np.floor(u0) + (1.0 if u1 > u0 else 0.0))
    t_v = next_share(v0, v1, np.floor(v0) + (1.0 if v1 > v0 else 0.0))
    first, second = min(t_u, t_v), min(1.0, max(t_u, t_v))
    length = _length(u1 - u0, v1 - v0)
    if second > first:
        middle = 0.5 * (first + second)
        if first <= 1.0:
            state = standing(valid, u0 + middle * (u1 - u0), v0 + middle * (v1 - v0))
            if state != _VALID:
                return max(0.0, first - _INSIDE / length), state
    state = standing(valid, u1, v1)
    if state != _VALID:
        return max(0.0, second - _INSIDE / length), state
    return 1.0, _VALID


@lean
def _closes(line: FloatArray, size: int) -> bool:
    """Return whether the last point lies near an earlier part of the line."""
    u, v, s = line[size - 1, 0], line[size - 1, 1], line[size - 1, 2]
    # A point at distance d rules out all others within d less the limit along the line, so that a
    # line that leads away costs next to nothing.
    k = 0
    while k < size - 1 and s - line[k, 2] > _LOOP_WAY:
        distance = _length(u - line[k, 0], v - line[k, 1])
        if distance < _LOOP_DISTANCE:
            return True
        # Points lie at most _POINT_DISTANCE apart: skipping so many cannot pass the next candidate.
        k += max(1, int((distance - _LOOP_DISTANCE) / _POINT_DISTANCE) - 1)
    return False


#: Distances in plan by which lines are moved (m); downslope is positive.
MOVES_M = tuple(float(m) for m in range(-60, 61, 20) if m)
#: Copies of all lines together at most: each is one more station that every path is cut with.
MOST_COPIES = 90


@dataclass(frozen=True, slots=True)
class MovedLine:
    """A copy of a line."""

    of: int  # position of the line itself among the lines
    moved_m: float  # distance in plan, downslope positive (m)
    trace: FloatArray  # shape (n, 2); x and y of its vertices (m)

    def as_station(self, name: str) -> tuple[ControlLine, FloatArray]:
        """Return a station there: it records blocks and stops none."""
        return ControlLine(f"{name} {self.moved_m:+g} m", "station"), self.trace


def moved_lines(
    grid: Grid, lines: Sequence[tuple[ControlLine, FloatArray]]
) -> tuple[MovedLine, ...]:
    """Copy each line by MOVES_M along the mean fall of the ground below it.

    Those that leave the terrain are left out; none are made where the ground is level, or where
    there would be more than MOST_COPIES.
    """
    if len(lines) * len(MOVES_M) > MOST_COPIES:
        return ()
    return tuple(
        copy
        for number, (_, trace) in enumerate(lines)
        for copy in _copies(grid, number, np.asarray(trace, np.float64))
    )


def mean_height_m(grid: Grid, trace: FloatArray) -> float:
    """Return the mean height of the known ground below a line (m); NaN where none is known."""
    heights = grid.value_at(*points_on(grid, trace).T)
    known = heights[np.isfinite(heights)]
    return float(known.mean()) if known.size else float("nan")


def _copies(grid: Grid, number: int, trace: FloatArray) -> list[MovedLine]:
    points = points_on(grid, trace)
    reach = max(2.0 * grid.cell_size, 10.0)
    aside = reach * np.eye(2)
    fall = [grid.value_at(*(points - d).T) - grid.value_at(*(points + d).T) for d in aside]
    known = np.isfinite(fall).all(axis=0)
    down = np.array([f[known].mean() if known.any() else 0.0 for f in fall])
    if not np.hypot(*down) > 0.0:
        return []
    down /= np.hypot(*down)
    copies = [MovedLine(number, m, trace + m * down) for m in MOVES_M]
    return [c for c in copies if np.isfinite(grid.value_at(*points_on(grid, c.trace).T)).all()]


def points_on(grid: Grid, trace: FloatArray, cells: float = 1.0) -> FloatArray:
    """Return points on a line, so many cells apart at most."""
    dense = shapely.segmentize(shapely.LineString(trace), cells * grid.cell_size)
    points: FloatArray = shapely.get_coordinates(dense)
    return points
