"""Scores of a check, by hand."""

from __future__ import annotations

import json
import math

import pytest

from sassgis.gap.check.answers import Answer, Truth, answer_from, is_covered, is_right
from sassgis.gap.check.check_scores import AIMS, ANSWERS, acceptance, score, scores_as_json

LEGS = ("release-S1", "S1-S2", "S2-end")


def truth(case: str, verdict: str, strength: str = "strong", **changes: object) -> Truth:
    names = () if verdict == "none" else tuple(verdict.split("+"))
    if verdict == "unknown":
        names = ("snow",)
    alone = len(names) == 1
    values: dict[str, object] = {
        "case": case, "verdict": verdict, "effects": names, "strengths": (strength,) * len(names),
        "phase": "impact" if alone else "", "segments": LEGS if alone else (), "reaches": LEGS,
        "slope": "gully", "rocks": 100, "kind": "everything",
    }  # fmt: skip
    return Truth(**{**values, **changes})  # type: ignore[arg-type]


def said(case: str, effect: str, confidence: float = 0.7, **changes: object) -> Answer:
    return Answer(case, effect, confidence, **{"confusion_set": (effect,), **changes})  # type: ignore[arg-type]


def test_each_share_as_counted_by_hand() -> None:
    truths = [
        truth("1", "none"),
        truth("2", "none"),
        truth("3", "none"),
        truth("4", "trees", "weak", phase="flight", segments=("S1-S2",)),
        truth("5", "trees", "strong", phase="flight", segments=("S1-S2",)),
        truth("6", "air_drag", "medium", rocks=40, kind="both"),
        truth("7", "soft_ground", "medium", segments=("S2-end",), kind="stops"),
        truth("8", "air_drag+trees"),
        truth("9", "fragmentation+trees"),
        truth("A", "unknown"),
        truth("B", "unknown"),
    ]
    answers = [
        said("1", "none", 0.9),
        said("2", "trees", 0.65, confusion_set=("trees", "none")),
        said("3", "unknown", 0.4),
        said("4", "none", 0.3, confusion_set=("none", "trees"), large_findings=True),
        said("5", "trees", 0.95, phase="flight", segments=LEGS[1:], group="along the way"),
        said("6", "trees", 0.6, group="along the way"),
        said("7", "soft_ground", 0.5, phase="impact", segments=("release-end",)),
        said("8", "trees+air_drag", 0.8),
        said("9", "trees", 0.55, confusion_set=("trees", "fragmentation")),
        said("A", "unknown", 0.7),
        said("B", "roughness", 0.2),
    ]
    measures = score(truths, answers).measures
    found = {key: (share.hits, share.trials) for key, share in measures.items()}
    assert found == {
        # Worlds 5 and 7; 7 was seen at its stops only. Groups were stated for 5 and 6.
        "family_full": (1, 1),
        "group_full": (1, 1),
        "family_modest": (0, 1),
        "group_modest": (1, 1),
        "family_full_all": (1, 1),
        "family_modest_all": (0, 1),
        "family_clear": (2, 3),
        "group_clear": (2, 3),
        "family_single": (2, 4),
        "group_single": (2, 4),
        "all_right": (5, 11),
        "false_alarm": (1, 3),
        # 6 and B.
        "wrong_named": (2, 8),
        "null_unknown": (1, 3),
        "null_right": (1, 3),
        # 1 and 4; the gap of 1 is no large one.
        "none_while_large": (1, 1),
        "recommended_short": (0, 0),
        # 3, 6, B are not, 8 and 9 are by their members; 6 and 7 were seen otherwise.
        "covered_everything": (7, 9),
        "covered_otherwise": (1, 2),
        "covered_single": (3, 4),
        # 1, 2, 5, 6, 8, A have confidence: 2 and 6 are wrong.
        "confident_right": (4, 6),
        # 2, 5, 6, 7, 8, 9, B name something: 5, 7, 8 are right.
        "named_right": (3, 7),
        "confident_named_right": (2, 4),
        "unknown_named": (1, 2),
        "unknown_right": (1, 2),
        "pair_one_none_wrong": (2, 2),
        "pair_one": (2, 2),
        "pair_both": (1, 2),
        "pair_wrong": (0, 2),
        "shrinkage_near": (0, 0),
        "shrinkage_near_20": (0, 0),
        "shrinkage_near_40": (0, 0),
        "shrinkage_near_100": (0, 0),
        # 4 and 5 are local and were seen at stations.
        "location_hit": (1, 2),
        "location_hit_named": (1, 1),
    }


