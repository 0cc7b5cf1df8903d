"""A result that was written earlier, as far as two of them can be compared."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import shapely

from sassgis.errors import InputError
from sassgis.grid import FloatArray, Grid
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.settings.crs import crs_name, same_crs
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.results import CHANGED_SHARE, RasterLayer

#: Part of a cell by which cells of two maps may lie apart.
_APART = 0.01
#: Coordinates of lines that are the same (m).
_SAME_M = 0.001


@dataclass(frozen=True, slots=True)
class StoredResult:
    """Contents of a result folder."""

    folder: Path
    manifest: Mapping[str, Any]
    grid: Grid  # the terrain of the run; NaN where the folder has none
    maps: Mapping[str, RasterLayer]  # maps of the blocks and the hazard level, by their stem
    # The row of each station and barrier, by its name.
    control_lines: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    # Name, kind and coordinates of each control line.
    traces: tuple[tuple[str, str, FloatArray], ...] = ()
    release: tuple[FloatArray, ...] = ()  # outlines of the release areas, shape (n, 2)
    # Zones of hazard level; classes are those of the map of levels. None without zoning.
    zones: Coverage | None = None
    # Codes of the levels, from low to high, as the tables have them.
    level_codes: tuple[str, ...] = ()
    # Exposed objects, with their only names and kinds.
    objects: PlacedObjects = field(default_factory=lambda: PlacedObjects((), ()))
    # ``deaths_per_year`` and ``loss_per_year`` of each object, roads as a whole.
    risk: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    # ``energy_q95_kj`` and ``height_q95_m`` of the blocks at each object: value, and low and high
    # limit by the sampling; of roads those of the stretch with the most energy.
    values: Mapping[str, Mapping[str, tuple[float, ...]]] = field(default_factory=dict)

    @property
    def blocks(self) -> int:
        """Simulated blocks that started: the denominator of the reach probability."""
        counts = self.manifest["counts"]
        return int(counts["rocks"]) - int(counts.get("rocks_never_started", 0))

    def seed_share(self, code: str) -> float:
        """Return the share of the area of a level that changes with another seed; NaN without."""
        stated = self.manifest["settings"].get("zoning", {}).get(f"{CHANGED_SHARE}_{code}")
        return float("nan") if stated is None else float(stated)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of sampling errors: infinite but where release points were drawn."""
        release = self.manifest["settings"].get("release", {})
        if release.get("placement") != "random":
            return math.inf
        return max(int(self.manifest["counts"].get("release_points", 0)) - 1.0, 0.0)

    @property
    def title(self) -> str:
        """Name of the project, or of the folder."""
        project = self.manifest["settings"].get("project", {})
        return str(project.get("name") or self.folder.name)

    def band(self, stem: str, name: str) -> FloatArray:
        """Return values of a band of a map; NaN where there is nothing."""
        bands = self.maps[stem].bands
        return np.asarray(next(b for b in bands if b.name == name).values, np.float64)


def on_common_cells(one: StoredResult, other: StoredResult) -> tuple[StoredResult, StoredResult]:
    """Return two results on the cells that both have.

    InputError: coordinate systems, cell sizes or borders of the cells differ, or none is common.
    """
    a, b = one.grid, other.grid
    if bool(a.crs) != bool(b.crs) or (
        a.crs and not same_crs(pyproj.CRS.from_wkt(a.crs), pyproj.CRS.from_wkt(b.crs))
    ):
        raise _differ(other, "coordinate system", crs_name(b.crs), crs_name(a.crs))
    if a.cell_size != b.cell_size:
        raise _differ(other, "cell size", f"{b.cell_size:g} m", f"{a.cell_size:g} m")
    size = a.cell_size
    shift = np.array([(b.west - a.west) / size, (a.north - b.north) / size])
    if (np.abs(shift - np.round(shift)) > _APART).any():
        found = f"shifted by {shift[0] % 1:.2g} and {shift[1] % 1:.2g} of a cell"
        raise _differ(other, "borders of the cells", found, "cells that coincide")
    col, row = (int(v) for v in np.round(shift))
    rows = max(0, row), min(a.shape[0], row + b.shape[0])
    cols = max(0, col), min(a.shape[1], col + b.shape[1])
    if rows[0] >= rows[1] or cols[0] >= cols[1]:
        raise _differ(other, "place", _place(b), f"cells within {_place(a)}")
    part = slice(*rows), slice(*cols)
    moved = slice(rows[0] - row, rows[1] - row), slice(cols[0] - col, cols[1] - col)
    return _cut(one, *part), _cut(other, *moved)


def objects_within(placed: PlacedObjects, grid: Grid) -> PlacedObjects:
    """Return the objects that lie on a grid with all their stretches."""
    west, south, east, north = grid.bounds
    bounds = shapely.bounds(np.array(placed.geometries, dtype=object)).reshape(-1, 4)
    out = (bounds < (west, south, west, south)) | (bounds > (east, north, east, north))
    gone = {o.whole for o, beyond in zip(placed.objects, out, strict=True) if beyond.any()}
    kept = [i for i, o in enumerate(placed.objects) if o.whole not in gone]
    return PlacedObjects(
        tuple(placed.objects[i] for i in kept), tuple(placed.geometries[i] for i in kept)
    )


def _differ(other: StoredResult, what: str, found: str, expected: str) -> InputError:
    text = f"the two results cannot be compared: they differ in the {what}"
    return InputError(text, file=other.folder, found=found, expected=expected)


def _place(grid: Grid) -> str:
    west, south, east, north = grid.bounds
    return f"{west:.0f} to {east:.0f}, {south:.0f} to {north:.0f}"


def _cut(result: StoredResult, rows: slice, cols: slice) -> StoredResult:
    """Return a part of the maps and zones; stops and control lines stay whole."""
    grid = result.grid
    if (rows.stop - rows.start, cols.stop - cols.start) == grid.shape:
        return result
    part = grid.part(rows, cols)
    maps = {}
    for stem, layer in result.maps.items():
        bands = tuple(replace(b, values=b.values[rows, cols]) for b in layer.bands)
        maps[stem] = replace(layer, bands=bands)
    zones = result.zones
    if zones is not None:
        inside = shapely.intersection(zones.polygons, shapely.box(*part.bounds))
        kept = shapely.area(inside) > 0.0
        zones = Coverage(inside[kept], zones.classes[kept])
    return replace(result, grid=part, maps=maps, zones=zones)


def is_one_line(trace: FloatArray, other: FloatArray) -> bool:
    """Return whether two control lines have the same coordinates (m), shape (n, 2)."""
    return trace.shape == other.shape and bool(np.allclose(trace, other, rtol=0.0, atol=_SAME_M))
