"""Time com4FlowPy of AvaFrame: ``python benchmarks/flowpy.py FOLDER [--environments FOLDER]``.

FOLDER is one that ``slope.py`` wrote. com4FlowPy (C. J. L. D'Amboise et al., 2022, *Flow-Py v1.0*,
Geoscientific Model Development 15, 2423-2439) routes a flux downslope from each release cell and
stops it by an angle; it knows no rocks. It runs in an environment of its own, made by pip and kept.
The whole model is timed with some of the release cells, evenly chosen, and with one of them: the
difference leaves out the start, the reading and the writing.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import rasterio
import saga
from peers import peer_run, python_of
from rasterio.features import geometry_mask

REQUIREMENT = "avaframe==2.1"
CELLS = 60


def write_releases(folder: Path, some_cells: Path, one_cell: Path, count: int) -> None:
    """Write rasters with so many of the release cells, and with the one in their middle."""
    with rasterio.open(folder / "dem.tif") as raster:
        profile, shape, transform = raster.profile, raster.shape, raster.transform
    areas = gpd.read_file(folder / "release.gpkg").geometry
    inside = geometry_mask(areas, shape, transform, invert=True)
    cells = np.flatnonzero(inside)
    chosen = cells[np.linspace(0, cells.size - 1, count).round().astype(np.int64)]
    profile |= {"dtype": "float32", "nodata": -9999.0}
    for file, own in ((some_cells, chosen), (one_cell, cells[cells.size // 2])):
        mask = np.zeros(shape, np.float32)
        mask.flat[own] = 1.0
        with rasterio.open(file, "w", **profile) as raster:
            raster.write(mask, 1)


def run_once(python: Path, dem: Path, release: Path) -> dict[str, Any]:
    """One run of the model with the release cells of a raster."""
    # Stopped by the angle at which SAGA's walks are.
    angle = saga.OPTIONS["FRICTION_ANGLE"]
    with tempfile.TemporaryDirectory() as scratch:
        given = (dem, release, Path(scratch) / "run", angle)
        failed = "com4FlowPy failed: "
        return peer_run(python, "flowpy_map.py", *given, folder=scratch, failed=failed)


def measure(
    folder: Path, environments: Path, repeats: int = 3, count: int = CELLS
) -> dict[str, Any]:
    """Release cells per second on one core, of the dem.tif and release.gpkg of a folder.

    The environment is made and kept in ``environments``. Both runs are timed ``repeats`` times; the
    median counts. The long run has ``count`` release cells, 2 or more.

    Returns
    -------
    dict
        version, release_cells, seconds (of each repeat: the long run), cells_per_s (of wall clock,
        without what a run with one cell takes), reached_cells, farthest_m.

    Raises
    ------
    RuntimeError, subprocess.CalledProcessError
        If it cannot be installed or ends with an error.
    """
    python = python_of(REQUIREMENT, environments / "avaframe")
    with tempfile.TemporaryDirectory() as name:
        some, one = (Path(name) / f"{which}.tif" for which in ("some", "one"))
        write_releases(folder, some, one, count)
        runs = [
            [run_once(python, folder / "dem.tif", release) for release in (some, one)]
            for _ in range(repeats)
        ]
    rates = [(count - 1) / (most["seconds"] - least["seconds"]) for most, least in runs]
    return {
        "version": REQUIREMENT.partition("==")[2],
        "release_cells": count,
        "seconds": [most["seconds"] for most, _ in runs],
        "cells_per_s": statistics.median(rates),
        "reached_cells": runs[0][0]["reached_cells"],
        "farthest_m": runs[0][0]["farthest_m"],
    }


def main() -> int:
    """Parse the arguments, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--environments", type=Path, default=Path("peer_environments"))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--cells", type=int, default=CELLS)
    given = parser.parse_args()
    if not (given.folder / "dem.tif").is_file():
        print(f"{given.folder}: no dem.tif; run benchmarks/slope.py first", file=sys.stderr)
        return 2
    result = measure(given.folder, given.environments.resolve(), given.repeats, given.cells)
    print(json.dumps(result, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
