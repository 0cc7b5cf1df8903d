"""The laws of the worlds against the paper's equations, closed forms, and the engine."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sassgis.engine.impact import rebound_at_contact
from sassgis.gap.check.worlds import motion as m
from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds.contact_laws import (
    ELASTIC,
    compressed,
    contact,
    kinetic,
    lever,
    rebound,
)
from sassgis.gap.check.worlds.forces import Forces, Local

pytestmark = pytest.mark.kernels


def test_worked_impact() -> None:
    a, b = 0.5, 0.38
    x, y = lever(a, b, 0.7)
    assert (x, y) == pytest.approx((0.1199303, 0.4338499), abs=1e-7)
    inertia = (a * a + b * b) / 5
    vx, vy, spin, eta = rebound(x, y, inertia, 9.0, -5.0, 12.0, 1.0)
    assert eta == pytest.approx(0.8994009, abs=1e-7)
    assert (spin, vx, vy) == pytest.approx((19.364381, 8.401235, -2.322376), abs=1e-6)
    vx, vy, spin, _ = rebound(x, y, inertia, 9.0, -5.0, 12.0, 0.70)
    assert (spin, vx, vy) == pytest.approx((17.083466, 7.411660, -2.048825), abs=1e-6)


@pytest.mark.parametrize(
    ("ratio", "gamma", "expected"),
    [
        (0.76, 0, (0, 19.00, 57.01, 76.02)),
        (0.76, 30, (4.87, 4.89, 36.43, 67.95)),
        (0.76, 120, (2.70, 29.56, 60.46, 64.48)),
        (0.40, 60, (8.15, 0.39, 15.55, 38.46)),
        (0.40, 150, (31.99, 60.44, 61.00, 33.10)),
    ],
)
def test_share_kept_without_spin(ratio: float, gamma: float, expected: tuple[float, ...]) -> None:
    a, b = 1.0, ratio
    # Contact seen from the centre under the angle γ to the major axis, in front of it for γ < 90°,
    # and the normal of the ellipse there.
    angle = -math.radians(gamma)
    r = 1.0 / math.hypot(math.cos(angle) / a, math.sin(angle) / b)
    px, py = r * math.cos(angle), r * math.sin(angle)
    nx, ny = -px / a**2, -py / b**2
    size = math.hypot(nx, ny)
    nx, ny = nx / size, ny / size
    tx, ty = ny, -nx
    x, y = -(px * tx + py * ty), -(px * nx + py * ny)
    for alpha, share in zip((0, 30, 60, 90), expected, strict=True):
        v = math.radians(alpha)
        *_, eta = rebound(x, y, (a * a + b * b) / 5, math.sin(v), -math.cos(v), 0.0, 1.0)
        assert 100 * eta == pytest.approx(share, abs=0.006)


def test_energy_is_never_made_at_a_contact() -> None:
    rng = np.random.default_rng(1)
    for _ in range(500):
        a = rng.uniform(0.3, 1.0)
        b = a * rng.uniform(0.3, 1.0)
        inertia = (a * a + b * b) / 5
        x, y = lever(a, b, rng.uniform(0, math.pi))
        before = rng.normal(0, 8, 3)
        eta = rng.uniform(0.2, 1.0)
        vx, vy, spin, _ = rebound(x, y, inertia, *before, eta)
        assert kinetic(inertia, vx, vy, spin) <= eta * kinetic(inertia, *before) * (1 + 1e-12)


def rough_contacts(n: int) -> list[tuple[float, ...]]:
    """Contacts that approach: x, y, inertia, velocity, spin, friction, restitution."""
    rng = np.random.default_rng(7)
    found = []
    while len(found) < n:
        a = rng.uniform(0.3, 1.0)
        b = a * rng.uniform(0.5, 1.0)
        x, y = lever(a, b, rng.uniform(0.0, math.pi))
        vx, vy, spin = rng.uniform(0, 15), -rng.uniform(0.5, 8), rng.uniform(-5, 25)
        if vy + x * spin < -0.5:
            mu, e = rng.uniform(0.2, 1.2), rng.uniform(0.0, 0.8)
            found.append((x, y, (a * a + b * b) / 5, vx, vy, spin, mu, e))
    return found


def test_contact_in_small_steps_is_that_of_the_engine() -> None:
    """Stronge's law integrated over the impulse here, in closed form there."""
    for case in rough_contacts(200):
        assert compressed(*case) == pytest.approx(rebound_at_contact(*case), abs=0.15)


def test_contact_in_small_steps_makes_no_energy() -> None:
    for x, y, inertia, vx, vy, spin, mu, e in rough_contacts(200):
        after = compressed(x, y, inertia, vx, vy, spin, mu, e)
        before = kinetic(inertia, vx, vy, spin)
        assert kinetic(inertia, *after) <= before * (1 + 1e-3)


