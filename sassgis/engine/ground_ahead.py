"""The ground along a path that is followed: a profile that is sampled just ahead of the block.

Between two turns of its heading a block moves in a vertical plane, over the heights of the terrain
along a straight line in plan. Where the heading turns (heading.py) the profile begins anew, on the
plane of the ground that the block touches, turned with the heading; that plane goes on until the
terrain has left it by the tolerance. So the position of the block to the ground is unchanged, and
the path, unfolded, is a profile in one plane, as in Bozzolo and Pamini (1986, Fig. 1).

Positions in plan are in cells from the outer corner of the grid: u eastward, v southward.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import fused, inlined, lean
from sassgis.engine.barriers import ControlLineTable, set_line
from sassgis.engine.cell_register import CellRegister, registered
from sassgis.engine.ellipse import CountedRows, Record, Records, empty_table
from sassgis.engine.flight import MARGIN_M
from sassgis.engine.recording import STRETCH_DTYPE
from sassgis.engine.state import CROSSING_DTYPE, FLIGHT, VERTEX_DTYPE, Block, Site
from sassgis.grid import FloatArray, IntArray
from sassgis.terrain.cells import SHORTEST_STRETCH, cell_index, exact, height_at, next_line

# Vertices, stretches and crossings of the ground just ahead for which there is room.
_ROOM = 512
#: Ground behind a block, in its longest semi-axes.
BEHIND = 4.0
# Least length of a plane, as a share of the shorter semi-axis: a plane that ended under the block,
# at the limit of the tolerance, would begin anew endlessly.
_LEAST_PLANE = 0.05
# A parabola may lie off its chord by this share of the tolerance.
_BENT = 0.25
# A line nearer than this (m) to where the block has met it is the same crossing: places in plan are
# rounded.
_SAME_CROSSING_M = 1e-6
# A line is near a cell if it comes closer than this (cells): places in plan are rounded.
_BESIDE = 1e-6
# Bits of the lines near a cell; lines whose numbers differ by a multiple of 63 share one. The last
# one says that they are known.
_LINE_BITS = 63
_KNOWN = np.uint64(1) << np.uint64(_LINE_BITS)
_ALL_LINES = np.uint64(2**64 - 1)
# Heights of a plane differ from a straight line by rounding: no vertex below this (m).
_ROUNDING = 1e-9


class Path(NamedTuple):
    """Terrain and lines on which a path is followed."""

    heights: FloatArray  # (n_rows, n_cols), of the cell centres (m)
    ground: NDArray[np.int32]  # as heights: position in the ground table
    stems: FloatArray  # (n_cells,) per m²; empty without a forest
    diameter: FloatArray  # as stems, of the stems (m)
    cell_size: float  # (m)
    tolerance: float  # largest vertical gap between terrain and segments (m)
    side_tilt: float  # standard deviation of the sideways tilt of what an impact meets (rad)
    drift: float  # standard deviation of the angle by which blocks drift sideways (rad)
    # (n, 4), of the points of a chunk: u and v of both sides of the parallelogram in which their
    # blocks start (cells).
    sides: FloatArray
    line_u: FloatArray  # vertices of all stations and barriers, one after the other (cells)
    line_v: FloatArray
    line_first: IntArray  # (n + 1,), by the number: where the vertices of each begin
    line_box: FloatArray  # (n, 4), by the number: least and largest u, least and largest v
    lines: ControlLineTable  # by the number
    line_seen: NDArray[np.bool_]  # by the number: whether the block has been here
    # By the number of a cell: lines that may come to it, as _lines_near has them; 0: not looked at.
    near: NDArray[np.uint64]
    register: CellRegister


def room_ahead(grounds: Records, times: int = 1) -> Site:
    """Make room for the ground ahead, so many times; classes as in ground_switch.GROUND_DTYPE."""
    n = times * _ROOM
    return Site(
        empty_table(n, VERTEX_DTYPE), grounds, empty_table(n, CROSSING_DTYPE),
        empty_table(3 * n, STRETCH_DTYPE),
    )  # fmt: skip


@inlined
def place(state: Record, x: float) -> tuple[float, float]:
    """Return the place in plan at a chainage of the present heading (cells)."""
    along = x - state.from_x
    return state.from_u + exact(along * state.du), state.from_v + exact(along * state.dv)


@fused
def gradient(path: Path, u: float, v: float, radius: float) -> tuple[float, float, bool]:
    """Return the terrain's slope along u and v at block scale (m per m), and whether it is known.

    Central differences over its diameter, or a cell if that is longer; at an edge one-sided.
    """
    step = exact(max(radius / path.cell_size, 0.5))
    east = terrain_height(path, u + step, v)
    west = terrain_height(path, u - step, v)
    south = terrain_height(path, u, v + step)
    north = terrain_height(path, u, v - step)
    per = 1.0 / (2.0 * step * path.cell_size)
    gu = (east - west) * per
    gv = (south - north) * per
    if math.isnan(gu) or math.isnan(gv):
        own = terrain_height(path, u, v)
        gu = _rise_across(west, own, east) * per
        gv = _rise_across(north, own, south) * per
        if math.isnan(gu) or math.isnan(gv):
            return 0.0, 0.0, False
    return gu, gv, True


@lean
def _rise_across(before: float, own: float, after: float) -> float:
    """Return the rise from side to side (m), twice that of one half if the other is not known."""
    if math.isnan(after):
        return 2.0 * (own - before)
    if math.isnan(before):
        return 2.0 * (after - own)
    return after - before


@inlined
def terrain_height(path: Path, u: float, v: float) -> float:
    """Return the height of the terrain (m); NaN where it is not known."""
    return height_at(path.heights, u, v, int(np.floor(v)), int(np.floor(u)))


@fused
def begin_profile(
    state: Record, block: Block, site: Site, path: Path, z: float, slope: float, ground: int,
    gravity: float, behind: int,
) -> None:  # fmt: skip
    """Begin the profile at the present chainage, on a plane through height z (m) there.

    ``slope`` is the rise of the plane per metre ahead, ``ground`` the class of the ground,
    ``behind`` how many vertices keep_behind has kept; 0: the plane goes on behind the block.
    """
    state.sampled = state.x
    state.open = True
    state.segment = behind
    state.stretch = behind
    state.on_plane = True
    state.plane_at = behind
    state.plane_z = z
    state.plane_slope = slope
    first = site.profile.rows[0]
    if behind == 0:
        first.x = state.x - BEHIND * block.a
        first.z = z + slope * (first.x - state.x)
        first.ground = ground
        site.profile.n[0] = 0
    start = site.stretches.rows[0]
    site.stretches.n[0] = 0
    start.start = first.x
    start.u, start.v = place(state, first.x)
    if behind > 0:
        u, v = place(state, state.x)
        cell = cell_index(u, v, path.heights.shape[0], path.heights.shape[1])
        for i in range(behind):
            _add_stretch(state, site, path, cell, i, site.profile.rows[i + 1].x)
    _keep_crossings(state, site)
    look_ahead(state, block, site, path, known_to(state, block), gravity)


@inlined
def known_to(state: Record, block: Block) -> float:
    """Return the chainage (m) up to which ground must be known under and just ahead of a block."""
    return float(state.x + block.a + 4.0 * MARGIN_M)


@fused
def add_vertex(site: Site, x: float, z: float) -> None:
    """End the last segment at chainage x and height z (m); the ground is that of the last."""
    profile = site.profile
    n = profile.n[0]
    here = profile.rows[n]
    dx = x - here.x
    dz = z - here.z
    here.length = math.sqrt(dx * dx + dz * dz)
    here.tx = dx / here.length
    here.tz = dz / here.length
    here.angle = math.nan
    after = profile.rows[n + 1]
    after.x = x
    after.z = z
    after.ground = here.ground
    profile.n[0] = n + 1


@fused
def _add_stretch(
    state: Record, site: Site, path: Path, cell: int, segment: int, end: float
) -> None:
    """Let the stretches go on in a cell (flat index) up to a chainage (m)."""
    stretches = site.stretches
    n = stretches.n[0]
    number = registered(path.register, cell) if cell >= 0 else -1
    if path.near.size:
        state.near |= _lines_near(path, number, cell)
    if n == 0 or stretches.rows[n - 1].cell != number or stretches.rows[n - 1].segment != segment:
        row = stretches.rows[n]
        row.cell = number
        row.segment = segment
        if path.stems.size:
            row.stems = path.stems[cell] if cell >= 0 else 0.0
            row.diameter = path.diameter[cell] if cell >= 0 else 0.0
        n += 1
        stretches.n[0] = n
    after = stretches.rows[n]
    after.start = end
    after.u, after.v = place(state, end)


@inlined
def _bit(line: int) -> np.uint64:
    return np.uint64(1) << np.uint64(line % _LINE_BITS)


@inlined
def _lines_near(path: Path, number: int, cell: int) -> np.uint64:
    """Return the lines that may come to a cell (number in the chunk, flat index), as bits."""
    if number < 0:
        return _ALL_LINES
    if path.near[number] == 0:
        path.near[number] = _look_for_lines(path, cell)
    near: np.uint64 = path.near[number]
    return near


@lean
def _look_for_lines(path: Path, cell: int) -> np.uint64:
    """Return the lines of which a segment's box meets a cell (flat index), as bits."""
    n_cols = path.heights.shape[1]
    west = cell % n_cols - _BESIDE
    north = cell // n_cols - _BESIDE
    east = west + 1.0 + 2.0 * _BESIDE
    south = north + 1.0 + 2.0 * _BESIDE
    near = _KNOWN
    for number in range(path.line_seen.size):
        box = path.line_box[number]
        if west > box[1] or east < box[0] or north > box[3] or south < box[2]:
            continue
        for k in range(path.line_first[number], path.line_first[number + 1] - 1):
            u0 = path.line_u[k]
            v0 = path.line_v[k]
            u1 = path.line_u[k + 1]
            v1 = path.line_v[k + 1]
            if max(u0, u1) < west or min(u0, u1) > east or max(v0, v1) < north:
                continue
            if min(v0, v1) <= south:
                near |= _bit(number)
                break
    return near


