"""Hypotheses of a diagnosis, calibrated when they are asked for; finished draws are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.gap.causes.all_causes import NUMBERS
from sassgis.gap.ladder.calibration import (
    TOP,
    FitTask,
    FittedEffect,
    best_draws,
    fitted,
    gain_of,
    held_out_scores,
    refine,
    run_task,
)
from sassgis.gap.ladder.handover import classes_at_limit
from sassgis.gap.ladder.parameter_posterior import ParameterPosterior, parameter_posterior
from sassgis.gap.which.ensemble import (
    COUNT,
    CalibrationProblem,
    Ensemble,
    Tried,
    ensemble_of,
    first_draw,
    tasks_of,
    try_task,
)
from sassgis.gap.which.hypotheses import NONE, Draw
from sassgis.io.saved_arrays import read_saved, write_saved
from sassgis.io.staging import CHECKPOINT_STEM, writing
from sassgis.model.grid import FloatArray
from sassgis.runs.workers import TaskMap

#: Draws of each hypothesis in the first round, and of the base.
DRAWS, BASE_DRAWS = 40, 80
#: Repetitions of the refinement, and draws in each of them and each fit.
REPETITIONS, REFINED = 2, 12
#: Factors on the range of the ground where the calibration runs into its limits.
WIDER = (2, 3)

OnProgress = Callable[[int, int, int], None]


def _try(problem: CalibrationProblem, task: tuple[str, int]) -> Tried:
    return try_task(problem, task, NUMBERS)


@dataclass(frozen=True, slots=True)
class KeptDraws:
    """First draws of effects that an earlier attempt with the same settings finished.

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

    def first_draws(
        self, problem: CalibrationProblem, effect: str, draws: int, run: TaskMap
    ) -> list[Tried]:
        """Draws of an effect, made now or before."""
        if self.work is None:
            return list(run(_try, tasks_of([effect], draws)))
        file = self.work / f"{CHECKPOINT_STEM}.{effect}.{problem.case.ground_range:g}.npz"
        tasks = tasks_of([effect], draws)
        known = read_saved(file, self.fingerprint, self.tell)
        if known is not None:
            # The draws follow from the seed; what takes time are their campaigns.
            again = (first_draw(problem, task, NUMBERS) for task in tasks)
            return [
                Tried(made, own, number=number)
                for (made, number), own in zip(again, known["rows"], strict=True)
            ]
        made = list(run(_try, tasks))
        rows = np.stack([t.rows for t in made])
        with writing(file):
            write_saved(file, {"rows": rows}, self.fingerprint)
        return made


class _Counter:
    """Reports how many draws are done, of how many, and the rocks simulated for them."""

    def __init__(self, on_progress: OnProgress | None, total: int, n_rocks: int) -> None:
        self._on_progress, self._total, self._rocks = on_progress, total, COUNT * n_rocks
        self._done = 0

    def step(self, number: int = 1) -> None:
        self._done += number
        if self._on_progress is not None:
            self._on_progress(self._done, self._total, self._rocks * self._done)

    def counted(self, results: Iterable[Tried]) -> Iterator[Tried]:
        for one in results:
            self.step()
            yield one


class HypothesisFits:
    """Hypotheses that are calibrated when they are asked for, in every fit by itself."""

    def __init__(
        self,
        problem: CalibrationProblem,
        ensemble: Ensemble,
        run: TaskMap,
        on_progress: OnProgress | None,
        draws: int,
        kept: KeptDraws,
    ) -> None:
        self.problem, self.ensemble, self._draws = problem, ensemble, draws
        self._kept = kept
        self.fits: dict[str, FittedEffect] = {}
        self.run, self._on_progress = run, on_progress

    def add(self, *effects: str) -> None:
        """Calibrate effects; draws of those that were never tried are made first."""
        due = [e for e in dict.fromkeys(effects) if e not in self.fits]
        for effect in due:
            if not self.ensemble.of(effect).size:
                made = self._kept.first_draws(self.problem, effect, self._draws, self.run)
                self.ensemble = self.ensemble.with_more(self.problem, made)
        fits = self.problem.n_parts + 1
        total = len(due) * fits * (REPETITIONS * REFINED + TOP)
        counter = _Counter(self._on_progress, total, self.problem.case.n_rocks)

        def again(tasks: Sequence[FitTask]) -> list[Tried]:
            return list(counter.counted(self.run(run_task, tasks)))

        self.ensemble = refine(
            self.problem, self.ensemble, due, again, repetitions=REPETITIONS, draws=REFINED
        )
        self.fits |= fitted(self.problem, self.ensemble, due, again)

    def rows(self, effect: str) -> FloatArray:
        """Rows of every rock by the model it had no say in."""
        return self.fits[effect].held_out_rows(self.problem.part)

    def model(self, effect: str) -> Draw:
        """The draw that is handed over."""
        return self.fits[effect].handed_over.draw

    def draws(self, effect: str, most: int) -> list[Draw]:
        """The draw that is handed over, and the next best of the fit that leaves no rock out."""
        last = self.problem.n_parts
        best = best_draws(self.ensemble, effect, self.problem.rocks_of(last), last, most - 1)
        return [self.model(effect), *(self.ensemble.tried[i].draw for i in best.tolist())]

    def posterior(self, effect: str) -> ParameterPosterior | None:
        """What all rocks leave of the parameters."""
        return parameter_posterior(self.problem, self.ensemble, effect, self.problem.n_parts)

    def scores(self, effect: str) -> FloatArray:
        """Energy scores of rocks by the best draws of the fits they had no say in."""
        return held_out_scores(self.problem, self.ensemble, effect)


def calibrated_base(
    problem: CalibrationProblem,
    run: TaskMap,
    draws: int,
    on_progress: OnProgress | None,
    kept: KeptDraws,
) -> HypothesisFits:
    """The base, calibrated within the range of the ground of the case."""

    def run_here(function: Callable[[Any, Any], Any], tasks: Sequence[Any]) -> Iterator[Any]:
        return run(partial(_in_range, problem.case.ground_range, function), tasks)

    tried = kept.first_draws(problem, NONE, BASE_DRAWS, run_here)
    made = HypothesisFits(problem, ensemble_of(problem, tried), run_here, on_progress, draws, kept)
    made.add(NONE)
    return made


def best_base(
    problem: CalibrationProblem,
    run: TaskMap,
    draws: int,
    on_progress: OnProgress | None,
    kept: KeptDraws,
) -> tuple[HypothesisFits, tuple[str, ...], HypothesisFits]:
    """The calibrated base, classes whose usual range had to be widened, and the base within it.

    Where the calibration runs into the limits of its range, a wider one is tried. It stays if it
    betters the score of rocks left out; if it certainly does, the usual range is wrong.
    """
    usual = problem.case.ground_range

    def calibrated(factor: int) -> HypothesisFits:
        case = replace(problem.case, ground_range=usual * factor)
        return calibrated_base(replace(problem, case=case), run, draws, on_progress, kept)

    found = first = calibrated(1)
    wrong: list[str] = []
    for factor in WIDER:
        limits = classes_at_limit(found.problem.case, found.posterior(NONE))
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
    """A task with another range of the calibration than that of the prepared problem."""
    return function(replace(problem, case=replace(problem.case, ground_range=ground_range)), task)
