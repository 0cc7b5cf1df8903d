"""One impact from an observed state: what the model makes of it, whatever is not observed drawn."""

from __future__ import annotations

import math

import numpy as np

from sassgis.engine.ellipse import frame_of, inertia, mean_radius
from sassgis.engine.impact import impact
from sassgis.engine.rolling import rolling_friction
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel

#: Parts into which the last bit of the fall, from the longer semi-axis to the shorter one, is cut.
_STEPS = 48


@kernel
def orientation_at_contact(a: float, b: float, phase: float, vn: float, omega: float) -> float:
    """Orientation in which a turning ellipse that comes down first touches the ground.

    A tumbling rock does not land in every orientation alike: its long axis strikes first. Its
    centre is let down from the height of the longer semi-axis at a constant speed, turning.

    Parameters
    ----------
    a, b : float
        Semi-axes (m).
    phase : float
        Angle of the major axis to the ground at the height a (rad).
    vn, omega : float
        Normal speed, below zero (m/s); spin (rad/s).

    Returns
    -------
    float
        Angle of the major axis to the ground (rad).
    """
    last = (a - b) / -vn
    before = 0.0
    for i in range(1, _STEPS + 1):
        t = last * i / _STEPS
        angle = phase - omega * t
        _, y, _ = frame_of(a, b, math.sin(angle), math.cos(angle))
        if a + vn * t <= y:
            for _ in range(20):
                middle = 0.5 * (before + t)
                angle = phase - omega * middle
                _, y, _ = frame_of(a, b, math.sin(angle), math.cos(angle))
                if a + vn * middle <= y:
                    t = middle
                else:
                    before = middle
            return phase - omega * t
        before = t
    return phase - omega * last


@kernel
def impact_draws(
    rows: FloatArray,
    axes: FloatArray,
    draws: FloatArray,
    gravity: float,
    rule: int,
    out: FloatArray,
) -> None:
    """What the model makes of observed states before impacts.

    Parameters
    ----------
    rows : float64, shape (n, 13)
        Dip of the ground along the travel (rad), v_t, v_n, ω before (m/s, rad/s) and η_max, μ_f of
        the ground; 1 where the ground met varies (0: it does not); restitution, the speed at which
        it has halved (m/s), rolling threshold and μ_0, k, d* of the ground.
    axes : float64, shape (n, m, 3)
        Semi-axes of the rock, longest first (m).
    draws : float64, shape (n, m, 3)
        Phase (rad) and relative variation of the slope; the orientation at contact (rad) is written
        into the last.
    gravity, rule
        As in the engine's settings.
    out : float64, shape (n, m, 3)
        v_t, v_n, ω after, along the ground as it was surveyed. NaN where the model would not have
        the rock rebound but roll.
    """
    for i in range(rows.shape[0]):
        dip, vt, vn, omega, eta_max, mu, varies, e, halved_at, threshold = rows[i, :10]
        mu_0, k_d, d_star = rows[i, 10:]
        for k in range(axes.shape[1]):
            a, b, c = axes[i, k]
            inert = inertia(a, b)
            radius = (a * b * c) ** (1.0 / 3.0)
            out[i, k, :] = np.nan
            if vn >= 0.0 or vn * vn < 2.0 * gravity * math.cos(dip) * threshold * radius:
                continue
            # Angles are counter-clockwise in the plane: the ground that is met is turned by this.
            turn = 0.0
            if varies > 0.0 and dip > 0.0 and vt > 0.0:
                turn = dip - math.atan(math.tan(dip) * (1.0 - draws[i, k, 1]))
            theta = orientation_at_contact(a, b, draws[i, k, 0], vn, omega)
            draws[i, k, 2] = theta
            cosine = math.cos(turn)
            sine = math.sin(turn)
            met_t = vt * cosine + vn * sine
            met_n = vn * cosine - vt * sine
            x, y, _ = frame_of(a, b, math.sin(theta - turn), math.cos(theta - turn))
            share = 1.0 + inert / mean_radius(a, b) ** 2
            resistance = share * rolling_friction(mu_0, k_d, d_star, radius)
            wt, wn, spin = impact(
                x, y, inert, met_t, met_n, omega, eta_max, rule, mu, e, halved_at, resistance
            )  # fmt: skip
            out[i, k, 0] = wt * cosine - wn * sine
            out[i, k, 1] = wn * cosine + wt * sine
            out[i, k, 2] = spin
