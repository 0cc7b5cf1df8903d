"""Store of draws that were made already, so that nothing is computed twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.files.saved_arrays import read_saved, write_saved
from sassgis.gap.fit.linear_fit import Seen, Trial
from sassgis.simulation.workers import OnProgress, TaskMap

#: Seconds between two savings.
_SAVE_EVERY_S = 5.0
#: Arrays of a saved file: number and parameters of each trial, and what it showed.
_ARRAYS = ("trials", "parameters", "numbers", "scores")

RunNew = Callable[[Sequence[Trial]], Iterable[Seen]]


def reported_tasks(run: TaskMap, n_rocks: int, on_progress: OnProgress | None) -> TaskMap:
    """Return the map of tasks, which have a count of campaigns each, with its progress reported."""

    def reported(function: Callable[[Any, Any], Any], tasks: Sequence[Any]) -> Iterator[Any]:
        each = sum(task.count for task in tasks) * n_rocks // max(len(tasks), 1)
        for done, result in enumerate(run(function, tasks), start=1):
            if on_progress is not None:
                on_progress(done, len(tasks), each * done)
            yield result

    return reported


class DrawStore:
    """Results of trials; one counts as made if its number and its parameters are the same.

    It is kept in a file of the working folder, if there is one. A file that does not fit is not
    used, which is reported.
    """

    def __init__(self, file: Path | None, fingerprint: str, tell: Callable[[str], None]) -> None:
        self._file, self._fingerprint = file, fingerprint
        self._saved = time.monotonic()
        known = (file and read_saved(file, fingerprint, tell)) or {}
        rows = zip(*(known.get(k, ()) for k in _ARRAYS), strict=True)
        self._made: dict[tuple[int, bytes], tuple[Any, ...]] = {
            (int(row[0]), row[1].tobytes()): row for row in rows
        }

    def seen(self, trials: Sequence[Trial], *, run: RunNew, step: Callable[[], None]) -> list[Seen]:
        """Return results of trials, known or made by ``run``; what is made is always saved."""
        due = [one for one in trials if _key(one) not in self._made]
        for _ in range(len(trials) - len(due)):
            step()
        try:
            for one, (numbers, score) in zip(due, run(due), strict=True):
                self._made[_key(one)] = (one.number, one.at, numbers, score)
                if time.monotonic() - self._saved > _SAVE_EVERY_S:
                    self.save()
                step()
        finally:
            self.save()
        made = (self._made[_key(one)] for one in trials)
        return [Seen(numbers, float(score)) for _, _, numbers, score in made]

    def save(self) -> None:
        """Write what was made; the file is whole at any time."""
        if not self._made or self._file is None:
            return
        columns = zip(*self._made.values(), strict=True)
        arrays = {name: np.stack(own) for name, own in zip(_ARRAYS, columns, strict=True)}
        write_saved(self._file, arrays, self._fingerprint)
        self._saved = time.monotonic()


def _key(trial: Trial) -> tuple[int, bytes]:
    return trial.number, trial.at.tobytes()
