"""Outlines of a raster of classes, smoothed without lowering any cell.

All boundaries are held once, as edges between corners of cells, and are smoothed by moving vertices
onto neighbouring vertices. Vertices therefore stay on corners of cells, every test is made with
whole numbers, and neighbouring zones share their boundary exactly: there is nothing to snap and
nothing that could open a gap. Maps of several return periods are drawn from the rarest to the most
frequent, each kept inside the one before.
"""

from __future__ import annotations

import heapq
from typing import Any, NamedTuple

import numpy as np

from sassgis.hazard.zoning.planar_graph import (
    MAX_DEGREE,
    Graph,
    Outlines,
    Whole,
    face_from,
    graph_of,
    merge_onto,
    merge_straight_runs,
    other_end,
    regions,
)
from sassgis.model.grid import IntArray
from sassgis.model.jit import kernel

#: Closest that a smoothed edge comes to another vertex (cells). It keeps strips between two
#: boundaries from becoming threads, and is far above the rounding of coordinates.
CLEARANCE = 0.25
#: A share of an edge, as two whole numbers without a common divisor.
_SHARE, _SCALE = 4999, 10007


class Lid(NamedTuple):
    """Boundaries of another map that a map must stay inside.

    Attributes
    ----------
    at, edges : int64
        Its edges at each cell: ``edges[at[cell] : at[cell + 1]]``; empty: no other map.
    ends : int64, shape (n_edges, 4)
        x and y of both ends.
    classes : int64, shape (n_edges + 1, 2)
        Left and right of the edges; at last the numbers of columns and rows.
    """

    at: IntArray
    edges: IntArray
    ends: IntArray
    classes: IntArray


@kernel
def _handed_over(g: Graph, p: Whole, e: Whole, f: Whole) -> tuple[Whole, Whole, Whole]:
    """What changes hands between p and another edge f when p moves along e onto its other end.

    Twice the area, above 0 on the left of e; the face that loses and the one that wins.
    """
    q, r = other_end(g, e, p), other_end(g, f, p)
    across = (g.x[q] - g.x[p]) * (g.y[r] - g.y[p]) - (g.y[q] - g.y[p]) * (g.x[r] - g.x[p])
    right = 0 if across > 0 else 1
    return across, face_from(g, e, p, right), face_from(g, f, p, right)


@kernel
def _swept(g: Graph, p: Whole, e: Whole, classes: IntArray) -> Whole:
    """Twice the area that changes hands when vertex p moves along edge e onto its other end.

    -1 if the move would lower any place, or make a region vanish.
    """
    q = other_end(g, e, p)
    # Two junctions may become one only where no more than four boundaries meet then.
    if g.degree[p] + g.degree[q] - 2 > MAX_DEGREE:
        return -1
    area: Whole = 0
    on_left = 0
    on_right = 0
    for s in range(g.degree[p]):
        f = g.edges_at[p, s]
        if f == e:
            continue
        r = other_end(g, f, p)
        if r == q:
            return -1
        for s2 in range(g.degree[q]):
            if other_end(g, g.edges_at[q, s2], q) == r:
                return -1  # a triangular region would collapse
        across, loser, winner = _handed_over(g, p, e, f)
        if across == 0:
            continue
        if across > 0:
            on_left += 1
        else:
            on_right += 1
        # With two edges on one side, more than one region would sweep over another.
        if on_left > 1 or on_right > 1:
            return -1
        if classes[winner] < classes[loser]:
            return -1
        area += abs(across)
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
    """Edges that touch each cell, or more, as in Lid."""
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
def _is_under(g: Graph, p: Whole, q: Whole, r: Whole, rises_to: Whole, lid: Lid) -> bool:
    """Whether another map is nowhere below a class in the triangle p, q, r.

    It must not be below the class beside p-r, on the side away from the triangle.
    """
    if lid.at.size == 0:
        return True
    px, py, qx, qy, rx, ry = g.x[p], g.y[p], g.x[q], g.y[q], g.x[r], g.y[r]
    turn = 1 if (qx - px) * (ry - py) - (qy - py) * (rx - px) > 0 else -1
    n_cols = lid.classes[-1, 0]
    n_rows = lid.classes[-1, 1]
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
            for k in range(lid.at[cell], lid.at[cell + 1]):
                e = lid.edges[k]
                left = lid.classes[e, 0]
                right = lid.classes[e, 1]
                if (left < rises_to) == (right < rises_to):
                    continue
                sx, sy, tx, ty = lid.ends[e, 0], lid.ends[e, 1], lid.ends[e, 2], lid.ends[e, 3]
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
    ax: Whole, ay: Whole, bx: Whole, by: Whole, sx: Whole, sy: Whole, tx: Whole, ty: Whole,
    turn: Whole,
) -> Whole:  # fmt: skip
    """Whether an end of s-t lies on the inner side of the side a-b of a triangle."""
    dx = turn * (bx - ax)
    dy = turn * (by - ay)
    return dx * (sy - ay) - dy * (sx - ax) > 0 or dx * (ty - ay) - dy * (tx - ax) > 0


