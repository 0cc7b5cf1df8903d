"""The one decorator for compiled code.

numba's on-disk cache looks only at the file that holds the function: after an edit in a callee that
lives in another file it would serve stale machine code. The cache therefore lives in a folder named
after the contents of every compiled module, so that an edit anywhere starts a fresh one.
"""

from __future__ import annotations

import functools
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

_PACKAGE = Path(__file__).resolve().parent.parent
_COMPILED_ROOMS = ("model", "engine", "terrain", "hazard", "gap/residuals", "gap/check/worlds")

F = TypeVar("F", bound=Callable[..., Any])


@functools.cache
def _cache_folder() -> Path:
    """Folder of the machine code that belongs to the sources as they stand."""
    digest = hashlib.sha256()
    for room in _COMPILED_ROOMS:
        for path in sorted((_PACKAGE / room).rglob("*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    default = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "sassgis"
    base = Path(os.environ.get("SASSGIS_CACHE_DIR", default))
    folder = base / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        return Path(tempfile.gettempdir()) / "sassgis" / digest.hexdigest()[:16]
    return folder


def kernel(function: F) -> F:
    """Compile a function with numba: cached, without the GIL, IEEE division."""
    return _compiled(function, _nrt=True)


def lean(function: F) -> F:
    """As kernel, for a function that makes and returns no arrays, and no views of them.

    It does not count the references to the arrays that it is given; its caller holds them. In the
    motion of a block counting them took half of the time. One that makes an array does not compile.
    """
    return _compiled(function, _nrt=False)


def inlined(function: F) -> F:
    """As lean, and made part of the machine code of its callers.

    For the parts of a long kernel: passing many arrays costs more than most of what they do. Only
    compiled code can call it: for calls from Python each part would be compiled once more.
    """
    return _compiled(function, _nrt=False, forceinline=True, no_cpython_wrapper=True)


@functools.cache
def _kind(only_compiled: bool) -> type:
    """The class of a compiled function, or of one that only compiled code can call."""
    from numba.core import types as numba_types
    from numba.core.registry import CPUDispatcher

    types: Any = numba_types

    def get_call_template(self: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        # A literal argument is none: else each part would be compiled once for each of them.
        plain = {name: types.unliteral(kind) for name, kind in kws.items()}
        return CPUDispatcher.get_call_template(self, tuple(map(types.unliteral, args)), plain)

    def refuse(self: Any, *_: object, **__: object) -> None:
        raise TypeError(f"{self.__name__} can be called by compiled code only")

    own: dict[str, Any] = {"get_call_template": get_call_template}
    if only_compiled:
        own["__call__"] = refuse
    return type("Compiled", (CPUDispatcher,), own)


def _compiled(function: F, **options: Any) -> F:
    """Compile with numba; its settings of cache and level hold for this package's code."""
    import numba

    config: Any = numba.config
    if not os.environ.get("NUMBA_OPT"):
        # A sixth less time to compile than at numba's own level, for code that is no slower.
        config.OPT = type(config.OPT)(2)
    before = config.CACHE_DIR
    # Where the machine code is kept is decided here, as the function is decorated.
    config.CACHE_DIR = before or str(_cache_folder())
    try:
        options["no_cfunc_wrapper"] = True
        compiled: Any = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    finally:
        config.CACHE_DIR = before
    if not config.DISABLE_JIT:
        compiled.__class__ = _kind("no_cpython_wrapper" in options)
    out: F = compiled
    return out
