"""The diagnosis of the gap between observed and simulated rocks, from files to a report."""

from __future__ import annotations

import json
import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from sassgis.gap.diagnosis import (
    Calibrated,
    Comparison,
    Diagnosis,
    Fingerprint,
    Hypothesis,
)
from sassgis.gap.inference.folds import folds_of
from sassgis.gap.ladder.calibration import (
    best_draws,
    fitted_rows,
    gain_of,
    held_out_scores,
    refine,
    run_refined,
    shrinkage_of,
)
from sassgis.gap.observations.case import Case
from sassgis.gap.observations.identifiable import what_is_identifiable
from sassgis.gap.replicas.model_json import model_as_json
from sassgis.gap.residuals.free_run import RunModel, free_run, observed_at_stations
from sassgis.gap.residuals.steps import steps_of
from sassgis.gap.where.findings import where
from sassgis.gap.which.ensemble import (
    COUNT,
    CalibrationProblem,
    Ensemble,
    Tried,
    ensemble_of,
    problem_of,
    tasks_of,
    try_task,
)
from sassgis.gap.which.families import FAMILIES
from sassgis.gap.which.fingerprints import fingerprints
from sassgis.gap.which.hypotheses import NONE, Draw, families_to_try
from sassgis.gap.which.verdict import (
    CONTACT_LAW,
    UNKNOWN,
    Thresholds,
    causes_of,
    measure_next,
    shares_of,
    verdict_of,
)
from sassgis.io.read.config import load_config
from sassgis.io.read.gap_thresholds import read_thresholds, thresholds_of
from sassgis.io.staging import CHECKPOINT_STEM, staged_output
from sassgis.io.write.gap_files import write_diagnosis_json
from sassgis.model.errors import InputError, Interrupted
from sassgis.model.ground import GroundTable
from sassgis.model.run_config import Config
from sassgis.runs.campaign_workers import CampaignMap, campaign_workers, fingerprint_of
from sassgis.runs.fresh_shrinkage import ENSEMBLE
from sassgis.runs.gap_case import read_case
from sassgis.runs.gap_outputs import write_outputs
from sassgis.runs.job import job_count

#: With fewer rocks nothing can be left out.
_FEWEST_ROCKS = 5
#: Draws of each hypothesis in the first round, and of the base.
DRAWS, BASE_DRAWS = 40, 80
#: Runs of each rock with which stations and stops are compared for the fingerprints.
_REPLICATES = 12
#: Repetitions of the refinement, and draws in each.
REPETITIONS, REFINED = 3, 24
#: Effects that are calibrated further, the most probable ones.
_FURTHER = 3
#: Draws of a pair of effects.
_PAIR_DRAWS = 40
_BOOTSTRAP = 120
_ORDER: Mapping[str, int] = {name: i for i, name in enumerate(FAMILIES)}

OnProgress = Callable[[int, int, int], None]


