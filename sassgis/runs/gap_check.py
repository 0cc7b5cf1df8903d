"""The blind check of the diagnosis: sites with blinded labels, answers, scores."""

from __future__ import annotations

import hashlib
import json
import math
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from sassgis.gap.check.answers import Answer, Truth, answer_from, names_in
from sassgis.gap.check.blinded_labels import blinding_hash, labels_text, truth_of
from sassgis.gap.check.check_scores import CheckScores, score
from sassgis.gap.check.sandbox import Task, TaskOutcome, perform
from sassgis.gap.check.worlds import (
    WorldSpec,
    battery,
    quick_battery,
    require_library,
    world_seeds,
)
from sassgis.io.digests import program_digest
from sassgis.io.read.gap_thresholds import THRESHOLDS, frozen_digest, read_thresholds
from sassgis.io.saved_arrays import read_saved_json, unfit, with_digest
from sassgis.io.staging import alone, partial_folder, staged_output, write_text, writing
from sassgis.io.write.gap_case_files import CONFIG_NAME, OBSERVATIONS_NAME, folder_digest
from sassgis.model.errors import InputError, Interrupted, OutputError
from sassgis.report.gap_check_report import CheckRecord, WorldRow, write_check
from sassgis.runs.workers import Jobs, Processes, Workers, available_cores

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

OnProgress = Callable[[int, int, int], None]


@dataclass(frozen=True, slots=True)
class PlannedSite:
    """A site of the battery: its name, what it is, and its seed."""

    case: str
    spec: WorldSpec
    seed: int


