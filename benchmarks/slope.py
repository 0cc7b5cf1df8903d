"""Make the slope on which run times are measured: ``python benchmarks/slope.py FOLDER [--rough]``.

1.2 km down the slope by 0.6 km along it at 2 m: plateau, cliff of 65°, talus of 36°, foot of 18°,
flat. A release polygon in the cliff holds exactly 3,000 cell centres. The ground is made, not
surveyed, and the same each time.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from shapely import box

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sample_dem"))
from terrain_kit import FloatArray, cell_centres, ease, noise, write_dem, write_vectors

CELL = 2.0
WIDTH, HEIGHT = 1200.0, 600.0
# Odd corner: cell centres then lie on even coordinates, where a 2 m lattice of release points lies.
WEST, SOUTH = 2_700_001.0, 1_120_001.0

#: Plan length (m), slope (degrees) and ground class of each unit, from the top in the west.
UNITS = (
    (100.0, 10.0, "soft_meadow"),
    (48.0, 65.0, "rock"),
    (350.0, 36.0, "debris"),
    (200.0, 18.0, "debris"),
    (502.0, 0.5, "soft_meadow"),
)
CLIFF_TOP = UNITS[0][0]
# 20 columns by 150 rows of cells, clear of the cliff's edge and foot.
RELEASE = (WEST + CLIFF_TOP + 4.0, SOUTH + 150.0, WEST + CLIFF_TOP + 44.0, SOUTH + 450.0)
RELEASE_CELLS = 3000
ROCKS_PER_CELL = 50
FLAT_Z = 1000.0

CONFIG = f"""\
[project]
name = "Benchmark slope"

[terrain]
dem = "dem.tif"
vertical_datum = "LN02"

[release]
file = "release.gpkg"
name_field = "name"
spacing_m = {CELL}
placement = "grid"
rocks_per_point = {ROCKS_PER_CELL}

[ground]
default = "debris"
file = "ground.gpkg"
class_field = "class"

# Semi-axes: half of the measured lengths.
[[blocks]]
name = "block"
axis_1_m = [0.30, 0.60]
axis_2_m = [0.25, 0.50]
axis_3_m = [0.20, 0.40]
density_kgm3 = [2600.0, 2750.0]

[run]
seed = 1986
jobs = 1
"""


def borders() -> FloatArray:
    """Distances from the western edge at which the units begin and the last one ends (m)."""
    return np.concatenate([[0.0], np.cumsum([length for length, _, _ in UNITS])])


def heights(x: FloatArray, y: FloatArray, rough: bool) -> FloatArray:
    """Heights of the slope at map coordinates (m).

    If it is rough, blocks and hollows of a few metres across and some decimetres high lie on the
    cliff, the talus and the foot.
    """
    edge = borders()
    fall = np.concatenate(
        [[0.0], np.cumsum([length * np.tan(np.radians(slope)) for length, slope, _ in UNITS])]
    )
    down = x - WEST
    z: FloatArray = FLAT_Z + fall[-1] - np.interp(down, edge, fall)
    if rough:
        strength = 0.05 + 0.25 * ease(down, edge[1], edge[1] + 10.0) * (
            1.0 - ease(down, edge[4] - 20.0, edge[4] + 20.0)
        )
        z = z + strength * (noise(x - WEST, y - SOUTH, 5.3, 1) + noise(x - WEST, y - SOUTH, 9.1, 2))
    return z


def write_slope(folder: Path, rough: bool = False) -> None:
    """Write dem.tif, release.gpkg, ground.gpkg and config.toml into a folder; they are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    x, y = cell_centres(WEST, SOUTH, WIDTH, HEIGHT, CELL)
    write_dem(folder / "dem.tif", heights(x, y, rough), WEST, SOUTH + HEIGHT, CELL, "LN02")
    write_vectors(
        folder / "release.gpkg", "release", [{"name": "cliff", "geometry": box(*RELEASE)}]
    )
    edge = WEST + borders()
    grounds = [
        {"class": ground, "geometry": box(edge[i], SOUTH, edge[i + 1], SOUTH + HEIGHT)}
        for i, (_, _, ground) in enumerate(UNITS)
    ]
    write_vectors(folder / "ground.gpkg", "ground", grounds)
    (folder / "config.toml").write_text(CONFIG, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--rough", action="store_true", help="with roughness of a few metres' scale"
    )
    arguments = parser.parse_args()
    write_slope(arguments.folder, arguments.rough)
    print(f"{RELEASE_CELLS} release cells x {ROCKS_PER_CELL} blocks: {arguments.folder}")


if __name__ == "__main__":
    main()
