"""Rocks released in a synthetic site: what the kernels take, and what they give."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy import ndimage

from sassgis.gap.check.worlds import motion, motion_state, rigid
from sassgis.gap.check.worlds.forces import Forces, Local, SteadyWind
from sassgis.gap.check.worlds.motion_state import Field, Tables
from sassgis.gap.check.worlds.slopes import guide
from sassgis.gap.check.worlds.world import LAWS, RIGID, Run, World, WorldRocks
from sassgis.model.grid import FloatArray, Grid, IntArray

STEP_S = 0.002


def heights_of(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights of a grid at points (m), bilinear."""
    col, row = grid.col_row(x, y)
    heights: FloatArray = ndimage.map_coordinates(grid.values, [row, col], order=1, mode="nearest")
    return heights


def draw_rocks(world: World, n: int, stream: int) -> WorldRocks:
    """Draw rocks; ``stream`` distinguishes campaigns."""
    rng = np.random.default_rng([world.seed, 303, stream])
    u = rng.random((n, 9))

    def between(limits: tuple[float, float], column: int) -> FloatArray:
        return limits[0] + (limits[1] - limits[0]) * u[:, column]

    blocks = world.blocks
    axes = np.column_stack(
        [
            between(blocks.axis_1_m, 0),
            between(blocks.axis_2_m, 1),
            between(blocks.axis_3_m, 2),
        ]
    )
    flat = _magnitude(world, "rock_shape")
    if world.spec.law == RIGID and flat > 0.0:
        # Slabs: the flat ones flatter, of the same volume.
        thin = np.maximum((axes[:, 2] / axes[:, :2].max(axis=1)) ** flat, 0.25)
        axes *= np.column_stack([thin**-0.5, thin**-0.5, thin])
    axes = -np.sort(-axes, axis=1)
    release = world.releases[np.arange(n) % len(world.releases)]
    speed = between(blocks.speed_mps, 4)
    stated = np.column_stack([release, speed])
    x, y, speed = release[:, 0].copy(), release[:, 1].copy(), speed.copy()
    wrong = _magnitude(world, "release_error")
    if wrong > 0.0:
        # The true places lie elsewhere than those written down, beside or below them and all on one
        # side, and the rocks had been moving.
        offset = np.random.default_rng([world.seed, 404, stream])
        frame = world.relief.frame
        side = np.random.default_rng([world.seed, 405]).uniform(-0.5, 0.5) * math.pi
        ds = np.abs(offset.normal(wrong * math.cos(side), 0.4 * wrong, n))
        dc = offset.normal(wrong * math.sin(side), 0.4 * wrong, n)
        speed += 0.8 * wrong * offset.gamma(2.0, 0.5, n)
        x, y = frame.xy(frame.s(x, y) + ds, frame.c(x, y) + dc)
    gx, gy = guide(world.true_grid)
    hx, hy = -_sample(world.true_grid, gx, x, y), -_sample(world.true_grid, gy, x, y)
    length = np.hypot(hx, hy)
    dip = np.arctan(length)
    phi = math.pi * u[:, 6]
    # Dropped from above where it would lie as it is turned.
    rest = np.hypot(axes[:, 0] * np.sin(phi + dip), axes[:, 1] * np.cos(phi + dip))
    state = np.zeros((n, motion_state.N_STATE))
    state[:, motion_state.X], state[:, motion_state.Y] = x, y
    state[:, motion_state.Z] = (
        heights_of(world.true_grid, x, y) + rest / np.cos(dip) + between(blocks.drop_m, 5)
    )
    # Written down is where the centre was when it was released: as high above the stated place.
    stated[:, 2] += state[:, motion_state.Z] - heights_of(world.true_grid, x, y)
    state[:, motion_state.HX], state[:, motion_state.HY] = hx / length, hy / length
    state[:, motion_state.VX] = speed * np.cos(dip) * state[:, motion_state.HX]
    state[:, motion_state.VY] = speed * np.cos(dip) * state[:, motion_state.HY]
    state[:, motion_state.VZ] = -speed * np.sin(dip)
    state[:, motion_state.PHI] = phi
    state[:, motion_state.A : motion_state.C + 1] = axes
    state[:, motion_state.DENSITY] = between(blocks.density_kgm3, 3)
    state[:, motion_state.HAND] = np.where(u[:, 7] < 0.5, -1.0, 1.0)
    keys = rng.integers(0, 2**63, n, dtype=np.uint64)
    return WorldRocks(state, stated, keys, (np.arange(n) + 0.5) / n)


