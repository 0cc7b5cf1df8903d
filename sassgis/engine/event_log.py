"""Paths of blocks from their event logs."""

from __future__ import annotations

from itertools import pairwise

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
    s_parts: list[FloatArray] = []
    z_parts: list[FloatArray] = []
    for here, after in pairwise(log):
        duration = after["t_s"] - here["t_s"]
        if here["phase"] == FLIGHT and duration > 0.0:
            t = np.linspace(0.0, duration, max(int(np.ceil(duration / step_s)), 1), endpoint=False)
        else:
            t = np.zeros(1)
        s_parts.append(here["x_m"] + here["vx_mps"] * t)
        z_parts.append(here["z_m"] + (here["vz_mps"] - 0.5 * gravity * t) * t)
    s_parts.append(log["x_m"][-1:])
    z_parts.append(log["z_m"][-1:])
    return np.concatenate(s_parts), np.concatenate(z_parts)
