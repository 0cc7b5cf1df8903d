"""The impact of Bozzolo and Pamini (1986), equations (3) to (7), and with rebound of the contact.

Whatever the impulse at the point of contact P, the angular momentum about P is kept.
"""

from __future__ import annotations

import math

from sassgis.compiled.jit import lean

SCALE, COULOMB, RESTITUTION = 0, 1, 2
#: Share of the resistance at an impact that turns the block back, in place of slowing its centre:
#: the ground pushes ahead of the contact. Ours; spins observed in flight lie between those of 0
#: and of 1 (docs/studies/kinematics.md).
TURNING = 0.3
#: The laws of impact by the names that they have in the settings.
RULES = {"scale": SCALE, "coulomb": COULOMB, "restitution": RESTITUTION}


@lean
def energy_kept(x: float, y: float, inertia: float, vx: float, vy: float, omega: float) -> float:
    """Return η_min, equation (6): share of the energy kept where the block turns about P."""
    before = inertia * omega * omega + vx * vx + vy * vy
    if before == 0.0:
        return 1.0
    momentum = inertia * omega + y * vx - x * vy
    return momentum * momentum / (before * (inertia + x * x + y * y))


@lean
def turn_about_contact(
    x: float, y: float, inertia: float, vx: float, vy: float, omega: float
) -> tuple[float, float, float]:
    """Return (v_x, v_y, ω) with the angular momentum about P kept: equations (3) to (5)."""
    after = (inertia * omega + y * vx - x * vy) / (inertia + x * x + y * y)
    return y * after, -x * after, after


@lean
def slip_at_contact(
    x: float, y: float, inertia: float, vx: float, vy: float, omega: float, mu: float
) -> tuple[float, float, float]:
    """Return (v_x, v_y, ω) after an impact without rebound in which friction μ holds P, if it can.

    Where the impulse that brings P to rest lies outside the friction cone, P slides on and the
    impulse lies on the cone.
    """
    slip = vx - y * omega
    approach = vy + x * omega
    xx = 1.0 + y * y / inertia
    yy = 1.0 + x * x / inertia
    xy = -x * y / inertia
    determinant = xx * yy - xy * xy
    jx = (-slip * yy + approach * xy) / determinant
    jy = (-approach * xx + slip * xy) / determinant
    if abs(jx) > mu * jy:
        side = -math.copysign(1.0, slip)
        effective = yy + side * mu * xy
        if effective > 0.0 and approach < 0.0:
            jy = -approach / effective
            jx = side * mu * jy
    return vx + jx, vy + jy, omega + (x * jy - y * jx) / inertia


@lean
def restitution_at(e: float, halved_at: float, approach: float) -> float:
    """Return the coefficient of restitution at a normal speed of the contact: e/(1 + (v_n/v)²).

    Pfeiffer and Bowen (1989), as coded in PlatRock (Common/BounceModels.py) with v = 9.144 m/s.
    """
    return e / (1.0 + (approach / halved_at) ** 2)


