"""Release areas, stations and barriers from any vector file, in the coordinates of the DEM."""

from __future__ import annotations

import difflib
import logging
import math
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pyproj
import shapely
from affine import Affine
from numpy.typing import NDArray
from pyogrio.errors import DataLayerError, DataSourceError
from pyproj.exceptions import ProjError
from rasterio.features import rasterize

from sassgis.io.read.dem import crs_name, same_crs
from sassgis.model.errors import ConfigError, InputError
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.release_areas import ReleaseArea
from sassgis.model.results import ControlLine
from sassgis.model.run_config import Config
from sassgis.model.settings import BarrierSettings, ReleaseSettings, StationSettings

log = logging.getLogger(__name__)

#: Below this slope no rock at rest rolls: the smallest rolling friction that Bozzolo and Pamini
#: (1986) quote from Statham (1979) is 0.37, the tangent of 20.3 degrees; sliding asks for more.
START_SLOPE_DEG = math.degrees(math.atan(0.37))

_KINDS = {
    "Point": "point",
    "MultiPoint": "point",
    "LineString": "line",
    "LinearRing": "line",
    "MultiLineString": "line",
    "Polygon": "polygon",
    "MultiPolygon": "polygon",
}


@dataclass(frozen=True, slots=True)
class Feature:
    """One feature of a layer, in the coordinates of the DEM.

    Attributes
    ----------
    number : int
        Place in the layer, counted from 1.
    attributes : mapping of str to object
    geometry : shapely geometry
        Valid, not empty, without heights.
    kind : {"polygon", "line", "point"}
    """

    number: int
    attributes: Mapping[str, Any]
    geometry: Any
    kind: str

    def text(self, field: str) -> str | None:
        """Attribute as text; None where it is empty."""
        return _text(self.attributes[field])

    def label(self, name_field: str | None = None) -> str:
        """How messages speak of the feature."""
        name = self.text(name_field) if name_field else None
        return f"feature {self.number}" + (f" ({name})" if name else "")


# ---------------------------------------------------------------------------------------------
# Release areas


def release_features(release: ReleaseSettings) -> list[Feature]:
    """The release areas of a file by number and attributes; their shapes are not looked at.

    Raises
    ------
    InputError
        If the file, the layer or a field cannot be used.
    """
    file = _release_file(release)
    frame = _open_layer(file, release.layer, "release", {"name_field": release.name_field})
    return _without_shapes(frame)


def release_names(release: ReleaseSettings) -> tuple[str, ...]:
    """Names of all release areas in the order of the file; their shapes are not looked at.

    Raises
    ------
    InputError
        If the file, the layer, a field or a name cannot be used.
    """
    file = _release_file(release)
    found = release_features(release)
    return tuple(feature_names(found, release.name_field, "area", file, "release"))


def _release_file(release: ReleaseSettings) -> Path:
    if release.file is None:
        raise InputError(
            "no release areas are given",
            file=release.config_file,
            field="release.file",
            expected="a file",
        )
    return release.file


def read_release(
    release: ReleaseSettings,
    grid: Grid,
    block_names: Sequence[str],
    only: Sequence[str] | None = None,
) -> list[ReleaseArea]:
    """Read the release areas and check them against the DEM.

    Parameters
    ----------
    release
        Section ``[release]`` of the configuration.
    grid
        The terrain model.
    block_names
        Names of the block scenarios.
    only
        Names of the areas to read; the shapes of the others are not looked at. Default: all.

    Returns
    -------
    list of ReleaseArea
        In the order of the file. What can be used but deserves a look (an area partly outside the
        DEM, over nodata, too flat for a start, or over another area) is logged as a warning.

    Raises
    ------
    InputError
        If the file, the layer, a field, a feature or a name cannot be used, or ``only`` names an
        area that is not there.
    """
    file = _release_file(release)
    name_field, scenario_field = release.name_field, release.scenario_field

    def named(features: Sequence[Feature]) -> list[str]:
        return feature_names(features, name_field, "area", file, "release")

    def chosen(features: Sequence[Feature]) -> list[Feature]:
        names = named(features)
        for name in only or ():
            if name not in names:
                raise InputError(
                    "no release area has this name",
                    file=file,
                    field="area",
                    found=repr(name),
                    expected=nearest(name, names),
                )
        return [f for f, n in zip(features, names, strict=True) if only is None or n in only]

    features = read_features(
        file,
        grid,
        "release",
        layer=release.layer,
        fields={"name_field": name_field, "scenario_field": scenario_field},
        label=name_field,
        choose=chosen,
    )
    areas = [
        release_area(feature, name, release, grid, block_names)
        for feature, name in zip(features, named(features), strict=True)
    ]
    warn_of_overlaps(areas, file)
    return areas


