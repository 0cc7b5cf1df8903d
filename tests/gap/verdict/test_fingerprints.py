"""Fingerprints: what each cause leaves, and what must leave nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import BASE, observed, with_metadata, with_observed, with_rows

from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.gap.causes.all_causes import CAUSES, STATISTICS
from sassgis.gap.causes.extra_blocks import mass_budget
from sassgis.gap.causes.trees_cause import losses_at_one_place
from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.forward.released_rocks import MeasurementError, ReleaseError
from sassgis.gap.observations.case import Case
from sassgis.gap.observations.tables import Deposits
from sassgis.gap.residuals.residual_table import (
    ResidualTable,
    StepTable,
    residuals_of,
    residuals_with,
    with_configured_paths,
)
from sassgis.gap.verdict.verdict import fingerprints, significant, strongest, where
from sassgis.settings.blocks import EffectSettings
from sassgis.terrain.cells import heights_at

EXTRA = ("fragmentation", "entrainment")


@pytest.fixture(scope="module")
def case() -> Case:
    """Rocks that the engine released without any effect."""
    return observed(30, 3)


def table_of(case: Case) -> ResidualTable:
    return residuals_of(case, BASE, seed=5, replicates=8)


@pytest.fixture(scope="module")
def residuals(case: Case) -> ResidualTable:
    return table_of(case)


def printed(case: Case, residuals: ResidualTable) -> dict[str, Fingerprint]:
    return strongest(fingerprints(case, residuals))


def sure(case: Case, residuals: ResidualTable) -> set[str]:
    """Causes that have a significant fingerprint."""
    return set(significant(fingerprints(case, residuals), 0.01))


def by_name(case: Case, residuals: ResidualTable) -> dict[str, Fingerprint]:
    return {f.statistic: f for f in fingerprints(case, residuals)}


def in_days(case: Case) -> Case:
    """The case with five rocks released on each day."""
    days = np.array([f"day {k // 5}" for k in range(case.n_rocks)])
    return with_observed(case, rocks=replace(case.observations.rocks, group=days))


def with_deposits(case: Case, **columns: object) -> Case:
    deposits = replace(case.observations.deposits, **columns)  # type: ignore[arg-type]
    return with_observed(case, deposits=deposits)


def with_blocks(case: Case, masses: list[float], drop: int = 0) -> Case:
    """The case with ``drop`` rocks' deposits replaced by, and more, unattributed blocks."""
    own = case.observations.deposits
    kept = own.take(np.arange(drop, len(own)))
    n = len(masses)
    deposits = Deposits.of(
        rock_id=[*kept.rock_id.tolist(), *[f"U{k}" for k in range(n)]],
        x=[*kept.x, *np.full(n, kept.x[0])],
        y=[*kept.y, *np.full(n, kept.y[0])],
        mass_kg=[*kept.mass_kg, *masses],
    )
    return with_observed(case, deposits=deposits)


def test_the_model_itself_leaves_no_fingerprint(case: Case, residuals: ResidualTable) -> None:
    assert not sure(case, residuals)
    assert {"trees", "lateral_deflection", "fragmentation"} <= set(printed(case, residuals))


def test_deflection_is_not_compared_with_paths_that_were_calibrated_to_it(case: Case) -> None:
    tilt, drift = case.engine.side_tilt_deg, case.engine.drift_deg
    wide = replace(BASE, side_tilt_deg=0.5 * tilt, drift_deg=3.0 * drift)
    followed = residuals_of(case, wide, seed=5, replicates=4)
    less = with_configured_paths(case, followed)
    assert less.run is followed.run and less.rows is followed.rows
    assert less.configured_paths.model == replace(wide, drift_deg=drift)
    assert less.configured_paths.axes_m.shape == followed.run.axes_m.shape
    narrow = residuals_of(case, replace(BASE, drift_deg=0.5 * drift), seed=5, replicates=4)
    assert with_configured_paths(case, narrow) is narrow
    assert narrow.configured_paths is narrow.run


def test_what_was_not_observed_cannot_be_seen() -> None:
    few = observed(20, 3, tables=("deposits",))
    found = fingerprints(few, table_of(few))
    assert {f.statistic for f in found} == set(STATISTICS)
    seen = strongest(found)
    unseen = {"trees", "air_drag", "release_error", "measurement_error", "lateral_deflection"}
    assert unseen.isdisjoint(seen)
    assert {"fragmentation", "entrainment"} <= set(seen)


