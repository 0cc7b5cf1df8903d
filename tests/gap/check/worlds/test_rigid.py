"""Sites of the rigid-body library: closed forms, hulls, effects, and what is recorded."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.synthetic_rocks import TABLES, mass_is_kept, some, with_effect

from sassgis.gap.check.worlds import rigid
from sassgis.gap.check.worlds.simulation import draw_rocks, simulate
from sassgis.gap.check.worlds.world import EFFECTS, World
from sassgis.model.errors import InputError

pytest.importorskip("pybullet", reason='pybullet is not installed: pip install "sassgis[rigid]"')

from sassgis.gap.check.worlds import rigid_bodies as bodies

BOX = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.2, 0.2)])
BOX_INERTIA = np.array([(1.0 + 0.16) / 12.0, (1.0 + 0.16) / 12.0, 2.0 / 12.0])
VOLUME_AXES = (0.5, 0.5, 0.4 / (4.0 / 3.0 * math.pi * 0.25))


def plane_job(
    beta: float, contact: tuple[float, ...], block: tuple[float, ...], dt: float = 0.001
) -> dict[str, Any]:
    """One block on a plane without bumps that falls to the east."""
    x = 2.0 * (np.arange(120) + 0.5)
    heights = np.repeat(-math.tan(beta) * x[None, :], 40, axis=0)
    return {
        "heights": heights, "ground": np.zeros(heights.shape, np.int64),
        "corner": np.array([0.0, 80.0, 2.0]), "law": np.array([contact]),
        "seed": np.array([1, 2]), "speed_loss": np.array(0.0),
        "frame": np.array([0.0, 40.0, 1.0, 0.0]), "stations": np.zeros(0),
        "blocks": np.array([block]), "keys": np.array([7], np.uint64), "campaign": np.zeros(1),
        "effects": np.zeros(0, np.str_), "effect_values": np.zeros((0, 4)),
        "obstacles": np.zeros((0, 6)), "dt": np.array(dt),
    }  # fmt: skip


@pytest.fixture
def as_box(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Every block is a box of 1 m by 1 m by 0.4 m that lies flat on a slope of that angle."""

    def lie(beta: float) -> None:
        tilt = [0.0, math.sin(0.5 * beta), 0.0, math.cos(0.5 * beta)]
        monkeypatch.setattr(bodies, "hull_of", lambda _axes, _rng: (BOX, BOX_INERTIA))
        monkeypatch.setattr(bodies, "turned", lambda _rng: tilt)

    return lie


def on_plane(beta: float, along: float, above: float) -> tuple[float, ...]:
    """A block 50 m down the plane, its centre so far above it, with a speed along it."""
    c, s = math.cos(beta), math.sin(beta)
    return (
        50.0 + above * s, 40.0, -50.0 * math.tan(beta) + above * c, along * c, 0.0, -along * s,
        *VOLUME_AXES, 2700.0,
    )  # fmt: skip


def test_a_sliding_box_stops_where_friction_says(as_box) -> None:  # type: ignore[no-untyped-def]
    """On a plane, v0² = 2 g (μ cos β − sin β) x; edges between triangles do not catch it."""
    beta, mu = math.radians(15.0), 0.6
    as_box(beta)
    job = plane_job(beta, (0.0, mu, 0.0, 0.0, 0.0, 0.0), on_plane(beta, 6.0, 0.205))
    stop = bodies.run(job)["deposits"][0]
    length = 36.0 / (2.0 * 9.81 * (mu * math.cos(beta) - math.sin(beta)))
    assert (stop[3] - 50.0) / math.cos(beta) == pytest.approx(length, rel=0.05)
    assert stop[6] == pytest.approx(0.4 * 2700.0)


def test_a_box_dropped_flat_rebounds_to_e_squared_of_its_height(as_box) -> None:  # type: ignore[no-untyped-def]
    as_box(0.0)
    job = plane_job(0.0, (0.5, 0.6, 0.0, 0.0, 0.0, 0.0), on_plane(0.0, 0.0, 3.2))
    found = bodies.run(job)
    hit = found["impacts"][0]
    assert hit[9] == pytest.approx(-math.sqrt(2.0 * 9.81 * 3.0), rel=0.01)
    assert hit[12] / -hit[9] == pytest.approx(0.5, abs=0.04)
    assert abs(hit[13]) < 0.3


