"""Peak memory of runs that differ in one thing: ``python benchmarks/memory.py [--json FILE]``.

Beside each stands what ``sassgis validate`` expects of it, and last what a million cells more take.
``--stages CONFIG`` shows memory and processor time of one zoning by stage (Linux).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import slope

#: What differs: command, width across the slope (m), spacing (m), blocks at a point, other keys.
CASES: dict[str, tuple[str, float, float, int, dict[str, object]]] = {
    "few of everything": ("run", 600.0, 10.0, 10, {}),
    "few of everything, zones": ("zone", 600.0, 10.0, 10, {}),
    "40 times the cells": ("run", 24_000.0, 10.0, 10, {}),
    "40 times the cells, zones": ("zone", 24_000.0, 10.0, 10, {}),
    "100 times the points": ("run", 600.0, 1.0, 1, {}),
    "many blocks at a point": ("run", 600.0, 20.0, 3000, {"stop_points_max": 0}),
    "every stop kept": ("run", 600.0, 20.0, 3000, {"stop_points_max": 1_000_000}),
    "a wide window": ("zone", 600.0, 10.0, 10, {"ref_width_m": 100.0}),
}


def written(folder: Path, name: str) -> None:
    """Write the case of a name into a folder."""
    _, across, spacing, rocks, keys = CASES[name]
    slope.HEIGHT = across
    slope.write_slope(folder)
    text = (folder / "config.toml").read_text(encoding="utf-8")
    text = text.replace(f"spacing_m = {slope.CELL}", f"spacing_m = {spacing}")
    text = text.replace(f"rocks_per_point = {slope.ROCKS_PER_CELL}", f"rocks_per_point = {rocks}")
    text = text.replace("[[blocks]]", "[[blocks]]\nonset_frequency = 0.1")
    text += f"\n[output]\nstop_points_max = {keys.get('stop_points_max', 100_000)}\n"
    text += f"\n[hazard]\nref_width_m = {keys.get('ref_width_m', 10.0)}\n"
    (folder / "config.toml").write_text(text, encoding="utf-8")


def _sassgis(*given: object) -> tuple[str, int]:
    """What a command prints, and its peak memory (bytes)."""
    command = [sys.executable, "-m", "sassgis", *map(str, given)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        printed, said = process.stdout.read().decode(), process.stderr.read().decode()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(command)} failed:\n{said}")
    return printed, 1024 * used.ru_maxrss


def measure(names: list[str]) -> list[dict[str, Any]]:
    """Of each case: what it is, what was expected, and what it took."""
    found = []
    for name in names:
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            written(folder, name)
            printed, _ = _sassgis("validate", folder / "config.toml", "--json")
            estimate = json.loads(printed)["estimate"]
            command = CASES[name][0]
            _, peak = _sassgis(command, folder / "config.toml", "-o", folder / "out")
        found.append({"case": name, "command": command, "peak_bytes": peak, **estimate})
        print(
            f"{name:28s} {peak / 1e9:6.2f} GB, expected {estimate.get('memory_bytes', 0) / 1e9:.2f}"
        )
    return found


def growth(found: list[dict[str, Any]]) -> None:
    """Print what a million cells more take, of two cases that differ in them."""
    peaks = {own["case"]: (own["peak_bytes"], own["cells"]) for own in found}
    for few, many in (
        ("few of everything", "40 times the cells"),
        ("few of everything, zones", "40 times the cells, zones"),
    ):
        if few in peaks and many in peaks:
            (low, n_low), (high, n_high) = peaks[few], peaks[many]
            print(f"{many}: {(high - low) / (n_high - n_low):.0f} MB for a million cells more")


def _state() -> tuple[float, float, float]:
    """Return peak since the last call and present memory (MB), and processor time (s)."""
    status = Path("/proc/self/status").read_text()
    peak, now = (
        float(re.findall(rf"{name}:\s+(\d+)", status)[0]) * 1.024e-3 for name in ("VmHWM", "VmRSS")
    )
    Path("/proc/self/clear_refs").write_text("5")
    used = resource.getrusage(resource.RUSAGE_SELF)
    return peak, now, used.ru_utime + used.ru_stime


def stages(config: Path) -> list[dict[str, Any]]:
    """Zone a configuration in this process; of each stage peak, end (MB) and processor time (s)."""
    found: list[dict[str, Any]] = []
    began, stage = 0.0, "start"

    def say(text: str) -> None:
        nonlocal began, stage
        peak, now, used = _state()
        found.append({"stage": stage, "peak_mb": peak, "end_mb": now, "cpu_s": used - began})
        print(f"{stage[:60]:60s} {peak:6.0f} MB, then {now:6.0f} MB, {used - began:6.2f} s")
        began, stage = used, text

    import sassgis

    with tempfile.TemporaryDirectory() as scratch:
        sassgis.zone(config, Path(scratch) / "out", say=say)
        say("")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", help="names of cases, separated by semicolons")
    parser.add_argument("--stages", type=Path, metavar="CONFIG", help="one zoning by stage")
    parser.add_argument("--json", type=Path, help="also write the figures to a file")
    given = parser.parse_args()
    if given.stages:
        found = stages(given.stages)
    else:
        found = measure(given.only.split(";") if given.only else list(CASES))
        growth(found)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
