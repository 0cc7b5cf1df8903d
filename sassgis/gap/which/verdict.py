"""The answer: from fingerprints and findings to a cause, its group and what is confused."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.diagnosis import Fingerprint, GapFinding, Verdict
from sassgis.gap.observations.case import Case
from sassgis.gap.where.findings import locate
from sassgis.gap.which.hypotheses import Draw

#: Causes besides the families.
NONE, UNKNOWN, CONTACT_LAW = "none", "unknown", "contact_law"
#: Groups of causes and what looks like a second cause where one of them acts, in the order in which
#: they are asked: an error of the instruments shows in all that follows, an error of the start in
#: all below it, a loss on the way turns the path as well.
_FOLLOWS: Mapping[str, tuple[str, ...]] = {
    "instruments": ("start", "along the way", "contact", "sideways"),
    "start": ("sideways",),
    "extra blocks": ("along the way", "contact", "sideways"),
    "along the way": ("contact", "sideways"),
    "contact": ("sideways",),
    "sideways": ("contact",),
}
GROUPS: Mapping[str, tuple[str, ...]] = {
    group: tuple(cause.name for cause in CAUSES.values() if cause.group == group)
    for group in _FOLLOWS
}
#: A gap is large from this share of the scatter of the rocks on (J. Cohen, 1988, Statistical power
#: analysis for the behavioral sciences, p. 26: d = 0.8).
_LARGE = 0.8


@dataclass(frozen=True, slots=True)
class Thresholds:
    """What was set on sites of development, and is frozen for all that is reported.

    Attributes
    ----------
    level : float
        Adjusted p value up to which a fingerprint is significant.
    named : float
        Probability from which a family is named.
    grouped : float
        Probability of all families of a group together from which the group is certain.
    second : float
        z of a second fingerprint, of another group, from which two causes are named.
    covered : float
        Probability of the causes in the confusion set together.
    """

    level: float = 0.01
    named: float = 0.6
    grouped: float = 0.7
    second: float = 6.0
    covered: float = 0.95


def group_of(effect: str) -> str:
    """Group of a cause; of two, that of the first; "" if it has none."""
    first = CAUSES.get(effect.split("+")[0])
    return "" if first is None else first.group


def adequate(findings: Sequence[GapFinding], level: float = 0.05) -> bool:
    """Whether no gap of the calibrated base is both significant and large."""
    return not any(f.p_adjusted <= level and _large(f) for f in findings)


def _large(finding: GapFinding) -> bool:
    low, high = finding.ci95
    scatter = (high - low) / 3.92 * math.sqrt(max(finding.rocks, 1))
    return scatter > 0.0 and abs(finding.gap) > _LARGE * scatter


#: A cause is named only if a fingerprint of its own is seen: one-sided 5 % of a normal deviate.
SEEN = 1.645


def strongest(prints: Sequence[Fingerprint]) -> dict[str, Fingerprint]:
    """The surest fingerprint of each cause that these data can show."""
    best: dict[str, Fingerprint] = {}
    for one in prints:
        if one.observable and (one.effect not in best or one.z > best[one.effect].z):
            best[one.effect] = one
    return best


def significant(prints: Sequence[Fingerprint], level: float) -> dict[str, Fingerprint]:
    """The surest fingerprint of each cause that has a significant one."""
    return {n: f for n, f in strongest(prints).items() if f.p_adjusted <= level and f.z > 0.0}


def second_of(
    first: str,
    prints: Sequence[Fingerprint],
    shares: Mapping[str, float],
    thresholds: Thresholds,
    tried: Sequence[str],
) -> str:
    """A second cause beside the first, whose fingerprint is none of its consequences; "" if none.

    It is more probable than all others together, were the first one none.

    Parameters
    ----------
    first : str
        A family.
    tried : sequence of str
        Families that may be named.
    """
    others = 1.0 - shares.get(first, 0.0)
    sure = {
        name: one
        for name, one in significant(prints, thresholds.level).items()
        if one.z >= thresholds.second and name in tried
    }
    likely = {n for n in sure if shares.get(n, 0.0) > 0.5 * others}
    hidden = {group_of(first), *_FOLLOWS[group_of(first)]}
    for name in sure:
        # What another sure cause brings about by itself is no cause of its own either.
        hidden |= set(_FOLLOWS[group_of(name)]) - {group_of(first)}
    return max(
        (n for n in likely if group_of(n) not in hidden), key=lambda n: sure[n].z, default=""
    )


def decide(
    prints: Sequence[Fingerprint],
    shares: Mapping[str, float],
    findings: Sequence[GapFinding],
    closes_at_most: float | None,
    thresholds: Thresholds,
    law: bool,
) -> tuple[str, str, str]:
    """Answer, its group, and the reason.

    Parameters
    ----------
    shares : mapping
        Probability of each family that may be named and of "none".
    findings : sequence of GapFinding
        Of the calibrated base.
    closes_at_most : float or None
        Upper limit of the shrinkage by the most probable family, on held-out rocks; None where it
        is withheld.
    law : bool
        Whether the base needs another law of the contact.

    Returns
    -------
    effect : str
        "none", "unknown", "contact_law", a family or a pair.
    group : str
        "" for none, and where not even the group is certain.
    reason : str
    """
    tried = [name for name in shares if name != NONE]
    best = strongest(prints)
    first = max(tried, key=lambda n: shares[n], default="")
    seen = first in best and best[first].z >= SEEN
    if seen and shares[first] >= thresholds.named:
        if closes_at_most is not None and closes_at_most < 0.0:
            reason = (
                f"the fingerprints are those of {first.replace('_', ' ')}, but the effect "
                "certainly closes none of the gap on rocks that took no part in its calibration"
            )
            return UNKNOWN, "", reason
        second = second_of(first, prints, shares, thresholds, tried)
        named = "+".join(sorted([first, second])) if second else first
        reason = (
            f"{shares[first]:.0%} probable by its fingerprints; the surest of its own: "
            f"{best[first].statistic} (z = {best[first].z:.1f})"
        )
        return named, group_of(named), reason
    together = {g: sum(shares.get(n, 0.0) for n in names) for g, names in GROUPS.items()}
    group = max(together, key=lambda g: together[g])
    if together[group] >= thresholds.grouped:
        reason = (
            f"a cause of the group {group} is {together[group]:.0%} probable; these data cannot "
            "answer which"
        )
        return UNKNOWN, group, reason
    if adequate(findings):
        reason = (
            "no cause is probable, and no gap of the calibrated base is both significant and large"
        )
        return NONE, "", reason
    if law and shares[NONE] > max((shares[name] for name in tried), default=0.0):
        reason = (
            "the contact follows another law: the motion is shifted in the same way for all sizes, "
            "or it certainly closes more of the gap than any values of the ground"
        )
        return CONTACT_LAW, group_of(CONTACT_LAW), reason
    reason = (
        "gaps are significant and large, and no known cause is probable: these data cannot answer "
        "which"
    )
    return UNKNOWN, "", reason


def confusion_set(effect: str, shares: Mapping[str, float], covered: float) -> tuple[str, ...]:
    """The answer, and the most probable causes until they are together as probable as asked."""
    held = effect.split("+")
    total = 0.0
    for name, share in shares.items():
        if total >= covered:
            break
        total += share
        if name not in held:
            held.append(name)
    return tuple(held)


def place_of(
    effect: str, case: Case, fitted: Sequence[Draw], findings: Sequence[GapFinding]
) -> tuple[str, tuple[str, ...]]:
    """Phase of motion and reaches in which an effect acts.

    Parameters
    ----------
    effect : str
        The answer.
    fitted : sequence of Draw
        Calibrated draws of the effect.
    findings : sequence of GapFinding
        Where the gap lies, for effects without a place of their own.
    """
    if effect == NONE:
        return "", ()
    if effect in (UNKNOWN, CONTACT_LAW):
        return locate(findings)
    first = CAUSES[effect.split("+")[0]]
    return first.phase, first.place(case, [draw.model for draw in fitted])


def confidence_of(effect: str, shares: Mapping[str, float]) -> float:
    """Probability of an answer; NaN where none is given.

    Of the contact law that none of the families is the cause.
    """
    if effect == UNKNOWN:
        return math.nan
    own = (
        NONE if effect == CONTACT_LAW else max(effect.split("+"), key=lambda n: shares.get(n, 0.0))
    )
    return float(min(shares.get(own, 0.0), 0.99))


def verdict_of(
    prints: Sequence[Fingerprint],
    shares: Mapping[str, float],
    closes_at_most: float | None,
    thresholds: Thresholds,
    law: bool,
    enough: bool,
    case: Case,
    fitted: Sequence[Draw],
    findings: Sequence[GapFinding],
) -> Verdict:
    """Put the answer together; parameters as for ``decide`` and ``place_of``.

    ``enough``: whether what calibrated ground leaves of the gap may be chance.
    """
    effect, group, reason = decide(prints, shares, findings, closes_at_most, thresholds, law)
    phase, segments = place_of(effect, case, fitted, findings)
    return Verdict(
        effect,
        confidence_of(effect, shares),
        confusion_set(effect, shares, thresholds.covered),
        phase,
        segments,
        reason,
        dict(shares),
        group,
        CONTACT_LAW if law else "ground" if enough or adequate(findings) else "unresolved",
    )
