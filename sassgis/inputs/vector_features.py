"""Features of vector files: found, read, checked and brought into the coordinates of the DEM."""

from __future__ import annotations

import difflib
import math
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import shapely
from numpy.typing import NDArray
from pyproj.exceptions import ProjError

from sassgis.errors import InputError, notice
from sassgis.files.digests import Stamp
from sassgis.files.gdal_safety import VECTOR, layers_of, read_frame, vector_file, with_composed
from sassgis.files.input_parts import stamps_of
from sassgis.files.plain_file import check_file, check_text, in_memory, number
from sassgis.grid import Bounds, FloatArray, Grid
from sassgis.inputs.dem import burnt, system_of
from sassgis.inputs.dem_system import beyond_degrees, extent_text
from sassgis.settings.crs import crs_name, crs_parts, same_crs
from sassgis.settings.results import some_of
from sassgis.settings.schema import InMemory, Input, composed

#: What messages and settings call lines.
_LINES = {"linestring": "line", "linearring": "line"}


@dataclass(frozen=True, slots=True)
class Feature:
    """One feature of a layer, in the coordinates of the DEM."""

    number: int  # place in the layer, counted from 1
    attributes: Mapping[str, Any]
    geometry: Any  # valid, not empty, without heights
    kind: str  # "polygon", "line" or "point"
    file: Input | None = None  # what holds the layer
    name_field: str | None = None  # attribute with the names of the features

    def text(self, field: str) -> str | None:
        """Return the attribute as text; None where it is empty, or where the layer has none."""
        return text_of(self.attributes.get(field))

    def value(self, field: str) -> float:
        """Return the attribute as a finite number; InputError otherwise."""
        assert self.file is not None
        return number(self.attributes[field], self.label, field, self.file)

    @property
    def label(self) -> str:
        """How messages speak of the feature."""
        name = self.text(self.name_field) if self.name_field else None
        return f"feature {self.number}" + (f" ({name})" if name else "")

    def wrong(self, problem: str, field: str | None, **detail: Any) -> InputError:
        """Return the error of a feature; ``detail``: keywords of InputError."""
        return InputError(f"{self.label} {problem}", file=self.file, field=field, **detail)


def nearest(name: str, known: Sequence[str]) -> str:
    """Return the known name that may have been meant by an unknown one."""
    if not known:
        return "one that exists, but there is none"
    close = difflib.get_close_matches(name.lower(), [k.lower() for k in known], n=1, cutoff=0.6)
    hint = next((f" (nearest: {k})" for k in known if close and k.lower() == close[0]), "")
    return f"one of {', '.join(known)}{hint}"


def refuse_unknown(name: str, known: Sequence[str], problem: str, **place: Any) -> None:
    """Raise InputError for a name that is not known; ``place`` is its file and field."""
    if name not in known:
        raise InputError(problem, found=repr(name), expected=nearest(name, known), **place)


def _file_key(key: str) -> str:
    """Return the key of the file of a section; an option names its file by itself."""
    return key if key.startswith("--") else f"{key}.file"


def refuse_twice(
    names: Iterable[str],
    expected: str,
    problem: str = "name is used twice",
    error: type[InputError] = InputError,
    **place: Any,
) -> None:
    """Raise an error for a name that is there twice; ``place`` is its file and field."""
    for name, count in Counter(names).items():
        if count > 1:
            raise error(problem, found=repr(name), expected=expected, **place)


def text_of(value: object) -> str | None:
    """Return a cell of a frame as text in one Unicode form, 7.0 as 7; None where it is empty.

    Empty are NaN and pandas.NA, also as text.
    """
    # NA first: what it is compared with is neither true nor false.
    if value is None or str(value) == "<NA>" or bool(value != value):
        return None
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return composed(str(value).strip()) or None


def read_features(
    file: Input,
    grid: Grid,
    key: str,
    *,
    layer: str | None = None,
    fields: Mapping[str, str | None] | None = None,
    label: str | None = None,
    kinds: Sequence[str] = ("polygon", "line", "point"),
    may_be_empty: bool = False,
) -> list[Feature]:
    """Read a layer, check its geometries and bring them into the coordinates of the DEM.

    ``fields`` are attributes that must exist, by the configuration key that names them; ``label``
    is the attribute with the names of the features, for messages; ``kinds`` are the kinds of
    geometry that can be used.
    """
    frame = open_layer(file, layer, key, fields or {}, may_be_empty)
    if not len(frame):
        return []
    return with_shapes(without_shapes(frame, file, label), frame, file, grid, key, kinds)


