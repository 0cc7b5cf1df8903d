"""The impact with restitution and friction: what must hold, closed forms, an independent sum."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sassgis.engine.ellipse import contact_frame, inertia
from sassgis.engine.impact import (
    RESTITUTION,
    TURNING,
    impact,
    rebound_at_contact,
    restitution_at,
    slip_at_contact,
    soft_landing,
    turn_about_contact,
)
from sassgis.engine.landing import way_on

pytestmark = pytest.mark.kernels
QUICK = settings(max_examples=150, derandomize=True)


@st.composite
def meetings(draw):
    """(x, y, I) and (v_x, v_y, ω) of an ellipse whose contact approaches the ground."""
    a = draw(st.floats(0.2, 2.0))
    b = a * draw(st.floats(0.15, 1.0))
    x, y, _ = contact_frame(a, b, draw(st.floats(0.0, math.pi)))
    v = draw(st.tuples(st.floats(-30, 30), st.floats(-30, 10), st.floats(-40, 40)))
    assume(v[1] + x * v[2] < -1e-3)
    return (x, y, inertia(a, b)), v


def energy(body, v):
    return v[0] ** 2 + v[1] ** 2 + body[2] * v[2] ** 2


def angular_momentum(body, v):
    x, y, i = body
    return i * v[2] + y * v[0] - x * v[1]


@given(m=meetings(), mu=st.floats(0.0, 3.0), e=st.floats(0.0, 1.0))
@QUICK
def test_no_impact_gains_energy_and_angular_momentum_about_p_is_kept(m, mu, e):
    body, v = m
    after = rebound_at_contact(*body, *v, mu, e)
    assert energy(body, after) <= energy(body, v) * (1.0 + 1e-12)
    size = math.sqrt(energy(body, v) * (body[2] + body[0] ** 2 + body[1] ** 2))
    assert abs(angular_momentum(body, after) - angular_momentum(body, v)) <= 1e-12 * size
    jx, jy = after[0] - v[0], after[1] - v[1]
    assert jy > 0.0
    assert abs(jx) <= mu * jy + 1e-9 * math.sqrt(energy(body, v))
    assert after[1] + body[0] * after[2] >= -1e-9 * math.sqrt(energy(body, v))


def summed(body, v, mu, e, steps=60_000):
    """The same impact by small steps of the normal impulse, by the laws as they are stated."""
    x, y, i = body
    vx, vy, w = v
    dp = 4.0 * abs(vy + x * w) / steps
    work, least = 0.0, None
    while True:
        slip, rate = vx - y * w, vy + x * w
        if rate >= 0.0 and least is None:
            least = work
        if least is not None and work - least >= e * e * -least:
            return vx, vy, w
        # Friction: against the slip; at rest what holds the contact, if the cone allows it.
        hold = -slip / dp / (1 + y * y / i) + x * y / i / (1 + y * y / i)
        jx = dp * min(max(hold, -mu), mu)
        vx, vy, w = vx + jx, vy + dp, w + (x * dp - y * jx) / i
        work += 0.5 * (rate + vy + x * w) * dp


@pytest.mark.parametrize("mu", [0.05, 0.2, 0.8])
@pytest.mark.parametrize("theta", [0.3, 0.8, 2.2])
@pytest.mark.parametrize("v", [(9.0, -5.0, 12.0), (1.0, -8.0, -6.0), (-4.0, -6.0, 3.0)])
def test_as_an_independent_sum_over_the_impulse(mu, theta, v):
    # Slip that ends before or after the largest compression, sticking, slipping back.
    a, b = 0.5, 0.25
    x, y, _ = contact_frame(a, b, theta)
    body = (x, y, inertia(a, b))
    if v[1] + x * v[2] >= 0.0:
        pytest.skip("does not approach")
    found = rebound_at_contact(*body, *v, mu, 0.6)
    assert found == pytest.approx(summed(body, v, mu, 0.6), abs=2e-2)


@given(m=meetings(), mu=st.floats(0.0, 3.0))
@QUICK
def test_without_restitution_it_is_the_coulomb_rule_bit_for_bit(m, mu):
    (x, y, i), v = m
    assume(abs(x * y) / (i + y * y) <= mu)  # friction holds P once it sticks
    assert rebound_at_contact(x, y, i, *v, mu, 0.0) == slip_at_contact(x, y, i, *v, mu)


@given(m=meetings())
@QUICK
def test_without_restitution_and_slip_it_is_the_paper_s(m):
    (x, y, i), v = m
    sass = turn_about_contact(x, y, i, *v)
    assume(sass[1] - v[1] > 1e-3)  # the ground pushes, it cannot pull
    found = rebound_at_contact(x, y, i, *v, 1e9, 0.0)
    assert found == pytest.approx(sass, abs=1e-9)
    assert soft_landing(x, y, i, *v, 0.0) == sass


@pytest.mark.parametrize("e", [0.0, 0.4, 1.0])
def test_a_sphere_in_closed_form(e):
    # v_y' = −e v_y; the impulse (1 + e)|v_y| stops the slip s where μ J >= |s|/(1 + r²/I) = 2|s|/7.
    r, v = 0.5, (9.0, -4.0, 6.0)
    i = inertia(r, r)
    normal = (1.0 + e) * 4.0
    for mu in (0.1, 2.0):
        along = -min(mu * normal, (9.0 - r * 6.0) * 2.0 / 7.0)
        found = rebound_at_contact(0.0, r, i, *v, mu, e)
        assert found == pytest.approx((9.0 + along, 4.0 * e, 6.0 - r * along / i), rel=1e-12)


@given(m=meetings(), e=st.floats(0.0, 1.0))
@QUICK
def test_without_friction_the_normal_work_is_lost(m, e):
    # 1 − e² of c²/(2 (1 + x²/I)), the energy of the approach c of P.
    (x, y, i), v = m
    after = rebound_at_contact(x, y, i, *v, 0.0, e)
    c = v[1] + x * v[2]
    lost = energy((x, y, i), v) - energy((x, y, i), after)
    assert lost == pytest.approx((1.0 - e * e) * c * c / (1.0 + x * x / i), rel=1e-6, abs=1e-6)
    assert after[0] == v[0]


def test_restitution_falls_with_speed():
    assert restitution_at(0.5, 9.144, 0.0) == 0.5
    assert restitution_at(0.5, 9.144, -9.144) == pytest.approx(0.25)
    assert restitution_at(0.5, 9.144, -27.432) == pytest.approx(0.05)


@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize("degrees", [5.0, 30.0, 60.0, 85.0])
def test_a_rolling_sphere_is_held_back_by_angle(e, degrees):
    # v_x'/v_x = 1 − p (1 + e) tan α, at least 0; rebound and spin are those without it.
    r, v, p = 0.5, 10.0, 0.3
    vn = v * math.tan(math.radians(degrees))
    body = (0.0, r, inertia(r, r), v, -vn, v / r)
    wx, wy, spin = impact(*body, 0.0, RESTITUTION, 0.8, e, 1e9, p)
    assert wx / v == pytest.approx(max(1.0 - p * (1.0 + e) * vn / v, 0.0), abs=1e-12)
    assert (wy, spin) == (pytest.approx(e * vn), v / r)


@given(m=meetings(), e=st.floats(0.0, 1.0), p=st.floats(0.0, 2.0))
@QUICK
def test_held_back_takes_energy_and_turns_nothing_round(m, e, p):
    body, v = m
    free = rebound_at_contact(*body, *v, 0.8, e)
    held = impact(*body, *v, 0.0, RESTITUTION, 0.8, e, 1e9, p)
    if v[1] + body[0] * v[2] < 0.0:
        assert held[1:] == pytest.approx(free[1:], rel=1e-6)
    assert energy(body, held) <= energy(body, v) * (1.0 + 1e-9)
    assert held[0] * free[0] >= 0.0 or v[1] + body[0] * v[2] >= 0.0


def test_nothing_held_back_leaves_the_contact_law_alone():
    body, v = (0.12, 0.43, 0.08), (9.0, -5.0, 12.0)
    alone = rebound_at_contact(*body, *v, 0.8, 0.3)
    assert impact(*body, *v, 0.2, RESTITUTION, 0.8, 0.3, 1e9) == pytest.approx(alone, rel=1e-6)


@pytest.mark.parametrize("vx", [-20.0, -10.0, 3.0, 10.0, 20.0])
def test_a_resistance_that_grows_with_the_speed_slows_a_rolling_sphere(vx):
    # A part turns it back, for which rolling counts 1 + r²/I as much; the rest slows the centre.
    r, q = 0.5, 2e-3
    body = (0.0, r, inertia(r, r), vx, -2.0, vx / r)
    wx, wy, spin = impact(*body, 0.0, RESTITUTION, 0.8, 0.4, 1e9, 0.0, q)
    assert wy == pytest.approx(0.8)
    taken = q * abs(vx) * 2.8
    assert wx == pytest.approx(vx / (1.0 + (1.0 - TURNING) * taken))
    assert spin == pytest.approx(vx / r / (1.0 + (1.0 + TURNING * 2.5) * taken))


@given(m=meetings(), e=st.floats(0.0, 1.0), q=st.floats(0.0, 5.0))
@QUICK
def test_a_loss_with_the_speed_only_takes_and_none_changes_nothing(m, e, q):
    body, v = m
    law = (0.0, RESTITUTION, 0.8, e, 1e9, 0.2)
    free, slow = (impact(*body, *v, *law, loss) for loss in (0.0, q))
    assert free == impact(*body, *v, *law)
    assert slow[1] == free[1]
    for k in (0, 2):
        assert abs(slow[k]) <= abs(free[k]) and slow[k] * free[k] >= 0.0


def test_a_flank_that_recedes_lets_the_core_be_met():
    # Its centre comes down all the same: not into the ground.
    x, y, i = 0.2, 0.4, 0.08
    wx, wy, _ = impact(x, y, i, 5.0, -2.0, 15.0, 1.0, RESTITUTION, 0.8, 0.3, 1e9, 0.0)
    assert wy == pytest.approx(0.6)
    assert np.isfinite(wx)


@pytest.mark.parametrize(
    ("along", "spin", "way"),
    [(2.0, -3.0, 1), (-2.0, 3.0, -1), (1e-17, -3.0, -1), (-1e-17, 3.0, 1), (0.0, 0.0, 1)],
)
def test_a_block_that_was_stopped_goes_on_as_it_spins(along, spin, way):
    assert way_on(along, spin, 0.5) == way
