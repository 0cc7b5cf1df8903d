"""The kernel: all blocks of a few fall lines, added to the sums of the run."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled import rng
from sassgis.compiled.jit import fused, inlined, kernel, lean
from sassgis.engine.barriers import crossings_of
from sassgis.engine.block import simulate_block, start_released, start_spawned
from sassgis.engine.cell_register import FULL
from sassgis.engine.draws import block_of, draw_block, draw_start, with_drag, with_outline
from sassgis.engine.effects import hooks
from sassgis.engine.effects.spawning import room_for
from sassgis.engine.ground_ahead import Path, place, room_ahead
from sassgis.engine.heading import continue_path, start_path
from sassgis.engine.profile import last_stretch, profile_of, stretches_of, without_straight_vertices
from sassgis.engine.recording import CellWork, empty_work, record_stop
from sassgis.engine.rows import Record, Records, last_of
from sassgis.engine.state import (
    BARRIER,
    REST,
    Block,
    EventLog,
    Output,
    Physics,
    Site,
    Spawned,
    Start,
)
from sassgis.engine.statistics import (
    CellSums,
    Disks,
    Event,
    Exceedance,
    FlatBins,
    Objects,
    PlaceWork,
    Wanted,
    add_visits,
    add_worth,
    by_cell,
    collect,
    count_places,
    empty_event,
    end_stratum,
    flush,
    give_back,
    meet_disks,
    meet_objects,
    passed_cells,
    place_work,
)
from sassgis.terrain.cell_geometry import exact

#: What simulate_lines returns: whether all went well; whether there were too few rows for passages
#: or spawned blocks, or for visits; whether one released block spawned more blocks than there is
#: room for.
DONE, NO_ROOM, MANY_VISITS, TOO_MANY_SPAWNED = 0, 1, 2, 3


# Room for visits of each thread: _room_for_visits.
_KEPT = threading.local()


class Lines(NamedTuple):
    """Profiles of a chunk, as in model.profiles.ProfileSet; ``cell`` counts the chunk's cells."""

    offset: NDArray[np.int64]
    s: NDArray[np.float64]
    z: NDArray[np.float64]
    ground: NDArray[np.int32]
    cell_offset: NDArray[np.int64]
    cell_s: NDArray[np.float64]
    cell: NDArray[np.int64]
    stems: NDArray[np.float64]  # as cell: stems per m² there
    diameter: NDArray[np.float64]  # as cell: of the stems at breast height (m)
    on_map: NDArray[np.float64]  # (cell_s.size, 2) borders on the map: columns and rows, in cells
    number: NDArray[np.int64]  # of the line in the run
    key: NDArray[np.uint64]  # identity of the line for random draws
    start: NDArray[np.float64]  # (n, 2) limits of the starting chainage
    control_line_offset: NDArray[np.int64]
    control_line_x: NDArray[np.float64]
    control_line: NDArray[np.int64]


class Points(NamedTuple):
    """Release points of a chunk from which paths are followed; each is a stratum of the sample."""

    u: NDArray[np.float64]  # place in plan (cells)
    v: NDArray[np.float64]
    number: NDArray[np.int64]  # of the point in the run
    key: NDArray[np.uint64]  # its identity for random draws


class ControlLineTable(NamedTuple):
    """Stations and barriers of the run."""

    kind: NDArray[np.int64]
    height: NDArray[np.float64]
    capacity: NDArray[np.float64]  # J


class Setup(NamedTuple):
    """Data common to the blocks of all lines."""

    grounds: Records  # ground_switch.GROUND_DTYPE
    limits: Records  # (1, 2) or (n_lines, 2), model.blocks.LIMITS_DTYPE
    physics: Physics
    control_lines: ControlLineTable
    seed: np.uint64
    first_rock: int  # number of the first block on each line
    n_blocks: int  # on each line


class Places(NamedTuple):
    """Objects, and the blocks that came to them."""

    under: Objects
    reach: Exceedance  # added to


class Windows(NamedTuple):
    """Windows, and the blocks whose path met them."""

    disks: Disks
    reach: Exceedance  # added to