def test_another_law_may_be_named_and_is_never_a_false_alarm() -> None:
    truths = [
        *(truth(case, "none", law="elastic") for case in "123"),
        truth("4", "none", disturbance="patch"),
        truth("5", "none"),
        truth("6", "trees", law="elastic"),
        truth("7", "soft_ground", law="elastic"),
    ]
    answers = [
        said("1", "contact_law", group="contact"),
        said("2", "none"),
        said("3", "roughness", group="contact"),
        said("4", "contact_law", confusion_set=("contact_law", "none")),
        said("5", "contact_law"),
        said("6", "contact_law", group="contact"),
        said("7", "contact_law", group="contact"),
    ]
    scores = score(truths, answers)
    own, elastic = scores.by_law["own"].measures, scores.by_law["elastic"].measures
    assert (elastic["null_right"].hits, elastic["false_alarm"].hits) == (2, 1)
    # At 5 the model's own law holds: naming another one is wrong, and yet no effect.
    assert (own["null_right"].hits, own["null_right"].trials) == (1, 2)
    assert own["false_alarm"].hits == 0
    assert (elastic["family_full"].hits, elastic["group_full"].hits) == (0, 1)
    assert elastic["family_full"].trials == elastic["group_full"].trials == 2
    assert scores.worlds == sum(f.worlds for f in scores.by_law.values())


def test_calibration_error_by_hand() -> None:
    """Two bins: 4 answers at 0.9, half of them right; 2 at 0.25, one of them right."""
    truths = [truth(str(k), "none") for k in range(6)]
    stated = [0.9, 0.9, 0.9, 0.9, 0.25, 0.25]
    right = [True, True, False, False, True, False]
    answers = [
        said(str(k), "none" if ok else "trees", c)
        for k, (c, ok) in enumerate(zip(stated, right, strict=True))
    ]
    numbers = score(truths, answers).figures.numbers
    assert numbers["calibration_error"] == pytest.approx((4 * 0.4 + 2 * 0.25) / 6)
    # By chance: E|share - p| of 4 draws of p = 0.9, and of 2 of p = 0.25, by the binomial laws.
    four = sum(math.comb(4, k) * 0.9**k * 0.1 ** (4 - k) * abs(k / 4 - 0.9) for k in range(5))
    two = sum(math.comb(2, k) * 0.25**k * 0.75 ** (2 - k) * abs(k / 2 - 0.25) for k in range(3))
    assert numbers["calibration_error_by_chance"] == pytest.approx(
        (4 * four + 2 * two) / 6, abs=0.01
    )


def test_the_confidence_of_a_named_effect_is_that_it_acts_alone_or_beside_another() -> None:
    truths = [truth("1", "air_drag+trees"), truth("2", "air_drag+trees"), truth("3", "trees")]
    answers = [said("1", "trees", 0.9), said("2", "roughness", 0.9), said("3", "none", 0.9)]
    scores = score(truths, answers)
    assert (scores.measures["confident_right"].hits, scores.measures["all_right"].hits) == (1, 0)
    assert scores.figures.numbers["calibration_error"] == pytest.approx(0.9 - 1 / 3)


