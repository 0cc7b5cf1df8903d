"""Evidence for causes at a site: models without an effect, causes added to them, the answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.causes.trees_cause import losses_at_one_place
from sassgis.gap.constants import (
    CHOSEN_COUNT,
    CONFIGURED_NUMBER,
    LEAST_SHARE,
    PLAUSIBLE_AT_ONCE,
    PLAUSIBLE_FITS,
    REPLICATES,
)
from sassgis.gap.diagnosis import CauseGain, Fingerprint, GapFinding, Rung, Shrinkage, Verdict
from sassgis.gap.fit.hypothesis_fit import (
    CONTACT_LAW,
    NONE,
    UNKNOWN,
    FittedHypothesis,
    HypothesisDraw,
    HypothesisFits,
    draw_of,
    families_to_try,
)
from sassgis.gap.fit.linear_fit import SiteSummary
from sassgis.gap.fit.site_data import model_rows
from sassgis.gap.forward.released_rocks import HypothesisModel, configured_model
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.discrepancy import Discrepancy, without_discrepancy
from sassgis.gap.residuals.residual_table import (
    ResidualTable,
    residuals_with,
    with_configured_paths,
)
from sassgis.gap.verdict.model_comparison import (
    CONFIGURED,
    GROUND,
    Ladder,
    cause_gains,
    ground_is_enough,
    needs_contact_law,
    shrinkage_of,
)
from sassgis.gap.verdict.verdict import (
    CauseWeights,
    Thresholds,
    adequate,
    confidence_of,
    confusion_set,
    decide,
    fingerprints,
    group_probability,
    is_certain,
    most_probable,
    place_of,
    second_of,
    seen_of,
    where,
)
from sassgis.gap.words import effect_key, quantity_name, tested_by
from sassgis.grid import FloatArray
from sassgis.settings.languages import joined, phrase


def configured_as_observed(made: HypothesisFits) -> HypothesisModel:
    """Return the configured model; its rotations are observed as those of calibrated ground.

    What the factor on rotations closes of the gap is closed by no model that is handed over.
    """
    seen = made.add(NONE).handed_over.draw.model.measurement
    return replace(configured_model(made.problem.case), measurement=seen)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Of a base; fingerprints and findings with the surest first."""

    prints: tuple[Fingerprint, ...]
    # Those of calibrated ground, if it leaves nothing that is significant and large, is what the
    # rocks ask for, and a freer contact would leave more.
    findings: tuple[GapFinding, ...]
    #: Whether the base leaves no gap that is significant and large beyond the discrepancy of the
    #: law; and that discrepancy.
    sound: bool
    law: tuple[Discrepancy, ...]
    gains: Mapping[str, CauseGain]  # by family
    notes: tuple[str, ...]  # what else the observations show


def evidence_beyond(
    made: HypothesisFits, base: FittedHypothesis, families: Sequence[str]
) -> Evidence:
    """Compute the remaining gap of a base, and the evidence for causes beyond it."""
    problem = made.problem
    case, residuals = residuals_with(problem.case, base.handed_over.draw.model, seed=problem.seed)
    notes: tuple[str, ...] = ()
    # What no cause explains.
    if (found := losses_at_one_place(residuals)) is not None:
        text = (
            "Measured paths that lose speed above the ground at the same place, about {1} m from "
            "the start: {0}. The terrain model may lack a step or a structure there. These paths "
            "give no evidence of trees."
        )
        notes = (phrase(text, found[0], f"{found[1]:.0f}"),)
    return Evidence(
        fingerprints(case, with_configured_paths(case, residuals)),
        *located(case, residuals, problem.seed),
        cause_gains(made.summary, base, families, made.run),
        notes,
    )


#: Gaps by place, whether none of them is significant and large beyond the discrepancy of the law,
#: and this discrepancy.
Located = tuple[tuple[GapFinding, ...], bool, tuple[Discrepancy, ...]]


def located(case: Case, residuals: ResidualTable, seed: int) -> Located:
    """Locate the gap of a model, and say whether the model is adequate."""
    findings = where(case, residuals, seed=seed)
    if adequate(findings):
        return findings, True, ()
    rows, law = without_discrepancy(residuals.rows)
    beyond = where(case, replace(residuals, rows=rows), seed=seed)
    return findings, adequate(beyond), law


