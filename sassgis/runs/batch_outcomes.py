"""The release areas of a batch, run one after the other or several at a time."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sassgis.io.saved_arrays import UNFIT
from sassgis.model.errors import InputError, SassgisError
from sassgis.runs.batch_area import AREAS_NAME, Setting, run_area
from sassgis.runs.batch_areas import Candidate
from sassgis.runs.batch_state import Record
from sassgis.runs.job import OnProgress, workers_asked
from sassgis.runs.workers import Jobs, task_map

log = logging.getLogger(__name__)

#: Bytes of a process that runs small areas.
_PROCESS = 800 << 20
#: From so many areas for each core on, every core has areas of its own.
_AREAS_PER_CORE = 4


@dataclass(frozen=True, slots=True)
class AreaOutcome:
    """What became of an area: its record, or why it is skipped; and the seconds that it took.

    What there was to tell of saved states comes with it from a process that nobody listens to.
    """

    record: Record | None
    reason: str
    seconds: float
    told: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Common:
    """What the areas have in common."""

    setting: Setting
    folder: Path


def outcomes(
    setting: Setting,
    candidates: Sequence[Candidate],
    folder: Path,
    jobs: Jobs,
    on_progress: OnProgress | None,
    tell: Callable[[str], None],
    memory_bytes: int | None = None,
) -> Generator[AreaOutcome, None, None]:
    """Run areas; outcomes come in the order of the areas.

    A few areas share all cores one after the other. Of many, as many are at work as there are
    cores, and progress is that of the batch: areas done, areas in all, blocks.

    Parameters
    ----------
    setting, candidates
    folder : Path
        Of the batch.
    jobs, on_progress, tell
        As for sassgis.runs.run.run.
    memory_bytes : int, optional
        What all processes together may take.
    """
    asked = workers_asked(setting.config, jobs)
    at_once = asked if isinstance(asked, int) else 1
    if memory_bytes is not None:
        at_once = min(at_once, memory_bytes // _PROCESS - 1)
    common = _Common(setting, folder)
    n = len(candidates)
    if at_once < 2 or n < _AREAS_PER_CORE * at_once:
        for i, candidate in enumerate(candidates, start=1):
            tell(f"Area {i} of {n}: {candidate.name}")
            yield _outcome(common, candidate, asked, on_progress, tell)
        return
    tell(f"Running {n} areas, {at_once} at a time")
    rocks = 0
    with task_map(common, at_once) as each:
        for i, outcome in enumerate(each(_alone, candidates), start=1):
            for text in outcome.told:
                tell(text)
            rocks += 0 if outcome.record is None else outcome.record.rocks
            if on_progress is not None:
                on_progress(i, n, rocks)
            yield outcome


def _alone(common: _Common, candidate: Candidate) -> AreaOutcome:
    """In a process of its own: one area on one core."""
    told: list[str] = []
    outcome = _outcome(common, candidate, 1, None, told.append)
    return replace(outcome, told=tuple(text for text in told if text.startswith(UNFIT)))


def _outcome(
    common: _Common,
    candidate: Candidate,
    jobs: Jobs,
    on_progress: OnProgress | None,
    tell: Callable[[str], None],
) -> AreaOutcome:
    began = time.perf_counter()
    record, reason = None, ""
    own = common.folder / AREAS_NAME / candidate.stem
    try:
        record = run_area(common.setting, candidate, own, jobs, on_progress, tell)
    except Exception as error:
        reason = _why_skipped(error)
    return AreaOutcome(record, reason, time.perf_counter() - began)


def _why_skipped(error: Exception) -> str:
    """Why an area is skipped; errors that are not about the area are raised again."""
    if isinstance(error, InputError):
        return str(error)
    # Compiled code that Ctrl-C strikes turns it into a SystemError.
    stopped = isinstance(error.__cause__ or error.__context__, KeyboardInterrupt)
    if isinstance(error, SassgisError) or stopped:
        raise error
    if isinstance(error, MemoryError):
        return "not enough memory; fewer release points or larger cells need less"
    log.debug("", exc_info=error)
    text = " ".join(str(error).split())
    return f"unexpected {type(error).__name__}: {text} (a fault of sassgis; --debug shows more)"
