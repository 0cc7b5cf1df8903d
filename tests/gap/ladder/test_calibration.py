"""Calibration of hypotheses, with and without the rocks to be left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import ORDER

from sassgis.gap.inference import distances as scores
from sassgis.gap.inference.folds import folds_of
from sassgis.gap.ladder.calibration import (
    FRESH,
    FitTask,
    FittedEffect,
    best_draws,
    fitted,
    refine,
    run_task,
)
from sassgis.gap.ladder.handover import classes_at_limit
from sassgis.gap.ladder.parameter_posterior import parameter_posterior
from sassgis.gap.which.ensemble import (
    BLIND,
    CalibrationProblem,
    Ensemble,
    Tried,
    ensemble_of,
    model_rows,
    rock_scores,
    tasks_of,
    try_task,
)
from sassgis.gap.which.hypotheses import NONE


@pytest.fixture(scope="module")
def ensemble(problem: CalibrationProblem, made: list[Tried]) -> Ensemble:
    tried = [try_task(problem, task, ORDER) for task in tasks_of(("lateral_deflection",), 10)]
    return ensemble_of(problem, [*made, *tried])


@pytest.fixture(scope="module")
def refined(problem: CalibrationProblem, ensemble: Ensemble) -> Ensemble:
    return refine(problem, ensemble, (NONE,), runner(problem), repetitions=2, draws=8)


def runner(problem: CalibrationProblem):  # type: ignore[no-untyped-def]
    return lambda tasks: [run_task(problem, t) for t in tasks]


def test_scores_are_those_of_the_room_of_scores() -> None:
    rng = np.random.default_rng(5)
    seen, replicas = rng.normal(size=(12, 4)), rng.normal(size=(5, 12, 4))
    expected = scores.energy_scores(replicas.transpose(1, 0, 2), seen, scale=np.ones(4))
    np.testing.assert_allclose(rock_scores(seen, replicas), expected, rtol=1e-12)


def test_refinement_betters_the_score_of_every_fit(
    problem: CalibrationProblem, ensemble: Ensemble, refined: Ensemble
) -> None:
    fits = problem.n_parts + 1
    assert len(refined.of(NONE)) == len(ensemble.of(NONE)) + 2 * 8 * fits
    for fit in range(fits):
        rocks = problem.rocks_of(fit)
        before = ensemble.scores[np.ix_(ensemble.of(NONE), rocks)].mean(axis=1).min()
        own = best_draws(refined, NONE, rocks, fit)
        assert set(refined.fit[own].tolist()) <= {BLIND, fit}
        assert refined.scores[np.ix_(own, rocks)].mean(axis=1).min() <= before


def test_rocks_that_are_left_out_have_no_say(
    problem: CalibrationProblem, ensemble: Ensemble
) -> None:
    """Whatever these rocks did, the draws of their fit and its model are the same."""

    def drawn(own: CalibrationProblem) -> tuple[list[FitTask], FittedEffect]:
        tasks: list[FitTask] = []

        def run(asked: Sequence[FitTask]) -> list[Tried]:
            tasks.extend(asked)
            return [run_task(own, t) for t in asked]

        made = refine(own, ensemble_of(own, ensemble.tried), (NONE,), run, repetitions=1, draws=6)
        return tasks, fitted(own, made, (NONE,), run)[NONE]

    rows = problem.rows.copy()
    rows[problem.part == 2] += 3.0
    (tasks, models), (other_tasks, others) = drawn(problem), drawn(replace(problem, rows=rows))
    for fit in range(problem.n_parts + 1):
        same = [t for t in tasks if t.fit == fit] == [t for t in other_tasks if t.fit == fit]
        assert same == (fit == 2)
    assert models.models[2].draw == others.models[2].draw
    assert models.handed_over.draw != others.handed_over.draw
    held_out = models.held_out_rows(problem.part)
    for fit in range(problem.n_parts):
        own = problem.part == fit
        np.testing.assert_array_equal(held_out[:, own], models.models[fit].rows[:, own])


def test_a_chosen_model_gives_its_campaigns_again(
    problem: CalibrationProblem, refined: Ensemble
) -> None:
    own = fitted(problem, refined, (NONE,), runner(problem))[NONE]
    assert len(own.models) == problem.n_parts + 1
    last = own.handed_over
    again = model_rows(problem, last.draw.model, last.number, FRESH)
    np.testing.assert_array_equal(again, last.rows)


def test_groups_stay_together_and_parts_are_even() -> None:
    group = np.array([0, 0, 0, 0, 1, 1, 2, 2, 3, 4, 5, 6])
    part = folds_of(12, 3, group)
    assert all(np.unique(part[group == g]).size == 1 for g in range(7))
    assert sorted(np.bincount(part).tolist()) == [2, 2, 2, 2, 4]
    assert np.bincount(folds_of(12, 3, np.array([7] * 5 + [2] * 7))).tolist() in ([5, 7], [7, 5])
    # One group is none.
    np.testing.assert_array_equal(folds_of(12, 3, np.zeros(12, np.int64)), folds_of(12, 3))
    np.testing.assert_array_equal(np.bincount(folds_of(12, 3)), [3, 3, 2, 2, 2])


def test_a_class_far_from_its_configured_values_is_at_the_limit(
    problem: CalibrationProblem, made: list[Tried]
) -> None:
    """Rocks of draws at the upper end of μ_0 of the meadow, calibrated as if they were observed."""
    assert classes_at_limit(problem.case, None) == []
    name = "meadow.mu_0"
    ends = sorted(made, key=lambda t: t.draw.parameter_draws[name])
    far = {**ends[-1].draw.parameter_draws, name: 0.999}
    rows = run_task(problem, FitTask(NONE, far, 3800, BLIND, 2)).rows[0].astype(np.float64)
    other = replace(problem, rows=rows)
    first = ensemble_of(other, made)
    other_made = refine(other, first, (NONE,), runner(other), repetitions=3, draws=12)
    left = parameter_posterior(other, other_made, NONE, other.n_parts)
    assert left is not None
    own = next(f for f in left.fitted if f.parameter.label == name)
    assert own.share > 0.7
