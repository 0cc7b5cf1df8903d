"""Legal settings at their extremes: does what must hold on any slope still hold?

    python benchmarks/extremes.py [--setups 10000] [--first 0] [--json FILE]

Each set-up draws a slope, a ground class, blocks, the readings of the engine and effects, mostly
from the ends of what each setting may be: semi-axes from 5 mm to blocks of 1,000 m³, axes of ratio
0.05, cliffs that stand upright, cells of 0.1 to 50 m, η_max and restitution 0 and 1, friction 0 and
10. Nine of ten are profiles, the tenth is a small map. Checked are:

- no number is NaN or infinite; a map is NaN only where no block arrives;
- a contact, a flight and a stretch on the ground never gain energy (wind may give some in flight);
- blocks stop on their profile, on the map, and for a reason;
- probabilities lie between 0 and 1, quantiles rise, no more blocks reach a higher energy than a
  lower one, and no more blocks reach a cell than were simulated;
- no set-up takes longer than TOO_LONG_S.

The share of blocks that the engine gives up (``max_events``) is stated.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

import numpy as np
import shapely
from numpy.lib.recfunctions import structured_to_unstructured
from watched import Case, watched

from sassgis.engine.effects.registry import EFFECTS
from sassgis.engine.effects.rock_shape import RockShape
from sassgis.engine.effects.wind import Wind
from sassgis.engine.ellipse import inertia
from sassgis.engine.simulate import Simulated, simulate
from sassgis.engine.state import FLIGHT
from sassgis.errors import InputError
from sassgis.grid import FloatArray, Grid
from sassgis.outputs.layers.maps import map_layers
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.ground import LIMITS, GroundClass, GroundTable
from sassgis.settings.map_run import Forest, MapRun, ReleaseArea
from sassgis.settings.results import ProfileSet, StopReason
from sassgis.settings.schema import declared, interval
from sassgis.settings.settings import EngineSettings, ReleaseSettings, TerrainSettings
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.accumulators import Progress, joined_rows, sample_of
from sassgis.simulation.loop import simulate_map
from sassgis.terrain.prepare import plan

SEED = 1986
TOO_LONG_S = 60.0
#: Set-ups before the first, which need all that is compiled: with and without effects, both paths.
WARM_UP = range(10**9, 10**9 + 40)
BLOCKS = 5
EVENTS = 3000
#: The radius of a sphere of 1,000 m³ (m).
LARGEST_M = (750.0 / math.pi) ** (1.0 / 3.0)
CELLS_M = (0.1, 0.5, 2.0, 10.0, 50.0)
#: Relative rounding of energies over a contact and a flight, and what is added to it where the
#: gap at which a contact is found is large beside the block, as a share of the gap over its axis.
ROUNDING = 1e-8
GAP_SHARE = 1e-3


# ---------------------------------------------------------------------------------------------
# Draws


def number_between(low: float, high: float, rng: np.random.Generator) -> float:
    """Mostly one of the ends; else between, evenly or by the size of the number."""
    kind = rng.random()
    if kind < 0.3:
        return low
    if kind < 0.6:
        return high
    if kind < 0.8 and low >= 0.0 and high > 0.0:
        return float(np.exp(rng.uniform(np.log(max(low, 1e-3 * high)), np.log(high))))
    return float(rng.uniform(low, high))


def setting(kind: Any, default: Any, rng: np.random.Generator) -> Any:
    """A legal value of a declared setting; the default where it is neither number nor choice."""
    if rng.random() < 0.4:
        return default
    limits = interval(kind)
    bare = kind
    while get_origin(bare) is not Literal and get_args(bare) and bare not in (int, float, bool):
        inner = [k for k in get_args(bare) if k is not type(None)]
        bare = inner[0]
    if get_origin(bare) is Literal:
        choices = get_args(bare)
        return choices[int(rng.integers(len(choices)))]
    if bare is bool:
        return bool(rng.random() < 0.5)
    if limits is None or bare not in (int, float) or get_origin(kind) is Union:
        return default
    low = limits.ge if limits.ge is not None else limits.gt
    if limits.le is None or low is None:
        return default
    drawn = number_between(float(low), float(limits.le), rng)
    return round(drawn) if bare is int else drawn


def section(cls: type, rng: np.random.Generator, **fixed: Any) -> Any:
    """A section of settings."""
    own = {
        key: setting(one.kind, one.default, rng)
        for key, one in declared(cls).items()
        if key not in fixed
    }
    return cls(**own, **fixed)


def ground_class(rng: np.random.Generator) -> GroundClass:
    own = {key: number_between(*ends, rng) for key, ends in LIMITS.items()}
    own["restitution_speed_mps"] = float(rng.choice([0.1, 9.144, 1e6]))
    own["dp_min"], own["dp_max"] = sorted((own["dp_min"], own["dp_max"]))
    if rng.random() < 0.5:  # such as there are
        own |= {"mu_f": rng.uniform(0.3, 1.0), "mu_0": rng.uniform(0.1, 0.8), "dp_max": 0.6,
                "dp_min": 0.0, "k": 0.2, "d_star_m": 0.3, "rolling_threshold": 0.1}  # fmt: skip
    return GroundClass("own", **own)


def population(rng: np.random.Generator) -> BlockPopulation:
    a = float(rng.choice([0.005, 0.05, 0.5, 2.0, LARGEST_M]))
    b = max(a * float(rng.choice([0.05, 0.5, 1.0])), 1e-3)
    c = max(b * float(rng.choice([0.05, 0.5, 1.0])), 1e-3)
    return BlockPopulation(
        axis_1_m=(a, a), axis_2_m=(b, b), axis_3_m=(c, c),
        density_kgm3=(500.0, 10_000.0) if rng.random() < 0.3 else (2700.0, 2700.0),
        drop_m=(0.0, float(rng.choice([0.0, 0.0, 1.0, 1000.0]))),
        speed_mps=(0.0, float(rng.choice([0.0, 0.0, 150.0]))),
        spin_radps=(-300.0, 300.0) if rng.random() < 0.2 else (0.0, 0.0),
    )  # fmt: skip


def engine(rng: np.random.Generator) -> EngineSettings:
    return section(  # type: ignore[no-any-return]
        EngineSettings, rng, max_events=int(rng.choice([100, 2000, 20_000])),
        gravity_mps2=float(rng.choice([9.81, 9.81, 0.1, 30.0])),
        contact_tolerance_m=float(rng.choice([1e-6, 1e-6, 1e-12, 1e-2])),
    )  # fmt: skip


def effects(rng: np.random.Generator) -> EffectSettings:
    """None in half of the set-ups; else each by chance."""
    if rng.random() < 0.5:
        return EffectSettings()
    rows = [row for row in EFFECTS.values() if rng.random() < 0.3]
    classes = {"classes": ()}
    return EffectSettings(
        *(
            section(r.settings, rng, **(classes if "classes" in declared(r.settings) else {}))
            for r in rows
            if r.phase != "path"
        )
    )


def line(cell: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Chainage and height of a slope with cliffs, steps and rises."""
    n = int(rng.integers(3, 60))
    ds = cell * rng.choice([1e-6, 0.05, 0.5, 1.0, 3.0], n, p=[0.1, 0.1, 0.2, 0.5, 0.1])
    angle = rng.choice([-80.0, -30.0, 0.0, 20.0, 36.0, 60.0, 85.0], n)
    dz = -np.where(ds < 1e-3 * cell, cell * rng.choice([-3.0, 1.0, 20.0], n), 0.0)
    dz -= np.where(dz == 0.0, ds * np.tan(np.radians(angle)), 0.0)
    if rng.random() < 0.5:
        dz = -np.abs(dz)
    s = np.concatenate([[0.0], np.cumsum(ds)])
    return s, 1000.0 + np.concatenate([[0.0], np.cumsum(dz)])


