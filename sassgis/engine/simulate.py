"""The driver: checks and converts what a run needs, calls the kernel, names what comes out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sassgis.engine import barriers as control_line_rules
from sassgis.engine import impact as impact_rules
from sassgis.engine.effects.hooks import MOST_SPAWNED, prepare
from sassgis.engine.kernel import (
    NO_ROOM,
    TOO_MANY_SPAWNED,
    ControlLineTable,
    Lines,
    Places,
    Rows,
    Setup,
    Totals,
    simulate_lines,
    working_space,
)
from sassgis.engine.state import EVENT_DTYPE, Physics
from sassgis.engine.statistics import Bins as Bins
from sassgis.engine.statistics import CellSums, Exceedance, Objects
from sassgis.model.blocks import BlockPopulation
from sassgis.model.effects import EffectSettings
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.ground import GroundTable
from sassgis.model.profiles import ProfileSet
from sassgis.model.results import PASSAGE_DTYPE, ROCK_DTYPE, ControlLine
from sassgis.model.settings import EngineSettings

# The same rows, as the kernel takes them.
_RECORDS_OF_ROCKS = np.dtype((np.record, ROCK_DTYPE))
_RECORDS_OF_PASSAGES = np.dtype((np.record, PASSAGE_DTYPE))


@dataclass(frozen=True, slots=True)
class ControlLineCrossings:
    """Where profiles cross stations and barriers.

    Attributes
    ----------
    control_lines : tuple of ControlLine
    offset : int64, shape (n_lines + 1,)
    chainage : float64, shape (offset[-1],)
        Rising within a line (m).
    control_line : int64, shape (offset[-1],)
        Position in ``control_lines``.
    """

    control_lines: tuple[ControlLine, ...]
    offset: IntArray
    chainage: FloatArray
    control_line: IntArray

    @classmethod
    def none(cls, n_lines: int) -> ControlLineCrossings:
        """No stations and no barriers."""
        return cls((), np.zeros(n_lines + 1, np.int64), np.empty(0), np.empty(0, np.int64))

    @classmethod
    def same_for_all(
        cls, control_lines: Sequence[ControlLine], chainages: Sequence[float], n_lines: int
    ) -> ControlLineCrossings:
        """The same control lines at the same chainages (m) on every one of ``n_lines`` profiles."""
        order = np.argsort(np.asarray(chainages, float), kind="stable")
        sorted_chainage = np.asarray(chainages, float)[order]
        return cls(
            tuple(control_lines),
            np.arange(n_lines + 1, dtype=np.int64) * len(control_lines),
            np.tile(sorted_chainage, n_lines),
            np.tile(order.astype(np.int64), n_lines),
        )


@dataclass(frozen=True, slots=True)
class ObjectCells:
    """The cells of exposed objects.

    Attributes
    ----------
    n_objects : int
    cell : int64, shape (n,)
        Flat indices of cells, ascending.
    number : int64, shape (n,)
        The object that covers the cell; a cell may belong to several.
    """

    n_objects: int
    cell: IntArray
    number: IntArray

    @classmethod
    def none(cls) -> ObjectCells:
        """No object."""
        return cls(0, np.empty(0, np.int64), np.empty(0, np.int64))

    def under(self, cells: IntArray) -> Objects:
        """The objects on each of some cells (flat indices, ascending)."""
        first = np.searchsorted(self.cell, cells, side="left")
        size = np.searchsorted(self.cell, cells, side="right") - first
        offset = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
        take = np.repeat(first - offset[:-1], size) + np.arange(offset[-1])
        return Objects(offset, np.asarray(self.number, np.int64)[take])


@dataclass(frozen=True, slots=True)
class Forest:
    """Stems on the cells of the grid.

    Attributes
    ----------
    stems_per_m2 : float64, shape (n_rows * n_cols,)
    diameter_m : float64, shape (n_rows * n_cols,)
        At breast height.
    """

    stems_per_m2: FloatArray
    diameter_m: FloatArray


@dataclass(frozen=True, slots=True)
class Window:
    """A disk of cells around each cell, in which a rock counts once.

    Attributes
    ----------
    n_rows, n_cols : int
        Of the grid.
    radius : float
        In cells, from centre to centre; below 1 the window is the cell itself.
    """

    n_rows: int
    n_cols: int
    radius: float

    def around(self, cells: IntArray) -> tuple[IntArray, Objects]:
        """Windows that hold any of some cells (flat indices).

        Returns
        -------
        centres : int64, shape (n_windows,)
            Flat indices of the cells in the middle of the windows, ascending.
        windows : Objects
            The windows of each of ``cells``, by their position in ``centres``.
        """
        reach = int(self.radius)
        step = np.arange(-reach, reach + 1)
        near = step[:, None] ** 2 + step[None, :] ** 2 <= self.radius**2 + 1e-9
        drow, dcol = (step[i] for i in np.nonzero(near))
        row, col = np.divmod(cells, self.n_cols)
        rows = row[:, None] + drow
        cols = col[:, None] + dcol
        inside = (rows >= 0) & (rows < self.n_rows) & (cols >= 0) & (cols < self.n_cols)
        flat = (rows * self.n_cols + cols)[inside]
        centres, number = np.unique(flat, return_inverse=True)
        offset = np.concatenate([[0], np.cumsum(inside.sum(axis=1))]).astype(np.int64)
        return centres.astype(np.int64), Objects(offset, number.astype(np.int64))


@dataclass(frozen=True, slots=True)
class Simulated:
    """What the rocks of some lines left.

    Attributes
    ----------
    cells : int64, shape (n_cells,)
        Flat indices of the grid cells under the lines, ascending.
    sums : dict of str to array with a row for each of ``cells``
        "reach" (rocks that came), "reach_square" (sum over lines of its square), "exceed" and
        "exceed_square" (the same of the rocks that reach each threshold), "stops", "energy_sum"
        (J), "energy_max" (kJ), "height_max" (m), "speed_max" (m/s), and the counts "energy",
        "height", "speed" in the bins of the run.
    windows : int64, shape (n_windows,)
        Flat indices of the cells in the middle of the windows; empty unless asked for.
    window_sums, objects : dict
        "exceed" and "exceed_square" with a row for each window, each object.
    rocks : ROCK_DTYPE, shape (n_lines * n_rocks,)
    pieces : ROCK_DTYPE
        Spawned blocks (fragments and entrained blocks), numbered from 1 for each released block.
    passages : PASSAGE_DTYPE
    event_logs : tuple of EVENT_DTYPE arrays, shape (n_events,)
        Events of each released block; empty unless asked for.
    """

    cells: IntArray
    sums: dict[str, NDArray[np.generic]]
    windows: IntArray
    window_sums: dict[str, IntArray]
    objects: dict[str, IntArray]
    rocks: NDArray[np.void]
    pieces: NDArray[np.void]
    passages: NDArray[np.void]
    event_logs: tuple[NDArray[np.void], ...]


def default_bins(
    largest_energy_kj: float = 1e6,
    largest_height_m: float = 100.0,
    largest_speed_mps: float = 80.0,
    thresholds_kj: Sequence[float] = (),
) -> Bins:
    """Edges of the histograms that the map's quantiles come from, and energies of hazard curves.

    Energy: 20 bins a decade, 30 and 300 kJ among the edges, from 0.03 kJ. Height: 0.1 m up to 2 m,
    then steps of 6 %. Speed: 0.5 m/s up to 20 m/s, then 1 m/s. Hazard curves: 0, four energies a
    decade from 0.95 kJ with 30 and 300 kJ among them, and the thresholds given.
    """
    top = max(int(np.ceil(20.0 * np.log10(max(largest_energy_kj, 1.0) / 30.0))), 20)
    energy = np.concatenate([[0.0], 30.0 * 10.0 ** (np.arange(-60, top + 1) / 20.0)])
    steps = max(int(np.ceil(np.log(max(largest_height_m, 4.0) / 2.0) / np.log(1.06))), 1)
    height = np.concatenate([np.arange(0.0, 2.0, 0.1), 2.0 * 1.06 ** np.arange(steps + 1)])
    speed = np.concatenate(
        [np.arange(0.0, 20.0, 0.5), np.arange(20.0, max(largest_speed_mps, 22.0) + 1.0, 1.0)]
    )
    regular = 30.0 * 10.0 ** (np.arange(-6, top // 5 + 1) / 4.0)
    regular[[6, 10]] = 30.0, 300.0
    given = np.array([t for t in thresholds_kj if not np.isclose(t, regular, rtol=1e-9).any()])
    threshold = np.unique(np.concatenate([[0.0], regular, given]))
    return Bins(energy, height, speed, threshold)


def empty_sums(n_cells: int, bins: Bins) -> CellSums:
    """Sums for ``n_cells`` cells to which nothing has come yet."""
    return CellSums(
        tally=np.zeros((n_cells, 2), np.int64),
        peak=np.zeros((n_cells, 3)),
        energy=np.zeros((n_cells, bins.energy.size - 1), np.uint32),
        height=np.zeros((n_cells, bins.height.size - 1), np.uint32),
        speed=np.zeros((n_cells, bins.speed.size - 1), np.uint32),
    )


def no_exceedance(n: int, bins: Bins) -> Exceedance:
    """Counts for ``n`` cells or objects to which nothing has come yet."""
    return Exceedance(*(np.zeros((n, bins.threshold.size), np.int64) for _ in range(2)))


def _exceedance(sums: Exceedance) -> dict[str, IntArray]:
    return {"exceed": sums.rocks, "exceed_square": sums.square}


def _columns(sums: CellSums, reach: Exceedance) -> dict[str, NDArray[np.generic]]:
    """The sums under their names."""
    return {
        "reach": reach.rocks[:, 0],
        "reach_square": reach.square[:, 0],
        "exceed": reach.rocks,
        "exceed_square": reach.square,
        "energy_sum": sums.tally[:, 0],
        "stops": sums.tally[:, 1],
        **{n: sums.peak[:, i] for i, n in enumerate(("energy_max", "height_max", "speed_max"))},
        "energy": sums.energy,
        "height": sums.height,
        "speed": sums.speed,
    }


def _windows(window: Window | None, cells: IntArray) -> tuple[IntArray, Objects]:
    if window is not None:
        return window.around(cells)
    none = np.empty(0, np.int64)
    return none, Objects(np.zeros(cells.size + 1, np.int64), none)


def _physics(settings: EngineSettings) -> Physics:
    return Physics(
        gravity=float(settings.gravity_mps2),
        eta_rule={"scale": impact_rules.SCALE, "coulomb": impact_rules.COULOMB}[
            settings.eta_max_rule
        ],
        slope_variation=settings.slope_variation == "per_impact",
        rolling_threshold=float(settings.rolling_threshold),
        as_ellipse=settings.rolling == "ellipse",
        end_sliding=bool(settings.end_sliding),
        tolerance=float(settings.contact_tolerance_m),
        max_events=int(settings.max_events),
    )


def _control_line_rule(control_line: ControlLine) -> int:
    """How the kernel treats a control line."""
    if control_line.kind == "station":
        return control_line_rules.STATION
    return control_line_rules.RELEASES if control_line.lets_go else control_line_rules.STOPS


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
    """Starting chainages as the kernel takes them; InputError where one is off its profile."""
    starts = np.asarray(starts, np.float64).reshape(len(profiles), 2)
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


def _cells_of(profiles: ProfileSet) -> tuple[IntArray, IntArray]:
    """Cells under the profiles, ascending, and the position among them of each stretch, or -1."""
    cells, local = np.unique(profiles.cell, return_inverse=True)
    known = cells >= 0
    local = np.where(profiles.cell >= 0, local - int((~known).sum()), -1).astype(np.int64)
    return cells[known], local


def _control_line_table(crossings: ControlLineCrossings) -> ControlLineTable:
    lines = crossings.control_lines
    return ControlLineTable(
        np.array([_control_line_rule(line) for line in lines], np.int64),
        np.array([line.height_m for line in lines], np.float64),
        1e3 * np.array([line.capacity_kj for line in lines], np.float64),
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
    strata: IntArray | None = None,
    first_rock: int = 0,
    bins: Bins | None = None,
    log_events: int = 0,
    effects: EffectSettings | None = None,
    forest: Forest | None = None,
) -> Simulated:
    """Simulate blocks down profiles.

    The rocks depend only on seed, line key and number on the line, never on what else is simulated.

    Parameters
    ----------
    profiles : ProfileSet
    table : GroundTable
    blocks : BlockPopulation, or one for each line
    settings : EngineSettings
    seed : int
        0 to 2**64 - 1.
    rocks_per_line : int
    line_keys : uint64, shape (n_lines,)
        Identity of each line for the random draws.
    starts : float64, shape (n_lines, 2)
        Limits of the starting chainage (m).
    control_lines : ControlLineCrossings, optional
    objects : ObjectCells, optional
        At each of which every rock counts once, with its largest energy in the object's cells.
    window : Window, optional
        In which a rock counts once with its largest energy, besides the counts by cell.
    line_numbers : int64, shape (n_lines,), optional
        Number of each line in the run; default 0, 1, 2, ...
    strata : int64, shape (n_lines,), optional
        Stratum of the sample of each line, over which the squares are summed; lines of one stratum
        follow each other. Default: each line is one.
    first_rock : int
        Number of the first rock on each line.
    bins : Bins, optional
        Edges of the histograms per cell, thresholds of the hazard curves; default
        ``default_bins()``.
    log_events : int
        Events to keep in the log of each block.
    effects : EffectSettings, optional
        What the model of 1986 leaves out. A rock and its pieces count once in each cell.
    forest : Forest, optional
        For the effect of trees.

    Returns
    -------
    Simulated

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
    starts = _checked_starts(profiles, starts)
    cells, local = _cells_of(profiles)
    if line_numbers is None:
        line_numbers = np.arange(n_lines, dtype=np.int64)
    lines = Lines(
        offset=profiles.offset,
        s=profiles.s,
        z=profiles.z,
        ground=profiles.ground,
        cell_offset=profiles.cell_offset,
        cell_s=profiles.cell_s,
        cell=local,
        number=np.asarray(line_numbers, np.int64),
        key=np.asarray(line_keys, np.uint64),
        stratum=np.asarray(np.arange(n_lines) if strata is None else strata, np.int64),
        start=starts,
        control_line_offset=crossings.offset,
        control_line_x=crossings.chainage,
        control_line=crossings.control_line,
    )
    populations = [blocks] if isinstance(blocks, BlockPopulation) else blocks
    setup = Setup(
        table.rows(),
        np.stack([population.limits() for population in populations]),
        _physics(settings),
        _control_line_table(crossings),
        np.uint64(seed),
        first_rock,
        rocks_per_line,
    )
    centres, windows = _windows(window, cells)
    stems = forest.stems_per_m2[cells] if forest is not None else np.zeros(0)
    diameter = forest.diameter_m[cells] if forest is not None else np.zeros(0)
    hooked = prepare(effects, table, stems, diameter)
    n = n_lines * rocks_per_line
    room = 1
    while True:
        totals = Totals(
            bins,
            empty_sums(cells.size, bins),
            no_exceedance(cells.size, bins),
            Places(windows, no_exceedance(centres.size, bins)),
            Places(objects.under(cells), no_exceedance(objects.n_objects, bins)),
        )
        rows = Rows(
            rocks=np.zeros(n, _RECORDS_OF_ROCKS),
            passages=np.zeros(
                max(room * crossings.chainage.size * rocks_per_line, 1), _RECORDS_OF_PASSAGES
            ),
            pieces=np.zeros(room * n if hooked is not None else 0, _RECORDS_OF_ROCKS),
            events=np.zeros((n, log_events), EVENT_DTYPE),
            event_counts=np.zeros(n, np.int64),
            filled=np.zeros(2, np.int64),
        )
        status = simulate_lines(lines, setup, totals, rows, working_space(totals), hooked)
        if status != NO_ROOM:
            break
        room *= 4
    if status == TOO_MANY_SPAWNED:
        raise InputError(
            "a block spawns too many others",
            field="effects",
            found=f"more than {MOST_SPAWNED} from one released block",
            expected="fewer fragments, a larger smallest fragment, or fewer blocks per impact",
        )
    n_passages, n_pieces = rows.filled
    counts = rows.event_counts
    return Simulated(
        cells=cells,
        sums=_columns(totals.sums, totals.reach),
        windows=centres,
        window_sums=_exceedance(totals.windows.reach),
        objects=_exceedance(totals.objects.reach),
        rocks=rows.rocks.view(ROCK_DTYPE),
        pieces=rows.pieces[:n_pieces].view(ROCK_DTYPE),
        passages=rows.passages[:n_passages].view(PASSAGE_DTYPE),
        event_logs=tuple(rows.events[i, : counts[i]] for i in range(n)) if log_events else (),
    )
