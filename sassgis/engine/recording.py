"""What a moving rock leaves behind: cells it passes, stations, the course of its events.

The cells under a profile come as stretches ("pieces") that are also cut at the profile's vertices,
so that the ground is straight in each. Within a piece of a flight the speed is greatest at an end and
the height above ground is a concave parabola, so all maxima are exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.core.jit import kernel


class Pieces(NamedTuple):
    """The profile of one line cut at cell borders and vertices."""

    border: NDArray[np.float64]  # (n + 1,) chainage (m)
    cell: NDArray[np.int64]  # (n,) position in the chunk's cells, -1 for none
    segment: NDArray[np.int64]  # (n,)


class CellWork(NamedTuple):
    """Maxima of one rock in each cell of a chunk; energy is -1 where it has not been."""

    energy: NDArray[np.float64]  # per unit mass (J/kg)
    height: NDArray[np.float64]  # (m)
    speed: NDArray[np.float64]  # (m/s)
    touched: NDArray[np.int64]  # cells in the order in which they were entered


@kernel
def _raise(work, n_touched, cell, energy, height, speed):
    """Raise the maxima of a cell; returns the new number of cells touched."""
    if work.energy[cell] < 0.0:
        work.touched[n_touched] = cell
        n_touched += 1
        work.energy[cell] = energy
        work.height[cell] = height
        work.speed[cell] = speed
        return n_touched
    work.energy[cell] = max(work.energy[cell], energy)
    work.height[cell] = max(work.height[cell], height)
    work.speed[cell] = max(work.speed[cell], speed)
    return n_touched


@kernel
def record_flight(
    pieces, work, n_touched, piece, x, z, vx, vz, spin_energy, gravity, until, rest, sx, sz, tx, tz
):
    """Record the cells under a flight.

    Parameters
    ----------
    pieces, work : Pieces, CellWork
    n_touched, piece : int
        Cells touched so far; the piece under the centre.
    x, z, vx, vz : float
        State at the start of the flight.
    spin_energy : float
        Per unit mass (J/kg).
    gravity, until : float
        (m/s²), duration (s).
    rest : float
        The shorter semi-axis (m): over cos β it is the resting height.
    sx, sz, tx, tz : float64 arrays
        The profile.

    Returns
    -------
    n_touched, piece : int
    top : float
        Greatest passing height (m).
    """
    n = pieces.cell.size
    while piece > 0 and pieces.border[piece] > x:
        piece -= 1
    while piece < n - 1 and pieces.border[piece + 1] < x:
        piece += 1
    x_end = x + vx * until
    now = 0.0
    top = 0.0
    step = 1 if vx >= 0.0 else -1
    while True:
        if step > 0:
            border = pieces.border[piece + 1]
            inside = border >= x_end or piece == n - 1
        else:
            border = pieces.border[piece]
            inside = border <= x_end or piece == 0
        leave = until if inside else (border - x) / vx
        leave = min(max(leave, now), until)
        cell = pieces.cell[piece]
        j = pieces.segment[piece]
        slope = tz[j] / tx[j]
        ground = sz[j] + slope * (x - sx[j])
        clear = rest / tx[j]
        w0 = vz - gravity * now
        w1 = vz - gravity * leave
        lift = vz - slope * vx
        high = z - ground + (lift - 0.5 * gravity * now) * now
        high = max(high, z - ground + (lift - 0.5 * gravity * leave) * leave)
        apex = lift / gravity
        if now < apex < leave:
            high = max(high, z - ground + 0.5 * lift * apex)
        high = max(high - clear, 0.0)
        top = max(top, high)
        if cell >= 0:
            half = 0.5 * (vx * vx + max(w0 * w0, w1 * w1))
            n_touched = _raise(work, n_touched, cell, half + spin_energy, high, np.sqrt(2.0 * half))
        if inside:
            return n_touched, piece, top
        now = leave
        piece += step


@kernel
def record_ground(pieces, work, n_touched, piece, x, x_end, v2, dv2, spin, dspin, chord):
    """Record the cells under a stretch of rolling or sliding.

    Parameters
    ----------
    x, x_end : float
        Chainage of the centre at both ends (m).
    v2, dv2 : float
        Speed squared at the start, and its change over the whole stretch (m²/s²).
    spin, dspin : float
        Rotational energy per unit mass at the start, and its change (J/kg).
    chord : float
        Chainage of the whole stretch, positive (m); speeds squared are linear in it.
    """
    n = pieces.cell.size
    while piece > 0 and pieces.border[piece] > x:
        piece -= 1
    while piece < n - 1 and pieces.border[piece + 1] < x:
        piece += 1
    step = 1 if x_end >= x else -1
    done = 0.0
    while True:
        if step > 0:
            border = pieces.border[piece + 1]
            inside = border >= x_end or piece == n - 1
        else:
            border = pieces.border[piece]
            inside = border <= x_end or piece == 0
        share = 1.0
        if not inside and chord > 0.0:
            share = min(max(abs(border - x) / chord, done), 1.0)
        cell = pieces.cell[piece]
        if cell >= 0:
            fast = max(v2 + dv2 * done, v2 + dv2 * share)
            energy = 0.5 * fast + max(spin + dspin * done, spin + dspin * share)
            n_touched = _raise(work, n_touched, cell, energy, 0.0, np.sqrt(max(fast, 0.0)))
        if inside:
            return n_touched, piece
        done = share
        piece += step
