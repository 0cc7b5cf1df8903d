"""The main job: from a configuration to maps, GeoPackage, project and report; hazard zoning."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sassgis.errors import ConfigError, InputError
from sassgis.files.atomic_output import MANIFEST_NAME, staged_output
from sassgis.files.saved_arrays import saved_digest
from sassgis.hazard.adaptive_sampling import MoreBlocks, check_budget
from sassgis.hazard.assess import Assessment, Rules, assess
from sassgis.hazard.sources import sampled_sources
from sassgis.inputs.config import as_named
from sassgis.inputs.result_folder import read_manifest
from sassgis.inputs.vectors import read_edits, release_names, with_earlier
from sassgis.outputs.manifest import plain
from sassgis.runs.inputs import (
    collected_notices,
    compared_run,
    placed_objects,
    read_rules,
    with_objects,
    with_rules,
)
from sassgis.runs.resumable_run import (
    AnyConfig,
    Job,
    Simulation,
    Workplace,
    configured,
    jobs_within,
    keeps_rows,
    read_job,
    simulate_job,
    workers_asked,
)
from sassgis.runs.variant_lab import DrawnGround, drawn_ground, spread_rules
from sassgis.settings.languages import in_language, phrase
from sassgis.settings.map_run import Config, MapRun
from sassgis.settings.process import give_back_freed
from sassgis.settings.results import RasterLayer, StopReason
from sassgis.settings.statistics_table import bins_of
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.reuse import KEPT_NAME, OtherInputs, begun_with
from sassgis.simulation.workers import Jobs, OnProgress, Workers
from sassgis.studies.result_change import setting_changes
from sassgis.studies.variants import GroundSpread
from sassgis.terrain.prepare import Plan

if TYPE_CHECKING:
    import xarray as xr

    from sassgis.report.page import ReportContext
    from sassgis.runs.publish import Published

_AUTO = (
    'hazard.blocks = "auto" applies to zone and batch. run simulates {} blocks of each scenario '
    "at each release point (release.rocks_per_point)."
)


_NOT_REUSED = (
    "an earlier result can be used again where there are walls, nets or galleries that are "
    "compared (hazard.compare_barriers), and no tables of single blocks or passages"
)


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of a run.

    ``run``, ``planned``, ``progress`` and ``layers`` are for further work in Python: inputs, plan,
    sums and all maps; ``maps`` returns these as a dataset.
    """

    folder: Path
    n_blocks: int  # simulated
    reasons: dict[StopReason, int]  # blocks by the reason of their end, with their weights
    warnings: tuple[str, ...]  # what the user should know before trusting the maps
    seconds: float  # of only the simulation
    run: MapRun = field(repr=False)
    planned: Plan = field(repr=False)
    progress: Progress = field(repr=False)
    layers: tuple[RasterLayer, ...] = field(repr=False)
    report: ReportContext = field(repr=False)  # a notebook shows it in short
    # Bands by the spread of the ground classes; None where no draws were asked for.
    spread: GroundSpread | None = field(default=None, repr=False)

    @property
    def maps(self) -> xr.Dataset:
        """All maps, as ``sassgis.simulate`` and ``sassgis.hazard_maps`` name them."""
        from sassgis.outputs.map_dataset import maps_dataset

        about = {"seed": self.run.seed, "blocks": self.n_blocks}
        return maps_dataset(self.layers, self.run.grid, about)

    def _repr_html_(self) -> str:
        from sassgis.report.page import in_short

        return in_short(self.report, self.folder)


