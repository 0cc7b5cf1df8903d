"""A digest of values as they were read, whatever files they came from."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Mapping
from enum import Enum
from pathlib import PurePath
from typing import Any

import numpy as np
import shapely

from sassgis.model.in_memory import InMemory


def value_digest(value: object) -> str:
    """SHA-256 of frozen data: plain values, arrays, geometries, and dataclasses of them.

    The paths of files do not count: what they hold does, where it was read. TypeError for a value
    of another kind.
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