def read_release_feature(release: ReleaseSettings, number: int, grid: Grid) -> Feature:
    """One feature of the release areas, in the coordinates of the DEM.

    Parameters
    ----------
    release
        Section ``[release]`` of the configuration.
    number
        Place in the layer, counted from 1.
    grid
        The terrain model; its heights are not looked at.

    Raises
    ------
    InputError
        If the file or the feature cannot be used, or it lies outside the DEM.
    """
    fields = {"name_field": release.name_field, "scenario_field": release.scenario_field}
    return read_features(
        _release_file(release),
        grid,
        "release",
        layer=release.layer,
        fields=fields,
        label=release.name_field,
        choose=lambda features: [features[number - 1]],
    )[0]


def release_area(
    feature: Feature, name: str, release: ReleaseSettings, grid: Grid, block_names: Sequence[str]
) -> ReleaseArea:
    """A release area from its feature, checked against the DEM under it.

    Raises
    ------
    InputError
        If it lies outside the DEM or on nodata, or names an unknown block scenario.
    """
    file = _release_file(release)
    _check_under(feature, feature.label(release.name_field), grid, file)
    scenarios = _scenarios(feature, release.scenario_field, block_names, release.name_field, file)
    return ReleaseArea(name, feature.geometry, scenarios)


def feature_names(
    features: Sequence[Feature], field: str | None, stem: str, file: Path, section: str
) -> list[str]:
    """Names of the features: identities, so no two are the same.

    Raises
    ------
    InputError
        If a feature has no name or two have the same.
    """
    if field is None:
        return [f"{stem} {f.number}" for f in features]
    seen: dict[str, Feature] = {}
    for feature in features:
        name = feature.text(field)
        if name is None:
            raise InputError(
                f"{feature.label()} has no name", file=file, field=field, expected="a text"
            )
        if name in seen:
            raise InputError(
                "name is used twice",
                file=file,
                field=field,
                found=f"{name!r} in features {seen[name].number} and {feature.number}",
                expected=f"names that differ, or another {section}.name_field",
            )
        seen[name] = feature
    return list(seen)


def _scenarios(
    feature: Feature,
    field: str | None,
    known: Sequence[str],
    name_field: str | None,
    file: Path,
) -> tuple[str, ...]:
    text = None if field is None else feature.text(field)
    if text is None:
        if field is not None:
            log.info("%s: %s names no scenario: all of them", file, feature.label(name_field))
        return tuple(known)
    chosen = tuple(dict.fromkeys(part.strip() for part in re.split(r"[;,]", text) if part.strip()))
    for name in chosen:
        if name not in known:
            raise InputError(
                f"{feature.label(name_field)} names an unknown block scenario",
                file=file,
                field=field,
                found=repr(name),
                expected=nearest(name, known),
            )
    return chosen or tuple(known)


