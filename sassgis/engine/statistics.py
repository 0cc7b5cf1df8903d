"""Sums per cell, window and object, and how one block is added to them."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import inlined, kernel, lean
from sassgis.engine.recording import ARRIVAL, ENERGY, HEIGHT, SPEED2, CellWork
from sassgis.grid import IntArray
from sassgis.settings.map_run import Window
from sassgis.settings.statistics_table import QUANTITIES, Bins, Reducer, sums_by


def _quantities(reducer: Reducer) -> tuple[int, ...]:
    """Find the quantity from which each column of the sums of a kind is made."""
    return tuple(QUANTITIES.index(s.quantity) for s in sums_by(reducer))


# Constants of the compiled code.
_SUMMED, _RAISED, _LOWERED = _quantities("sum"), _quantities("max"), _quantities("min")
_BINNED = _quantities("histogram")
_EMPTY = np.array([[s.empty for kind in ("sum", "max", "min") for s in sums_by(kind)]])


class FlatBins(NamedTuple):
    """Upper limits of the bins of all histograms, one after the other, then the energy thresholds.

    The last bin of each ends at infinity, the first begins there. At a threshold, in kJ and
    ascending from 0, blocks are counted that have this energy or more.
    """

    end: NDArray[np.float64]
    first: NDArray[np.int64]  # (histograms + 2,)
    guess: NDArray[np.int16]  # (histograms + 1, keys): bin of the smallest value of each key


# The bin of a value is looked for from that of its key on: the leading bits of its binary
# representation, exponent and so many digits, from 2^-10 up to 2^21. So the search is short.
_DIGITS = 8
_FIRST_KEY, _LAST_KEY = (int((e + 1023) << _DIGITS) for e in (-10, 21))


class Objects(NamedTuple):
    """Objects that cover cells of the chunk, cell by cell; each has a number."""

    offset: NDArray[np.int64]  # (n_cells + 1,)
    number: NDArray[np.int64]


class Disks(NamedTuple):
    """Windows: disks around the centres of cells, which paths may meet."""

    n: int  # how many, or for how many there is room
    # (n_cells of the chunk, steps): the disk around the cell at each step, -1 outside the grid.
    number: NDArray[np.int32]
    step_u: NDArray[np.float64]  # (steps,), of columns and rows
    step_v: NDArray[np.float64]
    # (n_cells, 2): column and row of each cell's centre, in cells; no rows without windows.
    middle: NDArray[np.float64]
    radius2: float  # in cells, squared
    gap: NDArray[np.float64]  # (steps,) working space of one thread, as _gap


def disks_of(window: Window | None, n: int, n_cells: int) -> Disks:
    """Return ``n`` windows around so many cells, whose numbers and middles are still to be set."""
    row_step, col_step = window.steps() if window is not None else (np.empty(0, np.int64),) * 2
    return Disks(
        n, np.zeros((n_cells, row_step.size), np.int32), col_step.astype(np.float64),
        row_step.astype(np.float64), np.zeros((n_cells if n else 0, 2)),
        0.0 if window is None else window.radius**2, np.zeros(row_step.size),
    )  # fmt: skip


class Exceedance(NamedTuple):
    """Blocks that came to each place (cell, window or object) with the energy of a threshold.

    While they are counted: by how much the number at a threshold exceeds that at the next one. So a
    block is one entry.
    """

    # (n, thresholds, 2): number, and sum over strata of the square of the stratum's number. Beside
    # each other, as they are touched together.
    blocks: NDArray[np.int64]
    # Working space for the blocks of one stratum: their number by the highest threshold that they
    # reached, and last that of all; the highest of all, -1 where none has been, and the places to
    # which they came.
    own: NDArray[np.int32]  # (n, thresholds + 1)
    top: NDArray[np.int16]
    met: NDArray[np.int64]
    n_met: NDArray[np.int64]  # (1,)
    # Of windows and objects, for one block: its largest energy there (J), -1 where it has not been,
    # and the places that it has met.
    peak: NDArray[np.float64]
    peaked: NDArray[np.int64]
    n_peaked: NDArray[np.int64]  # (1,)


def no_exceedance(n: int, thresholds: int, are_cells: bool = False) -> Exceedance:
    """Return counts for ``n`` places and so many thresholds."""
    n_peaks = 0 if are_cells else n
    return Exceedance(
        blocks=np.zeros((n, thresholds, 2), np.int64),
        own=np.zeros((n, thresholds + 1), np.int32),
        top=np.full(n, -1, np.int16),
        met=np.zeros(n, np.int64),
        n_met=np.zeros(1, np.int64),
        peak=np.full(n_peaks, -1.0),
        peaked=np.zeros(n_peaks, np.int64),
        n_peaked=np.zeros(1, np.int64),
    )


@kernel
def counted(sums: Exceedance, rows: IntArray) -> tuple[IntArray, IntArray]:
    """Return blocks and squares at the thresholds of some places, where all blocks are counted."""
    shape = rows.size, sums.blocks.shape[1]
    blocks = np.empty(shape, np.int64)
    square = np.empty(shape, np.int64)
    for k in range(rows.size):
        above = np.int64(0)
        above2 = np.int64(0)
        for i in range(shape[1] - 1, -1, -1):
            above += sums.blocks[rows[k], i, 0]
            above2 += sums.blocks[rows[k], i, 1]
            blocks[k, i] = above
            square[k, i] = above2
    return blocks, square


class Changes(NamedTuple):
    """By how much counts without barriers exceed those with them; without places: not wanted.

    As Exceedance, with signs. A block whose motion no barrier changed is the same in both.
    """

    reach: Exceedance
    windows: Exceedance
    objects: Exceedance


#: A block counts with barriers and without them, only with them, or only without them.
BOTH, WITH, WITHOUT = range(3)


class Totals(NamedTuple):
    """Sums of the run, to which the blocks of a chunk are added; one entry per block and place.

    Whole numbers and extremes, so that the order of adding does not matter.
    """

    bins: FlatBins
    stops: NDArray[np.int64]  # (n_cells,)
    # (n_cells, sums, maxima and minima): together, as they are touched together.
    values: NDArray[np.float64]
    counts: tuple[NDArray[np.uint32], ...]  # (n_cells, bins) of each histogram
    reach: Exceedance  # of the cells
    disks: Disks
    windows: Exceedance
    on_objects: Objects
    objects: Exceedance
    changes: Changes


# Blocks that came to cells are noted as visits, one word for each block and cell: the number of the
# cell, and below it the bins of the histograms. They are added cell by cell, as the histograms of a
# cell take kilobytes.
_BIN_BITS = 9
_CELL_BITS = _BIN_BITS * len(_BINNED)
_CELL, _BINS = np.uint64(_CELL_BITS), np.uint64(2**_BIN_BITS - 1)
#: Visits for which there is room at first.
VISITS = 2**22


def flat_bins(bins: Bins) -> FlatBins:
    """Return the bins as the kernel takes them."""
    edges = [bins.edges[s.name][1:-1] for s in sums_by("histogram")]
    edges.append(bins.threshold[1:])
    if max(e.size for e in edges) > _BINS:
        raise ValueError(f"a histogram has more than {_BINS + 1} bins")
    end = [np.append(e, np.inf) for e in edges]
    keys = np.arange(_FIRST_KEY, _LAST_KEY + 1, dtype=np.int64) << (52 - _DIGITS)
    least = keys.view(np.float64)
    # Below the first key there may be any value from 0 on.
    least[0] = 0.0
    guess = [np.searchsorted(e, least, side="right") for e in edges]
    first = np.cumsum([0, *(e.size for e in end)]).astype(np.int64)
    return FlatBins(np.concatenate(end), first, np.array(guess, np.int16))


def empty_totals(
    n_cells: int, bins: Bins, disks: Disks, on_objects: Objects, n_objects: int,
    *, changes: bool = False,
) -> Totals:  # fmt: skip
    """Return sums for ``n_cells`` cells to which nothing has come yet.

    ``changes`` is whether those without barriers are wanted too.
    """
    flat = flat_bins(bins)
    levels = bins.threshold.size
    # In one large block, which comes zeroed from the system: zeros that nobody writes to then take
    # no memory. Smaller blocks come from the C library, which clears them.
    zeros = np.zeros(n_cells * flat.first[-2], np.uint32)
    edges = pairwise(flat.first[:-1])
    # Hazard is counted in windows where there are some, and of the cells only who came; else in
    # cells.
    sizes = 0 if disks.n else n_cells, disks.n, n_objects
    return Totals(
        bins=flat,
        stops=np.zeros(n_cells, np.int64),
        values=np.repeat(_EMPTY, n_cells, axis=0),
        counts=tuple(zeros[n_cells * a : n_cells * b].reshape(n_cells, b - a) for a, b in edges),
        reach=no_exceedance(n_cells, 1 if disks.n else levels, are_cells=True),
        disks=disks,
        windows=no_exceedance(disks.n, levels),
        on_objects=on_objects,
        objects=no_exceedance(n_objects, levels),
        changes=Changes(*(no_exceedance(changes * n, levels, are_cells=True) for n in sizes)),
    )


@lean
def _bin_of(bins: FlatBins, which: int, value: float) -> int:
    """Return the bin of a histogram that holds a value, after all the highest threshold reached."""
    key = (np.float64(value).view(np.int64) >> (52 - _DIGITS)) - _FIRST_KEY
    i = np.int64(bins.guess[which, min(max(key, 0), bins.guess.shape[1] - 1)])
    first = bins.first[which]
    while value >= bins.end[first + i]:
        i += 1
    return int(i)


@inlined
def _cell_of(visit: np.uint64) -> int:
    return int(visit >> _CELL)


@kernel
def by_cell(visits: NDArray[np.uint64], n_cells: int) -> NDArray[np.uint64]:
    """Return visits, those of a cell together."""
    start = np.zeros(n_cells + 1, np.int64)
    for visit in visits:
        start[_cell_of(visit) + 1] += 1
    for i in range(1, start.size):
        start[i] += start[i - 1]
    out = np.empty_like(visits)
    for visit in visits:
        cell = _cell_of(visit)
        out[start[cell]] = visit
        start[cell] += 1
    return out


@lean
def _came(reach: Exceedance, place: int, level: int, times: int) -> None:
    """Count a block of the stratum at a place, by the highest threshold that it reached there."""
    if reach.top[place] < level:
        if reach.top[place] < 0:
            reach.met[reach.n_met[0]] = place
            reach.n_met[0] += 1
        reach.top[place] = level
    reach.own[place, level] += np.int32(times)
    reach.own[place, -1] += np.int32(times)


@lean
def _counts(reach: Exceedance, change: Exceedance, place: int, level: int, where: int) -> None:
    """Count a block of the stratum at a place: with and without barriers, or only in one."""
    if where != WITHOUT:
        _came(reach, place, level, 1)
    if where != BOTH and change.top.size > 0:
        _came(change, place, level, 1 if where == WITHOUT else -1)


@lean
def _end_changes(reach: Exceedance, change: Exceedance) -> None:
    """Add by how much the counts of a stratum differ without barriers."""
    for k in range(change.n_met[0]):
        place = change.met[k]
        above = np.int64(0)
        without = np.int64(0)
        for i in range(max(change.top[place], reach.top[place]), -1, -1):
            own = np.int64(reach.own[place, i])
            more = np.int64(change.own[place, i])
            change.own[place, i] = 0
            before = without * without - above * above
            above += own
            without += own + more
            change.blocks[place, i, 0] += more
            change.blocks[place, i, 1] += without * without - above * above - before
        change.own[place, -1] = 0
        change.top[place] = -1
    change.n_met[0] = 0


@lean
def end_stratum(reach: Exceedance, change: Exceedance) -> None:
    """Add the blocks of a stratum, all of which have been counted."""
    _end_changes(reach, change)
    for k in range(reach.n_met[0]):
        place = reach.met[k]
        above = np.int64(0)
        i = np.int64(reach.top[place])
        # At most places few blocks reach few thresholds: only these are processed.
        while above < reach.own[place, -1]:
            own = np.int64(reach.own[place, i])
            if own > 0:
                blocks = above + own
                reach.blocks[place, i, 0] += own
                reach.blocks[place, i, 1] += blocks * blocks - above * above
                reach.own[place, i] = 0
                above = blocks
            i -= 1
        reach.own[place, -1] = 0
        reach.top[place] = -1
    reach.n_met[0] = 0


class Wanted(NamedTuple):
    """Where more blocks are worth most, as in settings.map_run.Worth.

    Filled is ``found``: the sum over windows and energies of worth · k (n - k), k of the n blocks
    of a stratum having come there with the energy. That is n - 1 times worth times the variance of
    k.
    """

    energy: NDArray[np.int64]  # rising
    of_cell: NDArray[np.float32]  # (n_cells, energies)
    cell: NDArray[np.int64]  # of each window
    found: NDArray[np.float64]  # (strata,)


@lean
def add_worth(reach: Exceedance, wanted: Wanted, stratum: int, n_blocks: int) -> None:
    """Add the uncertainty that the blocks of a stratum leave in the windows they reached."""
    for k in range(reach.n_met[0]):
        place = reach.met[k]
        worth = wanted.of_cell[wanted.cell[place]]
        came = np.int64(0)
        i = np.int64(reach.top[place])
        for j in range(wanted.energy.size - 1, -1, -1):
            while i >= wanted.energy[j]:
                came += reach.own[place, i]
                i -= 1
            wanted.found[stratum] += worth[j] * came * (n_blocks - came)


@lean
def _meet(reach: Exceedance, place: int, joule: float) -> None:
    """Raise the energy of a block at a place."""
    if reach.peak[place] < 0.0:
        reach.peaked[reach.n_peaked[0]] = place
        reach.n_peaked[0] += 1
    reach.peak[place] = max(reach.peak[place], joule)


@lean
def meet_objects(work: CellWork, n_touched: int, mass: float, totals: Totals) -> None:
    """Note the largest energy of a block on the objects whose cells it touched."""
    if totals.objects.peak.size == 0:
        return
    on = totals.on_objects
    for k in range(n_touched):
        cell = work.touched[k]
        joule = work.peak[cell, ENERGY] * mass
        for m in range(on.offset[cell], on.offset[cell + 1]):
            _meet(totals.objects, on.number[m], joule)


class _Chord(NamedTuple):
    """The straight path of a block across a cell: from (u, v) on by (du, dv), in cells."""

    u: float
    v: float
    du: float
    dv: float
    length2: float  # squared
    per: float  # 1 over it; 0 without a length


@inlined
def _chord(work: CellWork, cell: int) -> _Chord:
    ends = work.chord[cell]
    du = ends[2] - ends[0]
    dv = ends[3] - ends[1]
    length2 = du * du + dv * dv
    return _Chord(ends[0], ends[1], du, dv, length2, 1.0 / length2 if length2 > 0.0 else 0.0)


@inlined
def _gap(chord: _Chord, u: float, v: float, radius2: float) -> float:
    """Return up to 0 where a straight path meets a disk around (u, v), else more.

    Whatever the rounding: a path along the edge of a disk meets it, one that ends there does not,
    or else what a block does in the next cell would count. Without branches, so that the processor
    looks at several disks at a time.
    """
    u -= chord.u
    v -= chord.v
    foot = u * chord.du + v * chord.dv
    beside = chord.per > 0.0 and 0.0 <= foot <= chord.length2
    share = foot * chord.per
    share = 0.0 if share < 0.0 else share
    share = 1.0 if share > 1.0 else share
    u -= share * chord.du
    v -= share * chord.dv
    return u * u + v * v - radius2 * (1.0 + 1e-9 if beside else 1.0 - 1e-9)


@lean
def meet_disks(work: CellWork, n_touched: int, mass: float, totals: Totals) -> None:
    """Note the largest energy of a block in the disks that its path meets.

    In each cell the path is taken as straight (recording._pass); the energy is the largest there.
    """
    if totals.windows.peak.size == 0:
        return
    disks = totals.disks
    for k in range(n_touched):
        cell = work.touched[k]
        joule = work.peak[cell, ENERGY] * mass
        chord = _chord(work, cell)
        u = disks.middle[cell, 0]
        v = disks.middle[cell, 1]
        for m in range(disks.gap.size):
            disks.gap[m] = _gap(chord, u + disks.step_u[m], v + disks.step_v[m], disks.radius2)
        for m in range(disks.gap.size):
            number = disks.number[cell, m]
            if disks.gap[m] <= 0.0 and number >= 0 and joule > totals.windows.peak[number]:
                _meet(totals.windows, number, joule)


@lean
def passed_cells(work: CellWork, n_touched: int, last: int) -> int:
    """Keep the cells for which a block counts; return their number.

    They are those whose centre it passes within half a cell, and the ``last``, where it stops (-1:
    nowhere): so a cell is as wide in all directions. On lines off a map it counts for all cells.
    """
    if work.chord.shape[0] == 0:
        return n_touched
    n = 0
    for k in range(n_touched):
        cell = work.touched[k]
        chord = _chord(work, cell)
        u = math.floor(chord.u + 0.5 * chord.du) + 0.5
        v = math.floor(chord.v + 0.5 * chord.dv) + 0.5
        if cell == last or _gap(chord, u, v, 0.25) <= 0.0:
            work.touched[n] = cell
            n += 1
        else:
            work.peak[cell, ENERGY] = -1.0
    return n


@lean
def count_places(reach: Exceedance, change: Exceedance, bins: FlatBins, where: int) -> None:
    """Count a block at all windows or objects that it met; ``where`` as for add_to_totals."""
    for k in range(reach.n_peaked[0]):
        place = reach.peaked[k]
        level = _bin_of(bins, len(_BINNED), 1e-3 * reach.peak[place])
        _counts(reach, change, place, level, where)
        reach.peak[place] = -1.0
    reach.n_peaked[0] = 0


@lean
def flush_changes(work: CellWork, n_touched: int, mass: float, totals: Totals) -> None:
    """Count in its cells a block that moves there only without barriers."""
    for k in range(n_touched):
        cell = work.touched[k]
        if totals.changes.reach.top.size > 0:
            joule = work.peak[cell, ENERGY] * mass
            level = _bin_of(totals.bins, len(_BINNED), 1e-3 * joule)
            _counts(totals.reach, totals.changes.reach, cell, level, WITHOUT)
        work.peak[cell, ENERGY] = -1.0


@lean
def flush(
    work: CellWork, n_touched: int, mass: float, totals: Totals, visits: NDArray[np.uint64],
    where: int,
) -> None:  # fmt: skip
    """Add one block's cells to the sums, and note its visits."""
    bins = totals.bins
    for k in range(n_touched):
        cell = work.touched[k]
        record = work.peak[cell]
        joule = record[ENERGY] * mass
        record[ENERGY] = 1e-3 * joule
        record[SPEED2] = math.sqrt(record[SPEED2])
        thousandth = (joule, 1e3 * record[HEIGHT], 1e3 * record[SPEED2], 1e3 * record[ARRIVAL])
        values = totals.values[cell]
        for i in range(len(_SUMMED)):
            values[i] += math.floor(thousandth[_SUMMED[i]] + 0.5)
        for i in range(len(_RAISED)):
            at = len(_SUMMED) + i
            values[at] = max(values[at], record[_RAISED[i]])
        for i in range(len(_LOWERED)):
            at = len(_SUMMED) + len(_RAISED) + i
            values[at] = min(values[at], record[_LOWERED[i]])
        level = 0
        if totals.reach.blocks.shape[1] > 1:
            level = _bin_of(bins, len(_BINNED), record[ENERGY])
        _counts(totals.reach, totals.changes.reach, cell, level, where)
        visit = np.uint64(cell) << _CELL
        for i in range(len(_BINNED)):
            own = np.uint64(_bin_of(bins, i, record[_BINNED[i]]))
            visit += own << np.uint64(_BIN_BITS * i)
        visits[k] = visit
        record[ENERGY] = -1.0


