"""Turns of the heading beyond those of the motion: closed forms on planes, and what they leave."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers.paths_lab import MIXED, STRAIGHT, paths
from helpers.terrains import folded, grid_of, middle
from scipy import stats

from sassgis.engine.effects import lateral_deflection
from sassgis.engine.effects.hooks import BLOCK_DTYPE
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.settings import EngineSettings


def deflected(grid, lateral, n, *, x=0.0, y=0.0, settings=STRAIGHT, **more):
    """Paths whose heading on a plane turns by the effect alone."""
    effects = EffectSettings(*([] if lateral is None else [lateral]))
    return paths(grid, x, y, n=n, settings=settings, effects=effects, keys=[0], **more)


def slope(bend=0.0):
    """A plane that falls to the east at 38°, hollow towards the row in its middle."""
    return grid_of(lambda x, y: 1000.0 - 0.78 * x + bend * y**2, 160, 160)


def across(grid, out):
    return out.y - middle(grid)[1]


@pytest.mark.parametrize("step", [pytest.param(0.3, marks=pytest.mark.battery), 4.0, 60.0])
def test_turns_come_after_hops_whatever_the_steps_of_the_path(step):
    # Hops of exponential length are a Poisson process: the variance of the sum is σ² L / h.
    sigma, hop, length, n = 7.0, 5.0, 120.0, 4000
    deflection = lateral_deflection.prepare(LateralDeflection("kicks", sigma, hop))
    turns = np.empty((n, 2))
    for i in range(n):
        for k, pace in enumerate((step, length)):
            state = np.zeros(1, BLOCK_DTYPE)[0]
            state.x = 10.0
            key = np.uint64(1000 + i)
            lateral_deflection.on_path(deflection, state, key)
            for x in np.append(np.arange(10.0, 10.0 + length, pace), 10.0 + length):
                state.x = x
                lateral_deflection.before_turn(deflection, state, key)
            turns[i, k] = state.turn
    assert np.array_equal(turns[:, 0], turns[:, 1])
    expected = math.radians(sigma) ** 2 * length / hop
    assert turns[:, 0].var() == pytest.approx(expected, rel=0.12)
    assert abs(turns[:, 0].mean()) < 4.0 * math.sqrt(expected / n)


def test_on_level_ground_the_heading_turns_as_the_hops_ask():
    """Nothing else turns it there: its variance is σ² L / h over paths of length L."""
    grid = grid_of(lambda x, y: 500.0 + 0.0 * x, 160, 160)
    pushed = dataclasses.replace(MIXED, speed_mps=(15.0, 25.0))
    sigma, hop, n = 3.0, 2.0, 1500
    out = deflected(grid, LateralDeflection("kicks", sigma, hop), n, blocks=pushed, log_events=4000)
    turned, ahead = [], []
    for log in out.event_logs:
        du, dv = np.diff(log["u"]), np.diff(log["v"])
        moved = np.hypot(du, dv) > 1e-6
        heading = np.arctan2(dv[moved], du[moved])
        turned.append(np.angle(np.exp(1j * (heading[-1] - heading[0]))))
        # One that rebounds backwards is turned about.
        ahead.append(np.abs(np.angle(np.exp(1j * (heading - heading[0])))).max() < 0.5 * math.pi)
    turned = np.array(turned)[ahead]
    assert np.mean(ahead) > 0.9
    expected = math.radians(sigma) ** 2 * out.rocks["runout_m"][ahead] / hop
    assert np.median(expected) > math.radians(6.0) ** 2
    ratio = np.square(turned).sum() / expected.sum()
    assert ratio == pytest.approx(1.0, abs=0.16)
    assert stats.ttest_1samp(turned, 0.0).pvalue > 1e-3


def test_constant_drifts_lie_evenly_within_the_width():
    grid, percent, n = slope(), 20.0, 800
    out = deflected(grid, LateralDeflection("constant", width_percent=percent), n, x=-140.0)
    down = out.x - middle(grid)[0] + 140.0
    share = across(grid, out)[down > 30.0] / down[down > 30.0]
    assert share.size > 0.5 * n
    half = 0.5 * percent / 100.0
    assert np.abs(share).max() < half + 1e-3
    assert stats.kstest(share, "uniform", (-half, 2.0 * half)).pvalue > 1e-3


@pytest.mark.parametrize("form", ["kicks", "constant"])
def test_without_strength_blocks_are_as_without_to_the_last_bit(form):
    grid = grid_of(folded, 260, 260, 1.0)

    def run(lateral):
        return deflected(grid, lateral, 120, settings=EngineSettings(), x=-80.0, y=3.0)

    base, off = run(None), run(LateralDeflection(form, angle_deg=0.0, width_percent=0.0))
    on = run(LateralDeflection(form))
    assert off.rocks.tobytes() == base.rocks.tobytes() != on.rocks.tobytes()
    assert off.x.tobytes() == base.x.tobytes() and off.y.tobytes() == base.y.tobytes()
    # Each block has the draws of its own as before: mass and start stay.
    for name in ("mass_kg", "a_m", "start_m"):
        assert on.rocks[name].tobytes() == base.rocks[name].tobytes()


def test_kicks_widen_the_map_to_both_sides_and_a_gully_holds_them():
    sides = {
        (angle, bend): across(
            slope(bend),
            deflected(
                slope(bend), LateralDeflection("kicks", angle, 5.0), 500, x=-140.0,
                settings=EngineSettings(drift_deg=0.0),
            ),
        )
        for angle, bend in ((0.0, 0.0), (20.0, 0.0), (20.0, 0.01))
    }  # fmt: skip
    narrow, wide, held = sides.values()
    assert wide.std() > 1.3 * narrow.std()
    assert stats.ks_2samp(wide, -wide).pvalue > 1e-3
    assert held.std() < 0.5 * wide.std()
