"""The base law of the worlds against numbers worked out from the paper's equations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sassgis.gap.check.worlds import motion as m
from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds.forces import Forces, Local
from sassgis.gap.check.worlds.law import kinetic, lever, rebound

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


def test_sphere_that_falls_on_a_slope_met_less_steep(plane) -> None:  # type: ignore[no-untyped-def]
    beta = math.radians(44)
    u = 1 - math.tan(math.radians(35)) / math.tan(beta)
    ground = plane(beta, [0.70, u, u, 0.7, 0.4, 0.17, 0.0])
    v = 10.0
    st = ground.rock(0.5, 0.5, v * math.sin(beta), -v * math.cos(beta))
    # The rock starts at the ground: nothing is lost to a fall before it.
    tables = ground.run(st, dt=0.0005)
    hit = tables.impacts[0]
    assert np.hypot(hit[11], hit[12]) == pytest.approx(4.096975, abs=2e-5)
    assert math.degrees(math.atan2(hit[12], hit[11])) == pytest.approx(9.0, abs=1e-6)
    # The next contact, 0.847454 m down the slope.
    along = (tables.impacts[1, 4] - hit[4]) / math.cos(beta)
    assert along == pytest.approx(0.847454, abs=2e-4)


def test_rolling_and_sliding_to_rest(plane) -> None:  # type: ignore[no-untyped-def]
    beta = math.radians(20)
    ground = plane(beta, [0.5, 0.0, 0.0, 0.8, 0.6, 0.0, 0.0])
    for mode, a, length in ((ms.ROLL, 0.5, 5.744979), (ms.SLIDE, 0.5, 3.109847)):
        errors = []
        for dt in (0.002, 0.001, 0.0005):
            st = ground.rock(a, 0.5, 5.0, 0.0, 10.0)
            st[ms.MODE] = mode
            stop = ground.run(st, dt).deposits[0]
            errors.append(abs((stop[3] - 50.0) / math.cos(beta) - length))
        assert errors[-1] < 0.004
        assert errors[2] < 0.6 * errors[0]


def test_flight_keeps_energy_and_follows_the_parabola(plane) -> None:  # type: ignore[no-untyped-def]
    ground = plane(math.radians(44), [0.5, 0, 0, 0.7, 0.5, 0, 0])
    angle = math.radians(10)
    st = ground.rock(0.5, 0.4, 10 * math.cos(angle), 10 * math.sin(angle), 7.0)
    energy = [
        0.5 * (st[ms.VX] ** 2 + st[ms.VZ] ** 2) + 9.81 * st[ms.Z],
    ]
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
            m.flight_step(Forces(air=Local(q=50.0)), st, 1.0 / n)
        ends.append(st[ms.X])
    errors = [abs(end - ends[-1]) for end in ends[:3]]
    assert errors[1] < errors[0] / 10 and errors[2] < errors[1] / 10
