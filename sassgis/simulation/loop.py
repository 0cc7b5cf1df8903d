"""From release points to sums per cell: trace, flatten, simulate and add up, chunk by chunk.

A chunk is a few release points. Its fall lines, profiles and blocks live only while it is worked
on, so that memory depends on the map, not on the number of blocks. Chunks are worked on in threads
and added up in their order; since all sums are whole numbers the result is the same for any number
of threads and any size of chunk.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.simulate import Simulated, simulate
from sassgis.engine.simulate_paths import PathTerrain, follow
from sassgis.errors import InputError
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.map_run import BlockRows, MapRun, ObjectCells, Round, Worth
from sassgis.settings.results import ReleasePoints, TraceSet
from sassgis.settings.schema import Input
from sassgis.settings.statistics_table import SUM_NAMES, Bins, bins_of
from sassgis.simulation.accumulators import (
    ChunkResult,
    Progress,
    add_chunk,
    joined_lines,
    joined_rows,
)
from sassgis.simulation.response import RunOutcome, ToleranceCheck, outcome_of, response
from sassgis.simulation.workers import Threads, Workers, held_back
from sassgis.terrain.fall_lines import trace
from sassgis.terrain.flatten import chainage_to_xy
from sassgis.terrain.prepare import Plan, PreparedLines, draw_keys, drawn_lines, prepare_lines
from sassgis.terrain.release import take

CHUNK_POINTS = 96


class TerrainTooSmall(Exception):
    """Raised where paths look into the rim of the grid, or lines come near, with the sides."""

    def __init__(self, sides: tuple[bool, bool, bool, bool]) -> None:
        super().__init__(sides)
        self.sides = sides

    def __str__(self) -> str:
        return f"paths leave the part of the terrain: {self.sides}"


@dataclass(frozen=True, slots=True)
class Chunk:
    """Repetitions at release points of one area, worked on together; shape (n,) each."""

    points: IntArray
    repetitions: IntArray  # numbers of them
    scenarios: tuple[int, ...]  # positions in ``blocks``
    weight: int  # how many times each block counts


#: Data common to all chunks of a simulation.
_Common = tuple[MapRun, Plan, Bins, Worth | None]


def numbered(rows: NDArray[np.void], chunk: Chunk, each: int) -> NDArray[np.void]:
    """Number rows of blocks of a chunk as in the run; ``each`` are the blocks of a repetition."""
    entry = rows["line"]
    rows["rock"] += (each * chunk.repetitions[entry]).astype(rows["rock"].dtype)
    rows["line"] = chunk.points[entry]
    return rows


def path_terrain(run: MapRun) -> PathTerrain:
    """Return the terrain on which paths are followed."""
    return PathTerrain(
        run.heights, run.ground, run.terrain.segment_tolerance_m, run.all_lines, run.forest
    )


def follow_blocks(
    run: MapRun, points: ReleasePoints, k: int, again: int | IntArray, **more: Any
) -> Simulated:
    """Return blocks of a scenario from points of one area, in some repetition, by ``follow``."""
    blocks = run.blocks[k]
    return follow(
        path_terrain(run), points, run.table, blocks, run.engine, seed=run.seed,
        point_keys=draw_keys(points.key, blocks.name, again),
        effects=run.effects, **more,
    )  # fmt: skip


def blocks_on_lines(
    run: MapRun,
    planned: Plan,
    which: IntArray,
    prepared: PreparedLines,
    k: int,
    again: int | IntArray,
    **more: Any,
) -> Simulated:
    """Return blocks of a scenario on the lines of some points; ``more`` as for simulate."""
    blocks = run.blocks[k]
    return simulate(
        prepared.profiles, run.table, blocks, run.engine, seed=run.seed,
        line_keys=draw_keys(planned.starts.key[which], blocks.name, again)[prepared.good],
        starts=prepared.starts(planned.moved[which][prepared.lines.point]),
        control_lines=prepared.crossings, effects=run.effects, forest=run.forest, **more,
    )  # fmt: skip


def on_known_ground(run: MapRun, points: ReleasePoints) -> NDArray[np.bool_]:
    """Find the release points on cells with a height; from the others no path is followed."""
    return np.isfinite(run.heights.value_at(points.x, points.y))


def traced(run: MapRun, planned: Plan, which: IntArray) -> TraceSet:
    """Return the fall lines of some release points."""
    return trace(run.grid, planned.surface, take(planned.starts, which), run.terrain)


def check_starts(
    run: MapRun, points: ReleasePoints, planned: Callable[[], Plan], file: Input | None
) -> None:
    """Raise InputError where no block can start: an empty map would read as "no hazard".

    The plan is made only where blocks keep to lines: lines are traced until one is found. The file
    of the release areas is named in the message.
    """
    if run.followed:
        can = bool(on_known_ground(run, points).any())
    else:
        plan = planned()
        can = any(len(prepare_lines(run, traced(run, plan, c.points))) for c in chunks_of(plan))
    if not can:
        why = "none on known terrain" if run.followed else "with lines that end where they begin"
        raise InputError(
            "no block could be simulated", file=file, field="release.file",
            found=f"{len(points)} release points, {why}",
            expected="release areas on slopes, on known terrain and not at its edge",
        )  # fmt: skip


#: Of a block scenario: its position, what was simulated, rows of all blocks, where each ends (m).
_OfScenario = tuple[int, Simulated, NDArray[np.void], FloatArray, FloatArray]


def _work(common: _Common, chunk: Chunk) -> ChunkResult:
    """Simulate one chunk."""
    run, planned, _, _ = common
    good, traces, found = (_followed if run.followed else _on_lines)(common, chunk)
    area, each = int(planned.points.area[chunk.points[0]]), run.release.rocks_per_point
    own = replace(chunk, points=chunk.points[good], repetitions=chunk.repetitions[good])
    parts = [
        BlockRows.of_chunk(
            numbered(ended, own, each), x, y, numbered(result.passages, own, each), k, chunk.weight
        )
        for k, result, ended, x, y in found
    ]
    for _, result, *_ in found:
        if result.without is not None:
            numbered(result.without.passages, own, each)
    lost = int((~good).sum()) * each * len(chunk.scenarios)
    # For the map: where the descent leads from each point, once for all repetitions.
    drawn = []
    if not chunk.repetitions[0]:
        lines = traced(run, planned, chunk.points) if traces is None else traces
        drawn.append(drawn_lines(lines, run.grid, chunk.points))
    return ChunkResult(
        area=area, points=own.points, weight=chunk.weight,
        sums={k: _to_add(result) for k, result, *_ in found}, rows=joined_rows(parts),
        lines=joined_lines(drawn), lost=lost,
    )  # fmt: skip


def _to_add(result: Simulated) -> Simulated:
    """Return what is added up: where windows are counted, not the counts of the cells as well."""
    if not result.windows.size:
        return result
    # Copies: a result that waits must not keep the omitted rows in memory.
    kept = {name: own.copy() for name, own in result.kept.items() if name in SUM_NAMES}
    return replace(result, kept=kept)


def _followed(common: _Common, chunk: Chunk) -> tuple[NDArray[np.bool_], None, list[_OfScenario]]:
    """Return blocks whose paths are followed, and which entries of a chunk have some."""
    run, planned, bins, worth = common
    points = take(planned.points, chunk.points)
    known = on_known_ground(run, points)
    points = take(points, np.flatnonzero(known))
    found: list[_OfScenario] = []
    for k in chunk.scenarios if len(points) else ():
        result = follow_blocks(
            run, points, k, chunk.repetitions[known], rocks_per_point=run.release.rocks_per_point,
            objects=run.objects, window=run.window, bins=bins, worth=worth, compared=run.compared,
        )  # fmt: skip
        if result.looked_at is not None and any(sides := run.sides_met(result.looked_at)):
            raise TerrainTooSmall(sides)
        ended = np.concatenate([result.rocks, result.pieces])
        found.append((k, result, ended, result.x, result.y))
    return known, None, found


def _on_lines(
    common: _Common, chunk: Chunk
) -> tuple[NDArray[np.bool_], TraceSet, list[_OfScenario]]:
    """Return blocks that keep to their points' lines, which entries have some, and all lines."""
    run, planned, bins, _ = common
    traces = traced(run, planned, chunk.points)
    prepared = prepare_lines(run, traces)
    lines, length = prepared.lines, prepared.length_m
    found: list[_OfScenario] = []
    for k in chunk.scenarios if len(lines) else ():
        result = blocks_on_lines(
            run, planned, chunk.points, prepared, k, chunk.repetitions,
            rocks_per_line=run.release.rocks_per_point,
            objects=run.objects, window=run.window, bins=bins, compared=run.compared,
        )  # fmt: skip
        ended = np.concatenate([result.rocks, result.pieces])
        line = ended["line"].astype(np.int64)
        x, y = chainage_to_xy(lines, line, np.clip(ended["runout_m"], 0.0, length[line]))
        found.append((k, result, ended, x, y))
    return prepared.good, traces, found


