"""Additions of draws of ground classes to a result: maps, areas, tables, lines of the report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.layers.variant_layers import (
    answer_table,
    band_table,
    range_table,
    spread_layers,
    spread_vectors,
)
from sassgis.outputs.qgis.entries import LayerEntry, LayerGroup
from sassgis.report.exposed_report import map_objects
from sassgis.report.map_report import map_marks
from sassgis.report.page import ReportFigure
from sassgis.report.pictures import map_pictures
from sassgis.report.variants_report import spread_lines, spread_table
from sassgis.runs.provenance import facts_of
from sassgis.runs.publish import Extras
from sassgis.runs.resumable_run import Simulation
from sassgis.runs.variant_lab import DrawnGround
from sassgis.settings.hazard_rules import HazardPreset

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
