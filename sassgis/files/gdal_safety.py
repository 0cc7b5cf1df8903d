"""Limits on what GDAL may open: files on disks, in a few formats.

A file of any name may be a list of sources (VRT), the description of a server (WMS, WFS, ...) or a
label next to raw bytes, which GDAL follows: what comes with a project could read any other file, or
fetch one. So drivers are named, virtual rasters are mosaics of GeoTIFF files (input_parts.py), and
there is no network.
"""

from __future__ import annotations

import os
import re
import sqlite3
import threading
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pyogrio
import rasterio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError
from rasterio.io import DatasetReader

from sassgis.errors import InputError
from sassgis.files.digests import Stamp
from sassgis.files.input_parts import check_beside, files_of, mosaic_text, stamps_of
from sassgis.files.plain_file import check_file, read_text
from sassgis.settings.schema import composed

#: Drivers of GDAL, and how messages speak of them. What lies next to raw bytes is read without its
#: driver (EHdr) if the name is a link, which could lead to any file.
_RASTERS = ("GTiff", "AAIGrid", "XYZ", "HFA", "EHdr")
RASTER = "GeoTIFF, VRT of GeoTIFF files, ESRI ASCII, XYZ, Imagine, ESRI BIL or FLT"
_VECTORS = ("GPKG", "ESRI Shapefile", "GeoJSON", "FlatGeobuf", "KML", "LIBKML", "OpenFileGDB")
VECTOR = "GeoPackage, Shapefile, GeoJSON, FlatGeobuf, KML or file geodatabase"

_SQLITE = b"SQLite format 3\0"
_SHAPES = b"\0\0\x27\x0a"
_BINARY_VECTORS = (_SQLITE, _SHAPES, b"fgb\x03")
#: Texts by which drivers that are not named here know their files, wherever it stands in them.
_LEADS_ELSEWHERE = re.compile(rb"<OGR|gdal_streamed_alg|<!DOCTYPE", re.IGNORECASE)
#: As far as GDAL looks for them, with room (bytes).
_HEAD = 1 << 20

#: No web address goes through such a proxy, and no remote file has such a name.
_SETTINGS = {
    "GDAL_HTTP_PROXY": "none://offline",
    "GDAL_HTTPS_PROXY": "none://offline",
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".offline",
    # Masks and overviews are looked for only by their names, as below.
    "GDAL_DISABLE_READDIR_ON_OPEN": "TRUE",
}


#: Of pyogrio, where it brings its own PROJ along.
_PROJ_DATA = Path(pyogrio.__file__).parent / "proj_data"


@contextmanager
def offline() -> Iterator[None]:
    """Keep rasterio and pyogrio, each with a separate GDAL, off the network.

    Servers named in the environment variable ``NO_PROXY`` can be reached all the same.
    """
    with pyogrio_settings(_SETTINGS), rasterio.Env(**_SETTINGS):
        yield


@contextmanager
def pyogrio_settings(settings: Mapping[str, str]) -> Iterator[None]:
    """Set pyogrio's GDAL within the block, and where its PROJ finds coordinate systems.

    For a GeoPackage it would look in the current folder, too, which may come from anybody.
    """
    before = {key: pyogrio.get_gdal_config_option(key) for key in settings}
    pyogrio.set_gdal_config_options(settings)
    # Not for longer: the PROJ of rasterio has separate data.
    placed = _PROJ_DATA.is_dir() and "PROJ_DATA" not in os.environ
    if placed:
        os.environ["PROJ_DATA"] = str(_PROJ_DATA)
    try:
        yield
    finally:
        if placed:
            os.environ.pop("PROJ_DATA", None)
        pyogrio.set_gdal_config_options(before)


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
    if dataset.driver == "HFA" and (
        others := set(map(Path, dataset.files)).difference(files_of(file.absolute()))
    ):
        dataset.close()
        expected = f"{file.stem}.ige, as it was written"
        found = min(others)
        raise InputError("has its heights elsewhere", file=file, found=found, expected=expected)
    return dataset


def kept_dataset(file: Path) -> DatasetReader:
    """Open as open_dataset does, once as long as the file stays: with what GDAL kept of it.

    Neighbouring release areas read the same tiles of a terrain model.
    """
    return _kept(file, stamps_of(file), threading.get_ident())


@lru_cache(maxsize=8)
def _kept(file: Path, _stamps: tuple[Stamp, ...], _thread: int) -> DatasetReader:
    # A dataset is of one thread at a time. The one that is left out longest closes itself.
    return open_dataset(file)


