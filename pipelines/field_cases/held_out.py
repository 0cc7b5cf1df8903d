"""``sassgis calibrate`` on some rocks of a site, its configuration run and scored on the others."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from field_cases.scores import (
    bands,
    between,
    crps,
    errors_of,
    quantiles,
    ranks,
    summary,
)
from field_cases.sites import Simulated, Site, simulated
from sassgis.gap.fit.class_calibration import SiteCalibration
from sassgis.grid import FloatArray
from sassgis.inputs.config import load_config
from sassgis.runs.calibrate import calibrate
from sassgis.simulation.workers import Jobs


def held_out(
    site: Site,
    configured: Simulated,
    other: Site,
    work: Path,
    count: int,
    jobs: Jobs,
    draws: int | None = None,
) -> dict[str, Any]:
    """Calibrated on one random half, scored on the other half and at another site.

    Parameters
    ----------
    site : Site
        With one set of observations to fit on and one left out for each division.
    configured : Simulated
        Of all rocks, as configured.
    other : Site
        The other site with the class of this one on its slope.
    work : Path
        For calibrations and runs.
    count : int
        Simulations of each rock.
    jobs, draws
        As of the calibration.
    """
    names = ("left_out", "left_out_configured", "halves_observed", f"at {other.name}")
    errors: dict[str, list[FloatArray]] = {name: [] for name in names}
    gains: dict[str, list[float]] = {"claimed_m": [], "crps_m": []}
    changed = 0
    rank: dict[str, list[FloatArray]] = {name: [] for name in names[:2]}
    divisions = [s for s in site.case.splits if s.startswith("halves")]
    for division in divisions:
        sides = site.case.splits[division]
        fit, left = (site.numbers(side) for side in sides)
        folder = work / f"{site.name}_{division}"
        found = calibrate([site.case.pair(sides[0])], folder, jobs=jobs, draws=draws)
        config = folder / "config.toml"
        made = simulated(site, folder / "run", count, config=config).take(left)
        rocks, before = site.take(left), configured.take(left)
        for name, own in (("left_out", made), ("left_out_configured", before)):
            errors[name].append(errors_of(rocks, own))
            rank[name].append(ranks(rocks, own))
        errors["halves_observed"].append(between(site.take(fit), rocks))
        # None where the configured ground stays.
        classes = load_config(config).ground.classes
        table = {} if classes is None else {"ground.classes": str(classes)}
        strange = simulated(other, folder / "run_elsewhere", count, table)
        errors[names[-1]].append(errors_of(other, strange))
        (claimed,) = (e.gain for e in found.sites[0].errors if e.name == "run-out")
        gains["crps_m"].append(crps(rocks, before) - crps(rocks, made))
        gains["claimed_m"].append(claimed.value)
        changed += classes is not None
    return {
        "halves": len(divisions),
        "rocks_left_out": len(site) // 2,
        **summary(errors),
        "bands": {name: bands(own) for name, own in rank.items()},
        "gain": {name: quantiles(np.array(own)) for name, own in gains.items()},
        "fitted_classes_recommended": changed,
    }


def parameters(found: Mapping[str, SiteCalibration]) -> list[dict[str, Any]]:
    """What calibrations on all rocks of each site say of the parameters."""
    return [
        {
            "site": name,
            "class": f.parameter.class_name,
            "parameter": f.parameter.name,
            "configured": f.parameter.configured,
            "value": f.value,
            "ci95": [f.low, f.high],
            "identified": f.identified,
            "at_limit": bool(f.limit),
        }
        for name, calibration in found.items()
        for f in calibration.fitted
    ]