@kernel
def _is_free(g: Graph, p: Whole, q: Whole, r: Whole) -> bool:
    """Whether no vertex but its corners is in the triangle p, q, r, or close to its side q-r."""
    px, py, qx, qy, rx, ry = g.x[p], g.y[p], g.x[q], g.y[q], g.x[r], g.y[r]
    cross = (qx - px) * (ry - py) - (qy - py) * (rx - px)
    turn = 1 if cross > 0 else -1
    dx = rx - qx
    dy = ry - qy
    length2 = dx * dx + dy * dy
    near2 = CLEARANCE * CLEARANCE
    n_rows, n_cols = g.at.shape
    for yy in range(min(py, qy, ry) - 1, max(py, qy, ry) + 2):
        row = -yy
        if row < 0 or row >= n_rows:
            continue
        low, high = _columns(px, py, qx, qy, rx, ry, yy - 1, yy + 1)
        if low > high:
            continue
        for xx in range(max(int(np.floor(low)) - 1, 0), min(int(np.ceil(high)) + 2, n_cols)):
            v = g.at[row, xx]
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
def _is_within(g: Graph, v: Whole, q: Whole, r: Whole, tolerance2: float) -> Whole:
    """Whether a vertex is no farther from the segment q-r than the tolerance."""
    dx = g.x[r] - g.x[q]
    dy = g.y[r] - g.y[q]
    ax = g.x[v] - g.x[q]
    ay = g.y[v] - g.y[q]
    length2 = dx * dx + dy * dy
    along = ax * dx + ay * dy
    if along <= 0:
        return ax * ax + ay * ay <= tolerance2
    if along >= length2:
        return (g.x[v] - g.x[r]) ** 2 + (g.y[v] - g.y[r]) ** 2 <= tolerance2
    cross = float(ax * dy - ay * dx)
    return cross * cross <= tolerance2 * length2


@kernel
def _chain_is_within(
    g: Graph, k: Whole, chain: IntArray, q: Whole, r: Whole, tolerance2: float
) -> bool:
    while k >= 0:
        if not _is_within(g, chain[k, 0], q, r, tolerance2):
            return False
        k = chain[k, 1]
    return True


@kernel
def _push_moves(
    heap: list[tuple[Whole, Whole, Whole, Whole]],
    g: Graph,
    p: Whole,
    classes: IntArray,
    version: IntArray,
) -> None:
    version[p] += 1
    n = 1 if g.degree[p] == 2 else g.degree[p]  # onto either end of two edges: the same outline
    for s in range(n):
        e = g.edges_at[p, s]
        area = _swept(g, p, e, classes)
        if area >= 0:
            heapq.heappush(heap, (area, p, e, version[p]))


@kernel
def _exchange_areas(
    g: Graph, p: Whole, e: Whole, classes: IntArray, room: IntArray, booked: IntArray, lid: Lid
) -> bool:
    """Book the areas that faces exchange when vertex `p` moves along edge `e` onto its other end.

    False, with `room` as it was, if a face has no room left or would rise above the map that this
    one must stay inside. `booked` is work space, one row for each edge of a vertex.
    """
    q = other_end(g, e, p)
    n_booked = 0
    for s in range(g.degree[p]):
        f = g.edges_at[p, s]
        if f == e:
            continue
        across, loser, winner = _handed_over(g, p, e, f)
        if across == 0:
            continue
        room[loser] -= abs(across)
        room[winner] += abs(across)
        booked[n_booked, 0] = loser
        booked[n_booked, 1] = winner
        booked[n_booked, 2] = abs(across)
        n_booked += 1
        if room[loser] < 0 or not _is_under(g, p, q, other_end(g, f, p), classes[winner], lid):
            for k in range(n_booked):
                room[booked[k, 0]] += booked[k, 2]
                room[booked[k, 1]] -= booked[k, 2]
            return False
    return True


@kernel
def _is_near(
    g: Graph, p: Whole, e: Whole, chain: IntArray, first: IntArray, tolerance2: float
) -> bool:
    """Whether outlines stay near where they were, and free, if p moves along e."""
    q = other_end(g, e, p)
    for s in range(g.degree[p]):
        f = g.edges_at[p, s]
        if f == e:
            continue
        r = other_end(g, f, p)
        if not (
            _is_within(g, p, q, r, tolerance2)
            and _chain_is_within(g, first[e], chain, q, r, tolerance2)
            and _chain_is_within(g, first[f], chain, q, r, tolerance2)
            and _is_free(g, p, q, r)
        ):
            return False
    return True


