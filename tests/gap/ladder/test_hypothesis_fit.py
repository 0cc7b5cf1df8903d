"""Calibration of hypotheses, with and without the rocks to be left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import TABLE, observed

from sassgis.gap.calibration.problem import CalibrationProblem, problem_of
from sassgis.gap.inference.folds import folds_of
from sassgis.gap.ladder.handover import classes_at_limit
from sassgis.gap.ladder.hypothesis_fit import FittedHypothesis, space_of
from sassgis.gap.which.hypotheses import NONE
from sassgis.model.ground import GroundTable
from sassgis.runs.hypothesis_fits import HypothesisFits, Keeping


def fitted(problem: CalibrationProblem, effect: str, draws: int = 32) -> FittedHypothesis:
    keeping = Keeping(None, "", lambda _text: None)
    made = HypothesisFits(
        problem, lambda f, tasks: (f(problem, t) for t in tasks), draws, None, keeping
    )
    made.add(effect)
    return made.fits[effect]


@pytest.fixture(scope="module")
def base(problem: CalibrationProblem) -> FittedHypothesis:
    return fitted(problem, NONE)


def test_every_rock_is_scored_by_the_model_it_has_no_weight_in(
    problem: CalibrationProblem, base: FittedHypothesis
) -> None:
    assert len(base.models) == problem.n_parts + 1
    rows, scores = base.held_out_rows(problem.part), base.held_out_scores(problem.part)
    for part in range(problem.n_parts):
        own = problem.part == part
        np.testing.assert_array_equal(rows[:, own], base.models[part].rows[:, own])
        np.testing.assert_array_equal(scores[own], base.models[part].scores[own])
    assert base.found is not None
    # Whatever the rocks of a part did: their emulated scores are of no account.
    (emulator,) = base.found.surface.emulators
    weights = emulator.weights.copy()
    weights[:, problem.unit_parts() == 2] *= -3.0
    changed = replace(base.found.surface, emulators=(replace(emulator, weights=weights),))
    other = replace(base.found, surface=changed)
    for part, same in ((2, True), (1, False)):
        one, two = (found.without([problem], part) for found in (base.found, other))
        assert np.allclose(one, two, atol=1e-6) == same


def test_a_model_that_is_handed_over_gives_its_campaigns_again(
    problem: CalibrationProblem, base: FittedHypothesis
) -> None:
    again = base.samples(problem.case, 3)
    assert len(again) == 3 and {d.effect for d in again} == {NONE}
    assert base.handed_over.draw.model.table != again[1].model.table


def test_calibration_betters_the_score_of_a_wrong_ground() -> None:
    """Rocks of a rougher debris: the base comes nearer to it than what is configured."""
    table = GroundTable(
        tuple(
            replace(c, eta_max=c.eta_max - 0.05) if c.name == "debris" else c for c in TABLE.classes
        )
    )
    other = problem_of(observed(25, 8, table=table), 5)
    found = fitted(other, NONE)
    space = space_of(other.case, NONE)
    middle = found.models[-1]
    labels = [p.label for p in space.parameters]
    assert "debris.eta_max" in labels and found.found is not None
    own = found.found.fitted[labels.index("debris.eta_max")]
    assert own.identified and own.low <= 0.5 - 0.05 / 0.18 <= own.high
    assert np.isfinite(middle.scores).all()
    # It runs towards the limit of the usual range.
    assert own.share < 0.5


def test_groups_stay_together_and_parts_are_even() -> None:
    group = np.array([0, 0, 0, 0, 1, 1, 2, 2, 3, 4, 5, 6])
    part = folds_of(12, 3, group)
    assert all(np.unique(part[group == g]).size == 1 for g in range(7))
    assert sorted(np.bincount(part).tolist()) == [2, 2, 2, 2, 4]
    assert np.bincount(folds_of(12, 3, np.array([7] * 5 + [2] * 7))).tolist() in ([5, 7], [7, 5])
    # One group is none.
    np.testing.assert_array_equal(folds_of(12, 3, np.zeros(12, np.int64)), folds_of(12, 3))
    np.testing.assert_array_equal(np.bincount(folds_of(12, 3)), [3, 3, 2, 2, 2])


def test_scores_of_a_group_count_as_one(problem: CalibrationProblem) -> None:
    group = replace(problem, unit=np.arange(problem.n_rocks) // 4)
    scores = np.arange(2.0 * problem.n_rocks).reshape(2, -1)
    np.testing.assert_array_equal(group.per_unit(scores), scores.reshape(2, -1, 4).sum(axis=2))


def test_a_class_far_from_its_configured_values_is_at_the_limit() -> None:
    """Rocks of ground whose η_max lies beyond the usual range."""
    table = GroundTable(tuple(replace(c, eta_max=c.eta_max - 0.2) for c in TABLE.classes))
    other = problem_of(observed(25, 9, table=table), 5)
    found = fitted(other, NONE, 24)
    assert classes_at_limit(other.case, found) != []
    assert classes_at_limit(other.case, replace(found, found=None)) == []


def test_nothing_scored_leaves_the_middle_of_the_ranges() -> None:
    alone = problem_of(observed(12, 1, tables=("trajectories",)), 1)
    assert not alone.scored
    found = fitted(alone, NONE)
    assert found.found is None and found.trade_offs == ()
    before = {c.name: c for c in alone.case.table.classes}
    after = {c.name: c for c in found.handed_over.draw.model.table.classes}
    assert {n: round(c.eta_max, 5) for n, c in before.items()} == {
        n: round(c.eta_max, 5) for n, c in after.items()
    }
