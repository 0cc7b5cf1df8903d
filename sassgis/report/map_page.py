"""A map page, complete in itself: a click shows the values of a place.

The map library is Leaflet (BSD 2-Clause), as the package XStatic-Leaflet brings it; the rest is
the template ``map_page.html.j2``. Numbers of cells are packed: logarithms in steps of 0.23 %,
compressed.
"""

from __future__ import annotations

import base64
import io
import math
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import shapely
from markupsafe import Markup
from numpy.typing import NDArray
from scipy import ndimage

from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.report.figures.map_figure import class_numbers, shown_values
from sassgis.report.figures.map_marks import MapObject, even_choice
from sassgis.report.figures.relief import MapView, footprint, hillshade, view_of
from sassgis.report.page import data_uri, sensible, template
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset
from sassgis.settings.languages import current_language, phrase, translated
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import STOP_TEXT, RasterLayer, ReleasePoints
from sassgis.settings.styles import class_colours, class_labels, rgb
from sassgis.simulation.path_sample import BlockPath

#: Maps that can be chosen, the first that there is at the beginning.
_SHOWN = ("hazard_level", "energy", "reach_probability", "passing_height", "return_period")
#: Maps whose values the page shows for a cell: numbers of blocks, quantiles of arriving ones.
_COUNTS = (("passages", "passages"), ("reach_probability", "reach"), ("stops", "stops"))
_QUANTILES = ("energy", "passing_height", "speed")
_BANDS = ("q50", "q95", "max")
#: Sources that are named of a cell; energies of a curve; dots of a picture; cells that are
#: distinguished.
_SOURCES, _ENERGIES, _DOTS, _CELLS = 3, 12, 1200, 120_000
#: Release points; paths, their places together, and the least time between two places (s).
_POINTS, _PATHS, _PLACES, _STEP_S = 3000, 300, 40_000, 0.25
#: Colours of speeds, different from those of levels.
_FAST = "plasma"
#: Dots from one stripe of a hatched class to the next.
_STRIPE = 6
#: Steps of a decade, and the smallest power of ten.
_STEPS, _LEAST = 1000, -10

#: Words and values that the page shows for a place.
Rows = tuple[tuple[str, str], ...]


#: What one source brings: area, scenario, cells, and how often, or how many simulated blocks.
Contribution = tuple[str, str, IntArray, FloatArray]
#: What a table says of an object, station or barrier; energies (kJ) with blocks a year.
PlaceFacts = tuple[Rows, Sequence[tuple[float, float]]]


@dataclass(frozen=True, slots=True)
class MapHazard:
    """Cells and zones of a zoning."""

    preset: HazardPreset
    curves: HazardCurves
    # Position of the level in the preset, polygon, and rows of the zone.
    zones: Sequence[tuple[int, Any, Rows]]
    # Kind, name, geometry and rows: "assessed" completely, "open" where zones continue beyond the
    # terrain model, "edit" by hand.
    marks: Sequence[tuple[str, str, Any, Rows]]
    ref_width_m: float  # of all frequencies


