"""The errors that sassgis raises on purpose.

Every one of them prints as a single line. Anything else that escapes is a bug in sassgis.
"""

from __future__ import annotations

from os import PathLike


class SassgisError(Exception):
    """Root of all errors raised on purpose; the command line prints it without a traceback."""

    exit_code = 1


class InputError(SassgisError):
    """Raised when a file or value that the user gave cannot be used.

    Parameters
    ----------
    problem
        What is wrong, in plain words.
    file
        The file in which it was found.
    field
        The key, column, layer or band that holds it.
    found, expected
        The offending value, and what would have been accepted.
    """

    exit_code = 2

    def __init__(
        self,
        problem: str,
        *,
        file: str | PathLike[str] | None = None,
        field: str | None = None,
        found: object = None,
        expected: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.field = field
        self.found = found
        self.expected = expected
        where = ": ".join(part for part in (self.file, field) if part)
        detail = "; ".join(
            part
            for part in (
                "" if found is None else f"found {found}",
                "" if expected is None else f"expected {expected}",
            )
            if part
        )
        line = f"{where}: {problem}" if where else problem
        if detail:
            line = f"{line} ({detail})"
        super().__init__(" ".join(line.split()))


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
