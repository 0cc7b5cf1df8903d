"""The blind check of the diagnosis: sites with blinded labels, answers, scores."""

from __future__ import annotations

import hashlib
import json
import math
import secrets
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from sassgis.gap.check.answers import Answer, Truth, answer_from, names_in
from sassgis.gap.check.blinded_labels import blinding_hash, labels_text, truth_of
from sassgis.gap.check.check_scores import CheckScores, score
from sassgis.gap.check.sandbox import Task, TaskOutcome, perform
from sassgis.gap.check.worlds import WorldSpec, battery, quick_battery, require_library, world_seeds
from sassgis.io.atomic_output import (
    alone,
    partial_folder,
    staged_output,
    write_json,
    write_text,
    writing,
)
from sassgis.io.digests import content_digest, program_digest
from sassgis.io.read.gap_thresholds import THRESHOLDS, read_thresholds
from sassgis.io.saved_arrays import read_saved_json, unfit, with_digest
from sassgis.io.write.gap_case_files import CONFIG_NAME, OBSERVATIONS_NAME, folder_digest
from sassgis.model.errors import InputError, Interrupted, OutputError
from sassgis.report.gap_check_report import CheckRecord, WorldRow, write_check
from sassgis.runs.workers import Jobs, OnProgress, Processes, Workers, available_cores

WORLDS = 150
#: Seed of the battery, if none is given.
SEED = 2026
#: Rocks on which a stated shrinkage is checked.
FRESH_ROCKS = 300
DIAGNOSER = "sassgis.runs.diagnose:answer"
MEASURER = "sassgis.runs.diagnose:measured_shrinkage"

_FORMAT = 2
_MAKER = "sassgis.runs.blinded_cases"
#: Sites whose fresh rocks are on the disk at the same time.
_BATCH = 8


def read_json(file: Path) -> dict[str, Any]:
    """Read an object; InputError if it is none."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("cannot be read", file=file, found=reason) from None
    if not isinstance(content, dict):
        raise InputError("cannot be read", file=file, expected="a JSON object")
    return content


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What a check found."""

    scores: CheckScores
    warnings: tuple[str, ...]


def check(
    out: str | Path,
    *,
    worlds: int = WORLDS,
    seed: int = SEED,
    law: str | None = None,
    jobs: Jobs = None,
    quick: bool = False,
    development: bool = False,
    diagnoser: str = DIAGNOSER,
    measurer: str = MEASURER,
    thresholds: Path | None = None,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
) -> CheckResult:
    """Let the diagnosis answer on synthetic sites whose truth is withheld from it, and score it.

    First all sites are made; what their observers have and know is written to ``cases``, of the
    truth nothing but a hash (``labels.sha256``). Each site is then diagnosed in a process that
    cannot load the synthetic sites and sees nothing of the folder but its own case and answer. When
    all answers are there, their hashes are written, the sites are made a second time, and the
    labels, which must have the hash that was written before, are put beside the answers.

    An interrupted check goes on with the same call.

    Parameters
    ----------
    out : path
        Folder of the check.
    seed : int
        Of the battery.
    law : str, optional
        Of the motion at all sites; default: all in turn.
    jobs : int or Workers, optional
        Processes of this machine, default: one for each core; or processes of a cluster, to all of
        which ``out`` is the same folder.
    quick : bool
        Six small sites, to see whether everything runs.
    development : bool
        Whether a battery may be used on which thresholds were chosen; the scores then say so.
    diagnoser, measurer : str
        Functions as "module:name", called as ``diagnose(config, observations, out, jobs=1,
        seed=, overwrite=True)`` and ``measured_shrinkage(config, fresh, answer_folder)``.
    thresholds : Path, optional
        Frozen thresholds of the diagnosis; default: those of the package.
    on_progress : callable, optional
        Called with (steps done, steps in all, rocks diagnosed).
    say : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If this battery was looked at while the thresholds were chosen; if labels, cases or answers
        are not those that were blinded.
    OutputError
        If the folder holds something else, or cannot be written.
    Interrupted
        If the user stops it; all answers are kept.
    """
    digest = _thresholds_digest(thresholds, seed, development)
    work = _Check(
        Path(out),
        _battery(seed, worlds, law, quick),
        jobs or available_cores(),
        on_progress or (lambda _done, _total, _rocks: None),
        say or (lambda _text: None),
    )
    plan = {
        "format": _FORMAT,
        "seed": seed,
        "law": law,
        "worlds": len(work.planned),
        "quick": quick,
        "development": development,
        "thresholds_sha256": digest,
    }
    try:
        programs = work.claim(plan)
        require_library(site.spec.law for site in work.planned)
        if not (work.blinding.exists() and work.cases.is_dir()):
            work.make()
        if not work.answer_list.exists():
            work.answer_all(diagnoser)
        if not work.labels.exists():
            work.open()
        truths = work.truths()
        answers = {site.case: work.read_answer(site.case) for site in work.planned}
        work.measure(answers, measurer)
    except KeyboardInterrupt:
        raise Interrupted(
            f"stopped by the user; what was made and answered is kept in {work.root}: "
            "the same command goes on from there"
        ) from None
    return work.conclude(plan, programs, truths, answers)