def write_map_page(
    file: Path,
    title: str,
    run: MapRun,
    layers: Sequence[RasterLayer],
    areas: Sequence[tuple[str, Any, Rows]],
    objects: Sequence[MapObject],
    contributions: Sequence[Contribution],
    points: ReleasePoints,
    envelope: VectorLayer,
    paths: Sequence[BlockPath],
    places: Mapping[tuple[str, str], PlaceFacts],
    hazard: MapHazard | None = None,
    warnings: Sequence[str] = (),
) -> None:
    """Write the page of a run with all its maps, in the language of the settings.

    Release areas are name, geometry and what is said; the envelope is the layer of the energy line;
    places are by kind and name of the object, station or barrier; warnings are those about what may
    make the maps wrong.
    """
    by_stem = {layer.stem: layer for layer in layers}
    first = by_stem[next(stem for stem in _SHOWN if stem in by_stem)]
    around = [np.column_stack([p.x, p.y]) for p in paths]
    around += [shapely.get_coordinates(geometry) for _, geometry, _ in areas]
    everything = np.concatenate([np.empty((0, 2)), *around])
    view = view_of(run.grid, footprint(run.grid, shown_values(first.bands[0]), everything))
    factor = -(-max(view.grid.shape) // _DOTS)
    grey = np.nan_to_num((hillshade(view.grid) + 0.35) / 1.3, nan=1.0)[::factor, ::factor]
    data = {
        "extent": view.grid.bounds,
        "relief": data_uri(_png(np.repeat(grey[..., None], 3, axis=2))),
        "maps": [_map(by_stem[stem], view) for stem in _SHOWN if stem in by_stem],
        "cells": _cells(run.grid, hazard, contributions, by_stem),
        "curve": _curve_facts(hazard),
        "shapes": [*_shapes(run, areas, objects, places, hazard), *_envelope(envelope, run.grid)],
        "points": _points(
            shapely.MultiPoint(_some(np.column_stack([points.x, points.y]), _POINTS))
        ),
        "paths": _paths(_some(paths, _PATHS), run.heights, by_stem["speed"]),
    }
    text = template("map_page.html.j2").render(
        title=title,
        language=current_language(),
        data=data,
        warnings=[translated(text) for text in warnings],
        words={key: translated(word) for key, word in _WORDS.items()},
        # The library holds no text that ends its element.
        script=Markup(_library("leaflet.js").partition("//# sourceMappingURL")[0]),
        # Pictures of its buttons, none of which is shown.
        style=Markup(re.sub(r"url\([^)]*\)", "none", _library("leaflet.css"))),
    )
    file.write_text(text, encoding="utf-8", newline="\n")


def _library(name: str) -> str:
    """Return a file of the map library, read without importing it, which takes setuptools."""
    place = distribution("XStatic-Leaflet").locate_file(f"xstatic/pkg/leaflet/data/{name}")
    return Path(str(place)).read_text(encoding="utf-8")


_WORDS = {
    "years": "years",
    "once": "once in {} years",
    "rarer": "– (no block)",
    "none": "No simulated block arrives here.",
    "level": "Hazard level of the cell",
    "no_level": "no level",
    "why_none": "Blocks arrive here too rarely to count for a level.",
    "certain": "With another random seed, the level changes with a probability of {}.",
    "between": "Range within the sampling error: {} to {}.",
    "frequency": "Frequency of blocks here",
    "energy": "energy",
    "any": "any block",
    "and_more": "and more",
    "with_period": "Energy with return period",
    "blocks": "Simulated blocks that arrive here",
    "sources": "Where these blocks start",
    "others": "others",
    "of_width": "Reference width {} m.",
    "thinned": "Values of the most frequently reached of {} × {} cells.",
    "chainage": "chainage",
    "ground": "ground at",
    "above": "block above the ground",
    "path": "Paths of blocks",
    "one_path": "Path of a block",
    "speed": "speed",
    "play": "Play",
    "pause": "Pause",
    "all": "All release areas",
    "point": "Release points",
    "energy_line": "Energy line",
    "east": "east",
    "north": "north",
    "release": "Release area",
    "zone": "Zone",
    "zones": "Hazard zones",
    "zones_note": "The zones as drawn. The other maps show cells.",
    "open": "Zone continues beyond the terrain model",
    "edit": "Edited by hand",
    "assessed": "Assessed area",
    "object": "Object",
    "station": "Station",
    "wall": "Wall",
    "net": "Net",
    "gallery": "Gallery (safeguard tunnel)",
    "of_blocks": "of the arriving blocks",
    "largest": "largest",
}
_LABELS = {
    "passages": "Simulated blocks",
    "reach_probability": "Reach probability",
    "stops": "Deposited blocks",
    "energy": "Energy",
    "passing_height": "Passing height",
    "speed": "Speed",
}


def _png(image: NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    # An empty name in place of matplotlib's version: equal runs give equal pages.
    matplotlib.image.imsave(
        buffer, np.clip(image, 0.0, 1.0), format="png", metadata={"Software": ""}
    )
    return buffer.getvalue()


def _map(layer: RasterLayer, view: MapView) -> dict[str, Any]:
    """Return a map as a picture with its legend, the highest class first."""
    values = view.cut(shown_values(layer.bands[0]))
    striped = {float(c.value) for c in layer.classes if c.hatched}
    if layer.classes:
        entries = {float(c.value): (c.colour, c.label) for c in layer.classes}
    else:
        labels = class_labels(layer.breaks, layer.bands[0].unit)
        entries = dict(enumerate(zip(class_colours(layer.breaks, layer.ramp), labels, strict=True)))
        values = class_numbers(values, layer.breaks)
    factor = -(-max(view.grid.shape) // _DOTS)
    shown = values[::factor, ::factor]
    image = np.zeros((*shown.shape, 4))
    row, col = np.indices(shown.shape)
    for value, (colour, _) in entries.items():
        here = shown == value
        image[here] = (*(c / 255.0 for c in rgb(colour)), 1.0)
        if value in striped:
            image[here & ((row + col) % _STRIPE >= _STRIPE // 2)] = 1.0
    legend = [
        (colour, translated(phrase(label)), value in striped)
        for value, (colour, label) in sorted(entries.items())
    ]
    return {
        "title": translated(layer.title),
        "note": translated(layer.note),
        "picture": data_uri(_png(image)),
        "legend": legend[::-1],
    }


def _cells(
    grid: Grid,
    hazard: MapHazard | None,
    contributions: Sequence[Contribution],
    by_stem: Mapping[str, RasterLayer],
) -> dict[str, Any]:
    """Return the values on the page of each cell that blocks reach."""
    shape = grid.shape
    of_blocks = np.nan_to_num(by_stem["passages"].bands[0].values.ravel().astype(np.float64))
    rate = np.zeros(of_blocks.size)
    if hazard is not None:
        rate[hazard.curves.places] = hazard.curves.rate[:, 0]
    factor = 1
    while np.count_nonzero((rate > 0.0) | (of_blocks > 0.0)) > _CELLS * factor**2:
        factor += 1
    cells = strongest_cells(rate + 1e-12 * of_blocks, shape, factor)

    def column(stem: str, name: str, factor: float = 1.0) -> str:
        return _packed(in_steps(factor * _band(by_stem[stem], name, cells)))

    sources, shares = largest_shares(contributions, cells)
    return {
        "places": _packed(np.diff(_squares(cells, shape, factor), prepend=0).astype(np.uint32)),
        "count": int(cells.size),
        "factor": factor,
        "grid": (grid.west, grid.north, grid.cell_size, -(-shape[1] // factor)),
        "counts": [
            (
                translated(_LABELS[stem]),
                "%" if stem == "reach_probability" else "",
                column(stem, name, 100.0 if stem == "reach_probability" else 1.0),
            )
            for stem, name in _COUNTS
        ],
        "quantiles": [
            (
                translated(_LABELS[stem]),
                by_stem[stem].bands[0].unit,
                [column(stem, name) for name in _BANDS],
            )
            for stem in _QUANTILES
        ],
        "names": [f"{area}, {scenario}" for area, scenario, *_ in contributions],
        "sources": [_packed(column) for column in sources.T],
        "shares": [_packed(column) for column in shares.T],
        "hazard": _hazard(hazard, by_stem, cells),
    }


def _band(layer: RasterLayer, name: str, cells: IntArray) -> FloatArray:
    """Return values of a band at some cells; 0 where there is none."""
    band = next(b for b in layer.bands if b.name == name)
    return np.nan_to_num(band.values.ravel()[cells].astype(np.float64))


def _squares(cells: IntArray, shape: tuple[int, int], factor: int) -> IntArray:
    """Find in which square of so many cells each cell lies, counted row by row."""
    row, col = np.divmod(cells, shape[1])
    numbers: IntArray = (row // factor) * -(-shape[1] // factor) + col // factor
    return numbers


def strongest_cells(strength: FloatArray, shape: tuple[int, int], factor: int) -> IntArray:
    """Return the cell of the largest strength of each square of so many cells that has any."""
    cells = np.flatnonzero(strength > 0.0)
    if factor == 1:
        return cells
    square = _squares(cells, shape, factor)
    order = np.lexsort((cells, -strength[cells], square))
    first = np.diff(square[order], prepend=-1) > 0
    chosen: IntArray = cells[order[first]]
    return chosen


def _hazard(
    hazard: MapHazard | None, by_stem: Mapping[str, RasterLayer], cells: IntArray
) -> dict[str, Any] | None:
    """Return curve, level and certainty of each cell."""
    if hazard is None:
        return None
    curves = hazard.curves
    at = np.minimum(np.searchsorted(curves.places, cells), max(curves.places.size - 1, 0))
    known = curves.places[at] == cells if curves.places.size else np.zeros(cells.size, bool)
    columns = [curves.column(e) for e in _curve_energies(hazard)]
    rate = np.where(known[:, None], curves.rate[at][:, columns], 0.0)

    def band(stem: str, name: str) -> FloatArray:
        return _band(by_stem[stem], name, cells)

    periods = [f"{years:g}" for years in hazard.preset.return_periods]
    return {
        "rates": [_packed(in_steps(column)) for column in rate.T],
        "level": _packed(band("hazard_level", "level").astype(np.uint16)),
        "lowest": _packed(band("confidence", "lowest_level").astype(np.uint16)),
        "highest": _packed(band("confidence", "highest_level").astype(np.uint16)),
        "change": _packed(in_steps(band("confidence", "change_chance"))),
        "energies": [
            [years, _packed(in_steps(band("energy_at_return_period", f"e{years}")))]
            for years in periods
        ],
    }


def _curve_energies(hazard: MapHazard) -> list[float]:
    """Return energies of the curves on the page: evenly chosen, the thresholds among them."""
    known = hazard.curves.energies_kj
    even = known[np.unique(np.linspace(0, known.size - 1, _ENERGIES).round().astype(int))]
    return sorted({*even.tolist(), *map(float, hazard.preset.thresholds_kj)})


def _curve_facts(hazard: MapHazard | None) -> dict[str, Any] | None:
    """Return the facts common to the curves of all cells."""
    if hazard is None:
        return None
    preset = hazard.preset
    return {
        "energies": _curve_energies(hazard),
        "thresholds": [float(t) for t in preset.thresholds_kj if t > 0.0],
        "periods": list(preset.return_periods),
        "levels": [
            [level.colour, translated(phrase(level.label)), level.hatched]
            for level in preset.levels
        ],
        "width": hazard.ref_width_m,
    }  # fmt: skip


def largest_shares(
    contributions: Sequence[Contribution], cells: IntArray
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Return the sources that most comes from at each cell, and their shares in thousandths."""
    best = np.zeros((cells.size, _SOURCES))
    which = np.zeros((cells.size, _SOURCES), np.uint16)
    total = np.zeros(cells.size)
    # Those of squares are in the order of the squares.
    order = np.argsort(cells)
    for number, (*_, reached, often) in enumerate(contributions if cells.size else ()):
        found = np.searchsorted(cells, reached, sorter=order)
        at = order[np.minimum(found, cells.size - 1)]
        here = cells[at] == reached
        weight = np.zeros(cells.size)
        weight[at[here]] = often[here]
        total += weight
        new = np.full(cells.size, number, np.uint16)
        for place in range(_SOURCES):
            earlier = (weight == best[:, place]) & (new < which[:, place])
            more = (weight > best[:, place]) | earlier
            weight, best[:, place] = (
                np.where(more, best[:, place], weight),
                np.where(more, weight, best[:, place]),
            )
            new, which[:, place] = (
                np.where(more, which[:, place], new),
                np.where(more, new, which[:, place]),
            )
    shares = np.rint(1000.0 * best / np.where(total > 0.0, total, 1.0)[:, None])
    return which, shares.astype(np.uint16)


def in_steps(values: FloatArray) -> NDArray[np.uint16]:
    """Return values as steps of their logarithm; 0 for what is not above 0."""
    above = values > 0.0
    power = np.log10(np.where(above, values, 1.0)) - _LEAST
    steps = np.clip(np.rint(_STEPS * power), 0.0, 65_534.0)
    return np.where(above, steps + 1.0, 0.0).astype(np.uint16)


def _packed(values: NDArray[Any]) -> str:
    """Return numbers of a type that the page knows, compressed, as text."""
    plain = values.astype(values.dtype.newbyteorder("<")).tobytes()
    return base64.b64encode(zlib.compress(plain)).decode("ascii")


def _shape(
    kind: str, name: str, geometry: Any, rows: Rows, colour: str = "", curve: Iterable[Any] = ()
) -> dict[str, Any]:
    """Return a geometry (lines, rings with their holes, or points) with its rows."""
    parts = []
    for part in shapely.get_parts(geometry):
        if isinstance(part, shapely.Polygon):
            parts.append([_points(ring) for ring in (part.exterior, *part.interiors)])
        else:
            parts.append([_points(part)])
    plain = {"Point": "point", "LineString": "line"}
    form = plain.get(shapely.get_parts(geometry)[0].geom_type, "area")
    said = [[translated(key), translated(value)] for key, value in rows]
    return {
        "kind": kind, "name": name, "form": form, "parts": parts, "rows": said, "colour": colour,
        "curve": [[float(f"{e:.5g}"), float(f"{r:.5g}")] for e, r in curve],
    }  # fmt: skip


def _points(geometry: Any) -> list[list[float]]:
    points: list[list[float]] = np.round(shapely.get_coordinates(geometry), 1).tolist()
    return points


def _shapes(
    run: MapRun,
    areas: Sequence[tuple[str, Any, Rows]],
    objects: Sequence[MapObject],
    places: Mapping[tuple[str, str], PlaceFacts],
    hazard: MapHazard | None,
) -> list[dict[str, Any]]:
    """Return zones, release areas, objects, stations and barriers: what lies on top comes last."""
    found = []
    if hazard is not None:
        levels = hazard.preset.levels
        found += [
            _shape("zone", translated(phrase(levels[k].label)), polygon, rows, levels[k].colour)
            for k, polygon, rows in hazard.zones
        ]
        found += [_shape(*mark) for mark in hazard.marks]
    found += [_shape("release", name, geometry, rows) for name, geometry, rows in areas]
    placed = [("object", name, geometry) for name, geometry in objects]
    placed += [(c.kind, c.name, shapely.LineString(trace)) for c, trace in run.control_lines]
    for kind, name, geometry in placed:
        rows, curve = places.get((kind, name), ((), ()))
        found.append(_shape(kind, name, geometry, rows, curve=curve))
    return found


def _envelope(layer: VectorLayer, grid: Grid) -> list[dict[str, Any]]:
    """Return the energy line as a shape, its steps of cells smoothed."""
    frame = layer.frame
    lines = frame.geometry.simplify(grid.cell_size)
    return [
        _shape("energy_line", "", line, (("reach angle", f"{angle:.1f}°"),))
        for angle, line in zip(frame["angle_deg"], lines, strict=True)
    ]


def _some(values: Any, most: int) -> Any:
    """Return at most so many of some values, evenly chosen."""
    return [values[i] for i in even_choice(len(values), most)]


def _paths(paths: Sequence[BlockPath], ground: Grid, speed: RasterLayer) -> dict[str, Any]:
    """Return where blocks are at equal steps of time, and how fast (0.1 m, 0.1 m/s)."""
    step = max(_STEP_S, sum(path.t[-1] for path in paths) / _PLACES)
    found = [frames(path, step) for path in paths]
    x, y, z, speeds = np.concatenate(found, axis=1) if found else np.empty((4, 0))
    column, row = ground.col_row(x, y)
    below = ndimage.map_coordinates(ground.values, [row, column], order=1, mode="nearest")
    above = np.nan_to_num(z - below)
    low = [
        float(np.floor(values.min(initial=np.inf))) if len(paths) else 0.0 for values in (x, y, z)
    ]
    tenths = [10.0 * (values - least) for values, least in zip((x, y, z), low, strict=True)]
    return {
        "step": step,
        "low": low,
        "columns": [
            _packed(np.diff(np.rint(values).astype(np.uint32), prepend=np.uint32(0)))
            for values in (*tenths, 10.0 * np.maximum(above, 0.0), 10.0 * speeds)
        ],
        "limits": [float(limit) for limit in speed.breaks],
        "colours": class_colours(speed.breaks, _FAST),
        "labels": class_labels(speed.breaks, speed.bands[0].unit),
        "blocks": [
            {
                "area": path.area,
                "scenario": path.scenario,
                "count": places.shape[1],
                "rows": [
                    (translated("reason for stopping"), translated(STOP_TEXT[path.reason])),
                    (translated("mass"), f"{sensible(path.mass_kg)} kg"),
                    (translated("run-out chainage"), f"{path.runout_m:.0f} m"),
                    (translated("duration"), f"{path.time_s:.1f} s"),
                    (translated("largest speed"), f"{path.max_speed_mps:.1f} m/s"),
                    (translated("largest energy"), f"{sensible(path.max_energy_kj)} kJ"),
                    (translated("largest passing height"), f"{path.max_height_m:.1f} m"),
                ],
            }
            for path, places in zip(paths, found, strict=True)
        ],
    }


def frames(path: BlockPath, step_s: float) -> FloatArray:
    """Return x, y, z (m) of a block at equal steps of time, and its speed after each (m/s).

    Shape (4, n). The speed is the length of the path over the step; the block ends within the last.
    """
    t = path.t - path.t[0]
    wanted = np.arange(math.ceil(t[-1] / step_s) + 1) * step_s
    way = np.hypot(np.hypot(np.diff(path.x), np.diff(path.y)), np.diff(path.z))
    length = np.append(0.0, np.cumsum(way))
    x, y, z, s = (np.interp(wanted, t, values) for values in (path.x, path.y, path.z, length))
    # The centre steps up or down by some centimetres where a flight ends in rolling.
    speed = np.minimum(np.append(np.diff(s), 0.0) / step_s, path.max_speed_mps)
    return np.array([x, y, z, speed])
