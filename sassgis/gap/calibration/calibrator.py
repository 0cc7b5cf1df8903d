"""The calibration of any parameters on the rocks of one or several sites.

Parameters are shares of their ranges. What they make of the model is known to those who score them
alone: ground classes (``calibrate``), or a hypothesis of the diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.calibration.identifiability import Fitted, fitted_parameters
from sassgis.gap.calibration.parameters import ClassParameter, Prior
from sassgis.gap.calibration.problem import CalibrationProblem
from sassgis.gap.calibration.search import (
    Posterior,
    ScoreSurface,
    SiteScores,
    first_design,
    keeping_configured,
    minimum_without,
    next_design,
    posterior_of,
    surface_of,
)
from sassgis.model.grid import FloatArray, IntArray

#: Number of a draw and its parameters as shares of their ranges.
NumberedDraw = tuple[int, FloatArray]
#: Scores of all rocks, site after site, of draws in their order.
RunDraws = Callable[[Sequence[NumberedDraw]], Sequence[FloatArray]]


@dataclass(frozen=True, slots=True)
class Space:
    """What is calibrated, and where it acts.

    Attributes
    ----------
    parameters : tuple of ClassParameter
    columns : tuple of int64
        Parameters that act at each site.
    kept : bool, shape (d,)
        Those that stay as configured where the rocks do not ask for more.
    """

    parameters: tuple[ClassParameter, ...]
    columns: tuple[IntArray, ...]
    kept: NDArray[np.bool_]

    @property
    def prior(self) -> Prior:
        """About the configured values."""
        return Prior.of(self.parameters)


@dataclass(frozen=True, slots=True)
class Budget:
    """Draws of the first design, repetitions after it, and draws of each of them."""

    first: int
    repetitions: int
    more: int

    @property
    def draws(self) -> int:
        """Draws in all."""
        return self.first + self.repetitions * self.more


@dataclass(frozen=True, slots=True)
class Calibrated:
    """What was tried, and what follows from it.

    Attributes
    ----------
    points : float64, shape (n_draws, d)
    surface : ScoreSurface
    posterior : Posterior
        Its ``best`` keeps at the configured value what need not leave it.
    fitted : tuple of Fitted
    """

    points: FloatArray
    surface: ScoreSurface
    posterior: Posterior
    fitted: tuple[Fitted, ...]

    def without(self, problems: Sequence[CalibrationProblem], part: int) -> FloatArray:
        """Best parameters for the rocks of the other parts; where draws lie is that of all."""
        weights = [(p.unit_parts() != part).astype(np.float64) for p in problems]
        return minimum_without(self.surface, self.posterior, weights)


def calibrate_on(
    problems: Sequence[CalibrationProblem], space: Space, run: RunDraws, budget: Budget
) -> Calibrated:
    """Try parameters, more and more of them where the best may lie.

    Parameters
    ----------
    problems : sequence of CalibrationProblem
        One or more, with something to be scored.
    space : Space
    run : callable
        Scores draws.
    budget : Budget
    """
    seed = problems[0].seed
    points = first_design(space.prior, budget.first, seed)
    scores = np.stack(run([(1 + k, share) for k, share in enumerate(points)]))
    for repetition in range(budget.repetitions + 1):
        surface = _surface(problems, space, points, scores, budget.first)
        if repetition == budget.repetitions:
            break
        new = next_design(surface, points, budget.more, seed)
        scored = run([(1 + len(points) + k, share) for k, share in enumerate(new)])
        scores, points = np.vstack([scores, *scored]), np.vstack([points, new])
    posterior = posterior_of(surface, points, seed)
    fitted = fitted_parameters(space.parameters, posterior)
    stays = np.array([f.identified for f in fitted]) | ~space.kept
    posterior = keeping_configured(surface, posterior, stays)
    return Calibrated(points, surface, posterior, fitted_parameters(space.parameters, posterior))


def _surface(
    problems: Sequence[CalibrationProblem],
    space: Space,
    points: FloatArray,
    scores: FloatArray,
    first: int,
) -> ScoreSurface:
    borders = np.cumsum([p.n_rocks for p in problems])[:-1]
    parts = np.split(scores, borders, axis=1)
    sites = [
        SiteScores(columns, problem.per_unit(own))
        for columns, problem, own in zip(space.columns, problems, parts, strict=True)
    ]
    return surface_of(points, sites, space.prior, first)
