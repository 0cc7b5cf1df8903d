"""Resistance that grows with the speed: closed forms, cuts, sizes, and many small impacts."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import engine_lab as lab
from scipy.integrate import solve_ivp

from sassgis.engine.impact import RESTITUTION, TURNING, impact, soft_landing
from sassgis.engine.resistance import gained, path_to, share_gained, time_over
from sassgis.settings.results import ControlLine, ControlLineCrossings

G = 9.81
MU_V = 0.01


@pytest.mark.kernels
@pytest.mark.parametrize(
    ("steady", "fade", "speed", "path"),
    [(1.3, 0.02, 3.0, 20.0), (1.3, 0.02, 12.0, 20.0), (-0.5, 0.02, 12.0, 30.0),
     (0.0, 0.02, 5.0, 10.0), (-0.5, 0.0, 12.0, 30.0), (1.3, 1e-14, 3.0, 20.0),
     (2.0, 0.5, 2.0, 9.0)],
)  # fmt: skip
def test_closed_forms_solve_the_equation_of_motion(steady, fade, speed, path):
    def slope(_, y):
        return [2.0 * (steady - fade * y[0]), 1.0 / math.sqrt(y[0])]

    end = solve_ivp(slope, (0.0, path), [speed**2, 0.0], rtol=1e-11, atol=1e-12).y[:, -1]
    pull = steady - fade * speed**2
    assert gained(pull, fade, path) == pytest.approx(end[0] - speed**2, abs=1e-7)
    assert time_over(steady, fade, speed, math.sqrt(end[0]), path) == pytest.approx(end[1])
    if pull != 0.0:
        assert path_to(pull, fade, end[0] - speed**2) == pytest.approx(path, rel=1e-5)
    half = gained(pull, fade, 0.4 * path)
    share = share_gained(0.4, 2.0 * fade * path)
    assert share * gained(pull, fade, path) == pytest.approx(half, rel=1e-9, abs=1e-12)


@pytest.mark.kernels
def test_a_speed_beyond_the_steady_one_is_never_reached():
    assert path_to(1.0 - 0.02 * 9.0, 0.02, 60.0) == math.inf


def passages(line, radius, at, mu_v=MU_V, speed=2.0, **changes):
    """Speeds of a ball that rolls down at some chainages (m/s)."""
    flat = lab.profile_set(line)
    lines = [ControlLine(f"S{i}", "station") for i in range(len(at))]
    ball = lab.sphere(radius, speed_mps=(speed, speed), spin_radps=(speed / radius,) * 2)
    out = lab.run(
        flat, lab.plain(mu_0=0.2, mu_v=mu_v), ball, start=2.0,
        control_lines=ControlLineCrossings.same_for_all(lines, list(at), 1),
        settings=dataclasses.replace(lab.HAZARD, rolling_friction_sd=0.0, **changes),
    )  # fmt: skip
    return out.passages["speed_mps"]


@pytest.mark.parametrize("speed", [0.5, 20.0])
def test_a_rolling_ball_nears_its_steady_speed(speed):
    angle, radius = math.radians(30.0), 0.3
    at = np.array([10.0, 40.0, 100.0, 190.0])
    v = passages(lab.slope((200.0, 30.0)), radius, at, speed=speed)
    fade = MU_V * math.cos(angle) / (2.0 * radius)
    steady2 = G * (math.sin(angle) - 0.2 * math.cos(angle)) / fade
    left = np.exp(-2.0 * fade * (at - 2.0) / math.cos(angle))
    assert v == pytest.approx(np.sqrt(steady2 + (speed**2 - steady2) * left), rel=1e-6)


def test_nothing_depends_on_how_a_slope_is_cut():
    at = [10.0, 40.0, 100.0, 190.0]
    cut = np.array([0.0, 3.0, 3.1, 17.0, 60.0, 61.0, 120.0, 200.0])
    whole = passages(lab.slope((200.0, 30.0)), 0.3, at)
    pieces = passages(lab.slope(*((float(d), 30.0) for d in np.diff(cut))), 0.3, at)
    assert pieces == pytest.approx(whole, rel=1e-9)


def test_blocks_of_all_sizes_move_alike():
    # Lengths and sizes times four: speeds times two.
    small = passages(lab.slope((120.0, 30.0)), 0.2, [20.0, 80.0], speed=1.0)
    start = 2.0  # of the ball, in both
    at = [start + 4.0 * (x - start) for x in (20.0, 80.0)]
    large = passages(lab.slope((480.0, 30.0)), 0.8, at, speed=2.0)
    assert large == pytest.approx(2.0 * small, rel=1e-9)


def test_the_readings_of_1986_do_not_know_it():
    line = lab.slope((120.0, 30.0))
    with_it, without = (passages(line, 0.3, [80.0], m, readings="1986") for m in (MU_V, 0.0))
    assert with_it == pytest.approx(without, rel=0.0, abs=0.0)


@pytest.mark.kernels
def test_small_impacts_take_in_the_end_what_rolling_takes():
    # A ball that rolls is pushed by its weight in many small impulses: μ_v v²/(g d) each, of force
    # or of moment, slows it as dv/dJ = −μ_v v²/(g d); friction at P keeps it rolling.
    radius, growth, speed, pushes = 0.3, 2e-3, 10.0, 4000
    inertia = 0.4 * radius**2
    vx, spin = speed, speed / radius
    small = 20.0 / pushes
    for _ in range(pushes):
        vx, _, spin = impact(
            0.0, radius, inertia, vx, -small, spin, 1.0, RESTITUTION, 0.9, 0.0, 9.144, 0.0, growth
        )
    assert vx == pytest.approx(speed / (1.0 + growth * speed * 20.0), rel=0.01)
    assert spin * radius == pytest.approx(vx, rel=0.01)
    assert 0.0 < TURNING < 1.0
    # A soft landing takes the same energy.
    softly, _, turning = soft_landing(
        0.0, radius, inertia, speed, -small, speed / radius, 1.4 * growth * speed**2
    )
    assert speed - softly == pytest.approx(growth * speed**2 * small, rel=0.01)
    assert turning == pytest.approx(softly / radius)
