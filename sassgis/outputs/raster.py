"""Maps as Cloud-Optimised GeoTIFF, whole or block by block, each with its QGIS style next to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.io import MemoryFile
from rasterio.windows import Window

from sassgis.files.atomic_output import write_text, writing
from sassgis.files.vector_layer import translated_raster
from sassgis.grid import Grid
from sassgis.inputs.dem import affine_of
from sassgis.outputs.layers.maps import terrain_layer
from sassgis.outputs.qgis.entries import LayerEntry, LayerGroup, qml
from sassgis.outputs.qgis.project import write_project
from sassgis.settings.results import Band, RasterLayer
from sassgis.settings.styles import HILLSHADE, PICTURE, class_tint, rgb, zero_is_nothing

#: Of measured numbers. NaN would do for the cells, but GDAL's most-frequent-value overviews turn it
#: into zeros (seen with 3.10); every GIS knows this one.
NODATA = -9999.0
#: Of maps of classes, by the type of their numbers; 0 is left to mean "not reached".
CLASS_NODATA = {"uint8": 255, "int16": -32768, "int32": -2147483648}
_BLOCK = 256
#: Side of the tiles of the files in between; blocks that begin at multiples of it are quickest.
TILE = 512
#: Most memory that GDAL may hold back (bytes), and work on at once as it makes overviews. With its
#: 10 MB for these it makes each overview of a wide file in between with several bands from all
#: cells, in place of from the one before as in write_raster, which takes twice as long.
_CACHE, _AT_ONCE = 256 << 20, 128 << 20


def write_raster(layer: RasterLayer, grid: Grid, folder: Path) -> Path:
    """Write a map as ``<stem>.tif`` and its style as ``<stem>.qml``; returns the first.

    The file is a Cloud-Optimised GeoTIFF: float32, nodata -9999, deflate, tiled. A map of classes
    is of the smallest type that holds them, as a rule uint8 with nodata 255 (else
    :data:`CLASS_NODATA`), in their colours, which its tag CLASSES names; float32 if another band
    holds fractions. Overviews of classes show the most frequent one, those of numbers the mean.
    Tags hold titles, notes and units. ValueError for bands of another shape than the grid, none, or
    a number above 0 that is no class.
    """
    if not layer.bands:
        raise ValueError(f"the map {layer.stem} has no band")
    for band in layer.bands:
        if band.values.shape != grid.shape:
            raise ValueError(
                f"band {band.name} of {layer.stem} has shape {band.values.shape}, "
                f"the grid {grid.shape}"
            )
    _check_classes(layer)
    target = folder / f"{layer.stem}.tif"
    number_type, nodata = _number_type(layer)
    profile = _frame_of(layer, grid, number_type, nodata) | _cog_options(layer)
    with writing(target), MemoryFile(ext=".tif") as memory:
        with memory.open(**profile) as dataset:
            _describe(dataset, layer, grid, number_type)
            for number, band in enumerate(layer.bands, start=1):
                dataset.write(_stored(band, number_type, nodata), number)
        folder.mkdir(parents=True, exist_ok=True)
        # GDAL writes when it closes a file and may then only log that the disk is full; plain
        # Python, writing what GDAL made in memory, fails with the reason.
        target.write_bytes(memory.getbuffer())
    _write_style(layer, target)
    return target


def _write_style(layer: RasterLayer, target: Path) -> None:
    write_text(target.with_suffix(".qml"), qml(translated_raster(layer)))


def _check_classes(layer: RasterLayer) -> None:
    """Raise ValueError if a map of classes holds a number above 0 that is no class."""
    if not layer.classes:
        return
    values = layer.bands[0].values
    known = {0, *(entry.value for entry in layer.classes)}
    strange = set(np.unique(values[np.isfinite(values)]).tolist()) - known
    if strange:
        raise ValueError(f"the map {layer.stem} holds {sorted(strange)}, which are no classes")


def _number_type(layer: RasterLayer) -> tuple[str, float]:
    """Return the type of the numbers in the file, and its nodata."""
    if not layer.classes:
        return "float32", NODATA
    held = [np.array([0, *(entry.value for entry in layer.classes)], float)]
    for band in layer.bands:
        known = band.values[np.isfinite(band.values)]
        if not np.array_equal(known, np.round(known)):
            return "float32", NODATA
        held.append(np.unique(known).astype(float))
    values = np.concatenate(held)
    for name, nodata in CLASS_NODATA.items():
        limits = np.iinfo(name)
        if limits.min <= values.min() and values.max() <= limits.max and nodata not in values:
            return name, nodata
    return "float32", NODATA


def _frame_of(layer: RasterLayer, grid: Grid, number_type: str, nodata: float) -> dict[str, Any]:
    """Return size, type and place of the file of a map."""
    return {
        "width": grid.shape[1], "height": grid.shape[0], "count": len(layer.bands),
        "dtype": number_type, "nodata": nodata, "crs": grid.crs or None,
        "transform": affine_of(grid),
    }  # fmt: skip


def _cog_options(layer: RasterLayer) -> dict[str, Any]:
    """Return GDAL's options for the Cloud-Optimised GeoTIFF of a map."""
    return {
        "driver": "COG",
        "compress": "DEFLATE",
        # Numbers that hang on counts share no digits with their neighbours: without it files are
        # 7 to 27 % smaller, and made in four fifths of the time.
        "predictor": "YES" if layer.ramp in (HILLSHADE, PICTURE) else "NO",
        "level": 3,  # Twice as fast as the default of 6, and no larger with floats.
        "num_threads": "ALL_CPUS",
        "blocksize": _BLOCK,
        # Of numbers the mean of the cells that have one, in the overview before; the most frequent
        # one takes three times as long, and is any of four that differ.
        "overview_resampling": "MODE" if layer.classes else "AVERAGE",
        # Kept in the file, or QGIS would write an .aux.xml next to it.
        "statistics": "YES",
        "bigtiff": "IF_SAFER",
    }


