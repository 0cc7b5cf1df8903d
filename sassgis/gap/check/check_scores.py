"""How good a diagnosis is, from its answers on sites whose truth is known."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from sassgis.gap.inference.intervals import Interval, share_interval
from sassgis.gap.which.families import FAMILIES

#: Least confidence with which an effect is named.
NAMED_CONFIDENCE = 0.6
#: How far a stated shrinkage may be from that on fresh rocks.
SHRINKAGE_TOLERANCE = 0.15
#: Fewest rocks of sites on which the shrinkage is checked.
SHRINKAGE_ROCKS = 100
#: Limits of the bins of the table of reliability.
CONFIDENCE_BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
#: Columns of the confusion matrix; rows are the first of them, without "no answer".
ANSWERS: tuple[str, ...] = ("none", *FAMILIES, "pair", "unknown", "no answer")


@dataclass(frozen=True, slots=True)
class Truth:
    """What is true of a site.

    Attributes
    ----------
    case : str
        Number of the site.
    verdict : str
        "none", "unknown", a family, or two joined by "+".
    effects : tuple of str
        Names of the effects, unknown ones by what they are.
    strengths : tuple of str
        As measured: less than was asked for where no magnitude gives that.
    phase : str
        Of a single effect; else "".
    segments : tuple of str
        Reaches that a single effect touches.
    reaches : tuple of str
        All reaches of the slope.
    slope : str
    rocks : int
    kind : str
        What was observed: stations, stops, both, everything.
    """

    case: str
    verdict: str
    effects: tuple[str, ...]
    strengths: tuple[str, ...]
    phase: str
    segments: tuple[str, ...]
    reaches: tuple[str, ...]
    slope: str
    rocks: int
    kind: str

    @property
    def part(self) -> str:
        """Part of the battery: none, single, pair or unknown."""
        if self.verdict in ("none", "unknown"):
            return self.verdict
        return "pair" if "+" in self.verdict else "single"

    @property
    def local(self) -> bool:
        """Whether it is one known effect that does not act everywhere."""
        return self.part == "single" and 0 < len(set(self.segments)) < len(self.reaches)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a diagnosis answered.

    Attributes
    ----------
    case : str
    effect : str
        "none", "unknown", a family, or several joined by "+" in any order; "no answer" if it
        failed.
    confidence : float
        NaN if none is stated.
    confusion_set : tuple of str
    phase : str
    segments : tuple of str
    shrinkage : float or None
        None if withheld.
    failure : str
        Why there is no answer.
    """

    case: str
    effect: str
    confidence: float
    confusion_set: tuple[str, ...] = ()
    phase: str = ""
    segments: tuple[str, ...] = ()
    shrinkage: float | None = None
    failure: str = ""


@dataclass(frozen=True, slots=True)
class Share:
    """A share of sites with its interval (95 %, Clopper and Pearson 1934).

    Attributes
    ----------
    measure : str
    hits, trials : int
    value, low, high : float
        NaN, 0, 1 without trials.
    """

    measure: str
    hits: int
    trials: int
    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Aim:
    """A measure that is asked for.

    Attributes
    ----------
    key : str
        Of the measure among the scores.
    title : str
    limit : float
    at_least : bool
        Whether the share must reach the limit, or not exceed it.
    """

    key: str
    title: str
    limit: float
    at_least: bool = True


#: What is asked of a diagnosis on the full battery.
AIMS: tuple[Aim, ...] = (
    Aim("top1_full", "single effect named, medium or strong, 100 rocks, everything observed", 0.85),
    Aim("top1_modest", "single effect named, medium or strong, 40 rocks, stations and stops", 0.65),
    Aim("false_alarm", "no effect, yet one is named", 0.05, at_least=False),
    Aim("covered_single", "single effect is in the confusion set", 0.95),
    Aim("confident_right", f"right where the confidence is {NAMED_CONFIDENCE} or more", 0.90),
    Aim("unknown_not_named", "unknown effect, and no known one is named", 0.75),
    Aim("shrinkage_near", f"shrinkage within {SHRINKAGE_TOLERANCE} of that on fresh rocks", 0.80),
    Aim("location_hit", "single local effect: phase right and reaches overlap", 0.80),
)


@dataclass(frozen=True, slots=True)
class ReliabilityRow:
    """Answers whose confidence lies in a bin.

    Attributes
    ----------
    low, high : float
        Of the bin; the last one includes its upper limit.
    confidence : float
        Mean.
    right : Share
    """

    low: float
    high: float
    confidence: float
    right: Share


