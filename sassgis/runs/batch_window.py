"""The part of a large terrain model that one release area needs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sassgis.io.read.tiles import Part, Terrain, hull
from sassgis.model.errors import InputError
from sassgis.model.map_run import MapRun
from sassgis.model.settings import LateralDeflection
from sassgis.terrain.block_scale import SD_PER_DIAMETER
from sassgis.terrain.plan import Plan, plan
from sassgis.terrain.prepare import trace_lines
from sassgis.terrain.release import take

#: Margin with which the search begins (m).
_FIRST_MARGIN_M = 200.0
#: What the edge of a part does to the spline through its heights fades by 0.268 per cell: it is
#: below the rounding of a double after 28 cells, and some more make the last bits the same.
_SPLINE_CELLS = 48
#: Standard deviations at which the Gaussian of the smoothing ends.
_GAUSSIAN_ENDS = 4.0
_POINTS = 256


@dataclass(frozen=True, slots=True)
class Windowed:
    """A run on a part of the terrain model.

    Attributes
    ----------
    part : Part
    run : MapRun
        Its grid is that part.
    planned : Plan
    """

    part: Part
    run: MapRun
    planned: Plan


def edge_cells(smoothing_m: float, ref_width_m: float, cell_size: float) -> int:
    """Cells from a cut edge within which fall lines would feel it, or counts be lost."""
    felt = math.ceil(_GAUSSIAN_ENDS * smoothing_m / cell_size) + _SPLINE_CELLS
    counted = math.ceil(0.5 * ref_width_m / cell_size) + 1
    return max(felt, counted)


def windowed(
    terrain: Terrain,
    bounds: tuple[float, float, float, float],
    ref_width_m: float,
    make: Callable[[Part], MapRun],
    repetitions: int,
    first_margin_m: float = _FIRST_MARGIN_M,
) -> Windowed:
    """Find the part of the terrain model that the fall lines of a release area need.

    A part is tried, the lines of all repetitions are traced on it, and on each side on which one
    comes near a cut edge (see edge_cells) the margin grows by half. So the lines are those of the
    whole terrain model: to the last bit where corners and sizes of cells are binary numbers (whole
    metres, halves, quarters, ...) and no nodata is near, else but for rounding.

    Parameters
    ----------
    terrain : Terrain
    bounds : (west, south, east, north)
        Of the release area (m).
    ref_width_m : float
        Reference width of the frequencies (m).
    make : callable
        Makes the run on a part.
    repetitions : int
        Most of them that there may be; where paths are random, each has its own.
    first_margin_m : float
        Margin with which to begin.

    Returns
    -------
    Windowed

    Raises
    ------
    InputError
        If the area lies outside the terrain model, and whatever ``make`` raises.
    """
    inner = terrain.part_of(bounds)
    first = math.ceil(min(first_margin_m, 1e9) / terrain.cell_size)
    margins = [max(first, 1)] * 4
    while True:
        part = inner.grown(*margins).common(terrain.whole)
        if part is None:
            raise InputError("lies outside the DEM", found=str(bounds))
        run = make(part)
        planned = plan(run)
        widest = max(run.fall_lines.smoothing_m, SD_PER_DIAMETER * run.block_scale_m)
        keep = edge_cells(widest, ref_width_m, terrain.cell_size)
        reached = terrain.part_of(_extent(run, planned, repetitions)).grown(keep, keep, keep, keep)
        near = [
            cut and beyond
            for cut, beyond in zip(cut_sides(part, terrain), _beyond(reached, part), strict=True)
        ]
        if not any(near):
            return Windowed(part, run, planned)
        margins = [m + (m + 1) // 2 if grow else m for m, grow in zip(margins, near, strict=True)]


def cut_sides(part: Part, terrain: Terrain) -> tuple[bool, bool, bool, bool]:
    """Whether the terrain model goes on in the north, east, south and west of a part."""
    whole = terrain.whole
    return (
        part.row > whole.row,
        part.end[1] < whole.end[1],
        part.end[0] < whole.end[0],
        part.col > whole.col,
    )


def _beyond(reached: Part, part: Part) -> tuple[bool, bool, bool, bool]:
    """On which sides (north, east, south, west) one part goes beyond another."""
    both = hull([reached, part])
    return (
        both.row < part.row,
        both.end[1] > part.end[1],
        both.end[0] > part.end[0],
        both.col < part.col,
    )


def _extent(run: MapRun, planned: Plan, repetitions: int) -> tuple[float, float, float, float]:
    """Rectangle around all lines of all repetitions (m)."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for first in range(0, len(planned.starts), _POINTS):
        some = take(planned.starts, slice(first, first + _POINTS))
        for repetition in range(
            repetitions if run.effects.get(LateralDeflection) is not None else 1
        ):
            lines = trace_lines(run, planned.surface, some, repetition)
            low = np.minimum(low, [lines.x.min(), lines.y.min()])
            high = np.maximum(high, [lines.x.max(), lines.y.max()])
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])