# ---------------------------------------------------------------------------------------------
# What must hold


def must(holds: Any, what: str) -> None:
    """Raise AssertionError unless it holds."""
    if not np.all(holds):
        raise AssertionError(what)


def all_finite(rows: np.ndarray, what: str) -> None:
    """Every number of structured rows."""
    must(np.isfinite(structured_to_unstructured(rows)), f"{what}: NaN or infinite")


def check_log(log: np.ndarray, rock: Any, reading: EngineSettings, on: EffectSettings) -> None:
    """Energies along the log of one block."""
    g = reading.gravity_mps2
    all_finite(log, "event log")
    must(np.diff(log["t_s"]) >= 0.0, "time runs backwards")
    if log.size < 3:
        return
    log = log[:-1]  # the end carries no velocity
    tumbling = on.get(RockShape)
    a, b, c = rock["a_m"], rock["b_m"], rock["c_m"]
    mean = tumbling is not None and tumbling.form == "mean_inertia"
    i = 2.0 / 15.0 * (a * a + b * b + c * c) if mean else inertia(a, b)
    kinetic = 0.5 * (log["vx_mps"] ** 2 + log["vz_mps"] ** 2 + i * log["omega_radps"] ** 2)
    total = kinetic + g * log["z_m"]
    size = np.maximum(kinetic[:-1] + g * np.abs(np.diff(log["z_m"])), g * rock["b_m"])
    size = np.maximum(size, g * np.abs(log["z_m"][:-1]) * 1e-6)
    gain = np.diff(total) / size
    if on.get(Wind) is not None:
        gain = gain[log["phase"][:-1] != FLIGHT]
        size = size[log["phase"][:-1] != FLIGHT]
    worst = int(np.argmax(gain)) if gain.size else 0
    most = max(ROUNDING, GAP_SHARE * reading.contact_tolerance_m / rock["b_m"])
    must(gain <= most, f"energy grows by {gain[worst] if gain.size else 0:.3g} of itself "
         f"at event {worst}")  # fmt: skip


