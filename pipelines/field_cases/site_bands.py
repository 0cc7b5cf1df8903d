"""Bands of the run-out by the spread of ground classes between sites, beside what was observed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from field_cases.scores import quantiles
from field_cases.sites import Simulated, Site, run_out
from sassgis.io.read.config import load_config
from sassgis.runs.ground_draws import runout_bands
from sassgis.runs.workers import Jobs

#: Draws of the classes, and simulations of each rock on each of them, about.
DRAWS = 60
COUNT = 16


def site_bands(site: Site, made: Simulated, out: Path, jobs: Jobs) -> dict[str, Any]:
    """Middle 80 % of the draws of median and 90 % quantile, and whether it holds the observed one.

    The program measures run-out along the path, the observed stops are known in plan: the limits
    are those along the path over the value with the classes as they are, times its plan distance.

    Parameters
    ----------
    site : Site
    made : Simulated
        With the classes as they are.
    out : Path
        As of runout_bands.
    jobs
        Worker processes.
    """
    each = {"release.rocks_per_point": max(1, round(COUNT / site.points))}
    config = load_config(site.case.config, each)
    seen = quantiles(run_out(site, site.stops)[:, 0])[1:]
    plain = quantiles(run_out(site, made.stops)[made.started, 0])[1:]
    rows = {}
    for name, band, observed, simulated in zip(
        ("median", "q90"), runout_bands(config, DRAWS, out, jobs=jobs), seen, plain, strict=True
    ):
        low, high = simulated * np.array([band.low, band.high]) / band.base
        rows[name] = {
            "observed_m": observed,
            "simulated_m": simulated,
            "band_m": [low, high],
            "holds": bool(low <= observed <= high),
        }
    return rows
