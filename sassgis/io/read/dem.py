"""Terrain models: any raster that GDAL reads becomes a north-up grid of square cells in metres."""

from __future__ import annotations

import logging
import math
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import rasterio
from affine import Affine
from numpy.typing import NDArray
from pyproj.exceptions import CRSError, ProjError
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import NotGeoreferencedWarning, RasterioError, RasterioIOError
from rasterio.warp import reproject
from rasterio.windows import Window

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid

log = logging.getLogger(__name__)

#: Metres in the height units that rasters state; US survey foot as defined in 1893.
_METRES = {
    **dict.fromkeys(("", "m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet"), 0.3048),
    **dict.fromkeys(
        ("us-ft", "ft-us", "ftus", "us survey foot", "us survey feet", "us foot"), 1200.0 / 3937.0
    ),
}
#: Heights that occur on land, with room: the Dead Sea shore lies at -430 m, Everest at 8849 m.
_LOWEST_M, _HIGHEST_M = -500.0, 9000.0
#: Where all other heights lie above this, heights of exactly 0 are suspect.
_ZERO_GAP_M = 50.0
#: Shift (in cells) over the whole raster below which cells count as square.
_SQUARE_TOLERANCE = 0.01
#: Outside the area of use of a coordinate system by more than this, a warning is due (degrees).
_AREA_MARGIN_DEG = 1.0
#: Departure of the map scale from 1 that draws a warning, and that is refused.
_SCALE_WARNING, _SCALE_ERROR = 0.005, 0.05


@dataclass(frozen=True, slots=True)
class DemFile:
    """A raster of heights that can be used, before its heights are read.

    Attributes
    ----------
    file : Path
    band : int
        Number of the band with the heights.
    transform : Affine
        From columns and rows to coordinates (m).
    shape : (n_rows, n_cols)
    crs : str
        Well-known text of the projected system; empty for local coordinates.
    vertical_datum : str
    vertical_unit : float
        Metres per unit of the height system.
    """

    file: Path
    band: int
    transform: Affine
    shape: tuple[int, int]
    crs: str
    vertical_datum: str
    vertical_unit: float

    @property
    def is_plain(self) -> bool:
        """Whether the cells are square with north up, so that parts can be read as they are."""
        return _is_square(self.transform, self.shape)


def describe_dem(
    path: str | PathLike[str], crs: str | None = None, vertical_datum: str | None = None
) -> DemFile:
    """What a terrain model is, without its heights; parameters and errors are those of read_dem."""
    file = Path(path)
    with open_raster(file, "terrain.dem") as dataset:
        return _described(dataset, file, crs, vertical_datum)


def read_dem_part(dem: DemFile, rows: slice, cols: slice) -> FloatArray:
    """Heights (m) of some rows and columns of a raster with square cells and north up.

    Parameters
    ----------
    dem : DemFile
    rows, cols : slice
        Within the raster.

    Returns
    -------
    float64, shape (n_rows, n_cols)
        NaN for nodata.

    Raises
    ------
    InputError
        If the file cannot be read, or holds heights that do not occur on Earth.
    """
    with open_raster(dem.file, "terrain.dem") as dataset:
        return _heights(dataset, dem, Window.from_slices(rows, cols))


def read_dem(
    path: str | PathLike[str], crs: str | None = None, vertical_datum: str | None = None
) -> Grid:
    """Read a terrain model.

    Parameters
    ----------
    path
        Any raster with one band of heights that GDAL reads.
    crs
        Coordinate system that stands in where the file has none, as pyproj understands it
        ("EPSG:2056"), or "local" for local coordinates in metres. If the file has one, both must
        be the same.
    vertical_datum
        Name of the height system that stands in where the file states none.

    Returns
    -------
    Grid
        Heights in metres, NaN where nothing is known. Rotated rasters and rasters whose cells are
        not square are resampled (bilinear) to square cells of the shorter side; the log says so.

    Raises
    ------
    InputError
        If the file cannot be used; the line says why and what to do about it.
    """
    file = Path(path)
    with open_raster(file, "terrain.dem") as dataset:
        dem = _described(dataset, file, crs, vertical_datum)
        values = _heights(dataset, dem)
    if not np.isfinite(values).any():
        raise InputError(
            "holds no height at all",
            file=file,
            field=f"band {dem.band}",
            found=f"{values.size} cells, all nodata",
            expected="heights",
        )
    values, transform = _north_up(values, dem.transform)
    if not _is_square(transform, values.shape):
        values, transform = _squared(values, transform, file)
        if not np.isfinite(values).any():
            raise InputError("holds no height at all after resampling", file=file)
    return Grid(
        values=np.ascontiguousarray(values),
        west=transform.c,
        north=transform.f,
        cell_size=(transform.a - transform.e) / 2.0,
        crs=dem.crs,
        vertical_datum=dem.vertical_datum,
    )


