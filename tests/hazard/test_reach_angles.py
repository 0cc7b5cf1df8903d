from __future__ import annotations

import numpy as np
import pytest

from sassgis.hazard.reach_angles import _angle_deg, foot_of_cliff
from sassgis.model.grid import Grid


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
