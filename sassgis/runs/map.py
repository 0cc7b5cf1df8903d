"""From release points to sums per cell: trace, flatten, simulate and add up, chunk by chunk.

A chunk is a few release points. Its fall lines, profiles and rocks live only while it is worked on,
so that memory depends on the map, not on the number of rocks. Chunks are worked on in threads and
added up in their order; since all sums are whole numbers the result is the same for any number of
threads and any size of chunk.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.engine.simulate import (
    Bins,
    ControlLineCrossings,
    Forest,
    ObjectCells,
    Simulated,
    Window,
    default_bins,
    simulate,
)
from sassgis.hazard.control_lines import ControlLineSums
from sassgis.hazard.source_sums import SourceSums
from sassgis.hazard.statistics import MapSums, Sample
from sassgis.io.read.vectors import ReleaseArea
from sassgis.model import rng
from sassgis.model.blocks import BlockPopulation
from sassgis.model.effects import EffectSettings
from sassgis.model.grid import FloatArray, Grid, IntArray
from sassgis.model.ground import GroundTable
from sassgis.model.profiles import LineEnd, ReleasePoints, TraceSet
from sassgis.model.results import PASSAGE_DTYPE, ROCK_DTYPE, ControlLine, StopReason
from sassgis.model.settings import EngineSettings, LateralDeflection
from sassgis.runs.interrupts import held_back
from sassgis.terrain.fall_lines import FallLineSettings, fall_line_surface
from sassgis.terrain.flatten import chainage_to_xy, crossings, profiles
from sassgis.terrain.release import release_points, take
from sassgis.terrain.spread import SpreadSettings, trace_bundles, trace_ways
from sassgis.terrain.stretch import (
    SHORTEST_LINE_M,
    moved_uphill,
    take_lines,
    take_profiles,
    usable,
    with_lead_in,
)
from sassgis.terrain.surface import Surface

CHUNK_POINTS = 32
#: Plan length of the ground behind the start (m).
LEAD_IN_M = 20.0
_SIMPLIFIED = 0.1


@dataclass(frozen=True, slots=True)
class MapRun:
    """Everything that a run on the map needs.

    Attributes
    ----------
    grid : Grid
    ground : int32, shape of the grid
        Ground class of each cell.
    table : GroundTable
    areas : tuple of ReleaseArea
    blocks : tuple of BlockPopulation
        Names are those of the scenarios.
    gates : tuple of (Gate, float64 array of shape (k, 2))
        Stations and barriers with their course on the map.
    engine : EngineSettings
    fall_lines : FallLineSettings
    spread : SpreadSettings
    segment_tolerance_m, spacing_m : float
    placement : {"grid", "random"}
    rocks_per_point, seed : int
    stop_points_max : int
        Most stop points to keep one by one.
    rounds : int
        How often ``rocks_per_point`` rocks are let go; the rocks of the first rounds stay the same
        when there are more.
    thresholds_kj : tuple of float
        Energies that hazard curves must have a value for.
    objects : ObjectCells
        Exposed objects at which rocks are counted.
    ref_width_m : float
        Reference width of the hazard curves (m); 0: one cell.
    effects : EffectSettings
        What the model of 1986 leaves out.
    forest : Forest or None
        For the effect of trees.
    """

    grid: Grid
    ground: NDArray[np.int32]
    table: GroundTable
    areas: tuple[ReleaseArea, ...]
    blocks: tuple[BlockPopulation, ...]
    control_lines: tuple[tuple[ControlLine, FloatArray], ...]
    engine: EngineSettings
    fall_lines: FallLineSettings
    spread: SpreadSettings
    segment_tolerance_m: float
    spacing_m: float
    placement: str
    rocks_per_point: int
    seed: int
    stop_points_max: int = 100_000
    rounds: int = 1
    thresholds_kj: tuple[float, ...] = ()
    objects: ObjectCells = field(default_factory=ObjectCells.none)
    ref_width_m: float = 0.0
    effects: EffectSettings = field(default_factory=EffectSettings)
    forest: Forest | None = None

    @property
    def rocks_per_line(self) -> int:
        """Rocks on each line of a bundle: those of the point, shared out and rounded up."""
        return -(-self.rocks_per_point // self.lines_per_point)

    @property
    def lines_per_point(self) -> int:
        """Lines traced from each release point in each round."""
        # Rocks that share a way come or stay away together: their errors would be understated.
        if self.effects.get(LateralDeflection) is not None:
            return self.rocks_per_point
        return self.spread.lines_per_point

    @property
    def lateral_spread(self) -> str:
        """In words: how rocks leave the fall line."""
        lateral = self.effects.get(LateralDeflection)
        if lateral is not None:
            how = (
                f"{lateral.angle_deg:g}° off the descent, anew every {lateral.hop_m:g} m or so"
                if lateral.form == "kicks"
                else f"a deviation of its own within {lateral.width_percent:g} % of the length"
            )
            return f"{self.lines_per_point} random ways per release point: {how}"
        if self.lines_per_point == 1:
            return "none: fall lines only; between lines that diverge the map has gaps"
        return (
            f"{self.lines_per_point} lines per release point, heading evenly over a width of "
            f"{self.spread.width_percent:g} % of their length; gullies hold them together"
        )

    @property
    def rocks_per_stratum(self) -> int:
        """Rocks of one stratum of the sample: of a line, or of a point where ways are random."""
        if self.effects.get(LateralDeflection) is None:
            return self.rocks_per_line
        return self.rocks_per_line * self.lines_per_point

    @property
    def window(self) -> Window | None:
        """The cells in which a rock counts for the hazard at the one in their middle."""
        radius = 0.5 * self.ref_width_m / self.grid.cell_size
        return Window(*self.grid.shape, radius) if radius >= 1.0 else None


@dataclass(frozen=True, slots=True)
class Plan:
    """What will be simulated, before anything is.

    Attributes
    ----------
    points : ReleasePoints
        As placed in the release areas.
    starts : ReleasePoints
        Where their fall lines begin.
    moved : float64, shape (n,)
        How far up the slope from the points (m).
    surface : Surface
    scenarios : tuple of int tuples
        Positions in ``blocks`` of the scenarios of each area.
    rounds : tuple of int
        Rounds of rocks of each area, where they are not those of the run for all; else empty.
    """

    points: ReleasePoints
    starts: ReleasePoints
    moved: FloatArray
    surface: Surface
    scenarios: tuple[tuple[int, ...], ...]
    rounds: tuple[int, ...] = ()

    def rocks_of_point(self, run: MapRun) -> IntArray:
        """Rocks that are released at each point, shape (n,)."""
        per_round = run.rocks_per_line * run.lines_per_point
        rounds = np.array(self.rounds or (run.rounds,) * len(self.scenarios), np.int64)
        counts = rounds * np.array([len(s) for s in self.scenarios], np.int64)
        rocks: IntArray = counts[self.points.area] * per_round
        return rocks


def plan(run: MapRun) -> Plan:
    """Place the release points and prepare the surface.

    Raises
    ------
    InputError, ConfigError
        As sassgis.terrain.release.release_points.
    """
    points = release_points(
        [(a.name, a.geometry) for a in run.areas],
        run.spacing_m,
        run.placement,  # type: ignore[arg-type]
        run.seed,
    )
    surface = fall_line_surface(run.grid, run.fall_lines)
    polygonal = np.array([a.geometry.area > 0.0 for a in run.areas], bool)
    distance = 0.5 * run.spacing_m if run.placement == "grid" else 0.0
    starts, moved = moved_uphill(points, surface, distance, polygonal[points.area])
    names = {b.name: i for i, b in enumerate(run.blocks)}
    return Plan(
        points,
        starts,
        moved,
        surface,
        tuple(tuple(names[s] for s in a.scenarios) for a in run.areas),
    )


@dataclass(frozen=True, slots=True)
class Rows:
    """Rocks and passages one by one, with their place on the map.

    Attributes
    ----------
    rocks, passages : structured arrays
        ROCK_DTYPE and PASSAGE_DTYPE. ``line`` counts the lines of the run: release point times
        lines per point, plus the place in the bundle.
    rock_scenario, passage_scenario : int64
        Position in ``blocks``.
    x, y : float64
        Where each rock ends (m).
    """

    rocks: NDArray[np.void]
    rock_scenario: IntArray
    x: FloatArray
    y: FloatArray
    passages: NDArray[np.void]
    passage_scenario: IntArray


@dataclass(frozen=True, slots=True)
class FallLines:
    """Fall lines for the map: ragged coordinates, thinned, and a row each.

    Attributes
    ----------
    offset, x, y
        Line ``i`` owns ``[offset[i], offset[i + 1])``.
    point : int64
        Release point.
    fan, length_m, drop_m : float64
    end : uint8
        A LineEnd.
    """

    offset: IntArray
    x: FloatArray
    y: FloatArray
    point: IntArray
    fan: FloatArray
    length_m: FloatArray
    drop_m: FloatArray
    end: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Chunk:
    """Release points of one area, worked on together in one round."""

    points: IntArray
    round: int


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What one chunk gave: of each block scenario, by its position in ``blocks``."""

    area: int
    sums: dict[int, Simulated]
    rows: Rows
    lines: FallLines
    lost: int


