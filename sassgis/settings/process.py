"""Limits of this process: its memory, and nothing from the current folder."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from sassgis.errors import InputError

#: Limit, use and what of the use can be given back, of a control group; second and first version.
_V2 = ("memory.max", "memory.current", "inactive_file")


_V1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")

#: The setting of the C library (malloc.h), and from how many bytes on it asks the system for memory
#: that goes back as soon as an array is gone. Otherwise it keeps that of ever larger arrays, here
#: of 10 to 30 MB each, in holes between others: a third of the memory of a run.
_MMAP_THRESHOLD, _LARGE = -3, 1 << 20


def give_back_arrays() -> None:
    """Let large arrays give their memory back as they are freed, where the C library is glibc."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LARGE)


def give_back_freed() -> None:
    """Give the system back what was freed in small parts, where the C library is glibc.

    It stays with the process otherwise, in holes between what is still in use.
    """
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def require_memory(need: Mapping[str, int], file: object = None, most: int | None = None) -> None:
    """Refuse what needs more memory than this process may have; where that is unknown, nothing.

    ``need`` is in bytes by the key of the configuration that it depends on, ``file`` what messages
    name, ``most`` what the user allows (bytes), where that is less. InputError names the key that
    most of it depends on, and others with a quarter of that at least.
    """
    free, total, words = memory_bytes(), sum(need.values()), "are free here"
    if most is not None and (free is None or most < free):
        free, words = most, "--memory allows"
    if free is None or total <= free:
        return
    largest = max(need.values())
    keys = sorted((key for key in need if 4 * need[key] >= largest), key=lambda key: -need[key])
    found, expected = f"about {total / 1e9:.3g} GB", f"at most {free / 1e9:.3g} GB, which {words}"
    problem, field = "needs more memory than there is", ", ".join(keys)
    raise InputError(problem, file=file, field=field, found=found, expected=expected)


def memory_bytes(root: Path = Path("/")) -> int | None:
    """Return the memory that this process has and may still take (bytes); None where it is unknown.

    What the machine has available, or less where a control group (a container, a batch system)
    allows less. ``root`` is where the files of the system lie.
    """
    free = [b for b in (_machine(root), *_groups(root)) if b is not None]
    own = _stated(root / "proc/self/status", "VmRSS:") or 0
    return max(0, min(free)) + 1024 * own if free else None


def _machine(root: Path) -> int | None:
    available = _stated(root / "proc/meminfo", "MemAvailable:")
    if available is not None:
        return 1024 * available
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None


def _groups(root: Path) -> Iterator[int | None]:
    """Yield the free memory of the control groups of this process and those around them (bytes)."""
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, kinds, group = line.split(":", 2)
        if kinds and "memory" not in kinds.split(","):
            continue
        names, base = (_V1, "sys/fs/cgroup/memory") if kinds else (_V2, "sys/fs/cgroup")
        own = PurePosixPath(group.strip().lstrip("/"))
        for place in (own, *own.parents):
            folder = root / base / place
            limit, used = (_text(folder / name).strip() for name in names[:2])
            if limit.isdecimal() and used.isdecimal():
                back = _stated(folder / "memory.stat", names[2]) or 0
                yield int(limit) - int(used) + back


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


def _stated(file: Path, name: str) -> int | None:
    """Return the number behind a name at the begin of a line."""
    rows = (line.split() for line in _text(file).splitlines())
    return next((int(row[1]) for row in rows if row[:1] == [name]), None)


@contextmanager
def not_found(name: str) -> Iterator[None]:
    """Have a library, as it is imported, not find a file that it looks for only by its name."""
    exists = os.path.exists
    os.path.exists = lambda path: path != name and exists(path)
    try:
        yield
    finally:
        os.path.exists = exists
