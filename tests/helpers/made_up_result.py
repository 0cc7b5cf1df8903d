"""A small made-up result: a plane slope, a fan of fall lines, maps of what they carry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import geopandas as gpd
import numpy as np
import rasterio
from helpers.hazard_samples import swiss
from shapely.geometry import LineString, Point, box

from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import Grid
from sassgis.hazard.levels import (
    energy_labels,
    hazard_level_style,
    level_change_style,
    uncertain_style,
    zone_style,
)
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.qgis.entries import LayerEntry, LayerGroup
from sassgis.outputs.qgis.layout import PrintLayout
from sassgis.outputs.qgis.project import write_project
from sassgis.outputs.raster import write_raster
from sassgis.settings.hazard_rules import HazardPreset
from sassgis.settings.results import Band, RasterClass, RasterLayer
from sassgis.settings.styles import (
    BARRIER_STYLE,
    FALL_LINE_STYLE,
    HILLSHADE,
    RELEASE_AREA_STYLE,
    RELEASE_POINT_STYLE,
    STOP_STYLE,
    FieldInfo,
    StyleClass,
    Symbol,
    VectorStyle,
    categorised_style,
    class_colours,
    class_labels,
    class_limits,
)

WEST, NORTH, CELL, ROWS, COLS = 2_600_000.0, 1_200_000.0, 2.0, 400, 500
EXTENT = (WEST, NORTH - ROWS * CELL, WEST + COLS * CELL, NORTH)


class Made(NamedTuple):
    project: Path
    geopackage: Path
    rasters: dict[str, Path]


def grid(crs: str | None = None) -> Grid:
    row, col = np.mgrid[0:ROWS, 0:COLS].astype(float)
    heights = 1800.0 - 1.6 * row + 25 * np.sin(col / 30) * np.cos(row / 40)
    if crs is None:
        crs = rasterio.CRS.from_epsg(2056).to_wkt()
    return Grid(heights, WEST, NORTH, CELL, crs, "LN02")


def preset() -> HazardPreset:
    """The preset of the tests with labels and colours of its own."""
    own = (
        ("residuo", "#ffe000"), ("basso", "#ffe000"), ("medio", "#2b6cff"), ("elevato", "#e60000"),
    )  # fmt: skip
    levels = zip(swiss().levels, own, strict=True)
    return replace(
        swiss(), levels=tuple(replace(a, label=label, colour=c) for a, (label, c) in levels)
    )


def raster_layers(dem: Grid) -> dict[str, RasterLayer]:
    row, col = np.mgrid[0:ROWS, 0:COLS].astype(float)
    inside = (np.abs(col - 250) < 20 + row / 4) & (row > 40) & (row < 340)
    energy = np.where(inside, 400.0 * (1 - (row - 40) / 300), np.nan)
    # Cells with exactly the limits of the classes, in bands that can be looked up.
    energy[100:110, 230:270] = 30.0
    energy[120:130, 230:270] = np.nextafter(np.float32(30), np.float32(0))
    energy[140:150, 230:270] = 300.0
    energy[160:170, 230:270] = 0.0
    reach = np.where(inside, np.exp(-((col - 250) ** 2) / 2000) * (1 - row / 400), np.nan)
    height = np.where(inside, np.abs(np.sin(row / 12)) * 6, np.nan)

    def band(name: str, text: str, unit: str, values: np.ndarray) -> Band:
        return Band(name, text, unit, values.astype(np.float32))

    width = "reference width 3 m"
    energies = (
        band("e95", "Energy not exceeded by 95 % of the passages", "kJ", energy),
        band("emax", "Greatest energy", "kJ", energy * 1.5),
    )
    reaches = (band("reach", "Reach probability", "1", reach),)
    heights = (band("h95", "Passing height", "m", height),)
    codes = (band("level", "Hazard level", "", levels_of_cells()),)
    terrain = (band("z", "Height", "m", dem.values),)
    classes = tuple(
        RasterClass(number, level.label, level.colour, level.hatched)
        for number, level in enumerate(preset().levels, start=1)
    )
    layers = (
        RasterLayer(
            "energy", "Energy, 95 % (kJ)", f"Share of the passages; {width}", energies,
            (30.0, 300.0), "YlOrRd",
        ),
        RasterLayer(
            "reach", "Reach probability (1)", f"Per released rock; {width}", reaches, (), "viridis"
        ),
        RasterLayer("height", "Passing height, 95 % (m)", "", heights, (1.0, 2.0, 5.0), "Blues"),
        RasterLayer(
            "level", "Hazard level on cells", f"Worst level; {width}", codes, (), "", classes
        ),
        RasterLayer("terrain", "Terrain (relief)", "Heights of the DEM", terrain, (), HILLSHADE),
    )  # fmt: skip
    return {layer.stem: layer for layer in layers}


#: Bands down the slope (first and last row), from severe to slight.
LEVEL_ROWS = {"substantial": (40, 120), "mean": (120, 220), "slight": (220, 300)}
RESIDUAL_ROWS = (300, 360)


def levels_of_cells() -> np.ndarray:
    codes = [level.code for level in preset().levels]
    level = np.zeros((ROWS, COLS))
    for code, (first, last) in {**LEVEL_ROWS, "residual_hazard": RESIDUAL_ROWS}.items():
        level[first:last, 180:320] = codes.index(code) + 1
    level[:, :10] = np.nan
    return level


def zone_layers(crs: str | None = "EPSG:2056") -> dict[str, VectorLayer]:
    rows = {**LEVEL_ROWS, "residual_hazard": RESIDUAL_ROWS}
    boxes = [
        box(WEST + 180 * CELL, NORTH - last * CELL, WEST + 320 * CELL, NORTH - first * CELL)
        for first, last in rows.values()
    ]

    def layer(name: str, title: str, style: VectorStyle, areas: list, **columns: list) -> None:
        frame = gpd.GeoDataFrame(columns, geometry=areas, crs=crs)
        layers[name] = VectorLayer(name, title, "", frame, {}, style=style)

    layers: dict[str, VectorLayer] = {}
    levels = preset().levels
    spans = zip(preset().intensities, energy_labels(preset()), strict=True)
    intensities = [(c.code, f"{c.label} ({span})", c.colour, False) for c, span in spans]
    middle = [area.buffer(-40) for area in boxes]
    layer("uncertain", "Level not settled", uncertain_style(), [boxes[1].buffer(-60)])
    style = hazard_level_style("hazard_level", levels)
    layer("zones", "Hazard level", style, boxes, hazard_level=list(rows))
    style, classes = zone_style("intensity_class", intensities), ["high", "mean", "low"]
    layer("intensity", "Intensity, 100 years", style, middle[:3], intensity_class=classes)
    title, style = "Change of level by the barriers", level_change_style("change")
    layer("change", title, style, middle[:3], change=["lower", "same", "higher"])
    return layers


def vector_layers(crs: str | None = "EPSG:2056") -> dict[str, VectorLayer]:
    lines = [
        LineString([(WEST + 500, NORTH - 90), (WEST + 500 + dx, NORTH - 640)])
        for dx in (-150, -75, 0, 75, 150)
    ]
    stops = [Point(line.coords[-1]) for line in lines]

    def frame(geometry: list, **columns: Any) -> gpd.GeoDataFrame:
        return gpd.GeoDataFrame(columns, geometry=gpd.GeoSeries(geometry, crs=crs), crs=crs)

    name = {"name": FieldInfo("Name", "", "As in the configuration")}
    wall = LineString([(WEST + 350, NORTH - 500), (WEST + 650, NORTH - 500)])
    cliff = box(WEST + 420, NORTH - 110, WEST + 580, NORTH - 60)
    rest = box(WEST + 20, NORTH - 780, WEST + 250, NORTH - 600)
    station = Symbol("marker", "#ffffff", outline="#08519c", shape="diamond")
    hatched = Symbol("fill", "#ffcc00", outline="#aa8800", outline_mm=0.4, hatch="diagonal")
    reasons = {
        "rest": ("At rest", "#1a1a1a"),
        "barrier": ("At a barrier", "#1b9e77"),
        "left_profile": ("Left the profile", "#d95f02"),
    }
    energies = zip(
        class_limits((30, 300)), class_labels((30, 300), "kJ"), class_colours((30, 300), "plasma"),
        strict=True,
    )  # fmt: skip
    classes = tuple(
        StyleClass(label, Symbol("line", colour, size_mm=0.8), lower=low, upper=high)
        for (low, high), label, colour in energies
    )
    layers = [
        VectorLayer(
            "barriers", "Barriers", "Walls and nets",
            frame([wall], name=["Dam & net <A>"], kind=["wall"], height_m=[4.0]),
            {**name, "height_m": FieldInfo("Height", "m", "Vertical, above the ground")},
            style=BARRIER_STYLE.showing(("wall", "net")),
        ),
        VectorLayer(
            "stations", "Stations", "Where passages are recorded",
            frame([Point(WEST + 500, NORTH - 400)], name=["Road"], n=[12]),
            {**name, "n": FieldInfo("Passages")}, style=VectorStyle(station, label_column="name"),
        ),
        VectorLayer(
            "stops", "Stops", "Where rocks came to rest",
            frame(stops, reason=["rest", "rest", "barrier", "left_profile", "rest"]),
            {"reason": FieldInfo("Reason of stop")},
            style=categorised_style(STOP_STYLE.symbol, "reason", reasons),
        ),
        VectorLayer(
            "fall_lines", "Fall lines: furthest rock (kJ)", "Plan of the profiles",
            frame(lines, energy_kj=[10.0, 30.0, 120.0, 300.0, 800.0]),
            {"energy_kj": FieldInfo("Greatest energy", "kJ", "Translation and rotation")},
            style=VectorStyle(
                Symbol("line", "#000000", size_mm=0.8), method="ranges", column="energy_kj",
                classes=classes,
            ),
        ),
        VectorLayer(
            "release_points", "Release points", "",
            frame([Point(WEST + 500, NORTH - 90)], point=[0]), {}, style=RELEASE_POINT_STYLE,
        ),
        VectorLayer(
            "release_areas", "Release areas", "", frame([cliff], name=["Cliff"]), name,
            style=RELEASE_AREA_STYLE,
        ),
        VectorLayer(
            "residual", "Residual (hatched)", "", frame([rest], level=["residual"]), {},
            style=VectorStyle(hatched),
        ),
        VectorLayer(
            "empty_lines", "Nothing here", "No line was traced", frame([], length_m=np.zeros(0)),
            {"length_m": FieldInfo("Length", "m")}, style=FALL_LINE_STYLE,
        ),
    ]  # fmt: skip
    return {layer.name: layer for layer in layers}


FACTS = (
    ("Terrain", "Made-up slope, cells of 2 m, LN02"),
    ("Model", "SASS (Bozzolo and Pamini, 1986); 120\u00a0000 rocks"),
    ("Reference width", "2 m (one cell)"),
)
NOTES = (
    "Unverified values: the residual column of the matrix.",
    "Fine black lines: the sample of rocks leaves the level open (95 % interval).",
)
LAYOUTS = (
    PrintLayout(
        "Hazard level", "Rockfall hazard: made-up slope", "Worst level of all return periods",
        (
            "vector_barriers", "vector_release_areas", "vector_uncertain", "vector_zones",
            "raster_terrain",
        ),
        EXTENT, FACTS, NOTES,
    ),
    PrintLayout(
        "Intensity & cells",
        "Intensity and levels of single cells, in a title that needs more than one line",
        "",
        ("vector_intensity", "raster_level", "raster_reach", "raster_energy", "raster_terrain"),
        EXTENT, FACTS, (),
    ),
)  # fmt: skip


def make(folder: Path, *, local: bool = False) -> Made:
    dem = grid("" if local else None)
    maps = raster_layers(dem)
    crs = None if local else "EPSG:2056"
    vectors = vector_layers(crs)
    zones = zone_layers(crs)
    rasters = {stem: write_raster(layer, dem, folder / "maps") for stem, layer in maps.items()}
    geopackage = write_geopackage(
        folder / "result.gpkg",
        [*vectors.values(), *zones.values()],
        {"seed": 1, "ref_width_m": 3.0},
    )

    def of_result(layer: VectorLayer, *, visible: bool = True) -> LayerEntry:
        return LayerEntry(layer, "result.gpkg", visible=visible)

    hidden = {name: of_result(layer, visible=False) for name, layer in zones.items()}
    tif = {
        stem: LayerEntry(layer, f"maps/{stem}.tif", visible=stem in ("energy", "terrain"))
        for stem, layer in maps.items()
    }
    intensity = LayerGroup(
        "Intensity maps", (hidden.pop("intensity"),), exclusive=True, expanded=False
    )
    terrain = tif.pop("terrain")
    project = write_project(
        folder / "project.qgz",
        title="Made-up slope – Ü & <test>",
        crs=dem.crs,
        groups=[
            LayerGroup("Fall lines and stops", tuple(map(of_result, vectors.values()))),
            LayerGroup("Hazard", (*hidden.values(), intensity)),
            LayerGroup("Maps", tuple(tif.values()), exclusive=True),
            LayerGroup("Terrain", (terrain,)),
        ],
        extent=EXTENT,
        abstract="Nothing real.",
        layouts=LAYOUTS,
    )
    return Made(project, geopackage, rasters)
