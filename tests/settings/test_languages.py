from __future__ import annotations

import ast
import csv
import pickle
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from string import Formatter

import pytest

from sassgis.settings.languages import (
    LANGUAGES,
    Language,
    all_of,
    counted,
    current_language,
    in_language,
    joined,
    named,
    phrase,
    translated,
    translations,
)

PACKAGE = Path(str(resources.files("sassgis")))


def texts() -> Iterator[str]:
    """All texts of the package: constants of its code, cells and values of its data."""
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value
                # Heads of tables: "name | unit; name | unit".
                yield from (part.strip() for part in re.split(r"[;|]", node.value))
    for file in (PACKAGE / "data").glob("*.csv"):
        for row in csv.reader(file.read_text(encoding="utf-8").splitlines()):
            yield from row
    for file in (PACKAGE / "data").glob("*.j2"):
        page = file.read_text(encoding="utf-8")
        yield from re.findall(r"(?:translated|words)\([\"'](.*?)[\"'][,)]", page)
    for file in (PACKAGE / "data").rglob("*.toml"):
        yield from words_in(tomllib.loads(file.read_text(encoding="utf-8")))


def words_in(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from words_in(part)


def fields(text: str) -> Counter[tuple[str | None, str | None]]:
    return Counter((name, spec) for _, name, spec, _ in Formatter().parse(text) if name is not None)


def test_all_languages_have_the_same_texts_of_the_program_with_the_same_parts() -> None:
    catalogues = {name: translations(name) for name in LANGUAGES if name != "en"}
    keys = set(catalogues["de"])
    assert len(keys) > 400 and keys <= {"", *texts()}
    for name, entries in catalogues.items():
        assert set(entries) == keys, name
        assert f"Language: {name}\n" in entries[""]
        for key, text in entries.items():
            assert text.strip() and fields(text) == fields(key), (name, key)


def test_no_phrase_is_missing() -> None:
    known = set(translations("de"))
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(ast.Name("phrase"), [ast.Constant(str(text)), *_]):
                    texts = [text]
                case ast.Call(
                    ast.Name("counted"), [_, ast.Constant(str(one)), ast.Constant(str(more)), *_]
                ):
                    texts = [one, more]
                case _:
                    continue
            for text in texts:
                words = re.findall(r"[a-z]{2,}", re.sub(r"{.*?}", "", text))
                assert text in known or not words, (file, text)


def test_columns_and_layers_of_a_result_are_named_in_all_languages() -> None:
    known = set(translations("de"))
    # The pages of a diagnosis, with the rocks that were observed, are in English only.
    english = re.compile(r"gap_\w+|impacts|stand|\w+\.observed")
    with (PACKAGE / "data" / "map_layers.csv").open(encoding="utf-8") as stream:
        rows = [
            row for row in csv.DictReader(stream)
            if not all(english.fullmatch(layer) for layer in row["layer"].split())
        ]  # fmt: skip
    names = {row["alias"] for row in rows}
    model = tomllib.loads((PACKAGE / "data" / "federal_model.toml").read_text(encoding="utf-8"))
    names |= {kind["title"] for kind in model["classes"].values()}
    assert {n for n in names if re.search("[a-z]{2}", n)} <= known


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Hazard zones", "Gefahrenzonen"),
        (phrase("Reference width {} m.", "10"), "Bezugsbreite 10 m."),
        # A part that is no phrase is a name, even where it is the name of something.
        (phrase("No block reaches: {}.", "net"), "Kein Block erreicht: net."),
        (phrase("Arriving blocks: {}", phrase("net")), "Ankommende Blöcke: Netz"),
        (joined("; ", (phrase("station"), phrase("net"), "A")), "Station; Netz; A"),
        # Parts by name, one of them a phrase.
        (
            phrase("Number of blocks that reach the cell. {width}",
                   width=phrase("Width {} m (one cell).", "2")),
            "Zahl der Blöcke, die die Zelle erreichen. Breite 2 m (eine Zelle).",
        ),
        # Braces of a user are no places for parts.
        (phrase("a {name}"), "a {name}"),
        ("", ""),
    ],
)  # fmt: skip
def test_texts_in_german(text: str, words: str) -> None:
    english = str(text)
    with in_language("de"):
        assert translated(text) == words
        # What was translated stays as it is when it is given again.
        assert translated(words) == words
        assert translated(pickle.loads(pickle.dumps(text))) == words
    assert translated(text) == english


@pytest.mark.parametrize(
    ("n", "language", "words"),
    [(1, "en", "1 block of 9"), (0, "en", "0 of 9 blocks"), (0, "de", "0 von 9 Blöcken"),
     (1, "de", "1 Block von 9"), (0, "fr", "0 bloc sur 9"), (2, "fr", "2 blocs sur 9"),
     (1, "it", "1 blocco su 9"), (0, "it", "0 blocchi su 9")],
)  # fmt: skip
def test_each_language_counts_by_its_plural_rule(n: int, language: Language, words: str) -> None:
    text = counted(n, "{} block of {}", "{} of {} blocks", n, 9)
    with in_language(language):
        assert translated(pickle.loads(pickle.dumps(text))) == words


@pytest.mark.parametrize(
    ("number", "words"),
    [("8", "l'8 %"), ("85", "l'85 %"), ("11", "l'11 %"), ("110", "il 110 %"), ("1.3", "l'1.3 %"),
     ("0.4", "lo 0.4 %"), ("12", "il 12 %")],
)  # fmt: skip
def test_italian_articles_follow_the_spoken_number(number: str, words: str) -> None:
    with in_language("it"):
        text = translated(phrase("{} % of the blocks", number))
        name = translated(phrase("{} % of the blocks", named("Via al 8, dal 05.03.")))
    assert text == f"{words[0].upper()}{words[1:]} dei blocchi"
    assert "Via al 8, dal 05.03." in name


def test_parts_of_a_list_are_separated_as_the_language_does() -> None:
    with in_language("fr"):
        assert translated(joined("; ", ("A", phrase("net")))) == "A\u00a0; filet"


def test_the_language_ends_with_its_block() -> None:
    with pytest.raises(RuntimeError), in_language("it"):
        assert translated("Maps") == "Carte"
        # A name is no word.
        assert translated("net") != translated(named("net")) == "net"
        raise RuntimeError
    assert current_language() == "en" and translated("Maps") == "Maps"


def test_the_last_of_several_texts_follows_and() -> None:
    with in_language("de"):
        said = [translated(all_of(own)) for own in (["wall"], ["a", "b"], ["a", "b", "c"])]
    assert said == ["Damm", "a und b", "a, b und c"]
