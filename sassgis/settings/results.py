"""Results of a run: rows per block and per passage, and layers for the map."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sassgis.settings.languages import named, phrase


class StopReason(IntEnum):
    """Why the simulation of a block stops."""

    REST = 0
    BARRIER = 1
    LEFT_PROFILE = 2
    STEP_LIMIT = 3
    NEVER_STARTED = 4
    BROKEN = 5


class Outcome(IntEnum):
    """Outcome of a block at a station or barrier."""

    PASSED = 0
    STOPPED = 1
    OVERTOPPED = 2
    BROKE_THROUGH = 3
    HELD_BY_NET = 4


#: One row per block, and per fragment or entrained block: ``piece`` is 0 for the
#: block itself. Chainages in m along the profile; ``line`` counts the profiles of the run.
ROCK_DTYPE = np.dtype(
    [
        ("line", np.int64),
        ("rock", np.int32),
        ("piece", np.int32),
        ("reason", np.uint8),
        ("start_m", np.float64),
        ("runout_m", np.float64),
        ("runout_z_m", np.float64),
        ("furthest_m", np.float64),
        ("time_s", np.float64),
        ("impacts", np.int32),
        ("a_m", np.float64),
        ("b_m", np.float64),
        ("c_m", np.float64),
        ("density_kgm3", np.float64),
        ("mass_kg", np.float64),
        ("max_speed_mps", np.float64),
        ("max_height_m", np.float64),
        ("max_energy_kj", np.float64),
    ]
)

#: One row per block and station or barrier: the first time that the block reaches it downhill.
#: ``height_m`` is the vertical distance from the ground to the centre, less the resting height.
PASSAGE_DTYPE = np.dtype(
    [
        ("control_line", np.int32),
        ("line", np.int64),
        ("rock", np.int32),
        ("outcome", np.uint8),
        ("chainage_m", np.float64),
        ("speed_mps", np.float64),
        ("vx_mps", np.float64),
        ("vz_mps", np.float64),
        ("rotation_hz", np.float64),
        ("height_m", np.float64),
        ("energy_trans_kj", np.float64),
        ("energy_rot_kj", np.float64),
        ("mass_kg", np.float64),
        ("x_m", np.float64),  # place on the map where a path is followed; on given lines NaN
        ("y_m", np.float64),
    ]
)


@dataclass(frozen=True, slots=True)
class ControlLine:
    """A station or a barrier."""

    name: str
    kind: Literal["station", "wall", "net"]
    height_m: float = 0.0  # height of the top above the ground, vertical (m); unused for a station
    # Energy that the barrier takes (kJ); infinite if it stops every block that meets it.
    capacity_kj: float = float("inf")
    # Whether a block that the barrier takes is only brought to zero speed there and then moves on,
    # as the paper saw nets do, instead of being stopped for good.
    restarts_from_rest: bool = False

    @property
    def described(self) -> str:
        """The name of a station; that of a barrier with its kind and height."""
        if self.kind == "station":
            return named(self.name)
        text = "{} (wall, {} m)" if self.kind == "wall" else "{} (net, {} m)"
        return phrase(text, self.name, f"{self.height_m:g}")


@dataclass(frozen=True, slots=True)
class Histogram:
    """Counts between edges; the first and the last bin also hold what lies beyond them."""

    edges: NDArray[np.float64]  # shape (n_bins + 1,)
    counts: NDArray[np.int64]  # shape (..., n_bins)
    unit: str


@dataclass(frozen=True, slots=True)
class Band:
    """One band of a map: float32, shape (n_rows, n_cols), NaN where there is nothing."""

    name: str
    description: str
    unit: str
    values: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class RasterClass:
    """Meaning of a whole number on a map of classes; ``hatched`` asks for lines in the colour."""

    value: int
    label: str
    colour: str
    hatched: bool = False


@dataclass(frozen=True, slots=True)
class RasterLayer:
    """A map to be written as one file."""

    stem: str  # file name without suffix, also the key of its style
    title: str  # name in the legend, with the unit
    note: str  # what the numbers mean: denominator, resolution, reference width
    bands: tuple[Band, ...]  # the first is the one shown
    # Class limits for the legend, ascending; empty: a continuous ramp over the data's range.
    breaks: tuple[float, ...]
    ramp: str  # of :mod:`sassgis.settings.styles`
    # For a map of classes: the values of the first band are theirs; ``breaks`` is empty.
    classes: tuple[RasterClass, ...] = ()
