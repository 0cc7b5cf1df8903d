"""Tables of a zoning in the report: levels, rules, sources, design values, risk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from sassgis.hazard.assess import Assessment, Rules
from sassgis.hazard.preset_labels import energy_labels, period_labels
from sassgis.hazard.risk import risk_totals
from sassgis.hazard.zoning.generalise import Coverage
from sassgis.model.hazard import HazardPreset
from sassgis.model.labels import rounded
from sassgis.report.page import ReportTable


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
    tables = [_matrix_table(preset)]
    tables.append(
        ReportTable(
            "Sources",
            (("release area", ""), ("block scenario", ""), ("onset frequency", "1/year"),
             ("blocks", ""), ("annual frequency per simulated block", "1/year")),
            _cells(sources),  # type: ignore[arg-type]
            "Onset frequencies are the user's; the hazard is proportional to them.",
        )
    )  # fmt: skip
    if len(design):
        tables += _design_tables(return_periods_years, design)
    if found.risk is not None:
        tables += _risk_tables(currency, found)
    return tuple(tables)


def level_table(preset: HazardPreset, found: Assessment) -> ReportTable:
    """Zones and their area by hazard level."""
    zones = found.hazard.levels

    def areas(coverage: Coverage) -> list[float]:
        return [
            float(sum(p.area for p in coverage.polygons[coverage.classes == k + 1]))
            for k in range(len(preset.levels))
        ]

    columns = [("hazard level", ""), ("zones", ""), ("area", "m²")]
    now = areas(zones)
    count = [int((zones.classes == k + 1).sum()) for k in range(len(preset.levels))]
    rows: list[list[object]] = [
        [level.label, n, round(a)] for level, n, a in zip(preset.levels, count, now, strict=True)
    ]
    if found.without is not None:
        columns.append(("area without walls and nets", "m²"))
        for row, area in zip(rows, areas(found.without.levels), strict=True):
            row.append(round(area))
    return ReportTable(
        "Hazard zones",
        tuple(columns),
        tuple(tuple(row) for row in reversed(rows)),  # type: ignore[arg-type]
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


def _matrix_table(preset: HazardPreset) -> ReportTable:
    return ReportTable(
        f"Rules: preset {preset.name}",
        (("intensity", ""), ("energy", ""), *((label, "years") for label in
                                              period_labels(preset.return_periods))),
        tuple(
            (c.label, span, *(preset.levels[k].label for k in row))
            for c, span, row in reversed(
                list(zip(preset.intensities, energy_labels(preset), preset.matrix, strict=True))
            )
        ),
        f"{preset.title}. The level of a cell is the highest that its hazard curve crosses.",
    )  # fmt: skip


def _design_tables(
    return_periods_years: Sequence[float], design: pd.DataFrame
) -> list[ReportTable]:
    tables = []
    for name, unit, title in (
        ("energy", "kj", "Arriving energy at stations and barriers"),
        ("height", "m", "Passing height at stations and barriers"),
    ):
        years = [f"{t:g}" for t in return_periods_years]
        keys = ["line", "arrivals_per_year", f"{name}_q95_{unit}", f"{name}_q99_{unit}"]
        keys += [f"{name}_{t}y_{unit}" for t in years]
        shown = "kJ" if unit == "kj" else "m"
        tables.append(
            ReportTable(
                title,
                (
                    ("line", ""), ("arrivals", "1/year"), ("95 %", shown), ("99 %", shown),
                    *((f"exceeded once in {t} years", shown) for t in years),
                ),
                _cells(design[keys]),  # type: ignore[arg-type]
                "As if no wall or net held a block, sources weighted by their onset frequency. A "
                "dash: blocks arrive less often than that. Height of the centre above its resting "
                "height: a barrier needs the block's half height and freeboard on top. How many "
                "simulated blocks lie beyond each value is in tables/design.csv.",
            )
        )  # fmt: skip
    return tables


def _risk_tables(currency: str, found: Assessment) -> list[ReportTable]:
    assert found.risk is not None
    money = f"{currency}/year"
    before = None if found.risk_without is None else risk_totals(found.risk_without)
    rows = []
    for total in risk_totals(found.risk):
        row = [
            total.name, total.scope, rounded(total.values["hits"]), rounded(total.values["loss"]),
            rounded(total.standard_error["loss"], 2), rounded(total.values["deaths"]),
            rounded(total.standard_error["deaths"], 2), rounded(total.individual_risk),
        ]  # fmt: skip
        if before is not None:
            same = [b for b in before if (b.scope, b.name) == (total.scope, total.name)]
            row.append(rounded(same[0].values["loss"]) if same else None)
            row.append(rounded(same[0].values["deaths"]) if same else None)
        rows.append(tuple(row))
    columns = [
        ("what", ""), ("sum over", ""), ("hits", "1/year"), ("loss", money),
        ("its standard error, at most", money), ("deaths", "1/year"),
        ("their standard error, at most", "1/year"), ("largest individual risk", "1/year"),
    ]  # fmt: skip
    if before is not None:
        columns += [("loss without walls and nets", money),
                    ("deaths without walls and nets", "1/year")]  # fmt: skip
    return [
        ReportTable(
            "Risk of exposed objects",
            tuple(columns),
            tuple(rows),
            "Values, presence, vulnerability and lethality are the user's. Each object is in "
            "tables/risk_objects.csv, each source in tables/risk_sources.csv. Standard errors are "
            "of the sampling of blocks only.",
        )
    ]


def _cells(frame: pd.DataFrame) -> tuple[tuple[object, ...], ...]:
    """Rows of a frame as a report takes them."""
    return tuple(
        tuple(None if isinstance(v, float) and np.isnan(v) else v for v in row)
        for row in frame.itertuples(index=False, name=None)
    )
