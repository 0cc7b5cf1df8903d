"""The former classes of soil, what is added to them step by step, and how far the gap shrinks.

Each step is fitted to some rocks by the energy distance of the diagnosis (CMA-ES, Hansen 2016) and
scored on the others, at Authume, where friction is fitted anew, and at Chant Sura.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cma
import numpy as np
import pandas as pd

from field_cases import contact_scores
from field_cases.kinematics import wheel_below_cliff
from field_cases.sites import Site
from field_cases.soil_fit import ENGINE, MEADOW, SEARCHED, SLOPE, WHEEL, unit_of, values_at
from sassgis.gap.fit.distances import RockDistances, energy_scores, quantiles_of
from sassgis.gap.fit.site_data import SiteData, model_rows, replicas, rows_of, site_data_of
from sassgis.gap.forward.released_rocks import HypothesisModel, configured_model
from sassgis.gap.observations.observed import rock_masses_kg
from sassgis.gap.verdict.model_comparison import Ladder
from sassgis.grid import FloatArray
from sassgis.inputs.ground_map import built_in_table
from sassgis.outputs.gap_files import classes_csv
from sassgis.runs.calibrate import read_case
from sassgis.settings.ground import GroundTable
from sassgis.settings.settings import EngineSettings

#: Values of classes and engine before the ground resisted with the speed and blocks had outlines.
#: Those of the soils were fitted to the stops of their sites.
_SOIL = {
    "eta_max": 0.85, "dp_min": 0.0, "dp_max": 0.30, "mu_f": 0.60, "k": 0.17, "d_star_m": 0.12,
    "restitution": 0.50, "restitution_speed_mps": 9.144, "rolling_threshold": 1.0, "mu_v": 0.0,
}  # fmt: skip
_HARD = {"restitution_speed_mps": 9.144, "mu_v": 0.0}
FORMER: Mapping[str, Mapping[str, float]] = {
    MEADOW: {**_SOIL, "mu_0": 0.31},
    SLOPE: {**_SOIL, "mu_0": 0.36},
    "rock": {**_HARD, "eta_max": 0.75, "mu_f": 0.70, "restitution": 0.65},
    "debris": {**_HARD, "eta_max": 0.80, "mu_0": 0.52, "restitution": 0.55},
}
FORMER_ENGINE: Mapping[str, float] = {
    "rolling_friction_sd": 0.15, "outline_edges": 0.0, "outline_share": 1.0, "drift_deg": 4.0,
}  # fmt: skip
FORMER_NAME, BUILT_IN = "former", "built-in"
#: What can be added, with the values that it sets free.
PARTS: Mapping[str, tuple[str, ...]] = {
    "resistance": ("mu_v",),
    "rebound": ("restitution", "restitution_speed_mps", "eta_max"),
    "unevenness": ("dp_max", "d_star_m", "rolling_threshold"),
    "outline": ENGINE,
}
#: Free in each step, and fitted anew at each site: a class has the friction of its site.
FRICTION = ("mu_0", "mu_f")
ALL, REST = "everything", "everything but resistance"
#: Parts of each step, and the step beyond which its gain counts.
STEPS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "friction": ((), FORMER_NAME),
    **{part: ((part,), "friction") for part in PARTS},
    "resistance and rebound": (("resistance", "rebound"), "resistance"),
    REST: (tuple(part for part in PARTS if part != "resistance"), "outline"),
    ALL: (tuple(PARTS), REST),
}
RANGES = {**SEARCHED, "mu_0": (0.0, 0.6)}
#: Trials of a search for each free value, and their first spread as a share of the ranges.
TRIALS_EACH, WIDTH = 80, 0.2
#: Campaigns of a trial and of a score, and their numbers.
TRIED, SCORED, TRIED_NUMBER, SCORED_NUMBER = 6, 24, 1, 2
#: Quantiles of the rocks whose errors are stated, samples of the rocks for their intervals, and
#: draws of each filmed contact.
SHARES, SAMPLES, DRAWS = (0.1, 0.5, 0.9), 999, 200

Quantities = Mapping[str, FloatArray]


def changed(table: GroundTable, values: Mapping[str, Mapping[str, Any]]) -> GroundTable:
    """The classes of a table with other values, by class."""
    return GroundTable(tuple(replace(c, **values.get(c.name, {})) for c in table.classes))


def former_sections(out: Path) -> dict[str, str]:
    """Lines of a configuration with the former values; writes their table of classes."""
    built_in, file = built_in_table(), out / "former_classes.csv"
    text = classes_csv(changed(built_in, FORMER), built_in, lambda _: "values of a former version")
    file.write_text(text, encoding="utf-8")
    keys = "\n".join(f"{key} = {value!r}" for key, value in FORMER_ENGINE.items())
    return {"ground": f'classes = "{file.name}"', "engine": keys}


def built_in(ground: str) -> dict[str, float]:
    """Values of a class and of the engine as they are built in."""
    table, engine = built_in_table(), EngineSettings().resolved()
    own = table.classes[table.index(ground)]
    return {name: float(getattr(own, name)) for name in FORMER[ground]} | {
        key: float(getattr(engine, key)) for key in FORMER_ENGINE
    }


def model_of(
    problem: SiteData, ground: str, values: Mapping[str, float]
) -> tuple[SiteData, HypothesisModel]:
    """A site, and its model, with other values of a class and of the engine."""
    engine = {key: value for key, value in values.items() if key in FORMER_ENGINE}
    own = {name: value for name, value in values.items() if name not in FORMER_ENGINE}
    case = replace(problem.case, engine=replace(problem.case.engine, **engine))
    model = configured_model(case, changed(case.table, {ground: own}))
    return replace(problem, case=case), model


def fitted(
    problem: SiteData, ground: str, names: Sequence[str], held: Mapping[str, float]
) -> dict[str, float]:
    """Values near the least energy distance, by a search that begins at the former ones."""
    ranges = {name: RANGES[name] for name in names}

    def distance(unit: FloatArray) -> float:
        own, model = model_of(problem, ground, {**held, **values_at(unit, ranges)})
        rows = model_rows(own, model, TRIED_NUMBER, TRIED)
        return RockDistances.of(problem.rows, rows).value()

    options = {
        "bounds": [0.0, 1.0], "seed": problem.seed, "maxfevals": TRIALS_EACH * len(names),
        "verbose": -9, "popsize": 10,
    }  # fmt: skip
    start = unit_of({**FORMER[ground], **FORMER_ENGINE}, ranges)
    search = cma.CMAEvolutionStrategy(start, WIDTH, options)
    search.optimize(distance)
    # The best set is best by chance: the mean of the last ones is kept.
    return {**held, **values_at(np.clip(search.result.xfavorite, 0.0, 1.0), ranges)}


@dataclass(frozen=True)
class Halves:
    """A site of which half of the rocks are fitted."""

    ground: str
    fit: SiteData
    left_out: SiteData

    @classmethod
    def of(cls, site: Site, seed: int) -> Halves:
        """Read the halves of a site."""
        sides = (read_case(*site.case.pair(side)) for side in site.case.splits["halves"])
        return cls(site.slope, *(site_data_of(case, seed) for case in sides))


def fit_step(meadow: Halves, slope: Halves, step: str) -> tuple[dict[str, float], ...]:
    """Values of a step at both sites: all but friction are carried over."""
    parts, _ = STEPS[step]
    names = [*FRICTION, *(name for part in parts for name in PARTS[part])]
    values = fitted(meadow.fit, meadow.ground, names, {})
    carried = {name: value for name, value in values.items() if name not in FRICTION}
    return values, fitted(slope.fit, slope.ground, FRICTION, carried)


def added_steps(tschamut: Site, authume: Site, data: Path, jobs: int, seed: int) -> dict[str, Any]:
    """Fit each step on half of the rocks at Tschamut; score it on the others and elsewhere."""
    meadow, slope = (Halves.of(site, seed) for site in (tschamut, authume))
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        # The longest first.
        order = sorted(STEPS, key=lambda step: -len(STEPS[step][0]))
        fits = pool.map(functools.partial(fit_step, meadow, slope), order)
        found = dict(zip(order, fits, strict=True))
    models = {FORMER_NAME: ({}, {}), **{step: found[step] for step in STEPS}}
    models[BUILT_IN] = built_in(MEADOW), built_in(SLOPE)
    here = {name: own for name, (own, _) in models.items()}
    there = {name: own for name, (_, own) in models.items()}
    ladder, motion = scored(meadow.left_out, meadow.ground, here)
    films = contact_scores.filmed(data)
    everything = site_data_of(read_case(*tschamut.case.pair("all")), seed)
    return {
        "steps": {step: over for step, (_, over) in STEPS.items()},
        "values": here,
        "values_authume": there,
        "tschamut": ladder,
        "authume": scored(slope.left_out, slope.ground, there)[0],
        "chant_sura": {name: below_cliff(films, own, seed) for name, own in here.items()},
        "where": scored(everything, meadow.ground, {FORMER_NAME: {}})[1][FORMER_NAME],
        "left_out": motion,
    }


def scored(
    problem: SiteData, ground: str, models: Mapping[str, Mapping[str, float]]
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Distances and shares of models on the rocks of a site, and errors of what they measure."""
    ladder, motion = Ladder(problem), {}
    seen = measured(problem, problem.quantities)
    for name, values in models.items():
        own, model = model_of(problem, ground, values)
        samples = replicas(own, model, SCORED_NUMBER, SCORED)
        over = STEPS[name][1] if name in STEPS else FORMER_NAME
        ladder.add(name, over, rows_of(problem, samples))
        made = [measured(problem, one) for one in samples]
        motion[name] = {
            q: errors(seen[q], np.stack([one[q] for one in made]), problem.seed) for q in seen
        }
    rungs = [
        {"rung": r.rung, "distance": r.distance, "share": r.share, "ci95": r.ci95,
         "gain": r.gain, "gain_ci95": r.gain_ci95}
        for r in ladder.rungs(*models)
    ]  # fmt: skip
    return rungs, motion