def with_shapes(
    plain: Sequence[Feature],
    frame: Any,
    file: Input,
    grid: Grid,
    key: str,
    kinds: Sequence[str] = ("polygon", "line", "point"),
) -> list[Feature]:
    """Return features of a layer with their geometries; arguments as of read_features."""
    shapes = [shapely.force_2d(frame.geometry.array[f.number - 1]) for f in plain]
    found = [_checked_kind(f, g, key, kinds) for f, g in zip(plain, shapes, strict=True)]
    moved = onto_grid(shapes, frame.crs, grid, file, key, [f.label for f in plain])
    return [
        replace(f, geometry=g, kind=kind) for f, g, kind in zip(plain, moved, found, strict=True)
    ]


def without_shapes(frame: Any, file: Input, name_field: str | None = None) -> list[Feature]:
    """Return the features of a layer by number and attributes."""
    # pandas 2 has no records of a frame without columns.
    rows = frame.drop(columns=frame.geometry.name).to_dict("records") or [{} for _ in frame.index]
    return [Feature(n, row, None, "", file, name_field) for n, row in enumerate(rows, start=1)]


#: Key of a layer that is kept for the fields whose texts have been checked.
_CHECKED = "checked"


def open_layer(
    file: Input,
    layer: str | None,
    key: str,
    fields: Mapping[str, str | None],
    may_be_empty: bool = False,
) -> Any:
    """Return the layer as a frame with geometry."""
    place = _file_key(key)
    check_file(file, place, VECTOR, folders=True)
    warned: tuple[str, ...] = ()
    if isinstance(file, InMemory):
        frame = with_composed(in_memory(file, "layer", place, "a GeoDataFrame"))
        name = file.name
    else:
        frame, name, warned = _read_layer(file, layer, key, stamps_of(file))
    for text in warned:
        notice(f"{file}: {text}")
    known = [c for c in frame.columns if c != "geometry"]
    for setting, field in fields.items():
        if field == setting and field not in known:
            # Of a layer whose attributes have fixed names.
            raise InputError(
                "attribute is missing", file=file, field=f"layer {name}, {field}",
                found=", ".join(known) or "no attributes", expected=", ".join(fields),
            )  # fmt: skip
        if field is not None:
            refuse_unknown(field, known, "attribute not found", file=file, field=f"{key}.{setting}")
        # Of a layer that is kept once only: a batch asks for each of its features.
        checked = frame.attrs.get(_CHECKED, set())
        if field is not None and field not in checked:
            for number, text in enumerate(frame[field], start=1):
                check_text(text, file, f"layer {name}, {field}", f"feature {number}")
            checked.add(field)
    if len(frame) == 0 and not may_be_empty:
        found, expected = f"layer {name}, which is empty", "at least one feature, drawn and saved"
        raise InputError("holds no feature", file=file, field=place, found=found, expected=expected)
    return frame


@lru_cache(maxsize=4)
def _read_layer(
    file: Path, layer: str | None, key: str, _stamps: tuple[Stamp, ...]
) -> tuple[Any, str, tuple[str, ...]]:
    """Return a layer as a frame, its name, and what GDAL has to say of it.

    A few are kept: a batch takes its release areas one by one from the same layer.
    """
    with vector_file(file, _file_key(key)), warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        name = _choose_layer(layers_of(file), layer, file, key)
        # Geometries that cannot be decoded come as None and are reported by feature.
        frame = read_frame(file, name, on_invalid="ignore")
    frame.attrs[_CHECKED] = set()
    texts = dict.fromkeys(" ".join(str(w.message).split()) for w in warned)
    if frame.crs is None and (beside := file.with_suffix(".prj")).is_file():
        unknown = f"{beside.name} states no coordinate system that is understood"
        texts[f"{unknown}: coordinates are taken to be those of the DEM"] = None
    # Measures along lines are dropped with the heights: nothing is lost.
    return frame, name, tuple(t for t in texts if not t.startswith("Measured"))