def line_draw_keys(
    traces: TraceSet, point_keys: NDArray[np.uint64], lines_per_point: int, scenario: str
) -> NDArray[np.uint64]:
    """Identity of lines for the random draws: release point, place in the bundle, scenario."""
    member = np.arange(len(traces), dtype=np.int64) % lines_per_point
    out: NDArray[np.uint64] = rng.combined(
        rng.combined(point_keys[traces.point], member), scenario_word(scenario)
    )
    return out


def scenario_word(name: str) -> np.uint64:
    """A number that stands for a scenario's name in the random draws."""
    return np.uint64(int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little"))


def control_line_crossings(run: MapRun, traces: TraceSet) -> ControlLineCrossings:
    """Where lines cross the stations and barriers of a run."""
    found = [crossings(traces, course) for _, course in run.control_lines]
    line = np.concatenate([np.empty(0, np.int64), *(f[0] for f in found)])
    chainage = np.concatenate([np.empty(0), *(f[1] for f in found)])
    control_line = np.repeat(np.arange(len(found), dtype=np.int64), [f[0].size for f in found])
    order = np.lexsort((control_line, chainage, line))
    counts = np.bincount(line, minlength=len(traces)).astype(np.int64)
    return ControlLineCrossings(
        tuple(g for g, _ in run.control_lines),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        chainage[order],
        control_line[order],
    )


def _thinned(traces: TraceSet, run: MapRun) -> FallLines:
    """Coordinates for drawing, within a tenth of a cell of the traced ones."""
    counts = np.diff(traces.offset)
    some = counts >= 2
    index = np.repeat(np.arange(len(traces)), counts)
    kept = some[index]
    lines = shapely.simplify(
        shapely.linestrings(
            traces.x[kept], traces.y[kept], indices=np.cumsum(some)[index[kept]] - 1
        ),
        _SIMPLIFIED * run.grid.cell_size,
        preserve_topology=False,
    )
    xy, owner = shapely.get_coordinates(lines, return_index=True)
    owner = np.flatnonzero(some)[owner]
    # Lines of one point stay as they are.
    single = ~kept
    xy = np.concatenate([xy, np.column_stack([traces.x[single], traces.y[single]])])
    owner = np.concatenate([owner, index[single]])
    order = np.argsort(owner, kind="stable")
    xy, owner = xy[order], owner[order]
    offset = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(traces)))])
    first, final = traces.offset[:-1], np.maximum(traces.offset[1:] - 1, 0)
    heights = run.grid.values.ravel()
    cells = [run.grid.cell_of(traces.x[k], traces.y[k]) for k in (first, final)]
    known = (cells[0] >= 0) & (cells[1] >= 0)
    drop = np.where(known, heights[cells[0]] - heights[cells[1]], 0.0)
    last = traces.s[np.maximum(traces.offset[1:] - 1, 0)]
    return FallLines(
        offset.astype(np.int64),
        np.ascontiguousarray(xy[:, 0]),
        np.ascontiguousarray(xy[:, 1]),
        traces.point,
        traces.fan,
        np.where(counts >= 1, last, 0.0),
        np.nan_to_num(drop),
        traces.end,
    )


