"""Fit the calibrated soils to three sites together by CMA-ES (Hansen 2016, arXiv 1604.00772)."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

import cma
import numpy as np
import pandas as pd

from field_cases import contact_scores
from field_cases.kinematics import Values, kinematics, observed, wheel_below_cliff
from field_cases.scores import widest_gap
from sassgis.gap.observations.case import Case
from sassgis.grid import FloatArray
from sassgis.settings.ground import GroundTable

Ranges = Mapping[str, tuple[float, float]]

MEADOW, SLOPE = "soft_meadow", "overgrown_slope"
#: What is searched, with its range: values of both soils; μ_0 of each; the rebound of rock, which
#: lies below the slope at Authume; the standard deviation of the resistance of blocks.
SEARCHED: Ranges = {
    "mu_f": (0.4, 0.9), "dp_max": (0.0, 0.5), "mu_v": (0.0, 0.016), "d_star_m": (0.0, 0.4),
    "restitution": (0.1, 0.9), "restitution_speed_mps": (0.7, 15.0), "eta_max": (0.6, 1.0),
    "rolling_threshold": (0.03, 1.0), "mu_0 meadow": (0.0, 0.45), "mu_0 slope": (0.1, 0.6),
    "rock restitution": (0.2, 0.9), "rock eta_max": (0.5, 0.95),
    "rolling_friction_sd": (0.0, 0.35), "outline_edges": (0.0, 0.3), "outline_share": (0.0, 1.0),
}  # fmt: skip
#: Those of them that are keys of ``[engine]``.
ENGINE = ("rolling_friction_sd", "outline_edges", "outline_share")
_LOG = {"restitution_speed_mps", "rolling_threshold"}
_SOIL = 8
#: Quantiles of each quantity that are met, each with the error of its logarithm that counts as one:
#: less of what a map and a net are made of, more of low quantiles and of hops.
TERMS: Mapping[str, Mapping[float, float]] = {
    "run-out": {0.1: 0.1, 0.5: 0.05, 0.9: 0.07},
    "run-out of": {0.5: 0.07},
    "speed 60 m of": {0.5: 0.1},
    "speed": {0.1: 0.15, 0.5: 0.05, 0.9: 0.05},
    "energy": {0.5: 0.07, 0.9: 0.08},
    "height": {0.5: 0.2, 0.9: 0.15},
    "contacts": {0.1: 0.2, 0.5: 0.08, 0.9: 0.2},
    "greatest speed": {0.1: 0.15, 0.5: 0.07, 0.9: 0.07},
    "spin over speed": {0.5: 0.1},
    "hop length": {0.1: 0.3, 0.5: 0.15, 0.9: 0.15},
    "hop height": {0.5: 0.4, 0.9: 0.3},
}
#: Published quartiles of the speed of the wheel of Chant Sura (m/s), its spin over that of rolling
#: and the height of its centre above that at rest (m), each with the error that counts as one.
WHEEL: Mapping[str, tuple[list[float], float]] = {
    "speed": ([16.0, 17.8, 21.3], 0.07), "rim over speed": ([0.58, 0.69, 0.80], 0.15),
    "height": ([0.4, 0.8, 1.6], 0.7),
}  # fmt: skip
#: Error of the logarithm of R_n and R_t of single contacts, and of the share beyond a gap.
_CONTACT, _BEYOND = 0.5, 0.08
#: Standard deviation of the first sets of values, as a share of the ranges.
_WIDTH = 0.15


@dataclass(frozen=True)
class Sites:
    """What the values are fitted to."""

    tschamut: Case
    authume: Case
    films: pd.DataFrame
    count: int = 4
    seed: int = 1986


def table_of(table: GroundTable, values: Mapping[str, float]) -> GroundTable:
    """The classes of a table with searched values."""
    soil = {name: values[name] for name in list(SEARCHED)[:_SOIL]}
    own: dict[str, dict[str, Any]] = {
        MEADOW: soil | {"mu_0": values["mu_0 meadow"]},
        SLOPE: soil | {"mu_0": values["mu_0 slope"]},
        "rock": {
            "restitution": values["rock restitution"],
            "eta_max": values["rock eta_max"],
        },
    }
    return GroundTable(tuple(replace(c, **own.get(c.name, {})) for c in table.classes))


def engine_of(values: Mapping[str, float]) -> dict[str, float]:
    """Keys of ``[engine]`` with searched values."""
    return {key: values[key] for key in ENGINE}


def values_at(unit: FloatArray, ranges: Ranges = SEARCHED) -> dict[str, float]:
    """Values at a point of the unit cube."""
    found = {}
    for at, (name, (low, high)) in zip(unit.tolist(), ranges.items(), strict=True):
        found[name] = low * (high / low) ** at if name in _LOG else low + at * (high - low)
    return found


def unit_of(values: Mapping[str, float], ranges: Ranges = SEARCHED) -> FloatArray:
    """The point of the unit cube with these values."""
    rows = [
        np.log(values[name] / low) / np.log(high / low)
        if name in _LOG
        else (values[name] - low) / (high - low)
        for name, (low, high) in ranges.items()
    ]
    return np.clip(np.array(rows), 0.0, 1.0)


def built_in(sites: Sites) -> dict[str, float]:
    """Values as they are built in."""
    table = sites.tschamut.table
    meadow, slope, rock = (table.classes[table.index(n)] for n in (MEADOW, SLOPE, "rock"))
    return {
        **{name: float(getattr(meadow, name)) for name in list(SEARCHED)[:_SOIL]},
        "mu_0 meadow": meadow.mu_0, "mu_0 slope": slope.mu_0,
        "rock restitution": rock.restitution, "rock eta_max": rock.eta_max,
        **{key: getattr(sites.tschamut.engine.resolved(), key) for key in ENGINE},
    }  # fmt: skip


def _motion(seen: Values, made: Values) -> dict[str, float]:
    """Misfit of each quantity: mean of the squared errors of its quantiles."""
    found = {}
    for name, values in seen.items():
        kind = name.rsplit(" ", 2)[0] if name.endswith((" m", " kg")) else name
        if kind in TERMS:
            shares, units = map(list, (TERMS[kind], TERMS[kind].values()))
            one, two = (np.maximum(np.quantile(v, shares), 0.05) for v in (values, made[name]))
            found[name] = _mean_square(np.log(two / one) / np.array(units))
    return found


def _mean_square(errors: FloatArray, most: float = 6.0) -> float:
    """Mean of squared errors, each at most so large that no single one decides."""
    return float(np.mean(np.minimum(np.abs(errors), most) ** 2))


def misfit(sites: Sites, values: Mapping[str, float]) -> dict[str, float]:
    """Squared errors in units of those that count as one, by quantity."""
    table = table_of(sites.tschamut.table, values)
    engine = engine_of(values)
    made = kinematics(sites.tschamut, table, sites.count, sites.seed, engine)
    found = _motion(observed(sites.tschamut), made)
    seen = observed(sites.authume)["run-out"]
    slope = table_of(sites.authume.table, values)
    stops = kinematics(sites.authume, slope, sites.count, sites.seed, engine)["run-out"]
    shares = (0.1, 0.25, 0.5, 0.75, 0.9)
    error = np.log(np.quantile(stops, shares) / np.quantile(seen, shares)) / 0.1
    found["Authume run-out"] = 2.0 * _mean_square(error)
    edge = widest_gap(seen)
    found["Authume beyond"] = (float(np.mean(stops > edge) - np.mean(seen > edge)) / _BEYOND) ** 2
    own = table.classes[table.index(MEADOW)]
    wheel = wheel_below_cliff(sites.seed, own, engine)
    for name, (quartiles, unit) in WHEEL.items():
        off = np.log(np.maximum(wheel[name], 0.05) / np.array(quartiles)) / unit
        found[f"Chant Sura {name}"] = _mean_square(off)
    after = contact_scores.simulated(sites.films, table, 100)
    middle = np.median(contact_scores.measures(sites.films, after), axis=1)
    off = np.log(middle / contact_scores.observed(sites.films)[:, 0])[:, :2] / _CONTACT
    for name, column in zip(("R_n", "R_t"), off.T, strict=True):
        found[f"Chant Sura {name}"] = _mean_square(column, 3.0)
    return found


def _total(sites: Sites, unit: FloatArray) -> float:
    return sum(misfit(sites, values_at(unit)).values())


def fitted(sites: Sites, evaluations: int, jobs: int = 2) -> dict[str, float]:
    """Values with the least misfit that are found from the built-in ones.

    Parameters
    ----------
    evaluations : int
        Sets of values that are looked at, about.
    """
    options = {
        "bounds": [0.0, 1.0], "seed": sites.seed, "maxfevals": evaluations, "verbose": -9,
        "popsize": 12,
    }  # fmt: skip
    search = cma.CMAEvolutionStrategy(unit_of(built_in(sites)), _WIDTH, options)
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        while not search.stop():
            points = search.ask()
            search.tell(points, list(pool.map(functools.partial(_total, sites), points)))
    # The favourite is the mean of the last sets: the best one is best by chance.
    return values_at(np.clip(search.result.xfavorite, 0.0, 1.0))
