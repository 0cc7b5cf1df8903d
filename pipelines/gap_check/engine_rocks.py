"""Sites whose rocks move by the engine of the program, with other parameters than it is told."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gap_check.motion import FILM_S, FRAGMENT, LOOSENED, ROCK, Rocks, Run, table_of
from gap_check.slopes import CLASSES, FloatArray, IntArray
from gap_check.worlds import PlacedEffect, World
from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.effects.rock_shape import RockShape
from sassgis.engine.effects.roughness import Roughness
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.effects.trees import Trees
from sassgis.engine.effects.wind import Wind
from sassgis.engine.simulate import Simulated
from sassgis.engine.simulate_paths import PathTerrain, follow
from sassgis.gap.forward.observation_operator import film, impacts_of, turns_of
from sassgis.grid import Grid
from sassgis.inputs.ground_map import built_in_table
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.ground import GroundClass, GroundTable
from sassgis.settings.map_run import Forest
from sassgis.settings.results import ControlLine, ReleasePoints, StopReason
from sassgis.settings.settings import EngineSettings
from sassgis.terrain.release import point_keys

#: Largest vertical gap between terrain and segments (m).
_TOLERANCE_M = 0.05
_LOGGED = 600
_DBH_M = 0.28
_LOOSE_SIZE = 0.4
#: True parameters of a class differ from the built-in ones by up to this, uniformly.
_SPREAD = {
    "eta_max": 0.06, "dp_min": 0.05, "dp_max": 0.08, "mu_f": 0.08,
    "restitution": 0.08,
}  # fmt: skip
_LIMITS = {"eta_max": (0.2, 1.0), "dp_min": (0.0, 0.5), "restitution": (0.0, 0.9)}

_FILMED = ["t_s", "x", "y", "z", "speed_mps", "rotation_hz"]

#: Each effect by its share of the way from its weakest to its strongest parameter.
_SETTINGS: dict[str, Callable[[PlacedEffect], Any]] = {
    "lateral_deflection": lambda e: LateralDeflection(angle_deg=e.between(1.0, 45.0)),
    "fragmentation": lambda e: Fragmentation(energy_jkg=e.between(600.0, 5.0)),
    "soft_ground": lambda e: SoftGround(
        form="slip", classes=(e.ground,), friction=e.between(1.0, 0.02)
    ),
    "entrainment": lambda e: Entrainment(
        number=e.between(0.01, 3.0), size_ratio=_LOOSE_SIZE, classes=(e.ground,)
    ),
    "trees": lambda _: Trees(),
    "air_drag": lambda e: AirDrag(drag_coefficient=e.between(0.5, 2.5)),
    "roughness": lambda e: Roughness(obstacle_m=e.between(0.03, 3.0), classes=(e.ground,)),
    "rock_shape": lambda e: RockShape(strength=e.between(0.1, 6.0)),
    "wind": lambda e: Wind(acceleration_mps2=(1 if e.seed % 2 else -1) * e.between(0.1, 5.0)),
}


def run_rocks(world: World, rocks: Rocks) -> Run:
    """Release rocks; what they spawn is theirs."""
    own = world.surface
    grid = Grid(own.z, own.west, own.north, own.cell_m, crs="EPSG:2056", vertical_datum="LN02")
    lines = world.station_lines().reshape(-1, 2, 2)
    stations = [(ControlLine(f"S{k + 1}", "station"), line) for k, line in enumerate(lines)]
    keys = point_keys("/".join(map(str, rocks.seed)), len(rocks))
    done = follow(
        PathTerrain(grid, _ground(world), _TOLERANCE_M, stations, _forest(world)),
        ReleasePoints(
            rocks.place[:, 0], rocks.place[:, 1], np.zeros(len(rocks), np.int64), keys,
            ("release",),
        ),
        true_table(world),
        _blocks(rocks),
        EngineSettings(),
        seed=world.seed % 2**31,
        rocks_per_point=1,
        point_keys=keys,
        log_events=_LOGGED,
        effects=EffectSettings(
            *(_SETTINGS[e.name](e) for e in world.effects if e.name in _SETTINGS)
        ),
    )  # fmt: skip
    events, index, hit = impacts_of(done.event_logs)
    return Run(
        rocks,
        _deposits(world, rocks, done),
        _passages(world, rocks, done),
        _impacts(world, rocks, grid, events, index, hit),
        _tracks(grid, events, index),
    )


def true_table(world: World) -> GroundTable:
    """Ground classes of a site: the built-in ones with other values, and ice as the last."""
    rng = np.random.default_rng([world.seed, 202])
    built_in = built_in_table()
    classes = []
    for name in CLASSES:
        own = built_in.classes[built_in.index(name)]
        new = {key: getattr(own, key) + rng.uniform(-d, d) for key, d in _SPREAD.items()}
        new |= {key: float(np.clip(new[key], *limits)) for key, limits in _LIMITS.items()}
        new["mu_0"] = own.mu_0 * math.exp(rng.uniform(-0.3, 0.3)) + rng.uniform(0.0, 0.05)
        new["dp_max"] = max(new["dp_max"], new["dp_min"] + 0.05)
        lost = rng.uniform(0.02, 0.08)
        if world.spec.disturbance == "speed_loss":
            new["mu_v"] = own.mu_v + lost
        classes.append(replace(own, **new))
    ice = GroundClass(
        "ice", eta_max=0.9, dp_min=0.0, dp_max=0.1, mu_f=0.1, mu_0=0.05, k=0.0, d_star_m=0.0,
        restitution=0.4,
    )  # fmt: skip
    return GroundTable((*classes, ice))


def _ground(world: World) -> NDArray[np.int32]:
    """Classes of the cells; ice lies on some of them between its ends."""
    ground, ice = world.ground.astype(np.int32), world.effect("ice")
    if ice is not None:
        s = world.relief.s_of_cells()
        lenses = np.random.default_rng([ice.seed, 606]).random(s.shape) < ice.between(0.02, 1.0)
        ground[(s > ice.s0_m) & (s < ice.s1_m) & lenses] = len(CLASSES)
    return ground


def _forest(world: World) -> Forest | None:
    trees = world.effect("trees")
    if trees is None:
        return None
    s = world.relief.s_of_cells().ravel()
    inside = (s > trees.s0_m) & (s < trees.s1_m)
    return Forest(
        np.where(inside, trees.between(20.0, 4000.0) / 1e4, 0.0), np.where(inside, _DBH_M, 0.0)
    )


def _blocks(rocks: Rocks) -> list[BlockPopulation]:
    values = np.column_stack([rocks.axes, rocks.density, rocks.speed, rocks.drop, rocks.tilt])
    names = ("axis_1_m", "axis_2_m", "axis_3_m", "density_kgm3", "speed_mps", "drop_m",
             "orientation_rad")  # fmt: skip
    return [
        BlockPopulation(**{k: (v, v) for k, v in zip(names, row, strict=True)})
        for row in values.tolist()
    ]


def _who(world: World, rocks: Rocks, rows: NDArray[np.void], piece: IntArray) -> pd.DataFrame:
    """Rock, number of the piece, and whether it broke off or was set in motion."""
    whole = (rocks.volume * rocks.density)[rows["line"]]
    loose = np.abs(rows["mass_kg"] / whole / _LOOSE_SIZE**3 - 1.0) < 1e-6
    if world.effect("entrainment") is None:
        loose[:] = False
    other = np.where(loose, LOOSENED, FRAGMENT)
    # A passage has no number of its piece: those of equal mass are one.
    return pd.DataFrame(
        {"rock": rows["line"], "piece": piece, "block": np.where(piece == 0, ROCK, other)}
    )


def _deposits(world: World, rocks: Rocks, done: Simulated) -> pd.DataFrame:
    rows = np.concatenate([done.rocks, done.pieces])
    left = ~np.isin(rows["reason"], (StopReason.BROKEN, StopReason.LEFT_PROFILE))
    rows, x, y = rows[left], done.x[left], done.y[left]
    table = _who(world, rocks, rows, rows["piece"].astype(np.int64))
    volume = rows["mass_kg"] / rocks.density[rows["line"]]
    return table.assign(x=x, y=y, z=world.surface.at(x, y), mass_kg=rows["mass_kg"],
                        volume_m3=volume)  # fmt: skip


def _passages(world: World, rocks: Rocks, done: Simulated) -> pd.DataFrame:
    rows = done.passages
    whole = (rocks.volume * rocks.density)[rows["line"]]
    apart = rows["mass_kg"] < whole * (1.0 - 1e-9)
    # A passage has no number of its piece, its mass tells it.
    piece = np.where(apart, _pieces_by_mass(done, rows), 0)
    table = _who(world, rocks, rows, piece)
    x, y = rows["x_m"], rows["y_m"]
    gx, gy = world.surface.gradient_at(x, y)
    size = np.cbrt(rows["mass_kg"] / whole)
    # Counted from where the block would lie.
    rest = rocks.axes[rows["line"], 1] * size * np.sqrt(1.0 + gx**2 + gy**2)
    height = rows["height_m"] + rest
    return table.assign(
        station=rows["control_line"].astype(np.int64), x=x, y=y, z=world.surface.at(x, y) + height,
        speed_mps=rows["speed_mps"], rotation_hz=np.abs(rows["rotation_hz"]), height_m=height,
        mass_kg=rows["mass_kg"],
    )  # fmt: skip


def _pieces_by_mass(done: Simulated, rows: NDArray[np.void]) -> IntArray:
    """Number of the piece of the same rock with the same mass; the first of several."""
    numbers: dict[tuple[int, float], int] = {}
    for own in done.pieces:
        numbers.setdefault((int(own["line"]), float(own["mass_kg"])), int(own["piece"]))
    keys = zip(rows["line"].tolist(), rows["mass_kg"].tolist(), strict=True)
    return np.array([numbers.get(key, 1) for key in keys], np.int64)


def _impacts(
    world: World, rocks: Rocks, grid: Grid, events: NDArray[np.void], index: IntArray, hit: IntArray
) -> pd.DataFrame:
    """Impacts of whole rocks, taken apart along the ground."""
    before, after, rock = events[hit], events[hit + 1], index[hit]
    x, y = _places(grid, before)
    turn, azimuth = turns_of(events, index, hit)
    gx, gy = world.surface.gradient_at(x, y)
    dip = np.arctan(gx * np.cos(azimuth) + gy * np.sin(azimuth))
    cosine, sine = np.cos(dip), np.sin(dip)
    off = (before["z_m"] - world.surface.at(x, y)) * cosine
    sides = {}
    for side, event in (("in", before), ("out", after)):
        vx, vz = event["vx_mps"], event["vz_mps"]
        sides[f"vt_{side}_mps"] = vx * cosine + vz * sine
        sides[f"vn_{side}_mps"] = vz * cosine - vx * sine
        sides[f"omega_{side}_radps"] = event["omega_radps"]
    first = pd.Series(rock).groupby(rock).cumcount().to_numpy() + 1
    return pd.DataFrame(
        {
            "rock": rock, "piece": 0, "block": ROCK, "impact": first,
            "x": x + off * sine * np.cos(azimuth), "y": y + off * sine * np.sin(azimuth),
            "z": before["z_m"] - off * cosine, "slope_deg": -np.degrees(dip), **sides,
            "turn_deg": -np.degrees(turn), "mass_kg": (rocks.volume * rocks.density)[rock],
            "t_s": before["t_s"],
        }
    )  # fmt: skip


def _tracks(grid: Grid, events: NDArray[np.void], index: IntArray) -> pd.DataFrame:
    """Films of whole rocks."""
    x, y = _places(grid, events)
    tables = [table_of("tracks", [])]
    ends = np.searchsorted(index, np.arange(index.max(initial=-1) + 2))
    for rock, (first, last) in enumerate(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)):
        own = slice(first, last)
        points = pd.DataFrame(film(events[own], x[own], y[own], FILM_S).T, columns=_FILMED)
        tables.append(points.assign(rock=rock, piece=0, block=ROCK))
    return pd.concat(tables)


def _places(grid: Grid, events: NDArray[np.void]) -> tuple[FloatArray, FloatArray]:
    """X and y of events (m)."""
    x: FloatArray = grid.west + events["u"] * grid.cell_size
    y: FloatArray = grid.north - events["v"] * grid.cell_size
    return x, y
