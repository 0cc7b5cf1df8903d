"""Rows of structured arrays, as numba and plain Python both know them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: A row of a structured array.
Record = Any
Records = NDArray[np.void]


class CountedRows(NamedTuple):
    """Rows of which only the first hold: a path that is followed has room for more.

    Of profiles and stretches of cells the segments are counted: one more row ends the last of them.
    """

    rows: Records
    n: NDArray[np.int64]  # (1,) how many of them hold


def record_type(*fields: tuple[str, Any]) -> np.dtype[np.void]:
    """Return a structured dtype whose rows give their fields as attributes."""
    return np.dtype((np.record, list(fields)))


def empty_table(n: int, dtype: np.dtype[np.void]) -> CountedRows:
    """Make an empty table with room for ``n`` rows."""
    return CountedRows(np.zeros(n, dtype), np.zeros(1, np.int64))
