"""Sums of a run on the map so far, and how the result of a chunk is added to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled import rng
from sassgis.engine.simulate import Simulated
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.map_run import BlockRows, FallLines, MapRun, Round, Worth
from sassgis.settings.profiles import LineEnd
from sassgis.settings.results import PASSAGE_DTYPE, ROCK_DTYPE, StopReason
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.map_sums import MapSums, Sample, weighted_counts, weighted_sums
from sassgis.simulation.source_sums import SourceSums


@dataclass(frozen=True, slots=True)
class ChunkResult:
    """Result of one chunk."""

    area: int  # position of its release area
    # Shape (n,); release points of which it has a repetition each; some may be there several times.
    points: IntArray
    weight: int  # how many times each of its blocks counts
    sums: dict[int, Simulated]  # by the position of the block scenario in ``blocks``
    rows: BlockRows
    lines: FallLines  # of the first repetition; else none
    lost: int  # blocks of lines that are too short to be simulated on


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

    @classmethod
    def fresh(cls, run: MapRun) -> SourceTally:
        """Return nothing added yet."""
        n = bins_of(run).threshold.size
        return cls(
            SourceSums(n), SourceSums(n), ControlLineSums(tuple(g for g, _ in run.control_lines))
        )

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
        idle = int((result.rocks["reason"] == StopReason.NEVER_STARTED).sum())
        self.simulated += result.rocks.size
        self.rocks += weight * result.rocks.size
        self.never_started += weight * idle
        self.heaviest = max(self.heaviest, weight)


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
    worth: Worth | None = None  # by which the present repetition shows where more blocks would help
    # Shape (n_points, n_scenarios); the worth of what the blocks of a repetition leave open, summed
    # over those of the repetition.
    scores: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    # After each repetition: blocks that were simulated, and the share of the zoned area whose level
    # another sample would change.
    history: list[tuple[int, float]] = field(default_factory=list)

    @property
    def lost_share(self) -> float:
        """Share of the blocks that started which left the terrain model, or their fall line."""
        started = int(self.reasons.sum() - self.reasons[StopReason.NEVER_STARTED])
        return float(self.reasons[StopReason.LEFT_PROFILE]) / max(started, 1)

    @property
    def started_runout(self) -> IntArray:
        """Blocks that started, by run-out in whole metres, with their weights."""
        counts: IntArray = np.delete(self.runout, StopReason.NEVER_STARTED, axis=0).sum(axis=0)
        return counts

    @classmethod
    def fresh(cls, run: MapRun) -> Progress:
        """Return nothing added yet."""
        n_rows, n_cols = run.grid.shape
        return cls(
            0, MapSums(n_rows * n_cols), ControlLineSums(tuple(g for g, _ in run.control_lines)),
            stop_share=1.0 if run.stop_points_max else 0.0, rounds=run.rounds,
        )  # fmt: skip


def add_chunk(progress: Progress, outcome: ChunkResult, run: MapRun) -> None:
    """Add the result of a chunk; chunks are added in their order."""
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
        if progress.worth is not None:
            np.add.at(progress.scores[:, scenario], outcome.points, result.worth)
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
    _keep_stops(progress, outcome.rows, run)
    progress.chunks += 1


def _keep_stops(progress: Progress, rows: BlockRows, run: MapRun) -> None:
    """Keep a share of the blocks: 1/weight at most, and less where they become too many."""
    _keep_fewer(progress, run.seed, 1.0 / float(rows.rock_weight.max(initial=1)))
    progress.stops.append(evenly_kept(rows, run.seed, progress.stop_share))
    while sum(own.rocks.size for own in progress.stops) > 2 * run.stop_points_max:
        _keep_fewer(progress, run.seed, progress.stop_share / 2.0)


def _keep_fewer(progress: Progress, seed: int, share: float) -> None:
    """Keep no more than a share of the blocks."""
    if share < progress.stop_share:
        progress.stop_share = share
        progress.stops = [evenly_kept(joined_rows(progress.stops), seed, share)]


def _furthest(rows: BlockRows) -> tuple[float, int, int, int]:
    """Return longest run-out and whose it is; the first in the order of the run among equals."""
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
        return FallLines(np.zeros(1, np.int64), empty, empty, none, empty, empty,
                         np.empty(0, np.uint8))  # fmt: skip
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
        rows.rocks[which], rows.rock_scenario[which], rows.x[which], rows.y[which],
        rows.passages[:0], rows.passage_scenario[:0], rows.rock_weight[which],
        rows.passage_weight[:0],
    )  # fmt: skip