def _check_under(feature: Feature, label: str, grid: Grid, file: Path) -> None:
    """Compare a release area with the DEM under it."""
    inside = share_inside(feature, grid)
    if inside == 0.0:
        raise _outside(file, "release.file", label, feature.geometry.bounds, grid)
    if inside < 1.0:
        log.warning(
            "%s: %s: %.1f %% of it lies outside the DEM; no rock starts there",
            file,
            label,
            max(100.0 * (1.0 - inside), 0.1),
        )
    rows, cols, mask = cells_under(feature.geometry, grid)
    unknown = ~np.isfinite(grid.values[rows, cols]) & mask
    n_cells, n_unknown = int(mask.sum()), int(unknown.sum())
    if n_unknown == n_cells:
        raise InputError(
            f"{label} lies on nodata",
            file=file,
            field="release.file",
            found=f"{n_cells} cells under it, none with a height",
            expected="an area on known terrain",
        )
    if n_unknown:
        log.warning(
            "%s: %s: %d of %d cells under it are nodata (%.1f %%); no rock starts there",
            file,
            label,
            n_unknown,
            n_cells,
            100.0 * n_unknown / n_cells,
        )
    steepest = steepest_slope_deg(feature.geometry, grid)
    if steepest < START_SLOPE_DEG:
        log.warning(
            "%s: %s: nowhere steeper than %.1f degrees; "
            "below %.1f degrees no rock at rest starts to move",
            file,
            label,
            steepest,
            START_SLOPE_DEG,
        )


def warn_of_overlaps(areas: Sequence[ReleaseArea], file: Path) -> None:
    """Where areas of one scenario overlap, rocks start twice as densely."""
    shapes = [a.geometry for a in areas]
    first, second = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        common = shapes[i].intersection(shapes[j]).area if i < j else 0.0
        if common > 0.0 and set(areas[i].scenarios) & set(areas[j].scenarios):
            log.warning(
                "%s: areas %s and %s overlap by %.1f m2; rocks start there from both",
                file,
                areas[i].name,
                areas[j].name,
                common,
            )


# ---------------------------------------------------------------------------------------------
# Stations and barriers


def read_control_lines(config: Config, grid: Grid) -> list[tuple[ControlLine, FloatArray]]:
    """Read stations and barriers that lie on the map.

    Parameters
    ----------
    config
        The configuration.
    grid
        The terrain model.

    Returns
    -------
    list of (Gate, float64 array of shape (n, 2))
        Stations, then barriers, in the order of the configuration; x and y of their vertices (m).

    Raises
    ------
    ConfigError
        If a station or barrier has no place on the map.
    InputError
        If a file, a layer, a field or a feature cannot be used, or a name turns up twice.
    """
    control_lines: list[tuple[ControlLine, FloatArray]] = []
    for section, items in (("stations", config.stations), ("barriers", config.barriers)):
        for item in items:
            control_lines += _control_lines_of(item, f"{section}[{item.name}]", config.file, grid)
    names = [control_line.name for control_line, _ in control_lines]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(
                "name is used twice",
                file=config.file,
                field="stations/barriers.name",
                found=repr(name),
                expected="names that differ, features of station and barrier files included",
            )
    return control_lines


def _control_lines_of(
    item: StationSettings, key: str, config_file: Path, grid: Grid
) -> list[tuple[ControlLine, FloatArray]]:
    if item.line is not None:
        line = shapely.LineString(item.line)
        if not line.is_valid:
            raise ConfigError(
                "has no length",
                file=config_file,
                field=f"{key}.line",
                found=str([list(p) for p in item.line]),
                expected="at least two points that differ",
            )
        feature = Feature(1, {}, line, "line")
        check_on_map(feature, grid, config_file, f"{key}.line", item.name)
        return [(_control_line(item, item.name), _vertices(line))]
    if item.file is None:
        raise ConfigError(
            "has no place on the map",
            file=config_file,
            field=key,
            found="chainage_m, which belongs to profile runs",
            expected="line or file",
        )
    features = read_features(
        item.file,
        grid,
        key,
        layer=item.layer,
        fields={"name_field": item.name_field},
        label=item.name_field,
        kinds=("line",),
    )
    if item.name_field is None and len(features) == 1:
        names = [item.name]
    else:
        names = feature_names(features, item.name_field, item.name, item.file, key)
    control_lines = []
    for feature, name in zip(features, names, strict=True):
        label = feature.label(item.name_field)
        line = feature.geometry
        if line.geom_type == "MultiLineString":
            line = shapely.line_merge(line)
        if line.geom_type != "LineString":
            raise InputError(
                f"{label} is made of separate parts",
                file=item.file,
                field=key,
                found=f"{len(line.geoms)} parts",
                expected="one line without gaps; make each part a feature of its own",
            )
        check_on_map(feature, grid, item.file, key, label)
        control_lines.append((_control_line(item, name), _vertices(line)))
    return control_lines


