"""Synthetic sites: what is asked for, what is true of them, and a battery of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from gap_check.slopes import SLOPE_TYPES, FloatArray, IntArray, Relief, Surface

T = TypeVar("T")

#: How rocks move: by the engine of the program, or in MuJoCo with elastic or plastic contacts.
LAWS: tuple[str, ...] = ("own", "elastic", "plastic")
#: Effects that the diagnosis can name, and the phase of the motion in which they act.
PHASES = {
    "lateral_deflection": "impact", "fragmentation": "impact", "soft_ground": "impact",
    "entrainment": "impact", "trees": "flight", "air_drag": "flight", "roughness": "impact",
    "rock_shape": "impact", "release_error": "release", "measurement_error": "observation",
}  # fmt: skip
FAMILIES = tuple(PHASES)
#: Effects that it has no name for.
UNKNOWNS = ("wind", "ice", "terrace")
STRENGTHS = ("weak", "medium", "strong")
#: What nature does besides at a site, and no effect: a patch of ground that no map shows, and a
#: loss at contacts that grows with the speed.
DISTURBANCES = ("", "patch", "speed_loss")
KINDS: dict[str, tuple[str, ...]] = {
    "stations": ("rocks", "stations", "passages"),
    "stops": ("rocks", "deposits"),
    "both": ("rocks", "stations", "passages", "deposits"),
    "everything": ("rocks", "stations", "passages", "deposits", "impacts", "trajectories"),
}
MOST_STATIONS = 8
FAR = 1e6


@dataclass(frozen=True, slots=True)
class EffectSpec:
    """One effect asked for."""

    name: str  # of FAMILIES or UNKNOWNS
    strength: str = "medium"  # one of STRENGTHS

    def __post_init__(self) -> None:
        require("effect", self.name, (*FAMILIES, *UNKNOWNS))
        require("strength", self.strength, STRENGTHS)


@dataclass(frozen=True, slots=True)
class WorldSpec:
    """What a site is to be; ValueError if there is no such thing."""

    slope: str  # one of SLOPE_TYPES
    effects: tuple[EffectSpec, ...] = ()  # none, one, or a pair
    n_rocks: int = 100  # rocks observed
    kind: str = "both"  # what is observed: one of KINDS
    law: str = "own"  # one of LAWS
    n_stations: int = 4  # 1 to MOST_STATIONS
    #: Whether observers know from which rock a piece or a loosened block comes.
    named: bool = True
    error_factor: float = 1.0  # stated errors of measurement over the true ones
    disturbance: str = ""  # one of DISTURBANCES
    faults: bool = False  # whether observers and terrain model have the faults of real ones

    def __post_init__(self) -> None:
        require("slope", self.slope, SLOPE_TYPES)
        require("kind", self.kind, tuple(KINDS))
        require("law", self.law, LAWS)
        require("disturbance", self.disturbance, DISTURBANCES)
        require("n_stations", self.n_stations, range(1, MOST_STATIONS + 1))

    @property
    def verdict(self) -> str:
        """What a diagnosis should answer: ``none``, ``unknown``, or families joined by ``+``."""
        names = sorted(e.name for e in self.effects)
        if set(names) & set(UNKNOWNS):
            return "unknown"
        return "+".join(names) or "none"


def require(what: str, found: object, known: Sequence[object]) -> None:
    """Raise ValueError if there is no such thing."""
    if found not in known:
        raise ValueError(f"no such {what}: {found!r}; known: {', '.join(map(str, known))}")


@dataclass(frozen=True, slots=True)
class PlacedEffect:
    """One effect as it acts in a site."""

    name: str
    strength: str  # by its size; less than was asked for where no magnitude gives that
    share: float  # of the way from its weakest to its strongest magnitude, 0 to 1
    # Between what it acts (m down the slope); infinitely far where everywhere.
    s0_m: float
    s1_m: float
    ground: str = ""  # class of ground that it is bound to; empty if none
    #: Energy distance from the same site without it, over its upper bound (0 to 1).
    size: float = math.nan
    seed: int = 0  # where its own random parts come from

    def between(self, weakest: float, strongest: float) -> float:
        """Its magnitude on a logarithmic scale between two limits."""
        return weakest * (strongest / weakest) ** self.share


@dataclass(frozen=True, slots=True)
class Faults:
    """What the observers of a site do not see, or see wrongly; without values, nothing."""

    contact_min_normal_speed_mps: float = 0.0  # lighter contacts are not recorded
    contact_min_interval_s: float = 0.0  # those that follow sooner are taken for one
    passages_missed_share: float = 0.0
    clipped_share: float = 0.0  # of the rocks, whose film begins late or ends early
    stops_m: float = 0.0  # grid to which stops are rounded; 0 for none
    axes_sd: float = 0.0  # relative error of semi-axes that are taken by eye
    #: Down the slope, of all release points together and of each (standard deviation).
    release_m: tuple[float, float] = (0.0, 0.0)
    stated: tuple[str, ...] = ()  # which of the first three the metadata state


@dataclass(frozen=True, slots=True)
class World:
    """A synthetic site."""

    spec: WorldSpec
    seed: int
    relief: Relief  # the slope, without a terrace
    survey: Surface  # the terrain model that the diagnosing side is given
    surface: Surface  # the slope on which the rocks move
    ground: IntArray  # position in CLASSES of each cell, in truth; shape of the surface
    releases: FloatArray  # release points x, y, z (m), shape (n_releases, 3)
    #: Limits between which rocks are drawn, all uniform: semi-axes (m), density (kg/m³), speed
    #: (m/s) and drop (m). The diagnosing side knows them.
    blocks: dict[str, tuple[float, float]]
    stations_s: FloatArray = field(default_factory=lambda: np.zeros(0))  # (m down the slope)
    faults: Faults = Faults()
    effects: tuple[PlacedEffect, ...] = ()  # the truth

    def effect(self, name: str) -> PlacedEffect | None:
        """The effect of that name, if it acts here."""
        return next((e for e in self.effects if e.name == name), None)

    def station_lines(self) -> FloatArray:
        """Stations as lines across the slope: x0, y0, x1, y1 (m), a row for each."""
        ends = [self.relief.frame.xy(self.stations_s, np.full(len(self.stations_s), c))
                for c in (-80.0, 80.0)]  # fmt: skip
        return np.column_stack([*ends[0], *ends[1]])


# ---------------------------------------------------------------------------------------------
# The mix of sites

#: Number of rocks, and kind of observations.
Design = tuple[int, str]
DESIGNS: tuple[Design, ...] = tuple((size, kind) for size in (20, 40, 100, 300) for kind in KINDS)
#: A well-equipped field test, and what is more often to be had.
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
_SINGLE_STRENGTHS = ("weak", "medium", "strong", "medium", "strong")


def battery(seed: int, n: int, laws: Sequence[str] = LAWS) -> list[WorldSpec]:
    """Specifications of a battery of ``n`` sites, in shuffled order.

    A third has no effect, two fifths a single one, two fifteenths a pair, the rest an unknown one.
    Of the single ones two fifths are observed as in ``FULL`` and a third as in ``MODEST``, of the
    unknown ones seven tenths as in ``FULL``. All else goes round in shuffled cycles. Half of the
    sites without an effect are disturbed. All observers and terrain models have faults.
    """
    rng = np.random.default_rng([seed, 1986])
    n_none, n_single = round(n * _NONE), round(n * _SINGLE)
    n_pair = min(round(n * _PAIR), n - n_none - n_single)
    n_unknown = n - n_none - n_single - n_pair
    n_full, n_modest = round(n_single * _SINGLE_FULL), round(n_single * _SINGLE_MODEST)
    unknown_full = round(n_unknown * _UNKNOWN_FULL)
    effects = [()] * n_none + _singles(rng, n_single) + _pairs(rng, n_pair)
    unknown = _cycle(rng, UNKNOWNS, n_unknown), _cycle(rng, STRENGTHS[1:], n_unknown)
    effects += [(EffectSpec(*own),) for own in zip(*unknown, strict=True)]
    designs = _cycle(rng, DESIGNS, n_none)
    designs += [FULL] * n_full + _cycle(rng, DESIGNS, n_single - n_full - n_modest)
    designs += [MODEST] * n_modest + _cycle(rng, DESIGNS, n_pair)
    designs += [FULL] * unknown_full + _cycle(rng, DESIGNS, n_unknown - unknown_full)
    circumstances = zip(
        _cycle(rng, SLOPE_TYPES, n), _cycle(rng, laws, n),
        _cycle(rng, range(1, MOST_STATIONS + 1), n), _cycle(rng, _NAMED, n),
        _cycle(rng, _ERROR_FACTORS, n), _cycle(rng, _DISTURBANCES, n_none) + [""] * (n - n_none),
        strict=True,
    )  # fmt: skip
    specs = [
        replace(WorldSpec(slope, own, *design, *rest), faults=True)
        for own, design, (slope, *rest) in zip(effects, designs, circumstances, strict=True)
    ]
    return [specs[k] for k in rng.permutation(n).tolist()]


def world_seeds(seed: int, n: int) -> list[int]:
    """Seeds of the ``n`` sites of a battery; those of two batteries have nothing in common."""
    state = np.random.SeedSequence([seed, 1977]).generate_state(n, np.uint64)
    # Other numbers are added to a seed further on: room is left above it.
    return [int(value >> np.uint64(16)) for value in state]


def _singles(rng: np.random.Generator, n: int) -> list[tuple[EffectSpec, ...]]:
    """Single effects: families in shuffled cycles, and each through the strengths in turn."""
    place = {name: k for k, name in enumerate(_cycle(rng, FAMILIES, len(FAMILIES)))}
    turn, n_kinds = _SINGLE_STRENGTHS, len(FAMILIES)
    return [
        (EffectSpec(name, turn[(place[name] + k // n_kinds) % len(turn)]),)
        for k, name in enumerate(_cycle(rng, FAMILIES, n))
    ]


def _pairs(rng: np.random.Generator, n: int) -> list[tuple[EffectSpec, ...]]:
    """The first of each pair goes round all families, the second is drawn from the others."""
    pairs: list[tuple[EffectSpec, ...]] = []
    for first in _cycle(rng, FAMILIES, n):
        others = [name for name in FAMILIES if name != first]
        second = others[int(rng.integers(len(others)))]
        own = zip((first, second), _cycle(rng, STRENGTHS[1:], 2), strict=True)
        pairs.append(tuple(EffectSpec(name, strength) for name, strength in own))
    return pairs


def _cycle(rng: np.random.Generator, values: Sequence[T], n: int) -> list[T]:
    """N values: all of them in a shuffled order, again and again."""
    out: list[T] = []
    while len(out) < n:
        out += [values[k] for k in rng.permutation(len(values))]
    return out[:n]
