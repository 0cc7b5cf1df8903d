"""The blinded check of the diagnosis: labels, answers, scores."""

from __future__ import annotations

import csv
import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gap_check.answers import Answer, Truth, answer_from, is_covered, is_right
from gap_check.check import Site, blinding_hash, check
from gap_check.make import inhomogeneity
from gap_check.motion import table_of
from gap_check.observers import merged_contacts
from gap_check.scores import ANSWERS, score, scores_as_json
from gap_check.worlds import FAMILIES, WorldSpec, battery

from sassgis.errors import InputError
from sassgis.gap.causes import all_causes

#: Answers "none" without looking, but at the case 002, where it fails; sees no more than its case.
SILENT = """
import json, os, pathlib, sys
config, observations, out = sys.argv[1:]
assert pathlib.Path(config).is_file() and "SECRET" not in os.environ
if pathlib.Path.cwd().name == "002":
    sys.exit("nothing to say")
verdict = {"effect": "none", "confidence": 0.7, "confusion_set": ["none"], "adequate": True}
pathlib.Path(out).mkdir()
text = json.dumps({"verdict": verdict, "advice": {}})
pathlib.Path(out, "diagnosis.json").write_text(text)
"""
SITES = [
    Site("001", WorldSpec("gully", n_rocks=20, kind="stops", faults=True), 5),
    Site("002", WorldSpec("quarry", n_rocks=20, kind="everything", n_stations=2), 6),
]


def truth(case: str, verdict: str, strength: str = "strong", **changes: object) -> Truth:
    names = () if verdict == "none" else tuple(verdict.split("+"))
    values: dict[str, object] = {
        "case": case, "verdict": verdict, "effects": ("ice",) if verdict == "unknown" else names,
        "strengths": (strength,) * len(names), "slope": "gully", "rocks": 100,
        "kind": "everything",
    }  # fmt: skip
    return Truth(**{**values, **changes})  # type: ignore[arg-type]


def said(case: str, effect: str, confidence: float = 0.7, **changes: object) -> Answer:
    return Answer(case, effect, confidence, **{"confusion_set": (effect,), **changes})  # type: ignore[arg-type]


# ---------------------------------------------------------------------------------------------
# From sites to scores


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("check") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SECRET", "1")
        check(out, SITES, seed=5, program=SILENT, say=lambda _: None)
    return out


@pytest.fixture
def copy(done: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(done, tmp_path / "out"))


def again(out: Path, sites: list[Site] = SITES) -> None:
    """Go on with a program that must not be asked any more."""
    check(out, sites, seed=5, program="raise SystemExit('asked again')", say=lambda _: None)


def test_a_silent_diagnosis_is_right_at_null_and_a_failure_counts_as_wrong(done: Path) -> None:
    scores = json.loads((done / "scores.json").read_text())
    found = {k: (m["hits"], m["trials"]) for k, m in scores["measures"].items()}
    assert found["null_right"] == found["all_right"] == (1, 2)
    assert found["false_alarm"] == (0, 2) and scores["failed"] == 1
    assert (done / "confusion.png").stat().st_size > 5000
    rows = list(csv.DictReader((done / "worlds.csv").open()))
    assert [(r["case"], r["truth"], r["answer"], r["failure"]) for r in rows] == [
        ("001", "none", "none", ""), ("002", "none", "no answer", "nothing to say"),
    ]  # fmt: skip


def test_cases_tell_nothing_of_the_truth_and_labels_have_the_hash_of_before(done: Path) -> None:
    salt, labels = ((done / "blinded" / n).read_text() for n in ("salt.txt", "labels.json"))
    assert blinding_hash(salt.strip(), labels) == (done / "labels.sha256").read_text().strip()
    assert sorted(p.name for p in (done / "cases" / "002").iterdir()) == [
        "config.toml", "dem.tif", "ground.tif", "observations", "release.gpkg",
    ]  # fmt: skip
    assert "law" not in (done / "cases" / "002" / "config.toml").read_text()


def test_what_was_answered_is_not_asked_again(copy: Path) -> None:
    (copy / "scores.json").unlink()
    again(copy)
    assert json.loads((copy / "scores.json").read_text())["failed"] == 1


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("blinded/labels.json", "labels are not those"),
        ("cases/001/observations/rocks.csv", "case is not the one"),
        ("answers/001/diagnosis.json", "changed after it was given"),
    ],
)
def test_what_was_changed_is_refused_in_one_line(copy: Path, file: str, message: str) -> None:
    with (copy / file).open("a") as stream:
        stream.write("\n")
    with pytest.raises(InputError, match=message) as caught:
        again(copy)
    assert "\n" not in str(caught.value)


