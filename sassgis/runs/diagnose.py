"""The diagnosis of the gap between observed and simulated rocks, from files to a report."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.errors import Interrupted
from sassgis.files.atomic_output import output_if_asked, write_text
from sassgis.gap.advice.measure_next import (
    not_testable,
    separations,
    tables_to_add,
    what_is_identifiable,
)
from sassgis.gap.advice.recommendation import (
    first_sentence,
    model_gaps,
    settings_of,
    shortfall,
    values_of,
    worst_of,
    wrong_ground,
)
from sassgis.gap.constants import (
    CHOSEN_COUNT,
    CHOSEN_NUMBER,
    CONFIGURED_NUMBER,
    FIT_DRAWS,
    SEPARATION_DRAWS,
)
from sassgis.gap.diagnosis import (
    Advice,
    Comparison,
    Diagnosis,
    Hypothesis,
    ModelGap,
    Range,
    Verdict,
)
from sassgis.gap.fit.distances import RockDistances
from sassgis.gap.fit.fit_errors import QUANTITIES
from sassgis.gap.fit.hypothesis_fit import (
    CONTACT_LAW,
    NONE,
    UNKNOWN,
    HypothesisFits,
    draw_of,
    families_to_try,
    gain_of,
)
from sassgis.gap.fit.linear_fit import summary_of
from sassgis.gap.fit.site_data import SiteData, site_data_of
from sassgis.gap.forward.observation_operator import share_left
from sassgis.gap.forward.released_rocks import HypothesisModel, model_as_json
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residual_table import residuals_with
from sassgis.gap.verdict.evidence import (
    AddedCauses,
    configured_as_observed,
    evidence_of_site,
    shares_of,
    verdict_of,
)
from sassgis.gap.verdict.model_comparison import CONFIGURED, GROUND
from sassgis.gap.verdict.verdict import where
from sassgis.grid import FloatArray
from sassgis.inputs.observation_files import AnyObservations
from sassgis.inputs.observation_values import cause_weights_of, read_thresholds, thresholds_of
from sassgis.outputs.gap_files import write_config_back, write_diagnosis_json, write_gap_gpkg
from sassgis.report.gap_report import gap_report, report_warnings
from sassgis.report.page import translated_report, write_report
from sassgis.runs.calibrate import (
    comparable,
    edge_warnings,
    fingerprint_of,
    group_warnings,
    limit_warnings,
    observed_files,
    prepared_case,
    scenario_warnings,
    stop_warnings,
)
from sassgis.runs.draw_store import reported_tasks
from sassgis.runs.provenance import write_origin
from sassgis.runs.resumable_run import AnyConfig, configured, workers_asked
from sassgis.settings.crs import crs_name
from sassgis.settings.languages import in_language
from sassgis.settings.map_run import Config
from sassgis.simulation.workers import Jobs, OnProgress, one_algebra_thread, task_map

#: Folder of the result in which the maps before and after are put, where they are wanted.
MAP_NAME = "map"
#: Models that are handed over, whole, for measuring on other rocks.
ENSEMBLE = "model/ensemble.json"
_NOT_THE_LAW = (
    "another contact law closes more of the gap on held-out rocks, but other ground values might "
    "close as much"
)
_ATYPICAL = (
    "The calibrated base model fits these observations worse than those of any synthetic site. "
    "The probabilities of the causes may be wrong here."
)


def diagnose(
    config: AnyConfig,
    observations: AnyObservations,
    out: str | Path | None = None,
    *,
    jobs: Jobs = 1,
    seed: int = 1,
    overwrite: bool = False,
    draws: int = FIT_DRAWS,
    ground_range: float = 1.0,
    report: bool = True,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Say where the gap lies, which effect causes it, and how far it shrinks.

    Parameters
    ----------
    config : path, Config or mapping
        Configuration of the model.
    observations : path, or mapping of str to DataFrame
        A GeoPackage, a folder of CSV files, or the tables by name.
    out : path, optional
        Folder to write; without it nothing is written.
    jobs : int, optional
        Processes; 0 or None: all cores. The answer does not depend on it.
    draws : int
        Draws in each round of a calibration. More take longer.
    ground_range : float
        Factor on the ranges in which the ground is calibrated; above 1 where the configured classes
        are guesses. What a wider calibration can explain is no longer laid to an effect.
    report : bool
        Whether map, figures, report and configuration are written besides the numbers.
    on_progress : callable, optional
        Called with draws done, draws in all, and rocks simulated; counts anew for each step.
    """
    tell = say or (lambda _text: None)
    with one_algebra_thread(), output_if_asked(out, overwrite, parts=(MAP_NAME,)) as work:
        settings = configured(config, None)
        tell("Reading the inputs")
        case = prepared_case(settings, observations, seed, ground_range)
        summary = summary_of(comparable(site_data_of(case, seed), observations))
        fingerprint = fingerprint_of(settings, observations, f"{seed} {draws} {ground_range:g}")
        try:
            with task_map(summary, workers_asked(settings, jobs)) as run:
                tell(f"Calibrating the base model with {case.n_rocks} rocks")
                reported = reported_tasks(run, case.n_rocks, on_progress)
                made = HypothesisFits(summary, reported, draws)
                made.add(CONTACT_LAW)
                tell("Weighing the causes")
                added = evidence_of_site(made)
                tell("Calibrating the most probable hypotheses")
                diagnosis = _diagnosis(added, read_thresholds(), fingerprint)
        except KeyboardInterrupt:
            raise Interrupted("stopped by the user") from None
        warnings = (*settings.notes, *scenario_warnings(settings), *group_warnings(case),
                    *stop_warnings(case), *diagnosis.warnings)  # fmt: skip
        diagnosis = replace(diagnosis, warnings=warnings)
        if out is None:
            return diagnosis
        tell("Writing the results")
        _write_models(work / ENSEMBLE, made, diagnosis)
        write_diagnosis_json(work / "diagnosis.json", diagnosis)
        if report:
            write_outputs(work, case, diagnosis, settings)
    return diagnosis


