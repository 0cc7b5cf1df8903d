"""Breaking of blocks at impacts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sassgis.model import rng
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel

OFF, FRACTAL, THRESHOLD = 0, 1, 2


class Breaking(NamedTuple):
    """core.effects.Fragmentation as the kernel reads it."""

    form: int
    energy: float  # J/kg
    shape: float
    survival: float
    pieces: int
    loss: float
    cone: float  # rad
    smallest: float  # m³


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
    """Shares of the volume of the pieces, largest first; they add up to 1.

    Parameters
    ----------
    volume : float
        Of the whole (m³).
    out : float64, shape (at least ``pieces``,)
        Filled.

    Returns
    -------
    int
        Pieces: as many as can be without one below the smallest; below 2 the block stays whole.
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
def ways(
    breaking: Breaking, key: np.uint64, number: int, n: int, share: FloatArray, out: FloatArray
) -> float:
    """Sideways speeds of the pieces over their common speed ahead.

    No sideways momentum is made: the mean over the masses is taken off.

    Parameters
    ----------
    share, out : float64, shape (at least n,)

    Returns
    -------
    float
        Common speed ahead over the speed of the whole: with the sideways motion and the loss the
        pieces together have 1 − loss of its energy.
    """
    mean = 0.0
    for i in range(n):
        angle = (2.0 * rng.uniform(key, rng.PIECE_WAY, 64 * number + i) - 1.0) * breaking.cone
        out[i] = math.tan(angle)
        mean += share[i] * out[i]
    sideways = 0.0
    for i in range(n):
        out[i] -= mean
        sideways += share[i] * out[i] * out[i]
    return math.sqrt((1.0 - breaking.loss) / (1.0 + sideways))
