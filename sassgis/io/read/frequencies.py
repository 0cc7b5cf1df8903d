"""Onset frequencies of single release areas, from a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

from sassgis.io.read.csv_table import CsvColumn, read_table
from sassgis.model.errors import InputError
from sassgis.model.hazard import Onset, OnsetUnit
from sassgis.model.in_memory import Input


def read_frequencies(
    file: Input, areas: Sequence[str], scenarios: Sequence[str]
) -> dict[tuple[str, str], Onset]:
    """Read onset frequencies by release area and block scenario.

    Parameters
    ----------
    file : Input
        CSV with the columns area, scenario, frequency, unit (per_year, per_year_ha, per_year_m).
    areas, scenarios : sequence of str
        Names that there are.

    Returns
    -------
    dict of (area, scenario) to Onset
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
                f"{where}: area and scenario turn up twice",
                file=file,
                field="scenario",
                found=", ".join(key),
                expected="one row for each",
            )
        found[key] = Onset(row["frequency"], row["unit"])
    return found
