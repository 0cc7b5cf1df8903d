"""Outlines of a raster of classes as one planar graph, smoothed without lowering any cell.

All boundaries are held once, as edges between corners of cells, and are smoothed by moving vertices
onto neighbouring vertices. Vertices therefore stay on corners of cells, every test is made with
whole numbers, and neighbouring zones share their boundary exactly: there is nothing to snap and
nothing that could open a gap. Maps of several return periods are drawn from the rarest to the most
frequent, each kept inside the one before.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sassgis.model.grid import IntArray
from sassgis.model.jit import kernel

#: Closest that a smoothed edge comes to another vertex (cells). It keeps strips between two
#: boundaries from becoming threads, and is far above the rounding of coordinates.
CLEARANCE = 0.25
_MAX_DEGREE = 4
#: A share of an edge, as two whole numbers without a common divisor.
_SHARE, _SCALE = 4999, 10007
#: A whole number (or truth value) in compiled code, of numpy's types or Python's.
Whole: TypeAlias = Any


@dataclass(frozen=True, slots=True)
class Rings:
    """Closed rings of labelled regions, on corners of cells.

    Attributes
    ----------
    col, row : int64, shape (n_vertices,)
        Corner number: (0, 0) is the outer corner of the first cell. The closing vertex is repeated.
    start : int64, shape (n_rings + 1,)
        First vertex of each ring.
    label : int64, shape (n_rings,)
        Region that the ring bounds.
    double_area : int64, shape (n_rings,)
        Twice the area in cells; above 0 for outer rings, below 0 for holes.
    """

    col: IntArray
    row: IntArray
    start: IntArray
    label: IntArray
    double_area: IntArray


@kernel
def components(codes: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Label regions of equal code that hang together over sides of cells.

    Parameters
    ----------
    codes : int64, shape (n_rows, n_cols)

    Returns
    -------
    labels : int64, shape (n_rows, n_cols)
        From 0, in the order in which rows first meet the regions.
    n : int
        Number of regions.
    """
    n_rows, n_cols = codes.shape
    parent = np.arange(n_rows * n_cols)
    flat = codes.ravel()
    for i in range(n_rows):
        for j in range(n_cols):
            k = i * n_cols + j
            for step in range(2):
                if step == 0:
                    if j == 0:
                        continue
                    other = k - 1
                else:
                    if i == 0:
                        continue
                    other = k - n_cols
                if flat[other] != flat[k]:
                    continue
                a = k
                while parent[a] != a:
                    parent[a] = parent[parent[a]]
                    a = parent[a]
                b = other
                while parent[b] != b:
                    parent[b] = parent[parent[b]]
                    b = parent[b]
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
    labels = np.empty(n_rows * n_cols, np.int64)
    n = 0
    for k in range(n_rows * n_cols):
        a = k
        while parent[a] != a:
            a = parent[a]
        # The root of a region is its smallest index, so that it has its label already.
        if a == k:
            labels[k] = n
            n += 1
        else:
            labels[k] = labels[a]
    return labels.reshape(n_rows, n_cols), n


