"""Ground rougher than its segments."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Interval

from sassgis.compiled import rng
from sassgis.compiled.jit import lean
from sassgis.engine.effects.forms import Numbers, kernel_form
from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import Several, Text, checked


@checked(frozen=True, slots=True)
class Roughness(EffectSection):
    """Ground rougher than its segments: each impact meets a surface that is tilted at random.

    "uniform" after Pfeiffer and Bowen (1989); "wave" after the amplitude and frequency of Spang's
    ROCKFALL.
    """

    name: ClassVar[str] = "roughness"

    form: Annotated[
        Literal["uniform", "wave"],
        '"uniform": the tilt is uniform within atan(obstacle height / radius of the block) to both '
        'sides. "wave": the surface is a wave of amplitude half the obstacle height and length '
        "wavelength_m that is met at a random phase; a block bridges waves shorter than its "
        "diameter",
    ] = "uniform"
    obstacle_m: Annotated[float, Interval(ge=0.0, le=10.0), "height of obstacles (m)"] = 0.1
    wavelength_m: Annotated[
        float, Interval(ge=0.01, le=100.0), 'length of the wave of "wave" (m)'
    ] = 2.0
    classes: Annotated[Several[Text], "ground classes that are rough; empty: all"] = ()


UNIFORM, WAVE = 1, 2

RoughnessNumbers, prepare = kernel_form(Roughness, lambda own: own.obstacle_m == 0.0)


@lean
def tilt(rough: Numbers, key: np.uint64, number: int, radius: float) -> float:
    """Return angle by which the surface that an impact meets is turned (rad), positive uphill."""
    u = rng.uniform(key, rng.TILT, number)
    if rough.form == UNIFORM:
        return (2.0 * u - 1.0) * math.atan(rough.obstacle_m / radius)
    # A block wider than the wave touches only its crests.
    bridged = min(rough.wavelength_m / (2.0 * radius), 1.0)
    steepest = math.pi * rough.obstacle_m / rough.wavelength_m
    return math.atan(bridged * steepest * math.cos(2.0 * math.pi * u))


@lean
def tilted(
    rough: Numbers, key: np.uint64, number: int, radius: float, vx: float, vz: float, nx: float,
    nz: float,
) -> tuple[float, float]:  # fmt: skip
    """Tilt the ground's normal to that of the surface met by an impact with velocity (vx, vz).

    Not where the tilted surface would be overturned or face away.
    """
    turn = tilt(rough, key, number, radius)
    # A positive tilt faces the block, from whichever side it comes.
    turn = turn if vx >= 0.0 else -turn
    cosine = math.cos(turn)
    sine = math.sin(turn)
    rx = cosine * nx - sine * nz
    rz = cosine * nz + sine * nx
    if vx * rx + vz * rz < 0.0 and rz > 0.0:
        return rx, rz
    return nx, nz