def _described(dataset: Any, file: Path, crs: str | None, vertical_datum: str | None) -> DemFile:
    band = _height_band(dataset, file)
    if min(dataset.shape) < 3:
        raise InputError(
            "is too small for slopes",
            file=file,
            found=f"{dataset.height} rows x {dataset.width} columns",
            expected="at least 3 x 3 cells",
        )
    transform = _transform(dataset, file)
    bounds = _outer_bounds(transform, dataset.shape)
    plane, datum, vertical_unit = _system(dataset, file, crs, vertical_datum, bounds)
    wkt = "" if plane is None else plane.to_wkt()
    return DemFile(file, band, transform, dataset.shape, wkt, datum, vertical_unit)


# ---------------------------------------------------------------------------------------------
# Opening


@contextmanager
def open_raster(file: Path, key: str) -> Iterator[Any]:
    """Open a raster or say in one line why that cannot be done."""
    if not file.exists():
        raise InputError(
            "file not found", file=file, field=key, expected="the path of a raster that GDAL reads"
        )
    with warnings.catch_warnings(), rasterio.Env(GTIFF_REPORT_COMPD_CS="YES"):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            dataset = rasterio.open(file)
        except (RasterioError, OSError) as error:
            raise InputError(
                "cannot be read as a raster",
                file=file,
                field=key,
                found=_reason(error, file),
                expected="a raster that GDAL reads (GeoTIFF, ESRI ASCII, ...)",
            ) from None
        with dataset:
            yield dataset


def _reason(error: Exception, file: Path) -> str:
    text = str(error).replace(f"'{file}' ", "").replace(str(file), file.name)
    return (text.splitlines() or [type(error).__name__])[0][:160]


def _height_band(dataset: Any, file: Path) -> int:
    """Number of the one band with heights; a transparency band beside it does no harm."""
    bands = [i for i, kind in enumerate(dataset.colorinterp, start=1) if kind != ColorInterp.alpha]
    if dataset.count == 0:
        names = ", ".join(dataset.subdatasets[:5]) or "none"
        raise InputError(
            "holds no band itself",
            file=file,
            found=f"subdatasets {names}",
            expected="a raster with one band; extract the heights with gdal_translate",
        )
    if len(bands) != 1:
        raise InputError(
            "has several bands",
            file=file,
            found=f"{dataset.count} bands",
            expected="one band of heights; extract it with gdal_translate -b",
        )
    kind = np.dtype(dataset.dtypes[bands[0] - 1])
    if kind.kind not in "iuf":
        raise InputError(
            "holds no real numbers", file=file, found=str(kind), expected="heights in metres"
        )
    if kind == np.uint8:
        log.warning(
            "%s: heights are stored as bytes (0 to 255); this may be an image such as a hillshade",
            file,
        )
    return bands[0]


def _transform(dataset: Any, file: Path) -> Affine:
    transform: Affine = dataset.transform
    # GDAL reports the identity, with rows running down, where a file has no georeference.
    if transform.is_identity:
        raise InputError(
            "has no georeference",
            file=file,
            found="control points only" if dataset.gcps[0] else "no corner and no cell size",
            expected="a raster placed on the map; use gdalwarp, or add a world file",
        )
    if transform.is_degenerate or not all(math.isfinite(v) for v in transform[:6]):
        raise InputError("has an unusable georeference", file=file, found=tuple(transform[:6]))
    return transform