def _sample(grid: Grid, values: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    return heights_of(replace(grid, values=values), x, y)


def simulate(world: World, rocks: WorldRocks, dt: float = STEP_S) -> Run:
    """Release rocks in a synthetic site.

    Parameters
    ----------
    dt : float
        Time step (s).
    """
    if world.spec.law == RIGID:
        return rigid.run_rocks(world, rocks, _obstacles(world), _wind_direction(world), dt)
    if "field" not in world._fields:
        world._fields["field"] = _field(world)
    n = len(rocks.state)
    room = np.array([4 * n + 64, 12 * n + 64, 80 * n + 64, 400 * n + 64])
    while True:
        tables = Tables(
            deposits=np.zeros((room[0], 3 + len(motion_state.DEPOSIT_COLUMNS))),
            passages=np.zeros((room[1], 3 + len(motion_state.PASSAGE_COLUMNS))),
            impacts=np.zeros((room[2], 3 + len(motion_state.IMPACT_COLUMNS))),
            tracks=np.zeros((room[3], 3 + len(motion_state.TRACK_COLUMNS))),
            used=np.zeros(4, np.int64),
            gain=np.full(n, -1.0),
        )
        ground, forces = world._fields["field"], forces_of(world)
        motion.run_rocks(ground, forces, rocks.state, rocks.keys, rocks.campaign, dt, tables)
        if (tables.used <= room).all():
            break
        room = np.maximum(room, tables.used)
    d, p, i, t = (int(k) for k in tables.used)
    return Run(
        rocks,
        tables.deposits[:d],
        tables.passages[:p],
        tables.impacts[:i],
        tables.tracks[:t],
        tables.gain,
    )


def _magnitude(world: World, name: str) -> float:
    return max((e.magnitude for e in world.effects if e.name == name), default=0.0)


def forces_of(world: World) -> Forces:
    """The effects of a site as the kernels take them."""
    slots = {
        "lateral_deflection": "facets",
        "fragmentation": "breaking",
        "soft_ground": "soft",
        "entrainment": "loose",
        "air_drag": "air",
        "roughness": "bumps",
        "rock_shape": "plates",
        "snow": "snow",
        "ice": "ice",
        "wetting": "wet",
        "magnus": "magnus",
    }
    found: dict[str, Local] = {}
    wind = SteadyWind()
    for effect in world.effects:
        if effect.name in slots:
            local = Local(float(effect.magnitude), float(effect.s0_m), float(effect.s1_m))
            found[slots[effect.name]] = local
        elif effect.name == "wind":
            turn = _wind_direction(world)
            wind = SteadyWind(float(effect.magnitude), math.cos(turn), math.sin(turn))
    own = {"loss": Local(world.speed_loss), "edges": Local(world.edges_rad)}
    return Forces(**found, **own, wind=wind)


def _wind_direction(world: World) -> float:
    """Direction of a wind in plan, askew to the slope (rad, counter-clockwise from east)."""
    seed = next((e.seed for e in world.effects if e.name == "wind"), 0)
    turn = float(np.random.default_rng([seed, 5]).uniform(0.5, 1.2))
    frame = world.relief.frame
    return math.atan2(frame.uy, frame.ux) + (turn if seed % 2 else -turn)


def _field(world: World) -> Field:
    grid = world.true_grid
    gx, gy = guide(grid)
    obstacles = _obstacles(world)
    start, near = _by_cell(grid, obstacles)
    frame = world.relief.frame
    return Field(
        np.ascontiguousarray(grid.values),
        gx,
        gy,
        float(grid.west),
        float(grid.north),
        float(grid.cell_size),
        world.ground,
        world.law,
        LAWS.index(world.spec.law),
        frame.x0,
        frame.y0,
        frame.ux,
        frame.uy,
        np.ascontiguousarray(world.stations_s),
        start,
        near,
        obstacles,
    )


def _obstacles(world: World) -> FloatArray:
    """Stems and lying blocks: x, y, radius (m), capacity (J), height (m), mass (kg)."""
    rows = []
    for effect in world.effects:
        if effect.name not in ("trees", "collisions"):
            continue
        rng = np.random.default_rng([effect.seed, 606])
        frame, belt = world.relief.frame, (effect.s0_m, effect.s1_m)
        spacing = 1.6 if effect.name == "trees" else 1.8
        s, c = _scatter(rng, belt, 70.0, spacing)
        # Thinning by rank: a denser stand holds all the stems of a lighter one.
        rank = rng.random(len(s))
        keep = rank < effect.magnitude
        x, y = frame.xy(s, c)
        size = rng.standard_normal(len(s))
        if effect.name == "trees":
            dbh = np.clip(0.28 * np.exp(0.4 * size), 0.08, 0.9)
            # A green stem bends plastically until its fibres fail: energy as the cube of DBH.
            capacity = 2.2e6 * dbh**3
            row = [x, y, 0.5 * dbh, capacity, np.full(len(s), 1e3), np.zeros(len(s))]
        else:
            radius = np.clip(0.4 * np.exp(0.3 * size), 0.2, 0.9)
            mass = 2700.0 * 4.0 / 3.0 * math.pi * radius**3
            row = [x, y, radius, np.full(len(s), 1e12), 1.6 * radius, mass]
        rows.append(np.column_stack(row)[keep])
    return np.concatenate(rows) if rows else np.zeros((0, 6))


def _scatter(
    rng: np.random.Generator, belt: tuple[float, float], half_width: float, spacing: float
) -> tuple[FloatArray, FloatArray]:
    """Points no nearer to each other than ``spacing``: a Poisson-disc process by darts."""
    low, high = belt
    cell = spacing / math.sqrt(2.0)
    n_s = int((high - low) / cell) + 1
    n_c = int(2.0 * half_width / cell) + 1
    taken = np.full((n_s + 4, n_c + 4, 2), 1e9)
    tries = 4 * n_s * n_c // 2
    darts = np.column_stack(
        [rng.uniform(low, high, tries), rng.uniform(-half_width, half_width, tries)]
    )
    kept = []
    for s, c in darts:
        i, j = int((s - low) / cell) + 2, int((c + half_width) / cell) + 2
        around = taken[i - 2 : i + 3, j - 2 : j + 3]
        if ((around[..., 0] - s) ** 2 + (around[..., 1] - c) ** 2 < spacing**2).any():
            continue
        taken[i, j] = s, c
        kept.append((s, c))
    points = np.array(kept).reshape(-1, 2)
    return points[:, 0], points[:, 1]


def _by_cell(grid: Grid, obstacles: FloatArray) -> tuple[IntArray, IntArray]:
    """For each cell the obstacles that a rock in it may reach: offsets and numbers."""
    n_rows, n_cols = grid.shape
    if not len(obstacles):
        return np.zeros(n_rows * n_cols + 1, np.int64), np.zeros(0, np.int64)
    col = np.floor((obstacles[:, 0] - grid.west) / grid.cell_size).astype(np.int64)
    row = np.floor((grid.north - obstacles[:, 1]) / grid.cell_size).astype(np.int64)
    cells, numbers = [], []
    for di in (-1, 0, 1):
        for dj in (-1, 0, 1):
            i, j = row + di, col + dj
            inside = (i >= 0) & (i < n_rows) & (j >= 0) & (j < n_cols)
            cells.append((i * n_cols + j)[inside])
            numbers.append(np.flatnonzero(inside))
    cell, number = np.concatenate(cells), np.concatenate(numbers)
    order = np.lexsort((number, cell))
    start = np.searchsorted(cell[order], np.arange(n_rows * n_cols + 1))
    return start.astype(np.int64), number[order].astype(np.int64)
