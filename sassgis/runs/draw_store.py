"""Scores of draws that were made already, kept so that nothing is computed twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.io.saved_arrays import read_saved, write_saved
from sassgis.model.grid import FloatArray

#: Seconds between two savings.
_SAVE_EVERY_S = 5.0


class DrawStore:
    """Scores by number of the draw; a draw counts as made if its parameters are the same.

    Parameters
    ----------
    file : Path
        In the working folder of the result. One that does not fit is not used, which is told.
    """

    def __init__(self, file: Path, fingerprint: str, tell: Callable[[str], None]) -> None:
        self._file, self._fingerprint = file, fingerprint
        self._saved = time.monotonic()
        known = read_saved(file, fingerprint, tell) or {}
        rows = zip(*(known.get(k, ()) for k in ("numbers", "shares", "scores")), strict=True)
        self._made: dict[int, tuple[FloatArray, FloatArray]] = {int(n): (u, s) for n, u, s in rows}

    def known(self, number: int, shares: FloatArray) -> FloatArray | None:
        """Scores of a draw, if it was made."""
        made = self._made.get(number)
        return made[1] if made is not None and np.array_equal(made[0], shares) else None

    def keep(
        self, draws: Sequence[tuple[int, FloatArray]], results: Iterable[FloatArray]
    ) -> Iterator[FloatArray]:
        """Pass results on and keep them; saved now and then, and whatever happens."""
        try:
            for (number, shares), scores in zip(draws, results, strict=True):
                self._made[number] = (shares, scores)
                if time.monotonic() - self._saved > _SAVE_EVERY_S:
                    self.save()
                yield scores
        finally:
            self.save()

    def save(self) -> None:
        """Write what was made; the file is whole at any time."""
        if not self._made:
            return
        numbers = sorted(self._made)
        arrays: dict[str, Any] = {
            "numbers": numbers,
            "shares": np.stack([self._made[n][0] for n in numbers]),
            "scores": np.stack([self._made[n][1] for n in numbers]),
        }
        write_saved(self._file, arrays, self._fingerprint)
        self._saved = time.monotonic()