def _thresholds_digest(file: Path | None, seed: int, development: bool) -> str:
    if seed in read_thresholds(file)["battery_seeds"] and not development:
        raise InputError(
            "this battery was looked at while the diagnosis was made: scores on it would flatter",
            file=file or THRESHOLDS,
            field="battery_seeds",
            found=f"seed {seed}",
            expected="another --seed, or --development",
        )
    return content_digest(file or THRESHOLDS)


@dataclass(frozen=True, slots=True)
class _Site:
    """A site of the battery: its name, what it is, and its seed."""

    case: str
    spec: WorldSpec
    seed: int


def _battery(seed: int, worlds: int, law: str | None, quick: bool) -> list[_Site]:
    laws = {"laws": (law,)} if law else {}
    specs = quick_battery(seed, **laws) if quick else battery(seed, worlds, **laws)
    numbered = enumerate(zip(specs, world_seeds(seed, len(specs)), strict=True), start=1)
    width = max(3, len(str(len(specs))))
    return [_Site(f"{k:0{width}d}", spec, own) for k, (spec, own) in numbered]


class _Check:
    """The files of a check, and its steps."""

    def __init__(
        self,
        root: Path,
        planned: Sequence[_Site],
        jobs: int | Workers,
        step: OnProgress,
        tell: Callable[[str], None],
    ) -> None:
        self.root, self.planned, self.jobs, self.step, self.tell = root, planned, jobs, step, tell
        self.plan = root / "check.json"  # what was asked for
        self.blinding = root / "labels.sha256"  # hash of the labels
        self.case_list = root / "cases.sha256"  # digests of the cases
        self.answer_list = root / "answers.sha256"  # digests of the answers
        self.salt = root / "blinded" / "salt.txt"  # what blinds the labels
        self.labels = root / "blinded" / "labels.json"  # the truth, opened at the end
        self.cases = root / "cases"  # all cases

    def answer(self, case: str) -> Path:
        """What the diagnosis wrote."""
        return self.root / "answers" / case

    def record(self, case: str) -> Path:
        """That it answered, or why not."""
        return self.root / "answers" / f"{case}.json"

    def fresh(self, case: str) -> Path:
        """Rocks that no diagnosis has seen."""
        return partial_folder(self.root / "fresh") / case

    def measured(self, case: str) -> Path:
        """The shrinkage on them."""
        return self.root / "shrinkage" / f"{case}.json"

    def claim(self, plan: dict[str, Any]) -> list[str]:
        """Take the folder, or go on in it; returns the states of the program that worked in it."""
        own, programs = program_digest(), []
        if self.plan.exists():
            there = read_json(self.plan)
            programs = [str(p) for p in there.pop("programs", [])]
            if there != plan:
                keys = [k for k in plan if there.get(k) != plan[k]]
                raise OutputError(
                    f"{self.root}: holds another check ({', '.join(keys)} differ); "
                    "choose another folder"
                )
        else:
            with writing(self.root):
                if self.root.exists() and (not self.root.is_dir() or any(self.root.iterdir())):
                    raise OutputError(f"{self.root}: exists and is no check; choose another folder")
                self.root.mkdir(parents=True, exist_ok=True)
        # What comes after the answers does not make them other than they are.
        if own not in programs and not self.answer_list.exists():
            programs.append(own)
        write_json(self.plan, {**plan, "programs": programs})
        return programs

    def _all(self, function: str, args: Callable[[_Site], tuple[Any, ...]]) -> dict[str, Any]:
        """What a function of the maker gives for each site; it must not fail."""
        tasks = [Task(w.case, f"{_MAKER}:{function}", args(w)) for w in self.planned]
        values: dict[str, Any] = {}
        with _processes(self.jobs) as each:
            for outcome in each(tasks):
                if outcome.failure:
                    raise OutputError(f"site {outcome.name} cannot be made: {outcome.failure}")
                values[outcome.name] = outcome.value
                self.step(len(values), len(tasks), 0)
        return values

    def make(self) -> None:
        """Write the cases, and the hash of their labels, which stay in memory until it is there."""
        self.tell(f"Making {len(self.planned)} sites")
        with staged_output(self.cases, overwrite=False) as work:
            made = self._all("make_case", lambda w: (w.spec, w.seed, w.case, str(work / w.case)))
            salt = secrets.token_hex(32)
            write_text(self.salt, f"{salt}\n")
            lines = [f"{made[w.case]['digest']}  cases/{w.case}" for w in self.planned]
            write_text(self.case_list, "\n".join(lines) + "\n")
            digest = blinding_hash(salt, labels_text([made[w.case]["label"] for w in self.planned]))
            write_text(self.blinding, f"{digest}  blinded/salt.txt + blinded/labels.json\n")

    def answer_all(self, diagnoser: str) -> None:
        """Let the diagnosis answer where it has not, and write the hashes of all answers."""
        self.tell("Diagnosing them, with blinded labels")
        open_sites = [w for w in self.planned if not self._is_answered(w.case)]
        if self.labels.exists() and open_sites:
            raise InputError(
                "the labels have been opened, and answers are missing",
                file=self.root,
                found=", ".join(w.case for w in open_sites),
                expected="a check in another folder",
            )
        rocks = {w.case: w.spec.n_rocks for w in open_sites}
        seen = sum(w.spec.n_rocks for w in self.planned) - sum(rocks.values())
        tasks = []
        options = {"jobs": 1, "seed": 1, "overwrite": True}
        for case in rocks:
            own, answer = self.cases / case, self.answer(case)
            given = (str(own / CONFIG_NAME), str(own / OBSERVATIONS_NAME), str(answer))
            folders = (own, answer, partial_folder(answer))
            tasks.append(Task(case, diagnoser, given, options, folders))
        with _processes(self.jobs, self.root) as each:
            first = len(self.planned) - len(tasks) + 1
            for done, outcome in enumerate(each(tasks), start=first):
                record = {
                    "failure": outcome.failure or self._unreadable(outcome.name),
                    "seconds": round(outcome.seconds, 2),
                    "answer_sha256": folder_digest(self.answer(outcome.name)),
                }
                made_of = _made_of(self.blinding, outcome.name)
                write_json(self.record(outcome.name), with_digest(record, made_of))
                seen += rocks[outcome.name]
                self.step(done, len(self.planned), seen)
        write_text(self.answer_list, self._answer_digests())

    def _is_answered(self, case: str) -> bool:
        """Whether the answer is there as it was given."""
        record = read_saved_json(self.record(case), _made_of(self.blinding, case), self.tell)
        if record is None or record["answer_sha256"] == folder_digest(self.answer(case)):
            return record is not None
        self.tell(unfit(self.answer(case)))
        return False

    def _unreadable(self, case: str) -> str:
        """Why an answer cannot be read; empty if it can."""
        file = self.answer(case) / "diagnosis.json"
        try:
            answer_from(case, json.loads(file.read_text(encoding="utf-8")))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            return f"diagnosis.json cannot be used: {type(error).__name__}: {error}"
        return ""

    def read_answer(self, case: str) -> Answer:
        """What was answered, or that it failed."""
        record = read_json(self.record(case))
        if record["failure"]:
            return Answer(case, "no answer", math.nan, failure=str(record["failure"]))
        return answer_from(case, read_json(self.answer(case) / "diagnosis.json"))

    def _answer_digests(self) -> str:
        lines = []
        for site in self.planned:
            record, answer = self.record(site.case), self.answer(site.case)
            digests = {record: hashlib.sha256(record.read_bytes()).hexdigest()}
            if not read_json(record)["failure"]:
                digests[answer] = folder_digest(answer)
            lines += [f"{d}  {f.relative_to(self.root).as_posix()}" for f, d in digests.items()]
        return "\n".join(lines) + "\n"

    def open(self) -> None:
        """Make the labels anew and write them down, if they have the hash that was blinded."""
        self.tell("Opening the labels")
        self._verify_answers()
        labels = self._all("make_label", lambda w: (w.spec, w.seed, w.case))
        text = labels_text([labels[w.case] for w in self.planned])
        self._verify_blinding(text, "labels made anew")
        write_text(self.labels, text)

    def truths(self) -> list[Truth]:
        """The opened labels, after everything has been compared with its hash."""
        text = self.labels.read_text(encoding="utf-8")
        self._verify_blinding(text, str(self.labels))
        self._verify_answers()
        for line in self.case_list.read_text(encoding="utf-8").splitlines():
            digest, name = line.split("  ")
            if folder_digest(self.root / name) != digest:
                raise InputError(
                    "the case is not the one that was made",
                    file=self.root / name,
                    expected=f"SHA-256 {digest}, as in {self.case_list.name}",
                )
        return [truth_of(label) for label in json.loads(text)]

    def _blinded(self) -> str:
        """Hash of the labels that was written before the first answer."""
        return self.blinding.read_text(encoding="utf-8").split()[0]

    def _verify_blinding(self, text: str, found: str) -> None:
        actual = blinding_hash(self.salt.read_text(encoding="utf-8").strip(), text)
        if actual != self._blinded():
            raise InputError(
                "the labels are not those that were blinded",
                file=self.blinding,
                found=f"{found}: SHA-256 {actual}",
                expected=f"SHA-256 {self._blinded()}",
            )

    def _verify_answers(self) -> None:
        frozen = self.answer_list.read_text(encoding="utf-8").splitlines()
        try:
            now = self._answer_digests().splitlines()
        except OSError as error:
            raise InputError(
                "an answer is gone", file=str(error.filename), expected="as it was written"
            ) from None
        changed = sorted({line.split("  ")[1] for line in set(frozen) ^ set(now)})
        if changed:
            raise InputError(
                "answers were changed after all had been given",
                file=self.answer_list,
                found=", ".join(changed),
                expected="the answers as they were given",
            )

    def measure(self, answers: dict[str, Answer], measurer: str) -> None:
        """Shrinkage on fresh rocks, where one was stated or an effect was named."""
        due = [
            w
            for w in self.planned
            if not answers[w.case].failure
            and (answers[w.case].shrinkage is not None or names_in(answers[w.case].effect))
        ]
        left = [w for w in due if self._read_measured(w.case) is None]
        if not left:
            return
        self.tell(f"Measuring the shrinkage of {len(due)} sites on {FRESH_ROCKS} fresh rocks each")
        done = len(due) - len(left)
        with _processes(self.jobs) as made, _processes(self.jobs, self.root) as measured:
            for first in range(0, len(left), _BATCH):
                fresh, tasks = [], []
                for w in left[first : first + _BATCH]:
                    own, answer = self.cases / w.case, self.answer(w.case)
                    rocks = self.fresh(w.case)
                    given = (w.spec, w.seed, FRESH_ROCKS, str(rocks))
                    fresh.append(Task(w.case, f"{_MAKER}:make_fresh", given))
                    files = (str(own / CONFIG_NAME), str(rocks), str(answer))
                    tasks.append(Task(w.case, measurer, files, folders=(own, rocks, answer)))
                with alone(self.root / "fresh"):
                    for outcome in made(fresh):
                        if outcome.failure:
                            raise OutputError(
                                f"fresh rocks of site {outcome.name} cannot be made: "
                                f"{outcome.failure}"
                            )
                    for outcome in measured(tasks):
                        made_of = _made_of(self.answer_list, outcome.name)
                        found = with_digest(_measured(outcome), made_of)
                        write_json(self.measured(outcome.name), found)
                        done += 1
                        self.step(done, len(due), FRESH_ROCKS * done)

    def _read_measured(self, case: str) -> dict[str, Any] | None:
        return read_saved_json(self.measured(case), _made_of(self.answer_list, case), self.tell)

    def conclude(
        self,
        plan: dict[str, Any],
        programs: list[str],
        truths: Sequence[Truth],
        answers: dict[str, Answer],
    ) -> CheckResult:
        """Score the answers, and write scores, figures and report."""
        measured = {w.case: self._read_measured(w.case) or {} for w in self.planned}
        fresh = {case: found["S"] for case, found in measured.items() if found}
        rows = []
        for truth in truths:
            case = truth.case
            seconds = float(read_json(self.record(case))["seconds"])
            rows.append(WorldRow(truth, answers[case], measured[case], seconds))
        record = CheckRecord(
            plan=plan,
            programs=tuple(programs),
            hashes={
                "labels_sha256": self._blinded(),
                "answers_sha256": hashlib.sha256(self.answer_list.read_bytes()).hexdigest(),
            },
            rows=tuple(rows),
            scores=score(truths, answers.values(), fresh),
        )
        self.tell("Writing scores, figures and report")
        with writing(self.root):
            warnings = write_check(self.root, record)
        return CheckResult(record.scores, warnings)


