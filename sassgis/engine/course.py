"""Trajectories from the course of a rock's events."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from sassgis.engine.rock import FLIGHT
from sassgis.model.grid import FloatArray


def trajectory(
    course: FloatArray, gravity: float, step_s: float = 0.02
) -> tuple[FloatArray, FloatArray]:
    """Path of the centre of a rock.

    Parameters
    ----------
    course : float64, shape (n, 11)
        Events, columns as sassgis.engine.simulate.COURSE_COLUMNS.
    gravity : float
        (m/s²)
    step_s : float
        Time between two points of a flight (s).

    Returns
    -------
    s, z : float64, shape (m,)
        Chainage and height (m): parabolas in flight, straight lines on the ground.
    """
    if course.shape[0] == 0:
        return np.empty(0), np.empty(0)
    s_parts: list[FloatArray] = []
    z_parts: list[FloatArray] = []
    for here, after in pairwise(course):
        duration = after[1] - here[1]
        if int(here[0]) == FLIGHT and duration > 0.0:
            t = np.linspace(0.0, duration, max(int(np.ceil(duration / step_s)), 1), endpoint=False)
        else:
            t = np.zeros(1)
        s_parts.append(here[2] + here[4] * t)
        z_parts.append(here[3] + (here[5] - 0.5 * gravity * t) * t)
    s_parts.append(course[-1:, 2])
    z_parts.append(course[-1:, 3])
    return np.concatenate(s_parts), np.concatenate(z_parts)
