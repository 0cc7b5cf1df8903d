"""The language of maps, sheets, figures and reports: English, German, French and Italian.

Texts are written in English where they arise, and translated where they leave the program. Whole
sentences are the keys of the catalogues ``data/languages/*.po`` (gettext). A text with numbers or
names in it is a :class:`Phrase`, which keeps its key and its parts. What is in no catalogue stays
as it is: names that the user gave, sources of values.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import cache
from importlib import resources
from typing import Any, Literal, TypeVar, get_args

Language = Literal["en", "de", "fr", "it"]
LANGUAGES: tuple[Language, ...] = get_args(Language)

T = TypeVar("T")

_LANGUAGE: ContextVar[Language] = ContextVar("language", default="en")

#: An Italian article before a part; and before a number that is marked as a part and begins with a
#: vowel ("otto", "undici", "uno virgola ...") or is "zero ...".
_BEFORE_A_PART = re.compile(r"\b(?:[Ii]|[DdNn]e|[Ss]u|[Dd]a|[Aa])l (?=\{)")
_ARTICLE = re.compile(r"(\w+)l \0(?=(8|11(?!\d)|1(?:\.\d+)?\s%)|0(?!\d))")


class Phrase(str):
    """A text in English that can be translated: its key, and the parts in the places of ``{}``."""

    key: str
    parts: tuple[object, ...]
    named: Mapping[str, object]
    #: Of a counted text: the key for one, for several, and their number.
    forms: tuple[str, str, int] | None = None

    def __str__(self) -> str:
        # Figures and frames take str() of a text.
        return self


def phrase(key: str, *parts: object, **named: object) -> Phrase:
    """Return a text with parts; those that are phrases are translated too, others stay."""
    if isinstance(key, Phrase):
        return key
    text = Phrase(key.format(*parts, **named) if parts or named else key)
    text.key, text.parts, text.named = key, parts, named
    return text


def counted(n: int, one: str, several: str, *parts: object) -> Phrase:
    """Return the text for one or for several things; each language chooses by its plural rule."""
    text = phrase(one if n == 1 else several, *parts)
    text.forms = one, several, n
    return text


def like_phrase(text: T, others: Phrase) -> T:
    """Give a text of a class of phrases the key and parts of another one."""
    vars(text).update(vars(others))
    return text


def named(name: str) -> Phrase:
    """Return a name that the user gave: it stays, also where it is a word of the program."""
    return phrase("{}", name)


def in_english(text: str, others: Phrase) -> Phrase:
    """Return a text in English, and a phrase that represents it in the other languages."""
    return like_phrase(Phrase(text), others)


def joined(separator: str, parts: Iterable[object]) -> Phrase:
    """Return a phrase of parts one after the other."""
    members = list(parts)
    return phrase(separator.join(["{}"] * len(members)), *members)


class Capital(Phrase):
    """A phrase that begins with a capital letter, in every language."""


def capital(text: str) -> Phrase:
    """Return a text with its first letter as a capital."""
    plain = phrase(text)
    return like_phrase(Capital(plain[:1].upper() + plain[1:]), plain)


def all_of(parts: Iterable[str]) -> Phrase:
    """Return texts one after the other, with commas and "and" between them."""
    *before, last = list(map(phrase, parts)) or [phrase("")]
    return phrase("{} and {}", joined(", ", before), last) if before else last


@contextmanager
def in_language(language: Language) -> Iterator[None]:
    """Write all that leaves the program in a language."""
    before = _LANGUAGE.set(language)
    try:
        yield
    finally:
        _LANGUAGE.reset(before)


def current_language() -> Language:
    """Return the language in which the program writes."""
    return _LANGUAGE.get()


def translated(text: str) -> str:
    """Return a text in the language in which the program writes."""
    language = _LANGUAGE.get()
    if language == "en":
        return text

    def part(value: Any) -> Any:
        return translated(value) if isinstance(value, Phrase) else value

    catalogue = translations(language)
    key = text.key if isinstance(text, Phrase) else text
    if isinstance(text, Phrase) and text.forms:
        one, several, n = text.forms
        key = several if (n > 1 if "plural=(n > 1)" in catalogue[""] else n != 1) else one
    if key and not key.strip("{}; "):
        # A list of parts.
        key = key.replace("; ", catalogue["; "])
    key = catalogue.get(key, key) if key else key
    if not isinstance(text, Phrase):
        return key
    if text.parts or text.named:
        named = {name: part(value) for name, value in text.named.items()}
        filled = _italian if language == "it" else str.format
        key = filled(key, *map(part, text.parts), **named)
    return key[:1].upper() + key[1:] if isinstance(text, Capital) else key


def _italian(text: str, *parts: object, **named: object) -> str:
    """Fill in parts; articles follow the spoken numbers after them: l'8 %, dell'11 %, lo 0.4 %."""

    def article(match: re.Match[str]) -> str:
        stem = {"i": "l", "I": "L"}.get(match[1], match[1] + "ll")
        return stem + ("'" if match[2] else "o ")

    # Only articles of the text itself, not those in names.
    marked = _BEFORE_A_PART.sub("\\g<0>\0", text).format(*parts, **named)
    return _ARTICLE.sub(article, marked).replace("\0", "")


def with_translated(thing: T, *names: str) -> T:
    """Return a frozen dataclass with some of its texts, or tuples of texts, translated."""
    own: Any = thing
    changed: T = replace(own, **{name: _each(getattr(own, name)) for name in names})
    return changed


def _each(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_each, value))
    return translated(value) if isinstance(value, str) else value


@cache
def translations(language: Language) -> dict[str, str]:
    """Return the catalogue of a language, a ``.po`` file: texts in English, and the same in it."""
    file = resources.files("sassgis").joinpath("data", "languages", f"{language}.po")
    entries: dict[str, str] = {}
    for entry in file.read_text(encoding="utf-8").split("\n\n"):
        texts: dict[str, str] = defaultdict(str)
        name = ""
        for line in entry.splitlines():
            if line.startswith("msg"):
                name, _, line = line.partition(" ")
            if line.startswith('"'):
                texts[name] += json.loads(line)
        entries[texts["msgid"]] = texts["msgstr"] or texts["msgstr[0]"]
        if "msgid_plural" in texts:
            entries[texts["msgid_plural"]] = texts["msgstr[1]"]
    return entries
