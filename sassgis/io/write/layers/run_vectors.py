"""The layers of the GeoPackage: tables with their meaning, units and style."""

from __future__ import annotations

from collections.abc import Sequence

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import ArrayLike

from sassgis.hazard.block_paths import BlockPath
from sassgis.hazard.control_lines import control_line_rows
from sassgis.hazard.progress import Progress, joined_lines, kept_stops
from sassgis.io.vector_layer import VectorLayer
from sassgis.io.write.layers.footprint import footprints
from sassgis.model.labels import LINE_END_TEXT, STOP_TEXT
from sassgis.model.map_run import MapRun
from sassgis.model.profiles import LineEnd
from sassgis.model.release_areas import ReleaseArea
from sassgis.model.results import Outcome, RasterLayer, StopReason
from sassgis.model.styles import (
    BARRIER_STYLE,
    FALL_LINE_STYLE,
    FOOTPRINT_STYLE,
    RELEASE_AREA_STYLE,
    RELEASE_POINT_STYLE,
    STATION_STYLE,
    STOP_STYLE,
    FieldInfo,
    Symbol,
    VectorStyle,
    categorised_style,
)
from sassgis.terrain.plan import Plan

_STOP_COLOUR = {
    StopReason.REST: "#1f4e79",
    StopReason.BARRIER: "#e07b00",
    StopReason.LEFT_PROFILE: "#c1121f",
    StopReason.STEP_LIMIT: "#7b2cbf",
    StopReason.NEVER_STARTED: "#8d99ae",
    StopReason.BROKEN: "#5f0f40",
}
#: Levels of the footprint: every cell reached, and shares of all blocks.
FOOTPRINT_LEVELS = (0.0, 0.001, 0.01)
_FOOTPRINT_COLOUR = ("#fed976", "#fd8d3c", "#bd0026")
#: Beyond these ends of a fall line nothing is known of the blocks.
_LINE_CUT = (LineEnd.LEFT_DEM, LineEnd.NODATA, LineEnd.MAX_LENGTH)


def release_areas(run: MapRun, planned: Plan) -> VectorLayer:
    """Release areas with what was released in them."""
    rocks = planned.rocks_of_point(run)
    n = len(run.areas)
    return released_from(
        run.areas,
        np.bincount(planned.points.area, minlength=n),
        np.bincount(planned.points.area, weights=rocks, minlength=n),
        run.grid.crs,
    )


def released_from(
    areas: Sequence[ReleaseArea], points: ArrayLike, rocks: ArrayLike, crs: str
) -> VectorLayer:
    """Release areas with the numbers of their release points and blocks."""
    frame = gpd.GeoDataFrame(
        {
            "name": [a.name for a in areas],
            "scenarios": [";".join(a.scenarios) for a in areas],
            "points": np.asarray(points, np.int64),
            "rocks": np.asarray(rocks, np.int64),
        },
        geometry=[a.geometry if a.geometry.area > 0 else a.geometry.buffer(1.0) for a in areas],
        crs=crs or None,
    )
    return VectorLayer(
        "release_areas",
        "Release areas",
        "Where blocks start; lines and points are drawn with a width of 2 m.",
        frame,
        {
            "name": FieldInfo("name"),
            "scenarios": FieldInfo("block scenarios"),
            "points": FieldInfo("release points"),
            "rocks": FieldInfo("blocks released"),
        },
        style=RELEASE_AREA_STYLE,
    )


def release_points(run: MapRun, planned: Plan) -> VectorLayer:
    """Release points."""
    points = planned.points
    frame = gpd.GeoDataFrame(
        {
            "area": [points.area_names[a] for a in points.area],
            "rocks": planned.rocks_of_point(run),
        },
        geometry=shapely.points(points.x, points.y),
        crs=run.grid.crs or None,
    )
    return VectorLayer(
        "release_points",
        "Release points",
        "Each represents the blocks released around it.",
        frame,
        {"area": FieldInfo("release area"), "rocks": FieldInfo("blocks released")},
        style=RELEASE_POINT_STYLE,
    )


