"""Maps of real terrain before and after: fall lines and the readings of 1986, and the defaults.

``python docs/studies/tirol.py DATA -o FOLDER`` runs both on the terrain models of Land Tirol in
DATA (folders ``tirol_*``) and draws them beside each other, one picture for each terrain.

The release polygons are those of snow avalanches, not mapped sources of rockfall: what the
pictures show is the form of the maps, no hazard of these places.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import rasterio
from matplotlib.colors import ListedColormap, LogNorm

from sassgis.model.grid import Grid
from sassgis.report.figures.relief import hillshade
from sassgis.runs.zone import zone

SITES = {
    "avaMal": ("tirol_avaMalRegional/avaMal.tif", "tirol_avaMalRegional/REL/relMalRegional.shp"),
    "avaKot": ("tirol_avaKot/avaKot.asc", "tirol_avaKot/REL/relKot.shp"),
    "avaGar": ("tirol_avaGar/avaGar.asc", "tirol_avaGar/REL/relGar.shp"),
}
BEFORE = '[engine]\nreadings = "1986"\n'
CONFIG = """\
[terrain]
dem = "{dem}"
crs = "EPSG:31287"
vertical_datum = "unstated"
path = "{path}"
segment_tolerance_m = {tolerance}

[release]
file = "{release}"
spacing_m = {spacing}
rocks_per_point = 20

[ground]
default = "talus"

[[blocks]]
name = "block"
axis_1_m = [0.5, 0.8]
axis_2_m = [0.4, 0.7]
axis_3_m = [0.3, 0.6]
onset_frequency = 0.5

[hazard]
ref_width_m = 10.0
by_source = false

{engine}
[run]
seed = 1
"""


def config_of(
    data: Path, name: str, spacing: float, path: str = "followed", tolerance: float = 0.05,
    engine: str = "",
) -> str:  # fmt: skip
    """Configuration of one terrain."""
    dem, release = (data / part for part in SITES[name])
    return CONFIG.format(
        dem=dem.resolve(), release=release.resolve(), path=path, tolerance=tolerance,
        spacing=spacing, engine=engine,
    )  # fmt: skip


def run_site(data: Path, out: Path, name: str, spacing: float) -> dict[str, Path]:
    """Zone one terrain both ways; the folders of the results."""
    folders = {}
    for label, path, tolerance, engine in (
        ("before", "fall_line", 0.25, BEFORE),
        ("after", "followed", 0.05, ""),
    ):
        config = out / f"{name}_{label}.toml"
        config.write_text(config_of(data, name, spacing, path, tolerance, engine))
        folders[label] = out / f"{name}_{label}"
        zone(config, folders[label])
    return folders


def read(path: Path) -> np.ndarray:
    """First band of a map, NaN where there is nothing."""
    with rasterio.open(path) as raster:
        values = raster.read(1, masked=True)
    return values.astype(float).filled(np.nan)


def draw(dem: Path, folders: dict[str, Path], png: Path) -> None:
    """Reach probability and hazard level, before above after."""
    reach = {k: read(f / "maps" / "reach_probability.tif") for k, f in folders.items()}
    seen = np.any([np.isfinite(r) for r in reach.values()], axis=0)
    rows, cols = np.nonzero(seen)
    top, left = max(rows.min() - 10, 0), max(cols.min() - 10, 0)
    box = (slice(top, rows.max() + 10), slice(left, cols.max() + 10))
    with rasterio.open(dem) as raster:
        heights = raster.read(1, masked=True).astype(float).filled(np.nan)
        cell = raster.transform.a
    relief = hillshade(Grid(heights, 0.0, 0.0, cell))
    figure, axes = plt.subplots(2, 2, figsize=(11, 10), layout="constrained")
    levels = ListedColormap(["#ffe97f", "#fde047", "#60a5fa", "#dc2626"])
    for row, (label, folder) in zip(axes, folders.items(), strict=True):
        level = read(folder / "maps" / "hazard_level.tif")
        for ax, values, words, style in (
            (row[0], reach[label], "reach probability",
             {"norm": LogNorm(1e-5, 0.3), "cmap": "plasma_r"}),
            (row[1], level, "hazard level", {"cmap": levels, "vmin": 1, "vmax": 4}),
        ):  # fmt: skip
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
    for name in given.sites:
        folders = run_site(given.data, given.output, name, given.spacing)
        draw(given.data / SITES[name][0], folders, given.output / f"{name}.png")


if __name__ == "__main__":
    main()
