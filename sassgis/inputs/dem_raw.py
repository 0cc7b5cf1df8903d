"""A terrain model with its faults, also where ``read_dem`` would refuse it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
from affine import Affine
from rasterio.transform import xy

from sassgis.errors import InputError
from sassgis.grid import FloatArray
from sassgis.inputs.dem import (
    HIGHEST_M,
    LOWEST_M,
    METRES,
    affine_of,
    describe_dem,
    height_band,
    lone_zeros,
    open_raster,
    read_band,
)
from sassgis.inputs.dem_system import beyond_degrees
from sassgis.inputs.tiles import gaps_of_mosaic, open_terrain, read_whole

#: Length of a degree of latitude (m), for the size of cells that are in degrees.
_DEGREE_M = 111_195.0


@dataclass(frozen=True)
class RawDem:
    """Heights with the faults of their file."""

    values: FloatArray  # heights (m), shape (n_rows, n_cols); NaN where nothing can be known
    dx_m: float  # size of the cells (m), roughly where they are in degrees
    dy_m: float
    transform: Affine  # from columns and rows to the coordinates of the file
    crs: str  # well-known text; empty where it is not stated, as the name of the height system
    vertical_datum: str
    unit: str  # of the heights as the file states it
    #: Whether the size of the cells in metres is known: it is not where the file says degrees and
    #: holds coordinates that cannot be. They are taken as metres then.
    in_metres: bool = True
    square: bool = True  # whether cells are square with north up
    system_fault: InputError | None = None  # why its coordinate system would be refused
    unit_fault: str = ""  # why the unit of the heights would be refused; empty if it would not
    nodata: float | None = None  # as the file declares it; None for a folder of tiles
    #: Cells with numbers that are no heights: infinite, beyond what occurs on Earth, or exactly 0
    #: where all others are far above. They are NaN in ``values``.
    not_heights: int = 0
    gaps: str = ""  # where tiles are missing, in words; empty if nowhere

    def place(self, row: int, col: int) -> tuple[float, float]:
        """Return x and y of the centre of a cell."""
        x, y = xy(self.transform, row, col)
        return float(x), float(y)


def read_raw_dem(path: Path, crs: str | None = None, override_crs: bool = False) -> RawDem:
    """Read a terrain model with its faults; a folder of tiles must be one that can be used.

    ``crs`` counts where the file states none, or with ``override_crs`` in place of it.
    """
    if path.is_dir():
        terrain = open_terrain(path, crs, None, override_crs)
        grid, gaps = read_whole(terrain, path), terrain.gaps
        size, place = grid.cell_size, affine_of(grid)
        return RawDem(grid.values, size, size, place, grid.crs, grid.vertical_datum, "m", gaps=gaps)
    system_fault, wkt, datum = None, "", ""
    gaps = gaps_of_mosaic(path)
    with open_raster(path, "DEM") as dataset:
        band = height_band(dataset, path)
        try:
            described = describe_dem(path, crs, None, override_crs)
            wkt, datum, factor = described.crs, described.vertical_datum, described.vertical_unit
            square = described.is_plain
        except InputError as error:
            if min(dataset.shape) < 3:
                raise
            system_fault, factor, square = error, 1.0, True
        unit = (dataset.units[band - 1] or "").strip()
        unit_fault = "" if unit.lower() in METRES else f"unknown unit {unit!r}"
        if unit and not unit_fault:
            factor = METRES[unit.lower()]
        values, not_heights = _heights(dataset, band, path, factor)
        dx, dy, in_metres = _cell_sizes(dataset, wkt)
        transform = dataset.transform
        nodata = dataset.nodata
    if not np.isfinite(values).any():
        raise InputError("holds no height at all", file=path, field=f"band {band}")
    return RawDem(
        values=values,
        dx_m=dx,
        dy_m=dy,
        transform=transform,
        crs=wkt,
        vertical_datum=datum,
        unit=unit,
        in_metres=in_metres,
        square=square,
        system_fault=system_fault,
        unit_fault=unit_fault,
        nodata=nodata,
        not_heights=not_heights,
        gaps=gaps,
    )


def _heights(dataset: Any, band: int, file: Path, factor: float) -> tuple[FloatArray, int]:
    """Return heights (m), and how many cells hold none that can be meant."""
    raw = read_band(dataset, band, file)
    values = np.array(raw.data, dtype=np.float64)
    values[np.ma.getmaskarray(raw)] = np.nan
    infinite = np.isinf(values)
    values[infinite] = np.nan
    values = (values * dataset.scales[band - 1] + dataset.offsets[band - 1]) * factor
    strange = (values < LOWEST_M) | (values > HIGHEST_M)
    values[strange] = np.nan
    strange |= lone_zeros(values)
    values[strange] = np.nan
    return values, int((strange | infinite).sum())


def _cell_sizes(dataset: Any, wkt: str) -> tuple[float, float, bool]:
    """Return the size of a cell in metres, and whether it is known."""
    t = dataset.transform
    width, height = math.hypot(t.a, t.d), math.hypot(t.b, t.e)
    system = None
    if wkt or dataset.crs:
        system = pyproj.CRS.from_user_input(wkt or dataset.crs)
    if system is not None and system.is_geographic:
        bounds = dataset.bounds
        if beyond_degrees(*bounds):
            return width, height, False
        middle = math.radians(0.5 * (bounds.top + bounds.bottom))
        return width * _DEGREE_M * math.cos(middle), height * _DEGREE_M, True
    factor = 1.0
    if system is not None and system.axis_info:
        factor = float(system.axis_info[0].unit_conversion_factor)
    return width * factor, height * factor, True
