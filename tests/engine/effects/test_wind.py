"""A steady wind against its closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import engine_lab as lab
from scipy.integrate import solve_ivp

from sassgis.engine.effects import wind
from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.trees import Trees
from sassgis.engine.effects.wind import WIND_STEP_S, Wind
from sassgis.engine.ellipse import inertia
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.settings import EngineSettings

pytestmark = pytest.mark.kernels

FLAT = lab.slope((400.0, 0.0))
START_M = 150.0


def landing(acceleration, speed=5.0, drop=60.0, others=(), radius=0.3):
    """The first impact of a sphere that falls on level ground."""
    blocks = lab.sphere(radius, drop_m=(drop, drop), speed_mps=(speed, speed))
    out = lab.run(
        FLAT, lab.plain(), blocks, EffectSettings(Wind(acceleration), *others), start=START_M,
        log_events=1000, settings=EngineSettings(readings="1986", rolling_threshold=0.0),
    )  # fmt: skip
    return lab.first(out.event_logs[0], lab.IMPACT)


# The last turns the block back in flight.
FALLS = [(0.4, 5.0), (5.0, 0.0), (-1.0, 20.0), (-3.0, 2.0)]


@pytest.mark.parametrize(("acceleration", "speed"), FALLS)
def test_a_fall_on_level_ground_is_a_parabola_in_both_directions(acceleration, speed):
    met = landing(acceleration, speed)
    t = met["t_s"]
    assert t == pytest.approx(math.sqrt(2.0 * 60.0 / lab.G), rel=1e-6)
    assert met["vx_mps"] == pytest.approx(speed + acceleration * t, rel=1e-12)
    assert met["vz_mps"] == pytest.approx(-lab.G * t, rel=1e-12)
    # Within a step the block moves along a chord or tangent.
    bound = abs(acceleration) * WIND_STEP_S**2 / 8.0
    x = START_M + speed * t + 0.5 * acceleration * t**2
    assert met["x_m"] == pytest.approx(x, rel=0.0, abs=bound + 1e-9)


def test_the_step_is_of_second_order(monkeypatch):
    # The fall ends a third of a step from where the chainage is exact, before or after, whether
    # the step is 0.2, 0.1 or 0.05 s: the error is a (h/3)²/2.
    t, acceleration = 0.2 * (20.0 + 1.0 / 3.0), 2.0
    exact = START_M + 5.0 * t + 0.5 * acceleration * t**2
    for step in (0.2, 0.1, 0.05):
        monkeypatch.setattr(wind, "WIND_STEP_S", step)
        met = landing(acceleration, drop=0.5 * lab.G * t**2)
        assert met["vx_mps"] == pytest.approx(5.0 + acceleration * t, rel=1e-6)
        assert exact - met["x_m"] == pytest.approx(0.5 * acceleration * (step / 3.0) ** 2, rel=0.02)


def test_with_the_drag_of_the_air_it_agrees_with_a_solver_of_differential_equations():
    radius, acceleration, speed = 0.05, 2.0, 30.0
    k = 0.5 * 1.1 * 3.0 * math.pi * radius**2 / lab.sphere_mass(radius)

    def moves(_t, y):
        v = math.hypot(y[2], y[3])
        return [y[2], y[3], acceleration - k * v * y[2], -lab.G - k * v * y[3]]

    def lands(_t, y):
        return y[1]

    lands.terminal = True
    exact = solve_ivp(
        moves, (0.0, 60.0), [START_M, 60.0, speed, 0.0], events=lands, rtol=1e-11, atol=1e-11
    )
    x, _, vx, vz = exact.y[:, -1]
    met = landing(acceleration, speed, others=(AirDrag(drag_coefficient=3.0),), radius=radius)
    assert met["t_s"] == pytest.approx(exact.t[-1], rel=5e-4)
    assert met["x_m"] - START_M == pytest.approx(x - START_M, rel=5e-4)
    assert met["vx_mps"] == pytest.approx(vx, rel=5e-4)
    assert met["vz_mps"] == pytest.approx(vz, rel=5e-4)


@pytest.mark.parametrize("angle", [36.0, -36.0])
def test_no_wind_on_the_ground(angle):
    # Down a slope from rest, and up one until it turns back.
    line = lab.slope((200.0, angle))
    blocks = lab.sphere(0.4, speed_mps=(0.0, 0.0) if angle > 0.0 else (12.0, 12.0))
    still, blown = (
        lab.run(line, lab.plain(), blocks, effects, log_events=500)
        for effects in (None, EffectSettings(Wind(5.0)))
    )
    assert not (blown.event_logs[0]["phase"] == lab.FLIGHT).any()
    assert still.rocks["runout_m"][0] > 5.0 or angle < 0.0
    assert lab.same(blown, still)


@pytest.mark.parametrize("acceleration", [-5.0, 0.4])
@pytest.mark.parametrize(
    "others", [(), (AirDrag(drag_coefficient=10.0), Trees("viscous"))], ids=["wind", "all"]
)
def test_no_energy_but_that_of_gravity_and_the_wind(acceleration, others):
    flat = lab.profile_set(lab.rough_slope(5))
    out = lab.run(
        flat, lab.ground(eta_max=0.9), lab.MIXED, EffectSettings(Wind(acceleration), *others), n=30,
        start=(3.0, 20.0), log_events=30_000, forest=lab.forest(flat, 0.03),
    )  # fmt: skip
    assert (out.rocks["reason"] != lab.STEP_LIMIT).all()
    flights = 0
    for block, log in zip(out.rocks, out.event_logs, strict=True):
        moment = inertia(block["a_m"], block["b_m"])
        speed2 = log["vx_mps"] ** 2 + log["vz_mps"] ** 2 + moment * log["omega_radps"] ** 2
        gained = np.diff(0.5 * speed2 + lab.G * log["z_m"])
        flying = log["phase"][:-1] == lab.FLIGHT
        flights += flying.sum()
        # Not from the chainage: a block that lands softly is moved to where it rolls.
        t = np.diff(log["t_s"])
        work = acceleration * (log["vx_mps"][:-1] * t + 0.5 * acceleration * t**2)
        # The drag shortens the path against the wind, within a step.
        room = (acceleration * WIND_STEP_S) ** 2 / 8.0 if others else 0.0
        assert (gained <= np.where(flying, work + room, 0.0) + 1e-6).all()
    assert flights > 200


@pytest.mark.compiled
def test_a_block_that_leaves_the_ground_is_not_pushed_back_into_it():
    # With symmetric pushes three of four flights against this wind end as they begin.
    out = lab.run(
        lab.rough_slope(5), lab.ground(eta_max=0.9), lab.MIXED, EffectSettings(Wind(-5.0)), n=60,
        start=(3.0, 20.0), log_events=30_000,
    )  # fmt: skip
    lasted = []
    for log in out.event_logs:
        left = (
            np.flatnonzero((log["phase"][:-1] == lab.IMPACT) & (log["phase"][1:] == lab.FLIGHT)) + 1
        )
        lasted += list(log["t_s"][left + 1] - log["t_s"][left])
    assert len(lasted) > 200
    assert max(lasted) <= 0.5 * WIND_STEP_S + 1e-12
    assert np.mean(np.array(lasted) > 1e-6) > 0.95


@pytest.mark.compiled
def test_a_stem_that_the_wind_carries_a_block_past_is_met_at_once():
    """The way to a stem is counted before the push: it was negative, and time ran backwards."""
    flat = lab.profile_set(lab.rough_slope(5))
    out = lab.run(
        flat, lab.ground(eta_max=0.9), lab.MIXED,
        EffectSettings(Wind(5.0), Trees(efficiency=1e-3)), n=30, start=(3.0, 20.0),
        log_events=30_000, forest=lab.forest(flat, 2.0),
    )  # fmt: skip
    assert all((np.diff(log["t_s"]) >= 0.0).all() for log in out.event_logs)
