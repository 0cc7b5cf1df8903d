"""What a mosaic that is made block by block has besides its maps and zones.

Release areas, stations and barriers with what passes and meets them, the risk of exposed objects,
and the project of all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sassgis.hazard.assess import risk_of
from sassgis.io.qgis.run_project import write_run_project, zone_groups
from sassgis.io.vector_layer import VectorLayer
from sassgis.io.write.frames import write_table
from sassgis.io.write.geopackage import write_geopackage
from sassgis.io.write.layers import run_vectors
from sassgis.io.write.layers.exposed_objects import exposed_layers
from sassgis.io.write.layers.risk_objects import risk_tables, risk_vectors
from sassgis.io.write.zone_tables import layer_table
from sassgis.model.grid import Grid
from sassgis.model.map_run import MapRun
from sassgis.model.release_areas import ReleaseArea
from sassgis.model.statistics_table import Bins
from sassgis.runs.batch_area import Setting, area_feature
from sassgis.runs.batch_areas import Candidate
from sassgis.runs.batch_blocks import Maps, Reached, met_objects
from sassgis.runs.inputs import compares_barriers
from sassgis.runs.publish import made_on

#: The zones; the other layers of zones are those of the federal model.
_ZONES = "hazard_zones"


def write_besides(
    work: Path,
    setting: Setting,
    run: MapRun,
    frame: Grid,
    candidates: Sequence[Candidate],
    areas: Sequence[Reached],
    bins: Bins,
    maps: Maps,
    zones: Sequence[VectorLayer],
) -> None:
    """Write GeoPackages, tables and project.

    Parameters
    ----------
    work : Path
        Folder of the mosaic, with its maps.
    setting : Setting
    run : MapRun
        With the settings of all areas; of its grid only the coordinate system counts.
    frame : Grid
        Of the mosaic, without heights.
    candidates : sequence of Candidate
    areas : sequence of Reached
        The same areas, in the same order.
    bins : Bins
        Of all areas.
    maps : Maps
        Of their values only the limits of the legend count.
    zones : sequence of VectorLayer
    """
    config, rules, crs = setting.config, setting.rules, frame.crs
    progress, sampled = met_objects(run, areas, bins)
    released = [
        ReleaseArea(c.name, area_feature(setting, c).geometry, tuple(a.record.frequencies))
        for c, a in zip(candidates, areas, strict=True)
    ]
    vectors = [
        run_vectors.released_from(
            released, [a.record.points for a in areas], [a.record.rocks for a in areas], crs
        ),
        *run_vectors.control_line_layers(run, progress),
        *exposed_layers(rules.placed, crs),
    ]
    write_geopackage(work / "result.gpkg", vectors)
    own = [layer for layer in zones if layer.name == _ZONES]
    tables = {"zones": layer_table(own[0])} if own else {}
    currency = config.risk.currency
    risk = risk_of(rules, sampled, bins.threshold)
    shown: list[VectorLayer] = []
    if risk is not None:
        shown = risk_vectors(risk, rules.placed, crs, currency)
        before = None
        if compares_barriers(config, run):
            _, sampled = met_objects(run, areas, bins, without=True)
            before = risk_of(rules, sampled, bins.threshold)
        tables |= risk_tables(risk, before, currency)
    if zones or shown:
        write_geopackage(work / "hazard.gpkg", [*zones, *shown], {"preset": rules.preset.name})
    for name, table in tables.items():
        write_table(work / "tables" / f"{name}.csv", [table])
    federal = [layer for layer in zones if layer.name != _ZONES]
    write_run_project(
        work, replace(config.project, date=made_on(config)), frame, frame.bounds, maps.blocks,
        maps.terrain, vectors, zone_groups(maps.hazard, own, shown, federal),
    )  # fmt: skip
