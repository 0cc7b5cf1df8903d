"""Sums of a run on the map, in all and by source, and how the result of a chunk is added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled import rng
from sassgis.compiled.jit import kernel
from sassgis.engine.simulate import Simulated
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.hazard_rules import SourceCounts
from sassgis.settings.map_run import BlockRows, FallLines, MapRun, Round, Worth
from sassgis.settings.results import (
    PASSAGE_DTYPE,
    ROCK_DTYPE,
    ControlLine,
    LineEnd,
    StopReason,
)
from sassgis.settings.statistics_table import SUM_NAMES, bins_of
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.map_sums import MapSums, Sample, weighted_counts, weighted_sums

#: Type of counts as long as none can be too large for it.
_FEW = np.int32
_Counts = NDArray[np.signedinteger[Any]]
#: Side of a tile (cells).
_TILE = 4


class SourceSums:
    """Growing counts, or differences of counts; memory grows with the places that are reached."""

    def __init__(self, n_energies: int) -> None:
        self.n_energies = n_energies
        # Places that were reached, ascending, and the row of each in the counts. New places get the
        # rows that follow, so that no count is moved for them.
        self._places: IntArray = np.empty(0, np.int64)
        self._row: IntArray = np.empty(0, np.int64)
        self._count: _Counts = np.zeros((0, n_energies), _FEW)
        self._square: _Counts = np.zeros((0, n_energies), _FEW)
        self._most = 0  # no number is larger
        self._handed_out = False  # whether counts of others are the same arrays

    def add(self, places: IntArray, count: IntArray, square: IntArray) -> None:
        """Add counts of some places, each of which is named once; all as in SourceCounts."""
        reached = np.flatnonzero(count.any(axis=1) | square.any(axis=1))
        at, known = self._found(places[reached])
        if not known.all():
            self._grow(np.sort(places[reached[~known]]))
            at, _ = self._found(places[reached])
        if self._handed_out:
            self._count, self._square = self._count.copy(), self._square.copy()
            self._handed_out = False
        self._widen_for(max(_largest(count), _largest(square)))
        _add_rows(self._count, self._square, self._row[at], count, square, reached)

    def _widen_for(self, more: int) -> None:
        """Widen the type of the counts where it may not hold them and so much more."""
        limit = np.iinfo(_FEW).max
        if self._count.dtype == _FEW and self._most + more > limit:
            self._most = max(_largest(self._count), _largest(self._square))
            if self._most + more > limit // 2:
                self._count = self._count.astype(np.int64)
                self._square = self._square.astype(np.int64)
        self._most += more

    def _found(self, places: IntArray) -> tuple[IntArray, NDArray[np.bool_]]:
        """Find where among the places some are or would be, and whether they are there."""
        at = np.searchsorted(self._places, places)
        known = at < self._places.size
        known[known] = self._places[at[known]] == places[known]
        return at, known

    def _grow(self, fresh: IntArray) -> None:
        """Make room for places that were not reached before, ascending."""
        used = self._places.size
        at = np.searchsorted(self._places, fresh)
        self._places = np.insert(self._places, at, fresh)
        self._row = np.insert(self._row, at, np.arange(used, used + fresh.size))
        if self._places.size > self._count.shape[0]:
            room = max(self._places.size, int(1.5 * self._count.shape[0]))
            for name in ("_count", "_square"):
                # Zeros that nobody has written to take no memory.
                own = getattr(self, name)
                larger = np.zeros((room, self.n_energies), own.dtype)
                larger[:used] = own[:used]
                setattr(self, name, larger)

    def counts(self) -> SourceCounts:
        """Return the counts added so far; they take no further memory until there are more."""
        if not self._handed_out:
            self._count, self._square = self._count[self._row], self._square[self._row]
            self._row = np.arange(self._row.size)
            self._handed_out = True
        return SourceCounts(self._places, self._count, self._square)

    def plus(self, differences: SourceSums) -> SourceSums:
        """Return these counts and their differences from others: the others."""
        if not differences._places.size:
            return self
        out = SourceSums(self.n_energies)
        for own in (self.counts(), differences.counts()):
            out.add(own.places, own.count, own.square)
        some = np.flatnonzero(out._count[out._row, 0] > 0)
        out._places, out._row = out._places[some], out._row[some]
        return out

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the state needed to go on later, as plain arrays."""
        counts = self.counts()
        return {"places": counts.places, "count": counts.count, "square": counts.square}

    @classmethod
    def from_state(cls, state: Mapping[str, NDArray[Any]]) -> SourceSums:
        """Return the counts that ``state`` returned."""
        sums = cls(int(state["count"].shape[1]))
        sums.add(*(np.asarray(state[n], np.int64) for n in ("places", "count", "square")))
        return sums