def _choose_layer(
    layers: Mapping[str, str | None], wanted: str | None, file: Input, key: str
) -> str:
    wrong, field = partial(InputError, file=file), f"{key}.layer"
    drawn = [name for name, kind in layers.items() if kind is not None]
    own = next((name for name in drawn if wanted is not None and composed(name) == wanted), None)
    if own is not None:
        return own
    if not drawn:
        found = f"layers {', '.join(layers) or 'none'}"
        problem, expected = "holds no layer with geometry", "a layer of polygons, lines or points"
        raise wrong(problem, field=_file_key(key), found=found, expected=expected)
    if wanted is not None:
        expected = nearest(wanted, drawn)
        raise wrong("layer not found", field=field, found=repr(wanted), expected=expected)
    if len(drawn) > 1:
        found, expected = ", ".join(drawn), f"one of them as {field}"
        raise wrong("has several layers", field=field, found=found, expected=expected)
    return drawn[0]


#: Beyond this a coordinate is a slip, in whatever system; computing with it would take for ever.
_FARTHEST = 1e8


def _checked_kind(feature: Feature, shape: Any, key: str, kinds: Sequence[str]) -> str:
    """Return kind of a geometry, in the coordinates of its file so that users find the place."""
    wrong = partial(feature.wrong, field=_file_key(key))
    wanted = "a " + " or ".join(kinds)
    if shape is None or shape.is_empty:
        found = "none" if shape is None else "an empty one"
        raise wrong("has no usable geometry", found=found, expected=wanted)
    kind: str = shape.geom_type.removeprefix("Multi").lower()
    kind = _LINES.get(kind, kind)
    if kind not in kinds:
        raise wrong("is of the wrong kind", found=shape.geom_type, expected=wanted)
    if not np.isfinite(shapely.get_coordinates(shape)).all():
        raise wrong("has a coordinate that is no number", expected="numbers")
    if not (np.abs(shapely.get_coordinates(shape)) <= _FARTHEST).all():
        expected = f"at most {_FARTHEST:g} m or degrees"
        raise wrong("has a coordinate that is no place on Earth", expected=expected)
    if not shape.is_valid:
        raise wrong(
            "is not valid",
            found=shapely.is_valid_reason(shape),
            expected="a geometry that does not cross itself; mend it with QGIS 'Fix geometries'",
        )
    return kind


def onto_grid(
    shapes: Sequence[Any], crs: Any, grid: Grid, file: Input, key: str, labels: Sequence[str]
) -> list[Any]:
    """Return geometries in the coordinates of the DEM; they must meet it somewhere."""
    place = _file_key(key)
    wrong = partial(InputError, file=file, field=place)
    own = None if crs is None else pyproj.CRS.from_user_input(crs)
    if own is not None and own.is_engineering:
        own = None
    # GeoJSON cannot leave its coordinate system out: longitude and latitude are then only implied.
    implied = own is not None and own.is_geographic and file.suffix.lower() in (".geojson", ".json")
    if own is None or (not grid.crs and implied):
        if not _meets(shapes, grid):
            raise wrong(
                "has no coordinate system and does not lie on the DEM",
                found=extent_text(*_bounds(shapes)),
                expected=f"a file with its coordinate system, or coordinates of the DEM: "
                f"{extent_text(*grid.bounds)}",
            )
        notice(f"{file}: states no coordinate system: taken to be that of the DEM", "info")
        return list(shapes)
    target = system_of(grid, own, file, place)
    bounds = _bounds(shapes)
    if own.is_geographic and beyond_degrees(*bounds):
        raise wrong(
            "coordinates cannot be degrees: the file is probably tagged with the wrong system",
            found=f"{own.name} with {extent_text(*bounds)}",
            expected="its true coordinate system",
        )
    plane, _ = crs_parts(own)
    moved, move = list(shapes), None
    if not same_crs(plane, target):
        move = pyproj.Transformer.from_crs(plane, target, always_xy=True)
        expected = f"coordinates that {target.name} can express"
        lost = partial(wrong, found=str(plane.name), expected=expected)
        moved = _reprojected(shapes, move, labels, lost)
        systems = f"from {plane.name} to {crs_name(grid.crs)}"
        notice(f"{file}: reprojected {systems}", "info")
    if not _meets(moved, grid):
        several = f"each of {len(moved)} features, the first {labels[0]},"
        who = labels[0] if len(moved) == 1 else several
        error = outside(file, place, who, _bounds(moved), grid)
        lat, lon = shapely.get_coordinates(list(shapes)).T
        if move and plane.is_geographic and (grid.cell_of(*move.transform(lon, lat)) >= 0).any():
            found, expected = extent_text(*bounds), "longitude first"
            error = wrong("latitude and longitude are swapped", found=found, expected=expected)
        elif move and _meets(shapes, grid):
            error = wrong(
                "lies on the DEM only if it is not reprojected: the file or the DEM states the "
                "wrong coordinate system", found=plane.name, expected=crs_name(grid.crs),
            )  # fmt: skip
        raise error
    return moved