@kernel
def _graph(
    faces: IntArray,
) -> tuple[IntArray, IntArray, IntArray, IntArray, IntArray]:
    """Boundary edges of the faces, one per side of a cell; `faces` has an outer frame of one face.

    Returns corner numbers (x, y) of the vertices with y upward, the vertex at each corner (-1:
    none), and the ends and the faces left and right of each edge.
    """
    n_rows, n_cols = faces.shape
    n_edges = 0
    for i in range(1, n_rows):
        for j in range(n_cols):
            if faces[i - 1, j] != faces[i, j]:
                n_edges += 1
    for i in range(n_rows):
        for j in range(1, n_cols):
            if faces[i, j - 1] != faces[i, j]:
                n_edges += 1
    at = np.full((n_rows + 1, n_cols + 1), -1, np.int64)
    n_vertices = 0
    for i in range(1, n_rows):
        for j in range(1, n_cols):
            a = faces[i - 1, j - 1]
            if faces[i - 1, j] != a or faces[i, j - 1] != a or faces[i, j] != a:
                at[i, j] = n_vertices
                n_vertices += 1
    x = np.empty(n_vertices, np.int64)
    y = np.empty(n_vertices, np.int64)
    for i in range(1, n_rows):
        for j in range(1, n_cols):
            if at[i, j] >= 0:
                x[at[i, j]] = j
                y[at[i, j]] = -i
    ends = np.empty((n_edges, 2), np.int64)
    sides = np.empty((n_edges, 2), np.int64)
    e = 0
    for i in range(1, n_rows):
        for j in range(n_cols):
            if faces[i - 1, j] != faces[i, j]:
                ends[e, 0] = at[i, j]
                ends[e, 1] = at[i, j + 1]
                sides[e, 0] = faces[i - 1, j]
                sides[e, 1] = faces[i, j]
                e += 1
    for i in range(n_rows):
        for j in range(1, n_cols):
            if faces[i, j - 1] != faces[i, j]:
                ends[e, 0] = at[i, j]
                ends[e, 1] = at[i + 1, j]
                sides[e, 0] = faces[i, j]
                sides[e, 1] = faces[i, j - 1]
                e += 1
    return x, y, at, ends, sides


@kernel
def _incidence(
    ends: IntArray,
    n_vertices: Whole,
) -> tuple[IntArray, IntArray]:
    """Edges at each vertex (-1: none) and their number."""
    edges_at = np.full((n_vertices, _MAX_DEGREE), -1, np.int64)
    degree = np.zeros(n_vertices, np.int64)
    for e in range(ends.shape[0]):
        for s in range(2):
            v = ends[e, s]
            edges_at[v, degree[v]] = e
            degree[v] += 1
    return edges_at, degree


@kernel
def _other(
    ends: IntArray,
    e: Whole,
    v: Whole,
) -> Whole:
    return ends[e, 1] if ends[e, 0] == v else ends[e, 0]


@kernel
def _left_from(
    ends: IntArray,
    sides: IntArray,
    e: Whole,
    v: Whole,
) -> Whole:
    """Face on the left of the edge when it is walked away from v."""
    return sides[e, 0] if ends[e, 0] == v else sides[e, 1]


@kernel
def _right_from(
    ends: IntArray,
    sides: IntArray,
    e: Whole,
    v: Whole,
) -> Whole:
    return sides[e, 1] if ends[e, 0] == v else sides[e, 0]


@kernel
def _swept(
    p: Whole,
    e: Whole,
    x: IntArray,
    y: IntArray,
    ends: IntArray,
    sides: IntArray,
    edges_at: IntArray,
    degree: IntArray,
    classes: IntArray,
) -> Whole:
    """Twice the area that changes hands when vertex p moves along edge e onto its other end.

    -1 if the move would lower any place, or make a region vanish.
    """
    q = _other(ends, e, p)
    # Two junctions may become one only where no more than four boundaries meet then.
    if degree[p] + degree[q] - 2 > _MAX_DEGREE:
        return -1
    ex = x[q] - x[p]
    ey = y[q] - y[p]
    area: Whole = 0
    on_left = 0
    on_right = 0
    for s in range(degree[p]):
        f = edges_at[p, s]
        if f == e:
            continue
        r = _other(ends, f, p)
        if r == q:
            return -1
        for s2 in range(degree[q]):
            if _other(ends, edges_at[q, s2], q) == r:
                return -1  # a triangular region would collapse
        cross = ex * (y[r] - y[p]) - ey * (x[r] - x[p])
        if cross == 0:
            continue
        if cross > 0:
            on_left += 1
            loser = _left_from(ends, sides, e, p)
            winner = _left_from(ends, sides, f, p)
        else:
            on_right += 1
            loser = _right_from(ends, sides, e, p)
            winner = _right_from(ends, sides, f, p)
        # With two edges on one side, more than one region would sweep over another.
        if on_left > 1 or on_right > 1:
            return -1
        if classes[winner] < classes[loser]:
            return -1
        area += abs(cross)
    return area


