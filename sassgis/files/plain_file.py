"""Files of a user before what they say counts: plain ones, of a bounded size; text, TOML in them.

They may come from anyone: a path leads to a pipe that never ends, a few letters to values that are
nested ten thousand times, a name fills a map sheet.
"""

from __future__ import annotations

import math
import os
import re
import stat
import tomllib
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from sassgis.errors import InputError
from sassgis.files.atomic_output import is_text
from sassgis.settings.schema import InMemory, Input

#: Longest text of an input (characters): a name, a title, an attribute, a cell of a table, a key.
LONGEST_TEXT = 1000
#: Largest files (bytes): a CSV table, and TOML, which takes far longer to read.
_LARGEST_TABLE, _LARGEST_TOML = 200_000_000, 2_000_000
#: Tables and lists within each other.
_DEEPEST = 20
#: What no XML file can hold, and so no map sheet.
NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
#: More dots than that in a key: reading it takes the square of their number.
_LONG_KEY = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_DEEPEST}}}"""
)


def seen_from(folder: Path, file: Path) -> str:
    """Return a file as a configuration in a folder would name it: relative, with slashes."""
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # On another drive (Windows).
        return file.as_posix()


def check_file(file: Input, field: str | None, expected: str, folders: bool = False) -> None:
    """Raise InputError unless a path leads to a file, or to a folder where that is as good.

    A pipe or a device could be read for ever. The readers check inputs in memory.
    """
    wrong = partial(InputError, file=file, field=field)
    if isinstance(file, InMemory):
        return
    if not is_text(file):
        raise wrong("has a name or lies in a folder that is not UTF-8", expected="another")
    try:
        kind = file.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        raise wrong("file not found", expected=expected) from None
    except (OSError, ValueError) as error:
        found = getattr(error, "strerror", None) or str(error)
        raise wrong("cannot be opened", found=found, expected=expected) from None
    if not (stat.S_ISREG(kind) or (folders and stat.S_ISDIR(kind))):
        found = "a folder" if stat.S_ISDIR(kind) else "a pipe or a device"
        raise wrong("is no file", found=found, expected=expected)


def in_memory(given: InMemory, kind: str, field: str | None, expected: str) -> Any:
    """Return the data of an input in memory; InputError if it is of another kind."""
    if given.kind != kind:
        raise InputError(
            "cannot be used here", file=given, field=field, found=f"a {given.kind}",
            expected=expected,
        )  # fmt: skip
    return given.data


def read_text(file: Input, field: str | None, what: str, largest: int = _LARGEST_TABLE) -> str:
    """Return the text of a UTF-8 file; InputError if it is missing, too large or not text."""
    wrong = partial(InputError, file=file, field=field)
    if isinstance(file, InMemory):
        return str(in_memory(file, "table", field, what))
    check_file(file, field, what)
    if (size := file.stat().st_size) > largest:
        found, expected = f"{size / 1e6:.0f} MB", f"{what} of at most {largest / 1e6:.0f} MB"
        raise wrong("is too large", found=found, expected=expected)
    try:
        # utf-8-sig: spreadsheets put a mark in front of UTF-8.
        return file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise wrong("is not UTF-8 text", found=f"byte {error.start}", expected="UTF-8") from None
    except OSError as error:
        raise wrong("cannot be read", found=error.strerror) from None


def read_toml(file: Path, field: str | None, what: str) -> dict[str, Any]:
    """Return the document of a TOML file; errors are those of read_text and toml_table."""
    return toml_table(read_text(file, field, what, _LARGEST_TOML), file, what)


def toml_table(text: str, file: str | Input, what: str = "valid TOML") -> dict[str, Any]:
    """Return a TOML document."""
    try:
        if _LONG_KEY.search(text):
            raise RecursionError
        document = tomllib.loads(text)
    except RecursionError:
        raise _too_deep(file, None) from None
    except tomllib.TOMLDecodeError as error:
        if re.search("escape|hex", str(error), re.IGNORECASE):
            what = "valid TOML (in paths write / or \\\\ instead of a single \\)"
        raise InputError("is not valid TOML", file=file, found=error, expected=what) from None
    except ValueError:
        found = "a number of thousands of digits"
        raise InputError("is not valid TOML", file=file, found=found, expected=what) from None
    _check_values(document, file)
    return document


def _check_values(value: object, file: str | Input, place: str = "", depth: int = 0) -> None:
    """Raise InputError for texts, numbers and tables in a document that are beyond the limits."""
    check_text(value, file, place)
    if isinstance(value, int) and value.bit_length() > 63:
        raise InputError(
            "is too large", file=file, field=place,
            found=f"a whole number of {value.bit_length()} bits", expected="at most 63 bits",
        )  # fmt: skip
    if isinstance(value, dict | list):
        if depth > _DEEPEST:
            raise _too_deep(file, place)
        for key, own in value.items() if isinstance(value, dict) else (("", v) for v in value):
            check_text(key, file, place)
            _check_values(own, file, f"{place}.{key}".strip("."), depth + 1)


def _too_deep(file: str | Input, field: str | None) -> InputError:
    expected = f"tables and lists at most {_DEEPEST} within each other"
    return InputError("is nested too deeply", file=file, field=field, expected=expected)


def check_text(text: object, file: str | Input, field: str, where: str = "") -> None:
    """Raise InputError for a text that no map sheet can show; other values pass."""
    wrong = partial(InputError, file=file, field=field)
    if not isinstance(text, str):
        return
    where = f"{where}: " if where else ""
    if len(text) > LONGEST_TEXT:
        found = f"{len(text)} characters: {text[:20]!r}..."
        expected = f"at most {LONGEST_TEXT} characters"
        raise wrong(f"{where}text is too long", found=found, expected=expected)
    if odd := NO_XML.search(text):
        found, expected = ascii(odd[0]), "letters, digits, signs"
        problem = f"{where}holds a character that cannot be shown"
        raise wrong(problem, found=found, expected=expected)


def number(value: object, where: str, column: str, file: Input) -> float:
    """Return finite number in a cell; InputError with the row and the column otherwise."""
    with suppress(TypeError, ValueError):
        result = float(value)  # type: ignore[arg-type]
        if math.isfinite(result) and not isinstance(value, bool):
            return result
    expected = "a finite number, with a point for decimals"
    raise InputError(
        f"{where}: is not a number", file=file, field=column, found=repr(value), expected=expected
    )
