"""The ground ahead of a block on a path: its segments against the terrain, its cells as walked."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.paths_lab import MIXED, TABLE, paths
from helpers.terrains import grid_of, points_at
from scipy import ndimage

from sassgis.engine import statistics
from sassgis.engine.cell_register import empty_register
from sassgis.engine.draws import block_of
from sassgis.engine.effects.hooks import BLOCK_DTYPE
from sassgis.engine.ground_ahead import look_ahead, room_ahead
from sassgis.engine.heading import start_path
from sassgis.engine.simulate_paths import PathTerrain, path_of
from sassgis.grid import Grid
from sassgis.settings.map_run import ObjectCells
from sassgis.settings.settings import EngineSettings

CELL = 2.0
TOLERANCE = 0.2
AHEAD = 45.0


def sampled(seed: int):
    """Vertices and stretches ahead of a place on a rough slope with patches of two grounds."""
    rng = np.random.default_rng(seed)
    heights = ndimage.gaussian_filter(rng.normal(0.0, 1.0, (60, 60)), 1.0)
    heights += 0.6 * CELL * (rng.normal() * np.arange(60)[:, None] + rng.normal() * np.arange(60))
    grid = Grid(heights, 1000.0, 2000.0, CELL)
    classes = (rng.random((60, 60)) > 0.9).astype(np.int32)
    register = empty_register(grid.shape, 4096, None, ObjectCells.none())
    settings = EngineSettings(drift_deg=0.0).resolved()
    points = points_at(0.0, 0.0)
    path = path_of(PathTerrain(grid, classes, TOLERANCE), settings, register, points)
    site = room_ahead(np.zeros(2))
    state = np.zeros(1, BLOCK_DTYPE).view(np.recarray)[0]
    block = block_of(0.5, 0.4, 0.4, 2600.0, 800.0, np.uint64(seed))
    u, v = rng.uniform(28.0, 32.0, 2)
    assert start_path(None, state, block, site, path, u, v)
    look_ahead(state, block, site, path, AHEAD, 9.81)
    vertices, stretches = (t.rows[: t.n[0] + 1] for t in (site.profile, site.stretches))
    return heights, classes, register, state, vertices, stretches


@pytest.mark.parametrize("seed", range(12))
def test_segments_stay_near_the_terrain_and_stretches_name_its_cells(seed: int) -> None:
    heights, classes, register, state, vertices, stretches = sampled(seed)
    end = min(float(vertices["x"][-1]), AHEAD)
    assert end == AHEAD
    x = np.linspace(0.0, end, 4001)[1:-1]
    u = state.from_u + x * state.du
    v = state.from_v + x * state.dv
    # Bilinear between cell centres, by another program.
    terrain = ndimage.map_coordinates(heights, [v - 0.5, u - 0.5], order=1)
    ground = np.interp(x, vertices["x"], vertices["z"])
    on_plane = x < 0.05 * 0.4
    assert np.abs(ground - terrain)[~on_plane].max() < 1.3 * TOLERANCE + 1e-6
    starts = stretches["start"]
    assert (np.diff(starts) > 0.0).all()
    at = np.searchsorted(starts, x, side="right") - 1
    near_border = np.abs(x[:, None] - starts[None, :]).min(axis=1) < 1e-6
    named = register.cells[stretches["cell"][at]]
    walked = np.floor(v).astype(int) * 60 + np.floor(u).astype(int)
    assert (named == walked)[~near_border].all()
    under = vertices["ground"][stretches["segment"][at]]
    assert (under == classes.ravel()[walked])[~near_border & ~on_plane].all()


@pytest.mark.parametrize("room", [7, 2000, 6000])
def test_sums_do_not_depend_on_the_room_for_visits(monkeypatch, room: int) -> None:
    grid = grid_of(lambda x, y: 0.7 * y + 0.0 * x, 30, 40, CELL)

    blocks = dataclasses.replace(MIXED, drop_m=(0.0, 0.0))
    x, y = [0.0, 1.0, 6.0], [34.0, 32.0, 34.0]

    def sums() -> dict[str, np.ndarray]:
        out = paths(grid, x, y, n=40, on=TABLE, blocks=blocks, seed=3, keys=range(3))
        return out.sums

    whole = sums()
    monkeypatch.setattr(statistics, "VISITS", room)
    few = sums()
    assert whole["energy"].sum() > 900
    assert all((few[name] == whole[name]).all() for name in whole)
