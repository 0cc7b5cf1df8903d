"""The one place where a result is written: maps, GeoPackages, project, tables, report, manifest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import Grid
from sassgis.hazard.measured_motion import motion_warnings
from sassgis.hazard.object_values import ObjectValues, object_values
from sassgis.hazard.reach_angles import reach_angles
from sassgis.hazard.sources import Sampled, sampled_sources
from sassgis.hazard.warnings import ground_shares
from sassgis.inputs.dem import read_base_map
from sassgis.inputs.result_folder import EDITS_FILE, RESULT_FILE, ZONE_FILE
from sassgis.outputs.frames import passage_frame, rock_frame, write_table
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.layers import run_vectors
from sassgis.outputs.layers.maps import map_layers, terrain_layer
from sassgis.outputs.layers.risk_objects import exposed_layers
from sassgis.outputs.qgis import run_project
from sassgis.outputs.qgis.entries import LayerGroup
from sassgis.outputs.qgis.layout import Extent, PrintLayout
from sassgis.outputs.raster import write_raster
from sassgis.report.exposed_report import exposed_table, map_objects, most_exposed
from sassgis.report.map_page import Contribution, MapHazard, PlaceFacts, write_map_page
from sassgis.report.map_report import map_report
from sassgis.report.page import (
    ReportContext,
    ReportFigure,
    ReportTable,
    first_warnings,
    translated_report,
    write_report,
)
from sassgis.report.pictures import GIVEN_UP
from sassgis.report.protection_page import PAGE_NAME, ProtectionSheet, write_protection_page
from sassgis.report.run_summary import Lines, object_lines, run_lines
from sassgis.report.zone_report import BARRIERS_TITLE
from sassgis.runs.map_answers import area_rows, blocks_by_source
from sassgis.runs.provenance import byline, facts_of, made_on, provenance, write_origin
from sassgis.runs.resumable_run import Simulation
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.results import RasterLayer, StopReason
from sassgis.settings.run_config import Config
from sassgis.settings.statistics_table import Bins, bins_of
from sassgis.simulation.accumulators import line_ends, sample_of
from sassgis.simulation.checkpoint import read_rows
from sassgis.simulation.map_sums import MapSums, Sample
from sassgis.simulation.path_sample import paths_on_line, sample_paths, some_paths
from sassgis.simulation.workers import beside


@dataclass(frozen=True, slots=True)
class Extras:
    """Contents of a result besides the maps of the blocks themselves."""

    layers: tuple[RasterLayer, ...] = ()
    vectors: tuple[VectorLayer, ...] = ()  # written to hazard.gpkg
    groups: tuple[LayerGroup, ...] = ()  # on top of the project
    # Gives its map sheets from what every sheet says.
    layouts: Callable[[PrintLayout], tuple[PrintLayout, ...]] = lambda _words: ()
    facts: dict[str, object] = field(default_factory=dict)  # added to those of the run
    frames: dict[str, Any] = field(default_factory=dict)  # written to tables/<name>.csv
    origin: dict[str, Any] = field(default_factory=dict)  # arguments of write_origin
    warnings: tuple[str, ...] = ()
    # Exposed objects, drawn on the maps; their hazard levels by name, and what reaches them, by
    # frequency, where there are zones.
    placed: PlacedObjects = field(default_factory=lambda: PlacedObjects((), ()))
    levels: dict[str, str] = field(default_factory=dict)
    objects: ObjectValues | None = None
    edits: VectorLayer | None = None  # written to edits.gpkg
    # Of the report: what draws its figures and the sheets of protection, and returns them.
    figures: Callable[[], tuple[ReportFigure, ...]] = tuple
    sheets: Callable[[], tuple[ProtectionSheet, ...]] = tuple
    key_results: ReportTable | None = None  # heads the report, in place of the stopping reasons
    tables: tuple[ReportTable, ...] = ()
    described: Lines = ()  # added to what was computed
    summary: Lines = ()  # added to the answer in short
    spread: Lines = ()  # added to it after the run-out
    # Of the interactive map: zones, sources, places and release areas.
    hazard: MapHazard | None = None
    contributions: Sequence[Contribution] = ()
    places: Mapping[tuple[str, str], PlaceFacts] = field(default_factory=dict)
    frequencies: Mapping[tuple[str, str], float] = field(default_factory=dict)


#: All maps; the report in its language; the warnings in English.
Published = tuple[tuple[RasterLayer, ...], ReportContext, tuple[str, ...]]


def publish_map(
    work: Path,
    done: Simulation,
    areas: Sequence[str] | None,
    tell: Callable[[str], None],
    extras: Extras,
) -> Published:
    """Write the result of a run on the map into a folder, in the language of the settings.

    ``areas`` are the names of the release areas, if not all were run.
    """
    tell("Writing the maps")
    config, run, planned, progress = done.config, done.run, done.planned, done.progress
    layers = block_maps(config, run.grid, progress.sums, sample_of(run, progress), bins_of(run))
    q95 = {layer.stem: layer.bands[0].values for layer in layers}
    highest = {"speed_mps": q95["speed"], "height_m": q95["passing_height"]}
    warnings = (*extras.warnings, *done.warnings, *motion_warnings(run.blocks, highest))
    counts = _counts(done)
    facts = facts_of(config, run) | extras.facts | counts
    report = partial(_write_report, work, done, layers, extras, warnings, facts)
    with beside(report, GIVEN_UP) as reported:
        terrain = terrain_layer(run.grid)
        for layer in (*extras.layers, *layers, terrain):
            write_raster(layer, run.grid, work / "maps")
        vectors = run_vectors.all_layers(run, planned, progress, layers)
        vectors += exposed_layers(extras.placed, run.grid.crs)
        paths = sample_paths(run, planned, config.output.paths_max)
        if paths:
            vectors.append(run_vectors.block_paths(paths, run.grid.crs))
        imprint = replace(config.project, date=made_on(config))
        words = run_project.sheet_words(
            run, progress.simulated, imprint, terrain_file=config.dem_source.name,
            program=str(facts["program"]), vectors=vectors,
            extent=run_project.reached_extent(layers, run.grid),
            ground=ground_shares(run, progress.sums.cells),
        )  # fmt: skip
        sheets = (*extras.layouts(words), *run_project.run_layouts(words, layers))
        write_layers(
            work, config, run.grid, extras, layers=layers, terrain=terrain, vectors=vectors,
            facts=facts, extent=words.extent, layouts=sheets,
        )  # fmt: skip
        _write_rows(work / "tables", done, tell)
        tell("Drawing the figures")
        context = reported()
    write_origin(
        work, config, counts, warnings, seed=run.seed, grid=run.grid,
        settings=({} if areas is None else {"areas": sorted(areas)})
        | ({"zoning": extras.facts} if extras.facts else {}),
        checks={} if done.tolerance is None else {"segment_tolerance": done.tolerance.facts()},
        **extras.origin,
    )  # fmt: skip
    return (*extras.layers, *layers, terrain), context, warnings


def block_maps(
    config: Config, grid: Grid, sums: MapSums, sample: Sample, bins: Bins
) -> tuple[RasterLayer, ...]:
    """Return maps of the blocks themselves."""
    classes = config.output.energy_classes_kj
    return map_layers(sums, grid.shape, sample, bins.edges, grid.cell_size, classes)


def write_layers(
    work: Path,
    config: Config,
    grid: Grid,
    extras: Extras,
    *,
    layers: Sequence[RasterLayer],
    terrain: RasterLayer,
    vectors: Sequence[VectorLayer],
    facts: Mapping[str, object],
    extent: Extent,
    layouts: Sequence[PrintLayout] = (),
) -> None:
    """Write GeoPackages, the project and the tables of what lies next to the maps.

    Of ``layers`` and ``terrain`` only the limits of the legend count; ``extent`` is shown at first.
    """
    write_geopackage(work / RESULT_FILE, vectors, facts)
    if extras.vectors:
        write_geopackage(work / ZONE_FILE, extras.vectors, facts)
    if extras.edits is not None:
        write_geopackage(work / EDITS_FILE, [extras.edits], facts)
    imprint = replace(config.project, date=made_on(config))
    run_project.write_run_project(
        work, imprint, grid, extent, layers, terrain, vectors, extras.groups, layouts,
        read_base_map(imprint.base_map, grid),
    )  # fmt: skip
    for name, frame in extras.frames.items():
        write_table(work / "tables" / f"{name}.csv", [frame])


def _counts(done: Simulation) -> dict[str, int]:
    """Return numbers of what was simulated, for the manifest and the GeoPackage."""
    run, planned, progress = done.run, done.planned, done.progress
    ends = line_ends(progress)
    return {
        "release_areas": len(run.areas),
        "release_points": len(planned.points),
        "fall_lines": sum(ends.values()),
        "rocks": int(progress.reasons.sum()),
        "rocks_simulated": progress.simulated,
        "rocks_not_simulated": progress.lost,
        "fragments": progress.pieces,
        **{f"rocks_{r.name.lower()}": int(progress.reasons[r]) for r in StopReason},
        **{f"lines_{e.name.lower()}": n for e, n in ends.items()},
    }


def _write_rows(folder: Path, done: Simulation, tell: Callable[[str], None]) -> None:
    """Write the tables of single blocks and passages if they are asked for."""
    output, parts = done.config.output, done.checkpoint.rows()
    for name, suffix, frame_of in (
        ("rocks", output.rock_table, rock_frame),
        ("passages", output.passage_table, passage_frame),
    ):
        if suffix != "none":
            tell(f"Writing the table of {name}")
            rows = (frame_of(read_rows(part), done.run, done.planned) for part in parts)
            write_table(folder / f"{name}.{suffix}", rows)


def _write_report(
    work: Path,
    done: Simulation,
    layers: tuple[RasterLayer, ...],
    extras: Extras,
    warnings: Sequence[str],
    facts: Mapping[str, object],
) -> ReportContext:
    """Write report, map page and sheets of protection if any; returns what the report says."""
    config, run, planned, progress = done.config, done.run, done.planned, done.progress
    furthest = progress.furthest
    shown = None if furthest is None else paths_on_line(run, planned, *furthest[1:])
    named = {"terrain_file": config.dem_source.name}
    if done.tolerance is not None:
        named["tolerance_check"] = done.tolerance.sentence()
    objects = map_objects(extras.placed)
    context = map_report(
        run, planned, progress, layers, shown, warnings, {**facts, **named}, work / "figures",
        objects,
    )  # fmt: skip
    values = extras.objects or values_at_objects(done, None, ())
    exposed = exposed_table(extras.placed, values, extras.levels)
    lines = run_lines(progress, reach_angles(run, planned, progress))
    first = () if extras.key_results is None else (context.key_results,)
    drawn, sheets = extras.figures(), extras.sheets()
    others = [("map.html", "The map in a browser")]
    if sheets:
        change = next((f for f in drawn if f.title == BARRIERS_TITLE), None)
        write_protection_page(
            work, config.project.name, byline(config), sheets, change, len(warnings)
        )
        others.append((PAGE_NAME, "Design of protection"))
    report = translated_report(
        replace(
            context,
            byline=byline(config),
            files_beside=tuple(others),
            summary=(
                *extras.summary[:1], *lines[:1], *extras.spread, *lines[1:],
                *object_lines(exposed), *extras.summary[1:],
            ),
            key_results=extras.key_results or context.key_results,
            figures=(*drawn, *context.figures),
            tables=(most_exposed(exposed), *extras.tables, *first, *context.tables),
            what_was_run=(*extras.described, *context.what_was_run),
            provenance=(*provenance(config).items(), ("Configuration", config.label)),
        )
    )  # fmt: skip
    write_report(work / "report.html", report)
    rows = area_rows(run, extras.frequencies)
    write_map_page(
        work / "map.html",
        config.project.name,
        run,
        (*extras.layers, *layers),
        [(area.name, area.geometry, rows[area.name]) for area in run.areas],
        objects,
        extras.contributions or blocks_by_source(run, progress),
        some_paths(run, planned),
        extras.places,
        extras.hazard,
        first_warnings(warnings),
    )
    return report


def values_at_objects(
    done: Simulation,
    sampled: Sequence[Sampled] | None,
    return_periods: Sequence[float],
    heights: bool = True,
) -> ObjectValues:
    """Compute what reaches the exposed objects; ``sampled`` with frequencies if there are any."""
    run, bins = done.run, bins_of(done.run)
    own = sampled_sources(run, done.progress, None) if sampled is None else sampled
    return object_values(
        run.objects, [s.source for s in own], [s.objects for s in own], bins.threshold,
        done.progress.sums if heights else None, bins.edges["height"],
        return_periods=return_periods, confidence=done.config.hazard.confidence,
    )  # fmt: skip
