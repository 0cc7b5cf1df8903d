"""How settings are declared: kind, limits and meaning stand in the annotation of a field, once.

``smoothing_m: Annotated[float, Interval(ge=0, le=200), "scale of the terrain (m)"] = 5.0`` is all
that checks, messages, the template and the documentation need. The checks are pydantic's.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import re
import types
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from numbers import Real
from os import PathLike
from pathlib import Path, PurePath
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
import pydantic
from annotated_types import Interval, MinLen
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PlainValidator,
    Strict,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
)
from pydantic_core import ErrorDetails, PydanticCustomError, core_schema

from sassgis.errors import ConfigError, InputError


@dataclass(frozen=True, slots=True)
class InMemory:
    """A raster, a vector layer or a table in place of a file."""

    name: str  # what messages and reports call it
    kind: Literal["raster", "layer", "table"]
    digest: str  # SHA-256 of its content: equal inputs are equal settings
    # What its reader takes: the bytes of a GeoTIFF, a GeoDataFrame, or the text of a CSV table.
    data: Any = dataclasses.field(compare=False, repr=False)

    #: As of a path, for what only asks for a name.
    suffix = ""

    def __str__(self) -> str:
        return self.name

    @property
    def stem(self) -> str:
        """Its name, as that of a file without suffix."""
        return self.name

    def is_dir(self) -> bool:
        """Return False: it is no folder."""
        return False


#: What a setting may name.
Input = Path | InMemory
#: What a caller may give for it.
AnyInput = str | PathLike[str] | InMemory


def named(given: AnyInput) -> Input:
    """Return a path, or what is in memory as it is."""
    return given if isinstance(given, InMemory) else Path(given)


#: What holds for all settings: a text is no number, and a number is finite.
RULES = ConfigDict(strict=True, allow_inf_nan=False, extra="forbid")


@dataclass(frozen=True, slots=True)
class Renamed:
    """The key that a setting had before; it is still read, with a note."""

    old: str


@dataclass(frozen=True, slots=True)
class Example:
    """Example of a setting in the template; ``needed`` if it stands there without a comment."""

    value: object
    needed: bool = False


def refused(
    problem: str, expected: str | None = None, field: str | None = None, found: object = None
) -> PydanticCustomError:
    """Return an error that pydantic carries to the place where it is reported in one line."""
    parts = {"problem": problem, "expected": expected, "field": field, "found": found}
    return PydanticCustomError("sassgis", "{problem}", parts)


def refusal(error: InputError) -> PydanticCustomError:
    """Return an error of several settings together, as pydantic carries it."""
    return refused(error.problem, error.expected, error.field, error.found)


def composed(text: str) -> str:
    """Return a name in the one Unicode form (NFC) in which all are compared: ö, not o and dots."""
    return text if unicodedata.is_normalized("NFC", text) else unicodedata.normalize("NFC", text)


class _Range:
    """A pair of numbers is a range [low, high]; a single number means two equal limits."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        made = core_schema.no_info_before_validator_function(self._pair, handler(source))
        return core_schema.no_info_after_validator_function(self._ordered, made)

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        pair = handler(core)
        return {"anyOf": [pair["prefixItems"][0], pair]}

    @staticmethod
    def _pair(value: Any) -> Any:
        if not isinstance(value, bool) and isinstance(value, Real):
            return (value, value)
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise refused("is not a range", "a number, or two numbers [low, high]")
        return tuple(value)

    @staticmethod
    def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
        if pair[0] > pair[1]:
            raise refused("limits are reversed", "[low, high] with the lower number first")
        return pair


def _plain_name(text: str) -> str:
    name = composed(text.strip())
    if not name or re.search(r"[,;\r\n\t]", name):
        raise refused("cannot be used as a name", "a text without comma, semicolon or line break")
    return name


