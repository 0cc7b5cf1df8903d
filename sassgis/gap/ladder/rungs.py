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
    """How often each rock is in bootstrap samples of the groups, shape (samples, n_rocks).

    ``group``: of each rock, numbered from 0.
    """
    weights = times_drawn(group, rng, samples)
    # A sample of one rock has no pairs.
    paired: FloatArray = weights[(weights > 0.0).sum(axis=1) > 1]
    return paired


def share_of(
    above: RockDistances, below: RockDistances, floor: float, drawn: Sequence[FloatArray]
) -> tuple[float, Range | None]:
    """Share of the gap ``above`` (model before) that is closed ``below`` (after); 95 % interval.

    ``drawn``: both in bootstrap samples, shape (samples,) each; one without a gap is left out.
    """
    value = (above.value() - below.value()) / (above.value() - floor)
    gap = drawn[0] - floor
    found = (drawn[0] - drawn[1])[gap > 0.0] / gap[gap > 0.0]
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
        self._observed = problem.rows
        rng = np.random.default_rng([problem.seed, 53])
        self._weights = group_weights(problem.unit, rng, _SAMPLES)
        self._found: dict[str, tuple[Step, RockDistances, FloatArray]] = {}
        self.add(*steps)

    def add(self, *steps: Step) -> None:
        """Compare more models."""
        if not self._observed.shape[1]:
            return
        for step in steps:
            own = RockDistances.of(self._observed, step.rows)
            self._found[step.rung] = step, own, own.drawn(self._weights)

    def gain(self, simpler: str, rung: str) -> Interval | None:
        """Distance of a simpler model less that of another; None where nothing was compared."""
        if not {simpler, rung} <= self._found.keys():
            return None
        (_, before, drawn), (_, after, drawn_after) = self._found[simpler], self._found[rung]
        low = high = float("nan")
        if drawn.size > 1:
            low, high = np.quantile(drawn - drawn_after, [0.025, 0.975]).tolist()
        return Interval(before.value() - after.value(), low, high)

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
                share_of(first, own, floor, (drawn, its)) if first.above_chance else (None, None)
            )
            gain = self.gain(step.over, step.rung)
            beyond = (None, None) if gain is None else (gain.value, (gain.low, gain.high))
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
                simpler: found
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

    ``base``, ``rows``: held-out replicas of each rock, without and with the effect, shape
    (m, n_rocks, p).
    """
    if not problem.rows.shape[1]:
        nan = float("nan")
        note = (
            "Neither stops nor stations were seen of enough rocks: there is no distance to shrink."
        )
        return Shrinkage(effect, None, None, nan, nan, nan, {}, note)
    before, after = (RockDistances.of(problem.rows, own) for own in (base, rows))
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
        drawn = [own.drawn(weights) for own in (before, after)]
        value, interval = share_of(before, after, after.floor, drawn)
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
        one, other, floor = before.value(), after.value(), after.floor
        share = (one - other) / (one - floor) if before.above_chance else None
        out[what] = {"base": one, "effect": other, "floor": floor, "shrinkage": share}
    return out
