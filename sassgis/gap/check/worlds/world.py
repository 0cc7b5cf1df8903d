"""Sites: a synthetic slope, rocks, and a truth that the diagnosing side does not know."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sassgis.gap.check.worlds.motion_state import KeyArray
from sassgis.gap.check.worlds.slopes import Relief
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid, IntArray


class EffectKind(NamedTuple):
    """Magnitudes between which a strength is searched for, and the phase in which it acts."""

    weakest: float
    strongest: float
    phase: str


FAMILIES = (
    "lateral_deflection", "fragmentation", "soft_ground", "entrainment", "trees", "air_drag",
    "roughness", "rock_shape", "release_error", "measurement_error",
)  # fmt: skip
UNKNOWNS = ("wind", "snow", "ice", "wetting", "terrace", "magnus", "collisions")
EFFECTS = {
    "lateral_deflection": EffectKind(0.01, 1.2, "impact"),
    "fragmentation": EffectKind(0.01, 8.0, "impact"),
    "soft_ground": EffectKind(0.05, 30.0, "impact"),
    "entrainment": EffectKind(0.0005, 2.0, "impact"),
    "trees": EffectKind(0.01, 1.0, "flight"),
    # Coefficients of drag up to 2: more is not in air.
    "air_drag": EffectKind(0.5, 2.5, "flight"),
    "roughness": EffectKind(0.05, 5.0, "impact"),
    "rock_shape": EffectKind(0.03, 6.0, "impact"),
    "release_error": EffectKind(0.1, 15.0, "release"),
    "measurement_error": EffectKind(0.01, 0.6, "observation"),
    "wind": EffectKind(0.05, 12.0, "flight"),
    "snow": EffectKind(0.01, 6.0, "rolling"),
    "ice": EffectKind(0.02, 1.0, "rolling"),
    "wetting": EffectKind(0.03, 0.9, "impact"),
    "terrace": EffectKind(0.1, 6.0, "impact"),
    "magnus": EffectKind(0.05, 3.0, "flight"),
    "collisions": EffectKind(0.01, 1.0, "rolling"),
}
STRENGTHS = ("weak", "medium", "strong")
#: Law of the motion in the rigid-body library.
RIGID = "rigid"
#: Laws of the motion; the first two are those of the contact, as ``contact_laws`` numbers them.
LAWS: tuple[str, ...] = ("own", "elastic", RIGID)
#: What nature does besides at a site, and no effect: a patch of ground that no map shows, and a
#: loss at contacts that grows with the speed.
DISTURBANCES: tuple[str, ...] = ("", "patch", "speed_loss")
MOST_STATIONS = 8


def require_known(problem: str, field: str, found: str, known: Collection[str]) -> None:
    """Raise InputError if there is no such thing."""
    if found not in known:
        raise InputError(problem, field=field, found=found, expected=", ".join(known))


@dataclass(frozen=True, slots=True)
class EffectSpec:
    """One effect asked for."""

    name: str  # one of EFFECTS
    strength: str = "medium"  # one of STRENGTHS

    def __post_init__(self) -> None:
        require_known("unknown effect", "name", self.name, EFFECTS)
        require_known("unknown strength", "strength", self.strength, STRENGTHS)


@dataclass(frozen=True, slots=True)
class WorldSpec:
    """What a site is to be.

    Raises
    ------
    InputError
        If there is no such law or disturbance, or no such number of stations.
    """

    slope: str  # one of SLOPE_TYPES
    effects: tuple[EffectSpec, ...] = ()  # none, one, or a pair
    n_rocks: int = 100  # rocks observed
    kind: str = "both"  # what is observed: "stations", "stops", "both" or "everything"
    law: str = "own"  # one of LAWS: how rocks move
    n_stations: int = 4  # 1 to MOST_STATIONS
    #: Whether observers know from which rock a piece or a loosened block comes, or whether it is
    #: the rock itself.
    named: bool = True
    error_factor: float = 1.0  # stated errors of measurement over the true ones
    disturbance: str = ""  # one of DISTURBANCES
    faults: bool = False  # whether observers and terrain model have the faults of real ones

    def __post_init__(self) -> None:
        counts = tuple(range(1, MOST_STATIONS + 1))
        for name, known in (
            ("law", LAWS), ("disturbance", DISTURBANCES), ("n_stations", counts)
        ):  # fmt: skip
            if getattr(self, name) not in known:
                raise InputError(
                    "no such site",
                    field=name,
                    found=getattr(self, name),
                    expected=f"one of {', '.join(map(repr, known))}",
                )

    @property
    def verdict(self) -> str:
        """What a diagnosis should answer: ``none``, ``unknown``, or families joined by ``+``."""
        names = [e.name for e in self.effects]
        if not names:
            return "none"
        if any(name in UNKNOWNS for name in names):
            return "unknown"
        return "+".join(sorted(names))


@dataclass(frozen=True, slots=True)
class PlacedEffect:
    """One effect as it acts in a site."""

    name: str
    strength: str  # by its size; less than was asked for where no magnitude gives that
    magnitude: float  # value of its principal parameter
    # Between what it acts (m down the slope); infinite where everywhere.
    s0_m: float
    s1_m: float
    segments: tuple[str, ...]  # reaches that it touches, such as "S4-end"; all, if it is everywhere
    ground: str = ""  # class of ground that it is bound to; empty if none
    #: Standardised energy distance from the same site without it (0 to 1); NaN if not measured.
    size: float = math.nan
    seed: int = 0  # where its own random parts come from

    @property
    def phase(self) -> str:
        """Of the motion: release, flight, impact, rolling; or observation."""
        return EFFECTS[self.name].phase


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
    survey: Grid  # the terrain model that the diagnosing side is given
    true_grid: Grid  # the slope on which the rocks move
    #: True parameters by class of ground, shape (n_classes, 10), in the order of ``make.LAW_KEYS``;
    #: in the rigid-body library those of ``rigid_bodies``, shape (n_classes, 6).
    law: FloatArray
    speed_loss: float  # share of the speed that a contact at 10 m/s takes besides, about
    ground: IntArray  # position in CLASSES of each cell, in truth; shape of the grid
    stations_s: FloatArray  # stations (m down the slope), shape (n_stations,)
    releases: FloatArray  # release points x, y, z (m), shape (n_releases, 3)
    #: Limits between which rocks are drawn, all uniform: semi-axes (m), density (kg/m³), speed
    #: (m/s) and drop (m). The diagnosing side knows them.
    blocks: dict[str, tuple[float, float]]
    faults: Faults = Faults()
    #: Scale of the tilt across the path that edges of the blocks make at contacts (rad); real
    #: blocks leave their line so. In the rigid-body library corners do.
    edges_rad: float = 0.0
    effects: tuple[PlacedEffect, ...] = ()  # the truth

    @property
    def station_names(self) -> tuple[str, ...]:
        """S1, S2, ... from above."""
        return tuple(f"S{k + 1}" for k in range(len(self.stations_s)))

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the reaches between release, stations and the end."""
        stops = ("release", *self.station_names, "end")
        return tuple(f"{a}-{b}" for a, b in pairwise(stops))

    def station_lines(self) -> FloatArray:
        """Stations as lines across the slope: x0, y0, x1, y1 (m), a row for each."""
        half = 80.0
        ax, ay = self.relief.frame.xy(self.stations_s, np.full(len(self.stations_s), -half))
        bx, by = self.relief.frame.xy(self.stations_s, np.full(len(self.stations_s), half))
        return np.column_stack([ax, ay, bx, by])


