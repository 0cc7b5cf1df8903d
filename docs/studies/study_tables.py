"""Tables of the studies: as CSV, and in Markdown between the marks of a page."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]], digits: int = 6) -> None:
    """Write rows as CSV, numbers with so many significant digits."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow(
                {k: f"{v:.{digits}g}" if isinstance(v, float) else v for k, v in row.items()}
            )


def table(head: str, rows: Iterable[str]) -> str:
    """A table in Markdown; between the cells of head and rows stands ``|``."""
    first, *others = (f"| {line} |" for line in (head, *rows))
    return "\n".join([first, "|" + "---|" * len(head.split(" | ")), *others])


def filled(text: str, tables: Mapping[str, Callable[[], str]], mark: str, end: str) -> str:
    """A page with the tables between ``<!-- mark: NAME -->`` and ``<!-- end -->`` written again."""

    def made(match: re.Match[str]) -> str:
        return f"<!-- {mark}: {match[1]} -->\n\n{tables[match[1]]()}\n\n<!-- {end} -->"

    return re.sub(rf"<!-- {mark}: (.+?) -->\n.*?<!-- {end} -->", made, text, flags=re.S)


def between_marks(text: str, name: str, part: str) -> str:
    """A page with a part between ``<!-- NAME -->`` and ``<!-- end NAME -->``."""
    first, last = f"<!-- {name} -->", f"<!-- end {name} -->"
    return re.sub(f"{first}.*{last}", lambda _: f"{first}\n{part}\n{last}", text, flags=re.S)


def replaced(page: Path, name: str, part: str) -> None:
    """Put a part between its two marks on a page."""
    text = page.read_text(encoding="utf-8")
    page.write_text(between_marks(text, name, part), encoding="utf-8")


def rewrite(pages: Iterable[Path], again: Callable[[str], str]) -> None:
    """Write pages again, those that change."""
    for page in pages:
        text = page.read_text(encoding="utf-8")
        new = again(text)
        if new != text:
            page.write_text(new, encoding="utf-8")
