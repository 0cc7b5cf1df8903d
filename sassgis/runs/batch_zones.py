"""The zones of a mosaic that is made block by block: group by group of areas.

Drawing a zone looks at what lies within some cells of it. Areas whose counts lie farther apart do
not feel each other: each group is drawn by itself, and the zones are those of the whole mosaic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sassgis.hazard.assess import Rules, assess
from sassgis.io.read.tiles import Part, Terrain, hull
from sassgis.io.vector_layer import VectorLayer
from sassgis.io.write.layers.federal import federal_layers
from sassgis.io.write.layers.zones import hazard_zones
from sassgis.model.exposure import PlacedObjects
from sassgis.model.map_run import MapRun
from sassgis.model.run_config import Config
from sassgis.model.statistics_table import Bins
from sassgis.runs.batch_blocks import Reached, added_up, bytes_needed
from sassgis.runs.inputs import compares_barriers
from sassgis.runs.workers import task_map

#: Layers of a group that make sense for all of them together.
_LAYERS = ("hazard_zones", "hazard_area", "synoptic_intensity", "indicative_hazard_area")


@dataclass(frozen=True, slots=True)
class ZoneTask:
    """What the groups of a mosaic have in common."""

    config: Config
    terrain: Terrain
    rules: Rules
    run: MapRun
    place: Part
    bins: Bins
    beside: int


def groups(areas: Sequence[Reached], beside: int) -> list[list[Reached]]:
    """Areas by groups whose counts, with so many cells around them, do not meet."""
    boxes = [a.counted.grown(beside, beside, beside, beside) for a in areas]
    low = np.array([[b.row, b.col] for b in boxes])
    high = np.array([b.end for b in boxes])
    group = np.arange(len(areas))
    for i in range(len(areas)):
        met = ((low < high[i]) & (low[i] < high)).all(axis=1)
        joined = np.unique(group[met])
        group[np.isin(group, joined)] = joined[0]
    return [[areas[i] for i in np.flatnonzero(group == g).tolist()] for g in np.unique(group)]


def zones_by_group(
    task: ZoneTask,
    areas: Sequence[Reached],
    jobs: int,
    memory_bytes: int,
    tell: Callable[[str], None],
) -> tuple[list[list[VectorLayer]], tuple[str, ...]]:
    """Zones of each group, and what to say of groups that need more memory than there is.

    Parameters
    ----------
    task : ZoneTask
    areas : sequence of Reached
        Those with counts.
    jobs : int
        Groups at work at the same time.
    memory_bytes : int
        For all of them together.
    tell : callable
    """
    found = groups(areas, task.beside)
    need = [bytes_needed(_box(task, own), own, task.bins) for own in found]
    said = tuple(
        f"The zones around area {own[0].name} ({len(own)} areas that meet) need about "
        f"{n / 1e9:.1f} GB of memory and were left out; the maps are complete."
        for own, n in zip(found, need, strict=True)
        if n > memory_bytes
    )
    fits = [own for own, n in zip(found, need, strict=True) if n <= memory_bytes]
    largest = max((n for n in need if n <= memory_bytes), default=1)
    at_once = max(1, min(jobs, memory_bytes // largest - 1))
    tell(f"Drawing the zones of {len(fits)} groups of areas")
    with task_map(task, at_once if len(fits) >= 2 * at_once else 1) as each:
        return list(each(_zones, fits)), said


def _box(task: ZoneTask, areas: Sequence[Reached]) -> Part:
    beside = task.beside
    box = hull([a.counted for a in areas]).grown(beside, beside, beside, beside)
    inside = box.common(task.place)
    assert inside is not None
    return inside


def _zones(task: ZoneTask, areas: Sequence[Reached]) -> list[VectorLayer]:
    """The zones of one group."""
    config, rules = task.config, task.rules
    box = _box(task, areas)
    grid = task.terrain.read(box)
    _, sampled = added_up(task.run, grid, box, areas, task.bins)
    alone = None
    if compares_barriers(config, task.run):
        # Zones with walls and nets are drawn within those without.
        _, alone = added_up(task.run, grid, box, areas, task.bins, without=True)
    found = assess(
        replace(rules, vulnerability=None, placed=PlacedObjects((), ())),
        grid, task.bins.threshold, sampled, alone,
        confidence=config.hazard.confidence, by_source=False,
    )  # fmt: skip
    width = rules.ref_width_m
    zones = hazard_zones(found.hazard, rules.preset, grid, width, config.hazard.confidence)
    federal = federal_layers(config, grid, rules.preset, width, found.hazard, {})
    return [layer for layer in (zones, *federal) if layer.name in _LAYERS]
