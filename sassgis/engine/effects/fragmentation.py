"""Breaking of blocks at impacts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Interval

from sassgis.engine.effects.spawning import spawn
from sassgis.engine.state import Block, Record, Spawned
from sassgis.model import rng
from sassgis.model.effects import EffectSection
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel, lean


@dataclass(frozen=True, slots=True)
class Fragmentation(EffectSection):
    """Breaking of blocks at impacts.

    "fractal" after Perfect (1997) and Ruiz-Carulla et al. (2017); "threshold" as in many lumped
    models (Matas et al. 2017 have a threshold as well).
    """

    name: ClassVar[str] = "fragmentation"

    form: Annotated[
        Literal["fractal", "threshold"],
        '"fractal": a block breaks with the probability 1 − exp(−(e/e_ref)^shape), e the energy '
        "lost in the impact per unit mass; the largest fragment keeps survival of the volume, the "
        'next that share of the rest, and so on. "threshold": it breaks if e is above e_ref, into '
        "equal parts",
    ] = "fractal"
    energy_jkg: Annotated[float, Interval(ge=0.0, le=1e6), "e_ref (J/kg)"] = 300.0
    shape: Annotated[float, Interval(ge=0.1, le=20.0), 'exponent of "fractal" (Weibull)'] = 2.0
    survival: Annotated[
        float,
        Interval(ge=0.01, le=0.999),
        'of "fractal": share of the volume that the largest fragment keeps',
    ] = 0.5
    pieces: Annotated[int, Interval(ge=2, le=20), "most fragments of one break"] = 5
    loss: Annotated[
        float,
        Interval(ge=0.0, le=0.99),
        "share of the energy left after the impact that breaking takes",
    ] = 0.1
    cone_deg: Annotated[
        float,
        Interval(ge=0.0, le=89.0),
        "fragments leave within this angle of the direction of the whole (degrees), in the "
        "vertical plane",
    ] = 20.0
    smallest_m3: Annotated[
        float,
        Interval(ge=0.0, le=10.0),
        "no smaller fragment is made: fewer fragments, or the block stays whole (m3)",
    ] = 0.02


OFF, FRACTAL, THRESHOLD = 0, 1, 2


class Breaking(NamedTuple):
    """Fragmentation as the kernel reads it."""

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


@lean
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


@lean
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
            state.theta, spin, block, size, share[i] * block.mass, state.began + state.t,
        )  # fmt: skip
    return True
