"""Inputs of Python programs in place of files: arrays with a place, frames, tables."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyproj
import rasterio
import shapely
from affine import Affine
from pyproj.exceptions import CRSError
from rasterio.io import MemoryFile

from sassgis.errors import InputError
from sassgis.grid import Grid
from sassgis.inputs.dem import affine_of
from sassgis.settings.ground import PARAMETERS, GroundClass
from sassgis.settings.schema import InMemory, Input

#: How far centres of cells may lie from even steps, in cells.
_UNEVEN = 1e-3
#: Texts that are none are refused where they are read, by their row.
_ANY_TEXT = ("utf-8", "surrogatepass")
_WANTED = (
    "a path, a DataArray, (array, transform, crs), a GeoDataFrame, GeoSeries or geometry, or a "
    "DataFrame"
)


def as_input(value: object, name: str) -> Input:
    """Return input that a value is: a path stays one, what is in memory gets a name and a digest.

    A raster may be xarray's DataArray (as rioxarray opens it), a Grid, or a tuple of array, affine
    transform and coordinate system; a layer a GeoDataFrame, GeoSeries or shapely geometry; a table
    a DataFrame or ground classes. ``name`` is what messages call it: its key in the configuration.
    InputError if it is none of these, or a raster has no place.
    """
    if isinstance(value, InMemory):
        return value
    if isinstance(value, str | os.PathLike):
        return Path(os.fspath(value))
    if isinstance(value, gpd.GeoDataFrame | gpd.GeoSeries | shapely.Geometry):
        return _layer(value, name)
    if isinstance(value, pd.DataFrame):
        return _table(value, name)
    if isinstance(value, Grid):
        return _raster(value.values, affine_of(value), value.crs or None, None, name)
    # Known by its name, so that xarray is loaded only by those who use it.
    if type(value).__name__ == "DataArray":
        return _from_data_array(value, name)
    if isinstance(value, Sequence) and value and all(isinstance(v, GroundClass) for v in value):
        return _table(classes_frame(value), name)
    if isinstance(value, tuple) and len(value) == 3:
        array, transform, crs = value
        try:
            place = Affine(*tuple(transform)[:6])
        except TypeError:
            raise InputError(
                "has no affine transform", field=name, found=repr(transform),
                expected="Affine(cell, 0, west, 0, -cell, north)",
            ) from None  # fmt: skip
        return _raster(np.asarray(array), place, crs, None, name)
    raise InputError("cannot be used", field=name, found=type(value).__name__, expected=_WANTED)


def classes_frame(classes: Sequence[GroundClass]) -> pd.DataFrame:
    """Return ground classes as the table of ``ground.classes``."""
    columns = ("name", *PARAMETERS, "source", "trust")
    frame = pd.DataFrame({c: [getattr(own, c) for own in classes] for c in columns})
    frame["source"] = frame["source"].replace("", "stated in the program")
    return frame


def _layer(value: Any, name: str) -> InMemory:
    kind = type(value).__name__
    if isinstance(value, shapely.Geometry):
        value = gpd.GeoSeries([value])
    if isinstance(value, gpd.GeoSeries):
        value = value.to_frame("geometry")
    frame = value.rename_geometry("geometry") if value.geometry.name != "geometry" else value
    frame = frame.reset_index(drop=True)
    digest = hashlib.sha256(str(frame.crs).encode())
    for geometry in frame.geometry.array:
        digest.update(b"" if geometry is None else shapely.to_wkb(geometry))
    digest.update(frame.drop(columns="geometry").to_csv(index=False).encode(*_ANY_TEXT))
    return InMemory(f"{name} ({kind})", "layer", digest.hexdigest(), frame)


def _table(frame: pd.DataFrame, name: str) -> InMemory:
    text = frame.to_csv(index=False)
    digest = hashlib.sha256(text.encode(*_ANY_TEXT)).hexdigest()
    return InMemory(f"{name} (DataFrame)", "table", digest, text)


def _from_data_array(array: Any, name: str) -> InMemory:
    """Return a DataArray with coordinates x and y, and its system where CF and rioxarray put it."""
    wrong = partial(InputError, field=name)
    squeezed = array.squeeze(drop=True)
    if squeezed.ndim != 2:
        raise wrong(
            "has several bands", found=f"shape {tuple(array.shape)}", expected="one band of heights"
        )
    rows, cols = squeezed.dims
    if not {rows, cols} <= set(squeezed.coords):
        raise wrong(
            "has no coordinates", found=f"dimensions {rows}, {cols}",
            expected="coordinates of the centres of its cells, y and x",
        )  # fmt: skip
    y, x = (np.asarray(squeezed[d], np.float64) for d in (rows, cols))
    mapping = array.encoding.get("grid_mapping", array.attrs.get("grid_mapping", "spatial_ref"))
    stated = array.coords[mapping].attrs if mapping in array.coords else {}
    crs = stated.get("crs_wkt") or stated.get("spatial_ref") or array.attrs.get("crs")
    sides = [_even_step(c, d, name) for c, d in ((x, cols), (y, rows))]
    place = Affine(sides[0], 0.0, x[0] - 0.5 * sides[0], 0.0, sides[1], y[0] - 0.5 * sides[1])
    if "GeoTransform" in stated:
        # Exact, where coordinates are rounded; of a part of a raster it is that of the whole.
        own = Affine.from_gdal(*map(float, str(stated["GeoTransform"]).split()))
        if np.allclose(tuple(own), tuple(place), rtol=0.0, atol=_UNEVEN * abs(sides[0])):
            place = own
    nodata = array.encoding.get("_FillValue", array.attrs.get("_FillValue"))
    return _raster(squeezed.values, place, crs, nodata, name, _stated_scale(array.attrs, name))


def _stated_scale(attributes: Mapping[str, Any], name: str) -> tuple[float, float]:
    """Read factor and offset from stored to true values, which rioxarray may hand on."""
    wrong = partial(InputError, field=name, expected="values opened with mask_and_scale=True")
    if of_bands := [key for key in ("scales", "offsets") if key in attributes]:
        raise wrong(f"has {of_bands[0]} that differ by band", found=attributes[of_bands[0]])
    stated = [attributes.get(key, usual) for key, usual in (("scale_factor", 1), ("add_offset", 0))]
    try:
        scale, offset = (float(value) for value in stated)
    except (TypeError, ValueError):
        scale = offset = math.nan
    if not (math.isfinite(scale) and math.isfinite(offset)):
        raise wrong("has a scale_factor or add_offset that is no number", found=stated)
    return scale, offset


def _even_step(centres: np.ndarray, axis: object, name: str) -> float:
    """Return the distance between neighbouring centres of cells."""
    steps = np.diff(centres)
    if steps.size == 0 or not np.all(np.abs(steps - steps.mean()) <= _UNEVEN * abs(steps.mean())):
        raise InputError(
            "is no regular raster", field=name, found=f"uneven steps of {axis}",
            expected="centres of cells at equal distances",
        )  # fmt: skip
    return float((centres[-1] - centres[0]) / (centres.size - 1))


def _raster(
    array: np.ndarray,
    place: Affine,
    crs: Any,
    nodata: Any,
    name: str,
    scale: tuple[float, float] = (1.0, 0.0),
) -> InMemory:
    """Return a raster as the bytes of a GeoTIFF, so that it is read and checked as a file is.

    ``nodata`` is a value as it stands in ``array``, before factor and offset of ``scale``.
    """
    wrong = partial(InputError, field=name)
    if array.ndim != 2 or array.dtype.kind not in "iuf":
        raise wrong(
            "is no raster", found=f"{array.dtype} of shape {array.shape}",
            expected="a two-dimensional array of numbers",
        )  # fmt: skip
    try:
        wkt = None if crs is None else pyproj.CRS.from_user_input(crs).to_wkt()
    except CRSError as error:
        raise wrong("has a coordinate system that is not understood", found=str(crs)) from error
    kind: np.dtype[Any] = np.dtype(np.int32 if array.dtype.kind in "iu" else np.float64)
    with MemoryFile() as file:
        with rasterio.open(
            file, "w", driver="GTiff", width=array.shape[1], height=array.shape[0], count=1,
            dtype=kind.name, transform=place, crs=wkt, nodata=nodata, BIGTIFF="IF_SAFER",
        ) as raster:  # fmt: skip
            raster.write(array.astype(kind), 1)
            if scale != (1.0, 0.0):
                raster.scales, raster.offsets = scale[:1], scale[1:]
        data = bytes(file.getbuffer())
    digest = hashlib.sha256(array.astype(kind).tobytes())
    stated = (tuple(place), wkt, nodata, array.shape)
    digest.update(repr(stated if scale == (1.0, 0.0) else (*stated, scale)).encode())
    return InMemory(f"{name} (in memory)", "raster", digest.hexdigest(), data)