def check_rocks(out: Simulated, s: FloatArray, windy: bool) -> None:
    """Rows of blocks, fragments and passages."""
    for name, rows in (("blocks", out.rocks), ("spawned blocks", out.pieces)):
        all_finite(rows, name)
        must(np.isin(rows["reason"], [int(r) for r in StopReason]), f"{name}: no reason")
        must(rows["time_s"] >= 0.0, f"{name}: time below 0")
        must(rows["max_energy_kj"] >= 0.0, f"{name}: energy below 0")
        must(rows["max_height_m"] >= 0.0, f"{name}: height below 0")
        must(rows["mass_kg"] > 0.0, f"{name}: no mass")
        # A block leaves the profile when no part of it is over the ground any more; where it is
        # then is known but for a push of the wind.
        x, a = rows["runout_m"], 1.001 * rows["a_m"] + (0.02 if windy else 0.0)
        must((x >= s[0] - a) & (x <= s[-1] + a), f"{name}: stop off the profile")
    all_finite(out.passages, "passages")


def check_sums(out: Simulated, n: int) -> None:
    """Sums per cell."""
    for name, values in out.sums.items():
        reached = out.sums["reach"] > 0
        must(np.isfinite(values[reached]), f"sum {name}: NaN or infinite")
        must(values[reached] >= 0, f"sum {name}: below 0")
    must(out.sums["reach"] <= n, "more blocks reach a cell than there are")
    must(np.diff(out.sums["exceed"].astype(np.int64), axis=1) <= 0, "exceedance rises")
    must(out.sums["reach"] >= out.sums["exceed"][:, :1].T, "more blocks exceed than reach")


# ---------------------------------------------------------------------------------------------
# Set-ups


def profile_case(rng: np.random.Generator) -> Mapping[str, int]:
    cell = float(rng.choice(CELLS_M))
    s, z = line(cell, rng)
    borders = np.unique(np.append(np.arange(s[0], s[-1], max(cell, s[-1] / 500.0)), s[-1]))
    n = borders.size - 1
    profiles = ProfileSet(
        np.array([0, s.size]), s, z, np.zeros(s.size, np.int32),
        np.array([0, n]), borders, np.arange(n, dtype=np.int64),
    )  # fmt: skip
    on, reading, blocks = effects(rng), engine(rng), population(rng)
    start = np.sort(rng.uniform(0.0, 0.5 * s[-1], 2))
    forest = Forest(np.full(n, rng.choice([0.0, 0.03, 2.0])), np.full(n, rng.choice([0.05, 3.0])))
    out = simulate(
        profiles, GroundTable((ground_class(rng),)), blocks, reading, seed=int(rng.integers(2**32)),
        rocks_per_line=BLOCKS, line_keys=np.zeros(1, np.uint64), starts=start[None],
        log_events=EVENTS, effects=on, forest=forest,
    )  # fmt: skip
    check_rocks(out, s, on.get(Wind) is not None)
    check_sums(out, BLOCKS)
    for rock, log in zip(out.rocks, out.event_logs, strict=True):
        check_log(log, rock, reading, on)
    given_up = int((out.rocks["reason"] == StopReason.STEP_LIMIT).sum())
    return {"profiles": 1, "blocks": BLOCKS, "given up": given_up}


