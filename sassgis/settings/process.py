"""Limits of this process, and coordinate systems by name."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import pyproj
from pyproj.exceptions import CRSError

from sassgis.errors import InputError

#: Limit, use and what of the use can be given back, of a control group; second and first version.
_V2 = ("memory.max", "memory.current", "inactive_file")
_V1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")


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


def parse_crs(text: str, *, file: object = None, field: str = "") -> pyproj.CRS:
    """Return a coordinate system from a code or well-known text; InputError if not understood."""
    try:
        return pyproj.CRS.from_user_input(text)
    except CRSError:
        raise InputError(
            "is no coordinate system", file=file, field=field or None,
            found=repr(text if len(text) < 60 else text[:57] + "..."),
            expected="a code such as EPSG:2056",
        ) from None  # fmt: skip


def crs_name(wkt: str) -> str:
    """Return the name of a coordinate system for people, with its code where it has one."""
    if not wkt:
        return "local coordinates"
    crs = pyproj.CRS.from_wkt(wkt)
    authority = crs.to_authority(min_confidence=90)
    return f"{crs.name} ({':'.join(authority)})" if authority else str(crs.name)


def crs_parts(crs: pyproj.CRS) -> tuple[pyproj.CRS, pyproj.CRS | None]:
    """Return the horizontal and vertical part of a coordinate system."""
    if crs.is_compound:
        return crs.sub_crs_list[0], crs.sub_crs_list[1]
    return crs, None


def same_crs(one: pyproj.CRS, other: pyproj.CRS) -> bool:
    """Return whether two coordinate systems put points in the same place, however spelled."""
    if one.equals(other, ignore_axis_order=True):
        return True
    codes = (one.to_epsg(), other.to_epsg())
    if None not in codes:
        return codes[0] == codes[1]
    # Files written by other programs leave codes and names of the projection out.
    return _fingerprint(one) == _fingerprint(other)


def _fingerprint(crs: pyproj.CRS) -> tuple[object, ...]:
    """Return the projection with its numbers, and the datum."""
    base = crs.source_crs if crs.is_bound and crs.source_crs is not None else crs
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what PROJ strings lose, the datum adds
        projection = sorted((k, str(v)) for k, v in base.to_dict().items())
    datum = "" if base.datum is None else str(base.datum.name).lower()
    return (*projection, re.sub(r"^d_|ensemble|[^a-z0-9]", "", datum))