def run(
    config: AnyConfig,
    out: str | Path,
    *,
    overwrite: bool = False,
    areas: Sequence[str] | None = None,
    seed: int | None = None,
    jobs: Jobs = None,
    memory_gb: float | None = None,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
) -> RunResult:
    """Run a configuration on the map and write everything.

    An interrupted run leaves its state next to ``out``; the same call goes on from there.

    Parameters
    ----------
    out : path
        Folder of the result; appears whole or not at all.
    areas : sequence of str, optional
        Names of the release areas to run; default: all. Their blocks are those of a run of all.
    seed, jobs : int, optional
        In place of those of the configuration.
    memory_gb : float, optional
        Memory that the run may take (GB): it limits the number of threads. What grows with the
        cells that blocks come to is not known before and not counted.
    on_progress : callable, optional
        Called with (chunks done, chunks in all, blocks done).
    say : callable, optional
        Called with a line of text now and then.

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
        if config.hazard.blocks == "auto":
            note = phrase(_AUTO, job.run.release.rocks_per_point)
            job = replace(job, notices=(*job.notices, note))
        jobs = jobs_within(config, job.run, jobs, memory_gb)
        # Read before the blocks are simulated: an error should not come at the end.
        with collected_notices():
            placed = placed_objects(config, job.run.grid)
        job = replace(job, run=with_objects(job.run, placed))
        known = spread_rules(config, job.run)
        place = Workplace(work, jobs, on_progress, tell)
        simulation = simulate_job(job, place)
        drawn = drawn_ground(simulation, place, known, None, placed)
        # What writes takes longer to load than what computes: not before there is a result.
        from sassgis.report.pictures import drawn_beside
        from sassgis.runs.publish import Extras, begun, publish_map, with_spread

        with in_language(config.project.language), drawn_beside(workers_asked(config, jobs)):
            extras = with_spread(Extras(placed=placed), drawn, work, simulation)
            blocks = begun(work, simulation, placed)
            published = publish_map(work, simulation, areas, tell, extras, blocks)
    return result_of(Path(out), simulation, published, drawn)


def result_of(
    out: Path, done: Simulation, published: Published, drawn: DrawnGround | None
) -> RunResult:
    """Return the result of a run."""
    layers, report, warnings = published
    return RunResult(
        folder=out, n_blocks=done.progress.simulated,
        reasons={r: int(done.progress.reasons[r]) for r in StopReason},
        warnings=warnings, seconds=done.seconds, run=done.run, planned=done.planned,
        progress=done.progress, layers=layers, report=report,
        spread=None if drawn is None else drawn[0],
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class ZoneResult:
    """Result of a zoning run: the run, the rules, and the zones."""

    run: RunResult
    rules: Rules = field(repr=False)
    found: Assessment = field(repr=False)
    seconds: float

    def _repr_html_(self) -> str:
        return self.run._repr_html_()


def prepared(job: Job, rules: Rules) -> Job:
    """Return the job with the energies and objects at which the zoning needs counts."""
    notices = (*job.notices, *rules.notices)
    return replace(job, run=with_rules(job.run, rules), notices=notices)


def zone(
    config: AnyConfig,
    out: str | Path,
    *,
    overwrite: bool = False,
    areas: Sequence[str] | None = None,
    seed: int | None = None,
    jobs: Jobs = None,
    memory_gb: float | None = None,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
    reuse: str | Path | None = None,
) -> ZoneResult:
    """Run a configuration and make hazard zones, and the risk of exposed objects if there are any.

    Everything that sassgis.runs.run.run writes, and ``hazard.gpkg``, maps of level, intensity,
    return period and confidence, tables of zones, barriers and risk. Parameters and errors are
    those of sassgis.runs.run.run, and ``reuse``: the folder of a result of the same inputs but for
    stations, walls, nets and galleries. Only release areas whose blocks come near one that has
    changed are simulated again, with as many blocks as there.
    """
    config = configured(config, seed)
    tell = say or (lambda _text: None)
    with staged_output(Path(out), overwrite) as work:
        job = read_job(config, areas, tell)
        rules = read_rules(config, job.run)
        edits = read_edits(config.edits, rules.preset, job.run.grid)
        some = areas is not None and len(job.run.areas) < len(release_names(config.release))
        rules = replace(rules, edits=with_earlier(edits, Path(out)), some_areas=some)
        job = prepared(job, rules)
        known = spread_rules(config, job.run)
        jobs = jobs_within(config, job.run, jobs, memory_gb)
        place = Workplace(work, jobs, on_progress, tell)
        began = time.perf_counter()
        earlier = None if reuse is None else Path(reuse)
        done = zone_simulation(job, rules, place, along_slope=True, reuse=earlier)
        drawn = drawn_ground(done, place, known, rules, rules.placed)
        found, published = write_zones(
            work, rules, done, areas, tell, drawn=drawn, jobs=workers_asked(config, jobs)
        )
        seconds = time.perf_counter() - began
    return ZoneResult(result_of(Path(out), done, published, drawn), rules, found, seconds)


def write_zones(
    work: Path,
    rules: Rules,
    done: Simulation,
    areas: Sequence[str] | None,
    tell: Callable[[str], None],
    *,
    first: Callable[[Assessment], None] | None = None,
    drawn: DrawnGround | None = None,
    jobs: int | Workers = 1,
) -> tuple[Assessment, Published]:
    """Find the zones and write everything into ``work``, in the language of the configuration.

    ``drawn`` are the results of draws of the ground classes. ``first`` is called with the results
    before a table or map is written. With more than one job a process next to this one draws
    figures.
    """
    # As in sassgis.runs.run.run: loaded when there is something to write.
    from sassgis.report.pictures import drawn_beside
    from sassgis.runs.publish import begun, publish_map, with_spread
    from sassgis.runs.publish_zones import zone_extras

    tell("Drawing the zones")
    language = done.config.project.language
    with drawn_beside(jobs):
        with in_language(language):
            # Their figures are drawn while this process makes the zones.
            blocks = begun(work, done, rules.placed)
        found = assessed(rules, done, jobs if isinstance(jobs, int) else 1)
        give_back_freed()
        if first is not None:
            first(found)
        with in_language(language):
            extras = zone_extras(rules, found, done, blocks.at_objects, work / "figures")
            extras = with_spread(extras, drawn, work, done, rules.preset)
            return found, publish_map(work, done, areas, tell, extras, blocks)


def assessed(rules: Rules, done: Simulation, jobs: int = 1) -> Assessment:
    """Assess hazard and risk from a simulation, with and without barriers, in so many threads."""
    # Loaded when there is something to draw.
    from sassgis.outputs.qgis.layout import drawing_on_sheet

    sources = partial(sampled_sources, done.run, done.progress, rules.frequencies)
    hazard = done.config.hazard
    metres = rules.ref_width_m, done.run.release.spacing_m, done.run.grid.cell_size
    return assess(
        rules, done.run.grid, bins_of(done.run).threshold, sources(),
        sources(barriers=False) if done.progress.compared else None,
        confidence=hazard.confidence, by_source=hazard.by_source,
        drawing_of=partial(drawing_on_sheet, done.config.zones, rules.preset.sheet, metres),
        jobs=jobs,
    )  # fmt: skip


def _reused(file: Path, tell: Callable[[str], None], config: Config, run: MapRun) -> Progress:
    """Begin with areas of an earlier result, and state which."""
    try:
        progress = begun_with(file, run)
    except OtherInputs as other:
        raise _with_values(other, file.parent, config) from None
    of_earlier = [area.name for i, area in enumerate(run.areas) if i in progress.reused]
    again = [area.name for i, area in enumerate(run.areas) if i not in progress.reused]
    tell(
        f"Reused from {file.parent}: {', '.join(of_earlier) or 'no area'}; "
        f"simulated again: {', '.join(again) or 'none'}"
    )
    return progress


def _with_values(other: OtherInputs, earlier: Path, config: Config) -> InputError:
    """Return the error with the values of the settings that differ, where it is settings."""
    if not (earlier / MANIFEST_NAME).is_file():
        return other
    keys = tuple(f"{key}." for key in (other.field or "").split(", "))
    changed = [
        own
        for own in setting_changes(read_manifest(earlier)["settings"], plain(as_named(config)))
        if f"{own.name}.".startswith(keys)
    ]
    if not changed:
        return other
    names, then, now = (", ".join(filter(None, texts)) or "nothing" for texts in zip(
        *((own.name, own.before, own.after) for own in changed), strict=True
    ))  # fmt: skip
    expected = f"{then}, as in the earlier result"
    return InputError(**other.parts(field=names, found=now, expected=expected))


def zone_simulation(
    job: Job,
    rules: Rules,
    place: Workplace,
    *,
    sums_only: bool = False,
    along_slope: bool = False,
    reuse: Path | None = None,
) -> Simulation:
    """Simulate with the barriers and, if that is wanted, the same blocks without them.

    ``sums_only`` as for simulate_job; ``along_slope``: without barriers blocks are recorded at
    copies of the lines along the slope, too, and the sums of the release areas are kept for
    another run. ``reuse`` is the folder of a result from which such sums are taken; its blocks are
    those of that result, also where the budget allows for more.
    """
    run, budget, more, schedule = job.run, job.config.hazard.budget, None, ""
    if budget is not None:
        check_budget(job.config, run, int(job.planned.blocks_of_point(run).sum()))
        more = MoreBlocks(rules, budget, budget.seconds, place.tell, adds=reuse is None)
        schedule = repr((budget, rules.preset, rules.frequencies))
    job = replace(job, run=compared_run(job.config, run, along_slope))
    begin = None
    if along_slope and job.run.compared is not None and not keeps_rows(job.config):
        begin = partial(Progress.fresh, apart=True)
    if reuse is not None:
        if begin is None:
            raise ConfigError(_NOT_REUSED, file=job.config.file, field="barriers")
        begin = partial(_reused, reuse / KEPT_NAME, place.tell, job.config)
        schedule += f" {saved_digest(reuse / KEPT_NAME)}"
    done = simulate_job(
        job, place, next_round=more, schedule=schedule, sums_only=sums_only, begin=begin
    )
    return replace(done, run=replace(done.run, further_stations=None), reused_from=reuse)