@dataclass(frozen=True, slots=True)
class ShrinkageCheck:
    """Stated shrinkages against those measured on fresh rocks.

    Attributes
    ----------
    worlds : int
        With enough rocks.
    compared : int
        Stated and measured.
    only_stated, only_measured, neither : int
        Where the other one is withheld, or both.
    bias, mean_error : float
        Mean of stated less measured, and of its absolute value; NaN without sites.
    """

    worlds: int
    compared: int
    only_stated: int
    only_measured: int
    neither: int
    bias: float
    mean_error: float


@dataclass(frozen=True, slots=True)
class CheckScores:
    """All scores of a check.

    Attributes
    ----------
    worlds : int
    failed : int
        Sites without an answer; they count as wrong.
    measures : mapping of key to Share
    groups : mapping of title to tuple of Share
        Accuracy on single effects by sample size, kind, strength, family and design.
    reliability : tuple of ReliabilityRow
    confusion : int64, shape (13, 14)
        Sites by truth (``ANSWERS`` without the last) and answer (``ANSWERS``).
    shrinkage : ShrinkageCheck
    confusion_set_size : float
        Mean number of names in a confusion set.
    location_overlap : float
        Mean share of the reaches named or touched that are both, over local effects; NaN without
        any.
    """

    worlds: int
    failed: int
    measures: Mapping[str, Share]
    groups: Mapping[str, tuple[Share, ...]]
    reliability: tuple[ReliabilityRow, ...]
    confusion: np.ndarray[Any, np.dtype[np.int64]] = field(repr=False)
    shrinkage: ShrinkageCheck
    confusion_set_size: float
    location_overlap: float


Pair = tuple[Truth, Answer]


def answer_from(case: str, diagnosis: Mapping[str, Any]) -> Answer:
    """Read an answer from the content of a ``diagnosis.json``.

    Parameters
    ----------
    case : str
    diagnosis : mapping
        Layout of ``sassgis.gap.diagnosis.as_json``.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the verdict or the shrinkage is missing, or is no such thing.
    """
    verdict = diagnosis["verdict"]
    confidence = verdict["confidence"]
    shrinkage = diagnosis["shrinkage"]["value"]
    return Answer(
        case=case,
        effect=str(verdict["effect"]),
        confidence=math.nan if confidence is None else float(confidence),
        confusion_set=tuple(str(name) for name in verdict["confusion_set"]),
        phase=str(verdict.get("phase", "")),
        segments=tuple(str(name) for name in verdict.get("segments", ())),
        shrinkage=None if shrinkage is None else float(shrinkage),
    )


def names_in(effect: str) -> frozenset[str]:
    """The names that a verdict holds; empty for none, unknown and no answer."""
    return frozenset(effect.split("+")) - {"none", "unknown", "no answer"}


def is_right(truth: Truth, answer: Answer) -> bool:
    """Whether the answer is the true verdict; the order of a pair does not matter."""
    return _sorted(answer.effect) == _sorted(truth.verdict)


def is_covered(truth: Truth, answer: Answer) -> bool:
    """Whether the truth is in the confusion set; of a pair, itself or both of its members."""
    sets = {_sorted(name) for name in answer.confusion_set}
    return _sorted(truth.verdict) in sets or bool(
        truth.part == "pair" and names_in(truth.verdict) <= sets
    )


def is_located(truth: Truth, answer: Answer) -> bool:
    """Whether the phase is right and at least one reach is that of the effect."""
    return answer.phase == truth.phase and bool(set(answer.segments) & set(truth.segments))


def score(
    truths: Iterable[Truth],
    answers: Iterable[Answer],
    measured: Mapping[str, float | None] | None = None,
) -> CheckScores:
    """Score answers.

    Parameters
    ----------
    truths : iterable of Truth
    answers : iterable of Answer
        One for each site, in any order.
    measured : mapping of case to float or None, optional
        Shrinkage on fresh rocks of the sites where it was measured; None where it is withheld.

    Raises
    ------
    ValueError
        If the answers are not those of the sites.
    """
    known = {truth.case: truth for truth in truths}
    given = {answer.case: answer for answer in answers}
    if known.keys() != given.keys():
        odd = sorted(known.keys() ^ given.keys())
        raise ValueError(f"sites and answers differ: {', '.join(odd)}")
    pairs = [(known[case], given[case]) for case in sorted(known)]
    singles = [p for p in pairs if p[0].part == "single"]
    measures = _measures(pairs, singles)
    checked = _shrinkage_pairs(pairs, measured or {})
    measures["shrinkage_near"] = share(
        "stated shrinkage near that on fresh rocks",
        [abs(stated - found) <= SHRINKAGE_TOLERANCE + 1e-12 for stated, found in _both(checked)],
    )
    overlaps = [
        len(set(a.segments) & set(t.segments)) / len(set(a.segments) | set(t.segments))
        for t, a in pairs
        if _locatable(t)
    ]
    sets = [len(a.confusion_set) for _, a in pairs if not a.failure]
    return CheckScores(
        worlds=len(pairs),
        failed=sum(bool(a.failure) for _, a in pairs),
        measures=measures,
        groups=_groups(singles),
        reliability=reliability(pairs),
        confusion=confusion_matrix(pairs),
        shrinkage=_shrinkage_check(checked),
        confusion_set_size=float(np.mean(sets)) if sets else math.nan,
        location_overlap=float(np.mean(overlaps)) if overlaps else math.nan,
    )


