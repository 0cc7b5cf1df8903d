"""The mix of sites on which a diagnosis is checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from sassgis.gap.check.worlds.observe import KINDS
from sassgis.gap.check.worlds.slopes import SLOPE_TYPES
from sassgis.gap.check.worlds.world import (
    DISTURBANCES,
    FAMILIES,
    LAWS,
    MOST_STATIONS,
    UNKNOWNS,
    EffectSpec,
    WorldSpec,
)
from sassgis.model.errors import InputError

T = TypeVar("T")
#: Number of rocks, and kind of observations.
Design = tuple[int, str]

SAMPLE_SIZES = (20, 40, 100, 300)
DESIGNS: tuple[Design, ...] = tuple((size, kind) for size in SAMPLE_SIZES for kind in KINDS)
#: A well-equipped field test, and what is more often to be had: the designs on which the accuracy
#: is asked for, and which therefore most of the sites with a single effect have.
FULL: Design = (100, "everything")
MODEST: Design = (40, "both")
# Shares of the battery: nothing, one effect, a pair; what is left is unknown effects.
_NONE, _SINGLE, _PAIR = 1 / 3, 2 / 5, 2 / 15
# Shares of the single effects in the two designs, and of the unknown ones in the first.
_SINGLE_FULL, _SINGLE_MODEST, _UNKNOWN_FULL = 2 / 5, 1 / 3, 7 / 10
# Half of the sites without an effect is disturbed otherwise; as many state wrong errors.
_DISTURBANCES = ("", "", *DISTURBANCES[1:])
_ERROR_FACTORS = (1.0, 1.0, 0.5, 1.5)
# Observers of every third site know no names of pieces.
_NAMED = (True, True, False)
# A fifth of the single effects is weak.
_STRENGTHS = ("weak", "medium", "strong", "medium", "strong")


def battery(seed: int, n: int, laws: Sequence[str] = LAWS) -> list[WorldSpec]:
    """Specifications of a battery of ``n`` sites, in shuffled order.

    A third has no effect, two fifths a single one, two fifteenths a pair, the rest an unknown one.
    Of the single ones two fifths are observed as in ``FULL`` and a third as in ``MODEST``; of the
    unknown ones seven tenths as in ``FULL``. All others go round the remaining designs; sites
    without an effect and pairs go round all of them. Families follow each other in shuffled cycles
    that run on from design to design, so that each comes as often as any other in all of them, to
    within one; in five cycles each of them is weak once, medium twice and strong twice. Pairs and
    unknown effects are medium or strong.

    Laws of the motion, slopes, numbers of stations, names and stated errors go round all sites.
    Half of the sites without an effect has a patch of ground that no map shows, or a loss that
    grows with the speed. All observers and terrain models have faults.

    Raises
    ------
    InputError
        If no site is asked for.
    """
    if n < 1:
        raise InputError("no sites", field="n", found=n, expected="at least 1")
    rng = np.random.default_rng([seed, 1986])
    n_none, n_single = round(n * _NONE), round(n * _SINGLE)
    n_pair = min(round(n * _PAIR), n - n_none - n_single)
    n_unknown = n - n_none - n_single - n_pair

    cells: list[tuple[tuple[EffectSpec, ...], Design]] = []
    cells += [((), design) for design in _cycle(rng, DESIGNS, n_none)]
    singles = _singles(rng, n_single)
    cells += zip(singles, _single_designs(rng, n_single), strict=True)
    cells += zip(_pairs(rng, n_pair), _cycle(rng, DESIGNS, n_pair), strict=True)
    n_full = round(n_unknown * _UNKNOWN_FULL)
    elsewhere = [design for design in DESIGNS if design != FULL]
    designs = [FULL] * n_full + _cycle(rng, elsewhere, n_unknown - n_full)
    cells += zip(_unknown(rng, n_unknown), designs, strict=True)

    disturbances = _cycle(rng, _DISTURBANCES, n_none) + [""] * (n - n_none)
    circumstances = zip(
        _cycle(rng, SLOPE_TYPES, n),
        _cycle(rng, laws, n),
        _cycle(rng, range(1, MOST_STATIONS + 1), n),
        _cycle(rng, _NAMED, n),
        _cycle(rng, _ERROR_FACTORS, n),
        disturbances,
        strict=True,
    )
    specs = [
        replace(WorldSpec(slope, own, *design, *rest), faults=True)
        for (own, design), (slope, *rest) in zip(cells, circumstances, strict=True)
    ]
    return [specs[k] for k in rng.permutation(n).tolist()]


def quick_battery(seed: int, laws: Sequence[str] = LAWS[:-1]) -> list[WorldSpec]:
    """Six sites that show whether a check runs, not how good a diagnosis is.

    Two without an effect, three with a strong one, one with an unknown one; 20 to 40 rocks; if not
    asked for otherwise under the laws that need no library.
    """
    rng = np.random.default_rng([seed, 1986])
    names = [*_cycle(rng, FAMILIES, 3), *_cycle(rng, UNKNOWNS, 1)]
    effects = [(), (), *((EffectSpec(name, "strong"),) for name in names)]
    designs: list[Design] = [(20, "both"), (40, "everything")] * 3
    slopes, motions = _cycle(rng, SLOPE_TYPES, 6), _cycle(rng, laws, 6)
    return [
        WorldSpec(slopes[k], effects[k], designs[k][0], designs[k][1], motions[k], faults=True)
        for k in rng.permutation(6).tolist()
    ]


def world_seeds(seed: int, n: int) -> list[int]:
    """Seeds of the ``n`` sites of a battery; those of two batteries have nothing in common."""
    state = np.random.SeedSequence([seed, 1977]).generate_state(n, np.uint64)
    # Other numbers are added to a seed further on: room is left above it.
    return [int(value >> np.uint64(16)) for value in state]


def _singles(rng: np.random.Generator, n: int) -> list[tuple[EffectSpec, ...]]:
    """Single effects: families in shuffled cycles, and each through the strengths in turn."""
    place = {name: k for k, name in enumerate(_cycle(rng, FAMILIES, len(FAMILIES)))}
    return [
        (EffectSpec(name, _STRENGTHS[(place[name] + k // len(FAMILIES)) % len(_STRENGTHS)]),)
        for k, name in enumerate(_cycle(rng, FAMILIES, n))
    ]


def _single_designs(rng: np.random.Generator, n: int) -> list[Design]:
    n_full, n_modest = round(n * _SINGLE_FULL), round(n * _SINGLE_MODEST)
    others = [design for design in DESIGNS if design not in (FULL, MODEST)]
    # In this order the cycles of families end with the battery of 150.
    return [FULL] * n_full + _cycle(rng, others, n - n_full - n_modest) + [MODEST] * n_modest


def _pairs(rng: np.random.Generator, n: int) -> list[tuple[EffectSpec, ...]]:
    """The first of each pair goes round all families, the second is drawn from the others."""
    pairs: list[tuple[EffectSpec, ...]] = []
    for first in _cycle(rng, FAMILIES, n):
        others = [name for name in FAMILIES if name != first]
        second = others[int(rng.integers(len(others)))]
        strengths = _cycle(rng, _STRENGTHS[1:3], 2)
        pairs.append((EffectSpec(first, strengths[0]), EffectSpec(second, strengths[1])))
    return pairs


def _unknown(rng: np.random.Generator, n: int) -> list[tuple[EffectSpec, ...]]:
    strengths = _cycle(rng, _STRENGTHS[1:3], n)
    names = _cycle(rng, UNKNOWNS, n)
    return [(EffectSpec(name, s),) for name, s in zip(names, strengths, strict=True)]


def _cycle(rng: np.random.Generator, values: Sequence[T], n: int) -> list[T]:
    """N values: all of them in a shuffled order, again and again."""
    out: list[T] = []
    while len(out) < n:
        out += [values[k] for k in rng.permutation(len(values))]
    return out[:n]
