"""The report of a run on the map and the map that can be asked, with what a zoning adds to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path

import sassgis
from sassgis.hazard.bins import bins_of
from sassgis.hazard.object_values import ObjectValues, object_values
from sassgis.hazard.reach_angles import reach_angles
from sassgis.hazard.sources import Sampled, sampled_sources
from sassgis.model.exposure import PlacedObjects
from sassgis.model.languages import translated
from sassgis.model.results import RasterLayer
from sassgis.model.run_config import Config
from sassgis.report.exposed_report import exposed_table, map_objects, most_exposed
from sassgis.report.map_page import Contribution, MapHazard, MapPage, PlaceFacts, write_map_page
from sassgis.report.map_report import map_report
from sassgis.report.page import (
    ReportContext,
    ReportFigure,
    ReportTable,
    translated_report,
    write_report,
)
from sassgis.report.protection_page import PAGE_NAME, ProtectionSheet, write_protection_page
from sassgis.report.run_summary import object_lines, run_lines
from sassgis.report.zone_report import BARRIERS_TITLE
from sassgis.runs.job import Simulation
from sassgis.runs.map_answers import area_rows, blocks_by_source
from sassgis.runs.path_sample import paths_on_line, some_paths


@dataclass(frozen=True, slots=True)
class ReportPart:
    """What a report says besides what was simulated.

    Attributes
    ----------
    figures : callable
        Draws its figures and gives them.
    key_results : ReportTable or None
        Heads the report, in place of the stopping reasons.
    described : tuple of (str, str)
        Added to what the report says was computed.
    levels : dict of str to str
        The hazard level of each exposed object by its name; empty without zones.
    objects : ObjectValues or None
        What reaches the exposed objects, by frequency; None without zones.
    summary : tuple of (str, str)
        Added to the answer in short.
    spread : tuple of (str, str)
        Added to it after the run-out.
    hazard, contributions, places, frequencies
        What the map that can be asked says of zones, sources, objects and release areas.
    sheets : callable
        Draws the sheets of protection and gives them.
    """

    figures: Callable[[], tuple[ReportFigure, ...]] = tuple
    key_results: ReportTable | None = None
    tables: tuple[ReportTable, ...] = ()
    described: tuple[tuple[str, str], ...] = ()
    levels: dict[str, str] = field(default_factory=dict)
    objects: ObjectValues | None = None
    summary: tuple[tuple[str, str], ...] = ()
    spread: tuple[tuple[str, str], ...] = ()
    hazard: MapHazard | None = None
    contributions: Sequence[Contribution] = ()
    places: Mapping[str, PlaceFacts] = field(default_factory=dict)
    frequencies: Mapping[tuple[str, str], float] = field(default_factory=dict)
    sheets: Callable[[], tuple[ProtectionSheet, ...]] = tuple


def publish_report(
    work: Path,
    done: Simulation,
    layers: tuple[RasterLayer, ...],
    more: Sequence[RasterLayer],
    placed: PlacedObjects,
    warnings: Sequence[str],
    facts: Mapping[str, object],
    part: ReportPart,
) -> ReportContext:
    """Write ``report.html`` with its figures, ``map.html``, and sheets of protection if any.

    ``layers`` are the maps of the blocks, ``more`` those of a zoning. Returns what the report says,
    in the language of the settings.
    """
    config, run, planned, progress = done.config, done.run, done.planned, done.progress
    furthest = progress.furthest
    shown = None if furthest is None else paths_on_line(run, planned, *furthest[1:])
    named = {"terrain_file": config.dem_source.name, "config_file": config.label}
    if done.tolerance is not None:
        named["tolerance_check"] = done.tolerance.sentence()
    objects = map_objects(placed)
    context = map_report(
        run, planned, progress, layers, shown, warnings, {**facts, **named}, work / "figures",
        objects,
    )  # fmt: skip
    values = part.objects or values_at_objects(done, None, ())
    exposed = exposed_table(placed, values, part.levels)
    lines = run_lines(progress, reach_angles(run, planned, progress))
    first = () if part.key_results is None else (context.key_results,)
    drawn, sheets = part.figures(), part.sheets()
    beside = [("map.html", "The map in a browser")]
    if sheets:
        change = next((own for own in drawn if own.title == BARRIERS_TITLE), None)
        write_protection_page(
            work, config.project.name, byline(config), sheets, change, len(warnings)
        )
        beside.append((PAGE_NAME, "Design of protection"))
    report = translated_report(
        replace(
            context,
            byline=byline(config),
            files_beside=tuple(beside),
            summary=(
                *part.summary[:1],
                *lines[:1],
                *part.spread,
                *lines[1:],
                *object_lines(exposed),
                *part.summary[1:],
            ),
            key_results=part.key_results or context.key_results,
            figures=(*drawn, *context.figures),
            tables=(most_exposed(exposed), *part.tables, *first, *context.tables),
            what_was_run=(*part.described, *context.what_was_run),
        )
    )
    write_report(work / "report.html", report)
    rows = area_rows(run, part.frequencies)
    page = MapPage(
        config.project.name,
        run,
        (*more, *layers),
        [(area.name, area.geometry, rows[area.name]) for area in run.areas],
        objects,
        part.contributions or blocks_by_source(run, progress),
        some_paths(run, planned),
        part.places,
        part.hazard,
    )
    write_map_page(work / "map.html", page)
    return report


def values_at_objects(
    done: Simulation,
    sampled: Sequence[Sampled] | None,
    return_periods: Sequence[float],
    heights: bool = True,
) -> ObjectValues:
    """What reaches the exposed objects of a run; ``sampled`` with frequencies, if there are any."""
    run, bins = done.run, bins_of(done.run)
    own = sampled_sources(run, done.progress, None) if sampled is None else sampled
    return object_values(
        run.objects,
        [s.source for s in own],
        [s.objects for s in own],
        bins.threshold,
        done.progress.sums if heights else None,
        bins.edges["height"],
        return_periods=return_periods,
        confidence=done.config.hazard.confidence,
    )


def made_on(config: Config) -> str:
    """The date on sheets and in the report: that of the configuration, or today."""
    return config.project.date or date.today().isoformat()


def byline(config: Config) -> tuple[str, ...]:
    """Who made it, when, with which program; where to ask; whose data."""
    project = config.project
    status = translated(project.status)
    parts = (status, project.author, made_on(config), f"sassgis {sassgis.__version__}",
             project.contact, project.rights)  # fmt: skip
    return tuple(part for part in parts if part)
