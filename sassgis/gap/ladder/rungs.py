"""How far the gap shrinks, rung by rung, on rocks left out of the calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.calibration.problem import CalibrationProblem
from sassgis.gap.diagnosis import Range, Rung, Shrinkage
from sassgis.gap.inference.distances import RockDistances
from sassgis.gap.inference.intervals import Interval, times_drawn
from sassgis.gap.which.hypotheses import NONE
from sassgis.gap.words import number_text, range_text, rung_name
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.languages import joined, phrase

#: Rungs that are no effect; calibrated ground is the hypothesis "none".
CONFIGURED, GROUND, FLOOR = "configured", "ground", "floor"
#: Bootstrap samples of groups of rocks.
_SAMPLES = 999


def group_weights(group: IntArray, rng: np.random.Generator, samples: int) -> FloatArray:
    """How often each rock is in bootstrap samples of the groups, shape (samples, n_rocks)."""
    weights = times_drawn(np.unique(group, return_inverse=True)[1], rng, samples)
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
    weights : float64, shape (samples, n_rocks)
        Of ``group_weights``; a sample without a gap is left out.
    """
    drawn = (np.array([own.value(w) for w in weights]) for own in (above, below))
    return _share(above.value(), below.value(), floor, *drawn)


def _share(
    above: float, below: float, floor: float, drawn_above: FloatArray, drawn_below: FloatArray
) -> tuple[float, Range | None]:
    """The same of distances, and of those in bootstrap samples."""
    value = (above - below) / (above - floor)
    gap = drawn_above - floor
    found = (drawn_above - drawn_below)[gap > 0.0] / gap[gap > 0.0]
    if found.size < 20:
        return value, None
    low, high = np.quantile(found, [0.025, 0.975])
    return value, (float(low), float(high))


@dataclass(frozen=True, slots=True)
class Step:
    """A model of the ladder: its name, the simpler one that it is added to, and held-out rows."""

    rung: str
    over: str
    rows: FloatArray


class Ladder:
    """Distances of models from the observed rocks, and what each closes beyond simpler ones.

    Rocks, or groups of them, are resampled alike for all.
    """

    def __init__(self, problem: CalibrationProblem, steps: Sequence[Step]) -> None:
        self._unit, self._seed = problem.unit, problem.seed
        self._observed = problem.rows
        self._found: dict[str, tuple[Step, RockDistances, FloatArray]] = {}
        self.add(*steps)

    def add(self, *steps: Step) -> None:
        """Compare more models."""
        if not self._observed.shape[1]:
            return
        rng = np.random.default_rng([self._seed, 53])
        weights = group_weights(self._unit, rng, _SAMPLES)
        for step in steps:
            own = RockDistances.of(self._observed, step.rows)
            drawn = np.array([own.value(w) for w in weights])
            self._found[step.rung] = step, own, drawn

    def gain(self, simpler: str, rung: str) -> tuple[Interval, float] | None:
        """Distance of a simpler model less that of another, and its standard error.

        None where nothing could be compared.
        """
        if not {simpler, rung} <= self._found.keys():
            return None
        before, after = self._found[simpler], self._found[rung]
        value = before[1].value() - after[1].value()
        drawn = before[2] - after[2]
        if drawn.size < 2:
            return Interval(value, float("nan"), float("nan")), float("nan")
        low, high = np.quantile(drawn, [0.025, 0.975])
        return Interval(value, float(low), float(high)), float(drawn.std(ddof=1))

    def rungs(self, *names: str) -> tuple[Rung, ...]:
        """Distance, share of the gap of the first model and gain of each, and the floor.

        Empty where nothing could be compared. Shares are withheld where the gap of the first model
        may be chance.
        """
        if not self._found:
            return ()
        found = [self._found[name] for name in names]
        (_, first, drawn), floor = found[0], found[-1][1].floor
        out = [Rung(names[0], first.value())]
        for step, own, its in found[1:]:
            share, span = (
                _share(first.value(), own.value(), floor, drawn, its)
                if first.above_chance
                else (None, None)
            )
            gain = self.gain(step.over, step.rung)
            beyond = (None, None) if gain is None else (gain[0].value, (gain[0].low, gain[0].high))
            out.append(Rung(step.rung, own.value(), share, span, step.over, *beyond))
        return (*out, Rung(FLOOR, floor))

    def recommended(self, *names: str) -> tuple[str, str]:
        """The last of some models whose gain over the simpler ones clears zero, and why no other.

        A model must close certainly more (95 %, rocks left out) than the one that it is added to,
        and than the one that is recommended without it.
        """
        best, why = names[0], list[str]()
        if not self._found:
            return best, "nothing was observed of which a gain on rocks left out could be shown"
        for name in names[1:]:
            gains = {
                simpler: found[0]
                for simpler in (self._found[name][0].over, best)
                if (found := self.gain(simpler, name)) is not None
            }
            unsure = [(simpler, gain) for simpler, gain in gains.items() if not gain.low > 0.0]
            if not unsure:
                best, why = name, []
                continue
            simpler, gain = unsure[-1]
            why.append(
                phrase(
                    "by {} beyond {} (energy distance {} of {}; 95 %: {})",
                    rung_name(name),
                    rung_name(simpler),
                    number_text(gain.value),
                    number_text(self._found[simpler][1].value()),
                    range_text(gain.low, gain.high),
                )
            )
        if not why:
            return best, ""
        nothing = phrase("on rocks left out nothing is closed for certain {}", joined(", ", why))
        return best, nothing


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
    base, rows : float64, shape (m, n_rocks, p)
        Held-out replicas of each rock, without and with the effect.
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
        weights = group_weights(problem.unit, rng, _SAMPLES)
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
