"""How good a diagnosis is, from its answers on sites whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gap_check.answers import OWN_LAW, Answer, Truth, holds, is_covered, is_right, names_in
from sassgis.gap.causes.all_causes import FAMILIES
from sassgis.gap.diagnosis import without_nan
from sassgis.gap.fit.hypothesis_fit import CONTACT_LAW

#: Least confidence with which an effect is named.
NAMED_CONFIDENCE = 0.6
_ECE_BINS = 10
#: Draws of the calibration error by chance.
_CHANCE_DRAWS = 2000
#: Columns of the confusion matrix; rows are the first of them, without "no answer".
ANSWERS: tuple[str, ...] = ("none", *FAMILIES, "pair", "unknown", CONTACT_LAW, "no answer")

Pair = tuple[Truth, Answer]


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
class CheckScores:
    """Scores of some sites: of a check, or of those of one law."""

    worlds: int
    failed: int  # sites without an answer; they count as wrong
    measures: Mapping[str, Share]
    #: What is no share: sizes of confusion sets, calibration error; NaN without sites.
    numbers: Mapping[str, float]
    by_law: Mapping[str, CheckScores]  # of a check
    #: Sites by truth (``ANSWERS`` without the last) and answer (``ANSWERS``).
    confusion: NDArray[np.int64]


def score(truths: Iterable[Truth], answers: Iterable[Answer]) -> CheckScores:
    """Score answers, one for each site, in any order; ValueError if they are of other sites."""
    known = {truth.case: truth for truth in truths}
    given = {answer.case: answer for answer in answers}
    if known.keys() != given.keys():
        odd = sorted(known.keys() ^ given.keys())
        raise ValueError(f"sites and answers differ: {', '.join(odd)}")
    pairs = [(known[case], given[case]) for case in sorted(known)]
    laws = sorted({truth.law for truth, _ in pairs}, key=lambda law: (law != OWN_LAW, law))
    by_law = {law: _scores([p for p in pairs if p[0].law == law]) for law in laws}
    return replace(_scores(pairs), by_law=by_law)


def scores_as_json(scores: CheckScores) -> dict[str, Any]:
    """The scores as plain values; missing numbers become None."""

    def figures(own: CheckScores) -> dict[str, Any]:
        measures = {key: asdict(share) for key, share in own.measures.items()}
        return {"worlds": own.worlds, "measures": measures, "numbers": own.numbers}

    plain: dict[str, Any] = without_nan(
        {
            "failed": scores.failed,
            **figures(scores),
            "by_law": {law: figures(own) for law, own in scores.by_law.items()},
            "confusion": {"answer": list(ANSWERS), "worlds": scores.confusion.tolist()},
        }
    )
    return plain


def _scores(pairs: Sequence[Pair]) -> CheckScores:
    """All scores of some sites but those by law."""

    def column(effect: str) -> int:
        name = "pair" if "+" in effect else effect
        return ANSWERS.index(name if name in ANSWERS else "no answer")

    confusion = np.zeros((len(ANSWERS) - 1, len(ANSWERS)), np.int64)
    for truth, answer in pairs:
        confusion[column(truth.verdict), column(answer.effect)] += 1
    answered = [(t.kind == "everything", len(a.confusion_set)) for t, a in pairs if not a.failure]
    sizes = {
        "set_size_everything": [size for whole, size in answered if whole],
        "set_size_otherwise": [size for whole, size in answered if not whole],
    }
    numbers = {key: float(np.mean(v)) if v else math.nan for key, v in sizes.items()}
    return CheckScores(
        worlds=len(pairs), failed=sum(bool(a.failure) for _, a in pairs),
        measures=_measures(pairs), numbers=numbers | _calibration(pairs), by_law={},
        confusion=confusion,
    )  # fmt: skip


def _measures(pairs: Sequence[Pair]) -> dict[str, Share]:
    nulls, singles, doubles, unknown = (
        [p for p in pairs if p[0].part == part] for part in ("none", "single", "pair", "unknown")
    )
    clear = [p for p in singles if p[0].strengths[0] != "weak"]
    full = [p for p in clear if (p[0].rocks, p[0].kind) == (100, "everything")]
    modest = [p for p in clear if (p[0].rocks, p[0].kind) == (40, "both")]

    def seen(chosen: Sequence[Pair]) -> list[Pair]:
        # What could not be seen is listed in the answer, and never named.
        return [(t, a) for t, a in chosen if not {*t.effects} & {*a.cannot_exclude}]

    def names_one(_truth: Truth, answer: Answer) -> bool:
        return bool(names_in(answer.effect))

    def grouped(truth: Truth, answer: Answer) -> bool:
        return answer.group in truth.groups

    def one_and_none_wrong(truth: Truth, answer: Answer) -> bool:
        return names_one(truth, answer) and names_in(answer.effect) <= {*truth.effects}

    whole = [p for p in pairs if p[0].kind == "everything"]
    parts = [p for p in pairs if p[0].kind != "everything"]
    # Words, what is asked of a truth and an answer, and of which of them.
    found: dict[str, tuple[str, Callable[[Truth, Answer], bool], Sequence[Pair]]] = {
        "false_alarm": ("no effect, yet one is named", names_one, nulls),
        "null_right": ("no effect, answer none, or contact law where it is one", is_right, nulls),
        "wrong_named": (
            "an effect, yet one is named that is not there",
            lambda t, a: bool(names_in(a.effect) - {*t.effects}),
            [p for p in pairs if p[0].effects],
        ),
        "named_right": (
            "right where an effect is named", is_right, [p for p in pairs if names_one(*p)],
        ),
        "family_full": ("medium or strong, seen, 100 rocks, everything", is_right, seen(full)),
        "group_full": ("the same, group right", grouped, seen(full)),
        "family_modest": ("medium or strong, seen, 40 rocks, both", is_right, seen(modest)),
        "group_modest": ("the same, group right", grouped, seen(modest)),
        "family_full_all": ("seen or not, 100 rocks, everything", is_right, full),
        "family_modest_all": ("seen or not, 40 rocks, both", is_right, modest),
        "family_single": ("single, all strengths and designs", is_right, singles),
        "group_single": ("the same, group right", grouped, singles),
        "all_right": ("all sites", is_right, pairs),
        "pair_one_none_wrong": (
            "pair, at least one right and none wrong", one_and_none_wrong, doubles,
        ),
        "unknown_named": ("unknown effect, a known one named", names_one, unknown),
        "unknown_right": ("unknown effect, answer unknown", is_right, unknown),
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
        "covered_everything": ("truth in the set, everything observed", is_covered, whole),
        "covered_otherwise": ("truth in the set, other observations", is_covered, parts),
        "confident_right": (
            "so where confident", holds, [p for p in pairs if p[1].confidence >= NAMED_CONFIDENCE],
        ),
    }  # fmt: skip
    return {key: _share(words, [test(*p) for p in of]) for key, (words, test, of) in found.items()}


def _share(measure: str, hits: list[bool]) -> Share:
    """A share with its 95 % interval, never too narrow (C. J. Clopper and E. S. Pearson, 1934)."""
    n, own = len(hits), sum(hits)
    if not n:
        return Share(measure, 0, 0, math.nan, 0.0, 1.0)
    found = stats.binomtest(own, n).proportion_ci(0.95, "exact")
    return Share(measure, own, n, own / n, float(found.low), float(found.high))


def _calibration(pairs: Sequence[Pair]) -> dict[str, float]:
    """Expected calibration error in ten bins (Guo, Pleiss, Sun and Weinberger 2017, eq. 3).

    The mean, over the answers, of |share right − mean confidence| in the bin of each; and its mean
    if each of as many answers is right with its confidence. NaN without a stated confidence.
    """
    own = [(a.confidence, holds(t, a)) for t, a in pairs if math.isfinite(a.confidence)]
    confidence, right = np.array(own, float).reshape(-1, 2).T
    drawn = np.random.default_rng(41).random((_CHANCE_DRAWS, confidence.size)) < confidence
    # Bins are open below and closed above, as in the source.
    within = np.clip(np.ceil(confidence * _ECE_BINS) - 1, 0, _ECE_BINS - 1)

    def error(hits: NDArray[Any]) -> float:
        if not confidence.size:
            return math.nan
        off = hits - confidence
        apart = [np.abs(off[..., within == k].sum(axis=-1)) for k in range(_ECE_BINS)]
        return float(np.mean(np.sum(apart, axis=0) / confidence.size))

    return {"calibration_error": error(right), "calibration_error_by_chance": error(drawn)}
