"""Exposed objects from vector files, the cells that they stand on, and their vulnerability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import shapely
from shapely.ops import substring

from sassgis.errors import InputError, notice
from sassgis.grid import Grid, IntArray
from sassgis.inputs.csv_table import CsvColumn, errors_of_row, read_table
from sassgis.inputs.vector_features import Feature, nearest, refuse_twice, without_repeats
from sassgis.inputs.vectors import check_on_map, named_features
from sassgis.settings.exposure import (
    NUMBERS_OF_KIND,
    VULNERABILITY_KINDS,
    ExposedObject,
    ObjectSettings,
    PlacedObjects,
    Traffic,
    Vulnerability,
    VulnerabilityRow,
)
from sassgis.settings.results import TraceSet
from sassgis.settings.schema import Input
from sassgis.terrain.cells import cell_stretches

_SHAPES: Mapping[str, tuple[str, ...]] = {
    "building": ("polygon", "point"),
    "people": ("point", "polygon"),
    "road": ("line",),
    "line": ("line",),
}
_TRAFFIC = ("traffic_per_day", "speed_kmh", "vehicle_length_m", "persons_per_vehicle")
_ROAD_USE = (*_TRAFFIC, "vehicle_value", "trips_per_day")
#: Shorter stretches, in cells, could be left without a separate cell.
_LEAST_CELLS = 3.0
#: More stretches than this are a slip in a coordinate.
_MOST_STRETCHES = 50_000
#: Sharing no more than this much of a cell's side is touching its border, not the cell.
_BORDER = 1e-6


def read_objects(settings: ObjectSettings, grid: Grid) -> PlacedObjects:
    """Read a layer of exposed objects; roads and lines are cut into stretches of equal length.

    An attribute goes before a number for all, which holds where the attribute is empty. Buildings
    and people are hit by blocks whose centre comes within ``radius_m``: half the width of a block,
    or the reach of people given as points. The objects are in the order of the file, stretches by
    chainage. Stretches outside the DEM are left out, with a notice.
    """
    file, key, kinds = settings.file, _key(settings), _SHAPES[settings.kind]
    _check_settings(settings, grid)
    objects: list[ExposedObject] = []
    geometries: list[Any] = []
    for feature, name in named_features(settings, grid, key, settings.fields, kinds):
        check_on_map(feature, grid, file, f"{key}.file", feature.label)
        whole = _object(name, _numbers(feature, settings), feature.label, settings)
        if feature.kind == "line":
            parts = _stretches(whole, feature.geometry, settings.segment_m, grid, file)
        else:
            around = settings.radius_m
            wide = feature.geometry.buffer(around) if around > 0.0 else feature.geometry
            parts = [(whole, wide)]
        objects += [thing for thing, _ in parts]
        geometries += [shape for _, shape in parts]
    placed = PlacedObjects(tuple(objects), tuple(geometries))
    _check_names([placed], file)
    _warn(placed, grid, file)
    return placed


def joined_objects(parts: Sequence[PlacedObjects], file: Input | None = None) -> PlacedObjects:
    """Return all objects of a run, in the order of the parts."""
    _check_names(parts, file)
    return PlacedObjects(
        tuple(o for part in parts for o in part.objects),
        tuple(g for part in parts for g in part.geometries),
    )


def _check_names(parts: Sequence[PlacedObjects], file: Input | None) -> None:
    """Check that only stretches of one road share a name."""
    names: list[str] = []
    for part in parts:
        names += [o.name for o in part.objects]
        names += dict.fromkeys(o.parent for o in part.objects if o.parent)
    expected = "names that differ, over all entries of [[objects]]"
    refuse_twice(names, expected, file=file, field="objects")


def _key(settings: ObjectSettings) -> str:
    """Return the name of a section in messages."""
    return f"objects[{settings.name}]"


def _check_settings(settings: ObjectSettings, grid: Grid) -> None:
    """Check that the numbers go with the kind, and stretches with the cells."""
    wrong, numbers = partial(InputError, file=settings.file), NUMBERS_OF_KIND[settings.kind]
    for name in (*settings.defaults, *settings.fields):
        if name not in numbers:
            problem, field = f"does not go with kind {settings.kind}", f"{_key(settings)}.{name}"
            raise wrong(problem, field=field, expected=nearest(name, numbers))
    least = _LEAST_CELLS * grid.cell_size
    if _SHAPES[settings.kind] == ("line",) and not settings.segment_m >= least:
        raise wrong(
            "stretches would be too short for the cells of the DEM",
            field=f"{_key(settings)}.segment_m", found=f"{settings.segment_m:g}",
            expected=f"{least:g} m or more ({_LEAST_CELLS:g} cells)",
        )  # fmt: skip


def _numbers(feature: Feature, settings: ObjectSettings) -> dict[str, float]:
    """Return the numbers of one feature by name, those that are stated."""
    columns, defaults = settings.fields, settings.defaults
    values: dict[str, float] = {}
    for name in NUMBERS_OF_KIND[settings.kind]:
        column = columns.get(name)
        if column is not None and feature.text(column) is not None:
            values[name] = feature.value(column)
        elif name in defaults:
            values[name] = defaults[name]
        elif column is not None:
            expected = f"a number, or {_key(settings)}.{name} for features without one"
            raise feature.wrong("has no value", column, expected=expected)
    return values


def _object(
    name: str, values: Mapping[str, float], label: str, settings: ObjectSettings
) -> ExposedObject:
    own: dict[str, Any] = dict(values)
    try:
        traffic = None
        if settings.kind == "road":
            flow = {k: own.pop(k) for k in values if k in _ROAD_USE}
            traffic = _traffic(flow, label, settings)
        return ExposedObject(name, settings.kind, traffic=traffic, **own)
    except InputError as error:
        if error.file is not None:
            raise
        field = str(error.field)
        field = settings.fields.get(field, f"{_key(settings)}.{field}")
        problem = f"{label}: {error.problem}"
        raise InputError(**error.parts(problem=problem, file=settings.file, field=field)) from None


def _traffic(values: Mapping[str, float], label: str, settings: ObjectSettings) -> Traffic | None:
    """Return the traffic of a road; None where no vehicles are stated."""
    if not values or values.get("traffic_per_day") == 0.0:
        return None
    problem = "has traffic, but not all of its numbers"
    if "traffic_per_day" not in values:
        problem = "has vehicles, but nothing says how many"
    for name in _TRAFFIC:
        if name not in values:
            raise InputError(
                f"{label} {problem}", file=settings.file, field=f"{_key(settings)}.{name}",
                found=", ".join(values), expected=f"{name} or {name}_field as well",
            )  # fmt: skip
    return Traffic(**values)


def _warn(placed: PlacedObjects, grid: Grid, file: Input) -> None:
    """Warn of usable values that should be checked."""
    cells, owner = object_cells(placed, grid)
    known = np.isfinite(grid.values[np.divmod(cells, grid.shape[1])])
    n_known = np.bincount(owner, weights=known, minlength=len(placed))
    n_cells = np.bincount(owner, minlength=len(placed))
    warned: set[str] = set()
    for i, thing in enumerate(placed.objects):
        if n_cells[i] and not n_known[i]:
            notice(f"{file}: {thing.name} lies on nodata; no block arrives there")
        stake = thing.value or thing.value_per_m or thing.persons or thing.traffic is not None
        if not stake and thing.whole not in warned:
            warned.add(thing.whole)
            notice(
                f"{file}: {thing.whole} has neither value nor people nor traffic: only hits are "
                "counted"
            )
        occupancy = 0.0 if thing.traffic is None else thing.traffic.occupancy
        if occupancy > 1.0 and thing.whole not in warned:
            warned.add(thing.whole)
            notice(
                f"{file}: {thing.whole}: vehicles cover {100.0 * occupancy:.0f} % of the length of "
                "the road, all lanes together"
            )


def _stretches(
    whole: ExposedObject, geometry: Any, segment_m: float, grid: Grid, file: Input
) -> list[tuple[ExposedObject, Any]]:
    """Return equal parts of about ``segment_m``; the chainage runs on over separate parts."""
    line = shapely.line_merge(geometry) if geometry.geom_type.startswith("Multi") else geometry
    parts = list(getattr(line, "geoms", [line]))
    if len(parts) > 1:
        separate = f"{len(parts)} separate parts, one after the other"
        notice(f"{file}: {whole.name} has {separate}", "info")
    if not line.length <= _MOST_STRETCHES * segment_m:
        raise InputError(
            f"{whole.name} has too many stretches", file=file, field="segment_m",
            found=f"a length of {line.length:.4g} m in stretches of {segment_m:g} m",
            expected=f"at most {_MOST_STRETCHES} of them: longer ones, or a shorter line",
        )  # fmt: skip
    spans: list[tuple[float, float, Any]] = []
    start = 0.0
    for part in parts:
        n = max(1, round(part.length / segment_m))
        cuts = np.linspace(0.0, part.length, n + 1)
        spans += [
            (start + cuts[i], start + cuts[i + 1], substring(part, cuts[i], cuts[i + 1]))
            for i in range(n)
        ]
        start += part.length
    names = _chainage_names(whole.name, [(a, b) for a, b, _ in spans])
    box = shapely.box(*grid.bounds)
    rows = [
        (replace(whole, name=name, parent=whole.name, length_m=b - a, from_m=a), shape)
        for name, (a, b, shape) in zip(names, spans, strict=True)
        if shape.intersection(box).length > 0.0
    ]
    if len(rows) < len(spans):
        lost = f"{len(spans) - len(rows)} of {len(spans)} stretches"
        notice(f"{file}: {whole.name}: {lost} lie outside the DEM and are left out")
    return rows


def _chainage_names(name: str, spans: Sequence[tuple[float, float]]) -> list[str]:
    """Return names as 'road 0+000–0+050', with decimals where whole metres do not separate them."""
    names: list[str] = []
    for digits in range(4):
        names = [f"{name} {chainage(a, digits)}–{chainage(b, digits)}" for a, b in spans]
        if len(set(names)) == len(names):
            break
    return names


def chainage(metres: float, digits: int = 0) -> str:
    """Return the chainage as on a road: kilometres, +, metres."""
    km, rest = divmod(round(metres, digits), 1000.0)
    width = 3 if digits == 0 else 4 + digits
    return f"{int(km)}+{rest:0{width}.{digits}f}"


def object_cells(placed: PlacedObjects, grid: Grid) -> tuple[IntArray, IntArray]:
    """Return cells that each object touches.

    The simulation knows an object by these cells: it is up to one cell wider, on each side, than it
    is drawn. A cell may belong to several objects, but to one stretch of a road only: the one that
    is nearest to its centre, so that the cells of the stretches add up to those of the road.

    Both arrays are int64 of shape (n,): flat indices of cells, ascending, and the number of the
    object of each, ascending within a cell.
    """
    found = [_touched(shape, grid) for shape in placed.geometries]
    cells = np.concatenate([np.empty(0, np.int64), *found])
    owner = np.repeat(np.arange(len(found), dtype=np.int64), [f.size for f in found])
    wholes = {name: i for i, name in enumerate(dict.fromkeys(o.whole for o in placed.objects))}
    whole = np.array([wholes[o.whole] for o in placed.objects], np.int64)[owner]
    x, y = grid.cell_centres(cells)
    shapes = np.array(placed.geometries, dtype=object)
    far = shapely.distance(shapes[owner], shapely.points(x, y)) if cells.size else np.empty(0)
    order = np.lexsort((owner, far, cells, whole))
    cells, owner, whole = cells[order], owner[order], whole[order]
    first = np.append(True, (np.diff(cells) != 0) | (np.diff(whole) != 0))[: cells.size]
    cells, owner = cells[first], owner[first]
    order = np.lexsort((owner, cells))
    return cells[order], owner[order]


def _touched(shape: Any, grid: Grid) -> IntArray:
    """Return cells that a geometry shares more with than a border; each once."""
    dimension = int(shapely.get_dimensions(shape))
    if dimension == 0:
        x, y = shapely.get_coordinates(shape).T
        cells = np.unique(grid.cell_of(x, y))
    elif dimension == 1:
        x, y = np.ascontiguousarray(without_repeats(shapely.get_coordinates(shape)).T)
        s = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
        line = TraceSet(
            np.array([0, s.size], np.int64), x, y, s, np.zeros(1, np.int64), np.zeros(1, np.uint8)
        )
        cells = np.unique(cell_stretches(grid, line)[2])
    else:
        return _under_polygon(shape, grid)
    return cells[cells >= 0]


def _under_polygon(shape: Any, grid: Grid) -> IntArray:
    n_rows, n_cols = grid.shape
    size = grid.cell_size
    west, south, east, north = shape.bounds
    first_col, last_col = (int((x - grid.west) // size) for x in (west, east))
    first_row, last_row = (int((grid.north - y) // size) for y in (north, south))
    col = np.arange(max(first_col, 0), min(last_col, n_cols - 1) + 1, dtype=np.int64)
    row = np.arange(max(first_row, 0), min(last_row, n_rows - 1) + 1, dtype=np.int64)
    if not col.size or not row.size:
        return np.empty(0, np.int64)
    shapely.prepare(shape)
    kept = []
    reach = (0.5 - _BORDER) * size
    for i in row.tolist():
        cells = i * n_cols + col
        x, y = grid.cell_centres(cells)
        boxes = shapely.box(x - reach, y - reach, x + reach, y + reach)
        kept.append(cells[shapely.intersects(shape, boxes)])
    return np.concatenate(kept)


def read_vulnerability(file: Input, intensities: Sequence[str]) -> Vulnerability:
    """Read what a hit does to objects of each kind.

    The CSV has the columns kind, intensity, vulnerability, lethality, source; ``intensities`` are
    the codes of the intensity classes, from weak to strong. There is a notice where a number falls
    with the intensity.
    """
    field = "risk.vulnerability"
    columns = {
        "kind": CsvColumn(known=VULNERABILITY_KINDS),
        "intensity": CsvColumn(known=intensities),
        "vulnerability": CsvColumn(float),
        "lethality": CsvColumn(float),
        "source": CsvColumn(),
    }
    rows = []
    for where, row in read_table(file, field, "a table of vulnerability (CSV)", columns):
        with errors_of_row(where, file):
            rows.append(VulnerabilityRow(**row))
    if not rows:
        raise InputError(
            "has no rows", file=file, field=field, expected="a row for each kind and intensity"
        )
    table = Vulnerability(tuple(intensities), tuple(rows), str(file))
    for phrase in table.falling():
        notice(f"{file}: {phrase}")
    return table
