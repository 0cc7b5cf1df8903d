"""Records of a moving block in the cells that it enters: its maxima and its time of arrival.

The cells under a profile come as stretches that are also cut at the profile's vertices, so that
the ground is straight in each. Over a stretch the speed of a flight is greatest at an end and its
height above ground is a concave parabola, so all maxima are exact. So is the time at a cell's
border: chainage is linear in time in flight, and on the ground resistance.py has it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import lean
from sassgis.engine.ellipse import CountedRows, record_type
from sassgis.engine.resistance import share_gained, time_over
from sassgis.settings.statistics_table import QUANTITIES

#: Columns of what is recorded: energy per unit mass (J/kg), -1 where the block has not been; height
#: (m); speed squared (m²/s²); time since the release at the first entry (s).
N_RECORDED = len(QUANTITIES)
ENERGY, HEIGHT, SPEED2, ARRIVAL = range(N_RECORDED)

#: The profile of one line cut at cell borders and vertices; the last row has only its start.
STRETCH_DTYPE = record_type(
    ("start", np.float64),  # chainage (m)
    ("cell", np.int64),  # position in the chunk's cells, -1 for none
    ("segment", np.int64),
    ("stems", np.float64),  # of the forest there, per m²
    ("diameter", np.float64),  # of the stems at breast height (m)
    ("u", np.float64),  # of the start on the map: columns from the west edge of the grid
    ("v", np.float64),  # rows from its north edge
)


class CellWork(NamedTuple):
    """Records of one block in each cell of a chunk; what is touched together lies together."""

    peak: NDArray[np.float64]  # (n, N_RECORDED), columns as above
    touched: NDArray[np.int64]  # cells in the order in which they were entered
    chord: NDArray[np.float64]  # (n, 4): u, v at both ends of the path there; (0, 4): not kept


def empty_work(n_cells: int, chords: bool) -> CellWork:
    """Return room for what a block does in cells and, if wanted, for its paths there."""
    return CellWork(
        np.full((n_cells, N_RECORDED), -1.0),
        np.zeros(n_cells, np.int64),
        np.zeros((n_cells if chords else 0, 4)),
    )


@lean
def _raise(
    work: CellWork, n_touched: int, cell: int, energy: float, height: float, speed2: float,
    t: float,
) -> int:  # fmt: skip
    """Raise the maxima of a cell that is entered at time t; returns the number of cells touched."""
    peak = work.peak
    if peak[cell, ENERGY] < 0.0:
        work.touched[n_touched] = cell
        peak[cell, ENERGY] = energy
        peak[cell, HEIGHT] = height
        peak[cell, SPEED2] = speed2
        peak[cell, ARRIVAL] = t
        return n_touched + 1
    peak[cell, ENERGY] = max(peak[cell, ENERGY], energy)
    peak[cell, HEIGHT] = max(peak[cell, HEIGHT], height)
    peak[cell, SPEED2] = max(peak[cell, SPEED2], speed2)
    return n_touched


@lean
def stretch_at(stretches: CountedRows, x: float, near: int) -> int:
    """Return the stretch under chainage x."""
    i = near
    while i > 0 and stretches.rows[i].start > x:
        i -= 1
    while i < stretches.n[0] - 1 and stretches.rows[i + 1].start < x:
        i += 1
    return i


@lean
def _on_map(stretches: CountedRows, i: int, x: float) -> tuple[float, float]:
    """Return the place on the map (u, v) of chainage x in stretch i, which is straight there."""
    here = stretches.rows[i]
    after = stretches.rows[i + 1]
    length = after.start - here.start
    share = min(max((x - here.start) / length, 0.0), 1.0) if length > 0.0 else 0.0
    return here.u + share * (after.u - here.u), here.v + share * (after.v - here.v)


@lean
def _pass(
    stretches: CountedRows, work: CellWork, i: int, step: int, x_end: float, inside: bool,
    first: bool, u: float, v: float,
) -> tuple[float, float]:  # fmt: skip
    """Note the path of a block across stretch i from (u, v) on; returns where it leaves.

    Within a cell it is taken as straight between the ends farthest from each other.
    """
    ahead = stretches.rows[i + 1] if step > 0 else stretches.rows[i]
    u_end, v_end = _on_map(stretches, i, x_end) if inside else (ahead.u, ahead.v)
    cell = stretches.rows[i].cell
    if cell < 0:
        return u_end, v_end
    chord = work.chord[cell]
    if first:
        chord[0] = u
        chord[1] = v
        chord[2] = u_end
        chord[3] = v_end
        return u_end, v_end
    length2 = (chord[2] - chord[0]) ** 2 + (chord[3] - chord[1]) ** 2
    if (u_end - chord[0]) ** 2 + (v_end - chord[1]) ** 2 > length2:
        chord[2] = u_end
        chord[3] = v_end
    elif (u_end - chord[2]) ** 2 + (v_end - chord[3]) ** 2 > length2:
        chord[0] = u_end
        chord[1] = v_end
    return u_end, v_end


@lean
def record_flight(
    stretches: CountedRows, work: CellWork, n_touched: int, i: int, x: float, z: float, vx: float,
    vz: float, spin_energy: float, gravity: float, until: float, t: float, rest: float,
    profile: CountedRows,
) -> tuple[int, int, float]:  # fmt: skip
    """Record the cells under a flight of a duration ``until`` (s) from time t since the release on.

    Parameters
    ----------
    n_touched, i : int
        Cells touched so far; the stretch under the centre. Both are returned, as they are then.
    spin_energy : float
        Per unit mass (J/kg).
    rest : float
        The shorter semi-axis (m): over cos β it is the resting height.

    Returns
    -------
    top : float
        Last of three: greatest passing height (m).
    """
    n = stretches.n[0]
    i = stretch_at(stretches, x, i)
    x_end = x + vx * until
    per_vx = 1.0 / vx if vx != 0.0 else 0.0
    per_gravity = 1.0 / gravity
    now = 0.0
    top = 0.0
    step = 1 if vx >= 0.0 else -1
    segment = -1
    lift = above = clear = apex = 0.0
    before = vz * vz
    chords = work.chord.shape[0] > 0
    u, v = _on_map(stretches, i, x) if chords else (0.0, 0.0)
    while True:
        if step > 0:
            border = stretches.rows[i + 1].start
            inside = border >= x_end or i == n - 1
        else:
            border = stretches.rows[i].start
            inside = border <= x_end or i == 0
        leave = until if inside else (border - x) * per_vx
        leave = min(max(leave, now), until)
        j = stretches.rows[i].segment
        if j != segment:
            # Height above this segment: above + lift t − gravity t²/2.
            segment = j
            here = profile.rows[j]
            slope = here.tz / here.tx
            above = z - here.z - slope * (x - here.x)
            clear = rest / here.tx
            lift = vz - slope * vx
            apex = lift * per_gravity
        after = vz - gravity * leave
        after *= after
        high = max(
            above + (lift - 0.5 * gravity * now) * now,
            above + (lift - 0.5 * gravity * leave) * leave,
        )
        if now < apex < leave:
            high = max(high, above + 0.5 * lift * apex)
        high = max(high - clear, 0.0)
        top = max(top, high)
        cell = stretches.rows[i].cell
        n_before = n_touched
        if cell >= 0:
            speed2 = vx * vx + max(before, after)
            n_touched = _raise(
                work, n_touched, cell, 0.5 * speed2 + spin_energy, high, speed2, t + now
            )
        if chords:
            first = n_touched > n_before
            u, v = _pass(stretches, work, i, step, x_end, inside, first, u, v)
        if inside:
            return n_touched, i, top
        before = after
        now = leave
        i += step


@lean
def record_stop(
    stretches: CountedRows, work: CellWork, n_touched: int, i: int, x: float, t: float
) -> int:
    """Record the cell of stretch i, where a block comes to rest; returns the cells touched.

    A block that lands softly is moved to where it rolls or slides: no path leads to that cell.
    """
    cell = stretches.rows[i].cell
    if work.peak[cell, ENERGY] >= 0.0:
        return n_touched
    if work.chord.shape[0] > 0:
        chord = work.chord[cell]
        chord[0], chord[1] = _on_map(stretches, i, x)
        chord[2], chord[3] = chord[0], chord[1]
    return _raise(work, n_touched, cell, 0.0, 0.0, 0.0, t)


@lean
def record_ground(
    stretches: CountedRows, work: CellWork, n_touched: int, i: int, x: float, x_end: float,
    v2: float, dv2: float, spin: float, dspin: float, chord: float, length: float, t: float,
    steady: float, fade: float,
) -> tuple[int, int]:  # fmt: skip
    """Record the cells under a stretch of rolling or sliding from chainage x to x_end (m).

    Parameters
    ----------
    v2, dv2 : float
        Speed squared at the start, and its change over the whole stretch (m²/s²).
    spin, dspin : float
        Rotational energy per unit mass at the start, and its change (J/kg).
    chord, length : float
        Chainage, positive, and distance along the ground of the whole stretch (m).
    t : float
        Time since the release at the start (s).
    steady, fade : float
        Acceleration without speed (m/s²) and how it falls (1/m), as in resistance.py.
    """
    n = stretches.n[0]
    i = stretch_at(stretches, x, i)
    step = 1 if x_end >= x else -1
    done = gone = 0.0
    fading = 2.0 * fade * length
    chords = work.chord.shape[0] > 0
    u, v = _on_map(stretches, i, x) if chords else (0.0, 0.0)
    while True:
        if step > 0:
            border = stretches.rows[i + 1].start
            inside = border >= x_end or i == n - 1
        else:
            border = stretches.rows[i].start
            inside = border <= x_end or i == 0
        way = share = 1.0
        if not inside and chord > 0.0:
            way = min(max(abs(border - x) / chord, gone), 1.0)
            share = share_gained(way, fading)
        cell = stretches.rows[i].cell
        n_before = n_touched
        if cell >= 0:
            fast = max(v2 + dv2 * done, v2 + dv2 * share)
            energy = 0.5 * fast + max(spin + dspin * done, spin + dspin * share)
            enters = t
            if done > 0.0 and work.peak[cell, ENERGY] < 0.0:
                now = math.sqrt(max(v2 + dv2 * done, 0.0))
                enters += time_over(steady, fade, math.sqrt(v2), now, length * gone)
            n_touched = _raise(work, n_touched, cell, energy, 0.0, max(fast, 0.0), enters)
        if chords:
            first = n_touched > n_before
            u, v = _pass(stretches, work, i, step, x_end, inside, first, u, v)
        if inside:
            return n_touched, i
        done = share
        gone = way
        i += step