def _gaps(
    problem: SiteData, model: HypothesisModel, rows: FloatArray, scale: float = 1.0
) -> tuple[tuple[ModelGap, ...], float]:
    """Compute how far a model is off (``scale``: speeds as observed over true), and what leaves."""
    left = share_left(problem.case, problem.rock_lines, model, problem.seed)
    scales = {"observed_scale": scale, "model_scale": model.measurement.scale}
    return model_gaps(problem, rows, left, **scales), left


def _diagnosis(added: AddedCauses, chosen: Mapping[str, Any], fingerprint: str) -> Diagnosis:
    """Return the answer, from what speaks for causes."""
    made, evidence = added.made, added.evidence
    problem, case = made.problem, made.problem.case
    frozen, weights = thresholds_of(dict(chosen)), cause_weights_of(dict(chosen))
    ladder, law, simplest = added.ladder, added.needs_law, added.simplest
    shares = shares_of(evidence, families_to_try(case), weights)
    as_configured = configured_as_observed(made)
    gaps = {CONFIGURED: _gaps(problem, as_configured, added.configured_rows)}
    if simplest != CONFIGURED:
        own = added.name(simplest)
        gaps[simplest] = _gaps(problem, made.model(own).model, made.rows(own))
    short = shortfall(gaps[simplest][0]) is not None
    sound = evidence.sound and not short
    verdict, shrinkage = verdict_of(added, shares, weights, frozen, sound)
    named = "+".join(verdict.named)
    # With two causes the surer one comes first.
    surer = max(verdict.named, key=lambda n: shares.get(n, 0.0), default="")
    steps = tuple(dict.fromkeys([surer, named])) if named else ()
    # Beside a scale of the speeds that is named, they are compared without it.
    scale = added.fit(named).handed_over.draw.model.measurement.scale if named else 1.0
    if scale != 1.0:
        left_before = gaps[CONFIGURED][1]
        rows = added.configured_rows
        rescaled = model_gaps(problem, rows, left_before, observed_scale=scale)
        gaps = {CONFIGURED: (rescaled, left_before)}
    for step in steps:
        ladder.add(step, added.rung if step == surer else surer, added.rows(step))
    recommended, why = ladder.recommended(*added.base_rungs, *steps)
    beyond = ladder.gain(GROUND, CONTACT_LAW)
    if not law and recommended == GROUND and beyond is not None and beyond.low > 0.0:
        why = why or _NOT_THE_LAW
    rungs = ladder.rungs(CONFIGURED, GROUND, CONTACT_LAW, *steps)
    # Of the configured ground nothing was calibrated.
    fit = None if recommended == CONFIGURED else added.fit(recommended)
    handed = as_configured if fit is None else fit.handed_over.draw.model
    if recommended not in gaps:
        gaps[recommended] = _gaps(problem, handed, added.rows(recommended), scale)
    (before, left_before), (left, left_after) = gaps[CONFIGURED], gaps[recommended]
    intervals = {effect: own.intervals(case) for effect, own in made.fits.items()}
    advice = Advice(
        configured=worst_of(before),
        wrong_ground=wrong_ground(case, intervals[CONTACT_LAW]) if law and not named else (),
        ground_range=case.ground_range,
        settings=() if fit is None else settings_of(case, fit, intervals[fit.effect]),
        trade_offs=tuple((t.one, t.other, t.correlation) for t in fit.trade_offs) if fit else (),
        compared=before, left=left, recommended=recommended, short=shortfall(left), why=why,
    )  # fmt: skip
    configured_case, residuals = residuals_with(case, as_configured, seed=problem.seed)
    gains = sorted(evidence.gains.values(), key=lambda gain: -gain.sureness)
    excess = max((gain.excess for gain in gains), default=1.0)
    return Diagnosis(
        verdict=verdict,
        where=evidence.findings,
        which=_hypotheses(added, shares, intervals),
        shrinkage=shrinkage,
        rocks=case.n_rocks,
        tables={name: len(table) for name, table in case.observations.tables.items()},
        not_identifiable=what_is_identifiable(case.observations).not_identifiable,
        measure_next=_measure_next(added, verdict),
        comparisons=_comparisons(
            problem,
            made.rows(added.base),
            added.rows(named) if named else None,
            added.configured_rows,
        ),
        base=made.model(added.base).model,
        effect=handed,
        settings_hash=fingerprint,
        seed=problem.seed,
        # Errors were logged while reading.
        warnings=(
            *(str(f) for f in case.observations.findings if f.level == "warning"),
            *edge_warnings(left_before, left_after),
            *(() if fit is None else limit_warnings(case, handed)),
            *evidence.notes,
            *(() if excess <= weights.farthest else (_ATYPICAL,)),
        ),
        fingerprints=evidence.prints,
        gains=tuple(gains),
        ladder=rungs,
        law=evidence.law,
        advice=advice,
        first_sentence=first_sentence(advice, rungs, verdict),
        not_testable=not_testable(case.observations, verdict.cannot_exclude),
        where_configured=where(configured_case, residuals, seed=problem.seed),
    )


