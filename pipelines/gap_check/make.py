"""Sites drawn from a seed, with effects brought to the strengths asked for.

The size of an effect is the energy distance between the rocks of a site with it and without it,
over its own upper bound (the coefficient of inhomogeneity of Székely and Rizzo, 2013, Energy
statistics: a class of statistics based on distances, J. Statist. Plann. Inference 143). Two normal
distributions one standard deviation apart are at 0.44, half a deviation apart at 0.24.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gap_check.motion import Run, draw_rocks, simulate
from gap_check.observers import distorted
from gap_check.slopes import CLASSES, FloatArray, IntArray, Relief, make_relief, surveyed
from gap_check.worlds import FAR, EffectSpec, Faults, PlacedEffect, World, WorldSpec

# Sizes aimed at, and how far from them is near enough.
_SIZES = {"weak": 0.20, "medium": 0.33, "strong": 0.48}
_NEAR = 0.04
_TRIES = 4
#: Rocks on which a site is measured, by the law of its motion.
_MEASURED = {"own": 160, "elastic": 50, "plastic": 50}
# Blur of the columns of stops (m, m, -) and of stations (m/s, Hz, m), and least scatter of them.
_BLUR = (np.array([1.0, 1.0, 0.0]), np.array([0.5, 0.1, 1.0]))
_FLOOR = (np.array([3.0, 2.0, 0.5]), np.array([1.0, 0.3, 2.0]))
_N_RELEASES = 12


def make_world(spec: WorldSpec, seed: int) -> World:
    """Draw a site with its effects at the strengths asked for; the same for the same seed."""
    world = base_world(spec, seed)
    for number, wanted in enumerate(spec.effects):
        effect = place_effect(world, wanted, seed + 7919 * (number + 1))
        world = with_effect(world, calibrated(world, effect))
    return world


def base_world(spec: WorldSpec, seed: int) -> World:
    """A site without effects: relief, stations, release points, blocks, faults."""
    relief = make_relief(spec.slope, seed)
    rng = np.random.default_rng([seed, 203])
    s = rng.uniform(*relief.release_s, _N_RELEASES)
    width = rng.uniform(10.0, 25.0)
    x, y = relief.frame.xy(s, np.linspace(-width, width, _N_RELEASES))
    survey = surveyed(relief.surface, rng) if spec.faults else relief.surface
    size, density = rng.uniform(0.8, 1.25), (2600.0, 2750.0)
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
    world = World(
        spec=spec, seed=seed, relief=relief, survey=survey, surface=relief.surface,
        ground=_patched(relief, rng) if spec.disturbance == "patch" else relief.ground,
        releases=np.column_stack([x, y, survey.at(x, y)]), blocks=blocks,
        faults=_drawn_faults(rng) if spec.faults else Faults(),
    )  # fmt: skip
    # Stations where nearly all to a third of the rocks still pass, evenly over the distance.
    stops = simulate(world, draw_rocks(world, 60, 11)).deposits
    ends = relief.frame.s(stops["x"].to_numpy(), stops["y"].to_numpy())
    first = float(relief.breaks_m[2]) - rng.uniform(0.0, 6.0)
    last = max(float(np.quantile(ends, 0.65)) if ends.size else 0.0, first + 30.0)
    return replace(world, stations_s=np.linspace(first, last, spec.n_stations))


def _drawn_faults(rng: np.random.Generator) -> Faults:
    """Faults of the observers of a site, as real tables have them."""
    known = ("contact_min_normal_speed_mps", "contact_min_interval_s", "passages_missed_share")
    return Faults(
        contact_min_normal_speed_mps=float(rng.uniform(0.2, 1.2)),
        contact_min_interval_s=float(rng.uniform(0.03, 0.25)),
        passages_missed_share=float(rng.uniform(0.0, 0.15)),
        clipped_share=float(rng.choice([0.0, 0.2, 0.5])),
        stops_m=2.0 if rng.random() < 0.5 else 0.0, axes_sd=float(rng.choice([0.0, 0.1, 0.2])),
        release_m=(float(rng.uniform(-1.5, 1.5)), float(rng.uniform(0.0, 0.5))),
        stated=tuple(name for name in known if rng.random() < 0.5),
    )  # fmt: skip


def _patched(relief: Relief, rng: np.random.Generator) -> IntArray:
    """Ground with a patch on a third of the slope that the map lacks: soft on hard, or reverse."""
    low, high = relief.breaks_m[2], relief.breaks_m[-2]
    start = low + rng.uniform(0.1, 0.6) * (high - low)
    s = relief.s_of_cells()
    within = (s > start) & (s < start + 0.35 * (high - low))
    soft = np.isin(relief.ground, [CLASSES.index(n) for n in ("soft_meadow", "forest_soil")])
    other = np.where(soft, CLASSES.index("debris"), CLASSES.index("soft_meadow"))
    return np.where(within, other, relief.ground)


def place_effect(world: World, wanted: EffectSpec, seed: int) -> PlacedEffect:
    """Say where an effect acts; its share is still that of the middle."""
    rng = np.random.default_rng([seed, 707])
    breaks, grounds = world.relief.breaks_m, world.relief.stretches
    # Below the second stretch, where rocks are in motion, down to where the run-out begins.
    top, foot = float(breaks[2]), float(breaks[-2])
    first, last = float(world.stations_s[0]), float(world.stations_s[-1])
    low, high, ground = -FAR, FAR, ""
    if wanted.name == "soft_ground":
        low, ground = min(foot - 15.0, 0.5 * (first + last)), grounds[-1]
    elif wanted.name == "trees":
        low = top + rng.uniform(0.0, 25.0)
        high = min(foot + 10.0, low + rng.uniform(45.0, 90.0))
    elif wanted.name in ("entrainment", "roughness"):
        low, high, ground = top, foot, grounds[2]
    elif wanted.name == "ice":
        low = rng.uniform(first, first + max(last - first, 30.0) / 3.0)
        high = float(breaks[-1])
    elif wanted.name == "terrace":
        low = rng.uniform(first + 5.0, max(first + 6.0, 0.6 * first + 0.4 * last))
        high = low + rng.uniform(14.0, 22.0)
    return PlacedEffect(wanted.name, wanted.strength, 0.5, low, high, ground, seed=seed)


def with_effect(world: World, effect: PlacedEffect) -> World:
    """The same site with one more effect; a terrace changes the slope, not its survey."""
    world = replace(world, effects=(*world.effects, effect))
    if effect.name != "terrace":
        return world
    u = (world.relief.s_of_cells() - effect.s0_m) / (effect.s1_m - effect.s0_m)
    # Cut at the back, filled at the front.
    wave = np.where((u > 0.0) & (u < 1.0), -np.sin(2.0 * np.pi * u) * np.sin(np.pi * u), 0.0)
    own = world.surface
    return replace(world, surface=replace(own, z=own.z + effect.between(0.1, 6.0) * wave))


# ---------------------------------------------------------------------------------------------
# Strength


def calibrated(world: World, effect: PlacedEffect) -> PlacedEffect:
    """Give an effect the magnitude at which its size is that of its strength.

    The site is compared with itself as it is before this effect. Where even the strongest magnitude
    is too weak, the nearest is taken, and the effect is called by the strength that it has.
    """
    n = _MEASURED[world.spec.law]
    base = features(world, simulate(world, draw_rocks(world, n, 21)))
    before = min(int((world.stations_s <= effect.s0_m).sum()), len(world.stations_s) - 1)
    aim, low, high = _SIZES[effect.strength], 0.0, 1.0
    tried = []
    for _ in range(_TRIES):
        middle = 0.5 * (low + high)
        changed = with_effect(world, replace(effect, share=middle))
        # Other rocks than those of the base: a difference of two samples, as a diagnosis has it.
        run = simulate(changed, draw_rocks(changed, n, 22))
        size = effect_size(base, features(changed, run), before)
        tried.append((abs(size - aim), middle, size))
        if abs(size - aim) < _NEAR:
            break
        low, high = (middle, high) if size < aim else (low, middle)
    _, share, size = min(tried)
    strength = min(_SIZES, key=lambda name: abs(_SIZES[name] - size))
    return replace(effect, share=share, size=size, strength=strength)


def features(world: World, run: Run) -> list[FloatArray]:
    """What is compared: a table of the stops, and one of the passages of each station.

    Stops: distance down the slope and lateral, logarithm of the number of blocks of a rock.
    Stations: speed, rotation, place across the slope. True errors of measurement are in them.
    """
    run = distorted(world, run)
    frame, d = world.relief.frame, run.deposits
    start = frame.c(run.rocks.stated[:, 0], run.rocks.stated[:, 1])
    pieces = np.bincount(d["rock"], minlength=len(run.rocks))[d["rock"]]
    x, y = d["x"].to_numpy(), d["y"].to_numpy()
    tables = [np.column_stack([frame.s(x, y), frame.c(x, y) - start[d["rock"]], np.log(pieces)])]
    for k in range(len(world.stations_s)):
        p = run.passages[run.passages["station"] == k]
        aside = frame.c(p["x"].to_numpy(), p["y"].to_numpy()) - start[p["rock"]]
        tables.append(np.column_stack([p["speed_mps"], p["rotation_hz"], aside]))
    # Nobody sees sharper than this: without it a shift of decimetres counts where paths lie close.
    rng = np.random.default_rng([world.seed, 515, *run.rocks.seed])
    return [
        table + rng.standard_normal(table.shape) * _BLUR[min(k, 1)]
        for k, table in enumerate(tables)
    ]


def effect_size(base: list[FloatArray], changed: list[FloatArray], before: int = 0) -> float:
    """Size of an effect: the largest on any quantity, or on all of a table together.

    Of stations the root mean square counts, over those after the first ``before``; each column on
    the scale of the rocks without the effect.
    """
    stops: list[float] = []
    stations: list[list[float]] = []
    for k, (one, other) in enumerate(zip(base, changed, strict=True)):
        if len(one) < 20 or 0 < k <= before:
            continue
        scale = np.maximum(one.std(axis=0), _FLOOR[min(k, 1)])
        # The number of blocks counts only together with where they lie: alone, a broken rock in
        # ten would pass for a strong effect.
        columns = [slice(0, 3), *(slice(j, j + 1) for j in range(2 if k == 0 else 3))]
        sizes = [inhomogeneity(one[:, c] / scale[c], other[:, c] / scale[c]) for c in columns]
        if k == 0:
            stops = sizes
        else:
            stations.append(sizes)
    passing = np.sqrt(np.mean(np.square(stations), axis=0)) if stations else np.zeros(1)
    return max([*stops, float(passing.max())])


def inhomogeneity(one: FloatArray, other: FloatArray) -> float:
    """Energy distance of samples (n, k), (m, k) over its upper bound, 0 to 1, unbiased at zero."""
    if len(one) < 2 or len(other) < 2:
        return 1.0
    between = _mean_distance(one, other)
    within = _mean_distance(one, one) * len(one) / (len(one) - 1)
    within += _mean_distance(other, other) * len(other) / (len(other) - 1)
    if between <= 0.0:
        return 0.0
    return math.sqrt(max(0.0, (2.0 * between - within) / (2.0 * between)))


def _mean_distance(one: FloatArray, other: FloatArray) -> float:
    return float(np.sqrt(((one[:, None, :] - other[None, :, :]) ** 2).sum(axis=2)).mean())
