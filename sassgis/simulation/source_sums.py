"""Growing counts of one source: how many blocks reached each place, by energy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import kernel
from sassgis.grid import IntArray
from sassgis.settings.hazard_rules import SourceCounts


class SourceSums:
    """Growing counts, in whole numbers; memory grows with the places that are reached."""

    def __init__(self, n_energies: int) -> None:
        self.n_energies = n_energies
        # Places that were reached, ascending, and the row of each in the counts. New places get the
        # rows that follow, so that no count is moved for them.
        self._places: IntArray = np.empty(0, np.int64)
        self._row: IntArray = np.empty(0, np.int64)
        self._count, self._square = (np.zeros((0, n_energies), np.int64) for _ in range(2))

    def add(self, places: IntArray, count: IntArray, square: IntArray) -> None:
        """Add counts of some places, each of which is named once; all as in SourceCounts."""
        reached = np.flatnonzero(count[:, 0] > 0)
        at, known = self._found(places[reached])
        if not known.all():
            self._grow(np.sort(places[reached[~known]]))
            at, _ = self._found(places[reached])
        _add_rows(self._count, self._square, self._row[at], count, square, reached)

    def _found(self, places: IntArray) -> tuple[IntArray, NDArray[np.bool_]]:
        """Find where among the places some are or would be, and whether they are there."""
        at = np.searchsorted(self._places, places)
        known = at < self._places.size
        known[known] = self._places[at[known]] == places[known]
        return at, known

    def _grow(self, fresh: IntArray) -> None:
        """Make room for places that were not reached before, ascending."""
        used = self._places.size
        at = np.searchsorted(self._places, fresh)
        self._places = np.insert(self._places, at, fresh)
        self._row = np.insert(self._row, at, np.arange(used, used + fresh.size))
        if self._places.size > self._count.shape[0]:
            room = max(self._places.size, int(1.5 * self._count.shape[0]))
            for name in ("_count", "_square"):
                # Of zeros that nobody has written to no memory is taken.
                larger = np.zeros((room, self.n_energies), np.int64)
                larger[:used] = getattr(self, name)[:used]
                setattr(self, name, larger)

    def counts(self) -> SourceCounts:
        """Return the counts added so far."""
        return SourceCounts(self._places, self._count[self._row], self._square[self._row])

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the state needed to go on later, as plain arrays."""
        counts = self.counts()
        return {"places": counts.places, "count": counts.count, "square": counts.square}

    @classmethod
    def from_state(cls, state: Mapping[str, NDArray[Any]]) -> SourceSums:
        """Return the counts that ``state`` returned."""
        sums = cls(int(state["count"].shape[1]))
        sums.add(*(np.asarray(state[n], np.int64) for n in ("places", "count", "square")))
        return sums


@kernel
def _add_rows(
    to_count: IntArray,
    to_square: IntArray,
    row: IntArray,
    count: IntArray,
    square: IntArray,
    which: IntArray,
) -> None:
    """Add some rows of counts to rows of others."""
    for k in range(which.size):
        for i in range(count.shape[1]):
            to_count[row[k], i] += count[which[k], i]
            to_square[row[k], i] += square[which[k], i]