def fall_lines(run: MapRun, planned: Plan, progress: Progress) -> VectorLayer:
    """Fall lines with length, drop and why they end."""
    lines = joined_lines(progress.lines)
    sizes = np.diff(lines.offset)
    # A line of one point has no length; it is drawn as a dot of zero length.
    index = np.repeat(np.arange(sizes.size), sizes)
    x, y = lines.x, lines.y
    single = np.flatnonzero(sizes == 1)
    if single.size:
        at = lines.offset[single]
        x = np.concatenate([x, x[at]])
        y = np.concatenate([y, y[at]])
        index = np.concatenate([index, single])
        order = np.argsort(index, kind="stable")
        x, y, index = x[order], y[order], index[order]
    frame = gpd.GeoDataFrame(
        {
            "area": [planned.points.area_names[planned.points.area[p]] for p in lines.point],
            "length_m": np.round(lines.length_m, 3),
            "drop_m": np.round(lines.drop_m, 3),
            "ends_at": [LINE_END_TEXT[LineEnd(int(e))] for e in lines.end],
        },
        geometry=shapely.linestrings(x, y, indices=index) if x.size else [],
        crs=run.grid.crs or None,
    )
    return VectorLayer(
        "fall_lines",
        "Fall lines",
        f"Steepest descent on the terrain smoothed over {run.fall_lines.smoothing_m:g} m.",
        frame,
        {
            "area": FieldInfo("release area"),
            "length_m": FieldInfo("length in plan", "m"),
            "drop_m": FieldInfo("drop", "m"),
            "ends_at": FieldInfo("ends at"),
        },
        style=categorised_style(
            FALL_LINE_STYLE.symbol,
            "ends_at",
            {
                text: (text, "#c1121f" if end in _LINE_CUT else FALL_LINE_STYLE.symbol.colour)
                for end, text in LINE_END_TEXT.items()
            },
            FALL_LINE_STYLE.smallest_scale,
        ),
    )


def stops(run: MapRun, planned: Plan, progress: Progress) -> VectorLayer:
    """Where single blocks end: all of them, or an even share of all."""
    total = int(progress.reasons.sum()) + progress.pieces
    rows = kept_stops(run, progress)
    on_map = np.isfinite(rows.x) & np.isfinite(rows.y)
    rocks = rows.rocks[on_map]
    frame = gpd.GeoDataFrame(
        {
            "area": [planned.points.area_names[planned.points.area[i]] for i in rocks["line"]],
            "scenario": [run.blocks[k].name for k in rows.rock_scenario[on_map]],
            "end": [STOP_TEXT[StopReason(int(r))] for r in rocks["reason"]],
            "runout_m": np.round(rocks["runout_m"], 2),
            "mass_kg": np.round(rocks["mass_kg"], 1),
            "max_energy_kj": np.round(rocks["max_energy_kj"], 2),
            "max_speed_mps": np.round(rocks["max_speed_mps"], 2),
            "max_height_m": np.round(rocks["max_height_m"], 2),
            "impacts": rocks["impacts"].astype(np.int64),
            "piece": rocks["piece"].astype(np.int64),
        },
        geometry=shapely.points(rows.x[on_map], rows.y[on_map]),
        crs=run.grid.crs or None,
    )
    which = (
        f"All {total} blocks."
        if rows.rocks.size == total
        else f"{rows.rocks.size} of {total} blocks, chosen at random."
    )
    return VectorLayer(
        "stops",
        "Stopping points",
        which,
        frame,
        {
            "area": FieldInfo("release area"),
            "scenario": FieldInfo("block scenario"),
            "end": FieldInfo("stopping reason"),
            "runout_m": FieldInfo("run-out chainage", "m"),
            "mass_kg": FieldInfo("mass", "kg"),
            "max_energy_kj": FieldInfo("largest energy", "kJ"),
            "max_speed_mps": FieldInfo("largest speed", "m/s"),
            "max_height_m": FieldInfo("largest passing height", "m"),
            "impacts": FieldInfo("impacts"),
            "piece": FieldInfo(
                "piece",
                "",
                "0: the released block; else a fragment of it, or an entrained block",
            ),
        },
        style=categorised_style(
            STOP_STYLE.symbol,
            "end",
            {text: (text, _STOP_COLOUR[reason]) for reason, text in STOP_TEXT.items()},
            STOP_STYLE.smallest_scale,
        ),
    )


