"""Digests of files, each taken once, of values as they were read, and of the program."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from enum import Enum
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import shapely

import sassgis
from sassgis.settings.schema import InMemory

_KINDS = (".py", ".csv", ".json", ".toml", ".npz")
#: Another version of these may read other numbers, or compute others in their last digits.
_LIBRARIES = ("numpy", "numba", "llvmlite", "scipy", "shapely", "pyproj", "rasterio", "pyogrio")
#: Inode, size and times of a file: who has the same is not read again.
Stamp = tuple[int, int, int, int]


def stamp_of(state: os.stat_result) -> Stamp:
    """Return the stamp of a file; no program can set its last time (on Windows: of its making)."""
    return state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns


def content_digest(file: Path) -> str:
    """Return SHA-256 of the content of a file, taken again only if its size or time has changed.

    A batch asks for that of each tile of its terrain with every release area.
    """
    return _taken(file, stamp_of(file.stat()))


@lru_cache(maxsize=16_384)
def _taken(file: Path, _stamp: Stamp) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def json_digest(plain: object) -> str:
    """Return SHA-256 of a value in canonical JSON; the order of the keys does not matter."""
    text = json.dumps(
        plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


@cache
def program_digest() -> str:
    """Return SHA-256 of the package, code and data, and of the libraries that it computes with.

    Data kept from an earlier run may come from another program.
    """
    root = Path(sassgis.__file__).parent
    total = hashlib.sha256(repr([(name, version(name)) for name in _LIBRARIES]).encode())
    for file in sorted(root.rglob("*")):
        if file.suffix in _KINDS and file.is_file():
            total.update(file.relative_to(root).as_posix().encode())
            total.update(file.read_bytes())
    return total.hexdigest()


def value_digest(value: object) -> str:
    """Return SHA-256 of frozen data: plain values, arrays, geometries, and dataclasses of them.

    Paths of files do not count, what they hold does, where it was read. TypeError for other values.
    """
    total = hashlib.sha256()
    _add(total, value)
    return total.hexdigest()


def _add(total: Any, value: object) -> None:
    """Add a value with its kind and length, so that no two values give the same bytes."""
    if isinstance(value, PurePath):
        return
    if isinstance(value, InMemory):
        value = value.digest
    elif isinstance(value, Enum):
        value = value.name
    elif isinstance(value, np.generic):
        value = value.item()
    elif isinstance(value, set | frozenset):
        value = sorted(value)
    if value is None or isinstance(value, bool | int | float | str):
        total.update(f"{type(value).__name__} {value!r}\n".encode(errors="surrogatepass"))
    elif isinstance(value, np.ndarray) and value.dtype != object:
        total.update(f"array {value.dtype.descr} {value.shape}\n".encode())
        total.update(np.ascontiguousarray(value).reshape(-1).view(np.uint8).data)
    elif isinstance(value, shapely.Geometry):
        wkb = shapely.to_wkb(value)
        total.update(f"geometry {len(wkb)}\n".encode() + wkb)
    elif dataclasses.is_dataclass(value):
        total.update(f"{type(value).__name__}\n".encode())
        for own in dataclasses.fields(value):
            total.update(f"{own.name}: ".encode())
            _add(total, getattr(value, own.name))
    elif isinstance(value, Mapping):
        _add(total, sorted(value.items()))
    elif isinstance(value, Iterable) and not isinstance(value, bytes):
        items = list(value)
        total.update(f"{len(items)} of\n".encode())
        for item in items:
            _add(total, item)
    else:
        raise TypeError(f"no digest of {type(value).__name__}")
