"""Rocks and effects of synthetic sites."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sassgis.gap.check.worlds import EffectSpec
from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds.make import place_effect
from sassgis.gap.check.worlds.world import Run, World, WorldRocks, with_effects

TABLES = ("deposits", "passages", "impacts", "tracks")


def with_effect(world: World, name: str, magnitude: float) -> World:
    """The site with one effect of a given magnitude, not calibrated."""
    effect = place_effect(world, EffectSpec(name), 5)
    return with_effects(world, (replace(effect, magnitude=magnitude),))


def some(rocks: WorldRocks, rows: list[int]) -> WorldRocks:
    """Rocks of those numbers."""
    return WorldRocks(rocks.state[rows], rocks.stated[rows], rocks.keys[rows])


def mass_is_kept(run: Run, least: int) -> bool:
    """Whether no rock stops with more mass than it had, and ``least`` of them with all of it.

    A few pieces leave the terrain.
    """
    state, stops = run.rocks.state, run.deposits
    mass = state[:, ms.DENSITY] * 4 / 3 * math.pi * state[:, [ms.A, ms.B, ms.C]].prod(axis=1)
    stopped = np.bincount(stops[:, 0].astype(int), stops[:, 6], minlength=len(mass))
    whole = (stopped > mass * (1 - 1e-9)).sum() >= least
    return bool((stopped < mass * (1 + 1e-9)).all() and whole)
