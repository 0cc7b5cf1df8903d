"""The main job: from a configuration to maps, GeoPackage, QGIS project, figures and report."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

import sassgis
from sassgis.io.qgis.layout import PrintLayout
from sassgis.io.qgis.project import LayerEntry, LayerGroup, write_project
from sassgis.io.read.config import Config, load_config, resolved, settings_hash
from sassgis.io.write.frames import passage_frame, require_parquet, rock_frame, rows_of, write_table
from sassgis.io.write.geopackage import VectorLayer, write_geopackage
from sassgis.io.write.layers import run_vectors as vector_layers
from sassgis.io.write.layers.maps import map_layers
from sassgis.io.write.manifest import write_manifest
from sassgis.io.write.raster import write_raster
from sassgis.io.write.staging import staged_output
from sassgis.model.crs import crs_name
from sassgis.model.errors import InputError, Interrupted
from sassgis.model.grid import Grid
from sassgis.model.profiles import LineEnd
from sassgis.model.results import Band, RasterLayer, StopReason
from sassgis.model.styles import HILLSHADE
from sassgis.report.map_report import map_report
from sassgis.report.page import ReportFigure, ReportTable, write_report
from sassgis.runs.checkpoint import Checkpoint
from sassgis.runs.inputs import (
    collected_notices,
    input_files,
    read_map_run,
    unverified_classes,
)
from sassgis.runs.interrupts import held_back
from sassgis.runs.map import (
    MapRun,
    Plan,
    Progress,
    Rows,
    bins_of,
    chunks_of,
    line_ends,
    plan,
    sample_of,
    simulate_map,
)

#: Seconds between two savings of the state of a run.
SAVE_EVERY_S = 60.0

#: Called with (chunks done, chunks in all, rocks done).
OnProgress = Callable[[int, int, int], None]


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run left.

    Attributes
    ----------
    folder : Path
    rocks : int
        Rocks that were followed.
    reasons : dict of StopReason to int
    warnings : tuple of str
        What the user should know before trusting the maps.
    seconds : float
        Time of the simulation alone.
    run, planned, progress, layers
        Inputs, plan, sums and layers, for further work in Python.
    """

    folder: Path
    rocks: int
    reasons: dict[StopReason, int]
    warnings: tuple[str, ...]
    seconds: float
    run: MapRun
    planned: Plan
    progress: Progress
    layers: tuple[RasterLayer, ...]


def warnings_of(run: MapRun, planned: Plan, progress: Progress) -> list[str]:
    """What happened to rocks and lines that a user must know of."""
    total = max(int(progress.reasons.sum()), 1)
    out = []
    ends = line_ends(progress)
    for end, what in (
        (LineEnd.LEFT_DEM, "reach the edge of the terrain model"),
        (LineEnd.NODATA, "run into nodata"),
        (LineEnd.MAX_LENGTH, "are cut at terrain.max_line_length_m"),
        (LineEnd.CLOSED_LOOP, "close upon themselves"),
    ):
        if ends[end]:
            out.append(f"{ends[end]} of {sum(ends.values())} fall lines {what}.")
    for reason, what in (
        (
            StopReason.LEFT_PROFILE,
            "still moved at the end of their fall line and are lost from the map",
        ),
        (StopReason.STEP_LIMIT, "were given up at engine.max_events contacts"),
        (
            StopReason.NEVER_STARTED,
            "never started: the slope at their release point is below the friction there "
            "(give blocks an initial speed if they should)",
        ),
    ):
        n = int(progress.reasons[reason])
        if n:
            out.append(f"{n} of {total} rocks ({100 * n / total:.2g} %) {what}.")
    if progress.lost:
        out.append(
            f"{progress.lost} rocks were not followed: their fall lines end where they begin "
            "(release points on nodata or at the edge of the terrain model). They are not part of "
            "the denominator of the reach probability."
        )
    asked = run.rocks_per_point
    given = run.rocks_per_line * run.lines_per_point
    if given != asked:
        out.append(
            f"Each release point lets go {given} rocks instead of {asked}: release.rocks_per_point "
            f"is shared among {run.lines_per_point} lines and rounded up."
        )
    idle = [
        g.name
        for i, (g, _) in enumerate(run.control_lines)
        if progress.control_lines.arrivals(i) == 0
    ]
    if idle:
        out.append("No rock comes to: " + ", ".join(idle) + ".")
    names = unverified_classes(run)
    if names:
        out.append(
            "Ground classes with values that are not from the paper (unverified): "
            + ", ".join(names)
            + "."
        )
    return out


