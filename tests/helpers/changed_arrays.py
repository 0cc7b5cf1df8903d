"""Saved arrays that somebody changes by hand, with any tool that knows their format."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

_PACKED = ".npy.zst"
Change = Callable[[dict[str, NDArray[Any]]], object]


def arrays_of(file: Path) -> dict[str, NDArray[Any]]:
    """Everything in a file, copies of arrays."""
    with np.load(file, allow_pickle=False) as stored:
        return {name.removesuffix(_PACKED): _array(stored[name]) for name in stored.files}


def _array(found: NDArray[Any] | bytes) -> NDArray[Any]:
    if isinstance(found, bytes):
        plain = io.BytesIO(zstandard.decompress(found))
        return np.asarray(np.load(plain, allow_pickle=False))
    return found.copy()


def change_arrays(file: Path, change: Change) -> None:
    """Write a file again with changed arrays; all others, and the digest, as they were."""
    arrays = arrays_of(file)
    change(arrays)
    np.savez(file, **arrays)
