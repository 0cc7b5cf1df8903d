"""How good a diagnosis is, from its answers on sites whose truth is known."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from sassgis.gap.causes.all_causes import FAMILIES
from sassgis.gap.check.answers import (
    OWN_LAW,
    Answer,
    Truth,
    holds,
    is_covered,
    is_located,
    is_right,
    names_in,
)
from sassgis.gap.diagnosis import without_nan
from sassgis.gap.inference.intervals import share_interval
from sassgis.gap.which.verdict import CONTACT_LAW
from sassgis.model.grid import BoolArray, FloatArray

#: Least confidence with which an effect is named.
NAMED_CONFIDENCE = 0.6
#: How far a stated shrinkage may be from that on fresh rocks.
SHRINKAGE_TOLERANCE = 0.15
#: Numbers of rocks for which the shrinkage is asked for.
SHRINKAGE_ROCKS = (20, 40, 100)
#: Limits of the bins of the table of reliability.
CONFIDENCE_BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
#: Bins of the expected calibration error.
_ECE_BINS = 10
#: Draws of the calibration error by chance.
_CHANCE_DRAWS = 2000
#: Columns of the confusion matrix; rows are the first of them, without "no answer".
ANSWERS: tuple[str, ...] = ("none", *FAMILIES, "pair", "unknown", CONTACT_LAW, "no answer")


@dataclass(frozen=True, slots=True)
class Share:
    """A share of sites with its interval (95 %, Clopper and Pearson 1934)."""

    measure: str
    hits: int
    trials: int
    # NaN, 0, 1 without trials.
    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Aim:
    """A measure that is asked for."""

    key: str  # of the measure or number among the scores
    title: str
    limit: float
    at_least: bool = True  # whether the share must reach the limit, or not exceed it


_CLEAR_FULL = "single effect, medium or strong, that could be seen, 100 rocks, everything observed"
_CLEAR_MODEST = "single effect, medium or strong, that could be seen, 40 rocks, stations and stops"
#: What is asked of a diagnosis on the full battery.
AIMS: tuple[Aim, ...] = (
    Aim("false_alarm", "no effect, yet one is named", 0.05, at_least=False),
    Aim("wrong_named", "an effect, yet one is named that is not there", 0.08, at_least=False),
    Aim("family_full", f"{_CLEAR_FULL}: named", 0.75),
    Aim("group_full", f"{_CLEAR_FULL}: group right", 0.90),
    Aim("group_modest", f"{_CLEAR_MODEST}: group right", 0.60),
    Aim("none_while_large", "gap significant and large, yet “none” is answered", 0.0, False),
    Aim("recommended_short", "model far short on the unsafe side, yet recommended", 0.0, False),
    Aim("unknown_named", "unknown effect, yet a known one is named", 0.20, at_least=False),
    Aim("covered_everything", "truth in the confusion set, everything observed", 0.90),
    Aim("covered_otherwise", "truth in the confusion set, other observations", 0.90),
    Aim("set_size_everything", "mean size of that set, everything observed", 2.0, False),
    Aim("set_size_otherwise", "mean size of that set, other observations", 3.5, False),
    Aim("calibration_error", "expected calibration error of the confidence", 0.08, False),
    Aim("confident_right", "right where the confidence is 0.6 or more", 0.85),
    *(
        Aim(
            f"shrinkage_near_{n}",
            f"shrinkage within {SHRINKAGE_TOLERANCE} of that on fresh rocks, {n} rocks",
            0.80,
        )
        for n in SHRINKAGE_ROCKS
    ),
    Aim("pair_one_none_wrong", "pair: at least one right and none wrong", 0.50),
    Aim("location_hit", "single local effect: phase right and reaches overlap", 0.80),
)


@dataclass(frozen=True, slots=True)
class ReliabilityRow:
    """Answers whose confidence lies in a bin."""

    low: float
    high: float  # the last bin includes it
    confidence: float  # mean
    right: Share


@dataclass(frozen=True, slots=True)
class ShrinkageCheck:
    """Stated shrinkages against those measured on fresh rocks."""

    worlds: int  # with enough rocks
    compared: int  # stated and measured
    only_stated: int  # where the other one is withheld
    only_measured: int
    neither: int  # where both are
    # Mean of stated less measured, and of its absolute value; NaN without sites.
    bias: float
    mean_error: float


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of some sites."""

    worlds: int
    measures: Mapping[str, Share]
    #: What is no share: sizes of confusion sets, calibration error, overlap of reaches; NaN without
    #: sites.
    numbers: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class CheckScores:
    """All scores of a check."""

    failed: int  # sites without an answer; they count as wrong
    figures: Figures  # of all sites
    by_law: Mapping[str, Figures]
    #: Accuracy on single effects by sample size, kind, strength, family, law and design.
    groups: Mapping[str, tuple[Share, ...]]
    reliability: tuple[ReliabilityRow, ...]
    #: Sites by truth (``ANSWERS`` without the last) and answer (``ANSWERS``), shape (14, 15).
    confusion: np.ndarray[Any, np.dtype[np.int64]] = field(repr=False)
    shrinkage: ShrinkageCheck

    @property
    def worlds(self) -> int:
        """Number of sites."""
        return self.figures.worlds

    @property
    def measures(self) -> Mapping[str, Share]:
        """Shares of all sites."""
        return self.figures.measures