def test_blocks_are_known_by_their_masses_whatever_they_are_called(
    case: Case, residuals: ResidualTable
) -> None:
    mass = case.mass_kg
    pieces = np.concatenate([mass[:8] * 0.6, mass[:8] * 0.4]).tolist()
    broken = with_blocks(case, pieces, drop=8)
    found = printed(broken, residuals)
    assert found["fragmentation"].p_adjusted <= 0.01
    assert found["entrainment"].p_adjusted > 0.05
    names = broken.observations.deposits.rock_id.copy()
    names = np.array([f"X{k}" for k in range(names.size)])
    again = printed(with_deposits(broken, rock_id=names), residuals)
    assert again["fragmentation"] == found["fragmentation"]
    more = printed(with_blocks(case, (mass * 0.2).tolist()), residuals)
    assert more["entrainment"].p_adjusted <= 0.01 and more["fragmentation"].p_adjusted > 0.05


def test_rocks_that_nobody_found_broke_or_left() -> None:
    few = observed(30, 3, tables=("deposits",))
    residuals, lost = table_of(few), few.mass_kg[:8]

    def seen(share: float, names: tuple[str, ...] = ()) -> dict[str, float]:
        """Z of causes that are significant where this share of eight rocks lies in ten blocks
        each.
        """
        blocks = with_blocks(few, np.repeat(0.1 * share * lost, 10).tolist(), drop=8)
        if names:
            ids = blocks.observations.deposits.rock_id.copy().astype(object)
            ids[-len(names) :] = names
            blocks = with_deposits(blocks, rock_id=ids.astype(str))
        found = printed(blocks, residuals)
        return {n: found[n].z for n in EXTRA if found[n].p_adjusted <= 0.01}

    assert [*seen(0.95)] == ["fragmentation"]
    # What lies makes up for half of them only: it may be theirs, or have been set in motion.
    either = seen(0.5)
    assert [*either] == ["fragmentation", "entrainment"] and len({*either.values()}) == 1
    # Where pieces bear the names of their rocks it is theirs.
    names = few.observations.rock_names[:8]
    assert [*seen(0.5, tuple(f"{n}.{k}" for n in names for k in range(10)))] == ["fragmentation"]


def test_pieces_that_bear_the_name_of_their_rock_show_that_it_broke(
    case: Case, residuals: ResidualTable
) -> None:
    """Whatever masses say: these are hardly known here."""
    unsure = with_metadata(case, mass_error_rel=0.3)
    pieces = with_blocks(unsure, [5.0] * 8)
    assert "fragmentation" not in sure(pieces, residuals)
    ids = pieces.observations.deposits.rock_id.astype(object)
    ids[-8:] = [f"{name}.1" for name in case.observations.rock_names[:8]]
    assert "fragmentation" in sure(with_deposits(pieces, rock_id=ids.astype(str)), residuals)
    # Of two rocks several pieces say as much, and one of each, which may be misnamed, does not.
    first, second = case.observations.rock_names[:2]
    for own, seen in (([f"{n}.{k}" for n in (first, second) for k in range(4)], True),
                      ([f"{first}.1", f"{second}.1"], False)):  # fmt: skip
        ids = pieces.observations.deposits.rock_id.astype(object)
        ids[-len(own) :] = own
        found = sure(with_deposits(pieces, rock_id=ids.astype(str)), residuals)
        assert ("fragmentation" in found) == seen


def test_a_few_rocks_that_nobody_found_and_blocks_without_a_name_may_be_either() -> None:
    """As many kilograms are no sign that the blocks are theirs."""
    few = observed(30, 3, tables=("deposits",))
    lost = few.mass_kg[:3]
    found = by_name(with_blocks(few, np.repeat(0.1 * lost, 10).tolist(), drop=3), table_of(few))
    broken, more = (found[CAUSES[c].statistics[-1].name].z for c in EXTRA)
    assert broken == more > 3.0


def test_masses_scatter_as_those_of_whole_rocks_do(case: Case, residuals: ResidualTable) -> None:
    """Where rocks lie under their names this is seen; errors that are stated too small do not."""
    rng = np.random.default_rng(4)
    mass = case.mass_kg * np.exp(0.25 * rng.standard_normal(case.n_rocks))
    stated = with_metadata(case, mass_error_rel=0.05)
    lies = with_blocks(with_deposits(stated, mass_kg=mass), [0.03 * float(np.median(mass))] * 60)
    score = CAUSES["fragmentation"].statistics[-1].scores
    assert float(score(lies, residuals).values[0]) < 3.0
    names = np.array([f"X{k}" for k in range(len(lies.observations.deposits))])
    assert float(score(with_deposits(lies, rock_id=names), residuals).values[0]) > 6.0


