"""The project of a run, and what a zoning adds to it: groups of layers and sheets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely

from sassgis.hazard.assess import Assessment, Rules
from sassgis.hazard.preset_labels import preset_unverified
from sassgis.hazard.zoning.generalise import Coverage
from sassgis.io.qgis.layout import PrintLayout
from sassgis.io.qgis.project import LayerEntry, LayerGroup, write_project
from sassgis.io.vector_layer import VectorLayer
from sassgis.model.grid import Grid
from sassgis.model.map_run import MapRun
from sassgis.model.results import RasterLayer

_VECTORS = "hazard.gpkg"


def write_run_project(
    folder: Path,
    title: str,
    grid: Grid,
    layers: tuple[RasterLayer, ...],
    terrain: RasterLayer,
    vectors: Sequence[VectorLayer],
    groups: Sequence[LayerGroup] = (),
    layouts: Sequence[PrintLayout] = (),
) -> None:
    """Write ``project.qgz`` over the files of a run.

    Parameters
    ----------
    folder : Path
    title : str
    grid : Grid
    layers : tuple of RasterLayer
        Maps of what was simulated, in ``maps``; the first one bounds the view.
    terrain : RasterLayer
        In ``maps`` too.
    vectors : sequence of VectorLayer
        In ``result.gpkg``.
    groups : sequence of LayerGroup
        On top of the project.
    layouts : sequence of PrintLayout
    """
    by_name = {v.name: v for v in vectors}

    def entries(*names: str, hidden: tuple[str, ...] = ()) -> tuple[LayerEntry, ...]:
        return tuple(
            LayerEntry(by_name[n], "result.gpkg", visible=n not in hidden)
            for n in names
            if n in by_name
        )

    maps = tuple(
        LayerEntry(layer, f"maps/{layer.stem}.tif", visible=layer.stem == "energy" and not groups)
        for layer in layers
    )
    write_project(
        folder / "project.qgz",
        title=title,
        crs=grid.crs,
        groups=[
            *groups,
            LayerGroup("Stations and measures", entries("barriers", "stations")),
            LayerGroup(
                "Release and fall lines",
                entries(
                    "release_areas",
                    "release_points",
                    "fall_lines",
                    "paths",
                    "stops",
                    hidden=("release_points", "fall_lines", "paths", "stops"),
                ),
            ),
            LayerGroup("Footprint", entries("footprint", hidden=("footprint",))),
            LayerGroup("Maps", maps, exclusive=True),
            LayerGroup("Terrain", (LayerEntry(terrain, "maps/terrain.tif"),)),
        ],
        extent=_reached_extent(layers, grid),
        abstract="Rockfall simulation with the SASS model (Bozzolo and Pamini, 1986). "
        f"Reach probabilities refer to a width of {grid.cell_size:.4g} m.",
        layouts=layouts,
    )


def _reached_extent(
    layers: tuple[RasterLayer, ...], grid: Grid
) -> tuple[float, float, float, float]:
    """What blocks reach, with a margin."""
    reached = np.isfinite(layers[0].bands[0].values)
    if not reached.any():
        return grid.bounds
    rows = np.flatnonzero(reached.any(axis=1))
    cols = np.flatnonzero(reached.any(axis=0))
    margin = 0.05 * max(rows[-1] - rows[0], cols[-1] - cols[0], 10)
    c = grid.cell_size
    return (
        grid.west + (cols[0] - margin) * c,
        grid.north - (rows[-1] + 1 + margin) * c,
        grid.west + (cols[-1] + 1 + margin) * c,
        grid.north - (rows[0] - margin) * c,
    )


def zone_groups(
    maps: tuple[RasterLayer, ...],
    own: Sequence[VectorLayer],
    risk: Sequence[VectorLayer],
    federal: Sequence[VectorLayer],
) -> tuple[LayerGroup, ...]:
    """The groups of a zoning: zones, intensities, frequencies, federal layers, risk.

    Parameters
    ----------
    maps : tuple of RasterLayer
        In ``maps``.
    own, risk, federal : sequence of VectorLayer
        In ``hazard.gpkg``.
    """

    def vectors(layers: Sequence[VectorLayer], visible: tuple[str, ...] = ()) -> list[LayerEntry]:
        return [LayerEntry(v, _VECTORS, visible=v.name in visible) for v in layers]

    def rasters(start: str, *more: str) -> tuple[LayerEntry, ...]:
        return tuple(
            LayerEntry(m, f"maps/{m.stem}.tif", visible=False)
            for m in maps
            if m.stem.startswith(start) or m.stem in more
        )

    groups = [
        LayerGroup(
            "Hazard",
            (
                *vectors(own, ("hazard_zones",)),
                LayerGroup("Intensity maps", rasters("intensity"), True, False),
                LayerGroup(
                    "Frequency and confidence",
                    rasters("frequency", "hazard_level", "return_period", "energy_at_return_period",
                            "confidence"),
                    True,
                    False,
                ),
                LayerGroup("Model 166.1", tuple(vectors(federal)), False, False),
            ),
        )
    ]  # fmt: skip
    if risk:
        groups.insert(0, LayerGroup("Risk", tuple(vectors(risk, tuple(v.name for v in risk)))))
    return tuple(groups)


def zone_layouts(
    run: MapRun,
    rocks: int,
    rules: Rules,
    found: Assessment,
    *,
    title: str,
    terrain_file: str,
) -> tuple[PrintLayout, ...]:
    """The sheets of a zoning: hazard level, and intensity at the middle return period."""
    grid, preset = run.grid, rules.preset
    extent = _zone_extent(found.hazard.intensities[-1].zones, grid)
    barriers = any(g.kind != "station" for g, _ in run.control_lines)
    on_top = ("vector_barriers",) if barriers else ()
    facts = (
        ("Model", f"SASS (Bozzolo and Pamini, 1986): blocks simulated along {run.path_words}"
         + (f"; with {', '.join(run.effects.names).replace('_', ' ')}"
            if run.effects.names else "")),
        ("Terrain", f"{terrain_file}, cells of {grid.cell_size:.4g} m; heights "
         f"{grid.vertical_datum or 'of an unstated datum'}"),
        ("Release areas", ", ".join(a.name for a in run.areas)),
        ("Simulated blocks", f"{rocks}"),
        ("Rules", preset.title),
        ("Reference width", f"{rules.ref_width_m:.4g} m"),
    )  # fmt: skip
    notes = (
        "Hazard follows from the onset frequencies that the user stated.",
        *(f"{text[:1].upper()}{text[1:]}" for text in preset_unverified(preset)[:1]),
    )
    middle = preset.return_periods[len(preset.return_periods) // 2]
    stem = f"intensity_{middle:g}"
    return (
        PrintLayout(
            "Hazard level", title, "Hazard zones, rockfall",
            (*on_top, "vector_release_areas", "vector_hazard_zones",
             "raster_terrain"),
            extent, facts, notes,
        ),
        PrintLayout(
            f"Intensity {middle:g} years", title,
            f"Intensity of rockfall, return period {middle:g} years",
            (*on_top, "vector_release_areas", f"raster_{stem}", "raster_terrain"),
            extent, facts, notes,
        ),
    )  # fmt: skip


def _zone_extent(zones: Coverage, grid: Grid) -> tuple[float, float, float, float]:
    if not zones.polygons.size:
        return grid.bounds
    west, south, east, north = shapely.total_bounds(zones.polygons)
    margin = 0.04 * max(east - west, north - south)
    return west - margin, south - margin, east + margin, north + margin
