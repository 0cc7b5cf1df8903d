"""What a rock does after a contact: it lands, turns, breaks, entrains blocks, strikes obstacles."""

from __future__ import annotations

import math

import numpy as np

from sassgis.gap.check.worlds import contact_laws as laws
from sassgis.gap.check.worlds import random_draws as draws
from sassgis.gap.check.worlds.contact_laws import GRAVITY, kinetic, lever, rebound, rolling_radius
from sassgis.gap.check.worlds.forces import Forces, strike
from sassgis.gap.check.worlds.motion_state import (
    BROKEN,
    FLY,
    FRAGMENT,
    HX,
    HY,
    KIND,
    LOOSENED,
    MAX_PIECES,
    MODE,
    PHI,
    PIECE,
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
    Waiting,
    X,
    Y,
    Z,
    along_of,
    angle_between,
    cell_of,
    face_velocity,
    ground_at,
    mass_of,
    rotated,
    set_velocity,
    slope_at,
)
from sassgis.gap.check.worlds.slopes import height_at
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel

FAR_UP = 100.0


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
    rise = ground_at(f, st[X], st[Y]) + radius / math.cos(slope) - st[Z]
    left = kinetic(inertia, vt, vn, spin) - GRAVITY * rise
    if left > 0.0:
        v = math.sqrt(2.0 * left / (1.0 + inertia / (radius * radius)))
        st[MODE] = ROLL
        turning = v / radius
    else:
        v = abs(vt)
        st[MODE] = SLIDE
        turning = 0.0
    if forward < 0.0:
        turn_back(st)
        slope = -slope
    st[SPIN] = turning
    set_velocity(st, v, 0.0, slope)


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
    st[HX], st[HY] = rotated(st[HX], st[HY], angle)


@kernel
def _spawned(st: FloatArray, key: np.uint64, kind: int, waiting: Waiting) -> FloatArray:
    """A flying block that waits, otherwise as the one that it comes from."""
    k, number = waiting.counts[0], waiting.counts[1]
    waiting.counts[0] += 1
    waiting.counts[1] += 1
    waiting.keys[k] = draws.child_key(key, number)
    child: FloatArray = waiting.states[k]
    child[:] = st
    child[MODE] = FLY
    child[PIECE] = number
    child[KIND] = kind
    return child


@kernel
def shatter(st: FloatArray, key: np.uint64, n: int, lost: float, waiting: Waiting) -> None:
    """Break a rock: stick-breaking sizes, a cone of velocities that keeps the momentum.

    A tenth of the energy lost in the impact drives the pieces apart.
    """
    pieces = 2 + int(4.0 * draws.uniform(key, draws.PIECES, 64 * n))
    # A waiting list that is full breaks no more: mass is never dropped.
    if waiting.counts[1] + pieces > MAX_PIECES:
        return
    share = np.empty(pieces)
    apart = np.empty((pieces, 3))
    mean = np.zeros(3)
    rest = 1.0
    for i in range(pieces):
        # Beta(1, 2): the stick is broken nearer to its beginning.
        cut = 1.0 - math.sqrt(draws.uniform(key, draws.PIECES, 64 * n + 1 + i))
        share[i] = rest if i == pieces - 1 else rest * max(0.05, cut)
        rest -= share[i]
        for k in range(3):
            apart[i, k] = draws.normal(key, draws.SIZE, 64 * n + 3 * i + k)
            mean[k] += share[i] * apart[i, k]
    spread = 0.0
    for i in range(pieces):
        for k in range(3):
            apart[i, k] -= mean[k]
            spread += 0.5 * share[i] * apart[i, k] ** 2
    scale = math.sqrt(0.1 * max(lost, 0.0) / max(spread, 1e-12))
    round_ = (st[A] * st[B] * st[C]) ** (1.0 / 3.0)
    for i in range(pieces):
        child = _spawned(st, key, FRAGMENT, waiting)
        # The pieces are rounder than a long parent, and together have its volume.
        for k in range(3):
            child[A + k] = share[i] ** (1.0 / 3.0) * math.sqrt(st[A + k] * round_)
            child[VX + k] = st[VX + k] + scale * apart[i, k]
        face_velocity(child)
    st[MODE] = BROKEN


@kernel
def loosen(
    f: Field,
    forces: Forces,
    st: FloatArray,
    key: np.uint64,
    n: int,
    impulse: float,
    px: float,
    py: float,
    waiting: Waiting,
) -> None:
    """Set a lying block in motion, by chance, with momentum taken from the rock.

    The chance grows with the tangential impulse over what the lying block needs.
    """
    if waiting.counts[1] >= MAX_PIECES:
        return
    size = min(0.8, 0.45 * math.exp(0.35 * draws.normal(key, draws.LOOSE, 2 * n)))
    mass_ratio = size**3
    hazard = forces.entrainment.q * impulse / (20.0 * mass_ratio)
    if draws.uniform(key, draws.LOOSE, 4 * n + 3) > 1.0 - math.exp(-hazard):
        return
    given = 0.5 * draws.uniform(key, draws.LOOSE, 4 * n + 2)
    child = _spawned(st, key, LOOSENED, waiting)
    for k in range(3):
        child[A + k] *= size
    zg, slope = slope_at(f, st, px, py)
    child[X], child[Y], child[Z] = px, py, zg + 1.02 * child[A] / math.cos(slope)
    vt, _ = rotated(along_of(st), st[VZ], slope)
    set_velocity(child, given * max(0.0, vt), 0.0, slope)
    child[SPIN] = 0.0
    st[VX] -= mass_ratio * child[VX]
    st[VY] -= mass_ratio * child[VY]
    st[VZ] -= mass_ratio * child[VZ]


@kernel
def meet_obstacles(f: Field, st: FloatArray, last_hit: IntArray) -> None:
    """Blow against the first stem or lying block that a rock reaches."""
    i, j = cell_of(f, st[X], st[Y])
    cell = i * f.ground.shape[1] + j
    radius = math.sqrt(st[A] * st[B])
    for at in range(f.ob_start[cell], f.ob_start[cell + 1]):
        k = f.ob_near[at]
        if k == last_hit[0]:
            continue
        ex = st[X] - f.obstacles[k, 0]
        ey = st[Y] - f.obstacles[k, 1]
        reach = radius + f.obstacles[k, 2]
        if ex * ex + ey * ey > reach * reach or st[VX] * ex + st[VY] * ey >= 0.0:
            continue
        height = f.obstacles[k, 4]
        if height < FAR_UP and st[Z] - radius > ground_at(f, st[X], st[Y]) + height:
            continue
        last_hit[0] = k
        distance = math.sqrt(ex * ex + ey * ey)
        speed = along_of(st)
        capacity, mass = f.obstacles[k, 3], f.obstacles[k, 5]
        st[VX], st[VY] = strike(
            ex / distance, ey / distance, st[VX], st[VY], mass_of(st), capacity, mass
        )
        # The spin goes with the speed that is left.
        kept = min(1.0, along_of(st) / max(speed, 1e-9))
        st[SPIN] *= kept
        if st[MODE] != FLY:
            st[VZ] *= kept
        st[MODE] = FLY
        old_x, old_y = st[HX], st[HY]
        face_velocity(st)
        if abs(angle_between(old_x, old_y, st[HX], st[HY])) >= 0.5 * math.pi:
            st[SPIN] = -st[SPIN]
            st[PHI] = math.pi - st[PHI]
        return
