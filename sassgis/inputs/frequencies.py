"""How often blocks come, from tables: onset frequencies, and volumes that were observed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np

from sassgis.errors import InputError
from sassgis.files.plain_file import number, read_text
from sassgis.hazard.volume_frequency import BlockSurvey
from sassgis.inputs.csv_table import CsvColumn, csv_cells, csv_rows, read_table
from sassgis.settings.hazard_rules import Onset, OnsetUnit
from sassgis.settings.schema import Input


def read_frequencies(
    file: Input, areas: Sequence[str], scenarios: Sequence[str]
) -> dict[tuple[str, str], Onset]:
    """Read onset frequencies by release area and block scenario.

    The CSV has the columns area, scenario, frequency, unit (per_year, per_year_ha, per_year_m);
    ``areas`` and ``scenarios`` are the names that there are.
    """
    columns = {
        "area": CsvColumn(known=areas),
        "scenario": CsvColumn(known=scenarios),
        "frequency": CsvColumn(float, low=0.0),
        "unit": CsvColumn(known=get_args(OnsetUnit)),
    }
    found: dict[tuple[str, str], Onset] = {}
    what = "a CSV table of onset frequencies"
    for where, row in read_table(file, "hazard.frequencies", what, columns):
        key = row["area"], row["scenario"]
        if key in found:
            raise InputError(
                f"{where}: area and scenario turn up twice", file=file, field="scenario",
                found=", ".join(key), expected="one row for each",
            )  # fmt: skip
        found[key] = Onset(row["frequency"], row["unit"])
    return found


_LIST, _CLASSES = ("volume_m3",), ("from_m3", "to_m3", "count")


def read_block_survey(file: Path) -> tuple[BlockSurvey, tuple[str, ...]]:
    """Read a list of block volumes, or counts of blocks by class of volume.

    The CSV has the column volume_m3 and, if one row is several blocks, count; or from_m3, to_m3
    (empty in an open class) and count. Other columns are left out, and returned as well.
    """
    text = read_text(file, "blocks", "a CSV table of block volumes")
    columns, _, _ = csv_cells(text, file)
    needed = _CLASSES if "from_m3" in columns else _LIST
    read = {*needed, "count"}
    wrong = partial(InputError, file=file)
    for name in needed:
        if name not in columns:
            found = ", ".join(columns) or "nothing"
            expected = f"{_LIST[0]}, or {', '.join(_CLASSES[:-1])} and {_CLASSES[-1]}"
            raise wrong("row 1: missing column", field=name, found=found, expected=expected)
    others = tuple(c for c in columns if c not in read)
    numbers = {**dict.fromkeys(needed, CsvColumn(float)), "count": CsvColumn(float, default=1.0)}
    rows = []
    for where, row in csv_rows(text, file, numbers | dict.fromkeys(others, CsvColumn(default=""))):
        value = partial(_at_least, row=row, where=where, file=file)
        low = high = value(needed[0], 0.0)
        if needed is _CLASSES:
            high = value("to_m3", low) if row["to_m3"] else math.inf
        rows.append((low, high, value("count", 0.0) if "count" in columns else 1.0))
    if not rows:
        raise wrong("has no blocks", expected="one row for each block or class")
    low, high, count = np.array(sorted(rows)).T
    if needed is _CLASSES and (high[:-1] > low[1:]).any():
        at = int(np.argmax(high[:-1] > low[1:]))
        found = f"{high[at]:g}, and the next from {low[at + 1]:g}"
        expected = "classes one above the other"
        raise wrong("classes overlap", field="to_m3", found=found, expected=expected)
    return BlockSurvey(low, high, count), others


def _at_least(column: str, least: float, row: Mapping[str, str], where: str, file: Path) -> float:
    """Return a volume above a least one, which is none itself, or a count."""
    found = number(row[column], where, column, file)
    if found < least or (column != "count" and found <= 0.0):
        raise InputError(
            f"{where}: cannot be used", file=file, field=column, found=row[column],
            expected="0 or more" if column == "count" else f"a volume above {least:g} m3",
        )  # fmt: skip
    return found
