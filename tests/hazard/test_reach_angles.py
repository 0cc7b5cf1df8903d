from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sassgis.grid import Grid
from sassgis.hazard.sources import _angle_deg, foot_of_cliff
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
