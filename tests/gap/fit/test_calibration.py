"""Calibration on campaigns of the engine itself: the truth is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.simulated_slope import TABLE, observed, table_with, with_observed

from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.gap.fit.class_calibration import (
    SiteCalibration,
    calibration_task,
    final_prediction,
    result_of,
    run_site,
    run_trial,
    search,
)
from sassgis.gap.fit.distances import energy_scores
from sassgis.gap.fit.parameters import learned_contacts
from sassgis.gap.fit.site_data import (
    Scale,
    SiteData,
    impact_scores,
    model_rows,
    prediction,
    scores_of,
    simulated_outcomes,
    site_data_of,
)
from sassgis.gap.forward.observation_operator import campaigns
from sassgis.gap.forward.released_rocks import MeasurementError, configured_model
from sassgis.gap.observations.case import classes_met, observed_campaign
from sassgis.grid import FloatArray
from sassgis.inputs.ground_map import read_ranges
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundTable

#: What the rocks of the tests were released with; configured is the table of the helper.
TRUTH = {"eta_max": 0.45, "mu_0": 0.3}


def site(
    n: int,
    seed: int,
    table: GroundTable,
    name: str = "one",
    tables: tuple[str, ...] = ("passages", "deposits"),
) -> SiteData:
    return site_data_of(observed(n, seed, table=table, tables=tables), 1, name=name, sideways=False)


def calibrated(
    sites: list[SiteData],
    classes: tuple[str, ...],
    names: tuple[str, ...],
    draws: int = 16,
) -> SiteCalibration:
    task = calibration_task(sites, classes, names, read_ranges(TABLE), seed=1)
    found = search(
        task,
        lambda new: [run_trial(task, one) for one in new],
        lambda due: [run_site(task, one) for one in due],
        draws,
    )
    return result_of(task, found, lambda finals: [final_prediction(task, f) for f in finals])


@cache
def recovered() -> SiteCalibration:
    return calibrated(
        [site(40, 11, table_with("debris", **TRUTH))], ("debris",), ("eta_max", "mu_0")
    )


@pytest.mark.battery
def test_intervals_hold_the_parameters_that_the_rocks_were_released_with() -> None:
    found = recovered()
    for f in found.fitted:
        assert f.low <= TRUTH[f.parameter.name] <= f.high, f.parameter.label
        assert f.low <= f.value <= f.high
    eta = found.fitted[0]
    assert eta.identified and eta.high - eta.low < 0.3
    assert eta.limit == "" and found.combinations >= 1


@pytest.mark.battery
def test_the_error_on_rocks_left_out_is_that_of_rocks_never_seen() -> None:
    found = recovered()
    new = site(80, 12, table_with("debris", **TRUTH))
    made = prediction(new, configured_model(new.case, found.table(TABLE)), 7, 40).replicas
    for e, name in zip(found.sites[0].errors, found.sites[0].observed, strict=True):
        if e.name != "run-out":
            continue
        scores = energy_scores(new.quantities[name][:, None], made[name][:, :, None])
        assert e.crps["left out"] == pytest.approx(np.nanmean(scores), rel=0.3)
        assert e.crps["left out"] >= 0.95 * e.crps["after"]
        assert e.crps["left out"] < e.crps["before"]
        break
    else:
        pytest.fail("no run-out was compared")


@pytest.mark.battery
def test_ground_that_is_wrong_is_left_and_ground_that_is_right_stays() -> None:
    wrong = recovered()
    assert wrong.recommended and wrong.gain.low > 0.0
    assert wrong.recommendation.startswith("Run the fitted classes")
    right = calibrated([site(40, 11, TABLE)], ("debris",), ("eta_max", "mu_0"))
    assert not right.recommended and right.gain.low < 0.0
    assert right.recommendation.startswith("Keep the configured ground")
    assert [f.kind for f in right.findings] == ["gain"]
    # Both tables are in, and the score is their sum.
    assert {t.table: t.rocks for t in right.sites[0].scores} == {"deposits": 40, "passages": 40}


def test_more_stations_and_more_impacts_weigh_no_more() -> None:
    """The same stations twice, and each impact ten times, leave the score of a rock as it is."""
    seen = site(12, 22, TABLE, tables=("passages", "deposits"))
    model = configured_model(seen.case)
    rows = model_rows(seen, model, 3, 4)
    k = len(seen.scale.names)
    passages = np.array([name.startswith("S") for name in seen.scale.names])
    twice = np.r_[np.arange(k), np.flatnonzero(passages)]
    scale = Scale(tuple(seen.scale.names[i] for i in twice), *np.ones((2, twice.size)), 12)
    both = np.r_[twice, twice + k]
    doubled = replace(seen, scale=scale, rows=seen.rows[:, both], unseen=seen.unseen[:, both])
    once = scores_of(seen, model, 3, rows)
    np.testing.assert_allclose(scores_of(doubled, model, 3, rows[..., both]), once)

    # An offset that is not scored is as if it had not been measured.
    with_offset = replace(scale, names=(*seen.scale.names, *["S0:aside"] * int(passages.sum())))
    unscored = replace(doubled, scale=with_offset, sideways=False)
    astray = rows[..., both].copy()
    astray[..., k : twice.size] += 9.0
    np.testing.assert_allclose(scores_of(unscored, model, 3, astray), once)

    hit = site(12, 22, TABLE, tables=("impacts",))
    assert hit.impacts is not None
    many = np.repeat(np.arange(len(hit.outcomes)), 10)
    times = replace(hit.impacts, rock=hit.impacts.rock[many])
    made = np.random.default_rng(1).normal(0.4, 0.2, (len(hit.outcomes), 8, 3))
    assert impact_scores(times, hit.outcomes[many], made[many], 12) == pytest.approx(
        impact_scores(hit.impacts, hit.outcomes, made, 12), rel=0.02
    )


@pytest.mark.battery
def test_a_class_that_no_rock_reaches_is_not_identified() -> None:
    # Stations end on debris; of the meadow below nothing is seen.
    only = site(25, 13, table_with("debris", **TRUTH), tables=("passages",))
    assert "meadow" in classes_met(only.case)
    found = calibrated([only], ("meadow",), ("eta_max", "mu_0"))
    assert not any(f.identified for f in found.fitted)
    assert found.combinations == 0
    # It keeps what was configured.
    assert found.fitted[0].value == pytest.approx(0.45, abs=0.05)


@pytest.mark.battery
def test_classes_that_the_stops_do_not_tell_apart_are_named() -> None:
    found = calibrated(
        [site(25, 34, TABLE, tables=("deposits",))], ("debris", "talus"), ("eta_max", "mu_0")
    )
    assert found.alike == (("debris", "talus"),)


@pytest.mark.battery
def test_sites_of_one_ground_agree_and_of_different_ground_do_not() -> None:
    one = site(30, 15, table_with("debris", eta_max=0.75))
    same = site(30, 16, table_with("debris", eta_max=0.75), "other")
    other = site(30, 17, table_with("debris", eta_max=0.25), "other")
    agree = calibrated([one, same], ("debris",), ("eta_max",))
    assert not agree.contradict
    assert agree.fitted[0].low <= 0.75 <= agree.fitted[0].high
    differ = calibrated([one, other], ("debris",), ("eta_max",))
    assert differ.contradict
    # Own values are a linear step from the common one, which falls short of so much.
    (one_value, other_value), common = (
        [s.own["debris.eta_max"] for s in differ.sites],
        differ.fitted[0].value,
    )
    assert 0.25 <= other_value < common < one_value <= 0.8


@pytest.mark.battery
def test_impacts_identify_what_stops_do_not() -> None:
    seen = site(30, 18, table_with("debris", eta_max=0.5), tables=("impacts",))
    assert seen.impacts is not None and not seen.scale.names
    found = calibrated([seen], ("debris",), ("eta_max", "mu_0"))
    eta, mu_0 = found.fitted
    assert eta.low <= 0.5 <= eta.high and eta.identified
    assert not mu_0.identified and mu_0.narrowed > 0.8


def test_contacts_speak_for_the_effect_that_acts_in_them() -> None:
    """Of rocks on soft ground, by their impacts alone."""
    soft = EffectSettings(SoftGround(classes=(), form="velocity_scaled", reference_speed_mps=3.0))
    seen = site_data_of(observed(30, 21, effects=soft, tables=("impacts",)), 1)
    without = configured_model(seen.case)
    total = [
        scores_of(seen, model, 5, model_rows(seen, model, 5, 4)).sum()
        for model in (without, replace(without, effects=soft))
    ]
    assert total[1] < 0.8 * total[0]


def test_a_factor_of_the_spins_is_taken_off_before_the_impact_and_put_on_after() -> None:
    seen = site(12, 22, TABLE, tables=("impacts",))
    assert seen.impacts is not None
    model = configured_model(seen.case)

    def outcomes(factor: float, turns: float) -> FloatArray:
        assert seen.impacts is not None
        spins = replace(seen.impacts, spin=factor * seen.impacts.spin)
        scaled = replace(model, measurement=MeasurementError(spin_scale=turns))
        return simulated_outcomes(seen.case, scaled, spins, seed=3, number=2)

    np.testing.assert_allclose(
        outcomes(0.8, 0.8), outcomes(1.0, 1.0) * np.array([1.0, 1.0, 0.8]), rtol=1e-9
    )


def test_contacts_teach_their_law_and_how_spins_scatter() -> None:
    truth = table_with("rock", restitution=0.4)
    case = observed(12, 22, table=truth, tables=("impacts",), readings="hazard")
    hit = case.observations.impacts
    after = np.random.default_rng(8).normal(np.log(0.75), 0.4, len(hit))
    turning = replace(
        hit,
        omega_in_radps=0.75 * hit.omega_in_radps,
        omega_out_radps=np.exp(after) * hit.omega_out_radps,
    )
    plain, scattered = (
        learned_contacts(one, 1) for one in (case, with_observed(case, impacts=turning))
    )
    assert plain is not None and scattered is not None
    assert plain.spin_noise <= 0.15 and 0.3 <= scattered.spin_noise <= 0.5
    assert 0.9 < plain.spin_scale < 1.1 and 0.65 < scattered.spin_scale < 0.9
    for learned in (plain, scattered):
        rock, *others = (own.restitution for own in learned.table.classes)
        assert rock > 0.15 > max(others)
    without = observed(12, 22, table=truth, tables=("deposits",), readings="hazard")
    assert learned_contacts(without, 1) is None


def test_rotations_that_scatter_scatter_at_stations_alone() -> None:
    seen = site(12, 22, TABLE, tables=("impacts", "passages"))
    models = [
        replace(configured_model(seen.case), measurement=MeasurementError(rotation_noise=noise))
        for noise in (0.0, 0.5)
    ]
    assert seen.impacts is not None
    plain, wide = (
        simulated_outcomes(seen.case, own, seen.impacts, seed=3, number=2) for own in models
    )
    np.testing.assert_array_equal(plain, wide)
    made = [campaigns(seen.case, seen.rock_lines, own, count=8, seed=2) for own in models]
    turns, speeds = (
        [np.concatenate([getattr(one.passages, name) for one in own]) for own in made]
        for name in ("rotation_hz", "speed_mps")
    )
    assert np.std(speeds[1]) < 1.05 * np.std(speeds[0])
    assert np.std(turns[1]) > 1.2 * np.std(turns[0])


def test_what_was_not_measured_of_a_rock_that_passed_is_not_a_rock_that_stopped() -> None:
    """Half of the rows of passages and stops have no numbers."""
    case = observed(30, 11)
    passed, lies = case.observations.passages, case.observations.deposits
    none = np.full(len(passed), np.nan)
    none[::2] = 1.0
    lost = np.full(len(lies), np.nan)
    lost[::2] = 1.0
    blank = replace(
        passed, speed_mps=passed.speed_mps * none, rotation_hz=passed.rotation_hz * none,
        height_m=passed.height_m * none,
    )  # fmt: skip
    put = case.projected["deposits"]
    case = replace(
        with_observed(case, passages=blank, deposits=lies),
        projected=case.projected | {"deposits": replace(put, s=put.s * lost)},
    )
    problem = site_data_of(case, 1)
    rows = model_rows(problem, configured_model(case), 3, 8)
    k = len(problem.scale.names)
    absent = problem.rows[:, k:].mean(axis=0) - rows[..., k:].mean(axis=(0, 1))
    assert np.abs(absent).max() < 0.1


def test_a_station_beside_the_line_of_a_rock_has_no_place_on_it() -> None:
    case = observed(12, 11)
    s = case.stations.copy()
    s[0, :2] = np.nan
    case = replace(case, stations=s)
    assert case.station_names == ("S1", "S2", "S3", "S4")
    # Stations are in the order of the median chainage, those that no line crosses left out.
    other = replace(case, stations=np.where(np.arange(4) == 1, np.nan, s[:, ::-1]))
    assert other.station_order.tolist() == [3, 2, 0]
    rows = observed_campaign(case).passages
    assert rows is not None
    beside = np.isin(rows.rock, np.flatnonzero(case.line == 0))
    assert (rows.station[beside] >= 2).all() and beside.any()
    # What lies below such stations lies on the reaches below them.
    below = case.stations[0, 2] + np.array([-1.0, 1.0])
    assert case.reach_of(np.zeros(2, np.int64), below).tolist() == [0, 3]


def test_rocks_of_a_given_mass_meet_the_ground_with_their_own_size() -> None:
    case = observed(12, 11)
    blocks = [
        replace(b, axis_1_m=(1.2, 1.2), axis_2_m=(1.0, 1.0), axis_3_m=(0.8, 0.8),
                volume_m3=(v, v), volume_exponent=0.0)
        for b, v in zip(case.blocks, 4.0 / 3.0 * np.pi * case.radius_m**3, strict=True)
    ]  # fmt: skip
    own = replace(case, blocks=tuple(blocks)).semi_axes_m
    assert np.cbrt(own.prod(axis=1)) == pytest.approx(case.radius_m)
    assert own[:, 0] / own[:, 2] == pytest.approx(1.5)


def test_without_stops_passages_and_impacts_there_is_nothing_to_score() -> None:
    assert not site(10, 19, TABLE, tables=("trajectories",)).scored
