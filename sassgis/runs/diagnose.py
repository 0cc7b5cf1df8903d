"""The diagnosis of the gap between observed and simulated rocks, from files to a report."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from sassgis.gap.calibration.problem import CalibrationProblem, model_rows, problem_of
from sassgis.gap.diagnosis import (
    Advice,
    Comparison,
    Diagnosis,
    Fingerprint,
    GapFinding,
    Hypothesis,
    Range,
    Verdict,
)
from sassgis.gap.inference.distances import RockDistances
from sassgis.gap.ladder.handover import (
    CONFIGURED_NUMBER,
    configured_gap,
    consequences_of,
    first_sentence,
    settings_of,
    values_of,
)
from sassgis.gap.ladder.hypothesis_fit import CHOSEN, FRESH, gain_of
from sassgis.gap.ladder.rungs import (
    ground_is_enough,
    ladder_of,
    needs_contact_law,
    shrinkage_of,
)
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import configured_model
from sassgis.gap.replicas.model_json import model_as_json
from sassgis.gap.residuals.table import ResidualTable, residuals_of
from sassgis.gap.where.findings import where
from sassgis.gap.which.cause_weights import CauseWeights
from sassgis.gap.which.fingerprints import fingerprints
from sassgis.gap.which.hypotheses import NONE, families_to_try
from sassgis.gap.which.identifiable import what_is_identifiable
from sassgis.gap.which.measure_next import DRAWS as DRAWS_COMPARED
from sassgis.gap.which.measure_next import separations
from sassgis.gap.which.verdict import (
    CONTACT_LAW,
    UNKNOWN,
    Thresholds,
    second_of,
    significant,
    verdict_of,
)
from sassgis.io.read.config import load_config
from sassgis.io.read.gap_thresholds import cause_weights_of, read_thresholds, thresholds_of
from sassgis.io.staging import staged_output, writing
from sassgis.io.write.gap_files import write_diagnosis_json
from sassgis.model.errors import InputError, Interrupted
from sassgis.model.grid import FloatArray
from sassgis.runs.draw_store import OnProgress
from sassgis.runs.fresh_shrinkage import ENSEMBLE
from sassgis.runs.gap_case import fingerprint_of, read_case
from sassgis.runs.gap_outputs import write_outputs
from sassgis.runs.hypothesis_fits import (
    DRAWS,
    HypothesisFits,
    Keeping,
    best_base,
    calibrated_base,
)
from sassgis.runs.job import workers_asked
from sassgis.runs.workers import Jobs, task_map

#: Folder of the result in which the maps before and after are put, where they are wanted.
MAP_NAME = "map"
#: With fewer rocks nothing can be left out.
_FEWEST_ROCKS = 5
#: With fewer groups of rocks a warning is given.
_FEWEST_GROUPS = 4
#: Effects that are calibrated further, the most probable ones.
_FURTHER = 2

_ATYPICAL = (
    "The fingerprints are unlike those of any synthetic site: the probabilities of the causes may "
    "not hold here."
)


def diagnose(
    config: str | Path,
    observations: str | Path,
    out: str | Path,
    *,
    jobs: Jobs = 1,
    seed: int = 1,
    overwrite: bool = False,
    draws: int = DRAWS,
    ground_range: float = 1.0,
    report: bool = True,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Say where the gap lies, which effect causes it, and how far it shrinks.

    Parameters
    ----------
    config : path
        Configuration of the model.
    observations : path
        A GeoPackage, or a folder of CSV files.
    out : path
        Folder to write.
    jobs : int, optional
        Processes; 0 or None: all cores. The answer does not depend on it.
    seed : int
    overwrite : bool
    draws : int
        Draws of each hypothesis. More take longer and separate effects better.
    ground_range : float
        Factor on the ranges in which the ground is calibrated; above 1 where the configured classes
        are guesses. What a wider calibration can explain is no longer laid to an effect.
    report : bool
        Whether map, figures, report and configuration are written besides the numbers.
    on_progress : callable, optional
        Called with draws done, draws in all, and rocks simulated; counts anew for the calibration.
    say : callable, optional

    Returns
    -------
    Diagnosis

    Raises
    ------
    ConfigError, InputError, OutputError
    Interrupted
        If the user stops it; campaigns that were made are kept.
    """
    tell = say or (lambda _text: None)
    # Many small products of matrices: threads of the linear algebra would only wait for each other.
    with (
        threadpool_limits(1, "blas"),
        staged_output(Path(out), overwrite, parts=(MAP_NAME,)) as work,
    ):
        settings = load_config(config)
        tell("Reading the inputs")
        case = replace(read_case(settings, observations), ground_range=ground_range)
        if case.n_rocks < _FEWEST_ROCKS:
            raise InputError(
                "too few rocks to distinguish a cause from chance",
                file=observations,
                field="rocks",
                found=case.n_rocks,
                expected=f"{_FEWEST_ROCKS} or more",
            )
        chosen = read_thresholds()
        frozen, weights = thresholds_of(chosen), cause_weights_of(chosen)
        problem = problem_of(case, seed)
        fingerprint = fingerprint_of(
            settings, Path(observations), f"{seed} {draws} {ground_range:g}"
        )
        try:
            with task_map(problem, workers_asked(settings, jobs)) as run:
                tell(f"Calibrating the base model with {case.n_rocks} rocks")
                made, wrong_ground, usual = best_base(
                    problem, run, draws, on_progress, Keeping(work, fingerprint, tell)
                )
                tell("Calibrating the most probable hypotheses")
                diagnosis = _diagnosis(made, wrong_ground, usual, frozen, weights, fingerprint)
        except KeyboardInterrupt:
            raise Interrupted(
                "stopped by the user; campaigns of finished hypotheses are kept: the same command "
                "goes on from there"
            ) from None
        diagnosis = replace(
            diagnosis,
            warnings=(
                *settings.notes,
                *_group_warnings(case),
                *diagnosis.warnings,
            ),
        )
        tell("Writing the results")
        _write_models(work / ENSEMBLE, made, diagnosis)
        if report:
            write_outputs(work, case, diagnosis, Path(config))
        else:
            write_diagnosis_json(work / "diagnosis.json", diagnosis)
    return diagnosis


