"""Exposed objects in the report: where they are, and what reaches them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from sassgis.hazard.zoning.coverage import Coverage
from sassgis.model.exposure import PlacedObjects
from sassgis.model.hazard import HazardLevel
from sassgis.model.languages import joined, phrase
from sassgis.model.map_run import ObjectCells
from sassgis.model.results import RasterLayer
from sassgis.report.figures.map_marks import MapObject
from sassgis.report.page import Cell, ReportTable, heads

#: Objects beyond this number are in the tables of the run only.
MOST_ROWS = 40


def map_objects(placed: PlacedObjects) -> list[MapObject]:
    """Exposed objects for drawing: the stretches of a road or line as one."""
    return [
        (name, shapely.union_all([placed.geometries[i] for i in own]))
        for name, own in _wholes(placed).items()
    ]


def _wholes(placed: PlacedObjects) -> dict[str, list[int]]:
    wholes: dict[str, list[int]] = {}
    for number, thing in enumerate(placed.objects):
        wholes.setdefault(thing.whole, []).append(number)
    return wholes


def levels_of(
    placed: PlacedObjects, zones: Coverage, levels: Sequence[HazardLevel]
) -> dict[str, str]:
    """The highest level of the zones that each object touches, by its name; "none" outside all."""
    highest = np.full(len(placed), -1)
    if len(placed) and zones.polygons.size:
        tree = shapely.STRtree(zones.polygons)
        owner, zone = tree.query(list(placed.geometries), predicate="intersects")
        np.maximum.at(highest, owner, zones.classes[zone].astype(int) - 1)
    labels = ["none", *(level.label for level in levels)]
    return {name: labels[highest[own].max() + 1] for name, own in _wholes(placed).items()}


def exposed_table(
    placed: PlacedObjects,
    cells: ObjectCells,
    layers: Sequence[RasterLayer],
    levels: Mapping[str, str],
) -> ReportTable:
    """What reaches the exposed objects on the cells that they touch; the largest energy first.

    The layers are maps of the blocks, the levels those of :func:`levels_of`, empty without zones.
    """
    bands = {(layer.stem, band.name): band for layer in layers for band in layer.bands}
    largest = []
    for key in (
        ("energy", "q95"), ("energy", "max"), ("passing_height", "q95"),
        ("reach_probability", "reach"),
    ):  # fmt: skip
        # NaN where no block arrives.
        peaks = np.full(cells.n_objects, np.nan)
        np.fmax.at(peaks, cells.number, bands[key].values.ravel()[cells.cell].astype(float))
        largest.append(peaks)
    rows: list[tuple[Cell, ...]] = [
        (
            name,
            placed.objects[own[0]].kind,
            *([levels[name]] if levels else []),
            *(float(np.fmax.reduce(peaks[own])) for peaks in largest),
        )
        for name, own in _wholes(placed).items()
    ]
    rows.sort(key=lambda row: -np.nan_to_num(float(row[-4] or 0.0), nan=-1.0))
    note = phrase(
        "The largest value of the maps on the cells that the object touches. A dash: no block "
        "arrives."
    )
    if len(rows) > MOST_ROWS:
        more = phrase("{} more are in the tables.", len(rows) - MOST_ROWS)
        note = joined(" ", (note, more))
    return ReportTable(
        "Exposed objects",
        heads(
            f"object; kind; {'hazard level; ' if levels else ''}energy, 95 % | kJ; "
            "largest energy | kJ; height, 95 % | m; reach probability"
        ),
        tuple(rows[:MOST_ROWS]),
        note,
    )