def test_what_could_not_be_seen_is_not_asked_for() -> None:
    truths = [truth("1", "trees"), truth("2", "trees")]
    answers = [said("1", "trees"), said("2", "none", cannot_exclude=("trees",))]
    measures = score(truths, answers).measures
    found = [measures[key] for key in ("family_full", "family_full_all")]
    assert [(own.hits, own.trials) for own in found] == [(1, 1), (1, 2)]


def test_sets_are_counted_by_what_was_observed() -> None:
    truths = [truth("1", "trees"), truth("2", "trees"), truth("3", "trees", kind="stops")]
    answers = [
        said("1", "trees", confusion_set=("trees",)),
        said("2", "trees", confusion_set=("trees", "none")),
        said("3", "trees", confusion_set=("trees", "none", "air_drag", "unknown")),
    ]
    numbers = score(truths, answers).figures.numbers
    assert (numbers["set_size_everything"], numbers["set_size_otherwise"]) == (1.5, 4.0)


def test_a_perfect_and_a_silent_diagnosis() -> None:
    verdicts = ["none"] * 4 + ["trees", "roughness", "air_drag+trees", "unknown"]
    truths = [truth(str(k), v) for k, v in enumerate(verdicts)]
    perfect = score(truths, [said(str(k), v, 1.0) for k, v in enumerate(verdicts)])
    assert perfect.measures["all_right"].value == 1.0
    assert perfect.measures["false_alarm"].value == 0.0
    assert perfect.confusion.sum() == perfect.confusion.trace() == len(verdicts)
    silent = score(truths, [said(str(k), "none", 1.0) for k in range(len(verdicts))])
    assert silent.measures["family_single"].hits == 0
    assert silent.measures["false_alarm"].hits == 0
    assert silent.measures["unknown_named"].value == 0.0
    assert silent.measures["confident_right"].hits == 4
    assert silent.confusion[:, 0].sum() == len(verdicts)


def test_intervals_are_those_of_clopper_and_pearson() -> None:
    truths = [truth(str(k), "none") for k in range(10)]
    answers = [said(str(k), "trees" if k < 2 else "none") for k in range(10)]
    alarm = score(truths, answers).measures["false_alarm"]
    # 2 of 10: 2.5 % to 55.6 % in any table of exact binomial limits.
    assert (alarm.value, round(alarm.low, 3), round(alarm.high, 3)) == (0.2, 0.025, 0.556)


def test_confidence_falls_into_bins_and_one_into_the_last() -> None:
    truths = [truth(str(k), "none") for k in range(5)]
    stated = [0.19, 0.6, 0.79, 0.8, 1.0]
    answers = [said(str(k), "none" if c > 0.7 else "trees", c) for k, c in enumerate(stated)]
    rows = score(truths, answers).reliability
    assert [(r.right.hits, r.right.trials) for r in rows] == [
        (0, 1), (0, 0), (0, 0), (1, 2), (2, 2),
    ]  # fmt: skip
    assert rows[3].confidence == pytest.approx(0.695)


def test_a_pair_is_the_same_in_any_order() -> None:
    pair = truth("1", "air_drag+trees")
    assert is_right(pair, said("1", "trees+air_drag"))
    assert not is_right(pair, said("1", "trees"))
    assert is_covered(pair, said("1", "none", confusion_set=("trees", "air_drag")))
    assert not is_covered(pair, said("1", "none", confusion_set=("trees",)))


def test_no_answer_is_a_wrong_one() -> None:
    truths = [truth("1", "none"), truth("2", "trees")]
    failed = [Answer(c, "no answer", math.nan, failure="broke") for c in "12"]
    scores = score(truths, failed)
    assert scores.failed == 2
    assert scores.measures["all_right"].hits == 0
    assert scores.measures["false_alarm"].hits == 0
    assert scores.measures["unknown_named"].trials == 0
    assert scores.confusion[:, ANSWERS.index("no answer")].sum() == 2


