"""Short ways to make profiles, grounds and runs for the tests of the engine."""

from __future__ import annotations

import dataclasses

import numpy as np
from helpers.effects_lab import (  # noqa: F401 - for the tests
    END,
    FLIGHT,
    IMPACT,
    MIXED,
    PAPER,
    ROLLING,
    SLIDING,
    ellipsoid,
    sphere,
)

from sassgis.engine.simulate import simulate
from sassgis.model.ground import GroundClass, GroundTable
from sassgis.model.profiles import ProfileSet
from sassgis.model.settings import EngineSettings


def ground(
    name="ground", eta_max=0.7, dp=(0.0, 0.0), mu_f=0.8, mu_0=0.5, k=0.0, d_star_m=0.0, **more
) -> GroundClass:
    return GroundClass(
        name,
        eta_max=eta_max,
        dp_min=dp[0],
        dp_max=dp[1],
        mu_f=mu_f,
        mu_0=mu_0,
        k=k,
        d_star_m=d_star_m,
        **more,
    )


#: The settings that are for hazard work, which are the usual ones.
HAZARD = EngineSettings()
#: Table 1 of Bozzolo and Pamini (1986), with frictions from the middle of their ranges.
ROCK = ground("rock", 0.70, (0.0, 0.3), 0.8, 0.5, 0.2, 0.2)
DEBRIS = ground("debris", 0.55, (0.2, 0.6), 0.8, 0.5, 0.2, 0.3)


def profile_set(*lines, classes=None, cell=2.0) -> ProfileSet:
    """Profiles from (s, z) pairs; cells are stretches of equal length, numbered line by line."""
    offset, cell_offset = [0], [0]
    all_s, all_z, all_ground, all_borders, all_cells = [], [], [], [], []
    number = 0
    for i, (s, z) in enumerate(lines):
        s = np.asarray(s, float)
        z = np.asarray(z, float)
        borders = np.append(np.arange(s[0], s[-1] - 1e-9, cell), s[-1])
        own = np.zeros(s.size, np.int32) if classes is None else np.asarray(classes[i], np.int32)
        all_s.append(s)
        all_z.append(z)
        all_ground.append(own)
        all_borders.append(borders)
        all_cells.append(np.arange(number, number + borders.size - 1))
        number += borders.size - 1
        offset.append(offset[-1] + s.size)
        cell_offset.append(cell_offset[-1] + borders.size - 1)
    return ProfileSet(
        np.array(offset),
        np.concatenate(all_s),
        np.concatenate(all_z),
        np.concatenate(all_ground),
        np.array(cell_offset),
        np.concatenate(all_borders),
        np.concatenate(all_cells).astype(np.int64),
    )


def slope(*parts, top=1000.0, start=0.0):
    """(s, z) of a profile from (chainage length, angle below the horizontal in degrees)."""
    ds = np.array([p[0] for p in parts], float)
    dz = -ds * np.tan(np.radians([p[1] for p in parts]))
    s = np.concatenate([[0.0], np.cumsum(ds)]) + start
    return s, np.concatenate([[0.0], np.cumsum(dz)]) + top


def run(lines, table, blocks, *, n=1, seed=1, start=None, settings=None, keys=None, **more):
    """``simulate`` with defaults for tests; ``lines`` is a ProfileSet or one (s, z) pair."""
    profiles = lines if isinstance(lines, ProfileSet) else profile_set(lines)
    count = len(profiles)
    if isinstance(table, GroundClass):
        table = GroundTable((table,))
    if start is None:
        start = [(profiles.vertices(i)[0][0] + 5.0,) * 2 for i in range(count)]
    starts = np.broadcast_to(np.asarray(start, float), (count, 2))
    return simulate(
        profiles,
        table,
        blocks,
        settings or PAPER,
        seed=seed,
        rocks_per_line=n,
        line_keys=np.arange(count, dtype=np.uint64) if keys is None else keys,
        starts=starts,
        **more,
    )


def with_settings(**changes) -> EngineSettings:
    """The words of the paper with changes."""
    return dataclasses.replace(PAPER, **changes)


def rough(seed, step=0.5, length=120.0, angle=36.0, amplitude=0.15, foot=40.0):
    """A rough slope with a flat foot, segments of ``step``; (s, z)."""
    rng = np.random.default_rng(seed)
    s = np.arange(0.0, length + foot + step, step)
    z = -np.tan(np.radians(angle)) * np.minimum(s, length)
    noise = rng.normal(0.0, amplitude, s.size)
    return s, z + noise + 1000.0


def valley():
    """A smooth slope that flattens step by step: 30, 65, 36, 18 and 0 degrees."""
    return slope((50, 30), (10, 65), (140, 36), (200, 18), (300, 0))
