"""Warnings where results go beyond what was measured on rocks."""

from __future__ import annotations

import numpy as np
import pytest

from sassgis.hazard.design import (
    measured_at,
    measured_motion,
    motion_warnings,
    size_warnings,
)
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.statistics_table import built_in_rows

SMALL = BlockPopulation("small", (0.2, 0.2), (0.2, 0.2), (0.1, 0.2))
LARGE = BlockPopulation("large", volume_m3=(0.2, 3.0))


def test_the_table_rises_and_names_its_sources() -> None:
    assert np.all(np.diff([row["volume_to_m3"] for row in measured_motion()]) > 0.0)
    assert all(row["source"] for row in built_in_rows("measured_motion"))


def test_the_class_of_a_size_is_that_of_its_largest_block() -> None:
    assert SMALL.volume_limits_m3[1] == pytest.approx(4.0 / 3.0 * np.pi * 0.2**3)
    assert LARGE.volume_limits_m3[1] == 3.0
    first, *_, last = measured_motion()
    assert measured_at(0.5 * first["volume_to_m3"]) is first
    assert measured_at(10.0 * last["volume_to_m3"]) is last


def test_only_scenarios_beyond_all_measurements_are_told() -> None:
    assert size_warnings((SMALL,)) == []
    (said,) = size_warnings((SMALL, LARGE))
    assert "large (3 m³)" in said and "small" not in said


def test_maps_beyond_measurements_are_told_with_how_far() -> None:
    limit = measured_at(3.0)["speed_mps"]
    speed = np.full((10, 10), np.nan)
    speed[:5] = 0.5 * limit
    within = {"speed_mps": speed, "height_m": np.zeros((10, 10))}
    assert motion_warnings((LARGE,), within) == []
    speed[0] = 1.2 * limit
    (said,) = motion_warnings((LARGE,), {"speed_mps": speed})
    # 10 of 50 cells, a fifth beyond.
    assert said.startswith("On 20 % of the reached area, 95 % speeds exceed 30 m/s")
    assert "They reach 36 m/s (20 % more)." in said
    # Smaller blocks were measured slower.
    assert motion_warnings((SMALL,), {"speed_mps": np.full((2, 2), 0.9 * limit)})
