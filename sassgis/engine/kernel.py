"""The kernel: all blocks of some lines or release points, added to the sums of the run."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled import rng
from sassgis.compiled.jit import fused, inlined, kernel, lean
from sassgis.engine import statistics
from sassgis.engine.barriers import ControlLineTable, crossings_of
from sassgis.engine.block import simulate_block, start_released, start_spawned
from sassgis.engine.cell_register import FULL
from sassgis.engine.draws import block_of, draw_block, with_drag, with_outline
from sassgis.engine.effects import hooks
from sassgis.engine.ellipse import CountedRows, Record, Records, empty_table
from sassgis.engine.fork import return_to_fork
from sassgis.engine.ground_ahead import Path, place, room_ahead, see_again
from sassgis.engine.heading import continue_path, start_path
from sassgis.engine.profile import last_stretch, profile_of, stretches_of, without_straight_vertices
from sassgis.engine.recording import CellWork, empty_work, record_stop
from sassgis.engine.state import (
    BARRIER,
    REST,
    SPAWNED_DTYPE,
    Block,
    Fork,
    Output,
    Physics,
    Site,
)
from sassgis.engine.statistics import BOTH, WITH, WITHOUT, Totals, Wanted
from sassgis.grid import FloatArray, IntArray
from sassgis.terrain.cells import exact

#: Result of simulate_strata: done, or what there was too little room for: rows of passages or
#: spawned blocks, cells of followed paths, visits, blocks spawned by a released one.
DONE, NO_ROOM, MANY_CELLS, MANY_VISITS, TOO_MANY_SPAWNED = range(5)

# Room for visits of each thread: _room_for_visits.
_KEPT = threading.local()


class Strata(NamedTuple):
    """Lines or release points; the blocks of each are a stratum of the sample."""

    number: IntArray  # in the run
    key: NDArray[np.uint64]  # identity for random draws
    # (n, 2): limits of the starting chainage (m), or where the followed paths begin: u, v (cells).
    start: FloatArray


class Lines(NamedTuple):
    """Profiles of a chunk, as in settings.results.ProfileSet; ``cell`` counts its cells."""

    offset: IntArray
    s: FloatArray
    z: FloatArray
    ground: NDArray[np.int32]
    cell_offset: IntArray
    cell_s: FloatArray
    cell: IntArray
    stems: FloatArray  # as cell: stems per m² there
    diameter: FloatArray  # as cell: of the stems at breast height (m)
    on_map: FloatArray  # (cell_s.size, 2) borders on the map: columns and rows, in cells
    control_line_offset: IntArray
    control_line_x: FloatArray
    control_line: IntArray


class Setup(NamedTuple):
    """Data common to the blocks of all lines."""

    grounds: Records  # ground_switch.GROUND_DTYPE
    limits: Records  # (1, 2) or (n_strata, 2), settings.blocks.LIMITS_DTYPE
    physics: Physics
    control_lines: ControlLineTable
    seed: np.uint64
    first_rock: int  # number of the first block of each stratum
    n_blocks: int  # of each stratum


class Rows(NamedTuple):
    """Rows of the run, which blocks fill."""

    # (n_blocks of all + 1,) settings.results.ROCK_DTYPE; the last is for blocks that are simulated
    # again, without barriers.
    rocks: Records
    passages: CountedRows  # settings.results.PASSAGE_DTYPE
    spawned: CountedRows  # ROCK_DTYPE
    ends: FloatArray  # as rocks, (n, 2): place of the end of a followed path (cells)
    spawned_ends: FloatArray  # the same of spawned blocks
    events: Records  # (n, n_events) state.EVENT_DTYPE; n_events may be 0
    event_counts: IntArray  # (n,)
    # Of the same blocks without barriers: reason of their end, (n_blocks of all,), empty where they
    # are not wanted; passages as above.
    reasons_without: NDArray[np.uint8]
    passages_without: CountedRows


class Work(NamedTuple):
    """Working space of a chunk."""

    state: Records  # hooks.BLOCK_DTYPE, one row
    cells: CellWork
    event: CellWork  # of a block and all that it spawned, as one block of 1 kg
    visits: NDArray[np.uint64]  # (room,)
    n_visits: IntArray  # (2,) of them; of those that are in histograms already
    spawned: CountedRows
    ahead: Site  # the ground just ahead, on a path that is followed
    fork: Fork


def _room_for_visits(n: int) -> NDArray[np.uint64]:
    """Return room for visits, kept by each thread: new memory would have to be cleared."""
    if getattr(_KEPT, "visits", np.empty(0)).size < n:
        _KEPT.visits = np.empty(n, np.uint64)
    own: NDArray[np.uint64] = _KEPT.visits
    return own[:n]


def working_space(
    n_cells: int, grounds: Records, has_effects: bool, most_spawned: int, visits: int,
    *, on_map: bool, followed: bool, compared: bool,
) -> Work:  # fmt: skip
    """Return working space for a chunk.

    ``most_spawned`` is how many blocks one released block may spawn, ``visits`` for how many of
    them to cells there is room; ``on_map`` is whether it is known where the paths lie on the map,
    ``followed`` whether they are followed, ``compared`` as for run_blocks.
    """
    # What effects remember of a step that a barrier cuts short is not kept.
    forks = compared and not has_effects
    return Work(
        np.zeros(1, hooks.BLOCK_DTYPE),
        empty_work(n_cells, chords=on_map),
        empty_work(n_cells if has_effects else 0, chords=False),
        _room_for_visits(visits),
        np.zeros(2, np.int64),
        empty_table(most_spawned, SPAWNED_DTYPE),
        room_ahead(grounds),
        Fork(
            np.zeros(int(forks), hooks.BLOCK_DTYPE),
            room_ahead(grounds, int(forks and followed)),
            empty_work(n_cells if forks else 0, chords=on_map),
        ),
    )


@kernel
def simulate_strata(
    strata: Strata, setup: Setup, totals: Totals, rows: Rows, work: Work,
    effects: hooks.Effects | None, lines: Lines | None, path: Path | None, wanted: Wanted | None,
) -> int:  # fmt: skip
    """Simulate all blocks of some lines or release points, with the blocks that they spawn.

    Parameters
    ----------
    totals, rows, work
        Added to, filled, and as working_space makes it.
    effects : Effects, optional
        None for the model of 1986 only.
    lines, path : optional
        Profiles on which the blocks stay, or the terrain over which their paths are followed: then
        the cells of the totals are those of its register.
    wanted : Wanted, optional
        Added to.

    Returns
    -------
    int
        DONE, or the reason why not; the filled rows are then invalid.
    """
    for i in range(strata.number.size):
        if lines is not None:
            site = site_of(i, lines, setup)
        else:
            site = work.ahead
        status = simulate_blocks(i, strata, site, setup, totals, rows, work, effects, path)
        if status != DONE:
            return status
        if wanted is not None:
            statistics.add_worth(totals.windows, wanted, i, setup.n_blocks)
        statistics.end_stratum(totals.reach, totals.changes.reach)
        statistics.end_stratum(totals.windows, totals.changes.windows)
        statistics.end_stratum(totals.objects, totals.changes.objects)
        visits_to_histograms(totals, work)
    return DONE


@kernel
def visits_to_histograms(totals: Totals, work: Work) -> None:
    """Add the visits where there are many."""
    n = work.n_visits
    if 2 * n[0] > work.visits.size:
        rows = np.arange(totals.stops.size).astype(np.int32)
        statistics.add_visits(
            statistics.by_cell(work.visits[: n[0]], rows.size), rows, totals.counts, 1
        )
        n[1] += n[0]
        n[0] = 0


@lean
def simulate_blocks(
    i: int, strata: Strata, site: Site, setup: Setup, totals: Totals, rows: Rows, work: Work,
    effects: hooks.Effects | None, path: Path | None,
) -> int:  # fmt: skip
    """Simulate all blocks of stratum ``i``; parameters and what it returns as simulate_strata.

    If wanted, a block whose motion a barrier has changed is simulated again without barriers: from
    that barrier on, or from the release where there are effects.
    """
    compared = rows.reasons_without.size > 0
    again = False
    r = 0
    while r < setup.n_blocks:
        first = rows.passages.n[0]
        state = work.state[0]
        if again and work.fork.state.size > 0:
            if not return_to_fork(
                work.state, site, work.cells, work.fork, rows.passages, rows.passages_without
            ):
                return NO_ROOM
            if path is not None:
                see_again(path, rows.passages_without, state.n_passages)
        state.meets_none = again
        state.hindered = False
        status = simulate_released(
            i, r, again, strata, site, setup, totals, rows, work, effects, path
        )  # fmt: skip
        if status != DONE:
            return status
        hindered = state.hindered
        if compared:
            number = i * setup.n_blocks + r
            rows.reasons_without[number] = rows.rocks[-1 if again else number].reason
            same = not (again or hindered)
            if same and not copied(rows.passages, first, rows.passages_without):
                return NO_ROOM
        again = compared and hindered
        r += 0 if again else 1
    return DONE


@lean
def simulate_released(
    i: int, r: int, again: bool, strata: Strata, site: Site, setup: Setup, totals: Totals,
    rows: Rows, work: Work, effects: hooks.Effects | None, path: Path | None,
) -> int:  # fmt: skip
    """Simulate block ``r`` of stratum ``i``, with those that it spawns; parameters as above.

    ``again``: without barriers, after it was simulated with them; from where it is if it resumes.
    """
    state = work.state[0]
    cells = work.cells
    spawned = work.spawned
    limits = setup.limits[i if setup.limits.shape[0] > 1 else 0]
    spread = setup.physics.rolling_friction_sd
    # The released block first, then those that it and they spawn, in turn.
    rock = setup.first_rock + r
    key = rng.block_key(setup.seed, strata.key[i], rock)
    # The released block is reported as it was drawn, a fragment as it moves.
    stated = draw_block(limits[0], limits[1], key)
    outlined = with_outline(stated, setup.physics)
    block = with_drag(hooks.on_block(effects, outlined), spread)
    number = i * setup.n_blocks + r
    if not state.resumed:
        release(effects, state, block, site, setup, limits, key, strata, path, i)
    first_x = rows.rocks[number].start_m if again else state.x
    passages, row, log, end_place = room_of(rows, number, again)
    open_row(row, strata.number[i], rock, 0, first_x)
    n_spawned = n_event = 0
    spawned.n[0] = 0
    while True:
        n = passages.n[0]
        n_lines = site.crossings.n[0] if path is None else path.line_seen.size
        if n + n_lines > passages.rows.size:
            return NO_ROOM
        output = Output(passages.rows[n:], cells, log, spawned, work.fork)
        simulate_block(state, block, site, output, setup.physics, effects, path)
        mass = block.mass
        last = finish_block(row, stated, state, site, passages, totals.stops, cells, 1 - int(again))
        n_touched = state.n_touched
        statistics.meet_disks(cells, n_touched, mass, totals)
        statistics.meet_objects(cells, n_touched, mass, totals)
        n_touched = statistics.passed_cells(cells, n_touched, last)
        if path is not None:
            end_place[0], end_place[1] = place(state, state.x)
            if path.register.counts[FULL]:
                return MANY_CELLS
        if effects is None:
            break
        n_event = statistics.collect(work.event, n_event, cells, n_touched, mass)
        if n_spawned >= min(spawned.n[0], spawned.rows.size):
            break
        if rows.spawned.n[0] >= rows.spawned.rows.size:
            return NO_ROOM
        leaving = spawned.rows[n_spawned]
        n_spawned += 1
        # It has separate draws.
        own_key = rng.mix(key + np.uint64(n_spawned) * np.uint64(0x9E3779B97F4A7C15))
        stated = block_of(leaving.a, leaving.b, leaving.c, block.density, leaving.mass, own_key)
        block = with_drag(hooks.on_block(effects, stated), spread)
        if path is not None:
            continue_path(effects, state, block, site, path, leaving)
        start_spawned(state, block, site, leaving, first_x)
        if not again:
            row = rows.spawned.rows[rows.spawned.n[0]]
            end_place = rows.spawned_ends[rows.spawned.n[0]]
            rows.spawned.n[0] += 1
        open_row(row, strata.number[i], rock, n_spawned, state.x)
        log = CountedRows(log.rows[:0], log.n)
    where = where_counted(state, again)
    if effects is None:
        added = add_to_totals(totals, work, cells, n_touched, mass, where)
    else:
        if spawned.n[0] > n_spawned:
            return TOO_MANY_SPAWNED
        # They count as one block, with energies in J.
        added = add_to_totals(totals, work, work.event, n_event, 1.0, where)
    return DONE if added else MANY_VISITS


@inlined
def room_of(
    rows: Rows, number: int, again: bool
) -> tuple[CountedRows, Record, CountedRows, FloatArray]:
    """Return room for passages, row, event log and end of a block; ``again``: without barriers."""
    if again:
        log = CountedRows(rows.events[number][:0], rows.event_counts[number:])
        return rows.passages_without, rows.rocks[-1], log, rows.ends[-1]
    log = CountedRows(rows.events[number], rows.event_counts[number:])
    return rows.passages, rows.rocks[number], log, rows.ends[number]


@inlined
def where_counted(state: Record, again: bool) -> int:
    """Return whether a block counts only with or without barriers, as its motion differs."""
    if again:
        return WITHOUT
    return WITH if state.hindered else BOTH


@inlined
def release(
    effects: hooks.Effects | None, state: Record, block: Block, site: Site, setup: Setup,
    limits: Records, key: np.uint64, strata: Strata, path: Path | None, i: int,
) -> None:  # fmt: skip
    """Start a block as its key says; parameters as those of simulate_blocks."""
    first = strata.start[i, 0]
    second = strata.start[i, 1]
    if path is None:
        x = rng.between(key, rng.START, 0, first, second)
    else:
        x = 0.0
        u, v = draw_place(key, first, second, path.sides[i])
        if not start_path(effects, state, block, site, path, u, v):
            start_path(effects, state, block, site, path, first, second)
    start_released(state, block, site, setup.physics, limits[0], limits[1], key, x)


@lean
def draw_place(
    key: np.uint64, u: float, v: float, sides: NDArray[np.float64]
) -> tuple[float, float]:
    """Draw where a block starts in the parallelogram that its release point represents."""
    first = rng.uniform(key, rng.START_U, 0) - 0.5
    second = rng.uniform(key, rng.START_V, 0) - 0.5
    return (
        u + exact(first * sides[0] + second * sides[2]),
        v + exact(first * sides[1] + second * sides[3]),
    )


@kernel
def site_of(i: int, lines: Lines, setup: Setup) -> Site:
    """Return the ground over which the blocks of line i move."""
    v0 = lines.offset[i]
    v1 = lines.offset[i + 1]
    s, z, ground = without_straight_vertices(lines.s[v0:v1], lines.z[v0:v1], lines.ground[v0:v1])
    profile = profile_of(s, z, ground)
    c0 = lines.cell_offset[i]
    c1 = lines.cell_offset[i + 1]
    stretches = stretches_of(
        lines.cell_s[c0 + i : c1 + i + 1], lines.cell[c0:c1], lines.stems[c0:c1],
        lines.diameter[c0:c1], lines.on_map[c0 + i : c1 + i + 1], s
    )  # fmt: skip
    g0 = lines.control_line_offset[i]
    g1 = lines.control_line_offset[i + 1]
    crossings = crossings_of(
        profile, lines.control_line_x[g0:g1], lines.control_line[g0:g1], setup.control_lines
    )
    return Site(profile, setup.grounds, crossings, stretches)


@lean
def open_row(row: Record, line: int, number: int, spawned: int, start: float) -> None:
    """Write the identity of a block into its row, and the chainage at which it starts (m)."""
    row.line = line
    row.rock = number
    row.piece = spawned
    row.start_m = start


@fused
def finish_block(
    row: Record, block: Block, state: Record, site: Site, passages: CountedRows, stops: IntArray,
    cells: CellWork, counted: int,
) -> int:  # fmt: skip
    """Write the row and the passages of a block; returns the cell of its stop, or -1.

    The stop is counted so many times.
    """
    row.reason = state.reason
    row.runout_m = state.x
    row.runout_z_m = state.z
    row.furthest_m = state.furthest
    row.time_s = state.t
    row.impacts = state.impacts
    row.a_m = block.a
    row.b_m = block.b
    row.c_m = block.c
    row.density_kgm3 = block.density
    row.mass_kg = block.mass
    row.max_speed_mps = state.top_speed
    row.max_height_m = state.top_height
    row.max_energy_kj = 1e-3 * state.top_energy * block.mass
    first = passages.n[0]
    for k in range(first, first + state.n_passages):
        passage = passages.rows[k]
        passage.line = row.line
        passage.rock = row.rock
    passages.n[0] = first + state.n_passages
    if state.reason == REST or state.reason == BARRIER:
        i = last_stretch(site.profile, site.stretches, state.reason, state.x, row.start_m)
        cell = site.stretches.rows[i].cell if i >= 0 else -1
        if cell >= 0:
            stops[cell] += counted
            state.n_touched = record_stop(
                site.stretches, cells, state.n_touched, i, state.x, state.began + state.t
            )
            return int(cell)
    return -1


@lean
def copied(passages: CountedRows, first: int, to: CountedRows) -> bool:
    """Copy passages from one on to the end of others; returns whether there was room."""
    n = to.n[0]
    more = passages.n[0] - first
    if n + more > to.rows.size:
        return False
    for k in range(more):
        to.rows[n + k] = passages.rows[first + k]
    to.n[0] = n + more
    return True


@inlined
def add_to_totals(
    totals: Totals, work: Work, cells: CellWork, n_touched: int, mass: float, where: int
) -> bool:
    """Add one block, or one with all that it has spawned, to the sums of the run.

    ``mass`` (kg) is 1 where the energies are not per unit mass; it counts BOTH with and without
    barriers, only WITH or only WITHOUT them. Returns whether there was room for its visits.
    """
    n = work.n_visits
    if n[0] + n_touched > work.visits.size:
        return False
    changes = totals.changes
    statistics.count_places(totals.windows, changes.windows, totals.bins, where)
    statistics.count_places(totals.objects, changes.objects, totals.bins, where)
    if where == WITHOUT:
        statistics.flush_changes(cells, n_touched, mass, totals)
        return True
    statistics.flush(cells, n_touched, mass, totals, work.visits[n[0] :], where)
    n[0] += n_touched
    return True
