"""Figures and reports of runs on the map and along a profile, and their answer in a few lines."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from matplotlib.figure import Figure

from sassgis.grid import FloatArray, IntArray
from sassgis.hazard.assess import Assessment
from sassgis.hazard.risk import total_rows
from sassgis.hazard.sources import ReachAngles, stated_angles
from sassgis.hazard.warnings import ground_shares, sample_words
from sassgis.report import figures
from sassgis.report.figures.map_marks import MapObject
from sassgis.report.page import Cell, ReportContext, ReportFigure, ReportTable, sensible, table_of
from sassgis.report.pictures import map_alt, map_drawn, path_alt, picture, station_alt
from sassgis.settings.ground import TRUST_TEXT
from sassgis.settings.hazard_rules import HazardPreset
from sassgis.settings.languages import counted, joined, named, phrase
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import (
    HALTED,
    LINE_END_TEXT,
    STILL_MOVING,
    STOP_TEXT,
    RasterLayer,
    StopReason,
    file_stems,
    ground_name,
    thousands,
)
from sassgis.settings.statistics_table import FEW_BLOCKS
from sassgis.simulation.accumulators import Progress, joined_lines, within_metres
from sassgis.simulation.control_lines import ControlLineSums, LineParts, control_line_rows, trimmed
from sassgis.simulation.path_sample import STRETCH_M, LinePaths, ProfileResult
from sassgis.terrain.prepare import Plan

Lines = tuple[tuple[str, str], ...]


def runout_words(counts: IntArray, text: str) -> str:
    """Put the run-out of blocks, counted in bins of 1 m, into a text; empty for none."""
    if not counts.sum():
        return ""
    return phrase(text, *(sensible(metres) for metres in within_metres(counts, 0.5, 0.95, 1.0)))


#: Where more of the blocks leave the terrain, they change the 95 % run-out.
_MANY_LEFT = 0.05


def _with_pieces(words: str, pieces: int) -> str:
    """Add to the run-out of released blocks that others are not in it."""
    text = "{}. Without {} fragments and entrained blocks, which may go farther."
    return phrase(text, words, thousands(pieces)) if pieces else words


def run_lines(progress: Progress, angles: ReachAngles) -> Lines:
    """State run-out of started blocks, and the angles under which their stops are seen."""
    text = "median {} m, 95 % of the blocks within {} m, longest {} m (along the path, in plan)"
    words = runout_words(progress.started_runout, text)
    if progress.lost_share > _MANY_LEFT:
        text = "{}. {} % of the blocks left the terrain: their run-outs are longer."
        words = phrase(text, words, f"{100.0 * progress.lost_share:.0f}")
    lines = [("Run-out", _with_pieces(words, progress.pieces))] if words else []
    for name, values, text in (
        (
            "Reach angle",
            angles.reach_deg,
            "99 % of the blocks above {}, 95 % above {}, median {}, seen from the release point",
        ),
        (
            "Shadow angle",
            angles.shadow_deg,
            "99 % of the blocks above {}, 95 % above {}, median {}, seen from the foot of the "
            "cliff",
        ),
    ):
        if (stated := stated_angles(values)).size:
            lines.append((name, phrase(text, *(f"{angle:.1f}°" for angle in stated))))
    return tuple(lines)


def profile_lines(result: ProfileResult) -> Lines:
    """State where the blocks of a profile stop, and what passes its stations and barriers."""
    # Of released blocks that started; one that a barrier stops has not come beyond it.
    started = result.rocks["reason"] != StopReason.NEVER_STARTED
    bins = np.maximum(np.ceil(result.rocks["runout_m"][started]) - 1.0, 0.0).astype(np.int64)
    text = "median {} m, 95 % of the blocks within {} m, longest {} m (chainage)"
    words = runout_words(np.bincount(bins), text)
    moving = np.isin(result.rocks["reason"], STILL_MOVING)
    if moving.any():
        text = "{}. {} of {} blocks were still moving there: their run-outs are longer."
        words = phrase(text, words, int(moving.sum()), int(started.sum()))
    lines = [("Run-out", _with_pieces(words, result.pieces.size))] if words else []
    for k, (line, _) in enumerate(result.profile.control_lines):
        energy = result.control_lines.distribution(k, "energy_kj")
        of = (energy.count, result.rocks.size + result.pieces.size)
        arrive = phrase("{} of {} blocks arrive", *of)
        if energy.count:
            (most,) = energy.quantile(0.95)
            text = "{} of {} blocks arrive; energy: 95 % of them below {} kJ"
            arrive = phrase(text, *of, sensible(most))
        lines.append((line.described, arrive))
    return tuple(lines)


def object_lines(exposed: ReportTable) -> Lines:
    """State how many of all exposed objects blocks reach, and which with the most energy."""
    if not exposed.rows:
        return ()
    reached = [row for row in exposed.rows if row[-2] is not None or row[-1] is not None]
    words = phrase("blocks reach {} of {} objects", len(reached), len(exposed.rows))
    if reached and reached[0][-2] is not None:
        (what, unit), of = exposed.columns[-2], (len(reached), len(exposed.rows))
        text = "blocks reach {} of {} objects; largest value at {}: {} {} {}"
        words = phrase(text, *of, reached[0][0], phrase(what), reached[0][-2], unit)
    return (("Energy at exposed objects", words),)


def zone_lines(
    preset: HazardPreset,
    levels: ReportTable,
    found: Assessment,
    edge: str,
    confidence: float,
    currency: str,
) -> Lines:
    """State the area of the zones by level, the risk of all objects, and how sure they are."""
    areas = [phrase("{} {} m²", phrase(str(row[0])), sensible(row[2])) for row in levels.rows]
    hazard = found.hazard
    text = (
        "{} The area of the hatched cells is {} % of the zoned area. They hold {} % of these "
        "changes."
    )
    shares = (f"{100 * share:.3g}" for share in (hazard.uncertain_share, confidence))
    sample = phrase(text, sample_words(hazard.chances, preset), *shares)
    lines: list[tuple[str, str]] = [("Hazard zones", joined("; ", areas))]
    if found.risk is not None:
        total = total_rows(found.risk)[-1]
        text = "loss {} {}/year; deaths {} per year; largest individual risk {} per year"
        loss, deaths = (sensible(total[f"{name}_per_year"]) for name in ("loss", "deaths"))
        largest = sensible(total["individual_risk_largest_per_year"])
        risk = phrase(text, loss, currency, deaths, largest)
        lines.append(("Risk of all exposed objects", risk))
    lines.append(("Sampling error", sample))
    if edge:
        lines.append(("Edge of the terrain model", edge))
    if hazard.edits:
        changed = sum(a.has_changed for a in hazard.edits)
        text = "places: {}; of these with a changed computed level: {}"
        lines.append(("Edited by hand", phrase(text, len(hazard.edits), changed)))
    return tuple(lines)


def release_outlines(run: MapRun) -> list[FloatArray]:
    """Return coordinates of the release areas, for drawing."""
    parts = [part for area in run.areas for part in shapely.get_parts(area.geometry)]
    return [
        shapely.get_coordinates(p.exterior if isinstance(p, shapely.Polygon) else p) for p in parts
    ]


def map_marks(run: MapRun, objects: Sequence[MapObject]) -> figures.MapMarks:
    """Return release areas, control lines and exposed objects, for drawing."""
    control_lines = [(line.name, line.kind, trace) for line, trace in run.control_lines]
    return figures.MapMarks(release_outlines(run), control_lines=control_lines, objects=objects)


def line_figure(shown: LinePaths) -> Callable[[], Figure]:
    """Return what draws the profile of one line with the paths of its blocks."""
    s, z = shown.s, shown.z
    reach = s <= max(float(shown.stops.max()) + 30.0, s[1])
    last = max(int(reach.sum()), 2)
    panel = figures.ProfilePanel(
        s[:last],
        z[:last],
        shown.paths,
        ground=shown.ground[:last],
        ground_names=[ground_name(name) for name in shown.ground_names],
        control_lines=[
            (line, chainage, float(np.interp(chainage, s, z)))
            for line, chainage in shown.control_lines
            if chainage <= s[last - 1]
        ],
        stops=shown.stops,
        title=phrase(
            "Path of the block with the longest run-out: {}, {}", shown.area, shown.scenario
        ),
    )
    return partial(figures.profile_figure, [panel])


def station_figures(
    control_lines: ControlLineSums,
    n: int,
    pieces: bool,
    folder: Path,
    caption: str,
    alts: Mapping[str, str],
) -> list[ReportFigure]:
    """Draw a figure for each station or barrier that blocks reach; ``alts`` by its name."""
    lines = control_lines.control_lines
    reached = [i for i in range(len(lines)) if control_lines.arrivals(i)]
    out = []
    for i, stem in zip(reached, file_stems([lines[i].name for i in reached]), strict=True):
        bins = [
            trimmed(control_lines.distribution(i, q).histogram)
            for q in ("speed_mps", "rotation_hz", "height_m", "energy_kj")
        ]
        name, kind = lines[i].name, lines[i].kind
        title = named(name) if kind == "station" else phrase("{} ({})", name, phrase(kind))
        figure = partial(figures.station_figure, title, *bins, n=n, pieces=pieces)
        title, alt = phrase("Arriving blocks: {}", name), alts.get(name, "")
        out.append(picture(folder, f"station_{stem}", title, caption, figure, alt))
    return out


def runout_drawn(progress: Progress) -> Callable[[], Figure]:
    """Return what draws run-out by reason, from counts by whole metres."""
    edges = np.arange(progress.runout.shape[1] + 1, dtype=float)
    counts = {r: progress.runout[r] for r in StopReason}
    return partial(figures.runout_figure, edges, counts, title="Run-out along the paths")


def stopping_reasons(counts: IntArray) -> ReportTable:
    """Tabulate how many blocks stop for which reason; ``counts`` by StopReason."""
    total = max(int(counts.sum()), 1)
    return table_of(
        "Reasons for stopping",
        "reason; blocks; share | %",
        ((STOP_TEXT[r], int(counts[r]), 100.0 * int(counts[r]) / total) for r in StopReason),
    )


_FIRST_PASSAGES = (
    "First downhill passage of each block, fragment and entrained block, with all barriers of the "
    "configuration."
)
#: Of stations, barriers and galleries: title, columns, their keys in the rows, and note.
_CONTROL_LINE_TABLES = (
    (
        "Stations",
        "station; blocks; speed, median | m/s; speed, 95 % | m/s; rotation, 95 % | Hz; "
        "height, 95 % | m; energy, median | kJ; energy, 95 % | kJ; energy, 99 % | kJ",
        "name rocks speed_mps_q50 speed_mps_q95 rotation_hz_q95 height_m_q95 energy_kj_q50 "
        "energy_kj_q95 energy_kj_q99",
        _FIRST_PASSAGES,
    ),
    (
        "Barriers",
        "barrier; kind; arriving blocks; hits; stopped; caught, then moving again; over the top; "
        "break through; energy, 95 % | kJ; energy, 99 % | kJ; height, 95 % | m; height, 99 % | m",
        "name kind rocks hits stopped held_by_net overtopped broke_through energy_kj_q95 "
        "energy_kj_q99 height_m_q95 height_m_q99",
        "Energy (translation + rotation) and passing height of all blocks at their first "
        "arrival, including those that pass over.",
    ),
    (
        "Roofs of galleries",
        "gallery; arriving blocks; stopped at the uphill side; on the roof; over the whole width; "
        "force, 95 % | kN; force, 99 % | kN; force, largest | kN",
        "name rocks stopped on_roof overtopped force_kn_q95 force_kn_q99 force_kn_max",
        "Static equivalent force of Labiouse, Descoeudres and Montani (1996) of the blocks that "
        "land on the roof, at their first arrival. The formula was not checked against the text.",
    ),
)
#: Kinds of lines of which a table holds rows.
_KINDS = {
    "Stations": ("station",), "Barriers": ("wall", "net", "gallery"),
    "Roofs of galleries": ("gallery",),
}  # fmt: skip


def control_line_tables(control_lines: ControlLineSums, parts: LineParts = ()) -> list[ReportTable]:
    """Return statistics at stations and barriers, for the report."""
    tables = []
    for title, columns, keys, note in _CONTROL_LINE_TABLES:
        if parts:
            more = phrase("Onset frequencies weight the blocks in all values.")
            note = joined(" ", (phrase(note), more))
        rows = [
            [row[key] for key in keys.split()]
            for row in control_line_rows(control_lines, parts)
            if row["kind"] in _KINDS[title]
        ]
        if rows:
            tables.append(table_of(title, columns, rows, note))
    return tables


def _span(low: float, high: float) -> str:
    one, other = (f"{x:.3g}" if abs(x) < 1000.0 else thousands(x) for x in (low, high))
    return phrase("{} to {}", one, other) if high > low else one


def _block_table(run: MapRun) -> ReportTable:
    return table_of(
        "Block scenarios",
        "scenario; volume | m³; mass | kg; length | m; width | m; height | m; "
        "density | kg/m³; initial speed | m/s",
        (
            (b.name, _span(*b.volume_limits_m3), _span(*b.mass_limits_kg),
             *(_span(*limits) for limits in b.size_limits_m), _span(*b.density_kgm3),
             _span(*b.speed_mps))
            for b in run.released_blocks
        ),
        "Blocks are ellipsoids. Where volumes are given, lengths are those of the mean shape.",
    )  # fmt: skip


def _ground_table(run: MapRun, reached: IntArray) -> ReportTable:
    """Return the ground classes of the cells that blocks reach."""
    return table_of(
        "Ground classes",
        "class; η max; Δp/p; μ_f; μ_0; k; d* | m; e; speed at e/2 | m/s; rolling threshold; "
        "μ_v; trust; share of the ground that blocks reach | %",
        (
            (ground_name(c.name), c.eta_max, _span(c.dp_min, c.dp_max), c.mu_f, c.mu_0, c.k,
             c.d_star_m, c.restitution, c.restitution_speed_mps, c.rolling_threshold, c.mu_v,
             TRUST_TEXT[c.trust], f"{100 * share:.0f}")
            for c, share in ground_shares(run, reached)
        ),
        "sassgis validate lists the sources of these values.",
    )  # fmt: skip


def passing_figures(progress: Progress, folder: Path) -> list[ReportFigure]:
    """Draw what passes each station and barrier that blocks reach."""
    total = int(progress.reasons.sum())
    alts = {row["name"]: station_alt(row) for row in control_line_rows(progress.control_lines)}
    return station_figures(
        progress.control_lines, total, progress.pieces > 0, folder, _FIRST_PASSAGES, alts
    )


def block_pictures(
    run: MapRun,
    progress: Progress,
    layers: Sequence[RasterLayer],
    furthest: LinePaths | None,
    objects: Sequence[MapObject],
    folder: Path,
) -> list[ReportFigure]:
    """Draw the maps, a profile and the run-out; some cell is reached.

    ``furthest`` are the paths on the line of the block with the longest run-out.
    """
    by_stem = {layer.stem: layer for layer in layers}
    marks = map_marks(run, objects)
    pictures = []
    for stem in ("energy", "reach_probability", "passing_height", "stops"):
        layer = by_stem[stem]
        if stem == "stops" and not run.followed:
            lines = joined_lines(progress.lines)
            xy = np.column_stack([lines.x, lines.y])
            marks = replace(marks, lines=[xy[a:b] for a, b in pairwise(lines.offset)])
        figure: Callable[[], Figure] = map_drawn(run.grid, layer, marks)
        alt = map_alt(run.grid, layer)
        caption = layer.note
        if stem in ("energy", "passing_height"):
            few = float((progress.sums.column("reach") < FEW_BLOCKS).mean())
            text = "Fewer than {} blocks arrive in {} % of the reached cells."
            caption = joined(" ", (caption, phrase(text, FEW_BLOCKS, f"{100 * few:.0f}")))
        pictures.append(picture(folder, f"map_{stem}", layer.title, caption, figure, alt))
    if furthest is not None:
        title = "Paths of blocks above the terrain"
        caption = "Paths unrolled into one vertical plane. Barriers are drawn at their true height."
        figure, alt = line_figure(furthest), path_alt(furthest)
        pictures.append(picture(folder, "profile_furthest", title, caption, figure, alt))
    caption = "Distance in plan along the path at which blocks stop, by reason."
    text = "Histogram: median {} m, 95 % of the blocks within {} m, longest {} m."
    alt = runout_words(progress.started_runout, text)
    pictures.append(picture(folder, "runout", "Run-out", caption, runout_drawn(progress), alt))
    return pictures


def _blocks_words(run: MapRun, planned: Plan, progress: Progress) -> str:
    """State how many blocks were simulated, and how they are shared among release points."""
    repetitions = planned.repetitions or (run.repetitions,)
    least, most = min(repetitions), max(repetitions)
    times = f"{most}" if least == most else phrase("{} to {}", least, most)
    one = "{} repetition, {} blocks per release point"
    more = "{} repetitions, {} blocks per release point in each"
    words = counted(most, one, more, times, run.release.rocks_per_point)
    if progress.simulated < progress.reasons.sum():
        text = (
            "{}; down to an eighth of them at release points that hardly reach uncertain cells, "
            "where each block counts up to 8 times"
        )
        words = phrase(text, words)
    if progress.simulated < progress.reasons.sum():
        text = "{} (weighted to {} in the tables): {}"
        return phrase(text, *map(thousands, (progress.simulated, progress.reasons.sum())), words)
    return phrase("{}: {}", thousands(progress.simulated), words)


def map_report(
    run: MapRun,
    planned: Plan,
    progress: Progress,
    warnings: Sequence[str],
    facts: Mapping[str, object],
    pictures: Sequence[ReportFigure],
    parts: LineParts = (),
) -> ReportContext:
    """Put the report of a run together.

    The facts are those of the GeoPackage, the name "terrain_file", and "tolerance_check" if there
    was one.
    """
    ends = joined_lines(progress.lines).end
    line_ends = table_of(
        "Ends of fall lines",
        "reason; lines",
        ((text, int((ends == e).sum())) for e, text in LINE_END_TEXT.items()),
    )
    roughness = "none: cells are at least as large as the blocks"
    if run.heights is not run.grid:
        text = "features smaller than {} m (terrain.block_scale_m)"
        roughness = phrase(text, f"{run.block_scale_m:.3g}")
    cell = f"{run.grid.cell_size:.4g}"
    n_rows, n_cols = run.grid.shape
    smoothing = "Smoothing of the terrain for fall lines"
    if run.followed:
        smoothing = "Smoothing of the terrain for the drawn fall lines"
    checked = facts.get("tolerance_check")
    return ReportContext(
        title=str(facts["title"]),
        subtitle="Rockfall simulation with the SASS model (Bozzolo and Pamini, 1986)",
        what_was_run=(
            ("Terrain",
             phrase("{}, {} × {} cells of {} m", facts["terrain_file"], n_cols, n_rows, cell)),
            ("Coordinate system", str(facts["crs"])),
            ("Height system", str(facts["vertical_datum"])),
            ("Release areas", ", ".join(a.name for a in run.areas)),
            ("Release points", len(planned.points)),
            ("Simulated blocks", _blocks_words(run, planned, progress)),
            ("Paths", run.path_words),
            ("Lateral spread", run.lateral_spread),
            ("Effects beyond the model of 1986", ", ".join(run.effects.names) or "none"),
            ("Reference width of the reach probability", phrase("{} m (one cell)", cell)),
            (smoothing, f"{run.terrain.smoothing_m:g} m"),
            ("Terrain treated as roughness", roughness),
            ("Largest vertical gap between terrain and segments",
             f"{run.terrain.segment_tolerance_m:g} m"),
            *((("Change of the results at half and double this gap", str(checked)),)
              * (checked is not None)),
        ),
        warnings=tuple(warnings),
        key_results=stopping_reasons(progress.reasons),
        figures=tuple(pictures),
        tables=(*control_line_tables(progress.control_lines, parts), _block_table(run),
                _ground_table(run, progress.sums.cells), line_ends),
    )  # fmt: skip


def profile_panel(result: ProfileResult, title: str = "") -> figures.ProfilePanel:
    """Return the slope with trajectories, control lines and stops, for one or several panels."""
    p = result.profile
    ended = np.concatenate([result.rocks, result.pieces])
    drawn = (ended["rock"] < result.drawn) & np.isin(ended["reason"], HALTED)
    return figures.ProfilePanel(
        s=p.s,
        z=p.z,
        trajectories=list(result.paths),
        ground=p.ground.astype(np.int64),
        ground_names=[ground_name(name) for name in p.table.names],
        control_lines=[(g, c, float(np.interp(c, p.s, p.z))) for g, c in p.control_lines],
        stops=ended["runout_m"][drawn],
        title=title or p.name,
    )


def profile_report(
    result: ProfileResult,
    warnings: Sequence[str],
    effects: Sequence[str],
    byline: tuple[str, ...],
    provenance: tuple[tuple[str, Cell], ...],
    folder: Path,
) -> ReportContext:
    """Draw the figures of a profile into ``folder`` and put the report together."""
    p = result.profile
    length, relief = p.s[-1] - p.s[0], p.z.max() - p.z.min()
    text = "{} vertices, {} m long, {} m of relief"
    return ReportContext(
        title=p.name,
        subtitle="Rockfall along one profile with the SASS model (Bozzolo and Pamini, 1986)",
        what_was_run=(
            ("Profile", phrase(text, p.s.size, f"{length:.0f}", f"{relief:.0f}")),
            ("Start", phrase("chainage {} to {} m", *(f"{s:g}" for s in p.start))),
            ("Simulated blocks", int(result.rocks.size)),
            ("Fragments and entrained blocks", int(result.pieces.size)),
            ("Effects beyond the model of 1986", ", ".join(effects) or "none"),
        ),
        byline=byline,
        summary=profile_lines(result),
        warnings=tuple(warnings),
        key_results=stopping_reasons(
            np.bincount(result.rocks["reason"], minlength=len(StopReason))
        ),
        figures=tuple(_profile_pictures(result, folder)),
        tables=tuple(control_line_tables(result.control_lines)),
        provenance=provenance,
    )


def _profile_pictures(result: ProfileResult, folder: Path) -> list[ReportFigure]:
    p = result.profile
    caption = "Paths of the centres of the blocks; chainage in plan."
    figure = partial(figures.profile_figure, [profile_panel(result)])
    out = [picture(folder, "profile", "Trajectories", caption, figure)]
    caption = phrase("Quantiles of the blocks that reach each stretch of {} m.", f"{STRETCH_M:g}")
    for quantity, title in (
        ("energy", "Energy along the profile"),
        ("speed", "Speed along the profile"),
        ("height", "Passing height along the profile"),
    ):
        figure = partial(
            figures.energy_profile_figure, result.stretches, result.along[quantity], p.s, p.z,
            quantity=quantity, control_lines=list(p.control_lines),
        )  # fmt: skip
        out.append(picture(folder, f"{quantity}_along", title, caption, figure))
    ended = np.concatenate([result.rocks, result.pieces])
    caption = "Chainage at which blocks stop, by reason."
    if result.pieces.size:
        caption = "Chainage at which blocks, fragments and entrained blocks stop, by reason."
    last = np.ceil(np.ptp(ended["runout_m"])) + 1.0
    edges = np.floor(ended["runout_m"].min()) + np.arange(last + 1.0)
    counts = {
        r: np.histogram(ended["runout_m"][ended["reason"] == r], edges)[0] for r in StopReason
    }
    figure = partial(figures.runout_figure, edges, counts)
    out.append(picture(folder, "runout", "Run-out", caption, figure))
    caption = "First downhill passage."
    return out + station_figures(
        result.control_lines, result.rocks.size, result.pieces.size > 0, folder, caption, {}
    )
