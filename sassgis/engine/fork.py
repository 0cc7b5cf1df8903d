"""Where the motion of a block without barriers leaves that with them.

Up to the first barrier that changes its motion a block moves the same with and without barriers.
What it was then is kept, and without them it goes on from there.
"""

from __future__ import annotations

from sassgis.compiled.jit import inlined, lean
from sassgis.engine.ellipse import CountedRows, Record, Records
from sassgis.engine.recording import CellWork
from sassgis.engine.state import Fork, Output, Site
from sassgis.settings.results import Outcome

_PASSED = int(Outcome.PASSED)


@inlined
def _copy(rows: CountedRows, to: CountedRows, more: int) -> None:
    """Copy rows, and so many after them."""
    for i in range(rows.n[0] + more):
        to.rows[i] = rows.rows[i]
    to.n[0] = rows.n[0]


@lean
def _copy_ground(site: Site, to: Site) -> None:
    """Copy the ground ahead, of profile and stretches with the row that ends them."""
    _copy(site.profile, to.profile, 1)
    _copy(site.stretches, to.stretches, 1)
    _copy(site.crossings, to.crossings, 0)


@inlined
def _copy_records(work: CellWork, at: int, to: CellWork, to_at: int) -> None:
    """Copy the records of a block in a cell."""
    for i in range(work.peak.shape[1]):
        to.peak[to_at, i] = work.peak[at, i]
    if work.chord.shape[0] > 0:
        for i in range(work.chord.shape[1]):
            to.chord[to_at, i] = work.chord[at, i]


@lean
def keep_fork(state: Record, site: Site, output: Output, n_passages: int) -> None:
    """Note that a barrier changes the motion of a block; keep what it is before, at the first.

    ``n_passages`` are its passages before the event.
    """
    fork = output.fork
    is_first = not state.hindered
    state.hindered = True
    if fork.state.size == 0 or not is_first:
        return
    fork.state[0] = state
    kept = fork.state[0]
    kept.n_passages = n_passages
    kept.events = state.events - 1
    kept.resumed = True
    if fork.ahead.profile.rows.size > 0:
        _copy_ground(site, fork.ahead)
    for k in range(state.n_touched):
        fork.cells.touched[k] = output.work.touched[k]
        _copy_records(output.work, output.work.touched[k], fork.cells, k)


@lean
def return_to_fork(
    states: Records, site: Site, cells: CellWork, fork: Fork, passages: CountedRows,
    to: CountedRows,
) -> bool:  # fmt: skip
    """Let a block that has moved with barriers be again what was kept of it.

    Its passages up to there are copied from the last of ``passages``, as rows of ``to`` that do not
    count yet. Returns whether there was room for them.
    """
    first = passages.n[0] - states[0].n_passages
    states[0] = fork.state[0]
    n_passages = states[0].n_passages
    if to.n[0] + n_passages > to.rows.size:
        return False
    for k in range(n_passages):
        row = to.rows[to.n[0] + k]
        to.rows[to.n[0] + k] = passages.rows[first + k]
        row.outcome = _PASSED
    if fork.ahead.profile.rows.size > 0:
        _copy_ground(fork.ahead, site)
    for i in range(site.crossings.n[0]):
        crossing = site.crossings.rows[i]
        crossing.seen = False
        for k in range(n_passages):
            if to.rows[to.n[0] + k].control_line == crossing.number:
                crossing.seen = True
    for k in range(states[0].n_touched):
        cell = fork.cells.touched[k]
        cells.touched[k] = cell
        _copy_records(fork.cells, k, cells, cell)
    return True
