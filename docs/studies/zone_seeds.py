"""Do hazard levels stay where they are with another sample of blocks, and is what is said true?

``python docs/studies/zone_seeds.py samples DATA -o FOLDER`` simulates the sample valley, and two
terrain models of Land Tirol in DATA, with twenty seeds each, and keeps the hazard curves.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from docs.studies.tirol import CONFIG, SITES
from sassgis.hazard.assess import curves_of
from sassgis.hazard.bins import bins_of
from sassgis.hazard.curves import at_energies
from sassgis.hazard.sources import sampled_sources
from sassgis.io.read.config import load_config
from sassgis.model.run_config import Config
from sassgis.runs.inputs import read_rules
from sassgis.runs.job import read_job
from sassgis.runs.zone import prepared, simulations

VALLEY = Path(__file__).parents[2] / "sample_dem" / "valley" / "config.toml"
SEEDS = 20


def configs(data: Path, out: Path) -> dict[str, Path]:
    """Configuration of each site; those on real terrain are written to ``out``."""
    found = {"valley": VALLEY}
    for name in ("avaMal", "avaKot"):
        dem, release = (data / part for part in SITES[name])
        found[name] = out / f"{name}.toml"
        found[name].write_text(
            CONFIG.format(
                dem=dem.resolve(), release=release.resolve(), path="followed", tolerance=0.05,
                spacing=20.0, engine="",
            ),
            encoding="utf-8",
        )  # fmt: skip
    return found


def sample(config: Config, file: Path) -> None:
    """Hazard curves, at the thresholds of the preset, of one seed."""
    config = replace(config, hazard=replace(config.hazard, compare_barriers=False))
    job = read_job(config, None, lambda _text: None)
    rules = read_rules(config, job.run)
    with TemporaryDirectory() as work:
        done, _ = simulations(
            config, Path(work), prepared(job, rules), rules, 1, None, lambda _text: None,
            check=False,
        )  # fmt: skip
    sampled = sampled_sources(done.run, done.progress, rules.frequencies)
    few = at_energies(
        curves_of(sampled, bins_of(done.run).threshold), rules.preset.thresholds_kj
    )
    np.savez(
        file, places=few.places, rate=few.rate, variance=few.variance,
        of_a_rock=few.rate_of_a_rock, shape=done.run.grid.shape, cell=done.run.grid.cell_size,
    )  # fmt: skip


def samples(data: Path, out: Path) -> None:
    """Curves of all sites and seeds; those that are there are not made again."""
    for name, path in configs(data, out).items():
        for seed in range(1, SEEDS + 1):
            file = out / f"{name}_{seed}.npz"
            if not file.exists():
                sample(load_config(path, {"run.seed": seed}), file)
                print(file, flush=True)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    command = parser.add_subparsers(dest="command", required=True)
    made = command.add_parser("samples")
    made.add_argument("data", type=Path)
    made.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    samples(given.data, given.output)


if __name__ == "__main__":
    main()
