"""The maps of a mosaic, block by block: memory is that of a block, whatever the area.

Counts are whole numbers, the frequencies of a cell are added up in the order of the areas, and
the limits of the histograms are those of the relief of the whole. So the maps are those of the
mosaic as a whole, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.hazard.assess import Rules, curves_of
from sassgis.hazard.bins import bins_for
from sassgis.hazard.control_lines import ControlLineSums
from sassgis.hazard.map_sums import MapSums, Sample
from sassgis.hazard.progress import Progress, SourceTally
from sassgis.hazard.source_sums import SourceSums
from sassgis.hazard.sources import Sampled, sampled_sources
from sassgis.io.read.tiles import Part, Terrain
from sassgis.io.staging import writing
from sassgis.io.write.block_maps import TILE, BlockMaps, Unfinished, finish_map
from sassgis.io.write.layers.hazard_maps import hazard_layers
from sassgis.io.write.layers.maps import map_layers
from sassgis.io.write.layers.terrain_layer import terrain_layer
from sassgis.model.grid import Grid
from sassgis.model.map_run import MapRun
from sassgis.model.release_areas import ReleaseArea
from sassgis.model.results import ControlLine, RasterLayer
from sassgis.model.run_config import Config
from sassgis.model.statistics_table import Bins
from sassgis.runs.batch_state import Record, add_cells, add_objects, read_state
from sassgis.runs.checkpoint import progress_from
from sassgis.runs.estimate import reached_bytes
from sassgis.runs.workers import task_map

#: Bytes of the program itself, and of each cell of a block: its heights, and its maps.
BASE, _PER_CELL = 800 << 20, 600
#: Smaller blocks are not made so that more can be at work (bytes, besides the program itself).
_LEAST_SHARE = 256 << 20


@dataclass(frozen=True, slots=True)
class Reached:
    """An area of the mosaic: its name, what is known of it, its folder, and its part."""

    name: str
    record: Record
    folder: Path
    part: Part

    @property
    def counted(self) -> Part:
        """The smallest part with all its counts."""
        row, col, n_rows, n_cols = self.record.counted
        return Part(self.part.row + row, self.part.col + col, n_rows, n_cols)


class Maps(NamedTuple):
    """Maps of a mosaic: of hazard, of what was simulated, of the terrain."""

    hazard: Sequence[RasterLayer]
    blocks: Sequence[RasterLayer]
    terrain: RasterLayer


def bytes_needed(place: Part, areas: Sequence[Reached], bins: Bins) -> int:
    """Memory that the maps of a place take (bytes), with all that its areas have counted."""
    reached = sum(a.record.reached for a in areas if a.part.common(place) is not None)
    return BASE + place.n_rows * place.n_cols * _PER_CELL + reached * reached_bytes(bins)


def shared(memory_bytes: int, cores: int) -> tuple[int, int]:
    """How many blocks may be at work at the same time, and the memory of each (bytes).

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
    """Blocks of a place that fit into the memory, with the areas that meet each.

    Blocks are halved until they fit; those of one tile of the files are not divided any more.
    """
    own = [a for a in areas if a.part.common(place) is not None]
    n_rows, n_cols = place.n_rows, place.n_cols
    if bytes_needed(place, own, bins) <= memory_bytes or max(n_rows, n_cols) <= TILE:
        return [(place, own)]
    if n_rows >= n_cols:
        cut = _half(n_rows)
        halves = (
            Part(place.row, place.col, cut, n_cols),
            Part(place.row + cut, place.col, n_rows - cut, n_cols),
        )
    else:
        cut = _half(n_cols)
        halves = (
            Part(place.row, place.col, n_rows, cut),
            Part(place.row, place.col + cut, n_rows, n_cols - cut),
        )
    return [block for half in halves for block in divided(half, own, bins, memory_bytes)]