@kernel
def _columns(
    px: Whole, py: Whole, qx: Whole, qy: Whole, rx: Whole, ry: Whole, below: Whole, above: Whole
) -> tuple[float, float]:
    """Extent in x of the part of a triangle between two heights; the first above the last: none."""
    xs = (px, qx, rx, px)
    ys = (py, qy, ry, py)
    low: Any = np.inf
    high: Any = -np.inf
    for k in range(3):
        ax, ay, bx, by = xs[k], ys[k], xs[k + 1], ys[k + 1]
        if max(ay, by) < below or min(ay, by) > above:
            continue
        if ay == by:
            low = min(low, min(ax, bx))
            high = max(high, max(ax, bx))
            continue
        for bound in (below, above):
            t: Any = min(max((bound - ay) / (by - ay), 0.0), 1.0)
            low = min(low, ax + t * (bx - ax))
            high = max(high, ax + t * (bx - ax))
    return low, high


@kernel
def _buckets(
    x: IntArray, y: IntArray, ends: IntArray, n_rows: Whole, n_cols: Whole
) -> tuple[IntArray, IntArray]:
    """Edges that touch each cell, or more: `edges[at[cell] : at[cell + 1]]`."""
    at = np.zeros(n_rows * n_cols + 1, np.int64)
    edges = np.empty(0, np.int64)
    for fill in range(2):
        if fill == 1:
            for k in range(n_rows * n_cols):
                at[k + 1] += at[k]
            edges = np.empty(at[-1], np.int64)
        for e in range(ends.shape[0]):
            ax, ay = x[ends[e, 0]], y[ends[e, 0]]
            bx, by = x[ends[e, 1]], y[ends[e, 1]]
            # Row i lies between y = -i - 1 and y = -i.
            for row in range(max(-max(ay, by) - 1, 0), min(-min(ay, by) + 1, n_rows)):
                low, high = _columns(ax, ay, bx, by, bx, by, -row - 1, -row)
                for col in range(max(int(np.ceil(low)) - 1, 0), min(int(high) + 1, n_cols)):
                    k = row * n_cols + col
                    if fill == 0:
                        at[k + 1] += 1
                    else:
                        # Filled from the back; the sums become the beginnings.
                        at[k + 1] -= 1
                        edges[at[k + 1]] = e
    # Each end was counted down to its beginning, so that everything stands one too late.
    total = edges.size
    for k in range(n_rows * n_cols):
        at[k] = at[k + 1]
    at[n_rows * n_cols] = total
    return at, edges


