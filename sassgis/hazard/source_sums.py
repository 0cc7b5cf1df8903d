"""Growing counts of one source: how many blocks reached each place, by energy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.model.grid import IntArray
from sassgis.model.hazard import SourceCounts

# Parts wait before they are joined, as that costs as much as all places reached so far, but no more
# of them than so many, and no more rows than there are places so far, or than these.
_WAITING, _WAITING_ROWS = 32, 1 << 14


class SourceSums:
    """Counts that grow chunk by chunk; memory grows with the places that are reached.

    All numbers are whole, so that the order of adding does not matter.
    """

    def __init__(self, n_energies: int) -> None:
        self.n_energies = n_energies
        self._parts: list[SourceCounts] = []

    def add(self, places: IntArray, count: IntArray, square: IntArray) -> None:
        """Join counts of some places, each of which is named once.

        Parameters
        ----------
        places : int64, shape (n,)
        count, square : int64, shape (n, n_energies)
            As in SourceCounts.
        """
        reached = count[:, 0] > 0
        if reached.any():
            self._parts.append(SourceCounts(places[reached], count[reached], square[reached]))
        rows = [part.places.size for part in self._parts]
        if len(rows) > _WAITING or sum(rows[1:]) > max(sum(rows[:1]), _WAITING_ROWS):
            self._parts = [joined(self._parts, self.n_energies)]

    def counts(self) -> SourceCounts:
        """All that was added."""
        self._parts = [joined(self._parts, self.n_energies)]
        return self._parts[0]

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that is needed to go on later, as plain arrays."""
        counts = self.counts()
        return {"places": counts.places, "count": counts.count, "square": counts.square}

    @classmethod
    def from_state(cls, state: Mapping[str, NDArray[Any]]) -> SourceSums:
        """The counts that ``state`` gave."""
        sums = cls(int(state["count"].shape[1]))
        sums.add(*(np.asarray(state[n], np.int64) for n in ("places", "count", "square")))
        return sums


def joined(parts: list[SourceCounts], n_energies: int) -> SourceCounts:
    """Counts of several parts of one sample as one; squares add, as no line is in two parts."""
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return SourceCounts.none(n_energies)
    # In runs that ascend, which np.unique would not make use of.
    places = np.sort(np.concatenate([p.places for p in parts]), kind="stable")
    places = places[np.diff(places, prepend=-1) > 0]
    out = SourceCounts(places, *(np.zeros((places.size, n_energies), np.int64) for _ in range(2)))
    for part in parts:
        rows = np.searchsorted(places, part.places)
        out.count[rows] += part.count
        out.square[rows] += part.square
    return out
