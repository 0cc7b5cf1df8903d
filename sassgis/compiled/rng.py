"""Counter-based random draws.

A draw is a pure function of (block key, stream, event): the same blocks result whatever the
chunks, threads or order, and one stream never shifts another.
"""

from __future__ import annotations

import hashlib
import math

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import kernel
from sassgis.grid import IntArray

# Streams: what a draw is for. An effect that needs draws takes separate streams.
AXIS_1, AXIS_2, AXIS_3, DENSITY, SPEED, SPIN, DROP, ORIENTATION, START, SLOPE = range(10)
VOLUME = 10
STEM_DISTANCE, STEM_OFFSET, TILT, LANDING, BREAKS, FRAGMENT_ANGLE = range(11, 17)
ENTRAINED, ENTRAINED_ANGLE = 17, 18
HOP, KICK, DEFLECTION = 19, 20, 26
ROLLING_FRICTION = 27
DRIFT, HEADING, SIDE_TILT, START_U, START_V = range(21, 26)
FRAGMENT_SIZE, FRAGMENT_ASIDE = 31, 32


@kernel
def mix(z: int | np.uint64) -> np.uint64:
    """Scramble 64 bits (the finaliser of SplitMix64; Steele, Lea and Flood 2014)."""
    z = np.uint64(z)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel
def block_key(seed: int | np.uint64, line_key: np.uint64, number: int) -> np.uint64:
    """Make the key of a block from the run's seed, the key of its line and its number on it."""
    key = mix(np.uint64(seed) + np.uint64(0x9E3779B97F4A7C15))
    key = mix(key ^ np.uint64(line_key))
    return mix(key + np.uint64(number) * np.uint64(0x9E3779B97F4A7C15))


@kernel
def uniform(key: np.uint64, stream: int, event: int) -> float:
    """Return a number in the open interval (0, 1), with 52 random bits."""
    word = mix(key + np.uint64(stream + 1) * np.uint64(0xD1B54A32D192ED03))
    word = mix(word + np.uint64(event + 1) * np.uint64(0x9E3779B97F4A7C15))
    return (np.float64(word >> np.uint64(12)) + 0.5) * 2.220446049250313e-16


@kernel
def between(key: np.uint64, stream: int, event: int, low: float, high: float) -> float:
    """Return a number between two limits, which may coincide."""
    return low + (high - low) * uniform(key, stream, event)


@kernel
def normal(key: np.uint64, stream: int, event: int) -> float:
    """Return a number of the standard normal distribution (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(uniform(key, stream, 2 * event)))
    return radius * math.cos(2.0 * math.pi * uniform(key, stream, 2 * event + 1))


def combined(
    keys: NDArray[np.uint64], word: int | np.uint64 | IntArray | NDArray[np.uint64]
) -> NDArray[np.uint64]:
    """Return keys of things that a further number distinguishes; keys and words are broadcast."""
    with np.errstate(over="ignore"):
        z = np.asarray(keys, np.uint64) + (
            np.asarray(word).astype(np.uint64) + np.uint64(1)
        ) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    out: NDArray[np.uint64] = z ^ (z >> np.uint64(31))
    return out


def word_of(text: str) -> np.uint64:
    """Return a number for a text in the random draws: the first 64 bits of its SHA-256."""
    return np.uint64(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little"))


def shares(keys: NDArray[np.uint64]) -> NDArray[np.float64]:
    """Return a number in the open interval (0, 1) for each key."""
    mixed = combined(keys, 0)
    return ((mixed >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
