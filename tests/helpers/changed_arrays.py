"""Saved arrays that somebody changes by hand, with any tool that knows their format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Change = Callable[[dict[str, NDArray[Any]]], object]


def arrays_of(file: Path) -> dict[str, NDArray[Any]]:
    """Everything in a file, copies of arrays."""
    with np.load(file, allow_pickle=False) as stored:
        return {name: stored[name].copy() for name in stored.files}


def change_arrays(file: Path, change: Change) -> None:
    """Write a file again with changed arrays; all others, and the digest, as they were."""
    arrays = arrays_of(file)
    change(arrays)
    np.savez(file, **arrays)
