"""What a run saves to go on from after an interruption: as it was saved, or not used.

Each file holds a digest of its content, its name, what it belongs to, and the program. It finds
damage and changes by hand; it is no signature, as whoever can write the file can write a digest.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import ArrayLike, NDArray

from sassgis.io.digests import content_digest, program_digest
from sassgis.model.errors import InputError

#: How a line begins that tells of a file that is not used.
UNFIT = "Saved state"
_FINGERPRINT, _DIGEST, _TYPES, _EMPTY = "fingerprint", "digest", "types", "empty"
_ADDED = (_FINGERPRINT, _DIGEST, _TYPES, _EMPTY)
_ARRAY, _PACKED = ".npy", ".zst"
#: What a damaged file may raise, from its end that is missing to flags that no archive has.
_DAMAGE = (
    OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error,
    SyntaxError, TypeError, MemoryError, OverflowError, zstandard.ZstdError,
)  # fmt: skip


def _every(_name: str) -> bool:
    return True


def write_saved(
    path: Path, arrays: Mapping[str, ArrayLike], fingerprint: str, *, compressed: bool = False
) -> str:
    """Write arrays beside and rename, so that a full disk leaves the older state; their digest.

    The arrays hold no objects. ``fingerprint`` is that of the settings and inputs that they belong
    to; the program is added here.
    """
    given = {name: np.asarray(own) for name, own in arrays.items()}
    # An entry of the archive takes longer than what is in it, if that is nothing.
    empty = {n: (a.dtype.str, a.shape) for n, a in given.items() if not (a.size or a.dtype.names)}
    narrow = {name: _narrow(own) for name, own in given.items() if name not in empty}
    types = {n: given[n].dtype.str for n, own in narrow.items() if own.dtype != given[n].dtype}
    said = {_TYPES: json.dumps(types), _EMPTY: json.dumps(empty)}
    whole: dict[str, ArrayLike] = {**narrow, **said}
    whole[_FINGERPRINT] = _of_program(fingerprint)
    digest = _digest(path.name, whole)
    fresh = path.with_suffix(".new")
    try:
        with fresh.open("wb") as stream:
            with zipfile.ZipFile(stream, "w") as archive:
                for name, array in {**whole, _DIGEST: digest}.items():
                    _add(archive, name, np.asanyarray(array), compressed)
            stream.flush()
            os.fsync(stream.fileno())
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)
    return digest


def _add(archive: zipfile.ZipFile, name: str, array: NDArray[Any], compressed: bool) -> None:
    """Add an array as numpy.savez does; compressed in a fifth of the time that zlib takes."""
    # Of a fixed date: equal arrays are equal bytes, and no clock is before the first year of ZIP.
    entry = zipfile.ZipInfo(f"{name}{_ARRAY}{_PACKED * compressed}")
    if compressed:
        plain = io.BytesIO()
        np.lib.format.write_array(plain, array, allow_pickle=False)
        archive.writestr(entry, zstandard.compress(plain.getbuffer(), 1))
        return
    with archive.open(entry, "w", force_zip64=True) as stream:
        np.lib.format.write_array(stream, array, allow_pickle=False)


def read_saved(
    path: Path, fingerprint: str, tell: Callable[[str], None], digest: str | None = None
) -> dict[str, NDArray[Any]] | None:
    """Arrays of ``write_saved``; None if there are none, or they do not fit, which is told.

    A file whose ``digest`` is given must have it, and so must be there.
    """
    found = _unchanged(path)
    if found is None or digest not in (None, str(found[_DIGEST])):
        if digest is None and not path.exists():
            return None
        tell(unfit(path))
    elif str(found[_FINGERPRINT]) != _of_program(fingerprint):
        tell(unfit(path, "of other settings, inputs or versions"))
    else:
        return _as_given(found)
    return None


def saved_or_refused(
    path: Path,
    expected: str,
    content: str | None = None,
    wanted: Callable[[str], bool] = _every,
) -> dict[str, NDArray[Any]]:
    """Arrays of ``write_saved``; InputError if there are none, or they are damaged or changed.

    Parameters
    ----------
    expected : str
        What they are, and what to do without them.
    content : str, optional
        Digest of the file, where that is known: then those that are not ``wanted`` are not read.
    """
    found = _unchanged(path, content, wanted)
    if found is None:
        raise InputError("cannot be read, or was changed", file=path, expected=expected)
    return _as_given(found)


def with_digest(content: Mapping[str, object], fingerprint: str) -> dict[str, object]:
    """What is to be saved as JSON, with its digest."""
    text = json.dumps([content, fingerprint], sort_keys=True)
    return {**content, _DIGEST: hashlib.sha256(text.encode()).hexdigest()}


def read_saved_json(
    path: Path, fingerprint: str, tell: Callable[[str], None]
) -> dict[str, Any] | None:
    """What was saved ``with_digest``; None if there is no file, or it does not fit, which is told.

    The fingerprint is the one that it was saved with.
    """
    if not path.exists():
        return None
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        content = {name: own for name, own in found.items() if name != _DIGEST}
        if found == with_digest(content, fingerprint):
            return content
    except (*_DAMAGE, AttributeError):
        pass
    tell(unfit(path))
    return None


def unfit(path: Path, why: str = "damaged, or changed since it was saved") -> str:
    """One line to tell that what was saved is not used."""
    return f"{UNFIT} {path} is not used: {why}"


def _of_program(fingerprint: str) -> str:
    return f"{program_digest()} {fingerprint}"


def _narrow(array: NDArray[Any]) -> NDArray[Any]:
    """Whole numbers in the smallest type that holds them: less to compress, and to add up."""
    if array.dtype.kind not in "iu" or not array.size or array.min() < 0:
        return array
    return array.astype(np.min_scalar_type(array.max()), copy=False)


def _as_given(found: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Arrays of a file in the types that they had, without what was added to them."""
    types, empty = (json.loads(str(found[name])) for name in (_TYPES, _EMPTY))
    whole = {
        name: own.astype(types.get(name, own.dtype), copy=False)
        for name, own in found.items()
        if name not in _ADDED
    }
    return whole | {name: np.empty(shape, kind) for name, (kind, shape) in empty.items()}


