"""Paths of blocks from their event logs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.state import FLIGHT
from sassgis.model.grid import FloatArray


def trajectory(
    log: NDArray[np.void], gravity: float, step_s: float = 0.02
) -> tuple[FloatArray, FloatArray]:
    """Path of the centre of a block.

    Parameters
    ----------
    log : EVENT_DTYPE, shape (n,)
    gravity : float
        (m/s²)
    step_s : float
        Time between two points of a flight (s).

    Returns
    -------
    s, z : float64, shape (m,)
        Chainage and height (m): parabolas in flight, straight lines on the ground.
    """
    if log.size == 0:
        return np.empty(0), np.empty(0)
    duration = np.append(np.diff(log["t_s"]), 0.0)
    duration[log["phase"] != FLIGHT] = 0.0
    points = np.maximum(np.ceil(duration / step_s), 1.0).astype(np.int64)
    of = np.repeat(np.arange(log.size), points)
    number = np.arange(of.size) - np.repeat(np.cumsum(points) - points, points)
    t = number * (duration / points)[of]
    s = log["x_m"][of] + log["vx_mps"][of] * t
    return s, log["z_m"][of] + (log["vz_mps"][of] - 0.5 * gravity * t) * t