def terrain_layer(grid: Grid) -> RasterLayer:
    """The heights, to be shown as relief."""
    return RasterLayer(
        "terrain",
        "Relief",
        f"Terrain model of the run. Heights: {grid.vertical_datum or 'datum not stated'}.",
        (Band("height", "Height of the terrain", "m", grid.values.astype(np.float32)),),
        (),
        HILLSHADE,
    )


def _extent(layers: tuple[RasterLayer, ...], grid: Grid) -> tuple[float, float, float, float]:
    """What rocks reach, with a margin."""
    reached = np.isfinite(layers[0].bands[0].values)
    if not reached.any():
        return grid.bounds
    rows = np.flatnonzero(reached.any(axis=1))
    cols = np.flatnonzero(reached.any(axis=0))
    margin = 0.05 * max(rows[-1] - rows[0], cols[-1] - cols[0], 10)
    c = grid.cell_size
    return (
        grid.west + (cols[0] - margin) * c,
        grid.north - (rows[-1] + 1 + margin) * c,
        grid.west + (cols[-1] + 1 + margin) * c,
        grid.north - (rows[0] - margin) * c,
    )


def _write_qgis(
    folder: Path,
    title: str,
    grid: Grid,
    layers: tuple[RasterLayer, ...],
    vectors: list[VectorLayer],
    extras: Extras,
) -> None:
    by_name = {v.name: v for v in vectors}

    def entries(*names: str, hidden: tuple[str, ...] = ()) -> tuple[LayerEntry, ...]:
        return tuple(
            LayerEntry(by_name[n], "result.gpkg", visible=n not in hidden)
            for n in names
            if n in by_name
        )

    maps = tuple(
        LayerEntry(
            layer, f"maps/{layer.stem}.tif", visible=layer.stem == "energy" and not extras.groups
        )
        for layer in layers
    )
    write_project(
        folder / "project.qgz",
        title=title,
        crs=grid.crs,
        groups=[
            *extras.groups,
            LayerGroup("Stations and measures", entries("barriers", "stations")),
            LayerGroup(
                "Release and fall lines",
                entries(
                    "release_areas",
                    "release_points",
                    "fall_lines",
                    "stops",
                    hidden=("release_points", "fall_lines", "stops"),
                ),
            ),
            LayerGroup("Footprint", entries("footprint", hidden=("footprint",))),
            LayerGroup("Maps", maps, exclusive=True),
            LayerGroup("Terrain", (LayerEntry(terrain_layer(grid), "maps/terrain.tif"),)),
        ],
        extent=_extent(layers, grid),
        abstract="Rockfall simulation with the SASS model (Bozzolo and Pamini, 1986). "
        f"Reach probabilities refer to a width of {grid.cell_size:.4g} m.",
        layouts=extras.layouts,
    )


def run(
    config: Config | str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    areas: Sequence[str] | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    on_progress: OnProgress | None = None,
    say: Callable[[str], None] | None = None,
) -> RunResult:
    """Run a configuration on the map and write everything.

    An interrupted run leaves its state beside ``out``; the same call goes on from there.

    Parameters
    ----------
    config : Config or path
    out : path
        Folder of the result; appears whole or not at all.
    overwrite : bool
        Whether a result that is there already may be replaced.
    areas : sequence of str, optional
        Names of the release areas to run; default: all. Their rocks are those of a run of all.
    seed, jobs : int, optional
        In place of those of the configuration.
    on_progress : callable, optional
        Called with (chunks done, chunks in all, rocks done).
    say : callable, optional
        Called with a line of text now and then.

    Returns
    -------
    RunResult

    Raises
    ------
    ConfigError, InputError, OutputError
    Interrupted
        If the user stops the run; its state is kept.
    """
    config = configured(config, seed)
    tell = say or (lambda _text: None)
    with staged_output(Path(out), overwrite) as work:
        simulation = simulate_config(
            config,
            work,
            read_job(config, areas, tell),
            jobs=jobs,
            on_progress=on_progress,
            tell=tell,
        )
        layers = write_result(work, simulation, areas, tell)
    return result_of(Path(out), simulation, layers)


