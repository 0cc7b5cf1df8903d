"""A synthetic canton through ``sassgis batch``: ``python benchmarks/canton.py [--share 0.01]``.

The whole is 3,000 km² at 5 m (120 million cells, in tiles of 1,000 x 1,000), with 10,000 release
areas of 100 points and 10 blocks each. ``--share`` takes a part of it with as many areas per km².
The ground is synthetic and the same each time: ridges 2 km apart, each with a cliff over a talus,
and a flat valley. The batch runs in a process of its own, whose time and memory are measured; one
small batch before it compiles the kernels.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from shapely import box

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sample_dem"))
from terrain_kit import FloatArray, noise, write_dem, write_vectors

WEST, NORTH = 2_600_000.0, 1_200_000.0
#: Cells along a tile.
TILE = 1000
#: Of the whole canton.
KM2, AREAS = 3000.0, 10_000
#: From one ridge to the next (m); half of it is one side of a valley.
PERIOD = 2000.0
#: From the ridge down: plan length (m) and slope (degrees).
UNITS = ((150.0, 12.0), (60.0, 65.0), (300.0, 35.0), (190.0, 15.0), (300.0, 1.0))
#: Steps of a batch after its areas, by how the line that tells of them begins.
STEPS = {
    "Adding up the areas": "mosaic",
    "Writing the overviews of the maps": "overviews",
    "Drawing the zones": "zones",
}
#: Side of a release area with 100 points (m), and where it lies below the ridge.
AREA_DEPTH, AREA_BELOW = 50.0, 155.0

CONFIG = """\
[project]
name = "Synthetic canton"

[terrain]
dem = "tiles"
vertical_datum = "LN02"

[release]
file = "release.gpkg"
name_field = "name"
spacing_m = 5.0
placement = "grid"
rocks_per_point = {rocks}

[ground]
default = "debris"

# Semi-axes: half of the measured lengths.
[[blocks]]
name = "block"
axis_1_m = [0.30, 0.60]
axis_2_m = [0.25, 0.50]
axis_3_m = [0.20, 0.40]
density_kgm3 = [2600.0, 2750.0]
onset_frequency = 1.0
onset_unit = "per_year_ha"

[hazard]
ref_width_m = 10.0

[run]
seed = 1986
"""


@dataclass(frozen=True, slots=True)
class Canton:
    """How large a canton is made: km², size of a cell (m), areas, points and blocks of each."""

    km2: float
    cell: float
    areas: int
    points: int
    rocks: int

    @property
    def tiles(self) -> tuple[int, int]:
        """Tiles from north to south and from west to east, about six to five."""
        side = TILE * self.cell
        rows = max(1, round(math.sqrt(self.km2 * 1e6 / 1.2) / side))
        return rows, max(1, math.ceil(self.km2 * 1e6 / side**2 / rows))

    @property
    def cells(self) -> int:
        """Of all tiles."""
        rows, cols = self.tiles
        return rows * cols * TILE**2


def heights(x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights of the canton at map coordinates (m)."""
    edge = np.cumsum([0.0, *(length for length, _ in UNITS)])
    drop = np.cumsum([0.0, *(length * math.tan(math.radians(a)) for length, a in UNITS)])
    below = np.abs((x - WEST) % PERIOD - 0.5 * PERIOD)
    z: FloatArray = 600.0 + drop[-1] - np.interp(below, edge, drop)
    # Gullies and ribs, and a relief of long waves along the ridges.
    return z + 4.0 * noise(x, y, 60.0, 1) + 40.0 * noise(x, y, 3000.0, 2)


def write_tiles(canton: Canton, folder: Path) -> None:
    """Write the terrain as tiles."""
    side = TILE * canton.cell
    along = (np.arange(TILE) + 0.5) * canton.cell
    for i in range(canton.tiles[0]):
        for j in range(canton.tiles[1]):
            west, north = WEST + j * side, NORTH - i * side
            x, y = np.meshgrid(west + along, north - along)
            file = folder / f"tile_{i:02d}_{j:02d}.tif"
            write_dem(file, heights(x, y), west, north, canton.cell, "LN02")