def _largest(counts: _Counts) -> int:
    return int(max(counts.max(initial=0), -counts.min(initial=0)))


@kernel
def _add_rows(
    to_count: _Counts,
    to_square: _Counts,
    row: IntArray,
    count: IntArray,
    square: IntArray,
    which: IntArray,
) -> None:
    """Add some rows of counts to rows of others."""
    for k in range(which.size):
        for i in range(count.shape[1]):
            to_count[row[k], i] += count[which[k], i]
            to_square[row[k], i] += square[which[k], i]


@dataclass(frozen=True, slots=True)
class ChunkResult:
    """Result of one chunk."""

    area: int  # position of its release area
    # Shape (n,); release point of each repetition; a point may occur several times.
    points: IntArray
    weight: int  # how many times each of its blocks counts
    sums: dict[int, Simulated]  # by the position of the block scenario in ``blocks``
    rows: BlockRows
    lines: FallLines  # of the first repetition; else none
    lost: int  # blocks of lines that are too short to be simulated on


def as_stations(lines: Sequence[ControlLine]) -> tuple[ControlLine, ...]:
    """Return control lines as stations, as blocks pass them without barriers."""
    return tuple(replace(line, kind="station") for line in lines)


@dataclass
class WithoutBarriers:
    """Sums of the blocks of a source without barriers."""

    # By how much counts exceed those with barriers.
    cells: SourceSums
    objects: SourceSums
    control_lines: ControlLineSums
    never_started: int = 0  # as in SourceTally

    @classmethod
    def fresh(cls, n_energies: int, lines: Sequence[ControlLine]) -> WithoutBarriers:
        """Return nothing added yet; all lines are stations then."""
        at_lines = ControlLineSums(as_stations(lines))
        return cls(SourceSums(n_energies), SourceSums(n_energies), at_lines)

    @classmethod
    def alike(cls, tally: SourceTally) -> WithoutBarriers:
        """Return the sums of a source that meets no barriers."""
        cells, objects = (SourceSums(own.n_energies) for own in (tally.cells, tally.objects))
        return cls(cells, objects, tally.control_lines, tally.never_started)