def _outer_bounds(transform: Affine, shape: tuple[int, int]) -> tuple[float, float, float, float]:
    a, b, c, d, e, f = transform[:6]
    corners = [(col, row) for col in (0, shape[1]) for row in (0, shape[0])]
    x = [a * col + b * row + c for col, row in corners]
    y = [d * col + e * row + f for col, row in corners]
    return min(x), min(y), max(x), max(y)


# ---------------------------------------------------------------------------------------------
# Coordinate system


def parse_crs(text: str, *, file: str | PathLike[str] | None = None, field: str = "") -> pyproj.CRS:
    """Coordinate system from a code or well-known text; InputError if it is not understood."""
    try:
        return pyproj.CRS.from_user_input(text)
    except CRSError:
        raise InputError(
            "is no coordinate system",
            file=file,
            field=field or None,
            found=repr(text if len(text) < 60 else text[:57] + "..."),
            expected="a code such as EPSG:2056",
        ) from None


def crs_name(wkt: str) -> str:
    """Name of a coordinate system for people, with its code where it has one."""
    if not wkt:
        return "local coordinates"
    crs = pyproj.CRS.from_wkt(wkt)
    authority = crs.to_authority(min_confidence=90)
    return f"{crs.name} ({':'.join(authority)})" if authority else str(crs.name)


def _parts(crs: pyproj.CRS) -> tuple[pyproj.CRS, pyproj.CRS | None]:
    """Horizontal and vertical part of a coordinate system."""
    if crs.is_compound:
        return crs.sub_crs_list[0], crs.sub_crs_list[1]
    return crs, None


def same_crs(one: pyproj.CRS, other: pyproj.CRS) -> bool:
    """Whether two coordinate systems put points in the same place, whatever their spelling."""
    if one.equals(other, ignore_axis_order=True):
        return True
    codes = (one.to_epsg(), other.to_epsg())
    if None not in codes:
        return codes[0] == codes[1]
    # Files written by other programs leave codes and names of the projection out.
    return _fingerprint(one) == _fingerprint(other)


def _fingerprint(crs: pyproj.CRS) -> tuple[object, ...]:
    """Projection with its numbers, and the datum."""
    base = crs.source_crs if crs.is_bound and crs.source_crs is not None else crs
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what PROJ strings lose, the datum adds
        projection = sorted((k, str(v)) for k, v in base.to_dict().items())
    datum = "" if base.datum is None else str(base.datum.name).lower()
    return (*projection, re.sub(r"^d_|ensemble|[^a-z0-9]", "", datum))


def _system(
    dataset: Any,
    file: Path,
    configured: str | None,
    configured_datum: str | None,
    bounds: tuple[float, float, float, float],
) -> tuple[pyproj.CRS | None, str, float]:
    """Horizontal system (None: local), name of the height system, metres per unit of height."""
    local = configured is not None and configured.strip().lower() == "local"
    stated = _stated_crs(dataset, file)
    wanted = None
    if configured is not None and not local:
        wanted = parse_crs(configured, file=file, field="terrain.crs")
    if stated is None and configured is None:
        raise InputError(
            "has no coordinate system",
            file=file,
            field="terrain.crs",
            expected='terrain.crs in the configuration, such as "EPSG:2056" (or "local")',
        )
    if stated is not None and (local or (wanted is not None and not _agree(stated, wanted))):
        raise InputError(
            "the coordinate system of the file and the one configured differ",
            file=file,
            field="terrain.crs",
            found=f"{stated.name} in the file, {configured} configured",
            expected="the same; drop terrain.crs, or reproject or retag the DEM",
        )
    if stated is None and local:
        return None, configured_datum or "", 1.0
    full = stated if stated is not None else wanted
    assert full is not None
    plane, vertical = _parts(full)
    if vertical is None and wanted is not None:
        vertical = _parts(wanted)[1]
    _check_plane(plane, file, bounds)
    datum, unit = _height_system(vertical, configured_datum, file)
    return plane, datum, unit


def _stated_crs(dataset: Any, file: Path) -> pyproj.CRS | None:
    if not dataset.crs:
        return None
    try:
        crs = pyproj.CRS.from_user_input(dataset.crs)
    except CRSError:
        raise InputError(
            "has a coordinate system that is not understood",
            file=file,
            expected="a known one; retag the file with gdal_edit.py -a_srs",
        ) from None
    # Nameless local systems say nothing about where the raster lies.
    return None if crs.is_engineering else crs


