"""Figures and report of a run on the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import shapely
from matplotlib.figure import Figure

from sassgis.engine.event_log import trajectory
from sassgis.engine.simulate import simulate
from sassgis.hazard.control_lines import ControlLineSums, trimmed
from sassgis.io.read.config import Config
from sassgis.io.write.layers.run_vectors import LINE_END_TEXT, STOP_TEXT, control_line_rows
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray
from sassgis.model.profiles import TraceSet
from sassgis.model.results import RasterLayer, StopReason
from sassgis.report import figures
from sassgis.report.page import Cell, ReportContext, ReportFigure, ReportTable
from sassgis.runs.checkpoint import joined_lines
from sassgis.runs.map import (
    LEAD_IN_M,
    MapRun,
    Plan,
    Progress,
    control_line_crossings,
    line_draw_keys,
    trace_lines,
)
from sassgis.terrain.flatten import profiles
from sassgis.terrain.release import take
from sassgis.terrain.stretch import SHORTEST_LINE_M, take_lines, usable, with_lead_in

_LOG_EVENTS = 2000
_PATHS = 100


def release_outlines(run: MapRun) -> list[FloatArray]:
    """Coordinates of the release areas, for drawing."""
    outlines = []
    for area in run.areas:
        for part in shapely.get_parts(area.geometry):
            if isinstance(part, shapely.Polygon):
                outlines.append(shapely.get_coordinates(part.exterior))
            else:
                outlines.append(shapely.get_coordinates(part))
    return outlines


def _drawn_lines(progress: Progress) -> TraceSet:
    lines = joined_lines(progress.lines)
    n = lines.point.size
    return TraceSet(
        lines.offset, lines.x, lines.y, np.zeros_like(lines.x), np.arange(n), lines.fan, lines.end
    )


def furthest_line(progress: Progress) -> tuple[int, int, int] | None:
    """Line, block scenario and number of the rock that came furthest."""
    if progress.furthest is None:
        return None
    _, line, scenario, rock = progress.furthest
    return line, scenario, rock


def one_profile_figure(run: MapRun, planned: Plan, line: int, scenario: int, rock: int) -> Figure:
    """The profile of one line with the paths of its rocks, in the round of one of them."""
    round_ = rock // run.rocks_per_line
    point, member = divmod(line, run.lines_per_point)
    starts = take(planned.starts, np.array([point]))
    bundle = trace_lines(run, planned.surface, starts, round_)
    chosen = np.arange(len(bundle)) == member
    traces = take_lines(bundle, chosen)
    flat = profiles(run.grid, traces, run.ground, run.segment_tolerance_m)
    if not usable(traces, SHORTEST_LINE_M).all():
        raise InputError("this fall line is too short for a profile")
    ahead = with_lead_in(flat, LEAD_IN_M)
    blocks = run.blocks[scenario]
    crossings = control_line_crossings(run, traces)
    s, z = flat.vertices(0)
    keys = line_draw_keys(bundle, starts.key, run.lines_per_point, blocks.name)[chosen]
    result = simulate(
        ahead, run.table, blocks, run.engine, seed=run.seed,
        rocks_per_line=min(_PATHS, run.rocks_per_line), line_keys=keys,
        first_rock=round_ * run.rocks_per_line,
        starts=np.array([[0.0, min(2.0 * planned.moved[point], s[-1])]]), control_lines=crossings,
        log_events=_LOG_EVENTS, effects=run.effects, forest=run.forest,
    )  # fmt: skip
    paths = [trajectory(c, run.engine.gravity_mps2) for c in result.event_logs]
    ends = result.rocks["runout_m"]
    reach = s <= max(float(ends.max()) + 30.0, s[1])
    last = max(int(reach.sum()), 2)
    control_lines = [
        (crossings.control_lines[g], float(c), float(np.interp(c, s, z)))
        for c, g in zip(crossings.chainage, crossings.control_line, strict=True)
        if c <= s[last - 1]
    ]
    area = planned.points.area_names[planned.points.area[point]]
    return figures.profile_figure(
        s[:last], z[:last], paths, ground=flat.ground[:last].astype(np.int64),
        ground_names=run.table.names, control_lines=control_lines, stops=ends,
        title=f"Fall line of the rock that came furthest: {area}, {blocks.name}",
    )  # fmt: skip


def station_figures(control_lines: ControlLineSums, n: int) -> list[tuple[str, Figure]]:
    """A figure for each station or barrier to which rocks came."""
    out = []
    for i, control_line in enumerate(control_lines.control_lines):
        if not control_lines.arrivals(i):
            continue
        bins = [
            trimmed(control_lines.distribution(i, q).histogram)
            for q in ("speed_mps", "rotation_hz", "height_m")
        ]
        name = (
            control_line.name
            if control_line.kind == "station"
            else f"{control_line.name} ({control_line.kind})"
        )
        out.append(
            (control_line.name, figures.station_figure(name, bins[0], bins[1], bins[2], n=n))
        )
    return out


def runout_counts(progress: Progress, bins: int = 40) -> Figure:
    """Run-out by reason, in bins of whole metres."""
    width = max(-(-progress.runout.shape[1] // bins), 1)
    groups = -(-progress.runout.shape[1] // width)
    padded = np.zeros((progress.runout.shape[0], groups * width), np.int64)
    padded[:, : progress.runout.shape[1]] = progress.runout
    counts = padded.reshape(padded.shape[0], groups, width).sum(axis=2)
    edges = width * np.arange(groups + 1, dtype=float)
    return figures.runout_counts_figure(
        edges, {r: counts[r] for r in StopReason}, title="Run-out along the fall lines"
    )


def control_line_tables(control_lines: ControlLineSums) -> list[ReportTable]:
    """Statistics at stations and barriers, for the report."""
    rows = control_line_rows(control_lines)
    tables = []

    def number(value: object) -> Cell:
        return value if isinstance(value, (int, float, str)) else None

    stations = [r for r in rows if r["kind"] == "station"]
    columns: tuple[tuple[str, str], ...] = (
        ("station", ""), ("rocks", ""), ("speed, median", "m/s"), ("speed, 95 %", "m/s"),
        ("rotation, 95 %", "Hz"), ("height, 95 %", "m"), ("energy, median", "kJ"),
        ("energy, 95 %", "kJ"), ("energy, 99 %", "kJ"),
    )  # fmt: skip
    keys = (
        "name", "rocks", "speed_mps_q50", "speed_mps_q95", "rotation_hz_q95", "height_m_q95",
        "energy_kj_q50", "energy_kj_q95", "energy_kj_q99",
    )  # fmt: skip
    if stations:
        tables.append(
            ReportTable(
                "Stations",
                columns,
                tuple(tuple(number(r[k]) for k in keys) for r in stations),
                "First downhill passage of each rock.",
            )
        )
    barriers = [r for r in rows if r["kind"] != "station"]
    if barriers:
        tables.append(
            ReportTable(
                "Walls and nets",
                (
                    ("barrier", ""), ("kind", ""), ("rocks that come", ""), ("hits", ""),
                    ("stopped", ""), ("taken, then move on", ""), ("over the top", ""),
                    ("break through", ""), ("energy, 95 %", "kJ"), ("energy, 99 %", "kJ"),
                    ("height, 95 %", "m"), ("height, 99 %", "m"),
                ),
                tuple(
                    tuple(
                        number(r[k])
                        for k in (
                            "name", "kind", "rocks", "hits", "stopped", "held_by_net",
                            "overtopped", "broke_through", "energy_kj_q95", "energy_kj_q99",
                            "height_m_q95", "height_m_q99",
                        )
                    )
                    for r in barriers
                ),
                "Energy (translation + rotation) and passing height of all rocks at their first "
                "arrival, also of those that pass over.",
            )
        )  # fmt: skip
    return tables


def save_figure(folder: Path, name: str, figure: Figure) -> bytes:
    """Save a figure as ``<name>.png`` and return its bytes."""
    png = figures.to_png(figure)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.png").write_bytes(png)
    return png


def file_stem(name: str) -> str:
    """A name as part of a file name."""
    return "".join(c if c.isalnum() else "_" for c in name).strip("_").lower() or "unnamed"


def file_stems(names: Sequence[str]) -> list[str]:
    """Names as parts of file names, no two the same."""
    taken: set[str] = set()
    stems = []
    for name in names:
        stem = base = file_stem(name)
        number = 1
        while stem in taken:
            number += 1
            stem = f"{base}_{number}"
        taken.add(stem)
        stems.append(stem)
    return stems


def map_report(
    config: Config,
    run: MapRun,
    planned: Plan,
    progress: Progress,
    layers: tuple[RasterLayer, ...],
    warnings: list[str],
    facts: Mapping[str, object],
    folder: Path,
) -> ReportContext:
    """Draw the figures of a run into ``folder`` and put the report together."""
    outlines = release_outlines(run)
    control_lines: list[tuple[str, str, FloatArray]] = [
        (g.name, g.kind, c) for g, c in run.control_lines
    ]
    by_stem = {layer.stem: layer for layer in layers}
    total = int(progress.reasons.sum())
    pictures = []
    anything = bool(progress.sums.cells.size)
    if anything:
        for stem in ("energy", "reach_probability", "passing_height", "stops"):
            layer = by_stem[stem]
            figure = figures.map_figure(
                run.grid, layer, release=outlines, control_lines=control_lines,
                lines=_drawn_lines(progress) if stem == "stops" else None,
            )  # fmt: skip
            png = save_figure(folder, f"map_{stem}", figure)
            pictures.append(ReportFigure(layer.title, layer.note, png))
        chosen = furthest_line(progress)
        if chosen is not None:
            figure = one_profile_figure(run, planned, *chosen)
            pictures.append(
                ReportFigure(
                    "A fall line with the paths of its rocks",
                    "Flattened into one vertical plane. Walls and nets at their true height.",
                    save_figure(folder, "profile_furthest", figure),
                )
            )
        pictures.append(
            ReportFigure(
                "Run-out",
                "Chainage in plan along the fall line at which rocks end, by the reason.",
                save_figure(folder, "runout", runout_counts(progress)),
            )
        )
    drawn = station_figures(progress.control_lines, total)
    for (name, figure), stem in zip(drawn, file_stems([n for n, _ in drawn]), strict=True):
        pictures.append(
            ReportFigure(
                f"At {name}",
                "First downhill passage of each rock.",
                save_figure(folder, f"station_{stem}", figure),
            )
        )
    blocks = ReportTable(
        "Block scenarios",
        (
            ("scenario", ""), ("semi-axis 1", "m"), ("semi-axis 2", "m"), ("semi-axis 3", "m"),
            ("density", "kg/m³"), ("initial speed", "m/s"),
        ),
        tuple(
            (
                b.name,
                *(
                    f"{low:g} to {high:g}" if high > low else f"{low:g}"
                    for low, high in (
                        b.axis_1_m, b.axis_2_m, b.axis_3_m, b.density_kgm3, b.speed_mps
                    )
                ),
            )
            for b in run.blocks
        ),
    )  # fmt: skip
    used = np.unique(run.ground[np.isfinite(run.grid.values)])
    ground = ReportTable(
        "Ground classes",
        (("class", ""), ("η max", ""), ("Δp/p", ""), ("μ_f", ""), ("μ_0", ""), ("k", ""),
         ("d*", "m"), ("η max, Δp from the paper", ""), ("source", "")),
        tuple(
            (c.name, c.eta_max, f"{c.dp_min:g} to {c.dp_max:g}", c.mu_f, c.mu_0, c.k, c.d_star_m,
             "yes" if c.verified else "no", c.source)
            for c in (run.table.classes[i] for i in used)
        ),
    )  # fmt: skip
    ends = ReportTable(
        "How rocks end",
        (("reason", ""), ("rocks", ""), ("share", "%")),
        tuple(
            (
                STOP_TEXT[r],
                int(progress.reasons[r]),
                100.0 * int(progress.reasons[r]) / max(total, 1),
            )
            for r in StopReason
        ),
    )
    lines = joined_lines(progress.lines)
    line_ends = ReportTable(
        "How fall lines end",
        (("reason", ""), ("lines", "")),
        tuple((text, int((lines.end == e).sum())) for e, text in LINE_END_TEXT.items()),
    )
    return ReportContext(
        title=config.project.name,
        subtitle="Rockfall simulation with the SASS model (Bozzolo and Pamini, 1986)",
        what_was_run=(
            ("Terrain", f"{config.dem_path.name}, {run.grid.shape[1]} × {run.grid.shape[0]} cells "
             f"of {run.grid.cell_size:.4g} m"),
            ("Coordinate system", str(facts["crs"])),
            ("Heights", str(facts["vertical_datum"])),
            ("Release areas", ", ".join(a.name for a in run.areas)),
            ("Release points", len(planned.points)),
            ("Rocks", total),
            ("Lateral spread", run.lateral_spread),
            ("Effects beyond the model of 1986", ", ".join(run.effects.names) or "none"),
            ("Reference width of the reach probability", f"{run.grid.cell_size:.4g} m (one cell)"),
            ("Smoothing of the terrain for fall lines", f"{run.fall_lines.smoothing_m:g} m"),
            ("Segments within", f"{run.segment_tolerance_m:g} m of the terrain, vertically"),
        ),
        warnings=tuple(warnings),
        key_results=ends,
        figures=tuple(pictures),
        tables=(*control_line_tables(progress.control_lines), blocks, ground, line_ends),
        provenance=(
            ("Program", str(facts["program"])),
            ("Seed", run.seed),
            ("Settings and inputs (SHA-256)", str(facts["settings_hash"])),
            ("Configuration", config.file.name),
        ),
    )  # fmt: skip
