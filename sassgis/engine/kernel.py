"""The kernel: all rocks of a few lines, with the statistics of the cells they pass."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.effects.state import (
    BORN_A,
    BORN_B,
    BORN_C,
    BORN_MASS,
    Effects,
    Spawned,
)
from sassgis.engine.recording import CellWork, Pieces
from sassgis.engine.rock import BARRIER, REST, follow
from sassgis.engine.state import Block, ControlLines, Course, Physics, Profile
from sassgis.model import rng
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel

# A vertex nearer than this to the line between its neighbours is none (m).
_STRAIGHT_M = 1e-9
#: Columns of a rock's row; the fields of core.results.ROCK_DTYPE after "line", "rock" and "piece".
ROCK_COLUMNS = 15
#: Columns of the row of a piece: line, rock, piece, then those of a rock.
PIECE_COLUMNS = ROCK_COLUMNS + 3
#: In place of a number of pieces: rows for passages or pieces were too few; one rock had more
#: pieces and blocks set in motion than there is room for.
NO_ROOM, TOO_MANY_SPAWNED = -1, -2
#: Columns of a passage's row: line, rock, then those of rock._passage.
PASSAGE_COLUMNS = 13


class Lines(NamedTuple):
    """Profiles of a chunk, as in core.profiles.ProfileSet; ``cell`` counts the chunk's cells."""

    offset: NDArray[np.int64]
    s: NDArray[np.float64]
    z: NDArray[np.float64]
    ground: NDArray[np.int32]
    cell_offset: NDArray[np.int64]
    cell_s: NDArray[np.float64]
    cell: NDArray[np.int64]
    number: NDArray[np.int64]  # of the line in the run
    key: NDArray[np.uint64]  # identity of the line for random draws
    stratum: NDArray[np.int64]  # (n,) of the sample; lines of one stratum follow each other
    start: NDArray[np.float64]  # (n, 2) limits of the starting chainage
    control_line_offset: NDArray[np.int64]
    control_line_x: NDArray[np.float64]
    control_line: NDArray[np.int64]


class ControlLineTable(NamedTuple):
    """Stations and barriers of the run."""

    kind: NDArray[np.int64]
    height: NDArray[np.float64]
    capacity: NDArray[np.float64]  # J


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
def _draw_volume(key: np.uint64, low: float, high: float, exponent: float) -> float:
    """Draw a volume: N(V > v) falls as v^-exponent between the limits; NaN: all equally likely."""
    u = rng.uniform(key, rng.VOLUME, 0)
    if high <= low:
        return low
    if math.isnan(exponent):
        return low + (high - low) * u
    span = math.log(high / low)
    # The share of the law's mass below v is expm1(-b log(v/low)) / expm1(-b span).
    if abs(exponent) * span < 1e-9:
        return low * math.exp(u * span)
    return low * math.exp(-math.log1p(u * math.expm1(-exponent * span)) / exponent)


@kernel
def draw_block(limits: FloatArray, key: np.uint64) -> tuple[Block, float]:
    """Draw one rock between limits (core.blocks.BlockPopulation.array).

    The three semi-axes are drawn and sorted; the two longer ones lie in the plane of motion, so
    that the spin is about the shortest, and the third sets the mass. Where the volume is drawn as
    well, the axes give the shape only.
    """
    p = rng.between(key, rng.AXIS_1, 0, limits[0, 0], limits[0, 1])
    q = rng.between(key, rng.AXIS_2, 0, limits[1, 0], limits[1, 1])
    r = rng.between(key, rng.AXIS_3, 0, limits[2, 0], limits[2, 1])
    if limits[8, 1] > 0.0:
        volume = _draw_volume(key, limits[8, 0], limits[8, 1], limits[9, 0])
        scale = (volume / (4.0 / 3.0 * math.pi * p * q * r)) ** (1.0 / 3.0)
        p *= scale
        q *= scale
        r *= scale
    a = max(p, q, r)
    c = min(p, q, r)
    b = p + q + r - a - c
    b = min(max(b, c), a)
    density = rng.between(key, rng.DENSITY, 0, limits[3, 0], limits[3, 1])
    mass = 4.0 / 3.0 * math.pi * a * b * c * density
    return Block(a, b, c, mass, key), density


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