def _agree(stated: pyproj.CRS, wanted: pyproj.CRS) -> bool:
    return same_crs(_parts(stated)[0], _parts(wanted)[0])


def _check_plane(plane: pyproj.CRS, file: Path, bounds: tuple[float, float, float, float]) -> None:
    """Refuse what cannot be measured in metres, or cannot be where it says it is."""
    west, south, east, north = bounds
    extent = f"x {west:.10g} to {east:.10g}, y {south:.10g} to {north:.10g}"
    in_degrees = max(abs(west), abs(east)) <= 360.0 and max(abs(south), abs(north)) <= 90.0
    if plane.is_geographic:
        if not in_degrees:
            raise InputError(
                "coordinates cannot be degrees: the file is probably tagged with the wrong system",
                file=file,
                field="terrain.crs",
                found=f"{plane.name} with {extent}",
                expected="its true, projected system; set it with gdal_edit.py -a_srs EPSG:...",
            )
        utm = _utm(0.5 * (west + east), 0.5 * (south + north))
        raise InputError(
            "is in degrees",
            file=file,
            field="terrain.crs",
            found=str(plane.name),
            expected=f"a projected system in metres; reproject it with gdalwarp -t_srs EPSG:{utm}",
        )
    if not plane.is_projected:
        raise InputError(
            "has no projected coordinate system",
            file=file,
            field="terrain.crs",
            found=str(plane.name),
            expected="a projected system in metres",
        )
    for axis in plane.axis_info[:2]:
        if abs(axis.unit_conversion_factor - 1.0) > 1e-9:
            raise InputError(
                "coordinates are not in metres",
                file=file,
                field="terrain.crs",
                found=f"{plane.name} in {axis.unit_name}",
                expected="a projected system in metres; reproject with gdalwarp -t_srs",
            )
    if in_degrees:
        raise InputError(
            "coordinates look like degrees, yet the file is tagged with a system in metres",
            file=file,
            field="terrain.crs",
            found=f"{plane.name} with {extent}",
            expected="its true system (EPSG:4326?), then reprojected to metres with gdalwarp",
        )
    _check_place(plane, file, 0.5 * (west + east), 0.5 * (south + north), extent)


def _utm(lon: float, lat: float) -> int:
    zone = min(60, max(1, math.floor((lon + 180.0) / 6.0) + 1))
    return (32600 if lat >= 0.0 else 32700) + zone


def _check_place(plane: pyproj.CRS, file: Path, x: float, y: float, extent: str) -> None:
    """Coordinates must belong to the system, and its metres must be metres on the ground."""
    base = plane.source_crs if plane.is_bound and plane.source_crs is not None else plane
    try:
        proj = pyproj.Proj(base)
        lon, lat = proj(x, y, inverse=True)
        factors = proj.get_factors(lon, lat)
        scale = max(factors.meridional_scale, factors.parallel_scale, key=lambda k: abs(k - 1.0))
    except ProjError:
        lon = lat = scale = math.inf
    if not (math.isfinite(lon) and math.isfinite(lat)):
        raise InputError(
            "coordinates do not belong to its coordinate system",
            file=file,
            field="terrain.crs",
            found=f"{plane.name} with {extent}",
            expected="coordinates on the Earth; the file is probably tagged with the wrong system",
        )
    area = _area_of_use(base)
    if area is not None:
        beyond = max(area.south - lat, lat - area.north, 0.0)
        width = (area.east - area.west) % 360.0 or 360.0
        past = (lon - area.west) % 360.0
        beyond = max(beyond, min(past - width, 360.0 - past) if past > width else 0.0)
        if beyond > _AREA_MARGIN_DEG:
            log.warning(
                "%s: lies %.1f degrees outside the area of use of %s (%s); "
                "the coordinate system may be wrong",
                file,
                beyond,
                plane.name,
                area.name,
            )
    if abs(scale - 1.0) > _SCALE_ERROR:
        raise InputError(
            "map metres are not metres on the ground",
            file=file,
            field="terrain.crs",
            found=f"{plane.name} with scale {scale:.3f} at the DEM",
            expected=f"a system true to scale; gdalwarp -t_srs EPSG:{_utm(lon, lat)} makes one",
        )
    if abs(scale - 1.0) > _SCALE_WARNING:
        log.warning(
            "%s: a metre in %s is %.4f m on the ground at the DEM", file, plane.name, 1.0 / scale
        )