def _describe(dataset: Any, layer: RasterLayer, grid: Grid, number_type: str) -> None:
    """Set tags, names and colours."""
    layer = translated_raster(layer)
    dataset.update_tags(TITLE=layer.title, NOTE=layer.note, AREA_OR_POINT="Area")
    if layer.classes:
        names = "; ".join(f"{entry.value} = {entry.label}" for entry in layer.classes)
        dataset.update_tags(1, CLASSES=names)
    if grid.vertical_datum:
        dataset.update_tags(VERTICAL_DATUM=grid.vertical_datum)
    for number, band in enumerate(layer.bands, start=1):
        text = band.description or band.name
        united = f"{text} ({band.unit})" if band.unit and band.unit not in ("1", text) else text
        dataset.set_band_description(number, united)
        dataset.set_band_unit(number, band.unit)
        dataset.update_tags(number, NAME=band.name, DESCRIPTION=band.description)
    if number_type == "uint8" and len(layer.bands) == 1:
        # For programs that do not read the style.
        colours = dict.fromkeys(range(256), (255, 255, 255, 0))
        colours |= {entry.value: (*rgb(class_tint(entry)), 255) for entry in layer.classes}
        dataset.write_colormap(1, colours)


def _stored(band: Band, number_type: str, nodata: float) -> NDArray[Any]:
    """Return values of a band as they are in the file."""
    return np.where(np.isfinite(band.values), band.values, nodata).astype(number_type)


@dataclass(frozen=True, slots=True)
class Unfinished:
    """A map all of whose blocks are written: the file that holds them, and the one to make."""

    layer: RasterLayer
    between: Path
    target: Path


def finish_map(unfinished: Unfinished) -> None:
    """Turn the file in between into a Cloud-Optimised GeoTIFF with overviews; it stays."""
    limits = {"GDAL_CACHEMAX": _CACHE, "GDAL_OVR_CHUNK_MAX_SIZE": _AT_ONCE}
    with rasterio.Env(**limits), writing(unfinished.target):
        rasterio.shutil.copy(
            unfinished.between, unfinished.target, **_cog_options(unfinished.layer)
        )


