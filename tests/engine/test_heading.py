"""How the heading of a followed path turns: closed forms, also as plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.engine_lab import ellipsoid, ground
from helpers.paths_lab import ends, paths
from helpers.terrains import grid_of

from sassgis.engine.heading import bending, bent
from sassgis.settings.settings import EngineSettings

pytestmark = pytest.mark.kernels

GROUND = ground(
    eta_max=0.85, dp_min=0.1, mu_f=0.7, mu_0=0.4, restitution=0.3, restitution_speed_mps=9.144,
    rolling_threshold=0.1,
)  # fmt: skip


@pytest.mark.parametrize("angle", [-3.0, -1.0, 0.4, 2.5])
def test_the_turn_on_the_ground_is_the_integral_of_its_rate(angle: float) -> None:
    gradient, speed, length = 0.7, 6.0, 9.0
    kappa = 9.81 * gradient / ((1.0 + gradient**2) * speed**2)
    assert bending(9.81, gradient**2, speed**2) == pytest.approx(kappa, rel=1e-12)
    chi, step = angle, length / 20_000
    for _ in range(20_000):
        half = chi - 0.5 * step * kappa * math.sin(chi)
        chi -= step * kappa * math.sin(half)
    assert angle - bent(angle, kappa * length) == pytest.approx(chi, abs=1e-8)


@pytest.mark.parametrize("angle", [-3.0, -0.01, 0.4, 3.1])
def test_an_angle_of_more_than_half_a_turn_is_turned_the_shorter_way(angle: float) -> None:
    """Less what is due already, the angle to a descent behind the block may be more than that."""
    for turns in (-1, 1):
        found = bent(angle + 2.0 * math.pi * turns, 0.3)
        assert found == pytest.approx(bent(angle, 0.3), abs=1e-12)


@pytest.mark.parametrize(("east", "south"), [(0.6, 0.0), (0.5, 0.3), (-0.2, 0.6)])
def test_without_chance_blocks_keep_to_the_fall_line_of_a_plane(east: float, south: float) -> None:
    grid = grid_of(lambda x, y: 500.0 - east * x + south * y, 60, 60)
    settings = EngineSettings(side_tilt_deg=0.0, drift_deg=0.0, rolling_friction_sd=0.0)
    out = paths(
        grid, n=4, on=GROUND, blocks=ellipsoid(0.45, 0.35, 0.3, drop_m=(1.0, 1.0)),
        settings=settings, seed=3,
    )  # fmt: skip
    x, y = ends(grid, out)
    assert np.all(out.rocks["runout_m"] > 10.0)
    assert np.abs(x * south + y * east).max() < 1e-6 * math.hypot(east, south)
