"""Short ways to make slopes, grounds, blocks and runs for the tests of the engine."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sassgis.engine.simulate import Simulated, simulate
from sassgis.grid import FloatArray
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.ground import GroundClass, GroundTable
from sassgis.settings.map_run import Forest
from sassgis.settings.results import ProfileSet
from sassgis.settings.settings import EngineSettings

FLIGHT, IMPACT, ROLLING, SLIDING, END = range(5)
REST, BARRIER, LEFT_PROFILE, STEP_LIMIT, NEVER_STARTED, BROKEN = range(6)
G = 9.81
#: The words of the paper: what the tests of the engine run with unless they say otherwise.
PAPER = EngineSettings(readings="1986")
#: The settings that are for hazard work, which are the usual ones.
#: Blocks are the ellipses that they state.
HAZARD = EngineSettings(outline_edges=0.0, outline_share=1.0)
#: A population of many shapes and sizes.
MIXED = BlockPopulation(axis_1_m=(0.4, 0.8), axis_2_m=(0.3, 0.6), axis_3_m=(0.2, 0.5))


def with_settings(**changes: Any) -> EngineSettings:
    """The words of the paper with changes."""
    return dataclasses.replace(PAPER, **changes)


def ground(name: str = "rock", **changes: float) -> GroundClass:
    values = {
        "eta_max": 0.7, "dp_min": 0.0, "dp_max": 0.3, "mu_f": 0.8, "mu_0": 0.5, "k": 0.2,
        "d_star_m": 0.2,
    }  # fmt: skip
    return GroundClass(name, **(values | changes))


#: Table 1 of Bozzolo and Pamini (1986), with frictions from the middle of their ranges.
ROCK = ground("rock")
DEBRIS = ground("debris", eta_max=0.55, dp_min=0.2, dp_max=0.6, d_star_m=0.3)


def plain(name: str = "rock", **changes: float) -> GroundClass:
    """Ground whose slope does not vary and whose friction does not know the size of the rock."""
    return ground(name, **({"dp_max": 0.0, "k": 0.0, "d_star_m": 0.0} | changes))


def slope(*parts: tuple[float, float], top: float = 500.0) -> tuple[FloatArray, FloatArray]:
    """(s, z) from plan lengths (m) and angles below the horizontal (degrees)."""
    ds = np.array([p[0] for p in parts], float)
    dz = -ds * np.tan(np.radians([p[1] for p in parts]))
    return np.append(0.0, np.cumsum(ds)), np.append(0.0, np.cumsum(dz)) + top


def rough(
    seed: int,
    step: float = 0.5,
    length: float = 120.0,
    angle: float = 36.0,
    amplitude: float = 0.15,
    foot: float = 40.0,
) -> tuple[FloatArray, FloatArray]:
    """(s, z) of a rough slope with a flat foot, segments of ``step``."""
    rng = np.random.default_rng(seed)
    s = np.arange(0.0, length + foot + step, step)
    z = 1000.0 - np.tan(np.radians(angle)) * np.minimum(s, length)
    return s, z + rng.normal(0.0, amplitude, s.size)


def rough_slope(seed: int, angle: float = 36.0) -> tuple[FloatArray, FloatArray]:
    return rough(seed, length=90.0, angle=angle, amplitude=0.12)


def valley() -> tuple[FloatArray, FloatArray]:
    """A smooth slope that flattens step by step: 30, 65, 36, 18 and 0 degrees."""
    return slope((50, 30), (10, 65), (140, 36), (200, 18), (300, 0))


LINES = {"smooth": valley(), "rough": rough(3, amplitude=0.1)}
#: A test on a smooth and a rough ``line``.
on_both_lines = pytest.mark.parametrize("line", LINES.values(), ids=LINES)


def profile_set(*lines: Any, cell: float = 2.0, classes: Any = 0) -> ProfileSet:
    """Profiles from (s, z) pairs, on stretches of equal length in place of cells."""
    s, z = ([np.asarray(line[i], float) for line in lines] for i in (0, 1))
    borders = [np.append(np.arange(own[0], own[-1] - 1e-9, cell), own[-1]) for own in s]
    offset, cells = (
        np.cumsum([0, *sizes]) for sizes in ([v.size for v in s], [v.size - 1 for v in borders])
    )
    return ProfileSet(
        offset,
        np.concatenate(s),
        np.concatenate(z),
        np.broadcast_to(np.asarray(classes, np.int32), offset[-1:]).copy(),
        cells,
        np.concatenate(borders),
        np.arange(cells[-1], dtype=np.int64),
    )


def sphere(radius: float = 0.5, **limits: Any) -> BlockPopulation:
    r = (radius, radius)
    return BlockPopulation(axis_1_m=r, axis_2_m=r, axis_3_m=r, **limits)


def ellipsoid(a: float = 0.5, b: float = 0.4, c: float = 0.3, **limits: Any) -> BlockPopulation:
    return BlockPopulation(axis_1_m=(a, a), axis_2_m=(b, b), axis_3_m=(c, c), **limits)


def sphere_mass(radius: float, density: float = 2700.0) -> float:
    return 4.0 / 3.0 * np.pi * radius**3 * density


def forest(flat: ProfileSet, stems_per_m2: Any, diameter_m: float = 0.3) -> Forest:
    """The same stems on all stretches, or stems for each."""
    stems = np.broadcast_to(np.asarray(stems_per_m2, float), flat.cell.shape).copy()
    return Forest(stems, np.where(stems > 0.0, diameter_m, 0.0))


def run(
    line: Any,
    table: Any,
    blocks: BlockPopulation,
    effects: EffectSettings | None = None,
    *,
    n: int = 1,
    seed: int = 1,
    start: Any = 5.0,
    cell: float = 2.0,
    keys: Any = None,
    settings: EngineSettings | None = None,
    **more: Any,
) -> Simulated:
    """``simulate`` on a ProfileSet or one line (s, z), and one ground class or a table."""
    flat = line if isinstance(line, ProfileSet) else profile_set(line, cell=cell)
    return simulate(
        flat,
        table if isinstance(table, GroundTable) else GroundTable((table,)),
        blocks,
        settings or PAPER,
        seed=seed,
        rocks_per_line=n,
        line_keys=np.arange(len(flat), dtype=np.uint64) if keys is None else keys,
        starts=np.broadcast_to(np.asarray(start, float), (len(flat), 2)),
        effects=effects,
        **more,
    )


def first(log: NDArray[np.void], phase: int) -> np.void:
    """The first event of a phase in a log."""
    return log[np.flatnonzero(log["phase"] == phase)[0]]


def same(one: Simulated, other: Simulated) -> bool:
    """Whether two runs left the same rocks, passages and maps to the last bit."""
    return (
        one.rocks.tobytes() == other.rocks.tobytes()
        and one.passages.tobytes() == other.passages.tobytes()
        and one.pieces.tobytes() == other.pieces.tobytes()
        and all(one.sums[k].tobytes() == other.sums[k].tobytes() for k in one.sums)
    )
