"""The driver: checks and converts what a run needs, calls the kernel, names the results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.engine import barriers as control_line_rules
from sassgis.engine import impact as impact_rules
from sassgis.engine import kernel, statistics
from sassgis.engine.effects.hooks import ground_of, most_spawned, prepare
from sassgis.engine.effects.spawning import MOST_SPAWNED
from sassgis.engine.ellipse import empty_table, outlined
from sassgis.engine.ground_ahead import Path
from sassgis.engine.kernel import Lines, Rows, Setup, Strata, Work
from sassgis.engine.state import EVENT_DTYPE, Physics
from sassgis.engine.statistics import Disks, Exceedance, Objects, Totals, Wanted, disks_of
from sassgis.errors import InputError
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.blocks import LIMITS_DTYPE, BlockPopulation, EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import Forest, ObjectCells, Window
from sassgis.settings.results import (
    PASSAGE_DTYPE,
    ROCK_DTYPE,
    ControlLine,
    ControlLineCrossings,
    Outcome,
    ProfileSet,
    StopReason,
)
from sassgis.settings.settings import EngineSettings
from sassgis.settings.statistics_table import Bins, default_bins, sums_by

# The same rows, as the kernel takes them.
_RECORDS_OF_ROCKS = np.dtype((np.record, ROCK_DTYPE))
_RECORDS_OF_PASSAGES = np.dtype((np.record, PASSAGE_DTYPE))


@dataclass(frozen=True, slots=True)
class Visits:
    """Visits of blocks to cells, for their histograms."""

    visits: NDArray[np.uint64]  # as statistics.by_cell returns them
    place: NDArray[np.int32]  # in the cells of the result; number of each cell in the visits

    def add_to(
        self, histograms: tuple[NDArray[np.uint32], ...], row: NDArray[np.int32], weight: int = 1
    ) -> None:
        """Add them to histograms, each ``weight`` times; ``row`` is that of each cell."""
        if self.visits.size:
            statistics.add_visits(self.visits, row[self.place], histograms, weight)


@dataclass(frozen=True, slots=True)
class BlocksWithoutBarriers:
    """The same blocks without barriers."""

    # Flat indices of the cells, or of those in the middle of the windows if asked for, at which
    # "exceed" and "exceed_square" differ; by how much they exceed those with barriers.
    places: IntArray
    differences: dict[str, IntArray]
    objects: dict[str, IntArray]  # the same with a row for each object
    passages: NDArray[np.void]  # PASSAGE_DTYPE; barriers are passed as stations
    never_started: int  # blocks


@dataclass(frozen=True)
class Simulated:
    """Results of the blocks of some lines or release points."""

    cells: IntArray  # flat indices of the grid cells that they may come to, ascending
    # A row for each of ``cells``: those of settings.statistics_table.SUMS but the histograms; of
    # the blocks that reach each threshold "exceed" and, summed over lines, its square
    # "exceed_square". Histograms where there were more visits than there was room for.
    kept: dict[str, NDArray[np.generic]]
    visits: Visits  # not yet in the histograms
    n_bins: dict[str, int]  # of each histogram, in the order of the visits
    windows: IntArray  # flat indices of the cells in the middle of the windows, if asked for
    # "exceed" and "exceed_square" with a row for each window, each object.
    window_sums: dict[str, IntArray]
    objects: dict[str, IntArray]
    rocks: NDArray[np.void]  # ROCK_DTYPE, shape (n_lines * n_rocks,)
    # ROCK_DTYPE: spawned blocks, numbered from 1 for each released block.
    pieces: NDArray[np.void]
    passages: NDArray[np.void]  # PASSAGE_DTYPE
    event_logs: tuple[NDArray[np.void], ...]  # EVENT_DTYPE, of each released block, if asked for
    # Where the blocks and the spawned blocks end on the map (m); empty on given lines.
    x: FloatArray = field(default_factory=lambda: np.empty(0))
    y: FloatArray = field(default_factory=lambda: np.empty(0))
    # First and last row, first and last column of the grid of the cells that followed paths looked
    # at, ahead of the blocks; None on given lines.
    looked_at: tuple[int, int, int, int] | None = None
    # Uncertainty left by the blocks of each point; empty on given lines, 0 unless asked for.
    worth: FloatArray = field(default_factory=lambda: np.empty(0))
    without: BlocksWithoutBarriers | None = None  # if asked for

    @cached_property
    def sums(self) -> dict[str, NDArray[np.generic]]:
        """Return all sums of each cell, with histograms in the bins of the run."""
        n = self.cells.size
        whole: dict[str, Any] = {
            name: np.array(self.kept[name]) if name in self.kept else np.zeros((n, k), np.uint32)
            for name, k in self.n_bins.items()
        }
        self.visits.add_to(tuple(whole.values()), np.arange(n, dtype=np.int32))
        return self.kept | whole


def left_in_cells(totals: Totals, work: Work, rows: IntArray) -> dict[str, Any]:
    """Return the records of blocks in some cells, by the names in Simulated."""
    reach = by_threshold(totals.reach, rows)
    values = totals.values[rows]
    kept: dict[str, Any] = {
        "reach": reach["exceed"][:, 0],
        "reach_square": reach["exceed_square"][:, 0],
        "stops": totals.stops[rows],
    }
    columns = [*sums_by("sum"), *sums_by("max"), *sums_by("min")]
    kept |= {s.name: values[:, i].astype(s.dtype) for i, s in enumerate(columns)} | reach
    bins = {s.name: own for s, own in zip(sums_by("histogram"), totals.counts, strict=True)}
    if work.n_visits[1]:
        kept |= {name: own[rows] for name, own in bins.items()}
    place = np.full(totals.stops.size, -1, np.int32)
    place[rows] = np.arange(rows.size, dtype=np.int32)
    visits = Visits(statistics.by_cell(work.visits[: work.n_visits[0]], place.size), place)
    n_bins = {name: own.shape[1] for name, own in bins.items()}
    return {"kept": kept, "visits": visits, "n_bins": n_bins}


def without_barriers(
    totals: Totals, rows: Rows, places: IntArray, changes: Exceedance
) -> BlocksWithoutBarriers | None:
    """Return the same blocks without barriers; None where these were not wanted.

    ``places`` are flat indices of those at which hazard is counted, with their changes.
    """
    if not rows.reasons_without.size:
        return None
    some = np.flatnonzero(changes.blocks[: places.size].any(axis=(1, 2)))
    some = some[np.argsort(places[some])]
    passages = rows.passages_without.rows[: rows.passages_without.n[0]].view(PASSAGE_DTYPE)
    passages["outcome"] = Outcome.PASSED
    idle = int((rows.reasons_without == StopReason.NEVER_STARTED).sum())
    return BlocksWithoutBarriers(
        places[some], by_threshold(changes, some),
        by_threshold(totals.changes.objects), passages, idle,
    )  # fmt: skip


def by_threshold(reach: Exceedance, rows: IntArray | None = None) -> dict[str, IntArray]:
    """Return counts of some places, or of all, under their names."""
    blocks, square = statistics.counted(reach, np.arange(reach.top.size) if rows is None else rows)
    return {"exceed": blocks, "exceed_square": square}


def _disks(window: Window | None, cells: IntArray) -> tuple[IntArray, Disks]:
    """Find windows that blocks in some cells may meet: their middle cells and their disks."""
    if window is None:
        return np.empty(0, np.int64), disks_of(None, 0, cells.size)
    centres, number = window.around(cells)
    disks = disks_of(window, centres.size, cells.size)
    disks.number[:] = number
    row, col = np.divmod(cells, window.n_cols)
    disks.middle[:, 0], disks.middle[:, 1] = col + 0.5, row + 0.5
    return centres, disks


def _check(profiles: ProfileSet, table: GroundTable) -> None:
    """Raise InputError for profiles that the kernel cannot take."""
    few = np.flatnonzero(np.diff(profiles.offset) < 2)
    if few.size:
        i = int(few[0])
        size = int(profiles.offset[i + 1] - profiles.offset[i])
        raise InputError(f"profile {i} has fewer than two vertices", found=size)
    owner = np.repeat(np.arange(len(profiles)), np.diff(profiles.offset))
    odd = np.flatnonzero(~(np.isfinite(profiles.s) & np.isfinite(profiles.z)))
    if odd.size:
        raise InputError(f"profile {owner[odd[0]]} has vertices that are not numbers")
    falling = np.flatnonzero((np.diff(profiles.s) <= 0.0) & (owner[1:] == owner[:-1]))
    if falling.size:
        raise InputError(
            f"profile {owner[falling[0]]}: chainage must rise", found="equal or falling values"
        )
    if profiles.ground.size and not (
        profiles.ground.min() >= 0 and profiles.ground.max() < len(table.classes)
    ):
        raise InputError(
            "a profile names a ground class that the table does not have",
            found=f"{profiles.ground.min()} to {profiles.ground.max()}",
            expected=f"0 to {len(table.classes) - 1}",
        )


def _checked_starts(profiles: ProfileSet, starts: FloatArray) -> FloatArray:
    """Return starting chainages; InputError where one is off its profile."""
    starts = np.reshape(starts, (len(profiles), 2))
    first = profiles.s[profiles.offset[:-1]]
    last = profiles.s[profiles.offset[1:] - 1]
    outside = (starts[:, 0] < first) | (starts[:, 1] > last) | (starts[:, 0] > starts[:, 1])
    if outside.any():
        i = int(np.flatnonzero(outside)[0])
        raise InputError(
            f"profile {i}: the start lies outside the profile",
            found=f"{starts[i, 0]:g} to {starts[i, 1]:g} m",
            expected=f"within {first[i]:g} to {last[i]:g} m, low first",
        )
    return starts


def control_line_table(lines: Sequence[ControlLine]) -> control_line_rules.ControlLineTable:
    """Return stations and barriers as the kernel takes them."""
    barrier = {True: control_line_rules.RESTARTS, False: control_line_rules.STOPS}
    rules = [
        control_line_rules.STATION if line.kind == "station" else barrier[line.restarts_from_rest]
        for line in lines
    ]
    return control_line_rules.ControlLineTable(
        np.array(rules, np.int64),
        np.array([line.height_m for line in lines], np.float64),
        1e3 * np.array([line.capacity_kj for line in lines], np.float64),
        np.array([line.width_m for line in lines], np.float64),
        np.tan(np.radians(np.array([line.roof_slope_deg for line in lines], np.float64))),
    )


def _lines(
    profiles: ProfileSet, local: IntArray, forest: Forest | None, crossings: ControlLineCrossings
) -> Lines:
    """Return the profiles as the kernel takes them; ``local`` is the position of each cell."""
    stems = diameter = np.zeros(profiles.cell.size)
    if forest is not None:
        inside = profiles.cell >= 0
        stems = np.where(inside, forest.stems_per_m2[profiles.cell], 0.0)
        diameter = np.where(inside, forest.diameter_m[profiles.cell], 0.0)
    return Lines(
        offset=profiles.offset,
        s=profiles.s,
        z=profiles.z,
        ground=profiles.ground,
        cell_offset=profiles.cell_offset,
        cell_s=profiles.cell_s,
        cell=local,
        stems=stems,
        diameter=diameter,
        on_map=np.zeros((profiles.cell_s.size, 2)) if profiles.on_map is None else profiles.on_map,
        control_line_offset=crossings.offset,
        control_line_x=crossings.chainage,
        control_line=crossings.control_line,
    )


def physics_of(settings: EngineSettings) -> Physics:
    """Return settings as the kernel reads them, from those of the named set and the user's."""
    return Physics(
        gravity=float(settings.gravity_mps2),
        eta_rule=impact_rules.RULES[settings.eta_max_rule or ""],
        slope_variation=settings.slope_variation == "per_impact",
        as_ellipse=settings.rolling == "ellipse",
        tipping=bool(settings.tipping) and settings.block == "ellipse",
        corner_as_circle=settings.corner == "circle",
        end_sliding=bool(settings.end_sliding),
        tolerance=float(settings.contact_tolerance_m),
        max_events=int(settings.max_events),
        rolling_friction_sd=float(settings.rolling_friction_sd or 0.0),
        outline_edges=float(settings.outline_edges or 0.0),
        outline_share=1.0 if settings.outline_share is None else float(settings.outline_share),
        point=settings.block == "point",
    )


