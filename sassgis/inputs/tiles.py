"""Terrain in tiles: one lattice of cells, of which only the parts that are needed are read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pyproj
from affine import Affine
from rasterio.windows import Window, bounds
from scipy import ndimage

from sassgis.errors import InputError, InputLost, notice
from sassgis.files.input_parts import mosaic_places
from sassgis.grid import BoolArray, FloatArray, Grid, IntArray
from sassgis.inputs.dem import (
    DemFile,
    describe_dem,
    open_raster,
    read_dem,
    read_dem_part,
    require_room,
)
from sassgis.inputs.dem_system import extent_text
from sassgis.settings.crs import crs_name, same_crs
from sassgis.settings.results import some_of
from sassgis.settings.schema import AnyInput, InMemory, Input, named

#: Rasters by their suffix; other files of a folder of tiles do not count.
TILE_SUFFIXES = (".tif", ".tiff", ".asc", ".img", ".bil", ".flt")
#: Cells of tiles may be off the common lattice by this share of a cell.
_OFF_LATTICE = 0.01
#: A tile is missing with others on so many sides of its place, or if these cover so much of a
#: rectangle.
_ENCLOSED, _NEARLY_FULL = 3, 0.75
#: Heights of tiles that overlap: equal up to here (m), and not of one terrain beyond (median, m).
_SAME_HEIGHT_M, _OTHER_TERRAIN_M = 0.01, 0.5


@dataclass(frozen=True, slots=True)
class Part:
    """Some rows and columns of a lattice of cells."""

    row: int  # row and column of the first cell; may be negative
    col: int
    n_rows: int
    n_cols: int

    @property
    def end(self) -> tuple[int, int]:
        """First row and column beyond."""
        return self.row + self.n_rows, self.col + self.n_cols

    def common(self, other: Part) -> Part | None:
        """Return the cells that are in both."""
        row, col = max(self.row, other.row), max(self.col, other.col)
        last_row, last_col = (min(a, b) for a, b in zip(self.end, other.end, strict=True))
        if last_row <= row or last_col <= col:
            return None
        return Part(row, col, last_row - row, last_col - col)

    def grown(self, north: int, east: int, south: int, west: int) -> Part:
        """Return the part with so many rows and columns more on each side."""
        n_rows, n_cols = self.n_rows + north + south, self.n_cols + west + east
        return Part(self.row - north, self.col - west, n_rows, n_cols)

    def cells_in(self, other: Part, cells: IntArray) -> tuple[BoolArray, IntArray]:
        """Find which of some cells (flat indices) lie in ``other``, and where these are there."""
        row, col = np.divmod(np.asarray(cells, np.int64), self.n_cols)
        row, col = row + self.row - other.row, col + self.col - other.col
        inside = (row >= 0) & (row < other.n_rows) & (col >= 0) & (col < other.n_cols)
        flat: IntArray = (row * other.n_cols + col)[inside]
        return inside, flat


def hull(parts: Sequence[Part]) -> Part:
    """Return the smallest part that holds all of the parts, of which there is one at least."""
    row, col = min(p.row for p in parts), min(p.col for p in parts)
    last = (max(p.end[0] for p in parts), max(p.end[1] for p in parts))
    return Part(row, col, last[0] - row, last[1] - col)


def gaps_between(parts: Sequence[Part]) -> list[Part]:
    """Find where parts of a terrain leave something out that is probably missing.

    There are parts on three sides of it or more, or all of them nearly fill a rectangle: the border
    along a valley has steps. Each is the smallest part that holds what is connected of it.
    """
    ends = np.array([(p.row, p.end[0], p.col, p.end[1]) for p in parts])
    rows, cols = np.unique(ends[:, :2]), np.unique(ends[:, 2:])
    covered = np.zeros((rows.size - 1, cols.size - 1), np.bool_)
    at = np.hstack([np.searchsorted(rows, ends[:, :2]), np.searchsorted(cols, ends[:, 2:])])
    for top, low, left, right in at.tolist():
        covered[top:low, left:right] = True
    sides = np.zeros(covered.shape, np.int64)
    for axis in (0, 1):
        sides += np.logical_or.accumulate(covered, axis)
        sides += np.flip(np.logical_or.accumulate(np.flip(covered, axis), axis), axis)
    cells = np.outer(np.diff(rows), np.diff(cols))
    is_rectangle = cells[covered].sum() >= _NEARLY_FULL * cells.sum()
    missing = ~covered & (is_rectangle | (sides >= _ENCLOSED))
    found = []
    for own in ndimage.find_objects(ndimage.label(missing)[0]):
        row, col = int(rows[own[0].start]), int(cols[own[1].start])
        end = int(rows[own[0].stop]), int(cols[own[1].stop])
        found.append(Part(row, col, end[0] - row, end[1] - col))
    return found


def gaps_text(parts: Sequence[Part], transform: Affine) -> str:
    """Describe where tiles leave gaps; empty if nowhere."""
    windows = [Window(own.col, own.row, own.n_cols, own.n_rows) for own in gaps_between(parts)]
    gaps = [f"({extent_text(*bounds(window, transform))})" for window in windows]
    return f"no tile covers {some_of(gaps, str)}: no height is known there" if gaps else ""


def gaps_of_mosaic(file: Input) -> str:
    """Return the same of a virtual raster; empty of any other raster."""
    places = mosaic_places(file) if isinstance(file, Path) else ()
    if not places:
        return ""
    with open_raster(file, "terrain.dem") as dataset:
        return gaps_text([Part(*own) for own in places], dataset.transform)


@dataclass(frozen=True, slots=True)
class Tile:
    """A raster and the part of the lattice that it covers."""

    dem: DemFile
    place: Part


@dataclass(frozen=True, slots=True)
class Terrain:
    """A terrain model that is read part by part."""

    #: From north to south and west to east; where they overlap the first with a height counts.
    tiles: tuple[Tile, ...]
    west: float  # of the lattice (m)
    north: float
    cell_size: float
    whole: Part  # everything, from row and column 0
    crs: str  # as in Grid
    vertical_datum: str
    #: Heights in memory, of the shape of a part: all of them where the raster had to be resampled
    #: to square cells and so read as a whole.
    held: tuple[Part, FloatArray] | None = None

    @property
    def gaps(self) -> str:
        """Where tiles are missing, in words; empty if nowhere."""
        corner = Affine(self.cell_size, 0.0, self.west, 0.0, -self.cell_size, self.north)
        return gaps_text([t.place for t in self.tiles], corner) or gaps_of_mosaic(
            self.tiles[0].dem.file
        )

    def holding(self, part: Part) -> Terrain:
        """Return terrain model with the heights of a part in memory: within it no file is read."""
        return self if self._holds(part) else replace(self, held=(part, self.read(part).values))

    def _holds(self, part: Part) -> bool:
        """Return whether all heights of a part are in memory."""
        inside = self.whole.common(part)
        return inside is None or (self.held is not None and self.held[0].common(inside) == inside)

    def read(self, part: Part) -> Grid:
        """Return heights of a part, NaN where no tile holds one; InputLost if a file is lost."""
        values = np.full((part.n_rows, part.n_cols), np.nan)
        if self.held is not None:
            place, heights = self.held
            own = place.common(part)
            if own is not None:
                values[_within(own, part)] = heights[_within(own, place)]
        for tile in () if self._holds(part) else self.tiles:
            own = tile.place.common(part)
            if own is not None:
                here = values[_within(own, part)]
                # Overlaps: what an earlier tile holds stays.
                np.copyto(here, _heights(tile, own), where=np.isnan(here))
        return replace(self.frame(part), values=values)

    def outline(self) -> Grid:
        """Return the whole lattice without its heights, which take no memory and are 0."""
        return self.frame(self.whole)

    def part_of(self, bounds: Sequence[float]) -> Part:
        """Return cells that meet a rectangle (west, south, east, north), also beyond the DEM."""
        west, south, east, north = bounds
        col, last_col = (math.floor((x - self.west) / self.cell_size) for x in (west, east))
        row, last_row = (math.floor((self.north - y) / self.cell_size) for y in (north, south))
        return Part(row, col, last_row - row + 1, last_col - col + 1)

    def frame(self, part: Part) -> Grid:
        """Return a part of the lattice without its heights, which take no memory and are 0."""
        values = np.broadcast_to(np.zeros(1), (part.n_rows, part.n_cols))
        west = self.west + part.col * self.cell_size
        north = self.north - part.row * self.cell_size
        return Grid(values, west, north, self.cell_size, self.crs, self.vertical_datum)


def _within(part: Part, whole: Part) -> tuple[slice, slice]:
    """Return rows and columns of a part, counted from the first cell of ``whole``."""
    row, col = part.row - whole.row, part.col - whole.col
    return slice(row, row + part.n_rows), slice(col, col + part.n_cols)


def _heights(tile: Tile, part: Part) -> FloatArray:
    file = tile.dem.file
    if isinstance(file, Path) and not file.exists():
        raise InputLost(f"{file}: was there when the terrain model was opened, and is gone")
    return read_dem_part(tile.dem, *_within(part, tile.place))


def open_terrain(
    path: AnyInput,
    crs: str | None = None,
    vertical_datum: str | None = None,
    override_crs: bool = False,
) -> Terrain:
    """Open a terrain model without reading its heights.

    It is a raster, a virtual raster (VRT), or a folder of tiles, of which all rasters with one of
    TILE_SUFFIXES count. The other parameters are those of sassgis.inputs.dem.read_dem.
    """
    given = named(path)
    if isinstance(given, InMemory) or not given.is_dir():
        dem = describe_dem(given, crs, vertical_datum, override_crs)
        if not dem.is_plain:
            grid = read_dem(given, crs, vertical_datum, override_crs)
            whole = Part(0, 0, *grid.shape)
            place = grid.west, grid.north, grid.cell_size, whole, grid.crs, grid.vertical_datum
            return Terrain((Tile(dem, whole),), *place, (whole, grid.values))
        return _laid_out([dem], given)
    files = sorted(f for f in given.iterdir() if f.suffix.lower() in TILE_SUFFIXES)
    if not files:
        raise InputError(
            "holds no tile of a terrain model", file=given, field="terrain.dem",
            expected=f"a raster, a VRT, or a folder of rasters ({', '.join(TILE_SUFFIXES)})",
        )  # fmt: skip
    if len(files) == 1:
        return open_terrain(files[0], crs, vertical_datum, override_crs)
    return _laid_out([describe_dem(f, crs, vertical_datum, override_crs) for f in files], given)


def open_tiles(files: Sequence[Path], given: Path) -> Terrain:
    """Open tiles as one terrain model; ``given`` names them in notices."""
    return _laid_out([describe_dem(f) for f in files], given)


def read_terrain(
    path: AnyInput,
    crs: str | None = None,
    vertical_datum: str | None = None,
    override_crs: bool = False,
) -> Grid:
    """Read a terrain model as a whole: a raster, or a folder of tiles, as open_terrain opens it."""
    given = named(path)
    if not given.is_dir():
        if gaps := gaps_of_mosaic(given):
            notice(f"{given}: {gaps}")
        return read_dem(given, crs, vertical_datum, override_crs)
    return read_whole(open_terrain(given, crs, vertical_datum, override_crs), given)


def read_whole(terrain: Terrain, given: Input) -> Grid:
    """Read a terrain model that is open, as a whole; InputError if it is too large or empty."""
    require_room((terrain.whole.n_rows, terrain.whole.n_cols), given)
    grid = terrain.read(terrain.whole)
    if not np.isfinite(grid.values).any():
        raise InputError("holds no height at all", file=given, field="terrain.dem")
    return grid


def _laid_out(dems: Sequence[DemFile], given: Input) -> Terrain:
    """Put tiles on one lattice."""
    first = dems[0]
    for dem in dems:
        if not dem.is_plain:
            raise InputError(
                "cells are not square with north up, as tiles must be", file=dem.file,
                found=f"{tuple(dem.transform)[:6]}",
                expected="a raster that rio warp has brought onto the lattice of the others",
            )  # fmt: skip
        _check_alike(first, dem)
    cell = _cell(first)
    west = min(d.transform.c for d in dems)
    north = max(d.transform.f for d in dems)
    tiles = [Tile(d, _place(d, west, north, cell)) for d in dems]
    tiles.sort(key=lambda t: (t.place.row, t.place.col, t.dem.file.name))
    _check_overlaps(tiles)
    whole = hull([t.place for t in tiles])
    covered = sum(t.place.n_rows * t.place.n_cols for t in tiles)
    notice(f"{given}: {len(tiles)} tiles, {covered} cells", "info")
    place = west, north, cell, whole, first.crs, first.vertical_datum
    terrain = Terrain(tuple(tiles), *place)
    if gaps := terrain.gaps:
        notice(f"{given}: {gaps}")
    return terrain


def _cell(dem: DemFile) -> float:
    return float(dem.transform.a - dem.transform.e) / 2.0


def _check_alike(first: DemFile, dem: DemFile) -> None:
    def refuse(what: str, found: str, expected: str) -> InputError:
        expected = f"{expected}, as {first.file.name}"
        return InputError(f"tiles have {what}", file=dem.file, found=found, expected=expected)

    systems = (first.crs, dem.crs)
    if systems[0] != systems[1] and (
        "" in systems or not same_crs(*(pyproj.CRS.from_wkt(s) for s in systems))
    ):
        raise refuse("different coordinate systems", crs_name(dem.crs), crs_name(first.crs))
    datums = [own.vertical_datum or "none stated" for own in (dem, first)]
    if dem.vertical_datum != first.vertical_datum:
        raise refuse("different height systems", *datums)
    a, b = _cell(first), _cell(dem)
    if abs(a - b) * max(*dem.shape, *first.shape) > _OFF_LATTICE * a:
        raise refuse("cells of different sizes", f"{b:.9g} m", f"{a:.9g} m")


def _place(dem: DemFile, west: float, north: float, cell: float) -> Part:
    col, row = (dem.transform.c - west) / cell, (north - dem.transform.f) / cell
    off = max(abs(col - round(col)), abs(row - round(row)))
    if off > _OFF_LATTICE:
        raise InputError(
            "cells of the tiles do not lie on one lattice",
            file=dem.file,
            found=f"corner {dem.transform.c:.10g}, {dem.transform.f:.10g}, {off:.3g} of a cell off",
            expected=f"corners a whole number of cells of {cell:g} m from each other; "
            "rio warp --target-aligned-pixels makes it so",
        )
    return Part(round(row), round(col), *dem.shape)


def _check_overlaps(tiles: Sequence[Tile]) -> None:
    """Check that tiles hold one terrain where they overlap."""
    for one, two in combinations(tiles, 2):
        common = one.place.common(two.place)
        if common is None:
            continue
        gap = np.abs(_heights(one, common) - _heights(two, common))
        gap = gap[np.isfinite(gap)]
        if not gap.size or gap.max() <= _SAME_HEIGHT_M:
            continue
        found = f"{float(np.median(gap)):.3g} m (median), up to {float(gap.max()):.3g} m"
        if np.median(gap) > _OTHER_TERRAIN_M:
            raise InputError(
                f"heights differ from those of {one.dem.file.name} where both overlap",
                file=two.dem.file, found=f"{found}, in {gap.size} cells",
                expected=f"the same heights, within {_OTHER_TERRAIN_M:g} m (median)",
            )  # fmt: skip
        notice(
            f"{two.dem.file}: heights differ by {found} from those of {one.dem.file.name}, which "
            "count where both overlap"
        )