def chunks_of(
    planned: Plan, rounds: Sequence[Round] = (Round(),), size: int = CHUNK_POINTS
) -> list[Chunk]:
    """Return the chunks of a plan, one repetition after the other; a chunk has one area."""
    area = planned.points.area
    starts = np.flatnonzero(np.diff(area, prepend=-1)) if area.size else np.empty(0, np.int64)
    of_area = [
        np.arange(*ends, dtype=np.int64)
        for ends in zip(starts, [*starts[1:], area.size], strict=True)
    ]
    chunks = []
    for own in rounds:
        numbers = own.first + np.arange(own.repetitions, dtype=np.int64)
        if own.halvings is None:
            # Points next to each other, as all of a chunk then lies on few cells.
            chunks += [
                Chunk(part, np.full(part.size, number), planned.scenarios[area[part[0]]], 1)
                for number in numbers
                for points in of_area
                for part in _parts(points, size)
            ]
            continue
        for points in of_area:
            for k in planned.scenarios[area[points[0]]]:
                halved = own.halvings[points, k]
                for h in np.unique(halved).tolist():
                    some, few = points[halved == h], numbers[: own.repetitions >> h]
                    entries = np.tile(some, few.size), np.repeat(few, some.size)
                    chunks += [
                        Chunk(part, again, (k,), 1 << h)
                        for part, again in zip(*(_parts(e, size) for e in entries), strict=True)
                    ]
    return chunks


