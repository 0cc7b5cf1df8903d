"""Rows of the tables that come with the package."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from importlib import resources


def built_in_rows(name: str) -> Iterator[dict[str, str]]:
    """Return rows of ``sassgis/data/<name>.csv`` by column, as text."""
    file = resources.files("sassgis") / "data" / f"{name}.csv"
    return csv.DictReader(file.read_text(encoding="utf-8").splitlines())