class BlockMaps:
    """Maps of a grid that is too large for the memory: close them, then finish_map each.

    Cells of blocks that are never written are nodata. The files are those of write_raster, but for
    a map of classes whose other bands hold no classes: it holds fractions whatever the values.
    """

    def __init__(self, grid: Grid, folder: Path) -> None:
        self._grid = grid
        self._folder = folder
        self._open: dict[str, tuple[Any, RasterLayer]] = {}
        self._limits: dict[str, tuple[float, float]] = {}
        #: The maps, once they are closed; of their values only the smallest and the largest.
        self.unfinished: list[Unfinished] = []
        self._env = rasterio.Env(GDAL_CACHEMAX=_CACHE)

    def __enter__(self) -> BlockMaps:
        self._env.__enter__()
        with writing(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            for stem in list(self._open):
                self._close(stem, kind is None)
        finally:
            self._env.__exit__(kind, error, trace)

    def write(self, layer: RasterLayer, row: int, col: int) -> None:
        """Write a block of a map; ``row`` and ``col`` are those of its first cell."""
        _check_classes(layer)
        target = self._between(layer.stem)
        n_rows, n_cols = layer.bands[0].values.shape
        number_type, nodata = "float32", NODATA
        if layer.classes and all(band.unit == "class" for band in layer.bands):
            number_type, nodata = "uint8", CLASS_NODATA["uint8"]
        with writing(target):
            if layer.stem not in self._open:
                dataset = rasterio.open(
                    target, "w", **_frame_of(layer, self._grid, number_type, nodata),
                    driver="GTiff", compress="DEFLATE", zlevel=1, tiled=True, blockxsize=TILE,
                    blockysize=TILE, sparse_ok=True, bigtiff="YES", interleave="band",
                )  # fmt: skip
                _describe(dataset, layer, self._grid, number_type)
                empty = tuple(replace(b, values=b.values[:0]) for b in layer.bands)
                self._open[layer.stem] = dataset, replace(layer, bands=empty)
            dataset, _ = self._open[layer.stem]
            window = Window(col, row, n_cols, n_rows)
            for number, band in enumerate(layer.bands, start=1):
                dataset.write(_stored(band, number_type, nodata), number, window=window)
        shown = layer.bands[0].values
        shown = shown[np.isfinite(shown)]
        if zero_is_nothing(layer.bands[0].unit):
            shown = shown[shown != 0]
        if shown.size:
            low, high = self._limits.get(layer.stem, (np.inf, -np.inf))
            self._limits[layer.stem] = min(low, float(shown.min())), max(high, float(shown.max()))

    def _between(self, stem: str) -> Path:
        return self._folder / f"{stem}.blocks.tif"

    def _close(self, stem: str, whole: bool) -> None:
        """Close a map whose blocks are written, and write its style."""
        dataset, layer = self._open.pop(stem)
        between, target = self._between(stem), self._folder / f"{stem}.tif"
        with writing(target):
            dataset.close()
            if not whole:
                between.unlink()
                return
        # Styles without limits go from the smallest to the largest value.
        limits = np.array([self._limits.get(stem, (np.nan, np.nan))])
        layer = replace(layer, bands=(replace(layer.bands[0], values=limits), *layer.bands[1:]))
        _write_style(layer, target)
        self.unfinished.append(Unfinished(layer, between, target))


def write_over_relief(
    work: Path,
    grid: Grid,
    maps: Sequence[RasterLayer],
    *,
    group: str,
    title: str,
    abstract: str,
    zones: LayerEntry | None = None,
) -> None:
    """Write maps and ``project.qgz``, in which the first map is seen, or zones in its place."""
    terrain = terrain_layer(grid)
    for layer in (*maps, terrain):
        write_raster(layer, grid, work / "maps")
    entries = tuple(
        LayerEntry(layer, f"maps/{layer.stem}.tif", visible=i == 0 and zones is None)
        for i, layer in enumerate(maps)
    )
    groups = [
        LayerGroup(group, entries, exclusive=True),
        LayerGroup("Terrain", (LayerEntry(terrain, "maps/terrain.tif"),)),
    ]
    write_project(
        work / "project.qgz",
        title=title,
        crs=grid.crs,
        groups=groups if zones is None else [LayerGroup("Zones", (zones,)), *groups],
        extent=grid.bounds,
        abstract=abstract,
    )
