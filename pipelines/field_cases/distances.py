"""Distances between observed and simulated rocks, of quantities that all of them have."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from sassgis.gap.inference import distances
from sassgis.model.grid import FloatArray


def observed_scale(observed: FloatArray) -> FloatArray:
    """Standard deviation of each quantity among the observed rows, shape (p,); 1 without any."""
    spread = np.nanstd(observed, axis=0, ddof=1) if len(observed) > 1 else np.zeros(1)
    return np.where(spread > 1e-12, spread, 1.0)


def energy_distance(one: FloatArray, other: FloatArray) -> float:
    """2 E|X − Y| − E|X − X'| − E|Y − Y'| (Székely and Rizzo 2013) of rows of quantities."""
    x, y = (_whole(np.reshape(v, (len(v), -1))) for v in (one, other))
    return float(2.0 * cdist(x, y).mean() - cdist(x, x).mean() - cdist(y, y).mean())


def _whole(rows: FloatArray) -> FloatArray:
    whole: FloatArray = rows[np.isfinite(rows).all(axis=1)]
    return whole


def energy_scores(
    made: FloatArray, seen: FloatArray, scale: FloatArray | float = 1.0
) -> FloatArray:
    """Energy score of each rock (n, p) against its replicas (n, m, p)."""
    return distances.energy_scores(seen / scale, np.swapaxes(made, 0, 1) / scale)
