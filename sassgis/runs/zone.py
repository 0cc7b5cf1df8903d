"""Hazard zoning: a run, what it says of the hazard with and without barriers, and the risk."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sassgis.engine.simulate import ObjectCells
from sassgis.hazard.assess import (
    curves_of,
    share_undecided,
)
from sassgis.hazard.curves import at_energies
from sassgis.hazard.sources import sampled_sources
from sassgis.io.read.objects import (
    object_cells,
)
from sassgis.io.write.staging import staged_output
from sassgis.model.results import RasterLayer
from sassgis.model.run_config import Config
from sassgis.runs.assessment import Assessment, Rules, assess, read_rules
from sassgis.runs.map import MapRun, Progress, bins_of
from sassgis.runs.run import (
    Job,
    OnProgress,
    RunResult,
    Simulation,
    configured,
    read_job,
    result_of,
    simulate_config,
    write_result,
)
from sassgis.runs.zone_outputs import zone_extras


@dataclass(frozen=True, slots=True)
class ZoneResult:
    """What zoning left: the run, the rules, and what was found."""

    run: RunResult
    rules: Rules
    found: Assessment
    seconds: float


def prepared(job: Job, rules: Rules) -> Job:
    """The job with the energies and objects at which the zoning needs counts."""
    cells, owner = object_cells(rules.placed, job.run.grid)
    run = replace(
        job.run,
        thresholds_kj=rules.preset.thresholds_kj,
        objects=ObjectCells(len(rules.placed), cells, owner),
        ref_width_m=rules.ref_width_m,
    )
    return Job(run, job.planned, (*job.notices, *rules.notices))


def without_barriers(job: Job) -> Job:
    """The job with its walls and nets as mere stations: they see rocks and hold none."""
    control_lines = tuple(
        (replace(g, kind="station"), course) for g, course in job.run.control_lines
    )
    return Job(replace(job.run, control_lines=control_lines), job.planned, ())


def zone(
    config: Config | str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    areas: Sequence[str] | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
) -> ZoneResult:
    """Run a configuration and make hazard zones, and the risk of exposed objects if there are any.

    Everything that sassgis.runs.run.run writes, and ``hazard.gpkg``, maps of level, intensity,
    return period and confidence, tables of zones, barriers and risk.

    Parameters
    ----------
    config, out, overwrite, areas, seed, jobs, on_progress, say
        As for sassgis.runs.run.run.

    Returns
    -------
    ZoneResult

    Raises
    ------
    ConfigError, InputError, OutputError
    Interrupted
        If the user stops the run; its state is kept.
    """
    config = configured(config, seed)
    tell = say or (lambda _text: None)
    with staged_output(Path(out), overwrite) as work:
        job = read_job(config, areas, tell)
        rules = read_rules(config, job.run)
        job = prepared(job, rules)
        began = time.perf_counter()
        done, bare = simulations(config, work, job, rules, jobs, on_progress, tell)
        found, layers, warnings = write_zones(work, rules, done, bare, areas, tell)
        seconds = time.perf_counter() - began
    result = result_of(Path(out), done, layers)
    result = replace(result, warnings=(*warnings, *result.warnings))
    return ZoneResult(result, rules, found, seconds)


def write_zones(
    work: Path,
    rules: Rules,
    done: Simulation,
    bare: Simulation | None,
    areas: Sequence[str] | None,
    tell: Callable[[str], None],
    first: Callable[[Assessment], None] | None = None,
) -> tuple[Assessment, tuple[RasterLayer, ...], tuple[str, ...]]:
    """Find the zones and write everything into ``work``.

    Parameters
    ----------
    work, done, areas, tell
        As for sassgis.runs.run.write_result.
    rules : Rules
    bare : Simulation or None
        The same rocks without walls and nets.
    first : callable, optional
        Called with what was found before anything is written.

    Returns
    -------
    found : Assessment
    layers : tuple of RasterLayer
        The maps of the rocks.
    warnings : tuple of str
        Of the zoning.
    """
    tell("Drawing the zones")
    found = assess(done.config, rules, done, bare)
    if first is not None:
        first(found)
    extras = zone_extras(done.config, rules, found, done, work / "figures")
    return found, write_result(work, done, areas, tell, extras), extras.warnings


def most_rounds(config: Config) -> int:
    """Rounds of rocks that a zoning may take."""
    return 1 if config.hazard.uncertain_share_max is None else config.hazard.repetitions_max


def simulations(
    config: Config,
    work: Path,
    job: Job,
    rules: Rules,
    jobs: int | None,
    on_progress: OnProgress | None,
    tell: Callable[[str], None],
) -> tuple[Simulation, Simulation | None]:
    """Simulate with the barriers and, if that is wanted, without them: the same rocks."""
    limit = config.hazard.uncertain_share_max
    confidence = config.hazard.confidence

    def enough(run: MapRun, progress: Progress) -> bool:
        assert limit is not None
        sampled = sampled_sources(run, progress, rules.frequencies)
        curves = curves_of(sampled, bins_of(run).threshold)
        few = at_energies(curves, rules.preset.thresholds_kj)
        share = share_undecided(few, rules.preset, confidence)
        tell(f"{100 * share:.1f} % of the reached cells are undecided")
        return share <= limit

    rounds_max = most_rounds(config)
    schedule = ""
    if rounds_max > 1:
        schedule = repr((limit, rounds_max, confidence, rules.preset, rules.frequencies))
    done = simulate_config(
        config, work, job, jobs=jobs, on_progress=on_progress, tell=tell, rounds_max=rounds_max,
        enough=None if limit is None else enough, schedule=schedule,
    )  # fmt: skip
    barriers = any(g.kind != "station" for g, _ in job.run.control_lines)
    if not (barriers and config.hazard.compare_barriers):
        return done, None
    tell("Once more without walls and nets")
    bare = simulate_config(
        config, work, without_barriers(job), jobs=jobs, on_progress=on_progress, tell=tell,
        rounds_max=done.run.rounds, schedule=schedule, part="without_barriers",
    )  # fmt: skip
    return done, bare