@inlined
def _full(site: Site) -> bool:
    """Return whether there is no room for another sample."""
    return bool(
        site.profile.n[0] + 3 >= site.profile.rows.size
        or site.stretches.n[0] + 3 >= site.stretches.rows.size
    )


class Patch(NamedTuple):
    """A segment of the path under which the terrain has no kink, and the cells that it crosses."""

    end: float  # chainage (m)
    z: float  # height of the terrain at its end (m)
    ground: int | np.int64
    cells: int  # how many it crosses, 1 to 3; 0 where the terrain is not known
    cell: int  # flat indices of them
    second: int
    third: int
    border: float  # chainages at which it comes into the second and the third (m)
    later: float


@lean
def look_ahead(
    state: Record, block: Block, site: Site, path: Path, to_x: float, gravity: float
) -> None:
    """Sample the ground ahead to a chainage (m); under a flight also to where it has landed.

    At first the plane goes on on which the profile began, until a sample lies farther from it than
    the tolerance. Then each sample narrows the cone of slopes from the last vertex, and where none
    remains the sample before makes a vertex. Of the slopes in the cone that of the terrain is
    taken.
    """
    if _full(site):
        _forget_behind(state, block, site)
    begin = state.sampled
    state.near = 0
    _go_on_from(state, site, path)
    limit = path.tolerance + _ROUNDING
    least = state.x + _LEAST_PLANE * block.b
    aloft = state.phase == FLIGHT and state.vx > 1e-6
    lines = _lines_ahead(state)
    while state.open and (state.sampled < to_x or aloft) and not _full(site):
        after = _next_patch(state, path, lines)
        if after.cells == 0:
            state.open = False
            break
        if state.on_plane:
            _along_plane(state, site, path, after, limit, least)
        if not state.on_plane and after.end - state.sampled > SHORTEST_STRETCH:
            _along_cone(state, site, path, after, limit)
        lines = _beyond(lines, state, after.end)
        if aloft:
            t = (after.end - state.x) / state.vx
            if state.z + (state.vz - 0.5 * gravity * t) * t < state.ahead_z - limit:
                aloft = False
                to_x = max(to_x, after.end + block.a + 4.0 * MARGIN_M)
    _end_profile(state, site, path)
    if path.near.size and state.near != _KNOWN:
        _cross_lines(state, site, path, begin, state.sampled)


