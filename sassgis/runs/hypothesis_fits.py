"""Hypotheses of a diagnosis, calibrated when they are asked for; finished draws are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.gap.calibration.calibrator import Budget, NumberedDraw, calibrate_on
from sassgis.gap.calibration.problem import CalibrationProblem
from sassgis.gap.ladder.handover import classes_at_limit
from sassgis.gap.ladder.hypothesis_fit import (
    COUNT,
    FittedHypothesis,
    HypothesisDraw,
    chosen_draws,
    gain_of,
    in_range,
    run_chosen,
    score_hypothesis,
    space_of,
)
from sassgis.gap.which.hypotheses import NONE, Draw
from sassgis.io.staging import CHECKPOINT_STEM
from sassgis.model.grid import FloatArray
from sassgis.runs.draw_store import DrawProgress, DrawStore, OnProgress
from sassgis.runs.workers import TaskMap

#: Draws of each hypothesis in the first design; the base has this many times as many.
DRAWS, _OF_BASE = 64, 1.5
#: Repetitions in which draws are placed where the best may lie, of a third as many draws each.
_REPETITIONS = 3
#: Factors on the range of the ground where the calibration runs into its limits.
WIDER = (2, 3)


@dataclass(frozen=True, slots=True)
class Keeping:
    """Where draws are kept that an earlier attempt with the same settings may have made.

    Attributes
    ----------
    work : Path or None
        Folder of the diagnosis; None: nothing is kept.
    fingerprint : str
        Of the settings.
    tell : callable
        Told of draws that do not fit.
    """

    work: Path | None
    fingerprint: str
    tell: Callable[[str], None]

    def store(self, effect: str, ground_range: float) -> DrawStore:
        """The draws of a hypothesis."""
        name = f"{CHECKPOINT_STEM}.{effect}.{ground_range:g}.npz"
        return DrawStore(self.work and self.work / name, self.fingerprint, self.tell)


class HypothesisFits:
    """Hypotheses that are calibrated when they are asked for."""

    def __init__(
        self,
        problem: CalibrationProblem,
        run: TaskMap,
        draws: int,
        on_progress: OnProgress | None,
        keeping: Keeping,
    ) -> None:
        self.problem = problem
        self.fits: dict[str, FittedHypothesis] = {}
        self._run, self._draws = run, draws
        self._on_progress, self._keeping = on_progress, keeping

    def add(self, *effects: str) -> None:
        """Calibrate effects that are not calibrated yet."""
        for effect in dict.fromkeys(effects):
            if effect not in self.fits:
                self.fits[effect] = self._fitted(effect)

    def _fitted(self, effect: str) -> FittedHypothesis:
        problem = self.problem
        space = space_of(problem.case, effect)
        labels = tuple(p.label for p in space.parameters)
        found = None
        if problem.scored:
            first = round(self._draws * (_OF_BASE if effect == NONE else 1.0))
            budget = Budget(first, _REPETITIONS, max(first // 3, 8))
            progress = DrawProgress(self._on_progress, budget.draws, COUNT * problem.n_rocks)
            store = self._keeping.store(effect, problem.case.ground_range)

            def new(due: Sequence[NumberedDraw]) -> Any:
                tasks = [HypothesisDraw(effect, labels, tuple(u.tolist()), n) for n, u in due]
                return self._here(score_hypothesis, tasks)

            scored = partial(store.scored, run=new, step=progress.step)
            found = calibrate_on([problem], space, scored, budget)
        models = self._here(run_chosen, chosen_draws(problem, effect, space, found))
        return FittedHypothesis(effect, labels, found, tuple(models))

    def _here(self, function: Callable[[Any, Any], Any], tasks: Sequence[Any]) -> Any:
        """Tasks with the range of the ground of this problem."""
        return self._run(partial(_in_range, self.problem.case.ground_range, function), tasks)

    def rows(self, effect: str) -> FloatArray:
        """Rows of every rock by the model it had no weight in."""
        return self.fits[effect].held_out_rows(self.problem.part)

    def scores(self, effect: str) -> FloatArray:
        """Scores of every rock by the model it had no weight in."""
        return self.fits[effect].held_out_scores(self.problem.part)

    def model(self, effect: str) -> Draw:
        """The draw that is handed over."""
        return self.fits[effect].handed_over.draw


def calibrated_base(
    problem: CalibrationProblem,
    run: TaskMap,
    draws: int,
    on_progress: OnProgress | None,
    keeping: Keeping,
) -> HypothesisFits:
    """The base, calibrated within the range of the ground of the case."""
    made = HypothesisFits(problem, run, draws, on_progress, keeping)
    made.add(NONE)
    return made


def best_base(
    problem: CalibrationProblem,
    run: TaskMap,
    draws: int,
    on_progress: OnProgress | None,
    keeping: Keeping,
) -> tuple[HypothesisFits, tuple[str, ...], HypothesisFits]:
    """The calibrated base, classes whose usual range had to be widened, and the base within it.

    Where the calibration runs into the limits of its range, a wider one is tried. It stays if it
    betters the score of rocks left out; if it certainly does, the usual range is wrong.
    """
    usual = problem.case.ground_range

    def calibrated(factor: int) -> HypothesisFits:
        return calibrated_base(in_range(problem, usual * factor), run, draws, on_progress, keeping)

    found = first = calibrated(1)
    wrong: list[str] = []
    for factor in WIDER:
        limits = classes_at_limit(found.problem.case, found.fits[NONE])
        if not limits:
            break
        wider = calibrated(factor)
        rng = np.random.default_rng([problem.seed, 83, factor])
        gain = gain_of(found.scores(NONE), wider.scores(NONE), problem.case.group, rng)
        if not gain.value > 0.0:
            break
        found = wider
        if gain.low > 0.0:
            wrong += limits
    return found, tuple(dict.fromkeys(wrong)), first


def _in_range(
    ground_range: float,
    function: Callable[[Any, Any], Any],
    problem: CalibrationProblem,
    task: Any,
) -> Any:
    """A task with another range of the ground than that of the prepared problem."""
    return function(in_range(problem, ground_range), task)
