"""The errors that sassgis raises on purpose, and what its readers have to say.

Every error prints as a single line. Anything else that escapes is a bug in sassgis.
"""

from __future__ import annotations

import errno
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Literal

#: What a message repeats of an input, or offers instead, is cut to so many characters and the last.
_FIRST, _LAST = 400, 150


class SassgisError(Exception):
    """Root of all errors raised on purpose; the command line prints it without a traceback."""

    exit_code = 1


class InputError(SassgisError):
    """Raised when a file or value that the user gave cannot be used.

    It says what is wrong (``problem``), in which file and key, column, layer or band (``field``),
    the value that was ``found`` there, and what would have been accepted (``expected``).
    """

    exit_code = 2

    def __init__(
        self,
        problem: str,
        *,
        file: object = None,
        field: str | None = None,
        found: object = None,
        expected: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.field = field
        self.found = found
        self.expected = expected
        line = ": ".join(shown(part) for part in (self.file, field, problem) if part)
        detail = "; ".join(
            f"{word} {shown(part)}"
            for word, part in (("found", found), ("expected", expected))
            if part is not None
        )
        super().__init__(f"{line} ({detail})" if detail else line)

    def parts(self, **other: object) -> dict[str, Any]:
        """Return its parts, to make one that says ``other`` things of the same fault."""
        names = ("problem", "file", "field", "found", "expected")
        return {name: getattr(self, name) for name in names} | other


#: Lists of notices, and of what needs no attention, of those who collect them.
_COLLECTED: ContextVar[tuple[tuple[list[str], list[str] | None], ...]] = ContextVar(
    "collected", default=()
)


def notice(text: str, level: Literal["info", "warning", "error"] = "warning") -> None:
    """Say something of an input to all who collect notices, and to the log of the program."""
    collected = _COLLECTED.get()
    for notices, quietly in collected:
        own = quietly if level == "info" else notices
        if own is not None and text not in own:
            own.append(text)
    if all(quietly is None for _, quietly in collected):
        logging.getLogger("sassgis").log(getattr(logging, level.upper()), "%s", text)


@contextmanager
def collected_notices(quietly: list[str] | None = None) -> Iterator[list[str]]:
    """Collect what the readers have to say within the block, each once.

    With ``quietly`` also what needs no attention, in that list; the log gets nothing of both.
    """
    notices: list[str] = []
    before = _COLLECTED.set((*_COLLECTED.get(), (notices, quietly)))
    try:
        yield notices
    finally:
        _COLLECTED.reset(before)


def chain(error: BaseException) -> Iterator[BaseException]:
    """Yield an error, and those from which it came."""
    seen: set[int] = set()
    current: BaseException | None = error
    while current is not None and id(current) not in seen:
        seen.add(id(current))
        yield current
        current = current.__cause__ or current.__context__


#: What libraries say where the system gives them no memory, or no thread.
_MEMORY_WORDS = (
    "failed to map segment", "cannot allocate memory", "unable to allocate", "start new thread",
)  # fmt: skip
#: Address space below which libraries cannot be loaded (bytes): instead of an error OpenBLAS waits
#: for ever, or stops the program as Ctrl-C does.
_LIBRARIES = 550_000_000
_NUMBERS = "EMFILE ENFILE ENOSPC EDQUOT EFBIG EROFS EIO EAGAIN ENOMEM"
_REFUSED = {getattr(errno, name, None) for name in _NUMBERS.split()}


def of_the_system(error: BaseException) -> str:
    """State in words what the system refused; empty where an error is of another kind."""
    text = str(error).lower()
    if isinstance(error, MemoryError) or any(words in text for words in _MEMORY_WORDS):
        return "not enough memory; fewer release points or larger cells need less"
    if isinstance(error, OSError) and error.errno in _REFUSED:
        return f"{shown(error.filename or 'the system')}: {error.strerror}"
    # Libraries fail in many ways where they cannot be loaded.
    if isinstance(error, ImportError | SystemError | OSError) and (limit := _memory_limit()):
        return f"probably {_too_little(limit)}"
    return ""


def require_room_for_libraries() -> None:
    """Raise SassgisError where the system allows less memory than libraries take."""
    if 0 < (limit := _memory_limit()) < _LIBRARIES:
        raise SassgisError(_too_little(limit))


def _too_little(limit: int) -> str:
    return f"not enough memory: {limit / 1e6:.0f} MB are allowed (ulimit -v)"


def _memory_limit() -> int:
    """Return the memory that this process may have (bytes); 0 if nothing limits it."""
    try:
        import resource
    except ImportError:  # pragma: no cover
        return 0  # on Windows
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return 0 if limit == resource.RLIM_INFINITY else limit


def shown(part: object) -> str:
    """Return a part of a message: of inputs of any length, without what would steer a terminal."""
    text = " ".join(str(part).split())
    if len(text) > _FIRST + _LAST:
        text = f"{text[:_FIRST]} ... {text[-_LAST:]}"
    return "".join(c if c.isprintable() else "\ufffd" for c in text)


class ConfigError(InputError):
    """Raised when the configuration has an unknown key, a missing key or an unusable value."""


class InputLost(SassgisError):
    """Raised when a file that all parts of a run share was there and is gone."""

    exit_code = 2


class OutputError(SassgisError):
    """Raised when results cannot be written (disk full, no permission, target exists)."""

    exit_code = 3


class Interrupted(SassgisError):
    """Raised when the user stops a run; what was computed has been kept for the next run."""

    exit_code = 130
