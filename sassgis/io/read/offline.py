"""What GDAL may open: files on disks, in a few formats.

A file of any name may be a list of sources (VRT), the description of a server (WMS, WFS, ...) or a
label beside raw bytes, which GDAL follows: what comes with a project could read any other file of
the machine, or fetch one. So the formats are named, of virtual rasters only mosaics of GeoTIFF
files are read, and there is no network.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import pyogrio
import rasterio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError
from rasterio.io import DatasetReader

from sassgis.io.digests import Stamp
from sassgis.io.read.input_parts import check_beside, files_of, mosaic_text, stamps_of
from sassgis.io.read.plain_file import check_file
from sassgis.model.errors import InputError

#: Drivers of GDAL, and how messages speak of them. What lies beside raw bytes is read without its
#: driver (EHdr) if the name is a link, which could lead to any file.
_RASTERS = ("GTiff", "AAIGrid", "XYZ", "HFA", "EHdr")
RASTER = "GeoTIFF, VRT of GeoTIFF files, ESRI ASCII, XYZ, Imagine, ESRI BIL or FLT"
_VECTORS = ("GPKG", "ESRI Shapefile", "GeoJSON", "FlatGeobuf", "KML", "LIBKML", "OpenFileGDB")
VECTOR = "GeoPackage, Shapefile, GeoJSON, FlatGeobuf, KML or file geodatabase"

_BINARY_VECTORS = (b"SQLite format 3\0", b"\0\0\x27\x0a", b"fgb\x03")
#: Texts by which drivers that are not named here know their files, wherever it stands in them.
_LEADS_ELSEWHERE = re.compile(rb"<OGR|gdal_streamed_alg|<!DOCTYPE", re.IGNORECASE)
#: As far as GDAL looks for them, with room (bytes).
_HEAD = 1 << 20

#: No web address goes through such a proxy, and no remote file has such a name.
_SETTINGS = {
    "GDAL_HTTP_PROXY": "none://offline",
    "GDAL_HTTPS_PROXY": "none://offline",
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".offline",
    # Masks and overviews are looked for by their names alone, as below.
    "GDAL_DISABLE_READDIR_ON_OPEN": "TRUE",
}


@contextmanager
def offline() -> Iterator[None]:
    """Keep rasterio and pyogrio, each with a GDAL of its own, off the network.

    Servers named in the environment variable ``NO_PROXY`` are left out: they can be reached.
    """
    with pyogrio_settings(_SETTINGS), rasterio.Env(**_SETTINGS):
        yield


@contextmanager
def pyogrio_settings(settings: Mapping[str, str]) -> Iterator[None]:
    """Settings of pyogrio's GDAL within the block."""
    before = {key: pyogrio.get_gdal_config_option(key) for key in settings}
    pyogrio.set_gdal_config_options(settings)
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options(before)


# ---------------------------------------------------------------------------------------------
# Rasters


def open_dataset(file: Path) -> DatasetReader:
    """Open a raster of a format that is named above; RasterioError if GDAL cannot open it."""
    check_beside(file)
    mosaic = mosaic_text(file)
    if mosaic is not None:
        return DatasetReader(mosaic, driver="VRT")
    drivers = [name for name in _RASTERS if name != "EHdr" or not file.is_symlink()]
    # Not as a relative path: rasterio would take "zip:a" for an archive.
    dataset = DatasetReader(str(file.absolute()), driver=drivers)
    # The header of Imagine files may name any file as that with their heights.
    if dataset.driver == "HFA" and (other := _foreign(dataset, file)):
        dataset.close()
        expected = f"{file.stem}.ige, as it was written"
        raise InputError("has its heights elsewhere", file=file, found=other, expected=expected)
    return dataset


def _foreign(dataset: DatasetReader, file: Path) -> Path | None:
    """A file that GDAL has opened for a raster and that does not belong to it."""
    own = files_of(file.absolute())
    return next((f for f in map(Path, dataset.files) if f not in own), None)


def kept_dataset(file: Path) -> DatasetReader:
    """As open_dataset; of the same file, the same as before, with what GDAL has kept of it.

    Neighbouring release areas read the same tiles of a terrain model.
    """
    return _kept(file, stamps_of(file), threading.get_ident())


@lru_cache(maxsize=8)
def _kept(file: Path, _stamps: tuple[Stamp, ...], _thread: int) -> DatasetReader:
    # A dataset is of one thread at a time. The one that is left out longest closes itself.
    return open_dataset(file)


# ---------------------------------------------------------------------------------------------
# Vector files

_VECTOR_ERRORS = (DataSourceError, DataLayerError, shapely.errors.ShapelyError)


@contextmanager
def vector_file(file: Path, field: str | None) -> Iterator[None]:
    """Have a vector file read within the block, if it is of a format that is named above."""
    check_file(file, field, VECTOR, folders=True)
    try:
        if not _is_vector(file):
            raise ValueError("none of the formats that are read")
        with offline():
            yield
    except (*_VECTOR_ERRORS, ValueError, OSError) as error:
        found = str(error).split(";")[0].replace(f"'{file}' ", "")[:160]
        raise InputError(
            "cannot be read as a vector file", file=file, field=field, found=found, expected=VECTOR
        ) from None


def read_frame(file: Path, layer: str, **options: Any) -> Any:
    """A layer as a frame, within a block of vector_file."""
    driver = pyogrio.read_info(file, layer=layer)["driver"]
    if driver not in _VECTORS:
        raise ValueError(f"a file of {driver}")
    return pyogrio.read_dataframe(file, layer=layer, **options)


def _is_vector(file: Path) -> bool:
    """Whether a file begins as one of the formats, so that no other driver takes it for its own."""
    if file.is_dir():
        return file.suffix.lower() == ".gdb" and (file / "a00000001.gdbtable").is_file()
    with file.open("rb") as stream:
        head = stream.read(_HEAD)
    if head.startswith(_BINARY_VECTORS):
        return True  # drivers look for texts up to the first zero
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    is_text = text.startswith(b"{") or (text.startswith(b"<") and b"<kml" in text)
    return is_text and not _LEADS_ELSEWHERE.search(text)