def _measure_next(added: AddedCauses, verdict: Verdict) -> tuple[str, ...]:
    """Find what would distinguish the causes that remain possible and were calibrated."""
    # Two causes that are named together are one answer.
    parts = set(verdict.effect.split("+")) - {verdict.effect}
    unknown = verdict.effect == UNKNOWN
    # A single cause is distinguished from none.
    named = [verdict.effect] if parts else []
    answer = verdict.effect.split("+")
    possible = dict.fromkeys([*named, *answer, *verdict.rivals, *[NONE] * unknown])
    problem, models = added.made.problem, {}
    for cause in possible:
        if cause not in parts and (own := _models_of(added, cause)):
            models[added.base if cause == NONE else cause] = own
    found = separations(problem.case, problem.rock_lines, models, problem.seed)
    more = () if verdict.named else verdict.rivals
    return (*(one.sentence for one in found), *tables_to_add(problem.case, more))


def _models_of(added: AddedCauses, cause: str) -> list[HypothesisModel]:
    """Return draws of a cause: calibrated, or the one that closes most."""
    case = added.made.problem.case
    own = added.base if cause in (NONE, CONTACT_LAW) else added.name(cause)
    if own in added.made.fits:
        fit = added.made.fits[own]
        others = fit.samples(case, SEPARATION_DRAWS - 1)
        return [fit.handed_over.draw.model, *(draw.model for draw in others)]
    gain = added.evidence.gains.get(cause)
    return [] if gain is None else [draw_of(case, own, gain.shares).model]


def _hypotheses(
    added: AddedCauses, shares: Mapping[str, float], intervals: Mapping[str, Mapping[str, Range]]
) -> tuple[Hypothesis, ...]:
    """List the calibrated hypotheses, most probable first."""
    made = added.made
    rng = np.random.default_rng([made.problem.seed, 81])
    found = []
    for tried, fit in made.fits.items():
        own = made.scores(tried)
        # A law of the contact is none of the cause's merits.
        simpler = NONE if tried in (NONE, CONTACT_LAW) else added.base
        gain = gain_of(made.scores(simpler), own, made.problem.case.group, rng)
        top = fit.handed_over.draw
        causes = [part for part in tried.split("+") if part != CONTACT_LAW]
        name = "+".join(causes) or CONTACT_LAW
        found.append(
            Hypothesis(
                effect=name, form=top.form, score=float(np.nanmean(own)), gain=gain.value,
                ci95=(gain.low, gain.high), probability=shares.get(name.split("+")[0], 0.0),
                parameters=top.parameters, intervals=intervals[tried],
            )
        )  # fmt: skip
    return tuple(sorted(found, key=lambda c: -c.probability))


