"""From release points to sums per cell: trace, flatten, simulate and add up, chunk by chunk.

A chunk is a few release points. Its fall lines, profiles and blocks live only while it is worked
on, so that memory depends on the map, not on the number of blocks. Chunks are worked on in threads
and added up in their order; since all sums are whole numbers the result is the same for any number
of threads and any size of chunk.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.simulate import Simulated, simulate
from sassgis.engine.simulate_paths import PathTerrain, follow
from sassgis.hazard.bins import bins_of
from sassgis.hazard.progress import (
    ChunkResult,
    Progress,
    add_chunk,
    joined_lines,
    joined_rows,
)
from sassgis.model.errors import InputError
from sassgis.model.grid import IntArray
from sassgis.model.in_memory import Input
from sassgis.model.map_run import BlockRows, MapRun
from sassgis.model.profiles import ReleasePoints
from sassgis.model.statistics_table import Bins
from sassgis.runs.interrupts import held_back
from sassgis.runs.workers import Threads, Workers
from sassgis.terrain.fall_lines import trace
from sassgis.terrain.flatten import chainage_to_xy
from sassgis.terrain.plan import Plan
from sassgis.terrain.prepare import (
    draw_keys,
    drawn_lines,
    prepare_lines,
)
from sassgis.terrain.release import take

CHUNK_POINTS = 96


class TerrainTooSmall(Exception):
    """Raised when a followed path looks into the rim of the grid.

    ``sides``: on which sides (north, east, south, west).
    """

    def __init__(self, sides: tuple[bool, bool, bool, bool]) -> None:
        super().__init__(sides)
        self.sides = sides

    def __str__(self) -> str:
        return f"paths leave the part of the terrain: {self.sides}"


@dataclass(frozen=True, slots=True)
class Chunk:
    """Release points of one area, worked on together in one repetition."""

    points: IntArray
    repetition: int


@dataclass(frozen=True, slots=True)
class _Common:
    """What all chunks of a simulation have in common."""

    run: MapRun
    planned: Plan
    bins: Bins


def _work(common: _Common, chunk: Chunk) -> ChunkResult:
    """One chunk."""
    run, planned, bins = common.run, common.planned, common.bins
    return (_followed if run.followed else _on_lines)(run, planned, chunk, bins)


def path_terrain(run: MapRun) -> PathTerrain:
    """What paths are followed on."""
    return PathTerrain(
        run.heights, run.ground, run.terrain.segment_tolerance_m, run.control_lines, run.forest
    )


def on_known_ground(run: MapRun, points: ReleasePoints) -> NDArray[np.bool_]:
    """Which release points lie on cells with a height: from the others no path is followed."""
    cells = run.heights.cell_of(points.x, points.y)
    return (cells >= 0) & np.isfinite(run.heights.values.ravel()[np.maximum(cells, 0)])


def check_starts(
    run: MapRun, points: ReleasePoints, planned: Callable[[], Plan], file: Input | None
) -> None:
    """Raise InputError where no block can start: an empty map would read as "no hazard".

    Parameters
    ----------
    planned : callable
        Gives the plan; asked only where blocks keep to lines, which are traced to find one.
    file : Input or None
        Of the release areas, for the message.
    """
    if run.followed:
        can = bool(on_known_ground(run, points).any())
    else:
        plan = planned()
        can = any(
            len(
                prepare_lines(
                    run,
                    trace(run.grid, plan.surface, take(plan.starts, own.points), run.terrain),
                )
            )
            for own in chunks_of(plan)
        )
    if not can:
        raise InputError(
            "no block could be simulated",
            file=file,
            field="release.file",
            found=f"{len(points)} release points, "
            + ("none on known terrain" if run.followed else "with lines that end where they begin"),
            expected="release areas on slopes, on known terrain and not at its edge",
        )


def _followed(run: MapRun, planned: Plan, chunk: Chunk, bins: Bins) -> ChunkResult:
    """A chunk of blocks whose paths are followed."""
    points = take(planned.points, chunk.points)
    known = on_known_ground(run, points)
    which = chunk.points[known]
    points = take(planned.points, which)
    area = int(planned.points.area[chunk.points[0]])
    scenarios = planned.scenarios[area]
    sums: dict[int, Simulated] = {}
    parts: list[BlockRows] = []
    for k in scenarios if which.size else ():
        result = follow(
            path_terrain(run),
            points,
            run.table,
            run.blocks[k],
            run.engine,
            seed=run.seed,
            rocks_per_point=run.release.rocks_per_point,
            point_keys=draw_keys(points.key, run.blocks[k].name),
            point_numbers=which,
            spread_m=run.start_spread_m(area),
            objects=run.objects,
            window=run.window,
            first_rock=chunk.repetition * run.release.rocks_per_point,
            bins=bins,
            effects=run.effects,
        )
        if result.looked_at is not None and any(sides := run.sides_met(result.looked_at)):
            raise TerrainTooSmall(sides)
        ended = np.concatenate([result.rocks, result.pieces])
        sums[k] = result
        parts.append(
            BlockRows(
                ended, np.full(ended.size, k, np.int64), result.x, result.y,
                result.passages, np.full(result.passages.size, k, np.int64),
            )
        )  # fmt: skip
    lines = joined_lines([])
    if chunk.repetition == 0:
        # For the map: where the descent leads from each point.
        starts = take(planned.starts, chunk.points)
        traces = trace(run.grid, planned.surface, starts, run.terrain)
        lines = drawn_lines(traces, run.grid, chunk.points)
    lost = int((~known).sum()) * run.release.rocks_per_point * len(scenarios)
    return ChunkResult(area, sums, joined_rows(parts), lines, lost)


def _on_lines(run: MapRun, planned: Plan, chunk: Chunk, bins: Bins) -> ChunkResult:
    """A chunk of blocks that keep to the lines of their release points."""
    which = chunk.points
    starts = take(planned.starts, which)
    traces = trace(run.grid, planned.surface, starts, run.terrain)
    prepared = prepare_lines(run, traces)
    good, lines = prepared.good, prepared.lines
    number = which[good]
    area = int(starts.area[0])
    scenarios = planned.scenarios[area]
    start = prepared.starts(planned.moved[which][lines.point])
    length = prepared.length_m
    sums: dict[int, Simulated] = {}
    parts: list[BlockRows] = []
    for k in scenarios if len(lines) else ():
        blocks = run.blocks[k]
        result = simulate(
            prepared.profiles,
            run.table,
            blocks,
            run.engine,
            seed=run.seed,
            rocks_per_line=run.release.rocks_per_point,
            line_keys=draw_keys(starts.key, blocks.name)[good],
            starts=start,
            control_lines=prepared.crossings,
            objects=run.objects,
            window=run.window,
            line_numbers=number,
            effects=run.effects,
            forest=run.forest,
            first_rock=chunk.repetition * run.release.rocks_per_point,
            bins=bins,
        )
        ended = np.concatenate([result.rocks, result.pieces])
        local = np.searchsorted(number, ended["line"]).astype(np.int64)
        x, y = chainage_to_xy(lines, local, np.clip(ended["runout_m"], 0.0, length[local]))
        sums[k] = result
        parts.append(
            BlockRows(
                ended, np.full(ended.size, k, np.int64), x, y,
                result.passages, np.full(result.passages.size, k, np.int64),
            )
        )  # fmt: skip
    lost = int((~good).sum()) * run.release.rocks_per_point * len(scenarios)
    return ChunkResult(area, sums, joined_rows(parts), drawn_lines(traces, run.grid, which), lost)


def chunks_of(planned: Plan, size: int = CHUNK_POINTS, repetitions: int = 1) -> list[Chunk]:
    """The chunks of a plan, repetition by repetition; a chunk holds points of one area only."""
    chunks = []
    area = planned.points.area
    starts = np.flatnonzero(np.diff(area, prepend=-1)) if area.size else np.empty(0, np.int64)
    for begin, end in zip(starts, [*starts[1:], area.size], strict=True):
        for i in range(begin, end, size):
            chunks.append(np.arange(i, min(i + size, end), dtype=np.int64))
    return [Chunk(points, r) for r in range(repetitions) for points in chunks]


def simulate_map(
    run: MapRun,
    planned: Plan,
    *,
    jobs: int | Workers = 1,
    resume: Progress | None = None,
    on_chunk: Callable[[Progress, int, BlockRows], None] | None = None,
    chunk_points: int = CHUNK_POINTS,
) -> Progress:
    """Simulate all blocks of a plan.

    Parameters
    ----------
    planned : Plan
        Of the same run.
    jobs : int or Workers
        Threads, or who works instead.
    resume : Progress, optional
        Of an earlier call with the same run and chunk size, interrupted or with fewer
        repetitions; grows further.
    on_chunk : callable, optional
        Called after each chunk with the progress, the number of chunks in all and the chunk's rows.
        Ctrl-C waits until it returns, so that the progress is whole at any time.
    chunk_points : int
        Release points per chunk.

    Raises
    ------
    TerrainTooSmall
        A followed path looks into the rim of the grid.
    """
    progress = resume if resume is not None else Progress.fresh(run)
    chunks = chunks_of(planned, chunk_points, run.repetitions)
    total = int(planned.blocks_of_point(run).sum()) // run.repetitions
    share = run.stop_points_max / total if total else 1.0

    workers = Threads(jobs) if isinstance(jobs, int) else jobs
    common = _Common(run, planned, bins_of(run))
    with closing(workers.in_order(_work, common, chunks[progress.chunks :])) as outcomes:
        for outcome in outcomes:
            with held_back():
                add_chunk(progress, outcome, run, share, chunks[progress.chunks].repetition == 0)
                if on_chunk is not None:
                    on_chunk(progress, len(chunks), outcome.rows)
    return progress
