from __future__ import annotations

import re
from collections import Counter

import pytest

from sassgis.model.languages import LANGUAGES, Dictionary, said, speaking, spoken, word_table


def test_every_word_is_there_in_every_language_with_its_source() -> None:
    rows = word_table()
    assert len(rows) > 300
    assert [en for en, n in Counter(row["en"] for row in rows).items() if n > 1] == []
    for row in rows:
        signs = Counter(re.findall(r"\{.*?\}", row["en"]))
        assert set(signs) <= {"{}", "{n}"}
        for language in (*LANGUAGES, "source"):
            assert row[language].strip(), f"{row['en']}: nothing in {language}"
        for language in LANGUAGES:
            assert Counter(re.findall(r"\{.*?\}", row[language])) == signs, row["en"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Hazard zones", "Gefahrenzonen"),
        ("Reference width 10 m.", "Bezugsbreite 10 m."),
        # A name keeps its place and is not translated.
        ("No block reaches: net A.", "Kein Block erreicht: net A."),
        # What is no entry is translated part by part.
        (
            "blue dashes: station; green dots: net",
            "blau gestrichelt: Station; grün gepunktet: Netz",
        ),
        ("Blue dashes: station", "Blau gestrichelt: Station"),
        ("Risk: loss. At road B", "Risiko: Schaden. Bei road B"),
        ("1e-4 to 1e-3 per year", "1e-4 bis 1e-3 pro Jahr"),
        # Not a span of numbers.
        ("sent to Chur", "sent to Chur"),
        ("12 kJ", "12 kJ"),
        ("", ""),
    ],
)
def test_texts_in_german(text: str, words: str) -> None:
    with speaking("de"):
        assert said(text) == words
        # What was translated stays as it is when it is given again.
        assert said(words) == words


def test_the_language_ends_with_its_block() -> None:
    with pytest.raises(RuntimeError), speaking("it"):
        assert said("Maps") == "Carte"
        raise RuntimeError
    assert spoken() == "en" and said("Maps") == "Maps"


def test_what_is_in_no_entry_is_noted() -> None:
    dictionary = Dictionary("fr")
    assert dictionary.say("Maps; Oberwald") == "Cartes; Oberwald"
    assert dictionary.missing == {"Oberwald"}
