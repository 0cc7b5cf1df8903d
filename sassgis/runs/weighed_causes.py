"""Causes weighed by fingerprints and gains, calibrated as far as that takes, and the answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.diagnosis import Fingerprint, GapFinding, Shrinkage, Verdict
from sassgis.gap.ladder.hypothesis_fit import FittedHypothesis
from sassgis.gap.ladder.rungs import GROUND, Ladder, Step, shrinkage_of
from sassgis.gap.residuals.table import residuals_with
from sassgis.gap.which.cause_weights import CauseWeights, gain_ratio, with_gains
from sassgis.gap.which.fingerprints import fingerprints
from sassgis.gap.which.hypotheses import NONE, families_to_try
from sassgis.gap.which.verdict import (
    CONTACT_LAW,
    UNKNOWN,
    Thresholds,
    adequate,
    confidence_of,
    confusion_set,
    decide,
    group_probability,
    place_of,
    second_of,
    seen_of,
    significant,
)
from sassgis.model.grid import FloatArray
from sassgis.runs.hypothesis_fits import HypothesisFits

#: Effects that are calibrated in any case, the most probable ones.
_FURTHER = 2


@dataclass(frozen=True, slots=True)
class AddedCauses:
    """Causes added to the base that the contact asks for: ground, or another law of the contact."""

    made: HypothesisFits
    law: bool

    @property
    def base(self) -> str:
        """Hypothesis of the base."""
        return CONTACT_LAW if self.law else NONE

    @property
    def rung(self) -> str:
        """The base as a rung of the ladder."""
        return CONTACT_LAW if self.law else GROUND

    def name(self, effect: str) -> str:
        """Hypothesis of a rung of the ladder."""
        if effect in (NONE, GROUND):
            return NONE
        return "+".join(sorted({*effect.split("+"), *([CONTACT_LAW] if self.law else [])}))

    def fit(self, effect: str) -> FittedHypothesis:
        """The base with an effect, calibrated if it is not yet."""
        self.made.add(self.name(effect))
        return self.made.fits[self.name(effect)]

    def rows(self, effect: str) -> FloatArray:
        """Rows of every rock by the model it had no weight in."""
        return self.fit(effect).held_out_rows(self.made.problem.part)

    def shrinkage(self, effect: str, without: str = "") -> Shrinkage:
        """How far the gap shrinks by an effect, on rocks left out."""
        before = self.rows(without) if without else self.made.rows(self.base)
        return shrinkage_of(self.made.problem, before, effect, self.rows(effect))


@dataclass(frozen=True, slots=True)
class Weighed:
    """Causes by fingerprints and gains.

    Attributes
    ----------
    by_prints, shares : mapping
        Probability of each cause that could be seen and of "none": by fingerprints, and with gains.
    ratios : mapping
        Of the gains, by calibrated cause.
    """

    by_prints: Mapping[str, float]
    shares: Mapping[str, float]
    ratios: Mapping[str, float]


def weighed_causes(
    added: AddedCauses,
    ladder: Ladder,
    prints: Sequence[Fingerprint],
    weights: CauseWeights,
    frozen: Thresholds,
) -> Weighed:
    """Weigh causes; the most probable ones are calibrated, until the first has been."""
    by_prints = weights.shares(prints, seen_of(prints, families_to_try(added.made.problem.case)))
    ratios: dict[str, float] = {}
    due = [name for name in by_prints if name != NONE][:_FURTHER]
    while True:
        for name in due:
            ladder.add(Step(name, added.rung, added.rows(name)))
            gain = ladder.gain(added.rung, name)
            ratios[name] = (
                gain_ratio(gain[0].value, gain[1], ladder.gap(added.rung))
                if gain is not None and CAUSES[name].closes
                else 1.0
            )
        shares = with_gains(by_prints, ratios)
        first = next((name for name in shares if name != NONE), "")
        if not first or first in ratios or shares[first] < frozen.named:
            return Weighed(by_prints, shares, ratios)
        due = [first]


def _second(
    added: AddedCauses,
    first: str,
    prints: Sequence[Fingerprint],
    shares: Mapping[str, float],
    weights: CauseWeights,
    frozen: Thresholds,
) -> str:
    """A second cause beside the first: its fingerprint is left once the first is in the model."""
    sure = significant(prints, frozen.level)
    if not any(sure[n].z >= frozen.second for n in shares if n in sure and n != first):
        return ""
    problem = added.made.problem
    model = added.fit(first).handed_over.draw.model
    case, residuals = residuals_with(problem.case, model, seed=problem.seed)
    left = [one for one in fingerprints(case, residuals, group=case.group) if one.effect != first]
    others = seen_of(left, [name for name in families_to_try(case) if name != first])
    second = second_of(first, left, weights.shares(left, others), frozen)
    if second and CAUSES[second].closes:
        closes = added.shrinkage("+".join(sorted([first, second])), without=first).value
        if closes is not None and closes <= 0.0:
            return ""
    return second


def verdict_of(
    added: AddedCauses,
    weighed: Weighed,
    prints: Sequence[Fingerprint],
    weights: CauseWeights,
    frozen: Thresholds,
    law: bool,
    sound: bool,
    enough: bool,
    findings: Sequence[GapFinding],
) -> tuple[Verdict, Shrinkage]:
    """The answer, and how far the gap shrinks by what is named.

    ``law``: whether the contact obeys another law; ``sound``: whether the calibrated base leaves
    nothing that is significant and large; ``enough``: whether what it leaves may be chance.
    """
    problem, shares = added.made.problem, weighed.shares
    first = next((name for name in shares if name in weighed.ratios), NONE)
    shrinkage = added.shrinkage(first) if first != NONE else _nothing_added(added)
    closes = shrinkage.value if first != NONE and CAUSES[first].closes else None
    effect, group, reason = decide(prints, shares, sound, closes, frozen, law)
    if effect == first and effect != NONE:
        second = _second(added, first, prints, shares, weights, frozen)
        if second:
            effect = "+".join(sorted([first, second]))
            shrinkage = added.shrinkage(effect)
            reason += f"; with it in the model, a fingerprint of {second.replace('_', ' ')} is left"
    elif effect == NONE:
        shrinkage = _nothing_added(added)
    elif first != NONE:
        note = f"No effect is named; this is of {first.replace('_', ' ')}, as a bound."
        shrinkage = replace(shrinkage, note=note)
    fitted = () if effect in (UNKNOWN, CONTACT_LAW) else added.fit(effect).models
    case = problem.case
    phase, segments = place_of(effect, case, [own.draw for own in fitted], findings)
    least = frozen.possible["impacts" if len(case.observations.impacts) else "otherwise"]
    verdict = Verdict(
        effect,
        confidence_of(effect, shares, frozen.right),
        confusion_set(effect, least, shares, weighed.by_prints),
        phase,
        segments,
        reason,
        dict(shares),
        group,
        CONTACT_LAW if law else "ground" if enough or adequate(findings) else "unresolved",
        # The law of the contact is that of the base, whichever families there are.
        group_probability(group, shares) + (shares[NONE] if effect == CONTACT_LAW else 0.0),
        tuple(name for name in families_to_try(case) if name not in shares),
    )
    return verdict, shrinkage


def _nothing_added(added: AddedCauses) -> Shrinkage:
    base = added.made.rows(added.base)
    return shrinkage_of(added.made.problem, base, NONE, base)
