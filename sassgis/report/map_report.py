"""Figures and report of a run on the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import shapely
from matplotlib.figure import Figure

from sassgis.hazard.along_profile import LinePaths
from sassgis.hazard.control_lines import ControlLineSums, control_line_rows, trimmed
from sassgis.hazard.progress import Progress, joined_lines
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.labels import LINE_END_TEXT, STOP_TEXT, file_stems
from sassgis.model.map_run import MapRun
from sassgis.model.noted_files import noted
from sassgis.model.profiles import TraceSet
from sassgis.model.results import RasterLayer, StopReason
from sassgis.report import figures
from sassgis.report.alt_text import map_alt, path_alt, station_alt
from sassgis.report.figures.map_marks import MapObject
from sassgis.report.page import Cell, ReportContext, ReportFigure, ReportTable
from sassgis.report.run_summary import runout_words
from sassgis.terrain.plan import Plan


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
    return TraceSet(lines.offset, lines.x, lines.y, np.zeros_like(lines.x), np.arange(n), lines.end)


def line_figure(shown: LinePaths) -> Figure:
    """The profile of one line with the paths of its blocks."""
    s, z = shown.s, shown.z
    reach = s <= max(float(shown.stops.max()) + 30.0, s[1])
    last = max(int(reach.sum()), 2)
    control_lines = [
        (line, chainage, float(np.interp(chainage, s, z)))
        for line, chainage in shown.control_lines
        if chainage <= s[last - 1]
    ]
    return figures.profile_figure(
        s[:last], z[:last], shown.paths, ground=shown.ground[:last],
        ground_names=shown.ground_names, control_lines=control_lines, stops=shown.stops,
        title=f"Path of the block with the longest run-out: {shown.area}, {shown.scenario}",
    )  # fmt: skip


def station_figures(control_lines: ControlLineSums, n: int) -> list[tuple[str, Figure]]:
    """A figure for each station or barrier that blocks reach."""
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
        edges, {r: counts[r] for r in StopReason}, title="Run-out along the paths"
    )


def stopping_reasons(counts: IntArray) -> ReportTable:
    """How many blocks stop for which reason; ``counts`` by StopReason."""
    total = max(int(counts.sum()), 1)
    return ReportTable(
        "Stopping reasons",
        (("reason", ""), ("blocks", ""), ("share", "%")),
        tuple((STOP_TEXT[r], int(counts[r]), 100.0 * int(counts[r]) / total) for r in StopReason),
    )


def control_line_tables(control_lines: ControlLineSums) -> list[ReportTable]:
    """Statistics at stations and barriers, for the report."""
    rows = control_line_rows(control_lines)
    tables = []

    def number(value: object) -> Cell:
        return value if isinstance(value, (int, float, str)) else None

    stations = [r for r in rows if r["kind"] == "station"]
    columns: tuple[tuple[str, str], ...] = (
        ("station", ""), ("blocks", ""), ("speed, median", "m/s"), ("speed, 95 %", "m/s"),
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
                "First downhill passage of each block.",
            )
        )
    barriers = [r for r in rows if r["kind"] != "station"]
    if barriers:
        tables.append(
            ReportTable(
                "Walls and nets",
                (
                    ("barrier", ""), ("kind", ""), ("arriving blocks", ""), ("hits", ""),
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
                "Energy (translation + rotation) and passing height of all blocks at their first "
                "arrival, also of those that pass over.",
            )
        )  # fmt: skip
    return tables


def save_figure(folder: Path, name: str, figure: Figure) -> bytes:
    """Save a figure as ``<name>.png`` and return its bytes."""
    png = figures.to_png(figure)
    folder.mkdir(parents=True, exist_ok=True)
    noted(folder / f"{name}.png").write_bytes(png)
    return png


def _block_table(run: MapRun) -> ReportTable:
    return ReportTable(
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


def _ground_table(run: MapRun) -> ReportTable:
    """The ground classes on the map."""
    used = np.unique(run.ground[np.isfinite(run.grid.values)])
    return ReportTable(
        "Ground classes",
        (("class", ""), ("η max", ""), ("Δp/p", ""), ("μ_f", ""), ("μ_0", ""), ("k", ""),
         ("d*", "m"), ("e", ""), ("v of e/2", "m/s"), ("rolling threshold", ""),
         ("η max, Δp from the paper", ""), ("source", "")),
        tuple(
            (c.name, c.eta_max, f"{c.dp_min:g} to {c.dp_max:g}", c.mu_f, c.mu_0, c.k, c.d_star_m,
             c.restitution, c.restitution_speed_mps, c.rolling_threshold,
             "yes" if c.verified else "no", c.source)
            for c in (run.table.classes[i] for i in used)
        ),
    )  # fmt: skip


def _block_scale(run: MapRun) -> str:
    """In words: what of the terrain blocks do not meet."""
    if run.heights is run.grid:
        return "none: cells are not finer than the blocks"
    return f"what is smaller than {run.block_scale_m:.3g} m (terrain.block_scale_m)"


def map_report(
    run: MapRun,
    planned: Plan,
    progress: Progress,
    layers: tuple[RasterLayer, ...],
    furthest: LinePaths | None,
    warnings: Sequence[str],
    facts: Mapping[str, object],
    folder: Path,
    objects: Sequence[MapObject] = (),
) -> ReportContext:
    """Draw the figures of a run into ``folder`` and put the report together.

    Parameters
    ----------
    run, planned, progress
    layers : tuple of RasterLayer
        Maps of what was simulated.
    furthest : LinePaths or None
        Paths on the line of the block with the longest run-out.
    warnings : sequence of str
    facts : mapping of str to object
        As in the GeoPackage, the names "terrain_file" and "config_file", and "tolerance_check" if
        there was one.
    folder : Path
    objects : sequence of (name, geometry)
        Exposed objects, drawn on the maps.
    """
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
                lines=_drawn_lines(progress) if stem == "stops" else None, objects=objects,
            )  # fmt: skip
            png = save_figure(folder, f"map_{stem}", figure)
            pictures.append(ReportFigure(layer.title, layer.note, png, map_alt(run.grid, layer)))
        if furthest is not None:
            figure = line_figure(furthest)
            pictures.append(
                ReportFigure(
                    "A path of blocks and the terrain under it",
                    "Flattened into one vertical plane. Walls and nets at their true height.",
                    save_figure(folder, "profile_furthest", figure),
                    path_alt(furthest),
                )
            )
        pictures.append(
            ReportFigure(
                "Run-out",
                "Chainage in plan along the path at which blocks stop, by stopping reason.",
                save_figure(folder, "runout", runout_counts(progress)),
                f"Histogram: {runout_words(progress.runout.sum(axis=0))}.",
            )
        )
    rows = {str(row["name"]): row for row in control_line_rows(progress.control_lines)}
    drawn = station_figures(progress.control_lines, total)
    for (name, figure), stem in zip(drawn, file_stems([n for n, _ in drawn]), strict=True):
        pictures.append(
            ReportFigure(
                f"At {name}",
                "First downhill passage of each block.",
                save_figure(folder, f"station_{stem}", figure),
                station_alt(rows[name]),
            )
        )
    ends = stopping_reasons(progress.reasons)
    lines = joined_lines(progress.lines)
    line_ends = ReportTable(
        "How fall lines end",
        (("reason", ""), ("lines", "")),
        tuple((text, int((lines.end == e).sum())) for e, text in LINE_END_TEXT.items()),
    )
    return ReportContext(
        title=str(facts["title"]),
        subtitle="Rockfall simulation with the SASS model (Bozzolo and Pamini, 1986)",
        what_was_run=(
            ("Terrain", f"{facts['terrain_file']}, {run.grid.shape[1]} × {run.grid.shape[0]} cells "
             f"of {run.grid.cell_size:.4g} m"),
            ("Coordinate system", str(facts["crs"])),
            ("Heights", str(facts["vertical_datum"])),
            ("Release areas", ", ".join(a.name for a in run.areas)),
            ("Release points", len(planned.points)),
            ("Simulated blocks", total),
            ("Paths", run.path_words),
            ("Lateral spread", run.lateral_spread),
            ("Effects beyond the model of 1986", ", ".join(run.effects.names) or "none"),
            ("Reference width of the reach probability", f"{run.grid.cell_size:.4g} m (one cell)"),
            ("Smoothing of the terrain for the drawn fall lines" if run.followed
             else "Smoothing of the terrain for fall lines", f"{run.fall_lines.smoothing_m:g} m"),
            ("Terrain that counts as roughness", _block_scale(run)),
            ("Segments within", f"{run.segment_tolerance_m:g} m of the terrain, vertically"),
            *((("A sample at other tolerances", str(facts["tolerance_check"])),)
              if "tolerance_check" in facts else ()),
        ),
        warnings=tuple(warnings),
        key_results=ends,
        figures=tuple(pictures),
        tables=(*control_line_tables(progress.control_lines), _block_table(run), _ground_table(run),
                line_ends),
        provenance=(
            ("Program", str(facts["program"])),
            ("Seed", str(run.seed)),
            ("Settings and inputs (SHA-256)", str(facts["settings_hash"])),
            ("Configuration", str(facts["config_file"])),
        ),
    )  # fmt: skip
