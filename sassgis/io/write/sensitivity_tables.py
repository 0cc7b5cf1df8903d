"""Tables of a sensitivity and of a spread: ranges, effects, bands, and every simulation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from sassgis.hazard.ground_spread import SpreadBand
from sassgis.hazard.sensitivity import Names, RangeEffect, Variant, VariantFinding, measures
from sassgis.io.write.frames import same, table_of
from sassgis.model.ground_ranges import ParameterRange, RangeRule
from sassgis.model.labels import rounded


def range_table(ranges: Sequence[ParameterRange]) -> pd.DataFrame:
    """The ranges with their sources."""
    names = ("parameter", "value", "low", "high", "sd", "source", "verified", "sites", "rocks")
    columns = {"class": "class_name", **same(*names)}
    table = table_of(ranges, columns, {"low": 6, "high": 6, "sd": 6})
    table.insert(0, "number", range(1, len(ranges) + 1))
    return table


def effect_table(effects: Sequence[RangeEffect]) -> pd.DataFrame:
    """A row for each parameter and measure."""
    columns = {
        "class": "range.class_name",
        "parameter": "range.parameter",
        **same("measure", "unit", "base"),
        "at_low": "low",
        "at_high": "high",
        "another_seed": "chance",
        "beyond_chance": "beyond_chance",
        "rank_correlation": "correlation",
    }
    digits = dict.fromkeys(("base", "at_low", "at_high", "another_seed"), 5)
    return table_of(effects, columns, {**digits, "rank_correlation": 3})


def band_table(bands: Sequence[SpreadBand]) -> pd.DataFrame:
    """A row for each measure, with the values of the classes and over the draws."""
    columns = {**same("measure", "unit", "base"), "q10": "low", "q50": "middle", "q90": "high"}
    return table_of(bands, columns, dict.fromkeys(("base", "q10", "q50", "q90"), 5))


def simulation_table(
    base: VariantFinding,
    simulations: Iterable[tuple[Variant, VariantFinding]],
    ranges: Sequence[ParameterRange],
    names: Names,
    cell_m2: float,
) -> pd.DataFrame:
    """A row for each simulation: the values of its parameters, and its measures."""
    rows = []
    for variant, finding in simulations:
        row: dict[str, object] = {"simulation": variant.name}
        for r in ranges:
            row[r.label] = rounded(variant.values.get((r.class_name, r.parameter), r.value), 5)
        for measure, (unit, value) in measures(base, finding, names, cell_m2).items():
            row[measure if unit == "1" else f"{measure} ({unit})"] = rounded(value, 5)
        rows.append(row)
    return pd.DataFrame(rows)


def rule_table(rules: Sequence[RangeRule]) -> pd.DataFrame:
    """Ranges as ``--ranges`` and ``[ground] ranges`` take them."""
    names = ("parameter", "kind", "low", "high", "source", "verified", "sites", "rocks")
    return table_of(rules, {"class": "class_name", **same(*names)}, {"low": 6, "high": 6})
