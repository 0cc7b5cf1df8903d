"""State of a moving block, and the ground and tables that the kernels share."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel

KeyArray = NDArray[np.uint64]
# Columns of a moving block.
X, Y, Z, VX, VY, VZ, HX, HY, PHI, SPIN = range(10)
A, B, C, DENSITY, TIME, MODE, COUNT, PIECE, KIND, HAND = range(10, 20)
N_STATE = 20
FLY, ROLL, SLIDE, STOPPED, BROKEN = range(5)
ROCK, FRAGMENT, LOOSENED = range(3)
#: Blocks that a rock may become.
MAX_PIECES = 64
# Columns of the tables; the first three are rock, number of the piece, kind of block.
DEPOSIT_COLUMNS = ("x", "y", "z", "mass_kg", "volume_m3")
PASSAGE_COLUMNS = ("station", "x", "y", "z", "speed_mps", "rotation_hz", "height_m", "mass_kg")

IMPACT_COLUMNS = (
    "impact",
    "x",
    "y",
    "z",
    "slope_deg",
    "vt_in_mps",
    "vn_in_mps",
    "omega_in_radps",
    "vt_out_mps",
    "vn_out_mps",
    "omega_out_radps",
    "turn_deg",
    "mass_kg",
    "t_s",
)

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


class Tables(NamedTuple):
    """Room for what is recorded, and how many rows are used."""

    deposits: FloatArray
    passages: FloatArray
    impacts: FloatArray
    tracks: FloatArray
    used: IntArray
    gain: FloatArray


@kernel
def chainage_of(f: Field, st: FloatArray) -> float:
    """Distance of a block down the slope (m)."""
    return float((st[X] - f.x0) * f.ux + (st[Y] - f.y0) * f.uy)


@kernel
def mass_of(st: FloatArray) -> float:
    """Mass of a block (kg)."""
    return float(st[DENSITY] * 4.0 / 3.0 * math.pi * st[A] * st[B] * st[C])


@kernel
def law_at(f: Field, x: float, y: float) -> FloatArray:
    """Parameters of the ground at a place."""
    n_rows, n_cols = f.ground.shape
    i = min(max(int((f.north - y) / f.cell), 0), n_rows - 1)
    j = min(max(int((x - f.west) / f.cell), 0), n_cols - 1)
    law: FloatArray = f.law[f.ground[i, j]]
    return law


@kernel
def face_velocity(st: FloatArray) -> None:
    """The plane of motion is that of the velocity."""
    along = math.sqrt(st[VX] ** 2 + st[VY] ** 2)
    if along > 1e-6:
        st[HX] = st[VX] / along
        st[HY] = st[VY] / along


@kernel
def speed_of(st: FloatArray) -> float:
    """Speed of the centre of a block (m/s)."""
    return math.sqrt(st[VX] ** 2 + st[VY] ** 2 + st[VZ] ** 2)
