"""Observations that the engine itself makes on a slope of four stretches: the truth is known."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any, Literal

import numpy as np

from sassgis.engine.simulate import simulate
from sassgis.engine.state import FLIGHT, IMPACT, ROLLING
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.forward.rock_lines import dips_at, repeated
from sassgis.gap.observations.case import Case
from sassgis.gap.observations.observed import Observations
from sassgis.gap.observations.projection import project_observations, station_chainages
from sassgis.gap.observations.tables import (
    Deposits,
    Impacts,
    Metadata,
    Passages,
    Rocks,
    Stations,
    Trajectories,
)
from sassgis.grid import Grid
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.ground import GroundClass, GroundTable
from sassgis.settings.map_run import Forest
from sassgis.settings.results import ControlLine, ControlLineCrossings, ReleasePoints
from sassgis.settings.settings import EngineSettings, TerrainSettings
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.flatten import chainage_to_xy, profiles
from sassgis.terrain.prepare import with_lead_in
from sassgis.terrain.release import point_keys

CELL, WIDTH, LENGTH = 2.0, 60.0, 330.0
TOP_Y = 20.0
#: Ends of the stretches (m down the map) and their tangents.
BREAKS = (70.0, 130.0, 205.0, LENGTH)
TANGENTS = (0.95, 0.72, 0.52, 0.2)
STATIONS = (45.0, 80.0, 115.0, 150.0)
TABLE = GroundTable(
    tuple(
        GroundClass(
            name, eta_max=eta, dp_min=low, dp_max=high, mu_f=mu_f, mu_0=mu_0, k=k, d_star_m=d_star
        )
        for name, eta, low, high, mu_f, mu_0, k, d_star in (
            ("rock", 0.72, 0.0, 0.3, 0.7, 0.4, 0.17, 0.0),
            ("debris", 0.62, 0.1, 0.4, 0.75, 0.45, 0.2, 0.1),
            ("talus", 0.6, 0.1, 0.4, 0.75, 0.45, 0.2, 0.2),
            ("meadow", 0.45, 0.1, 0.3, 0.8, 0.6, 0.17, 0.05),
        )
    )
)
#: The model that the case knows.
BASE = HypothesisModel(TABLE, EffectSettings())
CONFIGURED = BlockPopulation(
    axis_1_m=(0.45, 0.65), axis_2_m=(0.35, 0.48), axis_3_m=(0.25, 0.40), drop_m=(0.3, 1.0)
)
ERRORS = {
    "speed_error_rel": 0.05,
    "rotation_error_rel": 0.06,
    "height_error_m": 0.1,
    "position_error_m": 0.25,
    "fps": 25.0,
}


def table_with(name: str, **values: float) -> GroundTable:
    """The table with other values of one class."""
    return GroundTable(
        tuple(dataclasses.replace(c, **values) if c.name == name else c for c in TABLE.classes)
    )


def with_observed(case: Case, **changed: Any) -> Case:
    """The case with other tables or metadata."""
    return dataclasses.replace(case, observations=dataclasses.replace(case.observations, **changed))


def with_metadata(case: Case, **stated: float) -> Case:
    """The case with other errors of measurement in its metadata."""
    own = dataclasses.replace(case.observations.metadata, **stated)
    return with_observed(case, metadata=own)


def with_passages(case: Case, keep: Any) -> Case:
    """The case with some of its passages alone, by a mask."""
    return with_rows(case, "passages", keep)


def with_rows(case: Case, table: str, keep: Any) -> Case:
    """The case with some rows of a table of points alone."""
    put = case.projected[table]
    fewer = type(put)(*(getattr(put, f.name)[keep] for f in dataclasses.fields(put)))
    case = with_observed(case, **{table: case.observations.tables[table].take(keep)})
    return dataclasses.replace(case, projected={**case.projected, table: fewer})


def tangent(down: Any) -> Any:
    """Tangent of the slope; stretches go over into each other within 16 m."""
    at = np.array([d + e for d in BREAKS[:-1] for e in (-8.0, 8.0)])
    return np.interp(down, at, np.repeat(TANGENTS, 2)[1:-1])


def height(down: Any) -> Any:
    """Height of the ground (m) by the distance down the map."""
    at = np.linspace(0.0, LENGTH, 3301)
    steps = np.diff(at) * tangent(0.5 * (at[1:] + at[:-1]))
    return 500.0 - np.interp(down, at, np.concatenate([[0.0], np.cumsum(steps)]))


def slope() -> tuple[Grid, np.ndarray]:
    """The grid and the class of ground of its cells."""
    down = (np.arange(int(LENGTH / CELL)) + 0.5) * CELL
    columns = int(WIDTH / CELL)
    grid = Grid(np.repeat(height(down)[:, None], columns, axis=1), 0.0, LENGTH, CELL)
    kind = np.searchsorted(BREAKS, down).astype(np.int32)
    return grid, np.repeat(kind[:, None], columns, axis=1)


@cache
def observed(
    n_rocks: int,
    seed: int,
    *,
    table: GroundTable = TABLE,
    effects: EffectSettings | None = None,
    stand: tuple[float, float, float, float] | None = None,
    faster_mps: float = 0.0,
    readings: Literal["1986", "hazard"] = "1986",
    tables: tuple[str, ...] = ("passages", "deposits", "impacts", "trajectories"),
) -> Case:
    """A case whose rocks the engine has let go, with other settings than the case knows.

    ``stand``: chainages, stems per hectare and diameter (m) of a forest. ``faster_mps``: added to
    the speed of the release that is written down.
    """
    rng = np.random.default_rng([seed, 5])
    engine = EngineSettings(readings=readings)
    grid, kind = slope()
    release_x = np.linspace(15.0, 45.0, 6)
    release_y = np.full(6, LENGTH - TOP_Y)
    areas = tuple(f"P{i}" for i in range(6))
    keys = np.concatenate([point_keys(area, 1) for area in areas])
    points = ReleasePoints(release_x, release_y, np.arange(6), keys, areas)
    settings = TerrainSettings()
    traces = trace(grid, fall_line_surface(grid, settings), points, settings)
    flat = profiles(grid, traces, kind, 0.05)
    lines = with_lead_in(flat, 20.0)
    line = np.arange(n_rocks) % 6
    drawn = [rng.uniform(*getattr(CONFIGURED, f"axis_{j}_m"), n_rocks) for j in (1, 2, 3)]
    axes = np.sort(np.column_stack(drawn))[:, ::-1]
    speed = rng.uniform(0.5, 2.0, n_rocks)
    blocks = tuple(
        dataclasses.replace(
            CONFIGURED,
            speed_mps=(speed[i], speed[i]),
            **{f"axis_{j + 1}_m": (axes[i, j], axes[i, j]) for j in range(3)},
        )
        for i in range(n_rocks)
    )
    real = [dataclasses.replace(b, speed_mps=(b.speed_mps[0] + faster_mps,) * 2) for b in blocks]
    stations = Stations.of(
        station=[f"S{k + 1}" for k in range(len(STATIONS))],
        vertices=[
            np.array([[0.0, LENGTH - TOP_Y - s], [WIDTH, LENGTH - TOP_Y - s]]) for s in STATIONS
        ],
    )
    mass = 4.0 / 3.0 * np.pi * axes.prod(axis=1) * 2700.0
    names = [f"R{i}" for i in range(n_rocks)]
    rocks = Rocks.of(
        rock_id=names, x=release_x[line], y=release_y[line], mass_kg=mass,
        semi_axis_a_m=axes[:, 0], semi_axis_b_m=axes[:, 1], semi_axis_c_m=axes[:, 2],
        release_speed_mps=speed,
    )  # fmt: skip
    which = np.array(line)
    own = repeated(lines, which)
    forest = None
    if stand is not None:
        s0, s1, stems, girth = stand
        down = LENGTH - grid.cell_centres(np.arange(grid.values.size))[1] - TOP_Y
        inside = (down >= s0) & (down < s1)
        forest = Forest(np.where(inside, stems / 1e4, 0.0), np.where(inside, girth, 0.0))
    done = simulate(
        own, table, real, engine, seed=seed, rocks_per_line=1,
        line_keys=np.arange(n_rocks, dtype=np.uint64) + np.uint64(1000),
        starts=np.zeros((n_rocks, 2)),
        control_lines=ControlLineCrossings.same_for_all(
            [ControlLine(f"S{k}", "station") for k in range(len(STATIONS))], STATIONS, n_rocks
        ),
        log_events=4000, effects=effects, forest=forest,
    )  # fmt: skip
    made: dict[str, Any] = {}
    round_ = 0.5 * (axes[:, 0] + axes[:, 1])

    def noisy(values: Any, error: float) -> Any:
        return values * (1.0 + error * rng.standard_normal(np.shape(values)))

    def placed(rock: Any, s: Any) -> tuple[Any, Any]:
        x, y = chainage_to_xy(traces, line[rock], s)
        sd = ERRORS["position_error_m"]
        return x + sd * rng.standard_normal(x.size), y + sd * rng.standard_normal(y.size)

    if "passages" in tables:
        p = done.passages
        i = p["line"]
        cosine = np.cos(np.arctan(tangent(p["chainage_m"] + TOP_Y)))
        rest = np.where(p["height_m"] > 0.0, axes[i, 1], round_[i]) / cosine
        x, y = placed(i, p["chainage_m"])
        made["passages"] = Passages.of(
            rock_id=[names[k] for k in i],
            station=[f"S{g + 1}" for g in p["control_line"]],
            x=x,
            y=y,
            speed_mps=noisy(p["speed_mps"], 0.05),
            rotation_hz=noisy(p["rotation_hz"], 0.06),
            height_m=np.maximum(p["height_m"] + rest + 0.1 * rng.standard_normal(i.size), 0.0),
        )
    if "deposits" in tables:
        r = done.rocks
        x, y = placed(r["line"], r["runout_m"])
        made["deposits"] = Deposits.of(
            rock_id=[names[k] for k in r["line"]], x=x, y=y, mass_kg=noisy(r["mass_kg"], 0.05)
        )
    if "impacts" in tables:
        made["impacts"] = _impacts(done.event_logs, names, own, axes, placed, noisy, rng)
    if "trajectories" in tables:
        made["trajectories"] = _paths(done.event_logs, names, round_, placed, noisy, rng)
    observations = Observations(rocks=rocks, stations=stations, metadata=Metadata(**ERRORS), **made)
    return Case(
        observations=observations, grid=grid, table=TABLE, engine=engine,
        effects=EffectSettings(), forest=None, traces=traces, profiles=lines, line=line,
        blocks=blocks, start=np.zeros((n_rocks, 2)), mass_kg=mass,
        radius_m=np.cbrt(axes.prod(axis=1)), stations=station_chainages(traces, stations),
        projected=project_observations(observations, traces, line, grid=grid),
    )  # fmt: skip


def _impacts(
    logs: Any, names: list[str], own: Any, axes: Any, placed: Any, noisy: Any, rng: Any
) -> Impacts:
    rows: list[list[float]] = []
    for i, log in enumerate(logs):
        for k in np.flatnonzero(log["phase"][:-1] == IMPACT).tolist():
            before, after = log[k], log[k + 1]
            # The ground is that under the point of contact, not under the centre.
            ux, uz, (a, b) = before["ux"], before["uz"], axes[i, :2]
            sine = np.sin(before["theta_rad"]) * ux - np.cos(before["theta_rad"]) * uz
            cosine = np.cos(before["theta_rad"]) * ux + np.sin(before["theta_rad"]) * uz
            y = np.hypot(a * sine, b * cosine)
            x = (a * a - b * b) * sine * cosine / y
            dip = -float(
                dips_at(own, np.array([i]), np.array([before["x_m"] - x * ux + y * uz]))[0]
            )
            c, s = np.cos(dip), np.sin(dip)
            state = []
            for e in (before, after):
                vx, vz = e["vx_mps"], e["vz_mps"]
                state += [vx * c - vz * s, vx * s + vz * c, e["omega_radps"]]
            if state[1] < 0.0:
                rows.append([i, k, before["x_m"], np.degrees(dip), *state])
    table = np.array(rows)
    i = table[:, 0].astype(int)
    x, y = placed(i, table[:, 2])
    before, after = noisy(np.ones(len(i)), 0.05), noisy(np.ones(len(i)), 0.05)
    return Impacts.of(
        rock_id=[names[k] for k in i], impact=[str(int(k)) for k in table[:, 1]], x=x, y=y,
        slope_deg=table[:, 3],
        vt_in_mps=table[:, 4] * before, vn_in_mps=table[:, 5] * before,
        omega_in_radps=noisy(table[:, 6], 0.06),
        vt_out_mps=table[:, 7] * after, vn_out_mps=table[:, 8] * after,
        omega_out_radps=noisy(table[:, 9], 0.06),
        turn_deg=1.5 * rng.standard_normal(len(i)),
    )  # fmt: skip


def _paths(
    logs: Any, names: list[str], round_: Any, placed: Any, noisy: Any, rng: Any
) -> Trajectories:
    """Points of the centre 25 times a second."""
    rows = []
    for i, log in enumerate(logs):
        t = np.arange(0.0, log["t_s"][-1], 0.04)
        k = np.clip(np.searchsorted(log["t_s"], t, side="right") - 1, 0, len(log) - 2)
        e, after = log[k], log[k + 1]
        dt = t - e["t_s"]
        flying = e["phase"] == FLIGHT
        span = np.maximum(after["t_s"] - e["t_s"], 1e-9)
        speed0 = np.hypot(e["vx_mps"], e["vz_mps"])
        way = np.hypot(after["x_m"] - e["x_m"], after["z_m"] - e["z_m"])
        # Along the ground: constant acceleration over the way to the next event.
        pull = 2.0 * (way - speed0 * span) / span**2
        done = (speed0 * dt + 0.5 * pull * dt**2) / np.maximum(way, 1e-9)
        x = np.where(
            flying, e["x_m"] + e["vx_mps"] * dt, e["x_m"] + done * (after["x_m"] - e["x_m"])
        )
        z = np.where(
            flying,
            e["z_m"] + e["vz_mps"] * dt - 0.5 * 9.81 * dt**2,
            e["z_m"] + done * (after["z_m"] - e["z_m"]),
        )
        v = np.where(flying, np.hypot(e["vx_mps"], e["vz_mps"] - 9.81 * dt), speed0 + pull * dt)
        spin = np.where(
            e["phase"] == ROLLING, np.maximum(v, 0.0) / round_[i], np.abs(e["omega_radps"])
        )
        rows.append(np.column_stack([np.full(t.size, i), t, x, z, np.maximum(v, 0.0), spin]))
    table = np.concatenate(rows)
    i = table[:, 0].astype(int)
    x, y = placed(i, table[:, 2])
    return Trajectories.of(
        rock_id=[names[k] for k in i], t_s=table[:, 1], x=x, y=y,
        z=table[:, 3] + 0.25 * rng.standard_normal(i.size),
        speed_mps=noisy(table[:, 4], 0.05), rotation_hz=noisy(table[:, 5] / (2.0 * np.pi), 0.06),
    )  # fmt: skip
