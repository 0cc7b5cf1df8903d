"""Answer of a diagnosis, in sentences."""

from __future__ import annotations

from collections.abc import Iterable

from sassgis.gap import words
from sassgis.gap.diagnosis import Diagnosis, GapFinding, Hypothesis, Shrinkage
from sassgis.report.page import ReportAnswer, sensible
from sassgis.settings.languages import Phrase, all_of, capital, joined, phrase
from sassgis.settings.styles import with_unit

#: Answers that name no effect.
UNNAMED = ("none", "unknown")

#: Findings that are stated in a sentence.
_STATED = 4
#: What the map shows, if it differs from chance somewhere: reach and energy before the rest.
MATTERS = ("speed_mps", "runout_m", "energy_kept", "height_m", "rotation_hz", "lateral_m")


def verdict_sentence(diagnosis: Diagnosis) -> Phrase:
    """Return the certainty of the answer and the causes that are not testable."""
    verdict = diagnosis.verdict
    out = _of_named(diagnosis) if verdict.named else [_unnamed(diagnosis)]
    if verdict.group_probability >= 0.0 and not verdict.named:
        share = f"{100 * verdict.group_probability:.0f}"
        out.append(phrase("Group “{}”: {} %.", phrase(verdict.group), share))
    if diagnosis.not_testable:
        out.append(phrase(diagnosis.not_testable))
    return joined(" ", out)


def _of_named(diagnosis: Diagnosis) -> list[Phrase]:
    """Return what qualifies a named cause."""
    verdict, by = diagnosis.verdict, diagnosis.shrinkage
    out = []
    if "measurement_error" in verdict.named:
        out.append(phrase("This error lies in the observations."))
        out += _scaled(hypothesis_of(diagnosis.which, verdict.effect))
    if by.effect == verdict.effect and by.value is not None and by.value <= 0.0:
        out.append(phrase("Adding the effect does not close the gap on held-out rocks."))
    elif by.effect == verdict.effect and by.ci95 is not None and by.ci95[0] <= 0.0:
        text = "It is not certain that adding the effect closes the gap on held-out rocks."
        out.append(phrase(text))
    return out


def _scaled(named: Hypothesis | None) -> list[Phrase]:
    """Return the factor of the observed speeds, if it is significant."""
    scale = None if named is None else named.parameters.get("scale")
    low, high = (1.0, 1.0) if named is None else named.intervals.get("scale", (1.0, 1.0))
    if scale is None or low <= 1.0 <= high:
        return []
    if low == high:
        return [phrase("Observed speeds are {} times the true ones.", sensible(scale))]
    said = "Observed speeds are {} times the speeds that fit the other data (95 %: {})."
    return [phrase(said, sensible(scale), interval_text((low, high)))]


def _unnamed(diagnosis: Diagnosis) -> Phrase:
    verdict, advice = diagnosis.verdict, diagnosis.advice
    if verdict.effect == "unknown":
        return phrase("These data do not show the cause of the gap.")
    if verdict.effect == "contact_law":
        text = "These data show no other probable cause than {}."
        return phrase(text, words.effect_phrase(verdict.effect))
    left = phrase("The remaining differences are within chance ({} rocks).", diagnosis.rocks)
    if any(gap.counts and gap.side == "unsafe" for gap in advice.left) or any(
        words.significance(finding) == "sure" for finding in diagnosis.where
    ):
        left = phrase("The remaining differences are within the scatter of single rocks.")
    if any(gap.counts and gap.is_far for gap in advice.left):
        left = phrase("Large differences remain without a known cause.")
    text = "After calibration no missing effect is detectable. {}"
    if advice.recommended == "configured":
        text = "No missing effect is detectable. {}"
    elif advice.recommended == "contact_law":
        text = "After calibration of the contact law no missing effect is detectable. {}"
    sure = phrase("Confidence {} %.", f"{100 * verdict.confidence:.0f}")
    return joined(" ", (phrase(text, left), sure))


def answer(diagnosis: Diagnosis) -> tuple[ReportAnswer, ...]:
    """Put the result of the diagnosis into sentences."""
    return (
        _why(diagnosis),
        _ranked(diagnosis),
        ReportAnswer("What to measure next", (), diagnosis.measure_next),
        _where("Where the gap lies with the configured model", diagnosis.where_configured),
        _where("Where the gap lies after calibration", diagnosis.where),
        _how_far(diagnosis),
        ReportAnswer("Not identifiable with these data", (), diagnosis.not_identifiable),
    )


