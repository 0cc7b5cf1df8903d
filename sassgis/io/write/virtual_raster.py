"""Tiles as one virtual raster (VRT), which GDAL and QGIS open as a single file."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from sassgis.io.read.dem import open_raster
from sassgis.io.read.plain_file import seen_from
from sassgis.io.read.tiles import Terrain
from sassgis.io.staging import write_new

#: Types that hold the nodata of the whole; heights in others are given as Float32.
_TYPES = {"float32": "Float32", "float64": "Float64", "int16": "Int16", "int32": "Int32"}
_NODATA = -9999.0


def write_vrt(file: Path, terrain: Terrain, overwrite: bool = False) -> Path:
    """Write a virtual raster, which ends in ``.vrt``, over the tiles of a terrain model.

    Paths in it are relative to it. The tiles have square cells, as ``open_tiles`` gives them.
    OutputError if the file is there already.
    """
    whole, cell = terrain.whole, terrain.cell_size
    root = ET.Element("VRTDataset", rasterXSize=str(whole.n_cols), rasterYSize=str(whole.n_rows))
    if terrain.crs:
        ET.SubElement(root, "SRS").text = terrain.crs
    corner = (terrain.west, cell, 0.0, terrain.north, 0.0, -cell)
    ET.SubElement(root, "GeoTransform").text = ", ".join(repr(float(v)) for v in corner)
    sources = []
    kinds = set()
    # GDAL lets a later source cover an earlier one; here the first tile counts.
    for tile in reversed(terrain.tiles):
        with open_raster(tile.dem.file, "terrain.dem") as raster:
            kind, nodata = raster.dtypes[tile.dem.band - 1], raster.nodata
            block = raster.block_shapes[tile.dem.band - 1]
        kinds.add(kind)
        source = ET.Element("ComplexSource")
        place = seen_from(file.resolve().parent, Path(str(tile.dem.file)).resolve())
        ET.SubElement(source, "SourceFilename", relativeToVRT="1").text = place
        ET.SubElement(source, "SourceBand").text = str(tile.dem.band)
        rows, cols = tile.dem.shape
        ET.SubElement(
            source, "SourceProperties", RasterXSize=str(cols), RasterYSize=str(rows),
            DataType=_TYPES.get(kind, "Float32"),
            BlockXSize=str(block[1]), BlockYSize=str(block[0]),
        )  # fmt: skip
        size = {"xSize": str(cols), "ySize": str(rows)}
        ET.SubElement(source, "SrcRect", {"xOff": "0", "yOff": "0", **size})
        ET.SubElement(
            source, "DstRect", {"xOff": str(tile.place.col), "yOff": str(tile.place.row), **size}
        )
        if nodata is not None:
            ET.SubElement(source, "NODATA").text = repr(float(nodata))
        sources.append(source)
    kind = _TYPES.get(kinds.pop(), "Float32") if len(kinds) == 1 else "Float64"
    band = ET.SubElement(root, "VRTRasterBand", dataType=kind, band="1")
    ET.SubElement(band, "NoDataValue").text = repr(_NODATA)
    band.extend(sources)
    ET.indent(root, " ")
    write_new(file, ET.tostring(root, "unicode") + "\n", overwrite)
    return file