@kernel
def _is_under(
    p: Whole,
    q: Whole,
    r: Whole,
    x: IntArray,
    y: IntArray,
    rises_to: Whole,
    lid_at: IntArray,
    lid_edges: IntArray,
    lid_ends: IntArray,
    lid_classes: IntArray,
) -> bool:
    """Whether another map is nowhere below a class in the triangle p, q, r.

    It must not be below the class beside p-r, on the side away from the triangle.

    `lid_ends[e]` are x and y of both ends of its boundaries, `lid_classes[e]` the classes left and
    right of them, `lid_at` and `lid_edges` the boundaries at each cell; empty: no other map.
    """
    if lid_at.size == 0:
        return True
    px, py, qx, qy, rx, ry = x[p], y[p], x[q], y[q], x[r], y[r]
    turn = 1 if (qx - px) * (ry - py) - (qy - py) * (rx - px) > 0 else -1
    n_cols = lid_classes[-1, 0]
    n_rows = lid_classes[-1, 1]
    # A place on p-r where no boundary can end, as ends are whole numbers: scaled by `_SCALE`.
    mx = _SCALE * px + _SHARE * (rx - px)
    my = _SCALE * py + _SHARE * (ry - py)
    for yy in range(min(py, qy, ry) - 1, max(py, qy, ry) + 1):
        row = -yy - 1
        if row < 0 or row >= n_rows:
            continue
        low, high = _columns(px, py, qx, qy, rx, ry, yy - 1, yy + 2)
        for col in range(max(int(np.ceil(low)) - 1, 0), min(int(high) + 1, n_cols)):
            cell = row * n_cols + col
            for k in range(lid_at[cell], lid_at[cell + 1]):
                e = lid_edges[k]
                left = lid_classes[e, 0]
                right = lid_classes[e, 1]
                if (left < rises_to) == (right < rises_to):
                    continue
                sx, sy, tx, ty = lid_ends[e, 0], lid_ends[e, 1], lid_ends[e, 2], lid_ends[e, 3]
                dx = tx - sx
                dy = ty - sy
                # The boundary runs through the triangle unless some line separates them: one
                # along a side of the triangle, or along the boundary.
                a = dx * (py - sy) - dy * (px - sx)
                b = dx * (qy - sy) - dy * (qx - sx)
                c = dx * (ry - sy) - dy * (rx - sx)
                if (
                    max(a, b, c) > 0
                    and min(a, b, c) < 0
                    and _reaches_inside(px, py, qx, qy, sx, sy, tx, ty, turn)
                    and _reaches_inside(qx, qy, rx, ry, sx, sy, tx, ty, turn)
                    and _reaches_inside(rx, ry, px, py, sx, sy, tx, ty, turn)
                ):
                    return False
                # Along p-r, the triangle must lie on its higher side.
                if a == 0 and c == 0 and dx * (my - _SCALE * sy) == dy * (mx - _SCALE * sx):
                    along = dx * (mx - _SCALE * sx) + dy * (my - _SCALE * sy)
                    if 0 < along < _SCALE * (dx * dx + dy * dy):
                        own = left if b > 0 else right
                        if own < rises_to:
                            return False
    return True


@kernel
def _reaches_inside(
    ax: Whole,
    ay: Whole,
    bx: Whole,
    by: Whole,
    sx: Whole,
    sy: Whole,
    tx: Whole,
    ty: Whole,
    turn: Whole,
) -> Whole:
    """Whether an end of s-t lies on the inner side of the side a-b of a triangle."""
    dx = turn * (bx - ax)
    dy = turn * (by - ay)
    return dx * (sy - ay) - dy * (sx - ax) > 0 or dx * (ty - ay) - dy * (tx - ax) > 0


@kernel
def _is_free(
    p: Whole,
    q: Whole,
    r: Whole,
    x: IntArray,
    y: IntArray,
    at: IntArray,
) -> bool:
    """Whether no vertex but its corners is in the triangle p, q, r, or close to its side q-r."""
    px, py, qx, qy, rx, ry = x[p], y[p], x[q], y[q], x[r], y[r]
    cross = (qx - px) * (ry - py) - (qy - py) * (rx - px)
    turn = 1 if cross > 0 else -1
    dx = rx - qx
    dy = ry - qy
    length2 = dx * dx + dy * dy
    near2 = CLEARANCE * CLEARANCE
    n_rows, n_cols = at.shape
    for yy in range(min(py, qy, ry) - 1, max(py, qy, ry) + 2):
        row = -yy
        if row < 0 or row >= n_rows:
            continue
        low, high = _columns(px, py, qx, qy, rx, ry, yy - 1, yy + 1)
        if low > high:
            continue
        for xx in range(max(int(np.floor(low)) - 1, 0), min(int(np.ceil(high)) + 2, n_cols)):
            v = at[row, xx]
            if v < 0 or v in (p, q, r):
                continue
            a = turn * ((qx - px) * (yy - py) - (qy - py) * (xx - px))
            b = turn * ((rx - qx) * (yy - qy) - (ry - qy) * (xx - qx))
            c = turn * ((px - rx) * (yy - ry) - (py - ry) * (xx - rx))
            if cross != 0 and a >= 0 and b >= 0 and c >= 0:
                return False
            along = (xx - qx) * dx + (yy - qy) * dy
            if 0 < along < length2 and b * b < near2 * length2:
                return False
    return True


