"""What a diagnosis answers, in sentences."""

from __future__ import annotations

from collections.abc import Iterable

from sassgis.gap.diagnosis import Diagnosis, GapFinding, Hypothesis, Shrinkage
from sassgis.gap.words import (
    effect_name,
    effect_phrase,
    place_words,
    quantity_name,
    rung_name,
    significance,
    tested_by,
)
from sassgis.model.languages import phrase
from sassgis.model.styles import with_unit
from sassgis.report.page import ReportAnswer, sensible

#: Answers that name no effect.
UNNAMED = ("none", "unknown")

#: Findings that are stated in a sentence.
_STATED = 4
#: What the map shows, if it differs from chance somewhere: reach and energy before the rest.
MATTERS = ("speed_mps", "runout_m", "energy_kept", "height_m", "rotation_hz", "lateral_m")


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The answer in one or two sentences."""
    verdict = diagnosis.verdict
    sure = f"Confidence {100 * verdict.confidence:.0f} %." if verdict.confidence >= 0.0 else ""
    if verdict.group_probability >= 0.0:
        sure = f"{sure} Group “{verdict.group}”: {100 * verdict.group_probability:.0f} %.".strip()
    advice = diagnosis.advice
    if verdict.effect == "none":
        once = "" if advice.recommended == "configured" else "once the ground is calibrated, "
        left = f"is no more than chance among {diagnosis.rocks} rocks"
        if any(gap.counts and gap.side == "unsafe" for gap in advice.left):
            left = "is that of no known cause, and small"
        return (
            f"No effect has to be added: {once}what is left between observed and simulated rocks "
            f"{left}. {sure}"
        ).strip()
    if verdict.effect == "unknown":
        return f"These data cannot answer which cause the gap has. {sure}".strip()
    return f"The gap is best explained by {effect_phrase(verdict.effect)}. {sure}"


def answer(diagnosis: Diagnosis) -> tuple[ReportAnswer, ...]:
    """What the diagnosis says, in sentences."""
    return (
        _why(diagnosis),
        _confused(diagnosis),
        _where(diagnosis.where),
        _how_far(diagnosis.shrinkage, diagnosis.verdict.effect),
        ReportAnswer("What these data do not identify", (), diagnosis.not_identifiable),
    )


def _why(diagnosis: Diagnosis) -> ReportAnswer:
    verdict = diagnosis.verdict
    out = [_sentence(verdict.reason)] if verdict.reason else []
    if verdict.phase or verdict.segments:
        place = " and ".join(place_words(s) for s in verdict.segments)
        acts = f"It acts in the phase “{verdict.phase}”" if verdict.phase else "It acts"
        out.append(f"{acts}{' ' + place if place else ''}.")
    recommended = diagnosis.advice.recommended
    if verdict.effect not in UNNAMED and not {*recommended.split("+")} >= {
        *verdict.effect.split("+")
    }:
        out.append(
            f"It is named, but not recommended: what is handed over has {rung_name(recommended)}."
        )
    if verdict.effect != "unknown":
        out.append(
            "The confidence is that of synthetic sites of several laws of motion. Take the answer "
            "as what to look at first, not as found."
        )
    named = hypothesis_of(diagnosis.which, verdict.effect)
    if named is not None and verdict.effect not in ("none", "unknown", "contact_law"):
        interval = (
            f"(95 % interval {interval_text(named.ci95)}; the score of the calibrated base model "
            f"is {sensible(named.score + named.gain)})"
        )
        if named.gain > 0.0:
            gain = sensible(named.gain)
            out.append(f"With it, single held-out rocks are predicted better by {gain} {interval}.")
        else:
            out.append(
                f"Single held-out rocks are not predicted better with it {interval}: the evidence "
                "for it is in patterns over all rocks, such as trends, scatter and single impacts."
            )
    return ReportAnswer("How sure this is", tuple(out))


def hypothesis_of(which: Iterable[Hypothesis], effect: str) -> Hypothesis | None:
    """The hypothesis of an effect; None if it was not tried."""
    return next((c for c in which if c.effect == effect), None)


def _confused(diagnosis: Diagnosis) -> ReportAnswer:
    verdict = diagnosis.verdict
    others = [e for e in verdict.confusion_set if e != verdict.effect]
    names = ", ".join(effect_name(e) for e in others)
    sentences = ["None of the other explanations that were tried remains possible."]
    if others:
        sentences = [f"These data do not separate it from: {names}."]
    if verdict.cannot_exclude:
        unseen = ", ".join(effect_name(e) for e in verdict.cannot_exclude)
        sentences.append(f"Neither seen nor excluded, as these data could not show it: {unseen}.")
    if diagnosis.measure_next:
        sentences.append(f"What would {'separate them' if others else 'make it surer'}:")
    return ReportAnswer("What it may be mistaken for", tuple(sentences), diagnosis.measure_next)


def finding_sentence(finding: GapFinding) -> str:
    """A finding as a reader wants it: where, what, how much, how sure."""
    more = "more" if finding.gap > 0.0 else "less"
    low, high = sorted(abs(v) for v in finding.ci95)
    both = finding.ci95[0] * finding.ci95[1] > 0.0
    span = f"{sensible(low, 2)} to {sensible(high, 2)}"
    if not both:
        span = interval_text(finding.ci95, digits=2)
    name, unit = capital(quantity_name(finding.quantity)), finding.unit
    return (
        f"{name} {place_words(finding.place)}: observed "
        f"{with_unit(sensible(finding.observed), unit)}, predicted "
        f"{with_unit(sensible(finding.predicted), unit)}, that is "
        f"{with_unit(sensible(abs(finding.gap), 2), unit)} {more} "
        f"(95 % interval {span}; {finding.rocks} rocks; {tested_by(finding.test)}; "
        f"p {p_text(finding.p_adjusted)})."
    )


def _where(findings: tuple[GapFinding, ...]) -> ReportAnswer:
    heading = "Where the gap lies"
    if not findings:
        return ReportAnswer(heading, ("Nothing could be compared place by place.",))
    sure = [f for f in findings if significance(f) == "sure"]
    likely = [f for f in findings if significance(f) == "likely"]
    if not sure:
        text = (
            f"Of {len(findings)} comparisons by place, phase and quantity none is significant "
            "after adjustment for their number: the gap, if there is one, cannot be placed."
        )
        if likely:
            text += f" {len(likely)} are likely (see the figure)."
        return ReportAnswer(heading, (text,))
    stated = _one_per_quantity(sure)[:_STATED]
    text = (
        f"{len(sure)} of {len(findings)} comparisons are significant after adjustment for their "
        "number"
        + (f", {len(likely)} more are likely" if likely else "")
        + (". The most certain, one of each quantity:" if len(sure) > len(stated) else ":")
    )
    return ReportAnswer(heading, (text,), tuple(finding_sentence(f) for f in stated))


def _one_per_quantity(findings: Iterable[GapFinding]) -> list[GapFinding]:
    """The most certain finding of each quantity; those that matter most for the hazard first."""
    found: dict[str, GapFinding] = {}
    for finding in sorted(findings, key=lambda f: f.p_adjusted):
        found.setdefault(finding.quantity, finding)
    order = [q for q in MATTERS if q in found] + [q for q in found if q not in MATTERS]
    return [found[q] for q in order]


def _how_far(shrinkage: Shrinkage, effect: str) -> ReportAnswer:
    heading = "How far the gap shrinks"
    left = (
        f"Energy distance to the observed rocks: {sensible(shrinkage.distance_base)} with the "
        f"calibrated base model, {sensible(shrinkage.distance_effect)} with "
        f"{effect_name(shrinkage.effect)}, {sensible(shrinkage.distance_floor)} is the least that "
        "chance leaves."
    )
    note = (_sentence(shrinkage.note),) if shrinkage.note else ()
    if effect in UNNAMED:
        base = (
            f"No effect was named that could be added. The energy distance of the calibrated base "
            f"model to the observed rocks is {sensible(shrinkage.distance_base)}; "
            f"{sensible(shrinkage.distance_floor)} is the least that chance leaves."
        )
        return ReportAnswer(heading, (base, *(note if effect == "none" else ())))
    if shrinkage.value is None:
        first = (
            "By what share the gap shrinks is not given, as the gap itself is not certainly above "
            "what chance leaves."
        )
    else:
        span = ""
        if shrinkage.ci95 is not None:
            low, high = map(_share, shrinkage.ci95)
            span = f" (95 % interval {low} to {high})"
        first = (
            f"With {effect_name(shrinkage.effect)} added, {_share(shrinkage.value)} of the gap "
            f"that is not chance closes{span}, on rocks left out of the calibration."
        )
    return ReportAnswer(heading, (first, left, *note))


def _sentence(text: str) -> str:
    text = capital(text.strip())
    return text if text.endswith((".", "!", "?")) else text + "."


def capital(text: str) -> str:
    """A text with its first letter as a capital."""
    return text[:1].upper() + text[1:]


def _share(value: float) -> str:
    return f"{100 * value:.0f} %".replace("-", "\u2212")


def interval_text(span: tuple[float, float], digits: int = 3) -> str:
    """An interval, low to high."""
    # Not to be broken at the end of a line.
    return phrase("{}\u00a0to\u00a0{}", *(sensible(v, digits) for v in span))


def p_text(value: float) -> str:
    """A p-value, or that it is below a thousandth."""
    return "< 0.001" if value < 0.001 else f"{value:.2g}"
