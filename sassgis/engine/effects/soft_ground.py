"""Impacts on ground that yields."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from annotated_types import Interval

from sassgis.compiled.jit import lean
from sassgis.engine.effects.forms import Numbers, kernel_form
from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import Several, Text, checked


@checked(frozen=True, slots=True)
class SoftGround(EffectSection):
    """Impacts on ground that yields.

    Velocity scaling after Pfeiffer and Bowen (1989), with v_ref = 9.144 m/s; the depth of the scar
    after Lu et al. (2019, Landslides 16) or ASTRA 12006 (2008, after Labiouse), not verified.
    """

    name: ClassVar[str] = "soft_ground"

    form: Annotated[
        Literal["velocity_scaled", "scar", "slip"],
        '"velocity_scaled": the normal rebound is multiplied with 1 / (1 + (v_n / v_ref)²). '
        '"scar": a drag ½ C ρ A v² along a scar, A the section of the block below the surface. '
        '"slip": the contact slips with the friction where the impulse would need more',
    ] = "velocity_scaled"
    classes: Annotated[Several[Text], "ground classes that are soft; empty: all"] = (
        "soft_meadow",
        "overgrown_slope",
        "forest_soil",
    )
    reference_speed_mps: Annotated[
        float, Interval(ge=0.1, le=1e6), 'v_ref of "velocity_scaled" (m/s)'
    ] = 9.144
    modulus_mpa: Annotated[float, Interval(ge=0.1, le=1e4), 'M_E of "scar" (MPa)'] = 10.0
    depth_law: Annotated[
        Literal["lu", "astra"],
        'depth of "scar" (m; m in kg, M_E in kPa, v_n in m/s, R in m). "lu": '
        '0.16 m^¼ M_E^−0.4 v_n^0.8. "astra": m v_n²/F with F = 1.765 M_E^0.4 R^0.2 E^0.6 (kN), '
        "E = m v_n²/2 in kJ",
    ] = "lu"
    depth_scale: Annotated[
        float, Interval(ge=0.0, le=100.0), 'of "scar": factor on the depth of the law'
    ] = 1.0
    drag_coefficient: Annotated[float, Interval(ge=0.0, le=100.0), 'C of "scar"'] = 1.0
    soil_density_kgm3: Annotated[float, Interval(ge=100.0, le=4000.0), 'ρ of "scar" (kg/m3)'] = (
        1800.0
    )
    friction: Annotated[float, Interval(ge=0.0, le=100.0), 'friction of "slip"'] = 0.5


VELOCITY_SCALED, SCAR, SLIP = 1, 2, 3
LU = 0  # of depth_law
_KPA_PER_MPA = 1e3
_J_PER_KJ = 1e3

SoftGroundNumbers, prepare = kernel_form(SoftGround)


@lean
def rebound_left(soft: Numbers, normal_speed: float) -> float:
    """Return the share of the normal rebound that remains (Pfeiffer and Bowen 1989)."""
    ratio = normal_speed / soft.reference_speed_mps
    return float(1.0 / (1.0 + ratio * ratio))


@lean
def scar_depth(soft: Numbers, mass: float, radius: float, normal_speed: float) -> float:
    """Return the depth of the scar (m) at a normal speed (m/s).

    After Lu et al. (2019) as another program has it, 0.16 m^¼ M_E^−0.4 v_n^0.8; or m v_n²/F with
    the force of ASTRA 12006 (2008, after Labiouse). Neither was read in its source.
    """
    speed = max(normal_speed, 0.0)
    modulus = _KPA_PER_MPA * soft.modulus_mpa
    if soft.depth_law == LU:
        return float(soft.depth_scale * 0.16 * mass**0.25 * modulus**-0.4 * speed**0.8)
    twice = mass * speed * speed / _J_PER_KJ
    # m v²/F with E^0.6 = (m v²/2)^0.6 in F.
    return float(soft.depth_scale * twice**0.4 * 2.0**0.6 / (1.765 * modulus**0.4 * radius**0.2))


@lean
def scar_energy_left(soft: Numbers, mass: float, radius: float, normal_speed: float) -> float:
    """Return the share of the energy that remains after the drag along the scar.

    ½ C ρ A v² over the length of the scar, relative to ½ m v²; A is the segment of a circle of the
    block's radius below the surface and the length its chord.
    """
    depth = min(scar_depth(soft, mass, radius, normal_speed), radius)
    cosine = 1.0 - depth / radius
    half = math.acos(cosine)
    section = radius * radius * (half - cosine * math.sin(half))
    chord = 2.0 * radius * math.sin(half)
    # Over the length the speed falls exponentially.
    return math.exp(-soft.drag_coefficient * soft.soil_density_kgm3 * section * chord / mass)


@lean
def after_impact(
    soft: Numbers, mass: float, radius: float, into: float, wt: float, wn: float, omega: float
) -> tuple[float, float, float]:
    """Compute velocity and spin after an impact at normal speed ``into`` (m/s) from the others."""
    if soft.form == VELOCITY_SCALED and wn > 0.0:
        wn *= rebound_left(soft, into)
    elif soft.form == SCAR:
        kept = math.sqrt(scar_energy_left(soft, mass, radius, into))
        wt *= kept
        wn *= kept
        omega *= kept
    return wt, wn, omega
