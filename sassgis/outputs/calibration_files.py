"""Files of a calibration: its numbers, the table of classes, configurations to run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import sassgis
from sassgis.files.atomic_output import write_json, write_text
from sassgis.gap.constants import COMPARED_QUANTILES
from sassgis.gap.fit.class_calibration import SiteCalibration, SiteResult
from sassgis.gap.fit.fit_errors import QuantityErrors
from sassgis.outputs.config_template import written_document
from sassgis.outputs.gap_files import classes_csv, write_runnable
from sassgis.outputs.manifest import plain
from sassgis.settings.ground import GroundTable
from sassgis.settings.run_config import Config

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
        "classes_not_told_apart": calibration.alike,
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
    told = [f"{f.parameter.name} {f.low:.2g} to {f.high:.2g}" for f in own if f.identified]
    kept = [f.parameter.name for f in own if not f.identified]
    sites = ", ".join(f"{s.name} ({s.rocks} rocks)" for s in calibration.sites)
    parts = [f"Calibrated by sassgis {sassgis.__version__} on {sites}"]
    if told:
        parts.append("95 % intervals: " + ", ".join(told))
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
