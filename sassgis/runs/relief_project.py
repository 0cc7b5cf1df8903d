"""Maps over the relief: their files, and a project of QGIS that shows them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sassgis.io.qgis.entries import LayerEntry, LayerGroup
from sassgis.io.qgis.project import write_project
from sassgis.io.write.layers.maps import terrain_layer
from sassgis.io.write.raster import write_raster
from sassgis.model.grid import Grid
from sassgis.model.results import RasterLayer


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
    """Write maps and ``project.qgz``, in which the first map is seen, or zones in its place.

    Parameters
    ----------
    group : str
        Heading of the maps.
    """
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