def test_a_few_chips_change_nothing(case: Case, residuals: ResidualTable) -> None:
    light = float(np.median(case.mass_kg)) * np.array([0.008, 0.004, 0.009, 0.002, 0.006])
    chips = printed(with_blocks(case, light.tolist()), residuals)
    assert chips == printed(case, residuals)


def test_the_mass_budget_counts_what_is_missing_and_what_is_more() -> None:
    rocks = np.array([100.0, 400.0, 900.0])
    assert mass_budget(rocks, rocks[::-1]) == (0.0, 0.0)
    # 900 kg lie as 500 and 400: the ranks 900, 400, 100 hold 500, 400, 400.
    broken, more = mass_budget(rocks, np.array([400.0, 100.0, 500.0, 400.0]))
    assert broken == pytest.approx(400.0 / 1400.0) and more == pytest.approx(0.0)
    # A rock that was not found did not break.
    broken, _ = mass_budget(rocks, np.array([400.0, 100.0, 2.0, 1.0]))
    assert broken == pytest.approx(1.0 / 1400.0)
    broken, more = mass_budget(rocks, np.array([100.0, 400.0, 900.0, 280.0]))
    assert broken == pytest.approx(0.0) and more == pytest.approx(0.2)


@pytest.mark.parametrize("error", [0.02, 0.1])
def test_errors_of_masses_are_no_extra_blocks(
    case: Case, residuals: ResidualTable, error: float
) -> None:
    rng = np.random.default_rng(3)
    stated = with_metadata(case, mass_error_rel=error)
    largest = []
    for _ in range(40):
        mass = case.mass_kg * np.exp(error * rng.standard_normal(case.n_rocks))
        lies = with_blocks(
            with_deposits(stated, mass_kg=mass), [0.03 * float(np.median(case.mass_kg))]
        )
        found = [CAUSES[c].statistics[-1].scores(lies, residuals) for c in EXTRA]
        largest.append([float(own.values[0]) for own in found])
    assert (np.array(largest) > 3.0).mean() < 0.05


def test_a_film_that_begins_below_the_start_says_nothing_of_it(
    case: Case, residuals: ResidualTable
) -> None:
    name = "first point of the path against the stated start"
    track = case.observations.trajectories
    late = np.zeros(len(track), bool)
    begun = track.t_s.copy()
    at_rest = track.x.copy(), track.y.copy()
    for rows in case.observations.paths_of_rocks().values():
        below = rows[track.t_s[rows] > 3.0]
        late[below] = True
        begun[below] -= track.t_s[below[0]]
        # The same way from the true start, which is 12 m below the stated one.
        at_rest[1][rows] -= 12.0
    filmed = with_observed(case, trajectories=replace(track, t_s=begun))
    assert not by_name(with_rows(filmed, "trajectories", late), residuals)[name].observable
    wrong = with_observed(case, trajectories=replace(track, y=at_rest[1]))
    assert by_name(wrong, residuals)[name].z > 6.0

    def with_other_clock(own: Case) -> Case:
        path = own.observations.trajectories
        return with_observed(own, trajectories=replace(path, t_s=path.t_s + 40.0))

    # A clock may begin at any time; late films are seen by what the rocks have fallen then.
    assert by_name(with_other_clock(wrong), residuals)[name].z > 6.0
    moved = with_rows(with_other_clock(filmed), "trajectories", late)
    assert not by_name(moved, residuals)[name].observable


def test_what_is_wrong_below_a_station_without_speeds_is_no_error_of_the_release(
    case: Case, residuals: ResidualTable
) -> None:
    first, second = case.reaches[0], case.reaches[1]
    slow = [
        replace(r, observed=r.observed - (9.0 if r.place == second else 0.0))
        for r in residuals.rows
        if not (r.test == "reach" and r.quantity == "speed_mps" and r.place == first)
    ]
    found = by_name(case, replace(residuals, rows=tuple(slow)))
    assert not found["speed on the first reach, right on the others"].observable
    assert found["speed lost on one reach, right on the others"].z > 3.0


