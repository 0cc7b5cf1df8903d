"""Observed points on fall lines: chainage, offset to the side, height above the ground.

A rock moves in space, the model in the plane of its fall line. What was observed is put into that
plane by the nearest point of the fall line that starts at the rock's release point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.gap.constants import LINE_DIRECTION_M, LINE_END_M
from sassgis.gap.observations.observed import Observations
from sassgis.gap.observations.tables import POINT_TABLES, Stations
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.profiles import ReleasePoints, TraceSet
from sassgis.terrain.flatten import chainage_to_xy, crossings, xy_to_chainage
from sassgis.terrain.heights import heights_at
from sassgis.terrain.release import point_keys


@dataclass(frozen=True, slots=True)
class Projected:
    """Points in the plane of fall lines, one per point that was given; arrays of shape (n,)."""

    line: IntArray  # fall line; -1 where the point has none, and all else is NaN
    s: FloatArray  # chainage of the nearest point of the line (m)
    lateral_m: FloatArray  # distance from it, positive to the right looking downhill
    height_m: FloatArray  # above the ground under the point itself; NaN without a height
    ground_m: FloatArray  # height of the ground under the point
    #: 1: the line ends before it comes abreast of the point, so that the run-out is at least ``s``;
    #: -1: the point lies behind the start; 0: abreast of the line.
    beyond: NDArray[np.int8]


def observed_release_points(observations: Observations) -> tuple[ReleasePoints, IntArray]:
    """Return the release points of rocks that have one, and the place of each in ``rock_names``.

    Each rock is a separate area, named after it: its random draws do not depend on which other
    rocks were observed.
    """
    x, y = (observations.of_rocks(v) for v in (observations.rocks.x, observations.rocks.y))
    rock = np.flatnonzero(np.isfinite(x + y))
    every = observations.rock_names
    names = tuple(every[i] for i in rock.tolist())
    key = np.concatenate([np.empty(0, np.uint64), *(point_keys(name, 1) for name in names)])
    return ReleasePoints(x[rock], y[rock], np.arange(rock.size), key, names), rock


def nearest_lines(traces: TraceSet, x: FloatArray, y: FloatArray) -> IntArray:
    """Find the line nearest to each point (m), (n,), the first of equals; -1 for none."""
    lines = np.full(np.size(x), -1, np.int64)
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if not len(traces) or not known.size:
        return lines
    shapes = []
    for i in range(len(traces)):
        own = slice(int(traces.offset[i]), int(traces.offset[i + 1]))
        points = np.column_stack([traces.x[own], traces.y[own]])
        shapes.append(shapely.LineString(points) if len(points) > 1 else shapely.Point(points[0]))
    tree = shapely.STRtree(shapes)
    point, line = tree.query_nearest(shapely.points(x[known], y[known]), all_matches=True)
    first = np.full(known.size, len(traces), np.int64)
    np.minimum.at(first, point, line)
    lines[known] = first
    return lines


def project(
    traces: TraceSet,
    line: IntArray,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray | None = None,
    *,
    grid: Grid | None = None,
    prolonged: bool = False,
) -> Projected:
    """Put points into the planes of fall lines.

    ``line``: that of each point, -1 for none; ``x``, ``y``, ``z``: coordinates (m), NaN where
    missing, shape (n,). ``grid``: the ground under the points, to which heights refer: next to the
    line it has another height than on it. ``prolonged``: whether lines go straight on beyond their
    end.
    """
    x, y, line = np.asarray(x), np.asarray(y), np.asarray(line)
    n = x.size
    s, lateral, ground = np.full((3, n), np.nan)
    known = np.flatnonzero((line >= 0) & np.isfinite(x) & np.isfinite(y))
    lines = np.full(n, -1, np.int64)
    lines[known] = line[known]
    beyond = np.zeros(n, np.int8)
    if known.size:
        own, px, py = lines[known], x[known], y[known]
        if grid is not None:
            ground[known] = heights_at(grid, px, py)
        s[known], lateral[known] = xy_to_chainage(traces, own, px, py)
        beyond[known] = _beyond(traces, own, px, py, s[known])
        if prolonged:
            past = np.flatnonzero(beyond == 1)
            s[past], lateral[past] = _past_the_end(traces, lines[past], x[past], y[past])
    height = np.full(n, np.nan) if z is None else np.asarray(z, np.float64) - ground
    return Projected(lines, s, lateral, height, ground, beyond)


def _past_the_end(
    traces: TraceSet, line: IntArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the chainage and lateral offset of points beyond the ends of their lines (m)."""
    last = traces.offset[line + 1] - 1
    first_s = traces.s[traces.offset[line]]
    lx, ly, ls = traces.x[last], traces.y[last], traces.s[last]
    from_x, from_y = chainage_to_xy(traces, line, np.maximum(ls - LINE_DIRECTION_M, first_s))
    size = np.maximum(np.hypot(lx - from_x, ly - from_y), LINE_END_M)
    east, north = (lx - from_x) / size, (ly - from_y) / size
    ahead, aside = x - lx, y - ly
    return ls + ahead * east + aside * north, ahead * north - aside * east


