"""Paths of single blocks in space."""

from __future__ import annotations

from dataclasses import dataclass

from sassgis.model.grid import FloatArray
from sassgis.model.results import StopReason


@dataclass(frozen=True, slots=True)
class BlockPath:
    """The path of the centre of a block, and how it ended.

    Attributes
    ----------
    x, y, z : float64, shape (n,)
        Coordinates of the map and height (m); at least two points.
    max_energy_kj, max_speed_mps, max_height_m : float
        The largest on the path.
    """

    area: str
    scenario: str
    x: FloatArray
    y: FloatArray
    z: FloatArray
    reason: StopReason
    runout_m: float
    time_s: float
    mass_kg: float
    max_energy_kj: float
    max_speed_mps: float
    max_height_m: float
