"""Tiles as one virtual raster (VRT), which GDAL and QGIS open as a single file."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from sassgis.io.qgis.markup import filled
from sassgis.io.read.dem import open_raster
from sassgis.io.read.plain_file import seen_from
from sassgis.io.read.tiles import Terrain
from sassgis.io.staging import write_new

#: Types that hold the nodata of the whole; heights in others are given as Float32.
_TYPES = {"float32": "Float32", "float64": "Float64", "int16": "Int16", "int32": "Int32"}
_NODATA = -9999.0


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