def _beyond(
    traces: TraceSet, line: IntArray, x: FloatArray, y: FloatArray, s: FloatArray
) -> NDArray[np.int8]:
    """Project points beyond the ends of their lines along the last and first segment."""
    first, last = traces.offset[line], traces.offset[line + 1] - 1
    second, before = np.minimum(first + 1, last), np.maximum(last - 1, first)
    lx, ly, ls = traces.x, traces.y, traces.s
    ahead = (x - lx[last]) * (lx[last] - lx[before]) + (y - ly[last]) * (ly[last] - ly[before])
    behind = (x - lx[first]) * (lx[second] - lx[first]) + (y - ly[first]) * (ly[second] - ly[first])
    result = np.zeros(x.size, np.int8)
    result[(s >= ls[last] - LINE_END_M) & (ahead > LINE_END_M)] = 1
    result[(s <= ls[first] + LINE_END_M) & (behind < -LINE_END_M)] = -1
    return result


def project_observations(
    observations: Observations,
    traces: TraceSet,
    line_of_rock: IntArray,
    *,
    grid: Grid,
    prolonged: bool = False,
) -> dict[str, Projected]:
    """Put all observed points into the planes of their rocks' fall lines, by table, row by row.

    Points that belong to no rock with a line are put on the nearest line. ``line_of_rock``: -1 for
    a rock without one, shape (len(observations.rock_names),).
    """
    found = {}
    lookup = np.append(line_of_rock, -1)
    for name in POINT_TABLES:
        points = observations.tables[name].numbers
        line = lookup[observations.rock_of(name)]
        loose = np.flatnonzero(line < 0)
        line[loose] = nearest_lines(traces, points["x"][loose], points["y"][loose])
        found[name] = project(
            traces, line, points["x"], points["y"], points["z"], grid=grid, prolonged=prolonged
        )
    return found


def station_chainages(
    traces: TraceSet, stations: Stations, *, prolong_m: float = 0.0
) -> FloatArray:
    """Find where each fall line first crosses each station (m), (n_lines, n_stations); or NaN.

    Stations are prolonged by ``prolong_m``: a line may pass just next to what every rock crossed.
    """
    s = np.full((len(traces), len(stations)), np.nan)
    for j, vertices in enumerate(stations.vertices):
        if vertices.shape[0] < 2:
            continue
        line, chainage = crossings(traces, prolonged(vertices, prolong_m))
        # Crossings of a line come by rising chainage: written backwards, the first one stays.
        s[line[::-1], j] = chainage[::-1]
    return s


def prolonged(vertices: FloatArray, by_m: float) -> FloatArray:
    """Return a line prolonged straight on at both ends."""
    if by_m <= 0.0:
        return vertices
    steps = np.diff(vertices, axis=0)
    steps = steps / np.hypot(steps[:, 0], steps[:, 1])[:, None]
    return np.vstack(
        [vertices[0] - by_m * steps[0], vertices[1:-1], vertices[-1] + by_m * steps[-1]]
    )
