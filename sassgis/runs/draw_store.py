"""Scores of draws that were made already, kept so that nothing is computed twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.gap.calibration.class_calibration import NumberedDraw
from sassgis.io.saved_arrays import read_saved, write_saved
from sassgis.model.grid import FloatArray

#: Seconds between two savings.
_SAVE_EVERY_S = 5.0


OnProgress = Callable[[int, int, int], None]
RunNew = Callable[[Sequence[NumberedDraw]], Iterable[FloatArray]]


class DrawProgress:
    """Reports how many draws are done, of how many, and the rocks simulated for them."""

    def __init__(self, on_progress: OnProgress | None, total: int, rocks: int) -> None:
        self._on_progress, self._total, self._rocks, self._done = on_progress, total, rocks, 0

    def step(self) -> None:
        """One draw more."""
        self._done += 1
        if self._on_progress is not None:
            self._on_progress(self._done, self._total, self._rocks * self._done)


class DrawStore:
    """Scores by number of the draw; a draw counts as made if its parameters are the same.

    Parameters
    ----------
    file : Path or None
        In the working folder of the result; None: nothing is kept. One that does not fit is not
        used, which is told.
    """

    def __init__(self, file: Path | None, fingerprint: str, tell: Callable[[str], None]) -> None:
        self._file, self._fingerprint = file, fingerprint
        self._saved = time.monotonic()
        known = (file and read_saved(file, fingerprint, tell)) or {}
        rows = zip(*(known.get(k, ()) for k in ("numbers", "shares", "scores")), strict=True)
        self._made: dict[int, tuple[FloatArray, FloatArray]] = {int(n): (u, s) for n, u, s in rows}

    def scored(
        self, draws: Sequence[NumberedDraw], *, run: RunNew, step: Callable[[], None]
    ) -> list[FloatArray]:
        """Scores of draws: those that are known, and those that ``run`` makes now.

        What is made is saved now and then, and whatever happens.
        """
        due = [one for one in draws if not self._known(*one)]
        for _ in range(len(draws) - len(due)):
            step()
        try:
            for (number, shares), scores in zip(due, run(due), strict=True):
                self._made[number] = (shares, scores)
                if time.monotonic() - self._saved > _SAVE_EVERY_S:
                    self.save()
                step()
        finally:
            self.save()
        return [self._made[number][1] for number, _ in draws]

    def _known(self, number: int, shares: FloatArray) -> bool:
        made = self._made.get(number)
        return made is not None and np.array_equal(made[0], shares)

    def save(self) -> None:
        """Write what was made; the file is whole at any time."""
        if not self._made or self._file is None:
            return
        numbers = sorted(self._made)
        arrays: dict[str, Any] = {
            "numbers": numbers,
            "shares": np.stack([self._made[n][0] for n in numbers]),
            "scores": np.stack([self._made[n][1] for n in numbers]),
        }
        write_saved(self._file, arrays, self._fingerprint)
        self._saved = time.monotonic()