class _Lines(NamedTuple):
    """The next lines through centres of cells, where the terrain has a kink, and borders of cells.

    And the chainages at which they are met (m), infinite where they are not.
    """

    centre_u: float  # (cells)
    centre_v: float
    border_u: float
    border_v: float
    centre_u_at: float
    centre_v_at: float
    border_u_at: float
    border_v_at: float


@inlined
def _met_at(line: float, origin: float, rate: float, from_x: float) -> float:
    """Return the chainage at which a line is met (m)."""
    return from_x + (line - origin) / rate if rate != 0.0 else np.inf


@inlined
def _lines_ahead(state: Record) -> _Lines:
    """Return the lines ahead of where sampling goes on."""
    u, v = place(state, state.sampled)
    to_u = np.inf if state.du > 0.0 else -np.inf
    to_v = np.inf if state.dv > 0.0 else -np.inf
    centre_u = next_line(u - 0.5, to_u) + 0.5
    centre_v = next_line(v - 0.5, to_v) + 0.5
    border_u = next_line(u, to_u)
    border_v = next_line(v, to_v)
    lines = _Lines(
        centre_u, centre_v, border_u, border_v,
        _met_at(centre_u, state.from_u, state.du, state.from_x),
        _met_at(centre_v, state.from_v, state.dv, state.from_x),
        _met_at(border_u, state.from_u, state.du, state.from_x),
        _met_at(border_v, state.from_v, state.dv, state.from_x),
    )  # fmt: skip
    return _beyond(lines, state, state.sampled)


