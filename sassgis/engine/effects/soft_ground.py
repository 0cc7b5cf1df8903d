"""Impacts on ground that yields."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.effects.ground_switch import classes_on, nowhere
from sassgis.model.effects import SoftGround
from sassgis.model.ground import GroundTable
from sassgis.model.jit import kernel

OFF, VELOCITY_SCALED, SCAR, SLIP = 0, 1, 2, 3


class Soft(NamedTuple):
    """model.effects.SoftGround as the kernel reads it."""

    form: int
    reference: float  # m/s
    modulus: float  # MPa
    depth: float
    drag: float
    density: float
    friction: float
    on: NDArray[np.bool_]  # by ground class


def prepare(settings: SoftGround | None, table: GroundTable) -> Soft:
    """From settings to what the kernel reads."""
    if settings is None:
        return Soft(OFF, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, nowhere(table))
    return Soft(
        {"velocity_scaled": VELOCITY_SCALED, "scar": SCAR, "slip": SLIP}[settings.form],
        float(settings.reference_speed_mps),
        float(settings.modulus_mpa),
        float(settings.depth_factor),
        float(settings.drag_coefficient),
        float(settings.soil_density_kgm3),
        float(settings.friction),
        classes_on(settings.classes, table, "soft_ground"),
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