def changed(residuals: ResidualTable, step: str, quantity: str, add: np.ndarray) -> ResidualTable:
    steps: StepTable = residuals.steps
    own = (steps.step == step) & (steps.quantity == quantity)
    values = steps.observed.copy()
    values[own] += add[own]
    return replace(residuals, steps=replace(steps, observed=values))


def test_losses_in_flight_are_air_or_stems() -> None:
    # Of half of the flights it is certain that no contact was missed on them.
    case = observed(80, 3)
    residuals = table_of(case)
    rng = np.random.default_rng(4)
    steps = residuals.steps
    n = len(steps)
    hit = rng.random(n) < 0.15
    stems = changed(
        residuals, "flight", "energy_jpkg", -0.95 * np.nan_to_num(steps.predicted) * hit
    )
    found = sure(case, stems)
    assert "trees" in found and "air_drag" not in found
    # A loss on every flight that no air could take is not called air.
    huge = 30.0 * 0.75 * 1.2 / (2700.0 * steps.radius_m) * steps.way_m * steps.predicted
    found = printed(case, changed(residuals, "flight", "energy_jpkg", -huge))
    assert "air_drag" not in found or found["air_drag"].p_adjusted > 0.05


def test_contacts_that_last_are_no_air(case: Case, residuals: ResidualTable) -> None:
    # Blocks of light stone, of radii from 0.12 to 0.3 m: air takes more of the small ones.
    steps = residuals.steps
    radius = np.geomspace(0.12, 0.3, case.n_rocks)
    light = replace(case, radius_m=radius, mass_kg=4.0 / 3.0 * np.pi * radius**3 * 600.0)
    steps = replace(steps, radius_m=radius[steps.rock], sd=np.full(len(steps), 8.0))
    own = steps.step == "flight"
    noise = 2.0 * np.random.default_rng(5).standard_normal(len(steps))
    at_rest = np.where(own, steps.predicted + noise, steps.observed)
    flown = replace(residuals, steps=replace(steps, observed=at_rest))
    speed2 = np.where(own, 2.0 * steps.predicted, 0.0)
    fall = np.nan_to_num(steps.fell_jpkg / steps.way_m) * np.sqrt(speed2)
    pull = 0.5 * 1.2 * np.pi * steps.radius_m**2 / light.mass_kg[steps.rock] * speed2
    name, z = "energy lost in flight, over path and size, on every flight", {}
    for lasts_s, drag in ((0.0, 0.0), (0.06, 0.0), (0.0, 1.2), (0.06, 1.2)):
        lost = lasts_s * fall + drag * np.nan_to_num(pull * steps.way_m)
        z[lasts_s, drag] = by_name(light, changed(flown, "flight", "energy_jpkg", -lost))[name].z
    assert max(z[0.0, 0.0], z[0.06, 0.0]) < 0.0 < 3.0 < min(z[0.0, 1.2], z[0.06, 1.2])


