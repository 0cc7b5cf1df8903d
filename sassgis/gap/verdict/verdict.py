"""Findings by place; tests of fingerprints; the cause, its group and its rivals.

A fingerprint is one number per rock (or per group of rocks); its z is that of the mean over the
groups, with the errors of measurement, of the comparison, and of stated errors that may be wrong
taken off before. No synthetic site is needed for it. The p values are those of Student's t over
groups, adjusted for the number of fingerprints (Holm 1979).

Every cause is weighed alike: a few numbers say what its surest fingerprint counts, of those that no
contact can leave and of the others, and what its gain counts. They were fitted on sites of several
generators (``data/gap_thresholds.json``); each was judged by numbers that never saw it
(docs/studies/gap_weights.md). What a contact could leave may come from a law of the contact that
the base lacks: by itself it makes a cause likely, and never names one.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats
from scipy.special import softmax

from sassgis.gap.causes.all_causes import CAUSES, GROUPS
from sassgis.gap.causes.cause import Scores, Unseen
from sassgis.gap.constants import (
    BEGINNING_SHARE,
    FINDING_ROCKS,
    FINGERPRINT_ROCKS,
    LARGE_GAP,
    LEVEL,
    MOST_Z,
    NAMED_POWER,
    PRINTED_Z,
    SHARE_UNIT,
    SHOWING_GAIN,
    Z_UNIT,
)
from sassgis.gap.diagnosis import CauseGain, Fingerprint, GapFinding, Range
from sassgis.gap.fit.distances import times_drawn
from sassgis.gap.fit.hypothesis_fit import CONTACT_LAW, NONE, UNKNOWN, Draw
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.gap.residuals.rock_residuals import (
    Residual,
    false_discovery_adjusted,
    holm_adjusted,
    mean_gap_tests,
    per_rock,
    t_statistics,
)
from sassgis.gap.words import effect_key
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.languages import joined, phrase
from sassgis.settings.results import TraceSet
from sassgis.terrain.flatten import chainage_to_xy


def where(
    case: Case, residuals: ResidualTable, *, seed: int, draws: int = 999
) -> tuple[GapFinding, ...]:
    """Find where observation and model differ, most certain first; few rocks say nothing."""
    rng = np.random.default_rng([seed, 33])
    unit = case.unit
    tested = [(r, r.tested()) for r in residuals.rows]
    tested = [(r, v) for r, v in tested if int(np.isfinite(v).sum()) >= FINDING_ROCKS]
    if not tested:
        return ()
    values = np.column_stack([v for _, v in tested])
    t, p, adjusted = mean_gap_tests(values, draws=draws, rng=rng, unit=unit)
    q = false_discovery_adjusted(p)
    # A scatter known from above only is tested by scores that may all be zero.
    size = np.abs(np.nan_to_num(t, posinf=np.inf, neginf=-np.inf))
    times = times_drawn(unit, rng, draws)
    findings = [
        _finding(case, r, values[:, i], float(adjusted[i]), float(q[i]), times)
        for i, (r, _) in enumerate(tested)
    ]
    order = np.lexsort((-size, adjusted))
    return tuple(findings[i] for i in order.tolist())


def _finding(
    case: Case, residual: Residual, tested: FloatArray, adjusted: float, q: float, times: FloatArray
) -> GapFinding:
    own = np.isfinite(tested)
    weight = np.ones(int(own.sum())) if residual.weight is None else residual.weight[own]
    gap = residual.gap[own]
    x, y = _on_map(case, residual, own)
    return GapFinding(
        place=residual.place, phase=residual.phase, quantity=residual.quantity,
        gap=float(np.average(gap, weights=weight)), unit=residual.unit,
        ci95=_interval(gap, weight, times[:, own]), p_adjusted=adjusted, q_value=q,
        rocks=int(own.sum()), observed=float(np.average(residual.observed[own], weights=weight)),
        predicted=float(np.average(residual.predicted[own], weights=weight)), test=residual.test,
        s0_m=residual.s0_m, s1_m=residual.s1_m, x=x, y=y,
        values=max(residual.steps, int(own.sum())),
    )  # fmt: skip


def _interval(gap: FloatArray, weight: FloatArray, times: FloatArray) -> Range:
    """Return percentiles of the mean over rocks; ``times``: how often each was drawn."""
    below = times @ weight
    drawn = below > 0.0
    if not drawn.any():
        return math.nan, math.nan
    means = (times @ (weight * gap))[drawn] / below[drawn]
    low, high = np.quantile(means, (0.025, 0.975)).tolist()
    return low, high


def _on_map(case: Case, residual: Residual, own: np.ndarray) -> tuple[float, float]:
    """Return the mean over the lines of the rocks of the point in the middle of the place."""
    lines = np.unique(case.line[own & (case.line >= 0)])
    if not lines.size:
        return math.nan, math.nan
    last = case.traces.s[case.traces.offset[lines + 1] - 1]
    s = np.full(lines.size, 0.5 * (residual.s0_m + residual.s1_m))
    if residual.place in case.station_names:
        k = case.station_names.index(residual.place)
        crossed = case.stations[lines, case.station_order[k]]
        s = np.where(np.isfinite(crossed), crossed, s)
    x, y = chainage_to_xy(case.traces, lines, np.clip(s, 0.0, last))
    known = np.isfinite(x)
    if not known.any():
        return math.nan, math.nan
    return float(x[known].mean()), float(y[known].mean())


def locate(findings: Sequence[GapFinding]) -> tuple[str, tuple[str, ...]]:
    """Return the phase ("": nothing is certain) and reaches (may be none) in which the gap begins.

    Single steps say most, reaches more than runs from the release: what is wrong in a single step
    is wrong where it is made.
    """
    sure = [f for f in findings if f.p_adjusted < LEVEL]
    phase = ""
    for test in ("one step", "reach", "free run"):
        own = [f for f in sure if f.test == test]
        if not own:
            continue
        phase = phase or own[0].phase
        if test == "one step" or phase == "release":
            own = [f for f in own if f.phase == phase]
        own = [f for f in own if "-" in f.place and f.s0_m < f.s1_m]
        strongest = max((_strength(f) for f in own), default=0.0)
        reaches = {f.place: f.s0_m for f in own if _strength(f) >= BEGINNING_SHARE * strongest}
        if reaches:
            return phase, tuple(sorted(reaches, key=lambda name: reaches[name]))
    return phase, ()


def _strength(finding: GapFinding) -> float:
    """Return the gap over its standard error."""
    low, high = finding.ci95
    return abs(finding.gap) / (high - low) if high > low else math.inf


def line_stretch(traces: TraceSet, line: int, s0: float, s1: float) -> FloatArray:
    """Return coordinates of a fall line between chainages (m), cut to the line, (n, 2)."""
    own = slice(int(traces.offset[line]), int(traces.offset[line + 1]))
    s, x, y = traces.s[own], traces.x[own], traces.y[own]
    low, high = max(s0, float(s[0])), min(s1, float(s[-1]))
    if not low < high:
        return np.empty((0, 2))
    at = np.concatenate([[low], s[(s > low) & (s < high)], [high]])
    return np.column_stack([np.interp(at, s, x), np.interp(at, s, y)])


def is_stretch(finding: GapFinding) -> bool:
    """Return whether a finding belongs to a stretch of the fall lines rather than to a point."""
    return math.isfinite(finding.s0_m) and finding.s0_m < finding.s1_m


def limits_on(case: Case, finding: GapFinding, line: int) -> tuple[float, float]:
    """Return chainages between which a finding lies on one fall line (m).

    Reaches begin and end where this line crosses the stations; else the mean chainages of the
    finding.
    """
    low, high = finding.s0_m, finding.s1_m
    if finding.place in case.reaches:
        edges = case.stations[line][case.station_order]
        number = case.reaches.index(finding.place)
        if number > 0 and math.isfinite(edges[number - 1]):
            low = float(edges[number - 1])
        if number < edges.size and math.isfinite(edges[number]):
            high = float(edges[number])
    return low, high


def used_lines(case: Case) -> list[int]:
    """Return fall lines that rocks have, ascending."""
    lines: list[int] = np.unique(case.line[case.line >= 0]).tolist()
    return lines


def observed_end(case: Case) -> float:
    """Return the chainage beyond which nothing was observed (m); infinite without any."""
    known = np.concatenate([p.s[np.isfinite(p.s)] for p in case.projected.values()])
    return float(known.max()) if known.size else math.inf


def fingerprints(case: Case, residuals: ResidualTable) -> tuple[Fingerprint, ...]:
    """Test every fingerprint of a case against its base: the surest first, the unseen last."""
    group = case.group
    seen, unseen = list[Fingerprint](), list[Fingerprint]()  # p values are adjusted below
    for cause in CAUSES.values():
        for own in cause.statistics:
            one = Fingerprint(cause.name, own.name, math.nan, math.nan, math.nan, False, 0)
            with suppress(Unseen):
                scores = own.scores(case, residuals)
                z, p, n = z_of_scores(scores, group)
                if math.isfinite(z):
                    one = Fingerprint(cause.name, own.name, scores.size, z, p, True, n)
            (seen if one.observable else unseen).append(one)
    adjusted = holm_adjusted(np.array([one.p_adjusted for one in seen])).tolist()
    seen = [replace(one, p_adjusted=p) for one, p in zip(seen, adjusted, strict=True)]
    return (*sorted(seen, key=lambda one: (one.p_adjusted, -one.z)), *unseen)


def z_of_scores(one: Scores, group: IntArray) -> tuple[float, float, int]:
    """Return z of the mean over groups, one-sided p, and groups that have a value."""
    groups = int(group.max()) + 1
    own_null = one.values.size == 1
    values = np.zeros(groups) if own_null else per_rock(one.values, group, groups)
    n = int(np.isfinite(values).sum())
    if n < FINGERPRINT_ROCKS:
        return math.nan, math.nan, n
    if one.chance is not None:
        # So few score that their mean is not normal.
        none = np.ones(groups)
        np.multiply.at(none, group, 1.0 - one.chance)
        seem = stats.poisson(float((1.0 - none).sum()))
        hit = int((np.nan_to_num(values) > 0.0).sum())
        p = float(np.clip(seem.sf(hit) + 0.5 * seem.pmf(hit), 1e-30, 1.0 - 1e-9))
        return float(stats.norm.isf(p)), p, n
    if own_null:
        return float(one.values[0]), float(stats.norm.sf(one.values[0])), n
    t = float(np.clip(np.nan_to_num(t_statistics(values)[0], posinf=40.0, neginf=-40.0), -40, 40))
    p = float(stats.t.sf(t, n - 1))
    # The normal deviate of the same chance: a t of five rocks is not one of a hundred.
    z = float(np.clip(stats.norm.isf(p), -12.0, 12.0)) if 0.0 < p < 1.0 else math.copysign(12.0, t)
    return z, p, n


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds set on sites of development, and frozen for all that is reported."""

    level: float = 0.01  # adjusted p value up to which a fingerprint is significant
    named: float = 0.6  # probability from which a family is named
    grouped: float = 0.7  # that of all families of a group together from which it is certain
    #: z of a second fingerprint, after the first cause, from which two causes are named; of one
    #: that takes no contacts, from which a cause is named that closes nothing.
    second: float = 6.0
    #: Probability from which the most probable family is calibrated, though it is not named.
    calibrated: float = 0.2
    #: Probability from which a family, "none" or "unknown" is in the confusion set: so that nine
    #: sets of ten hold the truth.
    possible: float = 0.05
    #: Share of the sites at which an answer that names no family was right; its confidence is never
    #: higher.
    right: Mapping[str, float] = field(default_factory=dict)


