"""From release points to sums per cell: trace, flatten, simulate and add up, chunk by chunk.

A chunk is a few release points. Its fall lines, profiles and blocks live only while it is worked
on, so that memory depends on the map, not on the number of blocks. Chunks are worked on in threads
and added up in their order; since all sums are whole numbers the result is the same for any number
of threads and any size of chunk.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from sassgis.engine.event_log import trajectory
from sassgis.engine.simulate import Simulated, simulate
from sassgis.hazard.along_profile import LinePaths
from sassgis.hazard.bins import bins_of
from sassgis.hazard.progress import ChunkResult, Progress, add_chunk, joined_rows
from sassgis.model.errors import InputError
from sassgis.model.grid import IntArray
from sassgis.model.map_run import BlockRows, MapRun
from sassgis.model.settings import LateralDeflection
from sassgis.model.statistics_table import Bins
from sassgis.runs.interrupts import held_back
from sassgis.terrain.flatten import chainage_to_xy
from sassgis.terrain.plan import Plan
from sassgis.terrain.prepare import drawn_lines, line_draw_keys, prepare_lines, trace_lines
from sassgis.terrain.release import take
from sassgis.terrain.stretch import take_lines

CHUNK_POINTS = 32
_LOG_EVENTS = 2000
_PATHS = 100


@dataclass(frozen=True, slots=True)
class Chunk:
    """Release points of one area, worked on together in one repetition."""

    points: IntArray
    repetition: int


def _work(run: MapRun, planned: Plan, chunk: Chunk, bins: Bins) -> ChunkResult:
    """One chunk."""
    which, m = chunk.points, run.lines_per_point
    starts = take(planned.starts, which)
    traces = trace_lines(run, planned.surface, starts, chunk.repetition)
    prepared = prepare_lines(run, traces)
    good, lines = prepared.good, prepared.lines
    number = (which[traces.point] * m + np.arange(len(traces)) % m)[good]
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
            rocks_per_line=run.rocks_per_line,
            line_keys=line_draw_keys(traces, starts.key, m, blocks.name)[good],
            starts=start,
            control_lines=prepared.crossings,
            objects=run.objects,
            window=run.window,
            line_numbers=number,
            strata=None if run.effects.get(LateralDeflection) is None else lines.point,
            effects=run.effects,
            forest=run.forest,
            first_rock=chunk.repetition * run.rocks_per_line,
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
    lost = int((~good).sum()) * run.rocks_per_line * len(scenarios)
    return ChunkResult(area, sums, joined_rows(parts), drawn_lines(run, traces, which), lost)


def paths_on_line(run: MapRun, planned: Plan, line: int, scenario: int, rock: int) -> LinePaths:
    """Paths of blocks on one line of a run, in the repetition of one of them.

    Parameters
    ----------
    run, planned
    line, scenario, rock : int
        As in Progress.furthest.

    Raises
    ------
    InputError
        The line is too short for a profile.
    """
    repetition = rock // run.rocks_per_line
    point, member = divmod(line, run.lines_per_point)
    starts = take(planned.starts, np.array([point]))
    bundle = trace_lines(run, planned.surface, starts, repetition)
    chosen = np.arange(len(bundle)) == member
    prepared = prepare_lines(run, take_lines(bundle, chosen))
    if not len(prepared):
        raise InputError("this fall line is too short for a profile")
    blocks = run.blocks[scenario]
    keys = line_draw_keys(bundle, starts.key, run.lines_per_point, blocks.name)[chosen]
    result = simulate(
        prepared.profiles, run.table, blocks, run.engine, seed=run.seed,
        rocks_per_line=min(_PATHS, run.rocks_per_line), line_keys=keys,
        first_rock=repetition * run.rocks_per_line,
        starts=prepared.starts(planned.moved[[point]]), control_lines=prepared.crossings,
        log_events=_LOG_EVENTS, effects=run.effects, forest=run.forest,
    )  # fmt: skip
    s, z = prepared.flat.vertices(0)
    crossed = prepared.crossings
    return LinePaths(
        area=planned.points.area_names[planned.points.area[point]],
        scenario=blocks.name,
        s=s,
        z=z,
        ground=prepared.flat.ground.astype(np.int64),
        ground_names=run.table.names,
        control_lines=tuple(
            (crossed.control_lines[g], float(c))
            for c, g in zip(crossed.chainage, crossed.control_line, strict=True)
        ),
        paths=tuple(trajectory(c, run.engine.gravity_mps2) for c in result.event_logs),
        stops=result.rocks["runout_m"],
    )


def chunks_of(planned: Plan, size: int = CHUNK_POINTS, repetitions: int = 1) -> list[Chunk]:
    """The chunks of a plan, repetition by repetition; a chunk holds points of one area only."""
    chunks = []
    area = planned.points.area
    starts = np.flatnonzero(np.diff(area, prepend=-1)) if area.size else np.empty(0, np.int64)
    for begin, end in zip(starts, [*starts[1:], area.size], strict=True):
        for i in range(begin, end, size):
            chunks.append(np.arange(i, min(i + size, end), dtype=np.int64))
    return [Chunk(points, r) for r in range(repetitions) for points in chunks]


def _in_order(
    work: Callable[[Chunk], ChunkResult], chunks: list[Chunk], jobs: int
) -> Generator[ChunkResult, None, None]:
    """Results of ``work`` in the order of the chunks, a few of them at work at a time.

    Never in the calling thread: Ctrl-C would strike within compiled code, which turns it into a
    SystemError.
    """
    with ThreadPoolExecutor(jobs) as pool:
        waiting: deque[Future[ChunkResult]] = deque()
        todo = iter(chunks)
        try:
            for chunk in todo:
                waiting.append(pool.submit(work, chunk))
                if len(waiting) > 2 * jobs:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def simulate_map(
    run: MapRun,
    planned: Plan,
    *,
    jobs: int = 1,
    resume: Progress | None = None,
    on_chunk: Callable[[Progress, int, BlockRows], None] | None = None,
    chunk_points: int = CHUNK_POINTS,
) -> Progress:
    """Simulate all blocks of a plan.

    Parameters
    ----------
    run : MapRun
    planned : Plan
        Of the same run.
    jobs : int
        Threads.
    resume : Progress, optional
        Of an earlier call with the same run and chunk size, interrupted or with fewer
        repetitions; grows further.
    on_chunk : callable, optional
        Called after each chunk with the progress, the number of chunks in all and the chunk's rows.
        Ctrl-C waits until it returns, so that the progress is whole at any time.
    chunk_points : int
        Release points per chunk.

    Returns
    -------
    Progress
    """
    progress = resume if resume is not None else Progress.fresh(run)
    bins = bins_of(run)
    chunks = chunks_of(planned, chunk_points, run.repetitions)
    total = int(planned.rocks_of_point(run).sum()) // run.repetitions
    share = run.stop_points_max / total if total else 1.0

    def work(chunk: Chunk) -> ChunkResult:
        return _work(run, planned, chunk, bins)

    with closing(_in_order(work, chunks[progress.chunks :], jobs)) as outcomes:
        for outcome in outcomes:
            with held_back():
                add_chunk(progress, outcome, run, share, chunks[progress.chunks].repetition == 0)
                if on_chunk is not None:
                    on_chunk(progress, len(chunks), outcome.rows)
    return progress
