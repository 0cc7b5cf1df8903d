"""The words of maps, sheets and reports in English, German, French and Italian.

They are written in English where they arise, and translated where they leave the program: in files
of layers, the project with its sheets, figures and the report. The table ``data/words.csv`` holds
them. ``{}`` in an entry is any text (a number or a name) and ``{n}`` numbers only; the translation
gives them again in the same order. A text that is no entry is translated
part by part: sentences, parts between semicolons, colons or commas. What is in no entry stays as it
is: names that the user gave, sources of values.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib import resources
from typing import Literal, get_args

Language = Literal["en", "de", "fr", "it"]
LANGUAGES: tuple[Language, ...] = get_args(Language)

_LANGUAGE: ContextVar[Language] = ContextVar("language", default="en")
#: Where a text is cut if it is no entry, the first that is in it.
_JOINTS = ("\n", r"(?<=[.!?]) (?=[A-ZÄÖÜ])", "; ", ": ", ", ", r" \((?=.+\)$)")
#: Texts of numbers, signs and units only.
_NO_WORDS = re.compile(r"(?:[\W\d_]|kJ|kg|m[²³s/]|Hz|CHF|EUR|e|x|y|°|\b[a-zA-Zμηκ]\b)*")


@contextmanager
def speaking(language: Language) -> Iterator[None]:
    """Write all that leaves the program in a language."""
    before = _LANGUAGE.set(language)
    try:
        yield
    finally:
        _LANGUAGE.reset(before)


def spoken() -> Language:
    """The language in which the program writes now."""
    return _LANGUAGE.get()


def said(text: str) -> str:
    """A text in the language in which the program writes now."""
    language = _LANGUAGE.get()
    return text if language == "en" else _dictionary(language).say(text)


@cache
def word_table() -> tuple[dict[str, str], ...]:
    """The rows of the table."""
    text = resources.files("sassgis").joinpath("data", "words.csv").read_text(encoding="utf-8")
    return tuple(csv.DictReader(text.splitlines()))


@cache
def _dictionary(language: Language) -> Dictionary:
    return Dictionary(language)


def _form(entry: str) -> re.Pattern[str]:
    """What a text with numbers and names in it looks like."""
    number = "((?:[^A-Za-zÀ-ÿ]|e-)+?)"
    literal = re.escape(entry).replace(r"\{\}", "(.+?)")
    return re.compile(literal.replace(r"\{n\}", number))


class Dictionary:
    """Entries of one language.

    Attributes
    ----------
    missing : set of str
        Texts that were asked for and are in no entry.
    """

    def __init__(self, language: Language) -> None:
        rows = word_table()
        self._whole = {row["en"]: row[language] for row in rows if "{" not in row["en"]}
        # An entry with more text of its own is the better match.
        forms = sorted((row for row in rows if "{" in row["en"]), key=lambda r: -len(r["en"]))
        self._forms = [(_form(row["en"]), row[language].replace("{n}", "{}")) for row in forms]
        self._said: dict[str, str] = {}
        self.missing: set[str] = set()

    def say(self, text: str) -> str:
        """The text in this language; as it is where it is in no entry."""
        key = text.strip()
        if key not in self._said:
            found = self._found(key)
            # What was translated may be given again, as a part of a figure.
            self._said[found] = self._said[key] = found
        return text.replace(key, self._said[key]) if key else text

    def _found(self, text: str) -> str:
        if _NO_WORDS.fullmatch(text):
            return text
        entry = self._entry(text)
        if entry is not None:
            return entry
        for joint in _JOINTS:
            parts = re.split(f"({joint})", text)
            if len(parts) > 1:
                return "".join(
                    part if place % 2 else self.say(part) for place, part in enumerate(parts)
                )
        self.missing.add(text)
        return text

    def _entry(self, text: str) -> str | None:
        """An entry, whatever its first letter and whether it ends in a full stop."""
        for end in (".", ")", ""):
            bare = text.removesuffix(end)
            for start in dict.fromkeys((bare, bare[:1].lower() + bare[1:])):
                found = self._exact(start)
                if found is not None:
                    raised = found[:1].upper() + found[1:] if start != bare else found
                    return raised + (end if bare != text else "")
        return None

    def _exact(self, text: str) -> str | None:
        if text in self._whole:
            return self._whole[text]
        for form, words in self._forms:
            match = form.fullmatch(text)
            if match is not None:
                parts = [self.say(part) for part in match.groups()]
                return words.format(*parts)
        return None