def _group_warnings(case: Case) -> tuple[str, ...]:
    """Too few groups to tell what their members have in common from a cause."""
    groups = np.unique(case.group).size
    if groups >= _FEWEST_GROUPS:
        return ()
    return (
        f"The rocks are in {groups} group{'s' if groups > 1 else ''}. With fewer than "
        f"{_FEWEST_GROUPS} no cause can be told from what the rocks of a group have in common; "
        "intervals are far too narrow.",
    )


def fingerprints_of(
    config: str | Path, observations: str | Path, seed: int = 1
) -> tuple[tuple[Fingerprint, ...], tuple[GapFinding, ...]]:
    """Fingerprints and findings of the calibrated base alone, in this process.

    Parameters
    ----------
    config, observations : path
        As for ``diagnose``.
    seed : int
    """
    problem = problem_of(read_case(load_config(config), observations), seed)

    def run(function: Callable[[Any, Any], Any], tasks: Sequence[Any]) -> Iterator[Any]:
        return (function(problem, task) for task in tasks)

    # No rock is left out: what is asked for are no scores.
    whole = replace(problem, part=np.full(problem.case.n_rocks, -1))
    made = calibrated_base(whole, run, DRAWS, None, Keeping(None, "", lambda _text: None))
    residuals = _residuals(made)
    case = problem.case
    return fingerprints(case, residuals, group=case.group), where(case, residuals, seed=seed)


def _residuals(made: HypothesisFits) -> ResidualTable:
    """Residuals of the calibrated base."""
    case = made.problem.case
    return residuals_of(
        case,
        made.model(NONE).model.table,
        seed=made.problem.seed,
    )


# ---------------------------------------------------------------------------------------------
# Comparing


