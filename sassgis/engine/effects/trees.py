"""Stems of a forest along the way of a block."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from sassgis.model import rng
from sassgis.model.effects import EffectSection
from sassgis.model.jit import kernel


@dataclass(frozen=True, slots=True)
class Trees(EffectSection):
    """Loss of energy on the stems of a forest.

    The energy that a stem takes is that of Dorren and Berger (2006, Tree Physiology 26: 63-71);
    the viscous force is as in RAMMS::ROCKFALL.
    """

    name: ClassVar[str] = "trees"

    form: Annotated[
        Literal["stems", "full_stems", "viscous"],
        '"stems": the block meets stems at random along its path; each takes at most '
        "38.7 DBH^2.31 J (DBH in cm), the less the farther from its middle it is hit. "
        '"full_stems": each takes efficiency of that wherever it is hit. "viscous": a force −k v '
        "while the block is below the crowns; drag_kgps is k",
    ] = "stems"
    efficiency: Annotated[
        float,
        Interval(ge=0.0, le=10.0),
        "share of the energy of a stem that counts, for both forms with stems",
    ] = 1.0
    drag_kgps: Annotated[float, Interval(ge=0.0, le=1e5), 'k of "viscous" (kg/s)'] = 300.0
    height_m: Annotated[
        float,
        Interval(ge=0.0, le=100.0),
        "stems take energy up to this height above the ground (m)",
    ] = 15.0

    @property
    def takes_anything(self) -> bool:
        """Whether a stand with these settings takes any energy."""
        strength = self.drag_kgps if self.form == "viscous" else self.efficiency
        return strength > 0.0 and self.height_m > 0.0


OFF, STEMS, FULL_STEMS, VISCOUS = 0, 1, 2, 3
# Share of the speed that the viscous force takes in a step, and the shortest such step.
_SHARE_PER_STEP = 0.1
_SHORTEST_STEP_S = 0.005
# A block within rounding of the height of the stems passes it in this time.
_SHORTEST_CUT_S = 1e-6


class Stand(NamedTuple):
    """Trees as the kernel reads it, and the forest on the cells of the chunk."""

    form: int
    efficiency: float
    drag: float  # kg/s
    height: float  # m
    stems: NDArray[np.float64]  # (n_cells,) per m²
    diameter: NDArray[np.float64]  # (n_cells,) at breast height (m)


@kernel
def stands_on(stand: Stand, cell: int) -> bool:
    """Whether forest stands on a cell."""
    return bool(cell >= 0 and stand.stems[cell] > 0.0)


@kernel
def stems_per_metre(stand: Stand, cell: int, width: float) -> float:
    """Stems that a block of some width meets on a metre of its way in plan.

    A stem is met if its axis lies within half the width of block and stem from the way.
    """
    if cell < 0 or stand.form == OFF or stand.form == VISCOUS:
        return 0.0
    return float(stand.stems[cell] * (width + stand.diameter[cell]))


@kernel
def to_next_stem(key: np.uint64, number: int) -> float:
    """Stems that are expected up to the next one that is met: exponential with mean 1."""
    return -math.log(rng.uniform(key, rng.STEM_DISTANCE, number))


@kernel
def share_taken(offset: float) -> float:
    """Share of the energy of a stem that a hit takes, by its distance from the middle.

    Dorren and Berger (2006), with the constants as Rockyfor3D has them (from memory).

    Parameters
    ----------
    offset : float
        Distance of the way from the axis of the stem over the largest at which it is met; 0 to 1.
        The tests behind the formula have half the diameter of the stem in its place: a block that
        is much wider than the stem then counts as a smaller one.
    """
    share = -0.046 + (0.98 + 0.046) / (1.0 + 10.0 ** ((0.58 - offset) * -8.007))
    return float(min(max(share, 0.0), 1.0))


@kernel
def stem_loss(stand: Stand, key: np.uint64, number: int, cell: int) -> float:
    """Energy that a stem takes (J)."""
    centimetres = 100.0 * stand.diameter[cell]
    most = 38.7 * centimetres**2.31 * stand.efficiency
    if stand.form == STEMS:
        return float(most * share_taken(rng.uniform(key, rng.STEM_OFFSET, number)))
    return float(most)


@kernel
def left_by_viscous(stand: Stand, cell: int, mass: float, time: float) -> float:
    """Share of the speed that the viscous forest leaves after a time."""
    if stand.form != VISCOUS or not stands_on(stand, cell):
        return 1.0
    return math.exp(-stand.drag * time / mass)


@kernel
def left_after_way(stand: Stand, cell: int, mass: float, speed: float, way: float) -> float:
    """Share of the speed that it leaves after a way along the ground: dv = -k/m dx."""
    if stand.form != VISCOUS or not stands_on(stand, cell) or speed <= 0.0:
        return 1.0
    return max(1.0 - stand.drag * way / (mass * speed), 0.0)


@kernel
def longest_step(stand: Stand, cell: int, mass: float) -> float:
    """Longest time between two turns of the viscous force (s): a tenth of the speed, or 5 ms."""
    if stand.form != VISCOUS or not stands_on(stand, cell):
        return np.inf
    return max(_SHARE_PER_STEP * mass / stand.drag, _SHORTEST_STEP_S)


@kernel
def time_to_height(stand: Stand, above: float, climb: float, gravity: float) -> tuple[bool, float]:
    """Whether a block in flight is below the height of the stems, and when that changes (s).

    Parameters
    ----------
    above : float
        Height of its centre above straight ground (m).
    climb : float
        How fast that grows (m/s).
    gravity : float
        (m/s²)
    """
    over = above - stand.height
    square = climb * climb + 2.0 * gravity * over
    if over >= 0.0:
        return False, max((climb + math.sqrt(square)) / gravity, _SHORTEST_CUT_S)
    if climb <= 0.0 or square <= 0.0:
        return True, np.inf
    return True, max((climb - math.sqrt(square)) / gravity, _SHORTEST_CUT_S)
