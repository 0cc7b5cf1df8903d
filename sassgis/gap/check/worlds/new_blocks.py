"""Spawned blocks: fragments, and blocks of the slope that are entrained."""

from __future__ import annotations

import math

import numpy as np

from sassgis.gap.check.worlds import random_draws as draws
from sassgis.gap.check.worlds.forces import Forces
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
    PIECE,
    SPIN,
    VX,
    VY,
    VZ,
    A,
    B,
    C,
    Field,
    KeyArray,
    X,
    Y,
    Z,
    face_velocity,
)
from sassgis.gap.check.worlds.slopes import surface_at
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel


@kernel
def shatter(
    st: FloatArray,
    key: np.uint64,
    n: int,
    lost: float,
    stack: FloatArray,
    stack_keys: KeyArray,
    counts: IntArray,
) -> None:
    """Break a rock: stick-breaking sizes, a cone of velocities that keeps the momentum.

    A tenth of the energy lost in the impact drives the pieces apart.
    """
    pieces = 2 + int(4.0 * draws.uniform(key, draws.PIECES, 64 * n))
    # A waiting list that is full breaks no more: mass is never dropped.
    if counts[0] + pieces > MAX_PIECES or counts[1] + pieces > MAX_PIECES:
        return
    share = np.empty(pieces)
    apart = np.empty((pieces, 3))
    rest = 1.0
    for i in range(pieces):
        # Beta(1, 2): the stick is broken nearer to its beginning.
        cut = 1.0 - math.sqrt(draws.uniform(key, draws.PIECES, 64 * n + 1 + i))
        share[i] = rest if i == pieces - 1 else rest * max(0.05, cut)
        rest -= share[i]
        for k in range(3):
            apart[i, k] = draws.normal(key, draws.SIZE, 64 * n + 3 * i + k)
    mean = np.zeros(3)
    for i in range(pieces):
        for k in range(3):
            mean[k] += share[i] * apart[i, k]
    spread = 0.0
    for i in range(pieces):
        for k in range(3):
            apart[i, k] -= mean[k]
            spread += 0.5 * share[i] * apart[i, k] ** 2
    scale = math.sqrt(0.1 * max(lost, 0.0) / max(spread, 1e-12))
    for i in range(pieces):
        child = stack[counts[0]]
        child[:] = st
        # The pieces are rounder than a long parent, and together have its volume.
        size = share[i] ** (1.0 / 3.0)
        round_ = (st[A] * st[B] * st[C]) ** (1.0 / 3.0)
        child[A] = size * math.sqrt(st[A] * round_)
        child[B] = size * math.sqrt(st[B] * round_)
        child[C] = size * math.sqrt(st[C] * round_)
        child[VX] = st[VX] + scale * apart[i, 0]
        child[VY] = st[VY] + scale * apart[i, 1]
        child[VZ] = st[VZ] + scale * apart[i, 2]
        face_velocity(child)
        child[MODE] = FLY
        child[PIECE] = counts[1]
        child[KIND] = FRAGMENT
        stack_keys[counts[0]] = draws.child_key(key, counts[1])
        counts[0] += 1
        counts[1] += 1
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
    stack: FloatArray,
    stack_keys: KeyArray,
    counts: IntArray,
) -> None:
    """Set a lying block in motion, by chance, with momentum taken from the rock.

    The chance grows with the tangential impulse over what the lying block needs.
    """
    if counts[0] >= MAX_PIECES or counts[1] >= MAX_PIECES:
        return
    size = min(0.8, 0.45 * math.exp(0.35 * draws.normal(key, draws.LOOSE, 2 * n)))
    mass_ratio = size**3
    hazard = forces.loose.q * impulse / (20.0 * mass_ratio)
    if draws.uniform(key, draws.LOOSE, 4 * n + 3) > 1.0 - math.exp(-hazard):
        return
    given = 0.5 * draws.uniform(key, draws.LOOSE, 4 * n + 2)
    child = stack[counts[0]]
    child[:] = st
    child[A] *= size
    child[B] *= size
    child[C] *= size
    child[X] = px
    child[Y] = py
    zg, gx, gy = surface_at(f.z, f.west, f.north, f.cell, px, py)
    slope = math.atan(-(gx * st[HX] + gy * st[HY]))
    child[Z] = zg + 1.02 * child[A] / math.cos(slope)
    vt = given * max(
        0.0,
        math.sqrt(st[VX] ** 2 + st[VY] ** 2) * math.cos(slope) - st[VZ] * math.sin(slope),
    )
    child[VX] = vt * math.cos(slope) * st[HX]
    child[VY] = vt * math.cos(slope) * st[HY]
    child[VZ] = -vt * math.sin(slope)
    child[SPIN] = 0.0
    child[MODE] = FLY
    child[PIECE] = counts[1]
    child[KIND] = LOOSENED
    st[VX] -= mass_ratio * child[VX]
    st[VY] -= mass_ratio * child[VY]
    st[VZ] -= mass_ratio * child[VZ]
    stack_keys[counts[0]] = draws.child_key(key, counts[1])
    counts[0] += 1
    counts[1] += 1