def _control_line(item: StationSettings, name: str) -> ControlLine:
    return (
        item.control_line(name)
        if isinstance(item, BarrierSettings)
        else ControlLine(name, "station")
    )


def _vertices(line: Any) -> FloatArray:
    points = shapely.get_coordinates(line)
    keep = np.append(True, np.any(points[1:] != points[:-1], axis=1))
    return np.ascontiguousarray(points[keep], dtype=np.float64)


def check_on_map(feature: Feature, grid: Grid, file: Path, key: str, label: str) -> None:
    """Raise InputError if a feature lies outside the DEM; warn if a part of it does."""
    if not feature.geometry.intersects(shapely.box(*grid.bounds)):
        raise _outside(file, key, label, feature.geometry.bounds, grid)
    inside = share_inside(feature, grid)
    if inside < 1.0:
        log.warning(
            "%s: %s: %s: %.1f %% of it lies outside the DEM",
            file,
            key,
            label,
            max(100.0 * (1.0 - inside), 0.1),
        )


# ---------------------------------------------------------------------------------------------
# Geometry against the grid


def share_inside(feature: Feature, grid: Grid) -> float:
    """Share of a feature (of its area, length or number of points) within the DEM, 0 to 1."""
    box = shapely.box(*grid.bounds)
    if box.covers(feature.geometry):
        return 1.0
    common = feature.geometry.intersection(box)
    if feature.kind == "polygon":
        return float(common.area / feature.geometry.area)
    if feature.kind == "line":
        return float(common.length / feature.geometry.length)
    whole = shapely.get_num_coordinates(feature.geometry)
    return float(shapely.get_num_coordinates(common) / whole)


def cells_under(geometry: Any, grid: Grid) -> tuple[slice, slice, NDArray[np.bool_]]:
    """Cells that a geometry covers.

    Parameters
    ----------
    geometry
        Shapely geometry that meets the DEM.
    grid
        The terrain model.

    Returns
    -------
    rows, cols : slice
        The part of the grid that holds the geometry.
    mask : bool, shape of that part
        Cells whose centre lies in a polygon; for points, lines and polygons too small to hold a
        centre, the cells that they touch.
    """
    n_rows, n_cols = grid.shape
    west, south, east, north = geometry.bounds
    size = grid.cell_size
    first_row = min(max(math.floor((grid.north - north) / size), 0), n_rows - 1)
    last_row = min(max(math.floor((grid.north - south) / size), 0), n_rows - 1)
    first_col = min(max(math.floor((west - grid.west) / size), 0), n_cols - 1)
    last_col = min(max(math.floor((east - grid.west) / size), 0), n_cols - 1)
    rows, cols = slice(first_row, last_row + 1), slice(first_col, last_col + 1)
    corner = Affine(
        size, 0.0, grid.west + first_col * size, 0.0, -size, grid.north - first_row * size
    )
    mask = np.zeros((0, 0), dtype=bool)
    for touched in (False, True):
        if not touched and shapely.get_dimensions(geometry) < 2:
            continue
        burnt = rasterize(
            [(geometry, 1)],
            out_shape=(last_row - first_row + 1, last_col - first_col + 1),
            transform=corner,
            all_touched=touched,
            dtype=np.uint8,
        )
        mask = burnt.astype(bool)
        if mask.any():
            break
    return rows, cols, mask