@inlined
def _next_beyond(
    line: float, at: float, x: float, origin: float, rate: float, from_x: float
) -> tuple[float, float]:
    """Return first line that is met after a chainage (m), and where; from one met before it on."""
    while at - x <= SHORTEST_STRETCH:
        line += 1.0 if rate > 0.0 else -1.0
        at = _met_at(line, origin, rate, from_x)
    return line, at


@fused
def _beyond(lines: _Lines, state: Record, x: float) -> _Lines:
    """Return the next lines after a chainage (m)."""
    centre_u, centre_u_at = _next_beyond(
        lines.centre_u, lines.centre_u_at, x, state.from_u, state.du, state.from_x
    )
    centre_v, centre_v_at = _next_beyond(
        lines.centre_v, lines.centre_v_at, x, state.from_v, state.dv, state.from_x
    )
    border_u, border_u_at = _next_beyond(
        lines.border_u, lines.border_u_at, x, state.from_u, state.du, state.from_x
    )
    border_v, border_v_at = _next_beyond(
        lines.border_v, lines.border_v_at, x, state.from_v, state.dv, state.from_x
    )
    return _Lines(
        centre_u, centre_v, border_u, border_v, centre_u_at, centre_v_at, border_u_at, border_v_at
    )


@lean
def _next_patch(state: Record, path: Path, lines: _Lines) -> Patch:
    """Return the patch that follows the last sample.

    Between the centres of four cells the terrain is bilinear: along the path a parabola, which is
    taken for a straight line. The patch ends where it leaves the four cells; where the parabola
    bends by too much, the kind of ground changes, or not all four have a height, at each border.
    """
    heights = path.heights
    n_rows, n_cols = heights.shape
    x = state.sampled
    du = state.du
    dv = state.dv
    end = min(lines.centre_u_at, lines.centre_v_at)
    border = min(lines.border_u_at, lines.border_v_at)
    later = max(lines.border_u_at, lines.border_v_at)
    # The cell and the four centres between two lines each, of which those ahead are known.
    behind_u = 1 if du > 0.0 else 0
    behind_v = 1 if dv > 0.0 else 0
    to_col = 2 * behind_u - 1
    to_row = 2 * behind_v - 1
    row = int(lines.border_v) - behind_v
    col = int(lines.border_u) - behind_u
    if not (0 <= row < n_rows and 0 <= col < n_cols):
        return Patch(x, 0.0, 0, 0, -1, -1, -1, x, x)
    cell = row * n_cols + col
    ground = np.int64(path.ground[row, col])
    up = int(lines.centre_v - 0.5) - behind_v
    left = int(lines.centre_u - 0.5) - behind_u
    own = across = down = twist = np.nan
    if 0 <= up < n_rows - 1 and 0 <= left < n_cols - 1:
        own = heights[up, left]
        across = heights[up, left + 1] - own
        down = heights[up + 1, left] - own
        twist = heights[up + 1, left + 1] - own - across - down
    cells = 1
    second = third = cell
    if border < end - SHORTEST_STRETCH:
        bent = 0.25 * abs(twist * du * dv) * (end - x) * (end - x)
        ends = not bent <= _BENT * path.tolerance
        if not ends:
            cells = 2
            at_corner = later - border <= SHORTEST_STRETCH
            next_row = row + to_row if lines.border_v_at == border or at_corner else row
            next_col = col + to_col if lines.border_u_at == border or at_corner else col
            second = next_row * n_cols + next_col
            ends = path.ground[next_row, next_col] != ground
            if later < end - SHORTEST_STRETCH and not at_corner:
                cells = 3
                third = (row + to_row) * n_cols + col + to_col
                ends = ends or path.ground[row + to_row, col + to_col] != ground
        if ends:
            end = border
            cells = 1
    u, v = place(state, end)
    z = own + across * (u - left - 0.5) + (down + twist * (u - left - 0.5)) * (v - up - 0.5)
    if math.isnan(z):
        # One of the four is not known, which may be the cell itself.
        if math.isnan(heights[row, col]):
            return Patch(x, 0.0, 0, 0, -1, -1, -1, x, x)
        z = height_at(heights, u, v, row, col)
    return Patch(end, z, ground, cells, cell, second, third, border, later)


