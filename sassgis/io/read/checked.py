"""From declared settings to checked ones: pydantic reads a table, and says what is wrong in it."""

from __future__ import annotations

import dataclasses
import os
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, Required, TypeVar, get_args, get_origin

from annotated_types import Interval, MinLen
from pydantic import (
    AfterValidator,
    AllowInfNan,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    Strict,
    ValidationError,
    ValidationInfo,
    WrapValidator,
)
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import CoreSchema, PydanticCustomError
from typing_extensions import TypedDict

from sassgis.model.declared import Declared, Fault, Mark, declared, fault
from sassgis.model.errors import ConfigError, InputError
from sassgis.model.in_memory import InMemory, Input

# The keys are known at run time only, which type checkers do not follow.
new_table: Any = TypedDict

# ---------------------------------------------------------------------------------------------
# Tables


def table_of(
    name: str, fields: Mapping[str, Any], made: Callable[[dict[str, Any]], Any], meaning: str
) -> Any:
    """A type for pydantic: a table with these keys and no others, made into something.

    It is ``made`` from the values, without keys that were not given and with ``config_file``; what
    that raises as ConfigError is reported at the place of the table. The name is for pydantic's own
    messages, the meaning for editors.
    """
    table: Any = new_table(name, dict(fields))
    table.__pydantic_config__ = ConfigDict(extra="forbid")
    table.__doc__ = meaning

    def make(values: dict[str, Any], info: ValidationInfo) -> Any:
        try:
            return made({**values, "config_file": (info.context or {}).get("file")})
        except ConfigError as error:
            raise _refused(error.problem, error.expected, error.field, error.found) from None

    return Annotated[table, AfterValidator(make)]


def section_type(cls: Any) -> Any:
    """The type of a section that is one dataclass of declared settings."""
    fields = declared_fields(declared(cls))
    return table_of(cls.__name__, fields, partial(made_of, cls), first_line(cls))


def declared_fields(keys: Mapping[str, Declared]) -> dict[str, Any]:
    """The fields of a table with declared keys."""
    return {
        key: Required[_field(own)] if own.is_required else NotRequired[_field(own)]
        for key, own in keys.items()
    }


def made_of(cls: Any, values: Mapping[str, Any]) -> Any:
    """A dataclass of those values that it has a field for."""
    names = {field.name for field in dataclasses.fields(cls)}
    return cls(**{key: value for key, value in values.items() if key in names})


def first_line(cls: Any) -> str:
    """What a section is about: the first line of the docstring of its type."""
    return (cls.__doc__ or "").splitlines()[0]


# ---------------------------------------------------------------------------------------------
# Values


def _refused(
    problem: str, expected: str | None, key: str | None = None, found: object = None
) -> Exception:
    """An error that pydantic carries to the place where it is reported in one line."""
    context: dict[str, Any] = {"problem": problem, "expected": expected, "key": key or ""}
    if found is not None:
        context["found"] = str(found)
    return PydanticCustomError("sassgis", "{problem}", context)


def _field(own: Declared) -> Any:
    default = {} if own.default in (dataclasses.MISSING, None) else {"default": own.default}
    meaning = Field(description=own.description, json_schema_extra=default)
    return Annotated[_keeping_limits(_accepted(own.kind), own.kind), meaning]


def _keeping_limits(accepted: Any, kind: Any) -> Any:
    """A type whose values are held against the limits of their declaration."""

    def keep(value: Any) -> Any:
        wrong: Fault | None = fault(kind, value)
        if wrong is not None:
            # What was found is stated as the user wrote it, unless it is one of several.
            one = list(wrong.found) if isinstance(wrong.found, tuple) else wrong.found
            found = None if wrong.found is value else repr(one)
            raise _refused(wrong.problem, wrong.expected, found=found)
        return value

    return Annotated[accepted, AfterValidator(keep)]


_PLAIN: dict[Any, Any] = {
    float: Annotated[float, Strict(), AllowInfNan(False)],
    int: Annotated[int, Strict()],
    bool: Annotated[bool, Strict()],
    str: str,
}


