"""How far the gap shrinks, rung by rung, on rocks left out of the calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sassgis.gap.calibration.problem import CalibrationProblem
from sassgis.gap.diagnosis import Range, Rung, Shrinkage
from sassgis.gap.inference.distances import RockDistances
from sassgis.gap.which.hypotheses import NONE
from sassgis.model.grid import FloatArray, IntArray

#: Rungs that are no hypothesis.
CONFIGURED, FLOOR = "configured", "floor"
#: Bootstrap samples of groups of rocks.
_SAMPLES = 999


def group_weights(group: IntArray, rng: np.random.Generator, samples: int) -> FloatArray:
    """How often each rock is in bootstrap samples of the groups, shape (samples, n_rocks)."""
    unit = np.unique(group, return_inverse=True)[1]
    n = int(unit.max()) + 1
    times = rng.multinomial(n, np.full(n, 1.0 / n), size=samples).astype(np.float64)
    weights: FloatArray = times[:, unit]
    # A sample of one rock has no pairs.
    paired: FloatArray = weights[(weights > 0.0).sum(axis=1) > 1]
    return paired


def share_of(
    above: RockDistances, below: RockDistances, floor: float, weights: FloatArray
) -> tuple[float, Range | None]:
    """Share of the gap ``above`` that is closed ``below``, with its 95 % interval.

    Parameters
    ----------
    above, below : RockDistances
        Of the model before and after.
    floor : float
    weights : float64, shape (samples, n_rocks)
        Of ``group_weights``; a sample without a gap is left out.
    """
    value = (above.value() - below.value()) / (above.value() - floor)
    drawn = np.array([(above.value(w), below.value(w)) for w in weights]).reshape(-1, 2)
    gap = drawn[:, 0] - floor
    found = (drawn[:, 0] - drawn[:, 1])[gap > 0.0] / gap[gap > 0.0]
    if found.size < 20:
        return value, None
    low, high = np.quantile(found, [0.025, 0.975])
    return value, (float(low), float(high))


def ladder_of(
    problem: CalibrationProblem, rungs: Sequence[tuple[str, FloatArray]]
) -> tuple[Rung, ...]:
    """Distance and share of the gap of each model, the configured one first, and the floor.

    Parameters
    ----------
    problem : CalibrationProblem
    rungs : sequence of (name, rows)
        Held-out replicas of each rock.

    Returns
    -------
    tuple of Rung
        Empty where nothing could be compared. Shares are withheld where the gap of the configured
        model may be chance.
    """
    if not problem.rows.shape[1]:
        return ()
    found = [RockDistances.of(problem.rows, rows) for _, rows in rungs]
    first, floor = found[0], found[-1].floor
    rng = np.random.default_rng([problem.seed, 53])
    weights = group_weights(problem.case.group, rng, _SAMPLES)
    out = [Rung(rungs[0][0], first.value())]
    for (name, _), own in zip(rungs[1:], found[1:], strict=True):
        shared = share_of(first, own, floor, weights) if first.above_chance else (None, None)
        out.append(Rung(name, own.value(), *shared))
    return (*out, Rung(FLOOR, floor))


def needs_contact_law(ladder: Sequence[Rung]) -> bool:
    """Whether another law of the contact certainly closes more of the gap than ground alone."""
    span = {rung.rung: rung.ci95 for rung in ladder}
    ground, law = span.get("ground"), span.get("contact_law")
    return ground is not None and law is not None and law[0] > ground[1]


def ground_is_enough(ladder: Sequence[Rung]) -> bool:
    """Whether what calibrated ground leaves of the gap may be chance."""
    return any(r.rung == "ground" and r.ci95 is not None and r.ci95[1] >= 1.0 for r in ladder)


def shrinkage_of(
    problem: CalibrationProblem, base: FloatArray, effect: str, rows: FloatArray
) -> Shrinkage:
    """How far the gap of the calibrated base shrinks by an effect, on held-out rocks.

    Parameters
    ----------
    problem : CalibrationProblem
    base, rows : float64, shape (m, n_rocks, p)
        Held-out replicas of each rock, without and with the effect.
    effect : str
    """
    observed = problem.rows
    if not observed.shape[1]:
        nan = float("nan")
        note = (
            "Neither stops nor stations were seen of enough rocks: there is no distance to shrink."
        )
        return Shrinkage(effect, None, None, nan, nan, nan, {}, note)
    before, after = RockDistances.of(observed, base), RockDistances.of(observed, rows)
    value, interval, note = None, None, ""
    if effect == NONE:
        note = "No effect is named: nothing to shrink by."
    elif not before.above_chance:
        note = (
            "The gap of the calibrated base is not distinguished from chance: no share of it is "
            "given."
        )
    else:
        rng = np.random.default_rng([problem.seed, 51])
        weights = group_weights(problem.case.group, rng, _SAMPLES)
        value, interval = share_of(before, after, after.floor, weights)
    return Shrinkage(
        effect,
        value,
        interval,
        before.value(),
        after.value(),
        after.floor,
        _by_quantity(problem, base, rows),
        note,
    )


def _by_quantity(
    problem: CalibrationProblem, base: FloatArray, effect: FloatArray
) -> Mapping[str, Mapping[str, float | None]]:
    """The same for each quantity alone, all stations together."""
    k = len(problem.scale.names)
    kinds: dict[str, list[int]] = {}
    for i, name in enumerate(problem.scale.names):
        place, _, what = name.partition(":")
        kinds.setdefault(what if place != "stop" else f"stop {what}", []).extend([i, i + k])
    out: dict[str, dict[str, float | None]] = {}
    for what, columns in kinds.items():
        before, after = (
            RockDistances.of(problem.rows[:, columns], rows[:, :, columns])
            for rows in (base, effect)
        )
        share = None
        if before.above_chance:
            share = share_of(before, after, after.floor, np.empty((0, 0)))[0]
        out[what] = {
            "base": before.value(),
            "effect": after.value(),
            "floor": after.floor,
            "shrinkage": share,
        }
    return out
