"""How settings are declared: kind, limits and meaning stand in the annotation of a field, once.

``smoothing_m: Annotated[float, Interval(ge=0, le=200), "scale of the terrain (m)"] = 5.0`` is all
that checks, messages, the template and the documentation need.
"""

from __future__ import annotations

import dataclasses
import math
import re
import types
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from functools import cache
from numbers import Integral, Real
from operator import is_
from pathlib import Path, PurePath
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from annotated_types import Interval, MaxLen, MinLen

from sassgis.model.errors import ConfigError
from sassgis.model.in_memory import InMemory


class Mark(Enum):
    """What an annotation says of a value besides its type and its limits."""

    RANGE = auto()  # a pair of numbers is a range [low, high]; the user may give a single number
    PLAIN_NAME = auto()  # a text names a thing: no comma, semicolon or line break
    PRESET_NAME = auto()  # a text is the name of a built-in preset, or a TOML file
    OF_FEATURES = auto()  # the attribute with a setting of single features, as value_field: value
    CODES = auto()  # the keys of a table are whole numbers, which TOML writes as text


@dataclass(frozen=True, slots=True)
class Renamed:
    """The key that a setting had before; it is still read, with a note."""

    old: str


@dataclass(frozen=True, slots=True)
class Example:
    """What the template shows for a setting; ``needed`` if it stands there without a comment."""

    value: object
    needed: bool = False


Span = Annotated[tuple[float, float], Mark.RANGE]
Name = Annotated[str, Mark.PLAIN_NAME]
Text = Annotated[str, MinLen(1)]
FieldName = Annotated[Text | None, Mark.OF_FEATURES]


class Declared(NamedTuple):
    """One setting as it is declared."""

    name: str  # the key
    kind: Any  # its annotation
    default: Any  # ``dataclasses.MISSING`` if it must be given
    description: str  # meaning, with the unit
    old_name: str | None  # the key that it had before
    example: Example | None

    @property
    def is_required(self) -> bool:
        """Whether the user must give it."""
        return self.default is dataclasses.MISSING


@dataclass(frozen=True, slots=True)
class Section:
    """What all settings share: they are checked when they are made, and do not change.

    A program may give a single number for a range, a list for a tuple and a text for a path.
    """

    def __post_init__(self) -> None:
        for setting in declared(type(self)).values():
            given = getattr(self, setting.name)
            value = adapted(setting.kind, given)
            if value is not given:
                object.__setattr__(self, setting.name, value)
            wrong = fault(setting.kind, value)
            if wrong is not None:
                raise ConfigError(
                    wrong.problem,
                    field=setting.name,
                    found=repr(wrong.found),
                    expected=wrong.expected,
                )
        self._fits_together()

    def _fits_together(self) -> None:
        """Raise ConfigError where single values are right, but not all of them together."""

    def _goes_with(self, keys: Iterable[str], other: str, what: str, named: str = "") -> None:
        """Raise ConfigError where one of some keys has a value, and the other that it needs none.

        ``what`` the other is, and how the message names it where that is not its key.
        """
        for key in keys:
            if getattr(self, key) is not None and getattr(self, other) is None:
                problem, expected = f"has no {what} to go with", f"{named or other} as well"
                raise ConfigError(problem, field=key, expected=expected)


def declared(cls: type) -> Mapping[str, Declared]:
    """Settings of a section by key, in order; fields without a description are none."""
    return _declared(cast(Any, cls))


@cache
def _declared(cls: Any) -> Mapping[str, Declared]:
    hints = get_type_hints(cls, include_extras=True)
    found: dict[str, Declared] = {}
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        notes = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
        if Mark.OF_FEATURES in notes:
            key = field.name.removesuffix("_field")
            notes = (f"attribute with {key}", Example(key))
        text = next((n for n in notes if isinstance(n, str)), None)
        if text is not None:
            found[field.name] = Declared(
                field.name,
                hint,
                field.default,
                text,
                next((n.old for n in notes if isinstance(n, Renamed)), None),
                next((n for n in notes if isinstance(n, Example)), None),
            )
    return types.MappingProxyType(found)


def composed(text: str) -> str:
    """A name in the one of its Unicode forms that all are compared in (NFC): ö, not o and dots."""
    return text if unicodedata.is_normalized("NFC", text) else unicodedata.normalize("NFC", text)


