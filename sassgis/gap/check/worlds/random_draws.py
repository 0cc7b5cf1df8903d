"""Random numbers that depend on who asks, not on when.

Every number is a hash of (key of the block, stream, count): switching one effect on leaves the
draws of all others where they were. The mixing is that of SplitMix64 (Steele, Lea and Flood, 2014,
Fast splittable pseudorandom number generators, OOPSLA).
"""

from __future__ import annotations

import math

import numpy as np

from sassgis.model.jit import kernel

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_M1 = np.uint64(0xBF58476D1CE4E5B9)
_M2 = np.uint64(0x94D049BB133111EB)
_S30 = np.uint64(30)
_S27 = np.uint64(27)
_S31 = np.uint64(31)
_S11 = np.uint64(11)

# Streams: one for each purpose.
SLOPE, LATERAL, BUMP, PLATE, BREAK, PIECES, LOOSE, SIZE, PATCH, EDGE = range(1, 11)


@kernel
def mix(key: np.uint64) -> np.uint64:
    """Scramble 64 bits."""
    z = key + _GOLDEN
    z = (z ^ (z >> _S30)) * _M1
    z = (z ^ (z >> _S27)) * _M2
    return z ^ (z >> _S31)


@kernel
def child_key(key: np.uint64, number: int) -> np.uint64:
    """Key of the piece or loosened block of that number."""
    return mix(key ^ mix(np.uint64(number + 7919)))


@kernel
def uniform(key: np.uint64, stream: int, count: int) -> float:
    """A number from the open interval 0 to 1."""
    bits = mix(mix(key + np.uint64(stream) * _M2) + np.uint64(count) * _M1)
    return (float(bits >> _S11) + 0.5) / 9007199254740992.0


@kernel
def normal(key: np.uint64, stream: int, count: int) -> float:
    """A standard normal number; uses counts 2 * count and 2 * count + 1."""
    u = uniform(key, stream, 2 * count)
    v = uniform(key, stream, 2 * count + 1)
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * v)


@kernel
def laplace(key: np.uint64, stream: int, count: int) -> float:
    """A double exponential number of unit scale."""
    u = uniform(key, stream, count) - 0.5
    return -math.copysign(math.log(1.0 - 2.0 * abs(u)), u)
