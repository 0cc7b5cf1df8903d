"""Maps of real terrain before and after the resistance that grows with the speed.

``python docs/studies/tirol.py DATA -o FOLDER`` zones the terrain models of Land Tirol in DATA
(folders ``tirol_*``) with ``debris`` as it was, fitted to nothing but run-outs, and as it is; it
draws both beside each other, one picture for each terrain, and writes ``results.json``.

The release polygons are those of snow avalanches, not mapped sources of rockfall: what the
pictures show is the form of the maps, no hazard of these places.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import rasterio
from matplotlib.colors import ListedColormap, LogNorm

from sassgis.grid import Grid
from sassgis.report.figures.relief import hillshade
from sassgis.runs.run import zone

SITES = {
    "avaMal": ("tirol_avaMalRegional/avaMal.tif", "tirol_avaMalRegional/REL/relMalRegional.shp"),
    "avaKot": ("tirol_avaKot/avaKot.asc", "tirol_avaKot/REL/relKot.shp"),
    "avaGar": ("tirol_avaGar/avaGar.asc", "tirol_avaGar/REL/relGar.shp"),
}
#: The class as it was: no resistance that grows with the speed, more rebound.
BEFORE = """\
name,eta_max,dp_min,dp_max,mu_f,mu_0,k,d_star_m,restitution,restitution_speed_mps,rolling_threshold
debris,0.80,0.2,0.6,0.80,0.52,0.21,0.3,0.55,9.144,0.1
"""
#: Blocks moved as ellipses of their axes.
BEFORE_LINES = """classes = "before.csv"

[engine]
outline_edges = 0.0
outline_share = 1.0"""
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
{classes}

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


def config_of(
    data: Path, name: str, spacing: float, ground: str = "talus", classes: str = ""
) -> str:
    """Configuration of one terrain; ``classes``: lines that name a table of classes."""
    dem, release = ((data / part).resolve() for part in SITES[name])
    return CONFIG.format(dem=dem, release=release, spacing=spacing, ground=ground, classes=classes)


def run_site(data: Path, out: Path, name: str, spacing: float) -> dict[str, Path]:
    """Zone one terrain both ways; the folders of the results."""
    (out / "before.csv").write_text(BEFORE)
    folders = {}
    for label, classes in (("before", BEFORE_LINES), ("after", "")):
        config = out / f"{name}_{label}.toml"
        config.write_text(config_of(data, name, spacing, "debris", classes))
        folders[label] = out / f"{name}_{label}"
        zone(config, folders[label])
    return folders


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


def draw(dem: Path, folders: dict[str, Path], png: Path) -> None:
    """95 % speed and energy, and hazard level; before above after."""
    speed = {k: read(f / "maps" / "speed.tif") for k, f in folders.items()}
    seen = np.any([np.isfinite(v) for v in speed.values()], axis=0)
    rows, cols = np.nonzero(seen)
    top, left = max(rows.min() - 10, 0), max(cols.min() - 10, 0)
    box = (slice(top, rows.max() + 10), slice(left, cols.max() + 10))
    with rasterio.open(dem) as raster:
        heights = raster.read(1, masked=True).astype(float).filled(np.nan)
        cell = raster.transform.a
    relief = hillshade(Grid(heights, 0.0, 0.0, cell))
    figure, axes = plt.subplots(2, 3, figsize=(14, 9), layout="constrained")
    levels = ListedColormap(["#ffe97f", "#fde047", "#60a5fa", "#dc2626"])
    for row, (label, folder) in zip(axes, folders.items(), strict=True):
        energy, level = (read(folder / "maps" / f"{n}.tif") for n in ("energy", "hazard_level"))
        for ax, values, words, style in (
            (row[0], speed[label], "speed, 95 % (m/s)", {"vmin": 0, "vmax": 50, "cmap": "viridis"}),
            (row[1], energy, "energy, 95 % (kJ)", {"norm": LogNorm(3, 3000), "cmap": "plasma_r"}),
            (row[2], level, "hazard level", {"cmap": levels, "vmin": 1, "vmax": 4}),
        ):
            ax.imshow(relief[box], cmap="gray", vmin=0, vmax=1)
            drawn = ax.imshow(values[box], alpha=0.8, interpolation="nearest", **style)
            ax.set_axis_off()
            ax.set_title(f"{label}: {words}")
            figure.colorbar(drawn, ax=ax, shrink=0.7)
    figure.text(
        0.01, 0.002, "Datenquelle: Land Tirol - data.tirol.gv.at. Not a hazard map.", fontsize=7
    )
    figure.savefig(png, dpi=80)
    plt.close(figure)


def main() -> None:
    """Draw all sites."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--spacing", type=float, default=20.0, help="of the release points (m)")
    parser.add_argument("--sites", nargs="*", default=list(SITES))
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    found = {}
    for name in given.sites:
        folders = run_site(given.data, given.output, name, given.spacing)
        draw(given.data / SITES[name][0], folders, given.output / f"{name}.png")
        found[name] = {label: numbers(folder) for label, folder in folders.items()}
    (given.output / "results.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