def _accepted(kind: Any) -> Any:
    """The pydantic type of an annotation: what the user may write for it."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (typing.Union, types.UnionType):
        accepted = _accepted(next(p for p in parts if p is not type(None)))
        return accepted | None if type(None) in parts else accepted
    if origin is Literal:
        return kind
    if origin is tuple:
        return tuple[tuple(p if p is Ellipsis else _accepted(p) for p in parts)]  # type: ignore[misc]
    if origin is not None and origin is not Annotated:
        return dict[int, _keeping_limits(_accepted(parts[1]), parts[1])]  # type: ignore[misc]
    if kind is Path:
        return Annotated[Path, WrapValidator(_in_memory), AfterValidator(_anchored)]
    if origin is not Annotated:
        return _PLAIN[kind]
    accepted = _accepted(parts[0])
    for note in parts[1:]:
        if note is Mark.RANGE:
            either = _InSchema(lambda pair: {"anyOf": [{"type": "number"}, pair]})
            accepted = Annotated[accepted, BeforeValidator(_pair), either]
        elif isinstance(note, Interval):
            accepted = Annotated[accepted, _InSchema(partial(_within, limits=note))]
        elif isinstance(note, MinLen):
            accepted = Annotated[accepted, Field(min_length=note.min_length)]
        elif isinstance(note, Mark) and note in _MARKS:
            accepted = Annotated[accepted, _MARKS[note]]
    return accepted


def _pair(value: object) -> object:
    """A single number means two equal limits."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value)
    if value is not None and (not isinstance(value, (list, tuple)) or len(value) != 2):
        raise _refused("is not a range", "a number, or two numbers [low, high]")
    return value


def _in_memory(value: object, otherwise: Callable[[object], Path]) -> Input:
    """What is in memory stays as it is; all else is a path."""
    return value if isinstance(value, InMemory) else otherwise(value)


def _anchored(value: Input, info: ValidationInfo) -> Input:
    """Paths are relative to the configuration file."""
    if isinstance(value, InMemory):
        return value
    if str(value) in ("", "."):
        raise _refused("is empty", "the path of a file", found="''")
    base = (info.context or {}).get("base", Path())
    path = Path(base, os.path.expanduser(value))
    try:
        path.exists()
    except OSError as error:  # the name is too long, or a folder on the way is closed
        raise _refused("cannot be opened", "the path of a file", found=error.strerror) from None
    return path


def _preset(value: object, info: ValidationInfo) -> object:
    """A name of a built-in preset stays as it is; a file is relative to the configuration."""
    if isinstance(value, str) and is_preset_file(value):
        return str(_anchored(Path(value), info))
    return value


def is_preset_file(preset: str) -> bool:
    """Whether a preset is a file of the user, and not the name of a built-in one."""
    return preset.endswith(".toml") or "/" in preset


def _codes(value: object) -> object:
    """TOML keys are text; raster codes are whole numbers."""
    expected = 'codes and class names, as in {1 = "rock"}'
    if not isinstance(value, Mapping):
        raise _refused("is not a table of codes", expected)
    try:
        return {int(str(code)): name for code, name in value.items()}
    except ValueError:
        raise _refused("has a code that is no whole number", expected) from None


#: What is done with values that have one of these marks.
_MARKS: Mapping[Mark, Any] = {
    Mark.PLAIN_NAME: AfterValidator(str.strip),
    Mark.PRESET_NAME: BeforeValidator(_preset),
    Mark.CODES: BeforeValidator(_codes),
}


# ---------------------------------------------------------------------------------------------
# What editors know of it

JsonSchema = dict[str, Any]


class ForToml(GenerateJsonSchema):
    """A JSON Schema of TOML files, which have no null."""

    def nullable_schema(self, schema: Any) -> JsonSchema:
        """Describe a value that need not be given."""
        return self.generate_inner(schema["schema"])

    def field_title_should_be_set(self, schema: Any) -> bool:
        """Leave titles out: keys are names enough."""
        return False


