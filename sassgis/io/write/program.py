"""The state of the program: what is kept from an earlier run may have been made by another one."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

import sassgis

_KINDS = (".py", ".csv", ".json", ".toml", ".npz")
#: Another version of these may read other numbers, or compute others in their last digits.
_LIBRARIES = ("numpy", "numba", "llvmlite", "scipy", "shapely", "pyproj", "rasterio", "pyogrio")


@cache
def program_digest() -> str:
    """SHA-256 of the package, code and data, and of the versions of what it computes with."""
    root = Path(sassgis.__file__).parent
    total = hashlib.sha256(repr([(name, version(name)) for name in _LIBRARIES]).encode())
    for file in sorted(root.rglob("*")):
        if file.suffix in _KINDS and file.is_file():
            total.update(file.relative_to(root).as_posix().encode())
            total.update(file.read_bytes())
    return total.hexdigest()