@dataclass
class SourceTally:
    """Sums of one source: a block scenario of a release area."""

    # Places are flat indices of cells and numbers of objects. A block counts for a cell if it comes
    # within half the reference width of its centre.
    cells: SourceSums
    objects: SourceSums
    control_lines: ControlLineSums
    # Blocks with their weights, and those of them that never started.
    rocks: int = 0
    never_started: int = 0
    simulated: int = 0  # blocks, each once
    heaviest: int = 1  # largest weight of any of them
    without: WithoutBarriers | None = None  # if it is wanted

    @classmethod
    def fresh(cls, run: MapRun) -> SourceTally:
        """Return nothing added yet."""
        n, lines = bins_of(run).threshold.size, [line for line, _ in run.all_lines]
        return cls(
            SourceSums(n), SourceSums(n), ControlLineSums(tuple(lines[: run.compared])),
            without=None if run.compared is None else WithoutBarriers.fresh(n, lines),
        )  # fmt: skip

    def add(
        self, result: Simulated, weight: int = 1, each: int = 1, random_points: bool = False
    ) -> None:
        """Add the blocks of a chunk, which count ``weight`` times; ``each`` are of one stratum."""

        def counts(sums: Mapping[str, NDArray[Any]]) -> tuple[IntArray, IntArray]:
            count, square = (np.asarray(sums[n], np.int64) for n in ("exceed", "exceed_square"))
            return weighted_counts(count, square, weight, each)

        if result.windows.size:
            self.cells.add(result.windows, *counts(result.window_sums))
        else:
            self.cells.add(result.cells, *counts(result.kept))
        numbers = np.arange(result.objects["exceed"].shape[0], dtype=np.int64)
        self.objects.add(numbers, *counts(result.objects))
        self.control_lines.add(result.passages, weight, random_points)
        if self.without is not None and (other := result.without) is not None:
            self.without.cells.add(other.places, *counts(other.differences))
            self.without.objects.add(numbers, *counts(other.objects))
            self.without.control_lines.add(other.passages, weight, random_points)
            self.without.never_started += weight * other.never_started
        idle = int((result.rocks["reason"] == StopReason.NEVER_STARTED).sum())
        self.simulated += result.rocks.size
        self.rocks += weight * result.rocks.size
        self.never_started += weight * idle
        self.heaviest = max(self.heaviest, weight)

    def without_barriers(self) -> SourceTally:
        """Return the sums of the same blocks without barriers; these sums if they are the same."""
        if self.without is None:
            return self
        return replace(
            self,
            cells=self.cells.plus(self.without.cells),
            objects=self.objects.plus(self.without.objects),
            control_lines=self.without.control_lines,
            never_started=self.without.never_started,
            without=None,
        )


@dataclass
class Progress:
    """Sums so far; they grow chunk by chunk, in their order."""

    chunks: int  # added
    sums: MapSums
    control_lines: ControlLineSums
    # Shape (len(StopReason),); blocks by the reason of their end, with their weights.
    reasons: IntArray = field(default_factory=lambda: np.zeros(len(StopReason), np.int64))
    lost: int = 0  # blocks of lines that are too short to be simulated on
    # Shape (len(StopReason), n_bins); blocks by the reason of their end and by run-out chainage, in
    # metres, with their weights.
    runout: IntArray = field(default_factory=lambda: np.zeros((len(StopReason), 0), np.int64))
    lines: list[FallLines] = field(default_factory=list)
    # The blocks whose stop is kept one by one; kept_stops joins them.
    stops: list[BlockRows] = field(default_factory=list)
    # Run-out (m), line, scenario and block of the one with the longest run-out of all.
    furthest: tuple[float, int, int, int] | None = None
    # By position of area and scenario in ``areas`` and ``blocks``.
    sources: dict[tuple[int, int], SourceTally] = field(default_factory=dict)
    pieces: int = 0  # fragments and entrained blocks
    simulated: int = 0  # blocks, each once
    stop_share: float = 1.0  # of all blocks that they are
    rounds: tuple[Round, ...] = (Round(),)  # what the chunks are of
    seconds: float = 0.0  # for which blocks have been simulated
    worth: Worth | None = None  # of places, for which the present repetition fills ``scores``
    # Shape (n_points, n_scenarios); uncertainty that the blocks of the repetition leave, weighted
    # by the worth of the places.
    scores: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    # After each repetition: blocks that were simulated, and the share of the zoned area whose level
    # another sample would change.
    history: list[tuple[int, float]] = field(default_factory=list)
    # Separate sums of the release areas, by position. Except for the sources, they are added to the
    # sums here by join_parts. None if they are not wanted.
    parts: dict[int, Progress] | None = None
    # By chunk, the tiles of the grid that blocks came to, with barriers or without; of parts that
    # are compared without.
    tiles: list[IntArray] = field(default_factory=list)
    # Areas whose blocks are taken from an earlier result, except for passages without barriers at
    # ``new_lines``: chunks of these areas that may come there, by area and number.
    reused: tuple[int, ...] = ()
    recounted: frozenset[tuple[int, int]] = frozenset()
    new_lines: tuple[int, ...] = ()

    @property
    def compared(self) -> bool:
        """Return whether there are sums of the same blocks without barriers."""
        return any(tally.without is not None for tally in self.sources.values())

    @property
    def lost_share(self) -> float:
        """Return the share of started blocks that left the terrain model or their fall line."""
        started = int(self.reasons.sum() - self.reasons[StopReason.NEVER_STARTED])
        return float(self.reasons[StopReason.LEFT_PROFILE]) / max(started, 1)

    @property
    def started_runout(self) -> IntArray:
        """Return blocks that started, by run-out in whole metres, with their weights."""
        counts: IntArray = np.delete(self.runout, StopReason.NEVER_STARTED, axis=0).sum(axis=0)
        return counts

    def runout_m(self, *shares: float) -> tuple[int, ...]:
        """Return whole metres within which shares of the blocks that started stop; 0 without."""
        return within_metres(self.started_runout, *shares)

    @classmethod
    def fresh(cls, run: MapRun, *, apart: bool = False) -> Progress:
        """Return nothing added yet; ``apart``: sums of the release areas are kept apart."""
        n_rows, n_cols = run.grid.shape
        return cls(
            0, MapSums(n_rows * n_cols), ControlLineSums(tuple(g for g, _ in run.control_lines)),
            stop_share=1.0 if run.stop_points_max else 0.0, rounds=run.rounds,
            parts={} if apart else None,
        )  # fmt: skip


