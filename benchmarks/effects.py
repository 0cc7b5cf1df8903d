"""Time of a run without effects and with each of them: ``python benchmarks/effects.py``.

One line of the slope of slope.py, so that only the engine is measured. "off" is a run with empty
settings of effects, compared with a run without any.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import slope

from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.rock_shape import RockShape
from sassgis.engine.effects.roughness import Roughness
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.effects.trees import Trees
from sassgis.engine.effects.wind import Wind
from sassgis.engine.simulate import simulate
from sassgis.inputs.ground_map import read_ground_table
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import Forest
from sassgis.settings.results import ProfileSet
from sassgis.settings.settings import EngineSettings

#: Of the slope: plan length (m), slope (degrees) and ground class, from the cliff on.
UNITS = slope.UNITS[1:]
BLOCKS = BlockPopulation(axis_1_m=(0.3, 0.6), axis_2_m=(0.25, 0.5), axis_3_m=(0.2, 0.4))
CASES: dict[str, EffectSettings | None] = {
    "none": None,
    "off": EffectSettings(),
    "air_drag": EffectSettings(AirDrag()),
    "wind": EffectSettings(Wind()),
    "trees, stems": EffectSettings(Trees()),
    "trees, viscous": EffectSettings(Trees("viscous")),
    "soft_ground": EffectSettings(SoftGround()),
    "soft_ground, scar": EffectSettings(SoftGround("scar")),
    "roughness": EffectSettings(Roughness()),
    "rock_shape": EffectSettings(RockShape()),
    "fragmentation": EffectSettings(Fragmentation()),
    "entrainment": EffectSettings(Entrainment()),
}


def slope_line(table: GroundTable) -> ProfileSet:
    """One line down the slope, with bumps of some decimetres every 4 m."""
    borders = np.concatenate([[0.0], np.cumsum([u[0] for u in UNITS])])
    fall = np.concatenate([[0.0], np.cumsum([u[0] * np.tan(np.radians(u[1])) for u in UNITS])])
    s = np.unique(np.concatenate([borders, np.arange(0.0, borders[-1], 4.0)]))
    bumps = np.random.default_rng(1).normal(0.0, 0.1, s.size)
    unit = np.clip(np.searchsorted(borders, s, side="right") - 1, 0, len(UNITS) - 1)
    cells = np.append(np.arange(0.0, s[-1], slope.CELL), s[-1])
    ground = np.array([table.index(u[2]) for u in UNITS], np.int32)[unit]
    return ProfileSet(
        np.array([0, s.size]), s, 1000.0 - np.interp(s, borders, fall) + bumps, ground,
        np.array([0, cells.size - 1]), cells, np.arange(cells.size - 1),
    )  # fmt: skip


def measure(rocks: int, repeats: int) -> dict[str, dict[str, float]]:
    """Shortest time (s) of each case, its ratio to the first, mean run-out and fragments."""
    table = read_ground_table(None)
    line = slope_line(table)
    n = line.cell.size
    forest = Forest(np.full(n, 0.03), np.full(n, 0.3))
    keys = np.zeros(1, np.uint64)

    def play(effects: EffectSettings | None) -> tuple[float, float, int]:
        begun = time.process_time()
        out = simulate(
            line, table, BLOCKS, EngineSettings(), seed=1986, rocks_per_line=rocks,
            line_keys=keys, starts=np.array([[4.0, 44.0]]), effects=effects, forest=forest,
        )  # fmt: skip
        took = time.process_time() - begun
        return took, float(out.rocks["runout_m"].mean()), out.pieces.size

    for effects in CASES.values():
        play(effects)  # compiled
    best: dict[str, tuple[float, float, int]] = {}
    for _ in range(repeats):  # in turn, so that other load affects all cases alike
        for name, effects in CASES.items():
            found = play(effects)
            best[name] = min(best.get(name, found), found)
    base = best["none"][0]
    return {
        name: {"seconds": t, "ratio": t / base, "mean_runout_m": m, "pieces": p}
        for name, (t, m, p) in best.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rocks", type=int, default=3000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", type=Path, help="also write the figures to a file")
    arguments = parser.parse_args()
    result = measure(arguments.rocks, arguments.repeats)
    for name, row in result.items():
        print(
            f"{name:20s} {arguments.rocks / row['seconds']:9.0f} blocks/s  x {row['ratio']:.2f}  "
            f"run-out {row['mean_runout_m']:6.1f} m  {row['pieces']} fragments"
        )
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
