"""All effects of a run, as the kernel is given them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.effects.air_drag import Drag
from sassgis.engine.effects.entrainment import SetOff
from sassgis.engine.effects.fragmentation import Breaking
from sassgis.engine.effects.rock_shape import Shape
from sassgis.engine.effects.roughness import Rough
from sassgis.engine.effects.soft_ground import Soft
from sassgis.engine.effects.trees import Stand


class Effects(NamedTuple):
    """Every effect; its form is 0 where it is off."""

    drag: Drag
    stand: Stand
    soft: Soft
    rough: Rough
    shape: Shape
    breaking: Breaking
    set_off: SetOff


# Columns of a birth: a block that comes into being on the way of another, in flight.
BIRTH_COLUMNS = 11
(
    BORN_X, BORN_Z, BORN_VX, BORN_VZ, BORN_THETA, BORN_OMEGA, BORN_A, BORN_B, BORN_C, BORN_MASS,
    BORN_T,
) = range(BIRTH_COLUMNS)  # fmt: skip


class Spawned(NamedTuple):
    """Blocks that come into being in the course of one rock: pieces, and blocks set in motion."""

    rows: NDArray[np.float64]  # (room, BIRTH_COLUMNS)
    born: NDArray[np.int64]  # (1,), beyond the room if there was too little
    share: NDArray[np.float64]  # working space for the pieces of one break
    side: NDArray[np.float64]