def test_another_check_and_a_battery_that_was_fitted_to_are_refused(copy: Path) -> None:
    with pytest.raises(InputError, match="another check"):
        again(copy, SITES[:1])
    with pytest.raises(InputError, match="would flatter"):
        check(copy, SITES, seed=951)


# ---------------------------------------------------------------------------------------------
# Sites


def test_the_battery_has_all_families_of_the_diagnosis_and_all_laws() -> None:
    assert {*FAMILIES} == {*all_causes.FAMILIES}
    specs = battery(1, 150)
    parts = [s.verdict for s in specs]
    assert parts.count("none") == 50 and parts.count("unknown") == 20
    assert sum("+" in verdict for verdict in parts) == 20
    assert all(parts.count(name) == 6 for name in FAMILIES)
    assert {tuple(s.law for s in specs).count(law) for law in ("own", "elastic", "plastic")} == {50}
    assert all(s.faults for s in specs) and battery(1, 150) == specs != battery(2, 150)


def test_the_size_of_a_shift_by_one_deviation() -> None:
    rng = np.random.default_rng(1)
    one, other, same = (rng.normal(m, 1.0, (800, 1)) for m in (0.0, 1.0, 0.0))
    assert inhomogeneity(one, other) == pytest.approx(0.44, abs=0.04)
    assert inhomogeneity(one, same) < 0.08


def test_contacts_that_follow_soon_are_one() -> None:
    rows = [(0, 0, 0, k, 0, 0, 0, 30, 9, -3 + k, 1, 8, 2, k, 5, 100, t)
            for k, t in enumerate((0.0, 0.05, 0.3))]  # fmt: skip
    found = merged_contacts(table_of("impacts", [tuple(map(float, r)) for r in rows]), 0.1)
    assert found["vn_in_mps"].tolist() == [-3.0, -1.0]
    assert found["omega_out_radps"].tolist() == [1.0, 2.0]
    assert found["turn_deg"].tolist() == [10.0, 5.0]


# ---------------------------------------------------------------------------------------------
# Scores by hand


def test_each_share_as_counted_by_hand() -> None:
    truths = [
        truth("1", "none"), truth("2", "none"), truth("3", "none"),
        truth("4", "trees", "weak"), truth("5", "trees"),
        truth("6", "air_drag", "medium", rocks=40, kind="both"),
        truth("7", "soft_ground", "medium", kind="stops"),
        truth("8", "air_drag+trees"), truth("9", "fragmentation+trees"),
        truth("A", "unknown"), truth("B", "unknown"),
    ]  # fmt: skip
    answers = [
        said("1", "none", 0.9),
        said("2", "trees", 0.65, confusion_set=("trees", "none")),
        said("3", "unknown", 0.4),
        said("4", "none", 0.3, confusion_set=("none", "trees"), large_findings=True),
        said("5", "trees", 0.95, group="along the way"),
        said("6", "trees", 0.6, group="along the way"),
        said("7", "soft_ground", 0.5),
        said("8", "trees+air_drag", 0.8),
        said("9", "trees", 0.55, confusion_set=("trees", "fragmentation")),
        said("A", "unknown", 0.7),
        said("B", "roughness", 0.2),
    ]
    measures = score(truths, answers).measures
    assert {key: (own.hits, own.trials) for key, own in measures.items()} == {
        "false_alarm": (1, 3), "null_right": (1, 3),
        "wrong_named": (2, 8),  # 6 and B
        "named_right": (3, 7),  # 5, 7, 8 of 2, 5, 6, 7, 8, 9, B
        "family_full": (1, 1), "group_full": (1, 1), "family_modest": (0, 1),
        "group_modest": (1, 1), "family_full_all": (1, 1), "family_modest_all": (0, 1),
        "family_single": (2, 4), "group_single": (2, 4), "all_right": (5, 11),
        "pair_one_none_wrong": (2, 2), "unknown_named": (1, 2), "unknown_right": (1, 2),
        "none_while_large": (1, 1), "recommended_short": (0, 0),
        # 3 and B are not, 8 and 9 are by their members; 6 and 7 were seen otherwise.
        "covered_everything": (7, 9), "covered_otherwise": (1, 2),
        "confident_right": (4, 6),  # 2 and 6 of 1, 2, 5, 6, 8, A are wrong
    }  # fmt: skip
    alarm = measures["false_alarm"]
    # 1 of 3 in any table of exact binomial limits.
    assert (round(alarm.low, 4), round(alarm.high, 3)) == (0.0084, 0.906)