class CheckFolder:
    """The files of a check."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.plan = root / "check.json"  # what was asked for
        self.blinding = root / "labels.sha256"  # hash of the labels
        self.case_list = root / "cases.sha256"  # digests of the cases
        self.answer_list = root / "answers.sha256"  # digests of the answers
        self.salt = root / "blinded" / "salt.txt"  # what blinds the labels
        self.labels = root / "blinded" / "labels.json"  # the truth, opened at the end
        self.cases = root / "cases"  # all cases

    def case(self, case: str) -> Path:
        """The files of a case."""
        return self.cases / case

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


def write_json(file: Path, content: Mapping[str, object]) -> None:
    """Write an object whole or not at all."""
    write_text(file, json.dumps(content, indent=1) + "\n")


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
    place = CheckFolder(Path(out))
    tell = say or (lambda _text: None)
    step = on_progress or (lambda _done, _total, _rocks: None)
    jobs = jobs or available_cores()
    digest = _thresholds_digest(thresholds, seed, development)
    planned = _battery(seed, worlds, law, quick)
    plan = {
        "format": _FORMAT,
        "seed": seed,
        "law": law,
        "worlds": len(planned),
        "quick": quick,
        "development": development,
        "thresholds_sha256": digest,
    }
    try:
        programs = _claim(place, plan)
        require_library(world.spec.law for world in planned)
        if not (place.blinding.exists() and place.cases.is_dir()):
            tell(f"Making {len(planned)} sites")
            _make(place, planned, jobs, step)
        if not place.answer_list.exists():
            tell("Diagnosing them, with blinded labels")
            _answer(place, planned, jobs, diagnoser, step, tell)
            write_text(place.answer_list, _answer_digests(place, planned))
        if not place.labels.exists():
            tell("Opening the labels")
            _open(place, planned, jobs, step)
        truths = _truths(place, planned)
        answers = {world.case: _read_answer(place, world.case) for world in planned}
        _measure(place, planned, answers, jobs, measurer, step, tell)
    except KeyboardInterrupt:
        raise Interrupted(
            f"stopped by the user; what was made and answered is kept in {place.root}: "
            "the same command goes on from there"
        ) from None
    return _conclude(place, planned, plan, programs, truths, answers, tell)


def _thresholds_digest(file: Path | None, seed: int, development: bool) -> str:
    if seed in read_thresholds(file)["battery_seeds"] and not development:
        raise InputError(
            "this battery was looked at while the diagnosis was made: scores on it would flatter",
            file=file or THRESHOLDS,
            field="battery_seeds",
            found=f"seed {seed}",
            expected="another --seed, or --development",
        )
    return frozen_digest(file)


def _battery(seed: int, worlds: int, law: str | None, quick: bool) -> list[PlannedSite]:
    laws = {"laws": (law,)} if law else {}
    specs = quick_battery(seed, **laws) if quick else battery(seed, worlds, **laws)
    seeds = world_seeds(seed, len(specs))
    width = max(3, len(str(len(specs))))
    return [
        PlannedSite(f"{k + 1:0{width}d}", spec, own)
        for k, (spec, own) in enumerate(zip(specs, seeds, strict=True))
    ]


def _claim(place: CheckFolder, plan: dict[str, Any]) -> list[str]:
    """Take the folder, or go on in it; returns the states of the program that worked in it."""
    own, programs = program_digest(), []
    if place.plan.exists():
        there = read_json(place.plan)
        programs = [str(p) for p in there.pop("programs", [])]
        if there != plan:
            keys = [k for k in plan if there.get(k) != plan[k]]
            raise OutputError(
                f"{place.root}: holds another check ({', '.join(keys)} differ); "
                "choose another folder"
            )
    else:
        with writing(place.root):
            if place.root.exists() and (not place.root.is_dir() or any(place.root.iterdir())):
                raise OutputError(f"{place.root}: exists and is no check; choose another folder")
            place.root.mkdir(parents=True, exist_ok=True)
    # What comes after the answers does not make them other than they are.
    if own not in programs and not place.answer_list.exists():
        programs.append(own)
    write_json(place.plan, {**plan, "programs": programs})
    return programs


def _make(
    place: CheckFolder, planned: Sequence[PlannedSite], jobs: int | Workers, step: OnProgress
) -> None:
    """Write the cases, and the hash of their labels, which stay in memory until they are hashed."""
    with staged_output(place.cases, overwrite=False) as work:
        tasks = [
            Task(w.case, f"{_MAKER}:make_case", (w.spec, w.seed, w.case, str(work / w.case)))
            for w in planned
        ]
        made = _all(tasks, jobs, step)
        salt = secrets.token_hex(32)
        write_text(place.salt, f"{salt}\n")
        lines = [f"{made[w.case]['digest']}  cases/{w.case}" for w in planned]
        write_text(place.case_list, "\n".join(lines) + "\n")
        digest = blinding_hash(salt, labels_text([made[w.case]["label"] for w in planned]))
        write_text(place.blinding, f"{digest}  blinded/salt.txt + blinded/labels.json\n")


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


def _all(tasks: Sequence[Task], jobs: int | Workers, step: OnProgress) -> dict[str, Any]:
    """Values of tasks that must not fail."""
    values: dict[str, Any] = {}
    with _processes(jobs) as each:
        for outcome in each(tasks):
            if outcome.failure:
                raise OutputError(f"site {outcome.name} cannot be made: {outcome.failure}")
            values[outcome.name] = outcome.value
            step(len(values), len(tasks), 0)
    return values


def _answer(
    place: CheckFolder,
    planned: Sequence[PlannedSite],
    jobs: int | Workers,
    diagnoser: str,
    step: OnProgress,
    tell: Callable[[str], None],
) -> None:
    rocks = {w.case: w.spec.n_rocks for w in planned}
    open_cases = [w.case for w in planned if not _is_answered(place, w.case, tell)]
    if place.labels.exists() and open_cases:
        raise InputError(
            "the labels have been opened, and answers are missing",
            file=place.root,
            found=", ".join(open_cases),
            expected="a check in another folder",
        )
    total = len(planned)
    done = total - len(open_cases)
    seen = sum(n for case, n in rocks.items() if case not in open_cases)
    tasks = []
    options = {"jobs": 1, "seed": 1, "overwrite": True}
    for case in open_cases:
        own, answer = place.case(case), place.answer(case)
        given = (str(own / CONFIG_NAME), str(own / OBSERVATIONS_NAME), str(answer))
        folders = (own, answer, partial_folder(answer))
        tasks.append(Task(case, diagnoser, given, options, folders))
    with _processes(jobs, place.root) as each:
        for outcome in each(tasks):
            failure = outcome.failure or _unreadable(place, outcome.name)
            record = {
                "failure": failure,
                "seconds": round(outcome.seconds, 2),
                "answer_sha256": folder_digest(place.answer(outcome.name)),
            }
            made_of = _made_of(place.blinding, outcome.name)
            write_json(place.record(outcome.name), with_digest(record, made_of))
            done += 1
            seen += rocks[outcome.name]
            step(done, total, seen)


def _is_answered(place: CheckFolder, case: str, tell: Callable[[str], None]) -> bool:
    """Whether the answer is there as it was given."""
    record = read_saved_json(place.record(case), _made_of(place.blinding, case), tell)
    if record is None or record["answer_sha256"] == folder_digest(place.answer(case)):
        return record is not None
    tell(unfit(place.answer(case)))
    return False


def _made_of(file: Path, case: str) -> str:
    """What an answer or a measurement belongs to: hashes of labels or answers, and the case."""
    return f"{file.read_text(encoding='utf-8')} {case}"


def _unreadable(place: CheckFolder, case: str) -> str:
    """Why an answer cannot be read; empty if it can."""
    file = place.answer(case) / "diagnosis.json"
    try:
        answer_from(case, json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        return f"diagnosis.json cannot be used: {type(error).__name__}: {error}"
    return ""


def _read_answer(place: CheckFolder, case: str) -> Answer:
    record = read_json(place.record(case))
    if record["failure"]:
        return Answer(case, "no answer", math.nan, failure=str(record["failure"]))
    return answer_from(case, read_json(place.answer(case) / "diagnosis.json"))


def _answer_digests(place: CheckFolder, planned: Sequence[PlannedSite]) -> str:
    lines = []
    for world in planned:
        record, answer = place.record(world.case), place.answer(world.case)
        digests = {record: hashlib.sha256(record.read_bytes()).hexdigest()}
        if not read_json(record)["failure"]:
            digests[answer] = folder_digest(answer)
        lines += [f"{d}  {f.relative_to(place.root).as_posix()}" for f, d in digests.items()]
    return "\n".join(lines) + "\n"


def _open(
    place: CheckFolder, planned: Sequence[PlannedSite], jobs: int | Workers, step: OnProgress
) -> None:
    """Make the labels anew and write them down, if they have the hash that was blinded."""
    _verify_answers(place, planned)
    tasks = [Task(w.case, f"{_MAKER}:make_label", (w.spec, w.seed, w.case)) for w in planned]
    labels = _all(tasks, jobs, step)
    text = labels_text([labels[w.case] for w in planned])
    _verify_blinding(place, text, "labels made anew")
    write_text(place.labels, text)


def _truths(place: CheckFolder, planned: Sequence[PlannedSite]) -> list[Truth]:
    """The opened labels, after everything has been compared with its hash."""
    text = place.labels.read_text(encoding="utf-8")
    _verify_blinding(place, text, str(place.labels))
    _verify_answers(place, planned)
    for line in place.case_list.read_text(encoding="utf-8").splitlines():
        digest, name = line.split("  ")
        if folder_digest(place.root / name) != digest:
            raise InputError(
                "the case is not the one that was made",
                file=place.root / name,
                expected=f"SHA-256 {digest}, as in {place.case_list.name}",
            )
    return [truth_of(label) for label in json.loads(text)]


def _verify_blinding(place: CheckFolder, text: str, found: str) -> None:
    blinded = place.blinding.read_text(encoding="utf-8").split()[0]
    salt = place.salt.read_text(encoding="utf-8").strip()
    actual = blinding_hash(salt, text)
    if actual != blinded:
        raise InputError(
            "the labels are not those that were blinded",
            file=place.blinding,
            found=f"{found}: SHA-256 {actual}",
            expected=f"SHA-256 {blinded}",
        )


def _verify_answers(place: CheckFolder, planned: Sequence[PlannedSite]) -> None:
    frozen = place.answer_list.read_text(encoding="utf-8").splitlines()
    try:
        now = _answer_digests(place, planned).splitlines()
    except OSError as error:
        raise InputError(
            "an answer is gone", file=str(error.filename), expected="as it was written"
        ) from None
    changed = sorted({line.split("  ")[1] for line in set(frozen) ^ set(now)})
    if changed:
        raise InputError(
            "answers were changed after all had been given",
            file=place.answer_list,
            found=", ".join(changed),
            expected="the answers as they were given",
        )


def _measure(
    place: CheckFolder,
    planned: Sequence[PlannedSite],
    answers: dict[str, Answer],
    jobs: int | Workers,
    measurer: str,
    step: OnProgress,
    tell: Callable[[str], None],
) -> None:
    """Shrinkage on fresh rocks, where one was stated or an effect was named."""
    due = [
        w
        for w in planned
        if not answers[w.case].failure
        and (answers[w.case].shrinkage is not None or names_in(answers[w.case].effect))
    ]
    left = [w for w in due if _read_measured(place, w.case, tell) is None]
    if not left:
        return
    tell(f"Measuring the shrinkage of {len(due)} sites on {FRESH_ROCKS} fresh rocks each")
    done = len(due) - len(left)
    with _processes(jobs) as made, _processes(jobs, place.root) as measured:
        for first in range(0, len(left), _BATCH):
            some = left[first : first + _BATCH]
            fresh = []
            for w in some:
                given = (w.spec, w.seed, FRESH_ROCKS, str(place.fresh(w.case)))
                fresh.append(Task(w.case, f"{_MAKER}:make_fresh", given))
            with alone(place.root / "fresh"):
                for outcome in made(fresh):
                    if outcome.failure:
                        raise OutputError(
                            f"fresh rocks of site {outcome.name} cannot be made: {outcome.failure}"
                        )
                for outcome in measured(_measure_tasks(place, some, measurer)):
                    made_of = _made_of(place.answer_list, outcome.name)
                    found = with_digest(_measured(outcome), made_of)
                    write_json(place.measured(outcome.name), found)
                    done += 1
                    step(done, len(due), FRESH_ROCKS * done)


def _measure_tasks(place: CheckFolder, some: Iterable[PlannedSite], measurer: str) -> list[Task]:
    tasks = []
    for w in some:
        own, fresh, answer = place.case(w.case), place.fresh(w.case), place.answer(w.case)
        given = (str(own / CONFIG_NAME), str(fresh), str(answer))
        tasks.append(Task(w.case, measurer, given, folders=(own, fresh, answer)))
    return tasks


def _read_measured(
    place: CheckFolder, case: str, tell: Callable[[str], None]
) -> dict[str, Any] | None:
    return read_saved_json(place.measured(case), _made_of(place.answer_list, case), tell)


def _measured(outcome: TaskOutcome) -> dict[str, Any]:
    """What the measuring gave, or why it failed."""
    value = outcome.value
    if outcome.failure or not isinstance(value, dict) or "S" not in value:
        return {"S": None, "failure": outcome.failure or "no shrinkage was given back"}
    keys = ("S", "D_configured", "D_base", "D_effect", "D_floor")
    return {"failure": "", **{key: _number(value.get(key)) for key in keys}}


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _conclude(
    place: CheckFolder,
    planned: Sequence[PlannedSite],
    plan: dict[str, Any],
    programs: list[str],
    truths: Sequence[Truth],
    answers: dict[str, Answer],
    tell: Callable[[str], None],
) -> CheckResult:
    measured = {
        w.case: own for w in planned if (own := _read_measured(place, w.case, tell)) is not None
    }
    scores = score(truths, answers.values(), {case: m["S"] for case, m in measured.items()})
    rows = []
    for truth in truths:
        seconds = float(read_json(place.record(truth.case))["seconds"])
        found = measured.get(truth.case, {})
        rows.append(WorldRow(truth, answers[truth.case], found, seconds))
    record = CheckRecord(
        plan=plan,
        programs=tuple(programs),
        hashes={
            "labels_sha256": place.blinding.read_text(encoding="utf-8").split()[0],
            "answers_sha256": hashlib.sha256(place.answer_list.read_bytes()).hexdigest(),
        },
        rows=tuple(rows),
        scores=scores,
    )
    tell("Writing scores, figures and report")
    with writing(place.root):
        warnings = write_check(place.root, record)
    return CheckResult(scores, warnings)
