"""The project of a run, and what a zoning adds to it: groups of layers and sheets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely

from sassgis.files.plain_file import seen_from
from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import Bounds, Grid
from sassgis.hazard.assess import Assessment, Rules
from sassgis.hazard.levels import Shown, unverified_in_short, zone_style
from sassgis.hazard.warnings import edit_lines, ground_warnings, sample_words
from sassgis.inputs.dem import BASE_MAP_KEY
from sassgis.inputs.result_folder import EDITS_FILE
from sassgis.outputs.qgis.entries import LayerEntry, LayerGroup, without_empty
from sassgis.outputs.qgis.layout import PrintLayout, map_frame, scale_text, with_margin
from sassgis.outputs.qgis.project import write_project
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.ground import GroundClass
from sassgis.settings.hazard_rules import HazardPreset
from sassgis.settings.languages import joined, phrase
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import RasterLayer, short
from sassgis.settings.settings import ProjectSettings

_VECTORS = "hazard.gpkg"


#: Part of the assessed area that is complete.
_COMPLETE = "complete"


_EXPOSED = ("exposed_points", "exposed_areas", "exposed_lines")


#: Layers of ``result.gpkg`` on every sheet, the top first.
_ON_SHEETS = ("barriers", "release_areas", *_EXPOSED)


def _sheet(words: PrintLayout, name: str, subtitle: str, *layers: str) -> PrintLayout:
    """Return a sheet that shows layers over the terrain or the base map."""
    *around, ground = words.layers
    return replace(words, name=name, subtitle=subtitle, layers=(*around, *layers, ground))


def sheet_words(
    run: MapRun,
    rocks: int,
    imprint: ProjectSettings,
    *,
    terrain_file: str,
    program: str,
    vectors: Sequence[VectorLayer],
    extent: Bounds,
    ground: Sequence[tuple[GroundClass, float]],
) -> PrintLayout:
    """Return what all sheets share: words, layers around those of a sheet, and the lowest.

    ``vectors`` are those of ``result.gpkg``, ``ground`` the classes that blocks reach with shares.
    """
    grid = run.grid
    effects = ", ".join(run.effects.names).replace("_", " ")
    paths = phrase(run.path_words)
    model = phrase("SASS (Bozzolo and Pamini, 1986): blocks simulated along {}", paths)
    if effects:
        text = "SASS (Bozzolo and Pamini, 1986): blocks simulated along {}; with {}"
        model = phrase(text, paths, effects)
    walls = [line.name for line, _ in run.control_lines if line.kind != "station"]
    facts = (
        ("Status", imprint.status),
        ("Author", imprint.author),
        ("Date", imprint.date),
        ("Program", program),
        ("Model", model),
        ("Terrain", phrase(
            "{}, cells of {} m; height system {}", terrain_file, f"{grid.cell_size:.4g}",
            grid.vertical_datum or phrase("of an unstated datum"),
        )),
        ("Release areas", ", ".join(a.name for a in run.areas)),
        ("Block scenarios", ", ".join(f"{b.name} ({_volumes(b)} m³)" for b in run.released_blocks)),
        ("Barriers", phrase("counted: {}", ", ".join(walls)) if walls else phrase("none")),
        ("Simulated blocks", f"{rocks}"),
        ("Contact", imprint.contact),
        ("Rights", imprint.rights),
    )  # fmt: skip
    drawn = {v.name for v in vectors if not v.frame.empty}
    around = (f"vector_{name}" for name in _ON_SHEETS if name in drawn)
    lowest = "raster_terrain" if imprint.base_map is None else BASE_MAP_KEY
    stated = tuple((name, text) for name, text in facts if text)
    notes = tuple(ground_warnings(ground))
    return PrintLayout(
        name="",
        title=imprint.name,
        subtitle="",
        layers=(*around, lowest),
        extent=extent,
        facts=stated,
        notes=notes,
    )


def write_run_project(
    folder: Path,
    imprint: ProjectSettings,
    grid: Grid,
    extent: Bounds,
    layers: Sequence[RasterLayer],
    terrain: RasterLayer,
    vectors: Sequence[VectorLayer],
    groups: Sequence[LayerGroup] = (),
    layouts: Sequence[PrintLayout] = (),
    base_map: RasterLayer | None = None,
) -> None:
    """Write ``project.qgz`` over the files of a run, which opens at an extent.

    The groups are those of a zoning, and of draws of the ground: below what was drawn, above the
    maps of the blocks. ``base_map`` is that of ``imprint.base_map``.
    """
    by_name = {v.name: v for v in vectors}

    def entries(*names: str, visible: bool = True) -> tuple[LayerEntry, ...]:
        return tuple(
            LayerEntry(by_name[n], "result.gpkg", visible=visible) for n in names if n in by_name
        )

    zoned = any(entry.visible for group in groups for entry in group.entries)
    maps = tuple(
        LayerEntry(layer, f"maps/{layer.stem}.tif", visible=layer.stem == "energy" and not zoned)
        for layer in layers
    )
    base = []
    if base_map is not None and imprint.base_map is not None:
        # As seen from the working folder, which lies next to that of the result.
        place = seen_from(folder.resolve(), imprint.base_map)
        base = [LayerGroup("Base map", (LayerEntry(base_map, place),))]
    shown = [
        LayerGroup("Stations and measures", entries("barriers", "stations")),
        LayerGroup(
            "Release and fall lines",
            entries("release_areas")
            + entries("release_points", "fall_lines", "paths", "stops", visible=False),
        ),
        LayerGroup("Exposed objects", entries(*_EXPOSED, visible=not zoned)),
        *groups,
        LayerGroup("Footprint", entries("energy_line", "footprint", visible=False)),
        LayerGroup("Maps", maps, exclusive=True),
        *base,
        LayerGroup("Terrain", (LayerEntry(terrain, "maps/terrain.tif"),)),
    ]
    full = [group for group in map(without_empty, shown) if group.layers]
    keys = {entry.key for group in full for entry in group.entries}
    write_project(
        folder / "project.qgz",
        title=imprint.name,
        crs=grid.crs,
        groups=full,
        extent=extent,
        abstract=phrase(
            "Rockfall simulation with the SASS model (Bozzolo and Pamini, 1986). Reach "
            "probabilities refer to a width of {} m.",
            f"{grid.cell_size:.4g}",
        ),
        imprint=imprint,
        # Where no block arrives there are no zones, and no sheet of them.
        layouts=[layout for layout in layouts if keys.issuperset(layout.layers)],
    )


def _volumes(block: BlockPopulation) -> str:
    low, high = map(short, block.volume_limits_m3)
    return low if low == high else f"{low}\N{EN DASH}{high}"


def run_layouts(words: PrintLayout, layers: Sequence[RasterLayer]) -> tuple[PrintLayout, ...]:
    """Return sheets of what was simulated: energy, passing height, reach probability."""
    titles = {layer.stem: layer.title for layer in layers}
    return tuple(
        _sheet(words, name, titles[stem], f"raster_{stem}")
        for name, stem in (
            ("Energy", "energy"),
            ("Passing height", "passing_height"),
            ("Reach probability", "reach_probability"),
        )
    )


def reached_extent(layers: tuple[RasterLayer, ...], grid: Grid) -> Bounds:
    """Return the extent that blocks reach, with a margin."""
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
    maps: Sequence[RasterLayer],
    own: Sequence[VectorLayer],
    risk: Sequence[VectorLayer],
    federal: Sequence[VectorLayer],
    preset: HazardPreset,
    edits: VectorLayer | None = None,
    *,
    assessed: bool = False,
) -> tuple[LayerGroup, ...]:
    """Return the groups of a zoning: zones, intensities, frequencies, federal layers, risk.

    ``assessed``: the user stated what was assessed completely.
    """

    def vectors(layers: Sequence[VectorLayer], visible: tuple[str, ...] = ()) -> list[LayerEntry]:
        return [LayerEntry(v, _VECTORS, visible=v.name in visible) for v in layers]

    def rasters(start: str, *more: str) -> tuple[LayerEntry, ...]:
        return tuple(
            LayerEntry(m, f"maps/{m.stem}.tif", visible=False)
            for m in maps
            if m.stem.startswith(start) or m.stem in more
        )

    perimeter = [
        LayerEntry(replace(layer, title="Assessed area"), _VECTORS, part=_COMPLETE)
        for layer in federal if assessed and layer.name == "assessment_area"
    ]  # fmt: skip
    groups = [
        LayerGroup(
            "Hazard",
            (
                *([] if edits is None else [LayerEntry(edits, EDITS_FILE, though_empty=True)]),
                *perimeter,
                *vectors(own, ("hazard_zones", "open_limits")),
                LayerGroup("Intensity zones", _intensity_zones(maps, federal, preset), True, False),
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


def _intensity_zones(
    maps: Sequence[RasterLayer], federal: Sequence[VectorLayer], preset: HazardPreset
) -> tuple[LayerEntry, ...]:
    """Return zones of the intensity of each return period, with the legend of its map of cells."""
    whole = next((layer for layer in federal if layer.name == "synoptic_intensity"), None)
    out = []
    for own in maps:
        stem, _, period = own.stem.partition("_")
        if stem != "intensity" or whole is None:
            continue
        column = "extreme_scenario" if period == "extreme" else "return_period_in_years"
        value = 1.0 if period == "extreme" else float(period)
        signs = [
            (c.code, known.label, c.colour, False)
            for c, known in zip(preset.intensities, own.classes, strict=True)
        ]
        shown = replace(
            whole,
            title=own.title,
            frame=whole.frame[whole.frame[column] == value],
            style=zone_style("intensity_class", signs),
        )
        # A period without zones has its sheet all the same: it says that there are none.
        where = f'"{column}" = {value:g}'
        out.append(
            LayerEntry(shown, _VECTORS, False, though_empty=True, part=period, part_where=where)
        )
    return tuple(out)


def zone_layouts(
    words: PrintLayout,
    rules: Rules,
    found: Assessment,
    own: Sequence[VectorLayer],
    risk: Sequence[VectorLayer],
    grid: Grid,
) -> tuple[PrintLayout, ...]:
    """Return the sheets of a zoning: hazard level, intensity by return period, risk."""
    preset, drawn = rules.preset, found.drawing
    least = scale_text(drawn.scale), f"{drawn.width_m:g}", f"{drawn.area_m2:g}"
    facts: tuple[tuple[str, str], ...] = (
        *words.facts,
        ("Onset frequencies", onset_words(rules)),
        ("Rules", preset.title),
        ("Reference width", f"{rules.ref_width_m:.4g} m"),
    )

    def notes(shown: Shown) -> tuple[str, ...]:
        onset = "Hazard depends on the onset frequencies stated by the user."
        return (onset, *unverified_in_short(preset, shown), *words.notes)

    sample = sample_words(found.hazard.chances, preset)
    of_levels = (sample, *notes("level"), *edit_lines(found.hazard.edits))
    extent, zoned = grid.bounds, found.hazard.intensities[None].polygons
    if zoned.size:
        extent = with_margin(shapely.total_bounds(zoned).tolist())
    seen = shapely.box(*map_frame(extent, drawn.scale)[1])
    assessed = shapely.union_all(rules.assessed)
    whole = (("Assessed area", "the whole map"),) if assessed.contains_properly(seen) else ()
    crosses = assessed.intersects(seen) and not whole
    perimeter = [f"vector_assessment_area_{_COMPLETE}"] if crosses else []
    size = phrase("1:{}; least width {} m, least area {} m²", *least)
    zones = replace(
        words, facts=(*facts, ("Zones drawn for", size), *whole), notes=notes("intensity"),
        extent=extent, drawn_for=drawn.scale,
    )  # fmt: skip
    limits = [f"vector_{layer.name}" for layer in own if layer.name == "open_limits"]
    edits = ["vector_edits"] if found.hazard.edits else []
    shown = (*edits, *limits, *perimeter, "vector_hazard_zones")
    levels = replace(zones, notes=of_levels)
    sheets = [_sheet(levels, "Hazard level", "Hazard zones, rockfall", *shown)]
    for years, drawn_zones in found.hazard.intensities.items():
        title: tuple[str, str] = "Intensity extreme event", "Intensity of rockfall, extreme event"
        period, none = "extreme", phrase("No zones: no block arrives anywhere.")
        if years is not None:
            period = f"{years:g}"
            title = (
                phrase("Intensity {} years", period),
                phrase("Intensity of rockfall, return period {} years", period),
            )
            none = phrase("No zones: no block arrives anywhere once in {} years.", period)
        notes_of = zones.notes if drawn_zones.polygons.size else (none, *zones.notes)
        sheet = replace(zones, notes=notes_of)
        sheets.append(_sheet(sheet, *title, *perimeter, f"vector_synoptic_intensity_{period}"))
    if risk:
        around = tuple(k for k in words.layers if not k.startswith("vector_exposed"))
        shown = tuple(f"vector_{layer.name}" for layer in risk)
        objects = replace(words, facts=facts, notes=notes("risk"), extent=extent, layers=around)
        sheets.append(_sheet(objects, "Risk", "Risk of rockfall", *shown))
    return tuple(sheets)


def onset_words(rules: Rules) -> str:
    """Return onset frequencies of a release area by scenario, or their least and greatest."""
    by_scenario: dict[str, list[float]] = {}
    for (_, scenario), frequency in rules.frequencies.items():
        by_scenario.setdefault(scenario, []).append(frequency)
    areas = len({area for area, _ in rules.frequencies})

    def words(name: str, own: list[float]) -> str:
        low, high = f"{min(own):.3g}", f"{max(own):.3g}"
        span = f"{name} {low}" if high == low else phrase("{} {} to {}", name, low, high)
        return span if len(own) == areas else phrase("{} ({} of {} areas)", span, len(own), areas)

    spans = joined("; ", (words(name, own) for name, own in by_scenario.items()))
    return phrase("blocks a year in each release area: {}", spans)
