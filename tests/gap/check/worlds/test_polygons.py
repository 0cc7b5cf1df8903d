"""Sites of the rigid-body library: closed forms, energy, effects, and what is recorded."""

from __future__ import annotations

import builtins
import math
from dataclasses import replace

import numpy as np
import pytest

from sassgis.gap.check.worlds import EffectSpec, WorldSpec
from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds.forces import Forces
from sassgis.gap.check.worlds.make import base_world, place_effect
from sassgis.gap.check.worlds.motion_state import Tables
from sassgis.gap.check.worlds.polygons import SUPPORTED, corners, library, run_rocks
from sassgis.gap.check.worlds.simulation import draw_rocks, simulate
from sassgis.gap.check.worlds.world import LIMITS, World, with_effects
from sassgis.model.errors import InputError

pytest.importorskip("pymunk")

STILL_GROUND = [1.0, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.6, 9.144, 0.01]


def run(ground, st, seconds: float = 0.002) -> Tables:  # type: ignore[no-untyped-def]
    """What one rock did."""
    room = (200, 10, 2000, 20000)
    widths = (8, 11, 16, 9)
    tables = Tables(
        *(np.zeros(shape) for shape in zip(room, widths, strict=True)),
        used=np.zeros(4, np.int64),
        gain=np.full(1, -1.0),
    )
    run_rocks(ground.field, Forces(), st[None, :], np.array([1], np.uint64), seconds, tables)
    used = tables.used
    return tables._replace(
        deposits=tables.deposits[: used[0]],
        impacts=tables.impacts[: used[2]],
        tracks=tables.tracks[: used[3]],
    )


@pytest.fixture(scope="module")
def site() -> World:
    return base_world(WorldSpec("cliff_talus_meadow", law="polygons"), 5)


def with_magnitude(site: World, name: str, magnitude: float) -> World:
    effect = place_effect(site, EffectSpec(name), 5)  # type: ignore[arg-type]
    return with_effects(site, (replace(effect, magnitude=magnitude),))


def test_corners_are_a_convex_block_about_its_centre() -> None:
    for key in np.arange(1, 60, dtype=np.uint64):
        points = np.array(corners(0.6, 0.4, key))
        edges = np.roll(points, -1, axis=0) - points
        following = np.roll(edges, -1, axis=0)
        assert 8 <= len(points) <= 12
        assert (edges[:, 0] * following[:, 1] > edges[:, 1] * following[:, 0]).all()
        x, y = points.T
        cross = x * np.roll(y, -1) - y * np.roll(x, -1)
        assert 0.5 * cross.sum() == pytest.approx(math.pi * 0.6 * 0.4)
        for v in (x, y):
            assert ((v + np.roll(v, -1)) * cross).sum() == pytest.approx(0.0, abs=1e-9)


def flat_side() -> float:
    """Angle at which the block of the first key lies on a side, its centre over it (rad)."""
    points = np.array(corners(0.5, 0.5, np.uint64(1)))
    edges = np.roll(points, -1, axis=0) - points
    sizes = np.hypot(*edges.T)
    along = -(points * edges).sum(axis=1) / sizes
    k = int(np.argmax(np.minimum(along, sizes - along)))
    assert 0.0 < along[k] < sizes[k]
    return -math.atan2(edges[k, 1], edges[k, 0])


def test_a_drop_on_level_ground_rebounds_to_e_squared_of_its_height(plane) -> None:  # type: ignore[no-untyped-def]
    ground = plane(0.0, STILL_GROUND)
    st = ground.rock(0.5, 0.5, 0.0, 0.0)
    st[ms.Z], st[ms.PHI] = 3.5, flat_side()
    tables = run(ground, st)
    hit = tables.impacts[0]
    # Both ends of the side rebound with e: there is no turning.
    assert hit[13] == pytest.approx(0.0, abs=0.05)
    assert hit[12] ** 2 == pytest.approx(0.6**2 * hit[9] ** 2, rel=0.02)
    lowest = tables.tracks[tables.tracks[:, 3] < 1.0, 6].min()
    fallen = hit[9] ** 2 / (2.0 * 9.81)
    assert fallen == pytest.approx(3.5 - lowest, abs=0.5)
    after = tables.tracks[(tables.tracks[:, 3] > 1.0) & (tables.tracks[:, 3] < 1.6), 6].max()
    assert after - (3.5 - fallen) == pytest.approx(0.36 * fallen, rel=0.05)


def test_a_drop_on_a_corner_loses_no_more_than_e_takes(plane) -> None:  # type: ignore[no-untyped-def]
    ground = plane(0.0, STILL_GROUND)
    for phi in np.linspace(0.0, 3.0, 7):
        st = ground.rock(0.5, 0.5, 0.0, 0.0)
        st[ms.Z], st[ms.PHI] = 3.5, phi
        hit = run(ground, st).impacts[0]
        before, after = hit[9] ** 2, hit[12] ** 2 + 0.1 * hit[13] ** 2
        assert 0.36 * before * 0.97 <= after <= before


