"""What is drawn of each block: its size, shape and density."""

from __future__ import annotations

import math

import numpy as np

from sassgis.engine.state import Block
from sassgis.model import rng
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel


@kernel
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


@kernel
def draw_block(limits: FloatArray, key: np.uint64) -> tuple[Block, float]:
    """Draw one rock between limits (core.blocks.BlockPopulation.array).

    The three semi-axes are drawn and sorted; the two longer ones lie in the plane of motion, so
    that the spin is about the shortest, and the third sets the mass. Where the volume is drawn as
    well, the axes give the shape only.
    """
    p = rng.between(key, rng.AXIS_1, 0, limits[0, 0], limits[0, 1])
    q = rng.between(key, rng.AXIS_2, 0, limits[1, 0], limits[1, 1])
    r = rng.between(key, rng.AXIS_3, 0, limits[2, 0], limits[2, 1])
    if limits[8, 1] > 0.0:
        volume = _draw_volume(key, limits[8, 0], limits[8, 1], limits[9, 0])
        scale = (volume / (4.0 / 3.0 * math.pi * p * q * r)) ** (1.0 / 3.0)
        p *= scale
        q *= scale
        r *= scale
    a = max(p, q, r)
    c = min(p, q, r)
    b = p + q + r - a - c
    b = min(max(b, c), a)
    density = rng.between(key, rng.DENSITY, 0, limits[3, 0], limits[3, 1])
    mass = 4.0 / 3.0 * math.pi * a * b * c * density
    return Block(a, b, c, mass, key), density
