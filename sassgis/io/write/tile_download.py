"""Tiles fetched from a web server, whole, checked and resumed, and joined as one virtual raster."""

from __future__ import annotations

import hashlib
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import rasterio
from rasterio.errors import RasterioError

from sassgis.io.atomic_output import write_new, writing
from sassgis.io.qgis.markup import filled
from sassgis.io.read.dem import open_raster
from sassgis.io.read.plain_file import seen_from
from sassgis.io.read.stac import NoAnswer, TileOffer, opened
from sassgis.io.read.tiles import Terrain
from sassgis.model.errors import InputError, OutputError

#: Beginning of a multihash: code of the function and length of the digest.
_MULTIHASHES = {"1220": "sha256", "1340": "sha512", "1114": "sha1", "d50110": "md5"}
_CHUNK = 1 << 18
#: Times that a download is begun or continued.
_TRIES = 3
#: Types that hold the nodata of the whole; heights in others are given as Float32.
_TYPES = {"float32": "Float32", "float64": "Float64", "int16": "Int16", "int32": "Int32"}
_NODATA = -9999.0


def fetch_tile(offer: TileOffer, folder: Path, timeout_s: float) -> bool:
    """Fetch a tile; returns False if a whole one was there already.

    Until the tile is whole and checked its name ends in ``.part``; the next call goes on from
    there. A download that stops is continued, and one that is damaged begun anew, a few times; the
    next bytes are waited for no longer than ``timeout_s``.
    """
    target, part = folder / offer.name, folder / f"{offer.name}.part"
    if target.exists():
        if wrong := _damage(offer, target):
            raise OutputError(
                f"{target}: is not the tile that the server offers ({wrong}); delete it or move it "
                "away, and the same command fetches it"
            )
        return False
    wrong = ""
    for left in reversed(range(_TRIES)):
        try:
            _download(offer, part, timeout_s)
        except NoAnswer:
            if not left:
                raise
            continue
        wrong = _damage(offer, part)
        if not wrong:
            with writing(target):
                part.replace(target)
            return True
        part.unlink()
    raise InputError(
        "what the server sends is damaged", file=offer.href, found=wrong,
        expected="a whole GeoTIFF; try again later",
    )  # fmt: skip


def _download(offer: TileOffer, part: Path, timeout_s: float) -> None:
    """Fetch what is still missing of a file."""
    there = part.stat().st_size if part.exists() else 0
    try:
        _append(offer, part, there, timeout_s)
    except NoAnswer:
        raise
    except InputError:
        if not there:
            raise
        # The server may not like to go on from there, as where the file is whole already.
        part.unlink()
        _append(offer, part, 0, timeout_s)


def _append(offer: TileOffer, part: Path, there: int, timeout_s: float) -> None:
    headers = {"Range": f"bytes={there}-"} if there else {}
    with opened(offer.href, timeout_s, headers) as answer:
        goes_on = answer.status == 206 and str(answer.headers.get("Content-Range", "")).startswith(
            f"bytes {there}-"
        )
        length = answer.headers.get("Content-Length")
        received = 0
        with writing(part):
            file = part.open("ab" if goes_on else "wb")
        with file:
            while chunk := answer.read(_CHUNK):
                with writing(part):
                    file.write(chunk)
                received += len(chunk)
    if length is not None and received < int(length):
        raise NoAnswer(
            "the connection broke", file=offer.href, found=f"{received} of {length} bytes",
            expected="a connection that lasts",
        )  # fmt: skip


def _damage(offer: TileOffer, file: Path) -> str:
    """What is wrong with a file; empty if nothing is."""
    for start, function in _MULTIHASHES.items():
        if offer.checksum.startswith(start):
            want = offer.checksum.removeprefix(start)
            with file.open("rb") as stream:
                found = hashlib.file_digest(stream, function).hexdigest()
            return "" if found == want else f"{function} {found[:12]}..., stated {want[:12]}..."
    # Without a checksum all of it is read once.
    try:
        with rasterio.open(file, driver="GTiff") as raster:
            for _, window in raster.block_windows(1):
                np.isfinite(raster.read(1, window=window)).any()
    except (RasterioError, OSError) as error:
        return str(error).replace(str(file), file.name)[:120]
    return ""


def write_vrt(file: Path, terrain: Terrain) -> Path:
    """Write a virtual raster, which ends in ``.vrt``, over the tiles of a terrain model.

    Paths in it are relative to it. The tiles have square cells, as ``open_tiles`` gives them. One
    that is there already is replaced; OutputError if it has changed since it was written.
    """
    sources = []
    # GDAL lets a later source cover an earlier one; here the first tile counts.
    for tile in reversed(terrain.tiles):
        with open_raster(tile.dem.file, "terrain.dem") as raster:
            at = tile.dem.band - 1
            stored, block = raster.dtypes[at], raster.block_shapes[at]
            place = seen_from(file.resolve().parent, Path(str(tile.dem.file)).resolve())
            source = {"tile": tile, "file": place, "block": block, "nodata": raster.nodata}
            sources.append({**source, "stored": stored, "kind": _TYPES.get(stored, "Float32")})
    alike = len({source["stored"] for source in sources}) == 1
    kind = sources[0]["kind"] if alike else "Float64"
    root = filled("terrain.vrt.j2", terrain=terrain, sources=sources, kind=kind, nodata=_NODATA)
    ET.indent(root, " ")
    write_new(file, ET.tostring(root, "unicode") + "\n", overwrite=True)
    return file
