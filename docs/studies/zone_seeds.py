"""Do hazard levels stay where they are with another sample of blocks, and is what is said true?

``python docs/studies/zone_seeds.py samples DATA -o FOLDER`` simulates the sample valley, and two
terrain models of Land Tirol in DATA, with twenty seeds each, and keeps the hazard curves; and the
valley and one of the terrain models with ``hazard.blocks = "auto"``, with two seeds each.
``python docs/studies/zone_seeds.py compare FOLDER`` compares the seeds, also several of them joined
to one sample, and writes ``docs/studies/zone_seeds/*.csv``; ``python docs/studies/tables.py`` puts
them into the page.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from docs.studies.study_tables import write_csv
from docs.studies.tirol import config_of
from sassgis.grid import Grid, IntArray
from sassgis.hazard.assess import (
    NO_RIMS,
    curves_of,
    level_zones,
    raster,
    rims_of,
    zone_of_cells,
)
from sassgis.hazard.curves import at_energies
from sassgis.hazard.levels import hazard_level
from sassgis.hazard.sampling_error import level_chances
from sassgis.hazard.significance import SampledRates, beyond_sampling
from sassgis.hazard.sources import sampled_sources
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.inputs.config import load_config
from sassgis.inputs.presets import read_preset
from sassgis.runs.inputs import read_rules
from sassgis.runs.resumable_run import Workplace, read_job
from sassgis.runs.run import prepared, zone_simulation
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset, ZoningSettings
from sassgis.settings.map_run import Config
from sassgis.settings.statistics_table import bins_of

#: As in the configurations.
REF_WIDTH_M = 10.0
VALLEY = Path(__file__).parents[2] / "sample_dem" / "valley" / "config.toml"
SEEDS = 20
#: Settings of the twenty seeds, and with as many blocks as the map needs.
GIVEN = {"hazard.blocks": "given", "hazard.changed_share_max": None, "release.rocks_per_point": 50}
NEEDED = {"hazard.blocks": "auto", "hazard.changed_share_max": 0.02, "release.rocks_per_point": 20}
#: Sites with as many blocks as their maps need, and how many seeds of each.
AUTO, AUTO_SEEDS = ("valley", "avaKot"), 2

Row = dict[str, str | float]


def configs(data: Path, out: Path) -> dict[str, Path]:
    """Configuration of each site; those on real terrain are written to ``out``."""
    found = {"valley": VALLEY}
    for name in ("avaMal", "avaKot"):
        found[name] = out / f"{name}.toml"
        found[name].write_text(config_of(data, name, spacing=20.0), encoding="utf-8")
    return found


def sample(config: Config, file: Path) -> None:
    """Hazard curves, at the thresholds of the preset, of one seed."""
    config = replace(config, hazard=replace(config.hazard, compare_barriers=False))
    began = time.process_time()
    job = read_job(config, None, lambda _text: None)
    rules = read_rules(config, job.run)
    with TemporaryDirectory() as work:
        place = Workplace(Path(work), 1, None, lambda _text: None)
        done = zone_simulation(prepared(job, rules), rules, place, sums_only=True)
    sampled = sampled_sources(done.run, done.progress, rules.frequencies)
    few = at_energies(curves_of(sampled, bins_of(done.run).threshold), rules.preset.thresholds_kj)
    np.savez(
        file, places=few.places, rate=few.rate, variance=few.variance,
        of_a_rock=few.rate_of_a_rock, heights=done.run.grid.values, cell=done.run.grid.cell_size,
        blocks=done.progress.simulated, seconds=time.process_time() - began,
        rims=rims_of(sampled, done.run.grid),
    )  # fmt: skip


def samples(data: Path, out: Path) -> None:
    """Curves of all sites and seeds; those that are there are not made again."""
    for name, path in configs(data, out).items():
        own = GIVEN | ({} if name == "valley" else {"release.rocks_per_point": 20})
        wanted = [(f"{name}_{k}", own, k) for k in range(1, SEEDS + 1)]
        if name in AUTO:
            wanted += [(f"{name}_auto_{k}", NEEDED, k) for k in range(1, AUTO_SEEDS + 1)]
        for stem, settings, seed in wanted:
            file = out / f"{stem}.npz"
            if not file.exists():
                sample(load_config(path, {**settings, "run.seed": seed}), file)
                print(file, flush=True)


# ---------------------------------------------------------------------------------------------
# What changes


def read_sample(file: Path) -> tuple[HazardCurves, Grid]:
    """Curves of a seed, and the grid of its cells."""
    kept = np.load(file)
    energies = np.array(read_preset("ch-so").thresholds_kj)
    grid = Grid(kept["heights"], 0.0, 0.0, float(kept["cell"]))
    curves = HazardCurves(
        kept["places"], energies, kept["rate"], kept["variance"], kept["of_a_rock"]
    )
    return curves, grid


def joined(samples: Sequence[HazardCurves]) -> HazardCurves:
    """Several seeds as one sample of as many times the blocks."""
    places = np.unique(np.concatenate([s.places for s in samples]))
    rate = np.zeros((places.size, samples[0].rate.shape[1]))
    variance, of_a_rock = np.zeros_like(rate), np.zeros(places.size)
    for one in samples:
        rows = np.searchsorted(places, one.places)
        rate[rows] += one.rate / len(samples)
        variance[rows] += one.variance / len(samples) ** 2
        of_a_rock[rows] = np.maximum(of_a_rock[rows], one.rate_of_a_rock / len(samples))
    return HazardCurves(places, samples[0].energies_kj, rate, variance, of_a_rock)


def zones_at(
    curves: HazardCurves,
    grid: Grid,
    preset: HazardPreset,
    scale: float = 5_000.0,
    rims: IntArray = NO_RIMS,
) -> Coverage:
    """Zones of hazard level as they are drawn at a scale."""
    drawing = ZoningSettings(scale).drawing(preset.sheet, REF_WIDTH_M, 0.0, grid.cell_size)
    levels = [hazard_level(curves, preset)]
    (zones,) = level_zones([curves], levels, preset, grid, drawing, rims)
    return zones


def drawn_levels(curves: HazardCurves, grid: Grid, preset: HazardPreset) -> np.ndarray:
    """Level of the drawn zone of each cell, flat."""
    zones = zones_at(curves, grid, preset)
    cells = np.arange(grid.values.size)
    zone = zone_of_cells(zones, grid, cells)
    return np.where(zone >= 0, np.append(zones.classes, 0)[zone], 0)


def found_by_compare(one: HazardCurves, other: HazardCurves) -> bool:
    """Whether any frequency of the two is found to differ, as ``compare`` does."""
    places = np.union1d(one.places, other.places)
    rates, variances, of_a_block = np.zeros((3, 2, places.size))
    for k, own in enumerate((one, other)):
        rows = np.searchsorted(places, own.places)
        rates[k, rows], variances[k, rows] = own.rate[:, 0], own.variance[:, 0]
        of_a_block[k, rows] = own.rate_of_a_rock
    of_a_block = np.where(of_a_block > 0.0, of_a_block, of_a_block[::-1])
    samples = map(SampledRates, rates, variances, of_a_block)
    return bool(beyond_sampling(*samples).any())


def row_of(samples: Sequence[HazardCurves], grid: Grid, preset: HazardPreset) -> dict[str, float]:
    """What is stated of each sample, and what the next one changes; means over the samples."""
    n = grid.values.size
    stated, cells, caught, flagged, zones, areas, found = [], [], [], [], [], [], []
    levels = [raster(grid, s.places, hazard_level(s, preset)).ravel() for s in samples]
    drawn = [drawn_levels(s, grid, preset) for s in samples]
    for k, own in enumerate(samples):
        other = (k + 1) % len(samples)
        unsure = np.zeros(n, bool)
        level = hazard_level(own, preset)
        chances = level_chances(own, level, preset, np.isfinite(grid.values))
        unsure[chances.places] = chances.uncertain(0.95)
        changed = levels[k] != levels[other]
        zoned = (levels[k] > 0).sum()
        stated.append(chances.changed_share)
        cells.append(changed.sum() / zoned)
        caught.append((changed & unsure).sum() / max(changed.sum(), 1))
        flagged.append(unsure.sum() / zoned)
        zones.append((drawn[k] != drawn[other]).sum() / (drawn[k] > 0).sum())
        found.append(found_by_compare(own, samples[other]))
        areas.append((drawn[k] > 0).sum() * grid.cell_size**2)
    means = {
        "stated": stated, "cells": cells, "caught": caught, "flagged": flagged, "zones": zones,
        "area_m2": areas,
    }  # fmt: skip
    one_block = max(float(s.rate_of_a_rock.max()) for s in samples)
    return {k: float(np.mean(v)) for k, v in means.items()} | {
        "one_block_years": 1 / one_block, "found": sum(found), "pairs": len(samples),
    }  # fmt: skip


def compared(folder: Path) -> list[Row]:
    """Rows of all sites and numbers of blocks."""
    preset = read_preset("ch-so")
    rows = []
    for site in ("valley", "avaMal", "avaKot"):
        read = [read_sample(folder / f"{site}_{k}.npz") for k in range(1, SEEDS + 1)]
        grid = read[0][1]
        for times in (1, 2, 4, 8):
            parts = [
                joined([c for c, _ in read[k : k + times]])
                for k in range(0, SEEDS - times + 1, times)
            ]
            rows.append({"site": site, "times": times, **row_of(parts, grid, preset)})
            print(rows[-1], flush=True)
    return rows


def compared_auto(folder: Path) -> list[Row]:
    """Rows of the sites with as many blocks as their maps need."""
    preset = read_preset("ch-so")
    rows = []
    for site in AUTO:
        files = [folder / f"{site}_auto_{k}.npz" for k in range(1, AUTO_SEEDS + 1)]
        read = [read_sample(file) for file in files]
        own = row_of([c for c, _ in read], read[0][1], preset)
        blocks, seconds = (
            np.mean([float(np.load(file)[key]) for file in files]) for key in ("blocks", "seconds")
        )
        kept = {key: own[key] for key in list(own)[:6]}
        counts = {"blocks": float(blocks), "minutes": float(seconds) / 60}
        rows.append({"site": site, **counts, **kept})
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    command = parser.add_subparsers(dest="command", required=True)
    made = command.add_parser("samples")
    made.add_argument("data", type=Path)
    made.add_argument("-o", "--output", type=Path, required=True)
    command.add_parser("compare").add_argument("folder", type=Path)
    given = parser.parse_args()
    if given.command == "compare":
        out = Path(__file__).with_suffix("")
        out.mkdir(exist_ok=True)
        write_csv(out / "seeds.csv", compared(given.folder))
        write_csv(out / "auto.csv", compared_auto(given.folder))
    else:
        given.output.mkdir(parents=True, exist_ok=True)
        samples(given.data, given.output)


if __name__ == "__main__":
    main()