def test_flight_is_a_parabola_that_keeps_energy_and_spin() -> None:
    """Free of torque, angular momentum and energy of rotation last while the spin itself nods."""
    job = plane_job(0.0, (0.0, 0.5, 0.0, 0.0, 0.01, 0.0), on_plane(0.0, 0.0, 60.0))
    site = bodies.RigidSite(job)
    block = bodies.RigidBlock(
        0, (3,), (-60.0, 0.0, 60.0), (8.0, 1.0, 2.0), (0.7, 0.5, 0.3), 2700.0, spin=(3.0, 9.0, 2.0)
    )
    moved = bodies._Motion(site, block, 1)
    _, inertia = bodies.hull_of(block.axes, np.random.default_rng(block.key))
    turns = []
    for _ in range(400):
        bodies.bullet.stepSimulation()
        place, quaternion = bodies.bullet.getBasePositionAndOrientation(moved._body)
        _, spin = bodies.bullet.getBaseVelocity(moved._body)
        frame = np.array(bodies.bullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
        turns.append(np.array(spin) @ frame)
    t = 400 * bodies.SAMPLE_S
    assert place[:2] == pytest.approx((-60.0 + 8.0 * t, t), abs=1e-6)
    # The library's step of 1 ms puts velocity before place: g t dt / 2 too low.
    fallen = 60.0 + 2.0 * t - 0.5 * 9.81 * t * t
    assert place[2] == pytest.approx(fallen - 0.5 * 9.81 * t * 0.001, abs=1e-3)
    body_spin = np.array(turns)
    energy = (body_spin**2 * inertia).sum(axis=1)
    momentum = np.linalg.norm(body_spin * inertia, axis=1)
    assert np.ptp(energy) < 0.03 * energy[0] and np.ptp(momentum) < 0.03 * momentum[0]
    assert np.ptp(body_spin[:, 1]) > 0.1


def test_hulls_have_the_volume_and_the_inertia_that_they_should() -> None:
    volume, centre, moments = bodies.mass_properties(BOX + np.array([3.0, -1.0, 2.0]))
    assert volume == pytest.approx(0.4)
    assert centre == pytest.approx([3.0, -1.0, 2.0])
    assert moments / volume == pytest.approx(np.diag([1.0, 1.0, 0.16]) / 12.0, abs=1e-12)
    rng = np.random.default_rng(4)
    for _ in range(20):
        axes = tuple(np.sort(rng.uniform(0.1, 0.7, 3))[::-1].tolist())
        points, inertia = bodies.hull_of(axes, rng)
        volume, centre, moments = bodies.mass_properties(points)
        assert volume == pytest.approx(4.0 / 3.0 * math.pi * math.prod(axes))
        assert centre == pytest.approx(np.zeros(3), abs=1e-9)
        second = np.diag(moments) / volume
        assert moments / volume == pytest.approx(np.diag(second), abs=1e-9)
        assert inertia == pytest.approx(second.sum() - second)
        assert 8 <= len(points) <= 30


@pytest.fixture(scope="module")
def site(null_world: World) -> World:
    """Stations where they are at the site of the model's law, which is there at once."""
    law = rigid.drawn_contacts(np.random.default_rng(5))
    return replace(null_world, spec=replace(null_world.spec, law="rigid"), law=law)


def test_the_library_has_the_ground_that_is_given(site: World) -> None:
    """Rays from above end on the bumps; a grid that is mirrored or turned would be metres off."""
    job: dict[str, Any] = {}

    def keep(_args: Any, input: bytes, **_: Any) -> Any:
        import io

        job.update(np.load(io.BytesIO(input)))
        raise InputError("kept")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rigid.subprocess, "run", keep)
        with pytest.raises(InputError, match="kept"):
            simulate(site, draw_rocks(site, 2, 3))
    ground = bodies.RigidSite(job).ground
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-80.0, 80.0, (2, 200))
    rays = bodies.bullet.rayTestBatch(
        np.column_stack([x, y, np.full(200, 400.0)]).tolist(),
        np.column_stack([x, y, np.full(200, -400.0)]).tolist(),
    )
    hit = np.array([ray[3][2] for ray in rays])
    assert np.abs(hit - ground.rough_height(x, y)).max() < 0.3
    assert np.median(np.abs(hit - ground.rough_height(x, y))) < 0.05
    smooth, gx, gy = ground.surface(x, y)
    assert 0.02 < np.std(hit - smooth) < 0.3
    col, row = site.true_grid.col_row(x + ground.x0, y + ground.y0)
    near = site.true_grid.values[np.round(row).astype(int), np.round(col).astype(int)] - ground.z0
    assert np.abs(near - smooth).max() < 1.5 * np.hypot(gx, gy).max()


