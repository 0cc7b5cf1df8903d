"""The decorators of compiled code, and where its machine code is kept.

An edit in a function that another calls would leave the machine code of the caller as it was. The
cache therefore lives in a folder named after the contents of every compiled module. What is read
from it is run: so it is used only where nobody but the user can have written, and nothing in the
current folder decides where that is; else each process compiles anew.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import os
import stat
import sys
import tempfile
import warnings
from collections.abc import Callable
from multiprocessing import parent_process
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from sassgis.errors import require_room_for_libraries

log = logging.getLogger(__name__)

_PACKAGE = Path(__file__).resolve().parent.parent
_COMPILED_ROOMS = ("compiled", "settings", "terrain", "engine", "simulation", "gap/residuals")

#: First and last version of numba that machine_code.py was tried with; pyproject.toml allows no
#: others. With others numba compiles and keeps functions by itself: slower, with the same results.
_TRIED = (0, 60), (0, 68)

F = TypeVar("F", bound=Callable[..., Any])


@functools.cache
def loaded_numba() -> ModuleType:
    """Return numba, without settings of the current folder; SassgisError without room for it."""
    require_room_for_libraries()
    warnings.filterwarnings("ignore", "A Numba config file is found")
    # Where there is no yaml numba leaves its file alone.
    yaml = sys.modules.pop("yaml", None)
    sys.modules["yaml"] = None  # type: ignore[assignment]
    try:
        import numba
    finally:
        del sys.modules["yaml"]
        if yaml is not None:
            sys.modules["yaml"] = yaml
    return numba


@functools.cache
def _cache_folder() -> Path | None:
    """Return the folder of machine code of the sources as they stand; None where none is kept."""
    digest = hashlib.sha256()
    for room in _COMPILED_ROOMS:
        for path in sorted((_PACKAGE / room).rglob("*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    try:
        base = os.environ.get("SASSGIS_CACHE_DIR")
        if not base:
            home = os.environ.get("XDG_CACHE_HOME", "")
            base = str((Path(home) if os.path.isabs(home) else Path.home() / ".cache") / "sassgis")
        # A relative one would be another folder in each project.
        if not os.path.isabs(base):
            raise OSError(f"{base} is not an absolute path")
        folder = Path(base).resolve() / digest.hexdigest()[:16]
        for made in (folder.parent, folder):
            made.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.name == "posix":  # Elsewhere a user's folders are the user's.
            _check_own(folder)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError) as error:
        _say_not_kept(error)
        return None


def _say_not_kept(error: Exception) -> None:
    """Warn, once, that machine code cannot be kept."""
    if parent_process() is None and not log.disabled:
        log.warning(
            "compiled code is not kept, so that each command compiles anew: %s "
            "(SASSGIS_CACHE_DIR names another folder)", error,
        )  # fmt: skip
        log.disabled = True


def _check_own(folder: Path) -> None:
    """Raise OSError for a folder that others than the user and root can change, as ssh does."""
    user = os.geteuid()
    for place in (folder, *folder.parents):
        found = place.stat()
        if found.st_uid not in ((user,) if place == folder else (user, 0)):
            raise OSError(f"{place} belongs to another user")
        shared = found.st_mode & (stat.S_IWOTH | (0 if _is_private(found.st_gid) else stat.S_IWGRP))
        # In a folder such as /tmp nobody can replace what belongs to another.
        if shared and (place == folder or not found.st_mode & stat.S_ISVTX):
            raise OSError(f"others can write in {place}")


def _is_private(group: int) -> bool:
    """Return whether a group is the user's own, of the same name and without other members."""
    import grp
    import pwd

    try:
        user, found = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(group)
    except KeyError:
        return False
    return found.gr_name == user and set(found.gr_mem) <= {user}


def kernel(function: F) -> F:
    """Compile a function with numba: without the GIL, IEEE division.

    Where Python calls it, machine code is made of it and of all that it calls, and kept.
    """
    return _part(function, _nrt=True, forceinline=False)


def lean(function: F) -> F:
    """Compile as ``kernel`` does, for a function that makes and returns no arrays or views of them.

    It does not count the references to the arrays that it is given; its caller holds them. Counting
    them took half of the time of the motion. One that makes an array does not compile.
    """
    # Said explicitly: numba takes it over from the first caller else.
    return _part(function, _nrt=False, forceinline=False)


def fused(function: F) -> F:
    """Compile as ``lean`` does, and copy the function to each call however long it is.

    For what is called from one place, and for parts of an inner loop.
    """
    return _part(function, _nrt=False, forceinline=True)


def inlined(function: F) -> F:
    """Put in the place of each call before types are found.

    For short functions that take what differs from call to call, such as None.
    """
    return _part(function, inline="always")


@functools.cache
def _machine_code() -> Any:
    """Return machine_code.py; None where numba is not one that it was tried with."""
    first, last = _TRIED
    if not first <= tuple(map(int, loaded_numba().__version__.split(".")[:2])) <= last:
        return None
    from sassgis.compiled import machine_code

    machine_code.PartFunction.entry = staticmethod(_entry)
    return machine_code


def _part(function: F, **options: Any) -> F:
    """Return a function that compiled code calls."""
    if loaded_numba().config.DISABLE_JIT:
        return function
    own = _machine_code()
    if own is None:
        # No other option is one that numba documents.
        kept = _cache_folder() is not None
        return _compiled(function, cache=kept, inline=options.get("inline", "never"))
    part: Any = _compiled(
        function, pipeline_class=own.PartCompiler, no_cpython_wrapper=True, **options
    )
    part.__class__ = own.PartFunction
    out: F = part
    return out


@functools.cache
def _entry(function: F, counts: bool) -> F:
    """Return function as Python calls it; ``counts`` is whether it counts references to arrays."""
    compiler = _machine_code().EntryCompiler
    return _compiled(function, kept=True, pipeline_class=compiler, _nrt=counts)


def _compiled(function: F, *, kept: bool = False, **options: Any) -> F:
    """Compile with numba, machine code in our folder; ``kept``: as machine_code.py keeps it."""
    numba: Any = loaded_numba()
    config = numba.config
    # Where the machine code is kept is decided here, as the function is decorated.
    before = {name: getattr(config, name, "") for name in ("CACHE_DIR", "CACHE_LOCATOR_CLASSES")}
    config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = str(_cache_folder() or ""), ""
    options |= {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    try:
        out: Any = numba.njit(**options)(function)
        if kept and _cache_folder() is not None:
            out._cache = _machine_code().KeptCode(function, _say_not_kept)
        return out  # type: ignore[no-any-return]
    finally:
        for name, value in before.items():
            setattr(config, name, value)
