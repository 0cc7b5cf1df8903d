"""Bins of the histograms hold whatever can happen on a terrain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.settings import EngineSettings
from sassgis.settings.statistics_table import bins_for

BLOCK = BlockPopulation()


def most(block: BlockPopulation, relief_m: float, gravity: float) -> tuple[float, float]:
    """Energy (kJ) and speed (m/s) of a block that loses nothing on its way down."""
    fall = relief_m + block.drop_m[1]
    square = block.speed_mps[1] ** 2 + 2.0 * gravity * fall
    return 5e-4 * block.mass_limits_kg[1] * square, float(np.sqrt(square))


@pytest.mark.parametrize(
    "block",
    [BLOCK, replace(BLOCK, drop_m=(0.0, 40.0)), replace(BLOCK, speed_mps=(0.0, 30.0))],
    ids=["at rest", "dropped", "thrown"],
)
@pytest.mark.parametrize("gravity", [9.81, 20.0])
def test_no_block_is_beyond_the_last_bin(block: BlockPopulation, gravity: float) -> None:
    bins = bins_for(60.0, [BLOCK, block], EngineSettings(gravity_mps2=gravity))
    energy, speed = most(block, 60.0, gravity)
    assert bins.edges["energy"][-1] >= energy
    assert bins.edges["speed"][-1] >= speed
    assert bins.edges["height"][-1] >= 60.0 + block.drop_m[1]


def test_thresholds_are_among_the_energies_of_the_curves() -> None:
    assert {12.5, 77.0} <= set(bins_for(60.0, [BLOCK], EngineSettings(), (12.5, 77.0)).threshold)