def adapted(kind: Any, value: Any) -> Any:
    """A value in the form that its annotation asks for, as far as that is plain; else as it is."""
    origin, parts = get_origin(kind), get_args(kind)
    if value is None:
        return None
    if origin in (Union, types.UnionType):
        return adapted(next(k for k in parts if k is not type(None)), value)
    if origin is Annotated:
        if Mark.RANGE in parts[1:] and isinstance(value, Real):
            value = (value, value)
        if Mark.PRESET_NAME in parts[1:]:  # It may be the path of a file, whose name is as it is.
            return value
        return adapted(parts[0], value)
    if origin is tuple and isinstance(value, list | tuple):
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        if len(kinds) != len(value):
            return value
        made = tuple(map(adapted, kinds, value))
        return value if isinstance(value, tuple) and all(map(is_, made, value)) else made
    if origin is Mapping and isinstance(value, Mapping):
        table = {key: adapted(parts[1], own) for key, own in value.items()}
        return value if all(map(is_, table.values(), value.values())) else table
    if isinstance(value, bool):
        return value
    if kind is str and isinstance(value, str):
        return composed(value)
    if kind is float and isinstance(value, Real):
        return float(value)
    if kind is int and isinstance(value, Integral):
        return int(value)
    return Path(value) if kind is Path and isinstance(value, str) else value


_TYPES: Mapping[Any, tuple[Any, str]] = {
    float: (float, "a number"),
    int: (int, "a whole number"),
    bool: (bool, "true or false"),
    str: (str, "a text"),
    Path: ((PurePath, InMemory), "a path"),
}


class Fault(NamedTuple):
    """What is wrong with a value, and what would have been accepted."""

    problem: str
    found: object
    expected: str


def fault(kind: Any, value: Any) -> Fault | None:
    """What is wrong with a value; None if it is of the right type and keeps its limits.

    Parameters
    ----------
    kind
        The annotation of the setting.
    value
        Its value; a list is a tuple.
    """
    origin = get_origin(kind)
    if origin in (Union, types.UnionType):
        if value is None:
            return None
        return fault(next(k for k in get_args(kind) if k is not type(None)), value)
    if origin is Annotated:
        inner, *notes = get_args(kind)
        wrong = fault(inner, value)
        for note in notes:
            wrong = wrong or (None if value is None else _against(note, value))
        return wrong
    if origin is Literal and value not in get_args(kind):
        return Fault("unknown choice", value, "one of " + ", ".join(map(repr, get_args(kind))))
    if origin is tuple:
        parts = get_args(kind)
        if not isinstance(value, tuple) or (parts[-1] is not Ellipsis and len(value) != len(parts)):
            many = "numbers" if parts[-1] is Ellipsis else f"{len(parts)} values"
            return Fault("cannot be used", value, f"a list of {many}")
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        wrongs = (fault(k, v) for k, v in zip(kinds, value, strict=False))
        return next((w for w in wrongs if w is not None), None)
    if origin is None and kind in _TYPES:
        known, expected = _TYPES[kind]
        if not isinstance(value, known) or (kind is int and isinstance(value, bool)):
            return Fault("cannot be used", value, expected)
        if kind is float and not math.isfinite(value):
            return Fault("cannot be used", value, "a finite number")
    return None


def _against(note: Any, value: Any) -> Fault | None:
    """Whether a value goes against one of the marks of its annotation."""
    if note is Mark.RANGE and value[0] > value[1]:
        return Fault("limits are reversed", value, "[low, high] with the lower number first")
    if isinstance(note, Interval):
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(_within(note, number) for number in numbers):
            kind = "numbers" if isinstance(value, tuple) else "a number"
            return Fault("is out of range", value, f"{kind} {limits_text(note)}")
    if isinstance(note, MinLen) and len(value) < note.min_length:
        what = "text that is not empty" if value == "" else f"list of at least {note.min_length}"
        return Fault("cannot be used", value, f"a {what}")
    if isinstance(note, MaxLen) and len(value) > note.max_length:
        return Fault("cannot be used", value, f"at most {note.max_length} characters")
    if note is Mark.PLAIN_NAME and (not value or re.search(r"[,;\r\n\t]", value)):
        expected = "a text without comma, semicolon or line break"
        return Fault("cannot be used as a name", value, expected)
    return None


def _within(limits: Interval, number: Any) -> bool:
    return not (
        (limits.ge is not None and number < limits.ge)
        or (limits.gt is not None and number <= limits.gt)
        or (limits.le is not None and number > limits.le)
        or (limits.lt is not None and number >= limits.lt)
    )


def interval(kind: Any) -> Interval | None:
    """The limits of a number, as its annotation declares them; None if it has none."""
    if isinstance(kind, Interval):
        return kind
    parts = (part for part in get_args(kind) if not isinstance(part, str))
    return next((found for found in map(interval, parts) if found is not None), None)


def highest(cls: type, key: str) -> float:
    """What a number of a section may be at most."""
    limits = interval(declared(cls)[key].kind)
    return math.inf if limits is None or limits.le is None else cast(float, limits.le)


def limits_text(limits: Interval) -> str:
    """Limits in words, as in ``above 0 and at most 10``."""
    text = f"above {limits.gt:g}" if limits.gt is not None else f"{limits.ge:g} or more"
    if limits.le is not None:
        text = f"{text} and at most {limits.le:g}"
    return f"{text} and below {limits.lt:g}" if limits.lt is not None else text


def is_file(kind: Any) -> bool:
    """Whether a setting names a file."""
    return kind is Path or any(is_file(k) for k in get_args(kind) if not isinstance(k, str))
