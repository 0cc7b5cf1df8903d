"""Residuals of one step and of free runs: the law of impact, tolerances, stations."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers.simulated_slope import BASE, STATIONS, observed, with_passages

from sassgis.engine.effects import hooks, soft_ground
from sassgis.engine.effects.roughness import Roughness
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.ellipse import frame_of, inertia
from sassgis.engine.impact import SCALE, impact
from sassgis.engine.simulate import physics_of
from sassgis.gap.residuals.impact_residuals import impact_draws, orientation_at_contact
from sassgis.gap.residuals.residual_table import reach_edges
from sassgis.gap.residuals.rock_residuals import Residual, beyond, mean_of_draws, only_above, spread
from sassgis.gap.residuals.stop_residuals import free_run, observed_at_stations
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundClass, GroundTable
from sassgis.settings.settings import EngineSettings


def rebounds(dip, state, eta_max, r, draws, effects=None):
    """v_t, v_n, ω after one impact of spheres of radius r with some draws, shape (m, 3)."""
    ground = GroundTable(
        (
            GroundClass(
                "ground",
                eta_max=eta_max,
                dp_min=0.0,
                dp_max=0.0,
                mu_f=0.7,
                mu_0=0.5,
                k=0.2,
                d_star_m=0.3,
            ),
        )
    )
    own = EffectSettings() if effects is None else effects
    out = np.empty((1, len(draws), 3))
    keys = np.arange(len(draws), dtype=np.uint64)
    impact_draws(
        np.array([[dip, *state]]), np.zeros(1, np.int64), np.full((1, len(draws), 3), r),
        np.array(draws, float)[None], keys[None], np.array([2700.0]),
        hooks.ground_of(own, ground.with_rolling_threshold(0.1)),
        np.zeros(1, hooks.BLOCK_DTYPE), physics_of(EngineSettings(readings="1986").resolved()),
        hooks.prepare(own, has_stems=False), out,
    )  # fmt: skip
    return out[0]


def test_an_impact_of_a_sphere_is_that_of_the_law():
    """A sphere has no orientation: with an even slope nothing is left to chance."""
    r, draws = 0.4, [[phase, 0.0, 0.0] for phase in (0.1, 1.0, 2.0)]
    out = rebounds(math.radians(35.0), (9.0, -4.0, 15.0), 0.5, r, draws)
    expected = impact(0.0, r, inertia(r, r), 9.0, -4.0, 15.0, 0.5, SCALE, 0.7)
    np.testing.assert_allclose(out, np.tile(expected, (3, 1)), rtol=1e-12)


def test_the_slope_that_is_met_is_flatter_by_the_variation():
    """Half of the tangent: the velocity is taken apart along the met ground and put back."""
    r, dip = 0.4, math.radians(40.0)
    (out,) = rebounds(dip, (12.0, -5.0, 20.0), 1.0, r, [[0.0, 0.5, 0.0]])
    met = math.atan(0.5 * math.tan(dip))

    def apart(vx: float, vz: float, angle: float) -> tuple[float, float]:
        c, s = math.cos(angle), math.sin(angle)
        return vx * c - vz * s, vx * s + vz * c

    vx = 12.0 * math.cos(dip) + -5.0 * math.sin(dip)
    vz = -12.0 * math.sin(dip) + -5.0 * math.cos(dip)
    vt, vn = apart(vx, vz, met)
    wt, wn, spin = impact(0.0, r, inertia(r, r), vt, vn, 20.0, 1.0, SCALE, 0.7)
    ux = wt * math.cos(met) + wn * math.sin(met)
    uz = -wt * math.sin(met) + wn * math.cos(met)
    np.testing.assert_allclose(out, (*apart(ux, uz, dip), spin), rtol=1e-12)


def test_soft_landings_are_left_to_rolling():
    assert np.isnan(rebounds(0.5, (5.0, -0.3, 10.0), 0.5, 0.5, [[0.0, 0.0, 0.0]] * 4)).all()


def test_effects_act_in_one_step_as_in_the_motion():
    """Soft ground takes what its own law takes; rough ground scatters the rebound."""
    state, draws = (9.0, -4.0, 15.0), [[0.0, 0.0, 0.0]] * 200
    soft = SoftGround(classes=(), form="velocity_scaled", reference_speed_mps=2.0)
    plain = rebounds(0.5, state, 0.5, 0.4, draws)
    yielding = rebounds(0.5, state, 0.5, 0.4, draws, effects=EffectSettings(soft))
    mass = 4.0 / 3.0 * math.pi * 0.4**3 * 2700.0
    expected = soft_ground.after_impact(soft_ground.prepare(soft), mass, 0.4, 4.0, *plain[0])
    np.testing.assert_allclose(yielding, np.tile(expected, (200, 1)), rtol=1e-12)
    rough = rebounds(0.5, state, 0.5, 0.4, draws, effects=EffectSettings(Roughness(obstacle_m=0.2)))
    angle = np.arctan2(rough[:, 1], rough[:, 0])
    assert plain.std(axis=0).max() < 1e-12 < 0.1 < angle.std()


@pytest.mark.parametrize("omega", [0.0, 8.0, 40.0, -25.0])
def test_at_contact_the_ellipse_touches_and_approaches(omega):
    a, b, vn = 0.6, 0.4, -3.0
    for phase in np.linspace(0.0, math.pi, 37):
        theta = orientation_at_contact(a, b, phase, vn, omega)
        _, y, _ = frame_of(a, b, math.sin(theta), math.cos(theta))
        if omega:
            t = (phase - theta) / omega
            assert a + vn * t == pytest.approx(y, abs=1e-6)
            # And not before.
            for earlier in np.linspace(0.0, t, 50)[:-1]:
                angle = phase - omega * earlier
                assert (
                    a + vn * earlier >= math.hypot(a * math.sin(angle), b * math.cos(angle)) - 1e-3
                )
        else:
            assert theta == phase


def test_scatter_of_exchangeable_draws_is_as_expected():
    rng = np.random.default_rng(1)
    for m in (7, 20):
        values = rng.gamma(2.0, size=(20_000, m + 1))
        away, usual, score = spread(values[:, 0], values[:, 1:])
        assert score.mean() == pytest.approx(0.0, abs=4.0 * score.std() / 141.0)
        assert away.mean() == pytest.approx(usual.mean(), rel=0.03)
        _, _, wide = spread(3.0 * (values[:, 0] - 2.0) + 2.0, values[:, 1:])
        assert wide.mean() > 0.05
    away, usual, score = spread(np.array([1.0, np.nan]), np.array([[1.0, np.nan], [1.0, 2.0]]))
    assert np.isnan(score).all()


def test_tolerances():
    np.testing.assert_allclose(beyond(np.array([1.0, 3.0, np.nan]), 0.5)[:2], [0.5, 2.5])
    np.testing.assert_allclose(beyond(np.array([-0.1, 0.3]), 0.5).mean(), 0.0, atol=1e-15)
    assert (only_above(np.array([-1.0, 0.5])) == 0.0).all()
    np.testing.assert_allclose(only_above(np.array([-0.1, 0.5])), [-0.1, 0.5])
    assert np.isnan(mean_of_draws(np.array([[1.0, np.nan, np.nan]]))).all()


def test_weights_of_residuals():
    """The tested values have the weighted mean; rocks without one count for nothing."""
    weight = np.array([1.0, 3.0, 9.0])
    seen = np.array([1.0, 2.0, np.nan])
    r = Residual(
        "S1", "flight", "speed_mps", "one step", seen, np.zeros(3), 0.0, 0.0, weight=weight
    )
    assert np.nanmean(r.tested()) == pytest.approx((1.0 + 3.0 * 2.0) / 4.0)
    assert r.unit == "m/s"
    assert dataclasses.replace(r, quantity="rebound_angle_deg_spread").unit == "°"
    assert dataclasses.replace(r, quantity="energy_kept").unit == "1"
    assert dataclasses.replace(r, quantity="runout_m").unit == "m"
    assert dataclasses.replace(r, quantity="acceleration_mps2").unit == "m/s²"


def test_rocks_that_stop_or_pass_are_told_apart():
    case = observed(12, 1, tables=("passages", "deposits"))
    seen = observed_at_stations(case)
    assert seen.speed_mps.shape == (12, 4)
    np.testing.assert_array_equal(seen.arrived == 1.0, np.isfinite(seen.speed_mps))
    # A rock seen further down has passed, also where nobody looked.
    hidden = with_passages(case, case.observations.passages.station != "S2")
    np.testing.assert_array_equal(observed_at_stations(hidden).arrived, seen.arrived)


def test_runs_from_the_release_are_those_of_the_engine():
    case = observed(8, 2, tables=("deposits",))
    run = free_run(case, BASE, 4, 6)
    assert run.ends.runout_m.shape == (8, 6) and run.axes_m.shape == (8, 6, 3)
    assert (run.ends.stops == 1.0).all() and (run.ends.largest == 1.0).all()
    arrived = run.at.arrived == 1.0
    np.testing.assert_array_equal(
        arrived, run.ends.runout_m[:, :, None] >= case.station_s[:, None, :]
    )
    np.testing.assert_array_equal(arrived, np.isfinite(run.at.speed_mps))
    edges = reach_edges(case, run)
    np.testing.assert_allclose(edges[1:, 0], STATIONS, atol=0.1)
    np.testing.assert_array_equal(edges[1:, 0], edges[:-1, 1])
