"""What a run on the map has added up so far, and how the result of a chunk is added to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.simulate import Simulated
from sassgis.hazard.bins import bins_of
from sassgis.hazard.control_lines import ControlLineSums
from sassgis.hazard.map_sums import MapSums, Sample
from sassgis.hazard.source_sums import SourceSums
from sassgis.model import rng
from sassgis.model.grid import IntArray
from sassgis.model.map_run import BlockRows, FallLines, MapRun
from sassgis.model.profiles import LineEnd
from sassgis.model.results import PASSAGE_DTYPE, ROCK_DTYPE, StopReason
from sassgis.terrain.plan import Plan


@dataclass(frozen=True, slots=True)
class ChunkResult:
    """What one chunk gave.

    Attributes
    ----------
    area : int
        Position of its release area.
    sums : dict of int to Simulated
        By the position of the block scenario in ``blocks``.
    lost : int
        Blocks of lines that are too short to be simulated on.
    """

    area: int
    sums: dict[int, Simulated]
    rows: BlockRows
    lines: FallLines
    lost: int


@dataclass
class SourceTally:
    """What has been added up of one source: a block scenario of a release area.

    Attributes
    ----------
    cells, objects : SourceSums
        Places are flat indices of cells and numbers of objects. A block counts for a cell if it
        comes within half the reference width of its centre.
    rocks, never_started : int
        Simulated blocks, and those of them that never started.
    """

    cells: SourceSums
    objects: SourceSums
    control_lines: ControlLineSums
    rocks: int = 0
    never_started: int = 0

    @classmethod
    def fresh(cls, run: MapRun) -> SourceTally:
        """Nothing added yet."""
        n = bins_of(run).threshold.size
        return cls(
            SourceSums(n), SourceSums(n), ControlLineSums(tuple(g for g, _ in run.control_lines))
        )

    def add(self, result: Simulated) -> None:
        """Add the blocks of a chunk."""
        if result.windows.size:
            self.cells.add(result.windows, *result.window_sums.values())
        else:
            exceed = (np.asarray(result.kept[n], np.int64) for n in ("exceed", "exceed_square"))
            self.cells.add(result.cells, *exceed)
        numbers = np.arange(result.objects["exceed"].shape[0], dtype=np.int64)
        self.objects.add(numbers, result.objects["exceed"], result.objects["exceed_square"])
        self.control_lines.add(result.passages)
        self.rocks += result.rocks.size
        self.never_started += int((result.rocks["reason"] == StopReason.NEVER_STARTED).sum())


@dataclass
class Progress:
    """What has been added up so far; grows chunk by chunk, in their order.

    Attributes
    ----------
    chunks : int
        Chunks added.
    reasons : int64, shape (len(StopReason),)
        Blocks by the reason of their end.
    lost : int
        Blocks of lines that are too short to be simulated on.
    runout : int64, shape (len(StopReason), n_bins)
        Blocks by the reason of their end and by run-out chainage, in metres.
    stops : list of BlockRows
        The blocks whose stop is kept one by one; kept_stops joins them.
    furthest : (run-out, line, scenario, block) or None
        The block with the longest run-out of all (m).
    sources : dict of (area, scenario) to SourceTally
        By position in ``areas`` and ``blocks``.
    pieces : int
        Fragments and entrained blocks.
    """

    chunks: int
    sums: MapSums
    control_lines: ControlLineSums
    reasons: IntArray = field(default_factory=lambda: np.zeros(len(StopReason), np.int64))
    lost: int = 0
    runout: IntArray = field(default_factory=lambda: np.zeros((len(StopReason), 0), np.int64))
    lines: list[FallLines] = field(default_factory=list)
    stops: list[BlockRows] = field(default_factory=list)
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


def add_chunk(
    progress: Progress, outcome: ChunkResult, run: MapRun, share: float, first: bool
) -> None:
    """Add the result of a chunk; chunks are added in their order.

    Parameters
    ----------
    progress : Progress
        Grows.
    share : float
        Of the blocks whose stop is kept one by one.
    first : bool
        Whether the chunk belongs to the first repetition: its lines are drawn.
    """
    for scenario, result in outcome.sums.items():
        progress.sums.add(result.cells, result.kept, result.visits, result.n_bins)
        progress.control_lines.add(result.passages)
        source = (outcome.area, scenario)
        if source not in progress.sources:
            progress.sources[source] = SourceTally.fresh(run)
        progress.sources[source].add(result)
    # Fragments and entrained blocks are no released blocks.
    released = outcome.rows.rocks["piece"] == 0
    progress.pieces += int((~released).sum())
    reasons = outcome.rows.rocks["reason"][released]
    progress.reasons += np.bincount(reasons, minlength=len(StopReason))
    progress.lost += outcome.lost
    if reasons.size:
        metres = np.maximum(outcome.rows.rocks["runout_m"][released], 0.0).astype(np.int64)
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


def _furthest(rows: BlockRows) -> tuple[float, int, int, int]:
    """The longest run-out and whose it is; the first in the order of the run among equals."""
    rows = _rocks_alone(rows, rows.rocks["piece"] == 0)
    reach = rows.rocks["runout_m"]
    line, rock, scenario = rows.rocks["line"], rows.rocks["rock"], rows.rock_scenario
    i = np.lexsort((rock, scenario, line, -reach))[0]
    return float(reach[i]), int(line[i]), int(scenario[i]), int(rock[i])


def sample_of(run: MapRun, planned: Plan, progress: Progress) -> Sample:
    """The sample behind the maps: the simulated blocks that started."""
    return Sample(
        started=int(progress.reasons.sum() - progress.reasons[StopReason.NEVER_STARTED]),
        rocks_per_line=run.release.rocks_per_point,
        lines=int(progress.reasons.sum()) // run.release.rocks_per_point,
        random_points=run.release.placement == "random",
    )


def line_ends(progress: Progress) -> dict[LineEnd, int]:
    """How many fall lines end for which reason."""
    ends = np.concatenate([np.empty(0, np.uint8), *(f.end for f in progress.lines)])
    return {e: int((ends == e).sum()) for e in LineEnd}


def joined_rows(parts: list[BlockRows]) -> BlockRows:
    """Rows of several chunks as one."""
    return BlockRows(
        np.concatenate([np.empty(0, ROCK_DTYPE), *(p.rocks for p in parts)]),
        np.concatenate([np.empty(0, np.int64), *(p.rock_scenario for p in parts)]),
        np.concatenate([np.empty(0), *(p.x for p in parts)]),
        np.concatenate([np.empty(0), *(p.y for p in parts)]),
        np.concatenate([np.empty(0, PASSAGE_DTYPE), *(p.passages for p in parts)]),
        np.concatenate([np.empty(0, np.int64), *(p.passage_scenario for p in parts)]),
    )


def joined_lines(parts: list[FallLines]) -> FallLines:
    """Fall lines of several chunks as one."""
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
    """A share of the blocks, chosen by the identity of each; smaller shares are parts of larger."""
    if share >= 1.0:
        return _rocks_alone(rows, np.ones(rows.rocks.size, bool))
    return _rocks_alone(rows, _lots(rows, seed).astype(np.float64) < share * 2.0**64)


def kept_stops(run: MapRun, progress: Progress) -> BlockRows:
    """The blocks that are kept one by one, ``stop_points_max`` at most, by repetition."""
    rows = joined_rows(progress.stops)
    # A run has them in this order; the sums of several areas were added up area by area.
    repetition = rows.rocks["rock"] // run.release.rocks_per_point
    rows = _rocks_alone(rows, np.argsort(repetition, kind="stable"))
    if rows.rocks.size <= run.stop_points_max:
        return rows
    # The share that is kept is right on average only.
    order = np.argsort(_lots(rows, run.seed), kind="stable")
    return _rocks_alone(rows, np.sort(order[: run.stop_points_max]))


def _lots(rows: BlockRows, seed: int) -> NDArray[np.uint64]:
    """A number for each block, drawn from its identity."""
    lots: NDArray[np.uint64] = rng.combined(
        rng.combined(
            rng.combined(rows.rocks["line"].astype(np.uint64), rows.rocks["rock"]),
            rows.rocks["piece"],
        ),
        np.full(rows.rocks.size, seed % 2**63) + rows.rock_scenario,
    )
    return lots


def _rocks_alone(rows: BlockRows, which: NDArray[np.generic]) -> BlockRows:
    return BlockRows(
        rows.rocks[which], rows.rock_scenario[which], rows.x[which], rows.y[which],
        rows.passages[:0], rows.passage_scenario[:0],
    )  # fmt: skip
