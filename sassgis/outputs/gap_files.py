"""Files of a diagnosis and of a calibration: numbers, map, classes, configurations to run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import tomli_w

import sassgis
from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.files.atomic_output import write_json, write_text, writing
from sassgis.gap.advice.power import STRENGTHS, TABLE_SETS, CampaignPower
from sassgis.gap.constants import COMPARED_QUANTILES, PLANNED_ROCKS
from sassgis.gap.diagnosis import Diagnosis, as_json
from sassgis.gap.fit.class_calibration import SiteCalibration, SiteResult
from sassgis.gap.fit.fit_errors import QuantityErrors
from sassgis.gap.observations.case import Case
from sassgis.gap.words import effect_name, file_has
from sassgis.inputs.config import load_config
from sassgis.inputs.ground_map import read_ground_table
from sassgis.inputs.in_memory import classes_frame
from sassgis.outputs.config_template import written_document
from sassgis.outputs.frames import write_table
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.layers import gap_map
from sassgis.outputs.manifest import plain
from sassgis.settings.blocks import ForestPlace
from sassgis.settings.ground import PARAMETERS, GroundClass, GroundTable
from sassgis.settings.map_run import Config
from sassgis.settings.schema import declared

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


#: The table of the fitted classes.
FITTED_NAME = "fitted_classes.csv"


def write_calibration_json(path: Path, calibration: SiteCalibration) -> None:
    """Write ``calibration.json``: all numbers of a calibration."""
    content = {
        "program": f"sassgis {sassgis.__version__}",
        "seed": calibration.seed,
        "draws": calibration.draws,
        "recommendation": calibration.recommendation,
        "recommended": "calibrated" if calibration.recommended else "configured",
        "gain_left_out": calibration.gain,
        "findings": calibration.findings,
        "parameters": [
            {
                "class": f.parameter.class_name,
                "parameter": f.parameter.name,
                "configured": f.parameter.configured,
                "value": f.value,
                "ci95": [f.low, f.high],
                "prior_sd": f.parameter.spread,
                "range": [f.parameter.limits.low, f.parameter.limits.high],
                "identified": f.identified,
                "width_over_prior": f.narrowed,
                "at_limit": f.limit or None,
            }
            for f in calibration.fitted
        ],
        "identified_combinations": calibration.combinations,
        "trade_offs": calibration.trade_offs,
        "as_good": calibration.as_good,
        "indistinguishable_classes": calibration.alike,
        "sites_contradict": calibration.contradict,
        "sites": [_site(site) for site in calibration.sites],
    }
    write_json(path, plain(content, 6))


def _site(site: SiteResult) -> dict[str, Any]:
    return {
        "name": site.name,
        "rocks": site.rocks,
        "tables": site.tables,
        "score": site.score,
        "own_score": site.own_score,
        "own_parameters": site.own,
        "gain_left_out": site.gain,
        "scores": [
            {"table": t.table, "rocks": t.rocks, **t.score, "gain_left_out": t.gain}
            for t in site.scores
        ],
        "errors": [_errors(e) for e in site.errors],
    }


def _errors(e: QuantityErrors) -> dict[str, Any]:
    return {
        "quantity": e.name,
        "unit": e.unit,
        "rocks": e.rocks,
        "shares": COMPARED_QUANTILES,
        "observed": e.observed,
        "simulated": e.quantiles,
        "crps": e.crps,
        "median_error": e.median_error,
        "crps_gain_left_out": e.gain,
    }


def write_classes(path: Path, calibration: SiteCalibration, configured: GroundTable) -> None:
    """Write the table of ground classes with the provenance of each calibrated one."""
    text = classes_csv(
        calibration.table(configured), configured, lambda c: class_provenance(calibration, c.name)
    )
    write_text(path, text)


def class_provenance(calibration: SiteCalibration, name: str) -> str:
    """State in a sentence where the values of a calibrated class come from."""
    own = [f for f in calibration.fitted if f.parameter.class_name == name]
    stated = [f"{f.parameter.name} {f.low:.2g} to {f.high:.2g}" for f in own if f.identified]
    kept = [f.parameter.name for f in own if not f.identified]
    sites = ", ".join(f"{s.name} ({s.rocks} rocks)" for s in calibration.sites)
    parts = [f"Calibrated by sassgis {sassgis.__version__} on {sites}"]
    if stated:
        parts.append("95 % intervals: " + ", ".join(stated))
    if kept:
        parts.append("not identified by itself: " + ", ".join(kept))
    alike = [b if a == name else a for a, b in calibration.alike if name in (a, b)]
    if alike:
        parts.append("not distinguishable from " + ", ".join(alike))
    limits = [f.parameter.name for f in own if f.limit]
    if limits:
        parts.append("at the limit of its range: " + ", ".join(limits))
    for site in calibration.sites:
        for e in site.errors:
            if e.name == "run-out":
                parts.append(
                    f"on rocks of {site.name} left out: median run-out "
                    f"{100 * e.median_error['left out'].value:+.0f} %, "
                    f"CRPS {e.crps['left out']:.3g} m"
                )
    if calibration.contradict:
        parts.append("the sites contradict each other: fits none of them well")
    return "; ".join(parts)


def write_calibrated_config(path: Path, config: Config, calibration: SiteCalibration) -> Path:
    """Write a configuration with the recommended ground: the fitted classes or what was configured.

    ConfigError, InputError if the result could not be used in a run.
    """
    document = written_document(config, path)
    if calibration.recommended:
        document.setdefault("ground", {})["classes"] = FITTED_NAME
    comments = [
        f"Made by sassgis {sassgis.__version__} (calibrate) from {config.label} and "
        f"observations of {calibration.rocks} rocks.",
        calibration.recommendation,
        f"{FITTED_NAME} has the fitted classes and says where each value comes from.",
        "They are fitted to these sites and rocks of these sizes; elsewhere they are untested.",
        "Comments of the original file are not copied.",
    ]
    write_runnable(path, comments, document)
    return path


#: Columns of the table of planned campaigns.
POWER_COLUMNS = ("cause", "tables", "rocks", "weakest_named", "parameter", "value")


def write_power(path: Path, power: CampaignPower) -> None:
    """Write which effects campaigns would name: a row for each cause, set of tables and rocks."""
    rows = []
    for cause, (k, tables), rocks in itertools.product(
        power.causes, enumerate(TABLE_SETS), PLANNED_ROCKS
    ):
        least = power.least(cause, k, rocks)
        stated = ("", "") if least is None else (STRENGTHS[cause].reported, f"{least.value:.3g}")
        strength = "not named" if least is None else least.trial.strength
        rows.append((cause, " ".join(sorted(tables)), rocks, strength, *stated))
    write_table(path, [pd.DataFrame(rows, columns=POWER_COLUMNS)])
