"""Sums per cell, window and object, and how one block is added to them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.recording import ARRIVAL, ENERGY, HEIGHT, N_RECORDED, SPEED2, CellWork
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import lean
from sassgis.model.statistics_table import QUANTITIES, Bins, Reducer, sums_by


def _quantities(reducer: Reducer) -> tuple[int, ...]:
    """Which quantity each column of the sums of a kind is made from."""
    return tuple(QUANTITIES.index(s.quantity) for s in sums_by(reducer))


# Constants of the compiled code.
_SUMMED, _RAISED, _LOWERED = _quantities("sum"), _quantities("max"), _quantities("min")
_BINNED = _quantities("histogram")


class FlatBins(NamedTuple):
    """Edges of all histograms, one after the other."""

    edges: NDArray[np.float64]
    first: NDArray[np.int64]  # (histograms + 1,)
    threshold: NDArray[np.float64]  # kJ, ascending from 0: energies whose exceedance is counted


class Objects(NamedTuple):
    """Objects that cover cells of the chunk, cell by cell; each has a number."""

    offset: NDArray[np.int64]  # (n_cells + 1,)
    number: NDArray[np.int64]


class Disks(NamedTuple):
    """Disks around the centres of cells, which paths may meet."""

    under: Objects  # the disks that meet each cell of the chunk
    u: NDArray[np.float64]  # (n,) centres: columns and rows of the grid, in cells
    v: NDArray[np.float64]
    radius2: float  # in cells, squared


class Exceedance(NamedTuple):
    """Blocks that came to each place (cell or object) with at least the energy of a threshold.

    While they are counted: by how much the number at a threshold exceeds that at the next one. So a
    block is one entry.
    """

    blocks: NDArray[np.int64]  # (n, thresholds)
    square: NDArray[np.int64]  # sum over strata of the square of the stratum's number of blocks


def counted(sums: Exceedance) -> Exceedance:
    """The numbers themselves, where all blocks are counted."""
    return Exceedance(*(np.cumsum(own[:, ::-1], axis=1)[:, ::-1] for own in sums))


class CellSums(NamedTuple):
    """Statistics per cell of a chunk, one entry per block and cell: the table's sums by kind.

    Whole numbers, so that the order of adding does not matter.
    """

    stops: NDArray[np.int64]  # (n,)
    total: NDArray[np.int64]  # (n, sums)
    largest: NDArray[np.float64]  # (n, maxima)
    smallest: NDArray[np.float64]  # (n, minima)
    counts: NDArray[np.uint32]  # (n, bins of all histograms, one after the other)


class Visits(NamedTuple):
    """What blocks left in cells, until it is added to the histograms.

    A histogram takes kilobytes: cell by cell, each is fetched once for many blocks.
    """

    cell: NDArray[np.int32]  # (room,)
    column: NDArray[np.uint16]  # (room, histograms): position in CellSums.counts
    n: NDArray[np.int64]  # (1,) how many there are
    start: NDArray[np.int32]  # (n_cells + 1,) working space
    order: NDArray[np.int32]  # (room,) working space


class LineTally(NamedTuple):
    """Blocks of one stratum by place and highest threshold that they reach; cleared after each."""

    hits: NDArray[np.uint32]  # (n, thresholds)
    came: NDArray[np.bool_]
    touched: NDArray[np.int64]  # places in the order in which they were first reached


# Visits that are added to the histograms together.
_VISITS = 2**18


def empty_visits(n_cells: int) -> Visits:
    """Room for visits of some cells."""
    return Visits(
        np.empty(_VISITS, np.int32), np.empty((_VISITS, len(_BINNED)), np.uint16),
        np.zeros(1, np.int64), np.zeros(n_cells + 1, np.int32), np.empty(_VISITS, np.int32),
    )  # fmt: skip


class PlaceWork(NamedTuple):
    """Working space for disks or objects."""

    tally: LineTally
    peak: NDArray[np.float64]  # largest energy of the block there (J), -1 where it has not been
    met: NDArray[np.int64]
    n_met: NDArray[np.int64]  # (1,)


def place_work(reach: Exceedance) -> PlaceWork:
    """Working space for the places of some sums."""
    n = reach.blocks.shape[0]
    return PlaceWork(
        empty_tally(reach), np.full(n, -1.0), np.zeros(n, np.int64), np.zeros(1, np.int64)
    )


def flat_bins(bins: Bins) -> FlatBins:
    """The edges as the kernel takes them."""
    edges = [bins.edges[s.name] for s in sums_by("histogram")]
    first = np.cumsum([0, *(e.size for e in edges)]).astype(np.int64)
    return FlatBins(np.concatenate(edges), first, bins.threshold)


def empty_sums(n_cells: int, bins: FlatBins) -> CellSums:
    """Sums for ``n_cells`` cells to which nothing has come yet."""
    n_bins = bins.edges.size - len(_BINNED)
    return CellSums(
        stops=np.zeros(n_cells, np.int64),
        total=np.zeros((n_cells, len(_SUMMED)), np.int64),
        largest=np.zeros((n_cells, len(_RAISED))),
        smallest=np.full((n_cells, len(_LOWERED)), np.inf),
        counts=np.zeros((n_cells, n_bins), np.uint32),
    )


def by_name(sums: CellSums, reach: Exceedance, bins: FlatBins) -> dict[str, NDArray[np.generic]]:
    """The sums under their names in the table."""
    out: dict[str, NDArray[np.generic]] = {
        "reach": reach.blocks[:, 0], "reach_square": reach.square[:, 0], "stops": sums.stops,
    }  # fmt: skip
    out |= {s.name: sums.total[:, i] for i, s in enumerate(sums_by("sum"))}
    out |= {s.name: sums.largest[:, i] for i, s in enumerate(sums_by("max"))}
    out |= {s.name: sums.smallest[:, i] for i, s in enumerate(sums_by("min"))}
    for i, s in enumerate(sums_by("histogram")):
        # A histogram has one bin less than edges.
        out[s.name] = sums.counts[:, bins.first[i] - i : bins.first[i + 1] - i - 1]
    return out


@lean
def _hunt(edges: FloatArray, value: float, near: int) -> int:
    """The bin that holds a value, looking from one near it; the end bins take what lies beyond."""
    n = edges.size - 1
    i = near
    while i < n - 1 and value >= edges[i + 1]:
        i += 1
    while i > 0 and value < edges[i]:
        i -= 1
    return i


@lean
def _tally(tally: LineTally, n_line: int, place: int, level: int) -> int:
    """Count a block of the line at a place; returns the number of places that the line touched."""
    if not tally.came[place]:
        tally.came[place] = True
        tally.touched[n_line] = place
        n_line += 1
    tally.hits[place, level] += np.uint32(1)
    return n_line


def empty_tally(sums: Exceedance) -> LineTally:
    """A tally for the places of some sums."""
    n, n_levels = sums.blocks.shape
    return LineTally(
        np.zeros((n, n_levels), np.uint32), np.zeros(n, np.bool_), np.zeros(n, np.int64)
    )


@lean
def close_line(tally: LineTally, n_line: int, sums: Exceedance) -> None:
    """Add a line's blocks to the sums and clear its tally."""
    last = tally.hits.shape[1] - 1
    for k in range(n_line):
        place = tally.touched[k]
        above = np.int64(0)
        for i in range(last, -1, -1):
            hits = np.int64(tally.hits[place, i])
            if hits == 0:
                continue
            tally.hits[place, i] = np.uint32(0)
            blocks = above + hits
            sums.blocks[place, i] += hits
            sums.square[place, i] += blocks * blocks - above * above
            above = blocks
        tally.came[place] = False