def steepest_slope_deg(geometry: Any, grid: Grid) -> float:
    """Steepest slope (degrees) of the cells under a geometry, from central differences."""
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


# ---------------------------------------------------------------------------------------------
# Layers


def read_features(
    file: Path,
    grid: Grid,
    key: str,
    *,
    layer: str | None = None,
    fields: Mapping[str, str | None] | None = None,
    label: str | None = None,
    kinds: Sequence[str] = ("polygon", "line", "point"),
    choose: Callable[[Sequence[Feature]], list[Feature]] | None = None,
) -> list[Feature]:
    """Read a layer, check its geometries and bring them into the coordinates of the DEM.

    Parameters
    ----------
    file, layer
        The file, and its layer where it has several.
    grid
        The terrain model.
    key
        Section of the configuration that names the file, for messages.
    fields
        Attributes that must exist, by the configuration key that names them.
    label
        Attribute with the names of the features, for messages.
    kinds
        Kinds of geometry that can be used.
    choose
        Picks the features to read, by number and attributes alone. Default: all.

    Returns
    -------
    list of Feature

    Raises
    ------
    InputError
        If file, layer or field are missing, the layer is empty or lies outside the DEM, or a
        geometry is missing, invalid or of the wrong kind.
    """
    frame = _open_layer(file, layer, key, fields or {})
    bare = _without_shapes(frame)
    if choose is not None:
        bare = choose(bare)
    labels = [f.label(label) for f in bare]
    geometries = [frame.geometry.array[f.number - 1] for f in bare]
    shapes = [shapely.force_2d(g) if g is not None else None for g in geometries]
    found_kinds = [
        _check_shape(g, who, file, key, kinds) for g, who in zip(shapes, labels, strict=True)
    ]
    moved = onto_grid(shapes, frame.crs, grid, file, key, labels)
    return [
        Feature(f.number, f.attributes, g, kind)
        for f, g, kind in zip(bare, moved, found_kinds, strict=True)
    ]


def _without_shapes(frame: Any) -> list[Feature]:
    """The features of a layer by number and attributes."""
    rows = frame.drop(columns=frame.geometry.name).to_dict("records")
    return [Feature(n, row, None, "") for n, row in enumerate(rows, start=1)]


def _open_layer(file: Path, layer: str | None, key: str, fields: Mapping[str, str | None]) -> Any:
    """The layer as a frame with geometry."""
    if not file.exists():
        raise InputError(
            "file not found", file=file, field=f"{key}.file", expected="the path of a vector file"
        )
    try:
        with warnings.catch_warnings(record=True) as spoken:
            warnings.simplefilter("always")
            layers = {str(n): kind for n, kind in pyogrio.list_layers(file)}
            name = _choose_layer(layers, layer, file, key)
            # Geometries that cannot be decoded come as None and are reported by feature.
            frame = pyogrio.read_dataframe(file, layer=name, on_invalid="ignore")
    except (DataSourceError, DataLayerError, shapely.errors.ShapelyError, ValueError) as error:
        raise InputError(
            "cannot be read as a vector file",
            file=file,
            field=f"{key}.file",
            found=str(error).split(";")[0].replace(f"'{file}' ", "")[:160],
            expected="GeoPackage, Shapefile, GeoJSON or another format that GDAL reads",
        ) from None
    for text in dict.fromkeys(str(w.message) for w in spoken):
        # Measures along lines are dropped with the heights: nothing is lost.
        if not text.startswith("Measured"):
            log.warning("%s: %s", file, " ".join(text.split()))
    known = [c for c in frame.columns if c != "geometry"]
    for setting, field in fields.items():
        if field is not None and field not in known:
            raise InputError(
                "attribute not found",
                file=file,
                field=f"{key}.{setting}",
                found=repr(field),
                expected=nearest(field, known),
            )
    if len(frame) == 0:
        raise InputError(
            "layer is empty", file=file, field=f"layer {name}", expected="at least one feature"
        )
    return frame


