"""Compare models: how far the gap shrinks rung by rung, and what causes close of the rest.

Rungs are compared on rocks left out of the calibration. For the gains of causes, the ground
calibrated anew, the base and every cause release the rocks again; each campaign is summed up by the
same numbers (``SiteSummary``). In the directions that the ground cannot follow, by the linear model
of the base, what is observed less the base is compared with what the draws of a cause change.
Chance is seen from campaigns of the base itself (parametric bootstrap), and whether these data
could show a cause from campaigns with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.causes.cause import ParameterDraws
from sassgis.gap.constants import (
    BASE_CAMPAIGNS,
    BASE_PARTS,
    CAUSE_CAMPAIGNS,
    CAUSE_DRAWS,
    CAUSE_NUMBER,
    DIRECTIONS,
    LADDER_SAMPLES,
    MOST_CHANGE,
    OWN_SCATTER,
    SHOWING_GAIN,
)
from sassgis.gap.diagnosis import CauseGain, Range, Rung, Shrinkage
from sassgis.gap.fit.distances import Interval, RockDistances, times_drawn
from sassgis.gap.fit.hypothesis_fit import (
    NONE,
    FittedHypothesis,
    HypothesisDraw,
    RunTasks,
    draw,
    draw_of,
    families_of,
)
from sassgis.gap.fit.linear_fit import LinearFit, SiteSummary, law_changes
from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.words import rung_name
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.languages import joined, phrase

#: Rungs that are no effect; calibrated ground is the hypothesis "none".
CONFIGURED, GROUND, FLOOR = "configured", "ground", "floor"


def group_weights(group: IntArray, rng: np.random.Generator, samples: int) -> FloatArray:
    """Count how often samples of groups, from 0, hold each rock, (samples, n_rocks)."""
    weights = times_drawn(group, rng, samples)
    # A sample of one rock has no pairs.
    paired: FloatArray = weights[(weights > 0.0).sum(axis=1) > 1]
    return paired


def share_of(
    above: RockDistances, below: RockDistances, floor: float, drawn: Sequence[FloatArray]
) -> tuple[float, Range | None]:
    """Return the share of the gap ``above`` that is closed ``below``, with its 95 % interval.

    ``drawn``: both in bootstrap samples, shape (samples,) each; one without a gap is left out.
    """
    value = (above.value() - below.value()) / (above.value() - floor)
    gap = drawn[0] - floor
    found = (drawn[0] - drawn[1])[gap > 0.0] / gap[gap > 0.0]
    if found.size < 20:
        return value, None
    low, high = np.quantile(found, [0.025, 0.975])
    return value, (float(low), float(high))


class Ladder:
    """Distances of models from the observed rocks, and what each closes beyond simpler ones."""

    def __init__(self, problem: SiteData) -> None:
        self._observed = problem.rows
        rng = np.random.default_rng([problem.seed, 53])
        self._weights = group_weights(problem.unit, rng, LADDER_SAMPLES)
        self._found: dict[str, tuple[str, RockDistances, FloatArray]] = {}

    def add(self, rung: str, over: str, rows: FloatArray) -> None:
        """Compare one more model, added to the simpler ``over``, by its held-out rows."""
        if self._observed.shape[1]:
            own = RockDistances.of(self._observed, rows)
            self._found[rung] = over, own, own.drawn(self._weights)

    def gain(self, simpler: str, rung: str) -> Interval | None:
        """Return the distance of a simpler model less that of another; None without."""
        if not {simpler, rung} <= self._found.keys():
            return None
        (_, before, drawn), (_, after, drawn_after) = self._found[simpler], self._found[rung]
        low = high = float("nan")
        if drawn.size > 1:
            low, high = np.quantile(drawn - drawn_after, [0.025, 0.975]).tolist()
        return Interval(before.value() - after.value(), low, high)

    def rungs(self, *names: str) -> tuple[Rung, ...]:
        """Return distance, share of the gap of the first model and gain of each, and the floor.

        Empty where nothing could be compared; shares are withheld where the first gap may be
        chance.
        """
        if not self._found:
            return ()
        (_, first, drawn), floor = self._found[names[0]], self._found[names[-1]][1].floor
        out = [Rung(names[0], first.value())]
        for name in names[1:]:
            over, own, its = self._found[name]
            share, span = (
                share_of(first, own, floor, (drawn, its)) if first.above_chance else (None, None)
            )
            gain = self.gain(over, name)
            beyond = (None, None) if gain is None else (gain.value, (gain.low, gain.high))
            out.append(Rung(name, own.value(), share, span, over, *beyond))
        return (*out, Rung(FLOOR, floor))

    def recommended(self, *names: str) -> tuple[str, str]:
        """Return the last model whose gain over the simpler ones is above zero, and why no other.

        A model must close certainly more (95 %, rocks left out) than the one that it is added to,
        and than the one that is recommended without it.
        """
        best, why = names[0], list[str]()
        if not self._found:
            return best, "the observations do not allow a test on held-out rocks"
        for name in names[1:]:
            gains = {
                simpler: found
                for simpler in (self._found[name][0], best)
                if (found := self.gain(simpler, name)) is not None
            }
            uncertain = [(simpler, gain) for simpler, gain in gains.items() if not gain.low > 0.0]
            if not uncertain:
                best, why = name, []
                continue
            simpler, _ = uncertain[-1]
            why.append(phrase("{} over {}", rung_name(name), rung_name(simpler)))
        if not why:
            return best, ""
        nothing = phrase("no certain gain on held-out rocks: {}", joined(", ", why))
        return best, nothing


def needs_contact_law(ladder: Sequence[Rung]) -> bool:
    """Return whether another contact law certainly closes more of the gap than ground only."""
    span = {rung.rung: rung.ci95 for rung in ladder}
    ground, law = span.get("ground"), span.get("contact_law")
    return ground is not None and law is not None and law[0] > ground[1]


def ground_is_enough(ladder: Sequence[Rung]) -> bool:
    """Return whether what calibrated ground leaves of the gap may be chance."""
    return any(r.rung == "ground" and r.ci95 is not None and r.ci95[1] >= 1.0 for r in ladder)


def shrinkage_of(problem: SiteData, base: FloatArray, effect: str, rows: FloatArray) -> Shrinkage:
    """Measure how far the calibrated base's gap shrinks by an effect, on held-out rocks.

    ``base``, ``rows``: replicas of each rock without and with the effect, shape (m, n_rocks, p).
    """
    if not problem.rows.shape[1]:
        nan = float("nan")
        note = "Too few rocks have stops or passages at stations to state a distance."
        return Shrinkage(
            effect=effect, value=None, ci95=None, distance_base=nan, distance_effect=nan,
            distance_floor=nan, by_quantity={}, note=note,
        )  # fmt: skip
    before, after = (RockDistances.of(problem.rows, own) for own in (base, rows))
    value, interval, note = None, None, ""
    if effect != NONE and not before.above_chance:
        note = "No share is stated, because the gap of the calibrated base model may be chance."
    elif effect != NONE:
        rng = np.random.default_rng([problem.seed, 51])
        weights = group_weights(problem.unit, rng, LADDER_SAMPLES)
        drawn = [own.drawn(weights) for own in (before, after)]
        value, interval = share_of(before, after, after.floor, drawn)
    return Shrinkage(
        effect=effect, value=value, ci95=interval, distance_base=before.value(),
        distance_effect=after.value(), distance_floor=after.floor,
        by_quantity=_by_quantity(problem, base, rows), note=note,
    )  # fmt: skip


def _by_quantity(
    problem: SiteData, base: FloatArray, effect: FloatArray
) -> Mapping[str, Mapping[str, float | None]]:
    """Return the same for each single quantity, all stations together."""
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


def see_each(summary: SiteSummary, task: HypothesisDraw) -> FloatArray:
    """Return numbers of the single campaigns of a draw, shape (count, p)."""
    model = draw_of(summary.problem.case, task.effect, task.shares).model
    return summary.of_each(model, task.number, task.count)


def cause_gains(
    summary: SiteSummary, base: FittedHypothesis, families: Sequence[str], run: RunTasks
) -> dict[str, CauseGain]:
    """Return gains of causes beyond a calibrated base; empty where nothing is compared."""
    if base.found is None:
        return {}
    tasks = [
        HypothesisDraw(base.effect, base.shares, CAUSE_NUMBER + k, BASE_CAMPAIGNS)
        for k in range(BASE_PARTS)
    ]
    for family in families:
        tasks += _draws(summary, base, family)
    made = list(run(see_each, tasks))
    campaigns = np.concatenate(made[:BASE_PARTS])
    mean, onto = _directions(summary, base.found, campaigns)
    if not onto.shape[1]:
        return {}

    def seen(numbers: FloatArray) -> FloatArray:
        """Return numbers less those of the base, shape (n, p) to (n, q)."""
        scaled = summary.in_errors(numbers) - mean
        # What is not there is as in the base, and nothing counts more than it can by chance.
        return np.clip(np.nan_to_num(scaled), -12.0, 12.0) @ onto

    observed, chance = seen(summary.observed[None])[0], seen(campaigns)
    # A base that leaves more than chance does everywhere leaves it to any cause.
    excess = max(float(observed @ observed) / float(np.mean((chance**2).sum(axis=1))), 1.0)
    found = {}
    for k, family in enumerate(families):
        rows = slice(BASE_PARTS + k * CAUSE_DRAWS, BASE_PARTS + (k + 1) * CAUSE_DRAWS)
        drawn = np.array([seen(one) for one in made[rows]])
        found[family] = _gain_of(family, observed, chance, drawn, excess, tasks[rows])
    return found


def _draws(summary: SiteSummary, base: FittedHypothesis, family: str) -> list[HypothesisDraw]:
    """Return the base with draws of a cause."""
    effect = "+".join(sorted({*families_of(base.effect), family}))
    tasks, cause = [], CAUSES[family].number
    for k in range(CAUSE_DRAWS):
        rng = np.random.default_rng([summary.problem.seed, 61, cause, k])
        made = draw(summary.problem.case, families_of(effect), ParameterDraws(rng, base.shares))
        number = CAUSE_NUMBER + BASE_PARTS + cause * CAUSE_DRAWS + k
        tasks.append(HypothesisDraw(effect, made.parameter_draws, number, CAUSE_CAMPAIGNS))
    return tasks


def _directions(
    summary: SiteSummary, found: LinearFit, base: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean numbers of the base (p,), and units of chance where no ground follows (p, q).

    Nor does the discrepancy of a law, each with its prior.
    """
    scaled = summary.in_errors(base)
    known = np.isfinite(scaled)
    mean = np.where(known, scaled, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    off = np.where(known, scaled - mean, 0.0)
    # Observed numbers scatter as those of the base, or as the observed rocks themselves.
    covariance = off.T @ off / len(off)
    own = np.maximum(np.diag(covariance), 0.5)
    covariance = (1.0 - OWN_SCATTER) * covariance + OWN_SCATTER * np.diag(own)
    covariance[np.diag_indices_from(covariance)] = own
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    slopes = white @ np.column_stack([found.slopes, law_changes(summary)])
    d = slopes.shape[1]
    basis, _ = np.linalg.qr(np.vstack([slopes, np.eye(d)]), mode="complete")
    return mean, white.T @ basis[: len(slopes), d:]


def _gain_of(
    family: str,
    observed: FloatArray,
    chance: FloatArray,
    draws: FloatArray,
    excess: float,
    tasks: Sequence[HypothesisDraw],
) -> CauseGain:
    """Return ``draws``: shape (DRAWS, EACH, q)."""
    change = _cleaned(draws.mean(axis=1))
    gains = _closed(observed[None], change)[0]
    best = int(np.argmax(gains))
    usual = _closed(chance, change).max(axis=1)
    middle, most = np.quantile(usual, (0.5, 0.95))
    spread = max(float(most - middle), 1.0)
    sureness = (float(gains[best]) / excess - float(middle)) / spread
    found = [
        _closed(own, np.delete(change, k, axis=0)).max(axis=1) / excess
        > middle + SHOWING_GAIN * spread
        for k, own in enumerate(draws)
    ]
    share = float(gains[best] / max(float(observed @ observed), 1e-9))
    return CauseGain(family, share, sureness, float(np.mean(found)), excess, tasks[best].shares)


def _cleaned(change: FloatArray) -> FloatArray:
    """Keep changes in the few directions in which they exceed the chance of two campaigns."""
    n, q = change.shape
    _, size, directions = np.linalg.svd(change, full_matrices=False)
    # Largest singular value of n vectors of only chance (Marchenko and Pastur 1967).
    edge = (np.sqrt(n) + np.sqrt(q)) / np.sqrt(CAUSE_CAMPAIGNS)
    kept = directions[:DIRECTIONS][size[:DIRECTIONS] > edge]
    return np.asarray(change @ kept.T @ kept)


def _closed(seen: FloatArray, change: FloatArray) -> FloatArray:
    """Compute what draws close of the squared distance of some numbers, shape (n, n_draws)."""
    size = np.maximum((change**2).sum(axis=1), 1e-9)
    along = seen @ change.T
    times = np.clip(along / size, 0.0, MOST_CHANGE)
    return np.asarray(times * (2.0 * along - times * size))