Pair = tuple[Truth, Answer]


def score(
    truths: Iterable[Truth],
    answers: Iterable[Answer],
    measured: Mapping[str, float | None] | None = None,
) -> CheckScores:
    """Score answers, one for each site, in any order.

    ``measured``: shrinkage on fresh rocks by case, of the sites where it was measured; None where
    it is withheld.

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
    fresh = measured or {}
    laws = sorted({truth.law for truth, _ in pairs}, key=lambda law: (law != OWN_LAW, law))
    return CheckScores(
        failed=sum(bool(a.failure) for _, a in pairs),
        figures=_figures(pairs, fresh),
        by_law={law: _figures([p for p in pairs if p[0].law == law], fresh) for law in laws},
        groups=_groups([p for p in pairs if p[0].part == "single"]),
        reliability=reliability(pairs),
        confusion=confusion_matrix(pairs),
        shrinkage=_shrinkage_check(_shrinkage_pairs(pairs, fresh)),
    )


def _figures(pairs: Sequence[Pair], fresh: Mapping[str, float | None]) -> Figures:
    """All shares and numbers of some sites."""
    measures = _measures(pairs)
    for n in (None, *SHRINKAGE_ROCKS):
        some = [p for p in pairs if n in (None, p[0].rocks)]
        title, key = (f", rocks: {n}", f"_{n}") if n else ("", "")
        measures[f"shrinkage_near{key}"] = share(
            f"stated shrinkage near that on fresh rocks{title}",
            [
                abs(stated - found) <= SHRINKAGE_TOLERANCE + 1e-12
                for stated, found in _both(_shrinkage_pairs(some, fresh))
            ],
        )
    answered = [(t.kind, len(a.confusion_set)) for t, a in pairs if not a.failure]
    sizes: dict[str, list[float]] = {
        "set_size_everything": [size for kind, size in answered if kind == "everything"],
        "set_size_otherwise": [size for kind, size in answered if kind != "everything"],
        "location_overlap": [
            len({*a.segments} & {*t.segments}) / len({*a.segments} | {*t.segments})
            for t, a in pairs
            if _locatable(t)
        ],
    }
    means = {key: float(np.mean(v)) if v else math.nan for key, v in sizes.items()}
    means |= {
        "calibration_error": calibration_error(pairs),
        "calibration_error_by_chance": calibration_error_by_chance(pairs),
    }
    return Figures(len(pairs), measures, means)


def calibration_error(pairs: Sequence[Pair]) -> float:
    """Expected calibration error in ten equal bins (Guo, Pleiss, Sun and Weinberger 2017, eq. 3).

    The mean, over the answers, of |share right − mean confidence| in the bin of each; NaN without
    a stated confidence.
    """
    confidence, right = _stated(pairs)
    return float(_binned_error(confidence, right))


def calibration_error_by_chance(pairs: Sequence[Pair]) -> float:
    """Mean calibration error of so many answers if each is right with the stated confidence.

    It is above zero: the shares of few answers scatter about their confidence.
    """
    confidence, _ = _stated(pairs)
    drawn = np.random.default_rng(41).random((_CHANCE_DRAWS, confidence.size)) < confidence
    return float(np.mean(_binned_error(confidence, drawn)))


def _stated(pairs: Sequence[Pair]) -> tuple[FloatArray, FloatArray]:
    """Confidence of the answers that state one, and whether they are right."""
    own = [(a.confidence, holds(t, a)) for t, a in pairs if math.isfinite(a.confidence)]
    confidence, right = np.array(own, float).reshape(-1, 2).T
    return confidence, right


def _binned_error(confidence: FloatArray, right: FloatArray | BoolArray) -> FloatArray:
    """Calibration error; ``right`` has the answers in its last axis."""
    if not confidence.size:
        return np.array(math.nan)
    # Bins are open below and closed above, as in the source.
    within = np.clip(np.ceil(confidence * _ECE_BINS) - 1, 0, _ECE_BINS - 1)
    off = right - confidence
    apart = [np.abs(off[..., within == k].sum(axis=-1)) for k in range(_ECE_BINS)]
    return np.asarray(np.sum(apart, axis=0) / confidence.size)


def share(measure: str, hits: Iterable[bool]) -> Share:
    """Share of hits, with its interval."""
    found = list(hits)
    own = share_interval(int(sum(found)), len(found))
    return Share(measure, int(sum(found)), len(found), own.value, own.low, own.high)


def reliability(pairs: Sequence[Pair]) -> tuple[ReliabilityRow, ...]:
    """Share of right answers by bins of their confidence."""
    rows = []
    stated = [p for p in pairs if math.isfinite(p[1].confidence)]
    for low, high in itertools.pairwise(CONFIDENCE_BINS):
        within = [
            (t, a)
            for t, a in stated
            if low <= a.confidence < high or a.confidence == high == CONFIDENCE_BINS[-1]
        ]
        mean = float(np.mean([a.confidence for _, a in within])) if within else math.nan
        right = share(f"confidence {low:g} to {high:g}", [holds(t, a) for t, a in within])
        rows.append(ReliabilityRow(low, high, mean, right))
    return tuple(rows)


def confusion_matrix(pairs: Sequence[Pair]) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Sites by truth (rows) and answer (columns), in the order of ``ANSWERS``."""
    matrix = np.zeros((len(ANSWERS) - 1, len(ANSWERS)), np.int64)
    for truth, answer in pairs:
        matrix[ANSWERS.index(_column(truth.verdict)), ANSWERS.index(_column(answer.effect))] += 1
    return matrix


