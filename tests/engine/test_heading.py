"""How the heading of a followed path turns: closed forms, also as plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sassgis.engine.heading import _bending, _bent
from sassgis.engine.simulate import Simulated
from sassgis.engine.simulate_paths import PathTerrain, follow
from sassgis.model.blocks import BlockPopulation
from sassgis.model.grid import Grid
from sassgis.model.ground import GroundClass, GroundTable
from sassgis.model.profiles import ReleasePoints
from sassgis.model.settings import EngineSettings

pytestmark = pytest.mark.kernels

CELL, SIDE = 2.0, 60
TABLE = GroundTable(
    (
        GroundClass(
            "slope",
            eta_max=0.85,
            dp_min=0.1,
            dp_max=0.3,
            mu_f=0.7,
            mu_0=0.4,
            k=0.2,
            d_star_m=0.2,
            restitution=0.3,
            restitution_speed_mps=9.144,
            rolling_threshold=0.1,
        ),
    )
)
BLOCKS = BlockPopulation(
    "b", (0.45, 0.45), (0.35, 0.35), (0.3, 0.3), (2700.0, 2700.0), (0.0, 0.0), (0.0, 0.0),
    (1.0, 1.0),
)  # fmt: skip


def plane(east: float, south: float, rocks: int = 4, **engine: float) -> Simulated:
    """Blocks from the middle of a plane that falls by so much per metre to the east and south."""
    along = (np.arange(SIDE) + 0.5) * CELL
    z = 500.0 - east * along[None, :] - south * along[:, None]
    grid = Grid(z, 0.0, SIDE * CELL, CELL)
    middle = np.array([0.5 * SIDE * CELL])
    points = ReleasePoints(
        middle, middle.copy(), np.zeros(1, np.int64), np.array([7], np.uint64), ("a",)
    )
    return follow(
        PathTerrain(grid, np.zeros(grid.shape, np.int32), 0.25), points, TABLE, BLOCKS,
        EngineSettings(**engine), seed=3, rocks_per_point=rocks, point_keys=points.key,
        log_events=400,
    )  # fmt: skip


@pytest.mark.parametrize("angle", [-3.0, -1.0, 0.4, 2.5])
def test_the_turn_on_the_ground_is_the_integral_of_its_rate(angle: float) -> None:
    gradient, speed, length = 0.7, 6.0, 9.0
    kappa = 9.81 * gradient / ((1.0 + gradient**2) * speed**2)
    assert _bending(9.81, gradient**2, speed**2) == pytest.approx(kappa, rel=1e-12)
    chi, step = angle, length / 20_000
    for _ in range(20_000):
        half = chi - 0.5 * step * kappa * math.sin(chi)
        chi -= step * kappa * math.sin(half)
    assert angle - _bent(angle, kappa * length) == pytest.approx(chi, abs=1e-8)


@pytest.mark.parametrize(("east", "south"), [(0.6, 0.0), (0.5, 0.3), (-0.2, 0.6)])
def test_without_chance_blocks_keep_to_the_fall_line_of_a_plane(east: float, south: float) -> None:
    out = plane(east, south, side_tilt_deg=0.0, drift_deg=0.0)
    middle = 0.5 * SIDE * CELL
    across = ((out.x - middle) * south + (out.y - middle) * east) / math.hypot(east, south)
    assert np.all(out.rocks["runout_m"] > 10.0)
    assert np.abs(across).max() < 1e-6


def test_chance_moves_blocks_to_both_sides_and_makes_no_energy() -> None:
    out = plane(0.6, 0.0, rocks=12, side_tilt_deg=15.0, drift_deg=3.0)
    across = out.y - 0.5 * SIDE * CELL
    assert (across > 0.1).any() and (across < -0.1).any()
    inertia = (0.45**2 + 0.35**2) / 5.0
    for log in out.event_logs:
        energy = 9.81 * log["z_m"] + 0.5 * (
            log["vx_mps"] ** 2 + log["vz_mps"] ** 2 + inertia * log["omega_radps"] ** 2
        )
        assert np.diff(energy).max() < 1e-6
