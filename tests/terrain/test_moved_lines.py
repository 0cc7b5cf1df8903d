"""Copies of a line up and down the slope."""

from __future__ import annotations

import numpy as np
import pytest

from sassgis.grid import Grid
from sassgis.settings.results import ControlLine
from sassgis.terrain.fall_lines import MOVES_M, mean_height_m, moved_lines

NET = ControlLine("net", "net", 3.0)


def plane(rows: int = 100, cols: int = 100) -> Grid:
    """Cells of 2 m that fall by 3 in 5 to the north-east."""
    row, col = np.mgrid[:rows, :cols] * 2.0
    return Grid(1000.0 + 0.6 * row / np.sqrt(2.0) - 0.6 * col / np.sqrt(2.0), 0.0, 200.0, 2.0)


def test_copies_lie_down_the_slope_by_as_much_as_they_are_moved() -> None:
    trace = np.array([[90.0, 110.0], [110.0, 90.0]])
    copies = moved_lines(plane(), [(NET, trace)])
    assert [c.moved_m for c in copies] == list(MOVES_M)
    here = mean_height_m(plane(), trace)
    for copy in copies:
        assert copy.trace == pytest.approx(trace + copy.moved_m / np.sqrt(2.0), abs=0.01)
        fallen = here - mean_height_m(plane(), copy.trace)
        assert fallen == pytest.approx(0.6 * copy.moved_m, abs=1.0)
        line, there = copy.as_station("net")
        assert line == ControlLine(f"net {copy.moved_m:+g} m", "station") and there is copy.trace


def test_copies_that_leave_the_terrain_are_left_out() -> None:
    near = np.array([[170.0, 195.0], [195.0, 170.0]])
    assert [c.moved_m for c in moved_lines(plane(), [(NET, near)])] == [-60.0, -40.0, -20.0]
    hole = plane()
    hole.values[:60, :60] = np.nan
    assert all(c.moved_m > 0.0 for c in moved_lines(hole, [(NET, near - 60.0)]))


def test_on_level_ground_and_of_many_lines_there_are_none() -> None:
    trace = np.array([[90.0, 110.0], [110.0, 90.0]])
    level = Grid(np.full((100, 100), 5.0), 0.0, 200.0, 2.0)
    assert moved_lines(level, [(NET, trace)]) == ()
    assert moved_lines(plane(), [(NET, trace)] * 16) == ()
