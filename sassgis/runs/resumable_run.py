"""A run as a job: inputs that are read, a simulation that is saved and goes on after a stop."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sassgis.errors import ConfigError, Interrupted, OutputError
from sassgis.files.digests import value_digest
from sassgis.files.plain_file import seen_from
from sassgis.hazard.warnings import release_warnings, simulation_warnings
from sassgis.inputs.config import configure, load_config
from sassgis.outputs.frames import require_parquet
from sassgis.runs.inputs import collected_notices, input_digests, read_map_run
from sassgis.settings.languages import named, phrase
from sassgis.settings.map_run import BlockRows, Config, MapRun, Round
from sassgis.settings.process import give_back_arrays, give_back_freed, require_memory
from sassgis.settings.statistics_table import SUM_NAMES
from sassgis.simulation.accumulators import Progress, join_parts
from sassgis.simulation.checkpoint import Checkpoint
from sassgis.simulation.control_lines import QUANTITIES
from sassgis.simulation.estimate import estimate_of
from sassgis.simulation.loop import check_starts, check_tolerance, simulate_map
from sassgis.simulation.response import ToleranceCheck
from sassgis.simulation.reuse import KEPT_NAME, keep_areas
from sassgis.simulation.workers import Jobs, OnProgress, Workers, available_cores, held_back
from sassgis.terrain.prepare import Plan, plan

#: Seconds between two savings of the state of a run.
SAVE_EVERY_S = 60.0

_CHANGED = (
    "{} changed after it was read. The result comes from the former version; the digest in "
    "manifest.json is that of the present one. Run again."
)
#: Times that files are read, if they change meanwhile.
_READINGS = 3

#: A configuration: its file, its sections as a mapping, or what was read from either.
AnyConfig = Config | str | Path | Mapping[str, Any]
#: Gives another repetition of a run on its plan, after what there is so far; None: it is enough.
NextRound = Callable[[MapRun, Plan, Progress], Round | None]
#: Gives the progress from which a run begins.
Begin = Callable[[MapRun], Progress]


@dataclass(frozen=True, slots=True)
class Job:
    """A run that is ready to be simulated: inputs, plan, and what the readers had to say."""

    config: Config
    run: MapRun
    planned: Plan
    notices: tuple[str, ...]
    # Digests of its files as they were read, by file; none where they are not looked at again.
    read: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Workplace:
    """Where a job is worked on, by whom, and who is informed."""

    folder: Path | None  # working folder of the result; None where nothing is to be written
    jobs: Jobs
    on_progress: OnProgress | None
    tell: Callable[[str], None]  # called with a line of text now and then


@dataclass(frozen=True, slots=True)
class Simulation:
    """A run that has been simulated."""

    config: Config
    run: MapRun
    planned: Plan
    progress: Progress
    checkpoint: Checkpoint  # holds the rows for tables
    warnings: tuple[str, ...]
    seconds: float
    # How a sample depends on the tolerance of the segments; None where that was not asked.
    tolerance: ToleranceCheck | None = None
    # Folder of the earlier result whose areas in ``progress.reused`` were not simulated again.
    reused_from: Path | None = None

    @property
    def reused_areas(self) -> tuple[str, ...]:
        """Names of these areas."""
        return tuple(self.run.areas[i].name for i in self.progress.reused)


def configured(config: AnyConfig, seed: int | None) -> Config:
    """Return the configuration, read or made if need be, with another seed if one is given."""
    if isinstance(config, Mapping):
        config = configure(**config)
    if not isinstance(config, Config):
        return load_config(config, {} if seed is None else {"run.seed": seed})
    if seed is None:
        return config
    return replace(config, run=replace(config.run, seed=seed))


def read_job(config: Config, areas: Sequence[str] | None, tell: Callable[[str], None]) -> Job:
    """Read the inputs of a run and place its release points."""
    give_back_arrays()
    tell("Reading the inputs")
    digests = input_digests(config)
    for _ in range(_READINGS):
        with collected_notices() as notices:
            run = read_map_run(config, areas)
        before, digests = digests, input_digests(config)
        if digests == before:
            break
    check_means(config, run)
    tell("Placing the release points")
    return Job(config, run, plan(run), (*config.notes, *notices), digests)


def check_means(config: Config, run: MapRun, jobs: Jobs = None) -> None:
    """Check that there is what a run needs: memory, of a cluster in this process, and pyarrow."""
    if "parquet" in (config.output.rock_table, config.output.passage_table):
        require_parquet()
    workers = workers_asked(config, jobs)
    require_memory(estimate_of(run, workers if isinstance(workers, int) else 1).need, config.file)


def jobs_within(config: Config, run: MapRun, jobs: Jobs, memory_gb: float | None) -> Jobs:
    """Return as many of the threads asked for as fit into a memory; other workers as they are."""
    if memory_gb is None:
        return jobs
    most, asked = int(memory_gb * 1e9), workers_asked(config, jobs)
    threads = asked if isinstance(asked, int) else 1
    while threads > 1 and sum(estimate_of(run, threads).need.values()) > most:
        threads -= 1
    require_memory(estimate_of(run, threads).need, config.file, most)
    return threads if isinstance(asked, int) else asked


def simulate_job(
    job: Job,
    place: Workplace,
    *,
    next_round: NextRound | None = None,
    schedule: str = "",
    sums_only: bool = False,
    begin: Begin | None = None,
) -> Simulation:
    """Simulate a job; what is computed is kept in the working folder whatever happens.

    Parameters
    ----------
    next_round : callable, optional
        Asked after the repetitions of the run, and after each that it returns, for another one.
    schedule : str
        What the repetitions depend on: a saved state of another schedule is not used, as it may
        hold more of them than this one needs.
    sums_only : bool
        Whether only the sums are wanted, and written at once: no sample is repeated at other
        tolerances of the segments, and the state is not saved once more at the end.
    begin : callable, optional
        Gives the progress from which the run begins; default: nothing added yet. Sums of the
        release areas that it keeps apart are written with the result, and joined.
    """
    config, run, planned, tell = job.config, job.run, job.planned, place.tell
    check_means(config, run, place.jobs)
    jobs = workers_asked(config, place.jobs)
    check_starts(run, planned.points, lambda: planned, config.release.file)
    checkpoint = Checkpoint(place.folder, state_fingerprint(config, run, schedule))
    began = time.perf_counter()
    progress = checkpoint.restore(run, tell)
    if progress is None:
        progress = Progress.fresh(run) if begin is None else begin(run)
    else:
        tell(f"Resuming after {progress.chunks} chunks of an interrupted run")
    while True:
        give_back_freed()
        run = replace(run, rounds=progress.rounds)
        tell("Simulating")
        simulate_saved(
            run, planned, progress, checkpoint, jobs,
            on_progress=place.on_progress, rows=keeps_rows(config),
        )  # fmt: skip
        more = None if next_round is None else next_round(run, planned, progress)
        if more is not None:
            progress.rounds = (*progress.rounds, more)
            tell(f"The target needs further repetitions of all release areas: {more.repetitions}")
        if more is None:
            break
        checkpoint.save(progress, SAVE_EVERY_S)
    seconds = time.perf_counter() - began
    tolerance = None
    with ThreadPoolExecutor(1) as pool:
        # Whatever happens while the result is written, the simulation is not lost.
        saving = not sums_only or keeps_rows(config)
        kept = pool.submit(_keep, checkpoint if saving else None, place.folder, progress, run)
        try:
            if not sums_only:
                tell("Repeating a sample at half and double the tolerance")
                tolerance = check_tolerance(run, planned, jobs)
            kept.result()
        except KeyboardInterrupt:
            with held_back():
                kept.result()
            raise Interrupted(f"stopped by the user{checkpoint.kept}") from None
    if progress.parts is not None:
        join_parts(progress, run)
    give_back_freed()
    warnings = (
        *job.notices,
        *_changed(job),
        *(() if tolerance is None else tolerance.warnings()),
        *release_warnings(run, planned.points),
        *simulation_warnings(run, progress),
    )
    return Simulation(
        config=config, run=run, planned=planned, progress=progress, checkpoint=checkpoint,
        warnings=warnings, seconds=seconds, tolerance=tolerance,
    )  # fmt: skip


def _keep(
    checkpoint: Checkpoint | None, folder: Path | None, progress: Progress, run: MapRun
) -> None:
    """Save the state of a run at its end, and the sums of areas that are apart."""
    if checkpoint is not None:
        checkpoint.save(progress)
    if progress.parts is not None and folder is not None:
        keep_areas(folder / KEPT_NAME, progress, run)


def _changed(job: Job) -> list[str]:
    """Word the error on files that have changed since they were read."""
    now = input_digests(job.config) if job.read else {}
    return [
        phrase(_CHANGED, named(seen_from(job.config.base, Path(file))))
        for file, digest in job.read.items()
        if now[file] != digest
    ]


def state_fingerprint(config: Config, job: MapRun, schedule: str = "") -> str:
    """Fingerprint all that a saved state depends on: the run as read, and what tables keep."""
    # Digests of its files would not do: they may be edited while they are read.
    return value_digest((job, keeps_rows(config), schedule, SUM_NAMES, QUANTITIES))


def keeps_rows(config: Config) -> bool:
    """Return whether there will be a table of single blocks or passages."""
    return config.output.rock_table != "none" or config.output.passage_table != "none"


def workers_asked(config: Config, jobs: Jobs) -> int | Workers:
    """Return the workers: as asked, or as many threads or processes as configured; 0: all cores."""
    wanted = config.run.jobs if jobs is None else jobs
    if hasattr(wanted, "in_order"):
        return wanted
    if not isinstance(wanted, int) or wanted < 0:
        expected = "a number of processor cores, or 0 for all"
        raise ConfigError("cannot be used", field="jobs", found=repr(wanted), expected=expected)
    return wanted or available_cores()


def simulate_saved(
    run: MapRun,
    planned: Plan,
    progress: Progress,
    checkpoint: Checkpoint,
    jobs: int | Workers,
    *,
    on_progress: OnProgress | None = None,
    rows: bool = False,
) -> None:
    """Simulate, saving the growing progress now and then and when the user stops the run.

    With ``rows`` the checkpoint keeps those of single blocks.
    """
    began = time.monotonic()
    before = progress.seconds

    def on_chunk(now: Progress, chunks: int, own: BlockRows) -> None:
        now.seconds = before + time.monotonic() - began
        if rows:
            checkpoint.hand_on(own)
        checkpoint.save(now, SAVE_EVERY_S)
        if on_progress is not None:
            on_progress(now.chunks, chunks, now.simulated)

    try:
        simulate_map(run, planned, jobs=jobs, resume=progress, on_chunk=on_chunk)
    except (KeyboardInterrupt, OutputError) as stopped:
        with held_back():
            checkpoint.save(progress)
        if isinstance(stopped, OutputError):
            # The workers are lost.
            raise
        blocks = progress.simulated
        raise Interrupted(f"stopped by the user after {blocks} blocks{checkpoint.kept}") from None
