"""Stems and boulders in the way of a rock."""

from __future__ import annotations

import math

from sassgis.gap.check.worlds.forces import strike
from sassgis.gap.check.worlds.motion_state import (
    FLY,
    HX,
    HY,
    MODE,
    PHI,
    SPIN,
    VX,
    VY,
    VZ,
    A,
    B,
    Field,
    X,
    Y,
    Z,
    face_velocity,
    mass_of,
)
from sassgis.gap.check.worlds.slopes import height_at
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel

FAR_UP = 100.0


@kernel
def meet_obstacles(f: Field, st: FloatArray, last_hit: IntArray) -> None:
    """Blow against the first stem or lying block that a rock reaches."""
    n_rows, n_cols = f.ground.shape
    i = int((f.north - st[Y]) / f.cell)
    j = int((st[X] - f.west) / f.cell)
    if i < 0 or j < 0 or i >= n_rows or j >= n_cols:
        return
    cell = i * n_cols + j
    radius = math.sqrt(st[A] * st[B])
    for at in range(f.ob_start[cell], f.ob_start[cell + 1]):
        k = f.ob_near[at]
        if k == last_hit[0]:
            continue
        ex = st[X] - f.obstacles[k, 0]
        ey = st[Y] - f.obstacles[k, 1]
        reach = radius + f.obstacles[k, 2]
        if ex * ex + ey * ey > reach * reach:
            continue
        approach = st[VX] * ex + st[VY] * ey
        if approach >= 0.0:
            continue
        if f.obstacles[k, 4] < FAR_UP:
            ground = height_at(f.z, f.west, f.north, f.cell, st[X], st[Y])
            if st[Z] - radius > ground + f.obstacles[k, 4]:
                continue
        distance = math.sqrt(ex * ex + ey * ey)
        if distance < 1e-9:
            continue
        last_hit[0] = k
        speed = math.sqrt(st[VX] ** 2 + st[VY] ** 2)
        vx, vy, _ = strike(
            ex / distance,
            ey / distance,
            st[VX],
            st[VY],
            mass_of(st),
            f.obstacles[k, 3],
            f.obstacles[k, 5],
        )
        after = math.sqrt(vx * vx + vy * vy)
        if st[MODE] != FLY:
            st[MODE] = FLY
            st[VZ] *= min(1.0, after / max(speed, 1e-9))
        if speed > 1e-9:
            # The spin goes with the speed that is left.
            st[SPIN] *= min(1.0, after / speed)
        st[VX] = vx
        st[VY] = vy
        old_x, old_y = st[HX], st[HY]
        face_velocity(st)
        turned = math.atan2(old_x * st[HY] - old_y * st[HX], old_x * st[HX] + old_y * st[HY])
        if abs(turned) >= 0.5 * math.pi:
            st[SPIN] = -st[SPIN]
            st[PHI] = math.pi - st[PHI]
        return
