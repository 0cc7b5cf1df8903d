"""Short ways to make profiles, grounds and runs for the tests of the engine."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.effects_lab import (  # noqa: F401 - for the tests
    END,
    FLIGHT,
    IMPACT,
    MIXED,
    PAPER,
    ROLLING,
    SLIDING,
    ellipsoid,
    plain,
    profile_set,
    run,
    slope,
    sphere,
)
from helpers.effects_lab import ground as rough_ground

from sassgis.model.settings import EngineSettings

#: The settings that are for hazard work, which are the usual ones.
HAZARD = EngineSettings()
#: Table 1 of Bozzolo and Pamini (1986), with frictions from the middle of their ranges.
ROCK = rough_ground("rock")
DEBRIS = rough_ground("debris", eta_max=0.55, dp_min=0.2, dp_max=0.6, d_star_m=0.3)


def with_settings(**changes) -> EngineSettings:
    """The words of the paper with changes."""
    return dataclasses.replace(PAPER, **changes)


def rough(seed, step=0.5, length=120.0, angle=36.0, amplitude=0.15, foot=40.0):
    """A rough slope with a flat foot, segments of ``step``; (s, z)."""
    rng = np.random.default_rng(seed)
    s = np.arange(0.0, length + foot + step, step)
    z = -np.tan(np.radians(angle)) * np.minimum(s, length)
    noise = rng.normal(0.0, amplitude, s.size)
    return s, z + noise + 1000.0


def valley():
    """A smooth slope that flattens step by step: 30, 65, 36, 18 and 0 degrees."""
    return slope((50, 30), (10, 65), (140, 36), (200, 18), (300, 0))


LINES = {"smooth": valley(), "rough": rough(3, amplitude=0.1)}
#: A test on a smooth and a rough ``line``.
on_both_lines = pytest.mark.parametrize("line", LINES.values(), ids=LINES)
