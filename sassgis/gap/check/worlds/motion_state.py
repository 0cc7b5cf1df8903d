"""State of a moving block, the ground that it moves on, and what is recorded of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.check.worlds.slopes import height_at, surface_at
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel

KeyArray = NDArray[np.uint64]
# Columns of a moving block.
X, Y, Z, VX, VY, VZ, HX, HY, PHI, SPIN = range(10)
A, B, C, DENSITY, TIME, MODE, COUNT, PIECE, KIND, HAND, NUMBER, CAMPAIGN = range(10, 22)
N_STATE = 22
FLY, ROLL, SLIDE, STOPPED, BROKEN = range(5)
ROCK, FRAGMENT, LOOSENED = range(3)
#: Blocks that a rock may become.
MAX_PIECES = 64
# Columns of the tables; the first three are rock, number of the piece, kind of block.
DEPOSIT_COLUMNS = ("x", "y", "z", "mass_kg", "volume_m3")
PASSAGE_COLUMNS = ("station", "x", "y", "z", "speed_mps", "rotation_hz", "height_m", "mass_kg")
IMPACT_COLUMNS = (
    "impact", "x", "y", "z", "slope_deg", "vt_in_mps", "vn_in_mps", "omega_in_radps",
    "vt_out_mps", "vn_out_mps", "omega_out_radps", "turn_deg", "mass_kg", "t_s",
)  # fmt: skip
TRACK_COLUMNS = ("t_s", "x", "y", "z", "speed_mps", "rotation_hz")


class Field(NamedTuple):
    """Ground and obstacles as the kernels read them."""

    z: FloatArray
    gx: FloatArray
    gy: FloatArray
    west: float
    north: float
    cell: float
    ground: IntArray
    law: FloatArray
    contact: int
    x0: float
    y0: float
    ux: float
    uy: float
    stations: FloatArray
    ob_start: IntArray
    ob_near: IntArray
    obstacles: FloatArray


class Waiting(NamedTuple):
    """Blocks that wait for their turn: state and key of each, how many wait and ever did."""

    states: FloatArray
    keys: KeyArray
    counts: IntArray


class Tables(NamedTuple):
    """Room for what is recorded, and how many rows are used."""

    deposits: FloatArray
    passages: FloatArray
    impacts: FloatArray
    tracks: FloatArray
    used: IntArray
    gain: FloatArray

    @classmethod
    def of(cls, room: Sequence[int] | IntArray, n: int) -> Tables:
        """Empty tables with room for so many rows, and ``n`` rocks."""
        columns = (DEPOSIT_COLUMNS, PASSAGE_COLUMNS, IMPACT_COLUMNS, TRACK_COLUMNS)
        deposits, passages, impacts, tracks = (
            np.zeros((k, 3 + len(names))) for k, names in zip(room, columns, strict=True)
        )
        gain = np.full(n, -1.0)
        return cls(deposits, passages, impacts, tracks, np.zeros(4, np.int64), gain)


@kernel
def chainage_of(f: Field, x: float, y: float) -> float:
    """Distance of a place down the slope (m)."""
    return (x - f.x0) * f.ux + (y - f.y0) * f.uy


@kernel
def mass_of(st: FloatArray) -> float:
    """Mass of a block (kg)."""
    return float(st[DENSITY] * 4.0 / 3.0 * math.pi * st[A] * st[B] * st[C])


@kernel
def cell_of(f: Field, x: float, y: float) -> tuple[int, int]:
    """Row and column of the cell in which a place lies, or of the nearest."""
    n_rows, n_cols = f.ground.shape
    i = min(max(int((f.north - y) / f.cell), 0), n_rows - 1)
    j = min(max(int((x - f.west) / f.cell), 0), n_cols - 1)
    return i, j


@kernel
def ground_at(f: Field, x: float, y: float) -> float:
    """Height of the ground (m)."""
    return height_at(f.z, f.west, f.north, f.cell, x, y)


@kernel
def slope_at(f: Field, st: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Height of the ground (m), and its slope in the plane of motion (rad)."""
    z, gx, gy = surface_at(f.z, f.west, f.north, f.cell, x, y)
    return z, math.atan(-(gx * st[HX] + gy * st[HY]))


