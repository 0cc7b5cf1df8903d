"""Blocks on the roof of a gallery: where they land, how they leave it, and the force on it."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sassgis.compiled.jit import inlined, lean
from sassgis.engine.contact import resting_height
from sassgis.engine.ellipse import Record
from sassgis.engine.profile import segment_at
from sassgis.engine.state import (
    BARRIER,
    FLIGHT,
    ROLLING,
    SLIDING,
    Block,
    Output,
    Physics,
    Site,
    end,
    log_event,
)
from sassgis.grid import FloatArray
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.statistics_table import built_in_rows

#: Density of a block (kg/m³) of which only the mass is known: 2000 or 3200 instead change a force
#: by 2 %.
_DENSITY = BlockPopulation().density_kgm3[0]

# Friction of a block that rolls on the cushion (tangent): our choice, that of class debris.
_FRICTION = 0.45


class RoofLanding(NamedTuple):
    """Where a block lands on a roof, and its velocity there."""

    distance: float  # from the uphill edge, in plan (m)
    into: float  # speed into the roof (m/s)
    along: float  # speed down the roof (m/s)


@lean
def roof_landing(above: float, vx: float, vz: float, slope: float, gravity: float) -> RoofLanding:
    """Return where a block lands that flies from ``above`` (m) over the uphill edge of a roof.

    The roof is a plane that falls by ``slope`` (tangent); speeds in m/s.
    """
    away = vz + slope * vx
    closing = math.sqrt(away * away + 2.0 * gravity * above)
    steep = math.hypot(1.0, slope)
    fallen = vz - away - closing
    return RoofLanding(
        vx * (away + closing) / gravity, closing / steep, (vx - slope * fallen) / steep
    )


@lean
def move_over_roof(
    state: Record, block: Block, output: Output, physics: Physics, crossing: Record, above: float
) -> None:
    """Let a block that is ``above`` (m) the uphill edge of a roof land there, and roll.

    The cushion takes the speed into the roof. That along it becomes rolling with the angular
    momentum about the contact kept, and changes by slope and friction. The block ends on the roof,
    or leaves it at its lower edge. In between it meets no ground and reaches no cell.
    """
    g = physics.gravity
    slope = crossing.slope
    cosine = 1.0 / math.hypot(1.0, slope)
    landing = roof_landing(above, state.vx, state.vz, slope, g)
    share = _roll_share(block, physics)
    speed = (landing.along + (share - 1.0) * block.roll_radius * state.omega) / share
    length = (crossing.width - landing.distance) / cosine
    braked = 2.0 * g * cosine * _FRICTION * block.drag * length
    left2 = speed * speed + 2.0 * g * cosine * slope * length - braked
    if speed <= 0.0 or left2 <= 0.0:
        end(state, BARRIER)
        return
    leaves = math.sqrt(left2)
    duration = landing.distance / state.vx + 2.0 * length / (speed + leaves)
    state.phase = SLIDING if physics.point else ROLLING
    state.vx = speed * cosine
    state.vz = -slope * state.vx
    state.omega = 0.0 if physics.point else speed / block.roll_radius
    log_event(output.log, state, cosine, -slope * cosine)
    state.phase = FLIGHT
    state.roof_end = crossing.x + crossing.width
    state.roof_z = crossing.z + crossing.height - slope * crossing.width + block.b / cosine
    state.roof_vx = leaves * cosine
    state.roof_vz = -leaves * cosine * slope
    # On the way, in flight and rolling, it has its mean speed.
    state.vx = crossing.width / duration
    state.vz = -slope * state.vx
    if not physics.point:
        # Friction can turn the block no faster than its work allows.
        spin2 = min(left2, speed * speed + braked / (share - 1.0))
        state.omega = math.sqrt(spin2) / block.roll_radius


@inlined
def _roll_share(block: Block, physics: Physics) -> float:
    """Return the kinetic energy on a roof over that of the translation: points do not turn."""
    return 1.0 if physics.point else block.roll_share


@lean
def leave_roof(state: Record, block: Block, site: Site, output: Output, physics: Physics) -> None:
    """Let a block fly from the lower edge of a roof, and note its energy there.

    Where that lies in the ground, the block has risen to the ground, or ends.
    """
    profile = site.profile
    state.segment = segment_at(profile, state.x, state.segment)
    lies = resting_height(state.x, state.theta, block.a, block.b, profile, state.segment)
    state.z = max(state.roof_z, lies)
    state.roof_end = -np.inf
    twice = _roll_share(block, physics) * (state.roof_vx**2 + state.roof_vz**2)
    left2 = 1.0 - 2.0 * physics.gravity * (state.z - state.roof_z) / twice
    if left2 <= 0.0:
        end(state, BARRIER)
        return
    left = math.sqrt(left2)
    state.vx = left * state.roof_vx
    state.vz = left * state.roof_vz
    state.omega *= left
    for k in range(state.n_passages - 1, -1, -1):
        row = output.passages[k]
        if row.roof_energy_kj > 0.0:
            twice = state.vx**2 + state.vz**2 + block.inertia * state.omega**2
            row.roof_left_kj = 0.5e-3 * block.mass * twice
            break


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
