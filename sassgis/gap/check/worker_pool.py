"""Processes that work through a list of tasks, and the fence around those that must not peek."""

from __future__ import annotations

import importlib
import logging
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

from sassgis.model.errors import InputError, OutputError, SassgisError

#: What a process behind the fence must never hold.
FORBIDDEN = "sassgis.gap.check.worlds"
#: Libraries that would each start threads of their own.
_THREADS = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "GDAL_NUM_THREADS",
)
_FAREWELL_S = 5.0


@dataclass(frozen=True, slots=True)
class Task:
    """A call of a function in another process.

    Attributes
    ----------
    key : str
        Under which the outcome comes back.
    function : str
        As "module:name".
    args, kwargs
        Passed on to it.
    folders : tuple of Path
        What the function may open beneath the fenced folder.
    """

    key: str
    function: str
    args: tuple[Any, ...] = ()
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    folders: tuple[Path, ...] = ()


@dataclass(frozen=True, slots=True)
class TaskOutcome:
    """How a task ended.

    Attributes
    ----------
    key : str
    value : object
        What the function gave back, if it can be sent; None if it failed.
    failure : str
        Empty if it did not fail.
    seconds : float
    """

    key: str
    value: Any
    failure: str
    seconds: float


class Sandbox:
    """Refuses modules and folders to a process; set once, it cannot be taken away again.

    It hears of all that Python opens or imports. Files that GDAL opens by itself go by it.

    Parameters
    ----------
    root : Path
        Nothing beneath it is opened but what ``allow`` names.
    """

    def __init__(self, root: Path) -> None:
        self._root = os.path.realpath(root)
        self._allowed: tuple[str, ...] = ()

    def allow(self, folders: Sequence[Path]) -> None:
        """Name the folders beneath the root that may be used from now on."""
        self._allowed = tuple(os.path.realpath(folder) for folder in folders)

    def __call__(self, event: str, args: tuple[Any, ...]) -> None:
        """Hear of an event, as ``sys.addaudithook`` tells it."""
        if event == "import":
            name = str(args[0])
            if _forbidden(name):
                raise ImportError(f"{name} must not be seen from here")
        elif event in ("open", "os.listdir", "os.scandir", "sqlite3.connect"):
            path = args[0]
            if isinstance(path, str | bytes | os.PathLike):
                self._pass(os.path.realpath(os.fsdecode(path)))

    def _pass(self, path: str) -> None:
        if _within(path, self._root) and not any(_within(path, own) for own in self._allowed):
            raise PermissionError(f"{path} must not be seen from here")


def function_named(name: str) -> Any:
    """The function of a name such as "package.module:function"."""
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)


class WorkerPool:
    """Processes that live as long as the ``with`` block and take one task after the other.

    Each starts from a clean interpreter and works in a single thread.

    Parameters
    ----------
    jobs : int
        Number of processes.
    fenced : Path, optional
        Folder of which the processes see only what a task names; they then cannot load the made
        worlds either.
    """

    def __init__(self, jobs: int, fenced: Path | None = None) -> None:
        self._jobs = max(1, jobs)
        self._fenced = fenced
        self._members: list[tuple[SpawnProcess, Connection]] = []

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process, pipe in self._members:
            if kind is None:
                with suppress(OSError):
                    pipe.send(None)
            else:
                process.terminate()
        for process, pipe in self._members:
            process.join(_FAREWELL_S)
            if process.is_alive():
                process.kill()
                process.join()
            pipe.close()
        self._members.clear()

    def run(self, tasks: Iterable[Task]) -> Iterator[TaskOutcome]:
        """Outcomes of the tasks, in the order in which they end.

        Raises
        ------
        OutputError
            If the system ends a process, as it does when memory runs out.
        """
        waiting = list(tasks)[::-1]
        while len(self._members) < min(self._jobs, len(waiting)):
            self._members.append(self._hired())
        idle = [pipe for _, pipe in self._members]
        busy: dict[Connection, str] = {}
        while waiting or busy:
            while waiting and idle:
                pipe, task = idle.pop(), waiting.pop()
                busy[pipe] = task.key
                try:
                    pipe.send(task)
                except OSError:
                    raise self._lost(pipe, task.key) from None
            for ready in wait(list(busy)):
                assert isinstance(ready, Connection)
                key = busy.pop(ready)
                try:
                    outcome = ready.recv()
                except (EOFError, OSError):
                    raise self._lost(ready, key) from None
                idle.append(ready)
                yield outcome

    def _hired(self) -> tuple[SpawnProcess, Connection]:
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_member, args=(there, self._fenced), daemon=True)
        with _single_threaded(), _bare_main():
            process.start()
        there.close()
        return process, here

    def _lost(self, pipe: Connection, key: str) -> OutputError:
        process = next(process for process, own in self._members if own is pipe)
        process.join(_FAREWELL_S)
        code = process.exitcode or 0
        reason = f"signal {-code}" if code < 0 else f"exit code {code}"
        hint = "; memory may have run out: try fewer --jobs" if code == -9 else ""
        return OutputError(
            f"the process that worked on world {key} ended unexpectedly ({reason}){hint}; "
            "the same command goes on from there"
        )


def _member(pipe: Connection, fenced: Path | None) -> None:
    """Take tasks until told to stop, or until the other side is gone."""
    # Ctrl-C reaches all processes of a terminal; the first one sees to the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    sandbox = None
    if fenced is not None:
        _no_worlds()
        sandbox = Sandbox(fenced)
        sys.addaudithook(sandbox)
    with suppress(EOFError, OSError):
        while (task := pipe.recv()) is not None:
            if sandbox is not None:
                sandbox.allow(task.folders)
            outcome = _done(task)
            if sandbox is not None:
                _no_worlds()
            pipe.send(outcome)


def _done(task: Task) -> TaskOutcome:
    began = time.monotonic()
    value: Any = None
    failure = ""
    try:
        value = function_named(task.function)(*task.args, **task.kwargs)
    except SassgisError as error:
        failure = str(error)
    except Exception as error:
        # A world on which the diagnosis breaks is a result of the check.
        failure = " ".join(f"{type(error).__name__}: {error}".split())
    if not isinstance(value, dict | list | str | int | float | bool | None):
        value = None
    return TaskOutcome(task.key, value, failure, time.monotonic() - began)


def _no_worlds() -> None:
    seen = sorted(name for name in sys.modules if _forbidden(name))
    if seen:
        raise InputError(
            "the diagnosing process has loaded the made worlds",
            found=", ".join(seen),
            expected="none of them",
        )


def _forbidden(name: str) -> bool:
    return name == FORBIDDEN or name.startswith(f"{FORBIDDEN}.")


def _within(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


@contextmanager
def _bare_main() -> Iterator[None]:
    """Hide the program that is running: a new process would load it, and all that it loads."""
    before = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = before


@contextmanager
def _single_threaded() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
