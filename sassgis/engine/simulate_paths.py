"""The driver of followed paths: as simulate.py, on the terrain in place of given lines."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.cell_register import CELLS, WINDOWS, CellRegister, empty_register
from sassgis.engine.ground_ahead import Path
from sassgis.engine.kernel import Rows, Work
from sassgis.engine.simulate import (
    Simulated,
    at_first_lines,
    blocks_of,
    by_threshold,
    control_line_table,
    left_in_cells,
    run_blocks,
    setup_of,
    strata_of,
    without_barriers,
)
from sassgis.engine.statistics import Totals, Wanted, empty_totals
from sassgis.errors import InputError
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import Forest, ObjectCells, Window, Worth
from sassgis.settings.results import ControlLine, ReleasePoints
from sassgis.settings.settings import EngineSettings
from sassgis.settings.statistics_table import Bins, default_bins
from sassgis.terrain.cells import exact_positions

# Around the box of a station or barrier (cells), so that no rounding loses a crossing.
_AROUND = 1e-6
# For how many cells there has to be room, by the shape of the grid and the number of windows listed
# for each. Results do not depend on it.
_ENOUGH: dict[tuple[tuple[int, int], int], int] = {}


@dataclass(frozen=True, slots=True)
class PathTerrain:
    """Terrain on which paths are followed."""

    grid: Grid  # heights that blocks move over
    ground: NDArray[np.int32]  # shape of the grid; ground class of each cell
    tolerance_m: float  # largest vertical gap between terrain and segments (m)
    # Sequence of (ControlLine, float64 array of shape (k, 2)); stations and barriers with their
    # trace on the map (m).
    control_lines: Sequence[tuple[ControlLine, FloatArray]] = ()
    forest: Forest | None = None


def follow(
    terrain: PathTerrain,
    points: ReleasePoints,
    table: GroundTable,
    blocks: BlockPopulation | Sequence[BlockPopulation],
    settings: EngineSettings,
    *,
    seed: int,
    rocks_per_point: int,
    point_keys: NDArray[np.uint64],
    point_numbers: IntArray | None = None,
    objects: ObjectCells | None = None,
    window: Window | None = None,
    first_rock: int = 0,
    bins: Bins | None = None,
    log_events: int = 0,
    effects: EffectSettings | None = None,
    worth: Worth | None = None,
    compared: int | None = None,
) -> Simulated:
    """Simulate blocks from release points, each along the path that it takes over the terrain.

    Results depend only on seed, key of the point and number there, not on other blocks.

    Parameters
    ----------
    table, blocks, settings, seed, objects, window, first_rock, bins, log_events, effects, compared
        As for sassgis.engine.simulate.simulate.
    point_keys : uint64, shape (n,)
        Identity of each point for the random draws.
    point_numbers : int64, shape (n,), optional
        Number of each point in the run, which represents the line; default 0, 1, 2, ...
    worth : Worth, optional
        Of what the blocks of a point leave open in the windows.

    Returns
    -------
    Simulated
        ``runout_m`` is the length of the path in plan. Each point is a stratum of the sample.

    Raises
    ------
    InputError
        A point lies where no height is known.
    """
    bins = bins or default_bins()
    effects = effects or EffectSettings()
    objects = objects or ObjectCells.none()
    n = len(points)
    strata = strata_of(point_numbers, point_keys, np.column_stack(places_of(terrain.grid, points)))
    lines = [line for line, _ in terrain.control_lines]
    setup = setup_of(
        table, blocks, settings, lines=lines, effects=effects, first_rock=first_rock,
        n_blocks=rocks_per_point, seed=seed,
    )  # fmt: skip
    forest = terrain.forest
    steps = 0 if window is None else window.steps()[0].size
    # Room that sufficed for one chunk suffices for most of the next.
    key = terrain.grid.shape, steps

    def ground(n_cells: int) -> tuple[Totals, None, Path, Wanted | None]:
        register = empty_register(terrain.grid.shape, n_cells, window, objects)
        totals = empty_totals(
            n_cells, bins, register.disks, register.on_objects, objects.n_objects,
            changes=compared is not None,
        )  # fmt: skip
        path = path_of(terrain, settings, register, points)
        return totals, None, path, _wanted(worth, register, n)

    totals, rows, work, path, wanted = run_blocks(
        ground, max(room_at_first(steps), _ENOUGH.get(key, 0)), strata, setup, effects,
        has_stems=forest is not None and bool((forest.stems_per_m2 > 0.0).any()),
        passages=len(lines) * (n * rocks_per_point + 1), on_map=True, log_events=log_events,
        compared=compared is not None,
    )  # fmt: skip
    _ENOUGH[key] = totals.stops.size
    assert path is not None
    found = np.zeros(n) if wanted is None else wanted.found / max(setup.n_blocks - 1, 1)
    left = _named(terrain.grid, path.register, totals, rows, work, log_events)
    return replace(left, worth=found, passages=at_first_lines(left.passages, compared))


def _wanted(worth: Worth | None, register: CellRegister, n: int) -> Wanted | None:
    """Return the places where more is wanted for so many points, in the form of the kernel."""
    if worth is None:
        return None
    # A copy where it may not be written to, as of another process: see strata_of.
    of_cell = np.require(worth.of_cell, np.float32, ["C", "W"])
    energy = np.array(worth.energy, np.int64)
    return Wanted(energy, of_cell, register.windows, np.zeros(n))


def room_at_first(steps: int) -> int:
    """Return cells for which there is room at first, if so many windows are listed for each.

    If they were too few, the blocks are simulated again with room for twice as many. Unused room
    costs almost nothing, but the list of windows is in one block: at most as many cells as 32 MB
    hold, at least 8192.
    """
    return max(1 << 13, min(1 << 16, (1 << 23) // max(steps, 1)))


def places_of(grid: Grid, points: ReleasePoints) -> tuple[FloatArray, FloatArray]:
    """Return places of release points in cells; InputError where no height is known."""
    bad = np.flatnonzero(~np.isfinite(grid.value_at(points.x, points.y)))
    if bad.size:
        x, y = points.x[bad[0]], points.y[bad[0]]
        raise InputError(
            "a release point lies where no height is known", found=f"({x:.1f}, {y:.1f})"
        )
    return (
        exact_positions((points.x - grid.west) / grid.cell_size),
        exact_positions((grid.north - points.y) / grid.cell_size),
    )


def path_of(
    terrain: PathTerrain, settings: EngineSettings, register: CellRegister, points: ReleasePoints
) -> Path:
    """Return the terrain as the kernel takes it."""
    grid, forest = terrain.grid, terrain.forest
    traces = [np.asarray(trace, np.float64) for _, trace in terrain.control_lines]
    xy = np.concatenate([np.empty((0, 2)), *traces])
    u = exact_positions((xy[:, 0] - grid.west) / grid.cell_size)
    v = exact_positions((grid.north - xy[:, 1]) / grid.cell_size)
    first = np.cumsum([0, *map(len, traces)]).astype(np.int64)
    boxes = [
        (own.min() - _AROUND, own.max() + _AROUND)
        for a, b in itertools.pairwise(first)
        for own in (u[a:b], v[a:b])
    ]
    none = np.empty(0)
    sides = np.zeros((len(points), 2, 2)) if points.sides is None else points.sides
    return Path(
        heights=np.ascontiguousarray(grid.values, np.float64),
        ground=np.ascontiguousarray(terrain.ground, np.int32),
        stems=none if forest is None else forest.stems_per_m2,
        diameter=none if forest is None else forest.diameter_m,
        cell_size=float(grid.cell_size),
        tolerance=float(terrain.tolerance_m),
        side_tilt=math.radians(settings.side_tilt_deg),
        drift=math.radians(settings.drift_deg),
        sides=sides.reshape(-1, 4) * [1.0, -1.0, 1.0, -1.0] / grid.cell_size,
        line_u=u,
        line_v=v,
        line_first=first,
        line_box=np.array(boxes, np.float64).reshape(-1, 4),
        lines=control_line_table([line for line, _ in terrain.control_lines]),
        line_seen=np.zeros(len(traces), np.bool_),
        near=np.zeros(register.cells.size if traces else 0, np.uint64),
        register=register,
    )


def _named(
    grid: Grid, register: CellRegister, totals: Totals, rows: Rows, work: Work, log_events: int
) -> Simulated:
    """Return the results of the blocks, cells and windows in ascending order."""
    known = int(register.counts[CELLS])
    came = totals.reach.blocks[:known, :, 0].any(axis=1) | (totals.stops[:known] > 0)
    reached = np.flatnonzero(came)
    order = reached[np.argsort(register.cells[reached])]
    middles = register.windows[: register.counts[WINDOWS]]
    met = np.flatnonzero(totals.windows.blocks[: middles.size, :, 0].any(axis=1))
    windows = met[np.argsort(middles[met])]
    ends = np.concatenate([rows.ends[:-1], rows.spawned_ends[: rows.spawned.n[0]]])
    left = blocks_of(rows, log_events)
    for passages in (rows.passages, rows.passages_without):
        passed = passages.rows[: passages.n[0]]
        passed["x_m"] = grid.west + passed["x_m"] * grid.cell_size
        passed["y_m"] = grid.north - passed["y_m"] * grid.cell_size
    changes = totals.changes
    if not totals.disks.n:
        at_places = register.cells[:known], changes.reach
    else:
        at_places = middles, changes.windows
    return Simulated(
        cells=register.cells[order],
        **left_in_cells(totals, work, order),
        windows=middles[windows],
        window_sums=by_threshold(totals.windows, windows),
        objects=by_threshold(totals.objects),
        without=without_barriers(totals, rows, *at_places),
        **left,
        x=grid.west + ends[:, 0] * grid.cell_size,
        y=grid.north - ends[:, 1] * grid.cell_size,
        looked_at=_hull(*np.divmod(register.cells[:known], grid.shape[1])),
    )


def _hull(rows: IntArray, cols: IntArray) -> tuple[int, int, int, int] | None:
    """Return the first and last row, first and last column; None of no cell."""
    if not rows.size:
        return None
    return int(rows.min()), int(rows.max()), int(cols.min()), int(cols.max())