@pytest.mark.parametrize(
    ("drag", "aside", "slack", "mass_kg", "seen"),
    [
        (1.2, 0.0, 0.0, 5.0, True), (0.0, 0.0, 0.0, 5.0, False), (1.2, 1.2, 0.0, 5.0, False),
        (6.0, 0.0, 0.0, 5.0, False),
        # Gravity of the film that is hardly known, and rocks that air does not hold.
        (1.2, 0.0, 0.6, 5.0, False), (1.2, 0.0, 0.0, 4000.0, False),
    ],
)  # fmt: skip
def test_air_brakes_against_the_motion_and_by_the_size(
    case: Case,
    residuals: ResidualTable,
    drag: float,
    aside: float,
    slack: float,
    mass_kg: float,
    seen: bool,
) -> None:
    # Small blocks of light stone, well filmed; wind bends paths aside, lift does more than air.
    light = replace(case, mass_kg=np.full(case.n_rocks, mass_kg))
    steps = residuals.steps
    pull = 0.5 * 1.2 * np.pi * steps.radius_m**2 / mass_kg * steps.speed2
    own = steps.step == "air"
    ahead, across = 0.3 * np.random.default_rng(8).standard_normal((2, int(own.sum()) // 3))
    values, sd = steps.observed.copy(), np.where(own, 0.3, steps.sd)
    values[own] = np.concatenate([ahead, ahead, across])
    filmed = replace(residuals, steps=replace(steps, observed=values, sd=sd))
    shares = {"ahead_mps2": -drag, "lighter_mps2": slack - drag, "across_mps2": aside}
    for name, share in shares.items():
        filmed = changed(filmed, "air", name, np.nan_to_num(share * pull))
    name = "level speed lost in flight, over speed squared and size"
    found = by_name(light, filmed)[name]
    assert seen == (found.observable and found.p_adjusted <= 0.01)


def test_a_cause_in_the_model_leaves_no_fingerprint_of_its_own() -> None:
    effects = EffectSettings(SoftGround("velocity_scaled", classes=(), reference_speed_mps=2.0))
    soft = observed(30, 3, effects=effects)
    assert where(soft, table_of(soft), seed=5)[0].p_adjusted <= 0.01
    again, left = residuals_with(soft, replace(BASE, effects=effects), seed=5, replicates=8)
    assert not sure(again, left)


def test_what_instruments_scale_is_scaled_back(case: Case) -> None:
    seen = case.observations
    fast = seen.passages.speed_mps * 1.2
    scaled = with_observed(case, passages=replace(seen.passages, speed_mps=fast))
    model = replace(
        BASE, release=ReleaseError(faster_mps=4.0), measurement=MeasurementError(scale=1.2)
    )
    again, left = residuals_with(scaled, model, seed=5, replicates=4)
    np.testing.assert_allclose(again.observations.passages.speed_mps, seen.passages.speed_mps)
    assert [b.speed_mps[1] for b in again.blocks] == [b.speed_mps[1] + 4.0 for b in case.blocks]
    assert left.run.ends.runout_m.shape == (case.n_rocks, 4)


def test_rocks_of_one_group_count_once(case: Case, residuals: ResidualTable) -> None:
    found = printed(in_days(case), residuals)
    assert max(f.rocks for f in found.values()) <= 6


def test_stems_are_seen_where_paths_lose_speed_above_the_ground(
    case: Case, residuals: ResidualTable
) -> None:
    name = "speed lost above the ground, where no contact takes it"
    free = by_name(case, residuals)[name]
    steps = residuals.steps
    hit = np.random.default_rng(4).random(len(steps)) < 0.3
    lost = changed(residuals, "aloft", "speed_mps", -0.7 * np.nan_to_num(steps.predicted) * hit)
    found = by_name(case, lost)
    assert free.z < 2.0 < 4.0 < found[name].z and found[name].p_adjusted <= 0.01
    # Rocks of one day share what befell that day.
    days = by_name(in_days(case), lost)[name]
    assert days.rocks <= 6 and days.z < found[name].z
    # All at one place: a step that the terrain model lacks.
    same = np.where(steps.step == "aloft", 60.0, steps.way_m)
    at_one = replace(lost, steps=replace(lost.steps, way_m=same))
    assert not by_name(case, at_one)[name].observable
    found = losses_at_one_place(at_one)
    assert found is not None and found[0] > 5 and found[1] == 60.0
    assert losses_at_one_place(lost) is None


def test_turns_of_the_heading_do_not_speak_for_rough_ground(
    case: Case, residuals: ResidualTable
) -> None:
    rng = np.random.default_rng(6)
    steps = residuals.steps
    away = rng.standard_normal(len(steps))
    edges = changed(residuals, "impact", "normal_speed_mps", 3.0 * np.nan_to_num(steps.sd) * away)
    turned = changed(edges, "impact", "turn_deg", 30.0 * rng.standard_normal(len(steps)))
    found = by_name(case, turned)
    rough = [t.name for t in CAUSES["roughness"].statistics]
    assert all(found[name].p_adjusted > 0.01 for name in rough)
    assert found["turn of the heading at impacts"].effect == "lateral_deflection"
    assert found["turn of the heading at impacts"].z > 3.0


def test_rocks_that_tumble_have_no_heading(case: Case) -> None:
    impacts = case.observations.impacts
    out = np.hypot(impacts.vt_out_mps, impacts.vn_out_mps)
    fall = np.sqrt(4.0 * 9.81 * case.radius_m[case.observations.rock_of("impacts")])
    name = "turn of the heading at impacts"
    aside = 60.0 * np.random.default_rng(9).choice([-1.0, 1.0], len(impacts))
    found = []
    for tumbling in (out < fall, out >= fall):
        turned = replace(impacts, turn_deg=np.where(tumbling, aside, 0.0))
        other = with_observed(case, impacts=turned)
        found.append(by_name(other, table_of(other))[name])
    assert found[0].observable and found[1].observable
    assert found[0].z < 2.0 < 4.0 < found[1].z


def test_turns_are_those_of_simulated_paths_as_fast(residuals: ResidualTable) -> None:
    # 40° at 2 m/s, 20° at 4, 10° at 8: turns fall with the speed, on both sides alike.
    speed = np.linspace(1.0, 20.0, 400)
    turn_deg = 80.0 / speed * np.where(np.arange(400) % 2, 1.0, -1.0)
    rows = [
        replace(residuals.run.impacts[0], vt_out=own, vn_out=0.0 * own, turn_deg=turn)
        for own, turn in ((speed[::2], turn_deg[::2]), (speed[1::2], turn_deg[1::2]))
    ]
    run = replace(residuals.run, impacts=tuple(rows))
    at = np.array([4.0, 8.0, 16.0])
    np.testing.assert_allclose(run.turn_after(at), 80.0 / at, rtol=0.04)
    # Beyond all simulated speeds those of the nearest count.
    assert run.turn_after(np.array([99.0])) == pytest.approx(4.1, abs=0.2)
    assert replace(run, impacts=()).turn_after(at).tolist() == [0.0, 0.0, 0.0]


def test_errors_of_positions_are_those_that_paths_show() -> None:
    stated = with_metadata(observed(40, 3), position_error_m=0.08)
    name = "first point of the path against the stated start"
    found = by_name(stated, table_of(stated))
    assert found[name].observable and found[name].z < 2.0


def test_offsets_that_grow_that_stay_and_that_only_stops_have(
    case: Case, residuals: ResidualTable
) -> None:
    side = np.random.default_rng(8).choice([-1.0, 1.0], case.n_rocks)
    # Rocks that stop 10 m below the last station.
    near = np.where(
        residuals.steps.step == "stop", case.station_s[residuals.steps.rock, -1] + 10.0, np.nan
    )
    steps = replace(residuals.steps, way_m=near)
    residuals = replace(residuals, steps=steps)
    # The walk of a rock, m: 12 m more at each station, a third of the way, where edges of blocks
    # make half of that; the same everywhere; none but at the stop.
    walk = np.where(steps.step == "stop", 60.0, 12.0 * (steps.station + 1.0)) * side[steps.rock]
    start = 6.0 * side[steps.rock]
    aside = np.where(steps.step == "stop", 6.0 * side[steps.rock], 0.0)
    for added, cause in (
        (walk, "lateral_deflection"), (start, "release_error"), (aside, "measurement_error")
    ):  # fmt: skip
        off = changed(changed(residuals, "run", "lateral_m", added), "stop", "lateral_m", added)
        assert sure(case, off) == {cause}


def test_first_contacts_up_or_down_the_slope_are_errors_of_the_release(
    case: Case, residuals: ResidualTable
) -> None:
    name = "first contact up or down the slope from where the model has it"
    some = np.isin(residuals.steps.rock, np.arange(0, case.n_rocks, 5))

    def z(shift_m: float, only: np.ndarray | bool = True) -> float:
        off = changed(
            residuals, "start", "chainage_m", np.full(len(residuals.steps), shift_m) * only
        )
        return by_name(case, off)[name].z

    assert z(0.0) < 0.0 and z(1.0) < 2.0
    assert z(20.0) > 4.0 and z(-20.0) > 4.0
    # Films of a fifth of the rocks begin late.
    assert z(20.0, some) < 0.0


def test_contacts_above_the_stated_start_are_errors_of_the_release(
    case: Case, residuals: ResidualTable
) -> None:
    name = "contact above the stated start"

    def z(lower_m: float) -> float:
        rocks = case.observations.rocks
        z = heights_at(case.grid, rocks.x, rocks.y) - lower_m
        seen = replace(case.observations, rocks=replace(rocks, z=z))
        return by_name(replace(case, observations=seen), residuals)[name].z

    assert z(0.0) < 0.0
    assert z(40.0) > 4.0


def test_offsets_at_any_station_are_seen(case: Case, residuals: ResidualTable) -> None:
    name = "growth of the lateral offset below the first station"
    steps = residuals.steps
    for station in range(1, len(case.station_names)):
        far = 250.0 * (steps.station == station)
        off = changed(residuals, "run", "lateral_m", far)
        assert by_name(case, off)[name].z > 4.0