def _parts(entries: IntArray, size: int) -> list[IntArray]:
    return [entries[i : i + size] for i in range(0, entries.size, size)]


def simulate_map(
    run: MapRun,
    planned: Plan,
    *,
    jobs: int | Workers = 1,
    resume: Progress | None = None,
    on_chunk: Callable[[Progress, int, BlockRows], None] | None = None,
    chunk_points: int = CHUNK_POINTS,
) -> Progress:
    """Simulate all blocks of a plan of the run, with so many threads or other workers.

    TerrainTooSmall: a followed path looks into the rim of the grid.

    Parameters
    ----------
    resume : Progress, optional
        Of an earlier call with the same run and chunk size, interrupted or with fewer
        repetitions; grows further.
    on_chunk : callable, optional
        Called after each chunk with the progress, the number of chunks in all and the chunk's rows.
        Ctrl-C waits until it returns, so that the progress is whole at any time.
    """
    progress = resume if resume is not None else Progress.fresh(run)
    chunks = _wanted_chunks(chunks_of(planned, run.rounds, chunk_points), planned, progress)
    workers = Threads(jobs) if isinstance(jobs, int) else jobs
    common: _Common = (run, planned, bins_of(run), progress.worth)
    with closing(workers.in_order(_work, common, chunks[progress.chunks :])) as outcomes:
        for outcome in outcomes:
            with held_back():
                add_chunk(progress, outcome, run)
                if on_chunk is not None:
                    on_chunk(progress, len(chunks), outcome.rows)
    return progress


def _wanted_chunks(chunks: Sequence[Chunk], planned: Plan, progress: Progress) -> list[Chunk]:
    """Return the chunks that are not taken, or not wholly, from an earlier result."""
    number = Counter[int]()
    wanted = []
    for chunk in chunks:
        area = int(planned.points.area[chunk.points[0]])
        if area not in progress.reused or (area, number[area]) in progress.recounted:
            wanted.append(chunk)
        number[area] += 1
    return wanted


#: Blocks of the sample: a thirtieth of the run, so that three of it cost a tenth, within these.
_SHARE, _FEWEST, _MOST = 1.0 / 30.0, 2_000, 20_000
_POINTS = 40


def sampled_plan(run: MapRun, planned: Plan, blocks: int, points: int) -> tuple[MapRun, Plan]:
    """Return a part of a run: so many release points, evenly chosen, and their first blocks."""
    n = len(planned.points)
    once = replace(run, rounds=(Round(),))
    released = int(replace(planned, repetitions=()).blocks_of_point(once).sum())
    # Blocks of a point for each of its rocks_per_point: one for each scenario.
    scenarios = released / (n * run.release.rocks_per_point)
    least = min(n, points)
    each = int(np.clip(round(blocks / (scenarios * least)), 1, run.release.rocks_per_point))
    wanted = int(np.clip(round(blocks / (scenarios * each)), least, n))
    which = np.unique(np.linspace(0, n - 1, wanted).round().astype(np.int64))
    return (
        replace(
            once, release=replace(run.release, rocks_per_point=each),
            stop_points_max=0, ref_width_m=0.0, objects=ObjectCells.none(), rim=(0, 0, 0, 0),
            further_stations=None,
        ),
        plan_of_points(planned, which),
    )  # fmt: skip


def plan_of_points(planned: Plan, which: IntArray) -> Plan:
    """Return the plan with only some of its release points; each has the same random draws."""
    return replace(
        planned,
        points=take(planned.points, which),
        starts=take(planned.starts, which),
        moved=planned.moved[which],
    )


def check_tolerance(run: MapRun, planned: Plan, jobs: int | Workers) -> ToleranceCheck | None:
    """Repeat a sample of a run at half and double its tolerance; None where there is none."""
    tolerance = run.terrain.segment_tolerance_m
    total = int(planned.blocks_of_point(run).sum())
    if tolerance == 0.0 or not total:
        return None
    few, points = sampled_plan(run, planned, int(np.clip(_SHARE * total, _FEWEST, _MOST)), _POINTS)

    def outcome(t: float) -> RunOutcome:
        terrain = replace(few.terrain, segment_tolerance_m=t)
        progress = simulate_map(replace(few, terrain=terrain), points, jobs=jobs)
        return outcome_of(progress, bins_of(few))

    base = outcome(tolerance)
    answers = {t: response(base, outcome(t)) for t in (0.5 * tolerance, 2.0 * tolerance)}
    return ToleranceCheck(tolerance, base.blocks, answers)
