"""The saved state of a run on the map, so that nothing computed is lost.

The state is a folder ``checkpoint`` in the working folder of the result: ``state.npz`` with all
sums and the digests of numbered files of rows that have been handed on. It belongs to one
fingerprint of settings and inputs; with any other it is not used.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.files.atomic_output import CHECKPOINT_STEM, writing
from sassgis.files.saved_arrays import (
    read_saved,
    saved_digest,
    saved_or_refused,
    unfit,
    write_saved,
)
from sassgis.settings.map_run import BlockRows, FallLines, MapRun, Round, Worth
from sassgis.settings.results import ControlLine
from sassgis.simulation.accumulators import (
    Progress,
    SourceSums,
    SourceTally,
    WithoutBarriers,
    as_stations,
    joined_lines,
    joined_rows,
)
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.map_sums import MapSums

#: Plain numbers of a progress and of the tally of a source.
_NUMBERS: dict[str, Any] = {
    "chunks": int, "lost": int, "pieces": int, "simulated": int, "stop_share": float,
}  # fmt: skip
_ARRAYS = ("reasons", "runout", "scores")
_OF_SOURCE = ("rocks", "never_started", "simulated", "heaviest")
_ROW_FIELDS = tuple(f.name for f in fields(BlockRows))


class Checkpoint:
    """Saves and restores the progress of a run.

    ``work`` is the working folder of the result; without one nothing is saved. The fingerprint is
    that of settings and inputs; ``part`` distinguishes several simulations for one result.
    """

    def __init__(self, work: Path | None, fingerprint: str, part: str = "") -> None:
        self.folder = None if work is None else work / CHECKPOINT_STEM / part
        self._fingerprint = f"{fingerprint} {part}"
        self._waiting: list[BlockRows] = []
        self._digests: list[str] = []
        self._saved = time.monotonic()

    def restore(self, run: MapRun, tell: Callable[[str], None]) -> Progress | None:
        """Restore the progress of an earlier run with the same fingerprint, if one fits."""
        if self.folder is None:
            return None
        file = self.folder / "state.npz"
        state = read_saved(file, self._fingerprint, tell)
        if state is None:
            return None
        digests = state["parts"].tolist()
        for i, digest in enumerate(digests):
            if saved_digest(self._part(i)) != digest:
                tell(unfit(self._part(i)))
                return None
        n_rows, n_cols = run.grid.shape
        try:
            lines = tuple(line for line, _ in run.all_lines)
            found = progress_from(state, n_rows * n_cols, lines, run.compared)
        except (KeyError, IndexError, ValueError, TypeError):
            tell(unfit(file, "it is not whole"))
            return None
        self._digests = digests
        return found

    def hand_on(self, rows: BlockRows) -> None:
        """Take rows that are to be written to tables; they are saved with the next state."""
        if self.folder is not None:
            self._waiting.append(rows)

    def save(self, progress: Progress, every_s: float = 0.0) -> None:
        """Save the state, whole or not at all; not sooner than ``every_s`` after the last time."""
        if self.folder is None or time.monotonic() - self._saved < every_s:
            return
        with writing(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            if self._waiting:
                rows = joined_rows(self._waiting)
                own = {f: getattr(rows, f) for f in _ROW_FIELDS}
                part = self._part(len(self._digests))
                self._digests.append(write_saved(part, own, self._fingerprint))
                self._waiting = []
            state = state_of(progress) | {
                "parts": np.array(self._digests, np.str_),
                "seconds": np.array(progress.seconds),
            }
            write_saved(self.folder / "state.npz", state, self._fingerprint)
        self._saved = time.monotonic()

    def forget(self) -> None:
        """Remove what was saved, if anything: it is of no use any more."""
        if self.folder is not None:
            for file in (*self.rows(), self.folder / "state.npz"):
                file.unlink(missing_ok=True)

    @property
    def kept(self) -> str:
        """State in words what is kept when the user stops the run."""
        if self.folder is None:
            return ""
        kept = f"what was computed is kept in {self.folder}"
        return f"; {kept}: run the same command to resume"

    def rows(self) -> list[Path]:
        """Return files of the rows that were handed on, in order."""
        return [self._part(i) for i in range(len(self._digests))]

    def _part(self, number: int) -> Path:
        assert self.folder is not None
        return self.folder / f"rows_{number:06d}.npz"


def state_of(progress: Progress) -> dict[str, NDArray[np.generic]]:
    """Return all sums as plain arrays by name."""
    state: dict[str, NDArray[np.generic]] = {
        **{name: getattr(progress, name) for name in _ARRAYS},
        "rounds": np.array([(r.first, r.repetitions) for r in progress.rounds], np.int64),
        "history": np.array(progress.history, np.float64).reshape(-1, 2),
        "furthest_m": np.array((progress.furthest or ())[:1], np.float64),
        "furthest_rock": np.array((progress.furthest or ())[1:], np.int64),
        "tiles": np.concatenate([np.empty(0, np.int64), *progress.tiles]),
        "tiles_of_chunk": np.array([own.size for own in progress.tiles], np.int64),
        "reused": np.array(progress.reused, np.int64),
        "recounted": np.array(sorted(progress.recounted), np.int64).reshape(-1, 2),
        "new_lines": np.array(progress.new_lines, np.int64),
        "apart": np.array(progress.parts is not None),
    }
    for area, part in (progress.parts or {}).items():
        state |= {f"area.{area}.{name}": own for name, own in state_of(part).items()}
    state |= {name: np.array(getattr(progress, name)) for name in _NUMBERS}
    state |= {
        f"halvings.{i}": own.halvings
        for i, own in enumerate(progress.rounds)
        if own.halvings is not None
    }
    sums: dict[str, MapSums | ControlLineSums | SourceSums] = {
        "sums": progress.sums, "control_lines": progress.control_lines
    }  # fmt: skip
    # Sources of areas that are apart are those of their parts.
    for (area, scenario), tally in progress.sources.items() if progress.parts is None else ():
        name = f"source.{area}.{scenario}"
        state |= {f"{name}.{n}": np.array(getattr(tally, n)) for n in _OF_SOURCE}
        counted = ("cells", "objects", "control_lines")
        sums |= {f"{name}.{n}": getattr(tally, n) for n in counted}
        if tally.without is not None:
            state[f"{name}.without.never_started"] = np.array(tally.without.never_started)
            sums |= {f"{name}.without.{n}": getattr(tally.without, n) for n in counted}
    for name, added in sums.items():
        state |= {f"{name}.{k}": v for k, v in added.state().items()}
    records: list[tuple[str, FallLines | BlockRows | Worth]] = [
        ("lines", joined_lines(progress.lines)), ("stops", joined_rows(progress.stops)),
        *([] if progress.worth is None else [("worth", progress.worth)]),
    ]  # fmt: skip
    for name, record in records:
        state |= {f"{name}.{f.name}": getattr(record, f.name) for f in fields(record)}
    return state


def progress_from(
    state: dict[str, Any],
    n_cells: int,
    lines: tuple[ControlLine, ...],
    compared: int | None = None,
) -> Progress:
    """Restore a run's progress from its state, grid cells, stations and barriers.

    Of the lines, the first ``compared`` are met with barriers, or all.
    """
    at_lines, sources = counts_from(state, n_cells, lines, compared)
    areas = {int(name.split(".")[1]) for name in state if name.startswith("area.")}
    parts = {
        area: progress_from(_group(state, f"area.{area}"), n_cells, lines, compared)
        for area in sorted(areas)
    }
    for part in parts.values():
        sources |= part.sources
    worth = _group(state, "worth")
    furthest: Any = (*state["furthest_m"].tolist(), *state["furthest_rock"].tolist())
    plain: dict[str, Any] = {name: np.array(state[name]) for name in _ARRAYS}
    plain |= {name: kind(state[name]) for name, kind in _NUMBERS.items()}
    return Progress(
        sums=MapSums.from_state(n_cells, _group(state, "sums")),
        control_lines=at_lines,
        rounds=tuple(
            Round(int(first), int(repetitions), state.get(f"halvings.{i}"))
            for i, (first, repetitions) in enumerate(state["rounds"])
        ),
        history=[(int(blocks), float(share)) for blocks, share in state["history"]],
        furthest=furthest or None,
        # Of what is kept as a result it says nothing.
        seconds=float(state.get("seconds", 0.0)),
        worth=Worth(**worth) if worth else None,
        parts=parts if state["apart"] else None,
        tiles=np.split(state["tiles"], np.cumsum(state["tiles_of_chunk"]))[:-1],
        reused=tuple(state["reused"].tolist()),
        recounted=frozenset((area, chunk) for area, chunk in state["recounted"].tolist()),
        new_lines=tuple(state["new_lines"].tolist()),
        sources=sources,
        lines=[FallLines(**_group(state, "lines"))],
        stops=[BlockRows(**_group(state, "stops"))],
        **plain,
    )


def counts_from(
    state: dict[str, Any],
    n_cells: int,
    lines: tuple[ControlLine, ...],
    compared: int | None = None,
) -> tuple[ControlLineSums, dict[tuple[int, int], SourceTally]]:
    """Restore passages at control lines, and counts by source, from a state or part of it.

    ``compared`` as for progress_from. The sources keep their order. ValueError: there are counts
    outside of the grid.
    """
    counted = [own for name, own in state.items() if name.endswith(("sums.cells", "cells.places"))]
    if any(((own < 0) | (own >= n_cells)).any() for own in counted):
        raise ValueError("cells outside of the grid")

    def counts(
        name: str, at: tuple[ControlLine, ...]
    ) -> tuple[SourceSums, SourceSums, ControlLineSums]:
        return (
            SourceSums.from_state(_group(state, f"{name}.cells")),
            SourceSums.from_state(_group(state, f"{name}.objects")),
            ControlLineSums.from_state(at, _group(state, f"{name}.control_lines")),
        )

    def without_barriers(name: str) -> WithoutBarriers | None:
        never_started = state.get(f"{name}.never_started")
        if never_started is None:
            return None
        cells, objects, at_lines = counts(name, as_stations(lines))
        return WithoutBarriers(cells, objects, at_lines, int(never_started))

    met = lines[:compared]
    sources = {}
    for rocks in [name for name in state if re.fullmatch(r"source\.\d+\.\d+\.rocks", name)]:
        name = rocks.removesuffix(".rocks")
        _, area, scenario = name.split(".")
        cells, objects, at_lines = counts(name, met)
        sources[int(area), int(scenario)] = SourceTally(
            cells, objects, at_lines, **{n: int(state[f"{name}.{n}"]) for n in _OF_SOURCE},
            without=without_barriers(f"{name}.without"),
        )  # fmt: skip
    return ControlLineSums.from_state(met, _group(state, "control_lines")), sources


def read_rows(part: Path) -> BlockRows:
    """Return rows of one file of a checkpoint; InputError if it is damaged."""
    stored = saved_or_refused(part, "rows of an earlier attempt; delete its folder to begin anew")
    return BlockRows(*(stored[f] for f in _ROW_FIELDS))


def _group(state: dict[str, Any], name: str) -> dict[str, Any]:
    start = name + "."
    return {k.removeprefix(start): v for k, v in state.items() if k.startswith(start)}