def trace_lines(run: MapRun, surface: Surface, starts: ReleasePoints, round_: int) -> TraceSet:
    """The lines of some release points in one round."""
    lateral = run.effects.get(LateralDeflection)
    if lateral is None:
        return trace_bundles(run.grid, surface, starts, run.fall_lines, run.spread)
    return trace_ways(
        run.grid, surface, starts, run.fall_lines, lateral, run.lines_per_point, run.seed, round_
    )


def _first_of_each(lines: FallLines, per_point: int) -> FallLines:
    """The first of the lines of each release point, for drawing."""
    keep = np.arange(lines.point.size) % per_point == 0
    sizes = np.diff(lines.offset)
    kept = np.repeat(keep, sizes)
    return FallLines(
        np.concatenate([[0], np.cumsum(sizes[keep])]).astype(np.int64),
        lines.x[kept], lines.y[kept],
        *(getattr(lines, f)[keep] for f in ("point", "fan", "length_m", "drop_m", "end")),
    )  # fmt: skip


def _work(run: MapRun, planned: Plan, chunk: Chunk, bins: Bins) -> _Outcome:
    """One chunk."""
    which = chunk.points
    m = run.lines_per_point
    starts = take(planned.starts, which)
    traces = trace_lines(run, planned.surface, starts, chunk.round)
    flat = profiles(run.grid, traces, run.ground, run.segment_tolerance_m)
    good = usable(traces, SHORTEST_LINE_M) & (np.diff(flat.offset) >= 2)
    drawn = _thinned(traces, run)
    number = which[traces.point] * m + np.arange(len(traces)) % m
    area = int(starts.area[0])
    moved = planned.moved[which][traces.point]
    scenarios = planned.scenarios[area]
    lost = int((~good).sum()) * run.rocks_per_line * len(scenarios)

    sums: dict[int, Simulated] = {}
    parts: list[Rows] = []
    lines = take_lines(traces, good)
    ahead = with_lead_in(take_profiles(flat, good), LEAD_IN_M)
    last = ahead.s[ahead.offset[1:] - 1]
    start = np.column_stack([np.zeros(len(lines)), np.minimum(2.0 * moved[good], last)])
    crossed = control_line_crossings(run, lines)
    for k in scenarios if len(lines) else ():
        blocks = run.blocks[k]
        result = simulate(
            ahead,
            run.table,
            blocks,
            run.engine,
            seed=run.seed,
            rocks_per_line=run.rocks_per_line,
            line_keys=line_draw_keys(traces, starts.key, m, blocks.name)[good],
            starts=start,
            control_lines=crossed,
            objects=run.objects,
            window=run.window,
            line_numbers=number[good],
            strata=None if run.effects.get(LateralDeflection) is None else lines.point,
            effects=run.effects,
            forest=run.forest,
            first_rock=chunk.round * run.rocks_per_line,
            bins=bins,
        )
        ended = np.concatenate([result.rocks, result.pieces])
        local = np.searchsorted(number[good], ended["line"]).astype(np.int64)
        x, y = chainage_to_xy(lines, local, np.clip(ended["runout_m"], 0.0, last[local]))
        sums[k] = result
        parts.append(
            Rows(
                ended, np.full(ended.size, k, np.int64), x, y,
                result.passages, np.full(result.passages.size, k, np.int64),
            )
        )  # fmt: skip
    if run.effects.get(LateralDeflection) is not None:
        drawn = _first_of_each(drawn, m)
        return _Outcome(
            area, sums, joined_rows(parts), replace(drawn, point=which[drawn.point]), lost
        )
    drawn = FallLines(
        drawn.offset, drawn.x, drawn.y, which[traces.point], drawn.fan, drawn.length_m,
        drawn.drop_m, drawn.end,
    )  # fmt: skip
    return _Outcome(area, sums, joined_rows(parts), drawn, lost)