def _file(value: Any, info: ValidationInfo) -> Path:
    """Resolve paths relative to the configuration file; those of a program stay as they are."""
    if not isinstance(value, str | PurePath):
        raise refused("cannot be used", "a path in quotes")
    if info.context is None:
        return Path(value)
    if str(value) in ("", "."):
        raise refused("is empty", "the path of a file", found="''")
    path = Path(info.context["base"], os.path.expanduser(value))
    try:
        path.exists()
    except OSError as error:  # the name is too long, or a folder on the way is closed
        raise refused("cannot be opened", "the path of a file", found=error.strerror) from None
    return path


def _input(value: Any, info: ValidationInfo) -> Path | InMemory:
    return value if isinstance(value, InMemory) else _file(value, info)


def is_preset_file(preset: str) -> bool:
    """Return whether a preset is a file of the user, and not the name of a built-in one."""
    return preset.endswith(".toml") or "/" in preset


def _preset(value: str, info: ValidationInfo) -> str:
    return str(_file(value, info)) if is_preset_file(value) else value


def _codes(value: Any) -> Any:
    """Turn TOML keys, which are text, into raster codes, which are whole numbers."""
    expected = 'codes and class names, as in {1 = "rock"}'
    if not isinstance(value, Mapping):
        raise refused("is not a table of codes", expected)
    try:
        return {int(str(code)): name for code, name in value.items()}
    except ValueError:
        raise refused("has a code that is no whole number", expected) from None


def _from_context(value: Any, info: ValidationInfo) -> Any:
    if info.context is None:
        return value
    if value is not None:
        raise refused("unknown key")
    return info.context["file"]


Number = TypeVar("Number")
Item = TypeVar("Item")

Span = Annotated[tuple[Number, Number], _Range()]
Several = Annotated[tuple[Item, ...], Strict(False)]
Text = Annotated[str, MinLen(1), AfterValidator(composed)]
#: The name of a thing: no comma, semicolon or line break.
Name = Annotated[str, AfterValidator(_plain_name)]
#: The attribute with a setting of single features, as value_field: value.
FieldName = Annotated[Text | None, "attribute of single features"]
#: The name of a built-in preset, or a TOML file.
Preset = Annotated[str, MinLen(1), AfterValidator(_preset)]
File = Annotated[Path, PlainValidator(_file), WithJsonSchema({"type": "string"})]
#: A file, or what a program holds in memory.
InputFile = Annotated[Path | InMemory, PlainValidator(_input), WithJsonSchema({"type": "string"})]
Codes = Annotated[dict[int, Name], BeforeValidator(_codes)]
#: The configuration in which a section stands, for messages; it is no key.
ConfigFile = Annotated[Path | None, Field(validate_default=True), PlainValidator(_from_context)]


if TYPE_CHECKING:
    from dataclasses import dataclass as checked

    __all__ = ["checked"]
else:

    def checked(*, frozen, slots):
        """Make a dataclass that is checked when it is made: what cannot be used is a ConfigError.

        A program may give a single number for a range, a list for a tuple and a text for a path.
        """

        def made_of(cls):
            made = pydantic.dataclasses.dataclass(frozen=frozen, slots=slots, config=RULES)(cls)
            inner, names = made.__init__, tuple(f.name for f in dataclasses.fields(made))

            @functools.wraps(inner)
            def init(self, *given, **by_name):
                by_name |= zip(names[: len(given)], given, strict=True)
                plain = {
                    k: v.item() if isinstance(v, np.generic) else v for k, v in by_name.items()
                }
                try:
                    inner(self, **plain)
                except ValidationError as error:
                    wrong = error.errors()[0]
                    key = str(wrong["loc"][0]) if wrong["loc"] else ""
                    parts = explained(wrong, declared(made).get(key))
                    inner_key = parts.pop("field")
                    raise ConfigError(**parts, field=inner_key or key or None) from None

            made.__init__ = init
            return made

        return made_of


