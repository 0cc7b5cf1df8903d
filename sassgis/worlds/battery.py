"""The mix of worlds on which a diagnosis is checked."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from sassgis.core.errors import InputError
from sassgis.worlds.observe import KINDS
from sassgis.worlds.relief import SLOPE_TYPES
from sassgis.worlds.world import FAMILIES, STRENGTHS, UNKNOWNS, EffectSpec, WorldSpec

T = TypeVar("T")

SAMPLE_SIZES = (20, 40, 100, 300)
# Shares of the battery: nothing, one effect, a pair; what is left is unknown effects.
_NONE, _SINGLE, _PAIR = 1 / 3, 2 / 5, 2 / 15


def battery(seed: int, n: int) -> list[WorldSpec]:
    """Specifications of a battery of worlds, in an order that tells nothing.

    Families, strengths, sample sizes, kinds of observations and slopes each come round in turn, in
    shuffled cycles, so that none is missing from a battery that is long enough.

    Parameters
    ----------
    seed : int
    n : int
        Number of worlds, at least 1.
    """
    if n < 1:
        raise InputError("no worlds", field="n", found=n, expected="at least 1")
    rng = np.random.default_rng([seed, 1986])
    n_none, n_single = round(n * _NONE), round(n * _SINGLE)
    n_pair = min(round(n * _PAIR), n - n_none - n_single)
    n_unknown = n - n_none - n_single - n_pair

    singles = _cycle(rng, [(f, s) for f in FAMILIES for s in STRENGTHS], n_single)
    # The first member of each pair goes round all families, the second is drawn from the others.
    firsts = _cycle(rng, list(FAMILIES), n_pair)
    effects: list[tuple[EffectSpec, ...]] = [() for _ in range(n_none)]
    effects += [(EffectSpec(f, s),) for f, s in singles]
    for first in firsts:
        others = [f for f in FAMILIES if f != first]
        second = others[int(rng.integers(len(others)))]
        strong = _cycle(rng, list(STRENGTHS[1:]), 2)
        effects.append((EffectSpec(first, strong[0]), EffectSpec(second, strong[1])))
    unknown = _cycle(rng, list(UNKNOWNS), n_unknown)
    effects += [(EffectSpec(u, STRENGTHS[1:][int(rng.integers(2))]),) for u in unknown]
    slopes = _cycle(rng, list(SLOPE_TYPES), n)
    designs = _cycle(rng, [(size, kind) for size in SAMPLE_SIZES for kind in KINDS], n)
    order = rng.permutation(n)
    return [
        WorldSpec(slopes[k], effects[k], n_rocks=designs[k][0], kind=designs[k][1]) for k in order
    ]


def _cycle(rng: np.random.Generator, values: list[T], n: int) -> list[T]:
    """N values: all of them in a shuffled order, again and again."""
    out: list[T] = []
    while len(out) < n:
        out += [values[k] for k in rng.permutation(len(values))]
    return out[:n]
