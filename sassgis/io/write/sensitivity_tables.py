"""Tables of a sensitivity and of a spread: ranges, effects, bands, and every simulation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from sassgis.hazard.ground_spread import SpreadBand
from sassgis.hazard.sensitivity import Names, RangeEffect, Variant, VariantFinding, measures
from sassgis.model.ground_ranges import ParameterRange, RangeRule
from sassgis.model.labels import rounded


def range_table(ranges: Sequence[ParameterRange]) -> pd.DataFrame:
    """The ranges with their sources."""
    return pd.DataFrame(
        {
            "number": range(1, len(ranges) + 1),
            "class": [r.class_name for r in ranges],
            "parameter": [r.parameter for r in ranges],
            "value": [r.value for r in ranges],
            "low": [rounded(r.low, 6) for r in ranges],
            "high": [rounded(r.high, 6) for r in ranges],
            "sd": [rounded(r.sd, 6) for r in ranges],
            "source": [r.source for r in ranges],
            "verified": [r.verified for r in ranges],
            "sites": [r.sites for r in ranges],
            "rocks": [r.rocks for r in ranges],
        }
    )


def effect_table(effects: Sequence[RangeEffect]) -> pd.DataFrame:
    """A row for each parameter and measure."""
    return pd.DataFrame(
        {
            "class": [e.range.class_name for e in effects],
            "parameter": [e.range.parameter for e in effects],
            "measure": [e.measure for e in effects],
            "unit": [e.unit for e in effects],
            "base": [rounded(e.base, 5) for e in effects],
            "at_low": [rounded(e.low, 5) for e in effects],
            "at_high": [rounded(e.high, 5) for e in effects],
            "another_seed": [rounded(e.chance, 5) for e in effects],
            "beyond_chance": [e.beyond_chance for e in effects],
            "rank_correlation": [rounded(e.correlation, 3) for e in effects],
        }
    )


def band_table(bands: Sequence[SpreadBand]) -> pd.DataFrame:
    """A row for each measure, with the values of the classes and over the draws."""
    return pd.DataFrame(
        {
            "measure": [b.measure for b in bands],
            "unit": [b.unit for b in bands],
            "base": [rounded(b.base, 5) for b in bands],
            "q10": [rounded(b.low, 5) for b in bands],
            "q50": [rounded(b.middle, 5) for b in bands],
            "q90": [rounded(b.high, 5) for b in bands],
        }
    )


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
    return pd.DataFrame(
        {
            "class": [r.class_name for r in rules],
            "parameter": [r.parameter for r in rules],
            "kind": [r.kind for r in rules],
            "low": [rounded(r.low, 6) for r in rules],
            "high": [rounded(r.high, 6) for r in rules],
            "source": [r.source for r in rules],
            "verified": [r.verified for r in rules],
            "sites": [r.sites for r in rules],
            "rocks": [r.rocks for r in rules],
        }
    )
