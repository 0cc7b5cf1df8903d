"""How many blocks of each release area arrive where, and how much of the slope is in which class?

    python pipelines/hazard_zoning.py CONFIG -o OUT

Runs the configuration like ``sassgis run``, with the tables of blocks and passages, and adds two
tables to the result (after its manifest, which does not list them): ``OUT/tables/areas.csv`` has a
row per release area and station or barrier, with the arriving blocks, their energy, speed and
passing height; ``OUT/tables/energy_classes.csv`` has the share of the reached cells by class of the
95 % quantile of the energy.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

from sassgis.io.read.config import load_config
from sassgis.io.write.frames import area_control_line_table, class_table, write_table
from sassgis.model.errors import SassgisError
from sassgis.runs.run import run


def main(argv: list[str] | None = None) -> None:
    """Run a configuration and write both tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("config", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--overwrite", action="store_true")
    given = parser.parse_args(argv)
    config = load_config(given.config, {"output.rock_table": "csv", "output.passage_table": "csv"})
    result = run(config, given.output, jobs=given.jobs, overwrite=given.overwrite, say=print)

    job = result.run
    areas = area_control_line_table(
        pd.read_csv(given.output / "tables" / "rocks.csv", usecols=["area"]),
        pd.read_csv(given.output / "tables" / "passages.csv"),
        [area.name for area in job.areas],
        [control_line.name for control_line, _ in job.control_lines],
    )
    classes = class_table(
        result.maps.energy_q95.values, config.output.energy_classes_kj, "kJ", job.grid.cell_size
    )
    write_table(given.output / "tables" / "areas.csv", [areas])
    write_table(given.output / "tables" / "energy_classes.csv", [classes])
    print(areas.to_string(index=False))
    print(classes.to_string(index=False))
    for warning in result.warnings:
        print(f"Note: {warning}")


if __name__ == "__main__":
    try:
        main()
    except SassgisError as error:
        raise SystemExit(f"Error: {error}") from None