def evidence_of_site(made: HypothesisFits) -> AddedCauses:
    """Return the evidence beyond the base with a free contact, and the models without an effect.

    The base is adequate if one of the calibrations that the rocks leave plausible is: of all values
    of what is not known none may be right, for it to be wrong (R. L. Berger and D. D. Boos, 1994, P
    values maximized over a confidence set for the nuisance parameter, J. Am. Stat. Assoc. 89,
    1012-1016). A free contact may be calibrated less well than the ground alone.
    """
    problem = made.problem
    found = evidence_beyond(made, made.add(CONTACT_LAW), families_to_try(problem.case))
    rows = model_rows(problem, configured_as_observed(made), CONFIGURED_NUMBER, CHOSEN_COUNT)
    ladder = Ladder(problem)
    ladder.add(CONFIGURED, "", rows)
    ladder.add(GROUND, CONFIGURED, made.rows(NONE))
    ladder.add(CONTACT_LAW, GROUND, made.rows(CONTACT_LAW))
    rungs = ladder.rungs(CONFIGURED, GROUND, CONTACT_LAW)
    added = AddedCauses(made, found, ladder, rungs, rows, needs_contact_law(rungs))
    if not found.sound:
        draws = [
            HypothesisDraw(CONTACT_LAW, own.parameter_draws, 0, REPLICATES)
            for own in made.add(CONTACT_LAW).samples(problem.case, PLAUSIBLE_FITS)
        ]
        if added.base != CONTACT_LAW:
            draws.insert(0, HypothesisDraw(NONE, made.add(NONE).shares, 0, REPLICATES))
        if (left := first_adequate(made, draws)) is not None:
            note = phrase(
                "The best calibration with a free contact leaves a significant and large gap. "
                "The base model is therefore another calibration that the rocks allow. Gaps by "
                "place refer to it."
            )
            findings, sound, law = left
            notes = (*found.notes, note)
            found = replace(found, findings=findings, sound=sound, law=law, notes=notes)
    if found.sound and (said := law_in_words(found.law)):
        found = replace(found, notes=(*found.notes, said))
    return replace(added, evidence=found)


def law_in_words(law: Sequence[Discrepancy]) -> str:
    """State the discrepancy of the law that the base needs; "" if no share of it is certain."""
    certain = [one for one in law if abs(one.share) > max(2.0 * one.error, LEAST_SHARE)]
    said = [
        phrase(
            "{} {} % ({})",
            quantity_name(one.quantity),
            f"{100.0 * one.share:+.0f}".replace("-", "\u2212"),
            tested_by(one.test),
        )
        for one in certain
    ]
    text = (
        "After calibration the model differs from these rocks by the same share on the whole "
        "slope: {}. The search for causes starts from there."
    )
    return phrase(text, joined(", ", said)) if said else ""


def first_adequate(made: HypothesisFits, draws: Sequence[HypothesisDraw]) -> Located | None:
    """Locate the gap with the first draw that leaves nothing significant and large, if any."""
    for k in range(0, len(draws), PLAUSIBLE_AT_ONCE):
        left: list[Located] = list(made.run(_left_by, draws[k : k + PLAUSIBLE_AT_ONCE]))
        if (right := next((one for one in left if one[1]), None)) is not None:
            return right
    return None


def _left_by(summary: SiteSummary, task: HypothesisDraw) -> Located:
    """Locate the gap with a draw in place of the base."""
    case, seed = summary.problem.case, summary.problem.seed
    model = draw_of(case, task.effect, task.shares).model
    case, residuals = residuals_with(case, model, seed=seed, replicates=task.count)
    return located(case, residuals, seed)


@dataclass(frozen=True, slots=True)
class AddedCauses:
    """Models without an effect, and causes added to the one that the observed rocks ask for."""

    made: HypothesisFits
    evidence: Evidence  # beyond the base with a free contact
    ladder: Ladder
    rungs: tuple[Rung, ...]  # without an effect
    configured_rows: FloatArray  # of the configured model, shape (FRESH, n_rocks, p)
    needs_law: bool  # whether another law of the contact is needed

    @property
    def base_rungs(self) -> tuple[str, ...]:
        """Rungs without an effect that may be recommended."""
        return (CONFIGURED, GROUND, *([CONTACT_LAW] if self.needs_law else []))

    @property
    def simplest(self) -> str:
        """The last of them whose gain is certain."""
        return self.ladder.recommended(*self.base_rungs)[0]

    @property
    def base(self) -> str:
        """Hypothesis of the base: with another law of the contact if that is certainly better."""
        return CONTACT_LAW if self.simplest == CONTACT_LAW else NONE

    @property
    def rung(self) -> str:
        """The base as a rung of the ladder."""
        return GROUND if self.base == NONE else CONTACT_LAW

    def name(self, effect: str) -> str:
        """Return hypothesis of a rung of the ladder."""
        if effect in (NONE, GROUND):
            return NONE
        return "+".join(sorted({*effect.split("+"), self.base} - {NONE}))

    def fit(self, effect: str) -> FittedHypothesis:
        """Return the base with an effect, calibrated if it is not yet.

        It begins where the base has ended, with the draw of each cause that closes most. What
        fingerprints measure stays as they have it.
        """
        gains = self.evidence.gains
        seen = {f.statistic: f for f in self.evidence.prints if f.observable}
        start: dict[str, float] = {}
        held: dict[str, float] = {}
        for cause in effect.split("+"):
            start |= gains[cause].shares if cause in gains else {}
            held |= CAUSES[cause].measured(seen) if cause in CAUSES else {}
        start |= self.made.add(self.base).shares
        return self.made.add(self.name(effect), start, held)

    def rows(self, effect: str) -> FloatArray:
        """Return rows of every rock by the model it had no weight in."""
        return self.fit(effect).held_out_rows(self.made.problem.part)

    def shrinkage(self, effect: str, without: str = "") -> Shrinkage:
        """Measure how far the gap shrinks by an effect, on rocks left out."""
        before = self.rows(without) if without else self.made.rows(self.base)
        return shrinkage_of(self.made.problem, before, effect, self.rows(effect))