@kernel
def rotated(x: float, y: float, angle: float) -> tuple[float, float]:
    """A vector turned to the left (rad); by the slope: parts along and away from the ground."""
    c = math.cos(angle)
    s = math.sin(angle)
    return x * c - y * s, x * s + y * c


@kernel
def along_of(st: FloatArray) -> float:
    """Horizontal speed (m/s)."""
    return math.sqrt(st[VX] ** 2 + st[VY] ** 2)


@kernel
def speed_of(st: FloatArray) -> float:
    """Speed of the centre of a block (m/s)."""
    return math.sqrt(st[VX] ** 2 + st[VY] ** 2 + st[VZ] ** 2)


@kernel
def rotation_of(st: FloatArray) -> float:
    """Turns per second (Hz)."""
    return float(abs(st[SPIN]) / (2.0 * math.pi))


@kernel
def set_velocity(st: FloatArray, vt: float, vn: float, slope: float) -> None:
    """Move at vt along a slope and vn away from it, in the plane of motion (m/s)."""
    along, st[VZ] = rotated(vt, vn, -slope)
    st[VX] = along * st[HX]
    st[VY] = along * st[HY]


@kernel
def face_velocity(st: FloatArray) -> None:
    """The plane of motion is that of the velocity."""
    along = along_of(st)
    if along > 1e-6:
        st[HX] = st[VX] / along
        st[HY] = st[VY] / along


@kernel
def angle_between(ax: float, ay: float, bx: float, by: float) -> float:
    """Angle from one direction in plan to another, to the left (rad)."""
    return math.atan2(ax * by - ay * bx, ax * bx + ay * by)


@kernel
def _write(
    table: FloatArray, used: IntArray, which: int, st: FloatArray, values: tuple[float, ...]
) -> None:
    # Where there is no room left the last row is written again: all is done anew with more.
    row = table[min(used[which], table.shape[0] - 1)]
    used[which] += 1
    row[0], row[1], row[2] = st[NUMBER], st[PIECE], st[KIND]
    for k, value in enumerate(values):
        row[3 + k] = value


@kernel
def write_deposit(f: Field, st: FloatArray, tables: Tables) -> None:
    """Record where a block stopped."""
    z, mass = ground_at(f, st[X], st[Y]), mass_of(st)
    values = (st[X], st[Y], z, mass, mass / st[DENSITY])
    _write(tables.deposits, tables.used, 0, st, values)


@kernel
def write_passage(f: Field, st: FloatArray, station: int, tables: Tables) -> None:
    """Record a block at a station."""
    place = (float(station), st[X], st[Y], st[Z])
    height = st[Z] - ground_at(f, st[X], st[Y])
    values = (*place, speed_of(st), rotation_of(st), height, mass_of(st))
    _write(tables.passages, tables.used, 1, st, values)


@kernel
def write_impact(
    f: Field,
    st: FloatArray,
    px: float,
    py: float,
    speeds: tuple[float, ...],
    turn: float,
    tables: Tables,
) -> None:
    """Record an impact: slope (deg), speeds and spin before and after, turn (rad)."""
    place = (st[COUNT], px, py, ground_at(f, px, py))
    values = (*place, *speeds, math.degrees(turn), mass_of(st), st[TIME])
    _write(tables.impacts, tables.used, 2, st, values)


@kernel
def write_track(st: FloatArray, tables: Tables) -> None:
    """Record a point along the path."""
    values = (st[TIME], st[X], st[Y], st[Z], speed_of(st), rotation_of(st))
    _write(tables.tracks, tables.used, 3, st, values)