def _unchanged(
    path: Path, content: str | None = None, wanted: Callable[[str], bool] = _every
) -> dict[str, NDArray[Any]] | None:
    """All arrays of a file, if they fit the digest among them.

    If ``content`` is given, the wanted ones, if that is the digest of the file.
    """
    try:
        if content is not None:
            whole = content_digest(path) == content
            return _stored(path, lambda n: n in _ADDED or wanted(n)) if whole else None
        found = _stored(path, _every)
        digest = _digest(path.name, {k: own for k, own in found.items() if k != _DIGEST})
        return found if str(found[_DIGEST]) == digest else None
    except _DAMAGE:
        return None


def _stored(path: Path, wanted: Callable[[str], bool]) -> dict[str, NDArray[Any]]:
    """The wanted arrays of a file, as they are there."""
    found = {}
    with zipfile.ZipFile(path) as archive:
        for entry in archive.namelist():
            name = entry.removesuffix(_PACKED).removesuffix(_ARRAY)
            if wanted(name):
                plain = archive.read(entry)
                if entry.endswith(_PACKED):
                    plain = zstandard.decompress(plain)
                # Nothing is unpickled.
                found[name] = np.lib.format.read_array(io.BytesIO(plain), allow_pickle=False)
    return found


def _digest(name: str, arrays: Mapping[str, ArrayLike]) -> str:
    """SHA-256 over a name, and over names, types, shapes and bytes of arrays."""
    total = hashlib.sha256(name.encode())
    for key, given in sorted(arrays.items()):
        array = np.asarray(given)
        total.update(f"\n{key} {array.dtype.descr} {array.shape}\n".encode())
        total.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    return total.hexdigest()
