"""The blinded check: sites are made, diagnosed, and scored once all answers are there."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import multiprocessing
import os
import secrets
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from gap_check.answers import Answer, Truth, answer_from, is_covered, is_right, label_of, truth_of
from gap_check.make import make_world
from gap_check.observers import CONFIG_NAME, OBSERVATIONS_NAME, write_case
from gap_check.scores import ANSWERS, CheckScores, score, scores_as_json
from gap_check.worlds import LAWS, WorldSpec, battery, world_seeds
from sassgis.errors import InputError
from sassgis.files.atomic_output import write_json, write_text
from sassgis.inputs.observation_values import THRESHOLDS, read_thresholds

#: What a process of its own does: diagnose the case in its folder, the numbers alone.
_DIAGNOSE = (
    "import sys; from sassgis.runs.diagnose import diagnose; "
    "diagnose(sys.argv[1], sys.argv[2], sys.argv[3], report=False, jobs=1, seed=1, overwrite=True)"
)
#: Variables that such a process is given.
_KEPT = ("PATH", "HOME", "LANG", "PYTHONPATH", "SASSGIS_CACHE_DIR", "TMPDIR", "SYSTEMROOT")
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Site:
    """A site of the battery: its number without meaning, what it is, and its seed."""

    case: str
    spec: WorldSpec
    seed: int


def sites_of(seed: int, worlds: int, laws: Sequence[str] = LAWS) -> list[Site]:
    """The sites of a battery, numbered."""
    pairs = zip(battery(seed, worlds, laws), world_seeds(seed, worlds), strict=True)
    return [Site(f"{k:03d}", *own) for k, own in enumerate(pairs, 1)]


def check(
    out: Path,
    sites: Sequence[Site],
    *,
    seed: int,
    jobs: int = 1,
    program: str = _DIAGNOSE,
    say: Callable[[str], None] = print,
) -> CheckScores:
    """Let the diagnosis answer on synthetic sites whose truth is withheld from it, and score it.

    ``OUT/cases`` holds what observers have and know, ``OUT/blinded`` the labels, whose salted hash
    is in ``OUT/labels.sha256``; they are opened when every site has been answered. Each case is
    diagnosed by ``program``, Python that runs in its folder, with a clean environment and the names
    of configuration, observations and answer. A call goes on where the last one ended.

    InputError if weights were fitted to this battery, if the folder holds another one, or if labels
    or cases are not those that were made.
    """
    if seed in read_thresholds()["battery_seeds"]:
        raise InputError(
            "weights were fitted to this battery: scores on it would flatter",
            file=THRESHOLDS, field="battery_seeds", found=f"seed {seed}", expected="another seed",
        )  # fmt: skip
    plan = {"seed": seed, "sites": [f"{s.case} {s.seed} {s.spec}" for s in sites]}
    plan_file = out / "check.json"
    if not plan_file.exists():
        out.mkdir(parents=True, exist_ok=True)
        write_json(plan_file, plan)
    elif json.loads(plan_file.read_text(encoding="utf-8")) != plan:
        raise InputError("holds another check", file=out, expected="another folder")
    if not (out / "labels.sha256").exists():
        _make(out, sites, jobs, say)
    _diagnose(out, sites, jobs, program, say)
    truths = [truth_of(label) for label in _opened(out)]
    answers = [_answer(out, site.case) for site in sites]
    scores = score(truths, answers)
    _report(out, truths, answers, scores)
    return scores


# ---------------------------------------------------------------------------------------------
# Sites and answers


def make_case(spec: WorldSpec, seed: int, case: str, folder: Path) -> dict[str, Any]:
    """Make a site and write its case; ``label`` of it (its truth) and ``digest`` of its files."""
    world = make_world(spec, seed)
    write_case(world, folder, f"World {case}")
    return {"label": label_of(world, case), "digest": folder_digest(folder)}


def folder_digest(folder: Path) -> str:
    """SHA-256 over names and contents of all files of a folder, in the order of their names."""
    total = hashlib.sha256()
    for file in sorted(p for p in folder.rglob("*") if p.is_file()):
        total.update(f"{file.relative_to(folder).as_posix()}\n".encode())
        total.update(hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()


def blinding_hash(salt: str, text: str) -> str:
    """SHA-256 of salt and labels; the salt keeps anyone from trying out what labels may be."""
    return hashlib.sha256(f"{salt}\n{text}".encode()).hexdigest()


def _make_kept(site: Site, folder: Path, kept: Path) -> None:
    """Make a site where it is not there whole: the file ``kept`` is written last."""
    if kept.exists():
        return
    for file in sorted(folder.rglob("*"), reverse=True):
        file.rmdir() if file.is_dir() else file.unlink()
    if folder.exists():
        folder.rmdir()
    write_json(kept, make_case(site.spec, site.seed, site.case, folder))


def _make(out: Path, sites: Sequence[Site], jobs: int, say: Callable[[str], None]) -> None:
    """Write the cases, the labels apart, and the hash of the labels."""
    say(f"Making {len(sites)} sites")
    blinded = out / "blinded"
    (blinded / "single").mkdir(parents=True, exist_ok=True)
    kept = [blinded / "single" / f"{site.case}.json" for site in sites]
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        tasks = [
            pool.submit(_make_kept, site, out / "cases" / site.case, file)
            for site, file in zip(sites, kept, strict=True)
        ]
        for task in _counted(as_completed(tasks), len(tasks), say):
            task.result()
    made = [json.loads(file.read_text(encoding="utf-8")) for file in kept]
    lines = [f"{own['digest']}  cases/{own['label']['case']}\n" for own in made]
    write_text(out / "cases.sha256", "".join(lines))
    salt = secrets.token_hex(32)
    text = json.dumps([own["label"] for own in made], sort_keys=True, indent=1) + "\n"
    write_text(blinded / "salt.txt", f"{salt}\n")
    write_text(blinded / "labels.json", text)
    write_text(out / "labels.sha256", blinding_hash(salt, text) + "\n")


def _diagnose(
    out: Path, sites: Sequence[Site], jobs: int, program: str, say: Callable[[str], None]
) -> None:
    """Let the diagnosis answer where it has not."""
    left = [site.case for site in sites if not (out / "answers" / f"{site.case}.json").exists()]
    say(f"Diagnosing {len(left)} sites")
    (out / "answers").mkdir(exist_ok=True)
    with ThreadPoolExecutor(jobs) as pool:
        tasks = [pool.submit(_diagnose_one, out.resolve(), case, program) for case in left]
        for task in _counted(as_completed(tasks), len(tasks), say):
            task.result()


def _diagnose_one(out: Path, case: str, program: str) -> None:
    """Diagnose a case in a process of its own; what it says when it fails is its answer."""
    answer = out / "answers" / case
    environment = {k: os.environ[k] for k in _KEPT if k in os.environ}
    done = subprocess.run(
        [sys.executable, "-c", program, CONFIG_NAME, OBSERVATIONS_NAME, str(answer)],
        cwd=out / "cases" / case, env=environment | dict.fromkeys(_ONE_THREAD, "1"),
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    said = (done.stderr.strip().splitlines() or ["no output"])[-1]
    digest = folder_digest(answer) if answer.exists() else ""
    failure = said if done.returncode else ""
    write_json(answer.with_suffix(".json"), {"failure": failure, "sha256": digest})


def _counted(things: Iterable[Any], total: int, say: Callable[[str], None]) -> Iterable[Any]:
    for done, thing in enumerate(things, 1):
        say(f"  {done} of {total}")
        yield thing


def _opened(out: Path) -> list[dict[str, Any]]:
    """The labels, if they and the cases are those that were made."""
    text = (out / "blinded" / "labels.json").read_text(encoding="utf-8")
    salt = (out / "blinded" / "salt.txt").read_text(encoding="utf-8").strip()
    expected = (out / "labels.sha256").read_text(encoding="utf-8").strip()
    if blinding_hash(salt, text) != expected:
        raise InputError(
            "the labels are not those that were blinded",
            file=out / "blinded" / "labels.json", expected=f"SHA-256 {expected}",
        )  # fmt: skip
    for line in (out / "cases.sha256").read_text(encoding="utf-8").splitlines():
        digest, name = line.split("  ")
        if folder_digest(out / name) != digest:
            raise InputError(
                "the case is not the one that was made",
                file=out / name, expected=f"SHA-256 {digest}",
            )  # fmt: skip
    labels: list[dict[str, Any]] = json.loads(text)
    return labels


def _answer(out: Path, case: str) -> Answer:
    """What was answered, or that it failed."""
    record = json.loads((out / "answers" / f"{case}.json").read_text(encoding="utf-8"))
    folder = out / "answers" / case
    if not record["failure"] and folder_digest(folder) != record["sha256"]:
        raise InputError(
            "the answer was changed after it was given",
            file=folder, expected=f"SHA-256 {record['sha256']}",
        )  # fmt: skip
    try:
        if not record["failure"]:
            text = (folder / "diagnosis.json").read_text(encoding="utf-8")
            return answer_from(case, json.loads(text))
    except (OSError, ValueError, KeyError, TypeError) as error:
        record["failure"] = f"{type(error).__name__}: {error}"
    return Answer(case, "no answer", math.nan, failure=str(record["failure"]))


# ---------------------------------------------------------------------------------------------
# Report


def _report(
    out: Path, truths: Sequence[Truth], answers: Sequence[Answer], scores: CheckScores
) -> None:
    """Write scores.json, worlds.csv and confusion.png."""
    write_json(out / "scores.json", scores_as_json(scores))
    columns = ("case", "law", "slope", "disturbance", "rocks", "kind")
    with (out / "worlds.csv").open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow([*columns, "truth", "effects", "strengths", "answer", "confidence", "set",
                        "right", "covered", "failure"])  # fmt: skip
        for t, a in zip(truths, answers, strict=True):
            table.writerow(
                [
                    *(getattr(t, name) for name in columns),
                    t.verdict, "+".join(t.effects), "+".join(t.strengths), a.effect,
                    f"{a.confidence:.2f}", " ".join(a.confusion_set),
                    int(is_right(t, a)), int(is_covered(t, a)), a.failure,
                ]
            )  # fmt: skip
    _confusion_figure(scores.confusion, out / "confusion.png")


def _confusion_figure(worlds: NDArray[np.int64], file: Path) -> None:
    """Draw how many sites of each truth were given which answer, shaded by shares of the rows."""
    rows = [k for k in range(len(worlds)) if worlds[k].sum()]
    columns = [k for k in range(worlds.shape[1]) if k in rows or worlds[:, k].sum()]
    shown = worlds[np.ix_(rows, columns)]
    figure, ax = plt.subplots(figsize=(7.0, 2.0 + 0.3 * len(rows)), layout="constrained")
    ax.imshow(shown / shown.sum(axis=1)[:, None], cmap="Blues", vmin=0.0, vmax=1.5, aspect="auto")
    for (i, j), number in np.ndenumerate(shown):
        weight = "bold" if rows[i] == columns[j] else "normal"
        ax.text(j, i, str(number), ha="center", va="center", weight=weight)
    names = [name.replace("_", " ") for name in ANSWERS]
    ax.set_xticks(range(len(columns)), [names[k] for k in columns], rotation=45, ha="right")
    ax.set_yticks(range(len(rows)), [names[k] for k in rows])
    ax.set(xlabel="answer", ylabel="truth", title="Answers by truth (sites)")
    figure.savefig(file, dpi=150)
    plt.close(figure)
