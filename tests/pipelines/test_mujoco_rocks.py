"""Synthetic sites in MuJoCo: plausible motion, and no code in common with what they check."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest

pytest.importorskip("mujoco", reason='mujoco is not installed: pip install "sassgis[mujoco]"')

from gap_check.motion import FRAGMENT, Run, draw_rocks, simulate
from gap_check.mujoco_rocks import Block, Path, Site, spells
from gap_check.slopes import make_relief
from gap_check.worlds import FAR, PlacedEffect, World, WorldSpec

ROCKS = 3


def site(law: str, *effects: PlacedEffect, seed: int = 31) -> World:
    """A slope of grass with a bench, without the drawing of stations and strengths."""
    relief = make_relief("grass_slope", seed)
    x, y = relief.frame.xy(np.linspace(*relief.release_s, 4), np.linspace(-15.0, 15.0, 4))
    own = relief.surface
    blocks = {
        "axis_1_m": (0.45, 0.65), "axis_2_m": (0.35, 0.48), "axis_3_m": (0.2, 0.4),
        "density_kgm3": (2600.0, 2750.0), "speed_mps": (0.5, 2.0), "drop_m": (0.2, 1.0),
    }  # fmt: skip
    return World(
        WorldSpec("grass_slope", law=law), seed, relief, own, own, relief.ground,
        np.column_stack([x, y, own.at(x, y)]), blocks, np.array([40.0, 90.0]), effects=effects,
    )  # fmt: skip


def effect(name: str, share: float = 0.8, ground: str = "") -> PlacedEffect:
    return PlacedEffect(name, "strong", share, -FAR, FAR, ground, seed=3)


def run(world: World) -> Run:
    return simulate(world, draw_rocks(world, ROCKS, 3))


@pytest.fixture(scope="module", params=["elastic", "plastic"])
def moved(request: pytest.FixtureRequest) -> tuple[World, Run]:
    world = site(request.param)
    return world, run(world)


def test_nothing_is_shared_with_engine_and_diagnosis() -> None:
    program = (
        "import sys, gap_check.mujoco_rocks, gap_check.make, gap_check.observers\n"
        "print([name for name in sys.modules if name.split('.')[0] == 'sassgis'])"
    )
    pipelines = File(__file__).parents[2] / "pipelines"
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=pipelines, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_speeds_and_stops_are_plausible(moved: tuple[World, Run]) -> None:
    world, found = moved
    frame, d = world.relief.frame, found.deposits
    ends = frame.s(d["x"].to_numpy(), d["y"].to_numpy())
    # A slope of 33 to 38 degrees that ends in a meadow: they come down, and stop there.
    assert len(d) >= ROCKS - 1
    assert (ends > 60.0).all() and np.median(ends) < world.relief.breaks_m[-1]
    fall = found.tracks.groupby("rock")["z"].agg(lambda z: z.iloc[0] - z.min()).max()
    fastest = found.tracks["speed_mps"].max()
    assert 8.0 < fastest < np.sqrt(2.0 * 9.81 * fall + 4.0)
    assert (found.impacts["vn_in_mps"] < 0.0).all() and (found.impacts["vn_out_mps"] > 0.0).all()
    assert found.impacts["omega_out_radps"].median() > 0.0
    assert {*found.passages["station"]} == {0, 1}


def test_no_block_falls_through_the_ground(moved: tuple[World, Run]) -> None:
    world, found = moved
    t = found.tracks
    above = t["z"] - world.surface.at(t["x"].to_numpy(), t["y"].to_numpy())
    assert above.min() > 0.05


@pytest.mark.parametrize("law", ["elastic", "plastic"])
def test_no_energy_is_gained(law: str) -> None:
    world = site(law)
    own, rocks = Site(world), draw_rocks(world, 1, 3)
    start = Block(
        0, (1,), rocks.place[0] - own.middle, np.zeros(3), rocks.axes[0],
        float(rocks.volume[0] * 2700.0), float(rocks.volume[0]), np.zeros(3),
    )  # fmt: skip
    for shape in ("ellipsoid", "box", "mesh"):
        own.shape = shape
        path = Path(own, start, 1)
        path.follow()
        free = path.energy()[path.rows[: path.count, 13] == 0.0]
        lost = free[0] - free[-1]
        assert lost > 300.0
        assert (free - np.minimum.accumulate(free)).max() < 0.02 * lost


def test_plastic_contacts_rebound_less() -> None:
    ratios = {}
    for law in ("elastic", "plastic"):
        hit = run(site(law)).impacts
        hard = hit[hit["vn_in_mps"] < -3.0]
        ratios[law] = float((-hard["vn_out_mps"] / hard["vn_in_mps"]).median())
    assert ratios["plastic"] < ratios["elastic"] < 1.2


def test_the_same_seed_gives_the_same_numbers() -> None:
    world = site("plastic")
    one, two = (simulate(world, draw_rocks(world, 1, 3)) for _ in range(2))
    assert one.tracks.equals(two.tracks) and one.impacts.equals(two.impacts)


def test_pieces_have_the_mass_of_their_rock() -> None:
    found = run(site("elastic", effect("fragmentation", 0.4)))
    mass = found.rocks.volume * found.rocks.density
    stopped = found.deposits.groupby("rock")["mass_kg"].sum()
    assert (found.deposits["block"] == FRAGMENT).any()
    assert (stopped <= mass[stopped.index] * (1 + 1e-9)).all()
    assert (stopped > mass[stopped.index] * (1 - 1e-9)).sum() >= ROCKS - 2


def test_stems_and_soft_ground_hold_rocks_back() -> None:
    def farthest(*effects: PlacedEffect) -> float:
        world = site("elastic", *effects)
        t = run(world).tracks
        s = world.relief.frame.s(t["x"].to_numpy(), t["y"].to_numpy())
        return float(np.median(t.assign(s=s).groupby("rock")["s"].max()))

    free = farthest()
    stems = replace(effect("trees", 0.8), s0_m=50.0, s1_m=90.0)
    assert farthest(stems) < free - 20.0
    assert farthest(effect("soft_ground", 0.9, "soft_meadow")) < free - 20.0


def test_contacts_are_told_apart() -> None:
    touched = np.array([0, 0, 1, 1, 0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1], bool)
    assert spells(touched) == [(1, 4), (8, 12)]
