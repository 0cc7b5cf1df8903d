"""Blocks of the ground that an impact entrains."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Interval

from sassgis.compiled import rng
from sassgis.compiled.jit import lean
from sassgis.engine.effects.forms import Numbers, kernel_form
from sassgis.engine.effects.spawning import spawn
from sassgis.engine.ellipse import CountedRows, Record
from sassgis.engine.state import Block
from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import Several, Text, checked


@checked(frozen=True, slots=True)
class Entrainment(EffectSection):
    """Blocks of the ground that an impact sets in motion; these entrain no others."""

    name: ClassVar[str] = "entrainment"

    form: Annotated[
        Literal["poisson", "energy"],
        '"poisson": each impact entrains a Poisson number of blocks with the mean number. '
        '"energy": the mean is number times the energy lost over energy_kj',
    ] = "poisson"
    number: Annotated[float, Interval(ge=0.0, le=10.0), "blocks per impact"] = 0.05
    energy_kj: Annotated[
        float, Interval(ge=1e-3, le=1e6), 'energy of "energy" that entrains number (kJ)'
    ] = 10.0
    size_ratio: Annotated[
        float,
        Interval(ge=0.01, le=1.0),
        "axes of an entrained block over those of the block that hit",
    ] = 0.4
    share: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "share of the energy lost that each of them gets, all together at most 1",
    ] = 0.1
    classes: Annotated[Several[Text], "ground classes with loose blocks; empty: all"] = (
        "debris",
        "talus",
    )


POISSON, ENERGY = 1, 2
_MOST = 20
_STEEPEST = 0.25 * math.pi


EntrainmentNumbers, prepare = kernel_form(Entrainment, lambda own: own.number == 0.0)


@lean
def blocks_entrained(loose: Numbers, key: np.uint64, number: int, lost: float) -> int:
    """Draw how many blocks an impact that takes ``lost`` (J) entrains: Poisson, at most 20."""
    mean = loose.number
    if loose.form == ENERGY:
        mean *= lost / (1e3 * loose.energy_kj)
    limit = math.exp(-min(mean, 50.0))
    n = 0
    product = rng.uniform(key, rng.ENTRAINED, 64 * number)
    while product > limit and n < _MOST:
        n += 1
        product *= rng.uniform(key, rng.ENTRAINED, 64 * number + n)
    return n


@lean
def speed_of_each(loose: Numbers, n: int, lost: float, mass: float) -> float:
    """Return the speed of each of n blocks of a mass (kg), together with at most ``lost`` (J)."""
    own = min(loose.share, 1.0 / n) * lost
    return math.sqrt(2.0 * max(own, 0.0) / mass)


@lean
def angle_of(key: np.uint64, number: int, i: int) -> float:
    """Return the angle above the ground at which block i leaves (rad), up to 45 degrees."""
    return _STEEPEST * rng.uniform(key, rng.ENTRAINED_ANGLE, 64 * number + i)


@lean
def entrain(
    loose: Numbers, spawned: CountedRows, block: Block, number: int, lost: float, state: Record,
    ground: Record,
) -> None:  # fmt: skip
    """Set blocks of the ground in motion with part of the energy that an impact took (J).

    They leave the ground on which they lie flat, under the block that hit it: the height -inf
    represents that at which they rest.
    """
    n = blocks_entrained(loose, block.key, number, lost)
    if n == 0:
        return
    size = loose.size_ratio
    mass = block.mass * size**3
    speed = speed_of_each(loose, n, lost, mass)
    direction = 1 if state.vx >= 0.0 else -1
    lies = math.atan2(ground.tz, ground.tx)
    for i in range(n):
        angle = angle_of(block.key, number, i)
        along = direction * speed * math.cos(angle)
        up = speed * math.sin(angle)
        spawn(
            spawned, state.x, -np.inf, along * ground.tx - up * ground.tz,
            along * ground.tz + up * ground.tx, lies, 0.0, block, size, mass,
            state.began + state.t, 0.0,
        )  # fmt: skip