def measured(problem: SiteData, quantities: Quantities) -> dict[str, FloatArray]:
    """Run-out, speeds, energies of translation and heights by distance, contacts; (n_rocks,)."""
    found = {"run-out": quantities["stop:runout"]}
    mass = rock_masses_kg(problem.case.observations)
    for k, place in enumerate(problem.case.station_names):
        speed = np.exp(quantities[f"S{k}:speed"])
        found[f"speed {place}"] = speed
        found[f"energy {place}"] = 5e-4 * mass * speed**2
        found[f"height {place}"] = quantities[f"S{k}:height"]
    if "contacts:contacts" in quantities:
        found["contacts"] = quantities["contacts:contacts"]
    return found


def errors(seen: FloatArray, made: FloatArray, seed: int) -> dict[str, Any]:
    """Quantiles, observed and simulated, and relative errors with 95 % intervals over rocks.

    Parameters
    ----------
    seen : float64, shape (n_rocks,)
        NaN where there is none.
    made : float64, shape (m, n_rocks)
    """

    def relative(rocks: Any) -> FloatArray:
        return _quantiles(made[:, rocks]) / _quantiles(seen[rocks]) - 1.0

    rng = np.random.default_rng([seed, 7])
    n = seen.size
    drawn = np.array([relative(rng.integers(0, n, n)) for _ in range(SAMPLES)])
    return {
        "rocks": int(np.isfinite(seen).sum()),
        "observed": _quantiles(seen),
        "simulated": _quantiles(made),
        "error": relative(np.arange(n)),
        "ci95": np.quantile(drawn, [0.025, 0.975], axis=0).T,
    }


