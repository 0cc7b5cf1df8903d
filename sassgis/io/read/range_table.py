"""Ranges of the parameters of ground classes: the built-in table and the user's own."""

from __future__ import annotations

from importlib import resources

from sassgis.io.read.csv_table import CsvColumn, errors_of_row, read_table
from sassgis.model.ground import GroundTable
from sassgis.model.ground_ranges import EVERY_CLASS, RANGED, RangeRule
from sassgis.model.in_memory import Input


def read_ranges(table: GroundTable, own: Input | None = None) -> tuple[RangeRule, ...]:
    """Rules of the built-in table, and after them those of the user's own.

    Parameters
    ----------
    table : GroundTable
        Of the run: the classes that an own table may name.
    own : Input, optional
        CSV with the columns class (``*`` for every other class), parameter, kind (value, offset,
        factor), low, high and, if wanted, source, verified, sites, rocks and together.
    """
    with resources.as_file(resources.files("sassgis") / "data" / "ground_ranges.csv") as file:
        rules = _read(file, None)
    return rules if own is None else (*rules, *_read(own, table))


def _read(file: Input, table: GroundTable | None) -> tuple[RangeRule, ...]:
    classes = () if table is None else (*table.names, EVERY_CLASS)
    columns = {
        "class": CsvColumn(known=classes, what="ground class"),
        "parameter": CsvColumn(known=RANGED),
        "kind": CsvColumn(known=("value", "offset", "factor")),
        "low": CsvColumn(float),
        "high": CsvColumn(float),
        "source": CsvColumn(default=f"own table {file.name}"),
        "verified": CsvColumn(bool, default=False),
        "sites": CsvColumn(int, low=0, default=0),
        "rocks": CsvColumn(int, low=0, default=0),
        "together": CsvColumn(default=""),
    }
    rules = []
    what = "a table of ranges of ground classes (CSV)"
    for where, row in read_table(file, "ranges", what, columns):
        with errors_of_row(where, file):
            rules.append(RangeRule(*row.values()))
    return tuple(rules)