@dataclass
class SourceTally:
    """What has been added up of one source: a block scenario of a release area.

    Attributes
    ----------
    cells, objects : SourceSums
        Places are flat indices of cells and numbers of objects. A rock counts for a cell if it
        comes within half the reference width of its centre.
    gates : GateSums
    rocks : int
        Rocks followed.
    """

    cells: SourceSums
    objects: SourceSums
    control_lines: ControlLineSums
    rocks: int = 0

    @classmethod
    def fresh(cls, run: MapRun) -> SourceTally:
        """Nothing added yet."""
        n = bins_of(run).threshold.size
        return cls(
            SourceSums(n), SourceSums(n), ControlLineSums(tuple(g for g, _ in run.control_lines))
        )

    def add(self, result: Simulated) -> None:
        """Add the rocks of a chunk."""
        if result.windows.size:
            self.cells.add(result.windows, *result.window_sums.values())
        else:
            exceed = (result.sums[n].astype(np.int64) for n in ("exceed", "exceed_square"))
            self.cells.add(result.cells, *exceed)
        numbers = np.arange(result.objects["exceed"].shape[0], dtype=np.int64)
        self.objects.add(numbers, result.objects["exceed"], result.objects["exceed_square"])
        self.control_lines.add(result.passages)
        self.rocks += result.rocks.size