@lean
def worth_of_line(
    tally: LineTally,
    n_line: int,
    cell: IntArray,
    worth: NDArray[np.float32],
    energy: IntArray,
    n_blocks: int,
) -> float:
    """What the blocks of a line leave open, by what it is worth to know it.

    Sum over places and energies of worth · k (n - k)/(n - 1), k of the n blocks having come there
    with the energy: worth times the variance of k.

    Parameters
    ----------
    cell : int64
        Flat index of the cell of each place.
    worth, energy
        As in model.map_run.Worth.
    """
    total = 0.0
    for i in range(n_line):
        place = tally.touched[i]
        own = worth[cell[place]]
        level = tally.hits.shape[1] - 1
        came = np.int64(0)
        for j in range(energy.size - 1, -1, -1):
            while level >= energy[j]:
                came += np.int64(tally.hits[place, level])
                level -= 1
            total += own[j] * came * (n_blocks - came)
    return total / max(n_blocks - 1, 1)


@lean
def _meet(own: PlaceWork, number: int, joule: float) -> None:
    """Raise the energy of a block at a place."""
    if own.peak[number] < 0.0:
        own.met[own.n_met[0]] = number
        own.n_met[0] += 1
    own.peak[number] = max(own.peak[number], joule)


@lean
def meet_objects(
    work: CellWork, n_touched: int, mass: float, objects: Objects, own: PlaceWork
) -> None:
    """Note the largest energy of a block on the objects whose cells it touched."""
    for k in range(n_touched):
        cell = work.touched[k]
        joule = work.peak[cell, ENERGY] * mass
        for m in range(objects.offset[cell], objects.offset[cell + 1]):
            _meet(own, objects.number[m], joule)


