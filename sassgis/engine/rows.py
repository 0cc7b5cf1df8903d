"""Rows whose number is not that of their array: a path that is followed has room for more.

The first row says how many of them hold.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import inlined

#: A row of a structured array, as numba and plain Python both know it.
Record = Any
Records = NDArray[np.void]


def record_type(*fields: tuple[str, Any]) -> np.dtype[np.void]:
    """Return a structured dtype whose rows give their fields as attributes."""
    return np.dtype((np.record, list(fields)))


@inlined
def last_of(rows: Records) -> int:
    """Return the position of the last vertex, or of the end of the last stretch.

    For crossings it is their number.
    """
    return int(rows[0].last)
