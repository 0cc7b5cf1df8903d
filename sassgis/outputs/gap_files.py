"""Files of a diagnosis: its numbers, its map, and the calibrated model to run again."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import tomli_w

import sassgis
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.files.atomic_output import write_json, write_text, writing
from sassgis.gap.diagnosis import Diagnosis, as_json
from sassgis.gap.observations.case import Case
from sassgis.gap.words import effect_name, file_has
from sassgis.inputs.config import load_config
from sassgis.inputs.ground_map import read_ground_table
from sassgis.inputs.in_memory import classes_frame
from sassgis.outputs.config_template import written_document
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.layers import gap_map
from sassgis.outputs.manifest import plain
from sassgis.settings.ground import PARAMETERS, GroundClass, GroundTable
from sassgis.settings.run_config import Config
from sassgis.settings.schema import declared
from sassgis.settings.settings import ForestPlace

#: Files of the calibrated model, next to its configuration.
CLASSES_NAME = "ground_classes.csv"
FOREST_NAME = "forest.gpkg"


def write_diagnosis_json(path: Path, diagnosis: Diagnosis) -> None:
    """Write ``diagnosis.json``."""
    # as_json makes missing numbers null; what else JSON does not know (infinity) becomes text.
    write_json(path, plain(as_json(diagnosis)))


def write_gap_gpkg(path: Path, case: Case, diagnosis: Diagnosis) -> None:
    """Write a new ``gap.gpkg``: where observed and simulated rocks part, on the map.

    Findings of a stretch lie on every fall line; those without a place on the map ("all", kinds of
    ground) are points at the coordinates that they state.
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
        gap_map.gap_points(case, diagnosis),
        gap_map.gap_stretches(case, diagnosis),
        gap_map.station_layer(case),
        gap_map.fall_line_layer(case),
        gap_map.stop_layer(case, diagnosis),
        gap_map.impact_layer(case),
        gap_map.stand_layer(case, diagnosis.effect),
    ]
    write_geopackage(path, [own for own in layers if own is not None], metadata)


def write_config_back(path: Path, config: Config, diagnosis: Diagnosis, case: Case) -> Path:
    """Write the user's configuration with the calibrated ground and the named effect.

    A ground-class table and, for fitted trees, a forest are written next to it. ConfigError or
    InputError if the result could not be used in a run.
    """
    calibrated = diagnosis.effect
    sections = calibrated.sections(case.effects)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    document = written_document(config, path)
    document.setdefault("ground", {})["classes"] = CLASSES_NAME
    if calibrated.engine_keys:
        document.setdefault("engine", {}).update(calibrated.engine_keys)
    effects = document.setdefault("effects", {})
    for family, section in sections.items():
        own = {k: plain(v, 6) for k, v in section.items() if v is not None}
        if family == "trees":
            given, known = effects.get(family, {}), declared(ForestPlace)
            stands = {k: v for k, v in given.items() if k in known}
            own = {**stands, **own}
        effects[family] = own
    stand = gap_map.stand_layer(case, calibrated)
    if stand is not None:
        write_geopackage(path.parent / FOREST_NAME, [stand])
        trees = effects.setdefault("trees", {})
        for key in declared(ForestPlace):
            trees.pop(key, None)
        trees |= {
            "file": FOREST_NAME,
            "layer": stand.name,
            "stems_field": "stems_per_ha",
            "dbh_field": "dbh_cm",
        }
    document["terrain"]["path"] = "fall_line" if case.terrain is None else "followed"
    # Blocks cannot leave their fall line.
    left_out = case.terrain is None and effects.pop(LateralDeflection.name, None) is not None
    if not effects:
        del document["effects"]
    provenance = f"Calibrated to observations of {diagnosis.rocks} rocks (sassgis gap diagnose)"
    write_text(
        path.parent / CLASSES_NAME,
        classes_csv(calibrated.table, case.table, lambda _own: provenance),
    )
    write_runnable(
        path, _comments(diagnosis, sections, config.label, stand is not None, left_out), document
    )
    return path


def write_runnable(path: Path, comments: Sequence[str], document: Mapping[str, Any]) -> None:
    """Write a configuration below comments; ConfigError, InputError where it could not be run."""
    lines = "".join(f"# {line}\n" for line in comments)
    write_text(path, f"{lines}\n{tomli_w.dumps(document)}")
    # What cannot be run again is reported now, not in the next run.
    written = load_config(path)
    read_ground_table(written.ground.classes, written.engine.readings)


def _comments(
    diagnosis: Diagnosis, sections: Collection[str], config_name: str, stand: bool, left_out: bool
) -> list[str]:
    verdict, recommended = diagnosis.verdict, diagnosis.advice.recommended
    named = f"Named: {effect_name(verdict.effect)}, with a confidence of {verdict.confidence:.2f}"
    added = {*recommended.split("+")} >= {*verdict.effect.split("+")}
    lines = [
        f"Made by sassgis {sassgis.__version__} (gap diagnose) from {config_name} and "
        f"observations of {diagnosis.rocks} rocks.",
        f"Ground classes are as configured ({CLASSES_NAME})."
        if recommended == "configured"
        else f"Ground classes are calibrated to these observations ({CLASSES_NAME}).",
    ]
    if diagnosis.advice.short is not None:
        lines.append("Not recommended: simulated blocks stop too early (unsafe).")
    if diagnosis.advice.why:
        lines.append(f"{diagnosis.advice.why[:1].upper()}{diagnosis.advice.why[1:]}.")
    if verdict.effect == "none":
        lines.append("No effect was named.")
    elif verdict.effect == "unknown":
        lines.append("No known effect explains the gap.")
    elif not added:
        lines.append(f"{named}, but not added: the model has {file_has(recommended)}.")
    elif not set(verdict.effect.split("+")) & set(sections):
        lines.append(
            f"{named}. That is not a part of the motion, so nothing was added to the model."
        )
    else:
        fitted = ", ".join(f"[effects.{name}]" for name in sections)
        lines.append(f"{named}; fitted: {fitted}.")
        if len(verdict.confusion_set) > 1:
            alike = ", ".join(effect_name(e) for e in verdict.confusion_set)
            lines.append(f"The observations do not separate: {alike}.")
    if left_out:
        lines.append(
            "[effects.lateral_deflection] is left out: it turns followed paths, not fall lines."
        )
    if stand:
        lines.append(
            f"The forest ({FOREST_NAME}) is where the observations ask for one, along the fall "
            "lines of the observed rocks; it was not surveyed."
        )
    return [
        *lines,
        "Calibrated for this slope and rocks of these sizes; elsewhere it is untested.",
        "Comments of the original file are not copied.",
    ]


def classes_csv(
    table: GroundTable, configured: GroundTable, provenance: Callable[[GroundClass], str]
) -> str:
    """Return a table of ground classes; changed ones with a sentence and what was before."""
    before = {c.name: c for c in configured.classes}
    classes = []
    for own in table.classes:
        old = before.get(own.name, own)
        pairs = [(c, getattr(old, c), getattr(own, c)) for c in PARAMETERS]
        if changed := ", ".join(f"{c} {a:g}" for c, a, b in pairs if a != b):
            source = f"{provenance(own)}; before: {changed}."
            own = replace(own, source=source, trust="fitted")
        classes.append(own)
    frame = classes_frame(classes)
    return frame.to_csv(index=False, float_format="%.6g", lineterminator="\n")
