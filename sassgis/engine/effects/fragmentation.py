"""Breaking of blocks at impacts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sassgis.engine.effects.spawning import Spawned, spawn
from sassgis.engine.state import Block, Record
from sassgis.model import rng
from sassgis.model.effects import Fragmentation
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel

OFF, FRACTAL, THRESHOLD = 0, 1, 2


class Breaking(NamedTuple):
    """model.effects.Fragmentation as the kernel reads it."""

    form: int
    energy: float  # J/kg
    shape: float
    survival: float
    pieces: int
    loss: float
    cone: float  # rad
    smallest: float  # m³


def prepare(settings: Fragmentation | None) -> Breaking:
    """From settings to what the kernel reads."""
    if settings is None:
        return Breaking(OFF, 0.0, 1.0, 0.5, 2, 0.0, 0.0, 0.0)
    return Breaking(
        {"fractal": FRACTAL, "threshold": THRESHOLD}[settings.form],
        float(settings.energy_jkg),
        float(settings.shape),
        float(settings.survival),
        int(settings.pieces),
        float(settings.loss),
        math.radians(settings.cone_deg),
        float(settings.smallest_m3),
    )


@kernel
def breaks(breaking: Breaking, key: np.uint64, number: int, lost: float) -> bool:
    """Whether an impact that takes ``lost`` (J/kg) breaks the block."""
    if breaking.form == THRESHOLD:
        return lost > breaking.energy
    if breaking.energy <= 0.0:
        return lost > 0.0
    chance = -math.expm1(-((max(lost, 0.0) / breaking.energy) ** breaking.shape))
    return bool(rng.uniform(key, rng.BREAKS, number) < chance)


@kernel
def shares(breaking: Breaking, volume: float, out: FloatArray) -> int:
    """Shares of the volume of the fragments, largest first; they add up to 1.

    Parameters
    ----------
    volume : float
        Of the whole (m³).
    out : float64, shape (at least ``pieces``,)
        Filled.

    Returns
    -------
    int
        Fragments: as many as can be without one below the smallest; below 2 the block stays whole.
    """
    n = breaking.pieces
    while n >= 2:
        if breaking.form == THRESHOLD:
            least = 1.0 / n
        else:
            rest = (1.0 - breaking.survival) ** (n - 1)
            least = min(rest, breaking.survival * (1.0 - breaking.survival) ** (n - 2))
        if least * volume >= breaking.smallest:
            break
        n -= 1
    if n < 2:
        return 0
    left = 1.0
    for i in range(n - 1):
        out[i] = 1.0 / n if breaking.form == THRESHOLD else left * breaking.survival
        left -= out[i]
    out[n - 1] = left
    return n


@kernel
def sideways_speeds(
    breaking: Breaking, key: np.uint64, number: int, n: int, share: FloatArray, out: FloatArray
) -> float:
    """Sideways speeds of the fragments over their common speed ahead.

    No sideways momentum is made: the mean over the masses is taken off.

    Parameters
    ----------
    share, out : float64, shape (at least n,)

    Returns
    -------
    float
        Common speed ahead over the speed of the whole: with the sideways motion and the loss the
        fragments together have 1 − loss of its energy.
    """
    mean = 0.0
    for i in range(n):
        angle = (2.0 * rng.uniform(key, rng.FRAGMENT_ANGLE, 64 * number + i) - 1.0) * breaking.cone
        out[i] = math.tan(angle)
        mean += share[i] * out[i]
    sideways = 0.0
    for i in range(n):
        out[i] -= mean
        sideways += share[i] * out[i] * out[i]
    return math.sqrt((1.0 - breaking.loss) / (1.0 + sideways))


@kernel
def break_up(
    breaking: Breaking, spawned: Spawned, block: Block, number: int, state: Record
) -> bool:
    """Break a block in flight into fragments; False if it is too small to break."""
    volume = 4.0 / 3.0 * math.pi * block.a * block.b * block.c
    share = np.empty(breaking.pieces)
    n = shares(breaking, volume, share)
    if n < 2:
        return False
    side = np.empty(n)
    ahead = sideways_speeds(breaking, block.key, number, n, share, side)
    spin = math.sqrt(1.0 - breaking.loss) * state.omega
    vx = state.vx
    vz = state.vz
    for i in range(n):
        size = share[i] ** (1.0 / 3.0)
        spawn(
            spawned, state.x, state.z, ahead * (vx - side[i] * vz), ahead * (vz + side[i] * vx),
            state.theta, spin, block, size, share[i] * block.mass,
        )  # fmt: skip
    return True