@kernel
def _is_within(
    vx: Whole,
    vy: Whole,
    q: Whole,
    r: Whole,
    x: IntArray,
    y: IntArray,
    tolerance2: float,
) -> Whole:
    """Whether a point is no farther from the segment q-r than the tolerance."""
    dx = x[r] - x[q]
    dy = y[r] - y[q]
    ax = vx - x[q]
    ay = vy - y[q]
    length2 = dx * dx + dy * dy
    along = ax * dx + ay * dy
    if along <= 0:
        return ax * ax + ay * ay <= tolerance2
    if along >= length2:
        return (vx - x[r]) ** 2 + (vy - y[r]) ** 2 <= tolerance2
    cross = float(ax * dy - ay * dx)
    return cross * cross <= tolerance2 * length2


@kernel
def _chain_is_within(
    first: Whole,
    chain_v: IntArray,
    chain_next: IntArray,
    q: Whole,
    r: Whole,
    x: IntArray,
    y: IntArray,
    tolerance2: float,
) -> bool:
    k = first
    while k >= 0:
        v = chain_v[k]
        if not _is_within(x[v], y[v], q, r, x, y, tolerance2):
            return False
        k = chain_next[k]
    return True


@kernel
def _merge_onto(
    p: Whole,
    e: Whole,
    ends: IntArray,
    edges_at: IntArray,
    degree: IntArray,
    at: IntArray,
    x: IntArray,
    y: IntArray,
) -> Whole:
    """Move vertex p along edge e onto its other end, which takes over the edges of p."""
    q = _other(ends, e, p)
    k = 0
    for s in range(degree[q]):
        if edges_at[q, s] != e:
            edges_at[q, k] = edges_at[q, s]
            k += 1
    for s in range(degree[p]):
        f = edges_at[p, s]
        if f == e:
            continue
        if ends[f, 0] == p:
            ends[f, 0] = q
        else:
            ends[f, 1] = q
        edges_at[q, k] = f
        k += 1
    degree[q] = k
    degree[p] = 0
    at[-y[p], x[p]] = -1
    ends[e, 0] = -1
    ends[e, 1] = -1
    return q


@kernel
def _push_moves(
    heap: list[tuple[Whole, Whole, Whole, Whole]],
    p: Whole,
    x: IntArray,
    y: IntArray,
    ends: IntArray,
    sides: IntArray,
    edges_at: IntArray,
    degree: IntArray,
    classes: IntArray,
    version: IntArray,
) -> None:
    version[p] += 1
    n = 1 if degree[p] == 2 else degree[p]  # onto either end of two edges: the same outline
    for s in range(n):
        e = edges_at[p, s]
        area = _swept(p, e, x, y, ends, sides, edges_at, degree, classes)
        if area >= 0:
            heapq.heappush(heap, (area, p, e, version[p]))


@kernel
def _merge_straight_runs(
    x: IntArray, y: IntArray, at: IntArray, ends: IntArray, edges_at: IntArray, degree: IntArray
) -> None:
    """Remove vertices on straight runs: no area is swept and nothing can lie between."""
    for i in range(x.size):
        if degree[i] == 2:
            a = _other(ends, edges_at[i, 0], i)
            b = _other(ends, edges_at[i, 1], i)
            if (x[a] - x[i]) * (y[b] - y[i]) == (y[a] - y[i]) * (x[b] - x[i]):
                _merge_onto(i, edges_at[i, 0], ends, edges_at, degree, at, x, y)