def group_of(effect: str) -> str:
    """Return the group of a cause; of two, that of the first; "" if it has none."""
    first = CAUSES.get(effect.split("+")[0])
    return "" if first is None else first.group


def adequate(findings: Sequence[GapFinding]) -> bool:
    """Return whether no gap of the calibrated base is both significant and large."""
    return not large_gaps(findings)


def large_gaps(findings: Sequence[GapFinding]) -> list[GapFinding]:
    """Return gaps that are both significant and large."""

    def scatter(finding: GapFinding) -> float:
        low, high = finding.ci95
        return (high - low) / 3.92 * math.sqrt(max(finding.values, finding.rocks, 1))

    return [f for f in findings if f.p_adjusted <= LEVEL and abs(f.gap) > LARGE_GAP * scatter(f)]


def strongest(prints: Sequence[Fingerprint]) -> dict[str, Fingerprint]:
    """Return the surest fingerprint of each cause that these data can show."""
    best: dict[str, Fingerprint] = {}
    for one in prints:
        if one.observable and (one.effect not in best or one.z > best[one.effect].z):
            best[one.effect] = one
    return best


def significant(prints: Sequence[Fingerprint], level: float) -> dict[str, Fingerprint]:
    """Return the surest fingerprint of each cause that has a significant one."""
    return {n: f for n, f in strongest(prints).items() if f.p_adjusted <= level and f.z > 0.0}


