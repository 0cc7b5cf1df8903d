"""Files of a diagnosis: its numbers, its map, and the calibrated model to run again."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import shapely

import sassgis
from sassgis.gap.diagnosis import Calibrated, Diagnosis, GapFinding, as_json
from sassgis.gap.observations.case import Case
from sassgis.gap.where.places import is_stretch, limits_on, line_stretch, used_lines
from sassgis.gap.words import (
    effect_name,
    finding_label,
    quantity_name,
    significance,
    tested_by,
)
from sassgis.io.read.config import load_config
from sassgis.io.read.ground_map import read_ground_table
from sassgis.io.write.geopackage import VectorLayer, write_geopackage
from sassgis.io.write.manifest import plain
from sassgis.io.write.staging import writing
from sassgis.model.errors import ConfigError
from sassgis.model.ground import GroundClass, GroundTable
from sassgis.model.styles import (
    FALL_LINE_STYLE,
    STATION_STYLE,
    FieldInfo,
    StyleClass,
    Symbol,
    VectorStyle,
    categorised_style,
)

#: Files of the calibrated model, beside its configuration.
CLASSES_NAME = "ground_classes.csv"
FOREST_NAME = "forest.gpkg"

#: How the map shows a gap: code, words, colour.
_GAP_CLASSES = (
    ("open", "not told from chance", "#9a9a9a"),
    ("less_likely", "less observed, likely", "#9ecae1"),
    ("more_likely", "more observed, likely", "#f5b38c"),
    ("less", "less observed, significant", "#0072b2"),
    ("more", "more observed, significant", "#d55e00"),
)
_LEG_WIDTH_MM = 1.4
#: How far drawn stretches may lie from the fall lines, in cells.
_DRAWN_CELLS = 0.1
#: A forest along fall lines reaches this far to their sides, and further to join (m).
_STAND_SIDE_M, _STAND_SIDE_MAX_M = 15.0, 60.0


def write_diagnosis_json(path: Path, diagnosis: Diagnosis) -> Path:
    """Write ``diagnosis.json``.

    Parameters
    ----------
    path : Path
    diagnosis : Diagnosis

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        If the disk is full or not writable.
    """
    # as_json makes missing numbers null; what else JSON does not know (infinity) becomes text.
    text = json.dumps(plain(as_json(diagnosis)), indent=2, ensure_ascii=False, allow_nan=False)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", encoding="utf-8", newline="\n")
    return path


# --- the map ---------------------------------------------------------------------------------


def write_gap_gpkg(path: Path, case: Case, diagnosis: Diagnosis) -> Path:
    """Write ``gap.gpkg``: where observed and simulated rocks part, on the map.

    Layers ``gap_stretches`` (findings that belong to a stretch: that stretch of every fall line),
    ``gap_points`` (findings at a station), ``stations``, ``fall_lines``, ``stops``, ``impacts``
    and, if the named effect brings one, ``stand``. Findings without a place on the map ("all",
    kinds of ground) are points at the coordinates that they state.

    Parameters
    ----------
    path : Path
        Must not exist.
    case : Case
    diagnosis : Diagnosis

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        If the file exists or the disk is full or not writable.
    """
    verdict = diagnosis.verdict
    metadata = {
        "program": f"sassgis {sassgis.__version__}",
        "effect": verdict.effect,
        "confidence": verdict.confidence,
        "confusion_set": ", ".join(verdict.confusion_set),
        "rocks": diagnosis.rocks,
        "seed": diagnosis.seed,
        "settings_hash": diagnosis.settings_hash,
    }
    layers = [
        _gap_points(case, diagnosis),
        _gap_stretches(case, diagnosis),
        _stations(case),
        _fall_lines(case),
        _stops(case, diagnosis),
        _impacts(case),
    ]
    stand = _stand(case, diagnosis.effect)
    if stand is not None:
        layers.append(stand)
    return write_geopackage(path, layers, metadata)


def _shown_as(finding: GapFinding) -> str:
    sure = significance(finding)
    if sure == "open":
        return "open"
    side = "more" if finding.gap > 0.0 else "less"
    return side if sure == "sure" else f"{side}_likely"


_FINDING_FIELDS = {
    "place": FieldInfo("place"),
    "phase": FieldInfo("phase of motion"),
    "quantity": FieldInfo("quantity"),
    "unit": FieldInfo("unit"),
    "gap": FieldInfo("observed less predicted", "", "in the unit of the quantity"),
    "ci95_low": FieldInfo("lower limit of the gap", "", "95 % interval, rocks resampled"),
    "ci95_high": FieldInfo("upper limit of the gap", "", "95 % interval, rocks resampled"),
    "observed": FieldInfo("observed, mean"),
    "predicted": FieldInfo("predicted, mean"),
    "rocks": FieldInfo("rocks"),
    "p_adjusted": FieldInfo("p, adjusted", "", "largest gap over all findings"),
    "q_value": FieldInfo("q", "", "share of false findings among those up to this one"),
    "test": FieldInfo("how it was tested"),
    "shown_as": FieldInfo("shown as"),
    "label": FieldInfo("label", "", "of the most certain finding of a place"),
}


def _finding_columns(findings: Sequence[GapFinding], labelled: set[int]) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "place": [f.place for f in findings],
        "phase": [f.phase for f in findings],
        "quantity": [quantity_name(f.quantity) for f in findings],
        "unit": [f.unit for f in findings],
    }
    for name, values in (
        ("gap", [f.gap for f in findings]),
        ("ci95_low", [f.ci95[0] for f in findings]),
        ("ci95_high", [f.ci95[1] for f in findings]),
        ("observed", [f.observed for f in findings]),
        ("predicted", [f.predicted for f in findings]),
    ):
        columns[name] = np.array([float(f"{v:.5g}") for v in values], float)
    columns["rocks"] = np.array([f.rocks for f in findings], np.int64)
    columns["p_adjusted"] = np.array([f.p_adjusted for f in findings], float)
    columns["q_value"] = np.array([f.q_value for f in findings], float)
    columns["test"] = [tested_by(f.test) for f in findings]
    columns["shown_as"] = [_shown_as(f) for f in findings]
    columns["label"] = [
        finding_label(f) if id(f) in labelled and significance(f) != "open" else None
        for f in findings
    ]
    return columns


def _drawing_order(findings: Sequence[GapFinding]) -> list[GapFinding]:
    """Least certain first, so that the others lie on top."""
    return sorted(findings, key=lambda f: (-f.p_adjusted, -f.q_value))


def _most_certain(findings: Sequence[GapFinding]) -> set[int]:
    """Identities of the most certain finding of each place."""
    best: dict[str, GapFinding] = {}
    for finding in _drawing_order(findings):
        best[finding.place] = finding
    return {id(f) for f in best.values()}


def _gap_style(symbol: Symbol) -> VectorStyle:
    style = categorised_style(
        symbol, "shown_as", {code: (words, colour) for code, words, colour in _GAP_CLASSES}
    )
    return dataclasses.replace(style, label_column="label")


def _gap_points(case: Case, diagnosis: Diagnosis) -> VectorLayer:
    chosen = _drawing_order([f for f in diagnosis.where if not _on_lines(f)])
    known = [math.isfinite(f.x) and math.isfinite(f.y) for f in chosen]
    frame = gpd.GeoDataFrame(
        _finding_columns(chosen, _most_certain(chosen)),
        geometry=[
            shapely.Point(f.x, f.y) if ok else None for f, ok in zip(chosen, known, strict=True)
        ],
        crs=case.grid.crs or None,
    )
    return VectorLayer(
        "gap_points",
        "Gap at stations",
        "Observed less predicted, at stations and for places without a stretch of their own. The "
        "most certain of a place lies on top and has the label.",
        frame,
        _FINDING_FIELDS,
        style=_gap_style(
            Symbol("marker", "#9a9a9a", size_mm=3.2, outline="#1a1a1a", outline_mm=0.2)
        ),
    )


def _on_lines(finding: GapFinding) -> bool:
    """Whether a finding is drawn along the fall lines. Kinds of ground lie in patches."""
    return is_stretch(finding) and not finding.place.startswith("ground:")


def _gap_stretches(case: Case, diagnosis: Diagnosis) -> VectorLayer:
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
    columns = _finding_columns(rows, _most_certain(rows))
    columns["s0_m"] = np.array([round(f.s0_m, 2) for f in rows], float)
    columns["s1_m"] = np.array([round(f.s1_m, 2) for f in rows], float)
    frame = gpd.GeoDataFrame(columns, geometry=shapes, crs=case.grid.crs or None)
    return VectorLayer(
        "gap_stretches",
        "Gap along the fall lines",
        "Observed less predicted, on the stretch of every fall line to which it belongs. The most "
        "certain of a stretch lies on top and has the label.",
        frame,
        {
            **_FINDING_FIELDS,
            "s0_m": FieldInfo("from chainage", "m", "mean over the fall lines"),
            "s1_m": FieldInfo("to chainage", "m", "mean over the fall lines"),
        },
        style=_gap_style(Symbol("line", "#9a9a9a", opacity=0.85, size_mm=_LEG_WIDTH_MM)),
    )


def _stations(case: Case) -> VectorLayer:
    table = case.observations.stations
    rows = [i for i, v in enumerate(table.vertices) if v.shape[0] > 1]
    passed = case.observations.passages
    names = [str(table.station[i]) for i in rows]
    own = case.observations.rock_of("passages")
    chainage = []
    for i in rows:
        s = case.stations.s[used_lines(case), i]
        known = s[np.isfinite(s)]
        chainage.append(float(np.median(known)) if known.size else math.nan)
    frame = gpd.GeoDataFrame(
        {
            "name": names,
            "chainage_m": np.round(np.array(chainage, float), 2),
            "rocks": np.array(
                [np.unique(own[(passed.station == n) & (own >= 0)]).size for n in names], np.int64
            ),
        },
        geometry=[shapely.LineString(table.vertices[i]) for i in rows],
        crs=case.grid.crs or None,
    )
    return VectorLayer(
        "stations",
        "Stations",
        "Lines at which passing rocks were observed.",
        frame,
        {
            "name": FieldInfo("name"),
            "chainage_m": FieldInfo("chainage", "m", "median over the fall lines"),
            "rocks": FieldInfo("observed rocks"),
        },
        style=STATION_STYLE,
    )


def _fall_lines(case: Case) -> VectorLayer:
    lines = used_lines(case)
    names = np.array(case.observations.rock_names, object)
    rocks = [names[case.line == i] for i in lines]
    traces = case.traces
    shapes = []
    for i in lines:
        own = slice(int(traces.offset[i]), int(traces.offset[i + 1]))
        shapes.append(shapely.LineString(np.column_stack([traces.x[own], traces.y[own]])))
    frame = gpd.GeoDataFrame(
        {
            "rocks": np.array([len(r) for r in rocks], np.int64),
            "rock_ids": [", ".join(str(n) for n in r) for r in rocks],
            "length_m": np.array([round(shape.length, 2) for shape in shapes], float),
        },
        geometry=shapes,
        crs=case.grid.crs or None,
    )
    return VectorLayer(
        "fall_lines",
        "Fall lines",
        "Fall lines of the observed rocks, in whose planes they are simulated.",
        frame,
        {
            "rocks": FieldInfo("observed rocks"),
            "rock_ids": FieldInfo("names of the rocks"),
            "length_m": FieldInfo("length in plan", "m"),
        },
        style=FALL_LINE_STYLE,
    )


def _rock_names(case: Case, table: str) -> list[str]:
    """The rock that each row belongs to; empty for unattributed blocks."""
    names = case.observations.rock_names
    return [names[i] if i >= 0 else "" for i in case.observations.rock_of(table).tolist()]


def _predicted_runout(diagnosis: Diagnosis) -> float:
    """Mean run-out of the calibrated base model (m); NaN if it was not compared."""
    for comparison in diagnosis.comparisons:
        values = [v for v in comparison.base if math.isfinite(v)]
        if comparison.quantity.startswith("runout") and values:
            return float(np.mean(values))
    return math.nan


def _stops(case: Case, diagnosis: Diagnosis) -> VectorLayer:
    table = case.observations.deposits
    at = case.projected["deposits"]
    rows = np.flatnonzero(np.isfinite(table.x) & np.isfinite(table.y))
    kinds = np.where(
        case.observations.rock_of("deposits") < 0,
        "unattributed",
        np.where(case.observations.is_piece("deposits"), "piece", "rock"),
    )
    beyond = {1: "past the end of its fall line", -1: "behind its start", 0: ""}
    frame = gpd.GeoDataFrame(
        {
            "rock_id": table.rock_id[rows].tolist(),
            "rock": [_rock_names(case, "deposits")[i] for i in rows],
            "kind": kinds[rows].tolist(),
            "mass_kg": table.mass_kg[rows],
            "volume_m3": table.volume_m3[rows],
            "runout_m": np.round(at.s[rows], 2),
            "residual_m": np.round(at.s[rows] - _predicted_runout(diagnosis), 2),
            "lateral_m": np.round(at.lateral_m[rows], 2),
            "note": [beyond[int(b)] or None for b in at.beyond[rows]],
        },
        geometry=shapely.points(table.x[rows], table.y[rows]),
        crs=case.grid.crs or None,
    )
    return VectorLayer(
        "stops",
        "Where observed blocks lie",
        "Observed stops, with their place in the plane of the fall line.",
        frame,
        {
            "rock_id": FieldInfo("name"),
            "rock": FieldInfo("rock it belongs to"),
            "kind": FieldInfo("kind", "", "rock, piece of one, or unattributed block"),
            "mass_kg": FieldInfo("mass", "kg"),
            "volume_m3": FieldInfo("volume", "m³"),
            "runout_m": FieldInfo("run-out chainage", "m"),
            "residual_m": FieldInfo(
                "run-out less mean prediction",
                "m",
                "less the mean run-out of all rocks in the calibrated base model",
            ),
            "lateral_m": FieldInfo("aside of the fall line", "m", "to the right is positive"),
            "note": FieldInfo("note"),
        },
        style=VectorStyle(
            _STOP,
            "categories",
            "kind",
            (
                StyleClass("rock", _STOP, value="rock"),
                StyleClass("piece", dataclasses.replace(_STOP, size_mm=1.4), value="piece"),
                StyleClass(
                    "unattributed block",
                    dataclasses.replace(_STOP, colour="#9a9a9a"),
                    value="unattributed",
                ),
            ),
        ),
    )


_STOP = Symbol("marker", "#ffffff", size_mm=2.2, outline="#1a1a1a", outline_mm=0.3, shape="diamond")


def _impacts(case: Case) -> VectorLayer:
    table = case.observations.impacts
    at = case.projected["impacts"]
    rows = np.flatnonzero(np.isfinite(table.x) & np.isfinite(table.y))
    before = np.hypot(table.vt_in_mps, table.vn_in_mps)
    after = np.hypot(table.vt_out_mps, table.vn_out_mps)
    with np.errstate(divide="ignore", invalid="ignore"):
        kept = np.where(before > 0.0, (after / before) ** 2, np.nan)
    frame = gpd.GeoDataFrame(
        {
            "rock_id": table.rock_id[rows].tolist(),
            "impact": table.impact[rows].tolist(),
            "chainage_m": np.round(at.s[rows], 2),
            "lateral_m": np.round(at.lateral_m[rows], 2),
            "speed_in_mps": np.round(before[rows], 3),
            "speed_out_mps": np.round(after[rows], 3),
            "energy_kept": np.round(kept[rows], 4),
            "turn_deg": table.turn_deg[rows],
        },
        geometry=shapely.points(table.x[rows], table.y[rows]),
        crs=case.grid.crs or None,
    )
    return VectorLayer(
        "impacts",
        "Observed impacts",
        "Impacts with the speeds before and after.",
        frame,
        {
            "rock_id": FieldInfo("name"),
            "impact": FieldInfo("impact"),
            "chainage_m": FieldInfo("chainage", "m"),
            "lateral_m": FieldInfo("aside of the fall line", "m", "to the right is positive"),
            "speed_in_mps": FieldInfo("speed before", "m/s"),
            "speed_out_mps": FieldInfo("speed after", "m/s"),
            "energy_kept": FieldInfo("share of translational energy kept"),
            "turn_deg": FieldInfo("turn in plan", "°", "clockwise is positive"),
        },
        style=VectorStyle(
            Symbol("marker", "#e69f00", size_mm=1.8, outline="#1a1a1a", outline_mm=0.15,
                   shape="triangle")
        ),
    )  # fmt: skip


# --- the stand -------------------------------------------------------------------------------


def stand_polygon(case: Case, stand: tuple[float, float]) -> shapely.MultiPolygon:
    """Area of a stand that lies between two chainages of the fall lines.

    The stretches of the fall lines widened to both sides, as far as it takes to join neighbours.

    Parameters
    ----------
    case : Case
    stand : (low, high)
        Chainages (m).

    Returns
    -------
    MultiPolygon
        Empty where no fall line reaches the stand.
    """
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


def _stand(case: Case, calibrated: Calibrated) -> VectorLayer | None:
    if calibrated.stand is None or calibrated.stems_per_ha is None or calibrated.dbh_cm is None:
        return None
    area = stand_polygon(case, calibrated.stand)
    frame = gpd.GeoDataFrame(
        {
            "name": ["fitted stand"],
            "stems_per_ha": np.array([float(f"{calibrated.stems_per_ha:.4g}")], float),
            "dbh_cm": np.array([float(f"{calibrated.dbh_cm:.4g}")], float),
            "from_m": np.array([round(calibrated.stand[0], 2)], float),
            "to_m": np.array([round(calibrated.stand[1], 2)], float),
        },
        geometry=[area],
        crs=case.grid.crs or None,
    )
    return VectorLayer(
        "stand",
        "Fitted stand",
        "Where a forest would have to stand, and how dense, to explain the observations: fitted to "
        "them, not surveyed. Its sides are those of the fall lines of the observed rocks.",
        frame,
        {
            "name": FieldInfo("name"),
            "stems_per_ha": FieldInfo("stems", "1/ha"),
            "dbh_cm": FieldInfo("diameter at breast height", "cm"),
            "from_m": FieldInfo("from chainage", "m"),
            "to_m": FieldInfo("to chainage", "m"),
        },
        style=VectorStyle(
            Symbol("fill", "#238b45", opacity=0.35, outline="#00441b", outline_mm=0.3)
        ),
    )


# --- the calibrated model --------------------------------------------------------------------

#: Keys that name files, by section; the keys of ``[[...]]`` are those of each entry.
_FILE_KEYS: Mapping[str, tuple[str, ...]] = {
    "terrain": ("dem",),
    "release": ("file",),
    "ground": ("file", "classes"),
    "stations": ("file",),
    "barriers": ("file",),
    "profile": ("file",),
    "hazard": ("frequencies",),
    "risk": ("vulnerability",),
    "objects": ("file",),
}
_TREE_FILE_KEYS = ("file", "stems_raster", "dbh_raster")
_FOREST_PLACE_KEYS = (
    "file", "layer", "stems_field", "dbh_field", "stems_raster", "dbh_raster", "stems_per_ha",
    "dbh_cm",
)  # fmt: skip


def write_config_back(path: Path, config_file: Path, diagnosis: Diagnosis, case: Case) -> Path:
    """Write the user's configuration with the calibrated ground and the named effect.

    A ground-class table and, for fitted trees, a forest are written beside it. Files that the
    configuration names are named relative to the new place.

    Parameters
    ----------
    path : Path
        The new TOML file; its folder is made.
    config_file : Path
        The configuration that was diagnosed.
    diagnosis : Diagnosis
    case : Case

    Returns
    -------
    Path

    Raises
    ------
    ConfigError, InputError
        If the result could not be used in a run.
    OutputError
        If the disk is full or not writable.
    """
    calibrated = diagnosis.effect
    document = tomllib.loads(config_file.read_bytes().decode("utf-8-sig"))
    # Symbolic links are followed: the way up from the new place counts real folders.
    base, place = Path(os.path.realpath(config_file)).parent, Path(os.path.realpath(path)).parent
    _move_paths(document, base, place)
    document.setdefault("ground", {})["classes"] = CLASSES_NAME
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    effects = document.setdefault("effects", {})
    for family, section in calibrated.sections.items():
        own = {k: _toml_ready(v) for k, v in section.items() if v is not None}
        if family == "trees":
            stands = {k: v for k, v in effects.get(family, {}).items() if k in _FOREST_PLACE_KEYS}
            own = {**stands, **own}
        effects[family] = own
    stand = _stand(case, calibrated)
    if stand is not None:
        write_geopackage(path.parent / FOREST_NAME, [stand])
        trees = effects.setdefault("trees", {})
        for key in _FOREST_PLACE_KEYS:
            trees.pop(key, None)
        trees |= {
            "file": FOREST_NAME,
            "layer": stand.name,
            "stems_field": "stems_per_ha",
            "dbh_field": "dbh_cm",
        }
    if not effects:
        del document["effects"]
    bundled = (
        "lateral_deflection" in effects and document.get("spread", {}).get("lines_per_point", 1) > 1
    )
    if bundled:
        # One or the other: both would spread the rocks twice.
        del document["spread"]
    _write_text(path.parent / CLASSES_NAME, _classes_csv(calibrated.table, case.table, diagnosis))
    _write_text(
        path, _comments(diagnosis, config_file, stand is not None, bundled) + toml_text(document)
    )
    # What cannot be run again is told now, not in the next run.
    config = load_config(path)
    read_ground_table(config.ground.classes)
    return path


def _write_text(path: Path, text: str) -> None:
    with writing(path):
        path.write_text(text, encoding="utf-8", newline="\n")


def _comments(diagnosis: Diagnosis, config_file: Path, stand: bool, bundled: bool) -> str:
    verdict = diagnosis.verdict
    named = verdict.effect not in ("none", "unknown")
    lines = [
        f"Made by sassgis {sassgis.__version__} (gap diagnose) from {config_file.name} and "
        f"observations of {diagnosis.rocks} rocks.",
        "Ground classes are calibrated to these observations (" + CLASSES_NAME + ").",
    ]
    if not named:
        lines.append(
            "No effect was named: the model is that of the configuration, calibrated."
            if verdict.effect == "none"
            else "No known effect explains the gap: the model is calibrated, and a gap is left."
        )
    elif not diagnosis.effect.sections:
        lines.append(
            f"Named: {effect_name(verdict.effect)}, with a confidence of {verdict.confidence:.2f}. "
            "That is not a part of the motion, so nothing was added to the model."
        )
    else:
        lines.append(
            f"Named: {effect_name(verdict.effect)}, with a confidence of {verdict.confidence:.2f}; "
            "section [effects." + "], [effects.".join(diagnosis.effect.sections) + "] is fitted."
        )
        if len(verdict.confusion_set) > 1:
            lines.append(
                "The observations do not tell apart: "
                + ", ".join(effect_name(e) for e in verdict.confusion_set)
                + "."
            )
    if stand:
        lines.append(
            f"The forest ({FOREST_NAME}) is where the observations ask for one, along the fall "
            "lines of the observed rocks; it was not surveyed."
        )
    if bundled:
        lines.append(
            "Section [spread] is left out: a bundle of lines does not go with lateral deflection."
        )
    lines += [
        "Calibrated for this slope and rocks of these sizes; elsewhere it is untested.",
        "Comments of the original file are not copied.",
    ]
    return "".join(f"# {line}\n" for line in lines) + "\n"


def _move_paths(document: dict[str, Any], base: Path, place: Path) -> None:
    """Name the files of a configuration in ``base`` as seen from the folder ``place``."""

    def moved(value: str) -> str:
        file = Path(base, Path(value).expanduser())
        try:
            return Path(os.path.relpath(file, place)).as_posix()
        except ValueError:  # On another drive (Windows).
            return file.as_posix()

    def change(section: Any, keys: Sequence[str]) -> None:
        for entry in section if isinstance(section, list) else [section]:
            for key in keys:
                if isinstance(entry, dict) and isinstance(entry.get(key), str):
                    entry[key] = moved(entry[key])

    for name, keys in _FILE_KEYS.items():
        change(document.get(name), keys)
    change(document.get("effects", {}).get("trees"), _TREE_FILE_KEYS)
    preset = document.get("hazard", {}).get("preset")
    # As the configuration tells a file from the name of a built-in preset.
    if isinstance(preset, str) and (preset.endswith(".toml") or "/" in preset):
        document["hazard"]["preset"] = moved(preset)


_CLASS_COLUMNS = ("name", "eta_max", "dp_min", "dp_max", "mu_f", "mu_0", "k", "d_star_m")


def _classes_csv(table: GroundTable, configured: GroundTable, diagnosis: Diagnosis) -> str:
    before = {c.name: c for c in configured.classes}
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow((*_CLASS_COLUMNS, "source", "verified"))
    for own in table.classes:
        numbers = [f"{getattr(own, c):.6g}" for c in _CLASS_COLUMNS[1:]]
        changed = _changes(before.get(own.name), own)
        source, verified = own.source, own.verified
        if changed:
            verified = False
            source = (
                f"Calibrated to observations of {diagnosis.rocks} rocks (sassgis gap diagnose); "
                f"before: {changed}."
            )
        rows.writerow((own.name, *numbers, source, "true" if verified else "false"))
    return out.getvalue()


def _changes(old: GroundClass | None, new: GroundClass) -> str:
    if old is None:
        return ""
    pairs = [(c, getattr(old, c), getattr(new, c)) for c in _CLASS_COLUMNS[1:]]
    return ", ".join(f"{c} {a:g}" for c, a, b in pairs if a != b)


# --- TOML ------------------------------------------------------------------------------------


def toml_text(document: Mapping[str, Any]) -> str:
    """A document as TOML: keys, tables and lists of tables, read back as it was.

    Parameters
    ----------
    document : mapping
        Text, numbers, truth values, lists and mappings of them.

    Returns
    -------
    str
    """
    lines: list[str] = []
    _add_table(lines, (), document)
    return "\n".join(lines).strip("\n") + "\n"


def _add_table(lines: list[str], path: tuple[str, ...], table: Mapping[str, Any]) -> None:
    inner = {
        k: v
        for k, v in table.items()
        if (isinstance(v, Mapping) and len(path) < 1) or _is_tables(v) or _is_section(path, v)
    }
    for key, value in table.items():
        if key not in inner:
            lines.append(f"{_key(key)} = {_value(value)}")
    for key, value in inner.items():
        entries = value if isinstance(value, list | tuple) else [value]
        for entry in entries:
            name = ".".join(_key(p) for p in (*path, key))
            # A table that holds nothing but tables needs no head of its own.
            if isinstance(value, Mapping):
                if not entry or any(not _is_section((*path, key), v) for v in entry.values()):
                    lines += ["", f"[{name}]"]
            else:
                lines += ["", f"[[{name}]]"]
            _add_table(lines, (*path, key), entry)


def _is_tables(value: Any) -> bool:
    return (
        isinstance(value, list | tuple)
        and bool(value)
        and all(isinstance(v, Mapping) for v in value)
    )


def _is_section(path: tuple[str, ...], value: Any) -> bool:
    """Whether a mapping within a section gets a head: ``[effects.trees]``, not raster classes."""
    return isinstance(value, Mapping) and path == ("effects",)


def _key(key: str) -> str:
    bare = key and all(c.isascii() and (c.isalnum() or c in "_-") for c in key)
    return key if bare else json.dumps(key, ensure_ascii=False)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON leaves one control character as it is that TOML does not take.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        text = repr(value)
        return text if any(c in text for c in ".en") else f"{text}.0"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    raise ConfigError("has no form in TOML", found=type(value).__name__)


def _toml_ready(value: Any) -> Any:
    """A value of a section without numpy's types, numbers to six digits."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, list | tuple):
        return [_toml_ready(v) for v in value]
    return value
