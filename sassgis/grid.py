"""Regular, north-up grids with square cells."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
#: Classes of the cells of a grid: there may be many cells.
ClassMap = NDArray[np.int16]
BoolArray = NDArray[np.bool_]
#: West, south, east and north (m).
Bounds = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Grid:
    """A raster of heights: square cells, row 0 in the north, NaN where nothing is known.

    Attributes
    ----------
    values : float64, shape (n_rows, n_cols)
        Height of the cell *centre* in metres; NaN is nodata.
    west, north : float
        Outer corner of the first cell in the coordinates of ``crs`` (m).
    cell_size : float
        Side of a cell (m).
    crs : str
        Well-known text of the projected coordinate system; empty for local coordinates.
    vertical_datum : str
        Name of the height system, as far as the file or the user states it.
    """

    values: FloatArray
    west: float
    north: float
    cell_size: float
    crs: str = ""
    vertical_datum: str = ""

    @property
    def shape(self) -> tuple[int, int]:
        return (int(self.values.shape[0]), int(self.values.shape[1]))

    @property
    def bounds(self) -> Bounds:
        """(west, south, east, north) of the outer cell edges (m)."""
        n_rows, n_cols = self.shape
        south, east = self.north - n_rows * self.cell_size, self.west + n_cols * self.cell_size
        return self.west, south, east, self.north

    def part(self, rows: slice, cols: slice) -> Grid:
        """Return the cells of some rows and columns, which have a first and a last one."""
        west = self.west + cols.start * self.cell_size
        north = self.north - rows.start * self.cell_size
        return replace(self, values=self.values[rows, cols], west=west, north=north)

    def uv(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return fractional numbers of cells from the west and the north edge to points."""
        u, v = np.asarray(x, float) - self.west, self.north - np.asarray(y, float)
        return u / self.cell_size, v / self.cell_size

    def col_row(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return fractional column and row of points; the centre of cell (i, j) is (j, i)."""
        u, v = self.uv(x, y)
        return u - 0.5, v - 0.5

    def cell_of(self, x: FloatArray, y: FloatArray) -> IntArray:
        """Return flat index (row * n_cols + col) of the cells that hold the points; -1 outside."""
        n_rows, n_cols = self.shape
        col, row = (np.floor(own) for own in self.uv(x, y))
        inside = (col >= 0) & (col < n_cols) & (row >= 0) & (row < n_rows)
        row, col = (np.where(inside, own, 0).astype(np.int64) for own in (row, col))
        return np.where(inside, row * n_cols + col, np.int64(-1))

    def value_at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return values of the cells that hold the points; NaN outside."""
        cells = self.cell_of(x, y)
        values: FloatArray = np.where(cells < 0, np.nan, self.values.ravel()[np.maximum(cells, 0)])
        return values

    def cell_centres(self, cells: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return x and y (m) of the centres of flat cell indices."""
        n_cols = self.shape[1]
        row, col = np.divmod(np.asarray(cells, np.int64), n_cols)
        return (self.west + (col + 0.5) * self.cell_size, self.north - (row + 0.5) * self.cell_size)
