"""What a contact does to a rock: equations 3 to 7 of Bozzolo and Pamini (1986), and two laws.

Axes at the contact point P: x down-slope, y outward normal, clockwise spin positive; (x, y) is the
centre seen from P. Impulses and energies are per unit mass. The second law is one that the model of
the diagnosing side does not have.
"""

from __future__ import annotations

import math

from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel

GRAVITY = 9.81
#: own: that of the model. elastic: a constant coefficient of restitution and Coulomb friction,
#: and nothing else is lost.
OWN, ELASTIC = range(2)
#: Columns of a law of the ground.
ETA_MAX, DP_MIN, DP_MAX, MU_F, MU_0, K, D_STAR, E, E_SPEED, SOFT = range(10)
_INCREMENTS = 300
_MOST = 60_000


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
def rolling_friction(law: FloatArray, size: float) -> float:
    """μ_r = μ_0 + k d*/d with d = 2 ∛(abc) (equation 2)."""
    return float(law[MU_0] + law[K] * law[D_STAR] / (2.0 * size))


@kernel
def contact(
    kind: int,
    a: float,
    b: float,
    c: float,
    theta: float,
    vx: float,
    vy: float,
    spin: float,
    law: FloatArray,
    shrunk: float = 1.0,
    bare: bool = False,
) -> tuple[float, float, float]:
    """Velocity and spin after a contact with ground that is met.

    Parameters
    ----------
    kind : int
        OWN or ELASTIC.
    a, b, c : float
        Semi-axes (m); the first two lie in the plane of motion.
    theta : float
        Angle of the major axis, counter-clockwise from the tangent (rad).
    vx, vy, spin : float
        Before (m/s, rad/s).
    law : float64, shape (10,)
        Of the ground.
    shrunk : float
        Factor on the share of the energy that is kept, where an effect takes some.
    bare : bool
        Whether the rock is met as the circle as which it rolls.
    """
    inertia = (a * a + b * b) / 5.0
    x, y = lever(a, b, theta)
    if bare:
        x, y = 0.0, rolling_radius(a, b)
    if vy + x * spin >= 0.0:
        # The flank recedes: it is met with its round core.
        x = 0.0
    approach = vy + x * spin
    e = law[E]
    if kind == OWN:
        e /= 1.0 + (approach / law[E_SPEED]) ** 2
    wx, wy, after = compressed(x, y, inertia, vx, vy, spin, law[MU_F], e)
    if kind == OWN:
        share = rolling_charge(a, b, c, law) if bare else 1.0 - law[ETA_MAX]
        least = share * abs(wy - vy)
        wx = 0.0 if abs(wx) < least else wx - math.copysign(least, wx)
        scale = math.sqrt(shrunk)
        wx, wy, after = wx * scale, wy * scale, after * scale
    return wx, wy, after


@kernel
def rolling_charge(a: float, b: float, c: float, law: FloatArray) -> float:
    """Energy that rolling takes, over the normal force and the path: μ_r (1 + I/r²)."""
    mu = rolling_friction(law, (a * b * c) ** (1.0 / 3.0))
    return mu * (1.0 + (a * a + b * b) / 5.0 / rolling_radius(a, b) ** 2)


@kernel
def compressed(
    x: float, y: float, inertia: float, vx: float, vy: float, spin: float, mu: float, e: float
) -> tuple[float, float, float]:
    """Impact with dry friction in small steps of the normal impulse (Darboux and Keller).

    P slips and friction opposes it, or sticks. The normal force does work against the approach;
    e² of it is given back (Stronge 1990).
    """
    yy = 1.0 + x * x / inertia
    xx = 1.0 + y * y / inertia
    xy = -x * y / inertia
    slip = vx - y * spin
    approach = vy + x * spin
    step = -approach / (yy * _INCREMENTS)
    work = 0.0
    jx = 0.0
    jy = 0.0
    turned = False
    back = 0.0
    for _ in range(_MOST):
        if approach >= -1e-12 and not turned:
            turned = True
            back = -e * e * work
            work = 0.0
        if turned and work >= back:
            break
        stuck = abs(slip) < 1e-12
        if stuck:
            ratio = min(max(-xy / xx, -mu), mu)
        else:
            ratio = -math.copysign(mu, slip)
        dp = step
        rate = xx * ratio + xy
        normal = yy + ratio * xy
        if not turned and approach + normal * dp > 0.0:
            dp = -approach / normal
        if not stuck and slip * rate < 0.0 and abs(rate) * dp >= abs(slip):
            dp = abs(slip / rate)
            slip = 0.0
        elif not stuck or abs(-xy / xx) > mu:
            slip += rate * dp
        gain = normal * dp
        work += (approach + 0.5 * gain) * dp
        approach += gain
        jx += ratio * dp
        jy += dp
    return vx + jx, vy + jy, spin + (x * jy - y * jx) / inertia
