"""Machine code that is made once: of a function that Python calls, with all that it calls.

numba optimises each function together with those that it calls, and writes machine code for it:
what stands under ten others is made eleven times. Here all functions are parts. A part stays LLVM
code as numba's front end leaves it. Where Python enters, the parts below are linked into one
module, which is optimised and written once. Nothing else can call them there, so that LLVM puts
what is called once into its caller, and hands on no arguments that are not read: most of an array.
"""

from __future__ import annotations

import gc
import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba.core import config as _config
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder

config: Any = _config

# Objects that are made before Python looks for garbage among the youngest. numba makes millions
# that stay; at Python's own 700 looking through them takes a fifth of the time to compile.
_OBJECTS_BEFORE_GARBAGE = 100_000

# Instructions, as the front end leaves them, up to which a part is copied to where it is called.
# LLVM's own limit is for functions of a few arguments; those of the motion have a hundred.
_LONGEST_COPIED = 1750


class _NoMachineCode:
    """In the place of what writes machine code: a part has no variables to set."""

    def set_env(self, name: str, environment: object) -> None:
        """Set nothing: an entry sets those of its parts."""


class PartLibrary(JITCodeLibrary):
    """LLVM code of one function, to be linked into entries."""

    @property
    def codegen(self) -> _NoMachineCode:
        """Where machine code is written; here nowhere."""
        return _NoMachineCode()

    def add_ir_module(self, module: Any) -> None:
        """Take what numba's front end has made of the function."""
        for function in module.functions:
            n = sum(len(block.instructions) for block in function.blocks)
            if 0 < n <= _LONGEST_COPIED:
                function.attributes.add("alwaysinline")
        super().add_ir_module(module)

    def finalize(self) -> None:
        """Let other modules link the code, several times if need be."""
        for function in self._final_module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        self._ensure_finalized()
        return self._final_module

    def get_pointer_to_function(self, name: str) -> int:
        """Address of the machine code: there is none."""
        self._ensure_finalized()
        return 0


class EntryLibrary(JITCodeLibrary):
    """Machine code of a function that Python calls, and of all parts below it."""

    def finalize(self) -> None:
        """Link the parts, optimise, write machine code."""
        below: dict[Any, None] = {}
        waiting = list(self._linking_libraries)
        while waiting:
            library = waiting.pop()
            if library not in below:
                below[library] = None
                if isinstance(library, PartLibrary):
                    waiting += library._linking_libraries
        self._linking_libraries = list(below)
        super().finalize()

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        super()._optimize_final_module()


class _Compiler(CompilerBase):
    """numba's own passes, with the result in a library of ours."""

    library: type[JITCodeLibrary]

    def define_pipelines(self) -> list[Any]:
        """Passes of numba."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return [DefaultPassBuilder.define_nopython_pipeline(state)]


class PartCompiler(_Compiler):
    """Compiles a function as a part of others."""

    library = PartLibrary


class EntryCompiler(_Compiler):
    """Compiles a function as one that Python calls."""

    library = EntryLibrary

    def compile_extra(self, function: Callable[..., Any]) -> Any:
        """Compile it with all parts that it calls."""
        with _rare_garbage_collection():
            return super().compile_extra(function)


@contextmanager
def _rare_garbage_collection() -> Iterator[None]:
    before = gc.get_threshold()
    gc.set_threshold(max(before[0], _OBJECTS_BEFORE_GARBAGE) if before[0] else 0, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


class _ByModule:
    """Machine code lies in a folder named after its module.

    Wherever the package is, equal sources share it: numba's own folders are named after the place
    of the file, so that a package and the sources that it was installed from compile everything
    twice.
    """

    def __init__(self, function: Any, file: str) -> None:
        self._folder: str = os.path.join(config.CACHE_DIR, function.__module__)
        self._line = function.__code__.co_firstlineno
        self._stamp = hashlib.sha256(Path(file).read_bytes()).hexdigest()

    @classmethod
    def from_function(cls, function: Any, file: str) -> _ByModule:
        """As numba asks for it."""
        return cls(function, file)

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        os.makedirs(self._folder, exist_ok=True)

    def get_cache_path(self) -> str:
        """The folder."""
        return self._folder

    def get_source_stamp(self) -> str:
        """What changes as the file does, and with nothing else."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """What tells functions of one name apart."""
        return str(self._line)


class _Kept(CompileResultCacheImpl):
    _locator_classes: Any = (_ByModule,)


class KeptCode(FunctionCache):
    """Machine code of a function in the folder of the cache."""

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
