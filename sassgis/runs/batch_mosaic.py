"""All areas of a batch on one map: their sums are added up from what each has left."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from sassgis.hazard.assess import Assessment
from sassgis.hazard.progress import Progress
from sassgis.hazard.warnings import simulation_warnings
from sassgis.io.read.ground_map import built_in_table, ground_raster
from sassgis.io.read.tiles import Part, hull
from sassgis.io.read.vectors import release_area, warn_of_overlaps
from sassgis.io.staging import staged_output, writing
from sassgis.model.errors import InputError
from sassgis.model.grid import Grid
from sassgis.model.release_areas import ReleaseArea
from sassgis.runs.batch_area import AREAS_NAME, Setting, area_feature
from sassgis.runs.batch_areas import Candidate
from sassgis.runs.batch_state import (
    SIMULATION_NAME,
    WITHOUT_BARRIERS_NAME,
    Record,
    add_area,
    read_state,
)
from sassgis.runs.checkpoint import Checkpoint
from sassgis.runs.inputs import collected_notices, forest_of, map_run_of, yearly_frequencies
from sassgis.runs.job import Job, Simulation
from sassgis.runs.zone import without_barriers, write_zones
from sassgis.terrain.plan import plan

MOSAIC_NAME = "mosaic"
_FINGERPRINT_NAME = "batch.json"
#: A mosaic of more cells than this fits no common machine.
_MOST_CELLS = 100_000_000


def write_mosaic(
    setting: Setting,
    candidates: Sequence[Candidate],
    records: dict[str, Record],
    folder: Path,
    notices: tuple[str, ...],
    tell: Callable[[str], None],
) -> tuple[Assessment | None, tuple[str, ...]]:
    """Add up all areas and write what they give together."""
    parts = [[records[c.stem].fingerprint for c in candidates], notices]
    fingerprint = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
    target = folder / MOSAIC_NAME
    if _same_mosaic(target, fingerprint):
        tell("The mosaic is there already")
        return None, notices
    tell("Adding up the areas")
    config = replace(
        setting.config,
        output=replace(setting.config.output, rock_table="none", passage_table="none"),
    )
    began = time.perf_counter()
    job, place, more = _mosaic_job(setting, candidates, records)
    frequencies = yearly_frequencies(config, job.run.areas, setting.names)
    rules = replace(setting.rules, frequencies=frequencies)
    own = [(records[c.stem], folder / AREAS_NAME / c.stem) for c in candidates]
    with staged_output(target, overwrite=True) as work:

        def simulation(job: Job, without: bool) -> Simulation:
            progress = _sum_of_areas(setting, job, place, own, without)
            warnings = (
                *notices,
                *more,
                *simulation_warnings(
                    job.run, progress, built_in_table(config.engine.readings).classes
                ),
            )
            seconds = time.perf_counter() - began
            checkpoint = Checkpoint(work, fingerprint)
            return Simulation(config, job.run, job.planned, progress, checkpoint, warnings, seconds)

        done = simulation(job, without=False)
        without = None
        barriers = any(g.kind != "station" for g, _ in job.run.control_lines)
        if barriers and config.hazard.compare_barriers:
            without = simulation(without_barriers(job), without=True)

        def keep(_found: Assessment) -> None:
            path = work / _FINGERPRINT_NAME
            with writing(path):
                path.write_text(json.dumps({"fingerprint": fingerprint}) + "\n", encoding="utf-8")

        names = [c.name for c in candidates]
        found, _, warnings = write_zones(work, rules, done, without, names, tell, keep)
    return found, (*warnings, *done.warnings)


def _same_mosaic(folder: Path, fingerprint: str) -> bool:
    try:
        stored = json.loads((folder / _FINGERPRINT_NAME).read_text(encoding="utf-8"))
        return bool(stored["fingerprint"] == fingerprint)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _mosaic_job(
    setting: Setting, candidates: Sequence[Candidate], records: dict[str, Record]
) -> tuple[Job, Part, tuple[str, ...]]:
    """The run of all areas on the parts of the terrain that they need, and what to say of it."""
    config, terrain = setting.config, setting.terrain
    own = [records[c.stem] for c in candidates]
    place = hull([r.part(terrain) for r in own])
    if place.n_rows * place.n_cols > _MOST_CELLS:
        raise InputError(
            "the areas lie too far apart for one mosaic",
            file=config.release_path,
            found=f"{place.n_cols} x {place.n_rows} cells",
            expected=f"at most {_MOST_CELLS} cells; the results of the areas are complete, and "
            "batches of neighbouring areas give mosaics",
        )
    grid = terrain.read(place)
    # What there is to say of single areas was said when they were run.
    with collected_notices():
        areas = [_area_on_grid(setting, c, grid) for c in candidates]
    with collected_notices() as notices:
        warn_of_overlaps(areas, config.release_path)
    ground = ground_raster(config.ground, grid, setting.table, setting.outline)
    run = replace(
        map_run_of(
            config,
            grid,
            ground,
            setting.table,
            areas,
            setting.control_lines,
            forest_of(config, grid, setting.outline),
        ),
        thresholds_kj=setting.rules.preset.thresholds_kj,
        ref_width_m=setting.rules.ref_width_m,
        repetitions=max(r.repetitions for r in own),
    )
    planned = replace(plan(run), repetitions=tuple(r.repetitions for r in own))
    said = dict.fromkeys(text for r in own for text in r.notices)
    if len({r.repetitions for r in own}) > 1:
        said[
            "Areas had different numbers of repetitions: maps that count blocks (reach "
            "probability, energy, height) weigh them by blocks, those of hazard by frequency."
        ] = None
    return Job(run, planned, ()), place, (*said, *notices)


def _area_on_grid(setting: Setting, candidate: Candidate, grid: Grid) -> ReleaseArea:
    feature = area_feature(setting, candidate)
    names = setting.config.block_names
    return release_area(feature, candidate.name, candidate.release, grid, names)


def _sum_of_areas(
    setting: Setting, job: Job, place: Part, own: Sequence[tuple[Record, Path]], without: bool
) -> Progress:
    """Add up what the areas left; one area is in memory at a time."""
    run, planned = job.run, job.planned
    total = Progress.fresh(run)
    released = int(sum(r.rocks for r, _ in own))
    share = run.stop_points_max / released if released else 1.0
    for i, (record, folder) in enumerate(own):
        file = folder / WITHOUT_BARRIERS_NAME
        if not without or not file.is_file():
            # Where an area has no walls and nets, both are the same.
            file = folder / SIMULATION_NAME
        part = record.part(setting.terrain)
        add_area(total, run, planned, place, i, record, part, read_state(file), share)
    return total
