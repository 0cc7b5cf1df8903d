"""The base law at one contact, written from equations 3 to 7 of Bozzolo and Pamini (1986).

Axes at the contact point P: x down-slope, y outward normal, clockwise spin positive; (x, y) is
the centre seen from P. Energies are per unit mass.
"""

from __future__ import annotations

import math

from sassgis.model.jit import kernel

GRAVITY = 9.81


@kernel
def lever(a: float, b: float, theta: float) -> tuple[float, float]:
    """Centre (x, y) seen from the point where an ellipse touches its tangent (m).

    Parameters
    ----------
    a, b : float
        Semi-axes (m), a >= b.
    theta : float
        Angle of the major axis, counter-clockwise from the tangent (rad).
    """
    s = math.sin(theta)
    c = math.cos(theta)
    y = math.sqrt(a * a * s * s + b * b * c * c)
    return (a * a - b * b) * s * c / y, y


@kernel
def kinetic(inertia: float, vx: float, vy: float, spin: float) -> float:
    """Kinetic energy per unit mass (J/kg)."""
    return 0.5 * (vx * vx + vy * vy + inertia * spin * spin)


@kernel
def rebound(
    x: float, y: float, inertia: float, vx: float, vy: float, spin: float, eta_max: float
) -> tuple[float, float, float, float]:
    """State after an impact that keeps the angular momentum about P, and at most η_max of K.

    Returns
    -------
    vx, vy, spin : float
        After the impact (m/s, m/s, rad/s).
    eta_min : float
        Share of the energy that would be kept without the limit (equation 6).
    """
    before = kinetic(inertia, vx, vy, spin)
    if before <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    new_spin = (inertia * spin + y * vx - x * vy) / (inertia + x * x + y * y)
    eta_min = 0.5 * new_spin * new_spin * (inertia + x * x + y * y) / before
    if eta_min > eta_max:
        new_spin *= math.sqrt(eta_max / eta_min)
    return y * new_spin, -x * new_spin, new_spin, eta_min


@kernel
def thrown_off(a: float, b: float, theta: float, spin: float, slope: float) -> bool:
    """Whether an ellipse that turns about its point of contact leaves the ground.

    The normal force from its equation of motion is below zero, and its flank recedes from the
    ground faster than it falls.
    """
    x, y = lever(a, b, theta)
    bend = ((a * a - b * b) * math.cos(2.0 * theta) - x * x) / y
    inertia = (a * a + b * b) / 5.0
    pull, weight = GRAVITY * math.sin(slope), GRAVITY * math.cos(slope)
    turning = y * pull + x * weight + spin * spin * x * (y + bend)
    turning /= inertia + x * x + y * y
    force = weight + bend * spin * spin - x * turning
    return force < 0.0 and weight + bend * spin * spin < 0.0


@kernel
def rolling_radius(a: float, b: float) -> float:
    """Radius of the circle as which an ellipse rolls (m): its perimeter over 2π.

    The arc length by the trapezoidal rule, which converges geometrically on a closed curve.
    """
    n = 16
    total = 0.0
    for k in range(n):
        t = 0.5 * math.pi * (k + 0.5) / n
        total += math.sqrt((a * math.sin(t)) ** 2 + (b * math.cos(t)) ** 2)
    return total / n


@kernel
def rolling_friction(mu_0: float, k: float, d_star: float, size: float) -> float:
    """μ_r = μ_0 + k d*/d with d = 2 ∛(abc) (equation 2)."""
    return mu_0 + k * d_star / (2.0 * size)