@lean
def meet_disks(work: CellWork, n_touched: int, mass: float, disks: Disks, own: PlaceWork) -> None:
    """Note the largest energy of a block in the disks that its path meets.

    In each cell the path is taken as straight (recording._pass); the energy is the largest there.
    """
    # Whatever the rounding: a path along the edge of a disk meets it, one that ends there does not,
    # or else what a block does in the next cell would count.
    beside = disks.radius2 * (1.0 + 1e-9)
    at_end = disks.radius2 * (1.0 - 1e-9)
    for k in range(n_touched):
        cell = work.touched[k]
        joule = work.peak[cell, ENERGY] * mass
        chord = work.chord[cell]
        du = chord[2] - chord[0]
        dv = chord[3] - chord[1]
        length2 = du * du + dv * dv
        per_length2 = 1.0 / length2 if length2 > 0.0 else 0.0
        for m in range(disks.under.offset[cell], disks.under.offset[cell + 1]):
            number = disks.under.number[m]
            if joule <= own.peak[number]:
                continue
            u = disks.u[number] - chord[0]
            v = disks.v[number] - chord[1]
            foot = (u * du + v * dv) * per_length2
            share = min(max(foot, 0.0), 1.0)
            u -= share * du
            v -= share * dv
            if u * u + v * v <= (beside if share == foot else at_end):
                _meet(own, number, joule)


@lean
def count_places(own: PlaceWork, threshold: FloatArray, n_line: int) -> int:
    """Count a block at all places that it met; returns the number that its line has touched."""
    near = 0
    for k in range(own.n_met[0]):
        number = own.met[k]
        near = _level(threshold, 1e-3 * own.peak[number], near)
        n_line = _tally(own.tally, n_line, number, near)
        own.peak[number] = -1.0
    own.n_met[0] = 0
    return n_line


@lean
def _level(threshold: FloatArray, value: float, near: int) -> int:
    """The highest threshold that a value reaches, looking from one near it."""
    i = near
    while i < threshold.size - 1 and value >= threshold[i + 1]:
        i += 1
    while i > 0 and value < threshold[i]:
        i -= 1
    return i


@lean
def flush(
    work: CellWork,
    n_touched: int,
    sums: CellSums,
    bins: FlatBins,
    mass: float,
    visits: Visits,
    tally: LineTally,
    n_line: int,
) -> int:
    """Add one block's cells to the sums; returns the number of cells that its line has touched."""
    level = 0
    for k in range(n_touched):
        cell = work.touched[k]
        record = work.peak[cell]
        joule = record[ENERGY] * mass
        record[ENERGY] = 1e-3 * joule
        record[SPEED2] = math.sqrt(record[SPEED2])
        thousandth = (joule, 1e3 * record[HEIGHT], 1e3 * record[SPEED2], 1e3 * record[ARRIVAL])
        for i in range(len(_SUMMED)):
            sums.total[cell, i] += np.int64(thousandth[_SUMMED[i]] + 0.5)
        for i in range(len(_RAISED)):
            sums.largest[cell, i] = max(sums.largest[cell, i], record[_RAISED[i]])
        for i in range(len(_LOWERED)):
            sums.smallest[cell, i] = min(sums.smallest[cell, i], record[_LOWERED[i]])
        level = _level(bins.threshold, record[ENERGY], level)
        n_line = _tally(tally, n_line, cell, level)
    done = 0
    while done < n_touched:
        if visits.n[0] == visits.cell.size:
            add_visits(visits, sums)
        n = min(n_touched - done, visits.cell.size - visits.n[0])
        _note_visits(work, done, n, bins, visits)
        done += n
    for k in range(n_touched):
        work.peak[work.touched[k], ENERGY] = -1.0
    return n_line


