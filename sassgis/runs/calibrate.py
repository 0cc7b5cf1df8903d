"""Calibration of ground classes on observations of one or several sites, from files to a report."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from sassgis.gap.calibration.fitting import (
    REPETITIONS,
    CalibrationTask,
    NumberedDraw,
    SiteCalibration,
    calibration_task,
    draws_of,
    final_replicas,
    result_of,
    rocks_simulated,
    score_draw,
    search,
)
from sassgis.gap.calibration.parameters import fitted_names
from sassgis.gap.calibration.site import CalibrationSite, site_of
from sassgis.io.read.config import load_config
from sassgis.io.staging import CHECKPOINT_STEM, staged_output
from sassgis.model.errors import InputError, Interrupted
from sassgis.model.grid import FloatArray
from sassgis.model.ground import PARAMETERS
from sassgis.model.run_config import Config
from sassgis.runs.calibration_outputs import write_calibration
from sassgis.runs.draw_store import DrawStore
from sassgis.runs.gap_case import fingerprint_of, read_case
from sassgis.runs.job import workers_asked
from sassgis.runs.workers import Jobs, TaskMap, task_map

#: With fewer rocks nothing can be said of their scatter.
_FEWEST = 3

OnProgress = Callable[[int, int, int], None]


def calibrate(
    sites: Sequence[tuple[str | Path, str | Path]],
    out: str | Path,
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

    Parameters
    ----------
    sites : sequence of (config, observations)
        Configurations, and for each a GeoPackage or a folder of CSV files.
    out : path
        Folder to write.
    classes : sequence of str, optional
        Ground classes to calibrate; default: those that the rocks meet.
    parameters : sequence of str, optional
        Default: all that can be calibrated.
    jobs : int, optional
        Processes; 0 or None: all cores. The answer does not depend on it.
    seed : int
    draws : int, optional
        Parameter sets of the first design; each of the six repetitions after it has a third of
        them. Default: 32 for each parameter, at least 96.
    overwrite : bool
    on_progress : callable, optional
        Called with draws done, draws in all, and rocks simulated.
    say : callable, optional

    Returns
    -------
    SiteCalibration

    Raises
    ------
    ConfigError, InputError, OutputError
    Interrupted
        If the user stops it; what was computed is kept.
    """
    tell = say or (lambda _text: None)
    # Threads of the linear algebra would change the last digits with the number of cores.
    with threadpool_limits(1, "blas"), staged_output(Path(out), overwrite) as work:
        tell("Reading the inputs")
        configs = [load_config(config) for config, _ in sites]
        files = [Path(observations) for _, observations in sites]
        names = fitted_names(parameters, [config.engine for config in configs])
        ready = _sites(configs, files)
        chosen = _chosen(ready, classes)
        task = calibration_task(ready, chosen, names, seed)
        if task.measured < _FEWEST:
            raise InputError(
                "too few rocks to calibrate on",
                file=files[0],
                field="rocks",
                found=f"{task.measured} with a stop, a passage or an impact",
                expected=f"{_FEWEST} or more",
            )
        file = work / f"{CHECKPOINT_STEM}.draws.npz"
        store = DrawStore(file, _fingerprint(configs, files, task), tell)
        try:
            with task_map(task, workers_asked(configs[0], jobs)) as run:
                tell(
                    f"Calibrating {len(task.parameters)} parameters of {', '.join(chosen)} on "
                    f"{task.n_rocks} rocks"
                )
                first, more = draws_of(task, draws)
                counted = _Counted(task, store, run, first + REPETITIONS * more, on_progress)
                found = search(task, counted, draws)
                tell("Predicting rocks left out")
                calibration = result_of(task, found, lambda tasks: list(run(final_replicas, tasks)))
        except KeyboardInterrupt:
            raise Interrupted(
                "stopped by the user; what was computed is kept: the same command goes on from "
                "there"
            ) from None
        tell("Writing the results")
        write_calibration(work, configs, [s.case for s in ready], calibration)
    return calibration


class _Counted:
    """Scores of draws, those of an interrupted run first, with the progress reported."""

    def __init__(
        self,
        task: CalibrationTask,
        store: DrawStore,
        run: TaskMap,
        total: int,
        on_progress: OnProgress | None,
    ) -> None:
        self._task, self._store, self._run = task, store, run
        self._total, self._on_progress, self._done = total, on_progress, 0

    def __call__(self, draws: Sequence[NumberedDraw]) -> list[FloatArray]:
        scores = [self._store.known(*one) for one in draws]
        due = [one for one, known in zip(draws, scores, strict=True) if known is None]
        self._step(len(draws) - len(due))
        made = iter(self._new(due))
        return [next(made) if known is None else known for known in scores]

    def _new(self, due: list[NumberedDraw]) -> list[FloatArray]:
        found = []
        for scores in self._store.keep(due, self._run(score_draw, due)):
            found.append(scores)
            self._step(1)
        return found

    def _step(self, number: int) -> None:
        self._done += number
        if self._on_progress is not None and number:
            rocks = rocks_simulated(self._task, self._done)
            self._on_progress(self._done, self._total, rocks)


def _sites(configs: Sequence[Config], files: Sequence[Path]) -> list[CalibrationSite]:
    """The sites with names that differ; a class must be the same at all of them."""
    ready: list[CalibrationSite] = []
    for config, file in zip(configs, files, strict=True):
        name, number = config.project.name, 2
        while name in [s.name for s in ready]:
            name, number = f"{config.project.name} ({number})", number + 1
        ready.append(site_of(name, read_case(config, file), str(file)))
    known = {c.name: c for c in ready[0].case.table.classes}
    for site, config in zip(ready, configs, strict=True):
        for own in site.case.table.classes:
            other = known.setdefault(own.name, own)
            for column in PARAMETERS:
                one, two = getattr(other, column), getattr(own, column)
                if one != two:
                    raise InputError(
                        f"ground class {own.name!r} differs between the sites",
                        file=config.file,
                        field=f"ground.classes, {column}",
                        found=f"{two:g} at {site.name}, {one:g} before",
                        expected="one table of classes for all sites",
                    )
    return ready


def _chosen(sites: Sequence[CalibrationSite], asked: Sequence[str] | None) -> list[str]:
    """Classes to calibrate: those that the rocks meet, or those asked for."""
    met = list(dict.fromkeys(name for site in sites for name in site.classes))
    if asked is None:
        return met
    for name in asked:
        if name not in met:
            known = any(name in site.case.table.names for site in sites)
            raise InputError(
                "ground class is met by none of the rocks"
                if known
                else "is not a known ground class",
                field="classes",
                found=repr(name),
                expected="some of " + ", ".join(met),
            )
    return list(dict.fromkeys(asked))


def _fingerprint(configs: Sequence[Config], files: Sequence[Path], task: CalibrationTask) -> str:
    """Of all that the scores of a draw depend on."""
    digest = hashlib.sha256()
    for config, file in zip(configs, files, strict=True):
        options = f"{task.seed} {[p.label for p in task.parameters]}"
        digest.update(fingerprint_of(config, file, options).encode())
    return digest.hexdigest()