#: Fingerprints that no contact could leave; those of them that are of masses, places and paths in
#: time, so that they hang on no contact that may be missing in a table either; and of these
#: those that the scatter of the rocks does not hide.
_CLEAR = {t.name: t for c in CAUSES.values() for t in c.statistics if t.clear}
_WITHOUT_CONTACTS = {name for name, own in _CLEAR.items() if own.tables != ("impacts",)}
_OF_PATHS = {name for name, own in _CLEAR.items() if "trajectories" in own.tables}
_OF_MASSES = {name for name, own in _CLEAR.items() if {*own.tables} == {"rocks", "deposits"}}


def is_certain(prints: Sequence[Fingerprint], effect: str, thresholds: Thresholds) -> bool:
    """Return whether masses, places or paths in time show a cause, whatever else the rocks do."""
    return _has(prints, effect, _WITHOUT_CONTACTS, thresholds.second)


def _has(prints: Sequence[Fingerprint], effect: str, names: Container[str], least: float) -> bool:
    """Return whether one of some fingerprints of a cause has a z of at least so much."""
    own = (f for f in prints if f.effect == effect and f.statistic in names)
    return any(f.observable and f.z >= least for f in own)


def _would_show(one: Fingerprint) -> bool:
    """Return whether a fingerprint is one that would be seen where its cause is, or is seen."""
    if one.statistic in _OF_PATHS or (one.statistic in _CLEAR and one.z >= PRINTED_Z):
        return True
    return one.statistic in _OF_MASSES and one.z > -PRINTED_Z


