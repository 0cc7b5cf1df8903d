from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sassgis.grid import Grid
from sassgis.hazard.sources import _angle_deg, below_energy_line, foot_of_cliff, stated_angles
from sassgis.settings.map_run import BlockRows
from sassgis.settings.results import PASSAGE_DTYPE, ROCK_DTYPE
from sassgis.simulation.accumulators import (
    ChunkResult,
    Progress,
    add_chunk,
    joined_lines,
    kept_stops,
)
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.map_sums import MapSums


def slope(*, cliff: bool) -> Grid:
    """To the east a wall of 40 m that falls 2 m a metre, above a talus that falls half a metre."""
    x = np.arange(0.5, 300.0)
    steep = np.where(x < 40.0, 500.0 - 2.0 * x, 420.0 - 0.5 * (x - 40.0))
    heights = steep if cliff else 500.0 - 0.5 * x
    return Grid(np.tile(heights, (10, 1)), 0.0, 10.0, 1.0)


def test_the_cliff_ends_where_the_line_becomes_flatter() -> None:
    x, y, z = foot_of_cliff(slope(cliff=True), np.array([0.5, 250.5]), np.array([5.5, 5.5]))
    assert (x, y) == (40.5, 5.5)
    assert z == pytest.approx(419.75)


@pytest.mark.parametrize("x", [[0.5, 250.5], [0.5, 0.5], [0.5]])
def test_without_a_cliff_there_is_no_foot(x: list[float]) -> None:
    foot = foot_of_cliff(slope(cliff=False), np.array(x), np.full(len(x), 5.5))
    assert np.isnan(foot).all()


def test_angles_are_those_of_the_straight_line() -> None:
    upper = np.array([[0.0, 0.0, 100.0], [0.0, 0.0, 10.0], [5.0, 5.0, 9.0], [np.nan] * 3])
    lower = np.array([[60.0, 80.0, 0.0], [10.0, 0.0, 12.0], [5.0, 5.0, 3.0], [0.0, 0.0, 0.0]])
    angles = _angle_deg(upper, lower)
    assert angles[0] == pytest.approx(45.0)
    assert np.isnan(angles[1:]).all()


def test_the_energy_line_of_a_tower_on_a_plain_is_a_cone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """100 m high: the line of 45° meets the plain at 100 m, a hill of 60 m within 40 m."""
    heights = np.zeros((250, 250))
    heights[125, 125], heights[125, 155], heights[125, 175] = 100.0, 60.0, 60.0
    grid = Grid(heights, 0.0, 250.0, 1.0)
    grid.values[0, 125] = np.nan
    row, col = np.indices(heights.shape)
    distance = np.hypot(row - 125, col - 125)
    # A point on the plain within the cone of the first adds nothing.
    x, y = np.array([125.5, 140.5]), np.array([124.5, 124.5])
    below = below_energy_line(grid, x, y, 45.0)
    plain = (heights == 0.0) & np.isfinite(heights)
    assert (below[plain] == (distance[plain] <= 100.0 + 1e-9)).all()
    assert below[125, 155] and not below[125, 175]
    assert below.sum() == pytest.approx(np.pi * 100.0**2, rel=0.01)
    # Square by square it is the same but for the squares at its rim.
    monkeypatch.setattr("sassgis.hazard.sources._PAIRS", 250.0**2 / 16.0)
    coarse = below_energy_line(grid, x, y, 45.0)
    assert coarse.shape == grid.shape and not coarse[0, 125]
    assert (distance[plain & (coarse != below)] - 100.0 < 4.0).all()
    assert coarse.sum() == pytest.approx(np.pi * 100.0**2, rel=0.02)


def test_the_stated_angles_are_those_that_99_95_and_50_percent_of_the_blocks_stop_above() -> None:
    angles = np.append(np.arange(0.0, 101.0), np.nan)
    assert stated_angles(angles).tolist() == pytest.approx([1.0, 5.0, 50.0])
    assert not stated_angles(np.array([np.nan])).size


def ended(point: int, blocks: int, weight: int) -> ChunkResult:
    """Blocks of one release point that end as far away as its number, in metres."""
    rocks = np.zeros(blocks, ROCK_DTYPE)
    rocks["line"], rocks["rock"], rocks["runout_m"] = point, np.arange(blocks), point
    place, passages = np.zeros(blocks), np.zeros(0, PASSAGE_DTYPE)
    rows = BlockRows.of_chunk(rocks, place, place, passages, 0, weight)
    return ChunkResult(0, np.array([point]), weight, {}, rows, joined_lines([]), 0)


@pytest.mark.parametrize("most", [100_000, 800])
@pytest.mark.parametrize("heavy_first", [False, True])
def test_stops_that_are_kept_are_those_of_all_blocks(most: int, heavy_first: bool) -> None:
    """Two points with as many blocks each, of which those of one are an eighth that count 8."""
    run: Any = SimpleNamespace(
        seed=5, stop_points_max=most, release=SimpleNamespace(rocks_per_point=8)
    )
    progress = Progress(0, MapSums(4), ControlLineSums(()))
    chunks = [ended(1, 8000, 1), ended(2, 1000, 8)]
    for chunk in chunks[::-1] if heavy_first else chunks:
        add_chunk(progress, chunk, run)
    kept = kept_stops(run, progress).rocks["runout_m"]
    assert kept.size > 0.4 * min(most, 2000)
    # Half of them, within four standard errors.
    assert abs((kept == 1.0).mean() - 0.5) < 2.0 / np.sqrt(kept.size)
    assert kept.size <= most
