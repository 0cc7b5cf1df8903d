"""Blocks on the roof of a gallery, in closed form from their passage of its uphill edge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sassgis.grid import FloatArray
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.results import ControlLine, Outcome
from sassgis.settings.statistics_table import built_in_rows

#: Density of a block (kg/m³) of which only the mass is known: 2000 or 3200 instead change a force
#: by 2 %.
_DENSITY = BlockPopulation().density_kgm3[0]


def roof_landing(
    above_m: FloatArray, vx_mps: FloatArray, vz_mps: FloatArray, slope: float, gravity: float
) -> tuple[FloatArray, FloatArray]:
    """Return where blocks land on a plane roof, and their speed into it (m/s).

    The distance from the uphill edge is in plan (m). Blocks fly on parabolas from ``above_m`` (m)
    above that edge; the roof falls by ``slope`` (tangent).
    """
    away = vz_mps + slope * vx_mps
    closing = np.sqrt(away * away + 2.0 * gravity * above_m)
    return vx_mps * (away + closing) / gravity, closing / math.hypot(1.0, slope)


def mark_roofs(passages: NDArray[np.void], lines: Sequence[ControlLine], gravity: float) -> None:
    """Mark passages over the top of galleries that end on their roofs, with the normal energy.

    ``passages`` (PASSAGE_DTYPE) are changed in place.
    """
    passages["roof_energy_kj"] = 0.0
    for number, line in enumerate(lines):
        if line.kind != "gallery":
            continue
        over = np.flatnonzero(
            (passages["control_line"] == number) & (passages["outcome"] == Outcome.OVERTOPPED)
        )
        own = passages[over]
        slope = math.tan(math.radians(line.roof_slope_deg))
        # A block whose lowest point passes above the edge may have its centre lower than at rest
        # there.
        above = np.maximum(own["height_m"] - line.height_m, 0.0)
        distance, speed = roof_landing(above, own["vx_mps"], own["vz_mps"], slope, gravity)
        lands = distance <= line.width_m
        passages["outcome"][over[lands]] = Outcome.ON_ROOF
        energy = 0.5e-3 * own["mass_kg"] * speed**2
        passages["roof_energy_kj"][over[lands]] = energy[lands]


@cache
def _constants() -> tuple[float, ...]:
    """Read factor and exponents of modulus, radius and energy: sassgis/data/roof_force.csv."""
    row: dict[str, Any] = next(built_in_rows("roof_force"))
    keys = ("factor", "modulus_exponent", "radius_exponent", "energy_exponent")
    return tuple(float(row[key]) for key in keys)


def roof_force_kn(energy_kj: ArrayLike, mass_kg: ArrayLike, cushion_kpa: ArrayLike) -> FloatArray:
    """Return static equivalent forces of blocks on a roof with a cushion (kN).

    Labiouse, Descoeudres and Montani (1996), not checked against the text:
    F = 1.765 M_E^0.4 R^0.2 E^0.6. The energy is that of the motion into the roof, R the radius of
    the sphere of a block's mass.
    """
    factor, of_modulus, of_radius, of_energy = _constants()
    radius = np.cbrt(0.75 / np.pi * np.asarray(mass_kg, float) / _DENSITY)
    modulus, energy = np.asarray(cushion_kpa, float), np.asarray(energy_kj, float)
    force: FloatArray = factor * modulus**of_modulus * radius**of_radius * energy**of_energy
    return force