def seen_of(
    prints: Sequence[Fingerprint], gains: Mapping[str, CauseGain], tried: Sequence[str]
) -> tuple[str, ...]:
    """Return families that these data could show, by a fingerprint or by what they close.

    Paths in time could show theirs wherever they were recorded; so could masses, unless the one
    that a family adds may lie in the gap that another one leaves. Other fingerprints that no
    contact leaves may be hidden by the scatter of the rocks: they must be seen. What another law of
    the contact or a film that begins late leaves as well shows nothing by itself. Else a family
    must have the power to close something, or close it. Causes at the contact close what another
    law of the contact leaves, too: of these a fingerprint must be significant.
    """
    by_prints = {f.effect for f in prints if f.observable and _would_show(f)}
    by_gains = {
        n for n, own in gains.items() if own.power >= NAMED_POWER or own.sureness >= SHOWING_GAIN
    }
    contact, sure = group_of(CONTACT_LAW), significant(prints, LEVEL)
    by_gains = {n for n in by_gains if group_of(n) != contact or n in sure}
    return tuple(n for n in tried if n in by_prints or n in by_gains)


def is_clear(prints: Sequence[Fingerprint], gains: Mapping[str, CauseGain], effect: str) -> bool:
    """Return whether a cause shows by what no law of the contact leaves.

    By such a fingerprint, or by what it certainly closes beyond ground and discrepancy of the law,
    unless it acts at the contact, where another law may close as much.
    """
    closes = CAUSES[effect].closes and group_of(effect) != group_of(CONTACT_LAW)
    if closes and effect in gains and gains[effect].sureness >= SHOWING_GAIN:
        return True
    return _has(prints, effect, _CLEAR, PRINTED_Z)


def second_of(
    left: Sequence[Fingerprint], shares: Mapping[str, float], thresholds: Thresholds
) -> str:
    """Return a second cause: what remains once the first one is in the model; "" if nothing is.

    ``left``, ``shares``: fingerprints and probabilities beyond the base with the first cause.
    """
    sure = {
        name: one.z
        for name, one in significant(left, thresholds.level).items()
        if one.z >= thresholds.second
    }
    likely = [name for name in sure if shares.get(name, 0.0) >= thresholds.named]
    return max(likely, key=lambda n: sure[n], default="")