@dataclass
class Progress:
    """What has been added up so far; grows chunk by chunk, in their order.

    Attributes
    ----------
    chunks : int
        Chunks added.
    sums : MapSums
    gates : GateSums
    reasons : int64, shape (len(StopReason),)
        Rocks by the reason of their end.
    lost : int
        Rocks of lines that could not be followed.
    runout : int64, shape (n_bins,)
        Rocks by run-out chainage, in metres.
    lines : list of FallLines
    stops : list of Rows
        The rocks whose stop is kept one by one; kept_stops joins them.
    furthest : (run-out, line, scenario, rock) or None
        The rock with the longest run-out of all (m).
    sources : dict of (area, scenario) to SourceTally
        By position in ``areas`` and ``blocks``.
    pieces : int
        Pieces of broken rocks and blocks set in motion.
    """

    chunks: int
    sums: MapSums
    control_lines: ControlLineSums
    reasons: IntArray = field(default_factory=lambda: np.zeros(len(StopReason), np.int64))
    lost: int = 0
    runout: IntArray = field(default_factory=lambda: np.zeros((len(StopReason), 0), np.int64))
    lines: list[FallLines] = field(default_factory=list)
    stops: list[Rows] = field(default_factory=list)
    furthest: tuple[float, int, int, int] | None = None
    sources: dict[tuple[int, int], SourceTally] = field(default_factory=dict)
    pieces: int = 0

    @classmethod
    def fresh(cls, run: MapRun) -> Progress:
        """Nothing added yet."""
        n_rows, n_cols = run.grid.shape
        return cls(
            0, MapSums(n_rows * n_cols), ControlLineSums(tuple(g for g, _ in run.control_lines))
        )


def evenly_kept(rows: Rows, seed: int, share: float) -> Rows:
    """A share of the rocks, chosen by the identity of each; smaller shares are parts of larger."""
    if share >= 1.0:
        return _rocks_alone(rows, np.ones(rows.rocks.size, bool))
    return _rocks_alone(rows, _lots(rows, seed).astype(np.float64) < share * 2.0**64)


