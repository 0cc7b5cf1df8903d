"""The cells that blocks come to, numbered as they come, where they are not known beforehand."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import inlined, lean
from sassgis.engine.statistics import Disks, Objects, disks_of
from sassgis.grid import IntArray
from sassgis.settings.map_run import ObjectCells, Window

#: What ``counts`` holds: cells, windows, objects listed by cell, and whether there was room for all
#: of them.
CELLS, WINDOWS, LISTED_OBJECTS, FULL = range(4)


class CellRegister(NamedTuple):
    """Cells of the grid, windows around them and objects on them, by their number in the chunk."""

    n_cols: int
    n_rows: int
    number: NDArray[np.int32]  # (n_rows * n_cols,), one more than it; 0: nothing has come there
    cells: IntArray  # flat indices of the cells, as far as there are
    window_number: NDArray[np.int32]  # as ``number``; empty without windows
    windows: IntArray  # flat indices of their middle cells
    object_cell: IntArray  # as settings.map_run.ObjectCells
    object_number: IntArray
    disks: Disks  # of the windows
    on_objects: Objects
    counts: IntArray  # (4,)

    @property
    def full(self) -> bool:
        """Return whether there was no room for a cell."""
        return bool(self.counts[FULL])


def empty_register(
    shape: tuple[int, int], room: int, window: Window | None, objects: ObjectCells
) -> CellRegister:
    """Return room for so many cells, three times as many windows, and the objects on them."""
    n_rows, n_cols = shape
    n = n_rows * n_cols
    n_windows = 0 if window is None else 3 * room
    most = np.bincount(objects.cell).max() if objects.cell.size else 0
    return CellRegister(
        n_cols=n_cols,
        n_rows=n_rows,
        number=np.zeros(n, np.int32),
        cells=np.zeros(room, np.int64),
        window_number=np.zeros(n if n_windows else 0, np.int32),
        windows=np.zeros(n_windows, np.int64),
        object_cell=np.asarray(objects.cell, np.int64),
        object_number=np.asarray(objects.number, np.int64),
        disks=disks_of(window, n_windows, room),
        on_objects=Objects(np.zeros(room + 1, np.int64), np.zeros(room * int(most), np.int64)),
        counts=np.zeros(4, np.int64),
    )


@inlined
def registered(register: CellRegister, flat: int) -> int:
    """Return the number of a cell of the grid; -1 if there is no room for it, which is noted."""
    known = register.number[flat]
    if known > 0:
        return int(known) - 1
    return _register(register, flat)


@lean
def _register(register: CellRegister, flat: int) -> int:
    """Give a cell to which nothing has come yet its number."""
    counts = register.counts
    i = counts[CELLS]
    disks = register.disks
    n_steps = disks.step_u.size
    windows = counts[WINDOWS] + n_steps
    if i >= register.cells.size or (n_steps > 0 and windows > register.windows.size):
        counts[FULL] = 1
        return -1
    counts[CELLS] = i + 1
    register.number[flat] = i + 1
    register.cells[i] = flat
    row = flat // register.n_cols
    col = flat % register.n_cols
    if n_steps > 0:
        disks.middle[i, 0] = col + 0.5
        disks.middle[i, 1] = row + 0.5
    for k in range(n_steps):
        to_row = row + int(disks.step_v[k])
        to_col = col + int(disks.step_u[k])
        disks.number[i, k] = -1
        if 0 <= to_row < register.n_rows and 0 <= to_col < register.n_cols:
            middle = to_row * register.n_cols + to_col
            if register.window_number[middle] == 0:
                register.windows[counts[WINDOWS]] = middle
                counts[WINDOWS] += 1
                register.window_number[middle] = counts[WINDOWS]
            disks.number[i, k] = register.window_number[middle] - 1
    first = np.searchsorted(register.object_cell, flat)
    while first < register.object_cell.size and register.object_cell[first] == flat:
        register.on_objects.number[counts[LISTED_OBJECTS]] = register.object_number[first]
        counts[LISTED_OBJECTS] += 1
        first += 1
    register.on_objects.offset[i + 1] = counts[LISTED_OBJECTS]
    return int(i)