def _quantiles(values: FloatArray) -> FloatArray:
    return quantiles_of(values[np.isfinite(values)], SHARES)


def below_cliff(films: pd.DataFrame, values: Mapping[str, float], seed: int) -> dict[str, Any]:
    """What the block of 780 kg at Chant Sura does with values of Tschamut.

    Quartiles of its speed below the cliff, and the mean energy score of its filmed contacts, in
    units of the scatter of what was observed after them.
    """
    engine = {**FORMER_ENGINE, **{k: v for k, v in values.items() if k in FORMER_ENGINE}}
    own = {k: v for k, v in values.items() if k not in FORMER_ENGINE}
    table = changed(changed(built_in_table(), FORMER), {MEADOW: own})
    wheel = wheel_below_cliff(seed, table.classes[table.index(MEADOW)], engine)
    after = films[list(contact_scores.AFTER)].to_numpy(float)
    unit = after.std(axis=0, ddof=1)
    made = contact_scores.simulated(films, table, DRAWS, seed)
    scores = energy_scores(after / unit, np.swapaxes(made / unit, 0, 1))
    medians = np.median(contact_scores.measures(films, made), axis=(0, 1))
    return {
        "speed": wheel["speed"],
        "speed_error": np.divide(wheel["speed"], WHEEL["speed"][0]) - 1.0,
        "contacts": len(films),
        "energy_score": float(scores.mean()),
        "r_n": medians[0],
        "r_t": medians[1],
        "observed": np.median(contact_scores.observed(films), axis=(0, 1))[:2],
    }
