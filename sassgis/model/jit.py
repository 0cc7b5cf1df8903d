"""The decorators of compiled code.

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
    Its machine code has no entry from Python, which takes a tenth of the time to compile: where
    Python calls it, it is compiled once more with one.
    """
    return _compiled(function, _nrt=False, no_cpython_wrapper=True)


def fused(function: F) -> F:
    """As lean, and made part of the machine code of its callers.

    For the parts of a long kernel: passing many arrays costs more than most of what they do.
    """
    return _compiled(function, _nrt=False, forceinline=True, no_cpython_wrapper=True)


def inlined(function: F) -> F:
    """Put in the place of each call before types are found, without machine code of its own.

    For short functions, and for long ones that only one kernel calls: each function that is
    compiled for itself costs a tenth of a second, and a long one is optimised once more for each
    caller above it. Where many long ones stand in each other, copying them takes longer than that,
    and what stands in a kernel counts references at each call, as the kernel does.
    """
    return _compiled(function, inline="always")


@functools.cache
def _kind(without_entry: bool) -> type:
    """The class of a compiled function, or of one without an entry from Python."""
    from numba.core import types as numba_types
    from numba.core.registry import CPUDispatcher

    types: Any = numba_types

    def get_call_template(self: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        # A literal argument is none: else each part would be compiled once for each of them.
        plain = {name: types.unliteral(kind) for name, kind in kws.items()}
        return CPUDispatcher.get_call_template(self, tuple(map(types.unliteral, args)), plain)

    def call(self: Any, *given: object) -> object:
        return _with_entry(self.py_func)(*given)

    own: dict[str, Any] = {"get_call_template": get_call_template}
    if without_entry:
        own["__call__"] = call
    return type("Compiled", (CPUDispatcher,), own)


@functools.cache
def _with_entry(function: F) -> F:
    """A compiled function that Python can call; not kept, where it would be taken for the other."""
    return _compiled(function, _nrt=False, cache=False)


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
        options = {"cache": True, "no_cfunc_wrapper": True, **options}
        compiled: Any = numba.njit(nogil=True, error_model="numpy", **options)(function)
    finally:
        config.CACHE_DIR = before
    if not config.DISABLE_JIT:
        compiled.__class__ = _kind("no_cpython_wrapper" in options)
    out: F = compiled
    return out
