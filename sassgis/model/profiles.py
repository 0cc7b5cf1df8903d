"""Fall lines on the map and the flattened profiles made of them.

Ragged data are flat arrays with offsets: item ``i`` owns ``[offset[i], offset[i + 1])``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.results import ControlLine


class LineEnd(IntEnum):
    """Why a fall line ends where it does."""

    LEFT_DEM = 0
    NODATA = 1
    ENERGY_LINE = 2
    MAX_LENGTH = 3
    CLOSED_LOOP = 4


@dataclass(frozen=True, slots=True)
class ReleasePoints:
    """Points from which fall lines start.

    Attributes
    ----------
    x, y : float64, shape (n,)
        Coordinates (m).
    area : int64, shape (n,)
        Position of the release area in ``area_names``.
    key : uint64, shape (n,)
        Identity of the point for random draws. Made from the name of its area and its place in
        it, never from what else is in the run.
    area_names : tuple of str
    """

    x: FloatArray
    y: FloatArray
    area: IntArray
    key: NDArray[np.uint64]
    area_names: tuple[str, ...]

    def __len__(self) -> int:
        return int(self.x.size)


@dataclass(frozen=True, slots=True)
class TraceSet:
    """Fall lines as they lie on the map, densely sampled.

    Attributes
    ----------
    offset : int64, shape (n + 1,)
    x, y : float64, shape (offset[-1],)
        Coordinates (m); each line starts at its release point.
    s : float64, shape (offset[-1],)
        Chainage: plan length from the release point (m).
    point : int64, shape (n,)
        The release point of each line.
    end : uint8, shape (n,)
        A LineEnd.
    """

    offset: IntArray
    x: FloatArray
    y: FloatArray
    s: FloatArray
    point: IntArray
    end: NDArray[np.uint8]

    def __len__(self) -> int:
        return int(self.offset.size - 1)


@dataclass(frozen=True, slots=True)
class ProfileSet:
    """Fall lines unrolled into a vertical plane and made of straight segments.

    Attributes
    ----------
    offset : int64, shape (n + 1,)
        Of the vertices of each profile.
    s, z : float64, shape (offset[-1],)
        Chainage and height of the vertices (m); chainage rises strictly.
    ground : int32, shape (offset[-1],)
        Ground class of the segment that *starts* at the vertex; the last of a profile is unused.
    cell_offset : int64, shape (n + 1,)
        Of the cell stretches of each profile.
    cell_s : float64, shape (cell_offset[-1] + n,)
        Borders between the stretches: profile ``i`` has one more border than stretches, and
        they start at ``cell_offset[i] + i``. First border = first vertex, last = last vertex.
    cell : int64, shape (cell_offset[-1],)
        Flat index of the grid cell under each stretch; -1 where there is none.
    on_map : float64, shape (cell_offset[-1] + n, 2), or None
        Borders between the stretches on the map, laid out as ``cell_s``: columns from the west edge
        of the grid and rows from its north edge, in cells. None: not on a map.
    """

    offset: IntArray
    s: FloatArray
    z: FloatArray
    ground: NDArray[np.int32]
    cell_offset: IntArray
    cell_s: FloatArray
    cell: IntArray
    on_map: FloatArray | None = None

    def __len__(self) -> int:
        return int(self.offset.size - 1)

    def vertices(self, i: int) -> tuple[FloatArray, FloatArray]:
        """Chainage and height of the vertices of profile ``i`` (m)."""
        own = slice(int(self.offset[i]), int(self.offset[i + 1]))
        return self.s[own], self.z[own]


@dataclass(frozen=True, slots=True)
class ControlLineCrossings:
    """Where profiles cross stations and barriers.

    Attributes
    ----------
    control_lines : tuple of ControlLine
    offset : int64, shape (n_lines + 1,)
    chainage : float64, shape (offset[-1],)
        Rising within a line (m).
    control_line : int64, shape (offset[-1],)
        Position in ``control_lines``.
    """

    control_lines: tuple[ControlLine, ...]
    offset: IntArray
    chainage: FloatArray
    control_line: IntArray

    @classmethod
    def none(cls, n_lines: int) -> ControlLineCrossings:
        """No stations and no barriers."""
        return cls((), np.zeros(n_lines + 1, np.int64), np.empty(0), np.empty(0, np.int64))

    @classmethod
    def same_for_all(
        cls, control_lines: Sequence[ControlLine], chainages: Sequence[float], n_lines: int
    ) -> ControlLineCrossings:
        """The same control lines at the same chainages (m) on each of ``n_lines`` profiles."""
        order = np.argsort(np.asarray(chainages, float), kind="stable")
        sorted_chainage = np.asarray(chainages, float)[order]
        return cls(
            tuple(control_lines),
            np.arange(n_lines + 1, dtype=np.int64) * len(control_lines),
            np.tile(sorted_chainage, n_lines),
            np.tile(order.astype(np.int64), n_lines),
        )