@pytest.mark.parametrize("lying", [0.0, 0.3])
def test_rocks_do_not_depend_on_their_company(site: World, lying: float) -> None:
    world = with_effect(site, "collisions", lying)
    rocks = draw_rocks(world, 5, 3)
    together = simulate(world, rocks, 0.004)
    alone = simulate(world, some(rocks, [3, 0]), 0.004)
    for name in TABLES:
        one, other = getattr(together, name), getattr(alone, name)
        np.testing.assert_array_equal(one[one[:, 0] == 3, 1:], other[other[:, 0] == 0, 1:])
        np.testing.assert_array_equal(one[one[:, 0] == 0, 1:], other[other[:, 0] == 1, 1:])
    assert len(together.deposits) and len(together.passages) and len(together.impacts)


def test_a_block_is_stopped_by_what_stands_in_its_way_and_by_nothing_else(
    as_box: Callable[[float], None],
) -> None:
    beta = math.radians(20.0)
    as_box(beta)
    job = plane_job(beta, (0.0, 0.1, 0.0, 0.0, 0.0, 0.0), on_plane(beta, 4.0, 0.21))

    def last_x(*stems: tuple[float, float]) -> float:
        rows = [(x, y, 0.3, 1e12, 5.0, 0.0) for x, y in stems]
        found = bodies.run(job | {"obstacles": np.array(rows).reshape(-1, 6)})
        return float(found["tracks"][-1, 4])

    aside = [(60.0, y) for y in (20.0, 30.0, 50.0, 60.0)]
    assert last_x(*aside) == last_x() > 200.0
    assert last_x((60.0, 40.0), *aside) == pytest.approx(59.2, abs=0.2)


def test_contacts_are_those_of_the_path(site: World) -> None:
    run = simulate(site, draw_rocks(site, 8, 3), 0.004)
    hits = run.impacts
    assert (hits[:, 9] < 0.0).all() and (hits[:, 8] >= 0.0).all()
    assert (np.abs(hits[:, 14]) <= 180.0).all()
    # Of a contact comes no energy, but what the small bumps turn from one direction to another.
    before, after = np.hypot(hits[:, 8], hits[:, 9]), np.hypot(hits[:, 11], hits[:, 12])
    assert (after < before).mean() > 0.8
    # Where it was is where the film saw the block then.
    for row in hits[:: max(1, len(hits) // 40)]:
        own = run.tracks[(run.tracks[:, :2] == row[:2]).all(axis=1)]
        for axis, column in ((4, 4), (5, 5)):
            film = np.interp(row[16], own[:, 3], own[:, column])
            assert row[axis] == pytest.approx(film, abs=0.5)


@pytest.mark.battery
def test_stops_do_not_move_with_the_time_step(site: World) -> None:
    rocks = draw_rocks(site, 60, 9)
    frame = site.relief.frame
    s = [frame.s(*simulate(site, rocks, dt).deposits[:, 3:5].T) for dt in (0.004, 0.002, 0.001)]
    for one in s[:2]:
        standard = s[2].std() * math.sqrt(2.0 / 60.0)
        assert abs(one.mean() - s[2].mean()) < 2.5 * standard
        assert 0.6 < one.std() / s[2].std() < 1.7


@pytest.mark.battery
@pytest.mark.parametrize("name", [n for n in EFFECTS if n != "measurement_error"])
def test_an_effect_of_no_strength_changes_nothing(site: World, name: str) -> None:
    def stops(world: World) -> Any:
        return simulate(world, draw_rocks(world, 6, 7), 0.004).deposits

    bare = stops(site)
    np.testing.assert_array_equal(bare, stops(with_effect(site, name, 0.0)))
    assert not np.array_equal(bare, stops(with_effect(site, name, 0.9 * EFFECTS[name].strongest)))


def test_pieces_have_the_mass_of_their_rock(site: World) -> None:
    world = with_effect(site, "fragmentation", 8.0)
    run = simulate(world, draw_rocks(world, 6, 3), 0.004)
    assert len(run.deposits) > 10
    assert mass_is_kept(run, least=4)


def test_without_the_library_one_line_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rigid.importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(InputError, match=r"sassgis\[rigid\]"):
        rigid.require_library(["own", "rigid"])
    rigid.require_library(["own", "elastic"])
