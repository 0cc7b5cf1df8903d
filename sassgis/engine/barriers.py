"""What a rock does at stations and barriers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.state import Block, ControlLines, Profile
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel

# What became of it at a gate; the same numbers as core.results.Outcome.
PASSED, STOPPED, OVERTOPPED, BROKE_THROUGH, HELD_BY_NET = 0, 1, 2, 3, 4

# Kinds of gate: none of a barrier, one that stops for good, one that only takes the speed.
STATION, STOPS, LETS_GO = 0, 1, 2


@kernel
def _passage(
    passages: FloatArray,
    n_passages: int,
    control_lines: ControlLines,
    i: int,
    outcome: int,
    x: float,
    vx: float,
    vz: float,
    omega: float,
    height: float,
    inertia_: float,
    mass: float,
) -> int:
    """Write what a rock does at a gate; returns the new number of rows."""
    row = passages[n_passages]
    row[0] = control_lines.control_line[i]
    row[1] = outcome
    row[2] = x
    row[3] = math.sqrt(vx * vx + vz * vz)
    row[4] = vx
    row[5] = vz
    row[6] = abs(omega) / (2.0 * math.pi)
    row[7] = height
    row[8] = 0.5e-3 * mass * (vx * vx + vz * vz)
    row[9] = 0.5e-3 * mass * inertia_ * omega * omega
    row[10] = mass
    return n_passages + 1


@kernel
def _met(control_lines: ControlLines, i: int, energy: float) -> tuple[int, float]:
    """What a rock that meets barrier i does, and the share of its speed that is left."""
    if energy > control_lines.capacity[i]:
        return BROKE_THROUGH, math.sqrt(1.0 - control_lines.capacity[i] / energy)
    if control_lines.kind[i] == LETS_GO:
        return HELD_BY_NET, 0.0
    return STOPPED, 0.0


@kernel
def control_lines_in_flight(
    control_lines: ControlLines,
    seen: NDArray[np.bool_],
    passages: FloatArray,
    n_passages: int,
    profile: Profile,
    near: int,
    before: float,
    x: float,
    z: float,
    vx: float,
    vz: float,
    theta: float,
    omega: float,
    gravity: float,
    until: float,
    block: Block,
    inertia_: float,
) -> tuple[int, float, int, float, int]:
    """Stations and barriers that a flight comes to, from chainage ``before`` on.

    Returns
    -------
    n_passages : int
    t : float
        When the flight is ended by a barrier (s); infinite if it is not.
    outcome : int
    left : float
        Share of the speed that is left.
    gate : int
    """
    n = control_lines.x.size
    x_end = x + vx * until
    forward = vx > 0.0
    if vx == 0.0:
        return n_passages, np.inf, PASSED, 1.0, -1
    for k in range(n):
        i = k if forward else n - 1 - k
        gx = control_lines.x[i]
        if not (before < gx <= x_end if forward else x_end <= gx < before):
            continue
        t = max((gx - x) / vx, 0.0)
        wz = vz - gravity * t
        cz = z + (vz - 0.5 * gravity * t) * t
        outcome = PASSED
        left = 1.0
        if control_lines.kind[i] != STATION:
            angle = theta - omega * t
            down = math.sqrt((block.a * math.sin(angle)) ** 2 + (block.b * math.cos(angle)) ** 2)
            outcome = OVERTOPPED
            if (
                control_lines.height[i] > 0.0
                and cz - down < control_lines.z[i] + control_lines.height[i]
            ):
                energy = 0.5 * block.mass * (vx * vx + wz * wz + inertia_ * omega * omega)
                outcome, left = _met(control_lines, i, energy)
        if forward and not seen[i]:
            seen[i] = True
            j = near
            while j < profile.tx.size - 1 and profile.sx[j + 1] < gx:
                j += 1
            height = max(cz - control_lines.z[i] - block.b / profile.tx[j], 0.0)
            n_passages = _passage(
                passages,
                n_passages,
                control_lines,
                i,
                outcome,
                gx,
                vx,
                wz,
                omega,
                height,
                inertia_,
                block.mass,
            )
        if outcome not in (PASSED, OVERTOPPED):
            return n_passages, t, outcome, left, i
    return n_passages, np.inf, PASSED, 1.0, -1


@kernel
def control_lines_on_ground(
    control_lines: ControlLines,
    seen: NDArray[np.bool_],
    passages: FloatArray,
    n_passages: int,
    before: float,
    x: float,
    x_end: float,
    v2: float,
    dv2: float,
    spin2: float,
    dspin2: float,
    ux: float,
    uz: float,
    way: int,
    block: Block,
    inertia_: float,
) -> tuple[int, float, int, float, int]:
    """Stations and barriers that a rolling or sliding rock comes to, from chainage ``before`` on.

    ``v2`` and ``spin2`` are squares at the start, ``dv2`` and ``dspin2`` their changes up to
    ``x_end``. Returns (n_passages, share of the stretch done, outcome, left, gate).
    """
    n = control_lines.x.size
    forward = way > 0
    chord = abs(x_end - x)
    for k in range(n):
        i = k if forward else n - 1 - k
        gx = control_lines.x[i]
        if not (before < gx <= x_end if forward else x_end <= gx < before):
            continue
        share = 0.0
        if chord > 0.0:
            share = min(max((gx - x) / (x_end - x), 0.0), 1.0)
        speed2 = max(v2 + dv2 * share, 0.0)
        turn2 = max(spin2 + dspin2 * share, 0.0)
        outcome = PASSED
        left = 1.0
        if control_lines.kind[i] != STATION:
            outcome = OVERTOPPED
            if control_lines.height[i] > 0.0:
                outcome, left = _met(
                    control_lines, i, 0.5 * block.mass * (speed2 + inertia_ * turn2)
                )
        if forward and not seen[i]:
            seen[i] = True
            speed = math.sqrt(speed2)
            n_passages = _passage(
                passages, n_passages, control_lines, i, outcome, gx, speed * ux, speed * uz,
                math.sqrt(turn2), 0.0, inertia_, block.mass,
            )  # fmt: skip
        if outcome not in (PASSED, OVERTOPPED):
            return n_passages, share, outcome, left, i
    return n_passages, 1.0, PASSED, 1.0, -1