def test_shrinkage_is_compared_where_both_are_given() -> None:
    truths = [truth(str(k), "trees") for k in range(5)] + [truth("5", "trees", rocks=40)]
    stated = [0.80, 0.80, None, 0.5, None, 0.5]
    answers = [said(str(k), "trees", shrinkage=s) for k, s in enumerate(stated)]
    fresh = {"0": 0.65, "1": 0.60, "2": 0.9, "3": None, "4": None, "5": 0.5}
    scores = score(truths, answers, fresh)
    found = {n: scores.measures[f"shrinkage_near{n}"] for n in ("", "_20", "_40", "_100")}
    counted = {n: (s.hits, s.trials) for n, s in found.items()}
    assert counted == {"": (2, 3), "_20": (0, 0), "_40": (1, 1), "_100": (1, 2)}
    check = scores.shrinkage
    assert (check.worlds, check.compared) == (6, 3)
    assert (check.only_stated, check.only_measured, check.neither) == (1, 1, 1)
    assert check.bias == pytest.approx(0.35 / 3)


def test_groups_hold_every_single_effect_once() -> None:
    truths = [
        truth("1", "trees", "weak", rocks=20, kind="stops"),
        truth("2", "trees", "strong", rocks=300),
        truth("3", "air_drag", "strong"),
        truth("4", "none"),
    ]
    answers = [said(t.case, "trees") for t in truths]
    groups = score(truths, answers).groups
    assert all(sum(s.trials for s in rows) == 3 for rows in groups.values())
    sizes = [(s.measure, s.hits) for s in groups["sample size"]]
    assert sizes == [("20 rocks", 1), ("100 rocks", 0), ("300 rocks", 1)]
    assert [s.measure for s in groups["strength"]] == ["weak", "strong"]


def test_what_is_asked_for_is_met_only_where_it_is() -> None:
    truths = [truth(str(k), "none") for k in range(60)]
    limit = next(aim.limit for aim in AIMS if aim.key == "false_alarm")
    wrong = int(limit * 60) + 1
    answers = [said(str(k), "trees" if k < wrong else "none") for k in range(60)]
    rows = {row["key"]: row for row in acceptance(score(truths, answers))}
    assert rows["false_alarm"]["met"] is False
    answers = [said(str(k), "trees" if k < wrong - 1 else "none") for k in range(60)]
    rows = {row["key"]: row for row in acceptance(score(truths, answers))}
    assert rows["false_alarm"]["met"] is True and rows["false_alarm"]["sure"] is False
    assert rows["family_full"]["met"] is None


def test_worlds_and_answers_must_be_the_same() -> None:
    with pytest.raises(ValueError, match="2"):
        score([truth("1", "none")], [said("1", "none"), said("2", "none")])


def test_scores_are_plain_json() -> None:
    plain = scores_as_json(score([truth("1", "none")], [said("1", "none")]))
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain


def test_large_findings_are_read_from_the_answer() -> None:
    row = {
        "place": "S1", "phase": "flight", "quantity": "speed_mps", "unit": "m/s", "gap": 3.0,
        "ci95": [2.5, 3.5], "p_adjusted": 0.001, "q_value": 0.001, "rocks": 40, "observed": 9.0,
        "predicted": 6.0, "test": "", "s0_m": 0.0,
        "s1_m": 1.0, "x": 0.0, "y": 0.0,
    }  # fmt: skip
    verdict = {"effect": "none", "confidence": 0.5, "confusion_set": [], "group": "contact"}

    def read(**changes: object) -> Answer:
        where = [{**row, **changes}]
        advice = {"recommended": "ground"}
        return answer_from(
            "1", {"verdict": verdict, "ladder": [], "where": where, "advice": advice}
        )

    assert read().large_findings and read().group == "contact"
    assert not read(p_adjusted=0.2).large_findings
    assert not read(gap=0.2).large_findings
    assert not read(gap=None).large_findings


def test_an_answer_without_a_verdict_is_none() -> None:
    with pytest.raises(KeyError):
        answer_from("1", {"ladder": []})
