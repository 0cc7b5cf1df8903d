"""Ranges of the parameters of ground classes: the built-in table and the user's own."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from sassgis.io.read.csv_table import csv_rows, errors_of_row, number, one_of
from sassgis.io.read.plain_file import read_text
from sassgis.model.ground import GroundTable
from sassgis.model.ground_ranges import EVERY_CLASS, RANGED, RangeRule

_COLUMNS = ("class", "parameter", "kind", "low", "high")
_OPTIONAL = ("source", "verified")
_KINDS = ("value", "offset", "factor")


def read_ranges(table: GroundTable, own: Path | None = None) -> tuple[RangeRule, ...]:
    """Rules of the built-in table, and after them those of the user's own.

    Parameters
    ----------
    table : GroundTable
        Of the run: the classes that an own table may name.
    own : Path, optional
        CSV with the columns class (``*`` for every other class), parameter, kind (value, offset,
        factor), low, high and, if wanted, source and verified.
    """
    with resources.as_file(resources.files("sassgis") / "data" / "ground_ranges.csv") as file:
        rules = _read(file, None)
    return rules if own is None else (*rules, *_read(own, table))


def _read(file: Path, table: GroundTable | None) -> tuple[RangeRule, ...]:
    rules = []
    text = read_text(file, "ranges", "a table of ranges of ground classes (CSV)")
    for where, row in csv_rows(text, file, _COLUMNS, _OPTIONAL, ("low", "high")):
        name = row["class"]
        if table is not None:
            one_of(name, (*table.names, EVERY_CLASS), where, "class", file, "ground class")
        parameter = one_of(row["parameter"], RANGED, where, "parameter", file)
        kind = one_of(row["kind"], _KINDS, where, "kind", file)
        low, high = (number(row[c], where, c, file) for c in ("low", "high"))
        source = row.get("source", "") or f"own table {file.name}"
        verified = row.get("verified", "").lower() in ("true", "yes", "1")
        with errors_of_row(where, file):
            rules.append(RangeRule(name, parameter, kind, low, high, source, verified))  # type: ignore[arg-type]
    return tuple(rules)
