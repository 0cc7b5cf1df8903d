"""Blocks of an earlier result in a run that differs from it in its stations and barriers only.

If no block of a release area came near a station or barrier that has changed, with barriers or
without, the area has the same blocks in both runs: its sums are reused. The blocks of the other
areas are simulated again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from sassgis.errors import InputError
from sassgis.files.digests import value_digest
from sassgis.files.saved_arrays import read_saved, write_saved
from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.settings.map_run import MapRun
from sassgis.settings.results import ControlLine
from sassgis.simulation.accumulators import Progress, as_stations
from sassgis.simulation.checkpoint import progress_from, state_of
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.terrain.fall_lines import points_on

#: File in a result with the sums of its release areas.
KEPT_NAME = "simulation.npz"
#: Fields of a run that may differ; the repetitions are those of the earlier result.
_OTHERS = ("control_lines", "further_stations", "rounds")
#: Keys of the configuration behind fields that have no name of a section.
_KEYS = {
    "grid": "terrain.dem", "table": "ground.classes", "areas": "release.file", "seed": "run.seed",
    "stop_points_max": "output.stop_points_max", "thresholds_kj": "hazard.preset",
    "ref_width_m": "hazard.ref_width_m", "forest": "effects.trees",
    "ground_heights": "terrain.block_scale_m",
}  # fmt: skip
#: A line within so many cells of reached ones is near: blocks pass between cell centres, and places
#: are rounded.
_NEAR_CELLS = 2


def keep_areas(file: Path, progress: Progress, run: MapRun) -> None:
    """Write the sums of the release areas, which are apart, and what they depend on."""
    lines = run.all_lines
    arrays: dict[str, Any] = state_of(progress) | {
        f"digest.{name}": np.array(own) for name, own in _digests(run).items()
    }
    arrays["compared"] = np.array(run.compared)
    arrays["line_digests"] = np.array([value_digest(own) for own in lines], np.str_)
    arrays["line_offset"] = np.cumsum([0, *(len(trace) for _, trace in lines)])
    arrays["line_xy"] = np.concatenate([np.empty((0, 2)), *(trace for _, trace in lines)])
    write_saved(file, arrays, "", compressed=True)


def _digests(run: MapRun) -> dict[str, str]:
    return {
        own.name: value_digest(getattr(run, own.name))
        for own in fields(run)
        if own.name not in _OTHERS
    }


def begun_with(file: Path, run: MapRun) -> Progress:
    """Return the progress with which a run begins that has some areas of an earlier result.

    InputError: there is no such result, or more differs than stations and barriers.
    """
    said: list[str] = []
    state = read_saved(file, "", said.append)
    if state is None:
        raise InputError(
            said[0] if said else "there are no sums of release areas to be used again",
            file=file, expected="a result of sassgis zone with walls or nets, of this version",
        )  # fmt: skip
    now = _digests(run)
    differ = [_KEYS.get(n, n) for n, digest in now.items() if state[f"digest.{n}"] != digest]
    if differ:
        raise InputError(
            "the earlier result is of other inputs", file=file, field=", ".join(differ),
            expected="the same but for stations, walls, nets and galleries",
        )  # fmt: skip
    digests = [value_digest(own) for own in run.all_lines]
    was = state["line_digests"].tolist()
    # Where each line of the earlier result is now; -1: nowhere.
    moved = np.array([digests.index(own) if own in digests else -1 for own in was], np.int64)
    traces = np.split(state["line_xy"], state["line_offset"][1:-1])
    changed = [trace for trace, at in zip(traces, moved, strict=True) if at < 0]
    changed += [t for (_, t), own in zip(run.all_lines, digests, strict=True) if own not in was]
    lines = _placeholders(int(state["compared"]), len(was))
    earlier = progress_from(state, run.grid.values.size, lines, int(state["compared"]))
    progress = Progress.fresh(run)
    progress.parts = {
        area: part
        for area, part in (earlier.parts or {}).items()
        if not _come_near(run.grid, part, changed)
    }
    for part in progress.parts.values():
        _with_lines(part, run, moved)
        progress.sources |= part.sources
        progress.simulated += part.simulated
    progress.rounds = earlier.rounds
    progress.reused = tuple(progress.parts)
    progress.reused_rounds = len(earlier.rounds)
    return progress


def _placeholders(compared: int, n: int) -> tuple[ControlLine, ...]:
    """Return lines for reading counts of so many, the first of which are barriers."""
    return tuple(ControlLine(str(i), "wall" if i < compared else "station") for i in range(n))


def _come_near(grid: Grid, part: Progress, traces: Sequence[FloatArray]) -> bool:
    """Return whether a block of an area, with or without barriers, comes near one of the lines."""
    reached = np.zeros(grid.values.size, np.bool_)
    for tally in part.sources.values():
        reached[tally.cells.counts().places] = True
        reached[tally.without_barriers().cells.counts().places] = True
    near = ndimage.binary_dilation(reached.reshape(grid.shape), iterations=_NEAR_CELLS)
    points = [points_on(grid, trace) for trace in traces]
    xy = np.concatenate([np.empty((0, 2)), *points])
    cells = grid.cell_of(xy[:, 0], xy[:, 1])
    return bool(near.ravel()[cells[cells >= 0]].any())


def _with_lines(part: Progress, run: MapRun, moved: IntArray) -> None:
    """Assign the counts of an area to the lines of a run; ``moved``: present position of each."""
    lines = tuple(line for line, _ in run.all_lines)
    met = lines[: run.compared]
    n = len(part.control_lines.control_lines)
    part.control_lines = _placed(part.control_lines, met, moved[:n])
    for tally in part.sources.values():
        tally.control_lines = _placed(tally.control_lines, met, moved[:n])
        if tally.without is not None:
            without = tally.without
            without.control_lines = _placed(without.control_lines, as_stations(lines), moved)


def _placed(
    sums: ControlLineSums, lines: tuple[ControlLine, ...], moved: IntArray
) -> ControlLineSums:
    """Return counts at other lines, of which some are where ``moved`` says."""
    out = ControlLineSums(lines)
    out.add_sums(sums.only(np.flatnonzero(moved >= 0)), moved[moved >= 0])
    return out