def _why(diagnosis: Diagnosis) -> ReportAnswer:
    verdict = diagnosis.verdict
    out: list[str] = [_sentence(verdict.reason)] if verdict.reason else []
    if verdict.named and (verdict.phase or verdict.segments):
        place = all_of(words.place_words(s) for s in _stretches(verdict.segments))
        acts = phrase("It acts")
        if verdict.phase:
            acts = phrase("It acts in the phase “{}”", phrase(verdict.phase))
        out.append(phrase("{}.", joined(" ", filter(None, (acts, place)))))
    recommended = diagnosis.advice.recommended
    missing = {*verdict.effect.split("+")} - {*recommended.split("+")}
    if verdict.effect not in UNNAMED and missing:
        text = "The diagnosis names it but does not recommend it. The calibrated model contains {}."
        out.append(phrase(text, words.file_has(recommended)))
    if verdict.effect != "unknown":
        out.append(
            "The confidence was measured on synthetic sites. Treat this as a lead, not a finding."
        )
    if not verdict.named and verdict.confidence < verdict.ranked.get(verdict.effect, 0.0):
        out.append(
            "The confidence is lower than the probability in the list of causes: it is limited to "
            "the share of synthetic sites at which this answer was right."
        )
    tried = hypothesis_of(diagnosis.which, verdict.effect)
    if tried is not None and verdict.named:
        interval = phrase(
            "(95 % interval {}; the score of the calibrated base model is {})",
            interval_text(tried.ci95),
            sensible(tried.score + tried.gain),
        )
        if tried.gain > 0.0:
            text = "It improves the score of single held-out rocks by {} {}."
            out.append(phrase(text, sensible(tried.gain), interval))
        else:
            text = (
                "It does not improve the score of single held-out rocks {}. The evidence comes "
                "from all rocks together: trends, scatter and single impacts."
            )
            out.append(phrase(text, interval))
    return ReportAnswer("How sure this is", tuple(out))


def _stretches(segments: Iterable[str]) -> list[str]:
    """Return reaches that follow each other, as one."""
    out: list[str] = []
    for own in segments:
        before, (upper, _, lower) = out[-1] if out else "", own.partition("-")
        # Names of stations that have a dash cannot be taken apart.
        if before.partition("-")[2] == upper and (before + own).count("-") == 2:
            out[-1] = f"{before.partition('-')[0]}-{lower}"
        else:
            out.append(own)
    return out


def hypothesis_of(which: Iterable[Hypothesis], effect: str) -> Hypothesis | None:
    """Return the hypothesis of an effect; None if it was not tried."""
    return next((c for c in which if c.effect == effect), None)


def _ranked(diagnosis: Diagnosis) -> ReportAnswer:
    """Rank the causes by probability, and state what is not separated from the answer."""
    verdict = diagnosis.verdict
    points = tuple(
        phrase(
            "{}: {} %", capital(words.effect_name(name)), f"{100.0 * min(p, words.MOST_SURE):.0f}"
        )
        for name, p in verdict.ranked.items()
        if p >= words.LISTED
    )
    sentences: list[str] = []
    if others := verdict.rivals:
        possible = "Also possible: {}."
        if verdict.effect == "unknown":
            possible = "Still possible: {}."
        sentences.append(phrase(possible, effect_names(others)))
    elif verdict.effect == "unknown":
        sentences.append("These data show no probable cause.")
    elif diagnosis.not_testable:
        sentences.append("These data show no other probable cause.")
    else:
        sentences.append("All other tested explanations are ruled out.")
    return ReportAnswer("Causes, most likely first", tuple(sentences), points)


def effect_names(effects: Iterable[str]) -> Phrase:
    """Return names of causes, in a row."""
    return joined(", ", map(words.effect_name, effects))


def finding_sentence(finding: GapFinding) -> Phrase:
    """Return a finding as a reader wants it: where, what, how much, how sure."""
    more = phrase("more" if finding.gap > 0.0 else "less")
    low, high = sorted(abs(v) for v in finding.ci95)
    both = finding.ci95[0] * finding.ci95[1] > 0.0
    span = phrase("{} to {}", sensible(low, 2), sensible(high, 2))
    if not both:
        span = interval_text(finding.ci95, digits=2)
    name, unit = capital(words.quantity_name(finding.quantity)), finding.unit
    return phrase(
        "{} {}: observed {}, predicted {}, {} {} (95 % interval {}; {} rocks; {}; p {}).",
        name,
        words.place_words(finding.place),
        with_unit(sensible(finding.observed), unit),
        with_unit(sensible(finding.predicted), unit),
        with_unit(sensible(abs(finding.gap), 2), unit),
        more,
        span,
        finding.rocks,
        words.tested_by(finding.test),
        p_text(finding.p_adjusted),
    )


