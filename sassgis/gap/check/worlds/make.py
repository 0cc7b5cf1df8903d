"""Synthetic sites drawn from a seed, with effects brought to the strengths asked for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sassgis.gap.check.worlds.forces import FAR
from sassgis.gap.check.worlds.rigid import drawn_contacts
from sassgis.gap.check.worlds.simulation import draw_rocks, heights_of, simulate
from sassgis.gap.check.worlds.slopes import CLASSES, Relief, make_relief, surveyed
from sassgis.gap.check.worlds.strength import MEASURE_STEP_S, calibrated, n_measure
from sassgis.gap.check.worlds.world import (
    RIGID,
    EffectSpec,
    Faults,
    PlacedEffect,
    World,
    WorldSpec,
    with_effects,
)
from sassgis.model.grid import IntArray

#: Columns of a law of the ground, by their names in the table of classes.
LAW_KEYS = (
    "eta_max", "dp_min", "dp_max", "mu_f", "mu_0", "k", "d_star_m",
    "restitution", "restitution_speed_mps", "rolling_threshold",
)  # fmt: skip

#: Rows by class in the order of CLASSES, about which the laws of sites with OWN contacts are drawn.
NOMINAL_LAW = (
    (0.75, 0.0, 0.3, 0.70, 0.40, 0.17, 0.0, 0.65, 9.144, 0.1),
    (0.80, 0.2, 0.6, 0.80, 0.52, 0.21, 0.3, 0.55, 9.144, 0.1),
    (0.80, 0.2, 0.6, 0.85, 0.45, 0.25, 0.6, 0.55, 9.144, 0.1),
    (0.85, 0.0, 0.3, 0.60, 0.31, 0.17, 0.12, 0.50, 9.144, 1.0),
    (0.85, 0.0, 0.4, 0.60, 0.31, 0.17, 0.12, 0.50, 9.144, 1.0),
    (0.85, 0.0, 0.3, 0.60, 0.36, 0.17, 0.12, 0.50, 9.144, 1.0),
)

#: The same for laws of nature other than the package's: they have no speed law, or lose energy in
#: other ways, and with the restitution of its classes rocks would leave the sites.
FOREIGN_LAW = (
    (0.70, 0.0, 0.3, 0.70, 0.40, 0.17, 0.0, 0.0, 9.144, 0.1),
    (0.55, 0.2, 0.6, 0.80, 0.52, 0.21, 0.3, 0.0, 9.144, 0.1),
    (0.70, 0.2, 0.6, 0.85, 0.45, 0.25, 0.6, 0.35, 9.144, 0.1),
    (0.90, 0.0, 0.4, 0.65, 0.38, 0.17, 0.05, 0.2, 5.5, 1.5),
    (0.90, 0.0, 0.5, 0.65, 0.38, 0.17, 0.05, 0.2, 5.5, 1.5),
    (0.60, 0.0, 0.4, 0.65, 0.50, 0.17, 0.05, 0.2, 5.5, 0.1),
)

_N_RELEASES = 12


def make_world(spec: WorldSpec, seed: int) -> World:
    """Draw a site; its effects are brought to the strengths that are asked for.

    Same specification and seed, same site.

    Raises
    ------
    InputError
        If the specification names a slope, an effect or a strength that there is not.
    """
    world = base_world(spec, seed)
    for number, wanted in enumerate(spec.effects):
        effect = place_effect(world, wanted, seed + 7919 * (number + 1))
        world = with_effects(world, (*world.effects, calibrated(world, effect)))
    return world


def base_world(spec: WorldSpec, seed: int) -> World:
    """A site without effects: relief, laws of the ground, stations, release points, blocks."""
    relief = make_relief(spec.slope, seed)
    rng = np.random.default_rng([seed, 202])
    law = np.array(NOMINAL_LAW if spec.law == "own" else FOREIGN_LAW)
    n = len(law)
    law[:, 0] = np.clip(law[:, 0] + rng.uniform(-0.06, 0.06, n), 0.2, 0.95)
    law[:, 1] = np.clip(law[:, 1] + rng.uniform(-0.05, 0.05, n), 0.0, 0.5)
    law[:, 2] = np.clip(law[:, 2] + rng.uniform(-0.08, 0.08, n), law[:, 1] + 0.05, 0.8)
    law[:, 3] += rng.uniform(-0.08, 0.08, n)
    law[:, 4] += rng.uniform(-0.06, 0.06, n)
    law[:, 7] = np.clip(law[:, 7] + rng.uniform(-0.08, 0.08, n), 0.0, 0.9)
    if spec.law == RIGID:
        law = drawn_contacts(rng)
    low, high = relief.release_s
    s = rng.uniform(low, high, _N_RELEASES)
    width = rng.uniform(10.0, 25.0)
    c = np.linspace(-width, width, _N_RELEASES)
    x, y = relief.frame.xy(s, c)
    size = rng.uniform(0.8, 1.25)
    density = (2600.0, 2750.0)
    if any(e.name == "air_drag" for e in spec.effects):
        # Air holds only what is small and light.
        size, density = 0.25 * size, (1300.0, 1700.0)
    blocks = {
        "axis_1_m": (0.45 * size, 0.65 * size),
        "axis_2_m": (0.35 * size, 0.48 * size),
        "axis_3_m": (0.18 * size, 0.40 * size),
        "density_kgm3": density,
        "speed_mps": (0.5, 2.0),
        "drop_m": (0.2, 1.0),
    }
    # In this order: the draws hang on it.
    loss = float(rng.uniform(0.08, 0.25)) if spec.disturbance == "speed_loss" else 0.0
    ground = _patched(relief, rng) if spec.disturbance == "patch" else relief.ground
    survey = surveyed(relief.grid, rng) if spec.faults else relief.grid
    world = World(
        spec=spec,
        seed=seed,
        relief=relief,
        survey=survey,
        true_grid=relief.grid,
        law=law,
        speed_loss=loss,
        ground=ground,
        stations_s=np.zeros(0),
        releases=np.column_stack([x, y, heights_of(survey, x, y)]),
        blocks=blocks,
        faults=drawn_faults(rng) if spec.faults else Faults(),
        edges_rad=float(rng.uniform(0.05, 0.2)) if spec.faults else 0.0,
    )
    # Stations where four fifths to a third of the rocks still pass, evenly over the distance.
    run = simulate(world, draw_rocks(world, n_measure(world) + 20, 11), MEASURE_STEP_S)
    ends = np.sort(relief.frame.s(run.deposits[:, 3], run.deposits[:, 4]))
    first = float(relief.breaks_m[2]) - rng.uniform(0.0, 6.0)
    last = max(float(np.quantile(ends, 0.65)), first + 30.0)
    return replace(world, stations_s=np.linspace(first, last, spec.n_stations))


def drawn_faults(rng: np.random.Generator) -> Faults:
    """Faults of the observers of a site, as real tables have them."""
    known = ("contact_min_normal_speed_mps", "contact_min_interval_s", "passages_missed_share")
    return Faults(
        contact_min_normal_speed_mps=float(rng.uniform(0.2, 1.2)),
        contact_min_interval_s=float(rng.uniform(0.03, 0.25)),
        passages_missed_share=float(rng.uniform(0.0, 0.15)),
        clipped_share=float(rng.choice([0.0, 0.2, 0.5])),
        stops_m=2.0 if rng.random() < 0.5 else 0.0,
        axes_sd=float(rng.choice([0.0, 0.1, 0.2])),
        release_m=(float(rng.uniform(-1.5, 1.5)), float(rng.uniform(0.0, 0.5))),
        stated=tuple(name for name in known if rng.random() < 0.5),
    )


def _patched(relief: Relief, rng: np.random.Generator) -> IntArray:
    """Ground with a patch across the path that differs from the map: soft on hard, or hard on soft.

    The patch takes a third of the slope below the second stretch.
    """
    x, y = relief.grid.cell_centres(np.arange(relief.ground.size))
    low, high = relief.breaks_m[2], relief.breaks_m[-2]
    start = low + rng.uniform(0.1, 0.6) * (high - low)
    s = relief.frame.s(x, y).reshape(relief.ground.shape)
    within = (s > start) & (s < start + 0.35 * (high - low))
    soft = np.isin(relief.ground, [CLASSES.index(n) for n in ("soft_meadow", "forest_soil")])
    other = np.where(soft, CLASSES.index("debris"), CLASSES.index("soft_meadow"))
    return np.where(within, other, relief.ground)


def place_effect(world: World, wanted: EffectSpec, seed: int) -> PlacedEffect:
    """Say where an effect acts."""
    rng = np.random.default_rng([seed, 707])
    breaks = world.relief.breaks_m
    grounds = world.relief.stretches
    low, high = -FAR, FAR
    ground = ""
    # Below the second stretch, where rocks are in motion, down to where the run-out begins.
    top, foot = float(breaks[2]), float(breaks[-2])
    first, last = float(world.stations_s[0]), float(world.stations_s[-1])
    if wanted.name == "soft_ground":
        # The run-out, and the foot of the slope above it.
        low = min(foot - 15.0, 0.5 * (first + last))
        ground = grounds[-1]
    elif wanted.name == "trees":
        low = top + rng.uniform(0.0, 25.0)
        high = min(foot + 10.0, low + rng.uniform(45.0, 90.0))
    elif wanted.name in ("entrainment", "roughness"):
        low, high = top, foot
        if wanted.name == "roughness":
            # Blocks of the slope also strew the edge of the run-out.
            high += 20.0
        ground = grounds[2]
    elif wanted.name in ("snow", "ice", "collisions"):
        low = rng.uniform(first, first + max(last - first, 30.0) / 3.0)
        high = FAR if wanted.name == "snow" else float(breaks[-1])
    elif wanted.name == "terrace":
        low = rng.uniform(first + 5.0, max(first + 6.0, 0.6 * first + 0.4 * last))
        high = low + rng.uniform(14.0, 22.0)
    return PlacedEffect(
        name=wanted.name,
        strength=wanted.strength,
        magnitude=0.0,
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
