"""Blocks that impacts of another spawn: fragments and entrained blocks."""

from __future__ import annotations

from sassgis.compiled.jit import lean
from sassgis.engine.ellipse import CountedRows
from sassgis.engine.state import Block

#: Blocks that one released block may spawn.
MOST_SPAWNED = 5000


@lean
def spawn(
    spawned: CountedRows, x: float, z: float, vx: float, vz: float, theta: float, omega: float,
    parent: Block, size: float, mass: float, t: float, aside: float,
) -> None:  # fmt: skip
    """Add a block ``size`` times as long as its parent, at a time since the release (s).

    ``aside`` (rad) is the angle in plan, positive to the right, between its path and the parent's,
    for followed paths. A block without room is only counted.
    """
    i = spawned.n[0]
    spawned.n[0] = i + 1
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
        row.aside = aside
        row.about = 1.0
