"""Blocks that impacts of another spawn: fragments and entrained blocks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.state import SPAWNED_DTYPE, Block, Records
from sassgis.model.jit import kernel


class Spawned(NamedTuple):
    """Blocks that one released block and those that it has spawned have spawned so far."""

    rows: Records  # SPAWNED_DTYPE
    filled: NDArray[np.int64]  # (1,), beyond the rows if there were too few


def room_for(most: int) -> Spawned:
    """Room for so many spawned blocks of one released block."""
    return Spawned(np.zeros(most, SPAWNED_DTYPE), np.zeros(1, np.int64))


@kernel
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
) -> None:
    """Add a block ``size`` times as long as its parent; one without room is counted only."""
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
