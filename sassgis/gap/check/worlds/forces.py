"""What nature may do beyond the base law: parameters of every effect and its small kernels.

An effect with ``q == 0`` is off, and the path of a rock is then the same to the last bit. ``s0``
and ``s1`` limit it to a stretch of the slope (m down the slope). The functional forms are chosen
to differ from those that a diagnosis would try.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sassgis.gap.check.worlds import random_draws as draws
from sassgis.gap.check.worlds.contact_laws import GRAVITY
from sassgis.gap.check.worlds.motion_state import SPIN, A, B, C, mass_of
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel

FAR = 1e9
_AIR = 1.2
_VISCOSITY = 1.8e-5


class Local(NamedTuple):
    """An effect of strength q between s0 and s1."""

    q: float = 0.0
    s0: float = -FAR
    s1: float = FAR


class SteadyWind(NamedTuple):
    """A steady push towards (x, y) in plan; on a rock of radius R it is q · 0.3 m/R (m/s²)."""

    q: float = 0.0
    x: float = 0.0
    y: float = 0.0


class Forces(NamedTuple):
    """All effects of a site that act on moving rocks."""

    lateral_deflection: Local = Local()  # Laplace scale of the facets' cross tilt (rad)
    fragmentation: Local = Local()  # Weibull hazard at the reference energy and size
    soft_ground: Local = Local()  # reference yield stress over that of the ground
    entrainment: Local = Local()  # hazard per unit of tangential impulse
    rock_shape: Local = Local()  # weight of the third axis
    roughness: Local = Local()  # half chord of the caps on the ground (m)
    air_drag: Local = Local()  # density over that of air
    wind: SteadyWind = SteadyWind()
    snow: Local = Local()  # friction that grows by q per 10 m/s
    ice: Local = Local()  # share of the ground under lenses of ice
    wetting: Local = Local()  # share of η_max lost by the last rock of the campaign; less friction
    magnus: Local = Local()  # lift over spin times speed, in 1/50
    edges: Local = Local()  # scale of the cross tilt (rad) that edges of blocks make; no effect
    loss: Local = Local()  # speed that a contact leaves, less a share q at 10 m/s; no effect


@kernel
def active(effect: Local, s: float) -> bool:
    """Whether an effect acts at a place."""
    return bool(effect.q > 0.0 and effect.s0 <= s <= effect.s1)


@kernel
def acceleration(
    forces: Forces, st: FloatArray, phi: float, vx: float, vy: float, vz: float
) -> tuple[float, float, float]:
    """Acceleration of a flying rock by gravity, air, wind and lift (m/s²)."""
    ax = 0.0
    ay = 0.0
    az = 0.0
    along = math.sqrt(vx * vx + vy * vy)
    speed = math.sqrt(along * along + vz * vz)
    if speed < 1e-6:
        return ax, ay, -GRAVITY
    a, b, c = st[A], st[B], st[C]
    if forces.air_drag.q > 0.0:
        # The area that a turning ellipsoid shows to the wind, by its angle to the path.
        turn = phi - math.atan2(vz, along)
        wide = math.sqrt((a * math.sin(turn)) ** 2 + (b * math.cos(turn)) ** 2)
        area = math.pi * wide * c
        reynolds = _AIR * speed * 2.0 * wide / _VISCOSITY
        resistance = 0.4 + 24.0 / reynolds + 6.0 / (1.0 + math.sqrt(reynolds))
        resistance *= 1.0 + 1.2 * (wide - c) / wide
        pull = -0.5 * _AIR * forces.air_drag.q * resistance * area * speed / mass_of(st)
        ax += pull * vx
        ay += pull * vy
        az += pull * vz
    if forces.wind.q > 0.0:
        push = forces.wind.q * 0.3 / math.sqrt(a * b)
        ax += push * forces.wind.x
        ay += push * forces.wind.y
    if forces.magnus.q > 0.0 and along > 1e-6:
        lift = 0.02 * forces.magnus.q * st[SPIN]
        ax += lift * vz * vx / along
        ay += lift * vz * vy / along
        az -= lift * along
    return ax, ay, az - GRAVITY


@kernel
def cap_tilts(bumps: Local, key: np.uint64, count: int, radius: float) -> tuple[float, float]:
    """Tilt of the ground along and across the path where a rock lands on a cap (rad).

    Spherical caps of half chord q and radius 1.05 q cover nine tenths of the ground. A rock that
    touches a cap off its crown meets the line through the two centres as the normal: the larger
    the rock, the less it is turned.
    """
    if draws.uniform(key, draws.BUMP, 4 * count) > 0.9:
        return 0.0, 0.0
    off = 2.0 * draws.uniform(key, draws.BUMP, 4 * count + 1) - 1.0
    across = 2.0 * draws.uniform(key, draws.BUMP, 4 * count + 2) - 1.0
    sine = bumps.q / (radius + 1.05 * bumps.q)
    return math.asin(off * sine), 0.3 * math.asin(across * sine)


@kernel
def indent(
    soft: Local,
    mass: float,
    radius: float,
    inertia: float,
    vn_in: float,
    spin_in: float,
    vt: float,
    vn: float,
    spin: float,
) -> tuple[float, float, float]:
    """Rebound from ground that yields: visco-plastic, work ~ yield stress · (depth · R)^1.5.

    The depth follows from the normal energy. What springs back decays with the depth, the wall of
    the dent takes tangential speed, and the rock slips in it: its spin stays behind.
    """
    energy = 0.5 * mass * vn_in * vn_in
    depth = (energy * soft.q / (4.0e5 * radius**1.5)) ** (2.0 / 3.0)
    share = depth / radius
    held = math.exp(-2.5 * share)
    before = vt * vt + vn * vn + inertia * spin * spin
    ploughed = min(abs(vt), 0.9 * abs(vn_in) * share / (1.0 + share))
    vt -= math.copysign(ploughed, vt)
    vn *= held
    spin = spin_in + (spin - spin_in) * held
    after = vt * vt + vn * vn + inertia * spin * spin
    if after > before:
        scale = math.sqrt(before / after)
        vt *= scale
        vn *= scale
        spin *= scale
    return vt, vn, spin


@kernel
def break_chance(breaking: Local, volume: float, vn_in: float) -> float:
    """Chance that a rock breaks: Weibull in the specific energy, the larger the weaker."""
    energy = 0.5 * vn_in * vn_in
    return 1.0 - math.exp(-breaking.q * math.sqrt(volume / 0.5) * (energy / 40.0) ** 2)


@kernel
def on_ice(ice: Local, x: float, y: float) -> bool:
    """Whether a place lies on a lens of ice (lenses of 5 m)."""
    i = math.floor(x / 5.0)
    j = math.floor(y / 5.0)
    return bool(draws.uniform(draws.mix(np.uint64(i)), draws.PATCH, j) < ice.q)


@kernel
def strike(
    nx: float, ny: float, vx: float, vy: float, mass: float, capacity: float, other_mass: float
) -> tuple[float, float]:
    """Velocity in plan after an oblique, elastic-plastic blow against a stem or a lying block.

    Parameters
    ----------
    nx, ny : float
        Unit vector from the obstacle to the rock.
    capacity : float
        Energy at which the obstacle gives way (J).
    other_mass : float
        Mass that the rock has to move (kg); 0 for one that is rooted.
    """
    approach = -(vx * nx + vy * ny)
    energy = 0.5 * mass * approach * approach
    if energy > capacity:
        leave = -math.sqrt(2.0 * (energy - capacity) / mass)
    else:
        leave = 0.35 * (1.0 - 0.8 * energy / capacity) * approach
    if other_mass > 0.0:
        share = other_mass / (mass + other_mass)
        leave = -approach + share * 1.3 * approach
    tx = -ny
    ty = nx
    slide = vx * tx + vy * ty
    rub = min(abs(slide), 0.25 * (leave + approach))
    slide -= math.copysign(rub, slide)
    return leave * nx + slide * tx, leave * ny + slide * ty


@kernel
def snow_drag(snow: Local, speed: float) -> float:
    """Extra friction of snow, which grows with speed."""
    return snow.q * abs(speed) / 10.0


@kernel
def drained(loss: Local, vt: float, vn: float, spin: float) -> tuple[float, float, float]:
    """What a loss that grows with the speed leaves of velocity and spin after a contact."""
    held = 1.0 / (1.0 + loss.q * (vt * vt + vn * vn) / 100.0)
    return held * vt, held * vn, held * spin


@kernel
def weight_on(slope: float) -> float:
    """Normal component of gravity (m/s²)."""
    return GRAVITY * math.cos(slope)
