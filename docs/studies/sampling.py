"""Does another way of drawing blocks give the same certainty in less time?

``python docs/studies/sampling.py DATA -o docs/studies/sampling`` simulates blocks from some release
points of the sample valley and of a terrain model of Land Tirol in DATA. It writes after an hour or
so sampling.json: the variance of reach probabilities between many repetitions times processor time,
of plain sampling over that of

- draws of size, density, orientation, place, drift and rolling friction that are spread evenly over
  the blocks of each release point: Latin hypercubes (McKay, Beckman and Conover 1979) and scrambled
  Sobol sequences (Owen 1995);
- multilevel splitting (Kahn and Harris 1951; Glasserman et al. 1999): a block that comes to a
  chainage goes on as several, each with its share of the weight and with draws of its own.

Splitting at the start says how much of the variance is that of what is drawn there: no spreading of
these draws can take away more. The motion is that of the engine; what blocks leave is counted here.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path as File
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.stats import qmc

from docs.studies.tirol import config_of
from docs.studies.zone_seeds import VALLEY
from sassgis.compiled import rng
from sassgis.compiled.jit import kernel
from sassgis.engine.block import move, start_released
from sassgis.engine.cell_register import empty_register
from sassgis.engine.draws import draw_block
from sassgis.engine.effects.hooks import BLOCK_DTYPE
from sassgis.engine.ellipse import empty_table, record_type
from sassgis.engine.ground_ahead import Path, room_ahead
from sassgis.engine.heading import start_path
from sassgis.engine.recording import ENERGY, STRETCH_DTYPE, empty_work
from sassgis.engine.simulate import setup_of
from sassgis.engine.simulate_paths import PathTerrain, path_of, places_of
from sassgis.engine.state import (
    END,
    EVENT_DTYPE,
    SPAWNED_DTYPE,
    VERTEX_DTYPE,
    Block,
    Output,
    Site,
)
from sassgis.grid import FloatArray
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_map_run
from sassgis.settings.map_run import MapRun, ObjectCells
from sassgis.settings.results import PASSAGE_DTYPE
from sassgis.terrain.cells import exact_positions
from sassgis.terrain.prepare import plan
from sassgis.terrain.release import take

POINTS, BLOCKS, PILOT, REPEATED = 32, 256, 8192, 40
ROOM = 1 << 18
#: What is drawn at the start: three axes, density, orientation, place, drift, rolling friction.
AXIS_1, AXIS_2, AXIS_3, DENSITY, ORIENTATION, AT_U, AT_V, DRIFT, FRICTION = range(9)
#: Shares of the blocks of a point that come as far as the distances looked at.
FAR = (0.1, 0.01, 0.001)
#: Cells by the share of all blocks that comes to them.
CLASSES = ((0.01, 1.0), (0.001, 0.01), (0.0001, 0.001), (0.0, 0.0001))


@dataclass(frozen=True)
class Design:
    """A way of sampling."""

    name: str
    draws: str = "random"  # or "latin" or "sobol": of what is drawn at the start
    # Shares of the blocks of a point that come to the chainages at which they are split; 1 is the
    # start.
    levels: tuple[float, ...] = ()
    copies: int = 1  # as which a block goes on from each of them


PLAIN = Design("plain")
DESIGNS = (
    PLAIN,
    Design("split at the start into 4", levels=(1.0,), copies=4),
    Design("Latin hypercube", "latin"),
    Design("Sobol sequence", "sobol"),
    Design("split at 10 % into 5", levels=(0.1,), copies=5),
    Design("split at 30, 10, 3 % into 3", levels=(0.3, 0.1, 0.03), copies=3),
    Design("split at 50, 25, 12, 6, 3, 1.5 % into 2",
           levels=(0.5, 0.25, 0.12, 0.06, 0.03, 0.015), copies=2),
)  # fmt: skip


# ---------------------------------------------------------------------------------------------
# Blocks that are split


@kernel
def _with(block: Block, key: np.uint64, drag: float) -> Block:
    """The block with other draws to come and another rolling friction."""
    return Block(
        block.a, block.b, block.c, block.density, block.mass, key, block.inertia, block.radius,
        block.roll_radius, block.roll_share, drag,
    )  # fmt: skip


@kernel
def _drifting(path: Path, drift: float) -> Path:
    """The path with another standard deviation of the drift."""
    return Path(
        path.heights, path.ground, path.stems, path.diameter, path.cell_size, path.tolerance,
        path.side_tilt, drift, path.sides, path.line_u, path.line_v, path.line_first, path.line_box,
        path.lines, path.line_seen, path.near, path.register,
    )  # fmt: skip


@kernel
def _copy(rows: Any, to: Any, n: int) -> None:
    """Copy the rows of so many segments."""
    for i in range(n + 1):
        to[i] = rows[i]


@kernel
def _released(
    key: Any, drawn: Any, limits: Any, physics: Any, path: Path, site: Site, state: Any
) -> Block:
    """A block, let go with what was drawn for it; sets its state."""
    for k in range(2):
        limits[k].axis_1_m = drawn[AXIS_1]
        limits[k].axis_2_m = drawn[AXIS_2]
        limits[k].axis_3_m = drawn[AXIS_3]
        limits[k].density_kgm3 = drawn[DENSITY]
        limits[k].orientation_rad = drawn[ORIENTATION]
    block = _with(draw_block(limits[0], limits[1], key), key, drawn[FRICTION])
    # The engine multiplies a standard deviation by a draw of the block's own.
    own_path = _drifting(path, drawn[DRIFT] / rng.normal(key, rng.DRIFT, 0))
    start_path(None, state, block, site, own_path, drawn[AT_U], drawn[AT_V])
    start_released(state, block, site, physics, limits[0], limits[1], key, 0.0)
    return block


@kernel
def _newly_met(
    state: Any, output: Output, marked: Any, stack: Any, n: int, cells: Any, weight: float
) -> int:
    """Add the weight of a block to the cells that it has met just now, but for marked ones.

    They are marked, and come to the top of a stack of ``n``; returns how many there are then.
    """
    for i in range(state.n_touched):
        cell = output.work.touched[i]
        output.work.peak[cell, ENERGY] = -1.0
        if not marked[cell]:
            marked[cell] = True
            stack[n] = cell
            n += 1
            cells[cell] += weight
    state.n_touched = 0
    return n


@kernel
def follow_split(
    keys: Any, drawn: Any, limits: Any, physics: Any, path: Path, site: Site, state_row: Any,
    output: Output, kept: Any, vertices: Any, stretches: Any, levels: Any, copies: Any, far: Any,
    cells: Any, came: Any, furthest: Any,
) -> None:  # fmt: skip
    """Add the blocks of a release point: the weight that comes to each cell and distance.

    Of each depth of splitting ``kept``, ``vertices`` and ``stretches`` hold the state at the level,
    from which the copies go on one after the other. ``cells`` and ``came`` are added to.
    """
    depths = levels.size
    state = state_row[0]
    left = np.zeros(depths + 1, np.int64)
    # Of the stack of cells that a block has met, where those of each depth begin.
    first = np.zeros(depths + 2, np.int64)
    marked = np.zeros(cells.size, np.bool_)
    stack = np.zeros(cells.size, np.int64)
    sizes = np.zeros((depths, 2), np.int64)  # segments and stretches that are kept
    for r in range(keys.size):
        block = _released(keys[r], drawn[r], limits, physics, path, site, state)
        left[0] = 1
        depth = 0
        going = 0
        while depth >= 0:
            if left[depth] == 0:
                # All copies have ended: back to the block that they are copies of.
                depth -= 1
                for i in range(first[max(depth, 0)], first[depth + 1]):
                    marked[stack[i]] = False
                continue
            left[depth] -= 1
            going += 1
            before = -1.0
            if depth > 0:
                state_row[0] = kept[depth]
                site.profile.n[0], site.stretches.n[0] = sizes[depth - 1]
                _copy(vertices[depth - 1], site.profile.rows, site.profile.n[0])
                _copy(stretches[depth - 1], site.stretches.rows, site.stretches.n[0])
                block = _with(block, rng.mix(keys[r] + np.uint64(going)), block.drag)
                before = state.furthest
            until = levels[depth] if depth < depths else np.inf
            move(state, block, site, output, physics, None, path, until)
            weight = copies ** float(-depth)
            top = _newly_met(state, output, marked, stack, first[depth], cells, weight)
            first[depth + 1] = top
            for i in range(far.size):
                if before < far[i] <= state.furthest:
                    came[i] += weight
            furthest[r] = state.furthest
            if state.phase == END or depth == depths:
                for i in range(first[depth], top):
                    marked[stack[i]] = False
                continue
            depth += 1
            kept[depth] = state
            sizes[depth - 1] = site.profile.n[0], site.stretches.n[0]
            _copy(site.profile.rows, vertices[depth - 1], site.profile.n[0])
            _copy(site.stretches.rows, stretches[depth - 1], site.stretches.n[0])
            left[depth] = copies


class Points:
    """Release points of a map, from which blocks are followed with any design."""

    def __init__(self, run: MapRun) -> None:
        planned = plan(run)
        chosen = np.linspace(0, len(planned.points) - 1, POINTS).round().astype(int)
        points = take(planned.points, chosen)
        self.u, self.v = places_of(run.heights, points)
        scenarios = [planned.scenarios[a] for a in points.area]
        self.blocks = [run.blocks[own[k % len(own)]] for k, own in enumerate(scenarios)]
        terrain = PathTerrain(run.heights, run.ground, run.terrain.segment_tolerance_m)
        register = empty_register(run.heights.shape, ROOM, None, ObjectCells.none())
        self.path = path_of(terrain, run.engine, register, points)
        self.setup = setup_of(
            run.table, self.blocks, run.engine, lines=(), effects=run.effects, first_rock=0,
            n_blocks=BLOCKS, seed=run.seed,
        )  # fmt: skip
        self.site = room_ahead(self.setup.grounds)
        self.output = Output(
            np.zeros(1, np.dtype((np.record, PASSAGE_DTYPE))), empty_work(ROOM, False),
            empty_table(0, EVENT_DTYPE), empty_table(0, SPAWNED_DTYPE),
        )  # fmt: skip
        self.drift = np.radians(run.engine.drift_deg)

    def starts(self, point: int, unit: FloatArray) -> FloatArray:
        """What is drawn of blocks at their start, from numbers between 0 and 1, (n, 9)."""
        low, high = self.setup.limits[point]
        out = np.empty_like(unit)
        names = ("axis_1_m", "axis_2_m", "axis_3_m", "density_kgm3", "orientation_rad")
        for k, name in enumerate(names):
            out[:, k] = low[name] + (high[name] - low[name]) * unit[:, k]
        aside = (unit[:, [AT_U, AT_V]] - 0.5) @ self.path.sides[point].reshape(2, 2)
        for k, middle in enumerate((self.u, self.v)):
            out[:, (AT_U, AT_V)[k]] = middle[point] + exact_positions(aside[:, k])
        out[:, DRIFT] = self.drift * special.ndtri(unit[:, DRIFT])
        sd = self.setup.physics.rolling_friction_sd
        out[:, FRICTION] = np.exp(sd * special.ndtri(unit[:, FRICTION]))
        return out

    def follow(
        self, point: int, unit: FloatArray, seed: np.random.Generator, levels: FloatArray,
        copies: int, far: FloatArray, cells: FloatArray,
    ) -> tuple[FloatArray, FloatArray, float]:  # fmt: skip
        """Blocks of a point: how many come to each distance, how far each comes, seconds."""
        n = unit.shape[0]
        depths = levels.size
        came, furthest = np.zeros(far.size), np.zeros(n)
        keys = seed.integers(0, 2**64, n, np.uint64)
        room = (
            np.zeros(depths + 1, BLOCK_DTYPE),
            np.zeros((depths, self.site.profile.rows.size), VERTEX_DTYPE),
            np.zeros((depths, self.site.stretches.rows.size), STRETCH_DTYPE),
        )
        drawn = self.starts(point, unit)
        limits = self.setup.limits[point].astype(record_type(*self.setup.limits.dtype.descr))
        began = time.process_time()
        follow_split(
            keys, drawn, limits, self.setup.physics, self.path, self.site,
            np.zeros(1, BLOCK_DTYPE), self.output, *room, levels, copies, far, cells, came, furthest
        )  # fmt: skip
        took = time.process_time() - began
        assert not self.path.register.full
        return came / n, furthest, took


def units(design: Design, seed: np.random.Generator, n: int) -> FloatArray:
    """Numbers between 0 and 1 for what is drawn at the start, (n, 9)."""
    if design.draws == "latin":
        return qmc.LatinHypercube(9, rng=seed).random(n)
    if design.draws == "sobol":
        # Scrambled to 30 bits: 0 may come out.
        return np.clip(qmc.Sobol(9, rng=seed).random(n), 1e-9, 1.0 - 1e-9)
    return seed.random((n, 9))


# ---------------------------------------------------------------------------------------------
# Variance times time


def sampled(run: MapRun, repeated: int) -> dict[str, tuple[NDArray, NDArray, float]]:
    """Of each design reach of cells and distances in each repetition, and seconds in all."""
    site = Points(run)
    seed = np.random.default_rng(1)
    none = np.empty(0)
    waste = np.zeros(ROOM)
    pilot = [
        site.follow(p, units(PLAIN, seed, PILOT), seed, none, 1, none, waste)[1]
        for p in range(POINTS)
    ]
    far = [np.quantile(own, [1.0 - s for s in FAR]) for own in pilot]
    cells = {d.name: np.zeros((repeated, ROOM), np.float32) for d in DESIGNS}
    came = {d.name: np.zeros((repeated, POINTS, len(FAR))) for d in DESIGNS}
    took = dict.fromkeys(cells, 0.0)
    # One after the other in each repetition: a busy machine then slows all of them down alike.
    for k in range(repeated):
        for design in DESIGNS:
            own = np.zeros(ROOM)
            for p in range(POINTS):
                levels = np.array([
                    -1.0 if s == 1.0 else np.quantile(pilot[p], 1.0 - s) for s in design.levels
                ])  # fmt: skip
                came[design.name][k, p], _, seconds = site.follow(
                    p, units(design, seed, BLOCKS), seed, levels, design.copies, far[p], own
                )
                took[design.name] += seconds
            cells[design.name][k] = own / (POINTS * BLOCKS)
        print(k, flush=True)
    return {name: (cells[name], came[name], took[name]) for name in cells}


def variances(cells: NDArray, came: NDArray, of: list[NDArray]) -> FloatArray:
    """Variance between repetitions: summed over each class of cells, over points by distance."""
    by_cell = cells.var(axis=0, ddof=1)
    return np.array([by_cell[own].sum() for own in of] + list(came.var(axis=0, ddof=1).sum(axis=0)))


def rows_of(site: str, found: dict[str, tuple[NDArray, NDArray, float]]) -> Iterator[dict]:
    """A row for each design: how many times less it takes than plain sampling."""
    mean = np.mean([own[0].mean(axis=0) for own in found.values()], axis=0)
    of = [np.flatnonzero((mean > low) & (mean <= high)) for low, high in CLASSES]
    cells = {name: own[0][:, mean > 0.0] for name, own in found.items()}
    place = np.cumsum(mean > 0.0) - 1
    of = [place[own] for own in of]
    plain_cells, plain_came, plain_took = cells[PLAIN.name], *found[PLAIN.name][1:]
    n = plain_cells.shape[0]
    seed = np.random.default_rng(2)
    for design in DESIGNS:
        own_cells, (_, own_came, took) = cells[design.name], found[design.name]
        per_time = plain_took / took
        gain = variances(plain_cells, plain_came, of) / variances(own_cells, own_came, of)
        drawn = []
        for _ in range(200):
            a, b = seed.integers(0, n, (2, n))
            drawn.append(
                variances(plain_cells[a], plain_came[a], of)
                / variances(own_cells[b], own_came[b], of)
            )
        error = np.std(drawn, axis=0, ddof=1)
        yield {
            "site": site, "design": design.name, "time": took / plain_took,
            "variance": (1.0 / gain).tolist(), "gain": (gain * per_time).tolist(),
            "error": (error * per_time).tolist(),
            "reach": (own_came.mean(axis=(0, 1)) / plain_came.mean(axis=(0, 1))).tolist(),
            "blocks": BLOCKS * POINTS, "repeated": n, "seconds": took,
        }  # fmt: skip


def main() -> None:
    """Compare all designs on both terrains."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=File)
    parser.add_argument("-o", "--output", type=File, required=True)
    parser.add_argument("--repeated", type=int, default=REPEATED)
    given = parser.parse_args()
    rows: list[dict] = []
    with TemporaryDirectory() as work:
        other = File(work) / "avaKot.toml"
        other.write_text(config_of(given.data, "avaKot", spacing=20.0), encoding="utf-8")
        for name, path in (("valley", VALLEY), ("avaKot", other)):
            run = read_map_run(load_config(path))
            rows += rows_of(name, sampled(run, given.repeated))
    given.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"far": FAR, "classes": CLASSES, "rows": rows}, indent=1)
    (given.output / "sampling.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
