"""Arrays that a run saves, to go on from after an interruption: whole, or taken for none."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sassgis.model.errors import InputError
from sassgis.model.noted_files import noted

#: Key of what the arrays belong to.
FINGERPRINT = "fingerprint"
#: Key of the names of all other arrays.
_NAMES = "names of arrays"
#: What a damaged file may raise, from its end that is missing to flags that no archive has.
_DAMAGE = (
    OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error,
    SyntaxError, MemoryError, OverflowError,
)  # fmt: skip


def write_saved(path: Path, arrays: Mapping[str, ArrayLike], *, compressed: bool = False) -> None:
    """Write arrays beside and rename, so that a full disk leaves the older state as it was.

    Parameters
    ----------
    path : Path
    arrays : mapping of str to array
        No objects.
    compressed : bool
    """
    fresh = noted(path.with_suffix(".new"))
    save = np.savez_compressed if compressed else np.savez
    try:
        with fresh.open("wb") as stream:
            save(stream, **arrays, **{_NAMES: _names_of(arrays)})  # type: ignore[arg-type]
            stream.flush()
            os.fsync(stream.fileno())
        fresh.replace(noted(path))
    finally:
        fresh.unlink(missing_ok=True)


def _names_of(arrays: Iterable[str]) -> NDArray[np.uint8]:
    return np.frombuffer("\n".join(sorted(arrays)).encode(), np.uint8)


def read_saved(path: Path, fingerprint: str | None = None) -> dict[str, NDArray[Any]] | None:
    """Arrays of ``write_saved``; None if there are none, of another fingerprint, or damaged.

    Parameters
    ----------
    path : Path
    fingerprint : str, optional
        What the array FINGERPRINT must hold.
    """
    try:
        # Of a damaged file numpy leaves open what it has opened itself. Nothing is unpickled.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            found = {name: stored[name] for name in stored.files}
    except _DAMAGE:
        return None
    # A damaged list of contents may end too early without an error.
    if not np.array_equal(found.pop(_NAMES, np.empty(0)), _names_of(found)):
        return None
    same = fingerprint is None or str(found.get(FINGERPRINT, "")) == fingerprint
    return found if same else None


def saved_or_refused(path: Path, expected: str) -> dict[str, NDArray[Any]]:
    """Arrays of ``write_saved`` that must be there.

    Parameters
    ----------
    path : Path
    expected : str
        What they are, and what to do without them.

    Raises
    ------
    InputError
        If there are none, or they are damaged.
    """
    found = read_saved(path)
    if found is None:
        raise InputError("cannot be read", file=path, expected=expected)
    return found
