"""Whether observed places can be true: stations, the DEM, heights."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import shapely

from sassgis.gap.observations.allowances import (
    HEIGHT_ERROR_M,
    POSITION_ERROR_M,
    SIGMAS,
    above_release_m,
    stated_or,
    station_heights_m,
    station_lines,
    tops_m,
)
from sassgis.gap.observations.observation_finding import ObservationFinding
from sassgis.gap.observations.observed import Observations
from sassgis.gap.observations.rules import RULES
from sassgis.gap.observations.tables import POINT_TABLES
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.labels import some_of
from sassgis.terrain.heights import heights_at

#: Heights of the same ground in two height systems differ by more than this (m).
_OFFSET_M = 1.5
#: Rocks are released up to this high above the ground (m).
_RELEASE_HEIGHT_M = 5.0


def check_near_stations(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Passages far from the station that they name."""
    passages, lines = obs.passages, station_lines(obs)
    room = max(5.0, SIGMAS * stated_or(obs.metadata.position_error_m, POSITION_ERROR_M))
    far, worst = np.zeros(len(passages), np.bool_), 0.0
    for i, name in enumerate(passages.station.tolist()):
        if name in lines and math.isfinite(passages.x[i] + passages.y[i]):
            away = float(lines[name].distance(shapely.Point(passages.x[i], passages.y[i])))
            far[i] = away > room
            worst = max(worst, away)
    yield from RULES["far from station"].at(obs, "passages", far, f"up to {worst:.1f} m", room=room)


