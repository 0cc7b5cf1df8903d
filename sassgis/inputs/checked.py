"""From what pydantic finds in a file to errors of one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails
from typing_extensions import TypedDict

from sassgis.errors import ConfigError, InputError
from sassgis.settings.schema import RULES, Declared, explained

Place = tuple[int | str, ...]
Wrong = TypeVar("Wrong", bound=InputError)
# The keys are known at run time only, which type checkers do not follow.
_new_table: Any = TypedDict


def table_type(name: str, fields: Mapping[str, Any], about: str | None = None) -> Any:
    """Return a type for pydantic: a table with these keys and no others."""
    table = _new_table(name, dict(fields))
    table.__pydantic_config__ = RULES
    table.__doc__ = about
    return table


def first_error(
    error: ValidationError,
    file: object,
    document: Mapping[str, Any],
    lists: Sequence[str],
    nearest: Callable[[Place], str],
    *,
    setting: Callable[[Place], Declared | None] = lambda _loc: None,
    named_by: str = "name",
    expected: Callable[[Place, str], str | None] = lambda _loc, _kind: None,
) -> ConfigError:
    """Return the error that says most of a file.

    Parameters
    ----------
    document
        The file as it was read, for the names of blocks and stations.
    lists
        Sections that are written with double brackets; ``named_by`` is the key of their names.
    nearest
        What an unknown key at a place was probably meant to be.
    setting
        The setting at a place; None where there is none.
    expected
        From a place and the kind of pydantic's error to what would have been accepted, where the
        file has other words for it.
    """

    def one_line(wrong: ErrorDetails) -> ConfigError:
        loc, kind = wrong["loc"], wrong["type"]
        parts = explained(wrong, setting(loc))
        if parts["problem"] == "unknown key":
            words: str | None = nearest(loc)
        else:
            words = expected(loc, kind) or _section(loc, kind, lists)
        parts["expected"] = words or parts["expected"]
        inner = parts.pop("field")
        field = _dotted(loc, document, lists, named_by) + (f".{inner}" if inner else "")
        return ConfigError(file=file, field=field, **parts)

    return first_of([one_line(wrong) for wrong in error.errors()])


def _section(loc: Place, kind: str, lists: Sequence[str]) -> str | None:
    """Describe how a section must be written, where it is none."""
    name = str(loc[0])
    if kind in ("dict_type", "dataclass_type"):
        return f"[[{name}]]" if name in lists else f"a section [{'.'.join(map(str, loc))}]"
    if kind == "tuple_type" and len(loc) == 1:
        return f"one or more sections [[{name}]], with double brackets"
    return None


def _dotted(loc: Place, document: Mapping[str, Any], lists: Sequence[str], named_by: str) -> str:
    """Return the key as the user would look for it: ``blocks[large].axis_1_m``."""
    text, rest = str(loc[0]), list(loc[1:])
    if text in lists and rest and isinstance(rest[0], int):
        number = int(rest.pop(0))
        try:
            name = document[text][number][named_by]
        except (KeyError, IndexError, TypeError):
            name = None
        text += f"[{name}]" if isinstance(name, str) and name.strip() else f"[no. {number + 1}]"
    # The place inside a pair or a list is given by the value that was found there; what is a text
    # or a list was tried as both.
    tried = ("[key]", "str", "list[str]")
    return ".".join([text, *(p for p in rest if isinstance(p, str) and p not in tried)])


def first_of(problems: Sequence[Wrong]) -> Wrong:
    """Return the error that says most; it states how many more there are."""
    # A misspelt key shows up twice, as unknown and as missing: the first says more.
    first = min(problems, key=lambda p: p.problem != "unknown key")
    if len(problems) > 1:
        first.args = (f"{first} (and {len(problems) - 1} more)",)
    return first