def diagnose(
    config: str | Path,
    observations: str | Path,
    out: str | Path,
    *,
    jobs: int | None = 1,
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
    began = time.perf_counter()
    # Many small products of matrices: threads of the linear algebra would only wait for each other.
    with threadpool_limits(1, "blas"), staged_output(Path(out), overwrite) as work:
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
        frozen = thresholds_of(read_thresholds())
        problem = problem_of(case, seed)
        fingerprint = fingerprint_of(
            settings, Path(observations), f"{seed} {draws} {ground_range:g}"
        )
        try:
            with campaign_workers(problem, job_count(settings, jobs)) as run:
                tell(f"Releasing {case.n_rocks} rocks in the base model")
                tried = list(run(_try, tasks_of([NONE], BASE_DRAWS)))
                tell("Releasing them in every hypothesis")
                ensemble = _ensemble(problem, tried, draws, run, work, fingerprint, on_progress)
                tell("Calibrating the most probable hypotheses")
                diagnosis, ensemble = _diagnosis(
                    problem, ensemble, frozen, run, fingerprint, on_progress
                )
        except KeyboardInterrupt:
            raise Interrupted(
                "stopped by the user; campaigns of finished hypotheses are kept: the same command "
                "goes on from there"
            ) from None
        diagnosis = replace(
            diagnosis, warnings=(*settings.notes, *_motion_warnings(settings), *diagnosis.warnings)
        )
        tell("Writing the results")
        if report:
            write_outputs(work, case, diagnosis, Path(config), time.perf_counter() - began)
        else:
            write_diagnosis_json(work / "diagnosis.json", diagnosis)
            (work / "model").mkdir()
        _write_ensemble(work / ENSEMBLE, problem, ensemble, diagnosis.shrinkage.effect)
    return diagnosis


def _motion_warnings(settings: Config) -> tuple[str, ...]:
    """Where the configured motion is not that with which rocks are replayed or causes learned."""
    out = []
    if settings.terrain.path == "followed":
        out.append(
            'terrain.path is "followed". The diagnosis replays rocks along fall lines, and model/ '
            'states terrain.path = "fall_line". Lateral offsets of followed paths are not in the '
            "base model."
        )
    return tuple(out)


# ---------------------------------------------------------------------------------------------
# Campaigns


def _try(problem: CalibrationProblem, task: tuple[str, int]) -> Tried:
    return try_task(problem, task, _ORDER)


def _ensemble(
    problem: CalibrationProblem,
    base: list[Tried],
    draws: int,
    run: CampaignMap,
    work: Path,
    fingerprint: str,
    on_progress: OnProgress | None,
) -> Ensemble:
    """First round of campaigns; effects that were finished before are not made again.

    One draw of each effect goes ahead uncounted: it waits until its kernels are compiled, which
    would make the time left look like hours.
    """
    families = families_to_try(problem.case)
    files = {effect: work / f"{CHECKPOINT_STEM}.{effect}.pkl" for effect in families}
    made = {effect: _saved(file, fingerprint) for effect, file in files.items()}
    due = [effect for effect in families if made[effect] is None]
    first = dict(zip(due, run(_try, tasks_of(due, 1)), strict=True))
    counter = _Counter(on_progress, draws * len(families), problem.case.n_rocks)
    counter.step(draws * (len(families) - len(due)) + len(due))
    for effect in due:
        rest = counter.counted(run(_try, tasks_of([effect], draws)[1:]))
        made[effect] = [first[effect], *rest]
        _save(files[effect], fingerprint, made[effect] or [])
    return ensemble_of(problem, [*base, *(one for own in made.values() for one in own or [])])


class _Counter:
    """Reports how many draws are done, of how many, and the rocks simulated for them."""

    def __init__(self, on_progress: OnProgress | None, total: int, n_rocks: int) -> None:
        self._on_progress, self._total, self._rocks = on_progress, total, COUNT * n_rocks
        self._done = 0

    def step(self, number: int = 1) -> None:
        self._done += number
        if self._on_progress is not None:
            self._on_progress(self._done, self._total, self._rocks * self._done)

    def counted(self, results: Iterable[Tried]) -> Iterator[Tried]:
        for one in results:
            self.step()
            yield one


def _saved(file: Path, fingerprint: str) -> list[Tried] | None:
    """Campaigns of an earlier attempt with the same settings; our own file, in our own folder."""
    try:
        known, made = pickle.loads(file.read_bytes())
    except (
        OSError,
        EOFError,
        pickle.UnpicklingError,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        ImportError,
    ):
        return None
    return list(made) if known == fingerprint else None


def _save(file: Path, fingerprint: str, made: Sequence[Tried]) -> None:
    part = file.with_suffix(".part")
    part.write_bytes(pickle.dumps((fingerprint, list(made))))
    part.replace(file)


# ---------------------------------------------------------------------------------------------
# Comparing


def _diagnosis(
    problem: CalibrationProblem,
    ensemble: Ensemble,
    frozen: Thresholds,
    run: CampaignMap,
    fingerprint: str,
    on_progress: OnProgress | None,
) -> tuple[Diagnosis, Ensemble]:
    """The answer, and the ensemble with all that was calibrated for it."""
    case, seed = problem.case, problem.seed
    tried = families_to_try(case)
    counter = _Counter(on_progress, REPETITIONS * REFINED * (_FURTHER + 1), case.n_rocks)

    def again(tasks: Sequence[tuple[str, Mapping[str, float], int]]) -> list[Tried]:
        return list(counter.counted(run(run_refined, tasks)))

    ensemble = refine(problem, ensemble, [NONE], again, repetitions=REPETITIONS, draws=REFINED)
    base = ensemble.tried[int(best_draws(ensemble, NONE)[0])].draw
    prints = _prints(case, base.model.table, seed)
    shares = shares_of(prints, tried)
    causes = [c for c in causes_of(prints, frozen, tried) if c != CONTACT_LAW]
    families = [*causes, *(n for n in shares if n in tried and n not in causes)]
    best = families[0]
    further = families[:_FURTHER]
    if len(causes) > 1:
        best = "+".join(sorted(causes[:2]))
        tasks = [(best, i) for i in range(_PAIR_DRAWS)]
        ensemble = ensemble.with_more(problem, list(run(_try, tasks)))
        further.append(best)
    ensemble = refine(problem, ensemble, further, again, repetitions=REPETITIONS, draws=REFINED)
    part = folds_of(case.n_rocks, seed)
    shrinkage = shrinkage_of(problem, ensemble, best, part, draws=_BOOTSTRAP, seed=seed)
    fitted = [ensemble.tried[i].draw for i in best_draws(ensemble, best).tolist()]
    findings = where(case, base.model.table, seed=seed, effects=case.effects, forest=case.forest)
    most = None if shrinkage.ci95 is None else shrinkage.ci95[1]
    verdict = verdict_of(prints, most, frozen, case, fitted, findings, tried)
    named = verdict.effect not in (NONE, UNKNOWN, CONTACT_LAW)
    if named and verdict.effect != best:
        best = verdict.effect
        shrinkage = shrinkage_of(problem, ensemble, best, part, draws=_BOOTSTRAP, seed=seed)
        fitted = [ensemble.tried[i].draw for i in best_draws(ensemble, best).tolist()]
    if verdict.effect == NONE:
        shrinkage = shrinkage_of(problem, ensemble, NONE, part, draws=0, seed=seed)
    elif not named:
        shrinkage = replace(
            shrinkage, note=f"No effect is named; this is of {best.replace('_', ' ')}, as a bound."
        )
    known = what_is_identifiable(case.observations)
    effect = fitted[0] if named else base
    diagnosis = Diagnosis(
        verdict=verdict,
        where=findings,
        which=_hypotheses(problem, ensemble, shares, best, part),
        shrinkage=shrinkage,
        rocks=case.n_rocks,
        tables={name: len(table) for name, table in case.observations.tables.items()},
        not_identifiable=known.not_identifiable,
        measure_next=measure_next(case, verdict.confusion_set),
        comparisons=_comparisons(problem, ensemble, best if named else ""),
        base=_calibrated(base),
        effect=_calibrated(effect),
        settings_hash=fingerprint,
        seed=seed,
        # Errors were logged while reading.
        warnings=tuple(str(f) for f in case.observations.findings if f.level == "warning"),
        fingerprints=prints,
    )
    return diagnosis, ensemble


def _prints(case: Case, table: GroundTable, seed: int) -> tuple[Fingerprint, ...]:
    """Fingerprints in the residuals of the calibrated base."""
    rng = np.random.default_rng([seed, 61])
    run = free_run(case, RunModel.of(case, table, None, None, seed), _REPLICATES)
    steps = steps_of(case, table, run, observed_at_stations(case), rng)
    return fingerprints(case, steps, rng=rng)


def _hypotheses(
    problem: CalibrationProblem,
    ensemble: Ensemble,
    shares: Mapping[str, float],
    best: str,
    part: np.ndarray[tuple[int], np.dtype[np.int64]],
) -> tuple[Hypothesis, ...]:
    """Everything that was tried, most probable first."""
    families = [name for name in shares if name not in (NONE, UNKNOWN, CONTACT_LAW)]
    names = [NONE, *families, *([best] if "+" in best else [])]
    base = held_out_scores(ensemble, NONE, part)
    rng = np.random.default_rng([problem.seed, 81])
    found = []
    for name in names:
        own = held_out_scores(ensemble, name, part)
        gain = gain_of(base, own, rng)
        top = [ensemble.tried[i].draw for i in best_draws(ensemble, name).tolist()]
        values = {k: _values(top, k) for k in top[0].parameters}
        found.append(
            Hypothesis(
                name,
                top[0].form,
                float(np.nanmean(own)),
                gain.value,
                (gain.low, gain.high),
                shares.get(name.split("+")[0], 0.0),
                dict(top[0].parameters),
                {k: (float(v.min()), float(v.max())) for k, v in values.items()},
            )
        )
    return tuple(sorted(found, key=lambda c: -c.probability))


def _values(draws: Sequence[Draw], name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([d.parameters[name] for d in draws if name in d.parameters], np.float64)


def _calibrated(draw: Draw) -> Calibrated:
    stand = draw.model.stand
    return Calibrated(
        table=draw.model.table,
        effects=draw.model.effects,
        sections=draw.sections,
        stand=None if stand is None else (stand.s0, stand.s1),
        stems_per_ha=None if stand is None else stand.stems_per_ha,
        dbh_cm=None if stand is None else stand.dbh_cm,
    )


_SHOWN = {
    "runout": ("runout_m", "m"),
    "aside": ("lateral_m", "m"),
    "speed": ("speed_mps", "m/s"),
    "rotation": ("rotation_hz", "1/s"),
    "height": ("height_m", "m"),
    "blocks": ("stops_per_rock", ""),
}


def _comparisons(
    problem: CalibrationProblem, ensemble: Ensemble, effect: str
) -> tuple[Comparison, ...]:
    """Distributions of every scored quantity: observed, calibrated base, and effect."""
    base = fitted_rows(ensemble, NONE)
    after = fitted_rows(ensemble, effect) if effect else None
    k = len(problem.scale.names)
    out = []
    for i, name in enumerate(problem.scale.names):
        place, _, what = name.partition(":")
        quantity, unit = _SHOWN[what]
        shown = "stop" if place == "stop" else problem.case.station_names[int(place[1:])]

        def values(
            rows: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
            i: int = i,
            what: str = what,
        ) -> tuple[float, ...]:
            there = rows[..., i + k] < 0.5
            found = rows[..., i][there] * problem.scale.scale[i] + problem.scale.centre[i]
            if what in ("speed", "blocks"):
                found = np.exp(found)
            return tuple(np.round(found, 4).tolist())

        out.append(
            Comparison(
                shown,
                quantity,
                unit,
                values(problem.rows),
                values(base),
                () if after is None else values(after),
            )
        )
    return tuple(out)


def _write_ensemble(
    file: Path, problem: CalibrationProblem, ensemble: Ensemble, effect: str
) -> None:
    """The calibrated models, and the scale on which their rocks are compared."""
    scale = problem.scale
    kept = {
        "seed": problem.seed,
        "effect": effect,
        "scale": {
            "names": list(scale.names),
            "centre": scale.centre.tolist(),
            "scale": scale.scale.tolist(),
        },
        **{
            name: [
                model_as_json(ensemble.tried[i].draw.model)
                for i in best_draws(ensemble, own).tolist()
            ]
            for name, own in (("base", NONE), ("effect", effect))
        },
    }
    file.write_text(json.dumps(kept, indent=1), encoding="utf-8")


def answer(config: str | Path, observations: str | Path, out: str | Path, **options: Any) -> None:
    """The diagnosis without map, figures and report: the numbers alone, for the blind check."""
    diagnose(config, observations, out, report=False, **options)