@inlined
def _go_on_from(state: Record, site: Site, path: Path) -> None:
    """Take up sampling where the profile ends."""
    profile = site.profile
    state.ahead_z = profile.rows[profile.n[0]].z
    if state.on_plane:
        # The plane stays one segment.
        state.ahead_z = state.plane_z + state.plane_slope * (state.sampled - state.from_x)
        profile.n[0] = state.plane_at
    u, v = place(state, state.sampled)
    known = terrain_height(path, u, v)
    state.before_z = state.ahead_z if math.isnan(known) else known
    # The plane begins at the height of the last profile, within the tolerance of the terrain.
    state.gap = abs(state.before_z - state.ahead_z)
    _open_cone(state)


@inlined
def _open_cone(state: Record) -> None:
    """Begin a segment of any slope at the last vertex."""
    state.vertex_z = state.before_z
    state.low = -np.inf
    state.high = np.inf


@fused
def _add_stretches(
    state: Record, site: Site, path: Path, after: Patch, segment: int, end: float
) -> None:
    """Let the stretches go on over a patch, to its end or to where it is cut (m)."""
    first = end if after.cells == 1 else min(after.border, end)
    if first > state.sampled:
        _add_stretch(state, site, path, after.cell, segment, first)
    if after.cells > 1 and after.border < end:
        second = end if after.cells == 2 else min(after.later, end)
        if second > state.sampled:
            _add_stretch(state, site, path, after.second, segment, second)
    if after.cells > 2 and after.later < end:
        _add_stretch(state, site, path, after.third, segment, end)


