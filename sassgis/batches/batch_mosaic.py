"""All areas of a batch on one map, added up block by block from what each has left.

Counts are whole numbers, the frequencies of a cell are added up in the order of the areas, and the
limits of the histograms are those of the relief of the whole: maps are the same to the last bit
however many blocks there are. A mosaic that fits into one block is a run like any other and is
published as one. Of several blocks each has its maps, and zones are drawn group by group of areas
whose counts lie near each other.
"""

from __future__ import annotations

import hashlib
import json
import math
import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sassgis.batches.batch_area import AREAS_NAME, Candidate, Setting, area_feature, no_ground
from sassgis.batches.batch_window import Reached, Record, added_up
from sassgis.files.atomic_output import MANIFEST_NAME, staged_output, write_json, writing
from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import Grid
from sassgis.hazard.assess import Assessment, assess, curves_of, risk_of
from sassgis.hazard.levels import hazard_level
from sassgis.hazard.sampling_error import level_chances
from sassgis.hazard.sources import Sampled, line_parts, sampled_sources
from sassgis.hazard.warnings import simulation_warnings
from sassgis.hazard.zoning.drawing import reach_cells
from sassgis.inputs.ground_map import ground_raster
from sassgis.inputs.tiles import Part, hull
from sassgis.inputs.vectors import release_area, warn_of_overlaps
from sassgis.outputs.layers import run_vectors
from sassgis.outputs.layers.maps import terrain_layer
from sassgis.outputs.layers.risk_objects import exposed_layers
from sassgis.outputs.raster import TILE, BlockMaps, Unfinished, finish_map
from sassgis.runs.inputs import (
    collected_notices,
    compared_run,
    forest_of,
    map_run_of,
    with_rules,
    yearly_frequencies,
)
from sassgis.runs.provenance import facts_of, write_origin
from sassgis.runs.publish import block_maps, write_layers
from sassgis.runs.publish_zones import group_extras, group_zones, hazard_maps
from sassgis.runs.resumable_run import Simulation, workers_asked
from sassgis.runs.run import write_zones
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.languages import in_language
from sassgis.settings.map_run import MapRun, ReleaseArea, Round
from sassgis.settings.results import RasterLayer
from sassgis.settings.statistics_table import Bins, bins_for
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.checkpoint import Checkpoint
from sassgis.simulation.estimate import reached_bytes
from sassgis.simulation.map_sums import Sample
from sassgis.simulation.workers import Jobs, task_map
from sassgis.terrain.prepare import plan

MOSAIC_NAME = "mosaic"
#: What a mosaic was made from, and what was left out of it for want of memory.
_KEPT_NAME = "batch.json"
#: Of one block are mosaics of no more cells than this, if that is within the memory; else each
#: block is, and all that are at work (bytes).
_MOST_CELLS, _COMMON_BYTES = 100_000_000, 4 << 30
#: Bytes of the program itself, and of each cell of a block: its heights, and its maps.
BASE, _PER_CELL = 500 << 20, 600
#: Shapely geometries of release areas by their names.
Shapes = Mapping[str, Any]
#: Bytes of a process that draws zones, of each cell of its group with the lines that run through
#: it, and of a cell with counts of one area at each energy: rows of counts, squares, rates and
#: variances, and copies of them.
_ZONES_BASE, _ZONES_PER_CELL, _ZONES_PER_COUNT = 400 << 20, 215, 56
#: Smaller blocks are not made so that more can be at work (bytes, besides the program itself).
_LEAST_SHARE = 256 << 20
_SEVERAL_BLOCKS = (
    "The mosaic was made block by block and has no report, no sheets, and no fall lines and stops "
    "of single blocks; more memory, or batches of neighbouring areas, give them."
)


class Maps(NamedTuple):
    """Maps of a mosaic: of hazard, of what was simulated, of the terrain."""

    hazard: Sequence[RasterLayer]
    blocks: Sequence[RasterLayer]
    terrain: RasterLayer