def _made_of(file: Path, case: str) -> str:
    """What an answer or a measurement belongs to: hashes of labels or answers, and the case."""
    return f"{file.read_text(encoding='utf-8')} {case}"


def _measured(outcome: TaskOutcome) -> dict[str, Any]:
    """What the measuring gave, or why it failed."""
    value = outcome.value
    if outcome.failure or not isinstance(value, dict) or "S" not in value:
        return {"S": None, "failure": outcome.failure or "no shrinkage was given back"}
    keys = ("S", "D_configured", "D_base", "D_effect", "D_floor")
    return {"failure": "", **{key: _number(value.get(key)) for key in keys}}


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


@contextmanager
def _processes(
    jobs: int | Workers, sandboxed: Path | None = None
) -> Iterator[Callable[[Iterable[Task]], Iterator[TaskOutcome]]]:
    """What gives outcomes of tasks, in processes that see no more than they must."""
    if isinstance(jobs, int):
        # An outcome is written down when it is its turn; few wait, as these are lost when the user
        # stops, but enough that no process waits for one site that takes a minute.
        with Processes(jobs, ahead=3) as own:
            yield partial(own.in_order, perform, sandboxed)
    else:
        yield partial(jobs.in_order, in_own_process, sandboxed)


def in_own_process(sandboxed: Path | None, task: Task) -> TaskOutcome:
    """Outcome of a task, in a process that is there for it alone."""
    with Processes(1) as own:
        outcome: TaskOutcome = next(own.in_order(perform, sandboxed, [task]))
    return outcome
