"""A steady wind on blocks in flight."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from sassgis.compiled.jit import lean
from sassgis.engine.effects.forms import Numbers, kernel_form
from sassgis.engine.ellipse import Record
from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import checked


@checked(frozen=True, slots=True)
class Wind(EffectSection):
    """A steady wind: a horizontal acceleration of blocks in flight, none on the ground.

    The same for blocks of every size and speed, which is a modelling assumption: the drag of a
    wind of speed u is ½ ρ C_d A u²/m for a block that moves much slower than the air.
    """

    name: ClassVar[str] = "wind"

    acceleration_mps2: Annotated[
        float,
        Interval(ge=-5.0, le=5.0),
        "horizontal acceleration in flight, positive along the chainage, so down the fall line. "
        "A wind of 20 m/s gives a sphere of 0.001 m³ about 0.4, one of 1 m³ about 0.04 (m/s2)",
    ] = 0.4


#: Longest flight between two pushes of the wind (s); each push is one change of speed.
WIND_STEP_S = 0.05

#: What a block remembers of the wind.
MEMORY = (
    ("push_before", np.float64),  # share of the push that comes before the step; 0 in a first one
)


WindNumbers, prepare = kernel_form(
    Wind, lambda own: own.acceleration_mps2 == 0.0, lambda: {"step_s": WIND_STEP_S}
)


@lean
def longest_step(push: Numbers, state: Record) -> float:
    """Return the longest step of a flight (s).

    The first is half as long and begins without a push: a block that has just left the ground is
    not pushed back into it. Steps then are of second order in their length.
    """
    return float((0.5 + state.push_before) * push.step_s)


@lean
def push_before(push: Numbers, state: Record, limit: float) -> None:
    """Push a block before a step of flight of ``limit`` (s)."""
    state.vx += state.about * push.acceleration_mps2 * state.push_before * limit


@lean
def push_after(push: Numbers, state: Record, limit: float, until: float, goes_on: bool) -> None:
    """Push it after the step, which has taken ``until`` (s): the speed gained is exact."""
    state.vx += state.about * push.acceleration_mps2 * (until - state.push_before * limit)
    state.push_before = 0.5 if goes_on else 0.0
