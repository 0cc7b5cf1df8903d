"""Maps that are written block by block, so that none is ever in memory as a whole."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.windows import Window

from sassgis.io.staging import writing
from sassgis.io.write.raster import (
    CLASS_NODATA,
    NODATA,
    check_classes,
    cog_options,
    describe,
    frame_of,
    stored,
    write_style,
)
from sassgis.model.grid import Grid
from sassgis.model.results import RasterLayer
from sassgis.model.styles import zero_is_nothing

#: Side of the tiles of the files in between; blocks that begin at multiples of it are quickest.
TILE = 512
#: Most memory that GDAL may hold back (bytes).
_CACHE = 256 << 20


@dataclass(frozen=True, slots=True)
class Unfinished:
    """A map all of whose blocks are written: the file that holds them, and the one to make."""

    layer: RasterLayer
    between: Path
    target: Path


def finish_map(unfinished: Unfinished) -> None:
    """Turn the file in between into a Cloud-Optimised GeoTIFF with overviews; it stays."""
    with rasterio.Env(GDAL_CACHEMAX=_CACHE), writing(unfinished.target):
        rasterio.shutil.copy(unfinished.between, unfinished.target, **cog_options(unfinished.layer))


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
        self._unfinished: list[Unfinished] = []
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
        check_classes(layer)
        target = self._between(layer.stem)
        n_rows, n_cols = layer.bands[0].values.shape
        number_type, nodata = "float32", NODATA
        if layer.classes and all(band.unit == "class" for band in layer.bands):
            number_type, nodata = "uint8", CLASS_NODATA["uint8"]
        with writing(target):
            if layer.stem not in self._open:
                dataset = rasterio.open(
                    target, "w", **frame_of(layer, self._grid, number_type, nodata),
                    driver="GTiff", compress="DEFLATE", zlevel=1, tiled=True, blockxsize=TILE,
                    blockysize=TILE, sparse_ok=True, bigtiff="YES", interleave="band",
                )  # fmt: skip
                describe(dataset, layer, self._grid, number_type)
                empty = tuple(replace(b, values=b.values[:0]) for b in layer.bands)
                self._open[layer.stem] = dataset, replace(layer, bands=empty)
            dataset, _ = self._open[layer.stem]
            window = Window(col, row, n_cols, n_rows)
            for number, band in enumerate(layer.bands, start=1):
                dataset.write(stored(band, number_type, nodata), number, window=window)
        shown = layer.bands[0].values
        shown = shown[np.isfinite(shown)]
        if zero_is_nothing(layer.bands[0].unit):
            shown = shown[shown != 0]
        if shown.size:
            low, high = self._limits.get(layer.stem, (np.inf, -np.inf))
            self._limits[layer.stem] = min(low, float(shown.min())), max(high, float(shown.max()))

    @property
    def unfinished(self) -> tuple[Unfinished, ...]:
        """The maps, once they are closed; of their values only the smallest and the largest."""
        return tuple(self._unfinished)

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
        # Styles without limits of their own go from the smallest to the largest value.
        limits = np.array([self._limits.get(stem, (np.nan, np.nan))])
        layer = replace(layer, bands=(replace(layer.bands[0], values=limits), *layer.bands[1:]))
        write_style(layer, target)
        self._unfinished.append(Unfinished(layer, between, target))
