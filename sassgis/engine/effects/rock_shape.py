"""The third axis of a block."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sassgis.model import rng
from sassgis.model.effects import RockShape
from sassgis.model.jit import kernel

OFF, FLAT_LANDING, MEAN_INERTIA = 0, 1, 2


class Shape(NamedTuple):
    """model.effects.RockShape as the kernel reads it."""

    form: int
    strength: float


def prepare(settings: RockShape | None) -> Shape:
    """From settings to what the kernel reads."""
    if settings is None:
        return Shape(OFF, 0.0)
    forms = {"flat_landing": FLAT_LANDING, "mean_inertia": MEAN_INERTIA}
    return Shape(forms[settings.form], float(settings.strength))


@kernel
def tumbling_inertia(a: float, b: float, c: float) -> float:
    """Mean of the three moments of inertia per unit mass (m²)."""
    return 2.0 / 15.0 * (a * a + b * b + c * c)


@kernel
def lands_flat(shape: Shape, key: np.uint64, number: int, b: float, c: float) -> bool:
    """Whether an impact falls on the flat side of the block."""
    if shape.form != FLAT_LANDING:
        return False
    return bool(rng.uniform(key, rng.LANDING, number) < shape.strength * (1.0 - c / b))
