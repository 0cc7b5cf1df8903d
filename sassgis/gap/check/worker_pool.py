"""Processes that work through a list of tasks, and the sandbox of those that must not peek."""

from __future__ import annotations

import importlib
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from subprocess import PIPE, Popen
from types import ModuleType, TracebackType
from typing import Any

from threadpoolctl import threadpool_limits

from sassgis.model.errors import InputError, OutputError, SassgisError
from sassgis.model.worker_process import end_with_parent

#: What a sandboxed process must never hold.
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
        What the function may open beneath the sandboxed folder.
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
        """Hear of an event, as ``sys.addaudithook`` asks for."""
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
    sandboxed : Path, optional
        Folder of which the processes see only what a task names; they then cannot load the
        synthetic sites either.
    """

    def __init__(self, jobs: int, sandboxed: Path | None = None) -> None:
        self._jobs = max(1, jobs)
        self._others = frozenset(child.pid for child in multiprocessing.active_children())
        self._executor = ProcessPoolExecutor(
            self._jobs, multiprocessing.get_context("spawn"), _prepare, (sandboxed,)
        )

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is not None:
            # A task may take minutes: nobody waits for it after an error or Ctrl-C.
            for child in multiprocessing.active_children():
                if child.pid not in self._others:
                    child.terminate()
        self._executor.shutdown(cancel_futures=True)

    def run(self, tasks: Iterable[Task]) -> Iterator[TaskOutcome]:
        """Outcomes of the tasks, in the order in which they end.

        Raises
        ------
        InputError
            If a sandboxed process has loaded the synthetic sites.
        OutputError
            If a process ends, as it does when memory runs out.
        """
        waiting = iter(tasks)
        running: dict[Future[TaskOutcome], str] = {}
        while True:
            # No more than are worked on: if a process ends, these are the ones it may have held.
            for task in islice(waiting, self._jobs - len(running)):
                with _hidden_main():
                    running[self._executor.submit(_perform, task)] = task.key
            if not running:
                return
            ended, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in ended:
                try:
                    outcome = future.result()
                except BrokenProcessPool:
                    reason = "killed; memory may have run out: try fewer --jobs"
                    raise _ended(" or ".join(sorted(running.values())), reason) from None
                except SystemExit as error:
                    raise _ended(running[future], f"exit code {error.code}") from None
                del running[future]
                yield outcome


def in_own_process(sandboxed: Path | None, task: Task) -> TaskOutcome:
    """Outcome of one task in a process that is there for it alone, as on a machine of a cluster.

    Raises
    ------
    InputError
        If the sandboxed process has loaded the synthetic sites.
    OutputError
        If the process ends, as it does when memory runs out.
    """
    # Processes of a cluster may not have children of multiprocessing.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with Popen([sys.executable, "-c", _SERVE], stdin=PIPE, stdout=PIPE, env=environment) as own:
        assert own.stdin is not None and own.stdout is not None
        pickle.dump((sandboxed, task), own.stdin)
        own.stdin.flush()
        answer = own.stdout.read()
        own.wait()
    if not answer:
        raise _ended(task.key, f"exit code {own.returncode}")
    outcome: TaskOutcome | SassgisError = pickle.loads(answer)
    if isinstance(outcome, SassgisError):
        raise outcome
    return outcome


_SERVE = "from sassgis.gap.check.worker_pool import serve_one; serve_one()"


def serve_one() -> None:
    """Perform the task that comes by standard input, and end where that ends before."""
    with os.fdopen(os.dup(1), "wb") as answer:
        # What a library prints is none of the answer.
        os.dup2(2, 1)
        sandboxed, task = pickle.load(sys.stdin.buffer)

        def watch() -> None:
            os.read(0, 1)
            os._exit(1)

        threading.Thread(target=watch, name="end with parent", daemon=True).start()
        _prepare(sandboxed)
        outcome: TaskOutcome | SassgisError
        try:
            outcome = _perform(task)
        except SassgisError as error:
            outcome = error
        pickle.dump(outcome, answer)


def _ended(key: str, reason: str) -> OutputError:
    return OutputError(
        f"the process that worked on site {key} ended unexpectedly ({reason}); "
        "the same command goes on from there"
    )


#: The sandbox of this process, if it is a worker that has one.
_SANDBOX: Sandbox | None = None


def _prepare(sandboxed: Path | None) -> None:
    """Make a new process ready for its tasks."""
    global _SANDBOX
    end_with_parent()
    # Ctrl-C reaches all processes of a terminal; the first one sees to the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    threadpool_limits(1)
    if sandboxed is not None:
        _SANDBOX = Sandbox(sandboxed)
        sys.addaudithook(_SANDBOX)


def _perform(task: Task) -> TaskOutcome:
    if _SANDBOX is None:
        return _outcome(task)
    _no_worlds()
    _SANDBOX.allow(task.folders)
    outcome = _outcome(task)
    _no_worlds()
    return outcome


def _outcome(task: Task) -> TaskOutcome:
    began = time.monotonic()
    value: Any = None
    failure = ""
    try:
        value = function_named(task.function)(*task.args, **task.kwargs)
    except SassgisError as error:
        failure = str(error)
    except Exception as error:
        # A site on which the diagnosis breaks is a result of the check.
        failure = " ".join(f"{type(error).__name__}: {error}".split())
    if not isinstance(value, dict | list | str | int | float | bool | None):
        value = None
    return TaskOutcome(task.key, value, failure, time.monotonic() - began)


def _no_worlds() -> None:
    seen = sorted(name for name in sys.modules if _forbidden(name))
    if seen:
        raise InputError(
            "the diagnosing process has loaded the synthetic sites",
            found=", ".join(seen),
            expected="none of them",
        )


def _forbidden(name: str) -> bool:
    return name == FORBIDDEN or name.startswith(f"{FORBIDDEN}.")


def _within(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


@contextmanager
def _hidden_main() -> Iterator[None]:
    """Hide the program that is running: a new process would load it, and all that it loads."""
    before = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = before