def moving_axes(axes: FloatArray, settings: EngineSettings) -> FloatArray:
    """Return the semi-axes of blocks as they move, of those that they state, longest first (m).

    Heights of flight are counted from them. Shape (..., 2 or more) of both.
    """
    physics = physics_of(settings.resolved())
    moving: FloatArray = np.array(axes, order="C")
    for row in moving.reshape(-1, moving.shape[-1]):
        if physics.point:
            row[:3] = np.cbrt(row[:3].prod())
        else:
            row[:2] = outlined(row[0], row[1], physics.outline_edges, physics.outline_share)
    return moving


def setup_of(
    table: GroundTable, blocks: BlockPopulation | Sequence[BlockPopulation],
    settings: EngineSettings, *, lines: Sequence[ControlLine], effects: EffectSettings,
    first_rock: int, n_blocks: int, seed: int,
) -> Setup:  # fmt: skip
    """Return the setup common to the blocks of all lines, as the kernel takes it."""
    populations = [blocks] if isinstance(blocks, BlockPopulation) else blocks
    settings = settings.resolved()
    return Setup(
        grounds=ground_of(effects, table.with_rolling_threshold(settings.rolling_threshold)),
        # Not np.stack, which compares the fields of one record after the other.
        limits=np.array([population.limits() for population in populations], LIMITS_DTYPE),
        physics=physics_of(settings),
        control_lines=control_line_table(lines),
        seed=np.uint64(seed),
        first_rock=first_rock,
        n_blocks=n_blocks,
    )


