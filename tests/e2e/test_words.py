"""The word table of CONTRIBUTING holds in the package: names, docstrings, comments, texts."""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path

import pytest

pytestmark = pytest.mark.e2e

#: Words of the table that have another meaning as well, in plain English or in a file format.
OTHER_MEANINGS = {
    "aside", "alone", "bare", "bench", "bounce back", "caution", "course", "family", "follow",
    "hit (for the ground)", "how or why rocks end", "intensity mean", "judge", "learned on",
    "left out", "library", "made up", "mean", "piece", "position along", "reading", "round",
    "says", "sealed", "set in motion", "sideways ways", "slight", "substantial", "touch", "trip",
    "tuned", "untuned", "way", "what became of it", "number of a campaign",
    "what another seed would change", "what one rock stands for", "told apart",
}  # fmt: skip
WORDS = (tokenize.COMMENT, tokenize.STRING, tokenize.NAME)


def refused_terms(repository: Path) -> list[str]:
    text = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.split("| term | not |\n|---|---|\n")[1].split("\n\n")[0]
    cells = [line.strip("| ").split(" | ")[1] for line in table.splitlines()]
    return [term.strip() for cell in cells for term in re.split("[,;]", cell)]


def words_of(file: Path) -> str:
    """All that people read in a file; parts of a name are words of their own."""
    tokens = tokenize.generate_tokens(io.StringIO(file.read_text(encoding="utf-8")).readline)
    return "\n".join(
        re.sub(r"_|(?<=[a-z])(?=[A-Z])", " ", t.string) for t in tokens if t.type in WORDS
    )


def test_terms_that_the_table_refuses_are_not_used(repository: Path) -> None:
    refused = refused_terms(repository)
    assert set(refused) >= OTHER_MEANINGS
    wanted = [re.escape(t) + "s?" for t in refused if t not in OTHER_MEANINGS]
    assert len(wanted) > 20
    found = re.compile(rf"\b({'|'.join(wanted)})\b", re.IGNORECASE)
    used = {
        f"{file.relative_to(repository)}: {term}"
        for file in (repository / "sassgis").rglob("*.py")
        for term in found.findall(words_of(file))
    }
    assert sorted(used) == []
