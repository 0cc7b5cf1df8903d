"""Regions of a raster of classes and their boundaries as one planar graph, on corners of cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sassgis.model.grid import IntArray
from sassgis.model.jit import kernel

#: Most edges at a vertex.
MAX_DEGREE = 4
#: A whole number (or truth value) in compiled code, of numpy's types or Python's.
Whole: TypeAlias = Any


@dataclass(frozen=True, slots=True)
class Regions:
    """Connected regions of one map of classes.

    Attributes
    ----------
    of_cell : int64, shape (n_rows, n_cols)
        From 0, in the order in which rows first meet the regions.
    klass : int64, shape (n_regions,)
    cells : int64, shape (n_regions,)
        Number of cells.
    """

    of_cell: IntArray
    klass: IntArray
    cells: IntArray


class Graph(NamedTuple):
    """Boundaries of regions: edges between vertices, at first one for each side of a cell.

    Attributes
    ----------
    x, y : int64, shape (n_vertices,)
        Corners of cells; y is upward.
    at : int64, shape (n_rows + 1, n_cols + 1)
        The vertex at each corner; -1: none.
    ends : int64, shape (n_edges, 2)
        Vertices; -1 once an edge has gone.
    sides : int64, shape (n_edges, 2)
        Regions on the left and right.
    edges_at : int64, shape (n_vertices, MAX_DEGREE)
        The edges at each vertex, ``degree`` of them.
    degree : int64, shape (n_vertices,)
        0 once a vertex has gone.
    """

    x: IntArray
    y: IntArray
    at: IntArray
    ends: IntArray
    sides: IntArray
    edges_at: IntArray
    degree: IntArray


@kernel
def _root(parent: IntArray, k: Whole) -> Whole:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel
def _components(codes: IntArray) -> tuple[IntArray, int]:
    """Label cells of equal code that hang together over sides; labels, and their number."""
    n_rows, n_cols = codes.shape
    parent = np.arange(n_rows * n_cols)
    for i in range(n_rows):
        for j in range(n_cols):
            k = i * n_cols + j
            if j > 0 and codes[i, j - 1] == codes[i, j]:
                a, b = _root(parent, k), _root(parent, k - 1)
                parent[max(a, b)] = min(a, b)
            if i > 0 and codes[i - 1, j] == codes[i, j]:
                a, b = _root(parent, k), _root(parent, k - n_cols)
                parent[max(a, b)] = min(a, b)
    labels = np.empty(n_rows * n_cols, np.int64)
    n = 0
    for k in range(n_rows * n_cols):
        a = _root(parent, k)
        # The root of a region is its smallest index, so that it has its label already.
        if a == k:
            labels[k] = n
            n += 1
        else:
            labels[k] = labels[a]
    return labels.reshape(n_rows, n_cols), n


def regions(classes: IntArray) -> Regions:
    """Regions of equal class that hang together over sides of cells.

    Parameters
    ----------
    classes : int64, shape (n_rows, n_cols)
    """
    labels, n = _components(np.ascontiguousarray(classes, np.int64))
    klass = np.zeros(n, np.int64)
    klass[labels.ravel()] = classes.ravel()
    return Regions(labels, klass, np.bincount(labels.ravel(), minlength=n).astype(np.int64))


def graph_of(faces: IntArray) -> Graph:
    """Boundaries of the faces (regions of cells), which have an outer frame of one face."""
    n_rows, n_cols = faces.shape
    across, along = faces[:-1] != faces[1:], faces[:, :-1] != faces[:, 1:]
    row, col = np.nonzero(across[:, :-1] | across[:, 1:] | along[:-1] | along[1:])
    at = np.full((n_rows + 1, n_cols + 1), -1, np.int64)
    at[row + 1, col + 1] = np.arange(row.size)
    i, j = np.nonzero(across)
    k, m = np.nonzero(along)
    ends = np.concatenate(
        (
            np.column_stack((at[i + 1, j], at[i + 1, j + 1])),
            np.column_stack((at[k, m + 1], at[k + 1, m + 1])),
        )
    )
    sides = np.concatenate(
        (
            np.column_stack((faces[i, j], faces[i + 1, j])),
            np.column_stack((faces[k, m + 1], faces[k, m])),
        )
    )
    x, y = (col + 1).astype(np.int64), -(row + 1).astype(np.int64)
    return Graph(x, y, at, ends, sides, *_incidence(ends, x.size))


def _incidence(ends: IntArray, n_vertices: int) -> tuple[IntArray, IntArray]:
    """Edges at each vertex (-1: none) and their number."""
    vertex = ends.ravel()
    order = np.argsort(vertex, kind="stable")
    degree = np.bincount(vertex, minlength=n_vertices).astype(np.int64)
    first = np.cumsum(degree) - degree
    edges_at = np.full((n_vertices, MAX_DEGREE), -1, np.int64)
    edges_at[vertex[order], np.arange(order.size) - first[vertex[order]]] = order // 2
    return edges_at, degree


@kernel
def other_end(g: Graph, e: Whole, v: Whole) -> Whole:
    """The vertex at the other end of an edge."""
    return g.ends[e, 1] if g.ends[e, 0] == v else g.ends[e, 0]


@kernel
def face_from(g: Graph, e: Whole, v: Whole, right: Whole) -> Whole:
    """Face on the left (0) or right (1) of the edge when it is walked away from v."""
    return g.sides[e, right] if g.ends[e, 0] == v else g.sides[e, 1 - right]


@kernel
def merge_onto(g: Graph, p: Whole, e: Whole) -> Whole:
    """Move vertex p along edge e onto its other end, which takes over the edges of p."""
    q = other_end(g, e, p)
    k = 0
    for s in range(g.degree[q]):
        if g.edges_at[q, s] != e:
            g.edges_at[q, k] = g.edges_at[q, s]
            k += 1
    for s in range(g.degree[p]):
        f = g.edges_at[p, s]
        if f == e:
            continue
        if g.ends[f, 0] == p:
            g.ends[f, 0] = q
        else:
            g.ends[f, 1] = q
        g.edges_at[q, k] = f
        k += 1
    g.degree[q] = k
    g.degree[p] = 0
    g.at[-g.y[p], g.x[p]] = -1
    g.ends[e, 0] = -1
    g.ends[e, 1] = -1
    return q


@kernel
def merge_straight_runs(g: Graph) -> None:
    """Remove vertices on straight runs: no area is swept and nothing can lie between."""
    for i in range(g.x.size):
        if g.degree[i] == 2:
            a = other_end(g, g.edges_at[i, 0], i)
            b = other_end(g, g.edges_at[i, 1], i)
            across = (g.x[a] - g.x[i]) * (g.y[b] - g.y[i])
            if across == (g.y[a] - g.y[i]) * (g.x[b] - g.x[i]):
                merge_onto(g, i, g.edges_at[i, 0])


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


@dataclass(frozen=True, slots=True)
class Outlines:
    """Boundaries of one map of classes; there is a frame of one cell around the map.

    Attributes
    ----------
    x, y : int64, shape (n_vertices,)
        Corners of cells; y is upward.
    ends, sides : int64, shape (n_edges, 2)
        Vertices, and the regions on the left and right.
    klass : int64, shape (n_regions,)
    """

    x: IntArray
    y: IntArray
    ends: IntArray
    sides: IntArray
    klass: IntArray

    def rings(self) -> Rings:
        """Rings of all regions of class 1 and above; their labels are those of ``klass``."""
        incidence = _incidence(self.ends, self.x.size)
        wanted = self.klass > 0
        vertex, start, label = _trace(self.x, self.y, self.ends, self.sides, *incidence, wanted)
        x, y = self.x[vertex], self.y[vertex]
        # Of the last vertex of a ring to the first of the next nothing is added up.
        cross = np.append(x[:-1] * y[1:] - x[1:] * y[:-1], 0)
        cross[start[1:] - 1] = 0
        area = np.add.reduceat(cross, start[:-1]) if label.size else np.empty(0, np.int64)
        return Rings(x - 1, -y - 1, start, label, area)


@kernel
def _trace(
    x: IntArray, y: IntArray, ends: IntArray, label: IntArray, edges_at: IntArray,
    degree: IntArray, wanted: NDArray[np.bool_],
) -> tuple[IntArray, IntArray, IntArray]:  # fmt: skip
    """Rings of all wanted labels; `label[e]` are those left and right of the edges.

    At a corner where parts of one region meet, the ring walks on around the region outside:
    outer rings and holes may touch there, but no ring meets itself. Returns the vertices of all
    rings, the first of each, and its label.
    """
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
            n_rings += 1
            e = e0
            s = s0
            while not done[e, s]:
                done[e, s] = True
                u = ends[e, s]
                v = ends[e, 1 - s]
                out[n_out] = u
                n_out += 1
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
            out[n_out] = ends[e0, s0]
            n_out += 1
    start[n_rings] = n_out
    return out[:n_out], start[: n_rings + 1], ring_label[:n_rings]