def _choose_layer(
    layers: Mapping[str, str | None], wanted: str | None, file: Path, key: str
) -> str:
    drawn = [name for name, kind in layers.items() if kind is not None]
    if wanted is not None and wanted in drawn:
        return wanted
    if not drawn:
        raise InputError(
            "holds no layer with geometry",
            file=file,
            field=f"{key}.file",
            found=f"layers {', '.join(layers) or 'none'}",
            expected="a layer of polygons, lines or points",
        )
    if wanted is not None:
        raise InputError(
            "layer not found",
            file=file,
            field=f"{key}.layer",
            found=repr(wanted),
            expected=nearest(wanted, drawn),
        )
    if len(drawn) > 1:
        raise InputError(
            "has several layers",
            file=file,
            field=f"{key}.layer",
            found=", ".join(drawn),
            expected=f"one of them as {key}.layer",
        )
    return drawn[0]


def _check_shape(shape: Any, who: str, file: Path, key: str, kinds: Sequence[str]) -> str:
    """Kind of a geometry, in the coordinates of its file so that users find the place."""
    place = f"{key}.file"
    if shape is None or shape.is_empty:
        raise InputError(
            f"{who} has no usable geometry",
            file=file,
            field=place,
            expected="a " + " or ".join(kinds),
        )
    kind = _KINDS.get(shape.geom_type, "")
    if kind not in kinds:
        raise InputError(
            f"{who} is of the wrong kind",
            file=file,
            field=place,
            found=shape.geom_type,
            expected="a " + " or ".join(kinds),
        )
    if not np.isfinite(shapely.get_coordinates(shape)).all():
        raise InputError(
            f"{who} has a coordinate that is no number", file=file, field=place, expected="numbers"
        )
    if not shape.is_valid:
        raise InputError(
            f"{who} is not valid",
            file=file,
            field=place,
            found=shapely.is_valid_reason(shape),
            expected="a geometry that does not cross itself; mend it with QGIS 'Fix geometries'",
        )
    return kind


def onto_grid(
    shapes: Sequence[Any], crs: Any, grid: Grid, file: Path, key: str, labels: Sequence[str]
) -> list[Any]:
    """Geometries in the coordinates of the DEM; they must meet it somewhere.

    Raises
    ------
    InputError
        If they cannot be brought there or lie beside it, with a guess why.
    """
    place = f"{key}.file"
    own = None if crs is None else pyproj.CRS.from_user_input(crs)
    if own is not None and own.is_engineering:
        own = None
    # GeoJSON cannot leave its coordinate system out: longitude and latitude are then only implied.
    implied = own is not None and own.is_geographic and file.suffix.lower() in (".geojson", ".json")
    if own is None or (not grid.crs and implied):
        if not _meets(shapes, grid):
            raise InputError(
                "has no coordinate system and does not lie on the DEM",
                file=file,
                field=place,
                found=_extent(_bounds(shapes)),
                expected=f"a file with its coordinate system, or coordinates of the DEM: "
                f"{_extent(grid.bounds)}",
            )
        log.info("%s: states no coordinate system: taken to be that of the DEM", file)
        return list(shapes)
    if not grid.crs:
        raise InputError(
            "has a coordinate system, yet the DEM is in local coordinates",
            file=file,
            field=place,
            found=str(own.name),
            expected="local coordinates without a coordinate system",
        )
    target = pyproj.CRS.from_wkt(grid.crs)
    west, south, east, north = _bounds(shapes)
    if own.is_geographic and (
        max(abs(west), abs(east)) > 360.0 or max(abs(south), abs(north)) > 90.0
    ):
        raise InputError(
            "coordinates cannot be degrees: the file is probably tagged with the wrong system",
            file=file,
            field=place,
            found=f"{own.name} with {_extent((west, south, east, north))}",
            expected="its true coordinate system",
        )
    plane = own.sub_crs_list[0] if own.is_compound else own
    if same_crs(plane, target):
        moved = list(shapes)
    else:
        moved = _reprojected(shapes, plane, target, file, place, labels)
        log.info("%s: reprojected from %s to %s", file, plane.name, crs_name(grid.crs))
    if not _meets(moved, grid):
        error = _outside(file, place, labels[0], _bounds(moved), grid)
        if plane.is_geographic and _meets_swapped(shapes, plane, target, grid):
            error = InputError(
                "latitude and longitude are swapped",
                file=file,
                field=place,
                found=_extent((west, south, east, north)),
                expected="longitude first",
            )
        raise error
    return moved


