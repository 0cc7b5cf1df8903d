"""Calibration on campaigns of the engine itself: the truth is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.simulated_slope import TABLE, observed
from threadpoolctl import threadpool_limits

from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.gap.calibration.class_calibration import (
    SiteCalibration,
    calibration_task,
    final_replicas,
    result_of,
    score_draw,
    search,
)
from sassgis.gap.calibration.parameters import classes_met
from sassgis.gap.calibration.problem import (
    CalibrationProblem,
    compared_replicas,
    problem_of,
    scores_of,
)
from sassgis.gap.inference.distances import energy_scores
from sassgis.gap.replicas.hypothesis_model import configured_model
from sassgis.model.effects import EffectSettings
from sassgis.model.ground import GroundTable


@pytest.fixture(autouse=True, scope="module")
def _one_thread() -> Iterator[None]:
    with threadpool_limits(1, "blas"):
        yield


#: What the rocks of the tests were released with; configured is the table of the helper.
TRUTH = {"eta_max": 0.45, "mu_0": 0.3}


def table_of(**values: float) -> GroundTable:
    return GroundTable(
        tuple(
            dataclasses.replace(c, **values) if c.name == "debris" else c  # type: ignore[arg-type]
            for c in TABLE.classes
        )
    )


def site(
    n: int, seed: int, table: GroundTable, name: str = "one", **more: object
) -> CalibrationProblem:
    tables = more.pop("tables", ("passages", "deposits"))
    return problem_of(observed(n, seed, table=table, tables=tables), 1, name=name)  # type: ignore[arg-type]


def calibrated(
    sites: list[CalibrationProblem],
    classes: tuple[str, ...],
    names: tuple[str, ...],
    draws: int = 64,
) -> SiteCalibration:
    task = calibration_task(sites, classes, names, seed=1)
    found = search(task, lambda new: [score_draw(task, one) for one in new], draws)
    return result_of(task, found, lambda finals: [final_replicas(task, f) for f in finals])


@cache
def recovered() -> SiteCalibration:
    return calibrated([site(40, 11, table_of(**TRUTH))], ("debris",), ("eta_max", "mu_0"), 48)


def test_intervals_hold_the_parameters_that_the_rocks_were_released_with() -> None:
    found = recovered()
    for f in found.fitted:
        assert f.low <= TRUTH[f.parameter.name] <= f.high, f.parameter.label
        assert f.low <= f.value <= f.high
    eta = found.fitted[0]
    assert eta.identified and eta.high - eta.low < 0.3
    assert eta.limit == "" and found.combinations >= 1


def test_the_error_on_rocks_left_out_is_that_of_rocks_never_seen() -> None:
    found = recovered()
    new = site(80, 12, table_of(**TRUTH))
    made = compared_replicas(new, configured_model(new.case, found.table(TABLE)), 7, 40)
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


def test_a_class_that_no_rock_reaches_is_not_identified() -> None:
    # Stations end on debris; of the meadow below nothing is seen.
    only = site(25, 13, table_of(**TRUTH), tables=("passages",))
    assert "meadow" in classes_met(only.case)
    found = calibrated([only], ("meadow",), ("eta_max", "mu_0"), 32)
    assert not any(f.identified for f in found.fitted)
    assert found.combinations == 0
    # It keeps what was configured.
    assert found.fitted[0].value == pytest.approx(0.45, abs=0.05)


def test_classes_that_the_stops_do_not_tell_apart_are_named() -> None:
    found = calibrated(
        [site(25, 34, TABLE, tables=("deposits",))], ("debris", "talus"), ("eta_max", "mu_0"), 64
    )
    assert found.alike == (("debris", "talus"),)


@pytest.mark.battery
def test_sites_of_one_ground_agree_and_of_different_ground_do_not() -> None:
    one = site(30, 15, table_of(eta_max=0.75))
    same = site(30, 16, table_of(eta_max=0.75), "other")
    other = site(30, 17, table_of(eta_max=0.25), "other")
    agree = calibrated([one, same], ("debris",), ("eta_max",), 32)
    assert not agree.contradict
    assert agree.fitted[0].low <= 0.75 <= agree.fitted[0].high
    differ = calibrated([one, other], ("debris",), ("eta_max",), 32)
    assert differ.contradict
    own = [s.own["debris.eta_max"] for s in differ.sites]
    assert own == pytest.approx([0.75, 0.25], abs=0.12)


def test_impacts_identify_what_stops_do_not() -> None:
    seen = site(30, 18, table_of(eta_max=0.35), tables=("impacts",))
    assert seen.impacts is not None and not seen.scale.names
    found = calibrated([seen], ("debris",), ("eta_max", "mu_0"), 32)
    eta, mu_0 = found.fitted
    assert eta.low <= 0.35 <= eta.high and eta.identified
    assert mu_0.high - mu_0.low > 5.0 * (eta.high - eta.low)


def test_contacts_speak_for_the_effect_that_acts_in_them() -> None:
    """Of rocks on soft ground, by their impacts alone."""
    soft = EffectSettings(SoftGround(classes=(), form="velocity_scaled", reference_speed_mps=3.0))
    seen = problem_of(observed(30, 21, effects=soft, tables=("impacts",)), 1)
    without = configured_model(seen.case)
    total = [
        scores_of(seen, model, 5, 4).sum() for model in (without, replace(without, effects=soft))
    ]
    assert total[1] < 0.8 * total[0]


def test_without_stops_passages_and_impacts_there_is_nothing_to_score() -> None:
    assert not site(10, 19, TABLE, tables=("trajectories",)).scored
