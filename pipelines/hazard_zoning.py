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

import numpy as np
import pandas as pd

from sassgis.errors import SassgisError
from sassgis.inputs.config import load_config
from sassgis.outputs.frames import write_table
from sassgis.runs.run import run


def arrivals(tables: Path, areas: list[str], control_lines: list[str]) -> pd.DataFrame:
    """Blocks of each release area that arrive at each station and barrier, and how."""
    released = pd.read_csv(tables / "rocks.csv")["area"].value_counts()
    passages = pd.read_csv(tables / "passages.csv")
    passages["energy_kj"] = passages["energy_trans_kj"] + passages["energy_rot_kj"]
    groups = passages.groupby(["area", "control_line"])
    columns = {"arrive": groups.size()}
    for quantity in ("energy_kj", "speed_mps", "height_m"):
        columns[f"{quantity}_q95"] = groups[quantity].quantile(0.95)
        columns[f"{quantity}_max"] = groups[quantity].max()
    pairs = pd.MultiIndex.from_product([areas, control_lines], names=["area", "control_line"])
    table = pd.DataFrame(columns).reindex(pairs).reset_index()
    table["arrive"] = table["arrive"].fillna(0).astype(int)
    table.insert(2, "rocks", table["area"].map(released).fillna(0).astype(int))
    table.insert(4, "share", table["arrive"] / table["rocks"])
    return table


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
    areas = arrivals(
        given.output / "tables",
        [area.name for area in job.areas],
        [control_line.name for control_line, _ in job.control_lines],
    )
    energy = result.maps.energy_q95.values
    limits = [-np.inf, *config.output.energy_classes_kj, np.inf]
    classes = pd.DataFrame({"from_kj": limits[:-1], "to_kj": limits[1:]})
    classes["cells"] = np.histogram(energy[np.isfinite(energy)], limits)[0]
    classes["area_m2"] = classes["cells"] * job.grid.cell_size**2
    classes["share"] = classes["cells"] / max(classes["cells"].sum(), 1)
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
