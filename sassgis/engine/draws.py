"""Random draws of each block: its size, shape and density, and how it starts."""

from __future__ import annotations

import math

import numpy as np

from sassgis.compiled import rng
from sassgis.compiled.jit import lean
from sassgis.engine.ellipse import Record, inertia, mean_radius, outlined
from sassgis.engine.state import Block, Physics


@lean
def _draw_volume(key: np.uint64, low: float, high: float, exponent: float) -> float:
    """Draw a volume: N(V > v) falls as v^-exponent between the limits; NaN: all equally likely."""
    u = rng.uniform(key, rng.VOLUME, 0)
    if high <= low:
        return low
    if math.isnan(exponent):
        return low + (high - low) * u
    span = math.log(high / low)
    # The share of the law's mass below v is expm1(-b log(v/low)) / expm1(-b span).
    if abs(exponent) * span < 1e-9:
        return low * math.exp(u * span)
    return low * math.exp(-math.log1p(u * math.expm1(-exponent * span)) / exponent)


@lean
def draw_block(low: Record, high: Record, key: np.uint64) -> Block:
    """Draw one block between limits (rows of settings.blocks.LIMITS_DTYPE).

    The three semi-axes are drawn and sorted; the two longer ones lie in the plane of motion, so
    that the spin is about the shortest. Where the volume is drawn too, the axes give the shape
    only.
    """
    p = rng.between(key, rng.AXIS_1, 0, low.axis_1_m, high.axis_1_m)
    q = rng.between(key, rng.AXIS_2, 0, low.axis_2_m, high.axis_2_m)
    r = rng.between(key, rng.AXIS_3, 0, low.axis_3_m, high.axis_3_m)
    if high.volume_m3 > 0.0:
        volume = _draw_volume(key, low.volume_m3, high.volume_m3, low.volume_exponent)
        scale = (volume / (4.0 / 3.0 * math.pi * p * q * r)) ** (1.0 / 3.0)
        p *= scale
        q *= scale
        r *= scale
    a = max(p, q, r)
    c = min(p, q, r)
    b = p + q + r - a - c
    b = min(max(b, c), a)
    density = rng.between(key, rng.DENSITY, 0, low.density_kgm3, high.density_kgm3)
    mass = 4.0 / 3.0 * math.pi * a * b * c * density
    return block_of(a, b, c, density, mass, key)


@lean
def block_of(a: float, b: float, c: float, density: float, mass: float, key: np.uint64) -> Block:
    """Return a block of given axes (m), density (kg/m³) and mass (kg)."""
    own = inertia(a, b)
    roll_radius = mean_radius(a, b)
    return Block(
        a, b, c, density, mass, key, own, (a * b * c) ** (1.0 / 3.0), roll_radius,
        1.0 + own / (roll_radius * roll_radius), 1.0
    )  # fmt: skip


@lean
def changed(block: Block, own: float, drag: float) -> Block:
    """Return the block with another moment of inertia per unit mass (m²) and rolling friction."""
    return Block(
        block.a, block.b, block.c, block.density, block.mass, block.key, own, block.radius,
        block.roll_radius, 1.0 + own / (block.roll_radius * block.roll_radius), drag
    )  # fmt: skip


#: Moment of inertia of a mass point, over that of its mass at the rim: it gets no spin.
_UNTURNED = 1e9


@lean
def with_outline(block: Block, physics: Physics) -> Block:
    """Return the block with the axes that represent it in the plane.

    A mass point is the centre of a sphere of equal volume without rotation.
    """
    if physics.point:
        r = block.radius
        sphere = block_of(r, r, r, block.density, block.mass, block.key)
        return changed(sphere, _UNTURNED * r * r, 1.0)
    a, b = outlined(block.a, block.b, physics.outline_edges, physics.outline_share)
    return block_of(a, b, block.c, block.density, block.mass, block.key)


@lean
def with_drag(block: Block, sd: float) -> Block:
    """Return the block with a random rolling friction: log-normal, sd is that of the logarithm."""
    if sd <= 0.0:
        return block
    normal = rng.normal(block.key, rng.ROLLING_FRICTION, 0)
    return changed(block, block.inertia, math.exp(sd * normal))