def _area_of_use(crs: pyproj.CRS) -> Any:
    """Area of use; files do not carry it, but their codes lead to it."""
    code = crs.to_epsg()
    return crs.area_of_use or (None if code is None else pyproj.CRS.from_epsg(code).area_of_use)


def _height_system(
    vertical: pyproj.CRS | None, configured: str | None, file: Path
) -> tuple[str, float]:
    if vertical is None:
        return configured or "", 1.0
    name = str(vertical.name)
    if configured and configured.lower() not in name.lower():
        log.warning(
            "%s: height system %r of the file is used, not %r as configured", file, name, configured
        )
    axis = vertical.axis_info[0] if vertical.axis_info else None
    if axis is not None and axis.direction.lower() == "down":
        raise InputError(
            "holds depths, positive downwards",
            file=file,
            field="terrain.vertical_datum",
            found=name,
            expected="heights, positive upwards",
        )
    return name, 1.0 if axis is None else float(axis.unit_conversion_factor)


# ---------------------------------------------------------------------------------------------
# Heights


def _height_unit(dataset: Any, band: int, file: Path, vertical_unit: float) -> float:
    """Metres per unit of the band: what the band states counts before the height system."""
    stated = (dataset.units[band - 1] or "").strip().lower()
    if stated not in _METRES:
        raise InputError(
            "heights are in an unknown unit",
            file=file,
            field=f"band {band}",
            found=repr(dataset.units[band - 1]),
            expected="metres or feet",
        )
    unit = _METRES[stated] if stated else vertical_unit
    if unit != 1.0:
        log.info("%s: heights are converted to metres (1 unit = %.6f m)", file, unit)
    return unit


def _heights(dataset: Any, dem: DemFile, part: Window | None = None) -> FloatArray:
    """Heights in metres in the order of the file; NaN for nodata."""
    file, band = dem.file, dem.band
    unit = _height_unit(dataset, band, file, dem.vertical_unit)
    try:
        raw = dataset.read(band, masked=True, window=part)
        # GDAL takes transparency for a mask only where it is stored as bytes.
        for other, kind in enumerate(dataset.colorinterp, start=1):
            if kind == ColorInterp.alpha:
                raw = np.ma.masked_where(dataset.read(other, window=part) == 0, raw)
    except (RasterioIOError, RasterioError, OSError) as error:
        raise InputError(
            "cannot be read to the end",
            file=file,
            field=f"band {band}",
            found=_reason(error, file),
            expected="an undamaged file",
        ) from None
    values = np.array(raw.data, dtype=np.float64)
    values[np.ma.getmaskarray(raw)] = np.nan
    first = (0, 0) if part is None else (int(part.row_off), int(part.col_off))
    _refuse_infinite(values, file, band, first)
    scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
    values *= scale * unit
    values += offset * unit
    known = np.isfinite(values)
    absurd = known & ((values < _LOWEST_M) | (values > _HIGHEST_M))
    if absurd.any():
        row, col = np.unravel_index(int(np.argmax(absurd)), values.shape)
        stored = float(raw.data[row, col])
        raise InputError(
            "holds heights that do not occur on Earth, probably nodata that is not declared",
            file=file,
            field=f"band {band}",
            found=f"{int(absurd.sum())} cells, the first {stored:g} at "
            f"row {row + first[0] + 1}, column {col + first[1] + 1}",
            expected=f"heights from {_LOWEST_M:g} to {_HIGHEST_M:g} m; "
            f"declare nodata with gdal_edit.py -a_nodata {stored:g}",
        )
    _warn_of_zeros(values, file, band)
    return values


