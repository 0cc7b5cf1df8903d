"""The part of a large terrain model that one release area needs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sassgis.engine.heading import LONGEST_STEP
from sassgis.errors import InputError
from sassgis.inputs.tiles import Part, Terrain, hull
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.map_run import FallLines, MapRun
from sassgis.terrain.fall_lines import trace
from sassgis.terrain.plan import Plan, plan
from sassgis.terrain.release import take
from sassgis.terrain.surface import GAUSSIAN_ENDS, SD_PER_DIAMETER

#: Margin with which the search begins at least (m).
_FIRST_MARGIN_M = 200.0
#: What the edge of a part does to the spline through its heights fades by 0.268 per cell: it is
#: below the rounding of a double after 28 cells, and some more make the last bits the same.
_SPLINE_CELLS = 48
_POINTS = 256
#: So many lines are traced first, and one of so many: where one of them leaves a part, the others
#: need not be.
_SCOUTS, _ONE_OF = 8, 8
#: Cells around a release area whose heights are read at once, which takes 5 MB: its part of the
#: terrain is searched within them.
SEARCHED_CELLS = 400
#: On cells that are so many times as large lines are traced first of all, to begin with a part that
#: is about as large as it has to be.
_COARSER = 4
#: Margins of the first part to those that these lines ask for.
_MORE = 1.25
#: Share of the length of the fall lines by which a part is wider than they, for followed paths.
_ASIDE = 0.15
#: Cells next to one that a path looks at whose heights count there, next to half a block.
_BESIDE = 3

Sides = tuple[int, int, int, int]
Met = tuple[bool, bool, bool, bool]


@dataclass(frozen=True, slots=True)
class Windowed:
    """A run on a part of the terrain model."""

    part: Part
    run: MapRun  # its grid is that part
    planned: Plan
    margins: Sides  # cells around the release area, in the north, east, south and west
    notices: tuple[str, ...] = ()  # what the readers had to say

    def wider(self, sides: Met) -> Sides:
        """Return margins to try next if paths came to the rim on some sides."""
        n, e, s, w = (2 * m if met else m for m, met in zip(self.margins, sides, strict=True))
        return n, e, s, w


def edge_cells(smoothing_m: float, ref_width_m: float, cell_size: float) -> int:
    """Return cells from a cut edge within which fall lines would feel it, or counts be lost."""
    felt = math.ceil(GAUSSIAN_ENDS * smoothing_m / cell_size) + _SPLINE_CELLS
    return max(felt, _counted(ref_width_m, cell_size))


def rim_cells(run: MapRun, ref_width_m: float) -> int:
    """Return cells from a cut edge within which followed paths would feel it, or counts be lost."""
    cell = run.grid.cell_size
    smoothed = math.ceil(GAUSSIAN_ENDS * SD_PER_DIAMETER * run.block_scale_m / cell)
    radius = max(_largest_radius(b) for b in run.blocks) / cell
    # Whether a step along the ground may be twice as long depends on the slope at its end, up to
    # half of the longest step beyond the cells that the path looks at.
    ahead = math.ceil(0.5 * LONGEST_STEP * max(1.0, 2.0 * radius))
    return max(smoothed + math.ceil(radius) + _BESIDE + ahead, _counted(ref_width_m, cell))


def _largest_radius(blocks: BlockPopulation) -> float:
    """Return the radius of the sphere as large as the largest block (m)."""
    if blocks.volume_m3 is not None:
        return math.cbrt(0.75 * blocks.volume_m3[1] / math.pi)
    return math.cbrt(blocks.axis_1_m[1] * blocks.axis_2_m[1] * blocks.axis_3_m[1])


def _counted(ref_width_m: float, cell_size: float) -> int:
    """Return cells around a path in whose windows it counts."""
    return math.ceil(0.5 * ref_width_m / cell_size) + 1


def windowed(
    terrain: Terrain,
    bounds: tuple[float, float, float, float],
    ref_width_m: float,
    make: Callable[[Part], MapRun],
    margins: Sides = (1, 1, 1, 1),
) -> Windowed:
    """Find the part of the terrain model that a release area needs, within its bounds (m).

    A part is tried, the fall lines are traced on it, and on each side on which one
    comes near a cut edge (see edge_cells) the margin grows by what is missing, and by half at
    least: a line may go on beyond the edge. So the lines are those of the
    whole terrain model: to the last bit where corners and sizes of cells are binary numbers (whole
    metres, halves, quarters, ...) and no nodata is near, else but for rounding.

    Where paths are followed they go where they will: the part is wider than some of the fall lines,
    and the run has a rim on each cut side that no path may look at (see MapRun.rim). If one does,
    or if another line comes near a cut edge (see near_edge), ask again for wider margins.

    ``make`` makes the run on a part; ``margins`` there must be at least. InputError: the area lies
    outside the terrain model.
    """
    inner = terrain.part_of(bounds)
    first = math.ceil(_FIRST_MARGIN_M / terrain.cell_size)
    foreseen = _foreseen(terrain, inner, make, ref_width_m)
    north, east, south, west = (max(first, *m) for m in zip(margins, foreseen, strict=True))
    while True:
        part = inner.grown(north, east, south, west).common(terrain.whole)
        if part is None:
            raise InputError("lies outside the DEM", found=str(bounds))
        run = make(part)
        planned = plan(run)
        cut = cut_sides(part, terrain)
        for lines in (_scouts(planned), *([] if run.followed else [len(planned.starts)])):
            # Cells by which the part is too small for so many lines.
            reached = _reached(terrain, run, planned, ref_width_m, lines)
            missing = [c * more for c, more in zip(cut, _beyond(reached, part), strict=True)]
            if any(missing):
                break
        if not any(missing):
            if run.followed:
                rim = rim_cells(run, ref_width_m)
                run = replace(run, rim=(rim * cut[0], rim * cut[1], rim * cut[2], rim * cut[3]))
            return Windowed(part, run, planned, (north, east, south, west))
        north, east, south, west = (
            m + max(less, (m + 1) // 2) if less else m
            for m, less in zip((north, east, south, west), missing, strict=True)
        )


def near_edge(
    cut: Windowed, terrain: Terrain, ref_width_m: float, lines: Sequence[FallLines]
) -> Met:
    """Find on which cut sides (north, east, south, west) fall lines of a run come near the edge."""
    x, y = (np.concatenate([getattr(own, axis) for own in lines]) for axis in "xy")
    extent = x.min(), y.min(), x.max(), y.max()
    # Lines are thinned, by less than a cell.
    keep = 1 + _kept_free(terrain, cut.run, ref_width_m)
    beyond = _beyond(terrain.part_of(extent).grown(keep, keep, keep, keep), cut.part)
    cut_off = cut_sides(cut.part, terrain)
    n, e, s, w = (own and more > 0 for own, more in zip(cut_off, beyond, strict=True))
    return n, e, s, w


def _scouts(planned: Plan) -> int:
    """Count the lines that are traced first."""
    return max(_SCOUTS, len(planned.starts) // _ONE_OF)


def _foreseen(
    terrain: Terrain, inner: Part, make: Callable[[Part], MapRun], ref_width_m: float
) -> Sides:
    """Return margins that the fall lines ask for on larger cells: quick, and about right."""
    around = inner.grown(*[SEARCHED_CELLS] * 4).common(terrain.whole)
    if around is None:
        return 0, 0, 0, 0
    run = make(around)
    n_rows, n_cols = (n // _COARSER for n in run.grid.shape)
    fine = run.grid.values[: n_rows * _COARSER, : n_cols * _COARSER]
    coarse = fine.reshape(n_rows, _COARSER, n_cols, _COARSER).mean(axis=(1, 3))
    if not np.isfinite(coarse).any():
        return 0, 0, 0, 0
    run = replace(
        run, grid=replace(run.grid, values=coarse, cell_size=_COARSER * terrain.cell_size)
    )
    planned = plan(run)
    reached = _reached(terrain, run, planned, ref_width_m, _scouts(planned))
    n, e, s, w = (math.ceil(_MORE * m) for m in _beyond(reached, inner))
    return n, e, s, w


def _reached(terrain: Terrain, run: MapRun, planned: Plan, ref_width_m: float, lines: int) -> Part:
    """Return the part that so many of the fall lines need, also beyond the terrain model."""
    keep = _kept_free(terrain, run, ref_width_m)
    extent = _extent(run, planned, lines)
    if run.followed:
        aside = _ASIDE * math.hypot(extent[2] - extent[0], extent[3] - extent[1])
        keep += math.ceil((aside + run.release.spacing_m) / terrain.cell_size)
    return terrain.part_of(extent).grown(keep, keep, keep, keep)


def _kept_free(terrain: Terrain, run: MapRun, ref_width_m: float) -> int:
    """Return cells from a cut edge into which no fall line may come."""
    widest = max(run.terrain.smoothing_m, SD_PER_DIAMETER * run.block_scale_m)
    return edge_cells(widest, ref_width_m, terrain.cell_size)


def cut_sides(part: Part, terrain: Terrain) -> Met:
    """Return whether the terrain model goes on in the north, east, south and west of a part."""
    whole = terrain.whole
    return (
        part.row > whole.row,
        part.end[1] < whole.end[1],
        part.end[0] < whole.end[0],
        part.col > whole.col,
    )


def _beyond(reached: Part, part: Part) -> Sides:
    """Count the cells by which one part exceeds another in the north, east, south and west."""
    both = hull([reached, part])
    return (
        part.row - both.row,
        both.end[1] - part.end[1],
        both.end[0] - part.end[0],
        part.col - both.col,
    )


def _extent(run: MapRun, planned: Plan, lines: int) -> tuple[float, float, float, float]:
    """Return the rectangle around so many of the lines, evenly taken (m)."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    starts = take(planned.starts, slice(None, None, max(len(planned.starts) // lines, 1)))
    for first in range(0, len(starts), _POINTS):
        some = take(starts, slice(first, first + _POINTS))
        traced = trace(run.grid, planned.surface, some, run.terrain)
        low = np.minimum(low, [traced.x.min(), traced.y.min()])
        high = np.maximum(high, [traced.x.max(), traced.y.max()])
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])