@lean
def add_visits(
    visits: NDArray[np.uint64],
    row: NDArray[np.int32],
    counts: tuple[NDArray[np.uint32], ...],
    weight: int,
) -> None:
    """Add visits, those of a cell together, ``weight`` times each to the histograms.

    ``row`` is that of each cell in ``counts``.
    """
    for k in range(visits.size):
        visit = visits[k]
        at = row[_cell_of(visit)]
        for i in range(len(_BINNED)):
            own = (visit >> np.uint64(_BIN_BITS * i)) & _BINS
            counts[i][at, int(own)] += np.uint32(weight)


@lean
def collect(event: CellWork, n_event: int, work: CellWork, n_touched: int, mass: float) -> int:
    """Merge the cells of a block into those of it with all that it spawned, as one block of 1 kg.

    Returns how many cells there are then.
    """
    for k in range(n_touched):
        cell = work.touched[k]
        joule = work.peak[cell, ENERGY] * mass
        if event.peak[cell, ENERGY] < 0.0:
            event.touched[n_event] = cell
            n_event += 1
            event.peak[cell, HEIGHT] = 0.0
            event.peak[cell, SPEED2] = 0.0
            event.peak[cell, ARRIVAL] = np.inf
        event.peak[cell, ENERGY] = max(event.peak[cell, ENERGY], joule)
        event.peak[cell, HEIGHT] = max(event.peak[cell, HEIGHT], work.peak[cell, HEIGHT])
        event.peak[cell, SPEED2] = max(event.peak[cell, SPEED2], work.peak[cell, SPEED2])
        event.peak[cell, ARRIVAL] = min(event.peak[cell, ARRIVAL], work.peak[cell, ARRIVAL])
        work.peak[cell, ENERGY] = -1.0
    return n_event
