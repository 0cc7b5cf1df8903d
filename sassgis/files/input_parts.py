"""Parts of an input: a file, those next to it, and those that a virtual raster shows.

What reads an input, what separates it from others and what is kept of it all ask here: a part that
one of them forgets would be an edit that nobody notices.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import stat
from functools import cache, lru_cache
from html import unescape
from pathlib import Path
from xml.etree import ElementTree as ET

from sassgis.errors import InputError
from sassgis.files.digests import Stamp, content_digest, stamp_of
from sassgis.files.plain_file import check_file, read_text
from sassgis.settings.schema import AnyInput, InMemory

_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
#: Masks and overviews, which have such files themselves.
_LAYERS = (".msk", ".MSK", ".ovr", ".OVR")
#: What stands behind the whole name: what GDAL knows besides, and what SQLite has not yet written
#: into the file, as long as a GIS has it open.
_BEHIND = (".aux.xml", ".aux", "-wal", "-journal")
#: What stands in place of the ending: of rasters (header, systems, places, Imagine's heights and
#: overviews), and of the vector files and tables that are read.
_OF_RASTERS = (".hdr", ".prj", ".wld", ".tab", ".aux", ".ige", ".rrd")
_IN_PLACE = {
    ".shp": (".shx", ".dbf", ".prj", ".cpg"),
    **dict.fromkeys((".gpkg", ".geojson", ".json", ".kml", ".fgb", ".csv", ".toml"), ()),
}
#: In folders: locks, and the index of a -wal file.
_NO_CONTENT = (".lock", "-shm")

#: All that a mosaic needs, as gdalbuildvrt and gdal_translate write it.
_MOSAIC_TAGS = re.compile(
    "VRTDataset|SRS|GeoTransform|Metadata|MDI|OverviewList|Block[XY]Size|VRTRasterBand|MaskBand|"
    "Description|UnitType|Offset|Scale|NoDataValue|HideNoDataValue|ColorInterp|ColorTable|Entry|"
    "CategoryNames|Category|Histograms|HistItem|HistMin|HistMax|BucketCount|Approximate|HistCounts|"
    "IncludeOutOfRange|SimpleSource|ComplexSource|SourceFilename|SourceBand|SourceProperties|"
    "SrcRect|DstRect|NODATA|UseMaskBand|ScaleOffset|ScaleRatio"
)
#: What side files name overviews by that lie anywhere.
_ELSEWHERE = "OVERVIEW_FILE"
#: Of virtual rasters and side files (bytes): mosaics of ten thousand tiles have half as many.
_LARGEST_XML = 20_000_000


def files_of(given: Path) -> list[Path]:
    """Return the files that an input consists of: itself, then those next to it, each once.

    Of a virtual raster also the tiles that it shows with theirs, of a folder all files in it.
    OSError; InputError if one is a pipe or a device, or a virtual raster is not one that is read.
    """
    if given.is_dir():
        inner = sorted(
            f for f in given.rglob("*") if f.is_file() and not f.name.endswith(_NO_CONTENT)
        )
        return list(dict.fromkeys(part for file in inner for part in files_of(file)))
    tiles = _mosaic(given, stamp_of(given.stat()))[1] if _is_mosaic(given) else ()
    listed = cache(_names_in)
    shown = (p for t in tiles for p in (t, *_beside(t, listed(os.path.dirname(t)))))
    return list(dict.fromkeys([given, *_beside(given), *shown]))


def file_digest(given: AnyInput) -> str:
    """Return SHA-256 of all files that an input consists of; InputError if one cannot be read."""
    if isinstance(given, InMemory):
        return given.digest
    main = Path(given)
    check_file(main, None, "a file", folders=True)
    digest = hashlib.sha256()
    try:
        for part in files_of(main):
            # Within a folder a table is known by its name.
            inner = part != main and part.is_relative_to(main)
            name = part.relative_to(main).as_posix() if inner else part.suffix.lower()
            digest.update(name.encode())
            digest.update(bytes.fromhex(content_digest(part)))
    except OSError as error:
        found = error.strerror
        raise InputError("cannot be read", file=main, found=found, expected="a file") from None
    return digest.hexdigest()


def stamps_of(given: Path) -> tuple[Stamp, ...]:
    """Return stamps of all files of an input: with the same ones it is not read again."""
    return tuple(stamp_of(part.stat()) for part in files_of(given))


def _beside(file: Path, listed: frozenset[str] | None = None) -> list[Path]:
    """Return existing files next to a file that give it meaning, with those next to them.

    ``listed`` are the names in its folder, where they are known: a large mosaic asks for many.
    """
    stem, ending = os.path.splitext(file)
    placed, behind = _endings(ending.lower())
    found: dict[tuple[int, int, str], Path] = {}
    for name in (*(stem + own for own in placed), *(f"{file}{own}" for own in behind)):
        if listed is not None and os.path.basename(name) not in listed:
            continue
        try:
            state = os.stat(name)
        except OSError:
            continue
        beside = Path(name)
        if not stat.S_ISDIR(state.st_mode):
            check_file(beside, None, f"a file that belongs to {file.name}")
            if state.st_size and beside != file:
                # Where capitals are of no account both names are of one file.
                found.setdefault((state.st_dev, state.st_ino, name.lower()), beside)
    own = sorted(found.values())
    return [part for one in own for part in (one, *(_beside(one) if one.suffix in _LAYERS else ()))]


@cache
def _endings(kind: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """List endings in place of that of a kind of file (a lower-case suffix), and behind it."""
    placed = _IN_PLACE.get(kind)
    if placed is None:
        # World files: tfw and tifw of tif.
        worlds = {f"{kind}w", f"{kind[:2]}{kind[-1]}w"} if kind else set()
        placed = (*_OF_RASTERS, *sorted(worlds))
    return (*placed, *(own.upper() for own in placed)), (*_BEHIND, *_LAYERS)


def _names_in(folder: str) -> frozenset[str] | None:
    """Return names of all files of a folder; None where they cannot be listed."""
    try:
        return frozenset(os.listdir(folder))
    except OSError:
        return None


def mosaic_text(file: Path) -> str | None:
    """Return a virtual raster as GDAL is to see it, with absolute paths; None of any other file.

    InputError if it is more than a mosaic of GeoTIFF files.
    """
    return _mosaic(file, stamp_of(file.stat()))[0] if _is_mosaic(file) else None


def mosaic_places(file: Path) -> tuple[tuple[int, int, int, int], ...]:
    """Find where these lie in it: first row and column, numbers of rows and columns."""
    text = mosaic_text(file)
    if text is None:
        return ()
    root = ET.fromstring(text)
    sides = ("yOff", "xOff", "ySize", "xSize")
    rectangles = [[float(own.get(k, "nan")) for k in sides] for own in root.iter("DstRect")]
    whole = all(math.isfinite(v) for own in rectangles for v in own)
    places = [tuple(map(round, own)) for own in rectangles if whole]
    return tuple((n, w, rows, cols) for n, w, rows, cols in places if rows > 0 and cols > 0)


def _is_mosaic(file: Path) -> bool:
    """Return whether GDAL would take a file for a virtual raster."""
    if not file.is_file():
        return False
    with file.open("rb") as stream:
        head = stream.read(4096).lstrip()
    return head.startswith(b"<") and b"<VRTDataset" in head


@lru_cache(maxsize=4)
def _mosaic(file: Path, _stamp: Stamp) -> tuple[str, tuple[Path, ...]]:
    """Return a virtual raster for GDAL, and its sources."""
    text = read_text(file, None, "a virtual raster", _LARGEST_XML)

    def refused(what: str, found: object) -> InputError:
        return InputError(
            "is a virtual raster that is not read", file=file, field=what, found=found,
            expected="a plain mosaic of GeoTIFF files",
        )  # fmt: skip

    try:
        if "<!DOCTYPE" in text:
            raise refused("DOCTYPE", None)
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise refused("XML", error) from None
    for element in root.iter():
        if not _MOSAIC_TAGS.fullmatch(element.tag):
            raise refused("element", element.tag)
        if kinds := [v for k, v in element.attrib.items() if k.lower() == "subclass"]:
            raise refused(element.tag, kinds[0])
    places = []
    for source in root.iter("SourceFilename"):
        beside = any(
            k.lower() == "relativetovrt" and v.strip() == "1" for k, v in source.attrib.items()
        )
        place = Path(file.absolute().parent if beside else "", (source.text or "").strip())
        check_file(place, f"{file.name}, SourceFilename", "a GeoTIFF file")
        if not _is_tiff(place):
            raise refused("SourceFilename", place)
        check_beside(place)
        source.text, source.attrib = str(place.absolute()), {"relativeToVRT": "0"}
        places.append(place.absolute())
    return ET.tostring(root, "unicode"), tuple(dict.fromkeys(places))


def _is_tiff(file: Path) -> bool:
    with file.open("rb") as stream:
        return stream.read(4) in _TIFF


def check_beside(file: Path) -> None:
    """Check masks and overviews next to a raster, which GDAL opens whatever they are."""
    for part in _beside(file):
        if part.suffix in _LAYERS and not _is_tiff(part):
            raise InputError("is no GeoTIFF", file=part, expected="a mask or overviews")
        if part.name.endswith(".aux.xml") and _ELSEWHERE in unescape(
            read_text(part, None, "XML", _LARGEST_XML)
        ):
            raise InputError("names a file elsewhere", file=part, field=_ELSEWHERE)