def _reprojected(
    shapes: Sequence[Any],
    source: pyproj.CRS,
    target: pyproj.CRS,
    file: Path,
    place: str,
    labels: Sequence[str],
) -> list[Any]:
    transformer = pyproj.Transformer.from_crs(source, target, always_xy=True)

    def move(points: FloatArray) -> FloatArray:
        x, y = transformer.transform(points[:, 0], points[:, 1])
        return np.column_stack([x, y])

    try:
        moved = [shapely.transform(g, move) for g in shapes]
    except ProjError as error:
        raise InputError(
            "cannot be brought into the coordinates of the DEM",
            file=file,
            field=place,
            found=str(error),
            expected=f"coordinates that {target.name} can express",
        ) from None
    for shape, who in zip(moved, labels, strict=True):
        if not np.isfinite(shapely.get_coordinates(shape)).all() or not shape.is_valid:
            raise InputError(
                f"{who} cannot be brought into the coordinates of the DEM",
                file=file,
                field=place,
                found=f"{source.name}",
                expected=f"coordinates that {target.name} can express",
            )
    return moved


def _meets_swapped(
    shapes: Sequence[Any], source: pyproj.CRS, target: pyproj.CRS, grid: Grid
) -> bool:
    transformer = pyproj.Transformer.from_crs(source, target, always_xy=True)
    points = shapely.get_coordinates(list(shapes))
    x, y = transformer.transform(points[:, 1], points[:, 0])
    return bool((grid.cell_of(x, y) >= 0).any())


def _bounds(shapes: Iterable[Any]) -> tuple[float, float, float, float]:
    west, south, east, north = shapely.total_bounds(list(shapes)).tolist()
    return west, south, east, north


def _meets(shapes: Sequence[Any], grid: Grid) -> bool:
    return bool(shapely.intersects(np.array(shapes, dtype=object), shapely.box(*grid.bounds)).any())


def _extent(bounds: tuple[float, float, float, float]) -> str:
    west, south, east, north = bounds
    return f"x {west:.10g} to {east:.10g}, y {south:.10g} to {north:.10g}"


def _outside(
    file: Path, place: str, label: str, bounds: tuple[float, float, float, float], grid: Grid
) -> InputError:
    return InputError(
        f"{label} lies outside the DEM",
        file=file,
        field=place,
        found=_extent(bounds),
        expected=f"within {_extent(grid.bounds)}",
    )


# ---------------------------------------------------------------------------------------------
# Words


def nearest(name: str, known: Sequence[str]) -> str:
    """What may have been meant by a name that is not known."""
    if not known:
        return "one that exists, but there is none"
    close = difflib.get_close_matches(name.lower(), [k.lower() for k in known], n=1, cutoff=0.6)
    hint = next((f" (nearest: {k})" for k in known if close and k.lower() == close[0]), "")
    return f"one of {', '.join(known)}{hint}"


def _text(value: object) -> str | None:
    if value is None or value != value or str(value) == "<NA>":
        return None
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return str(value).strip() or None
