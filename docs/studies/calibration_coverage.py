"""Do the intervals of a calibration hold the truth? Simulation-based calibration.

    python docs/studies/calibration_coverage.py -o OUT [--campaigns 20] [--jobs 1]
    python docs/studies/calibration_coverage.py -o OUT --site CONFIG OBSERVATIONS --class NAME ...

Parameters are drawn from the prior, a campaign of the model with them takes the place of what was
observed, and is calibrated (Talts et al. 2018, arXiv:1804.06788). If intervals hold, the ranks of
the truth among the samples of the posterior are uniform, and 80 % intervals hold 80 % of it.
Without a site a synthetic one is made: a cliff, talus and a meadow, rocks with passages and stops.
Takes some seconds a campaign. Writes ``results.json``.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

sys.path.append(str(Path(__file__).resolve().parents[2] / "pipelines"))

from gap_check.make import make_world
from gap_check.observers import CONFIG_NAME, OBSERVATIONS_NAME, write_case
from gap_check.worlds import WorldSpec

import sassgis
from sassgis.gap.fit.class_calibration import calibration_task, run_site, run_trial, search
from sassgis.gap.fit.parameters import fitted_names, parameters_of, prior_shares, table_with
from sassgis.gap.fit.site_data import site_data_of
from sassgis.gap.forward.released_rocks import configured_model
from sassgis.gap.observations.case import Case
from sassgis.inputs.ground_map import read_ranges
from sassgis.runs.calibrate import read_case
from sassgis.simulation.workers import task_map

#: Samples of the posterior among which the truth has a rank.
SAMPLES = 99
LEVELS = (0.8, 0.95)
#: Numbers of the campaigns that stand for what was observed: no calibration uses them.
_TRUTH = 900_000
#: Parts of the ranks that are counted.
_BINS = 5


def synthetic(folder: Path, kind: str, rocks: int) -> Case:
    """A synthetic site; of its observations only what was measured of which rock is used."""
    world = make_world(WorldSpec("cliff_talus_meadow", (), rocks, kind), 31)
    write_case(world, folder, "synthetic", 1)
    return read_case(folder / CONFIG_NAME, folder / OBSERVATIONS_NAME)


def campaign(
    case: Case,
    classes: Sequence[str],
    names: Sequence[str],
    seed: int,
    draws: int | None,
    jobs: int,
) -> list[dict[str, Any]]:
    """Draw a truth, simulate and calibrate; a row for each parameter."""
    rules = read_ranges(case.table)
    parameters = parameters_of(case.table, classes, names, rules)
    level = np.random.default_rng([seed, 17]).random(len(parameters))
    truth = prior_shares(parameters, stats.norm.ppf(level))
    model = configured_model(case, table_with(case.table, parameters, truth))
    problem = site_data_of(case, seed, simulated=model, number=_TRUTH + seed, sideways=False)
    task = calibration_task([problem], classes, names, rules, seed)
    with task_map(task, jobs) as run:
        found = search(
            task, lambda new: list(run(run_trial, new)), lambda due: list(run(run_site, due)), draws
        )
    samples = found.posterior.samples
    few = samples[np.random.default_rng([seed, 18]).choice(len(samples), SAMPLES, replace=False)]
    rows = []
    for k, fitted in enumerate(found.fitted):
        held = [
            bool(
                np.diff(np.sign(np.quantile(samples[:, k], [0.5 - p / 2, 0.5 + p / 2]) - truth[k]))
            )
            for p in LEVELS
        ]
        rows.append(
            {
                "campaign": seed, "parameter": fitted.parameter.label,
                "truth": float(fitted.parameter.value(truth[k])), "value": fitted.value,
                "rank": int((few[:, k] < truth[k]).sum()), "narrowed": fitted.narrowed,
                "off_sd": float((truth[k] - samples[:, k].mean()) / samples[:, k].std()),
                "held": held,
            }
        )  # fmt: skip
    return rows


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Ranks and coverage by parameter, and of all."""
    labels = list(dict.fromkeys(r["parameter"] for r in rows))
    found = []
    for label in (*labels, "all"):
        own = [r for r in rows if label in (r["parameter"], "all")]
        ranks = np.array([r["rank"] for r in own])
        bins = np.bincount(ranks * _BINS // (SAMPLES + 1), minlength=_BINS)
        found.append(
            {
                "parameter": label, "intervals": len(own), "ranks": bins.tolist(),
                "p_uniform": float(stats.chisquare(bins).pvalue),
                "held": np.array([r["held"] for r in own]).sum(axis=0).tolist(),
                "off_sd": float(np.std([r["off_sd"] for r in own])),
                "narrowed": float(np.median([r["narrowed"] for r in own])),
            }
        )  # fmt: skip
    return found


def main() -> None:
    """Calibrate synthetic campaigns and count what their intervals hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--site", nargs=2, type=Path, metavar=("CONFIG", "OBSERVATIONS"))
    parser.add_argument("--class", dest="classes", action="append")
    parser.add_argument("--parameter", dest="names", action="append")
    parser.add_argument("--observed", default="both", help="of the synthetic site")
    parser.add_argument("--rocks", type=int, default=40, help="of the synthetic site")
    parser.add_argument("--campaigns", type=int, default=20)
    parser.add_argument("--seed", type=int, default=101, help="of the first campaign")
    parser.add_argument("--draws", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1, "blas"):
        if given.site:
            case = read_case(*given.site)
        else:
            case = synthetic(Path(folder) / "case", given.observed, given.rocks)
        names = fitted_names(given.names or ("eta_max", "mu_f", "mu_0"), [case.engine])
        rows: list[dict[str, Any]] = []
        for seed in range(given.seed, given.seed + given.campaigns):
            rows += campaign(
                case, given.classes or ("talus",), names, seed, given.draws, given.jobs
            )
            content = {
                "program": f"sassgis {sassgis.__version__}", "rocks": case.n_rocks,
                "tables": [n for n, t in case.observations.tables.items() if len(t)],
                "samples": SAMPLES, "levels": LEVELS, "summary": summary(rows), "rows": rows,
            }  # fmt: skip
            text = json.dumps(content) + "\n"
            (given.output / "results.json").write_text(text, encoding="utf-8")
            print(seed, [(r["rank"], round(r["off_sd"], 2)) for r in rows if r["campaign"] == seed])


if __name__ == "__main__":
    main()
