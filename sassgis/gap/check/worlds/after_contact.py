"""What a rock does after a contact: it lands, turns, breaks, entrains blocks, strikes obstacles."""

from __future__ import annotations

import math

import numpy as np

from sassgis.gap.check.worlds import contact_laws as laws
from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds import random_draws as draws
from sassgis.gap.check.worlds.forces import Forces, strike
from sassgis.gap.check.worlds.slopes import height_at
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel

FAR_UP = 100.0


@kernel
def settle(
    f: ms.Field, st: FloatArray, law: FloatArray, slope: float, vt_in: float, vn_in: float
) -> None:
    """Soft landing, on the mean slope: the bumps that vary it are part of rolling."""
    a, b = st[ms.A], st[ms.B]
    inertia = (a * a + b * b) / 5.0
    x, y = laws.lever(a, b, st[ms.PHI] + slope)
    vt, vn, spin, _ = laws.rebound(x, y, inertia, vt_in, vn_in, st[ms.SPIN], 1.0)
    before = laws.kinetic(inertia, vt_in, vn_in, st[ms.SPIN])
    taken = laws.rolling_charge(a, b, st[ms.C], law) * abs(vn - vn_in) * abs(vt_in)
    held = math.sqrt(
        min(1.0, max(before - taken, 0.0) / max(laws.kinetic(inertia, vt, vn, spin), 1e-12))
    )
    land(f, st, slope, held * vt, held * vn, held * spin)


@kernel
def land(f: ms.Field, st: FloatArray, slope: float, vt: float, vn: float, spin: float) -> None:
    """Go over into rolling with all of the energy, less what lifts the centre to the mean radius.

    What cannot be lifted that far slides as it lies.
    """
    a, b = st[ms.A], st[ms.B]
    inertia = (a * a + b * b) / 5.0
    radius = laws.rolling_radius(a, b)
    forward = vt if vt != 0.0 else spin
    rise = ms.ground_at(f, st[ms.X], st[ms.Y]) + radius / math.cos(slope) - st[ms.Z]
    left = laws.kinetic(inertia, vt, vn, spin) - laws.GRAVITY * rise
    if left > 0.0:
        v = math.sqrt(2.0 * left / (1.0 + inertia / (radius * radius)))
        st[ms.MODE] = ms.ROLL
        turning = v / radius
    else:
        v = abs(vt)
        st[ms.MODE] = ms.SLIDE
        turning = 0.0
    if forward < 0.0:
        turn_back(st)
        slope = -slope
    st[ms.SPIN] = turning
    ms.set_velocity(st, v, 0.0, slope)


@kernel
def turn_back(st: FloatArray) -> None:
    """Face the other way: the plane of motion is seen from its other side."""
    st[ms.HX] = -st[ms.HX]
    st[ms.HY] = -st[ms.HY]
    st[ms.PHI] = math.pi - st[ms.PHI]
    st[ms.SPIN] = -st[ms.SPIN]


@kernel
def lean(f: ms.Field, st: FloatArray) -> float:
    """Angle by which the smoothed terrain falls to the left of the heading (rad)."""
    gx = height_at(f.gx, f.west, f.north, f.cell, st[ms.X], st[ms.Y])
    gy = height_at(f.gy, f.west, f.north, f.cell, st[ms.X], st[ms.Y])
    return math.atan(gx * st[ms.HY] - gy * st[ms.HX])


@kernel
def turn_by(st: FloatArray, angle: float) -> None:
    """Turn the heading to the left (rad)."""
    st[ms.HX], st[ms.HY] = ms.rotated(st[ms.HX], st[ms.HY], angle)


@kernel
def _spawned(st: FloatArray, key: np.uint64, kind: int, waiting: ms.Waiting) -> FloatArray:
    """A flying block that waits, otherwise as the one that it comes from."""
    k, number = waiting.counts[0], waiting.counts[1]
    waiting.counts[0] += 1
    waiting.counts[1] += 1
    waiting.keys[k] = draws.child_key(key, number)
    child: FloatArray = waiting.states[k]
    child[:] = st
    child[ms.MODE] = ms.FLY
    child[ms.PIECE] = number
    child[ms.KIND] = kind
    return child


