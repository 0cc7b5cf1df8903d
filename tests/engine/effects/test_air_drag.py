"""Drag of the air against what is known of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.engine_lab import IMPACT, G, ellipsoid, first, plain, run, slope, sphere, sphere_mass
from scipy.integrate import solve_ivp

from sassgis.engine.effects import air_drag
from sassgis.engine.effects.air_drag import AirDrag
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.settings import EngineSettings

pytestmark = pytest.mark.kernels

FLAT = slope((400.0, 0.0))


def drag_of(**settings):
    return EffectSettings(AirDrag(**settings))


def factor(radius, coefficient, density=1.1, rock=2700.0):
    """K of the deceleration K v² of a sphere (1/m)."""
    return 0.5 * density * coefficient * math.pi * radius**2 / sphere_mass(radius, rock)


def landing(effects, radius=0.05, drop=100.0, speed=0.0, rock=2700.0):
    blocks = sphere(
        radius, drop_m=(drop, drop), speed_mps=(speed, speed), density_kgm3=(rock, rock)
    )
    never_soft = EngineSettings(readings="1986", rolling_threshold=0.0)
    out = run(FLAT, plain(), blocks, effects, log_events=3000, settings=never_soft)
    return first(out.event_logs[0], IMPACT)


@pytest.mark.parametrize(
    ("radius", "rock", "coefficient"), [(0.05, 2700.0, 1.0), (0.02, 900.0, 2.0)]
)
def test_a_fall_straight_down_follows_the_hyperbolic_tangent(radius, rock, coefficient):
    met = landing(drag_of(drag_coefficient=coefficient), radius, 100.0, rock=rock)
    terminal = math.sqrt(G / factor(radius, coefficient, rock=rock))
    t = met["t_s"]
    assert -met["vz_mps"] == pytest.approx(terminal * math.tanh(G * t / terminal), rel=2e-4)
    way = terminal**2 / G * math.log(math.cosh(G * t / terminal))
    assert way == pytest.approx(100.0, rel=2e-4)
    # The drag is felt: without it the speed is 44.3 m/s.
    assert -met["vz_mps"] < 0.95 * math.sqrt(2.0 * G * 100.0)


def exact_flight(k, speed, drop, radius):
    def moves(_t, y):
        v = math.hypot(y[2], y[3])
        return [y[2], y[3], -k * v * y[2], -G - k * v * y[3]]

    def lands(_t, y):
        return y[1] - radius

    lands.terminal = True
    start = [5.0, drop + radius, speed, 0.0]
    return solve_ivp(moves, (0.0, 60.0), start, events=lands, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("speed", [10.0, 40.0])
def test_a_flight_in_the_plane_agrees_with_a_solver_of_differential_equations(speed):
    met = landing(drag_of(drag_coefficient=1.0), speed=speed)
    exact = exact_flight(factor(0.05, 1.0), speed, 100.0, 0.05)
    x, _, vx, vz = exact.y[:, -1]
    assert met["x_m"] - 5.0 == pytest.approx(x - 5.0, rel=5e-4)
    assert met["vx_mps"] == pytest.approx(vx, rel=5e-4)
    assert met["vz_mps"] == pytest.approx(vz, rel=5e-4)
    assert met["t_s"] == pytest.approx(exact.t[-1], rel=5e-4)


def test_the_step_is_of_second_order_and_does_not_matter(monkeypatch):
    # Where a thin block of light rock flies, so that the drag is strong.
    k = factor(0.05, 3.0)
    exact = exact_flight(k, 40.0, 100.0, 0.05).y[:, -1]
    errors = []
    for step in (0.2, 0.1, 0.05):
        monkeypatch.setattr(air_drag, "DRAG_STEP_S", step)
        met = landing(drag_of(drag_coefficient=3.0), speed=40.0)
        errors.append(abs(met["x_m"] - exact[0]))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.4)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.4)
    assert errors[2] < 0.01


def test_two_per_cent_of_the_weight_at_30_cm_and_20_mps():
    # The estimate of Bozzolo and Pamini (1986); a sphere of 0.3 m with C_d 0.43 to 0.5.
    for coefficient, share in ((0.43, 0.018), (0.5, 0.021)):
        drag = air_drag.prepare(AirDrag(drag_coefficient=coefficient))
        k = air_drag.resistance(drag, 0.15, 0.15, 0.15, sphere_mass(0.15))
        assert k == pytest.approx(factor(0.15, coefficient), rel=1e-12)
        assert k * 20.0**2 / G == pytest.approx(share, abs=5e-4)


def test_sphericity():
    constant = air_drag.prepare(AirDrag())
    form = air_drag.prepare(AirDrag("sphericity"))
    # A sphere has the 0.43 of a sphere.
    assert air_drag.sphericity(0.4, 0.4, 0.4) == pytest.approx(1.0, abs=1e-14)
    one, other = (air_drag.resistance(d, 0.4, 0.4, 0.4, 700.0) for d in (constant, form))
    # The exponent 0.57 magnifies the rounding of a sphericity of 1.
    assert other == pytest.approx(one, rel=1e-6)
    # Spheroid of axes 2:1:1: its surface is known exactly.
    a, b = 1.0, 0.5
    e = math.sqrt(1.0 - b * b / (a * a))
    surface = 2.0 * math.pi * b * b * (1.0 + a / (b * e) * math.asin(e))
    ball = 4.0 * math.pi * (a * b * b) ** (2.0 / 3.0)
    psi = air_drag.sphericity(a, b, b)
    assert psi == pytest.approx(ball / surface, rel=0.012)  # Thomsen's formula: within 1.1 %
    ratio = air_drag.resistance(form, a, b, b, 1e3) / air_drag.resistance(constant, a, b, b, 1e3)
    assert ratio == pytest.approx(10.0 ** (1.8148 * (-math.log10(psi)) ** 0.5743), rel=1e-12)
    assert 1.5 < ratio < 4.0


def test_light_rocks_fall_slower_and_the_form_matters():
    heavy, light = (-landing(drag_of(), r)["vz_mps"] for r in (0.5, 0.02))
    assert light < heavy < math.sqrt(2.0 * G * 100.0)
    platy = ellipsoid(0.1, 0.08, 0.02, drop_m=(50.0, 50.0), orientation_rad=(0.0, 0.0))
    speeds = [
        run(FLAT, plain(), platy, drag_of(form=form), log_events=3000).rocks["max_speed_mps"][0]
        for form in ("constant", "sphericity")
    ]
    assert speeds[1] < speeds[0]


def test_a_short_fall_makes_no_energy():
    # The contact comes within the first half of a step: what was taken is given back at most.
    for drop in np.geomspace(1e-5, 0.02, 12):
        met = landing(drag_of(drag_coefficient=10.0, air_density_kgm3=2.0), 0.02, float(drop))
        energy = 0.5 * met["vz_mps"] ** 2
        assert 0.95 * G * drop - 2e-5 < energy <= G * drop + 1e-12
