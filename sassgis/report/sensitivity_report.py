"""Report of a sensitivity: what matters, how much, and where."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sassgis.hazard.sensitivity import Names, RangeEffect, SensitivityMaps
from sassgis.model.languages import joined, named, phrase, translated
from sassgis.model.map_run import MapRun
from sassgis.model.results import RasterLayer
from sassgis.report.figures import MapMarks
from sassgis.report.map_report import release_outlines
from sassgis.report.page import ReportContext, ReportTable, table_of
from sassgis.report.pictures import map_pictures

#: What the first table ranks by.
_RANKED = "run-out (95 %)"
_ENERGY = "energy (95 %) on the map, over the base"


def sensitivity_report(
    title: str,
    run: MapRun,
    effects: Sequence[RangeEffect],
    maps: SensitivityMaps,
    layers: Sequence[RasterLayer],
    samples: int,
    blocks: int,
    names: Names,
    folder: Path,
) -> ReportContext:
    """Draw the figures into ``folder`` and put the report together."""
    marks = MapMarks(release_outlines(run))
    measures = tuple(dict.fromkeys(e.measure for e in effects))
    return ReportContext(
        title=title,
        subtitle="How results change within the ranges of the ground classes",
        what_was_run=(
            ("Ranges", len({e.range.label for e in effects})),
            ("Simulations of all ranges at once", samples),
            ("Blocks in each simulation", blocks),
            ("Reference width of the hazard", f"{run.ref_width_m:.4g} m" if names.levels else "–"),
        ),
        verdict=_verdict(effects, maps, names),
        key_results=_key_table(effects),
        figures=map_pictures(folder, run.grid, layers, marks),
        tables=tuple(_measure_table(m, effects) for m in measures if m not in (_RANKED, _ENERGY)),
    )


def _verdict(effects: Sequence[RangeEffect], maps: SensitivityMaps, names: Names) -> str:
    ranked = [e for e in _ranked(effects, _RANKED) if e.beyond_chance]
    sentences = [phrase("No range alone changes the run-out (95 %) beyond chance.")]
    if ranked:
        sentences = [phrase("Run-out (95 %) answers most to {}.", ranked[0].range.label)]
    if names.levels:
        reached = maps.level > 0
        share = float((maps.higher[reached] >= 0.1).mean()) if reached.any() else 0.0
        text = (
            "On {} % of the cells with a level, it is higher in a tenth of the simulations or more."
        )
        sentences.append(phrase(text, f"{100 * share:.0f}"))
    return joined(" ", sentences)


def _ranked(effects: Sequence[RangeEffect], measure: str) -> list[RangeEffect]:
    chosen = [e for e in effects if e.measure == measure]
    return sorted(chosen, key=lambda e: -np.nan_to_num(e.largest_change, nan=-1.0))


def _key_table(effects: Sequence[RangeEffect]) -> ReportTable:
    energy = {e.range: e for e in effects if e.measure == _ENERGY}
    first = next(e for e in effects if e.measure == _RANKED)
    note = (
        "Base {} m, with another seed {} m. Energy: median ratio over the cells that 20 or more "
        "blocks reach in both. Each range alone, all other values as in the class. Beyond chance: "
        "more than twice the change by another seed."
    )
    return table_of(
        "Which ranges change run-out and energy",
        "class; parameter; value; range; run-out 95 %, low end | m; run-out 95 %, "
        "high end | m; energy ratio, low end | 1; energy ratio, high end | 1; run-out beyond "
        "chance; range read in its source",
        (
            (
                e.range.class_name, e.range.parameter, e.range.value,
                phrase("{} to {}", f"{e.range.low:.3g}", f"{e.range.high:.3g}"), e.low, e.high,
                energy[e.range].low, energy[e.range].high, "yes" if e.beyond_chance else "no",
                "yes" if e.range.verified else "no",
            )
            for e in _ranked(effects, _RANKED)
        ),
        phrase(note, f"{first.base:.4g}", f"{first.chance:.4g}"),
    )  # fmt: skip


def _measure_table(measure: str, effects: Sequence[RangeEffect]) -> ReportTable:
    chosen = _ranked(effects, measure)
    unit = "" if chosen[0].unit == "1" else chosen[0].unit
    title = translated(measure)
    return table_of(
        named(title[0].upper() + title[1:]),
        f"class; parameter; low end | {unit}; high end | {unit}; base | {unit}; "
        f"another seed | {unit}; rank correlation",
        (
            (e.range.class_name, e.range.parameter, e.low, e.high, e.base, e.chance, e.correlation)
            for e in chosen
        ),
        "Each range alone. Rank correlation: over the simulations of all ranges at once.",
    )