def _reprojected(
    shapes: Sequence[Any], move: pyproj.Transformer, labels: Sequence[str], wrong: Any
) -> list[Any]:
    """Return geometries in other coordinates; ``wrong`` makes an error of a problem."""
    problem = "cannot be brought into the coordinates of the DEM"

    def moved_points(points: FloatArray) -> FloatArray:
        return np.column_stack(move.transform(points[:, 0], points[:, 1]))

    try:
        moved = [shapely.transform(g, moved_points) for g in shapes]
    except ProjError as error:
        raise wrong(problem, found=str(error)) from None
    for shape, who in zip(moved, labels, strict=True):
        if not np.isfinite(shapely.get_coordinates(shape)).all() or not shape.is_valid:
            raise wrong(f"{who} {problem}")
    return moved


def _bounds(shapes: Iterable[Any]) -> Bounds:
    west, south, east, north = shapely.total_bounds(list(shapes)).tolist()
    return west, south, east, north


def _meets(shapes: Sequence[Any], grid: Grid) -> bool:
    return bool(shapely.intersects(np.array(shapes, dtype=object), shapely.box(*grid.bounds)).any())


def outside(file: Input | None, place: str, label: str, bounds: Bounds, grid: Grid) -> InputError:
    """Return the error for a feature beyond the DEM."""
    found, expected = extent_text(*bounds), f"within {extent_text(*grid.bounds)}"
    problem = f"{label} lies outside the DEM"
    return InputError(problem, file=file, field=place, found=found, expected=expected)


def without_repeats(points: FloatArray) -> FloatArray:
    """Return vertices, shape (n, 2), without those that repeat the one before."""
    again = np.append(False, (points[1:] == points[:-1]).all(axis=1))[: len(points)]
    return np.ascontiguousarray(points[~again])


def share_inside(feature: Feature, grid: Grid) -> float:
    """Return the share (0 to 1) of a feature's area, length or number of points within the DEM."""
    box = shapely.box(*grid.bounds)
    if box.covers(feature.geometry):
        return 1.0
    return _share(feature.geometry.intersection(box), feature.geometry)


def share_known(feature: Feature, grid: Grid) -> float:
    """Return the share, as share_inside, within the DEM and where its heights are known."""
    geometry = feature.geometry
    if shapely.get_dimensions(geometry) == 0:
        known = np.isfinite(grid.value_at(*shapely.get_coordinates(geometry).T))
        return float(known.mean())
    rows, cols = _part_under(geometry, grid)
    touched = burnt([(geometry, 1)], grid.part(rows, cols), 0, np.uint8, touched=True)
    row, col = (~np.isfinite(grid.values[rows, cols]) & (touched > 0)).nonzero()
    west = grid.west + grid.cell_size * (cols.start + col)
    north = grid.north - grid.cell_size * (rows.start + row)
    cells = shapely.box(west, north - grid.cell_size, west + grid.cell_size, north)
    known = geometry.intersection(shapely.box(*grid.bounds))
    known = known.difference(shapely.coverage_union_all(cells))
    # Rounded so far that a part of the terrain model gives the same.
    return round(_share(known, geometry), 9)