@lean
def _note_visits(work: CellWork, first: int, n: int, bins: FlatBins, visits: Visits) -> None:
    """Note ``n`` of a block's cells, from number ``first`` on."""
    begin = visits.n[0]
    for k in range(n):
        visits.cell[begin + k] = work.touched[first + k]
    for i in range(len(_BINNED)):
        # A histogram has one bin less than edges.
        base = bins.first[i] - i
        edges = bins.edges[bins.first[i] : bins.first[i + 1]]
        near = 0
        for k in range(n):
            near = _hunt(edges, work.peak[work.touched[first + k], _BINNED[i]], near)
            visits.column[begin + k, i] = base + near
    visits.n[0] = begin + n


@lean
def add_visits(visits: Visits, sums: CellSums) -> None:
    """Add the visits to the histograms, cell by cell, and clear them."""
    n = visits.n[0]
    start = visits.start
    start[:] = 0
    for k in range(n):
        start[visits.cell[k] + 1] += 1
    for cell in range(1, start.size):
        start[cell] += start[cell - 1]
    for k in range(n):
        cell = visits.cell[k]
        visits.order[start[cell]] = k
        start[cell] += 1
    for m in range(n):
        k = visits.order[m]
        cell = visits.cell[k]
        for i in range(len(_BINNED)):
            sums.counts[cell, visits.column[k, i]] += np.uint32(1)
    visits.n[0] = 0


class Event(NamedTuple):
    """What a block and all that it spawned did in each cell, as one block of 1 kg."""

    peak: NDArray[np.float64]  # (n_cells, N_RECORDED), energy -1 where none has been
    touched: NDArray[np.int64]
    filled: NDArray[np.int64]  # (1,)


def empty_event(n_cells: int) -> Event:
    """Room for what a block and those that it spawns do in some cells."""
    return Event(
        np.full((n_cells, N_RECORDED), -1.0), np.zeros(n_cells, np.int64), np.zeros(1, np.int64)
    )


@lean
def collect(event: Event, work: CellWork, n_touched: int, mass: float) -> None:
    """Move the cells of one block to those of the event."""
    for k in range(n_touched):
        cell = work.touched[k]
        joule = work.peak[cell, ENERGY] * mass
        if event.peak[cell, ENERGY] < 0.0:
            event.touched[event.filled[0]] = cell
            event.filled[0] += 1
            event.peak[cell, HEIGHT] = 0.0
            event.peak[cell, SPEED2] = 0.0
            event.peak[cell, ARRIVAL] = np.inf
        event.peak[cell, ENERGY] = max(event.peak[cell, ENERGY], joule)
        event.peak[cell, HEIGHT] = max(event.peak[cell, HEIGHT], work.peak[cell, HEIGHT])
        event.peak[cell, SPEED2] = max(event.peak[cell, SPEED2], work.peak[cell, SPEED2])
        event.peak[cell, ARRIVAL] = min(event.peak[cell, ARRIVAL], work.peak[cell, ARRIVAL])
        work.peak[cell, ENERGY] = -1.0


@lean
def give_back(event: Event, work: CellWork) -> int:
    """Move the cells of the event to the work, as of one block of 1 kg; returns their number."""
    n = event.filled[0]
    for k in range(n):
        cell = event.touched[k]
        work.touched[k] = cell
        for i in range(N_RECORDED):
            work.peak[cell, i] = event.peak[cell, i]
        event.peak[cell, ENERGY] = -1.0
    event.filled[0] = 0
    return int(n)