class Totals(NamedTuple):
    """Sums of the run, to which blocks are added."""

    bins: FlatBins
    sums: CellSums
    reach: Exceedance  # of the cells
    windows: Windows
    objects: Places


class Rows(NamedTuple):
    """Rows of the run, which blocks fill."""

    rocks: Records  # (n_lines * n_blocks,) model.results.ROCK_DTYPE
    passages: Records  # model.results.PASSAGE_DTYPE, filled from the top
    spawned: Records  # ROCK_DTYPE, spawned blocks, filled from the top
    ends: NDArray[
        np.float64
    ]  # (n_lines * n_blocks, 2), place of the end of a followed path (cells)
    spawned_ends: NDArray[np.float64]  # the same of spawned blocks
    events: Records  # (n_lines * n_blocks, n_events) state.EVENT_DTYPE; n_events may be 0
    event_counts: NDArray[np.int64]  # (n_lines * n_blocks,)
    filled: NDArray[np.int64]  # (2,) rows of passages and of spawned blocks that there are


class Work(NamedTuple):
    """Working space of a chunk."""

    state: Records  # hooks.BLOCK_DTYPE, one row
    cells: CellWork
    event: Event
    visits: NDArray[np.uint64]  # (room,)
    n_visits: NDArray[np.int64]  # (2,) of them; of those that are in histograms already
    windows: PlaceWork
    objects: PlaceWork
    spawned: Spawned
    vertices: Records  # of the ground just ahead, on a path that is followed
    crossings: Records
    stretches: Records


def _room_for_visits(n: int) -> NDArray[np.uint64]:
    """Return room for visits, which each thread keeps.

    The system clears memory that it gives out.
    """
    if getattr(_KEPT, "visits", np.empty(0)).size < n:
        _KEPT.visits = np.empty(n, np.uint64)
    own: NDArray[np.uint64] = _KEPT.visits
    return own[:n]


def working_space(
    totals: Totals, effects: hooks.Effects | None, most_spawned: int, visits: int, on_map: bool
) -> Work:
    """Return working space for a chunk whose blocks are added to some totals.

    ``most_spawned`` is how many blocks one released block may spawn, ``visits`` for how many of
    them to cells there is room; ``on_map`` is whether it is known where the paths lie on the map.
    """
    n = totals.sums.stops.size
    return Work(
        np.zeros(1, hooks.BLOCK_DTYPE),
        empty_work(n, chords=on_map),
        empty_event(0 if effects is None else n),
        _room_for_visits(visits),
        np.zeros(2, np.int64),
        place_work(totals.windows.reach.top.size),
        place_work(totals.objects.reach.top.size),
        room_for(most_spawned),
        *room_ahead(),
    )


@kernel
def simulate_lines(
    lines: Lines,
    setup: Setup,
    totals: Totals,
    rows: Rows,
    work: Work,
    effects: hooks.Effects | None,
) -> int:
    """Simulate all blocks of some lines, with the blocks that they spawn.

    Parameters
    ----------
    totals : Totals
        Added to.
    rows : Rows
        Filled.
    work : Work
        As working_space makes it.
    effects : Effects, optional
        None for the model of 1986 only.

    Returns
    -------
    int
        DONE, or else why not: then nothing that was filled is of use.
    """
    for i in range(lines.number.size):
        status = simulate_blocks(
            i, site_of(i, lines, setup), lines.number[i], lines.key[i], lines.start[i, 0],
            lines.start[i, 1], setup, totals, rows, work, effects, None
        )  # fmt: skip
        if status != DONE:
            return status
        end_line(totals, work)
    return DONE


