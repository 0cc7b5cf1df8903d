"""Writes results: maps, GeoPackages, project, tables, report, manifest, answers of the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import Bounds, Grid
from sassgis.hazard.assess import Assessment, Rules, governing
from sassgis.hazard.curves import hazard_curves
from sassgis.hazard.design import arrivals, motion_warnings, value_at_rate
from sassgis.hazard.object_values import ObjectValues, object_values
from sassgis.hazard.risk import RiskTable
from sassgis.hazard.sources import ReachAngles, Sampled, reach_angles, sampled_sources
from sassgis.hazard.warnings import ground_shares
from sassgis.hazard.zoning.applied_edits import shares_text
from sassgis.inputs.dem import read_base_map
from sassgis.inputs.result_folder import EDITS_FILE, RESULT_FILE, ZONE_FILE
from sassgis.outputs.frames import passage_frame, path_contacts, rock_frame, write_table
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.layers import run_vectors
from sassgis.outputs.layers.maps import map_layers, terrain_layer
from sassgis.outputs.layers.risk_objects import exposed_layers
from sassgis.outputs.layers.variant_layers import (
    answer_table,
    band_table,
    range_table,
    spread_layers,
    spread_vectors,
)
from sassgis.outputs.qgis import run_project
from sassgis.outputs.qgis.entries import LayerEntry, LayerGroup
from sassgis.outputs.qgis.layout import PrintLayout
from sassgis.outputs.raster import write_raster
from sassgis.report.change_report import spread_lines, spread_table
from sassgis.report.map_page import Contribution, MapHazard, PlaceFacts, Rows, write_map_page
from sassgis.report.map_report import (
    Lines,
    block_pictures,
    map_marks,
    map_report,
    object_lines,
    passing_figures,
    run_lines,
)
from sassgis.report.page import (
    ReportContext,
    ReportFigure,
    ReportTable,
    sensible,
    translated_report,
    write_report,
)
from sassgis.report.pictures import GIVEN_UP, map_pictures
from sassgis.report.protection_page import (
    PAGE_NAME,
    ObjectLevels,
    ProtectionSheet,
    exposed_table,
    map_objects,
    most_exposed,
    write_protection_page,
)
from sassgis.report.zone_report import BARRIERS_TITLE
from sassgis.runs.provenance import byline, facts_of, made_on, provenance, write_origin
from sassgis.runs.resumable_run import Simulation
from sassgis.runs.variant_lab import DrawnGround
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.hazard_rules import LIMIT_TEXT, HazardPreset
from sassgis.settings.languages import joined, named, phrase
from sassgis.settings.map_run import Config, MapRun
from sassgis.settings.process import give_back_freed
from sassgis.settings.results import RUNOUT_COUNTS, RasterLayer, StopReason, first_warnings
from sassgis.settings.statistics_table import Bins, bins_of
from sassgis.simulation.accumulators import Progress, line_ends, sample_of
from sassgis.simulation.checkpoint import read_rows
from sassgis.simulation.control_lines import FORCE, LineParts
from sassgis.simulation.map_sums import MapSums, Sample
from sassgis.simulation.path_sample import BlockPath, paths_on_line, sample_paths
from sassgis.simulation.workers import beside

#: Points of a curve at a line.
_POINTS = 16


def blocks_by_source(run: MapRun, progress: Progress) -> list[Contribution]:
    """Count the simulated blocks of each source that reach each cell."""
    found: list[Contribution] = []
    for (area, k), tally in sorted(progress.sources.items()):
        own = tally.cells.counts()
        weight = own.count[:, 0].astype(np.float64)
        found.append((run.areas[area].name, run.blocks[k].name, own.places, weight))
    return found


def rates_by_source(sampled: Sequence[Sampled]) -> list[Contribution]:
    """Compute how often blocks of each source reach each cell (1/year)."""
    return [
        (
            s.source.area, s.source.scenario, s.cells.places,
            np.asarray(s.source.rate_per_rock * s.cells.count[:, 0], np.float64),
        )
        for s in sampled
    ]  # fmt: skip


def area_rows(run: MapRun, frequencies: Mapping[tuple[str, str], float]) -> dict[str, Rows]:
    """Describe each release area: its scenarios, with their onset frequencies if known."""
    found: dict[str, Rows] = {}
    for area in run.areas:
        rows = []
        for scenario in area.scenarios:
            frequency = frequencies.get((area.name, scenario))
            text = phrase("")
            if frequency is not None:
                text = phrase("{} blocks a year", sensible(frequency))
            rows.append((named(scenario), text))
        found[area.name] = tuple(rows)
    return found


def map_hazard(rules: Rules, found: Assessment) -> MapHazard:
    """Return curves and zones with what is known of each."""
    facts, levels = found.hazard.facts, found.hazard.levels
    sources = [s.source for s in found.hazard.sampled]
    _, most = governing(facts.shares)
    zones = []
    for k, (polygon, level) in enumerate(zip(levels.polygons, levels.classes, strict=True)):
        rows = [("Area", phrase("{} m²", f"{facts.area_m2[k]:.0f}"))]
        if math.isfinite(facts.uncertain[k]):
            text = phrase("{} % of its cells", f"{100.0 * facts.uncertain[k]:.0f}")
            rows.append(("Statistically uncertain", text))
        source = int(facts.governing[k])
        if source >= 0:
            own = sources[source]
            share = f"{100.0 * most[k]:.0f} %"
            rows.append(("Governed by", phrase("{}, {} ({})", own.area, own.scenario, share)))
        zones.append((int(level) - 1, polygon, tuple(rows)))
    marks: list[tuple[str, str, Any, Rows]] = [
        ("assessed", "", polygon, ()) for polygon in rules.assessed
    ]
    marks += [
        ("open", f"{facts.open_m[k]:.0f} m", facts.open_limit[k], ())
        for k in np.flatnonzero(facts.open_m > 0.0)
    ]
    labels = [phrase("none"), *(phrase(c.label) for c in rules.preset.levels)]
    for applied in found.hazard.edits:
        edit, limit = applied.edit, phrase(LIMIT_TEXT[applied.edit.limit])
        said = (("Level", joined(" ", filter(None, (limit, labels[edit.level])))),
                ("computed now", named(shares_text(applied.now))))  # fmt: skip
        marks.append(("edit", edit.words, edit.geometry, said))
    return MapHazard(rules.preset, found.hazard.curves, zones, marks, rules.ref_width_m)


def line_facts(
    run: MapRun,
    without_barriers: Sequence[Sampled],
    with_barriers: Sequence[Sampled],
    periods_years: Sequence[float],
) -> dict[tuple[str, str], PlaceFacts]:
    """Return the loads at each station and barrier without barriers, by return period.

    At a gallery also the forces of the blocks that land on its roof.
    """
    found: dict[tuple[str, str], PlaceFacts] = {}
    for i, (line, _) in enumerate(run.control_lines):
        energy, height = (arrivals(without_barriers, i, q) for q in ("energy_kj", "height_m"))
        rows: list[tuple[str, str]] = []
        if line.kind != "station":
            stated = (("Height", f"{line.height_m:g} m"), ("Capacity", f"{line.capacity_kj:g} kJ"))
            rows += [(key, named(text)) for key, text in stated if "inf" not in text]
        for years in periods_years:
            values = (value_at_rate(own, 1.0 / years) for own in (energy, height))
            texts = ["–" if math.isnan(v) else sensible(v) for v in values]
            rows.append(
                (
                    phrase("once in {} years", f"{years:g}"),
                    phrase("{} kJ, passing height {} m", *texts),
                )
            )
        if line.kind == "gallery":
            force = arrivals(with_barriers, i, FORCE)
            # Blocks that do not land on the roof lie in the first bin.
            often = float(force.rate[1])
            loads = [
                phrase("{} years: {} kN", f"{years:g}", sensible(value_at_rate(force, 1.0 / years)))
                for years in periods_years
                if often > 1.0 / years
            ]
            rows.append(("force on the roof", joined("; ", loads) if loads else "–"))
        rows.append(("Blocks that arrive", phrase("{} a year", sensible(float(energy.rate[0])))))
        at = np.unique(np.linspace(0, energy.edges.size - 1, _POINTS * 4).astype(int))
        curve = [(float(energy.edges[k]), float(energy.rate[k])) for k in at if energy.rate[k] > 0]
        found[line.kind, line.name] = (tuple(rows), curve)
    return found


def object_facts(
    risk: RiskTable | None,
    sampled: Sequence[Sampled],
    energies_kj: np.ndarray,
    levels: Mapping[str, ObjectLevels],
    currency: str,
) -> dict[tuple[str, str], PlaceFacts]:
    """Return the hits of each exposed object; the curve of a road is that of its worst stretch."""
    if risk is None:
        return {}
    curves = hazard_curves([s.source for s in sampled], [s.objects for s in sampled], energies_kj)
    row_of = {int(place): row for row, place in enumerate(curves.places)}
    members: dict[str, list[int]] = {}
    for number, thing in enumerate(risk.objects):
        members.setdefault(thing.whole, []).append(number)
    quantity = {name: risk.of_object(name) for name in ("hits", "loss", "deaths")}
    found: dict[tuple[str, str], PlaceFacts] = {}
    for name, own in members.items():
        total = {key: float(values[own].sum()) for key, values in quantity.items()}
        rows: list[tuple[str, str]] = [
            ("Hazard level", phrase(levels.get(name, ("none", "none"))[0]))
        ]
        if total["hits"] > 0.0:
            rows.append(("Hits", phrase("once in {} years", sensible(1.0 / total["hits"]))))
        if total["loss"] > 0.0:
            rows.append(("Loss", phrase("{} {} a year", sensible(total["loss"]), currency)))
        if total["deaths"] > 0.0:
            rows.append(("Deaths", phrase("{} a year", sensible(total["deaths"]))))
        worst = max(own, key=lambda k: quantity["hits"][k])
        curve: list[tuple[float, float]] = []
        if worst in row_of:
            rates = curves.rate[row_of[worst]]
            curve = [(float(e), float(r)) for e, r in zip(energies_kj, rates, strict=True) if r > 0]
        found["object", name] = (tuple(rows), curve)
    return found


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
    levels: dict[str, ObjectLevels] = field(default_factory=dict)
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
    # What reaches stations and barriers by source, and how often one of its blocks comes.
    parts: LineParts = ()


@dataclass(frozen=True, slots=True)
class BlockFigures:
    """Maps of the blocks, and the figures that show nothing else."""

    layers: tuple[RasterLayer, ...]
    figures: tuple[ReportFigure, ...]
    at_objects: MapSums  # of the cells of exposed objects


def begun(work: Path, done: Simulation, placed: PlacedObjects) -> BlockFigures:
    """Make maps of the blocks and begin to draw them, in the language of the settings.

    The histograms of the simulation are freed: nothing else is read from them.
    """
    run, planned, progress = done.run, done.planned, done.progress
    layers = block_maps(
        done.config, run.grid, progress.sums, sample_of(run, progress), bins_of(run)
    )
    furthest = progress.furthest
    shown = None if furthest is None else paths_on_line(run, planned, *furthest[1:])
    drawn, folder = list[ReportFigure](), work / "figures"
    if progress.sums.cells.size:
        drawn = block_pictures(run, progress, layers, shown, map_objects(placed), folder)
    at_objects = progress.sums.part(run.objects.cell)
    progress.sums.free_histograms()
    return BlockFigures(layers, (*drawn, *passing_figures(progress, folder)), at_objects)


#: All maps; the report in its language; the warnings in English.
Published = tuple[tuple[RasterLayer, ...], ReportContext, tuple[str, ...]]


def publish_map(
    work: Path,
    done: Simulation,
    areas: Sequence[str] | None,
    tell: Callable[[str], None],
    extras: Extras,
    blocks: BlockFigures,
) -> Published:
    """Write the result of a run on the map into a folder, in the language of the settings.

    ``areas`` are the names of the release areas, if not all were run.
    """
    tell("Writing the maps")
    config, run, planned, progress = done.config, done.run, done.planned, done.progress
    layers, values = blocks.layers, extras.objects
    if values is None:
        values = values_at_objects(done, None, (), blocks.at_objects)
    q95 = {layer.stem: layer.bands[0].values for layer in layers}
    highest = {"speed_mps": q95["speed"], "height_m": q95["passing_height"]}
    warnings = (*extras.warnings, *done.warnings, *motion_warnings(run.released_blocks, highest))
    counts = _counts(done)
    facts = facts_of(config, run) | extras.facts | counts
    angles = reach_angles(run, planned, progress)
    envelope = run_vectors.energy_line(run, planned, angles)
    paths = sample_paths(run, planned, config.output.paths_max)
    report = partial(
        _write_report,
        work=work,
        done=done,
        blocks=blocks,
        extras=extras,
        exposed=exposed_table(extras.placed, values, extras.levels),
        warnings=warnings,
        facts=facts,
        angles=angles,
        envelope=envelope,
        paths=paths,
    )
    with beside(report, GIVEN_UP) as reported:
        terrain = terrain_layer(run.grid)
        for layer in (*extras.layers, *layers, terrain):
            write_raster(layer, run.grid, work / "maps")
        vectors = run_vectors.all_layers(run, planned, progress, layers, extras.parts)
        vectors += [envelope, *exposed_layers(extras.placed, run.grid.crs, values)]
        if paths:
            vectors.append(run_vectors.block_paths(paths, run.grid.crs))
            write_table(work / "tables" / "contacts.csv", [path_contacts(paths)])
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
    extent: Bounds,
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
        folder=work,
        imprint=imprint,
        grid=grid,
        extent=extent,
        layers=layers,
        terrain=terrain,
        vectors=vectors,
        groups=extras.groups,
        layouts=layouts,
        base_map=read_base_map(imprint.base_map, grid),
    )
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
        **dict(zip(RUNOUT_COUNTS, progress.runout_m(*RUNOUT_COUNTS.values()), strict=True)),
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
    blocks: BlockFigures,
    extras: Extras,
    exposed: ReportTable,
    warnings: Sequence[str],
    facts: Mapping[str, object],
    angles: ReachAngles,
    envelope: VectorLayer,
    paths: Sequence[BlockPath],
) -> ReportContext:
    """Write report, map page and sheets of protection if any; returns what the report says."""
    config, run, planned, progress = done.config, done.run, done.planned, done.progress
    named = {"terrain_file": config.dem_source.name}
    if done.tolerance is not None:
        named["tolerance_check"] = done.tolerance.sentence()
    objects = map_objects(extras.placed)
    context = map_report(
        run=run,
        planned=planned,
        progress=progress,
        warnings=warnings,
        facts={**facts, **named},
        pictures=blocks.figures,
        parts=extras.parts,
    )
    give_back_freed()
    lines = run_lines(progress, angles)
    first = () if extras.key_results is None else (context.key_results,)
    drawn, sheets = extras.figures(), extras.sheets()
    rows = area_rows(run, extras.frequencies)
    write_map_page(
        file=work / "map.html",
        title=config.project.name,
        run=run,
        layers=(*extras.layers, *blocks.layers),
        areas=[(area.name, area.geometry, rows[area.name]) for area in run.areas],
        objects=objects,
        contributions=extras.contributions or blocks_by_source(run, progress),
        points=planned.points,
        envelope=envelope,
        paths=paths,
        places=extras.places,
        hazard=extras.hazard,
        warnings=first_warnings(warnings),
    )
    others = [("map.html", "The map in a browser")]
    if sheets:
        change = next((f for f in drawn if f.title == BARRIERS_TITLE), None)
        write_protection_page(
            work,
            config.project.name,
            byline(config),
            sheets,
            change,
            len(first_warnings(warnings)),
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
    return replace(report, figures=tuple(figure.finished() for figure in report.figures))


def values_at_objects(
    done: Simulation,
    sampled: Sequence[Sampled] | None,
    return_periods: Sequence[float],
    sums: MapSums | None,
) -> ObjectValues:
    """Compute what reaches the exposed objects; ``sampled`` with frequencies if there are any.

    ``sums`` are those of their cells; without, no height is stated.
    """
    run, bins = done.run, bins_of(done.run)
    own = sampled_sources(run, done.progress, None) if sampled is None else sampled
    return object_values(
        run.objects, [s.source for s in own], [s.objects for s in own], bins.threshold,
        sums, bins.edges["height"],
        return_periods=return_periods, confidence=done.config.hazard.confidence,
    )  # fmt: skip


_VECTORS = "ground_spread.gpkg"


def with_spread(
    extras: Extras,
    drawn: DrawnGround | None,
    work: Path,
    done: Simulation,
    preset: HazardPreset | None = None,
) -> Extras:
    """Return the extras of a result with those of the draws, if there are any.

    Their areas are written, into a separate GeoPackage: all other files of the result but
    project, report and manifest are those of a run without draws.
    """
    if drawn is None:
        return extras
    (spread, maps, answers), run = drawn, done.run
    layers = spread_layers(maps, spread.draws, run.grid, preset, run.ref_width_m)
    vectors = spread_vectors(maps, spread.draws, run.grid, preset)
    write_geopackage(work / _VECTORS, vectors, facts_of(done.config, run))
    rasters = (LayerEntry(own, f"maps/{own.stem}.tif", visible=False) for own in layers)
    group = LayerGroup(
        "Spread of the ground classes",
        (
            *(LayerEntry(own, _VECTORS, visible=False) for own in vectors),
            LayerGroup("Limits of the bands", tuple(rasters), True, False),
        ),
        expanded=False,
    )

    def figures() -> tuple[ReportFigure, ...]:
        marks = map_marks(run, map_objects(extras.placed))
        return (*extras.figures(), *map_pictures(work / "figures", run.grid, layers, marks))

    frames = {
        "ground_uncertainty": band_table(spread.bands),
        "ground_draws": answer_table(answers, spread.ranges),
        "ground_spread": range_table(spread.ranges),
    }
    return replace(
        extras,
        layers=(*extras.layers, *layers),
        groups=(*extras.groups, group),
        frames=extras.frames | frames,
        figures=figures,
        tables=(*extras.tables, spread_table(spread)),
        spread=spread_lines(spread),
    )
