"""Exposed objects, and a sheet of A4 for each barrier and station.

The words of the sheets are in ``data/protection.html.j2``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

from sassgis.grid import FloatArray
from sassgis.hazard.curves import hazard_curves
from sassgis.hazard.design import arrivals, net_classes, words_at_line
from sassgis.hazard.levels import hazard_level
from sassgis.hazard.object_values import ObjectValues
from sassgis.hazard.sources import Sampled
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.report import figures
from sassgis.report.figures.map_marks import MapObject
from sassgis.report.page import (
    Cell,
    ReportFigure,
    ReportTable,
    heads,
    same_decimals,
    sensible,
    table_of,
    template,
    translated_table,
)
from sassgis.report.pictures import picture
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.hazard_rules import HazardPreset
from sassgis.settings.languages import (
    Phrase,
    counted,
    current_language,
    joined,
    phrase,
    translated,
)
from sassgis.settings.results import ControlLine
from sassgis.simulation.control_lines import BEHIND, FORCE, LOAD, OVER

#: Objects beyond this number are left out of the report.
MOST_ROWS = 40


def map_objects(placed: PlacedObjects) -> list[MapObject]:
    """Return exposed objects for drawing: the stretches of a road or line as one."""
    return [
        (name, shapely.union_all([placed.geometries[i] for i in own]))
        for name, own in placed.wholes.items()
    ]


#: Levels of an object: the highest of the zones that it touches, and that of all its blocks.
ObjectLevels = tuple[str, str]


def levels_of(
    placed: PlacedObjects,
    zones: Coverage,
    preset: HazardPreset,
    sampled: Sequence[Sampled],
    energies_kj: FloatArray,
) -> dict[str, ObjectLevels]:
    """Return the levels of each object by its name; "none" without.

    ``energies_kj`` are those of the counts. More blocks reach a wide object than the reference
    width of the zones.
    """
    of_zones, of_blocks = np.zeros((2, len(placed)), np.int64)
    if len(placed) and zones.polygons.size:
        tree = shapely.STRtree(zones.polygons)
        owner, zone = tree.query(list(placed.geometries), predicate="intersects")
        np.maximum.at(of_zones, owner, zones.classes[zone].astype(int))
    if len(placed):
        sources, counts = zip(*((one.source, one.objects) for one in sampled), strict=True)
        curves = hazard_curves(sources, counts, energies_kj)
        of_blocks[curves.places] = hazard_level(curves, preset)
    labels = ["none", *(level.label for level in preset.levels)]
    return {
        name: (labels[of_zones[own].max()], labels[of_blocks[own].max()])
        for name, own in placed.wholes.items()
    }


def exposed_table(
    placed: PlacedObjects, values: ObjectValues, levels: Mapping[str, ObjectLevels]
) -> ReportTable:
    """Tabulate what reaches all exposed objects, most energy first; ``levels`` may be empty."""
    rare = max(values.energy_kj, default=None)
    shown = [values.arrivals, values.energy_q95_kj, values.height_q95_m]
    if rare is not None:
        shown.insert(2, values.energy_kj[rare])
    rows: list[tuple[float, tuple[Cell, ...]]] = []
    for name, own in placed.wholes.items():
        number = values.stretch_of(own)
        level = levels[name] if levels else ()
        cells = [with_limits(*estimate.of(number)) for estimate in shown]
        energy = float(np.nan_to_num(shown[-2].value[number], nan=-1.0))
        rows.append((-energy, (name, placed.objects[number].kind, *level, *cells)))
    rows.sort(key=lambda row: row[0])
    note = phrase(
        "All blocks that reach the object, with limits of the sampling error. Energy: largest "
        "value of each block. Height: value of each block in each cell. Roads and lines: stretch "
        "with the highest energy. A dash means that no block arrives, or that blocks arrive less "
        "often than once in the period."
    )
    if levels:
        more = (
            "An object wider than the reference width is reached by more blocks, so that its "
            "level may be higher than that of the zone."
        )
        note = joined(" ", (note, phrase(more)))
    columns = heads(
        f"object; kind; {'level of the zone; level of the object; ' if levels else ''}"
        f"{'blocks | ' if rare is None else 'blocks a year | 1/year'}; energy, 95 % | kJ"
    )
    if rare is not None:
        columns = (*columns, (phrase("energy once in {} years", f"{rare:g}"), "kJ"))
    columns = (*columns, ("height, 95 %", "m"))
    return table_of("Exposed objects", columns, (row for _, row in rows), note)


def most_exposed(exposed: ReportTable) -> ReportTable:
    """Return the first rows of the table of exposed objects, as many as a page can show."""
    count = len(exposed.rows)
    if count <= MOST_ROWS:
        return exposed
    cut = phrase("{} of {} are listed, those with the largest energies.", MOST_ROWS, count)
    rows, note = exposed.rows[:MOST_ROWS], joined(" ", (exposed.note, cut))
    return replace(exposed, rows=rows, note=note)


def with_limits(value: float, low: float, high: float) -> Cell:
    """Return a value with its limits, in words, all with its decimals; None where there is none."""
    if not np.isfinite(value):
        return None
    if not np.isfinite(high):
        return phrase("{} ({} or more)", sensible(value), sensible(low))
    return phrase("{} ({} to {})", *same_decimals((value, low, high)))


def limited(row: pd.Series, column: str) -> Cell:
    """Return a value of a table with its limits, which have separate columns."""
    return with_limits(*row[[column, f"{column}_low", f"{column}_high"]].astype(float))


PAGE_NAME = "protection.html"
#: Share of the blocks of a line that a place upslope must see to be compared with it.
_ENOUGH = 0.95

#: What the template says of a line, by name.
ProtectionSheet = dict[str, Any]


def protection_sheets(
    lines: Sequence[tuple[ControlLine, FloatArray]],
    without_barriers: Sequence[Sampled],
    with_barriers: Sequence[Sampled],
    frames: tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame],
    given: tuple[tuple[str, str], ...],
    folder: Path,
    confidence: float,
) -> tuple[ProtectionSheet, ...]:
    """Return the sheets of all lines; their figures go into a folder.

    The frames are those of ``tables/design.csv``, ``protection.csv`` and ``protection_places.csv``;
    ``given`` is what the values rest on, the same on all sheets.
    """
    design, protection, places = frames
    sheets = []
    for i, (line, trace) in enumerate(lines):
        needs = protection[protection["line"] == line.name]
        along = places[places["line"] == line.name].dropna(subset=["energy_q95_kj"])
        here = along[along["moved_m"] == 0.0]
        built = line.kind != "station"
        drawn = partial(
            figures.protection_figure,
            {name: along[name].to_numpy(float) for name in figures.PLACES_SHOWN},
            arrivals(without_barriers, i, "energy_kj"),
            arrivals(with_barriers, i, BEHIND) if built else None,
            list(needs["return_period_years"]),
            capacity_kj=line.capacity_kj,
            confidence=confidence,
        )
        sheets.append(
            {
                "line": line,
                "built": built,
                "length_m": shapely.LineString(trace).length,
                "ground_m": here["ground_m"].iloc[0] if len(here) else None,
                "rate": float(design["arrivals_per_year"].iloc[i]),
                "blocks": int(design["rocks"].iloc[i]),
                "yearly": needs.iloc[0],
                # A roof protects only what it covers.
                "best": None if line.kind == "gallery" else best_words(along),
                "beyond": words_at_line(without_barriers, i),
                "given": given,
                "table": needs_table(design.iloc[i], needs),
                "figure": picture(folder, f"protection_{i + 1}", "", "", drawn),
                "moved": len(along) > 1,
                "percent": f"{100 * confidence:g}",
            }
        )
    return tuple(sheets)


def best_words(places: pd.DataFrame) -> Phrase | None:
    """State where along the slope the least energy and height (95 %) arrive, and against what.

    Places upslope that fewer blocks reach than the line itself are left out: the others start below
    them or pass next to it. So are places below an exposed object that the line is above. None if
    there is nothing to compare.
    """
    drawn = places[places["moved_m"] == 0.0]
    if len(places) < 2 or not len(drawn):
        return None
    here = drawn.iloc[0]
    enough = places["arrivals_per_year"] >= _ENOUGH * here["arrivals_per_year"]
    known = places[(enough | (places["moved_m"] >= 0.0)) & places["above_objects"]]
    parts: list[object] = [len(known)]
    for key in ("energy_q95_kj", "height_q95_m"):
        least = known.loc[known[key].idxmin()]
        parts += [_moved(least["moved_m"]), sensible(least[key]), sensible(here[key])]
    text = (
        "Of {} places that protect the same objects, the 95 % energy is lowest {}: {} kJ (as drawn "
        "{} kJ). The 95 % passing height is lowest {}: {} m (as drawn {} m)."
    )
    best = phrase(text, *parts)
    if len(known) == 1:
        best = phrase("No other place protects the same objects.")
    below = places.loc[~places["above_objects"], "energy_q95_kj"].min()
    if not below < known["energy_q95_kj"].min():
        return best
    more = "Places further down ({} kJ) do not count: an exposed object lies above them."
    return joined(" ", (best, phrase(more, sensible(below))))


def _moved(metres: float) -> Phrase:
    """Return where a copy of a line lies."""
    if metres == 0.0:
        return phrase("where it is drawn")
    text = "{} m downslope" if metres > 0.0 else "{} m upslope"
    return phrase(text, f"{abs(metres):g}")


#: Columns of protection.csv in the sheets: key, title, and kinds of lines that have it.
_NEEDS = (
    ("net_class", "energy class", "station net"),
    ("net_height_m", "net height | m", "station net"),
    ("net_height_m", "wall height | m", "wall"),
    (BEHIND, "energy behind | kJ", "net gallery"),
    (LOAD, "energy of hits | kJ", "wall"),
    (LOAD, "energy into the roof | kJ", "gallery"),
    (FORCE, "force on the roof | kN", "gallery"),
    (OVER, "energy over the top | kJ", "wall gallery"),
)


def needs_table(arriving: pd.Series, needs: pd.DataFrame) -> ReportTable:
    """Tabulate what a line must take by return period; a dash where blocks come less often."""
    shown = {key: title for key, title, kinds in _NEEDS if arriving["kind"] in kinds.split()}
    rows = []
    for _, row in needs.iterrows():
        years = f"{row['return_period_years']:g}"
        own, high = row["net_class"], row["net_class_high"]
        size = row["block_m"]
        classes = (own if high == own else phrase("{} to {}", own, high or "–")) or None
        rows.append(
            [
                years,
                limited(row, "energy_kj"),
                limited(arriving, f"height_{years}y_m"),
                None if pd.isna(size) else float(size),
                *(classes if key == "net_class" else limited(row, key) for key in shown),
            ]
        )
    columns = "return period | years; energy | kJ; passing height | m; block | m"
    return table_of(
        "Values reached or exceeded once in the return period",
        "; ".join([columns, *shown.values()]),
        rows,
    )


def write_protection_page(
    folder: Path,
    title: str,
    byline: Sequence[str],
    sheets: Sequence[ProtectionSheet],
    change: ReportFigure | None,
    warnings: int,
) -> None:
    """Write the sheets into one HTML file that prints a page of A4 for each."""
    text = template("protection.html.j2").render(
        title=title, byline=byline, sheets=sheets, change=change,
        warnings=warnings and translated(counted(
            warnings, "{} warning applies (see report.html).",
            "{} warnings apply (see report.html).", warnings,
        )),
        classes=", ".join(f"{name}: {most:g}" for name, most in net_classes() if most < np.inf),
        words=_words, in_words=translated, table_in_words=translated_table,
        language=current_language(),
    )  # fmt: skip
    (folder / PAGE_NAME).write_text(text, encoding="utf-8", newline="\n")


def _words(text: str, *parts: Cell) -> str:
    """Return a sentence with its numbers in the language of the page."""
    return translated(phrase(text, *(p if isinstance(p, str) else sensible(p) for p in parts)))
