"""Worlds: a made slope, rocks, and a truth that the diagnosing side is not told."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field, replace
from importlib import resources
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from scipy import ndimage

from sassgis.gap.check.worlds import motion
from sassgis.gap.check.worlds.forces import FAR, Forces, Local, Wind
from sassgis.gap.check.worlds.motion import Field, KeyArray, Tables
from sassgis.gap.check.worlds.slopes import CLASSES, Relief, guide, make_relief
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid, IntArray

Family = Literal[
    "lateral_deflection",
    "fragmentation",
    "soft_ground",
    "entrainment",
    "trees",
    "air_drag",
    "roughness",
    "rock_shape",
    "release_error",
    "measurement_error",
]
Unknown = Literal["wind", "snow", "ice", "wetting", "terrace", "magnus", "collisions"]
Strength = Literal["weak", "medium", "strong"]
FAMILIES: tuple[Family, ...] = get_args(Family)
UNKNOWNS: tuple[Unknown, ...] = get_args(Unknown)
STRENGTHS: tuple[Strength, ...] = get_args(Strength)

STEP_S = 0.002
N_STATIONS = 4
_N_RELEASES = 12

# Weakest and strongest magnitude that the search for a strength may try.
LIMITS: dict[str, tuple[float, float]] = {
    "lateral_deflection": (0.01, 1.2),
    "fragmentation": (0.01, 8.0),
    "soft_ground": (0.05, 30.0),
    "entrainment": (0.0005, 2.0),
    "trees": (0.01, 1.0),
    "air_drag": (2.0, 150.0),
    "roughness": (0.05, 5.0),
    "rock_shape": (0.03, 6.0),
    "release_error": (0.1, 15.0),
    "measurement_error": (0.01, 0.6),
    "wind": (0.05, 12.0),
    "snow": (0.01, 6.0),
    "ice": (0.02, 1.0),
    "wetting": (0.03, 0.9),
    "terrace": (0.1, 6.0),
    "magnus": (0.05, 3.0),
    "collisions": (0.01, 1.0),
}
_PHASES: dict[str, str] = {
    "lateral_deflection": "impact",
    "fragmentation": "impact",
    "soft_ground": "impact",
    "entrainment": "impact",
    "trees": "flight",
    "air_drag": "flight",
    "roughness": "impact",
    "rock_shape": "impact",
    "release_error": "release",
    "measurement_error": "observation",
    "wind": "flight",
    "snow": "rolling",
    "ice": "rolling",
    "wetting": "impact",
    "terrace": "impact",
    "magnus": "flight",
    "collisions": "rolling",
}


@dataclass(frozen=True, slots=True)
class EffectSpec:
    """One effect asked for.

    Attributes
    ----------
    name : str
        A family, or one of UNKNOWNS.
    strength : {"weak", "medium", "strong"}
    """

    name: Family | Unknown
    strength: Strength = "medium"

    def __post_init__(self) -> None:
        if self.name not in LIMITS:
            raise InputError(
                "unknown effect", field="name", found=self.name, expected=", ".join(LIMITS)
            )
        if self.strength not in STRENGTHS:
            raise InputError(
                "unknown strength",
                field="strength",
                found=self.strength,
                expected=", ".join(STRENGTHS),
            )


@dataclass(frozen=True, slots=True)
class WorldSpec:
    """What a world is to be.

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
    """

    slope: str
    effects: tuple[EffectSpec, ...] = ()
    n_rocks: int = 100
    kind: str = "both"

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
class Effect:
    """One effect as it acts in a world.

    Attributes
    ----------
    name : str
    strength : str
        By its size; less than was asked for where no magnitude gives that.
    magnitude : float
        Value of its principal parameter.
    phase : str
        release, flight, impact, rolling or observation.
    s0_m, s1_m : float
        Where it acts (m down the slope); infinite where everywhere.
    segments : tuple of str
        The legs that it touches, such as "release-S1" or "S4-end"; all, if it acts everywhere.
    ground : str
        Class of ground that it is bound to; empty if none.
    size : float
        Standardised energy distance from the same world without it (0 to 1); NaN if not measured.
    seed : int
        Where its own random parts come from.
    """

    name: str
    strength: str
    magnitude: float
    phase: str
    s0_m: float
    s1_m: float
    segments: tuple[str, ...]
    ground: str = ""
    size: float = math.nan
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Blocks:
    """Ranges from which rocks are drawn, all uniform: what the diagnosing side is told."""

    axis_1_m: tuple[float, float]
    axis_2_m: tuple[float, float]
    axis_3_m: tuple[float, float]
    density_kgm3: tuple[float, float]
    speed_mps: tuple[float, float]
    drop_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class World:
    """A made world.

    Attributes
    ----------
    spec : WorldSpec
    seed : int
    relief : Relief
        The slope as it is surveyed: the grid that the diagnosing side is given.
    true_grid : Grid
        The slope on which the rocks move; differs from the survey only where a terrace is missing.
    law : float64, shape (n_classes, 7)
        True parameters by class of ground: eta_max, dp_min, dp_max, mu_f, mu_0, k, d_star_m.
    stations_s : float64, shape (4,)
        Stations (m down the slope).
    releases : float64, shape (n_releases, 3)
        Release points x, y, z (m).
    blocks : Blocks
    effects : tuple of Effect
        The truth.
    """

    spec: WorldSpec
    seed: int
    relief: Relief
    true_grid: Grid
    law: FloatArray
    stations_s: FloatArray
    releases: FloatArray
    blocks: Blocks
    effects: tuple[Effect, ...] = ()
    _fields: dict[str, Field] = field(default_factory=dict, compare=False, repr=False)

    @property
    def station_names(self) -> tuple[str, ...]:
        """S1 to S4, from above."""
        return tuple(f"S{k + 1}" for k in range(len(self.stations_s)))

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the legs between release, stations and the end."""
        stops = ("release", *self.station_names, "end")
        return tuple(f"{a}-{b}" for a, b in pairwise(stops))

    def station_lines(self) -> FloatArray:
        """Stations as lines across the slope: x0, y0, x1, y1 (m), shape (4, 4)."""
        half = 80.0
        ax, ay = self.relief.frame.xy(self.stations_s, np.full(len(self.stations_s), -half))
        bx, by = self.relief.frame.xy(self.stations_s, np.full(len(self.stations_s), half))
        return np.column_stack([ax, ay, bx, by])


