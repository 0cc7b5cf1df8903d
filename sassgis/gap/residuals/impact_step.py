"""One impact from an observed state: what the model makes of it, whatever is not observed drawn."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.draws import block_of, with_outline
from sassgis.engine.effects import hooks
from sassgis.engine.ellipse import frame_of
from sassgis.engine.impact import impact
from sassgis.engine.rolling import growth
from sassgis.engine.rows import Records
from sassgis.engine.state import Physics
from sassgis.model.grid import FloatArray, IntArray
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
    states: FloatArray,
    kinds: IntArray,
    axes: FloatArray,
    draws: FloatArray,
    keys: NDArray[np.uint64],
    density: FloatArray,
    grounds: Records,
    scratch: Records,
    physics: Physics,
    effects: hooks.Effects | None,
    out: FloatArray,
) -> None:
    """What the engine makes of observed states before impacts.

    Parameters
    ----------
    states : float64, shape (n, 4)
        Dip of the ground along the travel (rad), v_t, v_n, ω before (m/s, rad/s).
    kinds : int64, shape (n,)
        Ground class.
    axes : float64, shape (n, m, 3)
        Semi-axes of the rock, longest first (m).
    draws : float64, shape (n, m, 3)
        Phase (rad) and relative variation of the slope; the orientation at contact (rad) is written
        into the last.
    keys : uint64, shape (n, m)
        For what effects draw.
    density : float64, shape (n,)
        (kg/m³)
    grounds : GROUND_DTYPE
    scratch : BLOCK_DTYPE, shape (1,)
    out : float64, shape (n, m, 3)
        v_t, v_n, ω after, along the ground as it was surveyed. NaN where the model would not have
        the rock rebound but roll.
    """
    state = scratch[0]
    for i in range(states.shape[0]):
        dip, vt, vn, omega = states[i]
        ux, uz, nx, nz = math.cos(dip), -math.sin(dip), math.sin(dip), math.cos(dip)
        ground = grounds[kinds[i]]
        for k in range(axes.shape[1]):
            a, b, c = axes[i, k]
            mass = 4.0 / 3.0 * math.pi * a * b * c * density[i]
            stated = block_of(a, b, c, density[i], mass, keys[i, k])
            block = hooks.on_block(effects, with_outline(stated, physics))
            a, b = block.a, block.b
            out[i, k, :] = np.nan
            low = 2.0 * physics.gravity * nz * ground.rolling_threshold * block.radius
            if vn >= 0.0 or vn * vn < low:
                continue
            theta = orientation_at_contact(a, b, draws[i, k, 0], vn, omega)
            draws[i, k, 2] = theta
            state.impacts = 1
            state.vx, state.vz = vt * ux + vn * nx, vt * uz + vn * nz
            mx, mz = nx, nz
            if physics.slope_variation and dip > 0.0 and vt > 0.0:
                # tan β' = tan β (1 − u), Bozzolo and Pamini (1986), Table 1.
                met = math.atan(math.tan(dip) * (1.0 - draws[i, k, 1]))
                mx, mz = math.sin(met), math.cos(met)
            mx, mz, rule, friction = hooks.on_contact(
                effects, state, block, ground, mx, mz, physics.eta_rule, ground.mu_f
            )
            turn = theta - dip + math.atan2(mx, mz)
            x, y, _ = frame_of(a, b, math.sin(turn), math.cos(turn))
            into = state.vx * mx + state.vz * mz
            wt, wn, spin = impact(
                x, y, block.inertia, state.vx * mz - state.vz * mx, into, omega, ground.eta_max,
                rule, friction, ground.restitution, ground.restitution_speed_mps,
                1.0 - ground.eta_max, growth(block, ground, physics),
            )  # fmt: skip
            wt, wn, spin = hooks.after_impact(effects, state, block, ground, -into, wt, wn, spin)
            vx, vz = wt * mz + wn * mx, wn * mz - wt * mx
            out[i, k, 0] = vx * ux + vz * uz
            out[i, k, 1] = vx * nx + vz * nz
            out[i, k, 2] = spin
