"""Effects: silent when off, honest about mass, momentum and energy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers.synthetic_rocks import TABLES, mass_is_kept

from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds.after_contact import loosen, shatter
from sassgis.gap.check.worlds.forces import Forces, Local, indent, strike
from sassgis.gap.check.worlds.observe import distort
from sassgis.gap.check.worlds.simulation import draw_rocks, simulate
from sassgis.gap.check.worlds.world import EFFECTS, World, with_effects

Make = Callable[[str, float], World]
# These give energy from outside, or change what is written down rather than what happens.
_OPEN = ("wind", "measurement_error")


def nothing_waits() -> ms.Waiting:
    """No block waits, and one has been made."""
    states = np.zeros((ms.MAX_PIECES, ms.N_STATE))
    return ms.Waiting(states, np.zeros(ms.MAX_PIECES, np.uint64), np.array([0, 1]))


def _same(one: World, other: World) -> bool:
    a = distort(one, simulate(one, draw_rocks(one, 24, 7)))
    b = distort(other, simulate(other, draw_rocks(other, 24, 7)))
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in TABLES)


@pytest.mark.battery
@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_no_strength_changes_no_bit(
    name: str, null_world: World, with_magnitude: Make
) -> None:
    assert _same(null_world, with_magnitude(name, 0.0))
    assert not _same(null_world, with_magnitude(name, 0.9 * EFFECTS[name].strongest))


@pytest.mark.parametrize("name", ["soft_ground", "roughness", "lateral_deflection", "ice"])
def test_an_effect_acts_nowhere_but_in_its_place(
    name: str, null_world: World, with_magnitude: Make
) -> None:
    world = with_magnitude(name, EFFECTS[name].strongest)
    elsewhere = replace(world.effects[0], s0_m=5000.0, s1_m=6000.0)
    assert _same(null_world, with_effects(world, (elsewhere,)))


@pytest.mark.battery
@pytest.mark.parametrize("name", [n for n in EFFECTS if n not in _OPEN])
def test_energy_is_never_made(name: str, with_magnitude: Make) -> None:
    world = with_magnitude(name, 0.6 * EFFECTS[name].strongest)
    run = simulate(world, draw_rocks(world, 30, 3))
    assert run.energy_gain.max() <= 1e-9
    # Along the path of each rock, energy rises by no more than its centre does as it turns over.
    axes = run.rocks.state[:, [ms.A, ms.B]]
    tracks = run.tracks[run.tracks[:, 2] == ms.ROCK]
    rock = tracks[:, 0].astype(int)
    inertia = (axes**2).sum(axis=1)[rock] / 5.0
    spin = 2 * math.pi * tracks[:, 8]
    energy = 0.5 * tracks[:, 7] ** 2 + 9.81 * tracks[:, 6] + 0.5 * inertia * spin**2
    same = np.diff(rock) == 0
    # On the cliff, at 65°, the centre of a rolling ellipse stands (a - b)/cos 65° higher at most.
    rise = 9.81 * (axes[:, 0] - axes[:, 1]).max() / math.cos(math.radians(65.0))
    assert np.diff(energy)[same].max() < rise + 1.0
    assert energy[0] > energy.min() + 500.0


@pytest.mark.parametrize(
    ("magnitude", "whole"), [(2.0, 14), pytest.param(8.0, 13, marks=pytest.mark.battery)]
)
def test_pieces_have_the_mass_of_their_rock(
    magnitude: float, whole: int, with_magnitude: Make
) -> None:
    world = with_magnitude("fragmentation", magnitude)
    run = simulate(world, draw_rocks(world, 16, 3))
    assert len(run.deposits) > 16
    assert mass_is_kept(run, least=whole)


def test_a_breaking_rock_keeps_its_momentum(plane) -> None:  # type: ignore[no-untyped-def]
    ground = plane(0.6, [0.5, 0, 0.3, 0.7, 0.5, 0, 0])
    st = ground.rock(0.6, 0.5, 12.0, 3.0, 9.0)
    for n in range(1, 40):
        waiting, state, lost = nothing_waits(), st.copy(), 30.0
        shatter(state, np.uint64(3), n, lost, waiting)
        pieces = waiting.states[: waiting.counts[0]]
        assert 2 <= len(pieces) <= 5 and state[ms.MODE] == ms.BROKEN
        mass = pieces[:, [ms.A, ms.B, ms.C]].prod(axis=1)
        assert mass.sum() == pytest.approx(0.6 * 0.5 * 0.5, rel=1e-12)
        velocity = pieces[:, ms.VX : ms.VZ + 1]
        before = st[ms.VX : ms.VZ + 1]
        assert (mass[:, None] * velocity).sum(axis=0) / mass.sum() == pytest.approx(
            before, abs=1e-9
        )
        energy = 0.5 * (mass[:, None] * velocity**2).sum() / mass.sum()
        assert energy <= 0.5 * (before**2).sum() + 0.1 * lost + 1e-9


def test_blows_and_dents_take_energy() -> None:
    rng = np.random.default_rng(2)
    for _ in range(400):
        angle = rng.uniform(0, 2 * math.pi)
        nx, ny = math.cos(angle), math.sin(angle)
        vx, vy = rng.normal(0, 10, 2)
        if vx * nx + vy * ny >= 0:
            continue
        mass = rng.uniform(50, 3000)
        other = rng.choice([0.0, 800.0])
        capacity = 10 ** rng.uniform(2, 6) if other == 0 else 1e12
        ox, oy = strike(nx, ny, vx, vy, mass, capacity, other)
        assert ox**2 + oy**2 <= (vx**2 + vy**2) * (1 + 1e-12)
        if 0.5 * mass * (vx * nx + vy * ny) ** 2 < capacity and other == 0:
            assert ox * nx + oy * ny >= 0
        out = indent(Local(q=rng.uniform(0.1, 30)), mass, 0.5, 0.1, -6.0, 9.0, 8.0, 2.0, 16.0)
        assert out[0] ** 2 + out[1] ** 2 + 0.1 * out[2] ** 2 <= 64 + 4 + 25.6 + 1e-9
        assert abs(out[1]) < 2.0 and out[2] < 16.0


def test_a_loosened_block_takes_its_momentum_from_the_rock(plane) -> None:  # type: ignore[no-untyped-def]
    ground = plane(0.6, [0.5, 0, 0.3, 0.7, 0.5, 0, 0])
    forces = Forces(entrainment=Local(q=1e9))
    for n in range(1, 30):
        st = ground.rock(0.6, 0.5, 12.0, 0.0, 9.0)
        before = st[ms.VX : ms.VZ + 1].copy()
        waiting = nothing_waits()
        loosen(ground.field, forces, st, np.uint64(5), n, 5.0, 50.0, 40.0, waiting)
        assert waiting.counts[0] == 1
        loose = waiting.states[0]
        ratio = (loose[ms.A] / st[ms.A]) ** 3
        small, large = loose[ms.VX : ms.VZ + 1], st[ms.VX : ms.VZ + 1]
        assert large + ratio * small == pytest.approx(before, abs=1e-9)
        assert (large**2).sum() + ratio * (small**2).sum() <= (before**2).sum() + 1e-9
