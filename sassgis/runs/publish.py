"""The one place where a result is written: maps, GeoPackages, project, tables, report, manifest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

import sassgis
from sassgis.hazard.along_profile import ProfileResult
from sassgis.hazard.assess import Assessment, Rules
from sassgis.hazard.bins import bins_of
from sassgis.hazard.progress import line_ends, sample_of
from sassgis.hazard.reach_angles import reach_angles
from sassgis.hazard.warnings import rule_warnings, zone_warnings
from sassgis.io.qgis.entries import LayerGroup
from sassgis.io.qgis.layout import PrintLayout
from sassgis.io.qgis.run_project import (
    SheetWords,
    reached_extent,
    run_layouts,
    sheet_words,
    write_run_project,
    zone_groups,
    zone_layouts,
)
from sassgis.io.read.config import resolved, settings_hash
from sassgis.io.read.objects import object_cells
from sassgis.io.vector_layer import VectorLayer
from sassgis.io.write.frames import (
    passage_frame,
    profile_passage_frame,
    profile_rock_frame,
    rock_frame,
    write_table,
)
from sassgis.io.write.geopackage import write_geopackage
from sassgis.io.write.layers import run_vectors
from sassgis.io.write.layers.exposed_objects import exposed_layers
from sassgis.io.write.layers.federal import federal_layers
from sassgis.io.write.layers.hazard_maps import hazard_layers
from sassgis.io.write.layers.maps import map_layers
from sassgis.io.write.layers.risk_objects import risk_tables, risk_vectors
from sassgis.io.write.layers.terrain_layer import terrain_layer
from sassgis.io.write.layers.zones import (
    change_table,
    changes,
    hazard_zones,
    level_changes,
    uncertain_zones,
    without_barriers,
    zone_sources,
)
from sassgis.io.write.manifest import write_manifest
from sassgis.io.write.raster import write_raster
from sassgis.io.write.zone_tables import design_table, layer_table, source_table
from sassgis.model.crs import crs_name
from sassgis.model.exposure import PlacedObjects
from sassgis.model.map_run import MapRun, ObjectCells
from sassgis.model.profiles import LineEnd
from sassgis.model.results import RasterLayer, StopReason
from sassgis.model.run_config import Config
from sassgis.report.exposed_report import exposed_table, levels_of, map_objects
from sassgis.report.map_report import map_report, release_outlines
from sassgis.report.page import (
    ReportContext,
    ReportFigure,
    ReportTable,
    translated_report,
    write_report,
)
from sassgis.report.path_page import write_path_page
from sassgis.report.profile_report import profile_report
from sassgis.report.run_summary import object_lines, run_lines, zone_lines
from sassgis.report.zone_report import level_table, zone_facts_of, zone_figures, zone_tables
from sassgis.runs.checkpoint import read_rows
from sassgis.runs.inputs import input_files
from sassgis.runs.job import Simulation
from sassgis.runs.map import paths_on_line, some_paths
from sassgis.runs.path_sample import sample_paths


@dataclass(frozen=True)
class Extras:
    """What a result holds besides the maps of the blocks themselves.

    Attributes
    ----------
    layers : tuple of RasterLayer
    vectors : tuple of VectorLayer
        Written to ``hazard.gpkg``.
    groups : tuple of LayerGroup
        On top of the project.
    layouts : callable
        Gives its map sheets from what every sheet says.
    figures : tuple of ReportFigure
    key_results : ReportTable or None
        Heads the report, in place of the stopping reasons.
    tables : tuple of ReportTable
    facts : dict
        Added to those of the run.
    described : tuple of (str, str)
        Added to what the report says was computed.
    frames : dict of str to DataFrame
        Written to ``tables/<name>.csv``.
    inputs : dict of str to Path
        Files that were read besides those of the run.
    warnings : tuple of str
    placed : PlacedObjects
        Exposed objects, drawn on the maps.
    levels : dict of str to str
        The hazard level of each of them by its name; empty without zones.
    summary : tuple of (str, str)
        Added to the answer in short.
    preset : str
    ref_widths_m : dict of str to float
        Reference widths besides that of the reach probability (m).
    """

    layers: tuple[RasterLayer, ...] = ()
    vectors: tuple[VectorLayer, ...] = ()
    groups: tuple[LayerGroup, ...] = ()
    layouts: Callable[[SheetWords], tuple[PrintLayout, ...]] = lambda _words: ()
    figures: tuple[ReportFigure, ...] = ()
    key_results: ReportTable | None = None
    tables: tuple[ReportTable, ...] = ()
    facts: dict[str, object] = field(default_factory=dict)
    described: tuple[tuple[str, str], ...] = ()
    frames: dict[str, Any] = field(default_factory=dict)
    inputs: dict[str, Path] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    placed: PlacedObjects = field(default_factory=lambda: PlacedObjects((), ()))
    levels: dict[str, str] = field(default_factory=dict)
    summary: tuple[tuple[str, str], ...] = ()
    preset: str = ""
    ref_widths_m: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Published:
    """What was written of a run on the map.

    Attributes
    ----------
    layers : tuple of RasterLayer
        The maps of the blocks.
    report : ReportContext
        What the report says, in its language.
    warnings : tuple of str
        In English.
    """

    layers: tuple[RasterLayer, ...]
    report: ReportContext
    warnings: tuple[str, ...]


def publish_map(
    work: Path,
    done: Simulation,
    areas: Sequence[str] | None,
    tell: Callable[[str], None],
    extras: Extras | None = None,
) -> Published:
    """Write the result of a run on the map, in the language of the settings.

    Parameters
    ----------
    work : Path
        Working folder of the result.
    done : Simulation
    areas : sequence of str or None
        Names of the release areas, if not all were run.
    tell : callable
        Called with a line of text now and then.
    extras : Extras, optional

    Returns
    -------
    Published
    """
    extras = extras or Extras()
    tell("Writing the maps")
    config, run, planned, progress = done.config, done.run, done.planned, done.progress
    warnings = [*extras.warnings, *done.warnings]
    sample = sample_of(run, planned, progress)
    layers = map_layers(
        progress.sums,
        run.grid.shape,
        sample,
        bins_of(run).edges,
        run.grid.cell_size,
        config.output.energy_classes_kj,
    )
    terrain = terrain_layer(run.grid)
    for layer in (*extras.layers, *layers, terrain):
        write_raster(layer, run.grid, work / "maps")
    vectors = [
        *run_vectors.all_layers(run, planned, progress, layers),
        *exposed_layers(extras.placed, run.grid.crs),
    ]
    paths = sample_paths(run, planned, config.output.paths_max)
    if paths:
        vectors.append(run_vectors.block_paths(paths, run.grid.crs))
    counts = _counts(done)
    facts = _facts(done) | extras.facts | counts
    write_geopackage(work / "result.gpkg", vectors, facts)
    if extras.vectors:
        write_geopackage(work / "hazard.gpkg", extras.vectors, facts)
    imprint = replace(config.project, date=made_on(config))
    words = sheet_words(
        run, int(progress.reasons.sum()), imprint, terrain_file=config.dem_path.name,
        program=f"sassgis {sassgis.__version__}", vectors=vectors,
        extent=reached_extent(layers, run.grid),
    )  # fmt: skip
    sheets = (*extras.layouts(words), *run_layouts(words, layers))
    write_run_project(
        work, imprint, run.grid, words.extent, layers, terrain, vectors, extras.groups, sheets
    )
    _write_tables(work / "tables", done, extras.frames, tell)
    tell("Drawing the figures")
    shown = (
        None if progress.furthest is None else paths_on_line(run, planned, *progress.furthest[1:])
    )
    named = {"terrain_file": config.dem_path.name, "config_file": config.file.name}
    if done.tolerance is not None:
        named["tolerance_check"] = done.tolerance.sentence()
    context = map_report(
        run, planned, progress, layers, shown, warnings, facts | named, work / "figures",
        map_objects(extras.placed),
    )  # fmt: skip
    exposed = _exposed(run, layers, extras)
    first = () if extras.key_results is None else (context.key_results,)
    report = replace(
        context,
        byline=_byline(config),
        summary=(
            *extras.summary[:1],
            *run_lines(progress, reach_angles(run, planned, progress)),
            *object_lines(exposed),
            *extras.summary[1:],
        ),
        key_results=extras.key_results or context.key_results,
        figures=(*extras.figures, *context.figures),
        tables=(exposed, *extras.tables, *first, *context.tables),
        what_was_run=(*extras.described, *context.what_was_run),
    )
    report = translated_report(report)
    write_report(work / "report.html", report)
    _write_paths(work / "paths.html", done, extras, layers)
    write_manifest(
        work / "manifest.json",
        inputs=input_files(config) | extras.inputs,
        base=config.file.parent,
        crs=run.grid.crs,
        vertical_datum=run.grid.vertical_datum,
        seed=run.seed,
        ref_widths_m={"reach_probability": run.grid.cell_size} | extras.ref_widths_m,
        preset=extras.preset,
        settings=resolved(config)
        | ({} if areas is None else {"areas": sorted(areas)})
        | ({"zoning": extras.facts} if extras.facts else {}),
        counts=counts,
        warnings=warnings,
        checks={} if done.tolerance is None else {"segment_tolerance": done.tolerance.facts()},
    )
    return Published(layers, report, tuple(warnings))


def _exposed(run: MapRun, layers: tuple[RasterLayer, ...], extras: Extras) -> ReportTable:
    """What reaches the exposed objects; without rows where there are none."""
    placed = extras.placed
    cells = (
        ObjectCells(len(placed), *object_cells(placed, run.grid))
        if len(placed)
        else ObjectCells.none()
    )
    return exposed_table(placed, cells, layers, extras.levels)


def _write_paths(
    file: Path, done: Simulation, extras: Extras, layers: tuple[RasterLayer, ...]
) -> None:
    """Write the page on which paths can be followed, if any block moved."""
    paths = some_paths(done.run, done.planned)
    if not paths:
        return
    by_stem = {layer.stem: layer for layer in (*layers, *extras.layers)}
    shown = by_stem.get("hazard_level", by_stem["energy"])
    outlines, objects = release_outlines(done.run), map_objects(extras.placed)
    write_path_page(file, done.config.project.name, done.run, shown, paths, outlines, objects)


def made_on(config: Config) -> str:
    """The date on sheets and in the report: that of the configuration, or today."""
    return config.project.date or date.today().isoformat()


def _byline(config: Config) -> tuple[str, ...]:
    """Who made it, when, with which program; where to ask; whose data."""
    project = config.project
    parts = (project.author, made_on(config), f"sassgis {sassgis.__version__}", project.contact,
             project.rights)  # fmt: skip
    return tuple(part for part in parts if part)


def _counts(done: Simulation) -> dict[str, int]:
    """Numbers of what was simulated, for the manifest and the GeoPackage."""
    run, planned, progress = done.run, done.planned, done.progress
    ends: dict[LineEnd, int] = line_ends(progress)
    return {
        "release_areas": len(run.areas),
        "release_points": len(planned.points),
        "fall_lines": sum(ends.values()),
        "rocks": int(progress.reasons.sum()),
        "rocks_not_simulated": progress.lost,
        "fragments": progress.pieces,
        **{f"rocks_{r.name.lower()}": int(progress.reasons[r]) for r in StopReason},
        **{f"lines_{e.name.lower()}": n for e, n in ends.items()},
    }


def _facts(done: Simulation) -> dict[str, object]:
    """What the maps rest on, for the GeoPackage and the report."""
    config, run = done.config, done.run
    return {
        "program": f"sassgis {sassgis.__version__}",
        "model": "SASS (Bozzolo and Pamini, 1986)",
        "title": config.project.name,
        "crs": crs_name(run.grid.crs) if run.grid.crs else "local coordinates",
        "vertical_datum": run.grid.vertical_datum or "not stated",
        "seed": run.seed,
        "ref_width_m": run.grid.cell_size,
        "lateral_spread": run.lateral_spread,
        "effects": ", ".join(run.effects.names) or "none",
        "settings_hash": settings_hash(config),
    }


def _write_tables(
    folder: Path, done: Simulation, frames: Mapping[str, Any], tell: Callable[[str], None]
) -> None:
    """Write the tables of the zoning, and those of single blocks and passages if asked for."""
    for name, frame in frames.items():
        write_table(folder / f"{name}.csv", [frame])
    output, parts = done.config.output, done.checkpoint.rows()
    for name, suffix, frame_of in (
        ("rocks", output.rock_table, rock_frame),
        ("passages", output.passage_table, passage_frame),
    ):
        if suffix != "none":
            tell(f"Writing the table of {name}")
            rows = (frame_of(read_rows(part), done.run, done.planned) for part in parts)
            write_table(folder / f"{name}.{suffix}", rows)


def zone_extras(rules: Rules, found: Assessment, done: Simulation, figures: Path) -> Extras:
    """Everything that zoning adds to a result; figures are drawn into the folder ``figures``."""
    config, run, preset = done.config, done.run, rules.preset
    grid, confidence, currency = run.grid, config.hazard.confidence, config.risk.currency
    hazard = found.hazard
    maps = hazard_layers(
        hazard.curves,
        preset,
        grid.shape,
        rules.ref_width_m,
        return_periods=preset.return_periods,
        confidence=confidence,
    )
    zones = hazard_zones(hazard, preset, grid, rules.ref_width_m, confidence)
    uncertain = hazard.curves.places[hazard.uncertain]
    own = [zones, uncertain_zones(uncertain, grid, confidence)]
    risk: list[VectorLayer] = []
    sources = source_table(hazard.sampled)
    frames = {
        "zones": layer_table(zones),
        "zone_sources": zone_sources(hazard),
        "sources": sources,
    }
    periods = config.hazard.design_return_periods_years
    design = design_table([line for line, _ in run.control_lines], found.without_barriers, periods)
    if len(design):
        frames["design"] = design
    if found.without is not None:
        before = hazard_zones(found.without, preset, grid, rules.ref_width_m, confidence)
        both = changes(found.without.levels, hazard.levels)
        codes, labels = zip(*((c.code, c.label) for c in preset.levels), strict=True)
        own += [without_barriers(before), level_changes(both, codes, grid.crs)]
        frames["level_changes"] = change_table(both, labels)
    if found.risk is not None:
        risk = risk_vectors(found.risk, rules.placed, grid.crs, currency)
        frames |= risk_tables(found.risk, found.risk_without, currency)
    federal = federal_layers(config, grid, preset, rules.ref_width_m, hazard, found.by_area)
    levels = level_table(preset, found)
    return Extras(
        layers=maps,
        vectors=(*own, *risk, *federal),
        groups=zone_groups(maps, own, risk, federal),
        layouts=lambda words: zone_layouts(words, rules, found, risk, grid),
        figures=zone_figures(
            run, rules, found, maps, figures, confidence=confidence, currency=currency
        ),
        key_results=levels,
        tables=zone_tables(
            preset, found, sources, design, return_periods_years=periods, currency=currency
        ),
        facts={
            "preset": f"{preset.name}: {preset.title}",
            "hazard_ref_width_m": rules.ref_width_m,
            "confidence": confidence,
            "uncertain_share": round(hazard.uncertain_share, 4),
            "repetitions": run.repetitions,
        },
        described=zone_facts_of(rules, found, run.repetitions, confidence),
        frames=frames,
        inputs=_zone_inputs(config),
        warnings=(
            *rule_warnings(preset, rules.frequencies),
            *zone_warnings(
                hazard.uncertain_share,
                config.hazard.uncertain_share_max,
                config.hazard.repetitions_max,
            ),
        ),
        placed=rules.placed,
        levels=levels_of(rules.placed, hazard.levels, preset.levels),
        summary=zone_lines(levels, found, currency),
        preset=preset.name,
        ref_widths_m={"hazard": rules.ref_width_m},
    )


def _zone_inputs(config: Config) -> dict[str, Path]:
    files = {"frequencies": config.hazard.frequencies, "vulnerability": config.risk.vulnerability}
    files |= {f"objects {o.name}": o.file for o in config.objects}
    if config.hazard.preset.endswith(".toml"):
        files["preset"] = Path(config.hazard.preset)
    return {role: path for role, path in files.items() if path is not None}


def publish_profile(
    work: Path,
    config: Config,
    result: ProfileResult,
    warnings: Sequence[str],
    *,
    own_file: Path | None,
    seed: int,
) -> ReportContext:
    """Write the result of a run along one profile, in the language of the settings.

    Parameters
    ----------
    work : Path
        Working folder of the result.
    config : Config
    result : ProfileResult
    warnings : sequence of str
    own_file : Path or None
        The profile, or the line under which it lies, if it is not that of the configuration.
    seed : int
        As used.

    Returns
    -------
    ReportContext
        What the report says.
    """
    scenarios = [b.name for b in config.blocks]
    tables = work / "tables"
    write_table(tables / "rocks.csv", [profile_rock_frame(result, scenarios)])
    write_table(tables / "passages.csv", [profile_passage_frame(result)])
    provenance = (
        ("Program", f"sassgis {sassgis.__version__}"),
        ("Seed", str(seed)),
        ("Settings and inputs (SHA-256)", settings_hash(config)),
    )
    effects = config.effects.names
    report = translated_report(
        profile_report(result, warnings, effects, _byline(config), provenance, work / "figures")
    )
    write_report(work / "report.html", report)
    own = {} if own_file is None else {"profile": own_file}
    write_manifest(
        work / "manifest.json",
        inputs=input_files(config) | own,
        base=config.file.parent,
        crs="",
        vertical_datum="",
        seed=seed,
        ref_widths_m={},
        preset="",
        settings=resolved(config),
        counts={
            "rocks": int(result.rocks.size),
            "fragments": int(result.pieces.size),
            **{
                f"rocks_{r.name.lower()}": int((result.rocks["reason"] == r).sum())
                for r in StopReason
            },
        },
        warnings=warnings,
    )
    return report
