"""Calibration of hypotheses on the observed rocks, with and without the rocks to be left out.

A fit has the number of the part of the rocks that has no say in it: neither in what is drawn next,
nor in which draw is chosen. The fit of number ``problem.n_parts`` leaves no rock out; its model is
the one that is handed over.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.causes.parameter_draws import ParameterDraws
from sassgis.gap.inference.intervals import Interval, bootstrap_interval
from sassgis.gap.ladder.parameter_posterior import parameter_posterior
from sassgis.gap.which.ensemble import (
    CalibrationProblem,
    Ensemble,
    Tried,
    rock_scores,
    try_draw,
)
from sassgis.gap.which.hypotheses import NONE, draw
from sassgis.model.grid import FloatArray, IntArray

#: Draws that stand together for a calibrated hypothesis until one of them is chosen.
TOP = 4
#: Campaigns of each of the draws of which one is chosen: fresh ones, so that luck in the first
#: ones does not count.
FRESH = 6
#: Numbers of campaigns of refinement, and of the choice, begin here: beyond those of first draws.
_REFINED, _CHOSEN = 3000, 3900


@dataclass(frozen=True, slots=True)
class FitTask:
    """Campaigns to make of given parameter draws of an effect, for a fit."""

    effect: str
    parameter_draws: Mapping[str, float]
    number: int
    fit: int
    count: int


Run = Callable[[Sequence[FitTask]], Sequence[Tried]]


def best_draws(
    ensemble: Ensemble, effect: str, rocks: IntArray, fit: int, most: int = TOP
) -> IntArray:
    """Draws of a fit with the best mean score over some rocks, best first, at most so many."""
    own = ensemble.of(effect, fit)
    order = np.argsort(np.nanmean(ensemble.scores[np.ix_(own, rocks)], axis=1), kind="stable")
    return own[order[:most]]


def refine(
    problem: CalibrationProblem,
    ensemble: Ensemble,
    effects: Sequence[str],
    run: Run,
    *,
    repetitions: int,
    draws: int,
) -> Ensemble:
    """Calibrate effects: draw again near the best draws, round by round, in every fit by itself.

    Cross-entropy method (Rubinstein 1999): each new draw starts from one of the best and moves by
    the scatter among them.

    Parameters
    ----------
    problem : CalibrationProblem
    ensemble : Ensemble
    effects : sequence of str
    run : callable
        Makes campaigns, in order.
    repetitions, draws : int
        Draws of each effect in each round and fit.
    """
    for repetition in range(repetitions):
        tasks = []
        for effect in effects:
            for fit in range(problem.n_parts + 1):
                rng = np.random.default_rng([problem.seed, 31, repetition, fit, *map(ord, effect)])
                made = _next_draws(problem, ensemble, effect, fit, draws, rng)
                first = _REFINED + (fit * repetitions + repetition) * draws
                tasks += [FitTask(effect, d, first + k, fit, 2) for k, d in enumerate(made)]
        ensemble = ensemble.with_more(problem, run(tasks))
    return ensemble


def _next_draws(
    problem: CalibrationProblem,
    ensemble: Ensemble,
    effect: str,
    fit: int,
    draws: int,
    rng: np.random.Generator,
) -> list[dict[str, float]]:
    rocks = problem.rocks_of(fit)
    most = max(TOP, ensemble.of(effect, fit).size // 8)
    good = best_draws(ensemble, effect, rocks, fit, most)
    elite = [ensemble.tried[i].draw.parameter_draws for i in good.tolist()]
    base = best_draws(ensemble, NONE, rocks, fit)
    made = []
    for k in range(draws):
        parameter_draws = _near(elite, rng)
        if effect != NONE and k % 2:
            # The ground of the calibrated base, with this effect.
            ground = ensemble.tried[int(base[k // 2 % base.size])].draw
            parameter_draws |= {
                n: v for n, v in ground.parameter_draws.items() if "." in n and n in parameter_draws
            }
        made.append(parameter_draws)
    return made


def run_task(problem: CalibrationProblem, task: FitTask) -> Tried:
    """Campaigns of given parameter draws."""
    families = () if task.effect == NONE else tuple(task.effect.split("+"))
    rng = np.random.default_rng([problem.seed, 41, task.number, *map(ord, task.effect)])
    return try_draw(
        problem,
        draw(problem.case, families, ParameterDraws(rng, task.parameter_draws)),
        task.number,
        fit=task.fit,
        count=task.count,
    )


def _near(elite: Sequence[Mapping[str, float]], rng: np.random.Generator) -> dict[str, float]:
    """Parameter draws near one of the best, moved by the scatter among the best."""
    parent = elite[int(rng.integers(len(elite)))]
    moved = {}
    for name, value in parent.items():
        others = np.array([e[name] for e in elite if name in e])
        scatter = max(float(others.std()) if others.size > 2 else 0.15, 0.04)
        new = value + 0.6 * scatter * float(rng.standard_normal())
        new = abs(new)
        moved[name] = min(max(1.0 - abs(1.0 - new), 0.0), 1.0 - 1e-9)
    return moved


# ---------------------------------------------------------------------------------------------
# The model of each fit


@dataclass(frozen=True, slots=True)
class FittedEffect:
    """The models of one hypothesis: one of each fit.

    Attributes
    ----------
    effect : str
    models : tuple of Tried, length n_parts + 1
        FRESH campaigns each; the last one is of all rocks.
    """

    effect: str
    models: tuple[Tried, ...]

    @property
    def handed_over(self) -> Tried:
        """The model of the fit that leaves no rock out."""
        return self.models[-1]

    def held_out_rows(self, part: IntArray) -> FloatArray:
        """Replicas of each rock by the model it had no say in, shape (FRESH, n_rocks, p)."""
        rows = self.models[-1].rows.astype(np.float64)
        for fit, tried in enumerate(self.models[:-1]):
            rows[:, part == fit] = tried.rows[:, part == fit]
        return rows


def fitted(
    problem: CalibrationProblem, ensemble: Ensemble, effects: Iterable[str], run: Run
) -> dict[str, FittedEffect]:
    """The best draw of each effect and fit, told from the next best by fresh campaigns."""
    tasks = []
    for effect in effects:
        for fit in range(problem.n_parts + 1):
            best = best_draws(ensemble, effect, problem.rocks_of(fit), fit)
            candidates = [ensemble.tried[i].draw.parameter_draws for i in best.tolist()]
            left = parameter_posterior(problem, ensemble, effect, fit) if effect == NONE else None
            if left is not None:
                # Ground that need not leave its configured values stays there.
                candidates.append({**candidates[0], **left.best})
            tasks += [
                FitTask(effect, own, _CHOSEN + k, fit, FRESH) for k, own in enumerate(candidates)
            ]
    chosen: dict[tuple[str, int], tuple[float, Tried]] = {}
    for task, tried in zip(tasks, run(tasks), strict=True):
        scores = rock_scores(problem.rows, tried.rows)[problem.rocks_of(task.fit)]
        key, score = (task.effect, task.fit), float(np.nanmean(scores))
        if key not in chosen or score < chosen[key][0]:
            chosen[key] = score, tried
    return {
        effect: FittedEffect(
            effect, tuple(chosen[effect, fit][1] for fit in range(problem.n_parts + 1))
        )
        for effect in dict.fromkeys(task.effect for task in tasks)
    }


# ---------------------------------------------------------------------------------------------
# Scores of rocks left out


def held_out_scores(problem: CalibrationProblem, ensemble: Ensemble, effect: str) -> FloatArray:
    """Energy score of each rock by the best draws of the fit in which it had no say."""
    scores = np.full(problem.part.size, np.nan)
    for fit in range(problem.n_parts):
        out = np.flatnonzero(problem.part == fit)
        best = best_draws(ensemble, effect, problem.rocks_of(fit), fit)
        scores[out] = np.nanmean(ensemble.scores[np.ix_(best, out)], axis=0)
    return scores


def gain_of(
    base: FloatArray,
    effect: FloatArray,
    group: IntArray,
    rng: np.random.Generator,
    draws: int = 999,
) -> Interval:
    """Mean gain of score over rocks, with its bootstrap interval over groups of rocks."""
    gain = base - effect
    known = np.isfinite(gain)
    if not known.any():
        return Interval(float("nan"), float("nan"), float("nan"))
    return bootstrap_interval(
        lambda rows: float(gain[known][rows].mean()),
        group[known],
        draws=draws,
        rng=rng,
        method="percentile",
    )
