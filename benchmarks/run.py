"""Rate, memory and compilation time of sassgis on the benchmark slope, compared with SAGA.

    python benchmarks/run.py [--repeats 3] [--rough] [--path followed] [--readings 1986]
                             [--flowpy FOLDER] [--jobs N] [--json FILE]

Each figure comes from a process of its own. The rate counts complete trajectories with all map
statistics on, from release points to sums per cell, by processor time, after compilation. The
comparison with SAGA has two ratios: of complete runs, and of blocks and walks only, without set-up.
With ``--flowpy`` com4FlowPy is timed too, in an environment that pip makes in FOLDER; with
``--jobs`` one area on 1 and on N threads and processes, the start of the workers included.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import saga
import slope


def simulate_once(folder: Path, repeats: int, settings: dict[str, str]) -> dict[str, Any]:
    """In this process: time runs on the slope, the first of them with compilation."""
    import dataclasses

    from sassgis.inputs.config import load_config
    from sassgis.runs.inputs import read_map_run
    from sassgis.simulation.loop import chunks_of, plan_of_points, simulate_map
    from sassgis.terrain.prepare import plan

    run = read_map_run(load_config(folder / "config.toml", settings))
    began = time.perf_counter()
    planned = plan(run)
    simulate_map(run, plan_of_points(planned, chunks_of(planned)[0].points), jobs=1)
    first = time.perf_counter() - began
    cpu, per_rock = [], []
    rocks = 0
    # One rock per line has the same set-up: terrain, fall lines, profiles. The difference is the
    # time of the blocks only, as saga.measure takes that of the walks only.
    one = dataclasses.replace(run, release=dataclasses.replace(run.release, rocks_per_point=1))
    for _ in range(repeats):
        c = time.process_time()
        # The sums of one run are not held beside those of the next.
        rocks = int(simulate_map(run, plan(run), jobs=1).reasons.sum())
        cpu.append(time.process_time() - c)
        c = time.process_time()
        single = int(simulate_map(one, plan(one), jobs=1).reasons.sum())
        per_rock.append((cpu[-1] - (time.process_time() - c)) / (rocks - single))
    return {
        "rocks": rocks,
        "first_s": first,
        "s_per_further_rock": per_rock,
        "cpu_s": cpu,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def simulate_together(folder: Path, settings: dict[str, str], most: int) -> list[dict[str, Any]]:
    """In this process: the same blocks by 1 and more threads and processes, compiled before."""
    from contextlib import nullcontext

    from sassgis.inputs.config import load_config
    from sassgis.runs.inputs import read_map_run
    from sassgis.simulation.loop import chunks_of, plan_of_points, simulate_map
    from sassgis.simulation.workers import Processes, Threads
    from sassgis.terrain.prepare import plan

    run = read_map_run(load_config(folder / "config.toml", settings))
    planned = plan(run)
    # Loads what was compiled before.
    simulate_map(run, plan_of_points(planned, chunks_of(planned)[0].points))
    found = []
    for kind in ("threads", "processes"):
        for count in (1, most):
            began, used = time.perf_counter(), sum(os.times()[:4])
            with nullcontext(Threads(count)) if kind == "threads" else Processes(count) as workers:
                rocks = int(simulate_map(run, planned, jobs=workers).reasons.sum())
            wall = time.perf_counter() - began
            cpu = sum(os.times()[:4]) - used
            found.append({"workers": kind, "count": count, "rocks_per_wall_s": rocks / wall,
                          "wall_s": wall, "cpu_s": cpu})  # fmt: skip
    return found


def _child(folder: Path, repeats: int, settings: dict[str, str], cache: Path, jobs: int = 0) -> Any:
    given = ["--child", str(folder), "--repeats", str(repeats), "--jobs", str(jobs)]
    done = subprocess.run(
        [sys.executable, __file__, *given, "--settings", json.dumps(settings)],
        env={**os.environ, "SASSGIS_CACHE_DIR": str(cache), "NUMBA_CACHE_DIR": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        sys.exit(f"the run failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def measure(
    repeats: int,
    rough: bool,
    settings: dict[str, str],
    environments: Path | None = None,
    jobs: int = 0,
) -> dict[str, Any]:
    """All figures, in one run of this script."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "slope"
        slope.write_slope(folder, rough=rough)
        cache = Path(scratch) / "cache"
        cold = _child(folder, 1, settings, cache)
        warm = _child(folder, repeats, settings, cache)
        together = _child(folder, 1, settings, cache, jobs) if jobs else []
        other = saga.measure(folder, repeats=repeats)
        routed = None
        if environments is not None:
            # It brings the engine of sassgis along, which nobody else here needs.
            import flowpy

            routed = flowpy.measure(folder, environments, repeats=repeats)
    rate = [warm["rocks"] / s for s in warm["cpu_s"]]
    result: dict[str, Any] = {
        "rocks": warm["rocks"],
        "trajectories_per_s_and_core": statistics.median(rate),
        "trajectories_per_s_range": [min(rate), max(rate)],
        "further_trajectories_per_s": 1.0 / statistics.median(warm["s_per_further_rock"]),
        "peak_mb": warm["peak_mb"],
        "first_call_compiling_s": cold["first_s"],
        "first_call_from_cache_s": warm["first_s"],
        "saga": other,
        "com4flowpy": routed,
        "together": together,
    }
    if other.get("available"):
        result["ratio_whole"] = result["trajectories_per_s_and_core"] / (
            other["walks"] / statistics.median(other["seconds"])
        )
        result["ratio_further"] = result["further_trajectories_per_s"] / other["walks_per_s"]
    return result