@kernel
def _exchange_areas(
    p: Whole,
    e: Whole,
    q: Whole,
    x: IntArray,
    y: IntArray,
    ends: IntArray,
    sides: IntArray,
    edges_at: IntArray,
    degree: IntArray,
    classes: IntArray,
    room: IntArray,
    booked: IntArray,
    lid_at: IntArray,
    lid_edges: IntArray,
    lid_ends: IntArray,
    lid_classes: IntArray,
) -> bool:
    """Book the areas that faces exchange when vertex `p` moves along edge `e` onto `q`.

    False, with `room` as it was, if a face has no room left or would rise above the map that this
    one must stay inside. `booked` is work space, one row for each edge of a vertex.
    """
    n_booked = 0
    for s in range(degree[p]):
        f = edges_at[p, s]
        if f == e:
            continue
        r = _other(ends, f, p)
        cross: Whole = (x[q] - x[p]) * (y[r] - y[p]) - (y[q] - y[p]) * (x[r] - x[p])
        if cross == 0:
            continue
        if cross > 0:
            loser = _left_from(ends, sides, e, p)
            winner = _left_from(ends, sides, f, p)
        else:
            loser = _right_from(ends, sides, e, p)
            winner = _right_from(ends, sides, f, p)
        room[loser] -= abs(cross)
        room[winner] += abs(cross)
        booked[n_booked, 0] = loser
        booked[n_booked, 1] = winner
        booked[n_booked, 2] = abs(cross)
        n_booked += 1
        if room[loser] < 0 or not _is_under(
            p, q, r, x, y, classes[winner], lid_at, lid_edges, lid_ends, lid_classes
        ):
            for k in range(n_booked):
                room[booked[k, 0]] += booked[k, 2]
                room[booked[k, 1]] -= booked[k, 2]
            return False
    return True


@kernel
def _smooth(
    x: IntArray,
    y: IntArray,
    at: IntArray,
    ends: IntArray,
    sides: IntArray,
    edges_at: IntArray,
    degree: IntArray,
    classes: IntArray,
    room: IntArray,
    tolerance: float,
    lid_at: IntArray,
    lid_edges: IntArray,
    lid_ends: IntArray,
    lid_classes: IntArray,
) -> None:
    """Move vertices until no further move is allowed, the smallest swept area first.

    `room[face]` is what each face may yet lose (twice the area, cells). The last four arrays are
    the boundaries of the map that this one must stay inside (see `_buckets`). Changes the graph in
    place.
    """
    n = x.size
    # A hair above, so that a notch of exactly the tolerance is filled.
    tolerance2 = tolerance * tolerance * (1.0 + 1e-9)
    _merge_straight_runs(x, y, at, ends, edges_at, degree)
    # Vertices that each edge has replaced, as linked lists: the outline as it was.
    first = np.full(ends.shape[0], -1, np.int64)
    chain_v = np.empty(4 * n + 16, np.int64)
    chain_next = np.empty(4 * n + 16, np.int64)
    n_chain: Whole = 0
    home = np.arange(n)
    version = np.zeros(n, np.int64)
    near = np.empty(_MAX_DEGREE + 1, np.int64)
    booked = np.empty((_MAX_DEGREE, 3), np.int64)
    moved = True
    while moved:
        moved = False
        heap = [(np.int64(0), np.int64(0), np.int64(0), np.int64(0))]
        heap.pop()
        for i in range(n):
            if degree[i] >= 2:
                _push_moves(heap, i, x, y, ends, sides, edges_at, degree, classes, version)
        while len(heap) > 0:
            _, p, e, v = heapq.heappop(heap)
            if version[p] != v or degree[p] == 0:
                continue
            if _swept(p, e, x, y, ends, sides, edges_at, degree, classes) < 0:
                continue
            q = _other(ends, e, p)
            # A junction takes boundaries along that did not run here: it stays near its home.
            h = home[p]
            allowed = degree[p] == 2 or ((x[q] - x[h]) ** 2 + (y[q] - y[h]) ** 2 <= tolerance2)
            for s in range(degree[p]):
                f = edges_at[p, s]
                if f == e or not allowed:
                    continue
                r = _other(ends, f, p)
                if not (
                    _is_within(x[p], y[p], q, r, x, y, tolerance2)
                    and _chain_is_within(first[e], chain_v, chain_next, q, r, x, y, tolerance2)
                    and _chain_is_within(first[f], chain_v, chain_next, q, r, x, y, tolerance2)
                    and _is_free(p, q, r, x, y, at)
                ):
                    allowed = False
                    break
            if not allowed:
                continue
            # Every edge that takes over vertices needs its own list of them.
            n_own = 1
            k = first[e]
            while k >= 0:
                n_own += 1
                k = chain_next[k]
            if n_chain + n_own * (degree[p] - 1) > chain_v.size:
                grown_v = np.empty(2 * (chain_v.size + n_own * _MAX_DEGREE), np.int64)
                grown_v[:n_chain] = chain_v[:n_chain]
                chain_v = grown_v
                grown_next = np.empty(chain_v.size, np.int64)
                grown_next[:n_chain] = chain_next[:n_chain]
                chain_next = grown_next
            if not _exchange_areas(
                p, e, q, x, y, ends, sides, edges_at, degree, classes, room, booked,
                lid_at, lid_edges, lid_ends, lid_classes,
            ):  # fmt: skip
                continue
            last_taken = False
            for s in range(degree[p]):
                f = edges_at[p, s]
                if f == e:
                    continue
                if degree[p] == 2:
                    # The only heir: takes the list as it is.
                    tail = first[e]
                    if tail >= 0:
                        while chain_next[tail] >= 0:
                            tail = chain_next[tail]
                        chain_next[tail] = first[f]
                        first[f] = first[e]
                    last_taken = True
                else:
                    k = first[e]
                    while k >= 0:
                        chain_v[n_chain] = chain_v[k]
                        chain_next[n_chain] = first[f]
                        first[f] = n_chain
                        n_chain += 1
                        k = chain_next[k]
                chain_v[n_chain] = p
                chain_next[n_chain] = first[f]
                first[f] = n_chain
                n_chain += 1
            if last_taken:
                first[e] = -1
            moved = True
            if degree[p] > 2:
                # Two junctions in one have two homes: it goes no further.
                home[q] = h if degree[q] == 2 else -1
            q = _merge_onto(p, e, ends, edges_at, degree, at, x, y)
            n_near = 1
            near[0] = q
            for s in range(degree[q]):
                near[n_near] = _other(ends, edges_at[q, s], q)
                n_near += 1
            for k in range(n_near):
                _push_moves(heap, near[k], x, y, ends, sides, edges_at, degree, classes, version)


