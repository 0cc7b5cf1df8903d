"""Contact of ellipse and profile: against a slow reference, closed forms and symmetry."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from helpers.contact_reference import first_contact, overlap
from shapely import affinity

from sassgis.engine.contact import next_contact, resting_height
from sassgis.engine.ellipse_contact import Flying
from sassgis.engine.profile import profile_of


def ground_profile(s, z):
    """The profile as the kernel reads it."""
    return profile_of(np.asarray(s, float), np.asarray(z, float), np.zeros(len(s), np.int32))


G = 9.81


def engine(rock, profile, until, tolerance=1e-9, gravity=G, near=None, start=0.0, skip=-1):
    """``next_contact`` from the state (x, z, vx, vz, theta, omega, a, b)."""
    sx, sz = (np.ascontiguousarray(v, float) for v in profile)
    if near is None:
        near = int(np.clip(np.searchsorted(sx, rock[0]) - 1, 0, sx.size - 2))
    return next_contact(
        Flying(*rock, gravity), start, until, tolerance, ground_profile(sx, sz), near, skip
    )[:4]


def random_case(rng, step):
    """A rock in the air above a random polyline with segments of ``step``."""
    a = rng.uniform(0.2, 1.2)
    b = a * rng.uniform(0.3, 1.0)
    s = np.arange(0.0, 30.0, step)
    amplitude = rng.choice([0.0, 0.05, 0.2, 0.5]) * min(1.0, step / 0.5) ** 0.5
    z = -math.tan(math.radians(rng.uniform(0.0, 60.0))) * s + rng.normal(0.0, 1.0, s.size) * (
        amplitude
    )
    x = rng.uniform(5.0, 25.0)
    speed, angle = rng.uniform(0.0, 60.0), rng.uniform(-math.pi, math.pi)
    vx, vz = speed * math.cos(angle), speed * math.sin(angle)
    height = z[np.abs(s - x) < a + step].max() + a + rng.uniform(0.001, 5.0)
    rock = (x, height, vx, vz, rng.uniform(0.0, math.pi), rng.uniform(-40.0, 40.0), a, b)
    end = (s[-1] - x) / vx if vx > 0.0 else (s[0] - x) / vx
    return rock, (s, z), min(end, 3.0)


def settle(rock, profile, t):
    """Scaled gaps and approaches of all segments at time ``t``."""
    sx, sz = profile
    out = [overlap(t, (sx[j], sz[j], sx[j + 1], sz[j + 1]), rock, G) for j in range(sx.size - 1)]
    return np.array([g for g, _ in out]), np.array([v for _, v in out])


@pytest.mark.parametrize(
    ("seed", "step", "count"), [(1, 0.5, 600), (2, 0.5, 600), (3, 0.1, 250), (4, 2.0, 250)]
)
def test_first_contact_is_that_of_the_reference(seed, step, count):
    # Spins to 40 rad/s, speeds to 60 m/s; a contact counts while the centre approaches. 1e-6 s.
    rng = np.random.default_rng(seed)
    met, wrong = 0, []
    for i in range(count):
        rock, profile, until = random_case(rng, step)
        t, _, nx, nz = engine(rock, profile, until)
        t_ref, segment = first_contact(rock, G, *profile, until)
        if np.isinf(t) and np.isinf(t_ref):
            continue
        met += 1
        if not abs(t - t_ref) <= 1e-6:
            wrong.append((i, t, t_ref))
            continue
        # The normal is the ellipse's at the point of contact: compare approach speeds.
        _, speeds = settle(rock, profile, t)
        own = rock[2] * nx + (rock[3] - G * t) * nz
        assert own == pytest.approx(speeds[segment], rel=1e-3, abs=1e-3), i
    assert met > 0.3 * count
    assert wrong == []


def test_the_reference_overlaps_as_polygons_do():
    # The scaled distance against shapely: an ellipse of 4000 points and a segment.
    rng = np.random.default_rng(8)
    unit = shapely.Point(0.0, 0.0).buffer(1.0, quad_segs=1000)
    agree = 0
    for _ in range(300):
        a, b, angle = rng.uniform(0.3, 1.0), rng.uniform(0.1, 0.3), rng.uniform(0.0, 7.0)
        x, z = rng.uniform(-1.0, 1.0, 2)
        shape = affinity.rotate(affinity.scale(unit, a, b), angle, origin=(0, 0), use_radians=True)
        shape = affinity.translate(shape, x, z)
        seg = (*rng.uniform(-1.0, 1.0, 2), *rng.uniform(-1.0, 1.0, 2))
        rock = (x, z, 0.0, 0.0, angle, 0.0, a, b)
        gap = overlap(0.0, seg, rock, G)[0]
        if abs(gap) < 1e-4:
            continue
        assert shape.intersects(shapely.LineString([seg[:2], seg[2:]])) == (gap < 0.0)
        agree += 1
    assert agree > 250


def beside_a_crest(rng):
    """Fast spin beside a sharp convex vertex at (10, 0).

    The direction that separates rock and ground turns quickly, and the centre recedes along one
    direction while a flank closes in along another.
    """
    speed, angle = rng.uniform(1.0, 15.0), rng.uniform(-math.pi, math.pi)
    rock = (
        rng.uniform(9.0, 12.0), rng.uniform(0.5, 2.5), speed * math.cos(angle),
        speed * math.sin(angle), rng.uniform(0.0, math.pi), rng.uniform(-30.0, 30.0), 1.0, 0.5,
    )  # fmt: skip
    return rock, (np.array([0.0, 10.0, 20.0]), np.array([0.0, 0.0, -20.0]))


def between_steps_and_walls(rng):
    """Steps up and down of several metres, as under walls, quarries and buildings."""
    run = rng.uniform(1.0, 6.0, 12)
    s = np.concatenate([[0.0], np.cumsum(np.column_stack([run, rng.uniform(0.005, 0.1, 12)]))])
    rise = [rng.normal(-0.3, 0.3, 12) * run, rng.uniform(-4.0, 4.0, 12)]
    z = np.concatenate([[0.0], np.cumsum(np.column_stack(rise))])
    a = rng.uniform(0.3, 1.0)
    b = a * rng.uniform(0.4, 1.0)
    x = rng.uniform(s[4], s[-5])
    near = np.abs(s - x) < a + 0.2
    low = max(np.interp([x - a, x, x + a], s, z).max(), z[near].max() if near.any() else -99.0)
    vx = rng.uniform(-12.0, 12.0)
    rock = (
        x, low + a + rng.uniform(0.01, 1.0), vx, rng.uniform(-5.0, 5.0),
        rng.uniform(0.0, math.pi), rng.uniform(-20.0, 20.0), a, b,
    )  # fmt: skip
    return rock, (s, z)


@pytest.mark.parametrize(
    ("case", "n", "least"), [(beside_a_crest, 400, 100), (between_steps_and_walls, 150, 80)]
)
@pytest.mark.parametrize("seed", range(4))
def test_no_contact_is_missed(case, n, least, seed):
    rng = np.random.default_rng(seed)
    wrong, met = [], 0
    for i in range(n):
        rock, (s, z) = case(rng)
        if settle(rock, (s, z), 0.0)[0].min() <= 0.0:
            continue
        until = min(2.0, ((s[-1] if rock[2] > 0 else s[0]) - rock[0]) / rock[2])
        t = engine(rock, (s, z), until)[0]
        t_ref = first_contact(rock, G, s, z, until)[0]
        # A flank that has got into the ground while the centre receded: what it then meets from
        # the inside is not a contact, and has no counterpart in the reference.
        inside = case is beside_a_crest and (
            settle(rock, (s, z), min(t, t_ref, until))[0].min() < -1e-6
        )
        met += np.isfinite(t_ref) and not inside
        if not (inside or abs(t - t_ref) <= 1e-6 or t == t_ref):
            wrong.append((i, t, t_ref))
    assert met > least
    assert wrong == []


@pytest.mark.parametrize("seed", range(6))
def test_ball_on_a_slope_in_closed_form(seed):
    # (C − V)·n = R: a quadratic in t.
    rng = np.random.default_rng(seed)
    beta = math.radians(rng.uniform(0.0, 70.0))
    r = rng.uniform(0.1, 2.0)
    sx = np.array([0.0, 4000.0])
    sz = -math.tan(beta) * sx
    n = np.array([math.sin(beta), math.cos(beta)])
    x = 2000.0
    z = -math.tan(beta) * x + (r + rng.uniform(0.0, 20.0)) / math.cos(beta)
    v = rng.uniform(-30.0, 30.0, 2)
    gap = (x * n[0] + z * n[1]) - r
    rate = v @ n
    want = (rate + math.sqrt(rate**2 + 2 * G * n[1] * gap)) / (G * n[1])
    t, j, nx, nz = engine((x, z, *v, 0.0, 9.0, r, r), (sx, sz), 60.0, tolerance=1e-12)
    assert j == 0
    assert t == pytest.approx(want, abs=1e-9)
    assert (nx, nz) == pytest.approx(tuple(n), abs=1e-14)


@pytest.mark.parametrize("theta", [0.1, 0.8, 1.5, 2.4])
@pytest.mark.parametrize("offset", [-0.3, 0.0, 0.25])
def test_contact_with_a_vertex_is_at_the_vertex(offset, theta):
    # q = Rot(−θ)(V − C), (q1/a)² + (q2/b)² = 1, and the normal there is the ellipse's.
    a, b = 0.8, 0.4
    profile = (np.array([-5.0, 0.0, 5.0]), np.array([-50.0, 0.0, -50.0]))
    rock = (offset, 4.0, 0.0, 0.0, theta, 0.0, a, b)
    t, _, nx, nz = engine(rock, profile, 10.0, 1e-12)
    assert np.isfinite(t)
    dx, dz = 0.0 - offset, 0.0 - (4.0 - 0.5 * G * t * t)
    q1 = dx * math.cos(theta) + dz * math.sin(theta)
    q2 = -dx * math.sin(theta) + dz * math.cos(theta)
    assert (q1 / a) ** 2 + (q2 / b) ** 2 == pytest.approx(1.0, abs=1e-10)
    g1, g2 = -q1 / a**2, -q2 / b**2
    wx = g1 * math.cos(theta) - g2 * math.sin(theta)
    wz = g1 * math.sin(theta) + g2 * math.cos(theta)
    size = math.hypot(wx, wz)
    assert (nx, nz) == pytest.approx((wx / size, wz / size), abs=1e-9)


@pytest.mark.parametrize("way", [1, -1])
def test_two_contacts_at_once_take_the_faster_approach(way):
    # A ball into a symmetric V with a sideways speed touches both sides at the same time.
    r = 0.5
    profile = (np.array([-10.0, 0.0, 10.0]), np.array([10.0, 0.0, 10.0]))
    # Moving along a line on which both distances stay equal is straight down; the sideways speed
    # comes from a start to the side, timed to meet at the axis: symmetric contact, uneven approach.
    v = 2.0
    height = r * math.sqrt(2.0)
    t_hit = 0.25
    rock = (
        -way * v * t_hit, height + 1.0 * t_hit + 0.5 * G * t_hit**2, way * v, -1.0, 0.0, 0.0, r, r,
    )  # fmt: skip
    t, j, nx, nz = engine(rock, profile, 10.0, 1e-12)
    # Approach to the side ahead is (v + w)/√2, to the one behind (w − v)/√2.
    assert t == pytest.approx(t_hit, abs=1e-9)
    assert j == (1 if way > 0 else 0)
    assert (nx, nz) == pytest.approx((-way * math.sqrt(0.5), math.sqrt(0.5)), abs=1e-12)


@pytest.mark.parametrize("way", [1, -1])
def test_a_still_ball_let_down_into_a_v_touches_once(way):
    r = 0.5
    profile = (np.array([-10.0, 0.0, 10.0]), np.array([10.0, 0.0, 10.0]))
    rock = (way * 1e-12, 3.0, 0.0, 0.0, 0.0, 0.0, r, r)
    t, j, _, _ = engine(rock, profile, 10.0, 1e-12)
    assert t == pytest.approx(math.sqrt(2 * (3.0 - r * math.sqrt(2.0)) / G), abs=1e-9)
    assert j in (0, 1)


@pytest.mark.parametrize("step", [0.5, 0.1])
def test_a_mirrored_world_gives_mirrored_contacts(step):
    rng = np.random.default_rng(5)
    for _ in range(300):
        rock, (s, z), until = random_case(rng, step)
        x, h, vx, vz, theta, omega, a, b = rock
        t, _, nx, nz = engine(rock, (s, z), until)
        mirrored = (-x, h, -vx, vz, math.pi - theta, -omega, a, b)
        t_m, _, mx, mz = engine(mirrored, (-s[::-1], z[::-1].copy()), until)
        if np.isinf(t):
            assert np.isinf(t_m)
            continue
        assert t_m == pytest.approx(t, abs=1e-9)
        assert (mx, mz) == pytest.approx((-nx, nz), abs=1e-6)


@pytest.mark.parametrize("pieces", [2, 16, 128])
def test_cutting_a_segment_moves_no_contact(pieces):
    # The same straight ground in one piece and in many: same time, same normal.
    rng = np.random.default_rng(6)
    for _ in range(200):
        rock, (_s, _), until = random_case(rng, 0.5)
        x, h, vx, vz, theta, omega, a, b = rock
        beta = rng.uniform(0.0, 1.0)
        ends = np.array([0.0, 30.0])
        cut = np.linspace(0.0, 30.0, pieces + 1)
        z = -math.tan(beta) * x + (h - np.floor(h)) * 4.0 + 2.0 * a / math.cos(beta)
        rock = (x, z, vx, vz, theta, omega, a, b)
        t, _, nx, nz = engine(rock, (ends, -math.tan(beta) * ends), until, 1e-6)
        u, _, ux, uz = engine(rock, (cut, -math.tan(beta) * cut), until, 1e-6)
        if np.isinf(t):
            assert np.isinf(u)
            continue
        assert u == pytest.approx(t, abs=1e-6)
        # The vertex of a cut must not be taken for the contact: its normal is not the slope's.
        assert (ux, uz) == pytest.approx((nx, nz), abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_resting_height_touches_without_overlap(seed):
    rng = np.random.default_rng(seed)
    for _ in range(40):
        s = np.arange(0.0, 12.0, 0.5)
        z = -0.6 * s + rng.normal(0.0, 0.3, s.size)
        a = rng.uniform(0.2, 1.0)
        b = a * rng.uniform(0.3, 1.0)
        x, theta = rng.uniform(3.0, 9.0), rng.uniform(0.0, math.pi)
        h = resting_height(x, theta, a, b, ground_profile(s, z), 0)
        gaps, _ = settle((x, h, 0.0, 0.0, theta, 0.0, a, b), (s, z), 0.0)
        assert gaps.min() == pytest.approx(0.0, abs=1e-9)
        lower, _ = settle((x, h - 1e-6, 0.0, 0.0, theta, 0.0, a, b), (s, z), 0.0)
        assert lower.min() < 0.0


@pytest.mark.parametrize("theta", [0.3, 0.8, 2.4])
def test_a_rock_at_the_foot_of_a_riser_does_not_touch_the_top(theta):
    # The top lies above the rock, on the far side of its line: no contact, though the line's gap
    # is negative. A step of 4 m up, met at 5 m/s.
    profile = (np.array([0.0, 30.0, 30.01, 60.0]), np.array([2.0, 2.0, 6.0, 6.0]))
    rock = (28.5, 3.2, 5.0, 0.0, theta, 0.0, 0.6, 0.3)
    t, _j, nx, _ = engine(rock, profile, 5.0)
    t_ref, j_ref = first_contact(rock, G, *profile, 5.0)
    assert t == pytest.approx(t_ref, abs=1e-6)
    assert nx == pytest.approx(-1.0, abs=1e-3)
    assert j_ref == 1


@pytest.mark.parametrize("offset", [-0.45, -0.2, 0.0, 0.2, 0.45])
def test_ball_falling_on_a_peak(offset):
    # A ball that falls straight down on a needle: contact where its underside is above the tip.
    r, height = 0.5, 3.0
    profile = (np.array([-5.0, 0.0, 5.0]), np.array([-50.0, 0.0, -50.0]))
    t, _, nx, nz = engine((offset, height, 0.0, 0.0, 0.0, 0.0, r, r), profile, 10.0, 1e-12)
    drop = height - math.sqrt(r * r - offset**2)
    assert t == pytest.approx(math.sqrt(2 * drop / G), abs=1e-9)
    assert (nx, nz) == pytest.approx((offset / r, math.sqrt(1 - (offset / r) ** 2)), abs=1e-6)