@dataclasses.dataclass(frozen=True, slots=True)
class _InSchema:
    """Changes what the schema says of a type, and not what is accepted."""

    change: Callable[[JsonSchema], JsonSchema]

    def __get_pydantic_json_schema__(
        self, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchema:
        return self.change(handler(core))


def _within(schema: Any, limits: Interval) -> Any:
    """The same with limits for each number in it."""
    if isinstance(schema, list):
        return [_within(part, limits) for part in schema]
    if not isinstance(schema, dict):
        return schema
    out = {key: _within(part, limits) for key, part in schema.items()}
    if out.get("type") in ("number", "integer"):
        lowest = {"minimum": limits.ge, "exclusiveMinimum": limits.gt}
        given = {**lowest, "maximum": limits.le, "exclusiveMaximum": limits.lt}
        out |= {key: value for key, value in given.items() if value is not None}
    return out


# ---------------------------------------------------------------------------------------------
# From what pydantic finds to one line

Place = tuple[int | str, ...]
Wrong = TypeVar("Wrong", bound=InputError)

#: What pydantic would have accepted, by the kind of its error.
EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "path_type": "a path in quotes",
    "tuple_type": "a list in [ ]",
    "list_type": "a list in [ ]",
    "string_too_short": "a text that is not empty",
}


@dataclasses.dataclass(frozen=True, slots=True)
class Messages:
    """Turns what pydantic finds in a file into errors of one line each."""

    file: object
    document: Mapping[str, Any]  # the file as it was read, for the names of blocks and stations
    lists: tuple[str, ...]  # sections that are written with double brackets
    meaning: Callable[[Place], str | None]  # of a key at a place; None where no key is
    nearest: Callable[[Place], str]  # what an unknown key at a place was probably meant to be
    named_by: str = "name"  # key by which a section with double brackets is called
    #: From a place and the kind of pydantic's error to what would have been accepted, where the
    #: file has words of its own for it.
    expected: Callable[[Place, str], str | None] = lambda _loc, _kind: None

    def of(self, error: ValidationError) -> list[ConfigError]:
        """All that is wrong."""
        return [self._one_line(dict(e)) for e in error.errors()]

    def _one_line(self, e: dict[str, Any]) -> ConfigError:
        wrong = partial(ConfigError, file=self.file)
        loc, kind, context = e["loc"], e["type"], e.get("ctx", {})
        field = self._dotted(loc)
        if kind == "extra_forbidden":
            return wrong("unknown key", field=field, expected=self.nearest(loc))
        if kind == "missing":
            text = self.meaning(loc)
            problem = "is too short" if text is None else "missing key"
            return wrong(problem, field=field, expected=text or "two numbers [x, y]")
        found: object = context["found"] if "found" in context else in_short(e["input"])
        if kind == "sassgis":
            if context["key"]:
                field = f"{field}.{context['key']}"
                found = context.get("found")
            return wrong(context["problem"], field=field, found=found, expected=context["expected"])
        expected = self.expected(loc, kind) or self._expected(loc, kind, context, e["msg"])
        return wrong("cannot be used", field=field, found=found, expected=expected)

    def _expected(self, loc: Place, kind: str, context: Mapping[str, Any], message: str) -> str:
        section = str(loc[0])
        if kind == "dict_type":
            if section in self.lists:
                return f"[[{section}]]"
            return f"a section [{'.'.join(map(str, loc))}]"
        if kind == "tuple_type" and len(loc) == 1:
            return f"one or more sections [[{section}]], with double brackets"
        if kind == "literal_error":
            return f"one of {context['expected']}"
        if kind == "too_short":
            return f"a list of at least {context['min_length']}"
        if kind == "too_long":
            return f"{context['max_length']} numbers"
        return EXPECTED.get(kind, message)

    def _dotted(self, loc: Place) -> str:
        """Key as the user would look for it: ``blocks[large].axis_1_m``."""
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


def in_short(value: object) -> str:
    """A value as messages repeat it."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def first_of(problems: Sequence[Wrong]) -> Wrong:
    """The error that says most; it tells how many more there are."""
    # A misspelt key shows up twice, as unknown and as missing: the first says more.
    first = min(problems, key=lambda p: p.problem != "unknown key")
    if len(problems) > 1:
        first.args = (f"{first} (and {len(problems) - 1} more)",)
    return first
