"""Room for errors of measurement, and heights, as the checks take them."""

from __future__ import annotations

import math

import numpy as np
import shapely

from sassgis.gap.observations.observed import Observations, rock_radii_m
from sassgis.gap.observations.tables import Table
from sassgis.model.grid import FloatArray, Grid
from sassgis.terrain.heights import heights_at

#: Of falls between observed points (m/s²).
GRAVITY = 9.81
#: Room for errors of measurement where none are stated.
SPEED_ERROR_REL, HEIGHT_ERROR_M, POSITION_ERROR_M = 0.05, 0.25, 0.5
MASS_ERROR_REL = 0.05
#: Errors in units of the standard error that are still put down to the measurement.
SIGMAS = 3.0


def stated_or(value: float, otherwise: float) -> float:
    """What the metadata state of the measurement, or else what is usual or estimated."""
    return value if math.isfinite(value) else otherwise


def tops_m(obs: Observations, grid: Grid | None, drop_m: float = 0.0) -> FloatArray:
    """Height from which each rock came, at most; the last one for unattributed blocks.

    Blocks are let go up to ``drop_m`` above the ground, or where their height is stated.
    """
    z = obs.rocks.z
    if grid is not None:
        z = np.fmax(z, heights_at(grid, obs.rocks.x, obs.rocks.y) + drop_m)
    top = np.append(obs.of_rocks(z) + np.nan_to_num(rock_radii_m(obs)), np.nan)
    summit = float(np.nanmax(z)) if np.isfinite(z).any() else math.nan
    if grid is not None and not math.isfinite(summit) and np.isfinite(grid.values).any():
        summit = float(np.nanmax(grid.values))
    if math.isfinite(summit):
        # Blocks torn out of the slope start below the releases.
        top[~np.isfinite(top)] = summit
    return top


def above_release_m(obs: Observations, grid: Grid | None) -> FloatArray:
    """Height of each impact above the stated release of its rock (m); NaN where unknown."""
    release = np.append(obs.of_rocks(heights_m(obs.rocks, grid)), np.nan)
    found: FloatArray = heights_m(obs.impacts, grid) - release[obs.rock_of("impacts")]
    return found


def heights_m(points: Table, grid: Grid | None) -> FloatArray:
    """Height of each point of a table as stated, else of the ground below (m); NaN unknown."""
    own = points.numbers
    if grid is None:
        return own["z"]
    return np.where(np.isfinite(own["z"]), own["z"], heights_at(grid, own["x"], own["y"]))


def height_errors_m(points: Table, grid: Grid | None, position_m: float) -> FloatArray:
    """What an error of the place makes of heights that are those of the ground (m); else 0."""
    own = points.numbers
    if grid is None:
        return np.zeros(len(points))
    d = grid.cell_size
    rises = [
        (
            heights_at(grid, own["x"] + e, own["y"] + n)
            - heights_at(grid, own["x"] - e, own["y"] - n)
        )
        / (2.0 * d)
        for e, n in ((d, 0.0), (0.0, d))
    ]
    found: FloatArray = np.nan_to_num(position_m * np.hypot(*rises))
    return np.where(np.isfinite(own["z"]), 0.0, found)


def station_lines(obs: Observations) -> dict[str, shapely.LineString]:
    """Lines of the stations that have one, by name."""
    table = zip(obs.stations.station.tolist(), obs.stations.vertices, strict=True)
    return {name: shapely.LineString(vertices) for name, vertices in table if len(vertices) > 1}


def station_heights_m(obs: Observations, grid: Grid | None, *, lowest: bool) -> FloatArray:
    """Ground at the station of each passage: its lowest or middle point."""
    if grid is None:
        return np.full(len(obs.passages), np.nan)
    heights = {}
    at = np.linspace(0.0, 1.0, 21) if lowest else np.array([0.5])
    for name, line in station_lines(obs).items():
        points = shapely.get_coordinates(line.interpolate(at, normalized=True))
        z = heights_at(grid, points[:, 0], points[:, 1])
        if np.isfinite(z).any():
            heights[name] = float(np.nanmin(z))
    return np.array([heights.get(s, math.nan) for s in obs.passages.station.tolist()], np.float64)
