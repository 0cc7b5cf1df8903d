"""Lateral deflection: turns of the heading beyond those that the motion gives."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Interval

from sassgis.compiled import rng
from sassgis.compiled.jit import lean
from sassgis.engine.effects.forms import Numbers, kernel_form
from sassgis.engine.ellipse import Record
from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import checked


@checked(frozen=True, slots=True)
class LateralDeflection(EffectSection):
    """Further turns of followed paths.

    By stems, bumps and the shape of blocks, say: these turns are drawn and no outcome of the
    motion. Tests report 5 to 20 degrees per impact, and widths of 10 to 20 per cent (Azzoni et al.
    1995, Crosta and Agliardi 2004).
    """

    name: ClassVar[str] = "lateral_deflection"

    form: Annotated[
        Literal["kicks", "constant"],
        '"kicks": after each hop the heading turns by an angle, normal with the standard deviation '
        'angle_deg. "constant": each block drifts off the descent by one angle; on a plane '
        "paths then lie evenly within width_percent of the length, both sides together",
    ] = "kicks"
    angle_deg: Annotated[
        float, Interval(ge=0.0, le=60.0), 'of "kicks": standard deviation of the angle (degrees)'
    ] = 10.0
    hop_m: Annotated[
        float, Interval(ge=0.5, le=1000.0), "mean length of the hops in plan, exponential (m)"
    ] = 10.0
    width_percent: Annotated[
        float, Interval(ge=0.0, le=100.0), 'of "constant": width in percent of the length'
    ] = 15.0


KICKS, CONSTANT = 1, 2

#: What a block remembers of its hops.
MEMORY = (
    ("hops", np.int64),  # that are over
    ("hop_end", np.float64),  # chainage at which the present one ends (m)
)


LateralDeflectionNumbers, prepare = kernel_form(
    LateralDeflection,
    lambda own: not (own.angle_deg if own.form == "kicks" else own.width_percent) > 0.0,
)


@lean
def on_path(deflection: Numbers, state: Record, key: np.uint64) -> None:
    """Begin the first hop of a path, or set the drift of the block for the whole path."""
    if deflection.form == KICKS:
        state.hops = 0
        state.hop_end = state.x - deflection.hop_m * math.log(rng.uniform(key, rng.HOP, 0))
    else:
        width = deflection.width_percent / 100.0
        state.drift += math.atan(width * (rng.uniform(key, rng.DEFLECTION, 0) - 0.5))


@lean
def before_turn(deflection: Numbers, state: Record, key: np.uint64) -> None:
    """Add the turns after all hops that are over: in flight no block turns."""
    angle = math.radians(deflection.angle_deg)
    while state.hop_end <= state.x:
        state.turn += angle * rng.normal(key, rng.KICK, state.hops)
        state.hops += 1
        state.hop_end -= deflection.hop_m * math.log(rng.uniform(key, rng.HOP, state.hops))
