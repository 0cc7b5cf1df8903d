"""Rocks that are released in a site, and what they do, by whatever law."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from gap_check.slopes import FloatArray
from gap_check.worlds import World

#: What a block in a table is: the rock itself, a piece of it, or a block that it set in motion.
ROCK, FRAGMENT, LOOSENED = 0, 1, 2
WHO = ["rock", "piece", "block"]  # ``block``: one of those three
#: Columns of each table of a run (SI units; spins in rad/s forward rolling, turns in degrees
#: clockwise; ``height_m`` of the centre above the ground).
TABLES = {
    "deposits": [*WHO, "x", "y", "z", "mass_kg", "volume_m3"],
    "passages": [
        *WHO, "station", "x", "y", "z", "speed_mps", "rotation_hz", "height_m", "mass_kg",
    ],
    "impacts": [
        *WHO, "impact", "x", "y", "z", "slope_deg", "vt_in_mps", "vn_in_mps", "omega_in_radps",
        "vt_out_mps", "vn_out_mps", "omega_out_radps", "turn_deg", "mass_kg", "t_s",
    ],
    "tracks": [*WHO, "t_s", "x", "y", "z", "speed_mps", "rotation_hz"],
}  # fmt: skip
#: Between two rows of a film (s).
FILM_S = 0.1
#: Errors of the release from the weakest to the strongest (m).
_RELEASE_M = (0.3, 15.0)


@dataclass(frozen=True, slots=True)
class Rocks:
    """Rocks before their release; all arrays have a row for each."""

    place: FloatArray  # true x, y, z of the centre (m), shape (n, 3)
    speed: FloatArray  # true, down the slope (m/s)
    drop: FloatArray  # above the resting position (m)
    tilt: FloatArray  # of the longest axis to the slope (rad)
    axes: FloatArray  # semi-axes, longest first (m), shape (n, 3)
    density: FloatArray  # (kg/m³)
    stated: FloatArray  # x, y, z of the centre and speed as they are written down, shape (n, 4)
    seed: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.speed)

    @property
    def volume(self) -> FloatArray:
        """Of the ellipsoids (m³)."""
        found: FloatArray = 4.0 / 3.0 * math.pi * self.axes.prod(axis=1)
        return found


@dataclass(frozen=True, slots=True)
class Run:
    """Everything that the rocks of a site did, without errors of measurement: see TABLES."""

    rocks: Rocks
    deposits: pd.DataFrame
    passages: pd.DataFrame
    impacts: pd.DataFrame
    tracks: pd.DataFrame


def draw_rocks(world: World, n: int, stream: int) -> Rocks:
    """Draw rocks; ``stream`` distinguishes campaigns."""
    rng = np.random.default_rng([world.seed, 303, stream])
    u = rng.random((n, 7))

    def between(name: str, column: int) -> FloatArray:
        low, high = world.blocks[name]
        return low + (high - low) * u[:, column]

    axes = -np.sort(-np.column_stack([between(f"axis_{k + 1}_m", k) for k in range(3)]), axis=1)
    flat = world.effect("rock_shape")
    if flat is not None and world.spec.law != "own":
        # In three dimensions the effect is in the rocks: flat ones are flatter, of equal volume.
        thin = np.maximum((axes[:, 2] / axes[:, 0]) ** flat.between(0.05, 3.0), 0.25)
        axes *= np.column_stack([thin**-0.5, thin**-0.5, thin])
    release = world.releases[np.arange(n) % len(world.releases)]
    speed, drop, tilt = between("speed_mps", 4), between("drop_m", 5), math.pi * u[:, 6]
    x, y, faster = _true_places(world, release, stream)
    gx, gy = world.surface.gradient_at(x, y)
    rest = np.hypot(axes[:, 0] * np.sin(tilt), axes[:, 1] * np.cos(tilt))
    above = rest * np.sqrt(1.0 + gx**2 + gy**2) + drop
    # Written down is where the centre was when it was released: as high above the stated place.
    stated = np.column_stack([release[:, :2], release[:, 2] + above, speed])
    place = np.column_stack([x, y, world.surface.at(x, y) + above])
    density = between("density_kgm3", 3)
    return Rocks(place, speed + faster, drop, tilt, axes, density, stated, (world.seed, stream))


def _true_places(
    world: World, release: FloatArray, stream: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where rocks start, and how much faster than stated: where the release is wrong, elsewhere."""
    x, y, n = release[:, 0], release[:, 1], len(release)
    effect = world.effect("release_error")
    if effect is None:
        return x, y, np.zeros(n)
    wrong = effect.between(*_RELEASE_M)
    rng = np.random.default_rng([world.seed, 404, stream])
    side = np.random.default_rng([world.seed, 405]).uniform(-0.5, 0.5) * math.pi
    ds = np.abs(rng.normal(wrong * math.cos(side), 0.4 * wrong, n))
    dc = rng.normal(wrong * math.sin(side), 0.4 * wrong, n)
    frame = world.relief.frame
    x, y = frame.xy(frame.s(x, y) + ds, frame.c(x, y) + dc)
    return x, y, 0.8 * wrong * rng.gamma(2.0, 0.5, n)


def simulate(world: World, rocks: Rocks) -> Run:
    """Release rocks in a site."""
    # Each generator is loaded alone: neither needs the other.
    if world.spec.law == "own":
        from gap_check.engine_rocks import run_rocks
    else:
        from gap_check.mujoco_rocks import run_rocks
    run = run_rocks(world, rocks)
    return replace(run, **{name: getattr(run, name).reset_index(drop=True) for name in TABLES})


def table_of(name: str, rows: list[tuple[float, ...]]) -> pd.DataFrame:
    """Rows as one of TABLES, all columns numbers."""
    columns = TABLES[name]
    return pd.DataFrame(np.array(rows, float).reshape(-1, len(columns)), columns=columns).astype(
        {key: int for key in (*WHO, "station", "impact") if key in columns}
    )