def blocks_of(rows: Rows, log_events: int) -> dict[str, Any]:
    """Return rows that blocks have filled, by their names in Simulated."""
    counts = rows.event_counts
    return {
        "rocks": rows.rocks[:-1].view(ROCK_DTYPE),
        "pieces": rows.spawned.rows[: rows.spawned.n[0]].view(ROCK_DTYPE),
        "passages": rows.passages.rows[: rows.passages.n[0]].view(PASSAGE_DTYPE),
        "event_logs": tuple(rows.events[i, : counts[i]] for i in range(counts.size))
        if log_events
        else (),
    }


def _empty_rows(n: int, n_passages: int, n_spawned: int, n_events: int, compared: bool) -> Rows:
    """Make room for so many released blocks, passages, spawned blocks and events of each.

    ``compared`` is whether the same blocks are wanted without barriers.
    """
    return Rows(
        rocks=np.zeros(n + 1, _RECORDS_OF_ROCKS),
        passages=empty_table(max(n_passages, 1), _RECORDS_OF_PASSAGES),
        spawned=empty_table(n_spawned, _RECORDS_OF_ROCKS),
        ends=np.zeros((n + 1, 2)),
        spawned_ends=np.zeros((n_spawned, 2)),
        events=np.zeros((n, n_events), EVENT_DTYPE),
        event_counts=np.zeros(n, np.int64),
        reasons_without=np.zeros(compared * n, np.uint8),
        passages_without=empty_table(max(compared * n_passages, 1), _RECORDS_OF_PASSAGES),
    )


