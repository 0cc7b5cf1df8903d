"""Calibration of hypotheses, with and without the rocks to be left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import TABLE, observed, table_with

from sassgis.gap.advice.recommendation import wrong_ground
from sassgis.gap.fit.distances import folds_of
from sassgis.gap.fit.hypothesis_fit import NONE, FittedHypothesis, HypothesisFits
from sassgis.gap.fit.linear_fit import summary_of
from sassgis.gap.fit.site_data import SiteData, site_data_of


def fitted(problem: SiteData, effect: str, draws: int = 32) -> FittedHypothesis:
    summary = summary_of(problem)
    made = HypothesisFits(summary, lambda f, tasks: (f(summary, t) for t in tasks), draws)
    return made.add(effect)


@pytest.fixture(scope="module")
def base(problem: SiteData) -> FittedHypothesis:
    return fitted(problem, NONE, 8)


@pytest.mark.battery
def test_every_rock_is_scored_by_the_model_it_has_no_weight_in(
    problem: SiteData, base: FittedHypothesis
) -> None:
    assert len(base.models) == problem.n_parts + 1
    rows, scores = base.held_out_rows(problem.part), base.held_out_scores(problem.part)
    for part in range(problem.n_parts):
        own = problem.part == part
        np.testing.assert_array_equal(rows[:, own], base.models[part].rows[:, own])
        np.testing.assert_array_equal(scores[own], base.models[part].scores[own])
    assert base.found is not None
    # Whatever the rocks of a part did, they are not in the numbers of the others.
    whole = summary_of(problem)
    changed = problem.rows.copy()
    changed[problem.part == 2] += 3.0
    other = replace(whole, problem=replace(problem, rows=changed))
    for part, same in ((2, True), (1, False)):
        weights = (problem.part != part).astype(float)
        one, two = (np.nan_to_num(own.of_rocks(weights)) for own in (whole, other))
        assert np.allclose(one, two) == same


def test_a_model_that_is_handed_over_gives_its_campaigns_again(
    problem: SiteData, base: FittedHypothesis
) -> None:
    again = base.samples(problem.case, 3)
    assert len(again) == 3 and {d.form for d in again} == {"calibrated ground"}
    assert base.handed_over.draw.model.table != again[1].model.table


@pytest.mark.battery
def test_calibration_betters_the_score_of_a_wrong_ground() -> None:
    """Rocks of a rougher debris: the base comes nearer to it than what is configured."""
    before = {c.name: c for c in TABLE.classes}["debris"].eta_max
    other = site_data_of(observed(25, 8, table=table_with("debris", eta_max=before - 0.05)), 5)
    found = fitted(other, NONE)
    assert "debris.eta_max" in found.identified
    low, high = found.intervals(other.case)["debris.eta_max"]
    # 25 rocks: what is configured lies at the end of the interval, and not nearer than the half.
    assert low <= before - 0.05 <= high < before + 0.005
    assert found.handed_over.draw.parameters["debris.eta_max"] < before - 0.025
    assert np.isfinite(found.handed_over.scores).all()


def test_groups_stay_together_and_parts_are_even() -> None:
    group = np.array([0, 0, 0, 0, 1, 1, 2, 2, 3, 4, 5, 6])
    part = folds_of(group, 3)
    assert all(np.unique(part[group == g]).size == 1 for g in range(7))
    assert sorted(np.bincount(part).tolist()) == [2, 2, 2, 2, 4]
    assert np.bincount(folds_of(np.array([7] * 5 + [2] * 7), 3)).tolist() in ([5, 7], [7, 5])
    # One group is none.
    alone = folds_of(np.arange(12), 3)
    np.testing.assert_array_equal(folds_of(np.zeros(12, np.int64), 3), alone)
    np.testing.assert_array_equal(np.bincount(alone), [3, 3, 2, 2, 2])


def test_scores_of_a_group_count_as_one(problem: SiteData) -> None:
    group = replace(problem, unit=np.arange(problem.n_rocks) // 4)
    scores = np.arange(2.0 * problem.n_rocks).reshape(2, -1)
    np.testing.assert_array_equal(group.per_unit(scores), scores.reshape(2, -1, 4).sum(axis=2))


def test_a_class_that_certainly_lies_outside_its_usual_range_is_wrong(
    problem: SiteData,
) -> None:
    case = replace(problem.case, met=frozenset({"debris"}))
    usual = {c.name: c for c in TABLE.classes}["debris"].eta_max
    outside, within = (usual - 0.3, usual - 0.1), (usual - 0.3, usual - 0.05)
    assert wrong_ground(case, {"debris.eta_max": outside}) == ("debris",)
    assert wrong_ground(case, {"debris.eta_max": within, "shift_of_mu_0": outside}) == ()
    # Wider where the configured classes are guesses; nothing is said of what no rock meets.
    assert wrong_ground(replace(case, ground_range=3.0), {"debris.eta_max": outside}) == ()
    assert wrong_ground(case, {"meadow.eta_max": (0.0, 0.01)}) == ()


def test_nothing_scored_leaves_the_middle_of_the_ranges() -> None:
    alone = site_data_of(observed(12, 1, tables=("trajectories",)), 1)
    assert not alone.scored
    found = fitted(alone, NONE)
    assert found.found is None and found.trade_offs == ()
    before = {c.name: c for c in alone.case.table.classes}
    after = {c.name: c for c in found.handed_over.draw.model.table.classes}
    assert {n: round(c.eta_max, 5) for n, c in before.items()} == {
        n: round(c.eta_max, 5) for n, c in after.items()
    }