def main() -> None:
    """Parse the arguments, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--rough", action="store_true", help="metre-scale roughness on the slope")
    parser.add_argument("--path", choices=("fall_line", "followed"), default="fall_line")
    parser.add_argument("--readings", choices=("hazard", "1986"), default="hazard")
    parser.add_argument("--flowpy", type=Path, help="also com4FlowPy, with an environment there")
    parser.add_argument("--jobs", type=int, default=0, help="also by so many threads and processes")
    parser.add_argument("--json", type=Path, help="also write the figures to a file")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--settings", type=json.loads, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        if given.jobs:
            print(json.dumps(simulate_together(given.child, given.settings, given.jobs)))
        else:
            print(json.dumps(simulate_once(given.child, given.repeats, given.settings)))
        return
    environments = given.flowpy.resolve() if given.flowpy else None
    settings = {"terrain.path": given.path, "engine.readings": given.readings}
    result = measure(given.repeats, given.rough, settings, environments, given.jobs)
    if given.json:
        given.json.write_text(json.dumps(result, indent=2) + "\n")
    surface = "rough" if given.rough else "plain"
    print(f"slope: {surface}, {given.path}, {given.readings}, {result['rocks']} blocks")
    low, high = result["trajectories_per_s_range"]
    print(
        f"sassgis: {result['trajectories_per_s_and_core']:,.0f} trajectories per second and core "
        f"({low:,.0f} to {high:,.0f}), peak memory {result['peak_mb']:.0f} MB"
    )
    print(
        f"first call: {result['first_call_compiling_s']:.1f} s compiling, "
        f"{result['first_call_from_cache_s']:.1f} s from the cache"
    )
    for row in result["together"]:
        print(
            f"{row['count']} {row['workers']}: {row['rocks_per_wall_s']:,.0f} trajectories per "
            f"second, {row['wall_s']:.1f} s, processor time {row['cpu_s']:.1f} s"
        )
    if result["saga"].get("available"):
        walks = result["saga"]["walks"] / statistics.median(result["saga"]["seconds"])
        print(
            f"SAGA {result['saga']['version']}: {walks:,.0f} walks per second, complete process; "
            f"sassgis: {result['ratio_whole']:.1f} times as many"
        )
        print(
            f"without set-up: {result['further_trajectories_per_s']:,.0f} trajectories and "
            f"{result['saga']['walks_per_s']:,.0f} walks per second, "
            f"{result['ratio_further']:.1f} times as many"
        )
    else:
        print(result["saga"]["message"])
    if result["com4flowpy"]:
        routed = result["com4flowpy"]["cells_per_s"]
        own = result["further_trajectories_per_s"] / slope.ROCKS_PER_CELL
        print(
            f"com4FlowPy: {routed:,.2f} release cells per second; "
            f"sassgis: {own:,.0f}, with {slope.ROCKS_PER_CELL} blocks in each"
        )


if __name__ == "__main__":
    main()