def block_paths(paths: Sequence[BlockPath], crs: str) -> VectorLayer:
    """Paths of single blocks, with heights; ``crs`` is empty for local coordinates."""
    frame = gpd.GeoDataFrame(
        {
            "area": [p.area for p in paths],
            "scenario": [p.scenario for p in paths],
            "end": [STOP_TEXT[p.reason] for p in paths],
            "runout_m": np.array([round(p.runout_m, 2) for p in paths], float),
            "time_s": np.array([round(p.time_s, 2) for p in paths], float),
            "mass_kg": np.array([round(p.mass_kg, 1) for p in paths], float),
            "max_energy_kj": np.array([round(p.max_energy_kj, 2) for p in paths], float),
            "max_speed_mps": np.array([round(p.max_speed_mps, 2) for p in paths], float),
            "max_height_m": np.array([round(p.max_height_m, 2) for p in paths], float),
        },
        geometry=[shapely.LineString(np.column_stack([p.x, p.y, p.z])) for p in paths],
        crs=crs or None,
    )
    return VectorLayer(
        "paths",
        "Paths of blocks",
        "Centres of some blocks, the first of release points evenly over the areas; with heights.",
        frame,
        {
            "area": FieldInfo("release area"),
            "scenario": FieldInfo("block scenario"),
            "end": FieldInfo("stopping reason"),
            "runout_m": FieldInfo("run-out chainage", "m"),
            "time_s": FieldInfo("duration", "s"),
            "mass_kg": FieldInfo("mass", "kg"),
            "max_energy_kj": FieldInfo("largest energy", "kJ"),
            "max_speed_mps": FieldInfo("largest speed", "m/s"),
            "max_height_m": FieldInfo("largest passing height", "m"),
        },
        style=VectorStyle(Symbol("line", "#d9480f", opacity=0.8, size_mm=0.3)),
    )


_STATISTICS = {
    "speed_mps": ("speed", "m/s"),
    "rotation_hz": ("rotation", "Hz"),
    "height_m": ("passing height", "m"),
    "energy_kj": ("kinetic energy", "kJ"),
    "mass_kg": ("mass", "kg"),
}
_OUTCOME_TEXT = {
    Outcome.STOPPED: "blocks stopped",
    Outcome.HELD_BY_NET: "blocks taken that then move on",
    Outcome.OVERTOPPED: "blocks over the top",
    Outcome.BROKE_THROUGH: "blocks that break through",
}


