"""The blind check: blinded labels, fenced processes, resuming, what is written."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from sassgis.gap.check.blinded_labels import blinding_hash, labels_text
from sassgis.gap.check.sandbox import Task
from sassgis.gap.check.worlds import EffectSpec, WorldSpec
from sassgis.io.read.gap_thresholds import read_thresholds
from sassgis.io.saved_arrays import unfit
from sassgis.model.errors import InputError, OutputError
from sassgis.runs import gap_check
from sassgis.runs.gap_check import check, in_own_process

SEED = 5
#: Few and small, as making worlds takes time; three of four have no effect to be brought to size.
SPECS = [
    WorldSpec("gully", n_rocks=20, kind="both"),
    WorldSpec("quarry", (EffectSpec("trees", "strong"),), n_rocks=40, kind="both"),
    WorldSpec("talus_fan", n_rocks=20, kind="everything", law="elastic", n_stations=2),
    WorldSpec("talus_fan", n_rocks=20, kind="stops"),
]


@pytest.fixture(scope="session", autouse=True)
def few_worlds() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gap_check, "quick_battery", lambda _seed: SPECS)
        yield


@pytest.fixture(scope="session")
def thresholds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("thresholds") / "thresholds.json"
    file.write_text(json.dumps({"battery_seeds": [1, 2]}))
    return file


def run(out: Path, thresholds: Path, **changes: Any) -> gap_check.CheckResult:
    options: dict[str, Any] = {
        "quick": True,
        "seed": SEED,
        "jobs": 2,
        "thresholds": thresholds,
        "diagnoser": "helpers.check_stubs:all_none",
        "measurer": "helpers.check_stubs:measured",
    }
    return check(out, **{**options, **changes})


@pytest.fixture(scope="session")
def done(tmp_path_factory: pytest.TempPathFactory, thresholds: Path) -> Path:
    """A check whose diagnoser fell over once, and that was gone on with."""
    out = tmp_path_factory.mktemp("check") / "out"
    with pytest.raises(OutputError, match=r"same task, 004 \(exit code 3\)"):
        run(out, thresholds, jobs=1, diagnoser="helpers.check_stubs:stops_at_four")
    assert (out / "labels.sha256").exists()
    assert [p.name for p in (out / "blinded").iterdir()] == ["salt.txt"]
    assert not (out / "answers.sha256").exists()
    there = {p: p.stat().st_mtime_ns for p in (out / "answers").glob("*/diagnosis.json")}
    assert [p.parent.name for p in sorted(there)] == ["001", "002", "003"]
    cases = {p: p.stat().st_mtime_ns for p in (out / "cases").rglob("*")}
    run(out, thresholds, diagnoser="helpers.check_stubs:stops_at_four")
    assert all(p.stat().st_mtime_ns == t for p, t in {**there, **cases}.items())
    return out


@pytest.fixture
def copy(done: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(done, tmp_path / "out"))


def without_answers(out: Path) -> Path:
    """Back to where the worlds are made and nothing is answered."""
    shutil.rmtree(out / "answers")
    (out / "answers").mkdir()
    for name in ("answers.sha256", "blinded/labels.json"):
        (out / name).unlink()
    return out


@pytest.mark.battery
def test_a_silent_diagnosis_is_right_at_null_alone(done: Path) -> None:
    scores = json.loads((done / "scores.json").read_text())
    found = {k: (m["hits"], m["trials"]) for k, m in scores["measures"].items()}
    assert found["null_right"] == (3, 3)
    assert found["family_single"] == (0, 1)
    assert found["unknown_named"] == (0, 0)
    assert found["all_right"] == (3, 4)
    assert scores["quick"] and not scores["development"] and scores["failed"] == 0
    assert len(scores["thresholds_sha256"]) == 64
    assert any("quick" in line for line in scores["warnings"])
    for name in ("report.html", "confusion.png", "reliability.png"):
        assert (done / name).stat().st_size > 5000
    rows = list(csv.DictReader((done / "worlds.csv").open()))
    assert [r["case"] for r in rows] == [f"00{k}" for k in range(1, 5)]
    assert [r["truth"] for r in rows] == [s.verdict for s in SPECS]


@pytest.mark.battery
def test_processes_of_a_cluster_give_the_same_answers(
    done: Path, thresholds: Path, tmp_path: Path
) -> None:
    pytest.importorskip(
        "distributed", reason='dask is not installed: pip install "sassgis[cluster]"'
    )
    from helpers.local_cluster import local_cluster

    out = tmp_path / "out"
    with local_cluster(2) as two:
        with pytest.raises(OutputError, match=r"same task, 004 \(exit code 3\)"):
            run(out, thresholds, jobs=two, diagnoser="helpers.check_stubs:stops_at_four")
        run(out, thresholds, jobs=two, diagnoser="helpers.check_stubs:stops_at_four")
    for names in ("cases/*/observations/*.csv", "answers/*/diagnosis.json"):
        made = {p.relative_to(out): p.read_bytes() for p in out.glob(names)}
        assert made == {p.relative_to(done): p.read_bytes() for p in done.glob(names)}, names
        assert made


def test_a_peek_at_the_sites_is_refused_in_a_process_of_its_own(tmp_path: Path) -> None:
    peek = Task("001", "importlib:import_module", ("sassgis.gap.check.worlds",))
    assert in_own_process(None, peek).failure == ""
    assert "must not be seen" in in_own_process(tmp_path, peek).failure


@pytest.mark.battery
def test_the_labels_have_the_hash_that_was_written_before(done: Path) -> None:
    text = (done / "blinded" / "labels.json").read_text()
    salt = (done / "blinded" / "salt.txt").read_text().strip()
    blinded, answered = done / "labels.sha256", done / "answers" / "001.json"
    assert blinded.read_text().split()[0] == blinding_hash(salt, text)
    assert blinded.stat().st_mtime_ns < answered.stat().st_mtime_ns
    assert (done / "answers.sha256").stat().st_mtime_ns < (
        done / "blinded" / "labels.json"
    ).stat().st_mtime_ns
    assert labels_text(json.loads(text)[::-1]) == text


@pytest.mark.battery
def test_cases_tell_nothing_of_the_truth(done: Path) -> None:
    truths = {e.name for s in SPECS for e in s.effects}
    seeds = {str(label["seed"]) for label in json.loads((done / "blinded/labels.json").read_text())}
    files = [p for p in (done / "cases").rglob("*") if p.is_file()]
    assert {p.suffix for p in files} == {".toml", ".tif", ".gpkg", ".csv"}
    for path in files:
        content = path.read_bytes()
        for word in truths | seeds | {"strong", "effect"}:
            assert word.encode() not in content, (path, word)


@pytest.mark.battery
@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("blinded/labels.json", lambda t: t.replace('"none"', '"trees"'), "not those that were"),
        ("blinded/salt.txt", lambda t: t[::-1], "not those that were blinded"),
        ("labels.sha256", lambda t: "0" * 64 + t[64:], "not those that were blinded"),
        ("answers/002/diagnosis.json", lambda t: t.replace("none", "trees"), "were changed"),
        ("answers/002.json", lambda t: t.replace('""', '"x"'), "were changed"),
        ("cases/003/observations/rocks.csv", lambda t: t + "R99\n", "not the one that was made"),
    ],
)
def test_tampering_is_found_out(
    copy: Path, thresholds: Path, name: str, change: Callable[[str], str], message: str
) -> None:
    text = (copy / name).read_text()
    changed = change(text)
    assert changed != text
    (copy / name).write_text(changed)
    with pytest.raises(InputError, match=message):
        run(copy, thresholds)


@pytest.mark.battery
def test_labels_made_anew_must_have_the_blinded_hash(copy: Path, thresholds: Path) -> None:
    (copy / "blinded" / "labels.json").unlink()
    (copy / "labels.sha256").write_text("0" * 64 + "  forged\n")
    with pytest.raises(InputError, match="labels made anew"):
        run(copy, thresholds)
    assert not (copy / "blinded" / "labels.json").exists()


@pytest.mark.battery
def test_an_answer_that_is_gone_is_not_given_again(copy: Path, thresholds: Path) -> None:
    (copy / "answers" / "002.json").unlink()
    with pytest.raises(InputError, match=r"002\.json"):
        run(copy, thresholds)
    (copy / "answers.sha256").unlink()
    with pytest.raises(InputError, match="labels have been opened"):
        run(copy, thresholds)


@pytest.mark.battery
def test_a_knowing_diagnosis_scores_in_full_but_for_where_it_breaks(
    copy: Path, thresholds: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gap_check, "FRESH_ROCKS", 30)
    labels = json.loads((copy / "blinded" / "labels.json").read_text())
    said: dict[str, dict[str, Any]] = {
        "001": {"effect": "none", "confidence": 0.9},
        "002": {
            "effect": "trees",
            "confidence": 0.9,
            "phase": "flight",
            "segments": labels[1]["effects"][0]["segments"][:1],
            "shrinkage": 0.1,
        },
        "003": {"effect": "break"},
        "004": {"effect": "none", "confidence": 0.3},
    }
    (copy.parent / "told.json").write_text(json.dumps(said))
    result = run(without_answers(copy), thresholds, diagnoser="helpers.check_stubs:told")
    measures = result.scores.measures
    found = {key: (share.hits, share.trials) for key, share in measures.items()}
    assert found["family_single"] == (1, 1)
    assert found["null_right"] == (2, 3)
    assert found["false_alarm"] == (0, 3)
    assert found["confident_right"] == (2, 2)
    assert found["location_hit"] == (1, 1)
    assert result.scores.failed == 1
    assert any("failed" in line for line in result.warnings)
    record = json.loads((copy / "answers" / "003.json").read_text())
    assert record["failure"] == "ZeroDivisionError: no way"
    # The stub measures 0.015 on 30 fresh rocks.
    assert found["shrinkage_near"] == (1, 1)
    assert [p.name for p in (copy / "shrinkage").iterdir()] == ["002.json"]
    file = copy / "shrinkage" / "002.json"
    text = file.read_text()
    measured = json.loads(text)
    measured.pop("digest")
    distances = {"D_configured": 2.0, "D_base": 1.0, "D_effect": 0.5, "D_floor": None}
    assert measured == {"failure": "", "S": 0.015, **distances}
    assert not (copy / "fresh").exists()
    # A measurement that somebody betters is made again.
    file.write_text(text.replace("0.015", "0.9"))
    heard: list[str] = []
    run(copy, thresholds, diagnoser="helpers.check_stubs:told", say=heard.append)
    assert file.read_text() == text
    assert [line for line in heard if "is not used" in line] == [unfit(file)]


@pytest.mark.battery
def test_answers_that_were_changed_before_all_were_given_are_given_again(
    copy: Path, thresholds: Path
) -> None:
    for name in ("answers.sha256", "blinded/labels.json"):
        (copy / name).unlink()
    answers = copy / "answers"
    files = [answers / "001" / "diagnosis.json", answers / "002.json", answers / "003.json"]
    before = [file.read_text() for file in files]
    files[0].write_text(before[0].replace("none", "trees"))
    files[1].write_text(before[1].replace('""', '"x"'))
    files[2].write_text((answers / "004.json").read_text())
    said: list[str] = []
    run(copy, thresholds, say=said.append)
    told = [line for line in said if "is not used" in line]
    assert told == [unfit(answers / "001"), unfit(files[1]), unfit(files[2])]
    assert files[0].read_text() == before[0]
    assert [json.loads(file.read_text())["failure"] for file in files[1:]] == ["", ""]


def task(root: Path, stub: str) -> Task:
    for number in ("001", "002"):
        (root / "cases" / number).mkdir(parents=True)
        (root / "cases" / number / "config.toml").write_text("")
    for name in ("check.json", "blinded/salt.txt"):
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_text("{}")
    (root / "answers").mkdir()
    case, out = root / "cases" / "001", root / "answers" / "001"
    return Task(
        "001", f"helpers.check_stubs:{stub}", (str(case), str(case), str(out)), {}, (case, out)
    )


def test_the_diagnosing_process_cannot_load_the_worlds(tmp_path: Path) -> None:
    outcome = in_own_process(tmp_path, task(tmp_path, "peeks_at_modules"))
    assert outcome.failure == ""
    assert "sassgis.gap.check.worlds" in (tmp_path / "answers/001/refused.txt").read_text()


def test_the_diagnosing_process_sees_its_own_case_alone(tmp_path: Path) -> None:
    outcome = in_own_process(tmp_path, task(tmp_path, "peeks_at_files"))
    assert outcome.failure == ""
    refused = json.loads((tmp_path / "answers/001/refused.json").read_text())
    assert refused == ["check.json", "blinded/salt.txt", "cases/002/config.toml", "cases"]


def test_a_battery_that_thresholds_were_chosen_on_is_refused(
    tmp_path: Path, thresholds: Path
) -> None:
    with pytest.raises(InputError, match="--development"):
        run(tmp_path / "out", thresholds, seed=2)
    assert not (tmp_path / "out").exists()


def test_thresholds_must_say_where_they_come_from(tmp_path: Path) -> None:
    file = tmp_path / "t.json"
    file.write_text("{}")
    with pytest.raises(InputError, match="battery_seeds"):
        read_thresholds(file)
    with pytest.raises(InputError, match="cannot be read"):
        read_thresholds(tmp_path / "none.json")


@pytest.mark.battery
def test_another_check_is_not_mixed_in(copy: Path, thresholds: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="another check"):
        run(copy, thresholds, seed=7)
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="is no check"):
        run(tmp_path / "own", thresholds)


def test_what_the_calling_program_has_loaded_does_not_pass_the_sandbox(tmp_path: Path) -> None:
    script = tmp_path / "program.py"
    script.write_text(
        "import sys\n"
        "from pathlib import Path\n"
        "import sassgis.gap.check.worlds\n"
        "from sassgis.gap.check.sandbox import Task\n"
        "from sassgis.runs.gap_check import in_own_process\n"
        "task = Task('1', 'os.path:basename', ('a/b',))\n"
        "print(in_own_process(Path(sys.argv[1]), task).value)\n"
    )
    ran = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "out")], capture_output=True, text=True
    )
    assert (ran.returncode, ran.stdout) == (0, "b\n"), ran.stderr


def test_a_process_that_is_killed_is_said_with_its_world(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"same task, 001 \(killed; memory"):
        in_own_process(tmp_path, task(tmp_path, "is_killed"))


def test_workers_compute_in_a_single_thread() -> None:
    outcome = in_own_process(None, Task("1", "helpers.check_stubs:threads"))
    assert outcome.value == {"numba": 1, "others": [1]}
