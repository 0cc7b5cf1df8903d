"""A synthetic canton through ``sassgis batch``: ``python benchmarks/canton.py [--share 0.01]``.

The whole is 3,000 km² at 5 m (120 million cells, in tiles of 1,000 x 1,000), with 10,000 release
areas of 100 points and 10 blocks each. ``--share`` takes a part of it that has as many areas per km².
The ground is made, not surveyed, and the same each time: ridges 2 km apart, each with a cliff over
a talus and a flat valley. The batch runs in a process of its own, which reports time and memory.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from shapely import box

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sample_dem"))
from terrain_kit import FloatArray, noise, write_dem, write_vectors

WEST, NORTH = 2_600_000.0, 1_200_000.0
#: Cells along a tile.
TILE = 1000
#: Of the whole canton.
KM2, AREAS = 3000.0, 10_000
#: From one ridge to the next (m); half of it is one side of a valley.
PERIOD = 2000.0
#: From the ridge down: plan length (m) and slope (degrees).
UNITS = ((150.0, 12.0), (60.0, 65.0), (300.0, 35.0), (190.0, 15.0), (300.0, 1.0))
#: Side of a release area with 100 points (m), and where it lies below the ridge.
AREA_DEPTH, AREA_BELOW = 50.0, 155.0

CONFIG = """\
[project]
name = "Synthetic canton"

[terrain]
dem = "tiles"
vertical_datum = "LN02"

[release]
file = "release.gpkg"
name_field = "name"
spacing_m = 5.0
placement = "grid"
rocks_per_point = {rocks}

[ground]
default = "debris"

# Semi-axes: half of what a folding rule shows.
[[blocks]]
name = "block"
axis_1_m = [0.30, 0.60]
axis_2_m = [0.25, 0.50]
axis_3_m = [0.20, 0.40]
density_kgm3 = [2600.0, 2750.0]
onset_frequency = 1.0
onset_unit = "per_year_ha"

[hazard]
ref_width_m = 10.0

[run]
seed = 1986
"""


@dataclass(frozen=True, slots=True)
class Canton:
    """How large a canton is made: km², size of a cell (m), areas, points and blocks of each."""

    km2: float
    cell: float
    areas: int
    points: int
    rocks: int

    @property
    def tiles(self) -> tuple[int, int]:
        """Tiles from north to south and from west to east, about six to five."""
        side = TILE * self.cell
        rows = max(1, round(math.sqrt(self.km2 * 1e6 / 1.2) / side))
        return rows, max(1, math.ceil(self.km2 * 1e6 / side**2 / rows))

    @property
    def cells(self) -> int:
        """Of all tiles."""
        rows, cols = self.tiles
        return rows * cols * TILE**2


def heights(x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights of the canton at map coordinates (m)."""
    edge = np.cumsum([0.0, *(length for length, _ in UNITS)])
    drop = np.cumsum([0.0, *(length * math.tan(math.radians(a)) for length, a in UNITS)])
    below = np.abs((x - WEST) % PERIOD - 0.5 * PERIOD)
    z: FloatArray = 600.0 + drop[-1] - np.interp(below, edge, drop)
    # Gullies and ribs, and a relief of long waves along the ridges.
    return z + 4.0 * noise(x, y, 60.0, 1) + 40.0 * noise(x, y, 3000.0, 2)


def write_tiles(canton: Canton, folder: Path) -> None:
    """Write the terrain as tiles."""
    side = TILE * canton.cell
    along = (np.arange(TILE) + 0.5) * canton.cell
    for i in range(canton.tiles[0]):
        for j in range(canton.tiles[1]):
            west, north = WEST + j * side, NORTH - i * side
            x, y = np.meshgrid(west + along, north - along)
            file = folder / f"tile_{i:02d}_{j:02d}.tif"
            write_dem(file, heights(x, y), west, north, canton.cell, "LN02")


def write_areas(canton: Canton, file: Path) -> None:
    """Write release areas below the ridges, evenly over the canton, two of each place."""
    rows, cols = canton.tiles
    side = TILE * canton.cell
    ridges = int(cols * side // PERIOD)
    each = math.ceil(canton.areas / (2 * ridges))
    pitch = (rows * side - 1000.0) / each
    width = canton.points * 5.0**2 / AREA_DEPTH
    features = []
    for k in range(canton.areas):
        ridge, rest = divmod(k, 2 * each)
        step, hand = divmod(rest, 2)
        middle = WEST + (ridge + 0.5) * PERIOD
        x = middle + AREA_BELOW if hand else middle - AREA_BELOW - AREA_DEPTH
        # Half a spacing off: no point of the lattice lies on an outline.
        x, y = x + 2.5, NORTH - 502.5 - round(step * pitch / 5.0) * 5.0
        shape = box(x, y - width, x + AREA_DEPTH, y)
        features.append({"name": f"A{k + 1:05d}", "geometry": shape})
    write_vectors(file, "release", features)


def write_canton(canton: Canton, folder: Path) -> None:
    """Write tiles, release areas and configuration."""
    write_tiles(canton, folder / "tiles")
    write_areas(canton, folder / "release.gpkg")
    (folder / "config.toml").write_text(CONFIG.format(rocks=canton.rocks), encoding="utf-8")
