"""Followed paths: what must hold on planes, in gullies, on ridges, at edges, with effects."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from helpers.engine_lab import ROLLING, run
from helpers.paths_lab import DEBRIS, HAZARD, MIXED, ROCK, STRAIGHT, ends, paths
from helpers.terrains import folded, grid_of, middle, points_at
from scipy.integrate import solve_ivp
from scipy.stats import ks_2samp, kstest

from sassgis.engine import ground_ahead, simulate_paths
from sassgis.engine.effects.air_drag import AirDrag
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.effects.trees import Trees
from sassgis.engine.effects.wind import Wind
from sassgis.engine.simulate import Simulated
from sassgis.engine.simulate_paths import PathTerrain, follow
from sassgis.errors import InputError
from sassgis.grid import FloatArray, Grid
from sassgis.settings.blocks import BlockPopulation, EffectSettings
from sassgis.settings.ground import GroundClass, GroundTable
from sassgis.settings.map_run import Forest
from sassgis.settings.results import (
    HALTED,
    ControlLine,
    ControlLineCrossings,
    Outcome,
    StopReason,
)
from sassgis.settings.settings import EngineSettings
from sassgis.terrain.release import square

G = 9.81


def ground(**changes: float) -> GroundClass:
    return dataclasses.replace(DEBRIS, name="own", **changes)


def bench(angle: float, length: float, *, run_out: float = 0.0, cell: float = 2.0) -> Grid:
    """A plane that falls to the east from x = -length to 0, and goes on level or at an angle."""
    n = 2 * round(1.15 * length / cell) + 1
    drop, after = (math.tan(math.radians(a)) for a in (angle, run_out))
    return grid_of(
        lambda x, y: 1000.0 - drop * np.minimum(x, 0.0) - after * np.maximum(x, 0.0) + 0.0 * y,
        n, n, cell,
    )  # fmt: skip


def along(out: Simulated, grid: Grid, x: float) -> FloatArray:
    """Where paths cross a meridian first (m from the middle): from the logs, straight between."""
    at = x / grid.cell_size + 0.5 * grid.shape[1]
    crossed = []
    for log in out.event_logs:
        beyond = np.flatnonzero(log["u"] >= at)
        if beyond.size and beyond[0] > 0:
            i, j = beyond[0] - 1, beyond[0]
            share = (at - log["u"][i]) / (log["u"][j] - log["u"][i])
            v = log["v"][i] + share * (log["v"][j] - log["v"][i])
            crossed.append((0.5 * grid.shape[0] - v) * grid.cell_size)
    return np.array(crossed)


def width(values: FloatArray) -> float:
    low, high = np.percentile(values, [10, 90])
    return float(high - low)


# --- planes --------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_unevenness_below_the_tolerance_does_not_brake_what_rolls() -> None:
    """Samples along the way are no vertices: blocks on a plane of rough cells roll as on it."""
    even = bench(38.0, 300.0)
    noise = np.random.default_rng(1).uniform(-0.01, 0.01, even.shape)
    uneven = dataclasses.replace(even, values=even.values + noise)
    rolling = dataclasses.replace(
        MIXED, axis_1_m=(0.5, 0.5), axis_2_m=(0.45, 0.45), axis_3_m=(0.4, 0.4), drop_m=(0, 0)
    )
    settings = dataclasses.replace(STRAIGHT, readings="1986")
    found = [
        paths(g, x=-280.0, n=200, blocks=rolling, settings=settings, tolerance=0.05)
        for g in (even, uneven)
    ]
    energy = [np.median(out.rocks["max_energy_kj"]) for out in found]
    assert energy[1] == pytest.approx(energy[0], rel=0.1)


@pytest.mark.parametrize("on", [DEBRIS, ROCK], ids=["debris", "rock"])
def test_on_a_plane_the_mean_path_is_the_fall_line(on: GroundClass) -> None:
    grid = bench(35.0, 200.0)
    out = paths(grid, x=-180.0, n=2000, on=on)
    _, y = ends(grid, out)
    assert y.std() > 3.0
    assert abs(y.mean()) < 3.5 * y.std() / math.sqrt(y.size)
    # Left and right are mirror images.
    assert ks_2samp(y, -y).pvalue > 1e-3


def test_without_tilt_and_drift_a_block_keeps_to_the_fall_line_and_its_run_out() -> None:
    """Heights are exact along the fall line: the same blocks stop where they do on it."""
    grid = bench(35.0, 120.0)
    out = paths(grid, x=-100.0, n=300, settings=STRAIGHT, tolerance=1e-6)
    _, y = ends(grid, out)
    # Up the slope, exactly against the descent, a block does not keep its balance.
    assert (np.abs(y) < 1e-6).mean() > 0.95 and np.abs(y).max() < 0.1
    line = straight(35.0, 100.0, 300, DEBRIS, settings=STRAIGHT)
    # Impact after impact rounding grows: most end at the same place, the others where they may.
    same = np.abs(out.rocks["runout_m"] - line.rocks["runout_m"]) < 1e-3
    assert same.mean() > 0.15
    middles = [np.median(r.rocks["runout_m"]) for r in (out, line)]
    assert middles[0] == pytest.approx(middles[1], rel=0.01)


def straight(angle: float, length: float, n: int, on: GroundClass, **more: Any) -> Simulated:
    """The same blocks on the profile of the fall line of a bench."""
    s = np.array([-20.0, length, length + 400.0])
    z = 1000.0 - math.tan(math.radians(angle)) * np.minimum(s, length)
    key = np.array([7], np.uint64)
    return run((s, z), on, MIXED, n=n, start=0.0, keys=key, **({"settings": HAZARD} | more))


@pytest.mark.parametrize(("on", "angle"), [(DEBRIS, 35.0), (DEBRIS, 38.0), (ROCK, 35.0)])
def test_run_out_along_the_path_is_that_of_the_line(on: GroundClass, angle: float) -> None:
    grid = bench(angle, 230.0)
    n = 3000
    out = paths(grid, x=-200.0, n=n, on=on).rocks
    line = straight(angle, 200.0, n, on).rocks
    assert (out["reason"] != StopReason.LEFT_PROFILE).all()
    # Some stop where they start, some on the slope: those that come to its foot are compared.
    for q in (50, 75, 90):
        far = [np.percentile(r["runout_m"], q) for r in (out, line)]
        assert far[0] == pytest.approx(far[1], rel=0.025), q


@pytest.mark.parametrize("length", [100.0, 800.0])
@pytest.mark.parametrize(("on", "angle"), [(DEBRIS, 38.0), (ROCK, 36.0)], ids=["debris", "rock"])
def test_plan_width_is_10_to_20_percent_of_the_length(
    on: GroundClass, angle: float, length: float
) -> None:
    grid = bench(angle, 840.0, run_out=angle, cell=4.0)
    out = paths(grid, x=-830.0, n=400, on=on, log_events=4000)
    y = along(out, grid, length - 830.0)
    assert y.size > 150
    # The sampling error of a quantile is some 6 % of the width here.
    assert 0.09 * length < width(y) < 0.25 * length


# --- symmetry ------------------------------------------------------------------------------------


def test_turning_and_mirroring_the_terrain_turns_and_mirrors_the_map() -> None:
    angle = math.radians(37.0)
    c, s = math.cos(angle), math.sin(angle)

    def turned(x: FloatArray, y: FloatArray) -> FloatArray:
        return folded(c * x + s * y, s * x - c * y)

    one, other = grid_of(folded, 360, 360, 1.0), grid_of(turned, 360, 360, 1.0)
    x, y = ends(one, paths(one, x=-80.0, y=3.0, n=1500, tolerance=0.1))
    assert abs(y.mean()) > 5.0 * y.std() / math.sqrt(y.size)
    start = (-80.0 * c + 3.0 * s, -80.0 * s - 3.0 * c)
    x2, y2 = ends(other, paths(other, *start, n=1500, tolerance=0.1, seed=2))
    assert ks_2samp(x, c * x2 + s * y2).pvalue > 1e-3
    assert ks_2samp(y, s * x2 - c * y2).pvalue > 1e-3


# --- gullies and ridges --------------------------------------------------------------------------


def test_in_a_gully_rocks_stay_and_on_a_ridge_they_part() -> None:
    def across(k: float) -> FloatArray:
        grid = grid_of(lambda x, y: 1000.0 - 0.7 * x + k * np.minimum(np.abs(y), 40.0), 200, 100)
        return ends(grid, paths(grid, x=-180.0, n=600))[1]

    plane, gully, ridge = across(0.0), across(0.4), across(-0.4)
    assert np.abs(gully).max() < 20.0
    assert width(gully) < 0.4 * width(plane)
    assert width(ridge) > 2.0 * width(plane)
    # They part to both sides, and leave the crest.
    assert 0.4 < (ridge > 0.0).mean() < 0.6
    assert (np.abs(ridge) < 5.0).mean() < 0.7 * (np.abs(plane) < 5.0).mean()


# --- conservation and independence ---------------------------------------------------------------


def test_every_block_ends_somewhere_once() -> None:
    grid = bench(36.0, 60.0)
    out = paths(grid, x=[-50.0, -30.0, 40.0], y=[0.0, 5.0, 0.0], n=300)
    reason = out.rocks["reason"]
    assert out.rocks.size == 900
    counts = np.bincount(reason, minlength=len(StopReason))
    assert counts[StopReason.STEP_LIMIT] == 0 and counts.sum() == 900
    stopped = np.isin(reason, HALTED)
    assert out.sums["stops"].sum() == stopped.sum()
    cells = grid.cell_of(out.x[stopped], out.y[stopped])
    found, number = np.unique(cells, return_counts=True)
    at = np.searchsorted(out.cells, found)
    assert np.array_equal(out.cells[at], found)
    # A stop on the border of two cells may count in either.
    assert np.abs(out.sums["stops"][at].astype(int) - number).sum() <= 2


def test_blocks_hang_on_nothing_but_their_key() -> None:
    grid = grid_of(folded, 260, 260, 1.0)
    x, y = np.linspace(-90.0, -60.0, 7), np.linspace(-8.0, 8.0, 7)

    def some(which: Any, n: int = 20, first: int = 0) -> Simulated:
        which = np.asarray(which)
        return paths(
            grid, x[which], y[which], n=n, seed=3, keys=which, point_numbers=which,
            sides=square(5.0), first_rock=first,
        )  # fmt: skip

    whole = some(range(7))
    backwards = some([6, 5, 4, 3, 2, 1, 0])
    order = np.argsort(backwards.rocks["line"], kind="stable")
    assert backwards.rocks[order].tobytes() == whole.rocks.tobytes()
    assert np.array_equal(backwards.cells, whole.cells)
    for name, values in whole.sums.items():
        assert backwards.sums[name].tobytes() == values.tobytes(), name
    alone = some([4])
    assert alone.rocks.tobytes() == whole.rocks[80:100].tobytes()
    later = some([4], n=10, first=10)
    assert later.rocks.tobytes() == whole.rocks[90:100].tobytes()


def test_blocks_start_evenly_in_what_their_point_represents() -> None:
    grid = grid_of(folded, 260, 260, 2.0)
    points = points_at(*middle(grid))
    along, across = np.array([12.0, 5.0]), np.array([1.0, -2.4])
    logs = paths(grid, n=400, sides=[along, across], log_events=1).event_logs
    at = np.array([[log["u"][0], log["v"][0]] for log in logs])
    aside = np.column_stack([grid.west + 2.0 * at[:, 0], grid.north - 2.0 * at[:, 1]])
    aside -= [points.x[0], points.y[0]]
    parts = np.linalg.solve(np.array([along, across]).T, aside.T)
    for part in parts:
        assert np.abs(part).max() < 0.5 + 1e-6
        assert kstest(part + 0.5, "uniform").pvalue > 0.01
    assert abs(np.corrcoef(*parts)[0, 1]) < 3.0 / np.sqrt(400)


def test_a_part_of_the_terrain_gives_the_same_bits() -> None:
    """Counted from another corner, with all that paths looked at inside."""
    grid = grid_of(folded, 300, 300, 0.5, west=2_612_345.0, north=1_187_654.5)
    x0, y0 = middle(grid)
    points = dataclasses.replace(points_at(x0 - 40.03, y0 + 3.07), sides=square(3.3)[None])
    wall = ControlLine("wall", "net", height_m=2.0, capacity_kj=50.0)
    trace = np.array([[x0 - 20.1, y0 - 30.3], [x0 - 19.7, y0 + 60.1]])

    def run(grid: Grid) -> Simulated:
        terrain = PathTerrain(grid, np.zeros(grid.shape, np.int32), 0.25, [(wall, trace)])
        return follow(
            terrain, points, GroundTable((DEBRIS,)), MIXED, HAZARD, seed=3, rocks_per_point=100,
            point_keys=points.key,
        )  # fmt: skip

    whole = run(grid)
    assert whole.looked_at is not None
    top, bottom, left, right = whole.looked_at
    rows, cols = slice(top - 4, bottom + 5), slice(left - 4, right + 5)
    part = Grid(
        np.ascontiguousarray(grid.values[rows, cols]), grid.west + 0.5 * cols.start,
        grid.north - 0.5 * rows.start, 0.5,
    )  # fmt: skip
    assert part.values.size < 0.8 * grid.values.size
    own = run(part)
    assert own.rocks.tobytes() == whole.rocks.tobytes()
    assert own.passages.tobytes() == whole.passages.tobytes() and own.passages.size
    assert own.x.tobytes() == whole.x.tobytes() and own.y.tobytes() == whole.y.tobytes()


# --- energy, and the turn against an independent integration -------------------------------------


@pytest.mark.parametrize("on", [DEBRIS, ROCK], ids=["debris", "rock"])
def test_no_path_gains_energy(on: GroundClass) -> None:
    rng = np.random.default_rng(5)
    bumps = rng.normal(0.0, 0.4, (200, 200))
    grid = grid_of(lambda x, y: folded(x, y) + bumps, 200, 200, 1.5)
    out = paths(grid, x=-120.0, y=np.linspace(-30.0, 30.0, 8), n=25, on=on, log_events=6000)
    for log, rock in zip(out.event_logs, out.rocks, strict=True):
        a, b, c = (rock[f"{axis}_m"] for axis in "abc")
        assert c <= b <= a
        inertia = (a * a + b * b) / 5.0
        energy = (
            0.5 * (log["vx_mps"] ** 2 + log["vz_mps"] ** 2 + inertia * log["omega_radps"] ** 2)
            + G * log["z_m"]
        )
        # Heights count from where the block ends.
        energy -= G * log["z_m"].min()
        gain = np.diff(energy) / energy[:-1].clip(1.0)
        assert gain.max() < 1e-6, (np.argmax(gain), gain.max())


def test_a_rolling_sphere_turns_as_an_independent_integration_says() -> None:
    """dφ/ds = g sin β sin(ψ − φ)/v² on a plane, with dv/dt = g (sin β' − μ cos β')."""
    mu, slope = 0.45, 0.6
    on = ground(mu_v=0.0, mu_0=mu, k=0.0, d_star_m=0.0, dp_min=0.0, dp_max=0.0, mu_f=5.0)
    settings = EngineSettings(
        side_tilt_deg=35.0, drift_deg=0.0, slope_variation="off", rolling="round",
        rolling_friction_sd=0.0, outline_edges=0.0,
    )  # fmt: skip
    # Small: the centre of a larger one stands the higher, the steeper its heading is. Fast: it
    # turns little in each step, which is as long as half of the turn at most.
    sphere = BlockPopulation(
        "s", (0.1, 0.1), (0.1, 0.1), (0.1, 0.1), drop_m=(3.0, 3.0), speed_mps=(9.0, 9.0)
    )
    grid = bench(math.degrees(math.atan(slope)), 200.0, run_out=math.degrees(math.atan(slope)))
    out = paths(grid, x=-150.0, n=60, on=on, settings=settings, blocks=sphere, log_events=4000)
    checked = 0
    for log in out.event_logs:
        rolls = np.flatnonzero(log["phase"] == ROLLING)
        assert np.array_equal(rolls, np.arange(rolls[0], rolls[-1] + 1))
        s = grid.cell_size * np.column_stack([log["u"], log["v"]])[rolls]
        step = np.diff(s, axis=0)
        chi = np.arctan2(step[:, 1], step[:, 0])
        if abs(chi[0]) < 0.25:
            continue
        v2 = [log["vx_mps"][i] ** 2 + log["vz_mps"][i] ** 2 for i in rolls[:2]]
        v0 = math.sqrt(0.5 * (v2[0] + v2[1]))

        def rate(_t: float, y: FloatArray) -> list[float]:
            phi, speed = y[2:]
            p = slope * math.cos(phi)
            flat = 1.0 / math.sqrt(1.0 + p * p)
            level = speed * flat
            kappa = G * slope / ((1.0 + slope**2) * level**2)
            return [
                level * math.cos(phi), level * math.sin(phi), -kappa * math.sin(phi) * level,
                G * (p - mu) * flat,
            ]  # fmt: skip

        # The heading of the first step is that in its middle.
        begin = 0.5 * (s[0] + s[1])
        far = np.hypot(*(s - begin).T)
        last = int(np.searchsorted(far[1:], 60.0))
        found = solve_ivp(
            rate, (0.0, 60.0), [*begin, chi[0], v0], rtol=1e-9, atol=1e-9, dense_output=True,
            events=lambda _t, y, end=s[last, 0]: y[0] - end,
        ).y_events[0][0]  # fmt: skip
        # The heading is that of the path within 0.01 rad: half of that over 60 m.
        assert s[last, 1] - begin[1] == pytest.approx(found[1] - begin[1], rel=0.02, abs=0.3)
        now = math.hypot(log["vx_mps"][rolls[last]], log["vz_mps"][rolls[last]])
        assert now == pytest.approx(found[3], rel=0.02)
        checked += 1
    assert checked > 10


# --- stations, walls, effects --------------------------------------------------------------------


def test_a_wall_holds_the_same_share_as_on_a_line() -> None:
    grid = bench(36.0, 100.0)
    wall = ControlLine("wall", "wall", height_m=1.5)
    trace = np.array([[-30.0, -100.0], [-30.0, 100.0]])
    n = 2500
    out = paths(grid, x=-90.0, n=n, lines=((wall, trace),))
    crossing = ControlLineCrossings.same_for_all((wall,), [60.0], 1)
    line = straight(36.0, 90.0, n, DEBRIS, control_lines=crossing)
    shares = [(r.rocks["reason"] == StopReason.BARRIER).mean() for r in (out, line)]
    assert 0.1 < shares[1] < 0.95
    assert shares[0] == pytest.approx(shares[1], abs=4.0 * math.sqrt(0.5 / n))
    held = out.rocks["reason"] == StopReason.BARRIER
    x, _ = ends(grid, out)
    assert np.abs(x[held] + 30.0).max() < 2.0
    assert np.unique(out.passages[["line", "rock"]]).size == out.passages.size


def test_a_block_passes_a_station_once() -> None:
    grid = bench(36.0, 100.0)
    # A trace with a corner just where paths cross it, one askew, and one beside all paths.
    lines = (
        (ControlLine("bent", "station"), np.array([[-60.0, -90.0], [-50.0, 0.0], [-60.0, 90.0]])),
        (ControlLine("askew", "station"), np.array([[-50.0, -70.0], [-10.0, 70.0]])),
        (ControlLine("aside", "station"), np.array([[-50.0, 90.0], [-10.0, 90.0]])),
    )
    out = paths(grid, x=-90.0, n=1000, lines=lines)
    rows = out.passages
    assert np.unique(rows[["rock", "control_line"]]).size == rows.size
    count = np.bincount(rows["control_line"], minlength=3)
    x, y = ends(grid, out)
    beyond = x > -50.0 - np.abs(y) / 9.0 + 0.1
    assert count[0] == pytest.approx(beyond.sum(), abs=3)
    assert 0 < count[1] <= count[0] and count[2] == 0


@pytest.mark.parametrize("arms", [(-60.0, -45.0), (-88.0, -86.5)], ids=["far", "at the start"])
def test_a_station_that_is_crossed_twice_is_passed_once(arms: tuple[float, float]) -> None:
    """Where both crossings lie ahead as the path turns, and where the block starts before both."""
    grid = bench(36.0, 100.0)
    first, second = arms
    trace = np.array([[first, -90.0], [first, 90.0], [second, 90.0], [second, -90.0]])
    out = paths(grid, x=-90.0, n=500, lines=((ControlLine("hairpin", "station"), trace),))
    rows = out.passages
    assert np.unique(rows["rock"]).size == rows.size
    x, _ = ends(grid, out)
    assert rows.size == pytest.approx((x > first).sum(), abs=3) and rows.size > 400
    assert np.abs(rows["x_m"] - middle(grid)[0] - first).max() < 0.01


def test_a_net_holds_a_block_once() -> None:
    """Where the heading turned at the net it was met again, until the block counted as wedged."""
    grid = bench(50.0, 60.0, run_out=50.0)
    net = ControlLine("net", "net", height_m=50.0, restarts_from_rest=True)
    trace = np.array([[-30.0, -60.0], [-28.7, 60.0]])
    out = paths(grid, x=-45.0, n=60, lines=((net, trace),))
    assert (out.passages["outcome"] == Outcome.HELD_BY_NET).sum() > 50
    # The slope is steeper than friction: all move on.
    assert (out.rocks["reason"] != StopReason.BARRIER).all()


@pytest.mark.parametrize("seed", [1, 2, 4, 6, 7])
def test_a_block_passes_all_stations_on_its_way(seed: int) -> None:
    """Also those between where it lands and where it goes on along the ground, and turns."""
    grid = bench(36.0, 60.0, run_out=36.0)
    at = np.arange(-39.0, -33.0, 0.05)
    lines = tuple(
        (ControlLine(f"s{i}", "station"), np.array([[x, -60.0], [x, 60.0]]))
        for i, x in enumerate(at)
    )
    flat = BlockPopulation(
        "flat", (0.6, 0.9), (0.4, 0.5), (0.2, 0.3), (2600.0, 2750.0), drop_m=(0.5, 1.0)
    )
    on = dataclasses.replace(DEBRIS, mu_v=0.0)
    out = paths(grid, x=-40.0, n=100, on=on, lines=lines, blocks=flat, seed=seed)
    passed = np.bincount(out.passages["rock"], minlength=100)
    x, _ = ends(grid, out)
    # More where it has come back.
    assert (passed >= np.searchsorted(at, x - 0.01)).all()


def test_passages_at_a_station_do_not_depend_on_where_lines_are_looked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """More stations than there are bits for those near a cell, straight, bent, askew and short.

    The same passages as if each line were near all cells, and as with room for few cells at first.
    """
    grid = bench(36.0, 100.0)
    lines = tuple(
        (
            ControlLine(f"s{i}", "station"),
            np.array([[x - 6.0 * (i % 3), -80.0], [x, 3.0 * (i % 2)], [x + 2.0 * (i % 5), 80.0]]),
        )
        for i, x in enumerate(np.linspace(-85.0, 10.0, 140))
    )
    lines += tuple(
        (ControlLine(f"short {i}", "station"), np.array([[x, i - 12.0], [x + 1.5, i - 10.0]]))
        for i, x in enumerate(np.linspace(-80.0, 20.0, 25))
    )
    found = paths(grid, x=-90.0, n=60, lines=lines).passages
    assert np.unique(found["control_line"]).size > 110
    path_of = simulate_paths.path_of

    def all_near(*given: Any) -> ground_ahead.Path:
        path = path_of(*given)
        return path._replace(near=np.full_like(path.near, 2**64 - 1))

    with monkeypatch.context() as patch:
        patch.setattr(simulate_paths, "path_of", all_near)
        assert (found == paths(grid, x=-90.0, n=60, lines=lines).passages).all()
    monkeypatch.setattr(simulate_paths, "room_at_first", lambda _steps: 40)
    monkeypatch.setattr(simulate_paths, "_ENOUGH", {})
    assert (found == paths(grid, x=-90.0, n=60, lines=lines).passages).all()


def test_trees_drag_and_fragments_on_paths() -> None:
    grid = bench(36.0, 120.0)
    reach = paths(grid, x=-110.0).rocks["runout_m"].mean()
    stems = np.full(grid.values.size, 0.06)
    wooded = Forest(stems, np.full(stems.size, 0.3))
    trees = paths(grid, x=-110.0, effects=EffectSettings(Trees()), forest=wooded)
    assert trees.rocks["runout_m"].mean() < 0.95 * reach
    drag = paths(grid, x=-110.0, effects=EffectSettings(AirDrag(drag_coefficient=50.0)))
    assert np.percentile(drag.rocks["max_speed_mps"], 90) < 20.0
    broken = paths(grid, x=-110.0, effects=EffectSettings(Fragmentation(energy_jkg=30.0)))
    whole = broken.rocks["reason"] == StopReason.BROKEN
    assert whole.any() and broken.pieces.size
    mass = broken.pieces["mass_kg"][broken.pieces["reason"] != StopReason.BROKEN].sum()
    assert mass == pytest.approx(broken.rocks["mass_kg"][whole].sum(), rel=1e-6)
    x, y = ends(grid, broken)
    own = slice(broken.rocks.size, None)
    assert x[own].size == broken.pieces.size
    assert (x[own] > -111.0).all() and np.abs(y[own]).max() < 120.0
    assert abs(y[own].mean()) < 5.0


def test_a_wind_carries_fragments_of_a_block_that_it_has_turned_back_as_the_block() -> None:
    grid = bench(2.0, 100.0, run_out=2.0)
    high = dataclasses.replace(MIXED, drop_m=(60.0, 60.0))
    both = EffectSettings(Wind(-5.0), Fragmentation("threshold", energy_jkg=100.0, cone_deg=0.0))
    out = paths(grid, n=4, blocks=high, settings=STRAIGHT, on=ROCK, effects=both)
    assert (out.rocks["reason"] == StopReason.BROKEN).all() and out.pieces.size
    x, _ = ends(grid, out)
    # Blown to the west, where the block falls, and not back again.
    assert (x[:4] < -25.0).all()
    assert (x[4:] < x[:4].max()).all()


# --- where segments meet under a rolling block ---------------------------------------------------


@pytest.mark.parametrize("relief", [0.0, 0.05])
def test_a_block_that_rolls_over_the_border_of_two_grounds_moves_on(relief: float) -> None:
    """It met the corner ahead of it again each time that its heading turned, on the spot."""
    grid = grid_of(
        lambda x, y: (
            500.0 - 0.9 * np.minimum(x, -10.0) - 0.04 * y
            + relief * np.sin(2.0 * np.pi * x / 9.0) * np.cos(2.0 * np.pi * y / 7.0)
        ), 60, 60, 2.0,
    )  # fmt: skip
    on = ground(mu_f=0.7, restitution=0.3)
    both = GroundTable((on, dataclasses.replace(on, name="other")))
    blocks = BlockPopulation("b", (0.8, 1.2), (0.6, 0.9), (0.5, 0.8), (2700.0, 2700.0))
    strips = np.arange(60) // 2 % 2
    out = paths(grid, x=-50.0, n=4000, on=both, classes=strips, blocks=blocks, seed=3, keys=[0])
    assert (out.rocks["reason"] != StopReason.STEP_LIMIT).all()
    assert np.median(out.rocks["runout_m"]) > 30.0


# --- where the terrain ends or says little -------------------------------------------------------


def test_release_at_the_edge_in_a_hole_and_on_level_ground() -> None:
    grid = bench(36.0, 60.0)
    west, south, _, _ = grid.bounds
    x0, y0 = middle(grid)
    at_edge = paths(grid, x=west - x0 + 0.3, y=south - y0 + 0.3, n=50)
    assert np.isfinite(at_edge.x).all() and (at_edge.rocks["reason"] != StopReason.STEP_LIMIT).all()
    holed = grid.values.copy()
    holed[30:40, 30:40] = np.nan
    with_hole = dataclasses.replace(grid, values=holed)
    hx, hy = with_hole.cell_centres(np.array([35 * grid.shape[1] + 35]))
    with pytest.raises(InputError, match="no height is known"):
        paths(with_hole, x=hx[0] - x0, y=hy[0] - y0, n=5)
    above = paths(with_hole, x=hx[0] - x0 - 24.0, y=hy[0] - y0, n=100)
    assert (above.rocks["reason"] == StopReason.LEFT_PROFILE).mean() > 0.3
    assert np.isfinite(with_hole.values.ravel()[grid.cell_of(above.x, above.y)]).all()
    level = grid_of(lambda x, y: 100.0 + 0.0 * x * y, 60, 60)
    fast = dataclasses.replace(MIXED, speed_mps=(6.0, 8.0))
    out = paths(level, n=800, blocks=fast)
    x, y = ends(level, out)
    assert np.hypot(x.mean(), y.mean()) < 4.0 * np.hypot(x, y).std() / math.sqrt(400.0) + 0.1
    share = np.histogram(np.arctan2(y, x), bins=8, range=(-math.pi, math.pi))[0] / 800
    assert share == pytest.approx(np.full(8, 0.125), abs=0.05)


def test_blocks_at_rest_start_beside_the_edge_and_beside_a_hole() -> None:
    """Where the terrain ends on one side they start down the slope that the other side has."""
    grid = bench(50.0, 60.0, run_out=50.0)
    values = grid.values.copy()
    values[35, 20] = np.nan
    holed = dataclasses.replace(grid, values=values)
    hole_x, hole_y = holed.cell_centres(np.array([35 * grid.shape[1] + 20]))
    west, south, _, north = grid.bounds
    x0, y0 = middle(grid)
    resting = dataclasses.replace(MIXED, drop_m=(0.0, 0.0))
    # Beside the west edge, in two corners, and all around the hole.
    x = [west + 0.4, west + 0.3, west + 0.3, *(hole_x[0] + np.array([1.3, -1.3, 0.0, 0.0]))]
    y = [y0, south + 0.5, north - 0.5, *(hole_y[0] + np.array([0.0, 0.0, 1.3, -1.3]))]
    out = paths(
        holed, x=np.array(x) - x0, y=np.array(y) - y0, n=8, blocks=resting, settings=STRAIGHT
    )  # fmt: skip
    assert (out.rocks["reason"] != StopReason.NEVER_STARTED).all()
    end_x, end_y = (end.reshape(7, 8) for end in ends(holed, out))
    down_the_slope = np.delete(np.arange(7), 4)
    assert (end_x[down_the_slope] > x0 - west - 6.0).all()
    assert np.abs(end_y - (np.array(y) - y0)[:, None]).max() < 0.1
    # One that the hole lies ahead of comes to its edge.
    assert (out.rocks["reason"].reshape(7, 8)[4] == StopReason.LEFT_PROFILE).all()


@pytest.mark.parametrize("angle", [36.0, 55.0])
def test_blocks_that_leave_the_terrain_end_at_its_edge_on_known_ground(angle: float) -> None:
    """Around holes of any shape, on steep ground, where the centre is ahead of the foot."""
    drop, turn = math.tan(math.radians(angle)), math.radians(25.0)
    grid = grid_of(
        lambda x, y: 1000.0
        - drop * (x * math.cos(turn) + y * math.sin(turn))
        + 3.0 * np.sin(x / 7.0) * np.cos(y / 5.0),
        120, 120,
    )  # fmt: skip
    values = grid.values.copy()
    values[40:60, 60:70] = np.nan
    values[np.random.default_rng(3).random(values.shape) < 0.003] = np.nan
    values[60, 20] = grid.values[60, 20]
    holed = dataclasses.replace(grid, values=values)
    out = paths(holed, x=-79.0, y=-1.0, n=1000)
    reason = out.rocks["reason"]
    left = reason == StopReason.LEFT_PROFILE
    assert (left.sum() > 30) and (reason != StopReason.STEP_LIMIT).all()
    cells = grid.cell_of(out.x, out.y)
    assert (cells >= 0).all() and np.isfinite(values.ravel()[cells]).all()
    # A step of 2 cm to one side, or over the corner of a cell, comes to where nothing is known.
    beyond = np.zeros(reason.size, bool)
    for step_x, step_y in itertools.product((-0.02, 0.0, 0.02), repeat=2):
        at = grid.cell_of(out.x + step_x, out.y + step_y)
        beyond |= (at < 0) | np.isnan(values.ravel()[np.maximum(at, 0)])
    assert beyond[left].all()


@pytest.mark.parametrize("cell", [0.5, 2.0])
def test_rough_ground_with_steps_and_pits(cell: float) -> None:
    rng = np.random.default_rng(11)
    n = 220
    bumps = rng.normal(0.0, 0.3 * cell, (n, n))
    bumps[rng.random((n, n)) < 0.02] -= 3.0
    steps = 8.0 * cell

    def rugged(x: FloatArray, y: FloatArray) -> FloatArray:
        return 1000.0 - 0.3 * x - 6.0 * np.floor(x / steps) + 0.3 * np.abs(y) + bumps

    grid = grid_of(rugged, n, n, cell)
    x = np.tile(np.linspace(-0.45, 0.3, 10), 4) * n * cell
    y = np.repeat([-0.3, -0.1, 0.1, 0.3], 10) * n * cell
    out = paths(grid, x=x, y=y, n=25, on=ROCK, log_events=1500)
    assert out.rocks.size == 1000
    for name in ("runout_m", "runout_z_m", "max_speed_mps", "max_height_m", "max_energy_kj"):
        assert np.isfinite(out.rocks[name]).all(), name
    assert (out.rocks["reason"] != StopReason.STEP_LIMIT).all()
    sunk = 0
    for log, rock in zip(out.event_logs, out.rocks, strict=True):
        u, v = log["u"], log["v"]
        inside = (u > 1) & (v > 1) & (u < n - 1) & (v < n - 1)
        # Bilinear between centres, by hand.
        i, j = (np.floor(w[inside] - 0.5).astype(int) for w in (v, u))
        fv, fu = v[inside] - 0.5 - i, u[inside] - 0.5 - j
        z = grid.values
        below = (
            (z[i, j] * (1 - fu) + z[i, j + 1] * fu) * (1 - fv)
            + (z[i + 1, j] * (1 - fu) + z[i + 1, j + 1] * fu) * fv
        )  # fmt: skip
        sunk += bool((log["z_m"][inside] <= below - 0.25 - rock["a_m"]).any())
    # On cells of 0.5 m, with pits narrower than they and walls of 80°, rock throws some blocks
    # backwards against walls that lie a cell aside.
    assert sunk <= 10