@kernel
def shatter(st: FloatArray, key: np.uint64, n: int, lost: float, waiting: ms.Waiting) -> None:
    """Break a rock: stick-breaking sizes, a cone of velocities that keeps the momentum.

    A tenth of the energy lost in the impact drives the pieces apart.
    """
    pieces = 2 + int(4.0 * draws.uniform(key, draws.PIECES, 64 * n))
    # A waiting list that is full breaks no more: mass is never dropped.
    if waiting.counts[1] + pieces > ms.MAX_PIECES:
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
    round_ = (st[ms.A] * st[ms.B] * st[ms.C]) ** (1.0 / 3.0)
    for i in range(pieces):
        child = _spawned(st, key, ms.FRAGMENT, waiting)
        # The pieces are rounder than a long parent, and together have its volume.
        for k in range(3):
            child[ms.A + k] = share[i] ** (1.0 / 3.0) * math.sqrt(st[ms.A + k] * round_)
            child[ms.VX + k] = st[ms.VX + k] + scale * apart[i, k]
        ms.face_velocity(child)
    st[ms.MODE] = ms.BROKEN


@kernel
def loosen(
    f: ms.Field,
    forces: Forces,
    st: FloatArray,
    key: np.uint64,
    n: int,
    impulse: float,
    px: float,
    py: float,
    waiting: ms.Waiting,
) -> None:
    """Set a lying block in motion, by chance, with momentum taken from the rock.

    The chance grows with the tangential impulse over what the lying block needs.
    """
    if waiting.counts[1] >= ms.MAX_PIECES:
        return
    size = min(0.8, 0.45 * math.exp(0.35 * draws.normal(key, draws.LOOSE, 2 * n)))
    mass_ratio = size**3
    hazard = forces.entrainment.q * impulse / (20.0 * mass_ratio)
    if draws.uniform(key, draws.LOOSE, 4 * n + 3) > 1.0 - math.exp(-hazard):
        return
    given = 0.5 * draws.uniform(key, draws.LOOSE, 4 * n + 2)
    child = _spawned(st, key, ms.LOOSENED, waiting)
    for k in range(3):
        child[ms.A + k] *= size
    zg, slope = ms.slope_at(f, st, px, py)
    child[ms.X], child[ms.Y], child[ms.Z] = px, py, zg + 1.02 * child[ms.A] / math.cos(slope)
    vt, _ = ms.rotated(ms.along_of(st), st[ms.VZ], slope)
    ms.set_velocity(child, given * max(0.0, vt), 0.0, slope)
    child[ms.SPIN] = 0.0
    st[ms.VX] -= mass_ratio * child[ms.VX]
    st[ms.VY] -= mass_ratio * child[ms.VY]
    st[ms.VZ] -= mass_ratio * child[ms.VZ]


@kernel
def meet_obstacles(f: ms.Field, st: FloatArray, last_hit: IntArray) -> None:
    """Blow against the first stem or lying block that a rock reaches."""
    i, j = ms.cell_of(f, st[ms.X], st[ms.Y])
    cell = i * f.ground.shape[1] + j
    radius = math.sqrt(st[ms.A] * st[ms.B])
    for at in range(f.ob_start[cell], f.ob_start[cell + 1]):
        k = f.ob_near[at]
        if k == last_hit[0]:
            continue
        ex = st[ms.X] - f.obstacles[k, 0]
        ey = st[ms.Y] - f.obstacles[k, 1]
        reach = radius + f.obstacles[k, 2]
        if ex * ex + ey * ey > reach * reach or st[ms.VX] * ex + st[ms.VY] * ey >= 0.0:
            continue
        height = f.obstacles[k, 4]
        if height < FAR_UP and st[ms.Z] - radius > ms.ground_at(f, st[ms.X], st[ms.Y]) + height:
            continue
        last_hit[0] = k
        distance = math.sqrt(ex * ex + ey * ey)
        speed = ms.along_of(st)
        capacity, mass = f.obstacles[k, 3], f.obstacles[k, 5]
        st[ms.VX], st[ms.VY] = strike(
            ex / distance, ey / distance, st[ms.VX], st[ms.VY], ms.mass_of(st), capacity, mass
        )
        # The spin goes with the speed that is left.
        kept = min(1.0, ms.along_of(st) / max(speed, 1e-9))
        st[ms.SPIN] *= kept
        if st[ms.MODE] != ms.FLY:
            st[ms.VZ] *= kept
        st[ms.MODE] = ms.FLY
        old_x, old_y = st[ms.HX], st[ms.HY]
        ms.face_velocity(st)
        if abs(ms.angle_between(old_x, old_y, st[ms.HX], st[ms.HY])) >= 0.5 * math.pi:
            st[ms.SPIN] = -st[ms.SPIN]
            st[ms.PHI] = math.pi - st[ms.PHI]
        return
