"""Worlds as a whole: fall lines, steps, strengths, observations, the battery."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from helpers.synthetic_rocks import some

from sassgis.gap.check.worlds import (
    EffectSpec,
    WorldSpec,
    battery,
    fresh_rocks,
    make_world,
    observe,
    setup,
)
from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds.battery import FULL, MODEST, quick_battery, world_seeds
from sassgis.gap.check.worlds.forces import Forces, Local, acceleration, drained
from sassgis.gap.check.worlds.make import NOMINAL_LAW, base_world, place_effect
from sassgis.gap.check.worlds.observe import merged_contacts
from sassgis.gap.check.worlds.simulation import draw_rocks, simulate
from sassgis.gap.check.worlds.slopes import SLOPE_TYPES
from sassgis.gap.check.worlds.strength import BANDS, effect_size, inhomogeneity
from sassgis.gap.check.worlds.world import (
    EFFECTS,
    FAMILIES,
    LAWS,
    Faults,
    World,
    with_effects,
)
from sassgis.model.errors import InputError


@pytest.mark.battery
def test_stops_do_not_move_with_the_time_step(null_world: World) -> None:
    rocks = draw_rocks(null_world, 150, 9)
    s = []
    for dt in (0.004, 0.002, 0.001):
        stops = simulate(null_world, rocks, dt).deposits
        s.append(null_world.relief.frame.s(stops[:, 3], stops[:, 4])[:, None])
    spread = s[2].std()
    assert inhomogeneity(s[1] / spread, s[2] / spread) < 0.1
    assert inhomogeneity(s[0] / spread, s[2] / spread) < 0.1


@pytest.mark.battery
def test_strengths_are_in_order_and_in_their_bands() -> None:
    found = []
    for strength in ("weak", "medium", "strong"):
        spec = WorldSpec("forested_slope", (EffectSpec("trees", strength),))
        effect = make_world(spec, 3).effects[0]
        low, _, high = BANDS[strength]
        assert effect.strength == strength
        assert low <= effect.size <= high
        found.append(effect.magnitude)
    assert found[0] < found[1] < found[2]


def test_the_same_seed_gives_the_same_world_and_rocks() -> None:
    spec = WorldSpec("gully", (EffectSpec("release_error", "medium"),))
    one, other = make_world(spec, 8), make_world(spec, 8)
    assert one.effects == other.effects
    assert np.array_equal(one.relief.grid.values, other.relief.grid.values)
    a, b = observe(one, "everything", 10, 1), observe(other, "everything", 10, 1)
    for name, table in a.tables.items():
        for column, values in table.items():
            assert np.array_equal(values, b.tables[name][column]), (name, column)
    fresh = fresh_rocks(one, 10)
    assert not np.array_equal(fresh.tables["rocks"]["mass_kg"], a.tables["rocks"]["mass_kg"])


def test_rocks_do_not_depend_on_their_company(null_world: World) -> None:
    rocks = draw_rocks(null_world, 5, 3)
    whole = simulate(null_world, rocks).deposits
    alone = simulate(null_world, some(rocks, [3])).deposits
    assert np.array_equal(whole[whole[:, 0] == 3, 1:], alone[:, 1:])


def test_each_kind_shows_what_it_says(null_world: World) -> None:
    shown = {
        "stations": {"rocks", "stations", "passages"},
        "stops": {"rocks", "deposits"},
        "both": {"rocks", "stations", "passages", "deposits"},
        "everything": {"rocks", "stations", "passages", "deposits", "impacts", "trajectories"},
    }
    for kind, names in shown.items():
        seen = observe(null_world, kind, 12, 2)
        assert set(seen.tables) == names
        for table in seen.tables.values():
            assert len({len(v) for v in table.values()}) == 1
    impacts = seen.tables["impacts"]
    assert (impacts["vn_in_mps"] < 0).all()
    assert (np.abs(impacts["turn_deg"]) <= 180.0).all()
    # Where the centre was released, not the ground beneath it.
    rocks = seen.tables["rocks"]
    ground = setup(null_world).releases[np.arange(12) % 12, 2]
    assert (rocks["z"] - ground > rocks["semi_axis_a_m"]).all()
    assert seen.metadata["speed_error_rel"] == 0.05
    with pytest.raises(InputError, match="kind"):
        observe(null_world, "all", 5, 1)


def test_measured_speeds_have_the_stated_error(null_world: World) -> None:
    true = simulate(null_world, draw_rocks(null_world, 200, 1004)).passages[:, 7]
    seen = observe(null_world, "stations", 200, 4).tables["passages"]["speed_mps"]
    assert np.std(np.log(seen / true)) == pytest.approx(0.05, rel=0.15)


def test_the_setup_tells_no_true_parameter(null_world: World) -> None:
    known = setup(null_world)
    assert not np.allclose(null_world.law, np.array(NOMINAL_LAW))
    assert known.class_codes.shape == known.dem.shape
    assert known.class_codes.max() < len(known.class_names)
    assert known.dem is null_world.relief.grid
    col, row = known.dem.col_row(known.releases[:, 0], known.releases[:, 1])
    assert (col > 2).all() and (row > 2).all()


def test_a_missing_terrace_is_missing_from_the_survey_alone(with_magnitude) -> None:  # type: ignore[no-untyped-def]
    world = with_magnitude("terrace", 2.0)
    apart = np.abs(world.true_grid.values - world.relief.grid.values)
    assert 1.0 < apart.max() < 2.0
    assert setup(world).dem is world.relief.grid


def test_the_battery_has_the_mix() -> None:
    specs = battery(3, 150)
    verdicts = Counter(_part(s) for s in specs)
    assert verdicts == {"none": 50, "single": 60, "pair": 20, "unknown": 20}
    assert battery(3, 150) == specs != battery(4, 150)
    for part in ("none", "pair"):
        designs = Counter((s.n_rocks, s.kind) for s in specs if _part(s) == part)
        assert len(designs) == 16
        assert max(designs.values()) - min(designs.values()) <= 1
    unknown = [s for s in specs if _part(s) == "unknown"]
    assert sum((s.n_rocks, s.kind) == FULL for s in unknown) == 14
    assert max(Counter(s.effects[0].name for s in unknown).values()) == 3
    assert "weak" not in {e.strength for s in specs if len(s.effects) == 2 for e in s.effects}
    for spec in specs:
        assert len({e.name for e in spec.effects}) == len(spec.effects)
    slopes = Counter(s.slope for s in specs)
    assert set(slopes) == set(SLOPE_TYPES)
    assert max(slopes.values()) - min(slopes.values()) <= 1


@pytest.mark.parametrize("seed", range(5))
def test_the_battery_spreads_sites_over_laws_and_circumstances(seed: int) -> None:
    specs = battery(seed, 160)
    laws = Counter(s.law for s in specs)
    assert set(laws) == set(LAWS)
    assert max(laws.values()) - min(laws.values()) <= 1
    assert {s.law for s in battery(seed, 30, ["rigid"])} == {"rigid"}
    for part in ("none", "single"):
        assert set(Counter(s.law for s in specs if _part(s) == part)) == set(LAWS)
    for spec in specs:
        assert spec.faults
        assert not (spec.disturbance and spec.effects)
    assert set(Counter(s.n_stations for s in specs)) == set(range(1, 9))
    assert Counter(s.named for s in specs)[False] == pytest.approx(160 / 3, abs=1)
    factors = Counter(s.error_factor for s in specs)
    assert [factors[f] for f in (0.5, 1.0, 1.5)] == [40, 80, 40]
    nulls = Counter(s.disturbance for s in specs if not s.effects)
    assert nulls[""] == pytest.approx(nulls["patch"] + nulls["speed_loss"], abs=1)


def test_a_site_that_cannot_be_is_refused() -> None:
    for changes in ({"law": "mine"}, {"n_stations": 0}, {"n_stations": 9}, {"disturbance": "x"}):
        with pytest.raises(InputError, match=next(iter(changes))):
            WorldSpec("gully", **changes)  # type: ignore[arg-type]


def test_observers_without_names_link_no_pieces(with_magnitude) -> None:  # type: ignore[no-untyped-def]
    world = with_magnitude("fragmentation", 2.0)
    nameless = replace(world, spec=replace(world.spec, named=False))
    known, seen = (observe(w, "everything", 8, 1).tables for w in (world, nameless))
    rocks = set(seen["rocks"]["rock_id"])
    pieces = np.char.find(known["deposits"]["rock_id"], ".") > 0
    assert pieces.sum() > 3
    own = seen["deposits"]["rock_id"]
    assert np.array_equal(own[~pieces], known["deposits"]["rock_id"][~pieces])
    assert not rocks & set(own[pieces])
    for name in ("deposits", "passages"):
        away = [i for i in seen[name]["rock_id"] if i not in rocks]
        assert len(away) == len(set(away)) > 0
    assert not set(away) & set(own)
    # On film a block is the same block from picture to picture.
    film = [i for i in seen["trajectories"]["rock_id"] if i not in rocks]
    assert len(set(film)) < len(film)
    assert {i for i in seen["impacts"]["rock_id"] if i not in rocks} <= set(film)


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_stated_errors_may_be_wrong_while_the_true_ones_stay(
    null_world: World, factor: float
) -> None:
    wrong = replace(null_world, spec=replace(null_world.spec, error_factor=factor))
    one, other = (observe(w, "stations", 12, 1) for w in (null_world, wrong))
    assert other.metadata["speed_error_rel"] == pytest.approx(factor * 0.05)
    assert other.metadata["fps"] == one.metadata["fps"]
    np.testing.assert_array_equal(
        one.tables["passages"]["speed_mps"], other.tables["passages"]["speed_mps"]
    )


@pytest.fixture(scope="module")
def faulty() -> World:
    world = base_world(WorldSpec("cliff_talus_meadow", faults=True), 5)
    faults = Faults(0.8, 0.2, 0.1, 0.5, 2.0, 0.15, (1.2, 0.3), ("contact_min_interval_s",))
    return replace(world, faults=faults)


def test_contacts_that_follow_soon_are_one_before_the_first_and_after_the_last() -> None:
    """Contacts at 0, 0.1, 0.3 s of one block and 0.35 s of another; none sooner than 0.2 s."""
    impacts = np.zeros((4, 17))
    impacts[3, 1] = 1
    impacts[:, 16] = 0.0, 0.1, 0.3, 0.35
    impacts[:, 9] = -4.0, -2.0, -3.0, -1.0
    impacts[:, 12] = 3.0, 1.0, 2.0, 0.5
    impacts[:, 14] = 5.0, -2.0, 1.0, 7.0
    found = merged_contacts(impacts[[3, 1, 0, 2]], 0.2)
    np.testing.assert_array_equal(found[:, 9], [-4.0, -3.0, -1.0])
    np.testing.assert_array_equal(found[:, 12], [1.0, 2.0, 0.5])
    np.testing.assert_array_equal(found[:, 14], [3.0, 1.0, 7.0])
    np.testing.assert_array_equal(merged_contacts(impacts, 0.0), impacts)


def test_observers_with_faults_miss_and_mistake_what_they_should(faulty: World) -> None:
    exact = replace(faulty, faults=Faults())
    seen, whole = (observe(w, "everything", 80, 1) for w in (faulty, exact))
    tables, all_tables = seen.tables, whole.tables
    # Speeds have an error of 5 %; the true ones are 0.8 m/s and more.
    assert (tables["impacts"]["vn_in_mps"] < -0.8 * 0.8).all()
    assert (all_tables["impacts"]["vn_in_mps"] > -0.8 * 0.8).any()
    kept = len(tables["passages"]["x"]) / len(all_tables["passages"]["x"])
    assert kept == pytest.approx(0.9, abs=0.08)
    shorter = len(tables["trajectories"]["x"]) / len(all_tables["trajectories"]["x"])
    assert shorter == pytest.approx(1.0 - 0.5 * 0.3, abs=0.06)
    assert (tables["deposits"]["x"] % 2.0 == 0.0).all()
    assert not (all_tables["deposits"]["x"] % 2.0 == 0.0).any()
    rocks, true = tables["rocks"], all_tables["rocks"]
    by_eye = np.log(rocks["semi_axis_a_m"] / true["semi_axis_a_m"])
    assert 0.08 < by_eye.std() < 0.2
    frame = faulty.relief.frame
    down = frame.s(rocks["x"], rocks["y"]) - frame.s(true["x"], true["y"])
    assert down.mean() == pytest.approx(1.2, abs=0.15)
    assert down.std() == pytest.approx(0.3, abs=0.1)
    assert seen.metadata["contact_min_interval_s"] == 0.2
    assert "passages_missed_share" not in seen.metadata


def test_terrain_models_have_faults_and_rocks_move_on_the_true_one() -> None:
    worlds = [base_world(WorldSpec("gully", faults=True, n_stations=1), k) for k in range(6)]
    apart = [np.abs(w.survey.values - w.relief.grid.values).mean() for w in worlds]
    assert min(apart) == 0.0 and 0.05 < max(apart) < 2.0
    assert len({round(v, 6) for v in apart}) > 3
    for world in worlds:
        assert setup(world).dem is world.survey
        assert world.true_grid is world.relief.grid


def test_a_patch_is_on_no_map_and_takes_part_in_the_motion() -> None:
    world = base_world(WorldSpec("cliff_talus_meadow", disturbance="patch"), 5)
    changed = world.ground != world.relief.ground
    assert 0.02 < changed.mean() < 0.4
    assert np.array_equal(setup(world).class_codes, world.relief.ground)
    rocks = draw_rocks(world, 40, 3)
    plain = replace(world, ground=world.relief.ground)
    assert not np.array_equal(simulate(world, rocks).deposits, simulate(plain, rocks).deposits)


def test_a_loss_that_grows_with_speed_takes_its_share(null_world: World) -> None:
    """At 10 m/s after a contact, a loss of 0.25 leaves 1/(1 + 0.25) of speed and spin."""
    assert drained(Local(0.25), 8.0, 6.0, 10.0) == pytest.approx((6.4, 4.8, 8.0))
    lossy = replace(null_world, speed_loss=0.25)
    rocks = draw_rocks(null_world, 60, 3)
    s = [
        null_world.relief.frame.s(*simulate(w, rocks).deposits[:, 3:5].T).mean()
        for w in (null_world, lossy)
    ]
    assert s[1] < s[0] - 10.0


@pytest.mark.battery
@pytest.mark.parametrize("count", [1, 8])
@pytest.mark.parametrize("slope", ["grass_slope", "quarry"])
def test_slopes_without_a_cliff_are_passed_and_hold_every_effect(slope: str, count: int) -> None:
    world = base_world(WorldSpec(slope, n_stations=count), 6)
    run = simulate(world, draw_rocks(world, 60, 3))
    assert world.station_names == tuple(f"S{k + 1}" for k in range(count))
    assert (run.passages[:, 3] == 0).sum() > 50
    # Rocks come to rest on the slope; few leave it.
    assert len(run.deposits) > 55
    for name in EFFECTS:
        effect = place_effect(world, EffectSpec(name), 9)
        assert effect.s0_m < effect.s1_m
        assert effect.segments


def test_air_resists_by_no_more_than_air_does() -> None:
    """C_d of a block that shows its widest side, at the strongest magnitude, is at most 2."""
    forces = Forces(air_drag=Local(EFFECTS["air_drag"].strongest))
    st = np.zeros(ms.N_STATE)
    st[ms.DENSITY] = 1500.0
    for size in (0.2, 1.25):
        st[ms.A : ms.C + 1] = axes = 0.65 * size, 0.35 * size, 0.18 * size
        pull, _, _ = acceleration(forces, st, 0.5 * np.pi, 20.0, 0.0, 0.0)
        mass = 1500.0 * 4.0 / 3.0 * np.pi * np.prod(axes)
        area = np.pi * axes[0] * axes[2]
        assert 1.5 < -pull * mass / (0.5 * 1.2 * area * 20.0**2) <= 2.0


def test_few_stops_have_a_size_too() -> None:
    rng = np.random.default_rng(1)
    few, many = rng.normal(size=(10, 3)), rng.normal(size=(60, 3))
    assert 0.0 <= effect_size([few, many], [few, many + 1.0]) <= 1.0


@pytest.mark.parametrize("seed", range(5))
def test_families_come_round_evenly_in_each_design(seed: int) -> None:
    singles = [s for s in battery(seed, 150) if _part(s) == "single"]
    rest = [s for s in singles if (s.n_rocks, s.kind) not in (FULL, MODEST)]
    full = [s for s in singles if (s.n_rocks, s.kind) == FULL]
    modest = [s for s in singles if (s.n_rocks, s.kind) == MODEST]
    assert [len(full), len(modest), len(rest)] == [24, 20, 16]
    for cell, most in ((full, 3), (modest, 2), (rest, 2), (singles, 6)):
        families = Counter(s.effects[0].name for s in cell)
        assert set(families) == set(FAMILIES)
        assert max(families.values()) <= most
    assert len({(s.n_rocks, s.kind) for s in rest}) == 14
    strengths = Counter(s.effects[0].strength for s in singles)
    assert strengths == {"weak": 12, "medium": 24, "strong": 24}
    weak = Counter(s.effects[0].name for s in singles if s.effects[0].strength == "weak")
    assert set(weak) == set(FAMILIES)


def test_the_quick_battery_is_small() -> None:
    specs = quick_battery(3)
    assert Counter(_part(s) for s in specs) == {"none": 2, "single": 3, "unknown": 1}
    assert {s.n_rocks for s in specs} == {20, 40}
    assert {e.strength for s in specs for e in s.effects} == {"strong"}


def test_batteries_have_no_world_in_common() -> None:
    one, other = world_seeds(1, 400), world_seeds(2, 400)
    assert len({*one, *other}) == 800
    assert world_seeds(1, 6) == one[:6]


def _part(spec: WorldSpec) -> str:
    if spec.verdict in ("none", "unknown"):
        return spec.verdict
    return "single" if len(spec.effects) == 1 else "pair"


@pytest.mark.battery
@pytest.mark.parametrize("name", ["trees", "terrace", "collisions"])
def test_what_stands_on_the_slope_is_there_after_a_world_is_made(name: str) -> None:
    world = make_world(WorldSpec("cliff_talus_meadow", (EffectSpec(name, "strong"),)), 50)
    rocks = draw_rocks(world, 60, 5)
    made = simulate(world, rocks)
    bare = simulate(with_effects(world, ()), rocks)
    assert made.passages.shape != bare.passages.shape
    fresh = with_effects(with_effects(world, ()), world.effects)
    np.testing.assert_array_equal(made.passages, simulate(fresh, rocks).passages)