@kernel
def _empty_tally(sums: Exceedance) -> LineTally:
    """A tally for the places of some sums."""
    n, n_levels = sums.rocks.shape
    return LineTally(
        np.zeros((n, n_levels), np.uint32), np.zeros(n, np.bool_), np.zeros(n, np.int64)
    )


@kernel
def _close_line(tally: LineTally, n_line: int, sums: Exceedance) -> None:
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
def _at_objects(
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
def _flush(
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


@kernel
def _cut(
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
def _without_straight_vertices(
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


class Event(NamedTuple):
    """Maxima of a rock and all its pieces in each cell: energy (J), height, speed squared."""

    peak: NDArray[np.float64]  # (n_cells, 3), energy -1 where none has been
    touched: NDArray[np.int64]
    filled: NDArray[np.int64]  # (1,)


@kernel
def _collect(event: Event, work: CellWork, n_touched: int, mass: float) -> None:
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
def _give_back(event: Event, work: CellWork) -> int:
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


@kernel
def _last_cell(pieces: Pieces, sx: FloatArray, reason: int, x: float, start: float) -> int:
    """Cell in which a rock ends; -1 outside."""
    if x < sx[0] or x > sx[sx.size - 1]:
        return -1
    # A rock that a wall holds lies in front of it, also on the border of a cell.
    k = int(np.searchsorted(pieces.border, x, side="right")) - 1
    if reason == BARRIER and k > 0 and pieces.border[k] >= x > start:
        k -= 1
    return int(pieces.cell[min(max(k, 0), pieces.cell.size - 1)])


@kernel
def _fill_row(
    row: FloatArray,
    block: Block,
    density: float,
    start: float,
    reason: int,
    x: float,
    z: float,
    furthest: float,
    t: float,
    impacts: int,
    top_speed: float,
    top_height: float,
    top_energy: float,
) -> None:
    """Write the row of a rock or piece."""
    row[0] = reason
    row[1] = start
    row[2] = x
    row[3] = z
    row[4] = furthest
    row[5] = t
    row[6] = impacts
    row[7] = block.a
    row[8] = block.b
    row[9] = block.c
    row[10] = density
    row[11] = block.mass
    row[12] = top_speed
    row[13] = top_height
    row[14] = 1e-3 * top_energy * block.mass


@kernel
def run_lines(
    lines: Lines,
    ground_table: FloatArray,
    limits: FloatArray,
    physics: Physics,
    control_line_table: ControlLineTable,
    bins: Bins,
    seed: int | np.uint64,
    first_rock: int,
    n_rocks: int,
    sums: CellSums,
    reach: Exceedance,
    windows: Objects,
    window_reach: Exceedance,
    objects: Objects,
    object_reach: Exceedance,
    rocks: FloatArray,
    passages: FloatArray,
    events: FloatArray,
    event_counts: IntArray,
    effects: Effects | None,
    spawned: Spawned | None,
    piece_rows: FloatArray,
) -> tuple[int, int]:
    """Follow ``n_rocks`` rocks on each line.

    Parameters
    ----------
    lines : Lines
    ground_table : float64, shape (n_classes, 7)
        core.ground.GroundTable.array.
    limits : float64, shape (1, 10, 2) or (n_lines, 10, 2)
        core.blocks.BlockPopulation.array, of all lines or of each.
    physics : Physics
    gate_table : GateTable
    bins : Bins
    seed : uint64
    first_rock, n_rocks : int
        Numbers of the rocks on each line.
    sums, reach : CellSums, Exceedance
        Of the cells; added to.
    windows : Objects
    window_reach : Exceedance
        Of windows of several cells; added to.
    objects : Objects
    object_reach : Exceedance
        Of the objects; added to.
    rocks : float64, shape (n_lines * n_rocks, ROCK_COLUMNS)
        Filled.
    passages : float64, shape (enough, PASSAGE_COLUMNS)
        Filled from the top.
    events : float64, shape (n_lines * n_rocks, n_events, 11)
        Course of each rock; n_events may be 0.
    event_counts : int64, shape (n_lines * n_rocks,)
    effects, births
        None for the model of 1986 alone.
    piece_rows : float64, shape (room, PIECE_COLUMNS)
        Filled from the top.

    Returns
    -------
    n_passages, n_born : int
        Rows of ``passages`` and ``piece_rows`` that there are. NO_ROOM or TOO_MANY_BIRTHS in place
        of the second: then nothing that was filled is of use.
    """
    n_lines = lines.number.size
    n_cells = sums.tally.shape[0]
    work = CellWork(np.full((n_cells, 4), -1.0), np.zeros(n_cells, np.int64))
    tally = _empty_tally(reach)
    window_tally = _empty_tally(window_reach)
    window_peak = np.full(window_reach.rocks.shape[0], -1.0)
    object_tally = _empty_tally(object_reach)
    object_peak = np.full(object_reach.rocks.shape[0], -1.0)
    met = np.zeros(max(window_peak.size, object_peak.size), np.int64)
    most = 1
    for i in range(n_lines):
        size = (
            lines.offset[i + 1] - lines.offset[i] + lines.cell_offset[i + 1] - lines.cell_offset[i]
        )
        most = max(most, size + 2)
    border = np.zeros(most)
    piece_cell = np.zeros(most, np.int64)
    piece_segment = np.zeros(most, np.int64)
    count = np.zeros(1, np.int64)
    n_passages = 0
    n_born = 0
    row_number = 0
    n_line = int(np.int64(0))
    n_line_windows = int(np.int64(0))
    n_line_objects = int(np.int64(0))
    no_birth = np.empty(0)
    n_event = n_cells if effects is not None else 0
    event = Event(np.full((n_event, 3), -1.0), np.zeros(n_event, np.int64), np.zeros(1, np.int64))
    for i in range(n_lines):
        v0 = lines.offset[i]
        v1 = lines.offset[i + 1]
        sx, sz, ground = _without_straight_vertices(
            lines.s[v0:v1], lines.z[v0:v1], lines.ground[v0:v1]
        )
        n = sx.size - 1
        tx = np.empty(n)
        tz = np.empty(n)
        length = np.empty(n)
        angle = np.empty(n)
        for j in range(n):
            dx = sx[j + 1] - sx[j]
            dz = sz[j + 1] - sz[j]
            length[j] = math.sqrt(dx * dx + dz * dz)
            tx[j] = dx / length[j]
            tz[j] = dz / length[j]
            angle[j] = math.atan2(dz, dx)
        profile = Profile(sx, sz, tx, tz, length, angle, ground)
        c0 = lines.cell_offset[i]
        c1 = lines.cell_offset[i + 1]
        n_pieces = _cut(
            lines.cell_s[c0 + i : c1 + i + 1], lines.cell[c0:c1], sx, border, piece_cell,
            piece_segment,
        )  # fmt: skip
        pieces = Pieces(border[: n_pieces + 1], piece_cell[:n_pieces], piece_segment[:n_pieces])
        g0 = lines.control_line_offset[i]
        g1 = lines.control_line_offset[i + 1]
        control_line = lines.control_line[g0:g1]
        control_line_z = np.empty(g1 - g0)
        for k in range(g1 - g0):
            gx = lines.control_line_x[g0 + k]
            j = min(max(np.searchsorted(sx, gx, side="right") - 1, 0), n - 1)
            control_line_z[k] = sz[j] + (gx - sx[j]) * tz[j] / tx[j]
        control_lines = ControlLines(
            lines.control_line_x[g0:g1],
            control_line_z,
            control_line_table.kind[control_line],
            control_line_table.height[control_line],
            control_line_table.capacity[control_line],
            control_line,
        )
        seen = np.zeros(g1 - g0, np.bool_)
        own = limits[i if limits.shape[0] > 1 else 0]
        for r in range(n_rocks):
            rock = first_rock + r
            key = rng.rock_key(seed, lines.key[i], rock)
            block, density = draw_block(own, key)
            start = rng.between(key, rng.START, 0, lines.start[i, 0], lines.start[i, 1])
            speed = rng.between(key, rng.SPEED, 0, own[4, 0], own[4, 1])
            spin = rng.between(key, rng.SPIN, 0, own[5, 0], own[5, 1])
            drop = rng.between(key, rng.DROP, 0, own[6, 0], own[6, 1])
            orientation = rng.between(key, rng.ORIENTATION, 0, own[7, 0], own[7, 1])
            seen[:] = False
            count[0] = 0
            if effects is not None and n_passages + seen.size > passages.shape[0]:
                return n_passages, NO_ROOM
            course = Course(events[row_number], count)
            (
                reason,
                x,
                z,
                furthest,
                t,
                impacts,
                top_speed,
                top_height,
                top_energy,
                n_new,
                n_touched,
            ) = follow(
                block,
                profile,
                ground_table,
                physics,
                control_lines,
                seen,
                passages[n_passages:, 2:],
                pieces,
                work,
                course,
                start,
                speed,
                spin,
                drop,
                orientation,
                effects,
                no_birth,
                spawned,
            )
            event_counts[row_number] = count[0]
            for k in range(n_passages, n_passages + n_new):
                passages[k, 0] = lines.number[i]
                passages[k, 1] = rock
            n_passages += n_new
            last = _last_cell(pieces, sx, reason, x, start)
            if last >= 0 and reason in (REST, BARRIER):
                sums.tally[last, 1] += 1
            _fill_row(
                rocks[row_number], block, density, start, reason, x, z, furthest, t, impacts,
                top_speed, top_height, top_energy,
            )  # fmt: skip
            row_number += 1
            mass = block.mass
            if effects is not None and spawned is not None:
                _collect(event, work, n_touched, block.mass)
                born = 0
                while born < min(spawned.born[0], spawned.rows.shape[0]):
                    birth = spawned.rows[born]
                    born += 1
                    if n_passages + seen.size > passages.shape[0] or n_born >= piece_rows.shape[0]:
                        return n_passages, NO_ROOM
                    piece_key = rng.mix(key + np.uint64(born) * np.uint64(0x9E3779B97F4A7C15))
                    part = Block(
                        birth[BORN_A], birth[BORN_B], birth[BORN_C], birth[BORN_MASS], piece_key
                    )
                    seen[:] = False
                    count[0] = 0
                    (
                        reason, x, z, furthest, t, impacts, top_speed, top_height, top_energy,
                        n_new, n_touched,
                    ) = follow(
                        part, profile, ground_table, physics, control_lines, seen,
                        passages[n_passages:, 2:], pieces, work,
                        Course(events[0, :0], count), start, 0.0, 0.0, 0.0, 0.0, effects, birth,
                        spawned,
                    )  # fmt: skip
                    for k in range(n_passages, n_passages + n_new):
                        passages[k, 0] = lines.number[i]
                        passages[k, 1] = rock
                    n_passages += n_new
                    _collect(event, work, n_touched, part.mass)
                    last = _last_cell(pieces, sx, reason, x, birth[0])
                    if last >= 0 and reason in (REST, BARRIER):
                        sums.tally[last, 1] += 1
                    row = piece_rows[n_born]
                    row[0] = lines.number[i]
                    row[1] = rock
                    row[2] = born
                    _fill_row(
                        row[3:], part, density, birth[0], reason, x, z, furthest, t, impacts,
                        top_speed, top_height, top_energy,
                    )  # fmt: skip
                    n_born += 1
                if spawned.born[0] > spawned.rows.shape[0]:
                    return n_passages, TOO_MANY_SPAWNED
                spawned.born[0] = 0
                n_touched = _give_back(event, work)
                mass = 1.0
            if window_peak.size:
                n_line_windows = _at_objects(
                    work, n_touched, mass, bins.threshold, windows, window_peak, met,
                    window_tally, n_line_windows,
                )  # fmt: skip
            if object_peak.size:
                n_line_objects = _at_objects(
                    work, n_touched, mass, bins.threshold, objects, object_peak, met,
                    object_tally, n_line_objects,
                )  # fmt: skip
            n_line = _flush(work, n_touched, sums, bins, mass, tally, n_line)
        if i == n_lines - 1 or lines.stratum[i + 1] != lines.stratum[i]:
            _close_line(tally, n_line, reach)
            _close_line(window_tally, n_line_windows, window_reach)
            _close_line(object_tally, n_line_objects, object_reach)
            n_line = 0
            n_line_windows = 0
            n_line_objects = 0
    return n_passages, n_born
