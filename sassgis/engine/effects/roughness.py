"""Ground rougher than its segments."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.model import rng
from sassgis.model.jit import kernel

OFF, UNIFORM, WAVE = 0, 1, 2


class Rough(NamedTuple):
    """core.effects.Roughness as the kernel reads it."""

    form: int
    obstacle: float  # m
    wavelength: float  # m
    on: NDArray[np.bool_]  # by ground class


@kernel
def tilt(rough: Rough, key: np.uint64, number: int, radius: float) -> float:
    """Angle by which the surface that an impact meets is turned (rad), positive uphill."""
    u = rng.uniform(key, rng.TILT, number)
    if rough.form == UNIFORM:
        return (2.0 * u - 1.0) * math.atan(rough.obstacle / radius)
    # A block that is wider than the wave touches only its crests.
    bridged = min(rough.wavelength / (2.0 * radius), 1.0)
    steepest = math.pi * rough.obstacle / rough.wavelength
    return math.atan(bridged * steepest * math.cos(2.0 * math.pi * u))