def configured(config: Config | str | Path, seed: int | None) -> Config:
    """The configuration, read if need be, with another seed if one is given."""
    if not isinstance(config, Config):
        return load_config(config, {} if seed is None else {"run.seed": seed})
    if seed is None:
        return config
    return replace(config, run=config.run.model_copy(update={"seed": seed}))


@dataclass(frozen=True, slots=True)
class Job:
    """A run that is ready to be simulated: inputs, plan, and what the readers had to say."""

    run: MapRun
    planned: Plan
    notices: tuple[str, ...]


def read_job(config: Config, areas: Sequence[str] | None, tell: Callable[[str], None]) -> Job:
    """Read the inputs of a run and place its release points."""
    if "parquet" in (config.output.rock_table, config.output.passage_table):
        require_parquet()
    tell("Reading the inputs")
    with collected_notices() as notices:
        run = read_map_run(config, areas)
    tell("Placing the release points")
    return Job(run, plan(run), tuple(notices))


@dataclass(frozen=True, slots=True)
class Simulation:
    """A run that has been simulated.

    Attributes
    ----------
    config, run, planned, progress
    checkpoint : Checkpoint
        Holds the rows for tables.
    warnings : tuple of str
    seconds : float
    """

    config: Config
    run: MapRun
    planned: Plan
    progress: Progress
    checkpoint: Checkpoint
    warnings: tuple[str, ...]
    seconds: float


