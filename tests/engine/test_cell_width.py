"""For which cells a block counts: a cell is as wide in every direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.engine_lab import run
from helpers.paths_lab import DEBRIS, HAZARD, MIXED, ROCK, STRAIGHT, paths
from helpers.terrains import folded, grid_of

from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.simulate import Simulated
from sassgis.grid import FloatArray, Grid
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.map_run import Window

SIDE, CELL = 141, 2.0
ALL_AROUND = np.radians(0.125 * (np.arange(2880) + 0.5))


def by_direction(grid: Grid, out: Simulated) -> FloatArray:
    """Blocks in cells over those that come to a strip one cell wide.

    Along the axes of the grid, between, and on the diagonals.
    """
    row, col = np.divmod(np.arange(grid.values.size), SIDE)
    x, y = (CELL * (k - SIDE // 2) for k in (col, row))
    off_axis = 45.0 - np.abs(np.degrees(np.arctan2(y, x)) % 90.0 - 45.0)
    ring = (np.hypot(x, y) > 50.0) & (np.hypot(x, y) < 120.0)
    came = np.zeros(grid.values.size)
    came[out.cells] = out.kept["reach"]
    found = []
    for first, last in ((0.0, 11.25), (11.25, 33.75), (33.75, 45.0)):
        own = ring & (off_axis >= first) & (off_axis <= last)
        even = out.rocks.size * CELL / (2.0 * np.pi * np.hypot(x, y)[own])
        found.append(came[own].sum() / even.sum())
    return np.array(found)


@pytest.mark.compiled
@pytest.mark.parametrize(
    # A block that the ground holds much would stop on the way.
    "settings",
    [replace(own, rolling_friction_sd=0.0) for own in (STRAIGHT, HAZARD)],
    ids=["straight", "default"],
)
def test_on_a_cone_as_many_blocks_come_to_a_cell_in_all_directions(settings) -> None:
    """A square is met by 1.28 times as many on a diagonal as along an axis."""
    grid = grid_of(lambda x, y: 1000.0 - 0.75 * np.hypot(x, y), SIDE, SIDE, CELL)
    x, y = 20.0 * np.cos(ALL_AROUND), 20.0 * np.sin(ALL_AROUND)
    held_little = replace(ROCK, restitution=0.55, eta_max=0.72)
    found = by_direction(grid, paths(grid, x, y, n=8, on=held_little, settings=settings))
    assert found.max() / found.min() < 1.025
    assert found == pytest.approx(1.0, rel=0.025)


@pytest.mark.parametrize(
    "effects",
    [EffectSettings(), EffectSettings(Fragmentation("threshold", energy_jkg=100.0))],
    ids=["whole", "fragments"],
)
def test_maps_of_cells_and_hazard_curves_of_that_width_count_the_same_blocks(effects) -> None:
    """But where a block stops off the middle of a cell: it counts there."""
    grid = grid_of(folded, 61, 61)
    held = replace(DEBRIS, mu_0=0.6)
    out, in_windows = (
        paths(grid, -49.3, [-20.4, 0.7], n=60, on=held, window=window, effects=effects)
        for window in (None, Window(61, 61, 0.5))
    )
    assert (out.pieces.size > 0) == (effects != EffectSettings())
    cells, disks = np.zeros((2, grid.values.size, out.kept["exceed"].shape[1]), np.int64)
    cells[out.cells] = out.kept["exceed"]
    disks[in_windows.windows] = in_windows.window_sums["exceed"]
    stops = np.zeros(grid.values.size, np.int64)
    stops[out.cells] = out.kept["stops"]
    alike = stops == 0
    assert (cells[alike] == disks[alike]).all() and cells[alike].any()
    more = cells[:, 0] - disks[:, 0]
    assert more.any() and ((more >= 0) & (more <= stops)).all()
    if not out.pieces.size:
        assert (stops <= cells[:, 0]).all()


def test_on_a_profile_without_a_map_a_block_counts_for_all_that_it_enters() -> None:
    s = np.array([-20.0, 60.0, 200.0])
    out = run((s, 200.0 - 0.7 * np.minimum(s, 60.0)), ROCK, MIXED, n=20)
    came = np.zeros(out.cells.max() + 1, np.int64)
    came[out.cells] = out.kept["reach"]
    ends = out.rocks["start_m"], out.rocks["runout_m"]
    first, last = (np.floor((x + 20.0) / CELL).astype(int) for x in ends)
    assert came.sum() >= (last - first + 1).sum() > 20