@dataclass(frozen=True, slots=True)
class Rocks:
    """Rocks before they are let go.

    Attributes
    ----------
    state : float64, shape (n, N_STATE)
        As the kernels take it; with the errors of the release, where the truth has them.
    stated : float64, shape (n, 4)
        Release x, y, z of the centre (m) and speed (m/s) as they are written down.
    keys : uint64, shape (n,)
    campaign : float64, shape (n,)
        When in the campaign each is let go, 0 to 1.
    """

    state: FloatArray
    stated: FloatArray
    keys: KeyArray
    campaign: FloatArray


@dataclass(frozen=True, slots=True)
class Run:
    """Everything that the rocks of a world did, without errors of measurement.

    Each table holds rock, number of the piece and kind of block before the columns named in
    ``sassgis.gap.check.worlds.motion``.
    """

    rocks: Rocks
    deposits: FloatArray
    passages: FloatArray
    impacts: FloatArray
    tracks: FloatArray
    energy_gain: FloatArray


def nominal_law() -> FloatArray:
    """Parameters of the classes as the package states them, in the order of CLASSES."""
    text = resources.files("sassgis").joinpath("data/ground_classes.csv").read_text("utf-8")
    rows = {row["name"]: row for row in csv.DictReader(text.splitlines())}
    names = ("eta_max", "dp_min", "dp_max", "mu_f", "mu_0", "k", "d_star_m")
    return np.array([[float(rows[name][key]) for key in names] for name in CLASSES])


def make_world(spec: WorldSpec, seed: int) -> World:
    """Draw a world; its effects are brought to the strengths that are asked for.

    Parameters
    ----------
    spec : WorldSpec
    seed : int
        Same specification and seed, same world.

    Raises
    ------
    InputError
        If the specification names a slope, an effect or a strength that there is not.
    """
    from sassgis.gap.check.worlds.strength import calibrated

    world = _base_world(spec, seed)
    for number, wanted in enumerate(spec.effects):
        effect = _place(world, wanted, seed + 7919 * (number + 1))
        world = with_effects(world, (*world.effects, calibrated(world, effect)))
    return with_effects(world, world.effects)


