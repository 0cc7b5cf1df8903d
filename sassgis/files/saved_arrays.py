"""Saved state from which a run resumes after an interruption; a damaged one is not used.

A file is a NumPy archive (npz). The comment at its end holds the fingerprint of what it belongs to,
and a digest of its name and of all bytes before. That finds damage and changes by hand; it is no
signature, as whoever can write the file can write a digest.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sassgis.errors import InputError
from sassgis.files.digests import Stamp, program_digest, stamp_of

#: How a line begins that reports a file that is not used.
UNFIT = "Saved state"
#: Bytes of a SHA-256 as text, and of a part of a file that is read at once.
_HEX, _BLOCK = 64, 1 << 20
#: What a file may raise that is cut, or that no program of ours has written.
_DAMAGE = (OSError, ValueError, zipfile.BadZipFile)


def write_saved(
    path: Path, arrays: Mapping[str, ArrayLike], fingerprint: str, *, compressed: bool = False
) -> str:
    """Write arrays next to it and rename, so that a full disk leaves the older state; their digest.

    They hold no objects. ``fingerprint`` is that of the settings and inputs that they belong to;
    the program is added here.
    """
    kind = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    fresh = path.with_suffix(".new")
    try:
        with zipfile.ZipFile(fresh, "w", kind, compresslevel=1) as archive:
            archive.comment = (_of_program(fingerprint) + _HEX * "0").encode()
            for name, given in arrays.items():
                # Of a fixed date, unlike numpy.savez: equal arrays are equal bytes.
                with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                    np.lib.format.write_array(entry, np.asanyarray(given), allow_pickle=False)
        digest = _digest(fresh, path.name)
        with fresh.open("r+b") as stream:
            stream.seek(-_HEX, os.SEEK_END)
            stream.write(digest.encode())
            stream.flush()
            os.fsync(stream.fileno())
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)
    return digest


def read_saved(
    path: Path, fingerprint: str, tell: Callable[[str], None]
) -> dict[str, NDArray[Any]] | None:
    """Return arrays of ``write_saved``; None if there are none, or, reported, if unfit."""
    if not path.exists():
        return None
    try:
        if _seal(path)[0] == _of_program(fingerprint):
            return _arrays(path)
        tell(unfit(path, "of other settings, inputs or versions"))
    except _DAMAGE:
        tell(unfit(path))
    return None


def saved_or_refused(
    path: Path,
    expected: str,
    digest: str | None = None,
    wanted: Callable[[str], bool] = lambda _name: True,
) -> dict[str, NDArray[Any]]:
    """Return the ``wanted`` arrays of ``write_saved``.

    ``expected`` says what they are, and what to do without them; with the ``digest`` that
    ``write_saved`` returned the file is looked through once, until it changes. InputError if there
    are none, they are damaged or changed, or others than those of the digest.
    """
    try:
        if digest is None:
            _seal(path)
        if digest is None or digest == _known(path, stamp_of(path.stat())):
            return _arrays(path, wanted)
    except _DAMAGE:
        pass
    raise InputError("cannot be read, or was changed", file=path, expected=expected)


def saved_digest(path: Path) -> str:
    """Return digest by ``write_saved``; empty if the file is damaged, changed or missing."""
    try:
        return _seal(path)[1]
    except _DAMAGE:
        return ""


@lru_cache(maxsize=16_384)
def _known(path: Path, _stamp: Stamp) -> str:
    return saved_digest(path)


def unfit(path: Path, why: str = "damaged, or changed since it was saved") -> str:
    """State in one line that what was saved is not used."""
    return f"{UNFIT} {path} is not used: {why}"


def _of_program(fingerprint: str) -> str:
    return hashlib.sha256(f"{program_digest()} {fingerprint}".encode()).hexdigest()


def _arrays(
    path: Path, wanted: Callable[[str], bool] = lambda _name: True
) -> dict[str, NDArray[Any]]:
    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files if wanted(name)}


def _seal(path: Path) -> tuple[str, str]:
    """Return fingerprint and digest of a file; ValueError or OSError if it is not as saved."""
    with path.open("rb") as stream:
        stream.seek(-2 * _HEX, os.SEEK_END)
        end = stream.read().decode("ascii")
    if end[_HEX:] != _digest(path, path.name):
        raise ValueError
    return end[:_HEX], end[_HEX:]


def _digest(path: Path, name: str) -> str:
    """Return SHA-256 of a name and of a file without the digest at its end."""
    total, left = hashlib.sha256(name.encode()), path.stat().st_size - _HEX
    with path.open("rb") as stream:
        while left > 0 and (block := stream.read(min(left, _BLOCK))):
            total.update(block)
            left -= len(block)
    return total.hexdigest()
