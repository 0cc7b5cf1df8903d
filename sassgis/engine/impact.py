"""The impact of Bozzolo and Pamini (1986), equations (3) to (7)."""

from __future__ import annotations

import math

from sassgis.model.jit import kernel

SCALE, COULOMB = 0, 1


@kernel
def energy_kept(x: float, y: float, inertia: float, vx: float, vy: float, omega: float) -> float:
    """η_min: share of the kinetic energy kept when P becomes the centre of rotation.

    Equation (6). 1 for a block that does not move.
    """
    before = inertia * omega * omega + vx * vx + vy * vy
    if before == 0.0:
        return 1.0
    momentum = inertia * omega + y * vx - x * vy
    return momentum * momentum / (before * (inertia + x * x + y * y))


@kernel
def turn_about_contact(
    x: float, y: float, inertia: float, vx: float, vy: float, omega: float
) -> tuple[float, float, float]:
    """Spin and velocity after an impact that keeps the angular momentum about P.

    Equations (3) to (5). Returns (v_x, v_y, ω).
    """
    after = (inertia * omega + y * vx - x * vy) / (inertia + x * x + y * y)
    return y * after, -x * after, after


@kernel
def slip_at_contact(
    x: float, y: float, inertia: float, vx: float, vy: float, omega: float, mu: float
) -> tuple[float, float, float]:
    """Impact without rebound of P in which friction holds the contact only up to μ.

    Where the impulse that brings P to rest lies outside the friction cone, P slides on and the
    impulse lies on the cone. Returns (v_x, v_y, ω).
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


@kernel
def impact(
    x: float,
    y: float,
    inertia: float,
    vx: float,
    vy: float,
    omega: float,
    eta_max: float,
    rule: int,
    mu: float,
) -> tuple[float, float, float]:
    """Velocity and spin after an impact, with the energy kept limited to η_max.

    Parameters
    ----------
    x, y : float
        Centre seen from P in the axes of the ground that is met (m).
    inertia : float
        Per unit mass (m²).
    vx, vy, omega : float
        Before the impact, in the same axes (m/s, rad/s).
    eta_max : float
        Equation (7).
    rule : int
        SCALE or COULOMB: how η_max is reached.
    mu : float
        Friction of the ground, for COULOMB.

    Returns
    -------
    vx, vy, omega : float
        After the impact.
    """
    before = inertia * omega * omega + vx * vx + vy * vy
    if rule == COULOMB:
        wx, wy, spin = slip_at_contact(x, y, inertia, vx, vy, omega, mu)
    else:
        wx, wy, spin = turn_about_contact(x, y, inertia, vx, vy, omega)
    after = inertia * spin * spin + wx * wx + wy * wy
    if after > eta_max * before:
        factor = math.sqrt(eta_max * before / after)
        return wx * factor, wy * factor, spin * factor
    return wx, wy, spin


@kernel
def normal_force(
    x: float,
    y: float,
    curvature: float,
    inertia: float,
    omega: float,
    cos_slope: float,
    sin_slope: float,
    gravity: float,
) -> float:
    """Normal force per unit mass on an ellipse that turns about P without slip (m/s²).

    From the Lagrangian of the rolling ellipse: with K = ω²(I + x² + y²)/2 and gravity along both
    axes, ω' follows, and with it the acceleration of the centre along the normal.
    """
    turn = (gravity * (y * sin_slope + x * cos_slope) + omega * omega * x * (y + curvature)) / (
        inertia + x * x + y * y
    )
    return gravity * cos_slope + curvature * omega * omega - x * turn