@fused
def _along_plane(
    state: Record, site: Site, path: Path, after: Patch, limit: float, least: float
) -> None:
    """Go on to the next sample on the plane, or end it where the terrain has left it.

    ``limit`` is the largest gap (m), ``least`` the chainage up to which the gap does not matter
    (m).
    """
    profile = site.profile
    on_plane = state.plane_z + state.plane_slope * (after.end - state.from_x)
    gap = abs(after.z - on_plane)
    same = after.ground == profile.rows[state.plane_at].ground
    x = state.sampled
    if same and (gap <= limit or after.end <= least):
        _add_stretches(state, site, path, after, state.plane_at, after.end)
        state.sampled = after.end
        state.ahead_z = on_plane
        state.before_z = after.z
        state.gap = gap
        return
    state.on_plane = False
    x_end = x
    if same and gap > state.gap:
        share = min(max((limit - state.gap) / (gap - state.gap), 0.0), 1.0)
        x_end = x + share * (after.end - x)
    x_end = max(x_end, state.x + SHORTEST_STRETCH, least if same else 0.0)
    if x_end > x:
        _add_stretches(state, site, path, after, state.plane_at, x_end)
        state.ahead_z += state.plane_slope * (x_end - x)
        state.before_z += (after.z - state.before_z) * (x_end - x) / (after.end - x)
        state.sampled = x_end
    add_vertex(site, state.sampled, state.ahead_z)
    _open_cone(state)


@fused
def _along_cone(state: Record, site: Site, path: Path, after: Patch, limit: float) -> None:
    """Go on to the next sample on the open segment, or on a new one."""
    profile = site.profile
    n = profile.n[0]
    here = profile.rows[n]
    per_x = 1.0 / (after.end - here.x)
    down = (after.z - limit - here.z) * per_x
    up = (after.z + limit - here.z) * per_x
    begun = state.sampled > here.x
    if begun and (after.ground != here.ground or max(state.low, down) > min(state.high, up)):
        add_vertex(site, state.sampled, state.ahead_z)
        n += 1
        here = profile.rows[n]
        _open_cone(state)
        per_x = 1.0 / (after.end - here.x)
        down = (after.z - limit - here.z) * per_x
        up = (after.z + limit - here.z) * per_x
    here.ground = after.ground
    state.low = max(state.low, down)
    state.high = min(state.high, up)
    # As steep as the terrain is over the segment, as far as the cone allows.
    rise = (after.z - state.vertex_z) * per_x
    state.ahead_z = here.z + min(max(rise, state.low), state.high) * (after.end - here.x)
    _add_stretches(state, site, path, after, n, after.end)
    state.sampled = after.end
    state.before_z = after.z


@inlined
def _end_profile(state: Record, site: Site, path: Path) -> None:
    """End the last segment at the last sample."""
    profile = site.profile
    if profile.n[0] == state.plane_at and state.sampled <= state.x:
        # The block is at the edge of the known terrain.
        state.sampled = state.x + SHORTEST_STRETCH
        state.ahead_z = state.plane_z + state.plane_slope * SHORTEST_STRETCH
        u, v = place(state, state.x)
        edge = cell_index(u, v, path.heights.shape[0], path.heights.shape[1])
        _add_stretch(state, site, path, edge, state.plane_at, state.sampled)
        # What was sampled before ended elsewhere.
        state.near = _ALL_LINES
    if state.sampled > profile.rows[profile.n[0]].x:
        add_vertex(site, state.sampled, state.ahead_z)


