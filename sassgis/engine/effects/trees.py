"""Stems of a forest on the path of a block."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Interval

from sassgis.engine.profile import segment_at, to_cell_border
from sassgis.engine.rows import Record
from sassgis.engine.state import Block, Site
from sassgis.model import rng
from sassgis.model.effects import EffectSection
from sassgis.model.errors import ConfigError
from sassgis.model.jit import lean
from sassgis.model.tree_species import energy_ratios


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
        "38.7 DBH^2.31 J (DBH in cm) of fir, the less the farther from its middle it is hit. "
        '"full_stems": each takes all of that wherever it is hit. "viscous": a force −k v '
        "while the block is below the crowns; drag_kgps is k",
    ] = "stems"
    species: Annotated[
        str,
        "what stands there, for both forms with stems: factor on the energy of a stem. fir, "
        "spruce, conifers, broadleaved, larch, maple or beech; the factors are not verified",
    ] = "fir"
    efficiency: Annotated[
        float,
        Interval(ge=0.0, le=10.0),
        "one more factor on the energy of a stem, for both forms with stems",
    ] = 1.0
    drag_kgps: Annotated[float, Interval(ge=0.0, le=1e5), 'k of "viscous" (kg/s)'] = 300.0
    height_m: Annotated[
        float,
        Interval(ge=0.0, le=100.0),
        "stems take energy up to this height above the ground (m)",
    ] = 15.0

    def _fits_together(self) -> None:
        if self.species not in energy_ratios():
            raise ConfigError(
                "unknown species",
                field="species",
                found=repr(self.species),
                expected="one of " + ", ".join(energy_ratios()),
            )

    @property
    def takes_anything(self) -> bool:
        """Whether a stand with these settings takes any energy."""
        strength = self.drag_kgps if self.form == "viscous" else self.efficiency
        return strength > 0.0 and self.height_m > 0.0


OFF, STEMS, FULL_STEMS, VISCOUS = 0, 1, 2, 3
# Share of the speed that the viscous force takes in a step, and the shortest such step.
_SHARE_PER_STEP = 0.1
_SHORTEST_STEP_S = 0.005
# Beyond it the square of a speed that is given back would be no number any more.
_LARGEST_EXPONENT = 300.0
# A block within rounding of the height of the stems passes it in this time.
_SHORTEST_CUT_S = 1e-6
# Shortest way along the ground between two turns of a viscous force (m): at the pace of a crawl.
_CREEP = 0.1

#: What a block remembers of the forest.
MEMORY = (
    ("to_stem", np.float64),  # stems expected up to the next one that is met
    ("stems_met", np.int64),
    ("stem_rate", np.float64),  # stems per metre of the present step
    ("stems", np.float64),  # per m² where the present step is; 0 where none can be met
    ("diameter", np.float64),  # of the stems there, at breast height (m)
    ("at_stem", np.bool_),  # whether the present step ends at a stem
)


class Stand(NamedTuple):
    """Trees as the kernel reads it; the forest stands on the stretches of the profile."""

    form: int
    efficiency: float
    drag: float  # kg/s
    height: float  # m


def prepare(settings: Trees | None, has_stems: bool) -> Stand:
    """From settings to what the kernel reads; ``has_stems``: whether there is any forest."""
    if settings is None or not settings.takes_anything or not has_stems:
        return Stand(OFF, 0.0, 0.0, 0.0)
    return Stand(
        {"stems": STEMS, "full_stems": FULL_STEMS, "viscous": VISCOUS}[settings.form],
        energy_ratios()[settings.species] * float(settings.efficiency),
        float(settings.drag_kgps),
        float(settings.height_m),
    )


@lean
def stems_per_metre(stand: Stand, stems: float, diameter: float, width: float) -> float:
    """Stems that a block of some width meets on a metre of its path in plan.

    A stem is met if its axis lies within half the width of block and stem from the path.

    Parameters
    ----------
    stems, diameter : float
        Stems per square metre; their diameter at breast height (m).
    width : float
        (m)
    """
    if stand.form == OFF or stand.form == VISCOUS:
        return 0.0
    return float(stems * (width + diameter))


@lean
def to_next_stem(key: np.uint64, number: int) -> float:
    """Stems that are expected up to the next one that is met: exponential with mean 1."""
    return -math.log(rng.uniform(key, rng.STEM_DISTANCE, number))


@lean
def share_taken(offset: float) -> float:
    """Share of the energy of a stem that a hit takes, by its distance from the middle.

    Dorren and Berger (2006), with the constants as Rockyfor3D has them (not checked
    against the source).

    Parameters
    ----------
    offset : float
        Distance of the path from the axis of the stem over the largest at which it is met; 0 to 1.
        The tests behind the formula have half the diameter of the stem in its place: a block that
        is much wider than the stem then counts as a smaller one.
    """
    share = -0.046 + (0.98 + 0.046) / (1.0 + 10.0 ** ((0.58 - offset) * -8.007))
    return float(min(max(share, 0.0), 1.0))


@lean
def stem_loss(stand: Stand, key: np.uint64, number: int, diameter: float) -> float:
    """Energy that a stem of a diameter (m) takes (J)."""
    centimetres = 100.0 * diameter
    most = 38.7 * centimetres**2.31 * stand.efficiency
    if stand.form == STEMS:
        return float(most * share_taken(rng.uniform(key, rng.STEM_OFFSET, number)))
    return float(most)


@lean
def left_by_viscous(stand: Stand, stems: float, mass: float, time: float) -> float:
    """Share of the speed that the viscous forest leaves after a time.

    For a negative time it is what gives the speed back; of one that is lost nothing comes back.
    """
    if stand.form != VISCOUS or stems <= 0.0:
        return 1.0
    return math.exp(min(-stand.drag * time / mass, _LARGEST_EXPONENT))


@lean
def left_after_path(stand: Stand, stems: float, mass: float, speed: float, path: float) -> float:
    """Share of the speed that it leaves after a path along the ground: dv = -k/m dx."""
    if stand.form != VISCOUS or stems <= 0.0 or speed <= 0.0:
        return 1.0
    return max(1.0 - stand.drag * path / (mass * speed), 0.0)


@lean
def longest_step(stand: Stand, stems: float, mass: float) -> float:
    """Longest time between two turns of the viscous force (s): a tenth of the speed, or 5 ms."""
    if stand.form != VISCOUS or stems <= 0.0:
        return np.inf
    return max(_SHARE_PER_STEP * mass / stand.drag, _SHORTEST_STEP_S)


@lean
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


@lean
def before_flight(
    stand: Stand,
    state: Record,
    block: Block,
    site: Site,
    gravity: float,
    longest: float,
) -> float:
    """How long a flight may go on before the forest changes or a stem is met (s)."""
    direction = 1 if state.vx >= 0.0 else -1
    ahead, gap = to_cell_border(site.stretches, state.stretch, state.x, direction)
    stretch = site.stretches[ahead]
    stems = stretch.stems
    limit = longest
    if stems > 0.0:
        under = site.profile[segment_at(site.profile, state.x, state.segment)]
        slope = under.tz / under.tx
        below, ends = time_to_height(
            stand, state.z - under.z - (state.x - under.x) * slope, state.vz - slope * state.vx,
            gravity,
        )  # fmt: skip
        if not below:
            stems = 0.0
        ends = min(ends, longest_step(stand, stems, block.mass))
        if ends < limit:
            limit = ends
            state.cut = True
        state.stem_rate = stems_per_metre(stand, stems, stretch.diameter, 2.0 * block.c)
    state.stems = stems
    state.diameter = stretch.diameter
    if state.stem_rate * gap >= state.to_stem:
        gap = state.to_stem / state.stem_rate
        state.at_stem = True
    if gap < limit * abs(state.vx):
        limit = gap / abs(state.vx)
        state.cut = True
    else:
        state.at_stem = False
    return limit


@lean
def before_stretch(
    stand: Stand, state: Record, block: Block, site: Site, pull: float, ux: float
) -> float:
    """Chainage over which a block may roll or slide before the forest changes or a stem is met."""
    ahead, gap = to_cell_border(site.stretches, state.stretch, state.x, state.direction)
    stretch = site.stretches[ahead]
    state.stems = stretch.stems
    state.diameter = stretch.diameter
    state.stem_rate = stems_per_metre(stand, stretch.stems, stretch.diameter, 2.0 * block.c)
    state.at_stem = state.stem_rate * gap >= state.to_stem
    if state.at_stem:
        gap = state.to_stem / state.stem_rate
    time = longest_step(stand, stretch.stems, block.mass)
    step = max((state.speed + 0.5 * abs(pull) * time) * time, _CREEP) * ux
    if step < gap:
        gap = step
        state.at_stem = False
    return gap


@lean
def speed_left_at_stem(stand: Stand, state: Record, key: np.uint64, energy: float) -> float:
    """Share of the speed that is left after the stem that a step has come to.

    Parameters
    ----------
    energy : float
        Kinetic energy of the block (J).
    """
    taken = stem_loss(stand, key, state.stems_met, state.diameter)
    state.stems_met += 1
    state.to_stem = to_next_stem(key, state.stems_met)
    return math.sqrt(max(1.0 - taken / energy, 0.0)) if energy > 0.0 else 1.0