def test_sphere_rebounds_with_its_coefficient() -> None:
    law = np.array([1.0, 0, 0, 0.5, 0.4, 0, 0, 0.6, 9.144, 0.1])
    vx, vy, spin = contact(ELASTIC, 0.5, 0.5, 0.5, 0.0, 9.0, -5.0, 0.0, law)
    assert vy == pytest.approx(3.0, abs=0.05)
    # Slip of 9 m/s ends when friction has given 2/7 of it, 2.57 m/s, of at most 0.5 · 8 m/s.
    assert vx == pytest.approx(9.0 * 5 / 7, abs=0.1)
    assert spin == pytest.approx(9.0 * 5 / 7 / 0.5, abs=0.2)


def test_sphere_that_falls_on_a_slope_met_less_steep(plane) -> None:  # type: ignore[no-untyped-def]
    beta = math.radians(44)
    u = 1 - math.tan(math.radians(35)) / math.tan(beta)
    ground = plane(beta, [1.00, u, u, 0.7, 0.4, 0.17, 0.0, 0.0, 9.144, 0.0])
    v = 10.0
    st = ground.rock(0.5, 0.5, v * math.sin(beta), -v * math.cos(beta))
    # The rock starts at the ground: nothing is lost to a fall before it.
    tables = ground.run(st, dt=0.0005)
    hit = tables.impacts[0]
    assert np.hypot(hit[11], hit[12]) == pytest.approx(4.096975, abs=1e-4)
    assert math.degrees(math.atan2(hit[12], hit[11])) == pytest.approx(9.0, abs=1e-6)
    # The next contact, 0.847454 m down the slope.
    along = (tables.impacts[1, 4] - hit[4]) / math.cos(beta)
    assert along == pytest.approx(0.847454, abs=2e-4)


def test_rolling_and_sliding_to_rest(plane) -> None:  # type: ignore[no-untyped-def]
    beta = math.radians(20)
    ground = plane(beta, [0.5, 0.0, 0.0, 0.8, 0.6, 0.0, 0.0])
    # The one that slides is too flat to be tipped over by the friction.
    for mode, b, length in ((ms.ROLL, 0.5, 5.744979), (ms.SLIDE, 0.2, 3.109847)):
        errors = []
        for dt in (0.002, 0.001, 0.0005):
            st = ground.rock(0.5, b, 5.0, 0.0, 10.0)
            st[ms.MODE] = mode
            stop = ground.run(st, dt).deposits[0]
            errors.append(abs((stop[3] - 50.0) / math.cos(beta) - length))
        assert errors[-1] < 0.004
        assert errors[2] < 0.6 * errors[0]


def test_flight_keeps_energy_and_follows_the_parabola(plane) -> None:  # type: ignore[no-untyped-def]
    ground = plane(math.radians(44), [0.5, 0, 0, 0.7, 0.5, 0, 0])
    angle = math.radians(10)
    st = ground.rock(0.5, 0.4, 10 * math.cos(angle), 10 * math.sin(angle), 7.0)
    energy = [0.5 * (st[ms.VX] ** 2 + st[ms.VZ] ** 2) + 9.81 * st[ms.Z]]
    x0, z0 = st[ms.X], st[ms.Z]
    for _ in range(1000):
        m.flight_step(Forces(), st, 0.492150 / 1000)
        energy.append(0.5 * (st[ms.VX] ** 2 + st[ms.VZ] ** 2) + 9.81 * st[ms.Z])
    assert np.ptp(energy) < 1e-9
    assert st[ms.SPIN] == 7.0
    along = math.hypot(st[ms.X] - x0, st[ms.Z] - z0)
    assert along == pytest.approx(5.672013, abs=2e-5)
    assert math.degrees(math.atan2(z0 - st[ms.Z], st[ms.X] - x0)) == pytest.approx(44, abs=1e-3)


def test_flight_through_air_converges_in_the_step(plane) -> None:  # type: ignore[no-untyped-def]
    ground = plane(0.7, [0.5, 0, 0, 0.7, 0.5, 0, 0])
    ends = []
    for n in (8, 16, 32, 512):
        st = ground.rock(0.3, 0.3, 20.0, 10.0)
        for _ in range(n):
            m.flight_step(Forces(air_drag=Local(q=50.0)), st, 1.0 / n)
        ends.append(st[ms.X])
    errors = [abs(end - ends[-1]) for end in ends[:3]]
    assert errors[1] < errors[0] / 10 and errors[2] < errors[1] / 10