def check_downhill(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Passages of a rock that climb, lie above its release, or are listed out of order."""
    passages = obs.passages
    yield from _impacts_above_release(obs, grid)
    if not len(passages):
        return
    own = passages.z - np.nan_to_num(passages.height_m)
    level = own.copy()
    if grid is not None:
        ground = heights_at(grid, passages.x, passages.y)
        level = np.where(np.isfinite(ground), ground, level)
        if len(obs.stations):
            middle = station_heights_m(obs, grid, lowest=False)
            level = np.where(np.isfinite(level), level, middle)
    room = max(2.0, SIGMAS * stated_or(obs.metadata.height_error_m, HEIGHT_ERROR_M))
    owner, rocks = obs.rock_of("passages"), obs.rocks
    # For rocks of unknown release the summit says nothing: only their own release counts.
    placed = np.isfinite(rocks.z) | np.isfinite(rocks.x + rocks.y)
    has_release = np.append(obs.of_rocks(placed) == 1.0, False)
    top = tops_m(obs, grid)[owner]
    above = has_release[owner] & (level > top + room)
    if above.any():
        most = np.nanmax((level - top)[above])
        yield from RULES["above release"].at(obs, "passages", above, f"up to {most:.1f} m above")
    # The order of the stations is what most rocks say.
    rank: dict[str, float] = {}
    for name in set(passages.station.tolist()):
        z = level[(passages.station == name) & np.isfinite(level)]
        if name and z.size:
            rank[name] = float(np.median(z))
    height = np.array([rank.get(s, math.nan) for s in passages.station.tolist()], np.float64)
    climbing, unordered = np.zeros((2, len(passages)), np.bool_)
    ids = passages.rock_id
    for name in dict.fromkeys(ids.tolist()):
        rows = np.flatnonzero((ids == name) & np.isfinite(height)) if name else np.empty(0, int)
        if rows.size < 2:
            continue
        unordered[rows[1:]] |= np.diff(height[rows]) > 0.0
        down = rows[np.argsort(-height[rows], kind="stable")]
        climbing[down[1:]] |= np.diff(own[down]) > room
    yield from RULES["climbs"].at(obs, "passages", climbing)
    names = some_of(passages.station[unordered].tolist())
    yield from RULES["unordered"].at(obs, "passages", unordered, names)


def _impacts_above_release(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    over = above_release_m(obs, grid)
    meta = obs.metadata
    error = stated_or(meta.height_error_m, HEIGHT_ERROR_M)
    error += stated_or(meta.position_error_m, POSITION_ERROR_M)
    above = over > max(2.0, SIGMAS * error)
    if above.any():
        most = f"up to {over[above].max():.1f} m above"
        yield from RULES["impacts above release"].at(obs, "impacts", above, most)


def check_on_the_dem(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Places outside the DEM."""
    if grid is None:
        return
    west, south, east, north = grid.bounds
    extent = f"x {west:.0f} to {east:.0f}, y {south:.0f} to {north:.0f}"
    for table in POINT_TABLES:
        numbers = obs.tables[table].numbers
        x, y = numbers["x"], numbers["y"]
        known = np.isfinite(x) & np.isfinite(y)
        outside = known & (grid.cell_of(x, y) < 0)
        if not outside.any():
            continue
        i = int(np.flatnonzero(outside)[0])
        every = bool(outside[known].all())
        yield from RULES["all outside" if every else "outside"].at(
            obs,
            table,
            outside,
            f"{x[i]:.6g}, {y[i]:.6g}" if abs(x[i]) < 1e4 else f"{x[i]:.1f}, {y[i]:.1f}",
            extent=extent,
            why=_why_outside(x[known], y[known], grid) if every else "",
        )
    dem = shapely.box(west, south, east, north)
    for i, vertices in enumerate(obs.stations.vertices):
        if len(vertices) > 1 and not shapely.LineString(vertices).intersects(dem):
            yield from RULES["station outside"].at(
                obs,
                "stations",
                np.array([i]),
                ", ".join(f"{v:.1f}" for v in vertices[0]),
                name=obs.stations.station[i],
                extent=extent,
                why=_why_outside(vertices[:, 0], vertices[:, 1], grid),
            )


def _why_outside(x: FloatArray, y: FloatArray, grid: Grid) -> str:
    """A guess at how coordinates missed the DEM."""
    if (np.abs(x) <= 180.0).all() and (np.abs(y) <= 90.0).all() and grid.crs:
        return ": the coordinates look like degrees"
    if (grid.cell_of(y, x) >= 0).mean() > 0.5:
        return ": x and y look swapped"
    return ": another coordinate system?"


def check_offsets(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Heights in another system than those of the DEM, and single heights far from it."""
    if grid is None:
        return
    limit = max(
        _OFFSET_M,
        0.5 * grid.cell_size,
        SIGMAS * stated_or(obs.metadata.position_error_m, POSITION_ERROR_M),
    )
    # A rock on its path may fly at any height.
    for table in (name for name in POINT_TABLES if name != "trajectories"):
        numbers = obs.tables[table].numbers
        over = numbers["z"] - heights_at(grid, numbers["x"], numbers["y"])
        if table == "passages":
            over = over - np.nan_to_num(numbers["height_m"])
            # Flying rocks may be high up: only those of known height count.
            over = np.where(np.isfinite(numbers["height_m"]) | (over < 0.0), over, np.nan)
        if table == "rocks":
            # Released from a bucket or a ledge: above the ground is no fault.
            over = np.where((over > 0.0) & (over < _RELEASE_HEIGHT_M), 0.0, over)
        known = np.isfinite(over)
        if not known.any():
            continue
        middle = float(np.median(over[known]))
        spread = 1.4826 * float(np.median(np.abs(over[known] - middle)))
        if known.sum() >= 3 and abs(middle) > limit and spread < 0.5 * abs(middle):
            yield from RULES["height system"].at(
                obs,
                table,
                known,
                f"{middle:+.2f} m in the median, scatter {spread:.2f} m",
                limit=limit,
            )
            over = over - middle
        stray = known & (np.abs(over) > max(20.0, 4.0 * limit))
        if stray.any():
            worst = over[stray][np.argmax(np.abs(over[stray]))]
            yield from RULES["stray height"].at(obs, table, stray, f"{worst:+.1f} m")
    path = obs.trajectories
    over = path.z - heights_at(grid, path.x, path.y)
    known = np.isfinite(over)
    if known.any():
        # A rock may fly at any height, but it cannot be under the ground.
        low = float(np.quantile(over[known], 0.05))
        if low < -limit:
            yield from RULES["under ground"].at(
                obs,
                "trajectories",
                known & (over < -limit),
                f"{low:+.2f} m at the lowest twentieth",
            )