@kernel
def simulate_paths(
    points: Points,
    setup: Setup,
    totals: Totals,
    rows: Rows,
    work: Work,
    effects: hooks.Effects | None,
    path: Path,
    wanted: Wanted | None,
) -> int:
    """Simulate all blocks of some release points, each along the path that it takes.

    Parameters as those of simulate_lines, and the terrain that the paths are followed on; the cells
    of the totals are those of its register.
    """
    site = Site(work.vertices, setup.grounds, work.crossings, work.stretches)
    n_points = points.number.size
    for i in range(n_points):
        status = simulate_blocks(
            i, site, points.number[i], points.key[i], points.u[i], points.v[i], setup, totals, rows,
            work, effects, path
        )  # fmt: skip
        if status != DONE:
            return status
        if wanted is not None:
            add_worth(totals.windows.reach, wanted, i, setup.n_blocks)
        end_line(totals, work)
    return DONE


@kernel
def end_line(totals: Totals, work: Work) -> None:
    """Count the blocks of a line or point, and add the visits where there are many."""
    end_stratum(totals.reach)
    end_stratum(totals.windows.reach)
    end_stratum(totals.objects.reach)
    n = work.n_visits
    if 2 * n[0] > work.visits.size:
        rows = np.arange(totals.sums.stops.size).astype(np.int32)
        add_visits(by_cell(work.visits[: n[0]], rows.size), rows, totals.sums.counts, 1)
        n[1] += n[0]
        n[0] = 0


@lean
def simulate_blocks(
    i: int,
    site: Site,
    line: int,
    line_key: np.uint64,
    first: float,
    second: float,
    setup: Setup,
    totals: Totals,
    rows: Rows,
    work: Work,
    effects: hooks.Effects | None,
    path: Path | None,
) -> int:
    """Simulate all blocks of line or release point ``i``.

    ``first`` and ``second`` are limits of the starting chainage (m), or the place of the release
    point (cells), ``path`` what paths are followed on. Returns as simulate_lines.
    """
    state = work.state[0]
    spawned = work.spawned
    limits = setup.limits[i if setup.limits.shape[0] > 1 else 0]
    for r in range(setup.n_blocks):
        # The released block first, then those that it and they spawn, in turn.
        key = rng.block_key(setup.seed, line_key, setup.first_rock + r)
        spread = setup.physics.rolling_friction_sd
        # The released block is reported as it was drawn, a fragment as it moves.
        stated = draw_block(limits[0], limits[1], key)
        outlined = with_outline(stated, setup.physics)
        block = with_drag(hooks.on_block(effects, outlined), spread)
        start = release(effects, state, block, site, setup, limits, key, first, second, path, i)
        number = i * setup.n_blocks + r
        row = rows.rocks[number]
        open_row(row, line, setup.first_rock + r, 0, state.x)
        log = EventLog(rows.events[number], rows.event_counts[number:])
        end_place = rows.ends[number]
        n_spawned = 0
        spawned.filled[0] = 0
        while True:
            n = rows.filled[0]
            n_lines = last_of(site.crossings) if path is None else path.line_kind.size
            if n + n_lines > rows.passages.size:
                return NO_ROOM
            output = Output(rows.passages[n:], work.cells, log, spawned)
            simulate_block(state, block, site, output, setup.physics, effects, path)
            cells, mass = work.cells, block.mass
            last = finish_block(row, stated, state, site, rows, totals.sums, cells)
            n_touched = state.n_touched
            if work.windows.peak.size:
                meet_disks(cells, n_touched, mass, totals.windows.disks, work.windows)
            if work.objects.peak.size:
                meet_objects(cells, n_touched, mass, totals.objects.under, work.objects)
            n_touched = passed_cells(cells, n_touched, last)
            if path is not None:
                end_place[0], end_place[1] = place(state, state.x)
                if path.register.counts[FULL]:
                    return NO_ROOM
            if effects is None:
                break
            collect(work.event, cells, n_touched, mass)
            if n_spawned >= min(spawned.filled[0], spawned.rows.size):
                break
            if rows.filled[1] >= rows.spawned.size:
                return NO_ROOM
            leaving = spawned.rows[n_spawned]
            n_spawned += 1
            stated = spawned_block(leaving, block.density, key, n_spawned)
            block = with_drag(hooks.on_block(effects, stated), spread)
            if path is not None:
                continue_path(effects, state, block, site, path, leaving)
            start_spawned(state, block, site, leaving, start.x)
            row = rows.spawned[rows.filled[1]]
            end_place = rows.spawned_ends[rows.filled[1]]
            rows.filled[1] += 1
            open_row(row, line, setup.first_rock + r, n_spawned, state.x)
            log = EventLog(log.rows[:0], log.filled)
        if effects is None:
            added = add_to_totals(totals, work, n_touched, mass)
        else:
            if spawned.filled[0] > n_spawned:
                return TOO_MANY_SPAWNED
            # They count together, with their energies in J.
            added = add_to_totals(totals, work, give_back(work.event, cells), 1.0)
        if not added:
            return MANY_VISITS
    return DONE


