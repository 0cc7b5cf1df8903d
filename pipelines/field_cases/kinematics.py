"""Speeds, heights, contacts and spins of rocks, observed and simulated, and on made slopes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

import sassgis
from sassgis.gap.forward.observation_operator import campaigns
from sassgis.gap.forward.released_rocks import configured_model
from sassgis.gap.forward.rock_lines import rock_lines_of
from sassgis.gap.observations.case import Campaign, Case, main_blocks, observed_campaign
from sassgis.gap.observations.observed import rock_masses_kg, rock_radii_m
from sassgis.gap.observations.projection import contact_numbers
from sassgis.grid import FloatArray
from sassgis.settings.ground import GroundClass, GroundTable

#: Values of all rocks, one for each where it has one, by quantity.
Values = dict[str, FloatArray]
SHARES = (0.1, 0.5, 0.9)
#: Blocks that a campaign released repeatedly are shown apart, so many at most.
MOST_BLOCKS = 5
#: The wheel of 780 kg of Chant Sura (m), and where it is looked at: from so far below the foot of
#: the cliff on, over so many metres in plan.
WHEEL_M, FOOT_M, SEEN_M = (0.465, 0.465, 0.235), 12.0, 45.0
#: Sizes (m³), slopes (degrees) and drops (m) at which blocks are looked at.
SIZES_M3, SLOPES_DEG, DROPS_M = (0.2, 1.0, 5.0), (30.0, 35.0, 40.0), (100.0, 200.0, 500.0)


def values_of(case: Case, seen: Campaign) -> Values:
    """Run-out, speeds, energies and heights at stations, and numbers of the contacts."""
    found: Values = {}
    mass = rock_masses_kg(case.observations)
    # A block that was released often has a mass of its own.
    repeated = np.unique(mass) if np.unique(mass).size <= MOST_BLOCKS else ()
    if seen.deposits is not None:
        main = main_blocks(seen.deposits, case.n_rocks)
        found["run-out"] = np.append(seen.deposits.s, np.nan)[main]
        found |= {f"run-out of {m:g} kg": found["run-out"][mass == m] for m in repeated}
    if seen.passages is not None:
        for k, name in enumerate(case.station_names):
            own = seen.passages.station == k
            speed = seen.passages.speed_mps[own]
            found[f"speed {name}"] = speed
            # Of translation: what a spin of which the axis is not known adds is not.
            found[f"energy {name}"] = 5e-4 * mass[seen.passages.rock[own]] * speed**2
            found[f"height {name}"] = seen.passages.height_m[own]
            if name == case.station_names[-1]:
                of = mass[seen.passages.rock[own]]
                found |= {f"speed {name} of {m:g} kg": speed[of == m] for m in repeated}
    if seen.contacts is not None:
        numbers = contact_numbers(seen.contacts, rock_radii_m(case.observations))
        names = {
            "contacts": "contacts",
            "fastest_second": "greatest speed",
            "rim_ratio": "spin over speed",
            "hop_length": "hop length",
            "hop_height": "hop height",
        }
        found |= {name: numbers[key] for key, name in names.items()}
    return {name: v[np.isfinite(v)] for name, v in found.items()}


def observed(case: Case) -> Values:
    """What was observed."""
    return values_of(case, observed_campaign(case))


def kinematics(
    case: Case,
    table: GroundTable,
    count: int,
    seed: int,
    engine: Mapping[str, float] | None = None,
) -> Values:
    """What ``count`` simulated campaigns show, all together; ``engine``: keys that differ."""
    case = replace(case, engine=replace(case.engine, **(engine or {})))
    model = replace(configured_model(case), table=table)
    made = campaigns(case, rock_lines_of(case), model, count=count, seed=seed)
    each = [values_of(case, one) for one in made]
    return {name: np.concatenate([one[name] for one in each]) for name in each[0]}


def compared(seen: Values, made: Values) -> dict[str, dict[str, Any]]:
    """Quantiles of both, by quantity."""
    return {
        name: {
            "rocks": values.size,
            "observed": np.quantile(values, SHARES),
            "simulated": np.quantile(made[name], SHARES),
        }
        for name, values in seen.items()
    }


def _line(parts: Sequence[tuple[float, float]], top: float = 3000.0) -> pd.DataFrame:
    """A profile of pieces, each of a length in plan (m) and a slope (degrees)."""
    plan = np.cumsum([0.0, *(length for length, _ in parts)])
    fall = np.cumsum([0.0, *(d * math.tan(math.radians(a)) for d, a in parts)])
    return pd.DataFrame({"s_m": plan, "z_m": top - fall})


def _passing(
    line: pd.DataFrame,
    at: Sequence[float],
    ground: str | GroundClass,
    block: Mapping[str, Any],
    n: int,
    seed: int,
    **sections: Any,
) -> pd.DataFrame:
    """Passages of blocks that start at 10 m, at some chainages."""
    found = sassgis.profile(
        line,
        blocks={"drop_m": (0.5, 1.0), **block},
        ground=ground,
        start_m=10.0,
        stations=[{"name": f"{s:g}", "chainage_m": float(s)} for s in at],
        n_blocks=n,
        seed=seed,
        **sections,
    )
    return found.passages


def wheel_below_cliff(
    seed: int, ground: str | GroundClass = "soft_meadow", engine: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Speed, height and spin of a block of 780 kg on 35 degrees below a cliff.

    As the site is described: 50 m of drop at 45 degrees, a cliff of 20 m, then soil. Values of the
    block in the air, by time.
    """
    line = _line([(60.0, 45.0), (6.0, math.degrees(math.atan2(20.0, 6.0))), (120.0, 35.0)])
    at = 66.0 + FOOT_M + np.arange(0.5, SEEN_M)
    axes = {f"axis_{k + 1}_m": axis for k, axis in enumerate(WHEEL_M)}
    block = {**axes, "density_kgm3": 2670.0}
    rows = _passing(line, at, ground, block, 200, seed, engine=dict(engine or {}))
    rows = rows[rows["height_m"] > 0.0]
    rim = 2.0 * math.pi * WHEEL_M[0] * rows["rotation_hz"] / rows["speed_mps"]
    time = 1.0 / rows["speed_mps"].to_numpy()
    return {
        "speed": _by_time(rows["speed_mps"], time),
        "height": _by_time(rows["height_m"], time),
        "spin": _by_time(rows["rotation_hz"], time),
        "rim over speed": _by_time(rim, time),
    }