def _warn_of_zeros(values: FloatArray, file: Path, band: int) -> None:
    """Zero often stands for nodata; amid mountains it shows."""
    zero = values == 0.0
    if not zero.any():
        return
    others = values[np.isfinite(values) & ~zero]
    if others.size and others.min() > _ZERO_GAP_M:
        log.warning(
            "%s: band %d: %d cells hold exactly 0 while all others lie above %.0f m; "
            "probably nodata that is not declared",
            file,
            band,
            int(zero.sum()),
            math.floor(float(others.min())),
        )


def _refuse_infinite(values: FloatArray, file: Path, band: int, first: tuple[int, int]) -> None:
    infinite = np.isinf(values)
    if infinite.any():
        row, col = np.unravel_index(int(np.argmax(infinite)), values.shape)
        raise InputError(
            "holds infinite heights",
            file=file,
            field=f"band {band}",
            found=f"{int(infinite.sum())} cells, the first at "
            f"row {row + first[0] + 1}, column {col + first[1] + 1}",
            expected="numbers or nodata",
        )


# ---------------------------------------------------------------------------------------------
# North up, square cells


def _north_up(values: FloatArray, transform: Affine) -> tuple[FloatArray, Affine]:
    """Turn rasters whose rows run north or whose columns run west."""
    if transform.b or transform.d:
        return values, transform
    a, _, west, _, e, north = transform[:6]
    if e > 0.0:
        values, north, e = values[::-1], north + e * values.shape[0], -e
    if a < 0.0:
        values, west, a = values[:, ::-1], west + a * values.shape[1], -a
    return values, Affine(a, 0.0, west, 0.0, e, north)


def _is_square(transform: Affine, shape: tuple[int, ...]) -> bool:
    cell = transform.a
    skew = max(abs(transform.b), abs(transform.d), abs(transform.a + transform.e))
    return cell > 0.0 and transform.e < 0.0 and skew * max(shape) <= _SQUARE_TOLERANCE * cell


def _squared(values: FloatArray, transform: Affine, file: Path) -> tuple[FloatArray, Affine]:
    """Resample to square cells with north up: bilinear, cells of the shorter side."""
    width = math.hypot(transform.a, transform.d)
    height = math.hypot(transform.b, transform.e)
    cell = min(width, height)
    west, south, east, north = _outer_bounds(transform, (values.shape[0], values.shape[1]))
    # Rounding must not add a row or column of nothing.
    n_cols = max(1, math.ceil((east - west) / cell - 1e-6))
    n_rows = max(1, math.ceil((north - south) / cell - 1e-6))
    target = Affine(cell, 0.0, west, 0.0, -cell, north)
    turned = bool(transform.b or transform.d)
    log.info(
        "%s: %s (%g m x %g m) are resampled to square cells of %g m with north up (bilinear)",
        file,
        "rotated cells" if turned else "cells that are not square",
        width,
        height,
        cell,
    )
    square = resample(values, transform, target, (n_rows, n_cols), Resampling.bilinear, np.nan)
    return square, target


def resample(
    values: NDArray[Any],
    transform: Affine,
    target: Affine,
    shape: tuple[int, int],
    how: Resampling,
    nodata: float,
    crs: str = "",
    target_crs: str = "",
) -> NDArray[Any]:
    """Bring an array onto another grid.

    Parameters
    ----------
    values : (n, m)
    transform, target : Affine
        Cell to coordinates, of ``values`` and of the result.
    shape : (n_rows, n_cols)
        Of the result.
    how : Resampling
    nodata
        Value that stands for nothing, here and in the result.
    crs, target_crs : str
        Well-known texts; where either is empty both are taken to be the same.

    Returns
    -------
    array of the kind of ``values``, shape ``shape``
    """
    # GDAL wants a system even where source and target share one; any plane one will do then.
    same = not (crs and target_crs) or crs == target_crs
    result = np.full(shape, nodata, dtype=values.dtype)
    reproject(
        np.ascontiguousarray(values),
        result,
        src_transform=transform,
        dst_transform=target,
        src_crs="EPSG:3857" if same else crs,
        dst_crs="EPSG:3857" if same else target_crs,
        src_nodata=nodata,
        dst_nodata=nodata,
        resampling=how,
    )
    return result
