"""What drawing makes of cells: number, size and certainty of zones, and pictures of them.

``python docs/studies/zone_drawing.py DATA -o FOLDER`` simulates the sample valley with its release
areas and with those that ``sassgis cliffs`` proposes, and three terrain models of Land Tirol in
DATA; writes the table into ``docs/studies/zone_drawing.md`` and the picture beside it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import shapely

from docs.studies.study_tables import replaced
from docs.studies.tirol import config_of
from docs.studies.zone_seeds import GIVEN, VALLEY, read_sample, sample, zones_at
from sassgis.grid import BoolArray, Grid
from sassgis.hazard.assess import raster, zone_of_cells
from sassgis.hazard.levels import hazard_level
from sassgis.hazard.sampling_error import level_chances
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.hazard.zoning.drawing import drawn_zones
from sassgis.inputs.config import load_config
from sassgis.inputs.presets import read_preset
from sassgis.report.figures.map_marks import draw_zones
from sassgis.report.figures.relief import hillshade
from sassgis.runs.propose_release import propose_release
from sassgis.settings.hazard_rules import Drawing
from sassgis.settings.results import RasterClass

PRESET = read_preset("ch-so")
LEVELS = [RasterClass(k, c.label, c.colour, c.hatched) for k, c in enumerate(PRESET.levels, 1)]
SCALES = (5_000, 10_000)
#: From this share of uncertain cells on a zone says little.
UNSURE = 0.3
SITES = ("valley", "cliffs", "avaMal", "avaKot", "avaGar")


def samples(data: Path, out: Path) -> None:
    """Hazard curves of each site; those that are there are not made again."""
    for name in SITES:
        file = out / f"{name}_1.npz"
        if file.exists():
            continue
        if name in ("valley", "cliffs"):
            config = VALLEY
        else:
            config = out / f"{name}.toml"
            config.write_text(config_of(data, name, spacing=20.0), encoding="utf-8")
        each = 50 if name in ("valley", "cliffs") else 20
        values: dict[str, object] = {**GIVEN, "run.seed": 1, "release.rocks_per_point": each}
        if name == "cliffs":
            release = out / "cliffs.gpkg"
            propose_release(VALLEY.parent / "dem.tif", release)
            values |= {"release.file": str(release), "release.scenario_field": None}
        sample(load_config(config, values), file)
        print(file, flush=True)


def facts(zones: Coverage, grid: Grid, cells: np.ndarray, unsure: BoolArray) -> str:
    """Number of zones, how many are unsure, and red on residual, as three columns."""
    zone = zone_of_cells(zones, grid, cells)
    n = zones.polygons.size
    inside = np.bincount(zone[zone >= 0], minlength=n)
    share = np.bincount(zone[zone >= 0], unsure[zone >= 0], n) / np.maximum(inside, 1)
    beside = 100.0 * red_on_residual(zones)
    return f"{n} | {(share > UNSURE).sum()} | {beside:.0f} %"


def red_on_residual(zones: Coverage) -> float:
    """Share of the outline of the highest level that borders on the lowest."""
    red, residual = (shapely.union_all(zones.polygons[zones.classes == k]) for k in (4, 1))
    outline = shapely.boundary(red)
    return float(outline.intersection(residual.buffer(0.01)).length / outline.length)


def picture(shown: list[tuple[str, Grid, list[Coverage]]], file: Path) -> None:
    """Cells and zones at two scales, a row for each site."""
    figure, axes = plt.subplots(len(shown), 3, figsize=(12, 4.6 * len(shown)), squeeze=False)
    for row, (name, grid, stages) in zip(axes, shown, strict=True):
        west, south, east, north = shapely.total_bounds(stages[-1].polygons)
        titles = ("cells", *(f"zones at 1:{scale:,}" for scale in SCALES))
        for ax, zones, title in zip(row, stages, titles, strict=True):
            left, bottom, right, top = grid.bounds
            ax.imshow(hillshade(grid), cmap="gray", extent=(left, right, bottom, top))
            classes = [LEVELS[k - 1] for k in zones.classes]
            draw_zones(ax, list(zip(zones.polygons, classes, strict=True)))
            ax.set(xlim=(west - 30, east + 30), ylim=(south - 30, north + 30), xticks=[], yticks=[])
            ax.set_title(f"{name}: {title}", fontsize=10)
    figure.tight_layout()
    source = "avaMal, avaKot, avaGar: Land Tirol - data.tirol.gv.at. Not a hazard map."
    figure.text(0.01, 0.002, source, fontsize=6)
    figure.savefig(file, dpi=70, pil_kwargs={"optimize": True})
    plt.close(figure)


def main() -> None:
    """Simulate, draw and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    samples(given.data, given.output)
    columns = " | ".join(
        f"{what}: number | unsure | red on residual"
        for what in ("cells", *map("1:{:,}".format, SCALES))
    )
    rows = [f"| site | {columns} |", "|---" * 10 + "|"]
    shown = []
    for name in SITES:
        curves, grid = read_sample(given.output / f"{name}_1.npz")
        rims = np.load(given.output / f"{name}_1.npz")["rims"]
        level = hazard_level(curves, PRESET)
        chances = level_chances(curves, level, PRESET, np.isfinite(grid.values))
        levels = raster(grid, curves.places, level)
        stages = [
            drawn_zones([levels], grid, Drawing())[0],
            *(zones_at(curves, grid, PRESET, s, rims) for s in SCALES),
        ]
        unsure = chances.uncertain(0.95)
        told = " | ".join(facts(zones, grid, chances.places, unsure) for zones in stages)
        rows.append(f"| {name} | {told} |")
        print(rows[-1], flush=True)
        shown.append((name, grid, stages))
    page = Path(__file__).with_suffix(".md")
    replaced(page, "table", "\n".join(rows))
    picture(shown, Path(__file__).with_suffix(".png"))


if __name__ == "__main__":
    main()
