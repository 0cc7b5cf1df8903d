"""Blocks of the ground that an impact sets in motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from sassgis.model import rng
from sassgis.model.effects import EffectSection
from sassgis.model.jit import kernel


@dataclass(frozen=True, slots=True)
class Entrainment(EffectSection):
    """Blocks of the ground that an impact sets in motion; these entrain no others."""

    name: ClassVar[str] = "entrainment"

    form: Annotated[
        Literal["poisson", "energy"],
        '"poisson": each impact sets in motion a Poisson number of blocks with the mean number. '
        '"energy": the mean is number times the energy lost over energy_kj',
    ] = "poisson"
    number: Annotated[float, Interval(ge=0.0, le=10.0), "blocks per impact"] = 0.05
    energy_kj: Annotated[
        float, Interval(ge=1e-3, le=1e6), 'energy of "energy" that sets number in motion (kJ)'
    ] = 10.0
    size_ratio: Annotated[
        float,
        Interval(ge=0.01, le=1.0),
        "axes of an entrained block over those of the block that hit",
    ] = 0.4
    share: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "of the energy that the impact took: what each of them gets, all together at most 1",
    ] = 0.1
    classes: Annotated[tuple[str, ...], "ground classes with loose blocks; empty: all"] = (
        "debris",
        "talus",
    )


OFF, POISSON, ENERGY = 0, 1, 2
_MOST = 20
_STEEPEST = 0.25 * math.pi


class SetOff(NamedTuple):
    """Entrainment as the kernel reads it."""

    form: int
    number: float
    energy: float  # J
    ratio: float
    share: float
    on: NDArray[np.bool_]  # by ground class


@kernel
def blocks_set_off(set_off: SetOff, key: np.uint64, number: int, lost: float) -> int:
    """How many blocks an impact that takes ``lost`` (J) sets in motion: Poisson, at most 20."""
    mean = set_off.number
    if set_off.form == ENERGY:
        mean *= lost / set_off.energy
    limit = math.exp(-min(mean, 50.0))
    n = 0
    product = rng.uniform(key, rng.SET_OFF, 64 * number)
    while product > limit and n < _MOST:
        n += 1
        product *= rng.uniform(key, rng.SET_OFF, 64 * number + n)
    return n


@kernel
def speed_of_each(set_off: SetOff, n: int, lost: float, mass: float) -> float:
    """Speed of each of n blocks of a mass (kg), all together with no more than ``lost`` (J)."""
    own = min(set_off.share, 1.0 / n) * lost
    return math.sqrt(2.0 * max(own, 0.0) / mass)


@kernel
def angle_of(key: np.uint64, number: int, i: int) -> float:
    """Angle above the ground at which block i leaves (rad), up to 45 degrees."""
    return _STEEPEST * rng.uniform(key, rng.SET_OFF_WAY, 64 * number + i)
