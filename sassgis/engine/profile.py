"""One profile as the motion needs it: vertices, segments, stretches of cells."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.recording import Pieces
from sassgis.engine.rock import BARRIER
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel

# A vertex nearer than this to the line between its neighbours is none (m).
_STRAIGHT_M = 1e-9


@kernel
def cut(
    cell_s: FloatArray,
    cell: IntArray,
    s: FloatArray,
    pieces_border: FloatArray,
    pieces_cell: IntArray,
    pieces_segment: IntArray,
) -> int:
    """Cut cell stretches at the vertices; returns the number of pieces."""
    i = 0
    j = 0
    n = 0
    here = s[0]
    n_cells = cell.size
    n_segments = s.size - 1
    while i < n_cells and j < n_segments:
        end = min(cell_s[i + 1], s[j + 1])
        if end > here:
            pieces_border[n] = here
            pieces_cell[n] = cell[i]
            pieces_segment[n] = j
            n += 1
            here = end
        if cell_s[i + 1] <= end:
            i += 1
        if s[j + 1] <= end:
            j += 1
    if n == 0:
        pieces_border[0] = s[0]
        pieces_cell[0] = -1
        pieces_segment[0] = 0
        n = 1
        here = s[n_segments]
    pieces_border[n] = here
    return n


@kernel
def without_straight_vertices(
    s: FloatArray, z: FloatArray, ground: NDArray[np.int32]
) -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    """The profile without vertices at which neither direction nor ground changes.

    Such a vertex is none: however a straight slope is cut, the same rocks come down it.
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
def last_cell(pieces: Pieces, sx: FloatArray, reason: int, x: float, start: float) -> int:
    """Cell in which a rock ends; -1 outside."""
    if x < sx[0] or x > sx[sx.size - 1]:
        return -1
    # A rock that a wall holds lies in front of it, also on the border of a cell.
    k = int(np.searchsorted(pieces.border, x, side="right")) - 1
    if reason == BARRIER and k > 0 and pieces.border[k] >= x > start:
        k -= 1
    return int(pieces.cell[min(max(k, 0), pieces.cell.size - 1)])