def acceptance(scores: CheckScores, law: str = "") -> list[dict[str, Any]]:
    """What is asked for, and what is reached: one row for each aim, of all sites or of a law.

    ``met`` is None where no site decides; ``sure`` says whether the whole interval is on the right
    side of the limit. A number that is no share has no interval and no sites.
    """
    figures = scores.by_law[law] if law else scores.figures
    rows = []
    for aim in AIMS:
        found = figures.measures.get(aim.key)
        value = figures.numbers[aim.key] if found is None else found.value
        met = sure = None
        if math.isfinite(value):
            met = value >= aim.limit if aim.at_least else value <= aim.limit
        if found is not None and found.trials:
            sure = found.low >= aim.limit if aim.at_least else found.high <= aim.limit
        row = {
            "key": aim.key,
            "measure": aim.title,
            "asked": aim.limit,
            "asked_is": "at least" if aim.at_least else "at most",
            "reached": value,
            "ci95": None if found is None else [found.low, found.high],
            "hits": None if found is None else found.hits,
            "worlds": None if found is None else found.trials,
            "met": met,
            "sure": sure,
            "is_share": found is not None,
        }
        rows.append(row)
    return rows


def scores_as_json(scores: CheckScores) -> dict[str, Any]:
    """The scores as plain values; missing numbers become None."""
    plain: dict[str, Any] = without_nan(
        {
            "failed": scores.failed,
            "acceptance": acceptance(scores),
            **_plain(scores.figures),
            "by_law": {
                law: {**_plain(figures), "acceptance": acceptance(scores, law)}
                for law, figures in scores.by_law.items()
            },
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
        }
    )
    return plain


def _plain(figures: Figures) -> dict[str, Any]:
    return {
        "worlds": figures.worlds,
        "measures": {key: asdict(value) for key, value in figures.measures.items()},
        "numbers": dict(figures.numbers),
    }