def decide(
    prints: Sequence[Fingerprint],
    gains: Mapping[str, CauseGain],
    shares: Mapping[str, float],
    is_adequate: bool,
    closes: float | None,
    thresholds: Thresholds,
    law: bool,
) -> tuple[str, str, str]:
    """Return the answer, its group ("" where not even that is certain), and the reason.

    ``shares``: probability of each family, of "none" and of "unknown"; a family is named only by
    what no contact could leave.
    ``is_adequate``: whether the calibrated base leaves no gap that is significant and large.
    ``closes``: share of the gap that the most probable family closes, on rocks left out; None where
    that says nothing of it. ``law``: whether the base needs another law of the contact.
    """
    tried = [name for name in shares if name not in (NONE, UNKNOWN)]
    best = strongest(prints)
    contact = group_of(CONTACT_LAW)
    first = most_probable(prints, gains, shares, thresholds)
    refused = phrase("")
    likely = 0.0
    if first != NONE:
        likely = probability_beside_certain(first, prints, shares, thresholds)
    if likely >= thresholds.named and is_clear(prints, gains, first):
        # Such a cause is one also where the rocks come as far without it. Of one at the contact
        # nothing may be left to close: the contact of the base is free.
        if (
            closes is None
            or closes > 0.0
            or is_certain(prints, first, thresholds)
            or group_of(first) == contact
        ):
            sure = f"{min(likely, 0.99):.0%}"
            reason = phrase("probability {} from its fingerprints", sure)
            if closes is not None and closes > 0.0:
                reason = phrase(
                    "probability {} from its fingerprints and from the gap that it closes", sure
                )
            if first in best:
                seen, z = phrase(best[first].statistic), f"{best[first].z:.1f}"
                reason = phrase("{}; strongest fingerprint: {} (z = {})", reason, seen, z)
            return first, group_of(first), reason
        refused = phrase(
            "the fingerprints point to {}, but the effect closes none of the gap on held-out "
            "rocks; ",
            effect_key(first),
        )
    together = {g: group_probability(g, shares) for g in GROUPS}
    group = max(together, key=lambda g: together[g])
    if together[group] >= thresholds.grouped and len(GROUPS[group]) == 1 and refused:
        return UNKNOWN, group, phrase("{}these data do not show the cause of the gap", refused)
    if together[group] >= thresholds.grouped:
        reason = phrase(
            "probability of a cause of the group {}: {}; these data do not show which one",
            phrase(group),
            f"{together[group]:.0%}",
        )
        return UNKNOWN, group, joined("", (refused, reason))
    if is_adequate:
        reason = phrase(
            "no cause is probable, and no gap of the calibrated base model is both significant "
            "and large"
        )
        if refused:
            reason = phrase(
                "no other cause is probable, and no gap of the calibrated base model is both "
                "significant and large"
            )
        return NONE, "", joined("", (refused, reason))
    # A cause at the contact that is as probable as none is not separable from another law of it.
    others = [name for name in tried if group_of(name) != contact or shares[name] > shares[NONE]]
    if law and shares[NONE] > max((shares[name] for name in others), default=0.0):
        reason = phrase(
            "the contact follows another law: the motion differs in the same way for all sizes, "
            "or another law certainly closes more of the gap than any ground values"
        )
        return CONTACT_LAW, contact, joined("", (refused, reason))
    reason = phrase("gaps are significant and large, and these data show no probable cause")
    return UNKNOWN, "", joined("", (refused, reason))


def most_probable(
    prints: Sequence[Fingerprint],
    gains: Mapping[str, CauseGain],
    shares: Mapping[str, float],
    thresholds: Thresholds,
) -> str:
    """Return the most probable cause, first of those that are certain by themselves.

    With the most certain gain if equal; "none" where none was tried.
    """

    def order(name: str) -> tuple[bool, float, float]:
        gain = gains[name].sureness if name in gains else 0.0
        likely = probability_beside_certain(name, prints, shares, thresholds)
        sure = is_certain(prints, name, thresholds) and likely >= thresholds.named
        return sure, shares[name], gain

    tried = [name for name in shares if name not in (NONE, UNKNOWN)]
    return max(tried, key=order, default=NONE)


def probability_beside_certain(
    cause: str, prints: Sequence[Fingerprint], shares: Mapping[str, float], thresholds: Thresholds
) -> float:
    """Return the probability of a cause among those that could be in its place.

    Shares are of one cause at a time. Another one that is certain by itself acts beside it; and
    beside one that is, whatever has no fingerprint that no contact leaves.
    """
    certain = is_certain(prints, cause, thresholds)
    beside = [
        name
        for name in CAUSES
        if name != cause
        and (
            is_certain(prints, name, thresholds)
            or (certain and not _has(prints, name, _CLEAR, PRINTED_Z))
        )
    ]
    together = sum(shares.get(name, 0.0) for name in beside)
    return shares[cause] / max(1.0 - together, shares[cause])


def group_probability(group: str, shares: Mapping[str, float]) -> float:
    """Return the probability of the families of a group together; NaN without a group."""
    if not group:
        return math.nan
    return sum(shares.get(name, 0.0) for name in GROUPS[group])


