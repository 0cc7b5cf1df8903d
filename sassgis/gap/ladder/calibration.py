"""Calibration of hypotheses on the observed rocks; how far the gap shrinks on held-out rocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist, pdist

from sassgis.gap.diagnosis import Shrinkage
from sassgis.gap.inference.intervals import Interval, bootstrap_interval
from sassgis.gap.which.ensemble import CalibrationProblem, Ensemble, Tried, try_draw
from sassgis.gap.which.hypotheses import NONE, ParameterDraws, draw
from sassgis.model.grid import FloatArray, IntArray

#: Draws that stand together for a calibrated hypothesis.
TOP = 4
#: Numbers of campaigns of refinement begin here, beyond those of the first draws.
_REFINED = 3000

Run = Callable[[Sequence[tuple[str, Mapping[str, float], int]]], Sequence[Tried]]


def best_draws(ensemble: Ensemble, effect: str, rocks: IntArray | None = None) -> IntArray:
    """Draws of an effect with the best mean score over some rocks, best first, TOP of them."""
    own = ensemble.of(effect)
    scores = ensemble.scores[own] if rocks is None else ensemble.scores[np.ix_(own, rocks)]
    order = np.argsort(np.nanmean(scores, axis=1), kind="stable")
    return own[order[:TOP]]


def refine(
    problem: CalibrationProblem,
    ensemble: Ensemble,
    effects: Sequence[str],
    run: Run,
    *,
    repetitions: int,
    draws: int,
) -> Ensemble:
    """Calibrate effects: draw again near the best draws, round by round.

    Cross-entropy method (Rubinstein 1999): each new draw starts from one of the best and moves by
    the scatter among them.

    Parameters
    ----------
    problem : CalibrationProblem
    ensemble : Ensemble
    effects : sequence of str
    run : callable
        Makes campaigns of (effect, parameter_draws, number), in order.
    repetitions, draws : int
        Draws of each effect in each round.
    """
    for repetition in range(repetitions):
        tasks = []
        for effect in effects:
            rng = np.random.default_rng([problem.seed, 31, repetition, *map(ord, effect)])
            own = ensemble.of(effect)
            order = np.argsort(np.nanmean(ensemble.scores[own], axis=1), kind="stable")
            elite = [
                ensemble.tried[i].draw.parameter_draws
                for i in own[order[: max(TOP, own.size // 8)]]
            ]
            for k in range(draws):
                number = _REFINED + repetition * draws + k
                parameter_draws = _near(elite, rng)
                if effect != NONE and k % 2:
                    # The ground of the calibrated base, with this effect.
                    ground = ensemble.tried[int(best_draws(ensemble, NONE)[k // 2 % TOP])].draw
                    parameter_draws |= {
                        n: v
                        for n, v in ground.parameter_draws.items()
                        if "." in n and n in parameter_draws
                    }
                tasks.append((effect, parameter_draws, number))
        ensemble = ensemble.with_more(problem, run(tasks))
    return ensemble


def run_refined(problem: CalibrationProblem, task: tuple[str, Mapping[str, float], int]) -> Tried:
    """Campaigns of given parameter draws."""
    effect, parameter_draws, number = task
    families = () if effect == NONE else tuple(effect.split("+"))
    rng = np.random.default_rng([problem.seed, 41, number, *map(ord, effect)])
    return try_draw(
        problem,
        draw(problem.case, families, ParameterDraws(rng, parameter_draws)),
        number,
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
# Rocks left out


def held_out_scores(ensemble: Ensemble, effect: str, part: IntArray) -> FloatArray:
    """Energy score of each rock by draws chosen on the rocks of the other parts."""
    scores = np.full(part.size, np.nan)
    for p in np.unique(part).tolist():
        out = part == p
        best = best_draws(ensemble, effect, np.flatnonzero(~out))
        scores[out] = np.nanmean(ensemble.scores[np.ix_(best, np.flatnonzero(out))], axis=0)
    return scores


def gain_of(
    base: FloatArray, effect: FloatArray, rng: np.random.Generator, draws: int = 999
) -> Interval:
    """Mean gain of score over rocks, with its bootstrap interval over rocks."""
    gain = base - effect
    gain = gain[np.isfinite(gain)]
    if gain.size == 0:
        return Interval(float("nan"), float("nan"), float("nan"))
    rocks = np.arange(gain.size)
    return bootstrap_interval(
        lambda rows: float(gain[rows].mean()), rocks, draws=draws, rng=rng, method="percentile"
    )


def held_out_rows(ensemble: Ensemble, effect: str, part: IntArray) -> FloatArray:
    """Replicas of each rock by draws chosen on the other parts, shape (m, n_rocks, p)."""
    rows: FloatArray | None = None
    for p in np.unique(part).tolist():
        out = part == p
        best = best_draws(ensemble, effect, np.flatnonzero(~out))
        own = np.concatenate([ensemble.tried[i].rows for i in best.tolist()]).astype(np.float64)
        if rows is None:
            rows = np.zeros_like(own)
        rows[:, out] = own[:, out]
    assert rows is not None
    return rows


def fitted_rows(ensemble: Ensemble, effect: str) -> FloatArray:
    """Replicas of each rock by draws chosen on all rocks, shape (m, n_rocks, p)."""
    best = best_draws(ensemble, effect)
    return np.concatenate([ensemble.tried[i].rows for i in best.tolist()]).astype(np.float64)


@dataclass(frozen=True, slots=True)
class Distances:
    """Energy distances between rocks and what models make of them.

    Attributes
    ----------
    base, effect, floor : float
        Unbiased, so that the floor is near zero; ``floor`` is the mean of those of replicas.
    floor_95 : float
        95 % quantile of those of replicas: a gap below it may be chance.
    """

    base: float
    effect: float
    floor: float
    floor_95: float

    @property
    def shrinkage(self) -> float | None:
        """S, or None where the gap of the base may be chance."""
        if not self.base > self.floor_95:
            return None
        return (self.base - self.effect) / (self.base - self.floor)


def distances(observed: FloatArray, base: FloatArray, effect: FloatArray) -> Distances:
    """Energy distances of the observed rocks from replicas.

    Parameters
    ----------
    observed : float64, shape (n_rocks, p)
    base, effect : float64, shape (m, n_rocks, p)

    Returns
    -------
    Distances
    """
    if not observed.shape[1]:
        return Distances(*[float("nan")] * 4)
    between = _mean_distances(effect)
    floor = np.array([_left_out(between, observed.shape[0], k) for k in range(len(effect))])
    return Distances(
        _distance(observed, base, _mean_distances(base)),
        _distance(observed, effect, between),
        float(floor.mean()),
        float(floor.mean() + 1.645 * floor.std(ddof=1)) if floor.size > 1 else float(floor[0]),
    )


def _mean_distances(replicas: FloatArray) -> FloatArray:
    """Mean distance of the rocks of any two replicas, and of different rocks of each one."""
    m = len(replicas)
    mean = np.zeros((m, m))
    for i in range(m):
        mean[i, i] = pdist(replicas[i]).mean()
        for j in range(i):
            mean[i, j] = mean[j, i] = cdist(replicas[i], replicas[j]).mean()
    return mean


def _within(mean: FloatArray, n: int) -> float:
    """Mean distance of any two different rows of a pool of replicas of ``n`` rocks each."""
    m = len(mean)
    own = float(np.trace(mean)) * n * (n - 1)
    others = float(mean.sum() - np.trace(mean)) * n * n
    return (own + others) / (m * n * (m * n - 1))


def _distance(rows: FloatArray, replicas: FloatArray, mean: FloatArray) -> float:
    """Energy distance (Székely and Rizzo 2013), unbiased."""
    across = float(np.mean([cdist(rows, one).mean() for one in replicas]))
    return 2.0 * across - float(pdist(rows).mean()) - _within(mean, replicas.shape[1])


def _left_out(mean: FloatArray, n: int, k: int) -> float:
    """Energy distance of one replica from all the others."""
    rest = np.delete(np.arange(len(mean)), k)
    within = _within(mean[np.ix_(rest, rest)], n)
    return 2.0 * float(mean[k, rest].mean()) - float(mean[k, k]) - within


def shrinkage_of(
    problem: CalibrationProblem,
    ensemble: Ensemble,
    effect: str,
    part: IntArray,
    *,
    draws: int,
    seed: int,
) -> Shrinkage:
    """How far the gap of the calibrated base shrinks by an effect, on held-out rocks.

    Parameters
    ----------
    problem : CalibrationProblem
    ensemble : Ensemble
        With both calibrated.
    effect : str
    part : int64, shape (n_rocks,)
        Parts of the cross-validation.
    draws : int
        Bootstrap samples of rocks; each chooses its draws anew on its own rocks and is measured on
        the rocks it lacks.
    seed : int
    """
    observed = problem.rows
    base = held_out_rows(ensemble, NONE, part)
    with_effect = held_out_rows(ensemble, effect, part)
    found = distances(observed, base, with_effect)
    by_quantity = _by_quantity(problem, base, with_effect)
    value = found.shrinkage if effect != NONE else None
    if effect == NONE:
        note = "No effect is named: nothing to shrink by."
    elif not observed.shape[1]:
        note = (
            "Neither stops nor stations were seen of enough rocks: there is no distance to shrink."
        )
    elif value is None:
        note = (
            "The gap of the calibrated base is not distinguished from chance: no share of it is "
            "given."
        )
    else:
        note = ""
    interval = None
    if value is not None:
        drawn = _bootstrap(problem, ensemble, effect, value, draws, seed)
        interval = (float(drawn[0]), float(drawn[1]))
    return Shrinkage(
        effect,
        value,
        interval,
        found.base,
        found.effect,
        found.floor,
        by_quantity,
        note,
    )


def _bootstrap(
    problem: CalibrationProblem,
    ensemble: Ensemble,
    effect: str,
    value: float,
    draws: int,
    seed: int,
) -> FloatArray:
    """Limits of S: rocks drawn anew, draws chosen on them, measured on the rocks that they lack."""
    rng = np.random.default_rng([seed, 51])
    n = problem.rows.shape[0]
    found = []
    for _ in range(draws):
        inside = np.unique(rng.integers(0, n, n))
        outside = np.setdiff1d(np.arange(n), inside)
        if inside.size < 3 or outside.size < 3:
            continue
        rows = [
            np.concatenate([ensemble.tried[i].rows for i in best_draws(ensemble, e, inside)])
            for e in (NONE, effect)
        ]
        one = distances(problem.rows[outside], *(r[:, outside].astype(np.float64) for r in rows))
        gap = one.base - one.floor
        if gap > 0.0:
            found.append((one.base - one.effect) / gap)
    if len(found) < 20:
        return np.array([np.nan, np.nan])
    # A third of the rocks is left out each time: the scatter of so few is wider than that of all.
    scatter = (np.array(found) - np.median(found)) * np.sqrt(0.37)
    limits: FloatArray = value + np.quantile(scatter, [0.025, 0.975])
    return limits


def _by_quantity(
    problem: CalibrationProblem, base: FloatArray, effect: FloatArray
) -> dict[str, dict[str, float | None]]:
    """The same for each quantity alone, all stations together."""
    k = len(problem.scale.names)
    kinds: dict[str, list[int]] = {}
    for i, name in enumerate(problem.scale.names):
        place, _, what = name.partition(":")
        kinds.setdefault(what if place != "stop" else f"stop {what}", []).extend([i, i + k])
    out: dict[str, dict[str, float | None]] = {}
    for what, columns in kinds.items():
        found = distances(problem.rows[:, columns], base[:, :, columns], effect[:, :, columns])
        out[what] = {
            "base": found.base,
            "effect": found.effect,
            "floor": found.floor,
            "shrinkage": found.shrinkage,
        }
    return out