#: Columns of observations with some of the scored quantities.
_COLUMNS = {
    "runout": "runout_m",
    "aside": "lateral_m",
    "speed": "speed_mps",
    "rotation": "rotation_hz",
    "height": "height_m",
    "blocks": "stops_per_rock",
}


def _comparisons(
    problem: SiteData, base: FloatArray, effect: FloatArray | None, configured: FloatArray
) -> tuple[Comparison, ...]:
    """Return distributions of every scored quantity: observed rocks, and those of the models."""
    out = []
    for i, name in enumerate(problem.scale.names):
        place, _, what = name.partition(":")
        quantity, unit = _COLUMNS.get(what, what), QUANTITIES[what][1]
        shown = problem.case.station_names[int(place[1:])] if place.startswith("S") else place
        given = (
            np.empty(0) if rows is None else values_of(problem.scale, rows, i)
            for rows in (problem.rows, base, effect, configured)
        )
        values = (tuple(np.round(v[np.isfinite(v)], 4).tolist()) for v in given)
        out.append(Comparison(shown, quantity, unit, *values))
    return tuple(out)


def write_outputs(work: Path, case: Case, diagnosis: Diagnosis, config: Config) -> None:
    """Write a diagnosis into a folder; equal diagnoses give equal files.

    ``work`` is the folder of the result, or the staged one next to it: paths in
    ``model/config.toml`` hold for both.
    """
    write_gap_gpkg(work / "gap.gpkg", case, diagnosis)
    write_config_back(work / "model" / "config.toml", config, diagnosis, case)
    # What the console says, and what only the report has.
    warnings = list(dict.fromkeys((*diagnosis.warnings, *report_warnings(case, diagnosis))))
    with in_language(config.project.language):
        context = gap_report(
            case, diagnosis, work / "figures", project=config.project.name,
            terrain=config.dem_source.name, crs=crs_name(case.grid.crs or ""),
            configuration=config.label, warnings=warnings,
        )  # fmt: skip
        write_report(work / "report.html", translated_report(context))
    verdict = diagnosis.verdict
    found = {"effect": verdict.effect, "confidence": verdict.confidence,
             "settings_hash": diagnosis.settings_hash}  # fmt: skip
    counts = {
        "rocks": diagnosis.rocks,
        **{f"rows_{name}": int(n) for name, n in diagnosis.tables.items()},
        "comparisons": len(diagnosis.where),
        "explanations": len(diagnosis.which),
    }
    write_origin(
        work, config, counts, warnings, seed=diagnosis.seed, grid=case.grid, maps=False,
        inputs=observed_files(case), settings={"diagnosis": found},
    )  # fmt: skip


def _write_models(file: Path, made: HypothesisFits, diagnosis: Diagnosis) -> None:
    """Write the models handed over, whole, and the scale on which their rocks are compared."""
    problem, scale = made.problem, made.problem.scale
    kept: dict[str, Any] = {
        "seed": problem.seed,
        "named": diagnosis.shrinkage.effect,
        "count": CHOSEN_COUNT,
        "scale": {
            "names": list(scale.names), "centre": scale.centre.tolist(),
            "scale": scale.scale.tolist(),
        },
    }  # fmt: skip
    configured = configured_as_observed(made)
    models = {"base": diagnosis.base, "effect": diagnosis.effect, "configured": configured}
    for name, model in models.items():
        # Of the configured model where nothing was calibrated: the first rung has its distance.
        number = CONFIGURED_NUMBER
        distance = diagnosis.ladder[0].distance if diagnosis.ladder else None
        for fit in made.fits.values():
            if fit.handed_over.draw.model == model:
                number = CHOSEN_NUMBER
                rows = RockDistances.of(problem.rows, fit.handed_over.rows)
                distance = rows.value() if scale.names else None
        kept[name] = {"number": number, "distance": distance, "model": model_as_json(model)}
    write_text(file, json.dumps(kept, indent=1))