def _measures(pairs: Sequence[Pair]) -> dict[str, Share]:
    parts = {
        part: [p for p in pairs if p[0].part == part]
        for part in ("single", "none", "pair", "unknown")
    }
    singles, nulls, unknown = parts["single"], parts["none"], parts["unknown"]
    clear = [p for p in singles if p[0].strengths[0] != "weak"]
    every_full = [p for p in clear if (p[0].rocks, p[0].kind) == (100, "everything")]
    every_modest = [p for p in clear if (p[0].rocks, p[0].kind) == (40, "both")]

    def seen(chosen: Sequence[Pair]) -> list[Pair]:
        # What could not be seen is listed in the answer, and never named.
        return [(t, a) for t, a in chosen if not {*t.effects} & {*a.cannot_exclude}]

    def named(chosen: Sequence[Pair]) -> list[Pair]:
        return [p for p in chosen if names_one(*p)]

    def names_one(_truth: Truth, answer: Answer) -> bool:
        return bool(names_in(answer.effect))

    def grouped(truth: Truth, answer: Answer) -> bool:
        return answer.group in truth.groups

    full, modest = seen(every_full), seen(every_modest)
    everything = [p for p in pairs if p[0].kind == "everything"]
    otherwise = [p for p in pairs if p[0].kind != "everything"]
    hits = [(names_in(t.verdict), names_in(a.effect)) for t, a in parts["pair"]]
    local = [p for p in singles if _locatable(p[0])]
    confident = [p for p in pairs if p[1].confidence >= NAMED_CONFIDENCE]
    title, covered = "single, medium or strong, ", "truth in the confusion set, "
    # Words, what is asked of a truth and an answer, and of which of them.
    found: dict[str, tuple[str, Callable[[Any, Any], bool], Sequence[tuple[Any, Any]]]] = {
        "family_full": (title + "seen, 100 rocks, everything", is_right, full),
        "group_full": ("the same, group right", grouped, full),
        "family_modest": (title + "seen, 40 rocks, both", is_right, modest),
        "group_modest": ("the same, group right", grouped, modest),
        "family_full_all": (title + "seen or not, 100 rocks, everything", is_right, every_full),
        "family_modest_all": (title + "seen or not, 40 rocks, both", is_right, every_modest),
        "family_clear": (title + "all designs", is_right, clear),
        "group_clear": ("the same, group right", grouped, clear),
        "family_single": ("single, all strengths and designs", is_right, singles),
        "group_single": ("the same, group right", grouped, singles),
        "all_right": ("all sites", is_right, pairs),
        "false_alarm": ("no effect, yet one is named", names_one, nulls),
        "wrong_named": (
            "an effect, yet one is named that is not there",
            lambda t, a: bool(names_in(a.effect) - {*t.effects}),
            [p for p in pairs if p[0].effects],
        ),
        "null_unknown": ("no effect, answer unknown", lambda _, a: a.effect == "unknown", nulls),
        "null_right": ("no effect, answer none, or contact law where it is one", is_right, nulls),
        "none_while_large": (
            "gap significant and large, answer none",
            lambda _, a: a.effect == "none",
            [p for p in pairs if p[1].large_findings],
        ),
        "recommended_short": (
            "model far short on the unsafe side, yet recommended",
            lambda _, a: a.recommended,
            [p for p in pairs if p[1].short],
        ),
        "covered_everything": (covered + "everything observed", is_covered, seen(everything)),
        "covered_otherwise": (covered + "other observations", is_covered, seen(otherwise)),
        "covered_single": ("single effect in the confusion set", is_covered, seen(singles)),
        "confident_right": ("so where confident", holds, confident),
        "named_right": ("right where an effect is named", is_right, named(pairs)),
        "confident_named_right": (
            "so where an effect is named with confidence",
            holds,
            named(confident),
        ),
        "unknown_named": ("unknown effect, a known one named", names_one, unknown),
        "unknown_right": ("unknown effect, answer unknown", is_right, unknown),
        "pair_one_none_wrong": (
            "pair, at least one right and none wrong",
            lambda t, n: bool(n) and n <= t,
            hits,
        ),
        "pair_one": ("pair, at least one of it named", lambda t, n: bool(n & t), hits),
        "pair_both": ("pair, both named and no other", lambda t, n: n == t, hits),
        "pair_wrong": ("pair, an effect named that is not there", lambda t, n: bool(n - t), hits),
        "location_hit": ("single local effect located", is_located, local),
        "location_hit_named": (
            "single local effect located, where it is named",
            is_located,
            [p for p in local if is_right(*p)],
        ),
    }
    return {key: share(words, [test(*p) for p in of]) for key, (words, test, of) in found.items()}


def _locatable(truth: Truth) -> bool:
    """Local, and seen at stations, without which reaches have no names."""
    return truth.local and truth.kind != "stops"


def _groups(singles: Sequence[Pair]) -> dict[str, tuple[Share, ...]]:
    groupings: dict[str, Callable[[Truth], str]] = {
        "sample size": lambda t: f"{t.rocks} rocks",
        "kind of observations": lambda t: t.kind,
        "strength": lambda t: t.strengths[0],
        "family": lambda t: t.verdict,
        "law": lambda t: t.law,
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
        # Sizes in the order of their numbers: "20 rocks" before "100 rocks".
        usual = sorted(found, key=lambda v: (int(v.split()[0]) if v[0].isdigit() else 0, v))
        out[title] = tuple(
            share(value, [is_right(t, a) for t, a in singles if value_of(t) == value])
            for value in order.get(title, usual)
            if value in found
        )
    return out


def _shrinkage_pairs(
    pairs: Sequence[Pair], measured: Mapping[str, float | None]
) -> list[tuple[float | None, float | None]]:
    return [
        (a.shrinkage, measured[t.case]) for t, a in pairs if t.case in measured and not a.failure
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


def _column(effect: str) -> str:
    if "+" in effect:
        return "pair"
    return effect if effect in ANSWERS else "no answer"
