"""All areas of a batch on one map: their sums are added up from what each has left."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sassgis.hazard.assess import Assessment, felt_cells
from sassgis.hazard.progress import Progress
from sassgis.hazard.warnings import simulation_warnings
from sassgis.io.own_files import MANIFEST_NAME
from sassgis.io.read.config import resolved
from sassgis.io.read.ground_map import built_in_table, ground_raster
from sassgis.io.read.tiles import Part, hull
from sassgis.io.read.vectors import release_area, warn_of_overlaps
from sassgis.io.staging import staged_output, writing
from sassgis.io.write.layers.zones import joined_layers
from sassgis.io.write.manifest import write_manifest
from sassgis.model.grid import Grid
from sassgis.model.languages import in_language
from sassgis.model.release_areas import ReleaseArea
from sassgis.model.statistics_table import Bins
from sassgis.runs.batch_area import AREAS_NAME, Setting, area_feature, no_ground
from sassgis.runs.batch_areas import Candidate
from sassgis.runs.batch_blocks import (
    Reached,
    bins_of_place,
    bytes_needed,
    divided,
    shared,
    write_blocks,
)
from sassgis.runs.batch_layers import write_besides
from sassgis.runs.batch_state import Record, add_area, read_state
from sassgis.runs.batch_zones import ZoneTask, zones_by_group
from sassgis.runs.checkpoint import Checkpoint
from sassgis.runs.inputs import (
    collected_notices,
    compares_barriers,
    forest_of,
    input_files,
    map_run_of,
    yearly_frequencies,
)
from sassgis.runs.job import Job, Simulation, workers_asked
from sassgis.runs.workers import Jobs
from sassgis.runs.zone import without_barriers, write_zones
from sassgis.terrain.plan import plan

MOSAIC_NAME = "mosaic"
_FINGERPRINT_NAME = "batch.json"
#: A mosaic of more cells than this is made block by block, within this memory (bytes).
_MOST_CELLS, _COMMON_BYTES = 100_000_000, 4 << 30
_BY_BLOCKS = (
    "The mosaic was made block by block and has no report, no sheets, and no fall lines and stops "
    "of single blocks; more memory, or batches of neighbouring areas, give them."
)


def write_mosaic(
    setting: Setting,
    candidates: Sequence[Candidate],
    records: dict[str, Record],
    folder: Path,
    notices: tuple[str, ...],
    tell: Callable[[str], None],
    memory_bytes: int | None = None,
    jobs: Jobs = 1,
) -> tuple[Assessment | None, tuple[str, ...]]:
    """Add up all areas and write what they give together.

    Within ``memory_bytes``, if given: a mosaic for which that is not enough, or of more than a
    hundred million cells, is made block by block and has no report.
    """
    parts = [[records[c.stem].fingerprint for c in candidates], notices]
    fingerprint = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
    target = folder / MOSAIC_NAME
    if _same_mosaic(target, fingerprint):
        tell("The mosaic is there already")
        return None, notices
    tell("Adding up the areas")
    asked = workers_asked(setting.config, jobs)
    cores = asked if isinstance(asked, int) else 1
    blocks = _blocks(setting, candidates, records, folder, memory_bytes, cores)
    if blocks is not None:
        said = (*notices, *_said(list(records.values())), _BY_BLOCKS)
        with (
            staged_output(target, overwrite=True) as work,
            in_language(setting.config.project.language),
        ):
            _keep(work, fingerprint)
            said = _write_blocks(work, setting, candidates, blocks, said, cores, tell)
        return None, said
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
        if compares_barriers(config, job.run):
            without = simulation(without_barriers(job), without=True)

        def keep(_found: Assessment) -> None:
            _keep(work, fingerprint)

        names = [c.name for c in candidates]
        found, published = write_zones(work, rules, done, without, names, tell, keep)
    return found, published.warnings


def _keep(work: Path, fingerprint: str) -> None:
    path = work / _FINGERPRINT_NAME
    with writing(path):
        path.write_text(json.dumps({"fingerprint": fingerprint}) + "\n", encoding="utf-8")


@dataclass(frozen=True, slots=True)
class _Blocks:
    """How a mosaic is made block by block."""

    place: Part
    areas: tuple[Reached, ...]
    bins: Bins
    blocks: list[tuple[Part, list[Reached]]]
    memory_bytes: int
    at_once: int


def _blocks(
    setting: Setting,
    candidates: Sequence[Candidate],
    records: dict[str, Record],
    folder: Path,
    memory_bytes: int | None,
    cores: int,
) -> _Blocks | None:
    """The blocks of a mosaic that is too large to be made as a whole; None for others."""
    areas = tuple(
        Reached(c.name, own, folder / AREAS_NAME / c.stem, own.part(setting.terrain))
        for c in candidates
        for own in (records[c.stem],)
    )
    place = hull([a.part for a in areas])
    if memory_bytes is None and place.n_rows * place.n_cols <= _MOST_CELLS:
        return None
    bins = bins_of_place(setting.config, setting.terrain, place, setting.rules)
    most = memory_bytes or _COMMON_BYTES
    # Zones, tables, figures and the report take about as much again.
    if 2 * bytes_needed(place, areas, bins) <= most and place.n_rows * place.n_cols <= _MOST_CELLS:
        return None
    at_once, share = shared(most, cores)
    return _Blocks(place, areas, bins, divided(place, areas, bins, share), most, at_once)


def _write_blocks(
    work: Path,
    setting: Setting,
    candidates: Sequence[Candidate],
    made: _Blocks,
    warnings: tuple[str, ...],
    cores: int,
    tell: Callable[[str], None],
) -> tuple[str, ...]:
    """Write all that a mosaic has which is made block by block; its warnings."""
    config, rules, terrain, bins = setting.config, setting.rules, setting.terrain, made.bins
    frame = terrain.frame(made.place)
    # One cell is enough where only settings count: processes get all cells of a grid in full.
    cell = terrain.frame(Part(0, 0, 1, 1))
    empty = map_run_of(
        config, cell, no_ground(cell), setting.table, (), setting.control_lines, None
    )
    run = replace(
        empty, thresholds_kj=rules.preset.thresholds_kj, ref_width_m=rules.ref_width_m,
        repetitions=max(a.record.repetitions for a in made.areas),
    )  # fmt: skip
    maps = write_blocks(
        work / "maps", config, terrain, rules, run, made.place, made.blocks, made.areas, bins,
        made.at_once, tell,
    )  # fmt: skip
    beside = 4 * felt_cells(rules.zones, frame.cell_size)
    task = ZoneTask(config, terrain, rules, run, made.place, bins, beside)
    counted = [a for a in made.areas if a.record.reached]
    drawn, said = zones_by_group(task, counted, cores, made.memory_bytes, tell)
    warnings += said
    zones = joined_layers(drawn) if drawn else []
    write_besides(work, setting, run, frame, candidates, made.areas, bins, maps, zones)
    write_manifest(
        work / MANIFEST_NAME,
        inputs=input_files(config),
        base=config.file.parent,
        crs=frame.crs,
        vertical_datum=frame.vertical_datum,
        seed=config.run.seed,
        ref_widths_m={"reach_probability": frame.cell_size, "hazard": rules.ref_width_m},
        preset=rules.preset.name,
        settings=resolved(config),
        counts={
            "release_areas": len(made.areas),
            "release_points": sum(a.record.points for a in made.areas),
            "rocks": sum(a.record.rocks for a in made.areas),
        },
        warnings=warnings,
    )
    return warnings


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
    grid = terrain.read(place)
    # What there is to say of single areas was said when they were run.
    with collected_notices():
        areas = [_area_on_grid(setting, c, grid) for c in candidates]
    with collected_notices() as notices:
        warn_of_overlaps(areas, config.release_path)
    ground = ground_raster(config.ground, grid, setting.table, setting.outline())
    run = replace(
        map_run_of(
            config,
            grid,
            ground,
            setting.table,
            areas,
            setting.control_lines,
            forest_of(config, grid, setting.outline()),
        ),
        thresholds_kj=setting.rules.preset.thresholds_kj,
        ref_width_m=setting.rules.ref_width_m,
        repetitions=max(r.repetitions for r in own),
    )
    planned = replace(plan(run), repetitions=tuple(r.repetitions for r in own))
    return Job(run, planned, ()), place, (*_said(own), *notices)


def _said(own: Sequence[Record]) -> tuple[str, ...]:
    """What there is to say of the areas."""
    said = dict.fromkeys(text for r in own for text in r.notices)
    if len({r.repetitions for r in own}) > 1:
        said[
            "Areas had different numbers of repetitions: maps that count blocks (reach "
            "probability, energy, height) weigh them by blocks, those of hazard by frequency."
        ] = None
    return tuple(said)


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
        part, state = record.part(setting.terrain), read_state(folder, without)
        add_area(total, run, planned, place, i, record, part, state, share)
    return total
