"""Files of a diagnosis: its numbers, its map, and the calibrated model to run again."""

from __future__ import annotations

import json
from pathlib import Path

import sassgis
from sassgis.gap.diagnosis import Diagnosis, as_json
from sassgis.gap.observations.case import Case
from sassgis.io.write.calibrated_config import write_text
from sassgis.io.write.geopackage import write_geopackage
from sassgis.io.write.layers.gap_map import (
    fall_line_layer,
    gap_points,
    gap_stretches,
    impact_layer,
    stand_layer,
    station_layer,
    stop_layer,
)
from sassgis.io.write.manifest import plain


def write_diagnosis_json(path: Path, diagnosis: Diagnosis) -> None:
    """Write ``diagnosis.json``."""
    # as_json makes missing numbers null; what else JSON does not know (infinity) becomes text.
    text = json.dumps(plain(as_json(diagnosis)), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_gap_gpkg(path: Path, case: Case, diagnosis: Diagnosis) -> None:
    """Write ``gap.gpkg``: where observed and simulated rocks part, on the map.

    Layers ``gap_stretches`` (findings that belong to a stretch: that stretch of every fall line),
    ``gap_points`` (findings at a station), ``stations``, ``fall_lines``, ``stops``, ``impacts``
    and, if the named effect brings one, ``stand``. Findings without a place on the map ("all",
    kinds of ground) are points at the coordinates that they state. The file must not exist.
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
        gap_points(case, diagnosis),
        gap_stretches(case, diagnosis),
        station_layer(case),
        fall_line_layer(case),
        stop_layer(case, diagnosis),
        impact_layer(case),
        stand_layer(case, diagnosis.effect),
    ]
    write_geopackage(path, [own for own in layers if own is not None], metadata)
