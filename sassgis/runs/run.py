"""The main job: from a configuration to maps, GeoPackage, QGIS project, figures and report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sassgis.files.atomic_output import staged_output
from sassgis.runs.inputs import collected_notices, placed_objects, with_objects
from sassgis.runs.resumable_run import (
    AnyConfig,
    Simulation,
    Workplace,
    configured,
    jobs_within,
    read_job,
    simulate_job,
)
from sassgis.runs.variant_lab import DrawnGround, drawn_ground, spread_rules
from sassgis.settings.languages import in_language, phrase
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import RasterLayer, StopReason
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.workers import Jobs, OnProgress
from sassgis.studies.variants import GroundSpread
from sassgis.terrain.plan import Plan

if TYPE_CHECKING:
    import xarray as xr

    from sassgis.report.page import ReportContext
    from sassgis.runs.publish import Published


_AUTO = (
    'hazard.blocks = "auto" is for zone and batch: run simulates {} blocks of each scenario at '
    "each release point (release.rocks_per_point)."
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
        from sassgis.runs.publish import Extras, publish_map
        from sassgis.runs.publish_ground import with_spread

        with in_language(config.project.language):
            extras = with_spread(Extras(placed=placed), drawn, work, simulation)
            published = publish_map(work, simulation, areas, tell, extras)
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