def within_metres(counts: IntArray, *shares: float) -> tuple[int, ...]:
    """Return whole metres within which shares of blocks stop, of counts by metre; 0 without."""
    below = np.cumsum(counts)
    if not below.size or not below[-1]:
        return (0,) * len(shares)
    return tuple(int(np.searchsorted(below, share * below[-1])) + 1 for share in shares)


def add_chunk(progress: Progress, outcome: ChunkResult, run: MapRun) -> None:
    """Add the result of a chunk; chunks are added in their order."""
    if progress.worth is not None:
        for scenario, result in outcome.sums.items():
            np.add.at(progress.scores[:, scenario], outcome.points, result.worth)
    progress.chunks += 1
    own = progress
    if outcome.area in progress.reused:
        _add_passages(progress, outcome, run)
        return
    if progress.parts is not None:
        own = progress.parts.setdefault(outcome.area, Progress.fresh(run))
        progress.simulated -= own.simulated
    _add_sums(own, outcome, run)
    if progress.parts is not None:
        own.tiles.append(_tiles_met(outcome, run.grid))
        progress.simulated += own.simulated
        progress.sources |= own.sources


def _tiles_met(outcome: ChunkResult, grid: Grid) -> IntArray:
    """Return tiles that blocks of a chunk come to, with barriers or without."""
    places = [np.empty(0, np.int64)]
    for own in outcome.sums.values():
        places.append(own.cells[(own.kept["reach"] != 0) | (own.kept["stops"] != 0)])
        if own.without is not None:
            # Of windows, where there are some, which are wider than cells.
            places.append(own.without.places)
    return tiles_of(grid, np.concatenate(places))


