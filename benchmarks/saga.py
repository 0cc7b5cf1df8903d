"""Time SAGA's Gravitational Process Path Model: ``python benchmarks/saga.py FOLDER [--repeats N]``.

FOLDER is one that ``slope.py`` wrote. The tool (V. Wichmann, 2017, *The Gravitational Process Path
(GPP) model (v1.0)*, Geoscientific Model Development 10, 3309-3327) walks a point from cell to cell
at random; one walk is its counterpart of one rock. What is timed is the whole process, once with
many walks and once with one walk per release cell: the difference leaves out the start of the
program, the reading and the writing.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.features import geometry_mask

PROGRAM = "saga_cmd"
ABSENT = f"{PROGRAM} is not on the PATH; on Debian and Ubuntu: apt-get install saga"
ITERATIONS = 50
FEWEST = 1

# Random walk at its own defaults. The geometric gradient stops a walk where the straight line to
# its start is flatter than the angle. This angle lets walks cross the talus and end on the foot,
# half of them within some 450 m of the cliff's edge; of the rocks of SASS half end within about 400
# (rough) to 430 m (plain), so neither side gains much by shorter paths. A flatter angle makes walks
# longer and slower.
OPTIONS = {
    "PROCESS_PATH_MODEL": 1,
    "RW_SLOPE_THRES": 40.0,
    "RW_EXPONENT": 2.0,
    "RW_PERSISTENCE": 1.5,
    "GPP_SEED": 1,
    "FRICTION_MODEL": 1,
    "FRICTION_ANGLE": 37.0,
    "DEPOSITION_MODEL": 0,
}


def version() -> str | None:
    """Version of SAGA as it states it, None if it is absent."""
    if shutil.which(PROGRAM) is None:
        return None
    stated = subprocess.run([PROGRAM, "--version"], capture_output=True, text=True, check=False)
    found = re.search(r"SAGA Version:\s*(\S+)", stated.stdout)
    return found.group(1) if found else "unknown"


def prepare(folder: Path, work: Path) -> int:
    """Write the DEM and the release cells as SAGA's own grids; returns the number of cells."""
    with rasterio.open(folder / "dem.tif") as raster:
        z = raster.read(1)
        kept = {name: raster.profile[name] for name in ("width", "height", "transform", "crs")}
    profile = {"driver": "SAGA", "count": 1, "nodata": -9999.0, "dtype": "float32", **kept}
    areas = gpd.read_file(folder / "release.gpkg").geometry
    inside = geometry_mask(areas, z.shape, profile["transform"], invert=True)
    release = np.where(inside, 1.0, -9999.0).astype(np.float32)
    for name, values in (("dem", z), ("release", release)):
        with rasterio.open(work / f"{name}.sdat", "w", **profile) as grid:
            grid.write(values, 1)
    return int(inside.sum())


def command(work: Path, iterations: int) -> list[str]:
    """The command line: one core, no progress report."""
    return [
        PROGRAM,
        "-c=1",
        "-f=q",
        "sim_geomorphology",
        "0",
        f"-DEM={work / 'dem.sgrd'}",
        f"-RELEASE_AREAS={work / 'release.sgrd'}",
        f"-PROCESS_AREA={work / 'process_area.sgrd'}",
        f"-STOP_POSITIONS={work / 'stops.sgrd'}",
        f"-GPP_ITERATIONS={iterations}",
        *(f"-{name}={value}" for name, value in OPTIONS.items()),
    ]


def run_once(work: Path, iterations: int) -> tuple[float, float]:
    """Wall time and processor time of one run of the whole process (s)."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    before = os.times()
    start = time.perf_counter()
    done = subprocess.run(
        command(work, iterations), env=environment, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - start
    after = os.times()
    busy = sum(after[2:4]) - sum(before[2:4])
    if done.returncode != 0:
        said = (done.stderr.strip() or done.stdout.strip()).splitlines()
        raise RuntimeError(f"{PROGRAM} failed: {said[-1] if said else 'no message'}")
    return seconds, busy


def stop_chainages(work: Path) -> dict[str, float]:
    """Where walks stop, from the western edge of the slope (m): count, 5, 50 and 95 %."""
    with rasterio.open(work / "stops.sdat") as grid:
        counts: NDArray[np.float64] = grid.read(1).astype(float)
        counts[~np.isfinite(counts) | (counts == grid.nodata) | (counts < 0)] = 0.0
        x = (np.arange(grid.width) + 0.5) * grid.res[0]
    share = np.cumsum(counts.sum(axis=0)) / max(counts.sum(), 1.0)
    at = {f"p{p:02d}_m": float(x[np.searchsorted(share, p / 100)]) for p in (5, 50, 95)}
    return {"stops": float(counts.sum()), **at}


def measure(folder: Path, repeats: int = 3, iterations: int = ITERATIONS) -> dict[str, Any]:
    """Walks per second of wall time on one core, of the dem.tif and release.gpkg of a folder.

    Both runs are timed ``repeats`` times; the median difference counts. The long run has so many
    ``iterations``: walks per release cell.

    Returns
    -------
    dict
        ``available``; if False only ``message`` besides. Otherwise version, command, release_cells,
        walks (in the long run), seconds and seconds_overhead (of each repeat: the long run, the
        run with one walk per cell), walks_per_s (median), walks_per_s_range, walks_per_cpu_s (per
        second of processor time, median: what a busy machine disturbs least), stop_chainage.

    Raises
    ------
    RuntimeError
        If SAGA ends with an error.
    """
    stated = version()
    if stated is None:
        return {"available": False, "message": ABSENT}
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        cells = prepare(folder, work)
        run_once(work, FEWEST)  # the first run also reads the program itself from the disk
        short, long = [], []
        for _ in range(repeats):
            short.append(run_once(work, FEWEST))
            long.append(run_once(work, iterations))
        stops = stop_chainages(work)
        line = " ".join(command(Path("WORK"), iterations))
    walks = (iterations - FEWEST) * cells
    rates = [walks / (b[0] - a[0]) for a, b in zip(short, long, strict=True)]
    busy_rates = [walks / (b[1] - a[1]) for a, b in zip(short, long, strict=True)]
    return {
        "available": True,
        "version": stated,
        "command": line,
        "release_cells": cells,
        "walks": iterations * cells,
        "seconds": [wall for wall, _ in long],
        "seconds_overhead": [wall for wall, _ in short],
        "walks_per_s": statistics.median(rates),
        "walks_per_s_range": [min(rates), max(rates)],
        "walks_per_cpu_s": statistics.median(busy_rates),
        "stop_chainage": stops,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--iterations", type=int, default=ITERATIONS)
    arguments = parser.parse_args()
    if not (arguments.folder / "dem.tif").is_file():
        print(f"{arguments.folder}: no dem.tif; run benchmarks/slope.py first", file=sys.stderr)
        return 2
    result = measure(arguments.folder, arguments.repeats, arguments.iterations)
    if not result["available"]:
        print(result["message"], file=sys.stderr)
        return 1
    print(json.dumps(result, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
