"""Terrain finer than a block: waves of known length keep the share that the Gaussian leaves."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.terrains import grid_of, points_at, rough

from sassgis.grid import Grid
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_map_run
from sassgis.settings.map_run import MapRun
from sassgis.terrain.cells import heights_at
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.prepare import prepare_lines
from sassgis.terrain.surface import block_scale_grid

DIAMETER = 2.0


@pytest.mark.parametrize("lengths", [0.5, 1.0, 2.0, 4.0])
def test_waves_are_damped_by_their_length_over_the_diameter(lengths: float) -> None:
    wave = lengths * DIAMETER
    fine = grid_of(lambda x, y: np.sin(2.0 * np.pi * x / wave) + 0.0 * y, 200, 60, cell=0.125)
    out = block_scale_grid(fine, DIAMETER)
    inner = np.s_[24:-24, 24:-24]
    kept = out.values[inner].std() / fine.values[inner].std()
    # Transfer of a Gaussian of standard deviation D/4 at the wave number 2π/λ.
    assert kept == pytest.approx(math.exp(-0.5 * (0.25 * 2.0 * np.pi / lengths) ** 2), abs=1e-4)


@pytest.mark.parametrize(("scale", "same"), [(0.0, True), (2.0, True), (2.01, False)])
def test_only_cells_finer_than_the_block(scale: float, same: bool) -> None:
    grid = grid_of(rough, 30, 30, cell=2.0)
    assert (block_scale_grid(grid, scale) is grid) is same


def test_profiles_follow_these_heights_and_maps_the_terrain_model(
    make_valley: Callable[..., Path],
) -> None:
    config = load_config(make_valley(), {"terrain.block_scale_m": 8.0, "run.seed": 3})
    run = read_map_run(config)
    assert run.block_scale_m == 8.0 and run.heights is run.ground_heights
    x, y = run.areas[0].geometry.centroid.coords[0]

    def gap(run: MapRun, heights: Grid) -> float:
        surface = fall_line_surface(run.grid, run.terrain)
        lines = trace(run.grid, surface, points_at(x, y), run.terrain)
        flat = prepare_lines(run, lines).flat
        z = flat.vertices(0)[1]
        # The first vertex is the start of the line: no tolerance there.
        return abs(float(z[0]) - float(heights_at(heights, lines.x[:1], lines.y[:1])[0]))

    assert gap(run, run.heights) < 1e-9 < 1e-3 < gap(run, run.grid)
    assert gap(replace(run, ground_heights=None), run.grid) < 1e-9


def test_the_default_is_the_smallest_scenario(make_valley: Callable[..., Path]) -> None:
    path = make_valley()
    smallest = min(b.mean_width_m for b in load_config(path).blocks)
    assert read_map_run(load_config(path)).block_scale_m == smallest
    for off in ({"terrain.block_scale_m": 0}, {"engine.readings": "1986"}):
        assert read_map_run(load_config(path, off)).block_scale_m == 0.0
    stated = {"engine.readings": "1986", "terrain.block_scale_m": 3.0}
    assert read_map_run(load_config(path, stated)).block_scale_m == 3.0