@dataclass(frozen=True, slots=True)
class WorldRocks:
    """Rocks before their release."""

    #: As the kernels take it, shape (n, N_STATE); with the errors of the release, where the truth
    #: has them, and the time in the campaign at which each is released, 0 to 1.
    state: FloatArray
    #: Release x, y, z of the centre (m) and speed (m/s) as they are written down, shape (n, 4).
    stated: FloatArray
    keys: KeyArray  # shape (n,)


@dataclass(frozen=True, slots=True)
class Run:
    """Everything that the rocks of a site did, without errors of measurement.

    Each table holds rock, number of the piece and kind of block before the columns named in
    ``sassgis.gap.check.worlds.motion_state``.
    """

    rocks: WorldRocks
    deposits: FloatArray
    passages: FloatArray
    impacts: FloatArray
    tracks: FloatArray
    energy_gain: FloatArray


def with_effects(world: World, effects: tuple[PlacedEffect, ...]) -> World:
    """The same site with other effects."""
    grid = world.relief.grid
    for effect in effects:
        if effect.name == "terrace":
            grid = replace(grid, values=grid.values + _terrace(world, effect))
    return replace(world, effects=effects, true_grid=grid)


def _terrace(world: World, effect: PlacedEffect) -> FloatArray:
    """What a terrace adds to the surveyed heights: cut at the back, filled at the front (m)."""
    grid = world.relief.grid
    x, y = grid.cell_centres(np.arange(grid.values.size))
    s = world.relief.frame.s(x, y)
    u = (s - effect.s0_m) / (effect.s1_m - effect.s0_m)
    wave = np.where((u > 0.0) & (u < 1.0), -np.sin(2.0 * np.pi * u) * np.sin(np.pi * u), 0.0)
    return effect.magnitude * wave.reshape(grid.shape)