def _diagnosis(
    made: HypothesisFits,
    wrong_ground: tuple[str, ...],
    usual: HypothesisFits,
    frozen: Thresholds,
    weights: CauseWeights,
    fingerprint: str,
) -> Diagnosis:
    """The answer, from a base that is calibrated and first draws of all effects."""
    problem, case, seed = made.problem, made.problem.case, made.problem.seed
    tried = families_to_try(case)
    # Fingerprints are of the base within the usual range of the ground, as the weights know them.
    residuals = _residuals(usual)
    prints = fingerprints(case, residuals, group=case.group)
    if usual is not made:
        residuals = _residuals(made)
    shares = weights.shares(prints, tried)
    made.add(CONTACT_LAW)
    configured = model_rows(problem, configured_model(case), CONFIGURED_NUMBER, FRESH)
    bases = [
        ("configured", configured),
        ("ground", made.rows(NONE)),
        (CONTACT_LAW, made.rows(CONTACT_LAW)),
    ]
    # An effect is added to the base that the contact asks for.
    first_rungs = ladder_of(problem, bases)
    law = CONTACT_LAW in significant(prints, frozen.level) or needs_contact_law(first_rungs)
    base = CONTACT_LAW if law else NONE

    def with_base(effect: str) -> str:
        names = set(effect.split("+")) | ({CONTACT_LAW} if law else set())
        return "+".join(sorted(names - {NONE})) or NONE

    families = [n for n in shares if n != NONE]
    second = second_of(families[0], prints, shares, frozen, tried)
    best = "+".join(sorted([families[0], second])) if second else families[0]
    made.add(*map(with_base, families[:_FURTHER]), with_base(best))
    shrinkage = shrinkage_of(problem, made.rows(base), best, made.rows(with_base(best)))
    findings = where(case, residuals, seed=seed)
    most = None if shrinkage.ci95 is None else shrinkage.ci95[1]
    draws = [own.draw for own in made.fits[with_base(best)].models]
    enough = ground_is_enough(first_rungs)
    verdict = verdict_of(prints, shares, most, frozen, law, enough, case, draws, findings)
    named = verdict.effect if verdict.effect not in (NONE, UNKNOWN, CONTACT_LAW) else ""
    if named and named != best:
        made.add(with_base(named))
        shrinkage = shrinkage_of(problem, made.rows(base), named, made.rows(with_base(named)))
    elif verdict.effect == NONE:
        shrinkage = shrinkage_of(problem, made.rows(base), NONE, made.rows(base))
    elif not named:
        shrinkage = replace(
            shrinkage, note=f"No effect is named; this is of {best.replace('_', ' ')}, as a bound."
        )
    final = with_base(named) if named else base if verdict.effect == CONTACT_LAW else NONE
    # With two causes the surer one comes first.
    parts = sorted(named.split("+"), key=lambda n: -shares.get(n, 0.0)) if named else []
    steps = list(dict.fromkeys([*parts[:1], *([named] if named else [])]))
    made.add(final, *map(with_base, steps))
    ladder = ladder_of(problem, [*bases, *((step, made.rows(with_base(step))) for step in steps)])
    intervals = {e: made.fits[e].intervals(case) for e in dict.fromkeys([NONE, final])}
    ground = made.fits[final]
    model = made.model(final).model
    advice = Advice(
        configured_gap(problem, configured),
        wrong_ground,
        case.ground_range,
        settings_of(case, ground, intervals[final]),
        tuple((t.one, t.other, t.correlation) for t in ground.trade_offs),
        consequences_of(problem, configured_model(case), model),
    )
    known = what_is_identifiable(case.observations)
    calibrated = (e for e in (*families, best) if with_base(e) in made.fits)
    tested = list(dict.fromkeys([NONE, CONTACT_LAW, *calibrated]))
    return Diagnosis(
        verdict=verdict,
        where=findings,
        which=_hypotheses(made, tested, with_base, shares, intervals),
        shrinkage=shrinkage,
        rocks=case.n_rocks,
        tables={name: len(table) for name, table in case.observations.tables.items()},
        not_identifiable=known.not_identifiable,
        measure_next=_measure_next(made, verdict, base, with_base),
        comparisons=_comparisons(problem, made.rows(base), made.rows(final) if named else None),
        base=made.model(base).model,
        effect=model,
        settings_hash=fingerprint,
        seed=seed,
        # Errors were logged while reading.
        warnings=(
            *(str(f) for f in case.observations.findings if f.level == "warning"),
            *(() if weights.is_typical(prints) else (_ATYPICAL,)),
        ),
        fingerprints=prints,
        ladder=ladder,
        advice=advice,
        first_sentence=first_sentence(advice, ladder, verdict.effect),
    )


