"""What the kernel is told of a rock, its profile, the gates on it and the readings of the paper."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Profile(NamedTuple):
    """One profile with its segments' unit tangents and lengths."""

    sx: NDArray[np.float64]
    sz: NDArray[np.float64]
    tx: NDArray[np.float64]
    tz: NDArray[np.float64]
    length: NDArray[np.float64]
    angle: NDArray[np.float64]
    ground: NDArray[np.int32]


class ControlLines(NamedTuple):
    """Stations and barriers on one profile, by rising chainage."""

    x: NDArray[np.float64]
    z: NDArray[np.float64]
    kind: NDArray[np.int64]
    height: NDArray[np.float64]
    capacity: NDArray[np.float64]  # J
    control_line: NDArray[np.int64]  # number of the gate in the run


class Block(NamedTuple):
    """One rock."""

    a: float
    b: float
    c: float
    mass: float
    key: np.uint64


class Physics(NamedTuple):
    """EngineSettings as the kernel reads them."""

    gravity: float
    eta_rule: int
    slope_variation: bool
    rolling_threshold: float
    as_ellipse: bool
    end_sliding: bool
    tolerance: float
    max_events: int


class Course(NamedTuple):
    """Room for the events of a rock; none are kept where it has no rows.

    Columns: phase, t, x, z, vx, vz, theta, omega, segment, ux, uz (direction of the ground, or 0).
    """

    rows: NDArray[np.float64]
    filled: NDArray[np.int64]  # (1,) number of rows written
