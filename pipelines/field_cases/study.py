"""A field case from end to end: untuned gap, diagnosis, and its score on rocks left out."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import energy_distance

import sassgis
from field_cases.sites import Site
from field_cases.tables import FieldCase, fresh, in_one_line, parser, write_json
from sassgis.gap.diagnosis import GapFinding
from sassgis.gap.fit.distances import Interval, bootstrap_interval, energy_scores
from sassgis.gap.forward.observation_operator import campaigns
from sassgis.gap.forward.released_rocks import HypothesisModel, configured_model
from sassgis.gap.forward.rock_lines import rock_lines_of
from sassgis.gap.observations.case import Case, main_blocks, observed_campaign
from sassgis.gap.residuals.residual_table import residuals_of
from sassgis.gap.residuals.rock_residuals import mean_gap_tests
from sassgis.gap.verdict.verdict import where
from sassgis.grid import FloatArray
from sassgis.runs.calibrate import calibrate, read_case
from sassgis.runs.diagnose import diagnose

#: Campaigns that each model is let go in.
CAMPAIGNS = 60
DRAWS = 1000
#: Rocks below which nothing is diagnosed.
FEWEST = 5
#: Findings that are kept.
SHOWN = 12
#: Within this of the end of a line, a rock has left it (m).
END_M = 3.0
QUANTITIES = ("runout_m", "aside_m")


def command(doc: str | None, write: Callable[[Path, Path], Site]) -> None:
    """Command line of a site with stops: write the case, diagnose one half, score on the other.

    Raises
    ------
    SystemExit
        With one line, if a file cannot be used.
    """
    given = parser(doc).parse_args()

    def main() -> None:
        site = write(given.data, fresh(given.output))
        study(site.case, given, site.groups)

    in_one_line(main)


def study(
    case: FieldCase,
    given: argparse.Namespace,
    groups: Mapping[str, str],
    more: Mapping[str, Any] | None = None,
) -> None:
    """Write ``results.json``.

    Parameters
    ----------
    given : Namespace
        Arguments of the pipeline.
    groups : mapping of rock to group
        In which the untuned gap is told apart.
    more : mapping, optional
        Results of the pipeline's own.
    """
    out: Path = given.output
    everything = read_case(*case.pair("all"))
    results: dict[str, Any] = {
        "program": f"sassgis {sassgis.__version__}",
        "seed": given.seed,
        "notes": list(case.notes),
        "rocks": everything.n_rocks,
        **(more or {}),
    }
    if len(everything.observations.deposits):
        seen, made = stops(everything, configured_model(everything), given.seed)
        labels = [groups[name] for name in everything.observations.rock_names]
        results["untuned"] = compare(seen, made, labels, given.seed)
        results["between_groups_p"] = between_groups(seen - made.mean(axis=1), labels, given.seed)
        results["apparent_friction"] = apparent_friction(everything, labels)
    residuals = residuals_of(everything, configured_model(everything), seed=given.seed)
    found = where(everything, residuals, seed=given.seed)
    results["untuned_where"] = [_finding(f) for f in found[:SHOWN]]
    if not given.case_only:
        results["splits"] = {
            split: diagnosed(case, split, fit, left_out, given)
            for split, (fit, left_out) in case.splits.items()
            if len(read_case(*case.pair(fit)).observations.rocks) >= FEWEST
        }
    write_json(out / "results.json", results)
    print(f"Wrote {out / 'results.json'}")


def stops(case: Case, model: HypothesisModel, seed: int) -> tuple[FloatArray, FloatArray]:
    """Chainage and distance aside of stops (m).

    Returns
    -------
    observed : float64, shape (n_rocks, 2)
    predicted : float64, shape (n_rocks, CAMPAIGNS, 2)
        With the stated errors of position.
    """
    n = case.n_rocks
    made = campaigns(case, rock_lines_of(case), model, count=CAMPAIGNS, seed=seed)
    samples = [observed_campaign(case), *made]
    found = np.full((len(samples), n, 2), np.nan)
    for k, sample in enumerate(samples):
        if sample.deposits is None:
            continue
        row = main_blocks(sample.deposits, n)
        known = row >= 0
        found[k, known] = np.c_[sample.deposits.s, sample.deposits.lateral_m][row[known]]
    return found[0], found[1:].transpose(1, 0, 2)


def compare(
    seen: FloatArray, made: FloatArray, labels: list[str], seed: int
) -> dict[str, dict[str, Any]]:
    """Observed and predicted stops, all together and by group.

    The gap of a rock is what was observed less the mean of its own predictions; intervals are
    bootstrapped over rocks, p is adjusted for the number of groups.
    """
    rng = np.random.default_rng(seed)
    gap = seen - made.mean(axis=1)
    names = ["all", *sorted(set(labels))]
    member = np.array([[g in ("all", label) for g in names] for label in labels])
    columns = np.where(member[:, 1:, None], gap[:, None, :], np.nan).reshape(len(gap), -1)
    _, _, adjusted = mean_gap_tests(columns, draws=DRAWS, rng=rng)
    p_of = adjusted.reshape(-1, 2)
    report: dict[str, dict[str, Any]] = {}
    for g, name in enumerate(names):
        rows = np.flatnonzero(member[:, g])
        one: dict[str, Any] = {"rocks": rows.size}
        for q, quantity in enumerate(QUANTITIES):
            interval = _mean_interval(gap[rows, q], rng)
            values, drawn = seen[rows, q], made[rows, :, q].ravel()
            one[quantity] = {
                "observed": np.quantile(values, [0.1, 0.5, 0.9]),
                "predicted": np.quantile(drawn, [0.1, 0.5, 0.9]),
                "gap": interval.value,
                "ci95": [interval.low, interval.high],
                "p_adjusted": p_of[g - 1, q] if g else None,
                "energy_distance_m": _distance(values, drawn),
                "observed_abs_median": float(np.median(np.abs(values))),
                "predicted_abs_median": float(np.median(np.abs(drawn))),
            }
        report[name] = one
    return report


def _mean_interval(values: FloatArray, rng: np.random.Generator) -> Interval:
    """Of the mean of a value of each rock."""

    def mean(rows: NDArray[np.int64]) -> float:
        return float(values[rows].mean())

    return bootstrap_interval(mean, np.arange(values.size), draws=DRAWS, rng=rng)


def _distance(one: FloatArray, other: FloatArray) -> float:
    """2 E|X − Y| − E|X − X'| − E|Y − Y'| (Székely and Rizzo 2013) of what is known."""
    x, y = (own[np.isfinite(own)] for own in (one, other))
    return float(energy_distance(x, y) ** 2) if x.size and y.size else float("nan")


def left_out_scores(config: Path, observed: Path, seed: int) -> dict[str, Any]:
    """Stops of rocks that were left out, simulated by a configuration: run-out and its scores."""
    other = read_case(config, observed)
    seen, made = stops(other, configured_model(other), seed)
    gap = (seen - made.mean(axis=1))[:, 0]
    interval = _mean_interval(gap, np.random.default_rng([seed, 3]))
    shift, sideways = (_distance(seen[:, q], made[:, :, q].ravel()) for q in (0, 1))
    ends = other.profiles.s[other.profiles.offset[1:] - 1][other.line]
    return {
        "rocks": gap.size,
        "observed": np.quantile(seen[:, 0], [0.1, 0.5, 0.9]),
        "predicted": np.quantile(made[:, :, 0], [0.1, 0.5, 0.9]),
        "gap_m": interval.value,
        "ci95": [interval.low, interval.high],
        "crps_m": float(np.mean(energy_scores(seen[:, :1], np.swapaxes(made[:, :, :1], 0, 1)))),
        "energy_distance_m": shift,
        "aside_energy_distance_m": sideways,
        # A run-out at the end of the line is at least that.
        "to_the_end": float(np.mean(made[:, :, 0] > ends[:, None] - END_M)),
    }


def between_groups(gap: FloatArray, labels: list[str], seed: int) -> dict[str, float]:
    """Whether the gap differs from group to group: p of the spread of the means of the groups.

    Groups are shuffled among the rocks.
    """
    rng = np.random.default_rng([seed, 9])
    names, own = np.unique(labels, return_inverse=True)
    size = np.bincount(own)

    def between(values: FloatArray) -> float:
        means = np.bincount(own, values) / size
        return float((size * (means - values.mean()) ** 2).sum())

    found = {}
    for q, quantity in enumerate(QUANTITIES):
        values = gap[:, q]
        reached = sum(
            between(rng.permutation(values)) >= between(values) * (1.0 - 1e-12)
            for _ in range(DRAWS)
        )
        found[quantity] = (reached + 1.0) / (DRAWS + 1.0) if names.size > 1 else 1.0
    return found


def apparent_friction(case: Case, labels: list[str]) -> dict[str, float]:
    """Drop over run-out of the observed stops (tan of the angle of reach), median of each group."""
    put = case.projected["deposits"]
    rock = case.observations.rock_of("deposits")
    top = np.array([np.interp(0.0, *case.profiles.vertices(i)) for i in case.line.tolist()])
    tangent = (top[rock] - put.ground_m) / put.s
    own = np.array(labels)[rock]
    return {name: float(np.median(tangent[own == name])) for name in sorted(set(labels))}


def _finding(found: GapFinding) -> dict[str, Any]:
    names = ("place", "phase", "quantity", "test", "gap", "unit", "ci95", "p_adjusted", "rocks")
    return {name: getattr(found, name) for name in names}


def diagnosed(
    case: FieldCase, split: str, fit: str, left_out: str, given: argparse.Namespace
) -> dict[str, Any]:
    """Calibrate and diagnose on the rocks to fit on; score both models on those left out."""
    folder = given.output / f"diagnosis_{split}".replace(" ", "_")
    answer = diagnose(*case.pair(fit), folder, jobs=given.jobs, seed=given.seed)
    verdict, shrinkage = answer.verdict, answer.shrinkage
    report: dict[str, Any] = {
        "fitted_on": answer.rocks,
        "first_sentence": answer.first_sentence,
        "verdict": verdict.effect,
        "base": verdict.base,
        "confidence": verdict.confidence,
        "confusion_set": verdict.confusion_set,
        "reason": verdict.reason,
        "which": [
            {"effect": c.effect, "form": c.form, "gain": c.gain, "probability": c.probability}
            for c in answer.which
        ],
        "ladder": [
            {"rung": r.rung, "distance": r.distance, "share": r.share, "ci95": r.ci95}
            for r in answer.ladder
        ],
        "shrinkage": {"value": shrinkage.value, "ci95": shrinkage.ci95, "note": shrinkage.note},
        "where": [_finding(f) for f in answer.where[:SHOWN]],
        "cannot_tell": answer.not_identifiable,
        "measure_next": answer.measure_next,
    }  # fmt: skip
    if left_out and (case.observations[left_out] / "deposits.csv").is_file():
        own = given.output / f"calibrated_{split}"
        found = calibrate([case.pair(fit)], own, jobs=given.jobs, seed=given.seed)
        report["calibrated"] = {f.parameter.label: f.value for f in found.fitted}
        models = {
            "uncalibrated": case.config,
            "sassgis calibrate": own / "config.toml",
            "sassgis gap diagnose": folder / "model" / "config.toml",
        }
        report["left_out"] = {
            name: left_out_scores(config, case.observations[left_out], given.seed)
            for name, config in models.items()
        }
    return report