def shares_of(
    evidence: Evidence, families: tuple[str, ...], weights: CauseWeights
) -> dict[str, float]:
    """Return probability of each cause, of "none" and of "unknown"."""
    return weights.shares(evidence.prints, evidence.gains, families, evidence.sound)


def _second(added: AddedCauses, first: str, weights: CauseWeights, frozen: Thresholds) -> str:
    """Return a second cause of which evidence is left once the first is in the model; or ""."""
    case = added.made.problem.case
    families = tuple(name for name in families_to_try(case) if name != first)
    # Only what there is evidence of beyond the base is looked for again.
    sure = {f.effect for f in added.evidence.prints if f.observable and f.z >= frozen.second}
    if sure.isdisjoint(families):
        return ""
    left = evidence_beyond(added.made, added.fit(first), families)
    shares = shares_of(left, families, weights)
    second = second_of(left.prints, shares, frozen)
    if second and CAUSES[second].closes and not is_certain(left.prints, second, frozen):
        closes = added.shrinkage("+".join(sorted([first, second])), without=first).value
        if closes is not None and closes <= 0.0:
            return ""
    return second


def verdict_of(
    added: AddedCauses,
    shares: Mapping[str, float],
    weights: CauseWeights,
    frozen: Thresholds,
    sound: bool,
) -> tuple[Verdict, Shrinkage]:
    """Give the answer, and how far the gap shrinks; ``sound``: the base leaves nothing large."""
    evidence, law = added.evidence, added.needs_law
    enough = ground_is_enough(added.rungs) or evidence.sound
    first = most_probable(evidence.prints, evidence.gains, shares, frozen)
    if first != NONE and shares[first] < min(frozen.calibrated, shares[NONE]):
        first = NONE
    shrinkage = added.shrinkage(first) if first != NONE else _nothing_added(added)
    closes = shrinkage.value if first != NONE and CAUSES[first].closes else None
    effect, group, reason = decide(
        evidence.prints, evidence.gains, shares, sound, closes, frozen, law
    )
    if effect == first and effect != NONE:
        second = _second(added, first, weights, frozen)
        if second:
            effect = "+".join(sorted([first, second]))
            shrinkage = added.shrinkage(effect)
            reason = phrase(
                "{}; with it in the model, a fingerprint of {} remains", reason, effect_key(second)
            )
    elif effect == NONE:
        shrinkage = _nothing_added(added)
    elif first != NONE:
        note = phrase(
            "No effect is named. The share is a bound for {}.",
            effect_key(first),
        )
        shrinkage = replace(shrinkage, note=note)
    fitted = () if effect in (UNKNOWN, CONTACT_LAW) else added.fit(effect).models
    case = added.made.problem.case
    phase, segments = place_of(effect, case, [own.draw for own in fitted], evidence.findings)
    families = families_to_try(case)
    seen = {*seen_of(evidence.prints, evidence.gains, families), *effect.split("+")}
    # The law of the contact is that of the base, whichever families there are.
    none = shares[NONE] if effect == CONTACT_LAW else 0.0
    verdict = Verdict(
        effect=effect, confidence=confidence_of(effect, evidence.prints, shares, frozen),
        confusion_set=confusion_set(effect, frozen.possible, shares), phase=phase,
        segments=segments, reason=reason, probabilities=dict(shares), group=group,
        base=CONTACT_LAW if law or (sound and evidence.law) else GROUND if enough else "unresolved",
        adequate=sound,
        group_probability=group_probability(group, shares) + none,
        cannot_exclude=tuple(n for n in families if n not in seen),
    )  # fmt: skip
    return verdict, shrinkage


def _nothing_added(added: AddedCauses) -> Shrinkage:
    base = added.made.rows(added.base)
    return shrinkage_of(added.made.problem, base, NONE, base)
