"""A field case from end to end: untuned gap, diagnosis, and its score on rocks left out."""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sassgis
from field_cases.distances import energy_distance, energy_scores, observed_scale
from field_cases.figures import stops_figure
from field_cases.tables import FieldCase, write_json
from sassgis.engine.effects.registry import EFFECTS
from sassgis.gap.diagnosis import Diagnosis, GapFinding
from sassgis.gap.inference.intervals import bootstrap_interval, bootstrap_rows
from sassgis.gap.inference.rock_tests import mean_gap_tests
from sassgis.gap.observations.campaign import main_blocks, observed_campaign
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.replicas.hypothesis_model import (
    HypothesisModel,
    LateralWalk,
    configured_model,
)
from sassgis.gap.replicas.rock_lines import rock_lines_of
from sassgis.gap.residuals.table import residuals_of
from sassgis.gap.where.findings import where
from sassgis.model.ground import GroundTable
from sassgis.report.figures import save
from sassgis.runs.gap_case import read_case

FloatArray = NDArray[np.float64]

#: Campaigns that each model is let go in.
CAMPAIGNS = 60
DRAWS = 1000
#: Rocks below which nothing is diagnosed.
FEWEST = 5
#: Findings that are kept.
SHOWN = 12
#: The class of which nothing was published, and the grid on which it is calibrated widely.
SOFT = "soft_meadow"
ETA_MAX = (0.35, 0.5, 0.65, 0.8, 0.95)
MU_0 = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
#: Within this of the end of a line, a rock has left it (m).
END_M = 3.0
#: Angles of ways aside on the grid (degrees).
ANGLES_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0)
#: Scores up to this many times the best one are told.
AS_GOOD = 1.1
QUANTITIES = ("runout_m", "aside_m")


