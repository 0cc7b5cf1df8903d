"""Tables of a zoning in the report: levels, rules, sources, design values, risk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from sassgis.hazard.assess import Assessment, Rules
from sassgis.hazard.preset_labels import energy_labels, period_labels
from sassgis.hazard.risk import RiskTable, risk_totals
from sassgis.hazard.zoning.generalise import Coverage
from sassgis.model.hazard import HazardPreset
from sassgis.model.labels import rounded
from sassgis.report.page import Cell, ReportTable, heads


def zone_tables(
    preset: HazardPreset,
    found: Assessment,
    sources: pd.DataFrame,
    design: pd.DataFrame,
    *,
    return_periods_years: Sequence[float],
    currency: str,
) -> tuple[ReportTable, ...]:
    """Tables of a zoning besides that of the levels.

    Parameters
    ----------
    preset : HazardPreset
    found : Assessment
    sources, design : DataFrame
        As in ``tables/sources.csv`` and ``tables/design.csv``.
    return_periods_years : sequence of float
        Of the design values.
    currency : str
    """
    tables = [
        ReportTable(
            f"Rules: preset {preset.name}",
            (*heads("intensity; energy"),
             *((label, "years") for label in period_labels(preset.return_periods))),
            tuple(
                (c.label, span, *(preset.levels[k].label for k in row))
                for c, span, row in reversed(
                    list(zip(preset.intensities, energy_labels(preset), preset.matrix, strict=True))
                )
            ),
            f"{preset.title}. The level of a cell is the highest that its hazard curve crosses.",
        ),
        ReportTable(
            "Sources",
            heads("release area; block scenario; onset frequency | 1/year; blocks; "
                  "annual frequency per simulated block | 1/year"),
            _cells(sources),
            "Onset frequencies are the user's; the hazard is proportional to them.",
        ),
    ]  # fmt: skip
    if len(design):
        years = [f"{t:g}" for t in return_periods_years]
        tables += [
            _design_table("Arriving energy", "energy", "kj", "kJ", years, design),
            _design_table("Passing height", "height", "m", "m", years, design),
        ]
    if found.risk is not None:
        tables.append(_risk_table(found.risk, found.risk_without, f"{currency}/year"))
    return tuple(tables)


def level_table(preset: HazardPreset, found: Assessment) -> ReportTable:
    """Zones and their area by hazard level."""

    def areas(coverage: Coverage) -> list[int]:
        return [
            round(float(sum(p.area for p in coverage.polygons[coverage.classes == k + 1])))
            for k in range(len(preset.levels))
        ]

    columns = "hazard level; zones; area | m²"
    zones = found.hazard.levels
    count = [int((zones.classes == k + 1).sum()) for k in range(len(preset.levels))]
    cells: list[Sequence[Cell]] = [[v.label for v in preset.levels], count, areas(zones)]
    if found.without is not None:
        columns += "; area without walls and nets | m²"
        cells.append(areas(found.without.levels))
    return ReportTable(
        "Hazard zones",
        heads(columns),
        tuple(zip(*cells, strict=True))[::-1],
        "Zones are never lower than the cells in them: gaps are closed and small zones enlarged or "
        "raised, so that areas are a little larger than those of the cells.",
    )


def zone_facts_of(
    rules: Rules, found: Assessment, repetitions: int, confidence: float
) -> tuple[tuple[str, str], ...]:
    """What was computed, in words."""
    share = 100.0 * found.hazard.uncertain_share
    return (
        ("Rules", f"{rules.preset.title} ({rules.preset.name})"),
        ("Reference width of all frequencies", f"{rules.ref_width_m:.4g} m"),
        ("Repetitions", str(repetitions)),
        (
            "Statistically uncertain",
            f"{share:.1f} % of the cells that blocks reach: their level changes within the "
            f"{100 * confidence:g} % sampling interval",
        ),
    )


def _design_table(
    title: str, name: str, key: str, unit: str, years: Sequence[str], design: pd.DataFrame
) -> ReportTable:
    keys = ["line", "arrivals_per_year", f"{name}_q95_{key}", f"{name}_q99_{key}"]
    columns = f"line; arrivals | 1/year; 95 % | {unit}; 99 % | {unit}"
    return ReportTable(
        f"{title} at stations and barriers",
        heads("; ".join([columns, *(f"exceeded once in {t} years | {unit}" for t in years)])),
        _cells(design[keys + [f"{name}_{t}y_{key}" for t in years]]),
        "As if no wall or net held a block, sources weighted by their onset frequency. A "
        "dash: blocks arrive less often than that. Height of the centre above its resting "
        "height: a barrier needs the block's half height and freeboard on top. How many "
        "simulated blocks lie beyond each value is in tables/design.csv.",
    )


def _risk_table(risk: RiskTable, without: RiskTable | None, money: str) -> ReportTable:
    columns = heads(
        "what; sum over; hits | 1/year; loss | money; its standard error, at most | money; "
        "deaths | 1/year; their standard error, at most | 1/year; largest individual risk | 1/year"
        + ("" if without is None else "; loss without walls and nets | money; "
           "deaths without walls and nets | 1/year")
    )  # fmt: skip
    before = {} if without is None else {(b.scope, b.name): b for b in risk_totals(without)}
    rows = []
    for total in risk_totals(risk):
        row = [
            total.name, total.scope, rounded(total.values["hits"]), rounded(total.values["loss"]),
            rounded(total.standard_error["loss"], 2), rounded(total.values["deaths"]),
            rounded(total.standard_error["deaths"], 2), rounded(total.individual_risk),
        ]  # fmt: skip
        if without is not None:
            same = before.get((total.scope, total.name))
            row += [None if same is None else rounded(same.values[v]) for v in ("loss", "deaths")]
        rows.append(tuple(row))
    return ReportTable(
        "Risk of exposed objects",
        tuple((name, money if unit == "money" else unit) for name, unit in columns),
        tuple(rows),
        "Values, presence, vulnerability and lethality are the user's. Each object is in "
        "tables/risk_objects.csv, each source in tables/risk_sources.csv. Standard errors are "
        "of the sampling of blocks only.",
    )


def _cells(frame: pd.DataFrame) -> tuple[tuple[Cell, ...], ...]:
    """Rows of a frame as a report takes them."""
    return tuple(
        tuple(None if isinstance(v, float) and np.isnan(v) else v for v in row)
        for row in frame.itertuples(index=False, name=None)
    )