@kernel
def _with_room(chain: IntArray, used: Whole, more: Whole) -> IntArray:
    """The lists of vertices, larger if so many more do not fit."""
    if used + more <= chain.shape[0]:
        return chain
    grown = np.empty((2 * (chain.shape[0] + more), 2), np.int64)
    for i in range(used):
        grown[i, 0], grown[i, 1] = chain[i, 0], chain[i, 1]
    return grown


@kernel
def _inherit(
    g: Graph, p: Whole, e: Whole, chain: IntArray, n_chain: Whole, first: IntArray
) -> Whole:
    """Add p, and the vertices that edge e has replaced, to the lists of the other edges at p."""
    for s in range(g.degree[p]):
        f = g.edges_at[p, s]
        if f == e:
            continue
        k = first[e]
        if g.degree[p] == 2:
            # The only heir: takes the list as it is.
            if k >= 0:
                while chain[k, 1] >= 0:
                    k = chain[k, 1]
                chain[k, 1] = first[f]
                first[f] = first[e]
        else:
            while k >= 0:
                chain[n_chain, 0] = chain[k, 0]
                chain[n_chain, 1] = first[f]
                first[f] = n_chain
                n_chain += 1
                k = chain[k, 1]
        chain[n_chain, 0] = p
        chain[n_chain, 1] = first[f]
        first[f] = n_chain
        n_chain += 1
    if g.degree[p] == 2:
        first[e] = -1
    return n_chain


@kernel
def _smooth(g: Graph, classes: IntArray, room: IntArray, tolerance: float, lid: Lid) -> None:
    """Move vertices until no further move is allowed, the smallest swept area first.

    `room[face]` is what each face may yet lose (twice the area, cells). Changes the graph in place.
    """
    n = g.x.size
    # A hair above, so that a notch of exactly the tolerance is filled.
    tolerance2 = tolerance * tolerance * (1.0 + 1e-9)
    merge_straight_runs(g)
    # Vertices that each edge has replaced, as linked lists: the outline as it was. Rows are a
    # vertex and the next row; -1 ends a list.
    first = np.full(g.ends.shape[0], -1, np.int64)
    chain = np.empty((4 * n + 16, 2), np.int64)
    n_chain: Whole = 0
    home = np.arange(n)
    version = np.zeros(n, np.int64)
    booked = np.empty((MAX_DEGREE, 3), np.int64)
    moved = True
    while moved:
        moved = False
        heap = [(np.int64(0), np.int64(0), np.int64(0), np.int64(0))]
        heap.pop()
        for i in range(n):
            if g.degree[i] >= 2:
                _push_moves(heap, g, i, classes, version)
        while len(heap) > 0:
            _, p, e, v = heapq.heappop(heap)
            if version[p] != v or g.degree[p] == 0 or _swept(g, p, e, classes) < 0:
                continue
            q = other_end(g, e, p)
            # A junction takes boundaries along that did not run here: it stays near its home.
            h = home[p]
            if g.degree[p] > 2 and (g.x[q] - g.x[h]) ** 2 + (g.y[q] - g.y[h]) ** 2 > tolerance2:
                continue
            if not _is_near(g, p, e, chain, first, tolerance2):
                continue
            # Every edge that takes over vertices needs its own list of them.
            n_own = 1
            k = first[e]
            while k >= 0:
                n_own += 1
                k = chain[k, 1]
            chain = _with_room(chain, n_chain, n_own * (g.degree[p] - 1))
            if not _exchange_areas(g, p, e, classes, room, booked, lid):
                continue
            n_chain = _inherit(g, p, e, chain, n_chain, first)
            moved = True
            if g.degree[p] > 2:
                # Two junctions in one have two homes: it goes no further.
                home[q] = h if g.degree[q] == 2 else -1
            merge_onto(g, p, e)
            _push_moves(heap, g, q, classes, version)
            for s in range(g.degree[q]):
                _push_moves(heap, g, other_end(g, g.edges_at[q, s], q), classes, version)


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
    """
    part = regions(np.pad(np.asarray(classes, np.int64), 1))
    g = graph_of(part.of_cell)
    room = np.maximum(2 * part.cells - np.maximum(2 * smallest_cells, part.cells), 0)
    none = np.empty(0, np.int64)
    lid = Lid(none, none, np.empty((0, 4), np.int64), np.empty((0, 2), np.int64))
    if inside is not None:
        n_rows, n_cols = part.of_cell.shape
        lid = Lid(
            *_buckets(inside.x, inside.y, inside.ends, n_rows, n_cols),
            np.stack((inside.x[inside.ends], inside.y[inside.ends]), axis=2).reshape(-1, 4),
            np.vstack((inside.klass[inside.sides], [[n_cols, n_rows]])),
        )
    _smooth(g, part.klass, room, float(tolerance_cells), lid)
    alive = g.ends[:, 0] >= 0
    return Outlines(g.x, g.y, g.ends[alive], g.sides[alive], part.klass)
