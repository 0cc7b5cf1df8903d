"""Sources of a run with their onset frequencies, and the angles under which stops are seen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.errors import ConfigError, InputError
from sassgis.grid import FloatArray, Grid
from sassgis.settings.hazard_rules import Onset, Source, SourceCounts
from sassgis.settings.map_run import MapRun, ReleaseArea
from sassgis.settings.results import HALTED
from sassgis.settings.schema import Input
from sassgis.simulation.accumulators import Progress, joined_lines, kept_stops
from sassgis.simulation.control_lines import ControlLineSums, LineParts
from sassgis.terrain.prepare import Plan

_HECTARE_M2 = 1e4
_PLACE = {"per_year_ha": "release polygons", "per_year_m": "release lines"}


@dataclass(frozen=True, slots=True)
class Sampled:
    """Simulated blocks of one source."""

    source: Source
    # Places are flat indices of cells, and numbers of exposed objects.
    cells: SourceCounts
    objects: SourceCounts
    control_lines: ControlLineSums  # at stations and barriers
    release: Any = None  # shapely geometry; where its blocks start, if it is known


def onset_frequencies(
    areas: Sequence[ReleaseArea],
    onsets: Mapping[str, Onset],
    table: Mapping[tuple[str, str], Onset],
    table_file: Input | None,
    config_file: Path | None,
) -> dict[tuple[str, str], float]:
    """Return blocks released per year, by release area and block scenario.

    ``onsets`` are by scenario; those of single sources from a table take precedence. Raises
    ConfigError for a scenario that is released somewhere without a frequency, InputError for a unit
    that does not fit the shape of an area.
    """
    annual = {}
    for area in areas:
        for scenario in area.scenarios:
            single = table.get((area.name, scenario))
            onset = onsets[scenario]
            if single is not None:
                onset = replace(single, share=onset.share)
            if onset.frequency is None:
                raise ConfigError(
                    "missing key: zones need to know how often blocks are released",
                    file=config_file,
                    field=f"blocks[{scenario}].onset_frequency",
                    expected="a number 0 or more"
                    + (f", or a row for {area.name} in {table_file.name}" if table_file else ""),
                )
            size = _size(area, onset)
            if size == 0.0:
                raise InputError(
                    f"release area {area.name} has no extent for this unit",
                    file=config_file if single is None else table_file,
                    field=f"blocks[{scenario}].onset_unit" if single is None else "unit",
                    found=f"{onset.unit}, {area.geometry.geom_type}",
                    expected=f"{_PLACE[onset.unit]}, or per_year",
                )
            annual[area.name, scenario] = onset.frequency * onset.share * size
    return annual


def _size(area: ReleaseArea, onset: Onset) -> float:
    """Return the factor of the frequency: the extent of the ground from which blocks start."""
    if onset.unit == "per_year_ha":
        return area.known * float(area.geometry.area) / _HECTARE_M2
    if onset.unit == "per_year_m":
        return 0.0 if area.geometry.area > 0.0 else area.known * float(area.geometry.length)
    return 1.0


def line_parts(sampled: Sequence[Sampled]) -> LineParts:
    """Return what reaches stations and barriers by source, with the rate of each block."""
    return [(one.source.rate_per_rock, one.control_lines) for one in sampled]


def sampled_sources(
    run: MapRun,
    progress: Progress,
    frequencies: dict[tuple[str, str], float] | None,
    *,
    barriers: bool = True,
) -> list[Sampled]:
    """Return every source of a run with its counts, areas in their order, scenarios within them.

    Without frequencies the rate of each block is 1. ``barriers`` is whether blocks meet them.
    """
    out = []
    for (area, scenario), tally in sorted(progress.sources.items()):
        tally = tally if barriers else tally.without_barriers()
        blocks = run.blocks[scenario]
        name = run.areas[area].name
        started = float(tally.rocks - tally.never_started)
        source = Source(
            area=name,
            scenario=blocks.name,
            frequency=started if frequencies is None else frequencies[name, blocks.name],
            rocks=tally.rocks,
            rocks_per_line=run.release.rocks_per_point,
            random_points=run.release.placement == "random",
            block_width_m=blocks.mean_width_m,
            never_started=tally.never_started,
            heaviest=tally.heaviest,
        )
        cells = on_known_terrain(tally.cells.counts(), run.grid)
        objects, shape = tally.objects.counts(), run.areas[area].geometry
        out.append(Sampled(source, cells, objects, tally.control_lines, shape))
    return out


def on_known_terrain(counts: SourceCounts, grid: Grid) -> SourceCounts:
    """Return counts without cells of unknown height, which nearby blocks count for as well."""
    known = np.isfinite(grid.values.ravel()[counts.places])
    if known.all():
        return counts
    return SourceCounts(counts.places[known], counts.count[known], counts.square[known])


#: A fall line leaves the cliff where it is flatter than this over one step (degrees; expert
#: judgement: steeper than any talus), and the step (m).
CLIFF_ANGLE_DEG = 45.0
STEP_M = 10.0


@dataclass(frozen=True, slots=True)
class ReachAngles:
    """Angles of the stops of single blocks, below the horizontal (degrees)."""

    # Shape (n,); seen from the release point: the reach angle (Heim 1932; Corominas 1996).
    reach_deg: FloatArray
    # Shape (n,); seen from the foot of the cliff on the fall line of the release point, where a
    # talus would begin: the shadow angle (Evans and Hungr 1993). NaN where there is no cliff below
    # the release point, or the block stops on it. Neither publication was checked.
    shadow_deg: FloatArray


def reach_angles(run: MapRun, planned: Plan, progress: Progress) -> ReachAngles:
    """Compute the angles of single blocks that came to rest or stopped at a barrier.

    Distances are straight lines in plan; heights are those of the terrain.
    """
    rows = kept_stops(run, progress)
    ended = np.isin(rows.rocks["reason"], HALTED)
    point = rows.rocks["line"][ended]
    end = _places(run.grid, rows.x[ended], rows.y[ended])
    start = _places(run.grid, planned.points.x, planned.points.y)
    foot = np.full((len(planned.points), 3), np.nan)
    lines = joined_lines(progress.lines)
    for i in np.flatnonzero(np.isin(lines.point, point)):
        part = slice(lines.offset[i], lines.offset[i + 1])
        foot[lines.point[i]] = foot_of_cliff(run.grid, lines.x[part], lines.y[part])
    return ReachAngles(_angle_deg(start[point], end), _angle_deg(foot[point], end))


#: Shares of the blocks that stop below the reach angles that are stated; the first is that of the
#: energy line.
ANGLE_SHARES = (0.01, 0.05, 0.5)
#: Most pairs of a release point and a cell that are compared: about a second.
_PAIRS = 1e8


def stated_angles(angles_deg: FloatArray) -> FloatArray:
    """Return the angles above which 99, 95 and 50 % of the blocks stop; empty without stops."""
    known = angles_deg[np.isfinite(angles_deg)]
    # The smallest angle is often that of a block that has hardly moved.
    return np.quantile(known, ANGLE_SHARES) if known.size else np.empty(0)


def below_energy_line(
    grid: Grid, x: FloatArray, y: FloatArray, angle_deg: float
) -> NDArray[np.bool_]:
    """Find cells below a straight line that falls at an angle from any point (Heim 1932).

    The lines go in all directions, also through ground that stands in their way, as those of
    Jaboyedoff and Labiouse (2011, not checked). Large models are compared square by square.
    """
    fall = math.tan(math.radians(angle_deg))
    start = _places(grid, x, y)
    start = start[np.isfinite(start[:, 2])]
    start = start[np.argsort(-start[:, 2], kind="stable")]
    upper = []
    while len(start):
        upper.append(start[0])
        # Points below the line of a higher one reach no other cells.
        distance = np.hypot(*(start - start[0])[:, :2].T)
        start = start[start[:, 2] > start[0, 2] - fall * distance]
    side = max(1, math.ceil(math.sqrt(len(upper) * grid.values.size / _PAIRS)))
    row, col = (np.minimum(np.arange(side // 2, n + side // 2, side), n - 1) for n in grid.shape)
    heights = grid.values[np.ix_(row, col)]
    east = grid.west + (col + 0.5) * grid.cell_size
    north = grid.north - (row[:, None] + 0.5) * grid.cell_size
    below = np.zeros(heights.shape, bool)
    for at_x, at_y, at_z in upper:
        below |= heights <= at_z - fall * np.hypot(east - at_x, north - at_y)
    whole = below[np.ix_(*(np.arange(n) // side for n in grid.shape))]
    return whole & np.isfinite(grid.values)


def foot_of_cliff(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """Find where a fall line leaves the cliff on which it begins: x, y, z (m); NaN for no cliff."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    at = np.arange(0.0, s[-1] + 1e-9, STEP_M)
    places = _places(grid, np.interp(at, s, x), np.interp(at, s, y))
    steep = -np.diff(places[:, 2]) > STEP_M * math.tan(math.radians(CLIFF_ANGLE_DEG))
    flat_after = np.flatnonzero(steep[:-1] & ~steep[1:]) + 1
    return places[flat_after[0]] if flat_after.size else np.full(3, np.nan)


def _places(grid: Grid, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return x, y and the height of the cell, shape (n, 3); NaN outside."""
    return np.column_stack([x, y, grid.value_at(x, y)])


def _angle_deg(upper: FloatArray, lower: FloatArray) -> FloatArray:
    """Return the angle of falling lines below the horizontal; NaN for others."""
    distance = np.hypot(*(lower - upper)[:, :2].T)
    drop = upper[:, 2] - lower[:, 2]
    out: FloatArray = np.where(
        (distance > 0.0) & (drop > 0.0), np.degrees(np.arctan2(drop, distance)), np.nan
    )
    return out