def study(
    case: FieldCase,
    given: argparse.Namespace,
    groups: Mapping[str, str],
    more: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write ``results.json`` and figures.

    Parameters
    ----------
    case : FieldCase
    given : Namespace
        Arguments of the pipeline.
    groups : mapping of rock to group
        In which the untuned gap is told apart.
    more : mapping, optional
        Results of the pipeline's own.

    Returns
    -------
    dict
        What ``results.json`` holds.
    """
    out: Path = given.output
    everything = read_case(case.config, case.observations["all"])
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
        title = f"{case.name}: stops of the untuned model"
        save(stops_figure(seen, made, labels, title), out / "untuned.png")
        results["recalibrated"] = {
            split: recalibrated(case, fit, left_out, given.seed)
            for split, (fit, left_out) in case.splits.items()
        }
    found = where(
        everything, residuals_of(everything, everything.table, seed=given.seed), seed=given.seed
    )
    results["untuned_where"] = [_finding(f) for f in found[:SHOWN]]
    if not given.case_only:
        results["splits"] = {
            split: diagnosed(case, split, fit, left_out, given)
            for split, (fit, left_out) in case.splits.items()
            if len(read_case(case.config, case.observations[fit]).observations.rocks) >= FEWEST
        }
    write_json(out / "results.json", results)
    print(f"Wrote {out / 'results.json'}")
    return results


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
            own = gap[rows, q]

            def mean(k: NDArray[np.int64], own: FloatArray = own) -> float:
                return float(own[k].mean())

            interval = bootstrap_interval(mean, np.arange(rows.size), draws=DRAWS, rng=rng)
            values, drawn = seen[rows, q], made[rows, :, q].ravel()
            one[quantity] = {
                "observed": np.quantile(values, [0.1, 0.5, 0.9]),
                "predicted": np.quantile(drawn, [0.1, 0.5, 0.9]),
                "gap": interval.value,
                "ci95": [interval.low, interval.high],
                "p_adjusted": p_of[g - 1, q] if g else None,
                "energy_distance_m": energy_distance(values, drawn),
                "observed_abs_median": float(np.median(np.abs(values))),
                "predicted_abs_median": float(np.median(np.abs(drawn))),
            }
        report[name] = one
    return report


def recalibrated(case: FieldCase, fit: str, left_out: str, seed: int) -> dict[str, Any]:
    """The ground alone, calibrated far beyond what is published for a kind of ground.

    η_max and μ_0 of one class, with μ_f kept above μ_0 by as much as it was, on a grid; chosen by
    the CRPS of run-outs of the rocks to fit on, and scored on those left out. Then, for the
    distance aside alone, the angle of ways that leave the fall line (hops of 10 m).
    """
    fitted = read_case(case.config, case.observations[fit])
    other = read_case(case.config, case.observations[left_out])
    scores: dict[tuple[float, float], float] = {}
    for point in itertools.product(ETA_MAX, MU_0):
        seen, made = stops(fitted, _with_ground(fitted, *point), seed)
        scores[point] = _crps(seen, made, 0)
    chosen = min(scores, key=lambda point: scores[point])
    by_angle = {}
    for angle in ANGLES_DEG:
        model = replace(_with_ground(fitted, *chosen), lateral_walk=LateralWalk(angle_deg=angle))
        by_angle[angle] = _crps(*stops(fitted, model, seed), 1)
    angle = min(by_angle, key=lambda a: by_angle[a])
    ground = _with_ground(other, *chosen)
    models = {
        "untuned": configured_model(other),
        "recalibrated": ground,
        "deflected": replace(ground, lateral_walk=LateralWalk(angle_deg=angle)),
    }
    report: dict[str, Any] = {
        "ground": SOFT,
        "eta_max": chosen[0],
        "mu_0": chosen[1],
        "angle_deg": angle,
        "as_good": [list(p) for p in scores if scores[p] <= AS_GOOD * scores[chosen]],
        "rocks": other.n_rocks,
    }
    rng = np.random.default_rng([seed, 3])
    for name, model in models.items():
        seen, made = stops(other, model, seed)
        gap = (seen - made.mean(axis=1))[:, 0]

        def mean(k: NDArray[np.int64], gap: FloatArray = gap) -> float:
            return float(gap[k].mean())

        interval = bootstrap_interval(mean, np.arange(gap.size), draws=DRAWS, rng=rng)
        report[name] = {
            "gap_m": interval.value,
            "ci95": [interval.low, interval.high],
            "crps_m": _crps(seen, made, 0),
            "aside": {
                "crps_m": _crps(seen, made, 1),
                "energy_distance_m": energy_distance(seen[:, 1], made[:, :, 1].ravel()),
                "predicted": np.quantile(made[:, :, 1], [0.1, 0.5, 0.9]),
                "observed": np.quantile(seen[:, 1], [0.1, 0.5, 0.9]),
            },
            "energy_distance_m": energy_distance(seen[:, 0], made[:, :, 0].ravel()),
            "predicted": np.quantile(made[:, :, 0], [0.1, 0.5, 0.9]),
            "observed": np.quantile(seen[:, 0], [0.1, 0.5, 0.9]),
            # A run-out at the end of the line is at least that.
            "to_the_end": float(np.mean(made[:, :, 0] > _ends(other)[:, None] - END_M)),
        }
    return report


def _crps(seen: FloatArray, made: FloatArray, quantity: int) -> float:
    """Mean over the rocks of the CRPS of one quantity (m)."""
    one = slice(quantity, quantity + 1)
    return float(np.mean(energy_scores(made[:, :, one], seen[:, one])))


def _ends(case: Case) -> FloatArray:
    """Chainage at which the line of each rock ends (m)."""
    ends: FloatArray = case.profiles.s[case.profiles.offset[1:] - 1][case.line]
    return ends


def _with_ground(case: Case, eta_max: float, mu_0: float) -> HypothesisModel:
    classes = [
        replace(c, eta_max=eta_max, mu_0=mu_0, mu_f=c.mu_f - c.mu_0 + mu_0) if c.name == SOFT else c
        for c in case.table.classes
    ]
    return replace(configured_model(case), table=GroundTable(tuple(classes)))


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
    """Diagnose on the rocks to fit on, score on those left out."""
    from sassgis.runs.diagnose import diagnose

    folder = given.output / f"diagnosis_{split}"
    answer = diagnose(case.config, case.observations[fit], folder, jobs=given.jobs, seed=given.seed)
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
    other = read_case(case.config, case.observations[left_out])
    if len(other.observations.deposits):
        report["left_out"] = held_out(other, answer, given.seed)
    return report


def held_out(case: Case, answer: Diagnosis, seed: int) -> dict[str, Any]:
    """How far the gap shrinks on rocks that the diagnosis has not seen.

    S = (D_base − D_effect)/(D_base − D_floor), D the energy distance of stops (chainage and
    distance aside over their observed spread) of all rocks left out, D_floor the mean of it where
    campaigns of the model with the effect stand in for what was observed. Base: the calibrated one.
    """
    rng = np.random.default_rng([seed, 5])
    models = {
        "untuned": configured_model(case), "base": answer.base, "effect": answer.effect
    }  # fmt: skip
    made: dict[str, FloatArray] = {}
    for name, model in models.items():
        seen, made[name] = stops(case, model, seed)
    scale = observed_scale(seen)
    rocks = np.arange(case.n_rocks)

    def distances(rows: NDArray[np.int64]) -> dict[str, float]:
        found = {k: _distance(seen[rows], v[rows], scale) for k, v in made.items()}
        alike = [
            _distance(made["effect"][rows, k], np.delete(made["effect"][rows], k, axis=1), scale)
            for k in range(0, CAMPAIGNS, 6)
        ]
        return {**found, "floor": float(np.mean(alike))}

    drawn = [distances(rows) for rows, _ in bootstrap_rows(rocks, 200, rng)]
    point = distances(rocks)
    shrinkage = np.array([_shrinkage(d) for d in drawn])
    above = np.quantile([d["base"] - d["floor"] for d in drawn], 0.05)
    # Without an effect that is named there is nothing that could shrink the gap, and errors of
    # the observation are in no calibrated model.
    named = set(answer.verdict.effect.split("+")) & set(EFFECTS)
    told = bool(above > 0.0) and bool(named)
    return {
        "rocks": case.n_rocks,
        "energy_distance": point,
        # Rocks that are drawn twice lengthen every distance; what is above the floor, much less.
        "above_floor_ci95": {
            k: np.quantile([d[k] - d["floor"] for d in drawn], [0.025, 0.975]) for k in made
        },
        "energy_score": {
            k: float(np.mean(energy_scores(v, seen, scale=scale))) for k, v in made.items()
        },
        "shrinkage": _shrinkage(point) if told else None,
        "shrinkage_ci95": np.quantile(shrinkage, [0.025, 0.975]) if told else None,
        "by_quantity_m": {
            q: {k: energy_distance(seen[:, i], v[:, :, i].ravel()) for k, v in made.items()}
            for i, q in enumerate(QUANTITIES)
        },
        "gap_m": {
            q: {k: float((seen - v.mean(axis=1))[:, i].mean()) for k, v in made.items()}
            for i, q in enumerate(QUANTITIES)
        },
    }


def _distance(seen: FloatArray, made: FloatArray, scale: FloatArray) -> float:
    return energy_distance(seen, made.reshape(-1, 2), scale=scale)


def _shrinkage(d: Mapping[str, float]) -> float:
    return (d["base"] - d["effect"]) / (d["base"] - d["floor"])
