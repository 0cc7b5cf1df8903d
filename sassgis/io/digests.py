"""Digests of files, each taken once."""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path


def content_digest(file: Path) -> str:
    """SHA-256 of the content of a file, taken again only if its size or time has changed.

    A batch asks for that of each tile of its terrain with every release area.
    """
    stat = file.stat()
    return _taken(file, stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)


@lru_cache(maxsize=16_384)
def _taken(file: Path, _inode: int, _size: int, _time_ns: int, _changed_ns: int) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def json_digest(plain: object) -> str:
    """SHA-256 of a value in canonical JSON; the order of the keys does not matter."""
    text = json.dumps(
        plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
