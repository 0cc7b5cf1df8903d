"""Hypotheses of a diagnosis, calibrated when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from sassgis.gap.calibration.linear_fit import FitBudget
from sassgis.gap.calibration.problem import CalibrationProblem
from sassgis.gap.calibration.site_summary import SiteSummary
from sassgis.gap.ladder.hypothesis_fit import COUNT, LOOKED, FittedHypothesis, fit_hypothesis
from sassgis.gap.which.hypotheses import NONE, Draw
from sassgis.gap.which.verdict import CONTACT_LAW
from sassgis.model.grid import FloatArray
from sassgis.runs.draw_store import DrawProgress
from sassgis.runs.workers import OnProgress, TaskMap

#: Draws of each round of a calibration, and rounds.
DRAWS, ROUNDS = 32, 6


class HypothesisFits:
    """Hypotheses that are calibrated when they are asked for.

    Another law of the contact begins where calibrated ground has ended, and a cause where its base
    has: a model with more parameters is not worse for want of draws.
    """

    def __init__(
        self, summary: SiteSummary, run: TaskMap, draws: int, on_progress: OnProgress | None = None
    ) -> None:
        self.summary = summary
        self._run, self._on_progress = run, on_progress
        self.fits: dict[str, FittedHypothesis] = {}
        self._budget = FitBudget(ROUNDS, draws, COUNT, LOOKED)

    def run(self, function: Callable[[Any, Any], Any], tasks: Sequence[Any]) -> Iterator[Any]:
        """Results of a function of the site and a task, in the order of the tasks."""
        rocks = sum(task.count for task in tasks) * self.problem.n_rocks
        progress = DrawProgress(self._on_progress, len(tasks), rocks // max(len(tasks), 1))
        for result in self._run(function, tasks):
            progress.step()
            yield result

    @property
    def problem(self) -> CalibrationProblem:
        """The site."""
        return self.summary.problem

    def add(
        self,
        effect: str,
        start: Mapping[str, float] | None = None,
        held: Mapping[str, float] | None = None,
    ) -> FittedHypothesis:
        """Calibrate a hypothesis that is not calibrated yet; others as for fit_hypothesis."""
        if effect not in self.fits:
            if start is None:
                start = self.add(NONE).shares if effect == CONTACT_LAW else {}
            self.fits[effect] = fit_hypothesis(
                self.summary, effect, self.run, self._budget, start, held or {}
            )
        return self.fits[effect]

    def rows(self, effect: str) -> FloatArray:
        """Rows of every rock by the model it had no weight in."""
        return self.fits[effect].held_out_rows(self.problem.part)

    def scores(self, effect: str) -> FloatArray:
        """Scores of every rock by the model it had no weight in."""
        return self.fits[effect].held_out_scores(self.problem.part)

    def model(self, effect: str) -> Draw:
        """The draw that is handed over."""
        return self.fits[effect].handed_over.draw