def _where(heading: str, findings: tuple[GapFinding, ...]) -> ReportAnswer:
    if not findings:
        return ReportAnswer(heading, ("No place has enough data for a comparison.",))
    sure = [f for f in findings if words.significance(f) == "sure"]
    likely = [f for f in findings if words.significance(f) == "likely"]
    if not sure:
        none = (
            "None of {} comparisons by place, phase and quantity is significant after adjustment "
            "for their number. The gap cannot be located."
        )
        text = phrase(none, len(findings))
        if likely:
            seen = phrase("{} of them are likely (see the figure).", len(likely))
            text = joined(" ", (text, seen))
        return ReportAnswer(heading, (text,))
    stated = _one_per_quantity(sure)[:_STATED]
    some = "{} of {} comparisons are significant after adjustment for their number"
    text = phrase(some, len(sure), len(findings))
    if likely:
        text = phrase("{}, {} more are likely", text, len(likely))
    more = len(sure) > len(stated)
    text = phrase("{}. The most certain one of each quantity:" if more else "{}:", text)
    return ReportAnswer(heading, (text,), tuple(finding_sentence(f) for f in stated))


def _one_per_quantity(findings: Iterable[GapFinding]) -> list[GapFinding]:
    """Return most certain finding of each quantity; those that matter most for the hazard first."""
    found: dict[str, GapFinding] = {}
    for finding in sorted(findings, key=lambda f: f.p_adjusted):
        found.setdefault(finding.quantity, finding)
    order = [q for q in MATTERS if q in found] + [q for q in found if q not in MATTERS]
    return [found[q] for q in order]


def nothing_changed(diagnosis: Diagnosis) -> bool:
    """Return whether no effect was added and the configured ground is kept."""
    return not diagnosis.verdict.named and diagnosis.advice.recommended == "configured"


def _how_far(diagnosis: Diagnosis) -> ReportAnswer:
    heading, shrinkage = "How far the gap shrinks", diagnosis.shrinkage
    if nothing_changed(diagnosis):
        return ReportAnswer(heading)
    said = _of_recommended(diagnosis)
    effect = words.effect_name(shrinkage.effect)
    if diagnosis.verdict.named:
        if shrinkage.value is not None:
            text = (
                "On held-out rocks, adding {} closes {} of the gap that remains beyond chance "
                "after calibration{}."
            )
            said.append(phrase(text, effect, _share(shrinkage.value), _span(shrinkage)))
        if shrinkage.note:
            said.append(_sentence(shrinkage.note))
    elif shrinkage.ci95 is not None and shrinkage.ci95[0] > 0.0:
        text = (
            "{} would close another {}{}. Another contact law may close as much, so this does "
            "not prove a cause."
        )
        said.append(phrase(text, effect, _share(shrinkage.value or 0.0), _span(shrinkage)))
    return ReportAnswer(heading, tuple(said))


def _of_recommended(diagnosis: Diagnosis) -> list[Phrase]:
    """Return what the recommended model closes of the gap of the configured one."""
    ladder = diagnosis.ladder
    rung = next((r for r in ladder if r.rung == diagnosis.advice.recommended), None)
    if rung is None or rung.rung == "configured":
        return []
    if words.is_chance(ladder[0], ladder):
        return [phrase("The gap of the configured model is not distinguishable from chance.")]
    name = capital(words.rung_name(rung.rung))
    if rung.share is None or (rung.ci95 is not None and rung.ci95[0] <= 0.0):
        return [phrase("{} does not reliably reduce the gap of the configured model.", name)]
    span = phrase("")
    if rung.ci95 is not None:
        span = phrase(" (95 % interval {} to {})", *map(_share, rung.ci95))
    text = "{} closes {} of the gap of the configured model on held-out rocks{}."
    said = [phrase(text, name, _share(rung.share), span)]
    if words.is_chance(rung, ladder):
        said.append(phrase("The remaining gap is not distinguishable from chance."))
    return said


def _span(shrinkage: Shrinkage) -> Phrase:
    """Return the interval of a share, in brackets."""
    if shrinkage.ci95 is None:
        return phrase("")
    return phrase(" (95 % interval {} to {})", *map(_share, shrinkage.ci95))


def _sentence(text: str) -> Phrase:
    own = capital(text)
    return own if own.endswith((".", "!", "?")) else phrase("{}.", own)


def _share(value: float) -> str:
    return f"{words.closed_percent(value):.0f} %".replace("-", "\u2212")


def interval_text(span: tuple[float, float], digits: int = 3) -> Phrase:
    """Return an interval, low to high."""
    # Not to be broken at the end of a line.
    return phrase("{}\u00a0to\u00a0{}", *(sensible(v, digits) for v in span))


def p_text(value: float) -> str:
    """Return a p-value, or that it is below a thousandth."""
    return "< 0.001" if value < 0.001 else f"{value:.2g}"
