"""How strong an effect is: measured on stops and stations, the same for all families.

The size of an effect is the energy distance between the rocks of a site with it and without it,
over its own upper bound (the coefficient of inhomogeneity of Székely and Rizzo, 2013, Energy
statistics: a class of statistics based on distances, J. Statist. Plann. Inference 143). Two normal
distributions one standard deviation apart are at 0.44, half a deviation apart at 0.24.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sassgis.gap.check.worlds.observe import distort
from sassgis.gap.check.worlds.simulation import draw_rocks, simulate
from sassgis.gap.check.worlds.world import EFFECTS, RIGID, PlacedEffect, Run, World, with_effects
from sassgis.model.grid import FloatArray

# Sizes that go by each name, as (lowest, aimed at, highest).
BANDS: dict[str, tuple[float, float, float]] = {
    "weak": (0.15, 0.20, 0.25),
    "medium": (0.28, 0.33, 0.38),
    "strong": (0.42, 0.48, 0.58),
}
_TRIES = 4
# Blur (standard deviation) of the columns of stops (m, m, -) and of stations (m/s, Hz, m).
_BLUR = (np.array([1.0, 1.0, 0.0]), np.array([0.5, 0.1, 1.0]))
# Twice the step of a site: what is measured here does not move with it.
MEASURE_STEP_S = 0.004


def n_measure(world: World) -> int:
    """Rocks on which a site is measured; fewer where each takes a tenth of a second."""
    return 40 if world.spec.law == RIGID else 180


def inhomogeneity(one: FloatArray, other: FloatArray) -> float:
    """Energy distance of two samples, shapes (n, k) and (m, k), over its upper bound.

    0 (same distribution) to 1, without bias at zero; negative estimates are given as 0.
    """
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


def features(world: World, run: Run) -> list[FloatArray]:
    """What is compared: a table of the stops, and one of the passages of each station.

    Stops: distance down the slope and lateral, and number of blocks that a rock has become.
    Stations: speed, rotation, and place across the slope. Errors of measurement that are the
    site's truth are in them.
    """
    run = distort(world, run)
    frame = world.relief.frame
    d, p = run.deposits, run.passages
    pieces = np.bincount(d[:, 0].astype(int), minlength=len(run.rocks.state))
    starts = frame.c(run.rocks.stated[:, 0], run.rocks.stated[:, 1])
    tables = [
        np.column_stack(
            [
                frame.s(d[:, 3], d[:, 4]),
                frame.c(d[:, 3], d[:, 4]) - starts[d[:, 0].astype(int)],
                np.log(np.maximum(pieces[d[:, 0].astype(int)], 1)),
            ]
        )
    ]
    for k in range(len(world.stations_s)):
        q = p[p[:, 3] == k]
        lateral = frame.c(q[:, 4], q[:, 5]) - starts[q[:, 0].astype(int)]
        tables.append(np.column_stack([q[:, 7], q[:, 8], lateral]))
    # Nobody sees sharper than this: without it a shift of decimetres counts where paths lie close.
    rng = np.random.default_rng([world.seed, 515, int(run.rocks.keys[0] >> np.uint64(32))])
    for k, table in enumerate(tables):
        table += rng.standard_normal(table.shape) * _BLUR[min(k, 1)]
    return tables


def effect_size(base: list[FloatArray], changed: list[FloatArray], first_station: int = 0) -> float:
    """Size of an effect: the largest on any quantity, or on all of a table together.

    Of stations the root mean square counts, over those that rocks reach after the effect: from
    ``first_station`` on. Each column is put on the scale of the rocks without the effect.
    """
    floor = (np.array([3.0, 2.0, 0.5]), np.array([1.0, 0.3, 2.0]))
    stops: list[float] = []
    stations: list[list[float]] = []
    for k, (one, other) in enumerate(zip(base, changed, strict=True)):
        if len(one) < 20 or 0 < k <= first_station:
            continue
        scale = np.maximum(one.std(axis=0), floor[min(k, 1)])
        one, other = one / scale, other / scale
        # The number of blocks counts only together with where they lie: alone, a broken rock in
        # ten would pass for a strong effect.
        alone = range(2) if k == 0 else range(3)
        columns = [slice(0, 3), *(slice(j, j + 1) for j in alone)]
        sizes = [inhomogeneity(one[:, c], other[:, c]) for c in columns]
        if k == 0:
            stops = sizes
        else:
            stations.append(sizes)
    passing = np.sqrt(np.mean(np.square(stations), axis=0)) if stations else np.zeros(1)
    return max([*stops, float(passing.max())])


def calibrated(world: World, effect: PlacedEffect) -> PlacedEffect:
    """Give an effect the magnitude at which its size is in the band of its strength.

    The site is compared with itself as it is before this effect: the second of a pair is measured
    on top of the first. Where even the strongest magnitude is too weak, the nearest one is taken,
    and the effect is called by the strength that it has.
    """
    rocks = draw_rocks(world, n_measure(world), 21)
    base = features(world, simulate(world, rocks, MEASURE_STEP_S))
    first_station = min(int((world.stations_s <= effect.s0_m).sum()), len(world.stations_s) - 1)

    def size(magnitude: float) -> float:
        changed = with_effects(world, (*world.effects, replace(effect, magnitude=float(magnitude))))
        # Other rocks than those of the base: a difference of two samples, as a diagnosis has it.
        run = simulate(changed, draw_rocks(changed, n_measure(world), 22), MEASURE_STEP_S)
        return effect_size(base, features(changed, run), first_station)

    low_size, aim, high_size = BANDS[effect.strength]
    low, high = (math.log(v) for v in EFFECTS[effect.name][:2])
    best = (math.inf, high, math.nan)
    for _ in range(_TRIES):
        middle = 0.5 * (low + high)
        found = size(math.exp(middle))
        if abs(found - aim) < best[0]:
            best = (abs(found - aim), middle, found)
        if low_size + 0.01 <= found <= high_size - 0.01 and abs(found - aim) < 0.03:
            break
        if found < aim:
            low = middle
        else:
            high = middle
    _, where, found = best
    reached = min(BANDS, key=lambda name: abs(BANDS[name][1] - found))
    return replace(effect, magnitude=math.exp(where), size=found, strength=reached)
