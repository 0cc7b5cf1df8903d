"""Onset frequencies of single release areas, from a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import cast, get_args

from sassgis.io.read.csv_table import csv_rows, number, one_of
from sassgis.io.read.plain_file import read_text
from sassgis.model.errors import InputError
from sassgis.model.hazard import Onset, OnsetUnit

_COLUMNS = ("area", "scenario", "frequency", "unit")


def read_frequencies(
    file: Path, areas: Sequence[str], scenarios: Sequence[str]
) -> dict[tuple[str, str], Onset]:
    """Read onset frequencies by release area and block scenario.

    Parameters
    ----------
    file : Path
        CSV with the columns area, scenario, frequency, unit (per_year, per_year_ha, per_year_m).
    areas, scenarios : sequence of str
        Names that there are.

    Returns
    -------
    dict of (area, scenario) to Onset

    Raises
    ------
    InputError
        If a column or value is missing, a name is unknown, a frequency is negative, or an area and
        a scenario turn up twice.
    """
    text = read_text(file, "hazard.frequencies", "a CSV table of onset frequencies")
    found: dict[tuple[str, str], Onset] = {}
    for where, row in csv_rows(text, file, _COLUMNS, (), ("frequency",)):
        names = {"area": areas, "scenario": scenarios, "unit": get_args(OnsetUnit)}
        for column, known in names.items():
            one_of(row[column], known, where, column, file)
        frequency = number(row["frequency"], where, "frequency", file)
        if frequency < 0.0:
            raise InputError(
                f"{where}: is negative",
                file=file,
                field="frequency",
                found=f"{frequency:g}",
                expected="0 or more",
            )
        key = row["area"], row["scenario"]
        if key in found:
            raise InputError(
                f"{where}: area and scenario turn up twice",
                file=file,
                field="scenario",
                found=f"{key[0]}, {key[1]}",
                expected="one row for each",
            )
        found[key] = Onset(frequency, cast(OnsetUnit, row["unit"]))
    return found
