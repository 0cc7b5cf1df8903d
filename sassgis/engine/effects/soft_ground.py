"""Impacts on ground that yields."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

from annotated_types import Interval

from sassgis.model.effects import EffectSection
from sassgis.model.jit import kernel


@dataclass(frozen=True, slots=True)
class SoftGround(EffectSection):
    """Impacts on ground that yields.

    Velocity scaling after Pfeiffer and Bowen (1989), with v_ref = 9.144 m/s; the depth of the scar
    after Lu et al. (2019, Landslides 16).
    """

    name: ClassVar[str] = "soft_ground"

    form: Annotated[
        Literal["velocity_scaled", "scar", "slip"],
        '"velocity_scaled": the normal rebound is multiplied with 1 / (1 + (v_n / v_ref)²). '
        '"scar": a scar of depth d = depth_factor · m^¼ M_E^−0.4 v_n^0.8 and a drag ½ C ρ A v² '
        'along it, A the section of the block below the surface; "slip": the contact slips with '
        "the friction where the impulse would need more",
    ] = "velocity_scaled"
    classes: Annotated[tuple[str, ...], "ground classes that are soft; empty: all"] = (
        "soft_meadow",
        "forest_soil",
    )
    reference_speed_mps: Annotated[
        float, Interval(ge=0.1, le=1e6), 'v_ref of "velocity_scaled" (m/s)'
    ] = 9.144
    modulus_mpa: Annotated[float, Interval(ge=0.1, le=1e4), 'M_E of "scar" (MPa)'] = 10.0
    depth_factor: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        'of "scar": depth in m for m in kg, M_E in MPa and v_n in m/s',
    ] = 0.02
    drag_coefficient: Annotated[float, Interval(ge=0.0, le=100.0), 'C of "scar"'] = 1.0
    soil_density_kgm3: Annotated[float, Interval(ge=100.0, le=4000.0), 'ρ of "scar" (kg/m3)'] = (
        1800.0
    )
    friction: Annotated[float, Interval(ge=0.0, le=100.0), 'friction of "slip"'] = 0.5


OFF, VELOCITY_SCALED, SCAR, SLIP = 0, 1, 2, 3


class Soft(NamedTuple):
    """SoftGround as the kernel reads it."""

    form: int
    reference: float  # m/s
    modulus: float  # MPa
    depth: float
    drag: float
    density: float
    friction: float


def prepare(settings: SoftGround | None) -> Soft:
    """From settings to what the kernel reads."""
    if settings is None:
        return Soft(OFF, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    return Soft(
        {"velocity_scaled": VELOCITY_SCALED, "scar": SCAR, "slip": SLIP}[settings.form],
        float(settings.reference_speed_mps),
        float(settings.modulus_mpa),
        float(settings.depth_factor),
        float(settings.drag_coefficient),
        float(settings.soil_density_kgm3),
        float(settings.friction),
    )


@kernel
def rebound_left(soft: Soft, normal_speed: float) -> float:
    """Share of the normal rebound that is left (Pfeiffer and Bowen 1989)."""
    ratio = normal_speed / soft.reference
    return 1.0 / (1.0 + ratio * ratio)


@kernel
def scar_depth(soft: Soft, mass: float, normal_speed: float) -> float:
    """Depth of the scar (m), after Lu et al. (2019): m^¼ M_E^−0.4 v_n^0.8."""
    return float(soft.depth * mass**0.25 * soft.modulus**-0.4 * max(normal_speed, 0.0) ** 0.8)


@kernel
def scar_energy_left(soft: Soft, mass: float, radius: float, normal_speed: float) -> float:
    """Share of the energy that is left after the drag along the scar.

    ½ C ρ A v² over the length of the scar, relative to ½ m v²; A is the segment of a circle of the
    block's radius below the surface and the length its chord.
    """
    depth = min(scar_depth(soft, mass, normal_speed), radius)
    cosine = 1.0 - depth / radius
    half = math.acos(cosine)
    section = radius * radius * (half - cosine * math.sin(half))
    chord = 2.0 * radius * math.sin(half)
    # Over the length the speed falls exponentially.
    return math.exp(-soft.drag * soft.density * section * chord / mass)


@kernel
def after_impact(
    soft: Soft, mass: float, radius: float, into: float, wt: float, wn: float, omega: float
) -> tuple[float, float, float]:
    """Velocity and spin after an impact with normal speed ``into`` (m/s), from those without."""
    if soft.form == VELOCITY_SCALED and wn > 0.0:
        wn *= rebound_left(soft, into)
    elif soft.form == SCAR:
        kept = math.sqrt(scar_energy_left(soft, mass, radius, into))
        wt *= kept
        wn *= kept
        omega *= kept
    return wt, wn, omega
