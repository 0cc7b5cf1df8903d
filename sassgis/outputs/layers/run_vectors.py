"""The layers of the GeoPackage: tables with their meaning, units and style."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import rasterio.features
import shapely
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from rasterio.errors import NotGeoreferencedWarning
from scipy import ndimage

from sassgis.files.vector_layer import VectorLayer, described_layer
from sassgis.grid import FloatArray, Grid
from sassgis.hazard.sources import ReachAngles, below_energy_line, stated_angles
from sassgis.inputs.dem import affine_of
from sassgis.settings import styles
from sassgis.settings.languages import phrase
from sassgis.settings.map_run import MapRun, ReleaseArea
from sassgis.settings.results import (
    LINE_END_TEXT,
    STOP_TEXT,
    LineEnd,
    RasterLayer,
    StopReason,
)
from sassgis.simulation.accumulators import Progress, joined_lines, kept_stops
from sassgis.simulation.control_lines import (
    BARRIER_OUTCOMES,
    FORCE,
    OF_ALL,
    LineParts,
    control_line_rows,
)
from sassgis.simulation.path_sample import BlockPath
from sassgis.terrain.prepare import Plan

# rasterio silences this for its arrays while it reads them; another thread may undo that meanwhile.
warnings.filterwarnings("ignore", category=NotGeoreferencedWarning, module="rasterio.features")

#: Legend text and colour by value.
Colours = dict[str | int, tuple[str, str]]

_STOP_COLOUR = {
    StopReason.REST: "#1f4e79",
    StopReason.BARRIER: "#e07b00",
    StopReason.LEFT_PROFILE: "#c1121f",
    StopReason.STEP_LIMIT: "#7b2cbf",
    StopReason.NEVER_STARTED: "#8d99ae",
    StopReason.BROKEN: "#5f0f40",
}
#: Decimals of what single blocks reach.
_DIGITS = {
    "runout_m": 2, "time_s": 2, "mass_kg": 1, "max_energy_kj": 2, "max_speed_mps": 2,
    "max_height_m": 2,
}  # fmt: skip
#: Levels of the footprint: every cell reached, and shares of all blocks.
FOOTPRINT_LEVELS = (0.0, 0.001, 0.01)
_FOOTPRINT_COLOUR = ("#fed976", "#fd8d3c", "#bd0026")
#: Beyond these ends of a fall line nothing is known of the blocks.
_LINE_CUT = (LineEnd.LEFT_DEM, LineEnd.NODATA, LineEnd.MAX_LENGTH)


def release_areas(run: MapRun, planned: Plan) -> VectorLayer:
    """Return the release areas with what was released in them."""
    area, n = planned.points.area, len(run.areas)
    rocks = np.bincount(area, weights=planned.blocks_of_point(run), minlength=n)
    return released_from(run.areas, np.bincount(area, minlength=n), rocks, run.grid.crs)


def released_from(
    areas: Sequence[ReleaseArea], points: ArrayLike, rocks: ArrayLike, crs: str
) -> VectorLayer:
    """Return the release areas with the numbers of their release points and blocks."""
    columns = {
        "name": [a.name for a in areas],
        "scenarios": [";".join(a.scenarios) for a in areas],
        "points": np.asarray(points, np.int64),
        "rocks": np.asarray(rocks, np.int64),
    }
    shapes = [a.geometry if a.geometry.area > 0 else a.geometry.buffer(1.0) for a in areas]
    return described_layer("release_areas", columns, shapes, crs, styles.RELEASE_AREA_STYLE)


def proposed_areas(
    patches: NDArray[np.int32],
    grid: Grid,
    slopes: FloatArray,
    rock: NDArray[np.bool_] | None = None,
) -> VectorLayer:
    """Return patches of steep cells as polygons with what was measured on them.

    All have the shape of the grid: numbers of patches (from 1; 0 elsewhere), slopes (degrees),
    cells that the ground map calls rock.
    """
    numbers = np.arange(1, int(patches.max(initial=0)) + 1)
    shapes = {number: outline for outline, number in cell_outlines(patches, affine_of(grid))}
    area = grid.cell_size**2

    def of(values: FloatArray, how: Callable[..., FloatArray]) -> FloatArray:
        return np.asarray(how(values, patches, numbers), float).reshape(numbers.size)

    measured = {
        "area_m2": of(np.full(grid.shape, area), ndimage.sum_labels),
        "surface_m2": of(area / np.cos(np.radians(slopes)), ndimage.sum_labels),
        "height_m": of(grid.values, ndimage.maximum) - of(grid.values, ndimage.minimum),
        "slope_mean_deg": of(slopes, ndimage.mean),
        "slope_max_deg": of(slopes, ndimage.maximum),
    }
    if rock is not None:
        measured["rock_share"] = of(rock.astype(float), ndimage.mean)
    columns: dict[str, Any] = {"name": [f"cliff {n}" for n in numbers]}
    columns |= {name: np.round(values, 3) for name, values in measured.items()}
    outlines, style = [shapes[int(n)] for n in numbers], styles.RELEASE_AREA_STYLE
    return described_layer("release_areas.proposed", columns, outlines, grid.crs, style)


#: Colour of each item of the check of a terrain model that has a place on the map.
_DEFECTS = {
    "nodata": "#b2182b", "steepness": "#762a83", "spikes": "#e66101", "pits": "#2166ac",
    "depressions": "#67a9cf", "extent": "#1b7837",
}  # fmt: skip


def defective_cells(found: Mapping[str, FloatArray], transform: Affine, crs: str) -> VectorLayer:
    """Return patches of cells that a check of the terrain objects to, by its items.

    Each array has the shape of the terrain model: how much is wrong with a cell, 0 for nothing.
    """
    rows: list[tuple[str, int, float]] = []
    outlines = []
    for item, wrong in found.items():
        patches, count = ndimage.label(wrong > 0.0)
        numbers = np.arange(1, count + 1)
        sizes = np.bincount(patches.ravel(), minlength=count + 1)
        most = np.asarray(ndimage.maximum(wrong, patches, numbers), float).reshape(count)
        for outline, number in cell_outlines(patches, transform):
            rows.append((item, int(sizes[number]), round(float(most[number - 1]), 2)))
            outlines.append(outline)
    columns = pd.DataFrame(rows, columns=["item", "cells", "largest"])
    symbol = styles.Symbol("fill", "#999999", outline="#222222", outline_mm=0.3)
    legend: Colours = {item: (item, colour) for item, colour in _DEFECTS.items()}
    style = styles.categorised_style(symbol, "item", legend)
    return described_layer("dem_defects", columns, outlines, crs, style)


def release_points(run: MapRun, planned: Plan) -> VectorLayer:
    """Return the release points."""
    points = planned.points
    columns = {
        "area": [points.area_names[a] for a in points.area],
        "rocks": planned.blocks_of_point(run),
    }
    at = shapely.points(points.x, points.y)
    return described_layer("release_points", columns, at, run.grid.crs, styles.RELEASE_POINT_STYLE)


def fall_lines(run: MapRun, planned: Plan, progress: Progress) -> VectorLayer:
    """Return fall lines with length, drop and why they end."""
    lines = joined_lines(progress.lines)
    sizes = np.diff(lines.offset)
    # A line of one point has no length; it is drawn as a dot of zero length.
    copies = np.repeat(np.where(sizes == 1, 2, 1), sizes)
    x, y = np.repeat(lines.x, copies), np.repeat(lines.y, copies)
    index = np.repeat(np.repeat(np.arange(sizes.size), sizes), copies)
    columns = {
        "area": [planned.points.area_names[planned.points.area[p]] for p in lines.point],
        "length_m": np.round(lines.length_m, 3),
        "drop_m": np.round(lines.drop_m, 3),
        "ends_at": [LINE_END_TEXT[LineEnd(int(e))] for e in lines.end],
    }
    colours: Colours = {
        text: (text, "#c1121f" if end in _LINE_CUT else styles.FALL_LINE_STYLE.symbol.colour)
        for end, text in LINE_END_TEXT.items()
    }
    shapes: Any = shapely.linestrings(x, y, indices=index) if x.size else []
    plain = styles.FALL_LINE_STYLE
    style = styles.categorised_style(plain.symbol, "ends_at", colours, plain.smallest_scale)
    return described_layer(
        "fall_lines", columns, shapes, run.grid.crs, style, smoothing_m=run.terrain.smoothing_m
    )


def stops(run: MapRun, planned: Plan, progress: Progress) -> VectorLayer:
    """Map where single blocks end: all of them, or an even share of all."""
    total = int(progress.reasons.sum()) + progress.pieces
    rows = kept_stops(run, progress)
    on_map = np.isfinite(rows.x) & np.isfinite(rows.y)
    rocks = rows.rocks[on_map]
    areas, area = planned.points.area_names, planned.points.area
    columns = {
        "area": [areas[area[i]] for i in rocks["line"]],
        "scenario": [run.blocks[k].name for k in rows.rock_scenario[on_map]],
        "end": [STOP_TEXT[StopReason(int(r))] for r in rocks["reason"]],
        **{k: np.round(rocks[k], n) for k, n in _DIGITS.items() if k != "time_s"},
        "impacts": rocks["impacts"].astype(np.int64),
        "piece": rocks["piece"].astype(np.int64),
    }
    which = phrase("All {} blocks.", total)
    if rows.rocks.size != total:
        which = phrase("{} of {} blocks, chosen at random.", rows.rocks.size, total)
    colours: Colours = {text: (text, _STOP_COLOUR[reason]) for reason, text in STOP_TEXT.items()}
    style = styles.categorised_style(
        styles.STOP_STYLE.symbol, "end", colours, styles.STOP_STYLE.smallest_scale
    )
    places = shapely.points(rows.x[on_map], rows.y[on_map])
    return described_layer("stops", columns, places, run.grid.crs, style, which=which)


def block_paths(paths: Sequence[BlockPath], crs: str) -> VectorLayer:
    """Return paths of single blocks, with heights; ``crs`` is empty for local coordinates."""
    columns = {
        "area": [p.area for p in paths],
        "scenario": [p.scenario for p in paths],
        "end": [STOP_TEXT[p.reason] for p in paths],
        **{
            k: np.array([round(getattr(p, k), n) for p in paths], float) for k, n in _DIGITS.items()
        },
    }
    shapes = [shapely.LineString(np.column_stack([p.x, p.y, p.z])) for p in paths]
    style = styles.VectorStyle(styles.Symbol("line", "#d9480f", opacity=0.8, size_mm=0.3))
    return described_layer("paths", columns, shapes, crs, style)


_OUTCOMES = [o.name.lower() for o in BARRIER_OUTCOMES]
_FORCES = [f"{FORCE}_{name}" for name in ("q95", "q99", "max")]


def control_line_layers(
    run: MapRun, progress: Progress, parts: LineParts = ()
) -> list[VectorLayer]:
    """Return stations, and barriers, with the statistics of the blocks that reach them.

    With ``parts`` these are of blocks that count by their frequency.
    """
    rows = control_line_rows(progress.control_lines, parts)
    kinds = [line.kind for line, _ in run.control_lines]
    # Walls and nets are in every legend, galleries where there are some.
    signs = {"wall", "net", *kinds}
    stations = [i for i, kind in enumerate(kinds) if kind == "station"]
    barriers = [i for i, kind in enumerate(kinds) if kind != "station"]
    statistics = [f"{q}_{n}" for q in OF_ALL for n in ("q50", "q95", "q99", "mean", "max")]
    protection = ["height_m", "capacity_kj", "hits", *_OUTCOMES, *_FORCES]
    layers = []
    for key, style, chosen, more in (
        ("stations", styles.STATION_STYLE, stations, []),
        ("barriers", styles.BARRIER_STYLE.showing(signs), barriers, protection),
    ):
        columns: dict[str, object] = {}
        for column in ("name", "kind", "rocks", *more, *statistics):
            values = [rows[i].get(column) for i in chosen]
            if column in ("name", "kind"):
                columns[column] = values
            elif column in ("rocks", "hits", *_OUTCOMES):
                columns[column] = np.array(values, np.int64)
            else:
                columns[column] = np.array([np.nan if v is None else v for v in values], float)
        shapes = [shapely.LineString(run.control_lines[i][1]) for i in chosen]
        layers.append(described_layer(key, columns, shapes, run.grid.crs, style))
    return layers


def cell_outlines(numbers: NDArray[Any], transform: Affine) -> Iterator[tuple[Any, int]]:
    """Yield outline and number of patches of cells (no diagonals) with a number above 0."""
    patches = rasterio.features.shapes(numbers, numbers > 0, connectivity=4, transform=transform)
    for outline, value in patches:
        yield shapely.geometry.shape(outline), int(value)


def footprints(
    probability: NDArray[np.float32], grid: Grid, levels: Sequence[float]
) -> dict[float, Any]:
    """Return areas where the reach probability is at least each of some levels, ascending.

    The probability has the shape of the grid and is NaN where no block arrives. Level 0 means every
    cell that a block reaches. Levels that no cell has are left out.
    """
    outlines = {}
    for level in sorted(levels):
        reached = (np.nan_to_num(probability, nan=-1.0) >= max(level, 1e-300)).astype(np.uint8)
        if parts := [part for part, _ in cell_outlines(reached, affine_of(grid))]:
            outlines[float(level)] = shapely.MultiPolygon(list(shapely.get_parts(parts)))
    return outlines


def _footprint_label(level: float) -> str:
    if level == 0.0:
        return "reached by a block"
    return phrase("reach probability {} % or more", f"{100 * level:g}")


def footprint(run: MapRun, layers: Sequence[RasterLayer]) -> VectorLayer:
    """Return the outline of the cells that blocks reach, and of higher reach probabilities."""
    reach = next(layer for layer in layers if layer.stem == "reach_probability")
    outlines = footprints(reach.bands[0].values, run.grid, FOOTPRINT_LEVELS)
    columns = {
        "label": [_footprint_label(level) for level in outlines],
        "level": np.array(list(outlines), float),
        "area_m2": np.array([outline.area for outline in outlines.values()], float),
        "ref_width_m": np.full(len(outlines), run.grid.cell_size),
    }
    labels = [_footprint_label(level) for level in FOOTPRINT_LEVELS]
    colours: Colours = {x: (x, colour) for x, colour in zip(labels, _FOOTPRINT_COLOUR, strict=True)}
    style = styles.categorised_style(styles.FOOTPRINT_STYLE.symbol, "label", colours)
    shapes, width = list(outlines.values()), run.grid.cell_size
    return described_layer("footprint", columns, shapes, run.grid.crs, style, ref_width_m=width)


def energy_line(run: MapRun, planned: Plan, angles: ReachAngles) -> VectorLayer:
    """Return the ground below the line of the reach angle that 99 % of the blocks stop above."""
    shapes, stated = [], stated_angles(angles.reach_deg)[:1]
    for angle in stated:
        points = planned.points
        below = below_energy_line(run.heights, points.x, points.y, float(angle))
        parts = [part for part, _ in cell_outlines(below.astype(np.uint8), affine_of(run.grid))]
        shapes.append(shapely.MultiPolygon(parts))
    columns = {
        "angle_deg": np.round(stated, 2),
        "area_m2": np.array([shape.area for shape in shapes], float),
    }
    return described_layer("energy_line", columns, shapes, run.grid.crs, styles.ENERGY_LINE_STYLE)


def all_layers(
    run: MapRun,
    planned: Plan,
    progress: Progress,
    layers: Sequence[RasterLayer],
    parts: LineParts = (),
) -> list[VectorLayer]:
    """Return the layers of ``result.gpkg``; ``layers`` are the maps of the blocks.

    ``parts`` are those of control_line_layers.
    """
    return [
        release_areas(run, planned),
        release_points(run, planned),
        fall_lines(run, planned, progress),
        stops(run, planned, progress),
        *control_line_layers(run, progress, parts),
        footprint(run, layers),
    ]
