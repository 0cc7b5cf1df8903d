"""Layers of the map of a diagnosis: gaps, stations, fall lines, stops, impacts, stand."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from sassgis.files.vector_layer import VectorLayer, described_layer
from sassgis.gap.diagnosis import Diagnosis, GapFinding
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.observations.case import Case
from sassgis.gap.verdict.verdict import is_stretch, limits_on, line_stretch, used_lines
from sassgis.gap.words import finding_label, quantity_name, significance, tested_by
from sassgis.settings import styles
from sassgis.settings.results import rounded

#: How the map shows a gap: code, words, colour.
_GAP_CLASSES: dict[str | int, tuple[str, str]] = {
    "open": ("not distinguished from chance", "#9a9a9a"),
    "less_likely": ("less observed, likely", "#9ecae1"),
    "more_likely": ("more observed, likely", "#f5b38c"),
    "less": ("less observed, significant", "#0072b2"),
    "more": ("more observed, significant", "#d55e00"),
}
_REACH_WIDTH_MM = 1.4
#: How far drawn stretches may lie from the fall lines, in cells.
_DRAWN_CELLS = 0.1
#: A forest along fall lines reaches this far to their sides, and further to join (m).
_STAND_SIDE_M, _STAND_SIDE_MAX_M = 15.0, 60.0


def _shown_as(finding: GapFinding) -> str:
    sure = significance(finding)
    if sure == "open":
        return "open"
    side = "more" if finding.gap > 0.0 else "less"
    return side if sure == "sure" else f"{side}_likely"


def _finding_columns(findings: Sequence[GapFinding]) -> dict[str, Any]:
    labelled = {id(f) for f in {f.place: f for f in findings}.values()}
    numbers = {
        "gap": [f.gap for f in findings],
        "ci95_low": [f.ci95[0] for f in findings],
        "ci95_high": [f.ci95[1] for f in findings],
        "observed": [f.observed for f in findings],
        "predicted": [f.predicted for f in findings],
    }
    return {
        "place": [f.place for f in findings],
        "phase": [f.phase for f in findings],
        "quantity": [quantity_name(f.quantity) for f in findings],
        "unit": [f.unit for f in findings],
        **{k: np.array([float(f"{v:.5g}") for v in own], float) for k, own in numbers.items()},
        "rocks": np.array([f.rocks for f in findings], np.int64),
        "p_adjusted": np.array([f.p_adjusted for f in findings], float),
        "q_value": np.array([f.q_value for f in findings], float),
        "test": [tested_by(f.test) for f in findings],
        "shown_as": [_shown_as(f) for f in findings],
        # The most certain of a place comes last.
        "label": [
            finding_label(f) if id(f) in labelled and significance(f) != "open" else None
            for f in findings
        ],
    }


def _drawing_order(findings: Sequence[GapFinding]) -> list[GapFinding]:
    """Sort the least certain first, so that the others lie on top."""
    return sorted(findings, key=lambda f: (-f.p_adjusted, -f.q_value))


def _gap_style(symbol: styles.Symbol) -> styles.VectorStyle:
    style = styles.categorised_style(symbol, "shown_as", _GAP_CLASSES)
    return dataclasses.replace(style, label_column="label")


def gap_points(case: Case, diagnosis: Diagnosis) -> VectorLayer:
    """Return gaps at stations, ground classes or the whole slope, as points."""
    chosen = _drawing_order([f for f in diagnosis.where if not _on_lines(f)])
    places = [
        shapely.Point(f.x, f.y) if math.isfinite(f.x) and math.isfinite(f.y) else None
        for f in chosen
    ]
    symbol = styles.Symbol("marker", "#9a9a9a", size_mm=3.2, outline="#1a1a1a", outline_mm=0.2)
    columns = _finding_columns(chosen)
    return described_layer("gap_points", columns, places, case.grid.crs, _gap_style(symbol))


def _on_lines(finding: GapFinding) -> bool:
    """Return whether a finding is drawn along the fall lines; kinds of ground lie in patches."""
    return is_stretch(finding) and not finding.place.startswith("ground:")


def gap_stretches(case: Case, diagnosis: Diagnosis) -> VectorLayer:
    """Return gaps of reaches, along the fall lines."""
    chosen = _drawing_order([f for f in diagnosis.where if _on_lines(f)])
    rows, shapes = [], []
    for finding in chosen:
        parts = [
            line_stretch(case.traces, i, *limits_on(case, finding, i)) for i in used_lines(case)
        ]
        parts = [p for p in parts if len(p) > 1]
        if parts:
            rows.append(finding)
            # Drawn alike, and many findings share a stretch.
            lines = shapely.MultiLineString(parts)
            shapes.append(shapely.simplify(lines, _DRAWN_CELLS * case.grid.cell_size))
    columns = {
        **_finding_columns(rows),
        "s0_m": np.array([round(f.s0_m, 2) for f in rows], float),
        "s1_m": np.array([round(f.s1_m, 2) for f in rows], float),
    }
    style = _gap_style(styles.Symbol("line", "#9a9a9a", opacity=0.85, size_mm=_REACH_WIDTH_MM))
    return described_layer("gap_stretches", columns, shapes, case.grid.crs, style)


def station_layer(case: Case) -> VectorLayer:
    """Return stations of the observations."""
    table = case.observations.stations
    rows = [i for i, v in enumerate(table.vertices) if v.shape[0] > 1]
    passed = case.observations.passages
    names = [str(table.station[i]) for i in rows]
    own = case.observations.rock_of("passages")
    chainage = []
    for i in rows:
        s = case.stations[used_lines(case), i]
        known = s[np.isfinite(s)]
        chainage.append(float(np.median(known)) if known.size else math.nan)
    columns = {
        "name": names,
        "chainage_m": np.round(np.array(chainage, float), 2),
        "rocks": np.array(
            [np.unique(own[(passed.station == n) & (own >= 0)]).size for n in names], np.int64
        ),
    }
    shapes = [shapely.LineString(table.vertices[i]) for i in rows]
    return described_layer(
        "stations.observed", columns, shapes, case.grid.crs, styles.STATION_STYLE
    )


def fall_line_layer(case: Case) -> VectorLayer:
    """Return fall lines of the observed rocks."""
    lines = used_lines(case)
    names = np.array(case.observations.rock_names, object)
    rocks = [names[case.line == i] for i in lines]
    traces = case.traces
    shapes = []
    for i in lines:
        own = slice(int(traces.offset[i]), int(traces.offset[i + 1]))
        shapes.append(shapely.LineString(np.column_stack([traces.x[own], traces.y[own]])))
    columns = {
        "rocks": np.array([len(r) for r in rocks], np.int64),
        "rock_ids": [", ".join(str(n) for n in r) for r in rocks],
        "length_m": np.array([round(shape.length, 2) for shape in shapes], float),
    }
    return described_layer(
        "fall_lines.observed", columns, shapes, case.grid.crs, styles.FALL_LINE_STYLE
    )


def _predicted_runout(diagnosis: Diagnosis) -> float:
    """Return the mean run-out of the calibrated base model (m); NaN if it was not compared."""
    for comparison in diagnosis.comparisons:
        values = [v for v in comparison.base if math.isfinite(v)]
        if comparison.quantity.startswith("runout") and values:
            return float(np.mean(values))
    return math.nan


def stop_layer(case: Case, diagnosis: Diagnosis) -> VectorLayer:
    """Return observed stops, with the predicted run-out."""
    table, at = case.observations.deposits, case.projected["deposits"]
    rows = np.flatnonzero(np.isfinite(table.x) & np.isfinite(table.y))
    # Unattributed blocks belong to no rock.
    rock = case.observations.rock_of("deposits")
    names = [*case.observations.rock_names, ""]
    pieces = case.observations.is_piece("deposits")
    kinds = np.where(rock < 0, "unattributed", np.where(pieces, "piece", "rock"))
    beyond = {1: "past the end of its fall line", -1: "behind its start", 0: None}
    columns = {
        "rock_id": table.rock_id[rows].tolist(),
        "rock": [names[i] for i in rock[rows]],
        "kind": kinds[rows].tolist(),
        "mass_kg": table.mass_kg[rows],
        "volume_m3": table.volume_m3[rows],
        "runout_m": np.round(at.s[rows], 2),
        "residual_m": np.round(at.s[rows] - _predicted_runout(diagnosis), 2),
        "lateral_m": np.round(at.lateral_m[rows], 2),
        "note": [beyond[int(b)] for b in at.beyond[rows]],
    }
    symbol = styles.Symbol(
        "marker", "#ffffff", size_mm=2.2, outline="#1a1a1a", outline_mm=0.3, shape="diamond"
    )
    grey = dataclasses.replace(symbol, colour="#9a9a9a")
    classes = (
        styles.StyleClass("rock", symbol, value="rock"),
        styles.StyleClass("piece", dataclasses.replace(symbol, size_mm=1.4), value="piece"),
        styles.StyleClass("unattributed block", grey, value="unattributed"),
    )
    places = shapely.points(table.x[rows], table.y[rows])
    style = styles.VectorStyle(symbol, "categories", "kind", classes)
    return described_layer("stops.observed", columns, places, case.grid.crs, style)


def impact_layer(case: Case) -> VectorLayer:
    """Return observed impacts."""
    table, at = case.observations.impacts, case.projected["impacts"]
    rows = np.flatnonzero(np.isfinite(table.x) & np.isfinite(table.y))
    before = np.hypot(table.vt_in_mps, table.vn_in_mps)
    after = np.hypot(table.vt_out_mps, table.vn_out_mps)
    with np.errstate(divide="ignore", invalid="ignore"):
        kept = np.where(before > 0.0, (after / before) ** 2, np.nan)
    columns = {
        "rock_id": table.rock_id[rows].tolist(),
        "impact": table.impact[rows].tolist(),
        "chainage_m": np.round(at.s[rows], 2),
        "lateral_m": np.round(at.lateral_m[rows], 2),
        "speed_in_mps": np.round(before[rows], 3),
        "speed_out_mps": np.round(after[rows], 3),
        "energy_kept": np.round(kept[rows], 4),
        "turn_deg": table.turn_deg[rows],
    }
    symbol = styles.Symbol(
        "marker", "#e69f00", size_mm=1.8, outline="#1a1a1a", outline_mm=0.15, shape="triangle"
    )
    places = shapely.points(table.x[rows], table.y[rows])
    return described_layer("impacts", columns, places, case.grid.crs, styles.VectorStyle(symbol))


def stand_polygon(case: Case, stand: tuple[float, float]) -> shapely.MultiPolygon:
    """Return the fall lines between two chainages (m), widened until neighbours join."""
    parts = [line_stretch(case.traces, i, *stand) for i in used_lines(case)]
    lines = [shapely.LineString(p) for p in parts if len(p) > 1]
    side = max(_STAND_SIDE_M, 2.0 * case.grid.cell_size)
    # Halfway to the next neighbour, of the one that is furthest from all others.
    joined = lines[:1]
    left = lines[1:]
    while left:
        gaps = [min(line.distance(other) for other in joined) for line in left]
        nearest = int(np.argmin(gaps))
        side = max(side, min(0.55 * gaps[nearest], _STAND_SIDE_MAX_M))
        joined.append(left.pop(nearest))
    # Flat ends: the stand must not begin above its chainage.
    area = shapely.unary_union([line.buffer(side, cap_style="flat") for line in lines])
    return shapely.MultiPolygon([p for p in shapely.get_parts(area) if p.geom_type == "Polygon"])


def stand_layer(case: Case, model: HypothesisModel) -> VectorLayer | None:
    """Map where a fitted forest would have to stand; None if none was fitted."""
    stand = model.stand
    if stand is None:
        return None
    columns = {
        "name": ["fitted stand"],
        "stems_per_ha": np.array([rounded(stand.stems_per_ha, 6)], float),
        "dbh_cm": np.array([rounded(stand.dbh_cm, 6)], float),
        "from_m": np.array([round(stand.s0, 2)], float),
        "to_m": np.array([round(stand.s1, 2)], float),
    }
    area = stand_polygon(case, (stand.s0, stand.s1))
    symbol = styles.Symbol("fill", "#238b45", opacity=0.35, outline="#00441b", outline_mm=0.3)
    return described_layer("stand", columns, [area], case.grid.crs, styles.VectorStyle(symbol))
