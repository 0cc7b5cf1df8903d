"""Maps as Cloud-Optimised GeoTIFF, each with its QGIS style beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rasterio.io import MemoryFile
from rasterio.transform import from_origin

from sassgis.core.grid import Grid
from sassgis.core.results import Band, RasterLayer
from sassgis.io.qgis.styles import HILLSHADE, qml, raster_style_elements
from sassgis.io.staging import writing

#: NaN would do for the cells, but GDAL's most-frequent-value overviews turn it into zeros (seen
#: with 3.10); every GIS knows this one.
NODATA = -9999.0
_BLOCK = 256


def write_raster(layer: RasterLayer, grid: Grid, folder: Path) -> Path:
    """Write a map as ``<stem>.tif`` and its style as ``<stem>.qml``.

    The file is a Cloud-Optimised GeoTIFF: float32, nodata -9999, deflate, tiled. Its overviews are
    made of values that occur (the most frequent one), so that a class seen from afar is a class of
    the map; only heights for shaded relief are averaged. The descriptions and units of the bands
    and the title and note of the layer are in its tags.

    Parameters
    ----------
    layer : RasterLayer
    grid : Grid
        Gives the place, cell size and CRS; its values are not used.
    folder : Path
        Made if missing.

    Returns
    -------
    Path
        The GeoTIFF.

    Raises
    ------
    OutputError
        If the disk is full or not writable.
    ValueError
        If a band does not have the shape of the grid, or there is none.
    """
    if not layer.bands:
        raise ValueError(f"the map {layer.stem} has no band")
    for band in layer.bands:
        if band.values.shape != grid.shape:
            raise ValueError(
                f"band {band.name} of {layer.stem} has shape {band.values.shape}, "
                f"the grid {grid.shape}"
            )
    target = folder / f"{layer.stem}.tif"
    with writing(target):
        folder.mkdir(parents=True, exist_ok=True)
        # GDAL writes when it closes a file and may then only log that the disk is full; plain
        # Python, writing what GDAL made in memory, fails with the reason.
        target.write_bytes(_encode(layer, grid))
    style = target.with_suffix(".qml")
    with writing(style):
        style.write_text(qml(raster_style_elements(layer)), encoding="utf-8")
    return target


def _encode(layer: RasterLayer, grid: Grid) -> bytes:
    n_rows, n_cols = grid.shape
    with MemoryFile(ext=".tif") as memory:
        with memory.open(
            driver="COG",
            width=n_cols,
            height=n_rows,
            count=len(layer.bands),
            dtype="float32",
            nodata=NODATA,
            crs=grid.crs or None,
            transform=from_origin(grid.west, grid.north, grid.cell_size, grid.cell_size),
            compress="DEFLATE",
            predictor="YES",
            level=3,  # Twice as fast as the default of 6, and no larger with floats.
            num_threads="ALL_CPUS",
            blocksize=_BLOCK,
            # Relief made of single heights, picked here and there, would look rough.
            overview_resampling="AVERAGE" if layer.ramp == HILLSHADE else "MODE",
            # Kept in the file, or QGIS would write an .aux.xml beside it.
            statistics="YES",
            bigtiff="IF_SAFER",
        ) as dataset:
            dataset.update_tags(TITLE=layer.title, NOTE=layer.note, AREA_OR_POINT="Area")
            if grid.vertical_datum:
                dataset.update_tags(VERTICAL_DATUM=grid.vertical_datum)
            for number, band in enumerate(layer.bands, start=1):
                values = np.where(np.isfinite(band.values), band.values, np.float32(NODATA))
                dataset.write(values.astype(np.float32, copy=False), number)
                dataset.set_band_description(number, _band_title(band))
                dataset.set_band_unit(number, band.unit)
                dataset.update_tags(number, NAME=band.name, DESCRIPTION=band.description)
        return bytes(memory.getbuffer())


def _band_title(band: Band) -> str:
    """What QGIS lists as the band: its description with the unit."""
    text = band.description or band.name
    return f"{text} ({band.unit})" if band.unit and band.unit not in ("1", text) else text