def _by_time(values: pd.Series, time: FloatArray) -> list[float]:
    """Quartiles of values that each hold for some time."""
    order = np.argsort(values.to_numpy())
    done = np.cumsum(time[order]) / time.sum()
    return [float(values.iloc[order[np.searchsorted(done, q)]]) for q in (0.25, 0.5, 0.75)]


def slopes(classes: Sequence[str], seed: int) -> list[dict[str, Any]]:
    """What blocks do on even slopes, by class, size, slope and drop."""
    rows = []
    for ground in classes:
        for volume in SIZES_M3:
            for slope in SLOPES_DEG:
                at = 10.0 + np.array(DROPS_M) / math.tan(math.radians(slope))
                line = _line([(at[-1] + 20.0, slope)])
                seen = _passing(line, at, ground, {"volume_m3": volume}, 100, seed)
                for drop, s in zip(DROPS_M, at.tolist(), strict=True):
                    own = seen[seen["control_line"] == f"{s:g}"]
                    if len(own) < 10:
                        continue
                    rows.append(
                        {"class": ground, "volume_m3": volume, "slope_deg": slope, "drop_m": drop,
                         "speed": own["speed_mps"].quantile([0.5, 0.95]).tolist(),
                         "height": own["height_m"].quantile([0.5, 0.95]).tolist()}
                    )  # fmt: skip
    return rows


def fan(classes: Sequence[str], seed: int) -> list[dict[str, Any]]:
    """Shadow angles of stops (degrees) below a cliff of 80 m and a slope of 36 degrees.

    Below it the slope falls to 5 degrees over 250 m. The shadow angle is that of the stop seen from
    the top of the slope.
    """
    concave = [(5.0, 36.0 - 31.0 * (k + 0.5) / 50.0) for k in range(50)]
    line = _line([(12.0, 20.0), (38.0, 65.0), (160.0, 36.0), *concave, (600.0, 5.0)])
    s, z = line["s_m"].to_numpy(), line["z_m"].to_numpy()
    top = 50.0
    rows = []
    for ground in classes:
        for volume in SIZES_M3:
            found = sassgis.profile(
                line, blocks={"volume_m3": volume, "drop_m": (0.5, 1.0)}, ground=ground,
                start_m=13.0, n_blocks=200, seed=seed,
            )  # fmt: skip
            end = 13.0 + found.blocks["runout_m"].to_numpy()
            below = end > top + 5.0
            fall = np.interp(top, s, z) - np.interp(end[below], s, z)
            angle = np.degrees(np.arctan2(fall, end[below] - top))
            rows.append(
                {"class": ground, "volume_m3": volume, "stops": int(below.sum()),
                 "angle_deg": np.quantile(angle, [0.0, 0.05, 0.5]).tolist() if below.any() else []}
            )  # fmt: skip
    return rows