def _control_line_layer(run: MapRun, progress: Progress, barriers: bool) -> VectorLayer:
    rows = control_line_rows(progress.control_lines)
    chosen = [i for i, (g, _) in enumerate(run.control_lines) if (g.kind != "station") == barriers]
    template = ["name", "kind", "rocks"]
    if barriers:
        template += ["height_m", "capacity_kj", "hits", *(o.name.lower() for o in _OUTCOME_TEXT)]
    template += [f"{q}_{n}" for q in _STATISTICS for n in ("q50", "q95", "q99", "mean", "max")]
    floats = [c for c in template if c not in ("name", "kind", "rocks", "hits")]
    data: dict[str, object] = {}
    for column in template:
        values = [rows[i].get(column) for i in chosen]
        if column in ("rocks", "hits", *(o.name.lower() for o in _OUTCOME_TEXT)):
            data[column] = np.array(values, np.int64)
        elif column in floats:
            data[column] = np.array([np.nan if v is None else v for v in values], float)
        else:
            data[column] = values
    frame = gpd.GeoDataFrame(
        data,
        geometry=[shapely.LineString(run.control_lines[i][1]) for i in chosen],
        crs=run.grid.crs or None,
    )
    fields = {
        "name": FieldInfo("name"),
        "kind": FieldInfo("kind"),
        "rocks": FieldInfo("arriving blocks"),
    }
    if barriers:
        fields["height_m"] = FieldInfo("height above the ground", "m")
        fields["capacity_kj"] = FieldInfo("energy capacity", "kJ", "empty: unlimited")
        fields["hits"] = FieldInfo("blocks that hit it")
        fields |= {o.name.lower(): FieldInfo(text) for o, text in _OUTCOME_TEXT.items()}
    words = {"q50": "median", "q95": "95 %", "q99": "99 %", "mean": "mean", "max": "largest"}
    for quantity, (word, unit) in _STATISTICS.items():
        for name, text in words.items():
            fields[f"{quantity}_{name}"] = FieldInfo(f"{word}, {text}", unit)
    if barriers:
        return VectorLayer(
            "barriers",
            "Walls and nets",
            "Statistics at the first downhill arrival of each block, whether it hits or overtops.",
            frame,
            fields,
            style=BARRIER_STYLE,
        )
    return VectorLayer(
        "stations",
        "Stations",
        "Statistics of the first downhill passage of each block.",
        frame,
        fields,
        style=STATION_STYLE,
    )


def stations(run: MapRun, progress: Progress) -> VectorLayer:
    """Stations with the statistics of what passes."""
    return _control_line_layer(run, progress, barriers=False)


def barriers(run: MapRun, progress: Progress) -> VectorLayer:
    """Walls and nets with hits, what becomes of them, and the statistics for their design."""
    return _control_line_layer(run, progress, barriers=True)


def _footprint_label(level: float) -> str:
    return "reached by a block" if level == 0.0 else f"reach probability {100 * level:g} % or more"


def footprint(run: MapRun, layers: Sequence[RasterLayer]) -> VectorLayer:
    """Outline of the cells that blocks reach, and of higher reach probabilities."""
    reach = next(layer for layer in layers if layer.stem == "reach_probability")
    frame = footprints(reach.bands[0].values, run.grid, FOOTPRINT_LEVELS)
    frame.insert(
        0,
        "label",
        [_footprint_label(v) for v in frame["level"]],
    )
    frame["ref_width_m"] = run.grid.cell_size
    return VectorLayer(
        "footprint",
        "Footprint",
        f"Cells that blocks reach. Reference width {run.grid.cell_size:.4g} m (one cell).",
        frame,
        {
            "label": FieldInfo("what"),
            "level": FieldInfo("reach probability, at least", "1"),
            "area_m2": FieldInfo("area", "m²"),
            "ref_width_m": FieldInfo("reference width", "m"),
        },
        style=categorised_style(
            FOOTPRINT_STYLE.symbol,
            "label",
            {
                _footprint_label(level): (_footprint_label(level), colour)
                for level, colour in zip(FOOTPRINT_LEVELS, _FOOTPRINT_COLOUR, strict=True)
            },
        ),
    )


def all_layers(
    run: MapRun, planned: Plan, progress: Progress, layers: Sequence[RasterLayer]
) -> list[VectorLayer]:
    """The layers of ``result.gpkg``; ``layers`` are the maps of the blocks."""
    return [
        release_areas(run, planned),
        release_points(run, planned),
        fall_lines(run, planned, progress),
        stops(run, planned, progress),
        stations(run, progress),
        barriers(run, progress),
        footprint(run, layers),
    ]
