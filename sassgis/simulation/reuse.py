"""Blocks of an earlier result in a run that differs from it in its stations and barriers only.

If no block of a release area came to a station or barrier that is gone, or to the place of a new
one, with barriers or without, the area has the same blocks in both runs: its sums are reused. The
blocks of the other areas are simulated again. Stations that are compared without barriers only, as
the copies of a net along the slope, change no motion: of the areas that are reused only blocks that
may come to new ones are simulated again, and only counted there.
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
from sassgis.simulation.accumulators import Progress, as_stations, tiles_of
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
#: How far from what it counts for a block that comes to a cell may be (cells): blocks pass between
#: cell centres.
_NEAR_CELLS = 2
#: Distance of points on a line, and from a point to the line's cells around it (cells).
_APART, _BESIDE = 0.1, 0.06


def keep_areas(file: Path, progress: Progress, run: MapRun) -> None:
    """Write the sums of the release areas, which are apart, and what they depend on."""
    lines = run.all_lines
    arrays: dict[str, Any] = state_of(progress) | {
        f"digest.{name}": np.array(own) for name, own in _digests(run).items()
    }
    arrays["compared"] = np.array(run.compared)
    arrays["line_digests"] = np.array([value_digest(own) for own in lines], np.str_)
    write_saved(file, arrays, "", compressed=True)


def _digests(run: MapRun) -> dict[str, str]:
    return {
        own.name: value_digest(getattr(run, own.name))
        for own in fields(run)
        if own.name not in _OTHERS
    }


class OtherInputs(InputError):
    """Raised when more differs than stations and barriers; ``field`` has the keys."""


def begun_with(file: Path, run: MapRun) -> Progress:
    """Return the progress with which a run begins that has some areas of an earlier result.

    InputError: there is no such result. OtherInputs: it is of other inputs.
    """
    said: list[str] = []
    state = read_saved(file, "", said.append)
    if state is None:
        raise InputError(
            "the sums of release areas are damaged or of another version" if said
            else "there are no sums of release areas to be used again",
            file=file, expected="a result of sassgis zone with barriers, of this version",
        )  # fmt: skip
    now = _digests(run)
    differ = [_KEYS.get(n, n) for n, digest in now.items() if state[f"digest.{n}"] != digest]
    if differ:
        raise OtherInputs(
            "the earlier result is of other inputs", file=file, field=", ".join(differ),
            found="another content",
            expected="the same but for stations, walls, nets and galleries",
        )  # fmt: skip
    digests = [value_digest(own) for own in run.all_lines]
    was = state["line_digests"].tolist()
    # Where each line of the earlier result is now; -1: nowhere.
    moved = np.array([digests.index(own) if own in digests else -1 for own in was], np.int64)
    # Without a further station, which no block meets, the others move the same.
    gone = np.flatnonzero(moved[: int(state["compared"])] < 0)
    new = [i for i, own in enumerate(digests) if own not in was]
    met, passed = ([i for i in new if (i < (run.compared or 0)) == own] for own in (True, False))
    lines = _placeholders(int(state["compared"]), len(was))
    earlier = progress_from(state, run.grid.values.size, lines, int(state["compared"]))
    near, tiles = _near(run, met), tiles_of(run.grid, _near(run, passed))
    progress = Progress.fresh(run)
    progress.parts = {
        area: part
        for area, part in (earlier.parts or {}).items()
        if not (_came_to(part, gone) or _may_come_to(part, near))
    }
    for part in progress.parts.values():
        _with_lines(part, run, moved)
        progress.sources |= part.sources
        progress.simulated += part.simulated
    progress.rounds = earlier.rounds
    progress.reused, progress.new_lines = tuple(progress.parts), tuple(passed)
    progress.recounted = frozenset(
        (area, chunk)
        for area, part in progress.parts.items()
        for chunk, own in enumerate(part.tiles)
        if np.isin(own, tiles).any()
    )
    return progress


def _placeholders(compared: int, n: int) -> tuple[ControlLine, ...]:
    """Return lines for reading counts of so many, the first of which are barriers."""
    return tuple(ControlLine(str(i), "wall" if i < compared else "station") for i in range(n))


def _came_to(part: Progress, lines: IntArray) -> bool:
    """Return whether a block of an area, with or without barriers, came to one of the lines."""
    counts = [part.control_lines]
    counts += [own.without.control_lines for own in part.sources.values() if own.without]
    return any(own.arrivals(int(i)) > 0 for own in counts for i in lines)


def _near(run: MapRun, lines: Sequence[int]) -> IntArray:
    """Return the cells that lines come to, and those in which a block counts that comes there."""
    near = np.zeros(run.grid.shape, np.bool_)
    for i in lines:
        near.ravel()[_cells_of(run.grid, run.all_lines[i][1])] = True
    return np.flatnonzero(ndimage.binary_dilation(near, iterations=_NEAR_CELLS))


def _may_come_to(part: Progress, near: IntArray) -> bool:
    """Return whether a block of an area, with or without barriers, may come to some cells."""
    reached = [part.sums.cells]
    reached += [t.without.cells.counts().places for t in part.sources.values() if t.without]
    return any(np.isin(near, own).any() for own in reached)


def _cells_of(grid: Grid, trace: FloatArray) -> IntArray:
    """Return all cells that a line comes to, also where it only touches them."""
    x, y = points_on(grid, trace, _APART).T
    beside = _BESIDE * grid.cell_size * np.array([-1.0, 1.0])
    cells = grid.cell_of((x + beside[:, None])[:, None], (y + beside[:, None])[None])
    return np.unique(cells[cells >= 0])


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