def _half(n: int) -> int:
    return TILE * -(-n // (2 * TILE))


def bins_of_place(config: Config, terrain: Terrain, place: Part, rules: Rules) -> Bins:
    """Limits of the histograms for the relief of a place, whose heights are read strip by strip."""
    low, high = np.inf, -np.inf
    for row in range(0, place.n_rows, TILE):
        strip = Part(place.row + row, place.col, min(TILE, place.n_rows - row), place.n_cols)
        heights = terrain.read(strip).values
        low = min(low, float(np.nanmin(heights, initial=np.inf)))
        high = max(high, float(np.nanmax(heights, initial=-np.inf)))
    return bins_for(high - low, config.blocks, config.engine, rules.preset.thresholds_kj)


def write_blocks(
    maps: Path,
    config: Config,
    terrain: Terrain,
    rules: Rules,
    run: MapRun,
    place: Part,
    blocks: Sequence[tuple[Part, Sequence[Reached]]],
    areas: Sequence[Reached],
    bins: Bins,
    cores: int,
    tell: Callable[[str], None],
) -> Maps:
    """Write all maps of a mosaic.

    Parameters
    ----------
    maps : Path
        Folder to write.
    config, terrain
    rules : Rules
    run : MapRun
        With the settings of all areas; its grid and areas are not looked at.
    place : Part
        Of the mosaic.
    blocks : sequence of (Part, areas)
        As ``divided`` gives them.
    areas : sequence of Reached
        All, by name.
    bins : Bins
    cores : int
        Blocks at work at the same time.
    tell : callable

    Returns
    -------
    Maps
        Of their values only the smallest and the largest.
    """
    task = _Task(config, terrain, rules, run, bins, _sample(run, areas))
    hazard: set[str] = set()
    with (
        BlockMaps(terrain.frame(place), maps) as files,
        # Few results wait, as they are large.
        task_map(task, min(cores, len(blocks)), ahead=1) as each,
    ):
        made = zip(blocks, each(_maps_of, blocks), strict=True)
        for i, ((block, own), found) in enumerate(made, start=1):
            tell(f"Block {i} of {len(blocks)} of the mosaic: {len(own)} areas")
            hazard |= {layer.stem for layer in found.hazard}
            for layer in (found.terrain, *found.hazard, *found.blocks):
                files.write(layer, block.row - place.row, block.col - place.col)
    tell("Writing the overviews of the maps")
    with task_map(None, cores) as each, writing(maps):
        for unfinished, _ in zip(files.unfinished, each(_finish, files.unfinished), strict=True):
            unfinished.between.unlink()
    layers = [u.layer for u in files.unfinished]
    stem = found.terrain.stem
    return Maps(
        [m for m in layers if m.stem in hazard],
        [m for m in layers if m.stem not in {*hazard, stem}],
        next(m for m in layers if m.stem == stem),
    )


def _finish(_: None, unfinished: Unfinished) -> None:
    finish_map(unfinished)


@dataclass(frozen=True, slots=True)
class _Task:
    """What the blocks of a mosaic have in common."""

    config: Config
    terrain: Terrain
    rules: Rules
    run: MapRun
    bins: Bins
    sample: Sample


def _sample(run: MapRun, areas: Sequence[Reached]) -> Sample:
    """The sample behind the maps: the blocks of all areas that started."""
    rocks = sum(a.record.rocks for a in areas)
    return Sample(
        started=rocks - sum(a.record.never_started for a in areas),
        rocks_per_line=run.rocks_per_point,
        lines=rocks // run.rocks_per_point,
        random_points=run.placement == "random",
    )


def added_up(
    run: MapRun,
    grid: Grid,
    block: Part,
    areas: Sequence[Reached],
    bins: Bins,
    *,
    without: bool = False,
) -> tuple[Progress, list[Sampled]]:
    """What areas have counted in a block, in all and by source.

    Parameters
    ----------
    run : MapRun
        With the settings of all areas; its grid and areas are not looked at.
    grid : Grid
        Heights of the block.
    block : Part
    areas : sequence of Reached
    bins : Bins
        Of all areas.
    without : bool
        Whether without walls and nets.
    """
    control_lines = tuple(g for g, _ in run.control_lines)
    total = Progress(0, MapSums(grid.values.size), ControlLineSums(()))
    for i, area in enumerate(areas):
        own, state = _of_area(area, control_lines, without)
        add_cells(total, (), bins, block, i, area.part, own, state["thresholds_kj"])
    return total, _sources(replace(run, grid=grid), areas, total)


def _of_area(
    area: Reached, control_lines: Sequence[ControlLine], without: bool
) -> tuple[Progress, dict[str, NDArray[Any]]]:
    """What an area has counted, as sums and as it was saved; with all ``control_lines``."""
    state = read_state(area.folder, without)
    own = tuple(control_lines[k] for k in area.record.control_lines)
    return progress_from(state, area.part.n_rows * area.part.n_cols, own), state


def _sources(run: MapRun, areas: Sequence[Reached], total: Progress) -> list[Sampled]:
    # Outlines are of no account here.
    named = tuple(ReleaseArea(a.name, None, tuple(a.record.frequencies)) for a in areas)
    frequencies = {(a.name, k): f for a in areas for k, f in a.record.frequencies.items()}
    return sampled_sources(replace(run, areas=named), total, frequencies)


def met_objects(
    run: MapRun, areas: Sequence[Reached], bins: Bins, *, without: bool = False
) -> tuple[Progress, list[Sampled]]:
    """What areas have counted at stations and barriers, and by source at exposed objects.

    Parameters as those of added_up; there is nothing in cells.
    """
    control_lines = tuple(g for g, _ in run.control_lines)
    total = Progress(0, MapSums(1), ControlLineSums(control_lines))
    n = bins.threshold.size
    for i, area in enumerate(areas):
        record = area.record
        if not (record.control_lines or record.objects):
            continue
        own, state = _of_area(area, control_lines, without)
        total.control_lines.add_sums(own.control_lines, np.array(record.control_lines, np.int64))
        for (_, scenario), tally in sorted(own.sources.items()):
            joined = SourceTally(
                SourceSums(n), SourceSums(n), ControlLineSums(()), tally.rocks, tally.never_started
            )
            add_objects(joined, bins, record, tally, state["thresholds_kj"])
            total.sources[i, scenario] = joined
    return total, _sources(run, areas, total)


def _maps_of(task: _Task, block: tuple[Part, Sequence[Reached]]) -> Maps:
    """The maps of a block; only that of the terrain where no area has counted anything."""
    (place, areas), config, rules, bins = block, task.config, task.rules, task.bins
    grid = task.terrain.read(place)
    total, sampled = added_up(task.run, grid, place, areas, bins)
    curves = curves_of(sampled, bins.threshold)
    del sampled
    total.sources.clear()
    of_hazard: tuple[RasterLayer, ...] = ()
    of_blocks: tuple[RasterLayer, ...] = ()
    if curves.places.size:
        of_hazard = hazard_layers(
            curves, rules.preset, grid.shape, rules.ref_width_m,
            return_periods=rules.preset.return_periods, confidence=config.hazard.confidence,
        )  # fmt: skip
    if total.sums.cells.size:
        of_blocks = map_layers(
            total.sums, grid.shape, task.sample, bins.edges, grid.cell_size,
            config.output.energy_classes_kj,
        )  # fmt: skip
    return Maps(of_hazard, of_blocks, terrain_layer(grid))
