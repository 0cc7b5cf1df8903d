"""What the parts of a simulation cost on this machine: ``python benchmarks/limits.py``.

Times by themselves what a block cannot do without, on one line of the slope, and counts how often
it does it. Their sum is what is left to a perfect engine that makes the same events; beside it
stands the time of the engine.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from effects import BLOCKS, slope_line

from sassgis.compiled import rng
from sassgis.compiled.jit import kernel
from sassgis.engine.ellipse import Records, cos_sin
from sassgis.engine.ellipse_contact import Flying, contact_with_segment
from sassgis.engine.impact import RESTITUTION, impact
from sassgis.engine.profile import profile_of
from sassgis.engine.simulate import simulate
from sassgis.engine.state import FLIGHT, IMPACT
from sassgis.grid import FloatArray, IntArray
from sassgis.inputs.ground_map import read_ground_table
from sassgis.settings.settings import EngineSettings

_N = 100_000


@kernel
def _angles(x: FloatArray) -> float:
    total = 0.0
    for angle in x:
        c, s = cos_sin(angle)
        total += c * s
    return total


@kernel
def _library_angles(x: FloatArray) -> float:
    total = 0.0
    for angle in x:
        total += math.cos(angle) * math.sin(angle)
    return total


@kernel
def _draws(x: FloatArray) -> float:
    total = 0.0
    for i in range(x.size):
        total += rng.uniform(np.uint64(1986), rng.SLOPE, i)
    return total


@kernel
def _impacts(x: FloatArray) -> float:
    total = 0.0
    for speed in x:
        vx, _, _ = impact(0.02, 0.4, 0.07, 8.0, -speed, 15.0, 0.8, RESTITUTION, 0.5, 0.4, 9.0, 0.1)
        total += vx
    return total


@kernel
def _contacts(x: FloatArray, profile: Records) -> float:
    total = 0.0
    for speed in x:
        flying = Flying(0.0, 1.0 + speed, 8.0, -5.0, 6.3 * speed, 15.0, 0.45, 0.38, 9.81)
        total += contact_with_segment(flying, 0.0, 9.0, 1e-6, profile[0], profile[0].length)[0]
    return total


@kernel
def _cells(peak: FloatArray, cell: IntArray) -> float:
    for i in range(cell.size):
        for k in range(4):
            peak[cell[i], k] = max(peak[cell[i], k], 1.0)
    return float(peak[0, 0])


def _ns(function: Callable[..., float], *given: object) -> float:
    """Shortest time of a call out of several, per element of ``_N`` (ns)."""
    function(*given)
    took = []
    for _ in range(9):
        began = time.process_time()
        function(*given)
        took.append(time.process_time() - began)
    return 1e9 * min(took) / _N


def measure(rocks: int, repeats: int) -> dict[str, dict[str, float]]:
    """Of each part: how often a block does it, what it costs (ns), and the product (µs)."""
    draws = np.random.default_rng(1).random(_N)
    ends = np.array([0.0, 200.0]), np.array([0.0, -140.0])
    slope = profile_of(*ends, np.zeros(2, np.int32)).rows
    cells = np.random.default_rng(2).integers(0, 20_000, _N)
    cost = {
        "flights, search for the contact": _ns(_contacts, draws, slope),
        "impacts": _ns(_impacts, draws),
        "cells, largest values": _ns(_cells, np.zeros((20_000, 4)), cells),
        "draws": _ns(_draws, draws),
        "cosine and sine": _ns(_angles, 100.0 * draws),
        "cosine and sine of the C library": _ns(_library_angles, 100.0 * draws),
    }
    table = read_ground_table(None)
    line = slope_line(table)

    def run(n: int, log: int = 0) -> tuple[float, object]:
        began = time.process_time()
        out = simulate(
            line, table, BLOCKS, EngineSettings(), seed=1986, rocks_per_line=n, log_events=log,
            line_keys=np.zeros(1, np.uint64), starts=np.array([[4.0, 44.0]]),
        )  # fmt: skip
        return time.process_time() - began, out

    _, out = run(200, 5000)
    phases = np.concatenate([log["phase"] for log in out.event_logs])  # type: ignore[attr-defined]
    often = {
        "flights, search for the contact": float((phases == FLIGHT).sum()) / 200,
        "impacts": float((phases == IMPACT).sum()) / 200,
        "cells, largest values": float(out.sums["reach"].sum()) / 200,  # type: ignore[attr-defined]
        "draws": float((phases == IMPACT).sum()) / 200 + 10.0,
    }
    few = min(run(10)[0] for _ in range(repeats))
    all_of_it = min(run(rocks + 10)[0] for _ in range(repeats))
    result = {
        name: {"per_block": often.get(name, 0.0), "ns": ns, "us": 1e-3 * often.get(name, 0.0) * ns}
        for name, ns in cost.items()
    }
    result["sum"] = {"us": sum(row["us"] for row in result.values())}
    result["engine"] = {"us": 1e6 * (all_of_it - few) / rocks}
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rocks", type=int, default=3000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path, help="also write the figures to a file")
    given = parser.parse_args()
    result = measure(given.rocks, given.repeats)
    print(f"{'':36s}per block      ns      µs")
    for name, row in result.items():
        if "ns" in row:
            print(f"{name:36s}{row['per_block']:9.1f}{row['ns']:8.1f}{row['us']:8.2f}")
        else:
            print(f"{name:36s}{'':17s}{row['us']:8.2f}")
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