def share(measure: str, hits: Iterable[bool]) -> Share:
    """Share of hits, with its interval."""
    found = list(hits)
    interval: Interval = share_interval(int(sum(found)), len(found), method="exact")
    return Share(measure, int(sum(found)), len(found), interval.value, interval.low, interval.high)


def reliability(pairs: Sequence[Pair]) -> tuple[ReliabilityRow, ...]:
    """Share of right answers by bins of their confidence."""
    rows = []
    stated = [p for p in pairs if math.isfinite(p[1].confidence)]
    for low, high in itertools.pairwise(CONFIDENCE_BINS):
        last = high == CONFIDENCE_BINS[-1]
        within = [
            (t, a)
            for t, a in stated
            if low <= a.confidence and (a.confidence < high or (last and a.confidence <= high))
        ]
        mean = float(np.mean([a.confidence for _, a in within])) if within else math.nan
        right = share(f"confidence {low:g} to {high:g}", [is_right(t, a) for t, a in within])
        rows.append(ReliabilityRow(low, high, mean, right))
    return tuple(rows)


def confusion_matrix(pairs: Sequence[Pair]) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Sites by truth (rows) and answer (columns), in the order of ``ANSWERS``."""
    matrix = np.zeros((len(ANSWERS) - 1, len(ANSWERS)), np.int64)
    for truth, answer in pairs:
        matrix[ANSWERS.index(_column(truth.verdict)), ANSWERS.index(_column(answer.effect))] += 1
    return matrix


def acceptance(scores: CheckScores) -> list[dict[str, Any]]:
    """What is asked for, and what is reached: one row for each aim.

    ``met`` is None where no site decides; ``sure`` says whether the whole interval is on the right
    side of the limit.
    """
    rows: list[dict[str, Any]] = []
    for aim in AIMS:
        found = scores.measures[aim.key]
        met: bool | None = None
        sure = False
        if found.trials:
            met = found.value >= aim.limit if aim.at_least else found.value <= aim.limit
            sure = found.low >= aim.limit if aim.at_least else found.high <= aim.limit
        rows.append(
            {
                "key": aim.key,
                "measure": aim.title,
                "asked": aim.limit,
                "asked_is": "at least" if aim.at_least else "at most",
                "reached": found.value,
                "ci95": [found.low, found.high],
                "hits": found.hits,
                "worlds": found.trials,
                "met": met,
                "sure": sure,
            }
        )
    return rows


def scores_as_json(scores: CheckScores) -> dict[str, Any]:
    """The scores as plain values; missing numbers become None."""
    plain: dict[str, Any] = _clean(
        {
            "worlds": scores.worlds,
            "failed": scores.failed,
            "acceptance": acceptance(scores),
            "measures": {key: asdict(value) for key, value in scores.measures.items()},
            "single_effects_named_by": {
                title: [asdict(s) for s in rows] for title, rows in scores.groups.items()
            },
            "reliability": [asdict(row) for row in scores.reliability],
            "confusion": {
                "truth": list(ANSWERS[:-1]),
                "answer": list(ANSWERS),
                "worlds": scores.confusion.tolist(),
            },
            "shrinkage": asdict(scores.shrinkage),
            "confusion_set_size": scores.confusion_set_size,
            "location_overlap": scores.location_overlap,
        }
    )
    return plain


def _measures(pairs: Sequence[Pair], singles: Sequence[Pair]) -> dict[str, Share]:
    nulls = [p for p in pairs if p[0].part == "none"]
    doubles = [p for p in pairs if p[0].part == "pair"]
    unknown = [p for p in pairs if p[0].part == "unknown"]
    clear = [p for p in singles if p[0].strengths[0] != "weak"]
    named = [p for p in pairs if names_in(p[1].effect)]

    def at(rocks: int, kind: str) -> list[Pair]:
        return [(t, a) for t, a in clear if t.rocks == rocks and t.kind == kind]

    def right(chosen: Sequence[Pair]) -> list[bool]:
        return [is_right(t, a) for t, a in chosen]

    def both(t: Truth, a: Answer) -> bool:
        return names_in(a.effect) == names_in(t.verdict)

    located = [p for p in singles if _locatable(p[0])]
    confident = [p for p in pairs if p[1].confidence >= NAMED_CONFIDENCE]
    return {
        "top1_full": share(
            "single, medium or strong, 100 rocks, everything", right(at(100, "everything"))
        ),
        "top1_modest": share("single, medium or strong, 40 rocks, both", right(at(40, "both"))),
        "top1_clear": share("single, medium or strong, all designs", right(clear)),
        "top1_single": share("single, all strengths and designs", right(singles)),
        "top1_all": share("all sites", right(pairs)),
        "false_alarm": share(
            "no effect, yet one is named", [bool(names_in(a.effect)) for _, a in nulls]
        ),
        "null_unknown": share(
            "no effect, answer unknown", [a.effect == "unknown" for _, a in nulls]
        ),
        "null_right": share("no effect, answer none", right(nulls)),
        "covered_single": share(
            "single effect in the confusion set", [is_covered(t, a) for t, a in singles]
        ),
        "covered_all": share(
            "truth in the confusion set, all sites", [is_covered(t, a) for t, a in pairs]
        ),
        "confident_right": share("right where confident", right(confident)),
        "named_right": share("right where an effect is named", right(named)),
        "confident_named_right": share(
            "right where an effect is named with confidence",
            right([p for p in confident if names_in(p[1].effect)]),
        ),
        "unknown_not_named": share(
            "unknown effect, no known one named",
            [a.effect in ("none", "unknown") for _, a in unknown],
        ),
        "unknown_right": share("unknown effect, answer unknown", right(unknown)),
        "pair_one": share(
            "pair, at least one of it named",
            [bool(names_in(a.effect) & names_in(t.verdict)) for t, a in doubles],
        ),
        "pair_both": share("pair, both named and no other", [both(t, a) for t, a in doubles]),
        "pair_wrong": share(
            "pair, an effect named that is not there",
            [bool(names_in(a.effect) - names_in(t.verdict)) for t, a in doubles],
        ),
        "location_hit": share(
            "single local effect located", [is_located(t, a) for t, a in located]
        ),
        "location_hit_named": share(
            "single local effect located, where it is named",
            [is_located(t, a) for t, a in located if is_right(t, a)],
        ),
    }


def _locatable(truth: Truth) -> bool:
    """Local, and seen at stations, without which reaches have no names."""
    return truth.local and truth.kind != "stops"


def _groups(singles: Sequence[Pair]) -> dict[str, tuple[Share, ...]]:
    groupings: dict[str, Callable[[Truth], str]] = {
        "sample size": lambda t: f"{t.rocks} rocks",
        "kind of observations": lambda t: t.kind,
        "strength": lambda t: t.strengths[0],
        "family": lambda t: t.verdict,
        "slope": lambda t: t.slope,
        "design": lambda t: f"{t.rocks} rocks, {t.kind}",
    }
    order: dict[str, Sequence[str]] = {
        "strength": ("weak", "medium", "strong"),
        "kind of observations": ("stations", "stops", "both", "everything"),
        "family": FAMILIES,
    }
    out: dict[str, tuple[Share, ...]] = {}
    for title, value_of in groupings.items():
        found = {value_of(t) for t, _ in singles}
        given = order.get(title)
        # Sizes in the order of their numbers: "20 rocks" before "100 rocks".
        values = (
            [v for v in given if v in found]
            if given
            else sorted(found, key=lambda v: (int(v.split()[0]) if v[0].isdigit() else 0, v))
        )
        out[title] = tuple(
            share(value, [is_right(t, a) for t, a in singles if value_of(t) == value])
            for value in values
        )
    return out


def _shrinkage_pairs(
    pairs: Sequence[Pair], measured: Mapping[str, float | None]
) -> list[tuple[float | None, float | None]]:
    return [
        (a.shrinkage, measured[t.case])
        for t, a in pairs
        if t.rocks >= SHRINKAGE_ROCKS and t.case in measured and not a.failure
    ]


def _both(checked: Sequence[tuple[float | None, float | None]]) -> list[tuple[float, float]]:
    return [(s, m) for s, m in checked if s is not None and m is not None]


def _shrinkage_check(checked: Sequence[tuple[float | None, float | None]]) -> ShrinkageCheck:
    apart = [stated - found for stated, found in _both(checked)]
    return ShrinkageCheck(
        worlds=len(checked),
        compared=len(apart),
        only_stated=sum(s is not None and m is None for s, m in checked),
        only_measured=sum(s is None and m is not None for s, m in checked),
        neither=sum(s is None and m is None for s, m in checked),
        bias=float(np.mean(apart)) if apart else math.nan,
        mean_error=float(np.mean(np.abs(apart))) if apart else math.nan,
    )


def _sorted(effect: str) -> str:
    return "+".join(sorted(effect.split("+")))


def _column(effect: str) -> str:
    if "+" in effect:
        return "pair"
    return effect if effect in ANSWERS else "no answer"


def _clean(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _clean(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [_clean(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
