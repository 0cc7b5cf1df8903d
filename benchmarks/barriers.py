"""Time of blocks without barriers: ``python benchmarks/barriers.py CONFIG [--json FILE]``.

Once the blocks with barriers only, once with those without that differ from them, and once with a
full repetition without barriers. Processor time of one thread, in turn, median of some repetitions;
the first, which compiles, does not count.
"""

from __future__ import annotations

import argparse
import json
import resource
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from sassgis.runs.inputs import compared_run, read_rules
from sassgis.runs.resumable_run import configured, read_job
from sassgis.runs.run import prepared
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import StopReason
from sassgis.simulation.accumulators import Progress, as_stations
from sassgis.simulation.loop import simulate_map
from sassgis.terrain.prepare import Plan


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _timed(run: MapRun, planned: Plan) -> tuple[Progress, float]:
    began = _cpu_s()
    progress = simulate_map(run, planned)
    return progress, _cpu_s() - began


def measure(config: Path, repeats: int) -> dict[str, Any]:
    """Return seconds of processor time, and how many blocks a barrier stops."""
    read = read_job(configured(config, None), None, lambda _text: None)
    job = prepared(read, read_rules(read.config, read.run))
    both = compared_run(read.config, job.run, along_slope=True)
    held = replace(both, further_stations=None)
    stations = as_stations([line for line, _ in both.all_lines])
    traces = [trace for _, trace in both.all_lines]
    again = replace(held, control_lines=tuple(zip(stations, traces, strict=True)))
    runs: dict[str, Callable[[], tuple[Progress, float]]] = {
        name: lambda run=run: _timed(run, job.planned)  # type: ignore[misc]
        for name, run in (("with", held), ("both", both), ("again", again))
    }
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats + 1):
        for name, timed in runs.items():
            progress, taken = timed()
            seconds[name].append(taken)
            if name == "with":
                stopped = int(progress.reasons[StopReason.BARRIER])
    return {
        "blocks": progress.simulated,
        "stopped_by_barriers": stopped,
        "seconds": {name: round(median(own[1:]), 2) for name, own in seconds.items()},
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("config", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found = measure(given.config, given.repeats)
    text = json.dumps(found, indent=2)
    print(text)
    if given.json is not None:
        given.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
