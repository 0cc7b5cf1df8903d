"""Synthetic sites with a known truth, on which a diagnosis of the sim-to-real gap is checked.

This room shares no code with the engine: the same base law, written anew, in small time steps, and
effects of nature in other functional forms than those that a diagnosis would try.
"""

from sassgis.gap.check.worlds.battery import battery, quick_battery, world_seeds
from sassgis.gap.check.worlds.make import make_world
from sassgis.gap.check.worlds.observe import ObservedTables, SiteSetup, fresh_rocks, observe, setup
from sassgis.gap.check.worlds.rigid import require_library
from sassgis.gap.check.worlds.world import EffectSpec, World, WorldSpec

__all__ = [
    "EffectSpec",
    "ObservedTables",
    "SiteSetup",
    "World",
    "WorldSpec",
    "battery",
    "fresh_rocks",
    "make_world",
    "observe",
    "quick_battery",
    "require_library",
    "setup",
    "world_seeds",
]