def simulate_config(
    config: Config,
    work: Path,
    job: Job,
    *,
    jobs: int | None,
    on_progress: OnProgress | None,
    tell: Callable[[str], None],
    rounds_max: int = 1,
    enough: Callable[[MapRun, Progress], bool] | None = None,
    schedule: str = "",
    part: str = "",
) -> Simulation:
    """Simulate a job; what is computed is kept in ``work`` whatever happens.

    Parameters
    ----------
    config : Config
    work : Path
        Working folder of the result.
    job : Job
    jobs, on_progress, tell
        As for run.
    rounds_max : int
        Most rounds of rocks.
    enough : callable, optional
        Asked after one, two, four, ... rounds whether they are enough; without it ``rounds_max``
        rounds are run.
    schedule : str
        What the number of rounds hangs on: a saved state of another schedule is not used, as it may
        hold more rounds than this one needs.
    part : str
        Tells the saved states of several simulations for one result apart.
    """
    run, planned = job.run, job.planned
    fingerprint = _state_fingerprint(config, run, schedule)
    checkpoint = Checkpoint(work, fingerprint, part)
    began = time.perf_counter()
    resumed = checkpoint.restore(run)
    progress = resumed if resumed is not None else Progress.fresh(run)
    if resumed is not None:
        tell(f"Going on after {resumed.chunks} chunks of an interrupted run")
    rounds = rounds_max if enough is None else 1
    done = -(-progress.chunks // max(len(chunks_of(planned)), 1))
    while rounds < min(done, rounds_max):
        rounds *= 2
    while True:
        rounds = min(rounds, rounds_max)
        run = replace(run, rounds=rounds)
        _simulate(config, run, planned, progress, checkpoint, jobs, on_progress, tell)
        if enough is None or rounds >= rounds_max or enough(run, progress):
            break
        rounds *= 2
        tell(f"Going on to {min(rounds, rounds_max)} rounds of rocks")
    seconds = time.perf_counter() - began
    warnings = (*job.notices, *warnings_of(run, planned, progress))
    return Simulation(config, run, planned, progress, checkpoint, warnings, seconds)


def result_of(out: Path, done: Simulation, layers: tuple[RasterLayer, ...]) -> RunResult:
    """What a run left."""
    reasons = {r: int(done.progress.reasons[r]) for r in StopReason}
    return RunResult(
        out, int(done.progress.reasons.sum()), reasons, done.warnings, done.seconds, done.run,
        done.planned, done.progress, layers,
    )  # fmt: skip


def _state_fingerprint(config: Config, job: MapRun, schedule: str = "") -> str:
    """Of all that a saved state hangs on, down to the version and to what is kept for tables."""
    parts = [
        sassgis.__version__,
        settings_hash(config),
        [a.name for a in job.areas],
        job.stop_points_max,
        _keeps_rows(config),
        [g.name for g, _ in job.control_lines],
        job.thresholds_kj,
        job.ref_width_m,
        schedule,
    ]
    digest = hashlib.sha256(json.dumps(parts).encode())
    for array in (job.objects.cell, job.objects.number):
        digest.update(array.tobytes())
    return digest.hexdigest()


def _keeps_rows(config: Config) -> bool:
    return config.output.rock_table != "none" or config.output.passage_table != "none"


def job_count(config: Config, jobs: int | None) -> int:
    """Threads to use: as asked, or all cores that this process may use."""
    import os

    wanted = config.run.jobs if jobs is None else jobs
    if wanted > 0:
        return wanted
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def _simulate(
    config: Config,
    job: MapRun,
    planned: Plan,
    progress: Progress,
    checkpoint: Checkpoint,
    jobs: int | None,
    on_progress: OnProgress | None,
    tell: Callable[[str], None],
) -> None:
    """Simulate, saving the state now and then and when the user stops the run."""
    keep = _keeps_rows(config)
    saved = time.monotonic()

    def on_chunk(now: Progress, chunks: int, rows: Rows) -> None:
        nonlocal saved
        if keep:
            checkpoint.hand_on(rows)
        if time.monotonic() - saved > SAVE_EVERY_S:
            checkpoint.save(now)
            saved = time.monotonic()
        if on_progress is not None:
            on_progress(now.chunks, chunks, int(now.reasons.sum()))

    tell("Following the rocks")
    try:
        simulate_map(job, planned, jobs=job_count(config, jobs), resume=progress, on_chunk=on_chunk)
    except KeyboardInterrupt:
        with held_back():
            checkpoint.save(progress)
        raise Interrupted(
            f"stopped by the user after {int(progress.reasons.sum())} rocks; what was computed is "
            f"kept in {checkpoint.folder}: the same command goes on from there"
        ) from None
    if not progress.reasons.sum():
        # An empty map would read as "no hazard".
        raise InputError(
            "no rock could be followed",
            file=config.release.file,
            field="release.file",
            found=f"{progress.lost} rocks, on fall lines that all end where they begin",
            expected="release areas on slopes, on known terrain and not at its edge",
        )
    # Whatever happens while the result is written, the simulation is not lost.
    checkpoint.save(progress)


@dataclass(frozen=True)
class Extras:
    """What a result holds besides the maps of the rocks themselves.

    Attributes
    ----------
    layers : tuple of RasterLayer
    vectors : tuple of VectorLayer
        Written to ``hazard.gpkg``.
    groups : tuple of LayerGroup
        On top of the project.
    layouts : tuple of PrintLayout
    figures : tuple of ReportFigure
    key_results : ReportTable or None
        Heads the report, in place of how rocks end.
    tables : tuple of ReportTable
    facts : dict
        Added to those of the run.
    described : tuple of (str, str)
        Added to what the report says was computed.
    frames : dict of str to DataFrame
        Written to ``tables/<name>.csv``.
    inputs : dict of str to Path
        Files that were read besides those of the run.
    warnings : tuple of str
    preset : str
    """

    layers: tuple[RasterLayer, ...] = ()
    vectors: tuple[VectorLayer, ...] = ()
    groups: tuple[LayerGroup, ...] = ()
    layouts: tuple[PrintLayout, ...] = ()
    figures: tuple[ReportFigure, ...] = ()
    key_results: ReportTable | None = None
    tables: tuple[ReportTable, ...] = ()
    facts: dict[str, object] = field(default_factory=dict)
    described: tuple[tuple[str, str], ...] = ()
    frames: dict[str, pd.DataFrame] = field(default_factory=dict)
    inputs: dict[str, Path] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    preset: str = ""


def write_result(
    work: Path,
    done: Simulation,
    areas: Sequence[str] | None,
    tell: Callable[[str], None],
    extras: Extras | None = None,
) -> tuple[RasterLayer, ...]:
    """Write everything; returns the maps of the rocks."""
    extras = extras or Extras()
    tell("Writing the maps")
    config, job, planned, progress = done.config, done.run, done.planned, done.progress
    warnings = [*extras.warnings, *done.warnings]
    bins = bins_of(job)
    sample = sample_of(job, planned, progress)
    layers = map_layers(
        progress.sums,
        job.grid.shape,
        sample,
        bins._asdict(),
        job.grid.cell_size,
        config.output.energy_classes_kj,
    )
    for layer in (*extras.layers, *layers, terrain_layer(job.grid)):
        write_raster(layer, job.grid, work / "maps")
    vectors = [
        vector_layers.release_areas(job, planned),
        vector_layers.release_points(job, planned),
        vector_layers.fall_lines(job, planned, progress),
        vector_layers.stops(job, planned, progress),
        vector_layers.stations(job, progress),
        vector_layers.barriers(job, progress),
        vector_layers.footprint(job, layers),
    ]
    counts = {
        "release_areas": len(job.areas),
        "release_points": len(planned.points),
        "fall_lines": sum(line_ends(progress).values()),
        "rocks": sample.rocks,
        "rocks_not_followed": progress.lost,
        "pieces": progress.pieces,
        **{f"rocks_{r.name.lower()}": int(progress.reasons[r]) for r in StopReason},
        **{f"lines_{e.name.lower()}": n for e, n in line_ends(progress).items()},
    }
    facts = {
        "program": f"sassgis {sassgis.__version__}",
        "model": "SASS (Bozzolo and Pamini, 1986)",
        "title": config.project.name,
        "crs": crs_name(job.grid.crs) if job.grid.crs else "local coordinates",
        "vertical_datum": job.grid.vertical_datum or "not stated",
        "seed": job.seed,
        "ref_width_m": job.grid.cell_size,
        "lateral_spread": job.lateral_spread,
        "effects": ", ".join(job.effects.names) or "none",
        "settings_hash": settings_hash(config),
        **extras.facts,
        **counts,
    }
    write_geopackage(work / "result.gpkg", vectors, facts)
    if extras.vectors:
        write_geopackage(work / "hazard.gpkg", extras.vectors, facts)
    _write_qgis(work, config.project.name, job.grid, layers, vectors, extras)
    for name, frame in extras.frames.items():
        write_table(work / "tables" / f"{name}.csv", [frame])
    if config.output.rock_table != "none":
        tell("Writing the table of rocks")
        write_table(
            work / "tables" / f"rocks.{config.output.rock_table}",
            (rock_frame(r, job, planned) for r in rows_of(done.checkpoint.rows())),
        )
    if config.output.passage_table != "none":
        tell("Writing the table of passages")
        write_table(
            work / "tables" / f"passages.{config.output.passage_table}",
            (passage_frame(r, job, planned) for r in rows_of(done.checkpoint.rows())),
        )
    tell("Drawing the figures")
    context = map_report(config, job, planned, progress, layers, warnings, facts, work / "figures")
    if extras.key_results is not None:
        assert context.key_results is not None
        context = replace(
            context,
            key_results=extras.key_results,
            tables=(context.key_results, *context.tables),
        )
    context = replace(
        context,
        figures=(*extras.figures, *context.figures),
        tables=(*extras.tables, *context.tables),
        what_was_run=(*extras.described, *context.what_was_run),
    )
    write_report(work / "report.html", context)
    write_manifest(
        work / "manifest.json",
        inputs=input_files(config) | extras.inputs,
        base=config.file.parent,
        crs=job.grid.crs,
        vertical_datum=job.grid.vertical_datum,
        seed=job.seed,
        ref_width_m=job.grid.cell_size,
        preset=extras.preset,
        settings=resolved(config)
        | ({} if areas is None else {"areas": sorted(areas)})
        | ({"zoning": extras.facts} if extras.facts else {}),
        counts=counts,
        warnings=warnings,
    )
    return layers