class Section:
    """What all settings share: they are checked when they are made, and do not change."""

    __slots__ = ()
    if TYPE_CHECKING:
        __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        made = handler(source)
        # A table makes a section as well.
        cast(Any, handler.resolve_ref_schema(made))["strict"] = False
        return made

    def __post_init__(self) -> None:
        try:
            self._fits_together()
        except InputError as error:
            raise refusal(error) from None

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


def _declared(cls: Any) -> Mapping[str, Declared]:
    """Find what is declared."""
    hints = get_type_hints(cls, include_extras=True)
    found: dict[str, Declared] = {}
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        notes = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
        if hint == FieldName:
            key = field.name.removesuffix("_field")
            notes = (f"attribute with {key}", Example(key))
        text = next((n for n in notes if isinstance(n, str)), None)
        if text is not None:
            old = next((n.old for n in notes if isinstance(n, Renamed)), None)
            example = next((n for n in notes if isinstance(n, Example)), None)
            found[field.name] = Declared(field.name, hint, field.default, text, old, example)
    return types.MappingProxyType(found)


#: Settings of a section by key, in order; fields without a description are none.
declared: Callable[[Any], Mapping[str, Declared]] = cache(_declared)


def interval(kind: Any) -> Interval | None:
    """Return the limits of a number, as its annotation declares them; None if it has none."""
    if isinstance(kind, Interval):
        return kind
    parts = (part for part in get_args(kind) if not isinstance(part, str))
    return next((found for found in map(interval, parts) if found is not None), None)


def highest(cls: type, key: str) -> float:
    """Return the highest value of a number of a section."""
    limits = interval(declared(cls)[key].kind)
    return math.inf if limits is None or limits.le is None else cast(float, limits.le)


def limits_text(limits: Interval) -> str:
    """Return limits in words, as in ``above 0 and at most 10``."""
    text = f"above {limits.gt:g}" if limits.gt is not None else f"{limits.ge:g} or more"
    if limits.le is not None:
        text = f"{text} and at most {limits.le:g}"
    return f"{text} and below {limits.lt:g}" if limits.lt is not None else text


def is_file(kind: Any) -> bool:
    """Return whether a setting names a file."""
    return kind is Path or any(is_file(k) for k in get_args(kind) if not isinstance(k, str))


#: What would have been accepted, by the kind of pydantic's error.
_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "tuple_type": "a list in [ ]",
    "list_type": "a list in [ ]",
    "string_too_short": "a text that is not empty",
    "string_too_long": "at most {max_length} characters",
    "literal_error": "one of {expected}",
    "too_short": "a list of at least {min_length} entries",
    "too_long": "{max_length} numbers",
}
_LIMITS = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")


def explained(error: ErrorDetails, own: Declared | None) -> dict[str, Any]:
    """Explain why a value is refused: problem, field within it, found and expected."""
    kind, context, loc = error["type"], error.get("ctx", {}), error["loc"]
    found: object = in_short(error["input"])
    if kind == "sassgis":
        stated = context["found"] is not None or context["field"]
        return {**context, "found": context["found"] if stated else found}
    problem: str = "cannot be used"
    expected: str | None = error["msg"]
    if kind in _EXPECTED:
        expected = _EXPECTED[kind].format_map(context)
    if kind in ("missing", "missing_argument"):
        problem, found = "missing key", None
        expected = None if own is None else own.description
        if isinstance(loc[-1], int) and len(loc) > 1:
            problem, expected = "is too short", "two numbers [x, y]"
    elif kind in ("extra_forbidden", "unexpected_keyword_argument"):
        problem, found, expected = "unknown key", None, None
    elif kind == "literal_error":
        problem = "unknown choice"
    elif kind in _LIMITS:
        limits = None if own is None else interval(own.kind)
        problem = "is out of range"
        expected = error["msg"] if limits is None else f"a number {limits_text(limits)}"
    return {"problem": problem, "field": None, "found": found, "expected": expected}


def in_short(value: object) -> str:
    """Return a value as messages repeat it."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
