"""Calibration of ground classes on observations; the case of a diagnosis and its warnings."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from sassgis.errors import InputError, Interrupted
from sassgis.files.atomic_output import CHECKPOINT_STEM, output_if_asked
from sassgis.files.digests import value_digest
from sassgis.files.input_parts import file_digest
from sassgis.gap.constants import (
    CALIBRATED_ROCKS,
    CLASS_COUNT,
    DIAGNOSED_ROCKS,
    LAW_BOUNDS,
    WARNED_GROUPS,
    WARNED_LEAVING,
    WARNED_LIMIT,
)
from sassgis.gap.fit.class_calibration import (
    SiteCalibration,
    budget_of,
    calibration_task,
    final_prediction,
    result_of,
    run_site,
    run_trial,
    search,
    spread_of_sites,
)
from sassgis.gap.fit.parameters import fitted_names, learned_contacts
from sassgis.gap.fit.site_data import SiteData, site_data_of
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.observations.case import Case, case_of, classes_met, drop_and_density
from sassgis.inputs.config import as_named, settings_hash
from sassgis.inputs.ground_map import read_ranges
from sassgis.inputs.observation_files import AnyObservations, observation_source, read_observations
from sassgis.outputs.frames import write_table
from sassgis.outputs.gap_files import (
    FITTED_NAME,
    write_calibrated_config,
    write_calibration_json,
    write_classes,
)
from sassgis.outputs.layers.variant_layers import rule_table
from sassgis.outputs.manifest import write_manifest
from sassgis.report.calibration_report import calibration_report, calibration_warnings
from sassgis.report.page import translated_report, write_report
from sassgis.runs.draw_store import DrawStore
from sassgis.runs.inputs import input_files, read_map_run
from sassgis.runs.resumable_run import AnyConfig, configured, workers_asked
from sassgis.settings.ground import PARAMETERS, GroundTable
from sassgis.settings.languages import counted, in_language, joined, phrase
from sassgis.settings.map_run import Config
from sassgis.settings.schema import Input
from sassgis.simulation.workers import Jobs, OnProgress, one_algebra_thread, task_map


def comparable(problem: SiteData, observations: AnyObservations) -> SiteData:
    """Return problem; InputError if nothing was measured that a simulation can be compared with."""
    if not problem.scored:
        tables = problem.case.observations.tables
        rows = ", ".join(f"{len(t)} {name}" for name, t in tables.items() if len(t))
        raise InputError(
            "nothing to compare simulations with",
            file=observations_name(observations), field="deposits, passages, impacts",
            found=rows or "no rows",
            expected="stops, passages at stations, of 5 rocks or more, or impacts",
        )  # fmt: skip
    return problem


def read_case(config: AnyConfig, observations: AnyObservations) -> Case:
    """Read a configuration and observations: a GeoPackage, a folder of CSV files, or the tables."""
    run = read_map_run(configured(config, None))
    seen = read_observations(observations, run.grid, *drop_and_density(run.blocks))
    return case_of(run, seen, observations_name(observations))


def observations_name(observations: AnyObservations) -> Path:
    """Return the name of the observations in messages."""
    return Path("observations" if isinstance(observations, Mapping) else observations)


def observed_files(case: Case) -> dict[str, Input]:
    """Return the files of the observations, each once, by their role."""
    files = sorted({*case.observations.files.values()}, key=str)
    return {f"observations {file.name}": file for file in files}


def fingerprint_of(config: Config, observations: AnyObservations, options: str) -> str:
    """Return the fingerprint of settings, inputs, observations and options."""
    digest = hashlib.sha256(settings_hash(config).encode())
    source = observation_source(observations)
    tables = {"": source} if isinstance(source, Path) else source
    digest.update("".join(f"{name} {file_digest(own)}" for name, own in tables.items()).encode())
    digest.update(options.encode())
    return digest.hexdigest()


def prepared_case(
    settings: AnyConfig, observations: AnyObservations, seed: int, ground: float
) -> Case:
    """Return a case with the contacts that were recorded, and the range of the ground.

    InputError if there are too few rocks for a diagnosis.
    """
    case = replace(read_case(settings, observations), ground_range=ground)
    # Before the contacts, which take their time.
    if case.n_rocks < DIAGNOSED_ROCKS:
        raise InputError(
            "too few rocks to distinguish a cause from chance",
            file=observations_name(observations),
            field="rocks",
            found=case.n_rocks,
            expected=f"{DIAGNOSED_ROCKS} or more",
        )
    return replace(case, learned=learned_contacts(case, seed))


def scenario_warnings(config: Config) -> tuple[str, ...]:
    """Warn that of several block scenarios only one counts."""
    if len(config.blocks) == 1:
        return ()
    text = "Unmeasured values of a rock are those of the first block scenario ({})."
    return (phrase(text, config.blocks[0].name),)


def group_warnings(case: Case) -> tuple[str, ...]:
    """Warn of too few groups to separate what their members share from a cause."""
    groups = np.unique(case.group).size
    if groups >= WARNED_GROUPS:
        return ()
    found = counted(groups, "The rocks form {} group.", "The rocks form {} groups.", groups)
    stated = phrase(
        "With fewer than {} groups, common features of a group cannot be separated from causes. "
        "Intervals are far too narrow.",
        WARNED_GROUPS,
    )
    return (joined(" ", (found, stated)),)


def stop_warnings(case: Case) -> tuple[str, ...]:
    """Warn that rocks passed the last station without a stop: the farthest may be among them."""
    seen = case.observations
    lying = seen.rock_of("deposits")
    if not (lying >= 0).any() or not case.station_names:
        return ()
    last = seen.passages.station == case.station_names[-1]
    lost = np.setdiff1d(seen.rock_of("passages")[last], [*lying, -1])
    if not lost.size:
        return ()
    text = (
        "Rocks that passed the last station and have no stop: {}. Observed run-outs may be too "
        "short."
    )
    return (phrase(text, lost.size),)


def limit_warnings(case: Case, model: HypothesisModel) -> tuple[str, ...]:
    """Warn that fitted values of the ground are as far as any ground has shown."""
    stated = {own.name: own for own in case.table.classes}
    met = [own for own in model.table.classes if own.name in case.met]
    found = [
        f"{own.name} {name} {getattr(own, name):.2g}"
        for own in met
        for name in LAW_BOUNDS
        if getattr(own, name) != getattr(stated[own.name], name)
        and _at_limit(name, getattr(own, name))
    ]
    if not found:
        return ()
    text = (
        "Values at the limit of all known grounds: {}. The contact may follow another law than "
        "the model's."
    )
    return (phrase(text, ", ".join(found)),)


def _at_limit(name: str, value: float) -> bool:
    low, high = LAW_BOUNDS[name]
    near = WARNED_LIMIT * (high - low)
    # Most ground has no loss that grows with the speed.
    return high - value < near or (value - low < near and name != "mu_v")


def edge_warnings(before: float, after: float) -> tuple[str, ...]:
    """Warn that rocks leave the terrain, as configured and in the model that is handed over."""
    if max(before, after) < WARNED_LEAVING:
        return ()
    text = (
        "{} % of the rocks of the configured model and {} % of those of the calibrated model "
        "reach the edge of the terrain model or the end of their fall line. They count as "
        "stopped there, but may go farther. Extend the terrain model."
    )
    return (phrase(text, *(f"{100.0 * share:.0f}" for share in (before, after))),)


def calibrate(
    sites: Sequence[tuple[AnyConfig, AnyObservations]],
    out: str | Path | None = None,
    *,
    classes: Sequence[str] | None = None,
    parameters: Sequence[str] | None = None,
    jobs: Jobs = 1,
    seed: int = 1,
    draws: int | None = None,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
) -> SiteCalibration:
    """Fit the parameters of ground classes that observed rocks can identify.

    The configuration that is written has the fitted classes only if they predict rocks left out
    better than the configured ones, by more than chance.

    Parameters
    ----------
    sites : sequence of (config, observations)
        Configurations, and for each a GeoPackage, a folder of CSV files, or DataFrames by name.
    out : path, optional
        Folder to write; without it nothing is written.
    classes, parameters : sequence of str, optional
        Ground classes to calibrate, default those that the rocks meet; and which of their
        parameters, default all that can be calibrated.
    jobs : int, optional
        Processes; 0 or None: all cores. The answer does not depend on it.
    draws : int, optional
        Parameter sets of each of the six rounds. Default: 4 for each parameter, at least 32.
    on_progress : callable, optional
        Called with draws done, draws in all, and rocks simulated.

    Raises
    ------
    ConfigError, InputError, OutputError
    Interrupted
        If the user stops it; what was computed is kept.
    """
    tell = say or (lambda _text: None)
    with one_algebra_thread(), output_if_asked(out, overwrite) as work:
        tell("Reading the inputs")
        try:
            given, observed = zip(*((config, own) for config, own in sites), strict=True)
        except (TypeError, ValueError):
            raise InputError(
                "cannot be used", field="sites", found=repr(sites),
                expected="a sequence of (configuration, observations)",
            ) from None  # fmt: skip
        configs = [configured(config, None) for config in given]
        for config in configs:
            for text in scenario_warnings(config):
                tell(f"{config.project.name}: {text}")
        names = fitted_names(parameters, [config.engine for config in configs])
        ready = _sites(configs, observed, seed)
        chosen = _chosen(ready, classes)
        rules = read_ranges(ready[0].case.table, configs[0].ground.ranges)
        task = calibration_task(ready, chosen, names, rules, seed)
        if task.measured < CALIBRATED_ROCKS:
            raise InputError(
                "too few rocks to calibrate on",
                file=observations_name(observed[0]),
                field="rocks",
                found=f"{task.measured} with a stop, a passage or an impact",
                expected=f"{CALIBRATED_ROCKS} or more",
            )
        file = work / f"{CHECKPOINT_STEM}.draws.npz"
        store = DrawStore(file, value_digest(task), tell)
        try:
            with task_map(task, workers_asked(configs[0], jobs)) as run:
                tell(
                    f"Calibrating {len(task.parameters)} parameters of {', '.join(chosen)} on "
                    f"{task.n_rocks} rocks"
                )
                budget = budget_of(task, draws)
                made = count(1)

                def step() -> None:
                    if on_progress is not None:
                        done = next(made)
                        on_progress(done, budget.trials, CLASS_COUNT * task.n_rocks * done)

                seen = partial(store.seen, run=partial(run, run_trial), step=step)
                found = search(task, seen, lambda due: list(run(run_site, due)), draws)
                tell("Predicting rocks left out")
                calibration = result_of(task, found, lambda due: list(run(final_prediction, due)))
        except KeyboardInterrupt:
            kept = "; what was computed is kept: run the same command to resume"
            raise Interrupted(f"stopped by the user{'' if out is None else kept}") from None
        if out is not None:
            tell("Writing the results")
            spread = rule_table(spread_of_sites(task, found, rules))
            write_table(work / "class_spread.csv", [spread])
            _write(work, configs, [s.case for s in ready], calibration)
    return calibration


def _sites(
    configs: Sequence[Config], observed: Sequence[AnyObservations], seed: int
) -> list[SiteData]:
    """Return the sites with names that differ; a class must be the same at all of them."""
    ready: list[SiteData] = []
    for config, of_site in zip(configs, observed, strict=True):
        name, number = config.project.name, 2
        while name in [s.name for s in ready]:
            name, number = f"{config.project.name} ({number})", number + 1
        problem = site_data_of(read_case(config, of_site), seed, name=name, sideways=False)
        ready.append(comparable(problem, of_site))
    known = {c.name: c for c in ready[0].case.table.classes}
    for site, config in zip(ready, configs, strict=True):
        for own in site.case.table.classes:
            other = known.setdefault(own.name, own)
            for column in PARAMETERS:
                one, two = getattr(other, column), getattr(own, column)
                if one != two:
                    raise InputError(
                        f"ground class {own.name!r} differs between the sites",
                        file=config.file, field=f"ground.classes, {column}",
                        found=f"{two:g} at {site.name}, {one:g} before",
                        expected="one table of classes for all sites",
                    )  # fmt: skip
    return ready


def _chosen(sites: Sequence[SiteData], asked: Sequence[str] | None) -> list[str]:
    """Return classes to calibrate: those that the rocks meet, or those asked for."""
    met = list(dict.fromkeys(name for site in sites for name in classes_met(site.case)))
    if asked is None:
        return met
    for name in asked:
        if name not in met:
            why = "is not a known ground class"
            if any(name in site.case.table.names for site in sites):
                why = "ground class is met by none of the rocks"
            expected = "some of " + ", ".join(met)
            raise InputError(why, field="classes", found=repr(name), expected=expected)
    return list(dict.fromkeys(asked))


def _write(
    work: Path, configs: Sequence[Config], cases: Sequence[Case], calibration: SiteCalibration
) -> None:
    """Write configurations to be run again, tables, figures, report and last the manifest."""
    classes = {c.name: c for case in reversed(cases) for c in case.table.classes}
    write_classes(work / FITTED_NAME, calibration, GroundTable(tuple(classes.values())))
    inputs: dict[str, Input] = {}
    settings = {}
    for k, (config, case) in enumerate(zip(configs, cases, strict=True)):
        name, mark = (f"config_{k + 1}.toml", f" ({k + 1})") if k else ("config.toml", "")
        write_calibrated_config(work / name, config, calibration)
        files = input_files(config) | observed_files(case)
        inputs |= {f"{role}{mark}": file for role, file in files.items()}
        settings[f"{config.label}{mark}"] = as_named(config)
    write_calibration_json(work / "calibration.json", calibration)
    warnings = [
        *dict.fromkeys(note for config in configs for note in config.notes),
        *calibration_warnings(calibration),
    ]
    with in_language(configs[0].project.language):
        labels = [config.label for config in configs]
        context = calibration_report(
            calibration, work / "figures", configurations=labels, warnings=warnings
        )
        write_report(work / "report.html", translated_report(context))
    counts = {
        "sites": len(cases), "rocks": calibration.rocks, "draws": calibration.draws,
        "parameters": len(calibration.fitted),
    }  # fmt: skip
    grid = cases[0].grid
    write_manifest(
        work / "manifest.json", inputs=inputs, base=configs[0].base, crs=grid.crs,
        vertical_datum=grid.vertical_datum, seed=calibration.seed, ref_widths_m={}, preset="",
        settings=settings, counts=counts, warnings=warnings,
    )  # fmt: skip
