"""The kernel: all blocks of a few fall lines."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.draws import draw_block
from sassgis.engine.effects.state import (
    BORN_A,
    BORN_B,
    BORN_C,
    BORN_MASS,
    Effects,
    Spawned,
)
from sassgis.engine.profile import cut, last_cell, without_straight_vertices
from sassgis.engine.recording import Pieces, empty_work
from sassgis.engine.rock import BARRIER, REST, follow
from sassgis.engine.state import Block, ControlLines, Course, Physics, Profile
from sassgis.engine.statistics import (
    CellSums,
    Exceedance,
    FlatBins,
    Objects,
    at_objects,
    close_line,
    collect,
    empty_event,
    empty_tally,
    flush,
    give_back,
)
from sassgis.model import rng
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel

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
    bins: FlatBins,
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
    bins : FlatBins
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
    n_cells = sums.stops.size
    work = empty_work(n_cells)
    tally = empty_tally(reach)
    window_tally = empty_tally(window_reach)
    window_peak = np.full(window_reach.rocks.shape[0], -1.0)
    object_tally = empty_tally(object_reach)
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
    event = empty_event(n_cells if effects is not None else 0)
    for i in range(n_lines):
        v0 = lines.offset[i]
        v1 = lines.offset[i + 1]
        sx, sz, ground = without_straight_vertices(
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
        n_pieces = cut(
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
            last = last_cell(pieces, sx, reason, x, start)
            if last >= 0 and reason in (REST, BARRIER):
                sums.stops[last] += 1
            _fill_row(
                rocks[row_number], block, density, start, reason, x, z, furthest, t, impacts,
                top_speed, top_height, top_energy,
            )  # fmt: skip
            row_number += 1
            mass = block.mass
            if effects is not None and spawned is not None:
                collect(event, work, n_touched, block.mass)
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
                    collect(event, work, n_touched, part.mass)
                    last = last_cell(pieces, sx, reason, x, birth[0])
                    if last >= 0 and reason in (REST, BARRIER):
                        sums.stops[last] += 1
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
                n_touched = give_back(event, work)
                mass = 1.0
            if window_peak.size:
                n_line_windows = at_objects(
                    work, n_touched, mass, bins.threshold, windows, window_peak, met,
                    window_tally, n_line_windows,
                )  # fmt: skip
            if object_peak.size:
                n_line_objects = at_objects(
                    work, n_touched, mass, bins.threshold, objects, object_peak, met,
                    object_tally, n_line_objects,
                )  # fmt: skip
            n_line = flush(work, n_touched, sums, bins, mass, tally, n_line)
        if i == n_lines - 1 or lines.stratum[i + 1] != lines.stratum[i]:
            close_line(tally, n_line, reach)
            close_line(window_tally, n_line_windows, window_reach)
            close_line(object_tally, n_line_objects, object_reach)
            n_line = 0
            n_line_windows = 0
            n_line_objects = 0
    return n_passages, n_born