def at_first_lines(passages: NDArray[np.void], lines: int | None) -> NDArray[np.void]:
    """Return the passages at the first so many control lines; None: at all."""
    return passages if lines is None else passages[passages["control_line"] < lines]


#: Ground of a chunk with room for so many cells, and the sums there: profiles, or terrain on which
#: paths are followed, with the places where more is wanted.
Ground = Callable[[int], tuple[Totals, Lines | None, Path | None, Wanted | None]]


def run_blocks(
    ground: Ground, n_cells: int, strata: Strata, setup: Setup, effects: EffectSettings, *,
    has_stems: bool, passages: int, on_map: bool, log_events: int, compared: bool,
) -> tuple[Totals, Rows, Work, Path | None, Wanted | None]:  # fmt: skip
    """Simulate blocks; repeat with more room if it was too little.

    Parameters
    ----------
    n_cells : int
        For how many there is room at first.
    has_stems : bool
        Whether there is any forest.
    passages : int
        Most passages of stations and barriers if no block spawns others.
    on_map : bool
        Whether it is known where the paths lie on the map.
    compared : bool
        Whether the same blocks are wanted without barriers.
    """
    n = strata.number.size * setup.n_blocks
    hooked = prepare(effects, has_stems)
    more, visits = 1, statistics.VISITS
    while True:
        totals, lines, path, wanted = ground(n_cells)
        rows = _empty_rows(
            n, more * passages, more * n if hooked is not None else 0, log_events, compared
        )
        work = kernel.working_space(
            n_cells, setup.grounds, hooked is not None, most_spawned(effects), visits,
            on_map=on_map, followed=path is not None, compared=compared,
        )  # fmt: skip
        status = kernel.simulate_strata(
            strata, setup, totals, rows, work, hooked, lines, path, wanted
        )
        if status == kernel.DONE:
            return totals, rows, work, path, wanted
        if status == kernel.NO_ROOM:
            more *= 4
        elif status == kernel.MANY_CELLS:
            n_cells *= 2
        elif status == kernel.MANY_VISITS:
            visits *= 4
        else:
            raise InputError(
                "a block spawns too many others",
                field="effects",
                found=f"more than {MOST_SPAWNED} from one released block",
                expected="fewer fragments, a larger smallest fragment, or fewer blocks per impact",
            )


def strata_of(numbers: IntArray | None, keys: NDArray[np.uint64], start: FloatArray) -> Strata:
    """Return lines or release points as the kernel takes them; numbered 0, 1, 2, ... by default."""
    given = np.arange(len(start)) if numbers is None else numbers
    # A copy: for an array that may not be written to the whole kernel would be compiled again.
    return Strata(
        np.asarray(given, np.int64),
        np.asarray(keys, np.uint64),
        np.array(start, np.float64, order="C"),
    )


