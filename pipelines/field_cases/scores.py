"""How well simulated stops meet observed ones, and which of many parameter sets does so best."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from field_cases.distances import energy_distance, energy_scores
from field_cases.sites import Simulated, Site, run_out, simulated, table_of
from sassgis.model.settings import EngineSettings

FloatArray = NDArray[np.float64]

SHARES = (0.1, 0.5, 0.9)
#: Parameters that are calibrated, and between what. d_star_m and dp_min are as in the class.
RANGES: Mapping[str, tuple[float, float]] = {
    "eta_max": (0.4, 1.0),
    "restitution": (0.0, 0.6),
    "restitution_speed_mps": (2.0, 10.0),
    "mu_0": (0.22, 0.6),
    "mu_f": (0.4, 0.9),
    "rolling_threshold": (0.1, 2.0),
    "dp_max": (0.1, 0.6),
}
BOOTSTRAPS = 1000
#: Sideways tilts and drifts (degrees) whose widths are compared.
TILTS = (4.0, 7.0, 10.0, 15.0)
DRIFTS = (2.0, 4.0, 6.0)


def quantiles(values: FloatArray) -> FloatArray:
    """At SHARES."""
    return np.quantile(values, SHARES)


def width(offset: FloatArray) -> float:
    """From the 10 to the 90 % quantile (m)."""
    low, _, high = quantiles(offset)
    return float(high - low)


def score(site: Site, made: Simulated, seed: int = 1986) -> dict[str, Any]:
    """Observed and simulated run-out and offset, relative errors with intervals, and the CRPS.

    The intervals (95 %) are of the relative errors: the observed rocks drawn anew.
    """
    seen = run_out(site, site.stops)
    rows = run_out(site, made.stops)
    # Blocks that never start are told apart; they are no stops.
    pool = rows[made.started]
    want, got = quantiles(seen[:, 0]), quantiles(pool[:, 0])
    draw = np.random.default_rng(seed)
    errors = []
    for _ in range(BOOTSTRAPS):
        own = seen[draw.integers(0, len(seen), len(seen))]
        errors.append(
            [*(got / quantiles(own[:, 0]) - 1.0), width(pool[:, 1]) / width(own[:, 1]) - 1.0]
        )
    low, high = np.quantile(errors, [0.025, 0.975], axis=0)
    return {
        "rocks": len(site),
        "observed_m": want,
        "simulated_m": got,
        "error": got / want - 1.0,
        "error_95": np.stack([low[:3], high[:3]], axis=1),
        "mean_gap_m": float(pool[:, 0].mean() - seen[:, 0].mean()),
        "crps_m": float(np.mean(energy_scores(rows[..., :1], seen[:, :1], scale=np.ones(1)))),
        "width_observed_m": width(seen[:, 1]),
        "width_simulated_m": width(pool[:, 1]),
        "width_error": width(pool[:, 1]) / width(seen[:, 1]) - 1.0,
        "width_error_95": [float(low[3]), float(high[3])],
        "left_the_terrain": float(made.left.mean()),
        "never_started": float(1.0 - made.started.mean()),
    }


def design(n: int, seed: int = 10) -> list[dict[str, float]]:
    """Parameter sets, evenly spread over RANGES."""
    low, high = np.array(list(RANGES.values())).T
    rows = qmc.scale(qmc.Sobol(len(RANGES), seed=seed).random(n), low, high)
    return [dict(zip(RANGES, row.tolist(), strict=True)) for row in rows]


def tried(
    site: Site, sets: Sequence[Mapping[str, float]], settings: EngineSettings, count: int
) -> list[Simulated]:
    """The rocks of a site with each set of parameters of its slope, by the same random draws."""
    return [simulated(site, table_of(site, {site.classes[0]: s}), settings, count) for s in sets]


def misfit(site: Site, made: Simulated, rocks: Sequence[int]) -> float:
    """Energy distance of run-out and offset, over the median run-out, of some of the rocks."""
    seen = run_out(site, site.stops)
    unit = np.full(2, np.median(seen[:, 0]))
    own = list(rocks)
    rows = run_out(site, made.stops)[own]
    return float(energy_distance(rows[made.started[own]], seen[own], scale=unit))


def part(made: Simulated, rocks: Sequence[int]) -> Simulated:
    """The simulations of some of the rocks."""
    own = list(rocks)
    return Simulated(made.stops[own], made.left[own], made.started[own])


def widths(sites: Mapping[str, Site], count: int) -> list[dict[str, Any]]:
    """Run-out and width against what turns the heading."""
    rows = []
    for tilt, drift in itertools.product(TILTS, DRIFTS):
        settings = EngineSettings(side_tilt_deg=tilt, drift_deg=drift)
        row: dict[str, Any] = {"side_tilt_deg": tilt, "drift_deg": drift}
        for name, site in sites.items():
            found = score(site, simulated(site, table_of(site), settings, count))
            row[name] = {"error": found["error"], "width_error": found["width_error"]}
        rows.append(row)
    return rows