def _share(part: Any, whole: Any) -> float:
    """Return the share of a part in the area, the length or the number of points of a geometry."""
    sizes = (shapely.get_num_coordinates, shapely.length, shapely.area)
    size = sizes[shapely.get_dimensions(whole)]
    return float(size(part) / size(whole))


def cells_under(
    geometry: Any, grid: Grid, centres_only: bool = False
) -> tuple[slice, slice, NDArray[np.bool_]]:
    """Return the part of the grid that holds a geometry, and which of its cells that covers.

    Rows, columns, and a mask of their shape: cells whose centre lies in a polygon; for points,
    lines and polygons too small to hold a centre, those that they touch, unless ``centres_only``.
    """
    rows, cols = _part_under(geometry, grid)
    part = grid.part(rows, cols)
    mask = burnt([(geometry, 1)], part, 0, np.uint8)
    if not centres_only and (shapely.get_dimensions(geometry) < 2 or not mask.any()):
        mask = burnt([(geometry, 1)], part, 0, np.uint8, touched=True)
    return rows, cols, mask.astype(bool)


def polygon_of_cells(polygons: Sequence[Feature], grid: Grid) -> NDArray[np.int32]:
    """Find the polygon that covers the centre of each cell: its position, -1 for none.

    Where several do, the last one counts. A notice names polygons that count nowhere, or on less
    than half of their area because they are too narrow for the cells.
    """
    shapes = np.array([own.geometry for own in polygons], dtype=object)
    found: NDArray[np.int32] = burnt(
        list(zip(shapes, range(shapes.size), strict=True)), grid, -1, np.int32
    )
    # What reaches into the grid by less than half a cell cannot hold a centre.
    centres = shapely.box(*grid.bounds).buffer(-0.5 * grid.cell_size, join_style="mitre")
    least = 0.5 * shapely.area(shapely.intersection(shapes, centres)) / grid.cell_size**2
    counted = np.bincount(found[found >= 0], minlength=shapes.size)
    few = np.flatnonzero(counted < least).tolist()
    alone = {k: cells_under(shapes[k], grid, centres_only=True)[2].sum() for k in few}
    why = {
        f"narrower than the cells of {grid.cell_size:g} m, whose centres decide; counts nowhere or "
        "on less than half of its area": [k for k in few if alone[k] < least[k]],
        "counts nowhere, as later polygons of the file lie on all of it": [
            k for k in few if alone[k] >= least[k] and not counted[k]
        ],
    }
    for text, own in why.items():
        if own:
            labels = some_of([polygons[k].label for k in own], str)
            notice(f"{polygons[0].file}: {labels}: {text}")
    return found


def _part_under(geometry: Any, grid: Grid) -> tuple[slice, slice]:
    """Return rows and columns that hold a geometry, as far as it lies on the grid."""
    n_rows, n_cols = grid.shape
    west, south, east, north = geometry.bounds
    size = grid.cell_size
    row = [min(max(math.floor((grid.north - y) / size), 0), n_rows - 1) for y in (north, south)]
    col = [min(max(math.floor((x - grid.west) / size), 0), n_cols - 1) for x in (west, east)]
    return slice(row[0], row[1] + 1), slice(col[0], col[1] + 1)


def steepest_slope_deg(geometry: Any, grid: Grid) -> float:
    """Return steepest slope (degrees) of the cells under a geometry, from central differences."""
    rows, cols, mask = cells_under(geometry, grid)
    n_rows, n_cols = grid.shape
    top, left = max(rows.start - 1, 0), max(cols.start - 1, 0)
    window = grid.values[top : min(rows.stop + 1, n_rows), left : min(cols.stop + 1, n_cols)]
    down = np.asarray(np.gradient(window, grid.cell_size, axis=0))
    right = np.asarray(np.gradient(window, grid.cell_size, axis=1))
    own = (
        slice(rows.start - top, rows.start - top + mask.shape[0]),
        slice(cols.start - left, cols.start - left + mask.shape[1]),
    )
    slopes = np.hypot(down[own], right[own])[mask]
    known = slopes[np.isfinite(slopes)]
    # Cells with nodata all around have no slope, and nothing is claimed about them.
    return math.degrees(math.atan(float(known.max()))) if known.size else 90.0
