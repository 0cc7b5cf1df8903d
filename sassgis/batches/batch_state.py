"""State of each release area of a batch, and how the mosaic is added up from it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.files.atomic_output import MANIFEST_NAME, write_json, writing
from sassgis.files.digests import json_digest
from sassgis.files.saved_arrays import saved_digest, saved_or_refused, unfit, write_saved
from sassgis.grid import FloatArray, IntArray
from sassgis.inputs.tiles import Part, Terrain
from sassgis.settings.map_run import BlockRows, MapRun
from sassgis.settings.statistics_table import SUM_NAMES, Bins, bins_of, wider
from sassgis.simulation.accumulators import Progress, SourceTally, evenly_kept, joined_rows
from sassgis.simulation.checkpoint import counts_from, progress_from, state_of
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.map_sums import MapSums
from sassgis.simulation.source_sums import SourceSums
from sassgis.terrain.plan import Plan

RECORD_NAME = "area.json"
_ENERGIES = "thresholds_kj"
#: Sums of the simulation, and of the same blocks without walls and nets.
SIMULATION_NAME, WITHOUT_BARRIERS_NAME = "simulation.npz", "without_barriers.npz"


@dataclass(frozen=True, slots=True)
class Record:
    """Record of a release area that has been run."""

    fingerprint: str  # of all that the result hangs on
    area: str
    # Outer corner of the part of the terrain model (m), and its cells.
    west: float
    north: float
    n_rows: int
    n_cols: int
    repetitions: int
    points: int  # release points
    rocks: int  # simulated blocks
    furthest_m: float | None  # longest run-out
    zones_m2: dict[str, float]  # area of the zones, by the code of the hazard level
    # Which stations and barriers, and which exposed objects, of those of the batch were in it.
    control_lines: tuple[int, ...]
    objects: tuple[int, ...]
    notices: tuple[str, ...]  # what the readers had to say
    sums_only: bool  # whether it has no separate maps and zones
    reached: int  # cells with counts, once for each block scenario
    # First row and column, and numbers of them, of the smallest part with all cells with counts.
    counted: tuple[int, int, int, int]
    never_started: int  # blocks
    frequencies: dict[str, float]  # blocks per year, by block scenario
    sums: dict[str, str]  # digests of the files of its sums

    def part(self, terrain: Terrain) -> Part:
        """Return the part on the lattice of a terrain model."""
        return Part(
            round((terrain.north - self.north) / terrain.cell_size),
            round((self.west - terrain.west) / terrain.cell_size),
            self.n_rows,
            self.n_cols,
        )


@dataclass(frozen=True, slots=True)
class Reached:
    """An area of the mosaic: its name, what is known of it, its folder, and its part."""

    name: str
    record: Record
    folder: Path
    part: Part

    @property
    def counted(self) -> Part:
        """The smallest part with all its counts."""
        row, col, n_rows, n_cols = self.record.counted
        return Part(self.part.row + row, self.part.col + col, n_rows, n_cols)


def write_record(folder: Path, record: Record) -> None:
    """Write what is known of an area into its folder."""
    plain = asdict(record)
    write_json(folder / RECORD_NAME, {**plain, "digest": json_digest(plain)})


def read_record(folder: Path, tell: Callable[[str], None]) -> Record | None:
    """Read the record of an area; None if the folder holds no whole result of a batch.

    A result whose record or sums are not as they were saved is none, which is reported.
    """
    file = folder / RECORD_NAME
    if not (file.is_file() and (folder / MANIFEST_NAME).is_file()):
        return None
    try:
        plain = json.loads(file.read_text(encoding="utf-8"))
        if plain.pop("digest") != json_digest(plain):
            raise ValueError
        lists = ("control_lines", "objects", "notices", "counted")
        record = Record(**plain | {name: tuple(plain[name]) for name in lists})
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        tell(unfit(file))
        return None
    now = digests_of_sums(folder)
    changed = sorted({name for name, _ in now.items() ^ record.sums.items()})
    for name in changed:
        tell(unfit(folder / name))
    return None if changed else record


def digests_of_sums(folder: Path) -> dict[str, str]:
    """Return digests of the files of sums of an area's folder, by name; empty for a damaged one."""
    files = [folder / name for name in (SIMULATION_NAME, WITHOUT_BARRIERS_NAME)]
    return {file.name: saved_digest(file) for file in files if file.is_file()}


def write_state(path: Path, progress: Progress, run: MapRun) -> None:
    """Write the sums of a simulation, with the energies of its hazard curves."""
    arrays = state_of(progress) | {_ENERGIES: bins_of(run).threshold}
    with writing(path):
        write_saved(path, arrays, "", compressed=True)


def read_state(
    area: Reached, without: bool = False, wanted: Callable[[str], bool] = lambda _name: True
) -> dict[str, NDArray[Any]]:
    """Read what write_state wrote into the folder of an area, or what is wanted of it.

    ``without`` walls and nets; where it has none, both are the same. InputError: the file is
    damaged, or not that of the record.
    """
    sums = area.record.sums
    name = WITHOUT_BARRIERS_NAME if without and WITHOUT_BARRIERS_NAME in sums else SIMULATION_NAME
    expected = "the sums of a release area; delete its folder to run it again"
    return saved_or_refused(area.folder / name, expected, sums[name], wanted)


