"""Sums per cell, window and object, and how one block is added to them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.recording import CellWork
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel


class Bins(NamedTuple):
    """Edges of the histograms; what lies beyond goes into the first or last bin."""

    energy: NDArray[np.float64]  # kJ
    height: NDArray[np.float64]  # m
    speed: NDArray[np.float64]  # m/s
    threshold: NDArray[np.float64]  # kJ, ascending from 0: energies whose exceedance is counted


class Objects(NamedTuple):
    """Objects that cover cells of the chunk, cell by cell; an object is told by its number."""

    offset: NDArray[np.int64]  # (n_cells + 1,)
    number: NDArray[np.int64]


class Exceedance(NamedTuple):
    """Rocks that came to each place (cell or object) with at least the energy of a threshold."""

    rocks: NDArray[np.int64]  # (n, thresholds)
    square: NDArray[np.int64]  # sum over strata of the square of the stratum's number of rocks


class CellSums(NamedTuple):
    """Statistics per cell of a chunk, one entry per rock and cell.

    Whole numbers, so that the order of adding does not matter.
    """

    tally: NDArray[np.int64]  # (n, 2): energy (J); stops
    peak: NDArray[np.float64]  # (n, 3): largest energy (kJ), height (m), speed (m/s)
    energy: NDArray[np.uint32]  # (n, bins)
    height: NDArray[np.uint32]
    speed: NDArray[np.uint32]


class LineTally(NamedTuple):
    """Rocks of one stratum by place and highest threshold that they reach; cleared after each."""

    hits: NDArray[np.uint32]  # (n, thresholds)
    came: NDArray[np.bool_]
    touched: NDArray[np.int64]  # places in the order in which they were first reached


@kernel
def _hunt(edges: FloatArray, value: float, near: int) -> int:
    """The bin that holds a value, looking from one near it; the end bins take what lies beyond."""
    n = edges.size - 1
    i = near
    while i < n - 1 and value >= edges[i + 1]:
        i += 1
    while i > 0 and value < edges[i]:
        i -= 1
    return i


@kernel
def _tally(tally: LineTally, n_line: int, place: int, level: int) -> int:
    """Count a rock of the line at a place; returns the number of places that the line touched."""
    if not tally.came[place]:
        tally.came[place] = True
        tally.touched[n_line] = place
        n_line += 1
    tally.hits[place, level] += np.uint32(1)
    return n_line


def empty_tally(sums: Exceedance) -> LineTally:
    """A tally for the places of some sums."""
    n, n_levels = sums.rocks.shape
    return LineTally(
        np.zeros((n, n_levels), np.uint32), np.zeros(n, np.bool_), np.zeros(n, np.int64)
    )


@kernel
def close_line(tally: LineTally, n_line: int, sums: Exceedance) -> None:
    """Add a line's rocks to the sums and clear its tally."""
    last = tally.hits.shape[1] - 1
    for k in range(n_line):
        place = tally.touched[k]
        rocks = np.int64(0)
        for i in range(last, -1, -1):
            rocks += np.int64(tally.hits[place, i])
            tally.hits[place, i] = np.uint32(0)
            sums.rocks[place, i] += rocks
            sums.square[place, i] += rocks * rocks
        tally.came[place] = False


@kernel
def at_objects(
    work: CellWork,
    n_touched: int,
    mass: float,
    threshold: FloatArray,
    objects: Objects,
    peak: FloatArray,
    met: IntArray,
    tally: LineTally,
    n_line: int,
) -> int:
    """Count one rock at the objects whose cells it touched, with its largest energy there.

    ``peak`` is -1 for all objects before and after; ``met`` is working space.
    """
    n_met = 0
    for k in range(n_touched):
        cell = work.touched[k]
        for m in range(objects.offset[cell], objects.offset[cell + 1]):
            number = objects.number[m]
            if peak[number] < 0.0:
                met[n_met] = number
                n_met += 1
            peak[number] = max(peak[number], work.peak[cell, 0])
    near = 0
    for k in range(n_met):
        number = met[k]
        near = _level(threshold, 1e-3 * (peak[number] * mass), near)
        n_line = _tally(tally, n_line, number, near)
        peak[number] = -1.0
    return n_line


@kernel
def _level(threshold: FloatArray, value: float, near: int) -> int:
    """The highest threshold that a value reaches, looking from one near it."""
    i = near
    while i < threshold.size - 1 and value >= threshold[i + 1]:
        i += 1
    while i > 0 and value < threshold[i]:
        i -= 1
    return i


@kernel
def flush(
    work: CellWork,
    n_touched: int,
    sums: CellSums,
    bins: Bins,
    mass: float,
    tally: LineTally,
    n_line: int,
) -> int:
    """Add one rock's cells to the sums; returns the number of cells that its line has touched."""
    ie = 0
    ih = 0
    iv = 0
    level = 0
    for k in range(n_touched):
        cell = work.touched[k]
        joule = work.peak[cell, 0] * mass
        kj = 1e-3 * joule
        height = work.peak[cell, 1]
        speed = math.sqrt(work.peak[cell, 2])
        ie = _hunt(bins.energy, kj, ie)
        ih = _hunt(bins.height, height, ih)
        iv = _hunt(bins.speed, speed, iv)
        level = _level(bins.threshold, kj, level)
        sums.energy[cell, ie] += np.uint32(1)
        sums.height[cell, ih] += np.uint32(1)
        sums.speed[cell, iv] += np.uint32(1)
        sums.tally[cell, 0] += np.int64(joule + 0.5)
        sums.peak[cell, 0] = max(sums.peak[cell, 0], kj)
        sums.peak[cell, 1] = max(sums.peak[cell, 1], height)
        sums.peak[cell, 2] = max(sums.peak[cell, 2], speed)
        n_line = _tally(tally, n_line, cell, level)
        work.peak[cell, 0] = -1.0
    return n_line


class Event(NamedTuple):
    """Maxima of a rock and all its pieces in each cell: energy (J), height, speed squared."""

    peak: NDArray[np.float64]  # (n_cells, 3), energy -1 where none has been
    touched: NDArray[np.int64]
    filled: NDArray[np.int64]  # (1,)


@kernel
def collect(event: Event, work: CellWork, n_touched: int, mass: float) -> None:
    """Move the cells of one block to those of the event."""
    for k in range(n_touched):
        cell = work.touched[k]
        joule = work.peak[cell, 0] * mass
        if event.peak[cell, 0] < 0.0:
            event.touched[event.filled[0]] = cell
            event.filled[0] += 1
            event.peak[cell, 1] = 0.0
            event.peak[cell, 2] = 0.0
        event.peak[cell, 0] = max(event.peak[cell, 0], joule)
        event.peak[cell, 1] = max(event.peak[cell, 1], work.peak[cell, 1])
        event.peak[cell, 2] = max(event.peak[cell, 2], work.peak[cell, 2])
        work.peak[cell, 0] = -1.0


@kernel
def give_back(event: Event, work: CellWork) -> int:
    """Move the cells of the event to the work, as of one block of 1 kg; returns their number."""
    n = event.filled[0]
    for k in range(n):
        cell = event.touched[k]
        work.touched[k] = cell
        for i in range(3):
            work.peak[cell, i] = event.peak[cell, i]
        event.peak[cell, 0] = -1.0
    event.filled[0] = 0
    return int(n)
