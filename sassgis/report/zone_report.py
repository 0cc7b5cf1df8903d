"""Figures and tables of a zoning in the report."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from matplotlib.figure import Figure

from sassgis.grid import FloatArray
from sassgis.hazard.assess import Assessment, Hazard, Rules, raster
from sassgis.hazard.curves import source_rate
from sassgis.hazard.levels import energy_labels, period_labels
from sassgis.hazard.risk import RiskTable, total_rows
from sassgis.hazard.zoning.applied_edits import shares_text
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.report import figures
from sassgis.report.figures.map_figure import shown_part
from sassgis.report.figures.map_marks import all_points
from sassgis.report.map_report import map_marks
from sassgis.report.page import Cell, ReportFigure, ReportTable, heads, sensible, table_of
from sassgis.report.pictures import classes_alt, map_alt, map_drawn, picture
from sassgis.report.protection_page import limited, map_objects
from sassgis.settings.hazard_rules import LIMIT_TEXT, HazardPreset
from sassgis.settings.languages import joined, phrase
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import RasterLayer, rounded, thousands

BARRIERS_TITLE = "Effect of barriers"
#: Over what rows of the table of risk are summed.
_SCOPES = {
    "whole": "whole object", "kind": "kind of object", "source": "release area and scenario",
    "all": "all objects",
}  # fmt: skip


def telling_place(hazard: Hazard) -> int | None:
    """Return the position in the curves of the place reached by most sources; None without."""
    curves = hazard.curves
    if not curves.places.size:
        return None
    sources = np.zeros(curves.places.size, np.int64)
    for sampled in hazard.sampled:
        sources[np.searchsorted(curves.places, sampled.cells.places)] += 1
    return int(np.lexsort((curves.places, -curves.rate[:, 0], -sources))[0])


def curves_at(hazard: Hazard, place: int) -> dict[str, FloatArray]:
    """Return the rate of each source at one place, by its label."""
    out = {}
    cell = hazard.curves.places[place]
    for sampled in hazard.sampled:
        at = int(np.searchsorted(sampled.cells.places, cell))
        if at < sampled.cells.places.size and sampled.cells.places[at] == cell:
            out[sampled.source.label] = source_rate(sampled.source, sampled.cells)[at]
    return out


def _rings(polygons: Sequence[Any]) -> list[FloatArray]:
    """Return the coordinates of all outlines of polygons."""
    rings = shapely.get_rings(shapely.get_parts(list(polygons)))
    return [shapely.get_coordinates(ring) for ring in rings]


def zone_figures(
    run: MapRun,
    rules: Rules,
    found: Assessment,
    maps: tuple[RasterLayer, ...],
    folder: Path,
    *,
    confidence: float,
    currency: str,
    history: Sequence[tuple[int, float]],
    changed_share_max: float,
) -> tuple[ReportFigure, ...]:
    """Draw the figures of a zoning into a folder; ``history`` is that of Progress."""
    hazard, grid = found.hazard, run.grid
    place = telling_place(hazard)
    if place is None:
        return ()
    out: list[ReportFigure] = []

    def add(name: str, title: str, caption: str, alt: str, make: Callable[[], Figure]) -> None:
        out.append(picture(folder, name, title, caption, make, alt))

    by_stem = {layer.stem: layer for layer in maps}
    zones = hazard.levels
    level, not_certain = by_stem["hazard_level"], by_stem["confidence"]
    marks = map_marks(run, map_objects(rules.placed))
    entry = {c.value: c for c in level.classes}
    zone_marks = replace(
        marks,
        zones=[(p, entry[k]) for p, k in zip(zones.polygons, zones.classes, strict=True)],
        edits=_rings([a.edit.geometry for a in hazard.edits]),
        assessed=_rings(rules.assessed),
    )
    width = phrase("Reference width {} m.", f"{rules.ref_width_m:.4g}")
    text = (
        "Preset {}: {}. No zone has a lower level than a cell in it, except where edited by "
        "hand. {}"
    )
    areas = [
        (c.label, float(shapely.area(zones.polygons[zones.classes == c.value]).sum()))
        for c in reversed(level.classes)
    ]
    add(
        "hazard_level",
        "Hazard zones",
        phrase(text, rules.preset.name, phrase(rules.preset.title), width),
        classes_alt(level.title, areas),
        map_drawn(grid, level, zone_marks),
    )
    intensities = [m for m in maps if m.stem.startswith("intensity")]
    released = all_points(marks.release)
    view, shown = shown_part(grid, intensities, released)
    add(
        "intensity",
        "Intensity by return period",
        phrase("Highest intensity reached at least once in the return period. {}", width),
        joined(" ", (map_alt(grid, layer) for layer in intensities)),
        partial(figures.intensity_figure, view.grid, shown, marks),
    )
    view, (shown_level,) = shown_part(grid, [level], released)
    uncertain = view.cut(not_certain.bands[0].values == 1)
    text = (
        "With another random seed, cells may change level. The hatched cells hold {} % of "
        "these changes. More blocks reduce their number. Other onset frequencies or ground "
        "parameters may change the level of any cell."
    )
    add(
        "confidence",
        "Where the level is statistically uncertain",
        joined(" ", (phrase(text, f"{100 * confidence:.3g}"), width)),
        map_alt(grid, not_certain),
        partial(figures.confidence_figure, view.grid, shown_level, uncertain, marks),
    )
    if len(history) > 1:
        add(
            "blocks",
            "Effect of more blocks",
            "After each batch of blocks, the larger of two shares that change level with another "
            "random seed: that of the whole zoned area, and the mean over the levels. Red line: "
            "limit hazard.changed_share_max.",
            joined(", ", (
                phrase("{} blocks: {} %", thousands(n), f"{100 * share:.1f}")
                for n, share in history
            )),
            partial(figures.blocks_figure, history, changed_share_max),
        )  # fmt: skip
    if found.without is not None:
        both = []
        for one in (found.without, hazard):
            levels = raster(grid, one.chances.places, one.chances.level)
            drawn = np.where(levels == 0, np.nan, levels).astype(np.float32)
            both.append(replace(level, bands=(replace(level.bands[0], values=drawn),)))
        names = ("Without barriers", "With barriers")
        view, shown = shown_part(grid, both, released)
        text = "Hazard level of the cells without and with barriers, from the same blocks."
        add(
            "barriers",
            BARRIERS_TITLE,
            joined(" ", (phrase(text), width)),
            phrase("Without: {} With: {}", *(map_alt(grid, layer) for layer in both)),
            partial(figures.change_figure, view.grid, shown[0], shown[1], marks, names=names),
        )
    curves, preset = hazard.curves, rules.preset
    x, y = grid.cell_centres(curves.places[place : place + 1])
    rates = [
        phrase("{} of {} kJ and more", sensible(curves.rate[place, curves.column(e)]), f"{e:g}")
        for e in preset.thresholds_kj
    ]
    add(
        "hazard_curve",
        "Hazard curve of one cell",
        phrase(
            "The cell that the most release areas and scenarios reach. The highest field of the "
            "matrix that the curve crosses gives the level. {}", width,
        ),
        phrase("Falling curve. Blocks per year: {}.", joined(", ", rates)),
        partial(
            figures.hazard_curve_figure, curves.part([place]), preset,
            by_source=curves_at(hazard, place), confidence=confidence,
            note=phrase("At {}, {}.", thousands(x[0]), thousands(y[0])),
        ),
    )  # fmt: skip
    if found.risk is not None:
        out += _risk_figures(found.risk, currency, folder)
    return tuple(out)


def _risk_figures(risk: RiskTable, currency: str, folder: Path) -> list[ReportFigure]:
    """Return the objects with the largest loss and with most deaths, where there are any."""
    out = []
    per_year = phrase("{}/year", currency)
    for quantity, title, unit in (
        ("loss", "Risk: loss", per_year),
        ("deaths", "Risk: deaths", phrase("1/year")),
    ):
        values = risk.of_object(quantity)
        if not (values > 0.0).any():
            continue
        names = [o.name for o in risk.objects]
        first = [i for i in np.argsort(-values, kind="stable")[:3] if values[i] > 0]
        largest = [phrase("{} {} {}", names[i], sensible(values[i]), unit) for i in first]
        caption = (
            "Objects with the largest values, with the 95 % interval of the sampling error (upper "
            "bound). The user stated values and vulnerability."
        )
        limits = risk.limits(quantity)
        figure = partial(figures.risk_figure, names, values, limits, quantity=quantity, unit=unit)
        alt = phrase("Bars, the largest first: {}.", joined(", ", largest))
        out.append(picture(folder, f"risk_{quantity}", title, caption, figure, alt))
    return out


def zone_tables(
    preset: HazardPreset,
    found: Assessment,
    sources: pd.DataFrame,
    design: pd.DataFrame,
    *,
    return_periods_years: Sequence[float],
    currency: str,
) -> tuple[ReportTable, ...]:
    """Return tables of a zoning besides that of the levels; frames as in ``tables/``."""
    text = "{}. The level of a cell is the highest that its hazard curve crosses."
    tables = [
        table_of(
            phrase("Rules: preset {}", preset.name),
            (*heads("intensity; energy"),
             *((label, "years") for label in period_labels(preset.return_periods))),
            (
                (c.label, span, *(preset.levels[k].label for k in row))
                for c, span, row in reversed(
                    list(zip(preset.intensities, energy_labels(preset), preset.matrix, strict=True))
                )
            ),
            phrase(text, phrase(preset.title)),
        ),
        table_of(
            "Release areas and block scenarios",
            "release area; block scenario; onset frequency | 1/year; blocks; "
            "annual frequency per simulated block | 1/year",
            (
                (None if isinstance(v, float) and np.isnan(v) else v for v in row)
                for row in sources.itertuples(index=False, name=None)
            ),
            "The user stated the onset frequencies. All annual frequencies are proportional to "
            "them.",
        ),
    ]  # fmt: skip
    if len(design):
        years = [f"{t:g}" for t in return_periods_years]
        tables += [
            _design_table(title, name, key, unit, years, design)
            for title, name, key, unit in (
                ("Energy at stations and barriers, without barriers", "energy", "kj", "kJ"),
                ("Passing height at stations and barriers, without barriers", "height", "m", "m"),
            )
        ]
    if found.hazard.edits:
        labels = ["none", *(c.label for c in preset.levels)]
        edits = table_of(
            "Edited by hand",
            "level; limit; author; date; reason; computed at the time; computed now; "
            "share with another level since",
            (
                (labels[a.edit.level], phrase(LIMIT_TEXT[a.edit.limit]), a.edit.author,
                 a.edit.date, a.edit.reason, shares_text(a.then) or None, shares_text(a.now),
                 f"{100 * a.changed:.0f} %" if a.then else None)
                for a in found.hazard.edits
            ),
            "Zones, map sheets and the federal model use these levels instead of the computed "
            "ones. Maps of cells, intensities, frequencies and risk are as computed.",
        )  # fmt: skip
        tables.append(edits)
    if found.risk is not None:
        money = phrase("{}/year", currency)
        tables.append(_risk_table(found.risk, found.risk_without, money))
    return tuple(tables)


def level_table(preset: HazardPreset, found: Assessment) -> ReportTable:
    """Return zones and their area by hazard level."""

    def areas(coverage: Coverage) -> list[int]:
        return [
            round(float(sum(p.area for p in coverage.polygons[coverage.classes == k + 1])))
            for k in range(len(preset.levels))
        ]

    columns = "hazard level; zones; area | m²"
    zones = found.hazard.levels
    count = [int((zones.classes == k + 1).sum()) for k in range(len(preset.levels))]
    cells: list[Sequence[Cell]] = [[v.label for v in preset.levels], count, areas(zones)]
    columns += "; changes level with another seed | %"
    changed = found.hazard.chances.changed_by_level.tolist()
    cells.append([None if math.isnan(share) else round(100.0 * share, 1) for share in changed])
    if found.hazard.edits:
        columns += "; area as computed | m²"
        cells.append(areas(found.hazard.computed))
    if found.without is not None:
        columns += "; area without barriers | m²"
        cells.append(areas(found.without.levels))
    return table_of(
        "Hazard zones",
        columns,
        list(zip(*cells, strict=True))[::-1],
        "No zone has a lower level than a cell in it. Gaps are closed; small zones are enlarged "
        "or join a higher one. Zone areas are therefore larger than cell areas.",
    )


def zone_facts_of(rules: Rules) -> tuple[tuple[str, str], ...]:
    """Describe what the zones rest on."""
    return (
        ("Rules", phrase("{} ({})", phrase(rules.preset.title), rules.preset.name)),
        ("Reference width of all frequencies", f"{rules.ref_width_m:.4g} m"),
    )


def _design_table(
    title: str, name: str, key: str, unit: str, years: Sequence[str], design: pd.DataFrame
) -> ReportTable:
    columns = heads(f"line; arrivals | 1/year; 95 % | {unit}; 99 % | {unit}")
    keys = [f"{name}_{what}_{key}" for what in ("q95", "q99", *(f"{t}y" for t in years))]
    rows = (
        (line["line"], line["arrivals_per_year"], *(limited(line, key) for key in keys))
        for _, line in design.iterrows()
    )
    return table_of(
        title,
        (*columns, *((phrase("exceeded once in {} years", t), unit) for t in years)),
        rows,
        "Without barriers. Onset frequencies weight release areas and block scenarios. The "
        "limits cover the sampling error. A dash means that blocks arrive less often than "
        "once in the period. Heights are those of the centre of the block above its height at rest "
        "(half the block). Add the height of the whole block and the freeboard. See "
        "tables/design.csv for the number of simulated blocks beyond each value.",
    )


def _risk_table(risk: RiskTable, without: RiskTable | None, money: str) -> ReportTable:
    columns = heads(
        "what; sum over; hits | 1/year; loss | money; standard error of the loss, at most | "
        "money; deaths | 1/year; standard error of the deaths, at most | 1/year; largest "
        "individual risk | 1/year"
        + ("" if without is None else "; loss without barriers | money; "
           "deaths without barriers | 1/year")
    )  # fmt: skip
    before = {} if without is None else {(t["scope"], t["name"]): t for t in total_rows(without)}
    rows = []
    for total in total_rows(risk):
        row = [
            total["name"], _SCOPES[total["scope"]], rounded(total["hits_per_year"]),
            rounded(total["loss_per_year"]), rounded(total["loss_per_year_se"], 2),
            rounded(total["deaths_per_year"]), rounded(total["deaths_per_year_se"], 2),
            rounded(total["individual_risk_largest_per_year"]),
        ]  # fmt: skip
        if without is not None:
            same = before.get((total["scope"], total["name"]), {})
            values = (same.get(f"{name}_per_year") for name in ("loss", "deaths"))
            row += [None if value is None else rounded(value) for value in values]
        rows.append(row)
    return table_of(
        "Risk of exposed objects",
        ((name, money if unit == "money" else unit) for name, unit in columns),
        rows,
        "The user stated values, presence, vulnerability and lethality. See "
        "tables/risk_objects.csv for each object and tables/risk_sources.csv for each release "
        "area. Standard errors cover the sampling of blocks.",
    )