def tiles_of(grid: Grid, cells: IntArray) -> IntArray:
    """Return the tiles of the grid that hold some cells, ascending."""
    n_rows, n_cols = grid.shape
    seen = np.zeros((-(-n_rows // _TILE), -(-n_cols // _TILE)), np.bool_)
    row, col = np.divmod(cells, n_cols)
    seen[row // _TILE, col // _TILE] = True
    return np.flatnonzero(seen)


def _add_passages(progress: Progress, outcome: ChunkResult, run: MapRun) -> None:
    """Add passages without barriers at new lines, of a chunk whose other sums are there."""
    for scenario, result in outcome.sums.items():
        without = progress.sources[outcome.area, scenario].without
        if without is not None and result.without is not None:
            passages = result.without.passages
            passages = passages[np.isin(passages["control_line"], progress.new_lines)]
            drawn = run.release.placement == "random"
            without.control_lines.add(passages, outcome.weight, drawn)


def _add_sums(progress: Progress, outcome: ChunkResult, run: MapRun) -> None:
    """Add the sums of a chunk."""
    weight, each = outcome.weight, run.release.rocks_per_point
    for scenario, result in outcome.sums.items():
        kept = weighted_sums(result.kept, weight, each)
        progress.sums.add(result.cells, kept, result.visits, result.n_bins, weight)
        progress.control_lines.add(result.passages, weight)
        source = (outcome.area, scenario)
        if source not in progress.sources:
            progress.sources[source] = SourceTally.fresh(run)
        drawn = run.release.placement == "random"
        progress.sources[source].add(result, weight, each, drawn)
    # Fragments and entrained blocks are no released blocks.
    released = outcome.rows.rocks["piece"] == 0
    progress.pieces += int((~released).sum())
    reasons = outcome.rows.rocks["reason"][released]
    progress.simulated += reasons.size
    progress.reasons += weight * np.bincount(reasons, minlength=len(StopReason))
    progress.lost += outcome.lost
    if reasons.size:
        metres = np.maximum(outcome.rows.rocks["runout_m"][released], 0.0).astype(np.int64)
        width = max(int(metres.max()) + 1, progress.runout.shape[1])
        grown = np.zeros((len(StopReason), width), np.int64)
        grown[:, : progress.runout.shape[1]] = progress.runout
        np.add.at(grown, (reasons, metres), weight)
        progress.runout = grown
        longest = _furthest(outcome.rows)
        if progress.furthest is None or longest[0] > progress.furthest[0]:
            progress.furthest = longest
    if outcome.lines.point.size:
        progress.lines.append(outcome.lines)
    _keep_stops(progress, outcome.rows, run, 1.0 / float(outcome.rows.rock_weight.max(initial=1)))


def join_parts(progress: Progress, run: MapRun) -> None:
    """Add the sums of the release areas, one after the other, and free them."""
    parts, progress.parts = progress.parts or {}, None
    simulated = progress.simulated
    for _, part in sorted(parts.items()):
        if progress.sums.cells.size:
            columns = {name: part.sums.column(name) for name in SUM_NAMES}
            progress.sums.add(part.sums.cells, columns)
        else:
            progress.sums = part.sums
        n = len(progress.control_lines.control_lines)
        progress.control_lines.add_sums(part.control_lines, np.arange(n))
        add_blocks(progress, part)
        _keep_stops(progress, joined_rows(part.stops), run, part.stop_share)
        part.sums = MapSums(0)
    progress.simulated = simulated


def add_blocks(total: Progress, own: Progress, first_point: int = 0) -> None:
    """Add the outcome of the blocks of an area; its release points begin at ``first_point``."""
    total.reasons += own.reasons
    total.simulated += own.simulated
    total.lost += own.lost
    total.pieces += own.pieces
    width = max(total.runout.shape[1], own.runout.shape[1])
    total.runout, more = (
        np.pad(r, ((0, 0), (0, width - r.shape[1]))) for r in (total.runout, own.runout)
    )
    total.runout += more
    total.lines += [replace(lines, point=lines.point + first_point) for lines in own.lines]
    if own.furthest is not None and (total.furthest is None or own.furthest[0] > total.furthest[0]):
        reach, line, scenario, rock = own.furthest
        total.furthest = (reach, line + first_point, scenario, rock)


def _keep_stops(progress: Progress, rows: BlockRows, run: MapRun, most: float) -> None:
    """Keep at most this share of the blocks, less where they become too many."""
    _keep_fewer(progress, run.seed, most)
    progress.stops.append(evenly_kept(rows, run.seed, progress.stop_share))
    while sum(own.rocks.size for own in progress.stops) > 2 * run.stop_points_max:
        _keep_fewer(progress, run.seed, progress.stop_share / 2.0)


def _keep_fewer(progress: Progress, seed: int, share: float) -> None:
    """Keep no more than a share of the blocks."""
    if share < progress.stop_share:
        progress.stop_share = share
        progress.stops = [evenly_kept(joined_rows(progress.stops), seed, share)]


def _furthest(rows: BlockRows) -> tuple[float, int, int, int]:
    """Return the longest run-out and its block; among equals the first in the order of the run."""
    rows = _rocks_alone(rows, rows.rocks["piece"] == 0)
    reach = rows.rocks["runout_m"]
    line, rock, scenario = rows.rocks["line"], rows.rocks["rock"], rows.rock_scenario
    i = np.lexsort((rock, scenario, line, -reach))[0]
    return float(reach[i]), int(line[i]), int(scenario[i]), int(rock[i])


def sample_of(run: MapRun, progress: Progress) -> Sample:
    """Return the sample behind the maps: the simulated blocks that started."""
    return Sample(
        started=int(progress.reasons.sum() - progress.reasons[StopReason.NEVER_STARTED]),
        rocks_per_line=run.release.rocks_per_point,
        lines=int(progress.reasons.sum()) // run.release.rocks_per_point,
        random_points=run.release.placement == "random",
    )


def line_ends(progress: Progress) -> dict[LineEnd, int]:
    """Count the fall lines that end for each reason."""
    ends = np.concatenate([np.empty(0, np.uint8), *(f.end for f in progress.lines)])
    return {e: int((ends == e).sum()) for e in LineEnd}


def joined_rows(parts: list[BlockRows]) -> BlockRows:
    """Return rows of several chunks as one."""
    rocks, passages = np.empty(0, ROCK_DTYPE), np.empty(0, PASSAGE_DTYPE)
    empty = BlockRows.of_chunk(rocks, np.empty(0), np.empty(0), passages, 0, 1)
    names = [f.name for f in fields(BlockRows)]
    return BlockRows(*(np.concatenate([getattr(p, n) for p in (empty, *parts)]) for n in names))


def joined_lines(parts: list[FallLines]) -> FallLines:
    """Return fall lines of several chunks as one."""
    if not parts:
        empty = np.empty(0)
        none = np.empty(0, np.int64)
        return FallLines(
            offset=np.zeros(1, np.int64),
            x=empty,
            y=empty,
            point=none,
            length_m=empty,
            drop_m=empty,
            end=np.empty(0, np.uint8),
        )
    sizes = np.concatenate([np.diff(p.offset) for p in parts])
    return FallLines(
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        *(
            np.concatenate([getattr(p, f) for p in parts])
            for f in ("x", "y", "point", "length_m", "drop_m", "end")
        ),
    )


def evenly_kept(rows: BlockRows, seed: int, share: float) -> BlockRows:
    """Return a share of the blocks, chosen by the identity of each; smaller are parts of larger.

    A block that counts several times is as much more likely to be among them, up to a share of one
    over its weight.
    """
    if share >= 1.0:
        return _rocks_alone(rows, np.ones(rows.rocks.size, bool))
    return _rocks_alone(rows, _lots(rows, seed) < share)


def kept_stops(run: MapRun, progress: Progress) -> BlockRows:
    """Return the blocks that are kept one by one, ``stop_points_max`` at most, by repetition."""
    rows = joined_rows(progress.stops)
    # A run has them in this order; the sums of several areas were added up area by area.
    repetition = rows.rocks["rock"] // run.release.rocks_per_point
    rows = _rocks_alone(rows, np.argsort(repetition, kind="stable"))
    if rows.rocks.size <= run.stop_points_max:
        return rows
    # The share that is kept is right on average only.
    order = np.argsort(_lots(rows, run.seed), kind="stable")
    return _rocks_alone(rows, np.sort(order[: run.stop_points_max]))


def _lots(rows: BlockRows, seed: int) -> FloatArray:
    """Return a number from 0 to 1 for each block, drawn from its identity, over its weight."""
    lots = rng.combined(
        rng.combined(
            rng.combined(rows.rocks["line"].astype(np.uint64), rows.rocks["rock"]),
            rows.rocks["piece"],
        ),
        np.full(rows.rocks.size, seed % 2**63) + rows.rock_scenario,
    )
    return lots.astype(np.float64) / 2.0**64 / rows.rock_weight


def _rocks_alone(rows: BlockRows, which: NDArray[np.generic]) -> BlockRows:
    return BlockRows(
        rocks=rows.rocks[which],
        rock_scenario=rows.rock_scenario[which],
        x=rows.x[which],
        y=rows.y[which],
        passages=rows.passages[:0],
        passage_scenario=rows.passage_scenario[:0],
        rock_weight=rows.rock_weight[which],
        passage_weight=rows.passage_weight[:0],
    )