def test_another_law_may_be_named_and_is_never_a_false_alarm() -> None:
    truths = [
        *(truth(case, "none", law="elastic") for case in "123"),
        truth("4", "none", disturbance="patch"), truth("5", "none"),
        truth("6", "trees", law="elastic"), truth("7", "soft_ground", law="elastic"),
    ]  # fmt: skip
    named = {"2": "none", "3": "roughness"}
    answers = [said(t.case, named.get(t.case, "contact_law"), group="contact") for t in truths]
    scores = score(truths, answers)
    own, elastic = scores.by_law["own"].measures, scores.by_law["elastic"].measures
    assert (elastic["null_right"].hits, elastic["false_alarm"].hits) == (2, 1)
    # At 5 the model's own law holds: naming another one is wrong, and yet no effect.
    assert (own["null_right"].hits, own["null_right"].trials) == (1, 2)
    assert own["false_alarm"].hits == 0
    assert (elastic["family_full"].hits, elastic["group_full"].hits) == (0, 1)


def test_calibration_error_by_hand() -> None:
    """Two bins: 4 answers at 0.9, half of them right; 2 at 0.25, one of them right."""
    stated = [(0.9, True), (0.9, True), (0.9, False), (0.9, False), (0.25, True), (0.25, False)]
    truths = [truth(str(k), "none") for k in range(6)]
    answers = [said(str(k), "none" if ok else "trees", c) for k, (c, ok) in enumerate(stated)]
    numbers = score(truths, answers).numbers
    assert numbers["calibration_error"] == pytest.approx((4 * 0.4 + 2 * 0.25) / 6)
    # By chance: E|share - p| of 4 draws of p = 0.9, and of 2 of p = 0.25, by the binomial laws.
    four = sum(math.comb(4, k) * 0.9**k * 0.1 ** (4 - k) * abs(k / 4 - 0.9) for k in range(5))
    two = sum(math.comb(2, k) * 0.25**k * 0.75 ** (2 - k) * abs(k / 2 - 0.25) for k in range(3))
    by_chance = numbers["calibration_error_by_chance"]
    assert by_chance == pytest.approx((4 * four + 2 * two) / 6, abs=0.01)


def test_what_could_not_be_seen_is_not_asked_for_and_sets_are_counted() -> None:
    truths = [truth("1", "trees"), truth("2", "trees"), truth("3", "trees", kind="stops")]
    answers = [
        said("1", "trees"),
        said("2", "none", cannot_exclude=("trees",), confusion_set=("trees", "none")),
        said("3", "trees", confusion_set=("trees", "none", "air_drag", "unknown")),
    ]
    scores = score(truths, answers)
    found = [scores.measures[key] for key in ("family_full", "family_full_all")]
    assert [(own.hits, own.trials) for own in found] == [(1, 1), (1, 2)]
    numbers = scores.numbers
    assert (numbers["set_size_everything"], numbers["set_size_otherwise"]) == (1.5, 4.0)
    assert scores.confusion[ANSWERS.index("trees"), ANSWERS.index("none")] == 1
    plain = scores_as_json(scores)
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain


def test_a_pair_is_the_same_in_any_order() -> None:
    pair = truth("1", "air_drag+trees")
    assert is_right(pair, said("1", "trees+air_drag")) and not is_right(pair, said("1", "trees"))
    assert is_covered(pair, said("1", "none", confusion_set=("trees", "air_drag")))
    # One of the two is in the set.
    assert is_covered(pair, said("1", "none", confusion_set=("trees",)))
    assert not is_covered(pair, said("1", "none", confusion_set=("none", "roughness")))


def test_sites_and_answers_must_be_the_same() -> None:
    with pytest.raises(ValueError, match="2"):
        score([truth("1", "none")], [said("1", "none"), said("2", "none")])
    with pytest.raises(KeyError):
        answer_from("1", {"advice": {}})


def test_the_command_says_a_fault_in_one_line(repository: Path, copy: Path) -> None:
    script = repository / "pipelines" / "gap_check"
    command = [sys.executable, script, "--worlds", "2", "--seed", "951", "-o", copy]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 1 and run.stderr.count("\n") == 1
    assert run.stderr.startswith("Error: ")
