"""Drag of the air in flight."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from annotated_types import Interval

from sassgis.compiled.jit import lean
from sassgis.engine.effects.forms import OFF, Numbers, kernel_form
from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import checked


@checked(frozen=True, slots=True)
class AirDrag(EffectSection):
    """Drag of the air in flight: ½ ρ C_d A v² against the motion.

    0.4 to 0.5 is C_d of a sphere, about 1 that of a tumbling block. The law of the sphericity is
    that of Ganser (1993, Powder Technology 77) for fast flow; not checked against the source.
    """

    name: ClassVar[str] = "air_drag"

    form: Annotated[
        Literal["constant", "sphericity"],
        '"constant": C_d is drag_coefficient. "sphericity": C_d grows with the departure from '
        "a sphere, 0.43 · 10^(1.8148 (−log ψ)^0.5743), times drag_coefficient over 0.43",
    ] = "constant"
    drag_coefficient: Annotated[
        float,
        Interval(ge=0.0, le=300.0),
        "C_d: 0.4 to 0.5 for a sphere, about 1 for a tumbling block. Values far "
        "above 2 are not those of air: a fit may give them where something else brakes the rocks",
    ] = 0.43
    air_density_kgm3: Annotated[
        float, Interval(ge=0.0, le=2.0), "1.2 at 300 m, 1.0 at 2,000 m above the sea (kg/m3)"
    ] = 1.1


CONSTANT, SPHERICITY = 1, 2
#: Longest flight between two steps of drag (s): halving it changes no result noticeably.
DRAG_STEP_S = 0.05

AirDragNumbers, prepare = kernel_form(
    AirDrag,
    lambda own: own.drag_coefficient == 0.0 or own.air_density_kgm3 == 0.0,
    lambda: {"step_s": DRAG_STEP_S},
)


@lean
def sphericity(a: float, b: float, c: float) -> float:
    """Divide the surface of the sphere of equal volume by the ellipsoid's (Thomsen's formula)."""
    p = 1.6075
    mean = ((a * b) ** p + (a * c) ** p + (b * c) ** p) / 3.0
    return float((a * b * c) ** (2.0 / 3.0) / mean ** (1.0 / p))


@lean
def resistance(drag: Numbers, a: float, b: float, c: float, mass: float) -> float:
    """Return K = ½ ρ C_d A / m of the deceleration K v² (1/m), A the block's mean section.

    The mean shadow of a convex body is a quarter of its surface (Cauchy).
    """
    if drag.form == OFF:
        return 0.0
    coefficient = drag.drag_coefficient
    round_ = sphericity(a, b, c)
    if drag.form == SPHERICITY:
        away = max(-math.log10(round_), 0.0)
        coefficient *= 10.0 ** (1.8148 * away**0.5743)
    section = math.pi * (a * b * c) ** (2.0 / 3.0) / round_
    return float(0.5 * drag.air_density_kgm3 * coefficient * section / mass)


@lean
def slowed(factor: float, vx: float, vz: float, time: float) -> tuple[float, float]:
    """Return the velocity after only drag has acted for a time: v / (1 + K v t), exact."""
    size = math.sqrt(vx * vx + vz * vz)
    over = 1.0 / (1.0 + factor * size * time)
    return vx * over, vz * over
