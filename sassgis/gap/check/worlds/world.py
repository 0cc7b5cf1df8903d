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
    """One effect asked for.

    Attributes
    ----------
    name : str
        One of EFFECTS.
    strength : {"weak", "medium", "strong"}
    """

    name: str
    strength: str = "medium"

    def __post_init__(self) -> None:
        require_known("unknown effect", "name", self.name, EFFECTS)
        require_known("unknown strength", "strength", self.strength, STRENGTHS)


@dataclass(frozen=True, slots=True)
class WorldSpec:
    """What a site is to be.

    Attributes
    ----------
    slope : str
        One of SLOPE_TYPES.
    effects : tuple of EffectSpec
        None, one, or a pair.
    n_rocks : int
        Rocks observed.
    kind : {"stations", "stops", "both", "everything"}
        What is observed.
    law : str
        One of LAWS: how rocks move.
    n_stations : int
        1 to MOST_STATIONS.
    named : bool
        Whether observers know from which rock a piece or a loosened block comes, or whether it is
        the rock itself.
    error_factor : float
        Stated errors of measurement over the true ones.
    disturbance : str
        One of DISTURBANCES.
    faults : bool
        Whether observers and terrain model have the faults of real ones.

    Raises
    ------
    InputError
        If there is no such law or disturbance, or no such number of stations.
    """

    slope: str
    effects: tuple[EffectSpec, ...] = ()
    n_rocks: int = 100
    kind: str = "both"
    law: str = "own"
    n_stations: int = 4
    named: bool = True
    error_factor: float = 1.0
    disturbance: str = ""
    faults: bool = False

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
    """One effect as it acts in a site.

    Attributes
    ----------
    strength : str
        By its size; less than was asked for where no magnitude gives that.
    magnitude : float
        Value of its principal parameter.
    s0_m, s1_m : float
        Where it acts (m down the slope); infinite where everywhere.
    segments : tuple of str
        The reaches that it touches, such as "release-S1" or "S4-end"; all, if it acts everywhere.
    ground : str
        Class of ground that it is bound to; empty if none.
    size : float
        Standardised energy distance from the same site without it (0 to 1); NaN if not measured.
    seed : int
        Where its own random parts come from.
    """

    name: str
    strength: str
    magnitude: float
    s0_m: float
    s1_m: float
    segments: tuple[str, ...]
    ground: str = ""
    size: float = math.nan
    seed: int = 0

    @property
    def phase(self) -> str:
        """Of the motion: release, flight, impact, rolling; or observation."""
        return EFFECTS[self.name].phase


@dataclass(frozen=True, slots=True)
class Faults:
    """What the observers of a site do not see, or see wrongly; without values, nothing.

    Attributes
    ----------
    contact_min_normal_speed_mps, contact_min_interval_s : float
        Lighter contacts are not recorded, and those that follow sooner are taken for one.
    clipped_share : float
        Share of the rocks whose film begins late or ends early.
    stops_m : float
        Grid to which stops are rounded; 0 for none.
    axes_sd : float
        Relative error of semi-axes that are taken by eye.
    release_m : tuple of float
        Down the slope, of all release points together and of each (standard deviation).
    stated : tuple of str
        Which of the first three the metadata state.
    """

    contact_min_normal_speed_mps: float = 0.0
    contact_min_interval_s: float = 0.0
    passages_missed_share: float = 0.0
    clipped_share: float = 0.0
    stops_m: float = 0.0
    axes_sd: float = 0.0
    release_m: tuple[float, float] = (0.0, 0.0)
    stated: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class World:
    """A synthetic site.

    Attributes
    ----------
    relief : Relief
        The slope, without a terrace.
    survey : Grid
        The terrain model that the diagnosing side is given.
    true_grid : Grid
        The slope on which the rocks move.
    law : float64, shape (n_classes, 10) or (n_classes, 6)
        True parameters by class of ground: eta_max, dp_min, dp_max, mu_f, mu_0, k, d_star_m,
        restitution, restitution_speed_mps, rolling_threshold; in the rigid-body library those of
        ``rigid_bodies``.
    speed_loss : float
        Share of the speed that a contact at 10 m/s takes besides, about.
    edges_rad : float
        Scale of the tilt across the path that edges of the blocks make at contacts; real blocks
        leave their line so. In the rigid-body library corners do.
    ground : int64, shape of the grid
        Position in CLASSES of each cell, in truth.
    stations_s : float64, shape (n_stations,)
        Stations (m down the slope).
    releases : float64, shape (n_releases, 3)
        Release points x, y, z (m).
    blocks : dict
        Limits between which rocks are drawn, all uniform: semi-axes (m), density (kg/m³), speed
        (m/s) and drop (m). The diagnosing side knows them.
    effects : tuple of PlacedEffect
        The truth.
    """

    spec: WorldSpec
    seed: int
    relief: Relief
    survey: Grid
    true_grid: Grid
    law: FloatArray
    speed_loss: float
    ground: IntArray
    stations_s: FloatArray
    releases: FloatArray
    blocks: dict[str, tuple[float, float]]
    faults: Faults = Faults()
    edges_rad: float = 0.0
    effects: tuple[PlacedEffect, ...] = ()

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
    """Rocks before their release.

    Attributes
    ----------
    state : float64, shape (n, N_STATE)
        As the kernels take it; with the errors of the release, where the truth has them, and the
        time in the campaign at which each is released, 0 to 1.
    stated : float64, shape (n, 4)
        Release x, y, z of the centre (m) and speed (m/s) as they are written down.
    keys : uint64, shape (n,)
    """

    state: FloatArray
    stated: FloatArray
    keys: KeyArray


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