@lean
def _forget_behind(state: Record, block: Block, site: Site) -> None:
    """Make room: remove the ground far behind the block."""
    profile = site.profile
    n = profile.n[0]
    first = 0
    while first < n - 1 and profile.rows[first + 1].x < state.x - BEHIND * block.a:
        first += 1
    for i in range(first, n + 1):
        profile.rows[i - first] = profile.rows[i]
    profile.n[0] = n - first
    state.plane_at = max(state.plane_at - first, 0)
    state.segment = max(state.segment - first, 0)
    if state.skip_to >= 0:
        state.skip_to = max(state.skip_to - first, -1)
    stretches = site.stretches
    n = stretches.n[0]
    begin = 0
    while begin < n - 1 and stretches.rows[begin + 1].start <= state.x:
        begin += 1
    for i in range(begin, n + 1):
        stretches.rows[i - begin] = stretches.rows[i]
        stretches.rows[i - begin].segment -= first
    stretches.n[0] = n - begin
    state.stretch = max(state.stretch - begin, 0)


@lean
def _cross_lines(state: Record, site: Site, path: Path, begin: float, end: float) -> None:
    """Find the stations and barriers that the path crosses between two chainages (m)."""
    u0, v0 = place(state, begin)
    u1, v1 = place(state, end)
    du = u1 - u0
    dv = v1 - v0
    for number in range(path.line_seen.size):
        if state.near & _bit(number) == 0:
            continue
        box = path.line_box[number]
        if max(u0, u1) < box[0] or min(u0, u1) > box[1]:
            continue
        if max(v0, v1) < box[2] or min(v0, v1) > box[3]:
            continue
        for k in range(path.line_first[number], path.line_first[number + 1] - 1):
            eu = path.line_u[k + 1] - path.line_u[k]
            ev = path.line_v[k + 1] - path.line_v[k]
            cross = du * ev - dv * eu
            if cross == 0.0:
                continue
            fu = path.line_u[k] - u0
            fv = path.line_v[k] - v0
            share = (fu * ev - fv * eu) / cross
            on_line = (fu * dv - fv * du) / cross
            # A vertex belongs to the segment that begins there.
            if 0.0 < share <= 1.0 and 0.0 <= on_line < 1.0:
                _add_crossing(site, path, number, begin + share * (end - begin))


@lean
def _keep_crossings(state: Record, site: Site) -> None:
    """Keep the stations and barriers that a new profile would not find, or find again.

    A block may have been moved over some, which it has still to pass. One at which it stands may,
    by what is rounded, be behind or ahead of it: it must not be met again, and no other be lost.
    """
    crossings = site.crossings
    near = _SAME_CROSSING_M
    kept = 0
    for i in range(crossings.n[0]):
        if state.lines_from - near <= crossings.rows[i].x <= state.x + near:
            crossings.rows[kept] = crossings.rows[i]
            kept += 1
    crossings.n[0] = kept


@lean
def _add_crossing(site: Site, path: Path, number: int, x: float) -> None:
    """Add a crossing at a chainage (m), in their order, unless it is there already."""
    crossings = site.crossings
    n = crossings.n[0]
    if n + 1 >= crossings.rows.size:
        return
    for i in range(n):
        if crossings.rows[i].number == number and abs(crossings.rows[i].x - x) < _SAME_CROSSING_M:
            return
    profile = site.profile
    j = profile.n[0] - 1
    while j > 0 and profile.rows[j].x > x:
        j -= 1
    at = n
    while at > 0 and crossings.rows[at - 1].x > x:
        crossings.rows[at] = crossings.rows[at - 1]
        at -= 1
    row = crossings.rows[at]
    row.x = x
    row.z = profile.rows[j].z + (x - profile.rows[j].x) * profile.rows[j].tz / profile.rows[j].tx
    set_line(row, path.lines, number)
    row.seen = path.line_seen[number]
    crossings.n[0] = n + 1


@inlined
def note_passages(site: Site, path: Path) -> None:
    """Remember the stations and barriers that the block has passed."""
    for i in range(site.crossings.n[0]):
        if site.crossings.rows[i].seen:
            path.line_seen[site.crossings.rows[i].number] = True


@inlined
def see_again(path: Path, passages: CountedRows, n: int) -> None:
    """Remember, of a block that has gone on, only so many passages, whose rows follow the last."""
    path.line_seen[:] = False
    for k in range(n):
        path.line_seen[passages.rows[passages.n[0] + k].control_line] = True