@inlined
def release(
    effects: hooks.Effects | None,
    state: Record,
    block: Block,
    site: Site,
    setup: Setup,
    limits: Records,
    key: np.uint64,
    first: float,
    second: float,
    path: Path | None,
    i: int,
) -> Start:
    """Let a block go as its key says; parameters as those of simulate_blocks."""
    if path is None:
        start = draw_start(limits[0], limits[1], key, first, second)
    else:
        start = draw_start(limits[0], limits[1], key, 0.0, 0.0)
        u, v = draw_place(key, first, second, path.sides[i])
        if not start_path(effects, state, block, site, path, u, v):
            start_path(effects, state, block, site, path, first, second)
    start_released(state, block, site, setup.physics, start)
    return start


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
    table = setup.control_lines
    crossings = crossings_of(
        profile, lines.control_line_x[g0:g1], lines.control_line[g0:g1], table.kind, table.height,
        table.capacity
    )  # fmt: skip
    return Site(profile, setup.grounds, crossings, stretches)


@lean
def spawned_block(spawned_row: Record, density: float, key: np.uint64, number: int) -> Block:
    """Return the spawned block of some number of a released block with a key.

    It has separate draws.
    """
    own = rng.mix(key + np.uint64(number) * np.uint64(0x9E3779B97F4A7C15))
    return block_of(spawned_row.a, spawned_row.b, spawned_row.c, density, spawned_row.mass, own)


@lean
def open_row(row: Record, line: int, number: int, spawned: int, start: float) -> None:
    """Write which block a row is about, and the chainage at which it starts (m).

    ``number`` is that of the released block on its line; ``spawned`` that of a block that it has
    spawned, 0 for itself.
    """
    row.line = line
    row.rock = number
    row.piece = spawned
    row.start_m = start


@fused
def finish_block(
    row: Record,
    block: Block,
    state: Record,
    site: Site,
    rows: Rows,
    sums: CellSums,
    cells: CellWork,
) -> int:
    """Write what became of a block: its row, its passages and its stop.

    Returns the cell in which it stops; -1 for none.
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
    first = rows.filled[0]
    for k in range(first, first + state.n_passages):
        passage = rows.passages[k]
        passage.line = row.line
        passage.rock = row.rock
    rows.filled[0] = first + state.n_passages
    if state.reason == REST or state.reason == BARRIER:
        i = last_stretch(site.profile, site.stretches, state.reason, state.x, row.start_m)
        if i >= 0 and site.stretches[i].cell >= 0:
            sums.stops[site.stretches[i].cell] += 1
            state.n_touched = record_stop(
                site.stretches, cells, state.n_touched, i, state.x, state.began + state.t
            )
            return int(site.stretches[i].cell)
    return -1


@inlined
def add_to_totals(totals: Totals, work: Work, n_touched: int, mass: float) -> bool:
    """Add one block, or one with all that it has spawned, to the sums of the run.

    ``mass`` (kg) is 1 where the energies in the work are not per unit mass. Returns whether there
    was room for its visits.
    """
    cells, n = work.cells, work.n_visits
    if n[0] + n_touched > work.visits.size:
        return False
    count_places(work.windows, totals.bins, totals.windows.reach)
    count_places(work.objects, totals.bins, totals.objects.reach)
    n[0] = flush(
        cells, n_touched, totals.sums, totals.reach, totals.bins, mass, work.visits, n[0]
    )  # fmt: skip
    return True
