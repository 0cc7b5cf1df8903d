"""Rates of sassgis and of other programs for profiles, on one profile and in one run.

    python benchmarks/peers.py [--environments FOLDER] [--json FILE]

Each program runs in an environment of its own, which is made in FOLDER (kept) by pip. One core,
processor time, alternating; the best of the repeats. A program that cannot be installed is reported
with the reason. PlatRock needs ``gdal-config`` (Debian: ``apt-get install libgdal-dev``).
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import effects
import numpy as np

from sassgis.engine.simulate import simulate
from sassgis.inputs.ground_map import read_ground_table
from sassgis.settings.settings import EngineSettings

SCRIPTS = Path(__file__).resolve().parent / "peer_scripts"
#: Requirement, script, and rocks of one run.
PEERS = {
    "PlatRock 2D": ("platrock==0.4.6", "platrock_2d.py", 300),
    "PyRockfall": ("pyrockfall==0.1.2", "pyrockfall_2d.py", 3000),
}
OWN_ROCKS = 20_000
_ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def write_profile(file: Path) -> None:
    """The line of ``effects.py`` as chainage, height and class of the segment that begins."""
    table = read_ground_table(None)
    line = effects.slope_line(table)
    with file.open("w", encoding="utf-8", newline="") as stream:
        out = csv.writer(stream, lineterminator="\n")
        out.writerow(["s_m", "z_m", "ground"])
        for s, z, ground in zip(line.s, line.z, line.ground, strict=True):
            out.writerow([f"{s:.3f}", f"{z:.4f}", table.names[ground]])


def own_run() -> dict[str, Any]:
    """One run of sassgis on the profile."""
    table = read_ground_table(None)
    line = effects.slope_line(table)
    began = time.process_time()
    found = simulate(
        line, table, effects.BLOCKS, EngineSettings(), seed=1986, rocks_per_line=OWN_ROCKS,
        line_keys=np.zeros(1, np.uint64),
        starts=np.array([[4.0, 44.0]]),
    )  # fmt: skip
    return {
        "seconds": time.process_time() - began,
        "rocks": OWN_ROCKS,
        "median_stop_m": float(np.median(found.rocks["runout_m"])),
    }


def python_of(requirement: str, folder: Path) -> Path:
    """Python of an environment with a program; made if it is not there."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "-q", requirement], check=True)
    return python


def peer_run(
    python: Path, script: str, *given: object, folder: str = ".", failed: str = ""
) -> dict[str, Any]:
    """One run of another program, on one core and with its own packages alone.

    ``failed`` stands before what it says where it fails.
    """
    own = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [python, SCRIPTS / script, *map(str, given)],
        env=own | _ONE_CORE, cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
        raise RuntimeError(failed + said)
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


def compare(environments: Path, repeats: int) -> dict[str, dict[str, Any]]:
    """The best run of each program, or why there is none."""
    best: dict[str, dict[str, Any]] = {}
    own_run()  # compiled
    with tempfile.TemporaryDirectory() as scratch:
        profile = Path(scratch) / "profile.csv"
        write_profile(profile)
        for _ in range(repeats):
            runs = {"sassgis": own_run()}
            for name, (requirement, script, rocks) in PEERS.items():
                if "failure" in best.get(name, {}):
                    continue
                try:
                    folder = environments / requirement.partition("==")[0]
                    runs[name] = peer_run(python_of(requirement, folder), script, profile, rocks)
                except (RuntimeError, subprocess.CalledProcessError) as error:
                    runs[name] = {"failure": str(error)}
                runs[name]["version"] = requirement.partition("==")[2]
            for name, run in runs.items():
                if "failure" in run:
                    best[name] = run
                    continue
                run["rocks_per_s"] = run["rocks"] / run["seconds"]
                if run["rocks_per_s"] > best.get(name, {}).get("rocks_per_s", 0.0):
                    best[name] = run
    own = best["sassgis"]["rocks_per_s"]
    for run in best.values():
        if "failure" not in run:
            run["sassgis_times"] = own / run["rocks_per_s"]
    return best


def main() -> None:
    """Parse the arguments, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--environments", type=Path, default=Path("build/peers"))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path, help="also write the figures to a file")
    given = parser.parse_args()
    found = compare(given.environments.resolve(), given.repeats)
    for name, run in found.items():
        print(
            f"{name:12s} {run['failure']}"
            if "failure" in run
            else f"{name:12s} {run['rocks_per_s']:9.0f} rocks/s; sassgis makes "
            f"{run['sassgis_times']:.0f} times as many; median stop {run['median_stop_m']:.0f} m"
        )
    if given.json:
        given.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