def _lots(rows: Rows, seed: int) -> NDArray[np.uint64]:
    """A number for each rock, drawn from its identity."""
    lots: NDArray[np.uint64] = rng.combined(
        rng.combined(
            rng.combined(rows.rocks["line"].astype(np.uint64), rows.rocks["rock"]),
            rows.rocks["piece"],
        ),
        np.full(rows.rocks.size, seed % 2**63) + rows.rock_scenario,
    )
    return lots


def _rocks_alone(rows: Rows, which: NDArray[np.generic]) -> Rows:
    return Rows(
        rows.rocks[which], rows.rock_scenario[which], rows.x[which], rows.y[which],
        rows.passages[:0], rows.passage_scenario[:0],
    )  # fmt: skip


def joined_rows(parts: list[Rows]) -> Rows:
    """Rows of several chunks as one."""
    return Rows(
        np.concatenate([np.empty(0, ROCK_DTYPE), *(p.rocks for p in parts)]),
        np.concatenate([np.empty(0, np.int64), *(p.rock_scenario for p in parts)]),
        np.concatenate([np.empty(0), *(p.x for p in parts)]),
        np.concatenate([np.empty(0), *(p.y for p in parts)]),
        np.concatenate([np.empty(0, PASSAGE_DTYPE), *(p.passages for p in parts)]),
        np.concatenate([np.empty(0, np.int64), *(p.passage_scenario for p in parts)]),
    )


def kept_stops(run: MapRun, progress: Progress) -> Rows:
    """The rocks that are kept one by one, ``stop_points_max`` at most, round by round."""
    rows = joined_rows(progress.stops)
    # A run has them in this order; the sums of several areas were added up area by area.
    round_ = rows.rocks["rock"] // run.rocks_per_line
    rows = _rocks_alone(rows, np.argsort(round_, kind="stable"))
    if rows.rocks.size <= run.stop_points_max:
        return rows
    # The share that is kept is right on average only.
    order = np.argsort(_lots(rows, run.seed), kind="stable")
    return _rocks_alone(rows, np.sort(order[: run.stop_points_max]))


def _furthest(rows: Rows) -> tuple[float, int, int, int]:
    """The longest run-out and whose it is; the first in the order of the run among equals."""
    rows = _rocks_alone(rows, rows.rocks["piece"] == 0)
    reach = rows.rocks["runout_m"]
    line, rock, scenario = rows.rocks["line"], rows.rocks["rock"], rows.rock_scenario
    i = np.lexsort((rock, scenario, line, -reach))[0]
    return float(reach[i]), int(line[i]), int(scenario[i]), int(rock[i])


def _add(progress: Progress, outcome: _Outcome, run: MapRun, share: float, first: bool) -> None:
    for scenario, result in outcome.sums.items():
        progress.sums.add(result.cells, result.sums)
        progress.control_lines.add(result.passages)
        source = (outcome.area, scenario)
        if source not in progress.sources:
            progress.sources[source] = SourceTally.fresh(run)
        progress.sources[source].add(result)
    # A piece of a broken rock, or a block that was set in motion, is no rock that was let go.
    let_go = outcome.rows.rocks["piece"] == 0
    progress.pieces += int((~let_go).sum())
    reasons = outcome.rows.rocks["reason"][let_go]
    progress.reasons += np.bincount(reasons, minlength=len(StopReason))
    progress.lost += outcome.lost
    if reasons.size:
        metres = np.maximum(outcome.rows.rocks["runout_m"][let_go], 0.0).astype(np.int64)
        width = max(int(metres.max()) + 1, progress.runout.shape[1])
        grown = np.zeros((len(StopReason), width), np.int64)
        grown[:, : progress.runout.shape[1]] = progress.runout
        np.add.at(grown, (reasons, metres), 1)
        progress.runout = grown
        longest = _furthest(outcome.rows)
        if progress.furthest is None or longest[0] > progress.furthest[0]:
            progress.furthest = longest
    if first:
        progress.lines.append(outcome.lines)
    progress.stops.append(evenly_kept(outcome.rows, run.seed, share))
    progress.chunks += 1