def heights(cell: float, rng: np.random.Generator) -> FloatArray:
    """A slope with a cliff, bumps, and now and then cells without height."""
    n = int(rng.integers(12, 40))
    row, col = np.mgrid[:n, :n]
    fall = np.tan(np.radians(float(rng.choice([10.0, 36.0, 60.0, 80.0]))))
    z = 2000.0 - cell * fall * np.minimum(col, 0.7 * n)
    z -= (col > n // 3) * cell * float(rng.choice([0.0, 20.0]))
    z += rng.normal(0.0, cell * float(rng.choice([0.0, 0.1, 1.0])), z.shape)
    if rng.random() < 0.2:
        z[row > 0.8 * n] = np.nan
    return np.asarray(z, np.float64)


def map_case(rng: np.random.Generator) -> Mapping[str, int]:
    blocks = population(rng)
    # The smallest map is some blocks wide.
    cell = max(float(rng.choice(CELLS_M)), 0.5 * blocks.axis_1_m[1])
    grid = Grid(heights(cell, rng), 2_700_000.0, 1_150_000.0, cell, "", "")
    n = grid.shape[0]
    x, y = grid.west + cell * 0.2 * n, grid.north - cell * 0.5 * n
    area = ReleaseArea("a", shapely.box(x, y, x + 3 * cell, y + 3 * cell), ("b",))
    on = effects(rng)
    run = MapRun(
        grid, np.zeros(grid.shape, np.int32), GroundTable((ground_class(rng),)), (area,),
        (replace(blocks, name="b"),), (), replace(engine(rng), max_events=2000),
        TerrainSettings(
            smoothing_m=float(rng.choice([0.0, cell])), segment_tolerance_m=0.1, block_scale_m=0.0,
        ),
        ReleaseSettings(spacing_m=1.5 * cell, rocks_per_point=3),
        seed=int(rng.integers(2**32)), thresholds_kj=(30.0, 300.0), effects=on,
        ref_width_m=float(rng.choice([0.0, cell])),
        forest=Forest(np.full(n * n, 0.03), np.full(n * n, 0.3)),
    )  # fmt: skip
    path = str(rng.choice(["followed", "fall_line"]))
    run = replace(run, terrain=replace(run.terrain, path=path))
    planned = plan(run)
    progress = simulate_map(run, planned)
    check_map(run, progress, int(planned.blocks_of_point(run).sum()))
    return {
        "maps": 1,
        "blocks": int(progress.reasons.sum()),
        "given up": int(progress.reasons[StopReason.STEP_LIMIT]),
    }


def check_map(run: MapRun, progress: Progress, n: int) -> None:
    """Maps and stops of a run."""
    must(progress.reasons.sum() + progress.lost == n, "blocks are lost")
    rows = joined_rows(progress.stops)
    all_finite(rows.rocks, "blocks")
    must(np.isfinite(rows.x) & np.isfinite(rows.y), "stops: NaN")
    west, south, east, north = run.grid.bounds
    inside = (rows.x >= west) & (rows.x <= east) & (rows.y >= south) & (rows.y <= north)
    must(inside, "stops off the map")
    if progress.lost == n:  # a run refuses that
        return
    layers = map_layers(
        progress.sums, run.grid.shape, sample_of(run, progress), bins_of(run).edges,
        run.grid.cell_size,
    )  # fmt: skip
    reach = {b.name: b.values for layer in layers for b in layer.bands}["reach"]
    there = np.nan_to_num(reach) > 0.0
    must((reach[there] <= 1.0), "a probability above 1")
    for layer in layers:
        bands = {b.name: b.values for b in layer.bands}
        for name, values in bands.items():
            must(~np.isinf(values), f"{layer.stem} {name}: infinite")
            must(np.isnan(values[~there]), f"{layer.stem} {name}: where no block arrives")
            if name not in ("standard_error", "stops"):
                must(np.isfinite(values[there]), f"{layer.stem} {name}: NaN where blocks arrive")
                must(values[there] >= 0.0, f"{layer.stem} {name}: below 0")
        ordered = [b for b in ("min", "q5", "q50", "q90", "q95", "q99", "max") if b in bands]
        for low, high in pairwise(ordered):
            must(bands[low][there] <= bands[high][there], f"{layer.stem}: {low} above {high}")
    for tally in progress.sources.values():
        counts = tally.cells.state()["count"]
        must(np.diff(counts, axis=1) <= 0, "exceedance rises")
        must(counts <= n, "more blocks exceed than there are")


def prepared() -> Case:
    """What does the set-up of a number."""

    def case(number: int) -> Mapping[str, int]:
        rng = np.random.default_rng([SEED, number])
        try:
            return map_case(rng) if number % 10 == 9 else profile_case(rng)
        except InputError as error:
            must("\n" not in str(error), "more than one line")
            return {"refused": 1}

    for number in WARM_UP:  # compiles what is not compiled yet, or reads it
        with suppress(AssertionError):
            case(number)
    return case


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--setups", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cases = range(options.first, options.first + options.setups)
    counts, failures = watched(prepared, (), cases, TOO_LONG_S)
    for one in failures[:20]:
        print(one["number"], one["said"], sep="\n")
    said = {one["number"]: one["said"].strip().splitlines()[-1] for one in failures}
    print(dict(counts), dict(Counter(s.split(" by ")[0] for s in said.values())), sep="\n")
    if options.json:
        rows = {"setups": options.setups, "counts": dict(counts), "failures": said}
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
