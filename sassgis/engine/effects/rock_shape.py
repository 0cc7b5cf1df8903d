"""The third axis of a block."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Interval

from sassgis.compiled import rng
from sassgis.compiled.jit import lean
from sassgis.engine.effects.forms import Numbers, kernel_form
from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import checked


@checked(frozen=True, slots=True)
class RockShape(EffectSection):
    """The third axis, which the plane ellipse leaves out.

    "flat_landing" is our own law, fitted to nothing: Caviezel et al. (2021, Nature Communications
    12) found that shape rules run-out and lateral spread more than mass, and gave no such law.
    "mean_inertia" is as for spheres of equal inertia in lumped models (Jaboyedoff et al. 2005).
    """

    name: ClassVar[str] = "rock_shape"

    form: Annotated[
        Literal["flat_landing", "mean_inertia"],
        '"flat_landing": at each impact a block may fall on its flat side, the more likely the '
        "flatter it is (probability strength · (1 − c/b), ours); the contact then "
        "stops its spin. "
        '"mean_inertia": the block tumbles about all axes: its moment of inertia is the mean of '
        "the three",
    ] = "flat_landing"
    strength: Annotated[
        float, Interval(ge=0.0, le=10.0), 'factor on the probability of "flat_landing"'
    ] = 1.0


FLAT_LANDING, MEAN_INERTIA = 1, 2

RockShapeNumbers, prepare = kernel_form(RockShape)


@lean
def tumbling_inertia(a: float, b: float, c: float) -> float:
    """Return the mean of the three moments of inertia per unit mass (m²)."""
    return 2.0 / 15.0 * (a * a + b * b + c * c)


@lean
def lands_flat(shape: Numbers, key: np.uint64, number: int, b: float, c: float) -> bool:
    """Return whether an impact falls on the flat side of the block."""
    if shape.form != FLAT_LANDING:
        return False
    return bool(rng.uniform(key, rng.LANDING, number) < shape.strength * (1.0 - c / b))
