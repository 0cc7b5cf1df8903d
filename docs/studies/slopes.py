"""Slopes of the samples for the studies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.simulate import simulate
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.inputs.config import load_config
from sassgis.inputs.csv_table import read_profile
from sassgis.inputs.ground_map import read_ground_table
from sassgis.outputs.site_template import sample_folder
from sassgis.runs.inputs import read_map_run
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.ground import GroundTable
from sassgis.settings.results import ControlLine, ControlLineCrossings, ProfileSet, TraceSet
from sassgis.settings.settings import EngineSettings
from sassgis.terrain.fall_lines import trace
from sassgis.terrain.flatten import profiles
from sassgis.terrain.prepare import LEAD_IN_M, draw_keys, plan, take_lines, usable, with_lead_in
from sassgis.terrain.release import take

#: Side of the cells of the strip of terrain that represents a profile from a table (m).
STRIP_CELL_M = 0.25


@dataclass(frozen=True)
class Slope:
    """One fall line that can be flattened with any tolerance."""

    name: str
    grid: Grid
    ground: NDArray[np.int32]  # shape of the grid
    trace: TraceSet  # a single line
    table: GroundTable
    blocks: BlockPopulation
    key: NDArray[np.uint64]  # shape (1,); identity for the random draws
    start: tuple[float, float]  # chainages between which rocks start (m)

    @property
    def length_m(self) -> float:
        """Plan length."""
        return float(self.trace.s[-1])

    def profile(self, tolerance_m: float) -> ProfileSet:
        """The flattened line, without the ground behind its start."""
        return profiles(self.grid, self.trace, self.ground, tolerance_m)


def valley_slopes(n: int) -> list[Slope]:
    """``n`` fall lines of the sample valley, with the readings and classes of 1986, spread evenly
    over its release points.
    """
    config = load_config(sample_folder() / "valley" / "config.toml")
    run = read_map_run(replace(config, engine=EngineSettings(readings="1986")))
    planned = plan(run)
    traces = trace(run.grid, planned.surface, planned.starts, run.terrain)
    good = np.flatnonzero(usable(traces, 100.0))
    chosen = good[np.linspace(0, good.size - 1, n).round().astype(int)]
    out = []
    for i in chosen:
        line = take_lines(traces, np.arange(len(traces)) == i)
        point = int(line.point[0])
        blocks = run.blocks[planned.scenarios[planned.starts.area[point]][0]]
        own = take(planned.starts, np.array([point]))
        line = replace(line, point=np.zeros(1, np.int64))
        out.append(
            Slope(
                f"valley, release point {point}",
                run.grid,
                run.ground,
                line,
                run.table,
                blocks,
                draw_keys(own.key, blocks.name),
                (0.0, min(2.0 * float(planned.moved[point]), float(line.s[-1]))),
            )
        )
    return out


def table_slope(name: str, config_name: str) -> Slope:
    """A profile of the samples, laid on a narrow strip of fine terrain."""
    config = load_config(sample_folder() / name / config_name)
    settings = config.profile
    assert settings is not None and settings.file is not None
    table = read_ground_table(config.ground.classes, config.engine.readings)
    given = read_profile(settings.file, table, config.ground.default)
    cell = STRIP_CELL_M
    centres = np.arange(given.s[0] + 0.5 * cell, given.s[-1], cell)
    row = np.interp(centres, given.s, given.z)
    classes = given.ground[np.searchsorted(given.s, centres, side="right") - 1]
    grid = Grid(np.tile(row, (3, 1)), float(given.s[0]), 3.0 * cell, cell)
    ends = np.array([centres[0], centres[-1]])
    trace = TraceSet(
        np.array([0, 2], np.int64),
        ends,
        np.full(2, 1.5 * cell),
        ends - ends[0],
        np.zeros(1, np.int64),
        np.zeros(1, np.uint8),
    )
    return Slope(
        name,
        grid,
        np.tile(classes, (3, 1)).astype(np.int32),
        trace,
        table,
        config.blocks[0],
        np.zeros(1, np.uint64),
        settings.start_m,
    )


def follow(
    slope: Slope,
    flat: ProfileSet,
    rocks: int,
    seed: int,
    stations_m: Sequence[float] = (),
    settings: EngineSettings | None = None,
    *,
    lead_in: bool = True,
) -> tuple[NDArray[np.void], FloatArray, FloatArray]:
    """Simulate rocks on one profile, with ground added behind its start unless it has it.

    Returns
    -------
    rocks : ROCK_DTYPE, shape (rocks,)
    energy, height : float64, shape (n_stations, rocks)
        Total energy (kJ) and passing height (m) of the first passage; NaN for rocks that do not
        come to the station.
    """
    control_lines = [ControlLine(f"{c:g} m", "station") for c in stations_m]
    result = simulate(
        with_lead_in(flat, LEAD_IN_M) if lead_in else flat,
        slope.table,
        slope.blocks,
        settings or EngineSettings(readings="1986"),
        seed=seed,
        rocks_per_line=rocks,
        line_keys=slope.key,
        starts=np.array([slope.start]),
        control_lines=ControlLineCrossings.same_for_all(control_lines, list(stations_m), 1),
    )
    energy, height = np.full((2, len(control_lines), rocks), np.nan)
    rows = result.passages
    where: tuple[IntArray, IntArray] = (rows["control_line"].astype(int), rows["rock"].astype(int))
    energy[where] = rows["energy_trans_kj"] + rows["energy_rot_kj"]
    height[where] = rows["height_m"]
    return result.rocks, energy, height


def split(flat: ProfileSet, parts: int) -> ProfileSet:
    """Every segment of a single profile divided into equal parts that lie on it."""
    shares = np.arange(parts) / parts
    s = np.append((flat.s[:-1, None] + np.diff(flat.s)[:, None] * shares).ravel(), flat.s[-1])
    z = np.append((flat.z[:-1, None] + np.diff(flat.z)[:, None] * shares).ravel(), flat.z[-1])
    ground = np.append(np.repeat(flat.ground[:-1], parts), flat.ground[-1]).astype(np.int32)
    return ProfileSet(
        np.array([0, s.size], np.int64), s, z, ground, flat.cell_offset, flat.cell_s, flat.cell
    )
