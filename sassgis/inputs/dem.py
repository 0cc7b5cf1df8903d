"""Terrain models: a raster becomes a north-up grid of square cells in metres."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import NotGeoreferencedWarning, RasterioError, RasterioIOError
from rasterio.features import rasterize
from rasterio.io import MemoryFile
from rasterio.warp import reproject
from rasterio.windows import Window

from sassgis.errors import InputError, notice
from sassgis.files.gdal_safety import RASTER, kept_dataset, offline, open_dataset
from sassgis.files.plain_file import check_file, check_text, in_memory
from sassgis.grid import BoolArray, Bounds, FloatArray, Grid
from sassgis.inputs.dem_system import dem_system
from sassgis.settings.crs import crs_name, crs_parts, same_crs
from sassgis.settings.process import require_memory
from sassgis.settings.results import Band, RasterClass, RasterLayer
from sassgis.settings.schema import AnyInput, InMemory, Input, named
from sassgis.settings.styles import PICTURE

#: Metres in the height units that rasters state; US survey foot as defined in 1893.
METRES = {
    **dict.fromkeys(("", "m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet"), 0.3048),
    **dict.fromkeys(
        ("us-ft", "ft-us", "ftus", "us survey foot", "us survey feet", "us foot"), 1200.0 / 3937.0
    ),
}
#: Heights that occur on land, with room: the Dead Sea shore lies at -430 m, Everest at 8849 m.
LOWEST_M, HIGHEST_M = -500.0, 9000.0
#: Where all other heights lie above this, heights of exactly 0 are suspect.
_ZERO_GAP_M = 50.0
#: Shift (in cells) over the whole raster below which cells count as square.
_SQUARE_TOLERANCE = 0.01
#: GDAL wants a system even where source and target share one; any plane one will do then.
_ONE_SYSTEM = ("EPSG:3857", "EPSG:3857")
#: So many whole numbers or fewer, in so many rows, are no heights.
_MOST_CLASSES, _LOOKED_AT = 20, 500
#: Of a cell while its height is read: as stored, as a number, and what is known of it (bytes).
_READING = 20
#: Of GDAL, among them the memory for cells of files that are kept open (bytes).
_OPTIONS = {"GTIFF_REPORT_COMPD_CS": "YES", "GDAL_CACHEMAX": 64 << 20}


@dataclass(frozen=True, slots=True)
class DemFile:
    """A raster of heights that can be used, before its heights are read."""

    file: Input
    band: int  # number of the band with the heights
    transform: Affine  # from columns and rows to coordinates (m)
    shape: tuple[int, int]  # rows, columns
    crs: str  # well-known text of the projected system; empty for local coordinates
    vertical_datum: str
    vertical_unit: float  # metres per unit of the height system

    @property
    def is_plain(self) -> bool:
        """Whether the cells are square with north up, so that parts can be read directly."""
        return _is_square(self.transform, self.shape)


def describe_dem(
    path: AnyInput,
    crs: str | None = None,
    vertical_datum: str | None = None,
    override_crs: bool = False,
) -> DemFile:
    """Describe a terrain model without its heights; parameters and errors as in read_dem."""
    file = named(path)
    with open_raster(file, "terrain.dem") as dataset:
        return _described(dataset, file, crs, vertical_datum, override_crs)


def read_dem_part(dem: DemFile, rows: slice, cols: slice) -> FloatArray:
    """Return heights (m) of some rows and columns of a raster that is plain; NaN for nodata."""
    with open_raster(dem.file, "terrain.dem", keep=True) as dataset:
        return _heights(dataset, dem, Window.from_slices(rows, cols))


def read_dem(
    path: AnyInput,
    crs: str | None = None,
    vertical_datum: str | None = None,
    override_crs: bool = False,
) -> Grid:
    """Read a terrain model: heights in metres, NaN where nothing is known.

    Parameters
    ----------
    path
        A raster with one band of heights, of one of the formats of sassgis.files.gdal_safety. If it
        is rotated or its cells are not square, it is resampled (bilinear) to square cells of the
        shorter side; a notice says so.
    crs
        Coordinate system where the file has none, as pyproj understands it ("EPSG:2056"), or
        "local" for local coordinates in metres. If the file has one, both must be the same, unless
        ``override_crs``: then this one counts.
    vertical_datum
        Name of the height system where the file states none.
    """
    file = named(path)
    with open_raster(file, "terrain.dem") as dataset:
        dem = _described(dataset, file, crs, vertical_datum, override_crs)
        require_room(dem.shape, file)
        values = _heights(dataset, dem)
    wrong = partial(InputError, file=file)
    if not np.isfinite(values).any():
        found = f"{values.size} cells, all nodata"
        field = f"band {dem.band}"
        raise wrong("holds no height at all", field=field, found=found, expected="heights")
    values, transform = _north_up(values, dem.transform)
    if not _is_square(transform, values.shape):
        values, transform = _squared(values, transform, file)
        if not np.isfinite(values).any():
            raise wrong("holds no height at all after resampling")
    return Grid(
        values=np.ascontiguousarray(values), west=transform.c, north=transform.f,
        cell_size=(transform.a - transform.e) / 2.0, crs=dem.crs, vertical_datum=dem.vertical_datum,
    )  # fmt: skip


def require_room(shape: tuple[int, int], file: Input) -> None:
    """Raise InputError if the heights of so many rows and columns do not fit into the memory."""
    require_memory({"terrain.dem": _READING * shape[0] * shape[1]}, file)


def _described(
    dataset: Any, file: Input, crs: str | None, vertical_datum: str | None, override_crs: bool
) -> DemFile:
    band = height_band(dataset, file)
    if min(dataset.shape) < 3:
        found, expected = f"{dataset.height} rows x {dataset.width} columns", "at least 3 x 3 cells"
        raise InputError("is too small for slopes", file=file, found=found, expected=expected)
    transform = _transform(dataset, file)
    bounds = _outer_bounds(transform, dataset.shape)
    plane, datum, vertical_unit = dem_system(
        dataset, file, crs, vertical_datum, bounds, override_crs
    )
    check_text(datum, file, "height system")
    check_text("" if plane is None else plane.name, file, "coordinate system")
    wkt = "" if plane is None else plane.to_wkt()
    return DemFile(
        file=file,
        band=band,
        transform=transform,
        shape=dataset.shape,
        crs=wkt,
        vertical_datum=datum,
        vertical_unit=vertical_unit,
    )


@contextmanager
def open_raster(file: Input, key: str, keep: bool = False) -> Iterator[Any]:
    """Open a raster or say in one line why that cannot be done.

    With ``keep`` it is left open for who reads other parts of it next.
    """
    check_file(file, key, RASTER)
    if isinstance(file, InMemory):
        with MemoryFile(in_memory(file, "raster", key, RASTER)) as held, held.open() as dataset:
            yield dataset
        return
    with warnings.catch_warnings(), offline(), rasterio.Env(**_OPTIONS):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            dataset = kept_dataset(file) if keep else open_dataset(file)
        except (RasterioError, OSError) as error:
            problem, found = "cannot be read as a raster", _reason(error, file)
            raise InputError(problem, file=file, field=key, found=found, expected=RASTER) from None
        with nullcontext() if keep else dataset:
            yield dataset


def _reason(error: Exception, file: Input) -> str:
    text = str(error).replace(f"'{file}' ", "").replace(str(file), file.name)
    if "not recognized as being in a supported" in text:
        return "none of the formats that are read"
    return (text.splitlines() or [type(error).__name__])[0][:160]


def height_band(dataset: Any, file: Input) -> int:
    """Return number of the one band with heights; a transparency band next to it does no harm."""
    wrong = partial(InputError, file=file)
    bands = _opaque_bands(dataset)
    if dataset.count == 0:
        found = f"subdatasets {', '.join(dataset.subdatasets[:5]) or 'none'}"
        expected = "a raster with one band; extract the heights with rio convert"
        raise wrong("holds no band itself", found=found, expected=expected)
    if len(bands) != 1:
        found = f"{dataset.count} bands"
        expected = "one band of heights; extract it with rio stack FILE --bidx 1 -o NEW"
        raise wrong("has several bands", found=found, expected=expected)
    kind = np.dtype(dataset.dtypes[bands[0] - 1])
    if kind.kind not in "iuf":
        raise wrong("holds no real numbers", found=str(kind), expected="heights in metres")
    return bands[0]


def _opaque_bands(dataset: Any) -> list[int]:
    """Return numbers of the bands that state no transparency."""
    return [i for i, kind in enumerate(dataset.colorinterp, start=1) if kind != ColorInterp.alpha]


def only_band(dataset: Any, file: Input, field: str, wanted: str) -> int:
    """Return the number of the one band of a raster on the map, transparency left out.

    ``wanted`` says what it should hold, for messages.
    """
    wrong = partial(InputError, file=file, field=field)
    bands = _opaque_bands(dataset)
    if len(bands) != 1:
        found, expected = f"{dataset.count} bands", f"one band of {wanted}"
        raise wrong("has several bands", found=found, expected=expected)
    if dataset.transform.is_identity:
        raise wrong("has no georeference", expected="a raster that lies on the map")
    return bands[0]


def _transform(dataset: Any, file: Input) -> Affine:
    wrong = partial(InputError, file=file)
    transform: Affine = dataset.transform
    # GDAL reports the identity, with rows running down, where a file has no georeference.
    if transform.is_identity:
        raise wrong(
            "has no georeference",
            found="control points only" if dataset.gcps[0] else "no corner and no cell size",
            expected="a raster on the map: place it in QGIS (Georeferencer), or add a world file",
        )
    if transform.is_degenerate or not all(math.isfinite(v) for v in transform[:6]):
        raise wrong("has an unusable georeference", found=tuple(transform[:6]))
    return transform


def _outer_bounds(transform: Affine, shape: tuple[int, int]) -> Bounds:
    a, b, c, d, e, f = transform[:6]
    corners = [(col, row) for col in (0, shape[1]) for row in (0, shape[0])]
    x = [a * col + b * row + c for col, row in corners]
    y = [d * col + e * row + f for col, row in corners]
    return min(x), min(y), max(x), max(y)


def _height_unit(dataset: Any, band: int, file: Input, vertical_unit: float) -> float:
    """Return metres per unit of the band: what the band states counts before the height system."""
    stated = (dataset.units[band - 1] or "").strip().lower()
    if stated not in METRES:
        raise InputError(
            "heights are in an unknown unit", file=file, field=f"band {band}",
            found=repr(dataset.units[band - 1]), expected="metres or feet",
        )  # fmt: skip
    unit = METRES[stated] if stated else vertical_unit
    if unit != 1.0:
        notice(f"{file}: heights are converted to metres (1 unit = {unit:.6f} m)", "info")
    return unit


def read_band(dataset: Any, band: int, file: Input, part: Window | None = None) -> Any:
    """Return a band as stored, masked where it is nodata or transparent."""
    try:
        raw = dataset.read(band, masked=True, window=part)
        # GDAL takes transparency for a mask only where it is stored as bytes.
        for other, kind in enumerate(dataset.colorinterp, start=1):
            if kind == ColorInterp.alpha:
                raw = np.ma.masked_where(dataset.read(other, window=part) == 0, raw)
    except (RasterioIOError, RasterioError, OSError) as error:
        raise InputError(
            "cannot be read to the end", file=file, field=f"band {band}",
            found=_reason(error, file), expected="an undamaged file",
        ) from None  # fmt: skip
    return raw


def _heights(dataset: Any, dem: DemFile, part: Window | None = None) -> FloatArray:
    """Return heights in metres in the order of the file; NaN for nodata."""
    file, band = dem.file, dem.band
    unit = _height_unit(dataset, band, file, dem.vertical_unit)
    raw = read_band(dataset, band, file, part)
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        values = np.array(raw.data, dtype=np.float64)
    values[np.ma.getmaskarray(raw)] = np.nan
    wrong = partial(InputError, file=file, field=f"band {band}")
    infinite = np.isinf(values)
    if infinite.any():
        found = f"{int(infinite.sum())} cells, the first at {_place(infinite, part)}"
        raise wrong("holds infinite heights", found=found, expected="numbers or nodata")
    scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
    values *= scale * unit
    values += offset * unit
    known = np.isfinite(values)
    absurd = known & ((values < LOWEST_M) | (values > HIGHEST_M))
    if absurd.any():
        stored = float(raw.data[absurd][0])
        # Nodata is one number; several, in most of the cells, are heights.
        if np.ptp(values[absurd]) > 0.0 and absurd.sum() > 0.5 * known.sum():
            cause = "in another unit than metres"
            advice = "of centimetres gdal_translate -a_scale 0.01 makes metres"
        else:
            cause = "nodata that is not declared"
            advice = f"declare nodata with rio edit-info FILE --nodata {stored:g}"
        raise wrong(
            f"holds heights that do not occur on Earth, probably {cause}",
            found=f"{int(absurd.sum())} cells, the first {stored:g} at {_place(absurd, part)}",
            expected=f"heights from {LOWEST_M:g} to {HIGHEST_M:g} m; {advice}",
        )
    zeros = lone_zeros(values)
    if zeros.any():
        others = math.floor(float(np.nanmin(values[~zeros])))
        notice(
            f"{file}: band {band}: {zeros.sum()} cells hold exactly 0 while all others lie above "
            f"{others} m; probably nodata that is not declared"
        )
    kinds = few_values(values)
    if kinds:
        notice(
            f"{file}: band {band} holds {len(kinds)} different numbers from {kinds[0]:g} to "
            f"{kinds[-1]:g}: a map of classes, such as zones or codes of ground, is no terrain "
            "model"
        )
    elif raw.dtype == np.uint8:
        notice(
            f"{file}: heights are stored as bytes (0 to 255); this may be an image such as a "
            "hillshade"
        )
    return values


def few_values(values: FloatArray) -> list[float]:
    """Return numbers of a raster, if they are whole and so few that they are codes of classes."""
    kinds: list[float] = []
    cells = 0
    for row in values[:: max(1, values.shape[0] // _LOOKED_AT)]:
        known = row[np.isfinite(row)]
        if (known != np.rint(known)).any():
            return []
        kinds, cells = np.union1d(kinds, known).tolist(), cells + known.size
        if len(kinds) > _MOST_CLASSES:
            return []
    # A plain has one height, and a few cells have few.
    return kinds if len(kinds) > 1 and cells >= _MOST_CLASSES * len(kinds) else []


def lone_zeros(values: FloatArray) -> BoolArray:
    """Return cells of exactly 0, which often means nodata, where all others lie far above."""
    zero: BoolArray = values == 0.0
    if zero.any():
        others = values[np.isfinite(values) & ~zero]
        zero &= bool(others.size and others.min() > _ZERO_GAP_M)
    return zero


def _place(cells: BoolArray, part: Window | None) -> str:
    """Find the position in the whole of the first of some cells of a part."""
    row, col = np.argwhere(cells)[0] + 1
    if part is not None:
        row, col = row + int(part.row_off), col + int(part.col_off)
    return f"row {row}, column {col}"


def burnt(
    shapes: Sequence[tuple[Any, float]], grid: Grid, fill: float, kind: Any, touched: bool = False
) -> NDArray[Any]:
    """Return values of geometries on the cells whose centre they cover, or all that they touch.

    Where several cover a cell, the last one counts; where none does, ``fill``.
    """
    where: dict[str, Any] = {"transform": affine_of(grid), "all_touched": touched}
    return np.asarray(rasterize(shapes, grid.shape, fill, dtype=kind, **where))


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


def _squared(values: FloatArray, transform: Affine, file: Input) -> tuple[FloatArray, Affine]:
    """Resample to square cells with north up: bilinear, cells of the shorter side."""
    width = math.hypot(transform.a, transform.d)
    height = math.hypot(transform.b, transform.e)
    cell = min(width, height)
    west, south, east, north = _outer_bounds(transform, (values.shape[0], values.shape[1]))
    # Rounding must not add a row or column of nothing.
    n_cols = max(1, math.ceil((east - west) / cell - 1e-6))
    n_rows = max(1, math.ceil((north - south) / cell - 1e-6))
    require_room((n_rows, n_cols), file)
    target = Affine(cell, 0.0, west, 0.0, -cell, north)
    what = "rotated cells" if transform.b or transform.d else "cells that are not square"
    notice(
        f"{file}: {what} ({width:g} m x {height:g} m) are resampled to square cells of {cell:g} m "
        "with north up (bilinear)",
        "info",
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
    systems: tuple[str, str] = _ONE_SYSTEM,
) -> NDArray[Any]:
    """Bring an array onto another grid of ``shape`` (n_rows, n_cols).

    ``transform`` and ``target`` lead from cells to coordinates, of ``values`` and of the result;
    ``systems`` are the well-known texts of both coordinate systems, by default the same.
    ``nodata`` means no value, here and in the result.
    """
    result = np.full(shape, nodata, dtype=values.dtype)
    reproject(
        np.ascontiguousarray(values), result, src_transform=transform, dst_transform=target,
        src_crs=systems[0], dst_crs=systems[1], src_nodata=nodata, dst_nodata=nodata,
        resampling=how,
    )  # fmt: skip
    return result


def affine_of(grid: Grid) -> Affine:
    """Return the transform from columns and rows of a grid to coordinates."""
    return Affine(grid.cell_size, 0.0, grid.west, 0.0, -grid.cell_size, grid.north)


def system_of(grid: Grid, own: pyproj.CRS, file: Input, field: str) -> pyproj.CRS:
    """Return the system of the DEM; InputError if it has none, while a file has its ``own``."""
    if not grid.crs:
        raise InputError(
            "has a coordinate system, yet the DEM is in local coordinates", file=file, field=field,
            found=str(own.name), expected="local coordinates without a coordinate system",
        )  # fmt: skip
    return pyproj.CRS.from_wkt(grid.crs)


def on_cells(
    file: Input, grid: Grid, field: str, read: Callable[[Any], NDArray[Any]], nodata: float
) -> NDArray[Any]:
    """Return values of a raster on the cells of the DEM: those of its nearest cell.

    ``read`` takes the open raster; ``nodata`` means no value, in what it returns and in the result.
    """
    with open_raster(file, field) as dataset:
        values, transform = read(dataset), dataset.transform
        systems = _pair_of_systems(dataset, grid, file, field)
    return resample(
        values=values,
        transform=transform,
        target=affine_of(grid),
        shape=grid.shape,
        how=Resampling.nearest,
        nodata=nodata,
        systems=systems,
    )


def _pair_of_systems(dataset: Any, grid: Grid, file: Input, field: str) -> tuple[str, str]:
    """Return coordinate systems of a raster and of the DEM, as ``resample`` takes them."""
    if not dataset.crs:
        notice(f"{file}: states no coordinate system: taken to be that of the DEM", "info")
        return _ONE_SYSTEM
    own, _ = crs_parts(pyproj.CRS.from_user_input(dataset.crs))
    if own.is_engineering:
        return _ONE_SYSTEM
    target = system_of(grid, own, file, field)
    if same_crs(own, target):
        return _ONE_SYSTEM
    notice(f"{file}: reprojected from {own.name} to {target.name} (nearest cell)", "info")
    return own.to_wkt(), grid.crs


_STEM = "base_map"
#: Of the layer in a project.
BASE_MAP_KEY = f"raster_{_STEM}"


def read_base_map(file: Path | None, grid: Grid) -> RasterLayer | None:
    """Read how a base map is shown: in colours, by its palette, or in grey; None without a file.

    InputError if it cannot be read, or is in other coordinates than the terrain model.
    """
    if file is None:
        return None
    field = "project.base_map"
    with open_raster(file, field) as dataset:
        own = dataset.crs
        if bool(own) != bool(grid.crs) or (
            own and not same_crs(pyproj.CRS.from_wkt(own.to_wkt()), pyproj.CRS.from_wkt(grid.crs))
        ):
            raise InputError(
                "is not in the coordinates of the terrain model",
                file=file,
                field=field,
                found=crs_name(own.to_wkt()) if own else "no coordinate system",
                expected=crs_name(grid.crs) if grid.crs else "local coordinates",
            )
        palette = {}
        if dataset.count < 3 and dataset.colorinterp[0].name == "palette":
            palette = dataset.colormap(1)
        # Nothing is drawn from the values here: the project shows the file.
        bands = (Band("", "", "", np.empty((0, 0), np.float32)),) * dataset.count
    classes = (
        RasterClass(value, "", "#{:02x}{:02x}{:02x}".format(*colour[:3]))
        for value, colour in palette.items()
    )
    return RasterLayer(
        stem=_STEM,
        title="Base map",
        note="",
        bands=bands,
        breaks=(),
        ramp=PICTURE,
        classes=tuple(classes),
    )