def with_effects(world: World, effects: tuple[Effect, ...]) -> World:
    """The same world with other effects."""
    grid = world.relief.grid
    for effect in effects:
        if effect.name == "terrace":
            grid = replace(grid, values=grid.values + _terrace(world, effect))
    same = _standing(effects) == _standing(world.effects)
    fields = world._fields if same else {}
    return replace(world, effects=effects, true_grid=grid, _fields=fields)


def _standing(effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """The effects that are part of the ground rather than of the motion."""
    return tuple(e for e in effects if e.name in ("trees", "collisions", "terrace"))


def _base_world(spec: WorldSpec, seed: int) -> World:
    relief = make_relief(spec.slope, seed)
    rng = np.random.default_rng([seed, 202])
    law = nominal_law()
    n = len(law)
    law[:, 0] = np.clip(law[:, 0] + rng.uniform(-0.06, 0.06, n), 0.2, 0.85)
    law[:, 1] = np.clip(law[:, 1] + rng.uniform(-0.05, 0.05, n), 0.0, 0.5)
    law[:, 2] = np.clip(law[:, 2] + rng.uniform(-0.08, 0.08, n), law[:, 1] + 0.05, 0.8)
    law[:, 3] += rng.uniform(-0.08, 0.08, n)
    law[:, 4] += rng.uniform(-0.06, 0.06, n)
    low, high = relief.release_s
    s = rng.uniform(low, high, _N_RELEASES)
    width = rng.uniform(10.0, 25.0)
    c = np.linspace(-width, width, _N_RELEASES)
    x, y = relief.frame.xy(s, c)
    size = rng.uniform(0.8, 1.25)
    blocks = Blocks(
        axis_1_m=(0.45 * size, 0.65 * size),
        axis_2_m=(0.35 * size, 0.48 * size),
        axis_3_m=(0.18 * size, 0.40 * size),
        density_kgm3=(2600.0, 2750.0),
        speed_mps=(0.5, 2.0),
        drop_m=(0.2, 1.0),
    )
    world = World(
        spec=spec,
        seed=seed,
        relief=relief,
        true_grid=relief.grid,
        law=law,
        stations_s=np.zeros(0),
        releases=np.column_stack([x, y, _heights(relief.grid, x, y)]),
        blocks=blocks,
    )
    # Stations where four fifths to a third of the rocks still pass, evenly over the distance.
    run = simulate(world, draw_rocks(world, 200, 11))
    ends = np.sort(relief.frame.s(run.deposits[:, 3], run.deposits[:, 4]))
    first = float(relief.breaks_m[2]) - rng.uniform(0.0, 6.0)
    last = max(float(np.quantile(ends, 0.65)), first + 30.0)
    return replace(world, stations_s=np.linspace(first, last, N_STATIONS), _fields={})


def _heights(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    col, row = grid.col_row(x, y)
    heights: FloatArray = ndimage.map_coordinates(grid.values, [row, col], order=1, mode="nearest")
    return heights


def draw_rocks(world: World, n: int, stream: int) -> Rocks:
    """Draw rocks; ``stream`` tells one campaign from another."""
    rng = np.random.default_rng([world.seed, 303, stream])
    u = rng.random((n, 9))

    def between(limits: tuple[float, float], column: int) -> FloatArray:
        drawn: FloatArray = limits[0] + (limits[1] - limits[0]) * u[:, column]
        return drawn

    blocks = world.blocks
    axes = np.column_stack(
        [
            between(blocks.axis_1_m, 0),
            between(blocks.axis_2_m, 1),
            between(blocks.axis_3_m, 2),
        ]
    )
    axes = -np.sort(-axes, axis=1)
    release = world.releases[np.arange(n) % len(world.releases)]
    speed = between(blocks.speed_mps, 4)
    stated = np.column_stack([release, speed])
    x, y, speed = release[:, 0].copy(), release[:, 1].copy(), speed.copy()
    wrong = _magnitude(world, "release_error")
    if wrong > 0.0:
        # The true places lie aside of those written down, and the rocks had been moving.
        offset = np.random.default_rng([world.seed, 404, stream])
        frame = world.relief.frame
        ds = np.abs(offset.normal(0.0, 0.25 * wrong, n))
        dc = offset.normal(0.5 * wrong, 0.8 * wrong, n)
        speed += 0.8 * wrong * offset.gamma(2.0, 0.5, n)
        x, y = frame.xy(frame.s(x, y) + ds, frame.c(x, y) + dc)
    gx, gy = guide(world.true_grid)
    hx, hy = -_sample(world.true_grid, gx, x, y), -_sample(world.true_grid, gy, x, y)
    length = np.hypot(hx, hy)
    dip = np.arctan(length)
    state = np.zeros((n, motion.N_STATE))
    state[:, motion.X], state[:, motion.Y] = x, y
    state[:, motion.Z] = (
        _heights(world.true_grid, x, y) + axes[:, 0] / np.cos(dip) + between(blocks.drop_m, 5)
    )
    # Written down is where the centre was when it was let go: as high above the stated place.
    stated[:, 2] += state[:, motion.Z] - _heights(world.true_grid, x, y)
    state[:, motion.HX], state[:, motion.HY] = hx / length, hy / length
    state[:, motion.VX] = speed * np.cos(dip) * state[:, motion.HX]
    state[:, motion.VY] = speed * np.cos(dip) * state[:, motion.HY]
    state[:, motion.VZ] = -speed * np.sin(dip)
    state[:, motion.PHI] = math.pi * u[:, 6]
    state[:, motion.A : motion.C + 1] = axes
    state[:, motion.DENSITY] = between(blocks.density_kgm3, 3)
    state[:, motion.HAND] = np.where(u[:, 7] < 0.5, -1.0, 1.0)
    keys = rng.integers(0, 2**63, n, dtype=np.uint64)
    return Rocks(state, stated, keys, (np.arange(n) + 0.5) / n)


def _sample(grid: Grid, values: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    return _heights(replace(grid, values=values), x, y)


def simulate(world: World, rocks: Rocks, dt: float = STEP_S) -> Run:
    """Let rocks go in a world.

    Parameters
    ----------
    dt : float
        Time step (s).
    """
    if "field" not in world._fields:
        world._fields["field"] = _field(world)
    n = len(rocks.state)
    room = np.array([4 * n + 64, 12 * n + 64, 80 * n + 64, 400 * n + 64])
    while True:
        tables = Tables(
            deposits=np.zeros((room[0], 3 + len(motion.DEPOSIT_COLUMNS))),
            passages=np.zeros((room[1], 3 + len(motion.PASSAGE_COLUMNS))),
            impacts=np.zeros((room[2], 3 + len(motion.IMPACT_COLUMNS))),
            tracks=np.zeros((room[3], 3 + len(motion.TRACK_COLUMNS))),
            used=np.zeros(4, np.int64),
            gain=np.full(n, -1.0),
        )
        motion.run_rocks(
            world._fields["field"],
            forces_of(world),
            rocks.state,
            rocks.keys,
            rocks.campaign,
            dt,
            tables,
        )
        if (tables.used <= room).all():
            break
        room = np.maximum(room, tables.used)
    d, p, i, t = (int(k) for k in tables.used)
    return Run(
        rocks,
        tables.deposits[:d],
        tables.passages[:p],
        tables.impacts[:i],
        tables.tracks[:t],
        tables.gain,
    )


def _magnitude(world: World, name: str) -> float:
    return max((e.magnitude for e in world.effects if e.name == name), default=0.0)


def forces_of(world: World) -> Forces:
    """The effects of a world as the kernels take them."""
    slots = {
        "lateral_deflection": "facets",
        "fragmentation": "breaking",
        "soft_ground": "soft",
        "entrainment": "loose",
        "air_drag": "air",
        "roughness": "bumps",
        "rock_shape": "plates",
        "snow": "snow",
        "ice": "ice",
        "wetting": "wet",
        "magnus": "magnus",
    }
    found: dict[str, Local] = {}
    wind = Wind()
    for effect in world.effects:
        if effect.name in slots:
            local = Local(float(effect.magnitude), float(effect.s0_m), float(effect.s1_m))
            found[slots[effect.name]] = local
        elif effect.name == "wind":
            turn = np.random.default_rng([effect.seed, 5]).uniform(0.5, 1.2)
            sign = 1.0 if effect.seed % 2 else -1.0
            frame = world.relief.frame
            c, s = math.cos(sign * turn), math.sin(sign * turn)
            x, y = c * frame.ux - s * frame.uy, s * frame.ux + c * frame.uy
            wind = Wind(float(effect.magnitude), float(x), float(y))
    return Forces(**found, wind=wind)


def _field(world: World) -> Field:
    grid = world.true_grid
    gx, gy = guide(grid)
    obstacles = _obstacles(world)
    start, near = _by_cell(grid, obstacles)
    frame = world.relief.frame
    return Field(
        np.ascontiguousarray(grid.values),
        gx,
        gy,
        float(grid.west),
        float(grid.north),
        float(grid.cell_size),
        world.relief.ground,
        world.law,
        frame.x0,
        frame.y0,
        frame.ux,
        frame.uy,
        np.ascontiguousarray(world.stations_s),
        start,
        near,
        obstacles,
    )


def _obstacles(world: World) -> FloatArray:
    """Stems and lying blocks: x, y, radius (m), capacity (J), height (m), mass (kg)."""
    rows = []
    for effect in world.effects:
        if effect.name not in ("trees", "collisions"):
            continue
        rng = np.random.default_rng([effect.seed, 606])
        frame, belt = world.relief.frame, (effect.s0_m, effect.s1_m)
        spacing = 1.6 if effect.name == "trees" else 1.8
        s, c = _scatter(rng, belt, 70.0, spacing)
        # Thinning by rank: a denser stand holds all the stems of a lighter one.
        rank = rng.random(len(s))
        keep = rank < effect.magnitude
        x, y = frame.xy(s, c)
        size = rng.standard_normal(len(s))
        if effect.name == "trees":
            dbh = np.clip(0.28 * np.exp(0.4 * size), 0.08, 0.9)
            # A green stem bends plastically until its fibres fail: energy as the cube of DBH.
            capacity = 2.2e6 * dbh**3
            row = [x, y, 0.5 * dbh, capacity, np.full(len(s), 1e3), np.zeros(len(s))]
        else:
            radius = np.clip(0.4 * np.exp(0.3 * size), 0.2, 0.9)
            mass = 2700.0 * 4.0 / 3.0 * math.pi * radius**3
            row = [x, y, radius, np.full(len(s), 1e12), 1.6 * radius, mass]
        rows.append(np.column_stack(row)[keep])
    return np.concatenate(rows) if rows else np.zeros((0, 6))


def _scatter(
    rng: np.random.Generator, belt: tuple[float, float], half_width: float, spacing: float
) -> tuple[FloatArray, FloatArray]:
    """Points no nearer to each other than ``spacing``: a Poisson-disc process by darts."""
    low, high = belt
    cell = spacing / math.sqrt(2.0)
    n_s = int((high - low) / cell) + 1
    n_c = int(2.0 * half_width / cell) + 1
    taken = np.full((n_s + 4, n_c + 4, 2), 1e9)
    tries = 4 * n_s * n_c // 2
    darts = np.column_stack(
        [rng.uniform(low, high, tries), rng.uniform(-half_width, half_width, tries)]
    )
    kept = []
    for s, c in darts:
        i, j = int((s - low) / cell) + 2, int((c + half_width) / cell) + 2
        around = taken[i - 2 : i + 3, j - 2 : j + 3]
        if ((around[..., 0] - s) ** 2 + (around[..., 1] - c) ** 2 < spacing**2).any():
            continue
        taken[i, j] = s, c
        kept.append((s, c))
    points = np.array(kept).reshape(-1, 2)
    return points[:, 0], points[:, 1]


def _by_cell(grid: Grid, obstacles: FloatArray) -> tuple[IntArray, IntArray]:
    """For each cell the obstacles that a rock in it may reach: offsets and numbers."""
    n_rows, n_cols = grid.shape
    if not len(obstacles):
        return np.zeros(n_rows * n_cols + 1, np.int64), np.zeros(0, np.int64)
    col = np.floor((obstacles[:, 0] - grid.west) / grid.cell_size).astype(np.int64)
    row = np.floor((grid.north - obstacles[:, 1]) / grid.cell_size).astype(np.int64)
    cells, numbers = [], []
    for di in (-1, 0, 1):
        for dj in (-1, 0, 1):
            i, j = row + di, col + dj
            inside = (i >= 0) & (i < n_rows) & (j >= 0) & (j < n_cols)
            cells.append((i * n_cols + j)[inside])
            numbers.append(np.flatnonzero(inside))
    cell, number = np.concatenate(cells), np.concatenate(numbers)
    order = np.lexsort((number, cell))
    start = np.searchsorted(cell[order], np.arange(n_rows * n_cols + 1))
    return start.astype(np.int64), number[order].astype(np.int64)


def _terrace(world: World, effect: Effect) -> FloatArray:
    """What a terrace adds to the surveyed heights: cut at the back, filled at the front (m)."""
    grid = world.relief.grid
    x, y = grid.cell_centres(np.arange(grid.values.size))
    s = world.relief.frame.s(x, y)
    u = (s - effect.s0_m) / (effect.s1_m - effect.s0_m)
    wave = np.where((u > 0.0) & (u < 1.0), -np.sin(2.0 * np.pi * u) * np.sin(np.pi * u), 0.0)
    added: FloatArray = effect.magnitude * wave.reshape(grid.shape)
    return added


def _place(world: World, wanted: EffectSpec, seed: int) -> Effect:
    """Say where an effect acts."""
    rng = np.random.default_rng([seed, 707])
    breaks = world.relief.breaks_m
    grounds = world.relief.stretches
    low, high = -FAR, FAR
    ground = ""
    # The stretches below the cliffs: where rocks lie, trees stand and ground is soft.
    below = [k for k, name in enumerate(grounds) if name in ("debris", "talus", "forest_soil")]
    meadow = next(k for k, name in enumerate(grounds) if name == "soft_meadow")
    first, last = float(world.stations_s[0]), float(world.stations_s[-1])
    if wanted.name == "soft_ground":
        # Wet meadow, and the foot of the slope above it.
        low = min(float(breaks[meadow]) - 15.0, 0.5 * float(world.stations_s[1:3].sum()))
        high = FAR
        ground = "soft_meadow"
    elif wanted.name == "trees":
        low = float(breaks[below[0]]) + rng.uniform(0.0, 25.0)
        high = min(float(breaks[meadow]) + 10.0, low + rng.uniform(45.0, 90.0))
    elif wanted.name in ("entrainment", "roughness"):
        low, high = float(breaks[below[0]]), float(breaks[meadow])
        if wanted.name == "roughness":
            # Blocks of the slope also strew the edge of the meadow.
            high += 20.0
        ground = grounds[below[0]]
    elif wanted.name in ("snow", "ice", "collisions"):
        low = rng.uniform(float(world.stations_s[0]), float(world.stations_s[1]))
        high = FAR if wanted.name == "snow" else float(breaks[-1])
    elif wanted.name == "terrace":
        low = rng.uniform(first + 5.0, max(first + 6.0, 0.6 * first + 0.4 * last))
        high = low + rng.uniform(14.0, 22.0)
    return Effect(
        name=wanted.name,
        strength=wanted.strength,
        magnitude=0.0,
        phase=_PHASES[wanted.name],
        s0_m=low,
        s1_m=high,
        segments=_touched(world, wanted.name, low, high),
        ground=ground,
        seed=seed,
    )


def _touched(world: World, name: str, low: float, high: float) -> tuple[str, ...]:
    if name == "release_error":
        return (world.segments[0],)
    edges = np.concatenate(([-math.inf], world.stations_s, [math.inf]))
    return tuple(
        segment
        for segment, start, end in zip(world.segments, edges[:-1], edges[1:], strict=True)
        if low < end and high > start
    )
