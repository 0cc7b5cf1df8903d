"""Blocks that impacts of another spawn: fragments and entrained blocks."""

from __future__ import annotations

import numpy as np

from sassgis.engine.state import SPAWNED_DTYPE, Block, Spawned
from sassgis.model.jit import lean


def room_for(most: int) -> Spawned:
    """Room for so many spawned blocks of one released block."""
    return Spawned(np.zeros(most, SPAWNED_DTYPE), np.zeros(1, np.int64))


@lean
def spawn(
    spawned: Spawned,
    x: float,
    z: float,
    vx: float,
    vz: float,
    theta: float,
    omega: float,
    parent: Block,
    size: float,
    mass: float,
    t: float,
) -> None:
    """Add a block ``size`` times as long as its parent, at a time since the release (s).

    One without room is counted only.
    """
    i = spawned.filled[0]
    spawned.filled[0] = i + 1
    if i < spawned.rows.shape[0]:
        row = spawned.rows[i]
        row.x = x
        row.z = z
        row.vx = vx
        row.vz = vz
        row.theta = theta
        row.omega = omega
        row.a = size * parent.a
        row.b = size * parent.b
        row.c = size * parent.c
        row.mass = mass
        row.t = t
