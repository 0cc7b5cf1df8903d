"""Rocks released in a synthetic site: what the kernels take, and what they give."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import ndimage

from sassgis.gap.check.worlds import motion, rigid
from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds.forces import Forces, Local, SteadyWind
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

    def between(name: str, column: int) -> FloatArray:
        low, high = world.blocks[name]
        return low + (high - low) * u[:, column]

    axes = np.column_stack([between(f"axis_{k + 1}_m", k) for k in range(3)])
    flat = _magnitude(world, "rock_shape")
    if world.spec.law == RIGID and flat > 0.0:
        # Slabs: the flat ones flatter, of the same volume.
        thin = np.maximum((axes[:, 2] / axes[:, :2].max(axis=1)) ** flat, 0.25)
        axes *= np.column_stack([thin**-0.5, thin**-0.5, thin])
    axes = -np.sort(-axes, axis=1)
    release = world.releases[np.arange(n) % len(world.releases)]
    speed = between("speed_mps", 4)
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
    grid = world.true_grid
    hx, hy = (-heights_of(replace(grid, values=own), x, y) for own in guide(grid))
    length = np.hypot(hx, hy)
    dip = np.arctan(length)
    phi = math.pi * u[:, 6]
    # Dropped from above where it would lie as it is turned.
    rest = np.hypot(axes[:, 0] * np.sin(phi + dip), axes[:, 1] * np.cos(phi + dip))
    ground = heights_of(grid, x, y)
    z = ground + rest / np.cos(dip) + between("drop_m", 5)
    # Written down is where the centre was when it was released: as high above the stated place.
    stated[:, 2] += z - ground
    hx, hy = hx / length, hy / length
    onward = speed * np.cos(dip)
    state = np.zeros((n, ms.N_STATE))
    state[:, ms.X : ms.Z + 1] = np.column_stack([x, y, z])
    state[:, ms.VX : ms.VZ + 1] = np.column_stack([onward * hx, onward * hy, -speed * np.sin(dip)])
    state[:, [ms.HX, ms.HY, ms.PHI]] = np.column_stack([hx, hy, phi])
    state[:, ms.A : ms.C + 1] = axes
    state[:, ms.DENSITY] = between("density_kgm3", 3)
    state[:, ms.HAND] = np.where(u[:, 7] < 0.5, -1.0, 1.0)
    state[:, ms.CAMPAIGN] = (np.arange(n) + 0.5) / n
    return WorldRocks(state, stated, rng.integers(0, 2**63, n, dtype=np.uint64))


def simulate(world: World, rocks: WorldRocks, dt: float = STEP_S) -> Run:
    """Release rocks in a synthetic site, in time steps of ``dt`` (s)."""
    if world.spec.law == RIGID:
        return rigid.run_rocks(world, rocks, _obstacles(world), _wind_direction(world), dt)
    field, forces, n = _field(world), forces_of(world), len(rocks.state)
    room = np.array([4, 12, 80, 400]) * n + 64
    while True:
        tables = ms.Tables.of(room, n)
        motion.run_rocks(field, forces, rocks.state, rocks.keys, dt, tables)
        if (tables.used <= room).all():
            break
        room = np.maximum(room, tables.used)
    d, p, i, t = (table[:used] for table, used in zip(tables[:4], tables.used, strict=True))
    return Run(rocks, d, p, i, t, tables.gain)


def _magnitude(world: World, name: str) -> float:
    return max((e.magnitude for e in world.effects if e.name == name), default=0.0)


def forces_of(world: World) -> Forces:
    """The effects of a site as the kernels take them."""
    found: dict[str, Any] = {"loss": Local(world.speed_loss), "edges": Local(world.edges_rad)}
    for effect in world.effects:
        if effect.name == "wind":
            turn = _wind_direction(world)
            found["wind"] = SteadyWind(effect.magnitude, math.cos(turn), math.sin(turn))
        elif effect.name in Forces._fields:
            found[effect.name] = Local(effect.magnitude, effect.s0_m, effect.s1_m)
    return Forces(**found)


def _wind_direction(world: World) -> float:
    """Direction of a wind in plan, askew to the slope (rad, counter-clockwise from east)."""
    seed = next((e.seed for e in world.effects if e.name == "wind"), 0)
    turn = float(np.random.default_rng([seed, 5]).uniform(0.5, 1.2))
    frame = world.relief.frame
    return math.atan2(frame.uy, frame.ux) + (turn if seed % 2 else -turn)


def _field(world: World) -> ms.Field:
    grid, frame, obstacles = world.true_grid, world.relief.frame, _obstacles(world)
    return ms.Field(
        np.ascontiguousarray(grid.values), *guide(grid),
        float(grid.west), float(grid.north), float(grid.cell_size),
        world.ground, world.law, LAWS.index(world.spec.law),
        frame.x0, frame.y0, frame.ux, frame.uy,
        np.ascontiguousarray(world.stations_s), *_by_cell(grid, obstacles), obstacles,
    )  # fmt: skip


def _obstacles(world: World) -> FloatArray:
    """Stems and lying blocks: x, y, radius (m), capacity (J), height (m), mass (kg)."""
    rows = []
    for effect in world.effects:
        if effect.name not in ("trees", "collisions"):
            continue
        rng = np.random.default_rng([effect.seed, 606])
        spacing = 1.6 if effect.name == "trees" else 1.8
        s, c = _scatter(rng, effect.s0_m, effect.s1_m, spacing)
        # Thinning by rank: a denser stand holds all the stems of a lighter one.
        keep = rng.random(len(s)) < effect.magnitude
        x, y = world.relief.frame.xy(s, c)
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
    rng: np.random.Generator, low: float, high: float, spacing: float
) -> tuple[FloatArray, FloatArray]:
    """Points no nearer to each other than ``spacing``: a Poisson-disc process by darts."""
    half_width = 70.0
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
    col = np.floor((obstacles[:, 0] - grid.west) / grid.cell_size).astype(np.int64)
    row = np.floor((grid.north - obstacles[:, 1]) / grid.cell_size).astype(np.int64)
    # The cell of each and the eight around it.
    di, dj = np.indices((3, 3)).reshape(2, 9, 1) - 1
    i, j = row + di, col + dj
    inside = (i >= 0) & (i < n_rows) & (j >= 0) & (j < n_cols)
    cell, number = (i * n_cols + j)[inside], np.nonzero(inside)[1]
    order = np.lexsort((number, cell))
    return np.searchsorted(cell[order], np.arange(n_rows * n_cols + 1)), number[order]