@dataclass(frozen=True, slots=True)
class Mosaic:
    """Data common to all blocks of a mosaic."""

    setting: Setting
    run: MapRun  # with the settings of all areas; of its grid only the coordinate system counts
    place: Part  # of the lattice
    bins: Bins  # of the relief of the whole
    sample: Sample  # behind the maps: the blocks of all areas that started

    @property
    def beside(self) -> int:
        """Cells around counts within which drawing their zones looks at others."""
        return reach_cells(self.setting.rules.zones, self.run.grid.cell_size)


def write_mosaic(
    setting: Setting,
    candidates: Sequence[Candidate],
    records: dict[str, Record],
    folder: Path,
    *,
    notices: tuple[str, ...],
    tell: Callable[[str], None],
    memory_bytes: int | None = None,
    jobs: Jobs = 1,
) -> tuple[Assessment | None, tuple[str, ...]]:
    """Add up all areas and write what they give together, within ``memory_bytes`` if given.

    Returns the assessment, None if the mosaic is there already or has several blocks; and its
    warnings, also of one that is there already.
    """
    parts = [[records[c.stem].fingerprint for c in candidates], notices]
    fingerprint = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
    target = folder / MOSAIC_NAME
    known = kept_mosaic(target, fingerprint, memory_bytes)
    if known is not None:
        tell("The mosaic is complete")
        return None, known
    tell("Adding up the areas")
    areas = [
        Reached(c.name, own, folder / AREAS_NAME / c.stem, own.part(setting.terrain))
        for c in candidates
        for own in (records[c.stem],)
    ]
    mosaic = _mosaic(setting, areas)
    asked = workers_asked(setting.config, jobs)
    cores = asked if isinstance(asked, int) else 1
    most = memory_bytes or _COMMON_BYTES
    cells = mosaic.place.n_rows * mosaic.place.n_cols
    # Zones, tables, figures and the report take about as much again as the maps.
    whole = 2 * bytes_needed(mosaic.place, areas, mosaic.bins)
    fits = memory_bytes is None or whole <= most
    warnings = (*notices, *_said(areas))
    with staged_output(target, overwrite=True) as work:

        def keep(zones: Sequence[int] = (), report: int | None = None) -> None:
            left_out = {"zones_bytes": list(zones), "report_bytes": report}
            write_json(work / _KEPT_NAME, {"fingerprint": fingerprint, **left_out})

        if fits and cells <= _MOST_CELLS:
            return _write_one_block(
                work, mosaic, candidates, areas, warnings=warnings, tell=tell,
                fingerprint=fingerprint, keep=keep,
            )  # fmt: skip
        with in_language(setting.config.project.language):
            rules = replace(setting.rules, in_part=True)
            mosaic = replace(mosaic, setting=replace(setting, rules=rules))
            return None, _write_blocks(
                work, mosaic, candidates, areas, warnings=(*warnings, _SEVERAL_BLOCKS),
                memory_bytes=most, cores=cores, tell=tell,
                keep=partial(keep, report=whole if cells <= _MOST_CELLS else None),
            )  # fmt: skip


