"""What a command compiles: ``python benchmarks/compilation.py [COMMAND ...]``, default ``demo``.

The command of sassgis runs in this process with an empty cache, on one core. Each function that is
compiled is a row: processor time (s) without that of the functions that it calls, of which in
LLVM's optimiser and in writing machine code, and for how many types of arguments. Garbage that
Python looks for counts where it falls.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

Row = dict[str, float]


class Stopwatch:
    """Processor time of each function that numba compiles, without that of others in it."""

    def __init__(self) -> None:
        self.rows: dict[str, Row] = defaultdict(
            lambda: {"seconds": 0.0, "optimising": 0.0, "machine code": 0.0, "times": 0}
        )
        self._open: list[list[Any]] = []  # name, begun, seconds of functions within

    def on_start(self, event: Any) -> None:
        """Begin a function."""
        function = event.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__qualname__}".removeprefix("sassgis.")
        self._open.append([name, time.process_time(), 0.0])

    def on_end(self, event: Any) -> None:
        """End a function."""
        name, begun, within = self._open.pop()
        took = time.process_time() - begun
        self.rows[name]["seconds"] += took - within
        self.rows[name]["times"] += 1
        if self._open:
            self._open[-1][2] += took

    def timed(self, kind: type, method: str, column: str) -> None:
        """Let a method of numba count in a column of the function that is being compiled."""
        plain: Callable[..., Any] = getattr(kind, method)

        def counted(*given: Any, **named: Any) -> Any:
            begun = time.process_time()
            try:
                return plain(*given, **named)
            finally:
                if self._open:
                    self.rows[self._open[-1][0]][column] += time.process_time() - begun

        setattr(kind, method, counted)


def measure(command: list[str]) -> dict[str, Any]:
    """Run a command, and say what it compiled."""
    import sassgis.compiled.rng  # noqa: I001 - brings numba, without settings of the current folder
    from numba.core import codegen, event

    from sassgis.cli import main as sassgis

    watch = Stopwatch()
    event.register("numba:compile", type("Listener", (event.Listener,), {
        "on_start": lambda self, e: watch.on_start(e), "on_end": lambda self, e: watch.on_end(e),
    })())  # fmt: skip
    watch.timed(codegen.CPUCodeLibrary, "_optimize_final_module", "optimising")
    watch.timed(codegen.JitEngine, "finalize_object", "machine code")
    wall, processor = time.perf_counter(), time.process_time()
    try:
        sassgis(command)
    except SystemExit as done:
        if done.code:
            raise
    return {
        "wall_s": time.perf_counter() - wall,
        "processor_s": time.process_time() - processor,
        "compiling_s": sum(row["seconds"] for row in watch.rows.values()),
        "functions": dict(sorted(watch.rows.items(), key=lambda row: -row[1]["seconds"])),
    }


def main() -> None:
    """Parse the arguments, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rows", type=int, default=40, help="how many of the dearest to print")
    parser.add_argument("--json", type=Path, help="also write all figures to a file")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="of sassgis; default demo")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        os.environ["SASSGIS_CACHE_DIR"] = str(Path(scratch) / "compiled")
        out = ["-o", str(Path(scratch) / "out")]
        sys.argv[0] = "sassgis"
        result = measure(given.command or ["demo", *out, "--jobs", "1"])
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n")
    print(f"{'seconds':>8} {'optimising':>10} {'machine code':>12} {'times':>5}  function")
    total: Row = defaultdict(float)
    for i, (name, row) in enumerate(result["functions"].items()):
        for column, value in row.items():
            total[column] += value
        if i < given.rows:
            _print(row, name)
    _print(total, f"all {len(result['functions'])} functions")
    print(
        f"{result['processor_s']:.1f} s of processor time and {result['wall_s']:.1f} s in all, "
        f"of which {result['compiling_s']:.1f} s compiling"
    )


def _print(row: Row, name: str) -> None:
    print(
        f"{row['seconds']:8.2f} {row['optimising']:10.2f} {row['machine code']:12.2f} "
        f"{row['times']:5.0f}  {name}"
    )


if __name__ == "__main__":
    main()
