"""Sites with observed stops: terrain, ground by description, blocks, simulated stops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from field_cases.tables import field_file
from sassgis.engine.simulate_paths import PathTerrain, follow
from sassgis.io.read.ground_map import built_in_table
from sassgis.io.read.tiles import read_terrain
from sassgis.model import rng
from sassgis.model.blocks import BlockPopulation
from sassgis.model.grid import Grid
from sassgis.model.ground import GroundTable
from sassgis.model.profiles import ReleasePoints
from sassgis.model.results import StopReason
from sassgis.model.settings import EngineSettings, TerrainSettings
from sassgis.terrain.block_scale import block_scale_grid

FloatArray = NDArray[np.float64]

#: Largest vertical gap between terrain and segments (m): the default of a run.
TOLERANCE_M = TerrainSettings().segment_tolerance_m
#: Tschamut: the terrain is known this far beyond the tracks (m), further out it is a plane.
BEYOND_M = 10.0
TSCHAMUT_BLOCKS = {1: "St. Leonard", 2: "heaviest", 4: "plate"}
#: Tschamut: release places, by the least x of each (m).
PLACES_M = (0.0, 17.5, 25.0, 32.0, 45.0)
#: Authume: the substratum zones, read as ground classes by their description alone.
AUTHUME_ZONES = {1: "overgrown_slope", 2: "rock", 3: "debris"}
#: Authume: rocks beyond this plan distance have left the slope above the faces (m).
EDGE_M = 30.0
DENSITY_KGM3 = 2600.0


@dataclass(frozen=True)
class Site:
    """A site and the stops that were observed on it.

    Attributes
    ----------
    name : str
    heights : Grid
        At the scale of the blocks.
    ground : int32, shape of the grid
        Number of the class in ``classes``.
    classes : tuple of str
        The first one is that of the slope below the release, which is calibrated.
    release : float64, shape (n, 2)
        Plan position of each rock (m); of the middle of the square where single ones are unknown.
    square_m : float
        Side of that square, 0 where each position is known.
    blocks : tuple of BlockPopulation
        Of each rock.
    labels : tuple of str
        Group of each rock, of which each half holds as many.
    stops : float64, shape (n, 2)
        Observed (m).
    """

    name: str
    heights: Grid
    ground: NDArray[np.int32]
    classes: tuple[str, ...]
    release: FloatArray
    square_m: float
    blocks: tuple[BlockPopulation, ...]
    labels: tuple[str, ...]
    stops: FloatArray

    def __len__(self) -> int:
        return len(self.stops)

    def take(self, rocks: Sequence[int]) -> Site:
        """The same site with some of the rocks."""
        return replace(
            self, release=self.release[rocks], stops=self.stops[rocks],
            blocks=tuple(self.blocks[i] for i in rocks),
            labels=tuple(self.labels[i] for i in rocks),
        )  # fmt: skip


def halves(site: Site, seed: int = 2014) -> tuple[list[int], list[int]]:
    """Rocks to fit and rocks to score, half of each group."""
    draw = np.random.default_rng(seed)
    fit: list[int] = []
    for number, label in enumerate(sorted(set(site.labels))):
        own = draw.permutation([i for i, group in enumerate(site.labels) if group == label])
        fit.extend(own[: (len(own) + number % 2) // 2].tolist())
    return sorted(fit), sorted(set(range(len(site))) - set(fit))


def _block(
    name: str, half: Sequence[float], mass_kg: float, drop: tuple[float, float]
) -> BlockPopulation:
    """A block of known semi-axes (m) and mass."""
    a, b, c = (float(h) for h in half)
    density = mass_kg / (4.0 / 3.0 * np.pi * a * b * c)
    return BlockPopulation(name, (a, a), (b, b), (c, c), (density, density), drop_m=drop)


def tschamut(data: Path) -> Site:
    """The runs of Tschamut 2014, each from where it was released."""
    folder = "tschamut2014"
    release = pd.read_csv(field_file(data, folder, "release_points.csv"))
    ends = pd.read_csv(field_file(data, folder, "observed_deposition.csv"))
    sizes = pd.read_csv(field_file(data, folder, "block_metadata.csv")).set_index("block_id")
    runs = release.merge(ends, on="trajectory_id", suffixes=("", "_stop"), validate="1:1")
    # One run is there twice.
    runs = runs[~runs.duplicated(["x_m", "y_m", "x_m_stop", "y_m_stop"])]
    start = runs[["x_m", "y_m"]].to_numpy(float)
    stops = runs[["x_m_stop", "y_m_stop"]].to_numpy(float)
    half = np.sort(sizes[["size_x_m", "size_y_m", "size_z_m"]].to_numpy() / 2.0, axis=1)[:, ::-1]
    made = {
        number: _block(TSCHAMUT_BLOCKS[int(number)], axes, sizes.loc[number, "mass_kg"], (0.0, 0.0))
        for number, axes in zip(sizes.index, half, strict=True)
    }
    tracks = shapely.MultiPoint(np.vstack([start, stops])).convex_hull.buffer(BEYOND_M)
    grid = _clipped(read_terrain(field_file(data, folder, "terrain.asc"), "local"), tracks)
    return Site(
        name="Tschamut",
        heights=_at_block_scale(grid, list(made.values())),
        ground=np.zeros(grid.shape, np.int32),
        classes=("soft_meadow",),
        release=start,
        square_m=0.0,
        blocks=tuple(made[number] for number in runs["block_id"]),
        labels=tuple(TSCHAMUT_BLOCKS[int(number)] for number in runs["block_id"]),
        stops=stops,
    )


def authume(data: Path) -> Site:
    """The blocks of position P1, let go somewhere in a square above the quarry."""
    folder = "authume_quarry_p1"
    ends = np.loadtxt(field_file(data, folder, "Endpoints_P1.txt"), ndmin=2)
    corners = np.loadtxt(field_file(data, folder, "positions_P1.xyz"), ndmin=2)
    grid = read_terrain(field_file(data, folder, "derived_dtm_0p5m_local.tif"), "local")
    zones = read_terrain(
        field_file(data, folder, "derived_substratum_zones_0p5m_local.tif"), "local"
    )
    half = np.sort(ends[:, 4:7], axis=1)[:, ::-1] / 2.0
    mass = ends[:, 3]
    # Y is the vertical.
    square = corners[:, [0, 2]]
    x, y = grid.cell_centres(np.arange(grid.values.size))
    (west, south), (east, north) = square.min(axis=0), square.max(axis=0)
    under = grid.values.ravel()[(x >= west) & (x <= east) & (y >= south) & (y <= north)]
    height = corners[:, 1].mean() - np.median(half[:, 2])
    drop = (max(float(height - under.max()), 0.0), float(height - under.min()))
    blocks = [_block(f"P1-{i + 1:02d}", half[i], mass[i], drop) for i in range(len(ends))]
    classes = tuple(AUTHUME_ZONES.values())
    ground = np.zeros(grid.shape, np.int32)
    for number, code in enumerate(AUTHUME_ZONES):
        ground[zones.values == code] = number
    # Unmapped cells are hard ground, as in the quarry around them.
    ground[~np.isin(zones.values, list(AUTHUME_ZONES))] = classes.index("rock")
    return Site(
        name="Authume",
        heights=_at_block_scale(grid, blocks),
        ground=ground,
        classes=classes,
        release=np.tile(square.mean(axis=0), (len(ends), 1)),
        square_m=float((east - west + north - south) / 2.0),
        blocks=tuple(blocks),
        labels=tuple(np.where(mass > np.median(mass), "heavy", "light")),
        stops=ends[:, [0, 2]],
    )


def _clipped(grid: Grid, within: shapely.Geometry) -> Grid:
    """The terrain within an outline."""
    x, y = grid.cell_centres(np.arange(grid.values.size))
    known = shapely.contains_xy(within, x, y).reshape(grid.shape)
    return replace(grid, values=np.where(known, grid.values, np.nan))


def _at_block_scale(grid: Grid, blocks: Sequence[BlockPopulation]) -> Grid:
    """Heights as a run with a typical one of the blocks has them."""
    return block_scale_grid(grid, float(np.median([b.mean_width_m for b in blocks])))


@dataclass(frozen=True)
class Simulated:
    """Stops of a site's rocks, simulated.

    Attributes
    ----------
    stops : float64, shape (n, m, 2)
        Of m simulations of each rock (m); of those that left the terrain, its edge.
    left : bool, shape (n, m)
        Whether they left the terrain.
    started : bool, shape (n, m)
    """

    stops: FloatArray
    left: NDArray[np.bool_]
    started: NDArray[np.bool_]


def simulated(
    site: Site, table: GroundTable, settings: EngineSettings, count: int, seed: int = 1986
) -> Simulated:
    """Simulate each rock of a site ``count`` times; the draws depend on the seed only."""
    terrain = PathTerrain(site.heights, site.ground, TOLERANCE_M)
    stops = np.empty((len(site), count, 2))
    reason = np.empty((len(site), count), np.uint8)
    groups: dict[BlockPopulation, list[int]] = {}
    for i, block in enumerate(site.blocks):
        groups.setdefault(block, []).append(i)
    for block, own in groups.items():
        x, y = np.ascontiguousarray(site.release[own].T)
        key = np.array([rng.combined(np.uint64(7), np.uint64(i)) for i in own], np.uint64)
        points = ReleasePoints(x, y, np.zeros(len(own), np.int64), key, (site.name,))
        result = follow(
            terrain, points, table, block, settings, seed=seed, rocks_per_point=count,
            point_keys=key, spread_m=site.square_m,
        )  # fmt: skip
        stops[own] = np.stack([result.x, result.y], axis=1).reshape(len(own), count, 2)
        reason[own] = result.rocks["reason"].reshape(len(own), count)
    return Simulated(stops, reason == StopReason.LEFT_PROFILE, reason != StopReason.NEVER_STARTED)


def table_of(
    site: Site,
    changes: Mapping[str, Mapping[str, float]] | None = None,
    readings: str = "hazard",
) -> GroundTable:
    """The built-in classes of a site, some with other parameters."""
    built_in = built_in_table(readings)
    return GroundTable(
        tuple(
            replace(built_in.classes[built_in.index(name)], **(changes or {}).get(name, {}))
            for name in site.classes
        )
    )


def run_out(site: Site, stops: FloatArray) -> FloatArray:
    """Plan distance and offset from the mean direction of the observed stops (m).

    Parameters
    ----------
    site : Site
    stops : float64, shape (n, ..., 2)

    Returns
    -------
    float64, shape (n, ..., 2)
        Run-out, and offset, positive to the right.
    """
    away = site.stops - site.release
    ahead = (away / np.linalg.norm(away, axis=1)[:, None]).mean(axis=0)
    ahead /= np.linalg.norm(ahead)
    start = site.release.reshape(len(site), *[1] * (stops.ndim - 2), 2)
    d = stops - start
    return np.stack(
        [np.hypot(d[..., 0], d[..., 1]), d[..., 0] * ahead[1] - d[..., 1] * ahead[0]], axis=-1
    )