def test_a_block_slides_without_turning_as_friction_has_it(plane) -> None:  # type: ignore[no-untyped-def]
    """A flat block on a plane: v² = v0² + 2 g (sin β - μ cos β) x."""
    beta, mu = math.radians(20.0), 0.5
    ground = plane(beta, [1.0, 0, 0, mu, 0.0, 0.0, 0.0, 0.0, 9.144, 0.01])
    st = ground.rock(1.2, 0.15, 6.0, 0.0)
    st[ms.PHI] = -beta
    st[ms.Z] = -math.tan(beta) * 50.0 + 0.15 / math.cos(beta)
    stop = run(ground, st).deposits[0]
    length = 36.0 / (2.0 * 9.81 * (mu * math.cos(beta) - math.sin(beta)))
    assert (stop[3] - 50.0) / math.cos(beta) == pytest.approx(length, rel=0.1)


def test_a_block_rolls_slower_than_a_disc_and_faster_than_it_slides(plane) -> None:  # type: ignore[no-untyped-def]
    """A disc of inertia 2/5 m r² that never slips has 5/7 g sin β; with friction alone, less."""
    beta, mu = math.radians(35.0), 0.6
    ground = plane(beta, [1.0, 0, 0, mu, 0.0, 0.0, 0.0, 0.0, 9.144, 0.01])
    tracks = run(ground, ground.rock(0.5, 0.5, 1.0, 0.0, 2.0)).tracks
    at = np.searchsorted(tracks[:, 3], 4.0)
    t, v = tracks[at, 3], tracks[at, 7]
    assert 1.0 + 9.81 * (math.sin(beta) - mu * math.cos(beta)) * t < v
    assert v < 1.0 + 5.0 / 7.0 * 9.81 * math.sin(beta) * t


@pytest.mark.battery
def test_stops_do_not_move_with_the_time_step(site: World) -> None:
    rocks = draw_rocks(site, 200, 9)
    s = [
        site.relief.frame.s(*simulate(site, rocks, dt).deposits[:, 3:5].T) for dt in (0.004, 0.002)
    ]
    standard = s[1].std() * math.sqrt(2.0 / 200.0)
    assert abs(s[0].mean() - s[1].mean()) < 3.0 * standard


@pytest.mark.battery
@pytest.mark.parametrize("name", ["none", *sorted(SUPPORTED - {"wind", "measurement_error"})])
def test_energy_is_never_made(site: World, name: str) -> None:
    # Of rocks that break at once there is no path.
    strong = 0.1 if name == "fragmentation" else 0.5 * LIMITS.get(name, (0.0, 0.0))[1]
    world = site if name == "none" else with_magnitude(site, name, strong)
    run_ = simulate(world, draw_rocks(world, 24, 3), 0.004)
    tracks = run_.tracks[run_.tracks[:, 2] == ms.ROCK]
    rock = tracks[:, 0].astype(int)
    inertia = (run_.rocks.state[:, [ms.A, ms.B]] ** 2).sum(axis=1)[rock] / 5.0
    energy = 0.5 * tracks[:, 7] ** 2 + 9.81 * tracks[:, 6]
    energy += 0.5 * inertia * (2 * math.pi * tracks[:, 8]) ** 2
    same = np.diff(rock) == 0
    # Beside the path the ground is higher or lower than that of the path, which the block is on.
    beside = {"lateral_deflection", "trees", "collisions", "magnus"}
    assert np.diff(energy)[same].max() < (9.81 * 0.4 if name in beside else 0.05)
    assert energy[0] > energy.min() + 500.0


@pytest.mark.battery
@pytest.mark.parametrize("name", sorted(SUPPORTED - {"measurement_error"}))
def test_an_effect_of_no_strength_changes_nothing(site: World, name: str) -> None:
    rocks = draw_rocks(site, 8, 7)
    bare = simulate(site, rocks, 0.004).deposits
    weak = with_magnitude(site, name, 0.0)
    np.testing.assert_array_equal(bare, simulate(weak, draw_rocks(weak, 8, 7), 0.004).deposits)
    strong = with_magnitude(site, name, 0.9 * LIMITS[name][1])
    changed = simulate(strong, draw_rocks(strong, 8, 7), 0.004).deposits
    assert not np.array_equal(bare, changed)


def test_pieces_have_the_mass_of_their_rock(site: World) -> None:
    world = with_magnitude(site, "fragmentation", 0.2)
    rocks = draw_rocks(world, 30, 3)
    found = simulate(world, rocks, 0.004).deposits
    mass = rocks.state[:, ms.DENSITY] * 4 / 3 * math.pi
    mass = mass * rocks.state[:, [ms.A, ms.B, ms.C]].prod(axis=1)
    stopped = np.bincount(found[:, 0].astype(int), found[:, 6], minlength=30)
    assert len(found) > 33
    assert (stopped < mass * (1 + 1e-9)).all()
    assert (stopped > mass * (1 - 1e-9)).sum() >= 20


def test_only_these_sites_need_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: object) -> object:
        if name.startswith("pymunk"):
            raise ImportError(name)
        return real(name, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"sassgis\[check\]"):
        library()
    simulate(base_world(WorldSpec("gully"), 1), draw_rocks(base_world(WorldSpec("gully"), 1), 2, 1))
