"""Machine code that is made once: of a function that Python calls, with all that it calls.

numba writes machine code for each function with those that it calls: what stands under ten others
is made eleven times. Here a function is a part, which stays LLVM code as numba's front end leaves
it. Where Python enters, the parts below are linked into one module, which is optimised and written
once: LLVM puts what is called once into its caller, and hands on no arguments that are not read.

All this stands on the inside of numba; jit.py does without it where that is another one.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from numba.core import config as _config
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.registry import CPUDispatcher
from numba.core.types import unliteral

config: Any = _config

# Instructions, as the front end leaves them, up to which a part is copied to where it is called.
# LLVM's own limit is for functions of a few arguments; those of the motion have a hundred.
_LONGEST_COPIED = 1750


class _PartLibrary(JITCodeLibrary):
    """LLVM code of one function, to be linked into entries."""

    # In the place of what writes machine code: an entry sets the variables of its parts.
    codegen = SimpleNamespace(set_env=lambda *_: None)

    def add_ir_module(self, module: Any) -> None:
        for function in module.functions:
            n = sum(len(block.instructions) for block in function.blocks)
            if 0 < n <= _LONGEST_COPIED:
                function.attributes.add("alwaysinline")
        super().add_ir_module(module)

    def finalize(self) -> None:
        # So that other modules can link the code, several times if need be.
        for function in self._final_module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        self._ensure_finalized()
        return self._final_module

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0  # There is no machine code.


class _EntryLibrary(JITCodeLibrary):
    """Machine code of a function that Python calls, and of all parts below it."""

    def finalize(self) -> None:
        below: dict[Any, None] = {}
        waiting = list(self._linking_libraries)
        while waiting:
            library = waiting.pop()
            if library not in below:
                below[library] = None
                if isinstance(library, _PartLibrary):
                    waiting += library._linking_libraries
        self._linking_libraries = list(below)
        super().finalize()

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        super()._optimize_final_module()


class PartCompiler(CompilerBase):
    """Compiles a function as a part of others: numba's own passes, into a library of ours."""

    library: type[JITCodeLibrary] = _PartLibrary

    def define_pipelines(self) -> list[Any]:
        """Return passes of numba."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return [DefaultPassBuilder.define_nopython_pipeline(state)]


class EntryCompiler(PartCompiler):
    """Compiles a function as one that Python calls, with all parts that it calls."""

    library = _EntryLibrary


class PartFunction(CPUDispatcher):
    """A compiled function: a part of others, that Python calls by its ``entry``."""

    entry: Callable[[Callable[..., Any], bool], Callable[..., Any]]

    def get_call_template(self, args: Any, kws: Any) -> Any:
        # A literal argument is none: else each part would be compiled once for each of them.
        plain = {name: unliteral(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(map(unliteral, args)), plain)

    def __call__(self, *given: object) -> object:
        return self.entry(self.py_func, self.targetoptions.get("_nrt", True))(*given)


class _Place:
    """A folder named after the module of a function: equal sources share it wherever they are."""

    def __init__(self, function: Any, file: str) -> None:
        folder = os.path.join(config.CACHE_DIR, function.__module__)
        stamp = hashlib.sha256(Path(file).read_bytes()).hexdigest()
        line = str(function.__code__.co_firstlineno)  # distinguishes functions of one name
        self.ensure_cache_path = partial(os.makedirs, folder, exist_ok=True)
        self.get_cache_path = lambda: folder
        self.get_source_stamp = lambda: stamp
        self.get_disambiguator = lambda: line

    @classmethod
    def from_function(cls, function: Any, file: str) -> _Place:
        return cls(function, file)


class _Kept(CompileResultCacheImpl):
    _locator_classes: Any = (_Place,)


class KeptCode(FunctionCache):
    """Machine code of a function in the folder of the cache; ``tell`` hears why it is not kept."""

    _impl_class = _Kept

    def __init__(self, function: Callable[..., Any], tell: Callable[[Exception], None]) -> None:
        super().__init__(function)
        self._tell = tell

    @contextmanager
    def _guard_against_spurious_io_errors(self) -> Iterator[None]:
        # A full disk of the cache ends no run: the code is there, and is made again another time.
        try:
            yield
        except OSError as error:
            self._tell(error)
