"""From what pydantic finds in a file to errors of one line."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from sassgis.errors import ConfigError, InputError
from sassgis.settings.schema import Declared, explained

Place = tuple[int | str, ...]
Wrong = TypeVar("Wrong", bound=InputError)


@dataclasses.dataclass(frozen=True, slots=True)
class Messages:
    """Turns what pydantic finds in a file into errors of one line each."""

    file: object
    document: Mapping[str, Any]  # the file as it was read, for the names of blocks and stations
    lists: tuple[str, ...]  # sections that are written with double brackets
    nearest: Callable[[Place], str]  # what an unknown key at a place was probably meant to be
    # The setting at a place; None where there is none.
    setting: Callable[[Place], Declared | None] = lambda _loc: None
    named_by: str = "name"  # key by which a section with double brackets is called
    #: From a place and the kind of pydantic's error to what would have been accepted, where the
    #: file has other words for it.
    expected: Callable[[Place, str], str | None] = lambda _loc, _kind: None

    def of(self, error: ValidationError) -> list[ConfigError]:
        """List all that is wrong."""
        return [self._one_line(e) for e in error.errors()]

    def _one_line(self, error: ErrorDetails) -> ConfigError:
        loc, kind = error["loc"], error["type"]
        parts = explained(error, self.setting(loc))
        if parts["problem"] == "unknown key":
            words: str | None = self.nearest(loc)
        else:
            words = self.expected(loc, kind) or self._section(loc, kind)
        parts["expected"] = words or parts["expected"]
        inner = parts.pop("field")
        field = self._dotted(loc) + (f".{inner}" if inner else "")
        return ConfigError(file=self.file, field=field, **parts)

    def _section(self, loc: Place, kind: str) -> str | None:
        """Describe how a section must be written, where it is none."""
        name = str(loc[0])
        if kind in ("dict_type", "dataclass_type"):
            return f"[[{name}]]" if name in self.lists else f"a section [{'.'.join(map(str, loc))}]"
        if kind == "tuple_type" and len(loc) == 1:
            return f"one or more sections [[{name}]], with double brackets"
        return None

    def _dotted(self, loc: Place) -> str:
        """Return the key as the user would look for it: ``blocks[large].axis_1_m``."""
        head, rest = str(loc[0]), list(loc[1:])
        text = head
        if head in self.lists and rest and isinstance(rest[0], int):
            number = int(rest.pop(0))
            try:
                name = self.document[head][number][self.named_by]
            except (KeyError, IndexError, TypeError):
                name = None
            text += f"[{name}]" if isinstance(name, str) and name.strip() else f"[no. {number + 1}]"
        for part in rest:
            # The place inside a pair or a list is given by the value that was found there; what is
            # a text or a list was tried as both.
            if isinstance(part, str) and part not in ("[key]", "str", "list[str]"):
                text += f".{part}"
        return text


def first_of(problems: Sequence[Wrong]) -> Wrong:
    """Return the error that says most; it states how many more there are."""
    # A misspelt key shows up twice, as unknown and as missing: the first says more.
    first = min(problems, key=lambda p: p.problem != "unknown key")
    if len(problems) > 1:
        first.args = (f"{first} (and {len(problems) - 1} more)",)
    return first