def kept_mosaic(folder: Path, fingerprint: str, memory_bytes: int | None) -> tuple[str, ...] | None:
    """Return warnings of the mosaic that is there; None if it is another, or can be completed.

    What was left out for want of memory is made as soon as ``memory_bytes`` are enough for it.
    """
    try:
        stored, manifest = (
            json.loads((folder / name).read_text(encoding="utf-8"))
            for name in (_KEPT_NAME, MANIFEST_NAME)
        )
        report = stored["report_bytes"]
        fits = report is not None and (memory_bytes is None or report <= memory_bytes)
        most = memory_bytes or _COMMON_BYTES
        more = fits or any(need <= most for need in stored["zones_bytes"])
        return None if more or stored["fingerprint"] != fingerprint else tuple(manifest["warnings"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _mosaic(setting: Setting, areas: Sequence[Reached]) -> Mosaic:
    config, rules, terrain = setting.config, setting.rules, setting.terrain
    place = hull([a.part for a in areas])
    low, high = np.inf, -np.inf
    # Strip by strip: the place may be larger than the memory.
    for row in range(0, place.n_rows, TILE):
        strip = Part(place.row + row, place.col, min(TILE, place.n_rows - row), place.n_cols)
        heights = terrain.read(strip).values
        low = min(low, float(np.nanmin(heights, initial=np.inf)))
        high = max(high, float(np.nanmax(heights, initial=-np.inf)))
    bins = bins_for(high - low, config.blocks, config.engine, rules.preset.thresholds_kj)
    # One cell is enough where only settings count: processes get all cells of a grid in full.
    cell = terrain.frame(Part(0, 0, 1, 1))
    lines = setting.control_lines
    run = replace(
        map_run_of(config, cell, no_ground(cell), setting.table, control_lines=lines),
        thresholds_kj=rules.preset.thresholds_kj,
        ref_width_m=rules.ref_width_m,
        rounds=(Round(0, max(a.record.repetitions for a in areas)),),
    )
    rocks = sum(a.record.rocks for a in areas)
    sample = Sample(
        started=rocks - sum(a.record.never_started for a in areas),
        rocks_per_line=run.release.rocks_per_point,
        lines=rocks // run.release.rocks_per_point,
        random_points=run.release.placement == "random",
    )
    return Mosaic(setting, run, place, bins, sample)


def _said(areas: Sequence[Reached]) -> tuple[str, ...]:
    """Return warnings and notes on the areas."""
    said = dict.fromkeys(text for a in areas for text in a.record.notices)
    if len({a.record.repetitions for a in areas}) > 1:
        said[
            "Areas had different numbers of repetitions. Maps that count blocks (reach "
            "probability, energy, height) weight areas by blocks. Hazard maps weight them by "
            "frequency."
        ] = None
    return tuple(said)


def _write_one_block(
    work: Path,
    mosaic: Mosaic,
    candidates: Sequence[Candidate],
    areas: Sequence[Reached],
    *,
    warnings: tuple[str, ...],
    tell: Callable[[str], None],
    fingerprint: str,
    keep: Callable[[], None],
) -> tuple[Assessment, tuple[str, ...]]:
    """Publish a mosaic of one block as a zoning of all areas."""
    began = time.perf_counter()
    setting, config = mosaic.setting, mosaic.setting.config
    grid = setting.terrain.read(mosaic.place)
    # Warnings of single areas were given when they were run.
    with collected_notices():
        released = [
            release_area(area_feature(setting, c), c.name, c.release, grid, config.block_names)
            for c in candidates
        ]
    with collected_notices() as overlaps:
        warn_of_overlaps(released, config.release_source)
    whole = setting.terrain.outline()
    run = replace(
        mosaic.run,
        grid=grid,
        ground=ground_raster(config.ground, grid, setting.table, whole),
        areas=tuple(released),
        forest=forest_of(config, grid, whole),
    )
    planned = replace(plan(run), repetitions=tuple(a.record.repetitions for a in areas))
    rules = replace(setting.rules, frequencies=yearly_frequencies(config, released, setting.names))
    run = with_rules(run, rules)
    # Tables of single blocks and passages are in the folders of the areas.
    output = replace(config.output, rock_table="none", passage_table="none")

    progress = added_up(
        compared_run(config, run), mosaic.place, areas, mosaic.bins, planned=planned
    )
    said = (*warnings, *overlaps, *simulation_warnings(run, progress))
    done = Simulation(
        config=replace(config, output=output), run=run, planned=planned, progress=progress,
        checkpoint=Checkpoint(work, fingerprint), warnings=said,
        seconds=time.perf_counter() - began,
    )  # fmt: skip
    names = [c.name for c in candidates]
    found, (_, _, said) = write_zones(work, rules, done, names, tell, first=lambda _found: keep())
    return found, said


def bytes_needed(place: Part, areas: Sequence[Reached], bins: Bins) -> int:
    """Estimate the memory (bytes) of the maps of a place, with all that its areas counted there."""
    reached = math.ceil(sum(a.record.reached * _share_in(a, place) for a in areas))
    return BASE + place.n_rows * place.n_cols * _PER_CELL + reached * reached_bytes(bins)


def _share_in(area: Reached, place: Part) -> float:
    """Return the share within a place of the part in which an area has counted."""
    own, here = area.counted, area.counted.common(place)
    return 0.0 if here is None else here.n_rows * here.n_cols / (own.n_rows * own.n_cols)


def shared(memory_bytes: int, cores: int) -> tuple[int, int]:
    """Count the blocks that may be at work at the same time, and the memory of each (bytes).

    As many results wait to be written, in this process, as are at work.
    """
    for n in range(cores, 1, -1):
        left = memory_bytes - (n + 1) * BASE
        if left >= 2 * (n + 1) * _LEAST_SHARE:
            return n, BASE + left // (2 * (n + 1))
    return 1, memory_bytes


def divided(
    place: Part, areas: Sequence[Reached], bins: Bins, memory_bytes: int
) -> list[tuple[Part, list[Reached]]]:
    """Return blocks of a place that fit into the memory, with the areas that meet each.

    Blocks are halved until they fit; those of one tile of the files are not divided any more.
    """
    own = [a for a in areas if a.counted.common(place) is not None]
    row, col, n_rows, n_cols = place.row, place.col, place.n_rows, place.n_cols
    if bytes_needed(place, own, bins) <= memory_bytes or max(n_rows, n_cols) <= TILE:
        return [(place, own)]
    cut = TILE * -(-max(n_rows, n_cols) // (2 * TILE))
    if n_rows >= n_cols:
        halves = Part(row, col, cut, n_cols), Part(row + cut, col, n_rows - cut, n_cols)
    else:
        halves = Part(row, col, n_rows, cut), Part(row, col + cut, n_rows, n_cols - cut)
    return [block for half in halves for block in divided(half, own, bins, memory_bytes)]


def _write_blocks(
    work: Path,
    mosaic: Mosaic,
    candidates: Sequence[Candidate],
    areas: Sequence[Reached],
    *,
    warnings: tuple[str, ...],
    memory_bytes: int,
    cores: int,
    tell: Callable[[str], None],
    keep: Callable[[Sequence[int]], None],
) -> tuple[str, ...]:
    """Write all that a mosaic of several blocks has; its warnings.

    ``keep`` is called with the memory that zones which are left out need (bytes).
    """
    setting, rules, place = mosaic.setting, mosaic.setting.rules, mosaic.place
    config = setting.config
    frame = setting.terrain.frame(place)
    at_once, share = shared(memory_bytes, cores)
    blocks = divided(place, areas, mosaic.bins, share)
    maps = _write_maps(work / "maps", mosaic, blocks, frame, at_once, tell)
    counted = [a for a in areas if a.record.reached]
    shapes = {c.name: area_feature(setting, c).geometry for c in candidates}
    drawn, left_out = _zones_by_group(work, mosaic, counted, shapes, cores, memory_bytes, tell)
    keep(list(left_out.values()))
    here = Part(place.row, place.col, 0, 0)
    met = [a for a in areas if a.record.control_lines or a.record.objects]

    progress = added_up(compared_run(config, mosaic.run), here, met, mosaic.bins)
    sampled, without = _sources(mosaic.run, met, progress, {})
    parts, thresholds = line_parts(sampled), mosaic.bins.threshold
    risk = risk_of(rules, sampled, thresholds)
    risk_before = None if without is None else risk_of(rules, without, thresholds)
    released = [ReleaseArea(a.name, shapes[a.name], tuple(a.record.frequencies)) for a in areas]
    points, rocks = ([getattr(a.record, n) for a in areas] for n in ("points", "rocks"))
    vectors = [
        run_vectors.released_from(released, points, rocks, frame.crs),
        *run_vectors.control_line_layers(mosaic.run, progress, parts),
        *exposed_layers(rules.placed, frame.crs),
    ]
    counts = {"release_areas": len(areas), "release_points": sum(points), "rocks": sum(rocks)}
    extras = group_extras(config, rules, frame, maps.hazard, drawn, (risk, risk_before))
    facts = facts_of(config, mosaic.run) | {"preset": rules.preset.name} | counts
    write_layers(
        work, config, frame, extras, layers=maps.blocks, terrain=maps.terrain, vectors=vectors,
        facts=facts, extent=frame.bounds,
    )  # fmt: skip
    warnings = (*warnings, *left_out)
    write_origin(work, config, counts, warnings, seed=config.run.seed, grid=frame, **extras.origin)
    return warnings


def _write_maps(
    folder: Path,
    mosaic: Mosaic,
    blocks: Sequence[tuple[Part, Sequence[Reached]]],
    frame: Grid,
    cores: int,
    tell: Callable[[str], None],
) -> Maps:
    """Write the maps of all blocks, several at a time; of their values only extremes come back."""
    hazard: set[str] = set()
    with (
        BlockMaps(frame, folder) as files,
        # Few results wait, as they are large.
        task_map(mosaic, min(cores, len(blocks)), ahead=1) as each,
    ):
        made = zip(blocks, each(_maps_of, blocks), strict=True)
        for i, ((block, own), found) in enumerate(made, start=1):
            tell(f"Block {i} of {len(blocks)} of the mosaic: {len(own)} areas")
            hazard |= {layer.stem for layer in found.hazard}
            for layer in (found.terrain, *found.hazard, *found.blocks):
                files.write(layer, block.row - mosaic.place.row, block.col - mosaic.place.col)
    tell("Writing the overviews of the maps")
    with task_map(None, cores) as each, writing(folder):
        for unfinished, _ in zip(files.unfinished, each(_finish, files.unfinished), strict=True):
            unfinished.between.unlink()
    layers = {u.layer.stem: u.layer for u in files.unfinished}
    terrain = layers.pop(found.terrain.stem)
    return Maps(
        [layer for stem, layer in layers.items() if stem in hazard],
        [layer for stem, layer in layers.items() if stem not in hazard],
        terrain,
    )


def _finish(_: None, unfinished: Unfinished) -> None:
    finish_map(unfinished)


def _maps_of(mosaic: Mosaic, block: tuple[Part, Sequence[Reached]]) -> Maps:
    """Return the maps of a block; only that of the terrain where no area has counted anything."""
    (place, areas), rules, config = block, mosaic.setting.rules, mosaic.setting.config
    grid = mosaic.setting.terrain.read(place)
    total = added_up(mosaic.run, place, areas, mosaic.bins)
    sampled, _ = _sources(replace(mosaic.run, grid=grid), areas, total, {})
    curves = curves_of(sampled, mosaic.bins.threshold)
    del sampled
    total.sources.clear()
    of_hazard: tuple[RasterLayer, ...] = ()
    of_blocks: tuple[RasterLayer, ...] = ()
    if curves.places.size:
        level = hazard_level(curves, rules.preset)
        chances = level_chances(curves, level, rules.preset, in_part=True)
        of_hazard = hazard_maps(rules, curves, chances, grid, config.hazard.confidence)
    if total.sums.cells.size:
        of_blocks = block_maps(config, grid, total.sums, mosaic.sample, mosaic.bins)
    return Maps(of_hazard, of_blocks, terrain_layer(grid))


def _sources(
    run: MapRun, areas: Sequence[Reached], total: Progress, shapes: Shapes
) -> tuple[list[Sampled], list[Sampled] | None]:
    """Return the sums by source, with barriers and, if there are any, without.

    ``shapes`` of areas are of account for zones only.
    """
    named = tuple(
        ReleaseArea(a.name, shapes.get(a.name), tuple(a.record.frequencies)) for a in areas
    )
    frequencies = {(a.name, k): f for a in areas for k, f in a.record.frequencies.items()}
    sources = partial(sampled_sources, replace(run, areas=named), total, frequencies)
    return sources(), sources(barriers=False) if total.compared else None


def groups(areas: Sequence[Reached], beside: int) -> list[list[Reached]]:
    """Return areas by groups between whose counts there are more cells than these.

    Drawing a zone looks at what lies within so many cells of it: groups do not feel each other.
    """
    # As drawing.drawn_zones distinguishes places, and a little more.
    half = beside // 2 + 3
    boxes = [a.counted.grown(half, half, half, half) for a in areas]
    low = np.array([[b.row, b.col] for b in boxes])
    high = np.array([b.end for b in boxes])
    group = np.arange(len(areas))
    for i in range(len(areas)):
        met = ((low < high[i]) & (low[i] < high)).all(axis=1)
        joined = np.unique(group[met])
        group[np.isin(group, joined)] = joined[0]
    return [[areas[i] for i in np.flatnonzero(group == g).tolist()] for g in np.unique(group)]


def _zones_by_group(
    work: Path,
    mosaic: Mosaic,
    areas: Sequence[Reached],
    shapes: Shapes,
    jobs: int,
    memory_bytes: int,
    tell: Callable[[str], None],
) -> tuple[list[list[VectorLayer]], dict[str, int]]:
    """Return zones of each group of areas with counts, and those that are left out as too large.

    Of these, what to say, and the memory that they need (bytes). What is drawn waits in files of
    the folder ``work``: zones of 10,000 areas take 1.4 GB, which the processes that draw need.
    """
    found = groups(areas, mosaic.beside)
    energies = len(mosaic.setting.rules.preset.thresholds_kj)
    need = [bytes_for_zones(_box(mosaic, own), own, energies) for own in found]
    left_out = {
        f"The zones around area {own[0].name} ({len(own)} areas that meet) need about "
        f"{n / 1e9:.1f} GB of memory and were left out; the maps are complete.": n
        for own, n in zip(found, need, strict=True)
        if n > memory_bytes
    }
    fits = [own for own, n in zip(found, need, strict=True) if n <= memory_bytes]
    largest = max((n for n in need if n <= memory_bytes), default=1)
    at_once = max(1, min(jobs, (memory_bytes - BASE) // largest))
    tell(f"Drawing the zones of {len(fits)} groups of areas")
    files = [work / f"{i}.zones" for i in range(len(fits))]
    with task_map(mosaic, at_once if len(fits) >= 2 * at_once else 1) as each:
        parts = [{a.name: shapes[a.name] for a in own} for own in fits]
        for _ in each(_draw_zones, list(zip(fits, parts, files, strict=True))):
            pass
    drawn = []
    for file in files:
        drawn.append(pickle.loads(file.read_bytes()))
        file.unlink()
    return drawn, left_out


def bytes_for_zones(box: Part, areas: Sequence[Reached], n_energies: int) -> int:
    """Estimate the memory (bytes) of drawing a group's zones, with counts at so many energies."""
    reached = sum(a.record.reached for a in areas)
    cells = box.n_rows * box.n_cols * _ZONES_PER_CELL
    return _ZONES_BASE + cells + reached * _ZONES_PER_COUNT * n_energies


def _box(mosaic: Mosaic, areas: Sequence[Reached]) -> Part:
    """Return the part of a mosaic that the zones of a group need."""
    beside = mosaic.beside
    inside = hull([a.counted for a in areas]).grown(beside, beside, beside, beside)
    box = inside.common(mosaic.place)
    assert box is not None
    return box


def _draw_zones(mosaic: Mosaic, group: tuple[Sequence[Reached], Shapes, Path]) -> None:
    """Draw the zones of one group into a file."""
    areas, shapes, file = group
    drawn = pickle.dumps(_zones(mosaic, areas, shapes), pickle.HIGHEST_PROTOCOL)
    with writing(file):
        file.write_bytes(drawn)


def _zones(mosaic: Mosaic, areas: Sequence[Reached], shapes: Shapes) -> list[VectorLayer]:
    """Return the zones of one group."""
    config, rules, box = mosaic.setting.config, mosaic.setting.rules, _box(mosaic, areas)
    grid = mosaic.setting.terrain.read(box)
    run = replace(mosaic.run, grid=grid)
    # Zones ask for nothing between the classes of intensity.
    energies = np.array(rules.preset.thresholds_kj)
    # Zones with barriers are drawn within those without.
    total = added_up(compared_run(config, run), box, areas, mosaic.bins, only_energies_kj=energies)
    sampled, without = _sources(run, areas, total, shapes)
    found = assess(
        replace(rules, vulnerability=None, placed=PlacedObjects((), ())),
        grid, energies, sampled, without,
        confidence=config.hazard.confidence, by_source=False,
    )  # fmt: skip
    return group_zones(config, rules, grid, found)