def chunks_of(planned: Plan, size: int = CHUNK_POINTS, rounds: int = 1) -> list[Chunk]:
    """The chunks of a plan, round by round; a chunk holds points of one release area only."""
    chunks = []
    area = planned.points.area
    starts = np.flatnonzero(np.diff(area, prepend=-1)) if area.size else np.empty(0, np.int64)
    for begin, end in zip(starts, [*starts[1:], area.size], strict=True):
        for i in range(begin, end, size):
            chunks.append(np.arange(i, min(i + size, end), dtype=np.int64))
    return [Chunk(points, r) for r in range(rounds) for points in chunks]


def _in_order(
    work: Callable[[Chunk], _Outcome], chunks: list[Chunk], jobs: int
) -> Generator[_Outcome, None, None]:
    """Results of ``work`` in the order of the chunks, a few of them under way at a time.

    Never in the calling thread: Ctrl-C would strike within compiled code, which turns it into a
    SystemError.
    """
    with ThreadPoolExecutor(jobs) as pool:
        waiting: deque[Future[_Outcome]] = deque()
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


def bins_of(run: MapRun) -> Bins:
    """Histogram bins wide enough for what can happen on this terrain."""
    relief = float(np.nanmax(run.grid.values) - np.nanmin(run.grid.values))
    g = run.engine.gravity_mps2
    drop = relief + max(b.drop_m[1] for b in run.blocks)
    speed = max(b.speed_mps[1] for b in run.blocks)
    mass = max(b.largest_mass_kg for b in run.blocks)
    energy = 1e-3 * mass * (g * drop + 0.5 * speed * speed)
    fastest = float(np.sqrt(2.0 * g * drop + speed * speed))
    return default_bins(
        2.0 * energy, min(drop, 300.0), min(fastest, 150.0), tuple(run.thresholds_kj)
    )


def simulate_map(
    run: MapRun,
    planned: Plan,
    *,
    jobs: int = 1,
    resume: Progress | None = None,
    on_chunk: Callable[[Progress, int, Rows], None] | None = None,
    chunk_points: int = CHUNK_POINTS,
) -> Progress:
    """Simulate all rocks of a plan.

    Parameters
    ----------
    run : MapRun
    planned : Plan
        Of the same run.
    jobs : int
        Threads.
    resume : Progress, optional
        Of an earlier call with the same run and chunk size, interrupted or with fewer rounds; grows
        further.
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
    chunks = chunks_of(planned, chunk_points, run.rounds)
    total = int(planned.rocks_of_point(run).sum()) // run.rounds
    share = run.stop_points_max / total if total else 1.0

    def work(chunk: Chunk) -> _Outcome:
        return _work(run, planned, chunk, bins)

    with closing(_in_order(work, chunks[progress.chunks :], jobs)) as outcomes:
        for outcome in outcomes:
            with held_back():
                _add(progress, outcome, run, share, chunks[progress.chunks].round == 0)
                if on_chunk is not None:
                    on_chunk(progress, len(chunks), outcome.rows)
    return progress


def sample_of(run: MapRun, planned: Plan, progress: Progress) -> Sample:
    """The sample behind the maps: rocks that were followed."""
    return Sample(
        rocks=int(progress.reasons.sum()),
        rocks_per_line=run.rocks_per_stratum,
        lines=int(progress.reasons.sum()) // run.rocks_per_stratum,
        random_points=run.placement == "random",
    )


def line_ends(progress: Progress) -> dict[LineEnd, int]:
    """How many fall lines end for which reason."""
    ends = np.concatenate([np.empty(0, np.uint8), *(f.end for f in progress.lines)])
    return {e: int((ends == e).sum()) for e in LineEnd}
