"""Fall lines on the map and the flattened profiles made of them.

Ragged data are flat arrays with offsets: item ``i`` owns ``[offset[i], offset[i + 1])``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray, IntArray
from sassgis.settings.results import ControlLine


class LineEnd(IntEnum):
    """Why a fall line ends where it does."""

    LEFT_DEM = 0
    NODATA = 1
    ENERGY_LINE = 2
    MAX_LENGTH = 3
    CLOSED_LOOP = 4


@dataclass(frozen=True, slots=True)
class ReleasePoints:
    """Points from which fall lines start."""

    # Shape (n,); coordinates (m).
    x: FloatArray
    y: FloatArray
    area: IntArray  # shape (n,); position of the release area in ``area_names``
    # Shape (n,); identity of the point for random draws. Made from the name of its area and its
    # place in it, never from what else is in the run.
    key: NDArray[np.uint64]
    area_names: tuple[str, ...]
    # Shape (n, 2, 2); two sides (east, north; m) of the parallelogram around each point that it
    # represents, in which blocks start whose paths are followed. None: all start at the points.
    sides: FloatArray | None = None

    def __len__(self) -> int:
        return int(self.x.size)


@dataclass(frozen=True, slots=True)
class TraceSet:
    """Fall lines as they lie on the map, densely sampled."""

    offset: IntArray  # shape (n + 1,)
    # Shape (offset[-1],); coordinates (m); each line starts at its release point.
    x: FloatArray
    y: FloatArray
    s: FloatArray  # shape (offset[-1],); chainage: plan length from the release point (m)
    point: IntArray  # shape (n,); the release point of each line
    end: NDArray[np.uint8]  # shape (n,); a LineEnd

    def __len__(self) -> int:
        return int(self.offset.size - 1)


@dataclass(frozen=True, slots=True)
class ProfileSet:
    """Fall lines unrolled into a vertical plane and made of straight segments."""

    offset: IntArray  # shape (n + 1,); of the vertices of each profile
    # Shape (offset[-1],); chainage and height of the vertices (m); chainage rises strictly.
    s: FloatArray
    z: FloatArray
    # Shape (offset[-1],); ground class of the segment that *starts* at the vertex; the last of a
    # profile is unused.
    ground: NDArray[np.int32]
    cell_offset: IntArray  # shape (n + 1,); of the cell stretches of each profile
    # Shape (cell_offset[-1] + n,); borders between the stretches: profile ``i`` has one more border
    # than stretches, and they start at ``cell_offset[i] + i``. First border = first vertex, last =
    # last vertex.
    cell_s: FloatArray
    # Shape (cell_offset[-1],); flat index of the grid cell under each stretch; -1 where there is
    # none.
    cell: IntArray
    # Shape (cell_offset[-1] + n, 2), or None; borders between the stretches on the map, laid out as
    # ``cell_s``: columns from the west edge of the grid and rows from its north edge, in cells.
    # None: not on a map.
    on_map: FloatArray | None = None

    def __len__(self) -> int:
        return int(self.offset.size - 1)

    def vertices(self, i: int) -> tuple[FloatArray, FloatArray]:
        """Return the chainage and height of the vertices of profile ``i`` (m)."""
        own = slice(int(self.offset[i]), int(self.offset[i + 1]))
        return self.s[own], self.z[own]


@dataclass(frozen=True, slots=True)
class ControlLineCrossings:
    """Where profiles cross stations and barriers."""

    control_lines: tuple[ControlLine, ...]
    offset: IntArray  # shape (n_lines + 1,)
    chainage: FloatArray  # shape (offset[-1],); rising within a line (m)
    control_line: IntArray  # shape (offset[-1],); position in ``control_lines``

    @classmethod
    def none(cls, n_lines: int) -> ControlLineCrossings:
        """Return control lines without stations or barriers."""
        return cls((), np.zeros(n_lines + 1, np.int64), np.empty(0), np.empty(0, np.int64))

    @classmethod
    def same_for_all(
        cls, control_lines: Sequence[ControlLine], chainages: Sequence[float], n_lines: int
    ) -> ControlLineCrossings:
        """Return same control lines at the same chainages (m) on each of ``n_lines`` profiles."""
        order = np.argsort(np.asarray(chainages, float), kind="stable")
        sorted_chainage = np.asarray(chainages, float)[order]
        return cls(
            tuple(control_lines), np.arange(n_lines + 1, dtype=np.int64) * len(control_lines),
            np.tile(sorted_chainage, n_lines), np.tile(order.astype(np.int64), n_lines),
        )  # fmt: skip
