"""Calibration of an effect, and how far the gap shrinks."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.simulated_slope import ORDER, observed

from sassgis.gap.inference import distances as scores
from sassgis.gap.inference.folds import folds_of
from sassgis.gap.ladder.calibration import distances, refine, run_refined, shrinkage_of
from sassgis.gap.which.ensemble import (
    CalibrationProblem,
    Ensemble,
    Tried,
    ensemble_of,
    problem_of,
    rock_scores,
    tasks_of,
    try_task,
)
from sassgis.gap.which.hypotheses import NONE


@pytest.fixture(scope="module")
def ensemble(problem: CalibrationProblem, made: list[Tried]) -> Ensemble:
    tasks = tasks_of(("lateral_deflection", "air_drag", "fragmentation"), 10)
    return ensemble_of(
        problem,
        [*made, *(try_task(problem, task, ORDER) for task in tasks)],
    )


def test_scores_are_those_of_the_room_of_scores() -> None:
    rng = np.random.default_rng(5)
    seen, replicas = rng.normal(size=(12, 4)), rng.normal(size=(5, 12, 4))
    ensembles = replicas.transpose(1, 0, 2)
    expected = scores.energy_scores(ensembles, seen, scale=np.ones(4))
    np.testing.assert_allclose(rock_scores(seen, replicas), expected, rtol=1e-12)
    found = distances(seen, replicas, replicas + 1.0)
    pool = replicas.reshape(-1, 4)
    expected_distance = scores.energy_distance(seen, pool, scale=np.ones(4), unbiased=True)
    assert found.base == pytest.approx(expected_distance, abs=1e-12)
    assert found.effect > found.base


def test_shrinkage_is_one_where_the_effect_explains_all_and_withheld_without_a_gap() -> None:
    rng = np.random.default_rng(6)
    seen = rng.normal(size=(200, 3))
    far, near = rng.normal(2.0, 1.0, size=(8, 200, 3)), rng.normal(size=(8, 200, 3))
    assert distances(seen, far, near).shrinkage == pytest.approx(1.0, abs=0.05)
    assert distances(seen, near, near).shrinkage is None


def test_refinement_betters_the_score(problem: CalibrationProblem, ensemble: Ensemble) -> None:
    before = ensemble.scores[ensemble.of(NONE)].mean(axis=1).min()
    refined = refine(
        problem, ensemble, (NONE,), lambda tasks: [run_refined(problem, t) for t in tasks],
        repetitions=2, draws=8,
    )  # fmt: skip
    best = refined.scores[refined.of(NONE)].mean(axis=1)
    assert best.min() <= before
    assert len(refined.of(NONE)) == len(ensemble.of(NONE)) + 16


def test_without_a_gap_no_shrinkage_is_stated(
    problem: CalibrationProblem, ensemble: Ensemble
) -> None:
    part = folds_of(problem.case.n_rocks, 1)
    assert np.bincount(part).min() >= problem.case.n_rocks // 5
    found = shrinkage_of(problem, ensemble, NONE, part, draws=0, seed=1)
    assert found.value is None and found.note


def test_impacts_alone_can_be_told_apart_but_not_scored() -> None:
    alone = problem_of(observed(12, 1, tables=("impacts",)), 1)
    base = [try_task(alone, task, ORDER) for task in tasks_of([NONE], 8)]
    tried = [try_task(alone, task, ORDER) for task in tasks_of(("air_drag",), 3)]
    ensemble = ensemble_of(alone, [*base, *tried])
    assert ensemble.scores.shape == (11, 12)
    found = shrinkage_of(alone, ensemble, "air_drag", folds_of(12, 1), draws=5, seed=1)
    assert found.value is None and "no distance" in found.note