def _measure_next(
    made: HypothesisFits, verdict: Verdict, base: str, with_base: Callable[[str], str]
) -> tuple[str, ...]:
    """What would tell the causes apart that remain possible and were calibrated."""
    # Two causes that are named together are one answer.
    parts = set(verdict.effect.split("+")) - {verdict.effect}
    possible = dict.fromkeys([*([verdict.effect] if parts else []), *verdict.confusion_set])
    models = {}
    for cause in (c for c in possible if c not in parts):
        own = base if cause == NONE else with_base(cause)
        if own in made.fits:
            name = base if cause == NONE else cause
            fit = made.fits[own]
            others = fit.samples(made.problem.case, DRAWS_COMPARED - 1)
            models[name] = [fit.handed_over.draw.model, *(draw.model for draw in others)]
    case, lines = made.problem.case, made.problem.rock_lines
    found = separations(case, lines, models, made.problem.seed)
    return tuple(one.sentence for one in found)


def _hypotheses(
    made: HypothesisFits,
    effects: Sequence[str],
    with_base: Callable[[str], str],
    shares: Mapping[str, float],
    intervals: Mapping[str, Mapping[str, Range]],
) -> tuple[Hypothesis, ...]:
    """Everything that was tried, most probable first."""
    problem = made.problem
    base = made.scores(NONE)
    rng = np.random.default_rng([problem.seed, 81])
    found = []
    for name in effects:
        tried = with_base(name) if name != NONE and with_base(name) in made.fits else name
        own = made.scores(tried)
        gain = gain_of(base, own, problem.case.group, rng)
        top = made.model(tried)
        found.append(
            Hypothesis(
                name,
                top.form,
                float(np.nanmean(own)),
                gain.value,
                (gain.low, gain.high),
                shares.get(name.split("+")[0], 0.0),
                dict(top.parameters),
                intervals.get(tried, {}),
            )
        )
    return tuple(sorted(found, key=lambda c: -c.probability))


_SHOWN = {
    "runout": ("runout_m", "m"),
    "aside": ("lateral_m", "m"),
    "speed": ("speed_mps", "m/s"),
    "rotation": ("rotation_hz", "1/s"),
    "height": ("height_m", "m"),
    "blocks": ("stops_per_rock", ""),
}


def _comparisons(
    problem: CalibrationProblem, base: FloatArray, effect: FloatArray | None
) -> tuple[Comparison, ...]:
    """Distributions of every scored quantity: observed, calibrated base, and effect."""
    out = []
    for i, name in enumerate(problem.scale.names):
        place, _, what = name.partition(":")
        quantity, unit = _SHOWN[what]
        shown = "stop" if place == "stop" else problem.case.station_names[int(place[1:])]
        seen, before, after = (
            () if rows is None else _finite(values_of(problem.scale, rows, i))
            for rows in (problem.rows, base, effect)
        )
        out.append(Comparison(shown, quantity, unit, seen, before, after))
    return tuple(out)


def _finite(values: FloatArray) -> tuple[float, ...]:
    return tuple(np.round(values[np.isfinite(values)], 4).tolist())


def _write_models(file: Path, made: HypothesisFits, diagnosis: Diagnosis) -> None:
    """The models that are handed over, whole, and the scale on which their rocks are compared.

    ``number`` and ``count`` are those of the campaigns by which each was chosen and scored,
    ``distance`` what these leave to the observed rocks.
    """
    scale = made.problem.scale
    kept = {
        "seed": made.problem.seed,
        "named": diagnosis.shrinkage.effect,
        "count": FRESH,
        "scale": {
            "names": list(scale.names),
            "centre": scale.centre.tolist(),
            "scale": scale.scale.tolist(),
        },
        **{
            name: {
                "number": CHOSEN,
                "distance": RockDistances.of(
                    made.problem.rows, made.fits[own].handed_over.rows
                ).value()
                if made.problem.rows.shape[1]
                else None,
                "model": model_as_json(model),
            }
            for name, model in (("base", diagnosis.base), ("effect", diagnosis.effect))
            for own in (next(e for e in made.fits if made.model(e).model == model),)
        },
    }
    with writing(file):
        file.parent.mkdir()
        file.write_text(json.dumps(kept, indent=1), encoding="utf-8")


def answer(config: str | Path, observations: str | Path, out: str | Path, **options: Any) -> None:
    """The diagnosis without map, figures and report: the numbers alone, for the blind check."""
    diagnose(config, observations, out, report=False, **options)
