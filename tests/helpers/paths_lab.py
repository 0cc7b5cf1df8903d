"""Short ways to follow paths on small terrains."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from helpers.terrains import middle, points_at

from sassgis.engine.simulate import Simulated
from sassgis.engine.simulate_paths import PathTerrain, follow
from sassgis.grid import FloatArray, Grid
from sassgis.inputs.ground_map import built_in_table
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.ground import GroundClass, GroundTable
from sassgis.settings.map_run import Forest
from sassgis.settings.results import ControlLine
from sassgis.settings.settings import EngineSettings

TABLE = built_in_table()
DEBRIS = TABLE.classes[TABLE.index("debris")]
ROCK = TABLE.classes[TABLE.index("rock")]
MIXED = BlockPopulation("b", (0.3, 0.6), (0.25, 0.5), (0.2, 0.4), (2600.0, 2750.0), drop_m=(1, 2))
#: Blocks are the ellipses that they state.
HAZARD = EngineSettings(outline_edges=0.0, outline_share=1.0)
#: Without tilt and drift a block keeps to the fall line of a plane.
STRAIGHT = EngineSettings(side_tilt_deg=0.0, drift_deg=0.0)


def paths(
    grid: Grid,
    x: Any = 0.0,
    y: Any = 0.0,
    *,
    n: int = 500,
    on: GroundClass | GroundTable = DEBRIS,
    classes: Any = 0,
    blocks: BlockPopulation = MIXED,
    settings: EngineSettings = HAZARD,
    tolerance: float = 0.25,
    seed: int = 1,
    keys: Any = None,
    lines: tuple[tuple[ControlLine, FloatArray], ...] = (),
    forest: Forest | None = None,
    sides: Any = None,
    **more: Any,
) -> Simulated:
    """Paths of ``n`` blocks from each point, in coordinates from the middle of the grid."""
    x0, y0 = middle(grid)
    x, y = np.broadcast_arrays(x, y)
    points = points_at(x + x0, y + y0)
    if sides is not None:
        points = replace(points, sides=np.broadcast_to(sides, (len(points), 2, 2)))
    traces = [(line, trace + np.array([x0, y0])) for line, trace in lines]
    under = np.broadcast_to(np.asarray(classes, np.int32), grid.shape).copy()
    return follow(
        PathTerrain(grid, under, tolerance, traces, forest), points,
        on if isinstance(on, GroundTable) else GroundTable((on,)), blocks, settings, seed=seed,
        rocks_per_point=n,
        point_keys=points.key + np.uint64(7) if keys is None else np.asarray(keys, np.uint64),
        **more,
    )  # fmt: skip


def ends(grid: Grid, out: Simulated) -> tuple[FloatArray, FloatArray]:
    """Where blocks came to rest, from the middle of the grid."""
    x0, y0 = middle(grid)
    return out.x - x0, out.y - y0
