"""The sandbox of processes that must not peek, and the tasks that they are given."""

from __future__ import annotations

import os
import pkgutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sassgis.model.errors import InputError, SassgisError

#: What a sandboxed process must never hold.
FORBIDDEN = "sassgis.gap.check.worlds"


@dataclass(frozen=True, slots=True)
class Task:
    """A call of a function in another process."""

    name: str  # of the site
    function: str  # as "module:name"
    args: tuple[Any, ...] = ()
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    folders: tuple[Path, ...] = ()  # what it may open beneath the sandboxed folder


@dataclass(frozen=True, slots=True)
class TaskOutcome:
    """How a task ended."""

    name: str  # of the task
    value: Any  # what the function gave back, if it can be sent; None if it failed
    failure: str  # empty if it did not fail
    seconds: float


class Sandbox:
    """Refuses modules and folders to a process; set once, it cannot be taken away again.

    It hears of all that Python opens or imports; beneath ``root`` nothing is opened but what
    ``allow`` names. Files that GDAL opens by itself go by it.
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


#: The sandbox of this process, if it is a worker that has one.
_SANDBOX: Sandbox | None = None


def perform(sandboxed: Path | None, task: Task) -> TaskOutcome:
    """In a process that does nothing else: the outcome of a task.

    Parameters
    ----------
    sandboxed : Path or None
        Folder of which the process sees only what the task names, the same for all of its tasks;
        it then cannot load the synthetic sites either.

    Raises
    ------
    InputError
        If a sandboxed process has loaded the synthetic sites.
    """
    global _SANDBOX
    if sandboxed is None:
        return _outcome(task)
    if _SANDBOX is None:
        _SANDBOX = Sandbox(sandboxed)
        sys.addaudithook(_SANDBOX)
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
        value = pkgutil.resolve_name(task.function)(*task.args, **task.kwargs)
    except SassgisError as error:
        failure = str(error)
    except Exception as error:
        # A site on which the diagnosis breaks is a result of the check.
        failure = " ".join(f"{type(error).__name__}: {error}".split())
    if not isinstance(value, dict | list | str | int | float | bool | None):
        value = None
    return TaskOutcome(task.name, value, failure, time.monotonic() - began)


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