def added_up(
    run: MapRun,
    place: Part,
    areas: Sequence[Reached],
    bins: Bins,
    *,
    without: bool = False,
    planned: Plan | None = None,
    only_energies_kj: FloatArray | None = None,
) -> Progress:
    """Add up what areas counted in the cells of a place, at stations, barriers and objects.

    Counts are whole numbers: the sums of a place are those of the whole that lie there. One area
    is in memory at a time. The positions of the areas are those of the sources.

    Parameters
    ----------
    run : MapRun
        With the settings of all areas; its grid is not looked at.
    without : bool
        Whether without walls and nets.
    planned : Plan, optional
        Of all areas: then fall lines, stops, reasons and run-out are added up as well.
    only_energies_kj : float64, shape (n,), optional
        Counts of single sources only at these energies, of those of ``bins``, without the sums of
        all blocks in a cell: a fraction of the memory.
    """
    control_lines = tuple(g for g, _ in run.control_lines)
    total = Progress(0, MapSums(place.n_rows * place.n_cols), ControlLineSums(control_lines))
    energies = bins.threshold if only_energies_kj is None else only_energies_kj
    share = run.stop_points_max / max(sum(a.record.rocks for a in areas), 1)
    stops: list[tuple[BlockRows, int]] = []
    begin = ("source.", "control_lines.", *(("sums.",) if only_energies_kj is None else ()))

    def wanted(name: str) -> bool:
        return planned is not None or name == _ENERGIES or name.startswith(begin)

    for i, area in enumerate(areas):
        state = read_state(area, without, wanted)
        lines = tuple(control_lines[k] for k in area.record.control_lines)
        sums = {k: state.pop(f"sums.{k}") for k in ("cells", *SUM_NAMES) if f"sums.{k}" in state}
        n_cells = area.part.n_rows * area.part.n_cols
        if planned is None:
            at_lines, by_source = counts_from(state, n_cells, lines)
        else:
            own = progress_from(state, n_cells, lines)
            at_lines, by_source = own.control_lines, own.sources
            first_point = int(np.flatnonzero(planned.points.area == i)[0])
            _add_blocks(total, own, first_point)
            share = min(share, own.stop_share)
            stops.append((evenly_kept(joined_rows(own.stops), run.seed, share), first_point))
        if only_energies_kj is None and len(sums) > 1:
            inside, cells = area.part.cells_in(place, sums["cells"])
            here = {k: wider(k, sums[k][inside], bins) for k in SUM_NAMES}
            total.sums.add(cells, here)
        # Those of single sources take much memory; only the table of design values needs them.
        of_sources = control_lines if planned is not None else ()
        total.control_lines.add_sums(at_lines, np.array(area.record.control_lines, np.int64))
        for (_, scenario), tally in sorted(by_source.items()):
            joined = SourceTally(
                SourceSums(energies.size), SourceSums(energies.size), ControlLineSums(of_sources),
                rocks=tally.rocks, never_started=tally.never_started,
                simulated=tally.simulated, heaviest=tally.heaviest,
            )  # fmt: skip
            _add_counts(joined, tally, place, area, _columns(state[_ENERGIES], energies))
            total.sources[i, scenario] = joined
    # One share of all areas: no more than any of them has kept.
    for rows, first_point in stops:
        kept = evenly_kept(rows, run.seed, share)
        kept.rocks["line"] += first_point
        total.stops.append(kept)
    return total


def _add_counts(
    joined: SourceTally,
    tally: SourceTally,
    place: Part,
    area: Reached,
    of_energies: tuple[IntArray, IntArray],
) -> None:
    """Add what a source of an area has counted: in cells, at stations and barriers, at objects.

    ``of_energies`` are the columns of the wanted energies, and those of the area's.
    """
    columns, counted = of_energies
    objects = np.array(area.record.objects, np.int64)

    def widened(counts: IntArray) -> IntArray:
        out = np.zeros((counts.shape[0], joined.cells.n_energies), np.int64)
        out[:, columns] = counts[:, counted]
        return out

    counts = tally.cells.counts()
    inside, cells = area.part.cells_in(place, counts.places)
    joined.cells.add(cells, *(widened(c[inside]) for c in (counts.count, counts.square)))
    counts = tally.objects.counts()
    joined.objects.add(objects[counts.places], widened(counts.count), widened(counts.square))
    if joined.control_lines.control_lines:
        lines = np.array(area.record.control_lines, np.int64)
        joined.control_lines.add_sums(tally.control_lines, lines)


def _add_blocks(total: Progress, own: Progress, first_point: int) -> None:
    """Add what became of the blocks of an area, whose release points begin at ``first_point``."""
    total.reasons += own.reasons
    total.simulated += own.simulated
    total.lost += own.lost
    total.pieces += own.pieces
    width = max(total.runout.shape[1], own.runout.shape[1])
    total.runout, more = (
        np.pad(r, ((0, 0), (0, width - r.shape[1]))) for r in (total.runout, own.runout)
    )
    total.runout += more
    total.lines += [replace(lines, point=lines.point + first_point) for lines in own.lines]
    if own.furthest is not None and (total.furthest is None or own.furthest[0] > total.furthest[0]):
        reach, line, scenario, rock = own.furthest
        total.furthest = (reach, line + first_point, scenario, rock)


def _columns(own: NDArray[Any], wanted: NDArray[Any]) -> tuple[IntArray, IntArray]:
    """Return columns of the wanted energies that an area has counts of, and those of the area."""
    columns = np.flatnonzero(wanted <= own.max(initial=-1.0))
    counted = np.searchsorted(own, wanted[columns])
    if not np.array_equal(own[counted], wanted[columns]):
        raise ValueError("hazard curves of areas have different energies")
    return columns, counted
