"""Maps of real terrain.

``python docs/studies/tirol.py DATA -o FOLDER`` zones the terrain models of Land Tirol in DATA
(folders ``tirol_*``) with ``debris`` everywhere and writes ``results.json``.

The release polygons are those of snow avalanches, not mapped sources of rockfall: the maps show
no hazard of these places.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import rasterio

from sassgis.runs.run import zone

SITES = {
    "avaMal": ("tirol_avaMalRegional/avaMal.tif", "tirol_avaMalRegional/REL/relMalRegional.shp"),
    "avaKot": ("tirol_avaKot/avaKot.asc", "tirol_avaKot/REL/relKot.shp"),
    "avaGar": ("tirol_avaGar/avaGar.asc", "tirol_avaGar/REL/relGar.shp"),
}
CONFIG = """\
[terrain]
dem = "{dem}"
crs = "EPSG:31287"
vertical_datum = "unstated"

[release]
file = "{release}"
spacing_m = {spacing}
rocks_per_point = 20

[ground]
default = "{ground}"

[[blocks]]
name = "block"
axis_1_m = [0.5, 0.8]
axis_2_m = [0.4, 0.7]
axis_3_m = [0.3, 0.6]
onset_frequency = 0.5

[hazard]
ref_width_m = 10.0
by_source = false

[run]
seed = 1
"""


def config_of(data: Path, name: str, spacing: float, ground: str = "talus") -> str:
    """Configuration of one terrain."""
    dem, release = ((data / part).resolve() for part in SITES[name])
    return CONFIG.format(dem=dem, release=release, spacing=spacing, ground=ground)


def numbers(folder: Path) -> dict[str, object]:
    """Median and 90 % over the reached cells of 95 % values there, and areas by hazard level."""
    found: dict[str, object] = {}
    for stem in ("speed", "passing_height", "energy"):
        values = read(folder / "maps" / f"{stem}.tif")
        found[stem] = np.nanquantile(values, [0.5, 0.9]).tolist()
    level = read(folder / "maps" / "hazard_level.tif")
    with rasterio.open(folder / "maps" / "hazard_level.tif") as raster:
        cell = raster.transform.a
    found["level_ha"] = [float((level == k).sum()) * cell * cell / 1e4 for k in (1, 2, 3, 4)]
    return found


def read(path: Path) -> np.ndarray:
    """First band of a map, NaN where there is nothing."""
    with rasterio.open(path) as raster:
        values = raster.read(1, masked=True)
    return values.astype(float).filled(np.nan)


def main() -> None:
    """Zone all sites."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--spacing", type=float, default=20.0, help="of the release points (m)")
    parser.add_argument("--sites", nargs="*", default=list(SITES))
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    found = {}
    for name in given.sites:
        config = given.output / f"{name}.toml"
        config.write_text(config_of(given.data, name, given.spacing, "debris"))
        zone(config, given.output / name)
        found[name] = numbers(given.output / name)
    (given.output / "results.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