def write_areas(canton: Canton, file: Path) -> None:
    """Write release areas below the ridges, evenly over the canton, two of each place."""
    rows, cols = canton.tiles
    side = TILE * canton.cell
    ridges = int(cols * side // PERIOD)
    each = math.ceil(canton.areas / (2 * ridges))
    pitch = (rows * side - 1000.0) / each
    width = canton.points * 5.0**2 / AREA_DEPTH
    features = []
    for k in range(canton.areas):
        ridge, rest = divmod(k, 2 * each)
        step, hand = divmod(rest, 2)
        middle = WEST + (ridge + 0.5) * PERIOD
        x = middle + AREA_BELOW if hand else middle - AREA_BELOW - AREA_DEPTH
        # Half a spacing off: no point of the lattice lies on an outline.
        x, y = x + 2.5, NORTH - 502.5 - round(step * pitch / 5.0) * 5.0
        shape = box(x, y - width, x + AREA_DEPTH, y)
        features.append({"name": f"A{k + 1:05d}", "geometry": shape})
    write_vectors(file, "release", features)


def write_canton(canton: Canton, folder: Path) -> None:
    """Write tiles, release areas and configuration."""
    write_tiles(canton, folder / "tiles")
    write_areas(canton, folder / "release.gpkg")
    (folder / "config.toml").write_text(CONFIG.format(rocks=canton.rocks), encoding="utf-8")


def run(folder: Path, jobs: int, memory_gb: float) -> dict[str, float]:
    """Run the batch in a process of its own; times (s) and memory (MB)."""
    out = folder / "out"
    command = [sys.executable, __file__, "--child", str(folder), "--jobs", str(jobs)]
    command += ["--memory", str(memory_gb)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    with subprocess.Popen(command) as child:
        used = [(0.0, 0.0)]
        while child.poll() is None:
            used.append((time.time(), _resident_mb(child.pid)))
            time.sleep(0.5)
    if child.returncode:
        sys.exit("the batch failed")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    parts = json.loads((folder / "times.json").read_text())
    parts |= {f"{name}_mb": 0.0 for name in ("areas", *STEPS.values())}
    for (name, begin), (_, end) in pairwise(parts.pop("marks")):
        parts[f"{name}_mb"] = max((mb for t, mb in used if begin <= t < end), default=0.0)
    return {
        "wall_s": time.perf_counter() - began,
        "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        **parts,
        "peak_mb": max(mb for _, mb in used),
        "results_mb": sum(f.stat().st_size for f in out.rglob("*") if f.is_file()) / 1e6,
    }


def _resident_mb(pid: int) -> float:
    """Memory of a process and those that it has started (proportional set size; Linux)."""
    total = 0.0
    for number in (pid, *_started_by(pid)):
        try:
            text = Path(f"/proc/{number}/smaps_rollup").read_text()
        except OSError:
            continue
        total += sum(float(r.split()[1]) for r in text.splitlines() if r.startswith("Pss:"))
    return total * 1024.0 / 1e6


def _started_by(pid: int) -> list[int]:
    own = []
    # Workers may be started by any thread.
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            own += [int(n) for n in file.read_text().split()]
    return own + [n for child in own for n in _started_by(child)]


def child(folder: Path, jobs: int, memory_gb: float) -> None:
    """In a process of its own: the batch, and how long its steps took."""
    from sassgis.batches.batch import batch

    marks = [("areas", time.time(), _cpu_s())]

    def say(text: str) -> None:
        step = next((name for begin, name in STEPS.items() if text.startswith(begin)), None)
        if step:
            marks.append((step, time.time(), _cpu_s()))

    batch(
        folder / "release.gpkg", folder / "out", config=folder / "config.toml", jobs=jobs,
        memory_gb=memory_gb, mosaic_only=True, say=say,
    )  # fmt: skip
    marks.append(("", time.time(), _cpu_s()))
    parts: dict[str, object] = {f"{n}_wall_s": 0.0 for n in ("areas", *STEPS.values())}
    parts |= {f"{name}_wall_s": b[0] - a[0] for (name, *a), (_, *b) in pairwise(marks)}
    cpu = {name: used for name, _, used in marks}
    parts |= {"areas_cpu_s": cpu["mosaic"] - cpu["areas"], "mosaic_cpu_s": cpu[""] - cpu["mosaic"]}
    parts["marks"] = [(name, at) for name, at, _ in marks]
    (folder / "times.json").write_text(json.dumps(parts))


def _cpu_s() -> float:
    """Processor time of this process and of those that it has started and that have ended."""
    used = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def measured(
    canton: Canton, jobs: int, memory_gb: float, kept: Path | None = None
) -> dict[str, float]:
    """Make a canton, run it, and what it took; in a folder that is kept, what it takes still."""
    with tempfile.TemporaryDirectory() if kept is None else nullcontext(kept) as scratch:
        folder = Path(scratch)
        began = time.perf_counter()
        if not (folder / "config.toml").exists():
            folder.mkdir(exist_ok=True)
            write_canton(canton, folder)
        made = time.perf_counter() - began
        found = run(folder, jobs, memory_gb)
    return {**asdict(canton), "cells": canton.cells, "jobs": jobs, "made_s": made, **found}


def growth(base: Canton, jobs: int, memory_gb: float) -> list[dict[str, float]]:
    """Twice the blocks, points, areas and untouched cells, one after the other; then one job."""
    steps = [
        base,
        replace(base, rocks=2 * base.rocks),
        replace(base, points=2 * base.points),
        replace(base, areas=2 * base.areas),
        replace(base, km2=2.0 * base.km2),
    ]
    rows = [measured(step, jobs, memory_gb) for step in steps]
    return [*rows, measured(base, 1, memory_gb)]


def main() -> None:
    """Parse the arguments, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--share", type=float, default=0.01, help="of 3,000 km² and 10,000 areas")
    parser.add_argument("--cell", type=float, default=5.0, help="side of a cell (m)")
    parser.add_argument("--points", type=int, default=100, help="in each area")
    parser.add_argument("--rocks", type=int, default=10, help="blocks at each point")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--memory", type=float, default=8.0, help="GB")
    parser.add_argument("--folder", type=Path, help="kept; the batch goes on from what is there")
    parser.add_argument("--growth", action="store_true", help="also with twice of each")
    parser.add_argument("--json", type=Path, help="also write the figures to a file")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        child(given.child, given.jobs, given.memory)
        return
    areas = max(round(given.share * AREAS), 1)
    base = Canton(given.share * KM2, given.cell, areas, given.points, given.rocks)
    measured(replace(base, km2=25.0, areas=2), 1, given.memory)
    rows = (
        growth(base, given.jobs, given.memory)
        if given.growth
        else [measured(base, given.jobs, given.memory, given.folder)]
    )
    if given.json:
        given.json.write_text(json.dumps(rows, indent=2) + "\n")
    names = list(rows[0])
    print("  ".join(names))
    for row in rows:
        print("  ".join(f"{row[n]:{len(n)}.0f}" for n in names))


if __name__ == "__main__":
    main()