@kernel
def _trace(
    x: IntArray,
    y: IntArray,
    ends: IntArray,
    label: IntArray,
    wanted: NDArray[np.bool_],
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Rings of all wanted labels; `label[e]` are those left and right of the edges.

    At a corner where parts of one region meet, the ring walks on around the region outside:
    outer rings and holes may touch there, but no ring meets itself.
    """
    n = x.size
    edges_at, degree = _incidence(ends, n)
    n_edges = ends.shape[0]
    done = np.zeros((n_edges, 2), np.bool_)
    n_half = 0
    for e in range(n_edges):
        for s in range(2):
            if wanted[label[e, s]]:
                n_half += 1
    out = np.empty(2 * n_half, np.int64)
    start = np.empty(n_half + 1, np.int64)
    ring_label = np.empty(n_half, np.int64)
    area = np.empty(n_half, np.int64)
    n_out = 0
    n_rings = 0
    for e0 in range(n_edges):
        for s0 in range(2):
            # Side 0: walked from end 0 to end 1, with label[e, 0] on the left.
            own = label[e0, s0]
            if done[e0, s0] or not wanted[own]:
                continue
            start[n_rings] = n_out
            ring_label[n_rings] = own
            twice = np.int64(0)
            e = e0
            s = s0
            while not done[e, s]:
                done[e, s] = True
                u = ends[e, s]
                v = ends[e, 1 - s]
                out[n_out] = u
                n_out += 1
                twice += x[u] * y[v] - x[v] * y[u]
                back = np.arctan2(float(y[u] - y[v]), float(x[u] - x[v]))
                best = np.inf
                next_e = -1
                next_s = 0
                for k in range(degree[v]):
                    f = edges_at[v, k]
                    side = 0 if ends[f, 0] == v else 1
                    if label[f, side] != own or f == e:
                        continue
                    w = ends[f, 1 - side]
                    turn = np.arctan2(float(y[w] - y[v]), float(x[w] - x[v])) - back
                    if turn <= 0.0:
                        turn += 2.0 * np.pi
                    if turn < best:
                        best = turn
                        next_e = f
                        next_s = side
                e = next_e
                s = next_s
            out[n_out] = out[start[n_rings]]
            n_out += 1
            area[n_rings] = twice
            n_rings += 1
    start[n_rings] = n_out
    return out[:n_out], start[: n_rings + 1], ring_label[:n_rings], area[:n_rings]


@dataclass(frozen=True, slots=True)
class Regions:
    """Connected regions of one map of classes.

    Attributes
    ----------
    of_cell : int64, shape (n_rows, n_cols)
    klass : int64, shape (n_regions,)
    cells : int64, shape (n_regions,)
        Number of cells.
    """

    of_cell: IntArray
    klass: IntArray
    cells: IntArray


def regions(classes: IntArray) -> Regions:
    """Regions of equal class that hang together over sides of cells.

    Parameters
    ----------
    classes : int64, shape (n_rows, n_cols)

    Returns
    -------
    Regions
    """
    labels, n = components(np.ascontiguousarray(classes, np.int64))
    klass = np.zeros(n, np.int64)
    klass[labels.ravel()] = classes.ravel()
    return Regions(labels, klass, np.bincount(labels.ravel(), minlength=n).astype(np.int64))


@dataclass(frozen=True, slots=True)
class Outlines:
    """Smoothed boundaries of one map of classes.

    Attributes
    ----------
    shape : (n_rows, n_cols)
    x, y : int64, shape (n_vertices,)
        Corners of cells; y is upward, and there is a frame of one cell around the map.
    ends : int64, shape (n_edges, 2)
        Vertices.
    sides : int64, shape (n_edges, 2)
        Regions on the left and right.
    klass : int64, shape (n_regions,)
    """

    shape: tuple[int, int]
    x: IntArray
    y: IntArray
    ends: IntArray
    sides: IntArray
    klass: IntArray

    def rings(self) -> Rings:
        """Rings of all regions of class 1 and above; their labels are those of ``klass``."""
        vertex, start, label, area = _trace(self.x, self.y, self.ends, self.sides, self.klass > 0)
        return Rings(self.x[vertex] - 1, -self.y[vertex] - 1, start, label, area)


def smoothed(
    classes: IntArray,
    smallest_cells: int,
    tolerance_cells: float,
    inside: Outlines | None = None,
) -> Outlines:
    """Boundaries of a map, with corners cut on the side of the lower class only.

    Parameters
    ----------
    classes : int64, shape (n_rows, n_cols)
        From 0.
    smallest_cells : int
        Area that no region of at least this size falls below (cells); nor does a region lose more
        than half its area.
    tolerance_cells : float
        Largest distance of a boundary from where it was (cells).
    inside : Outlines, optional
        A map of the same shape, drawn from classes nowhere below these: no place becomes higher
        than there.

    Returns
    -------
    Outlines
    """
    part = regions(np.pad(np.asarray(classes, np.int64), 1))
    x, y, at, ends, sides = _graph(part.of_cell)
    edges_at, degree = _incidence(ends, x.size)
    room = np.maximum(2 * part.cells - np.maximum(2 * smallest_cells, part.cells), 0)
    if inside is None:
        lid_at, lid_edges = np.empty(0, np.int64), np.empty(0, np.int64)
        lid_ends, lid_classes = np.empty((0, 4), np.int64), np.empty((0, 2), np.int64)
    else:
        n_rows, n_cols = part.of_cell.shape
        lid_at, lid_edges = _buckets(inside.x, inside.y, inside.ends, n_rows, n_cols)
        lid_ends = np.stack((inside.x[inside.ends], inside.y[inside.ends]), axis=2).reshape(-1, 4)
        lid_classes = np.vstack((inside.klass[inside.sides], [[n_cols, n_rows]]))
    _smooth(
        x,
        y,
        at,
        ends,
        sides,
        edges_at,
        degree,
        part.klass,
        room,
        float(tolerance_cells),
        lid_at,
        lid_edges,
        lid_ends,
        lid_classes,
    )
    alive = ends[:, 0] >= 0
    shape = (int(classes.shape[0]), int(classes.shape[1]))
    return Outlines(shape, x, y, ends[alive], sides[alive], part.klass)