def simulate(
    profiles: ProfileSet,
    table: GroundTable,
    blocks: BlockPopulation | Sequence[BlockPopulation],
    settings: EngineSettings,
    *,
    seed: int,
    rocks_per_line: int,
    line_keys: NDArray[np.uint64],
    starts: FloatArray,
    control_lines: ControlLineCrossings | None = None,
    objects: ObjectCells | None = None,
    window: Window | None = None,
    line_numbers: IntArray | None = None,
    first_rock: int = 0,
    bins: Bins | None = None,
    log_events: int = 0,
    effects: EffectSettings | None = None,
    forest: Forest | None = None,
    compared: int | None = None,
) -> Simulated:
    """Simulate blocks down profiles.

    Results depend only on seed, line key and number on the line, not on other blocks.

    Parameters
    ----------
    seed : int
        0 to 2**64 - 1.
    rocks_per_line : int
        Each line is a stratum of the sample.
    line_keys : uint64, shape (n_lines,)
        Identity of each line for the random draws.
    starts : float64, shape (n_lines, 2)
        Limits of the starting chainage (m).
    objects : ObjectCells, optional
        At each of which every block counts once, with its largest energy in the object's cells.
    window : Window, optional
        In which a block counts once with its largest energy, besides the counts by cell; needs
        profiles that are on a map.
    line_numbers : int64, shape (n_lines,), optional
        Number of each line in the run; default 0, 1, 2, ...
    first_rock : int
        Number of the first block on each line.
    bins : Bins, optional
        Edges of the histograms per cell, thresholds of the hazard curves; default
        ``default_bins()``.
    log_events : int
        Events to keep in the log of each block.
    effects : EffectSettings, optional
        Effects that the model of 1986 leaves out. A block and those that it spawns count once in
        each cell.
    forest : Forest, optional
        For the effect of trees.
    compared : int, optional
        The same blocks are wanted without barriers, too, which pass all control lines; those with
        barriers are counted at the first so many of them.

    Raises
    ------
    InputError
        Profiles, classes or starts that cannot be used.
    """
    n_lines = len(profiles)
    bins = bins or default_bins()
    crossings = control_lines or ControlLineCrossings.none(n_lines)
    objects = objects or ObjectCells.none()
    effects = effects or EffectSettings()
    _check(profiles, table)
    if window is not None and profiles.on_map is None:
        raise ValueError("profiles that are not on a map do not meet windows on it")
    strata = strata_of(line_numbers, line_keys, _checked_starts(profiles, starts))
    # Of stretches without a cell, which have the number -1, there are none in the sums.
    cells, local = np.unique(profiles.cell, return_inverse=True)
    none = int((cells < 0).sum())
    local = np.where(profiles.cell >= 0, local - none, -1).astype(np.int64)
    cells = cells[none:]
    lines = _lines(profiles, local, forest, crossings)
    setup = setup_of(
        table, blocks, settings, lines=crossings.control_lines, effects=effects,
        first_rock=first_rock, n_blocks=rocks_per_line, seed=seed,
    )  # fmt: skip
    centres, disks = _disks(window, cells)

    def ground(n_cells: int) -> tuple[Totals, Lines, None, None]:
        on_objects = Objects(*objects.under(cells))
        totals = statistics.empty_totals(
            n_cells, bins, disks, on_objects, objects.n_objects, changes=compared is not None
        )
        return totals, lines, None, None

    totals, rows, work, _, _ = run_blocks(
        ground, cells.size, strata, setup, effects, has_stems=bool((lines.stems > 0.0).any()),
        passages=crossings.chainage.size * rocks_per_line, on_map=profiles.on_map is not None,
        log_events=log_events, compared=compared is not None,
    )  # fmt: skip
    # Where a given line lies on the map is not known here.
    for passages in (rows.passages, rows.passages_without):
        passed = passages.rows[: passages.n[0]]
        passed["x_m"] = passed["y_m"] = np.nan
    left = blocks_of(rows, log_events)
    left["passages"] = at_first_lines(left["passages"], compared)
    changes = totals.changes
    at_places = (cells, changes.reach) if window is None else (centres, changes.windows)
    return Simulated(
        cells=cells,
        **left_in_cells(totals, work, np.arange(cells.size)),
        windows=centres,
        window_sums=by_threshold(totals.windows),
        objects=by_threshold(totals.objects),
        without=without_barriers(totals, rows, *at_places),
        **left,
    )
