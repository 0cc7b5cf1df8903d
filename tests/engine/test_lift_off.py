"""Where the ground ceases to bear a rolling ellipse."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sassgis.engine.draws import block_of
from sassgis.engine.ellipse import frame_of
from sassgis.engine.impact import normal_force
from sassgis.engine.rolling import Way, lift_off_angle, lift_off_speed

pytestmark = pytest.mark.kernels

G = 9.81


def _rolling(seed):
    """A block and its way, fast enough to leave the ground where it would stand upright."""
    rng = np.random.default_rng(seed)
    a = rng.uniform(0.2, 2.0)
    block = block_of(a, a * rng.uniform(0.5, 0.98), 0.2, 2700.0, 100.0, np.uint64(1))
    slope = rng.uniform(-0.2, 0.8)
    pull = G * rng.uniform(-0.2, 0.6)
    first = block.roll_radius * rng.uniform(0.3, 3.0)
    least = lift_off_speed(block, G, math.cos(slope))
    fade = rng.choice([0.0, 0.02, 0.3])
    v2 = max(least**2 * rng.uniform(1.0, 3.0) - 2.0 * pull * first, 0.1)
    return block, Way(math.sqrt(v2), pull, fade, first, G * math.cos(slope), G * math.sin(slope))


def _force(block, way, angle):
    """The force from the energy and the general law of the rolling ellipse (m/s²)."""
    x, y, curvature = frame_of(block.a, block.b, math.cos(angle), -math.sin(angle))
    path = way.first - block.roll_radius * angle
    here2 = way.v**2 + 2.0 * way.pull * path
    if way.fade > 0.0:
        steady2 = way.v**2 + way.pull / way.fade
        here2 = steady2 + (way.v**2 - steady2) * math.exp(-2.0 * way.fade * path)
    twice = block.roll_share * max(here2, 0.0) - 2.0 * way.weight * (y - block.roll_radius)
    spin = math.sqrt(max(twice / (block.inertia + x * x + y * y), 0.0))
    return normal_force(x, y, curvature, block.inertia, spin, way.weight / G, way.push / G, G)


@pytest.mark.parametrize("seed", range(40))
def test_it_leaves_where_the_force_ends(seed):
    block, way = _rolling(seed)
    angle = lift_off_angle(block, way)
    high = min(1.5, way.first / block.roll_radius)
    assert 0.0 <= angle <= high
    if 0.0 < angle < high:
        # Borne just before, which is at a larger angle, and no more just after.
        assert _force(block, way, angle + 1e-7) > 0.0 > _force(block, way, angle - 1e-7)
    # What comes before is borne everywhere.
    before = np.linspace(angle + 1e-7, high, 200)[:-1] if angle < high else []
    assert all(_force(block, way, one) > 0.0 for one in before)