@lean
def rebound_at_contact(
    x: float, y: float, inertia: float, vx: float, vy: float, omega: float, mu: float, e: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the impact with dry friction μ and Stronge's energetic coefficient of restitution e.

    The normal impulse p grows from 0; slip s and approach c at P change in proportion to it. P
    slips until s = 0 (at p_s), then sticks, or slips back where friction cannot hold it. The
    normal force does work ∫c dp < 0 until c = 0, and gives e² of it back (Stronge, 1990, Proc. R.
    Soc. A 431, 169). The impact ends there. Friction never adds energy.
    Returns (v_x, v_y, ω).
    """
    slip = vx - y * omega
    approach = vy + x * omega
    if approach >= 0.0:
        return vx, vy, omega
    xx = 1.0 + y * y / inertia
    yy = 1.0 + x * x / inertia
    xy = -x * y / inertia
    # Without slip at first, P starts to slip to where the impulse pushes it, or sticks.
    side = math.copysign(1.0, slip) if slip != 0.0 else 0.0
    p_s = 0.0
    rate = yy
    if side != 0.0:
        towards = mu * xx - side * xy  # how fast |s| shrinks
        p_s = abs(slip) / towards if towards > 0.0 else math.inf
        rate = yy - side * mu * xy
    # After the slip: stick, or slip the other way.
    ratio = -xy / xx
    if e == 0.0 and abs(ratio) <= mu:
        return slip_at_contact(x, y, inertia, vx, vy, omega, mu)
    if abs(ratio) > mu:
        ratio = math.copysign(mu, ratio)
    later = yy + ratio * xy
    at_stop = approach + rate * p_s if p_s < math.inf else math.inf
    if at_stop > 0.0:
        # Compressed before the slip ends.
        taken = 0.5 * approach * approach / rate
        p = (1.0 + e) * -approach / rate
        if p > p_s:
            back = e * e * taken - 0.5 * at_stop * at_stop / rate
            p = p_s + (math.sqrt(at_stop * at_stop + 2.0 * later * back) - at_stop) / later
    else:
        taken = -0.5 * (approach + at_stop) * p_s + 0.5 * at_stop * at_stop / later
        p = p_s + (e * math.sqrt(2.0 * later * taken) - at_stop) / later
    jx = -side * mu * min(p, p_s) + ratio * max(p - p_s, 0.0)
    return vx + jx, vy + p, omega + (x * p - y * jx) / inertia


@lean
def held_back(vx: float, ploughing: float, impulse: float) -> float:
    """Return the speed along the ground after the resistance of yielding ground (m/s).

    The impulse ploughing × normal impulse (per unit mass, m/s) acts at the centre, against ``vx``,
    the speed after rebound and friction. It stops the block at most and leaves its spin unchanged.
    Blocks observed at Chant Sura lose speed along the ground without gaining spin, steep impacts
    more than grazing ones: docs/studies/contacts.md.
    """
    return math.copysign(max(abs(vx) - ploughing * impulse, 0.0), vx)


@lean
def share_left(speed: float, growth: float, impulse: float) -> float:
    """Return share of a speed that a resistance of growth × speed² leaves over a normal impulse.

    From dv/dJ = −growth v²; ``growth`` (s²/m²), ``impulse`` per unit mass (m/s).
    """
    return 1.0 / (1.0 + growth * abs(speed) * impulse)


@lean
def limited(
    wx: float, wy: float, spin: float, inertia: float, most: float
) -> tuple[float, float, float]:
    """Return velocity and spin, scaled down together to twice a largest kinetic energy (J/kg)."""
    after = inertia * spin * spin + wx * wx + wy * wy
    if after > most:
        factor = math.sqrt(most / after)
        return wx * factor, wy * factor, spin * factor
    return wx, wy, spin


@lean
def soft_landing(
    x: float, y: float, inertia: float, vx: float, vy: float, omega: float, resistance: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return (v_x, v_y, ω) of turn_about_contact, less what rolling would take.

    Rolling friction takes the energy μ_r (1 + I/r²) N along the path; here the normal impulse takes
    the place of the force N over time. ``resistance`` is μ_r (1 + I/r²), 0 for the words of 1986.
    """
    wx, wy, spin = turn_about_contact(x, y, inertia, vx, vy, omega)
    if resistance == 0.0:
        return wx, wy, spin
    before = inertia * omega * omega + vx * vx + vy * vy
    taken = 2.0 * resistance * (wy - vy) * abs(vx)
    return limited(wx, wy, spin, inertia, max(before - taken, 0.0))


@lean
def impact(
    x: float, y: float, inertia: float, vx: float, vy: float, omega: float, eta_max: float,
    rule: int, mu: float, e: float = 0.0, halved_at: float = 9.144, ploughing: float = 0.0,
    growth: float = 0.0,
) -> tuple[float, float, float]:  # fmt: skip
    """Return (v_x, v_y, ω) after an impact: limited to η_max, or with RESTITUTION held back.

    Parameters
    ----------
    x, y : float
        Centre seen from P in the axes of the ground that is met (m).
    inertia : float
        Per unit mass (m²).
    vx, vy, omega : float
        Before the impact, in the same axes (m/s, rad/s).
    eta_max : float
        Equation (7); not with RESTITUTION.
    rule : int
        SCALE, COULOMB or RESTITUTION.
    mu : float
        Friction of the ground, for COULOMB and RESTITUTION.
    e, halved_at, ploughing, growth : float
        For RESTITUTION: as restitution_at and held_back take them; μ_v/(g d) (s²/m²),
        rolling.growth.
    """
    if rule == RESTITUTION:
        if vy + x * omega >= 0.0:
            # The flank recedes: the round core has been met, below the centre.
            x = 0.0
        rebound = restitution_at(e, halved_at, vy + x * omega)
        wx, wy, spin = rebound_at_contact(x, y, inertia, vx, vy, omega, mu, rebound)
        impulse = wy - vy
        wx = held_back(wx, ploughing, impulse)
        if growth > 0.0:
            # Rolling with some resistance as a moment and as a force takes the same in the end.
            wx *= share_left(vx, (1.0 - TURNING) * growth, impulse)
            spin *= share_left(vx, (1.0 + TURNING * y * y / inertia) * growth, impulse)
        return wx, wy, spin
    if rule == COULOMB:
        wx, wy, spin = slip_at_contact(x, y, inertia, vx, vy, omega, mu)
    else:
        wx, wy, spin = turn_about_contact(x, y, inertia, vx, vy, omega)
    before = inertia * omega * omega + vx * vx + vy * vy
    return limited(wx, wy, spin, inertia, eta_max * before)


@lean
def normal_force(
    x: float, y: float, curvature: float, inertia: float, omega: float, cos_slope: float,
    sin_slope: float, gravity: float,
) -> float:  # fmt: skip
    """Return the normal force per unit mass on an ellipse that turns about P without slip (m/s²).

    From the Lagrangian of the rolling ellipse: with K = ω²(I + x² + y²)/2 and gravity along both
    axes, ω' follows, and with it the acceleration of the centre along the normal.
    """
    turn = (gravity * (y * sin_slope + x * cos_slope) + omega * omega * x * (y + curvature)) / (
        inertia + x * x + y * y
    )
    return gravity * cos_slope + curvature * omega * omega - x * turn
