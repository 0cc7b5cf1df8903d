"""The profile of one line as the kernels read it, and where a block is on it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import inlined, kernel, lean
from sassgis.engine.ellipse import CountedRows
from sassgis.engine.recording import STRETCH_DTYPE
from sassgis.engine.state import BARRIER, VERTEX_DTYPE
from sassgis.grid import FloatArray, IntArray

# A vertex nearer than this to the line between its neighbours is removed (m).
_STRAIGHT_M = 1e-9
# Distance from the end of a segment at which a block counts as past it (m).
_PAST = 1e-5
#: A vertex with a turn below this angle is removed (rad).
STRAIGHT = 1e-9


@kernel
def profile_of(s: FloatArray, z: FloatArray, ground: NDArray[np.int32]) -> CountedRows:
    """Return the segments between vertices (VERTEX_DTYPE).

    Chainage ``s`` (m) rises; ``ground`` is the class of the segment that starts at the vertex.
    """
    n = s.size
    rows = np.zeros(n, VERTEX_DTYPE)
    for i in range(n):
        row = rows[i]
        row.x = s[i]
        row.z = z[i]
        if i == n - 1:
            break
        dx = s[i + 1] - s[i]
        dz = z[i + 1] - z[i]
        length = math.sqrt(dx * dx + dz * dz)
        row.length = length
        row.tx = dx / length
        row.tz = dz / length
        row.angle = math.nan
        row.ground = ground[i]
    return CountedRows(rows, np.full(1, n - 1, np.int64))


@kernel
def without_straight_vertices(
    s: FloatArray, z: FloatArray, ground: NDArray[np.int32]
) -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    """Return the profile without vertices at which neither direction nor ground changes.

    So blocks do not depend on how a straight slope is divided.
    """
    n = s.size
    keep = np.empty(n, np.int64)
    keep[0] = 0
    count = 1
    for i in range(1, n - 1):
        k = keep[count - 1]
        # The run since the last vertex that was kept stays straight up to the next one.
        dx = s[i + 1] - s[k]
        dz = z[i + 1] - z[k]
        size = math.sqrt(dx * dx + dz * dz)
        straight = ground[i] == ground[k]
        for m in range(k + 1, i + 1):
            off = abs((s[m] - s[k]) * dz - (z[m] - z[k]) * dx) / size
            if off > _STRAIGHT_M:
                straight = False
                break
        if not straight:
            keep[count] = i
            count += 1
    keep[count] = n - 1
    kept = keep[: count + 1]
    return s[kept], z[kept], ground[kept]


@kernel
def stretches_of(
    cell_s: FloatArray, cell: IntArray, stems: FloatArray, diameter: FloatArray,
    on_map: FloatArray, s: FloatArray,
) -> CountedRows:  # fmt: skip
    """Return stretches of cells, cut at the vertices (STRETCH_DTYPE).

    ``cell_s`` are the borders of the cells along the profile (m), ``on_map`` the same on the map
    (u, v), one more than cells; ``s`` is the chainage of the vertices (m).
    """
    rows = np.zeros(cell.size + s.size + 2, STRETCH_DTYPE)
    i = 0
    j = 0
    n = 0
    here = s[0]
    n_segments = s.size - 1
    while i < cell.size and j < n_segments:
        end = min(cell_s[i + 1], s[j + 1])
        if end > here:
            rows[n].start = here
            rows[n].cell = cell[i]
            rows[n].segment = j
            share = min(max((here - cell_s[i]) / (cell_s[i + 1] - cell_s[i]), 0.0), 1.0)
            rows[n].u = on_map[i, 0] + share * (on_map[i + 1, 0] - on_map[i, 0])
            rows[n].v = on_map[i, 1] + share * (on_map[i + 1, 1] - on_map[i, 1])
            rows[n].stems = stems[i]
            rows[n].diameter = diameter[i]
            n += 1
            here = end
        if cell_s[i + 1] <= end:
            i += 1
        if s[j + 1] <= end:
            j += 1
    if n == 0:
        rows[0].start = s[0]
        rows[0].cell = -1
        n = 1
        here = s[n_segments]
    rows[n].start = here
    rows[n].u = on_map[cell.size, 0]
    rows[n].v = on_map[cell.size, 1]
    return CountedRows(rows, np.full(1, n, np.int64))


@lean
def segment_at(profile: CountedRows, x: float, near: int) -> int:
    """Return the segment under chainage x."""
    j = near
    n = profile.n[0]
    while j > 0 and profile.rows[j].x > x:
        j -= 1
    while j < n - 1 and profile.rows[j + 1].x < x:
        j += 1
    return j


@inlined
def angle_of(profile: CountedRows, j: int) -> float:
    """Return the angle of segment j to the horizontal, positive if it rises (rad)."""
    here = profile.rows[j]
    if math.isnan(here.angle):
        after = profile.rows[j + 1]
        here.angle = math.atan2(after.z - here.z, after.x - here.x)
    return float(here.angle)


@lean
def along(profile: CountedRows, j: int, x: float, z: float) -> float:
    """Return the distance of a point along segment j from its start (m)."""
    row = profile.rows[j]
    return float((x - row.x) * row.tx + (z - row.z) * row.tz)


@lean
def turn(profile: CountedRows, j: int, direction: int) -> float:
    """Return the sine of the turn from segment j to the next in a direction; above 0: convex."""
    here = profile.rows[j]
    after = profile.rows[j + direction]
    cross = here.tx * after.tz - here.tz * after.tx
    return float(-direction * cross)


@lean
def foot_segment(profile: CountedRows, j: int, x: float, z: float, direction: int) -> int:
    """Return the segment along which a block that touches segment j moves on in a direction."""
    n = profile.n[0]
    while True:
        u = along(profile, j, x, z)
        if direction > 0 and u >= profile.rows[j].length - _PAST and j < n - 1:
            j += 1
        elif direction < 0 and u <= _PAST and j > 0:
            j -= 1
        else:
            break
    # Where only the ground class changes, the foot decides behind it too.
    while True:
        u = along(profile, j, x, z)
        if direction > 0 and u < 0.0 and j > 0 and abs(turn(profile, j, -1)) < STRAIGHT:
            j -= 1
        elif (
            direction < 0
            and u > profile.rows[j].length
            and j < n - 1
            and abs(turn(profile, j, 1)) < STRAIGHT
        ):
            j += 1
        else:
            return j


@lean
def stretch_from(stretches: CountedRows, i: int, x: float) -> int:
    """Return the stretch under chainage x, looking ahead from stretch i."""
    while i < stretches.n[0] - 1 and stretches.rows[i + 1].start < x:
        i += 1
    return i


@lean
def to_cell_border(stretches: CountedRows, i: int, x: float, direction: int) -> tuple[int, float]:
    """Find the stretch ahead of a block in a direction, and the distance to its border (m)."""
    n = stretches.n[0]
    while direction > 0 and i < n - 1 and stretches.rows[i + 1].start <= x + _PAST:
        i += 1
    while direction < 0 and i > 0 and stretches.rows[i].start >= x - _PAST:
        i -= 1
    gap = stretches.rows[i + 1].start - x if direction > 0 else x - stretches.rows[i].start
    return i, max(gap, _PAST)


@lean
def last_stretch(
    profile: CountedRows, stretches: CountedRows, reason: int, x: float, start: float
) -> int:
    """Return the stretch in which a block ends; -1 outside."""
    if x < profile.rows[0].x or x > profile.rows[profile.n[0]].x:
        return -1
    # The last stretch that starts at or before x.
    low = 0
    high = stretches.n[0] + 1
    while low < high:
        middle = (low + high) // 2
        if stretches.rows[middle].start <= x:
            low = middle + 1
        else:
            high = middle
    k = low - 1
    # A block stopped by a wall lies in front of it, also on the border of a cell.
    if reason == BARRIER and k > 0 and stretches.rows[k].start >= x > start:
        k -= 1
    return int(min(max(k, 0), stretches.n[0] - 1))
