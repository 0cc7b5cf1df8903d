"""What a rock does after a contact that it does not leave, and where it heads."""

from __future__ import annotations

import math

from sassgis.gap.check.worlds import contact_laws as laws
from sassgis.gap.check.worlds.law import GRAVITY, kinetic, lever, rebound, rolling_radius
from sassgis.gap.check.worlds.motion_state import (
    HX,
    HY,
    MODE,
    PHI,
    ROLL,
    SLIDE,
    SPIN,
    VX,
    VY,
    VZ,
    A,
    B,
    C,
    Field,
    X,
    Y,
    Z,
)
from sassgis.gap.check.worlds.slopes import height_at
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel


@kernel
def settle(
    f: Field, st: FloatArray, law: FloatArray, slope: float, vt_in: float, vn_in: float
) -> None:
    """Soft landing, on the mean slope: the bumps that vary it are part of rolling."""
    a, b = st[A], st[B]
    inertia = (a * a + b * b) / 5.0
    x, y = lever(a, b, st[PHI] + slope)
    vt, vn, spin, _ = rebound(x, y, inertia, vt_in, vn_in, st[SPIN], 1.0)
    before = kinetic(inertia, vt_in, vn_in, st[SPIN])
    taken = laws.rolling_charge(a, b, st[C], law) * abs(vn - vn_in) * abs(vt_in)
    held = math.sqrt(
        min(1.0, max(before - taken, 0.0) / max(kinetic(inertia, vt, vn, spin), 1e-12))
    )
    land(f, st, slope, held * vt, held * vn, held * spin)


@kernel
def land(f: Field, st: FloatArray, slope: float, vt: float, vn: float, spin: float) -> None:
    """Go over into rolling with all of the energy, less what lifts the centre to the mean radius.

    What cannot be lifted that far slides as it lies.
    """
    a, b = st[A], st[B]
    inertia = (a * a + b * b) / 5.0
    radius = rolling_radius(a, b)
    forward = vt if vt != 0.0 else spin
    ground = height_at(f.z, f.west, f.north, f.cell, st[X], st[Y])
    rise = ground + radius / math.cos(slope) - st[Z]
    left = kinetic(inertia, vt, vn, spin) - GRAVITY * rise
    if left > 0.0:
        v = math.sqrt(2.0 * left / (1.0 + inertia / (radius * radius)))
        st[MODE] = ROLL
        st[SPIN] = v / radius
    else:
        v = abs(vt)
        st[MODE] = SLIDE
        st[SPIN] = 0.0
    if forward < 0.0:
        turning = st[SPIN]
        turn_back(st)
        st[SPIN] = turning
        slope = -slope
    st[VX] = v * math.cos(slope) * st[HX]
    st[VY] = v * math.cos(slope) * st[HY]
    st[VZ] = -v * math.sin(slope)


@kernel
def turn_back(st: FloatArray) -> None:
    """Face the other way: the plane of motion is seen from its other side."""
    st[HX] = -st[HX]
    st[HY] = -st[HY]
    st[PHI] = math.pi - st[PHI]
    st[SPIN] = -st[SPIN]


@kernel
def lean(f: Field, st: FloatArray) -> float:
    """Angle by which the smoothed terrain falls to the left of the heading (rad)."""
    gx = height_at(f.gx, f.west, f.north, f.cell, st[X], st[Y])
    gy = height_at(f.gy, f.west, f.north, f.cell, st[X], st[Y])
    return math.atan(gx * st[HY] - gy * st[HX])


@kernel
def turn_by(st: FloatArray, angle: float) -> None:
    """Turn the heading to the left (rad)."""
    c = math.cos(angle)
    s = math.sin(angle)
    hx = st[HX]
    st[HX] = c * hx - s * st[HY]
    st[HY] = s * hx + c * st[HY]
