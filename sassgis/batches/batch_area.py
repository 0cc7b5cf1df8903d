"""One release area of a batch: zoned on the part of the terrain that its fall lines need."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sassgis.batches.batch_window import (
    SEARCHED_CELLS,
    SIMULATION_NAME,
    Record,
    Sides,
    Windowed,
    cut_sides,
    digests_of_sums,
    near_edge,
    read_record,
    windowed,
    write_record,
    write_state,
)
from sassgis.errors import InputError, OutputError
from sassgis.files.atomic_output import MANIFEST_NAME, staged_output
from sassgis.files.digests import program_digest
from sassgis.files.input_parts import file_digest
from sassgis.grid import FloatArray, Grid
from sassgis.hazard.assess import Assessment, Rules
from sassgis.inputs.config import SECTIONS, settings_hash
from sassgis.inputs.dem import read_base_map
from sassgis.inputs.ground_map import ground_raster, read_ground_table
from sassgis.inputs.tiles import Part, Terrain, open_terrain
from sassgis.inputs.vector_features import Feature
from sassgis.inputs.vectors import (
    check_no_edits,
    read_control_lines,
    read_release_feature,
    release_area,
)
from sassgis.outputs.manifest import write_manifest
from sassgis.runs.inputs import (
    check_heights,
    collected_notices,
    forest_of,
    map_run_of,
    on_block_scale,
    read_rules,
    yearly_frequencies,
)
from sassgis.runs.resumable_run import Job, Simulation, Workplace
from sassgis.runs.run import prepared, write_zones, zone_simulation
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.ground import GroundTable
from sassgis.settings.map_run import Config, MapRun, ReleaseArea
from sassgis.settings.results import ControlLine, StopReason
from sassgis.settings.settings import ReleaseSettings
from sassgis.settings.statistics_table import SUM_NAMES
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.loop import TerrainTooSmall
from sassgis.simulation.workers import task_map
from sassgis.terrain.release import meeting, wkb_hex

AREAS_NAME = "areas"


@dataclass(frozen=True, slots=True)
class Candidate:
    """A release area that a batch is to run."""

    name: str
    stem: str  # name of its folder
    release: ReleaseSettings  # with the file and fields of this area
    number: int  # place in the layer, counted from 1
    problem: str = ""  # why it cannot be run; empty if nothing is known against it


@dataclass(frozen=True, slots=True)
class Setting:
    """Data shared by all areas of a batch."""

    config: Config
    terrain: Terrain
    table: GroundTable
    control_lines: tuple[tuple[ControlLine, FloatArray], ...]
    rules: Rules  # with all exposed objects, and no frequencies
    names: tuple[str, ...]  # of all areas
    digest: str  # of the settings and of all files but terrain and release areas
    sums_only: bool  # whether areas keep only what the mosaic is made of


def read_setting(
    config: Config, candidates: Sequence[Candidate], sums_only: bool
) -> tuple[Setting, tuple[str, ...]]:
    """Read and check what all areas share; what the readers had to say comes with it."""
    names = tuple(dict.fromkeys(c.name for c in candidates))
    with collected_notices() as notices:
        own = config.terrain
        terrain = open_terrain(config.dem_source, own.crs, own.vertical_datum, own.override_crs)
        outline = terrain.outline()
        read_base_map(config.project.base_map, outline)
        check_no_edits(config.edits)
        table = read_ground_table(config.ground.classes, config.engine.readings)
        control_lines = tuple(read_control_lines(config, outline))
        empty = map_run_of(config, outline, no_ground(outline), table, control_lines=control_lines)
        # The table of frequencies is read by area, with the names of all.
        hazard = replace(config.hazard, frequencies=None)
        rules = read_rules(replace(config, hazard=hazard), empty)
        yearly_frequencies(config, (), names)
    setting = Setting(
        config=config, terrain=terrain, table=table, control_lines=control_lines,
        rules=replace(rules, notices=()), names=names, digest=shared_digest(config),
        sums_only=sums_only,
    )  # fmt: skip
    return setting, tuple(dict.fromkeys((*config.notes, *notices, *rules.notices)))


def shared_digest(config: Config) -> str:
    """Return the fingerprint of the settings and of the files that all areas share."""
    own = replace(
        config,
        terrain=replace(config.terrain, dem=None),
        release=replace(config.release, file=None),
        hazard=replace(config.hazard, frequencies=None, preset=Path(config.hazard.preset).name),
        risk=replace(config.risk, vulnerability=None),
    )
    sections = [s for s in SECTIONS if s != "profile"]
    parts: list[object] = [program_digest(), settings_hash(own, sections=sections), SUM_NAMES]
    if config.risk.vulnerability is not None:
        parts.append(file_digest(config.risk.vulnerability))
    if config.hazard.preset.endswith(".toml"):
        parts.append(file_digest(config.hazard.preset))
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def area_feature(setting: Setting, candidate: Candidate) -> Feature:
    """Return the feature of an area, checked against the terrain model."""
    if candidate.problem:
        raise InputError(candidate.problem)
    return read_release_feature(candidate.release, candidate.number, setting.terrain.outline())


def _area_on(
    setting: Setting, candidate: Candidate, feature: Feature, part: Part
) -> tuple[Grid, ReleaseArea]:
    """Return the terrain of a part, and the area checked against it."""
    grid = setting.terrain.read(part)
    names = setting.config.block_names
    return grid, release_area(feature, candidate.name, candidate.release, grid, names)


def _control_lines_in(setting: Setting, grid: Grid) -> tuple[int, ...]:
    """Return stations and barriers that meet a part of the terrain."""
    return meeting([trace for _, trace in setting.control_lines], grid)


def _fingerprint(
    setting: Setting,
    part: Part,
    grid: Grid,
    area: ReleaseArea,
    frequencies: dict[tuple[str, str], float],
) -> str:
    """Return the fingerprint of all that the result of an area depends on."""
    head = [
        setting.digest,
        area.name,
        area.scenarios,
        sorted((*key, value) for key, value in frequencies.items()),
        wkb_hex(area.geometry),
        cut_sides(part, setting.terrain),
        [grid.west, grid.north, grid.cell_size, grid.crs, grid.vertical_datum, *grid.shape],
    ]
    digest = hashlib.sha256(json.dumps(head).encode())
    digest.update(grid.values.astype("<f8").tobytes())
    return digest.hexdigest()


def kept_areas(
    setting: Setting,
    candidates: Sequence[Candidate],
    folder: Path,
    overwrite: bool,
    tell: Callable[[str], None],
    at_once: int = 1,
) -> dict[str, Record]:
    """Return areas that are complete and were made from the same settings and inputs.

    So many processes look at them at once. OutputError: there is another result.
    """
    kept = {}
    folders = [folder / AREAS_NAME / c.stem for c in candidates]
    there = [
        (c, own) for c, own in zip(candidates, folders, strict=True)
        if own.is_dir() and any(own.iterdir())
    ]  # fmt: skip
    with task_map(setting, at_once) as each:
        for (candidate, own), (record, stated) in zip(there, each(_kept, there), strict=True):
            for text in stated:
                tell(text)
            if record is not None:
                kept[candidate.stem] = record
            elif not overwrite:
                raise OutputError(
                    f"{own}: exists and was made from other settings, inputs or versions, or has "
                    "changed; choose another folder, or --overwrite (edited files stay)"
                )
    if kept:
        tell(f"{len(kept)} of {len(candidates)} areas are complete")
    return kept


def _kept(setting: Setting, there: tuple[Candidate, Path]) -> tuple[Record | None, list[str]]:
    """Return the record of an area if it is complete and of the same inputs, and a note on it."""
    candidate, own = there
    stated: list[str] = []
    record = read_record(own, stated.append)
    if record is None:
        return None, stated
    same = False
    # An area that cannot be used any more is reported when it is its turn.
    with suppress(InputError), collected_notices():
        part = record.part(setting.terrain)
        feature = area_feature(setting, candidate)
        grid, area = _area_on(setting, candidate, feature, part)
        frequencies = yearly_frequencies(setting.config, (area,), setting.names)
        same = record.fingerprint == _fingerprint(setting, part, grid, area, frequencies)
        same &= setting.sums_only or not record.sums_only
    return (record if same else None), stated


def run_area(setting: Setting, candidate: Candidate, place: Workplace) -> Record:
    """Zone one area into its folder, which is that of the workplace.

    Where followed paths or fall lines come to the edge of its part of the terrain, it begins anew
    on a wider one.
    """
    margins: Sides = (1, 1, 1, 1)
    # What is read now may be another file than at the beginning of the batch.
    setting = replace(setting, digest=shared_digest(setting.config))
    while True:
        cut = area_window(setting, candidate, margins)
        try:
            return _run_cut(setting, candidate, cut, place)
        except TerrainTooSmall as small:
            place.tell("Paths leave this part of the terrain. Repeating on a wider one")
            margins = cut.wider(small.sides)


def _own_config(setting: Setting, candidate: Candidate) -> Config:
    """Return the configuration for one area."""
    project = setting.config.project
    named = replace(project, name=f"{project.name}: {candidate.name}")
    return replace(setting.config, release=candidate.release, project=named)


def area_window(setting: Setting, candidate: Candidate, margins: Sides) -> Windowed:
    """Return the run of an area on its part of the terrain, with ground and forest."""
    config = _own_config(setting, candidate)
    with collected_notices() as notices:
        feature = area_feature(setting, candidate)
        around = setting.terrain.part_of(feature.geometry.bounds).grown(*[SEARCHED_CELLS] * 4)
        around = around.common(setting.terrain.whole) or around
        terrain = setting.terrain.holding(around)
        _, area = _area_on(replace(setting, terrain=terrain), candidate, feature, around)

        def make(part: Part) -> MapRun:
            grid = terrain.read(part)
            lines = [setting.control_lines[i] for i in _control_lines_in(setting, grid)]
            # Ground and forest are of no account for fall lines.
            ground = no_ground(grid)
            return map_run_of(
                config, grid, ground, setting.table, control_lines=lines, areas=(area,)
            )

        width = setting.rules.ref_width_m
        cut = windowed(terrain, feature.geometry.bounds, width, make, margins=margins)
        check_heights(cut.run.grid, config.dem_source)
        whole = setting.terrain.outline()
        run = replace(
            on_block_scale(cut.run),
            ground=ground_raster(config.ground, cut.run.grid, setting.table, whole),
            forest=forest_of(config, cut.run.grid, whole),
        )
    return replace(cut, run=run, notices=tuple(notices))


def _run_cut(setting: Setting, candidate: Candidate, cut: Windowed, place: Workplace) -> Record:
    """Zone one area on its part of the terrain."""
    config, run, folder = _own_config(setting, candidate), cut.run, place.folder
    assert folder is not None
    frequencies = yearly_frequencies(config, run.areas, setting.names)
    placed = setting.rules.placed
    objects = meeting(placed.geometries, run.grid)
    rules = replace(
        setting.rules,
        frequencies=frequencies,
        placed=PlacedObjects(
            tuple(placed.objects[i] for i in objects), tuple(placed.geometries[i] for i in objects)
        ),
        vulnerability=setting.rules.vulnerability if objects else None,
        some_areas=len(setting.names) > 1,
    )
    job = prepared(Job(config, run, cut.planned, cut.notices), rules)
    with staged_output(folder, overwrite=True) as work:
        here = replace(place, folder=work)
        done = zone_simulation(job, rules, here, sums_only=setting.sums_only)
        if run.followed:
            met = near_edge(cut, setting.terrain, rules.ref_width_m, done.progress.lines)
            if any(met):
                raise TerrainTooSmall(met)
        write_state(work / SIMULATION_NAME, done.progress, done.run)
        furthest = done.progress.furthest
        record = Record(
            fingerprint=_fingerprint(setting, cut.part, run.grid, run.areas[0], frequencies),
            area=candidate.name, west=run.grid.west, north=run.grid.north,
            n_rows=cut.part.n_rows, n_cols=cut.part.n_cols,
            repetitions=done.run.repetitions, points=len(cut.planned.points),
            rocks=int(done.progress.reasons.sum()),
            furthest_m=None if furthest is None else round(furthest[0], 2), zones_m2={},
            control_lines=_control_lines_in(setting, run.grid), objects=objects,
            notices=cut.notices, sums_only=setting.sums_only,
            reached=sum(t.cells.counts().places.size for t in done.progress.sources.values()),
            counted=_counted(done.progress, cut.part.n_cols),
            never_started=int(done.progress.reasons[StopReason.NEVER_STARTED]),
            frequencies={scenario: annual for (_, scenario), annual in frequencies.items()},
            sums=digests_of_sums(work),
        )  # fmt: skip
        if setting.sums_only:
            write_record(work, record)
            _write_sums_manifest(work, config, done)
            return record

        def keep(found: Assessment) -> None:
            nonlocal record
            record = replace(record, zones_m2=_zones_m2(found, rules))
            write_record(work, record)

        write_zones(work, rules, done, [candidate.name], place.tell, first=keep)
    return record


def _write_sums_manifest(work: Path, config: Config, done: Simulation) -> None:
    """Write what makes the sums of an area a result; its inputs are listed with the mosaic."""
    grid = done.run.grid
    write_manifest(
        work / MANIFEST_NAME, inputs={}, base=config.base, crs=grid.crs,
        vertical_datum=grid.vertical_datum, seed=done.run.seed,
        ref_widths_m={"hazard": done.run.ref_width_m}, preset="", settings={},
        counts={"rocks": int(done.progress.reasons.sum())}, warnings=done.warnings,
    )  # fmt: skip


def _counted(progress: Progress, n_cols: int) -> tuple[int, int, int, int]:
    """Return the first row and column of the counts, and how many rows and columns they take."""
    own = [progress.sums.cells, *(t.cells.counts().places for t in progress.sources.values())]
    row, col = np.divmod(np.concatenate(own), n_cols)
    if not row.size:
        return 0, 0, 1, 1
    size = int(np.ptp(row)) + 1, int(np.ptp(col)) + 1
    return int(row.min()), int(col.min()), *size


def _zones_m2(found: Assessment, rules: Rules) -> dict[str, float]:
    """Return the area of the zones by the code of the hazard level."""
    levels = found.hazard.levels
    return {
        level.code: round(float(sum(p.area for p in levels.polygons[levels.classes == k])), 1)
        for k, level in enumerate(rules.preset.levels, start=1)
    }


def no_ground(grid: Grid) -> NDArray[np.int32]:
    """Return the ground of no account, which takes no memory."""
    return np.broadcast_to(np.zeros(1, np.int32), grid.shape)