_VECTOR_ERRORS = (DataSourceError, DataLayerError, shapely.errors.ShapelyError, sqlite3.Error)
#: How SQLite writes down what computes nothing where it is read. A view does, perhaps for ever, and
#: GDAL asks each; so may virtual tables, but for the index of a layer.
_PLAIN = re.compile(
    r"CREATE (TABLE|(UNIQUE )?INDEX|TRIGGER|VIRTUAL TABLE (\"([^\"]|\"\")*\"|\w+) USING rtree)\b",
    re.IGNORECASE,
)


@contextmanager
def vector_file(file: Path, field: str | None) -> Iterator[None]:
    """Have a vector file read within the block, if it is of a format that is named above."""
    check_file(file, field, VECTOR, folders=True)
    try:
        if file.is_dir():
            is_known = file.suffix.lower() == ".gdb" and (file / "a00000001.gdbtable").is_file()
            head = _SHAPES if is_known else b""
        else:
            with file.open("rb") as stream:
                head = stream.read(_HEAD)
        if not _is_vector(head):
            raise ValueError("a folder" if file.is_dir() else "none of the formats that are read")
        if head.startswith(_SQLITE) and (computed := _computed_table(file)):
            raise InputError(
                "holds a view or a virtual table", file=file, field=field, found=computed,
                expected="plain tables: export the layer to a GeoPackage of its own",
            )  # fmt: skip
        with offline():
            yield
    except (*_VECTOR_ERRORS, ValueError, OSError) as error:
        found = str(error).split(";")[0].replace(f"'{file}' ", "")[:160]
        raise InputError(
            "cannot be read as a vector file", file=file, field=field, found=found, expected=VECTOR
        ) from None


def layers_of(file: Path) -> dict[str, str | None]:
    """Return layers by name, with their kind of geometry, within a block of vector_file."""
    return {str(name): kind for name, kind in pyogrio.list_layers(file)}


def read_frame(file: Path, layer: str, **options: Any) -> Any:
    """Return a layer as a frame, within a block of vector_file."""
    try:
        info = pyogrio.read_info(file, layer=layer)
    except UnicodeDecodeError:
        info = pyogrio.read_info(file, layer=layer, encoding="ISO-8859-1")
    if info["driver"] not in _VECTORS:
        raise ValueError(f"a file of {info['driver']}")
    if info["driver"] == "ESRI Shapefile":
        options["encoding"] = _encoding(file, layer, info["encoding"])
    return with_composed(pyogrio.read_dataframe(file, layer=layer, **options))


def with_composed(frame: Any) -> Any:
    """Return a frame whose columns have their names in one Unicode form; itself where they have."""
    texts = [name for name in frame.columns if isinstance(name, str)]
    other = {name: composed(name) for name in texts if composed(name) != name}
    return frame.rename(columns=other) if other else frame


def _encoding(file: Path, layer: str, taken: str) -> str | None:
    """Return the encoding of the texts of a shapefile; None for the one that it states.

    Without a .cpg GDAL takes them for ISO-8859-1. No other text than ASCII is UTF-8 by chance.
    ``taken`` is what GDAL leaves to its caller: UTF-8 where it knows what is stated.
    """

    def texts(encoding: str | None) -> Any:
        with suppress(UnicodeDecodeError):
            return pyogrio.read_dataframe(file, layer=layer, encoding=encoding, read_geometry=False)

    utf_8 = texts("UTF-8")
    beside = [own for own in (file.with_suffix(".cpg"), file.with_suffix(".CPG")) if own.is_file()]
    if not beside:
        return None if utf_8 is None else "UTF-8"
    stated = texts(None)
    known = utf_8 is not None or taken == "UTF-8"
    if stated is None or not known or not (utf_8 is None or stated.equals(utf_8)):
        raise InputError(
            "states another encoding than that of the texts", file=beside[0],
            found=repr(read_text(beside[0], None, "an encoding", 1000).strip()),
            expected="ISO-8859-1, for example" if utf_8 is None else "UTF-8",
        )  # fmt: skip
    return None


def _computed_table(file: Path) -> str:
    """Return the declaration of a view or virtual table, if any; no SQL of it is run."""
    # The second way: next to a log of changes, in a folder without the right to write.
    for mode in ("mode=ro", "mode=ro&immutable=1"):
        place = f"file:{quote(str(file.absolute()))}?{mode}"
        with suppress(sqlite3.OperationalError), closing(sqlite3.connect(place, uri=True)) as own:
            found = own.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")
            return next((str(sql)[:100] for (sql,) in found if not _PLAIN.match(str(sql))), "")
    raise ValueError("a database that cannot be opened")


def _is_vector(head: bytes) -> bool:
    """Return whether a file begins as one of the formats, so that no other driver takes it."""
    if head.startswith(_BINARY_VECTORS):
        return True  # drivers look for texts up to the first zero
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    is_text = text.startswith(b"{") or (text.startswith(b"<") and b"<kml" in text)
    return is_text and not _LEADS_ELSEWHERE.search(text)