def confusion_set(effect: str, least: float, shares: Mapping[str, float]) -> tuple[str, ...]:
    """Return the answer, then causes as probable as it or as ``least``, most likely first."""
    named = effect.split("+")
    least = min([least, *(p for n, p in shares.items() if n in named)])
    return tuple(dict.fromkeys([*named, *(n for n, p in shares.items() if p >= least)]))


def place_of(
    effect: str, case: Case, fitted: Sequence[Draw], findings: Sequence[GapFinding]
) -> tuple[str, tuple[str, ...]]:
    """Return the phase and reaches in which an effect acts, by its draws, else by the gap."""
    if effect == NONE:
        return "", ()
    if effect in (UNKNOWN, CONTACT_LAW):
        return locate(findings)
    first = CAUSES[effect.split("+")[0]]
    return first.phase, first.place(case, [draw.model for draw in fitted])


def confidence_of(
    effect: str,
    prints: Sequence[Fingerprint],
    shares: Mapping[str, float],
    thresholds: Thresholds,
) -> float:
    """Return the probability of an answer, of two causes together; NaN where none is given.

    No more than the share of the sites of development at which such an answer was right.
    """
    if effect == UNKNOWN:
        return math.nan
    named = [NONE] if effect == CONTACT_LAW else effect.split("+")
    if effect in CAUSES and effect != CONTACT_LAW:
        own = probability_beside_certain(effect, prints, shares, thresholds)
    else:
        own = sum(shares.get(name, 0.0) for name in named)
    return float(min(own, thresholds.right.get(effect, 1.0), 0.99))


#: Evidence for a cause, in the order of the weights.
FEATURES = ("clear", "usual", "gain", "share")


@dataclass(frozen=True, slots=True)
class CauseWeights:
    """Weights of the evidence."""

    weights: FloatArray  # shape (4,); of FEATURES
    offset: float  # by which a cause is less likely than "none" before any evidence
    other: float  # logarithm of the odds of an effect that is not known
    #: What a gap that the base leaves counts for such an effect, if it is significant and large.
    unsound: float
    farthest: float  # excess of the base that one site of a hundred exceeds (``CauseGain``)

    def logits(self, evidence: FloatArray, sound: bool) -> FloatArray:
        """Return log odds against "none" of an unknown effect, and of each cause, shape (n + 1,).

        ``evidence``: FEATURES of each cause, (n, 4); ``sound``: whether the base leaves no gap that
        is significant and large.
        """
        causes = evidence.reshape(-1, len(FEATURES)) @ self.weights - self.offset
        return np.append(self.other + self.unsound * (not sound), causes)

    def shares(
        self,
        prints: Sequence[Fingerprint],
        gains: Mapping[str, CauseGain],
        tried: Sequence[str],
        sound: bool = True,
    ) -> dict[str, float]:
        """Return the probability of causes, "none" and "unknown", most likely first."""
        evidence = np.array([evidence_of(name, prints, gains) for name in tried])
        p = softmax(np.append(0.0, self.logits(evidence, sound)))
        names = (NONE, UNKNOWN, *tried)
        return {names[k]: float(p[k]) for k in np.argsort(-p, kind="stable").tolist()}


def evidence_of(
    cause: str, prints: Sequence[Fingerprint], gains: Mapping[str, CauseGain]
) -> FloatArray:
    """Return FEATURES of a cause, shape (4,); 0 for unobserved ones.

    Several fingerprints that no contact leaves and that are seen by themselves count together. A
    share of the gap counts by its square: many causes close a fifth of any gap, few close most.
    """
    clear = {own.name for own in CAUSES[cause].statistics if own.clear}
    own = [f for f in prints if f.effect == cause and f.observable]
    certain = [f.z for f in own if f.statistic in clear]
    usual = max((f.z for f in own if f.statistic not in clear), default=0.0)
    together = math.hypot(*(min(z, MOST_Z) for z in certain if z >= PRINTED_Z))
    gain = gains.get(cause)
    sureness, share = 0.0, 0.0
    if gain is not None and CAUSES[cause].closes:
        sureness, share = gain.sureness, gain.share
    z = max(*certain, together) if certain else 0.0
    return np.array([_count(z), _count(usual), _count(sureness), (share / SHARE_UNIT) ** 2])


def _count(z: float) -> float:
    return float(np.clip(z, 0.0, MOST_Z)) / Z_UNIT
