"""Exposed objects in the report: where they are, and what reaches them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import shapely

from sassgis.hazard.object_values import ObjectValues
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.report.figures.map_marks import MapObject
from sassgis.report.page import Cell, ReportTable, heads, sensible, table_of
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.hazard_rules import HazardLevel
from sassgis.settings.languages import joined, phrase

#: Objects beyond this number are left out of the report.
MOST_ROWS = 40


def map_objects(placed: PlacedObjects) -> list[MapObject]:
    """Return exposed objects for drawing: the stretches of a road or line as one."""
    return [
        (name, shapely.union_all([placed.geometries[i] for i in own]))
        for name, own in placed.wholes.items()
    ]


def levels_of(
    placed: PlacedObjects, zones: Coverage, levels: Sequence[HazardLevel]
) -> dict[str, str]:
    """Return the highest level of the zones that each object touches, by its name, or "none"."""
    highest = np.full(len(placed), -1)
    if len(placed) and zones.polygons.size:
        tree = shapely.STRtree(zones.polygons)
        owner, zone = tree.query(list(placed.geometries), predicate="intersects")
        np.maximum.at(highest, owner, zones.classes[zone].astype(int) - 1)
    labels = ["none", *(level.label for level in levels)]
    return {name: labels[highest[own].max() + 1] for name, own in placed.wholes.items()}


def exposed_table(
    placed: PlacedObjects, values: ObjectValues, levels: Mapping[str, str]
) -> ReportTable:
    """Tabulate what reaches all exposed objects, most energy first; ``levels`` may be empty."""
    rare = max(values.energy_kj, default=None)
    shown = [values.arrivals, values.energy_q95_kj, values.height_q95_m]
    if rare is not None:
        shown.insert(2, values.energy_kj[rare])
    rows: list[tuple[float, tuple[Cell, ...]]] = []
    for name, own in placed.wholes.items():
        energy = np.nan_to_num(shown[-2].value[own], nan=-1.0)
        number = own[int(np.argmax(energy))]
        level = [levels[name]] if levels else []
        cells = [with_limits(*estimate.of(number)) for estimate in shown]
        rows.append((-energy.max(), (name, placed.objects[number].kind, *level, *cells)))
    rows.sort(key=lambda row: row[0])
    note = phrase(
        "All blocks that reach the object, with limits of the sampling error. Energy: the largest "
        "value of each block. Height: each block in each cell. Roads and lines: the stretch with "
        "the most energy. A dash means that no block arrives, or less often."
    )
    columns = heads(
        f"object; kind; {'hazard level; ' if levels else ''}"
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
    """Return a value with its limits, in words; None where there is none."""
    if not np.isfinite(value):
        return None
    most = sensible(high) if np.isfinite(high) else phrase("more")
    return phrase("{} ({} to {})", sensible(value), sensible(low), most)


def limited(row: pd.Series, column: str) -> Cell:
    """Return a value of a table with its limits, which have separate columns."""
    return with_limits(*row[[column, f"{column}_low", f"{column}_high"]].astype(float))
