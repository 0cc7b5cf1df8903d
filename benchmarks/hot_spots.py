"""Where the engine spends its time: ``python benchmarks/hot_spots.py [--rough] [--json FILE]``.

perf (Debian package linux-perf) looks 4,000 times a second where the processor is, while blocks run
down the slope of slope.py, on fall lines and on followed paths. The engine is compiled with the
lines of its sources beside the instructions, which changes none of these; objdump says which
instruction belongs to which line. Of functions that are put in the place of a call before that
(jit.inlined), numba keeps the line and takes the file of the caller: they count there.
"""

from __future__ import annotations

import argparse
import bisect
import collections
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import slope

#: Modules of the engine by what they do; all others are "the rest".
PARTS = {
    "search for contacts": ("contact.py", "ellipse_contact.py"),
    "impacts and landing": ("impact.py", "landing.py", "flight.py", "ellipse.py"),
    "rolling and sliding": ("rolling.py", "ground_motion.py"),
    "statistics of cells": ("statistics.py", "recording.py", "cell_register.py"),
    "the ground ahead of a followed path": ("ground_ahead.py", "ground_behind.py", "cells.py"),
    "headings": ("heading.py",),
}


def watched(folder: Path, path: str, blocks: int, code: Path, address: Path) -> None:
    """In a process that is watched: run the blocks, and leave the machine code and its place."""
    import dataclasses

    from numba.core import compiler

    plain = compiler.CompilerBase.__init__

    def with_lines(self: Any, *given: Any) -> None:
        flags = given[5]
        flags.debuginfo = flags.dbg_directives_only = True
        plain(self, *given)

    compiler.CompilerBase.__init__ = with_lines
    from sassgis.compiled import jit
    from sassgis.engine import kernel
    from sassgis.inputs.config import load_config
    from sassgis.runs.inputs import read_map_run
    from sassgis.simulation.loop import simulate_map
    from sassgis.terrain.prepare import plan

    run = read_map_run(load_config(folder / "config.toml", {"terrain.path": path}))
    release = dataclasses.replace(run.release, rocks_per_point=blocks)
    run = dataclasses.replace(run, release=release)
    simulate_map(run, plan(run), jobs=1)
    # Compiled code is looked at only: what Python, the terrain and its lines take is not in it.
    function: Any = kernel.simulate_strata
    (made,) = jit._entry(function.py_func, True).overloads.values()  # type: ignore[attr-defined]
    name = made.fndesc.llvm_func_name
    code.write_bytes(made.library._get_compiled_object())
    address.write_text(f"{made.library.get_pointer_to_function(name)} {name}")


def lines_of(code: Path) -> tuple[list[int], list[str]]:
    """Where in machine code a line of the sources begins, ascending, and in which file it is."""
    found = []
    last = ""
    for text in _said("objdump", "--dwarf=decodedline", str(code)).splitlines():
        row = re.match(r"(\S+\.py)\s+(\d+)\s+(0x[0-9a-f]+|0)\b", text)
        if row:
            # Line 0 is what the compiler cannot say: it stays with what comes before.
            last = row[1] if int(row[2]) else last
            found.append((int(row[3], 16), last))
    found.sort(key=lambda one: one[0])
    return [at for at, _ in found], [name for _, name in found]


def shares(record: Path, code: Path, address: Path) -> dict[str, float]:
    """Share of the looks at the compiled engine that found it in each part."""
    place, name = address.read_text().split()
    symbols = [row.split() for row in _said("nm", "-S", str(code)).splitlines()]
    bodies = [(int(s[0], 16), int(s[1], 16), s[3]) for s in symbols if len(s) == 4 and s[2] in "tT"]
    begins = int(place) - next(at for at, _, own in bodies if own == name)
    end = max(at + size for at, size, _ in bodies)
    at, files = lines_of(code)
    part_of = {name: part for part, names in PARTS.items() for name in names}
    looks = collections.Counter(dict.fromkeys((*PARTS, "the rest"), 0))
    for word in _said("perf", "script", "-i", str(record), "-F", "ip").split():
        offset = int(word, 16) - begins
        if 0 <= offset < end:
            file = files[max(bisect.bisect_right(at, offset) - 1, 0)]
            looks[part_of.get(file, "the rest")] += 1
    return {part: count / looks.total() for part, count in looks.items()}


def _said(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def measure(rough: bool, blocks: int) -> dict[str, dict[str, float]]:
    """Shares by part, on fall lines and on followed paths."""
    out = {}
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        slope.write_slope(work / "slope", rough)
        for path in ("fall_line", "followed"):
            code, address, record = (work / f"{path}.{kind}" for kind in ("o", "address", "perf"))
            # Machine code from a cache would have no lines.
            cache = work / path
            cache.mkdir(mode=0o700)
            given = (str(work / "slope"), path, str(blocks), str(code), str(address))
            subprocess.run(
                ["perf", "record", "-q", "-e", "cpu-clock", "-F", "4000", "-o", str(record),
                 sys.executable, __file__, "--watched", *given],
                check=True, env=os.environ | {"SASSGIS_CACHE_DIR": str(cache)},
            )  # fmt: skip
            out[path] = shares(record, code, address)
    return out


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rough", action="store_true")
    parser.add_argument("--blocks", type=int, default=100, help="at each release point (100)")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--watched", nargs=5, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.watched:
        folder, path, blocks, code, address = given.watched
        watched(Path(folder), path, int(blocks), Path(code), Path(address))
        return
    found = measure(given.rough, given.blocks)
    for part in found["fall_line"]:
        print(f"{part:50}" + "".join(f"{100 * own[part]:6.0f} %" for own in found.values()))
    if given.json:
        given.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
