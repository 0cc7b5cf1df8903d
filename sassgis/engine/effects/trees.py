"""Stems of a forest on the path of a block."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Interval

from sassgis.compiled import rng
from sassgis.compiled.jit import inlined, lean
from sassgis.engine.effects.forms import OFF, Numbers, kernel_form
from sassgis.engine.ellipse import CountedRows, Record
from sassgis.engine.profile import segment_at, to_cell_border
from sassgis.engine.state import Block, Site
from sassgis.errors import ConfigError
from sassgis.settings.blocks import EffectSection
from sassgis.settings.schema import checked
from sassgis.settings.statistics_table import built_in_rows


@checked(frozen=True, slots=True)
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
        "tree species, for both forms with stems: factor on the energy of a stem. fir, "
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
        """Return whether a stand with these settings takes any energy."""
        if self.form == "viscous":
            return self.drag_kgps > _LEAST_DRAG_KGPS and self.height_m > 0.0
        return self.efficiency > 0.0 and self.height_m > 0.0


STEMS, FULL_STEMS, VISCOUS = 1, 2, 3
# A smaller force slows no block within hours, and its steady speed would overflow.
_LEAST_DRAG_KGPS = 1e-6
# Share of the speed that the viscous force takes in a step, and the shortest such step.
_SHARE_PER_STEP = 0.1
_SHORTEST_STEP_S = 0.005
# Beyond it the square of a restored speed would overflow.
_LARGEST_EXPONENT = 300.0
# A block within rounding of the height of the stems passes it in this time.
_SHORTEST_CUT_S = 1e-6
# On a stretch of the ground it closes this share of the difference to the steady speed, or more
# where that changes the speed by no larger share of itself, up to so much; the shortest stretch (m)
# at the pace of a crawl, and that pace (m/s).
_SHARE_ON_GROUND = 0.25
_MOST_CLOSED = 0.95
_HARDLY_CLOSED = 1e-7
_CREEP = 0.1
_SLOWEST = 1e-6
# Steps of Newton's method for the time in which a path is gone.
_NEWTON = 4
# Cells of the same forest that a step passes at most.
_MOST_CELLS = 8

#: What a block remembers of the forest.
MEMORY = (
    ("to_stem", np.float64),  # stems expected up to the next one that is met
    ("stems_met", np.int64),
    ("stem_rate", np.float64),  # stems per metre of the present step
    ("stems", np.float64),  # per m² where the present step is; 0 where none can be met
    ("diameter", np.float64),  # of the stems there, at breast height (m)
    ("at_stem", np.bool_),  # whether the present step ends at a stem
)


TreesNumbers, _prepare = kernel_form(Trees, lambda own: not own.takes_anything)


def prepare(settings: Trees | None, has_stems: bool) -> Numbers:
    """Convert the settings to the form of the kernel; ``has_stems``: whether a forest is there."""
    stand = _prepare(settings if has_stems else None)
    if settings is None:
        return stand
    return stand._replace(efficiency=energy_ratios()[settings.species] * stand.efficiency)


@lean
def stems_per_metre(stand: Numbers, stems: float, diameter: float, width: float) -> float:
    """Return the stems that a block of some width (m) meets on a metre of its path in plan.

    A stem is met if its axis lies within half the width of block and stem from the path. ``stems``
    are per m², of a diameter at breast height (m).
    """
    if stand.form == OFF or stand.form == VISCOUS:
        return 0.0
    return float(stems * (width + diameter))


@lean
def to_next_stem(key: np.uint64, number: int) -> float:
    """Return stems that are expected up to the next one that is met: exponential with mean 1."""
    return -math.log(rng.uniform(key, rng.STEM_DISTANCE, number))


@lean
def share_taken(offset: float) -> float:
    """Return the share of the energy of a stem that a hit takes, by its distance from the middle.

    Dorren and Berger (2006), with the constants as Rockyfor3D has them (not checked against the
    source). ``offset`` is the distance of the path from the axis of the stem over the largest at
    which it is met, 0 to 1. The tests behind the formula have half the diameter of the stem in its
    place: a block that is much wider than the stem then counts as a smaller one.
    """
    share = -0.046 + (0.98 + 0.046) / (1.0 + 10.0 ** ((0.58 - offset) * -8.007))
    return float(min(max(share, 0.0), 1.0))


@lean
def stem_loss(stand: Numbers, key: np.uint64, number: int, diameter: float) -> float:
    """Return the energy that a stem of a diameter (m) takes (J)."""
    centimetres = 100.0 * diameter
    most = 38.7 * centimetres**2.31 * stand.efficiency
    if stand.form == STEMS:
        return float(most * share_taken(rng.uniform(key, rng.STEM_OFFSET, number)))
    return float(most)


@inlined
def brakes(stand: Numbers, stems: float) -> bool:
    """Return whether a viscous force acts."""
    return stand.form == VISCOUS and stems > 0.0


@lean
def left_by_viscous(stand: Numbers, stems: float, mass: float, time: float) -> float:
    """Return the share of the speed that the viscous forest leaves after a time.

    A negative time restores the speed; a speed of 0 is not restored.
    """
    if not brakes(stand, stems):
        return 1.0
    return math.exp(min(-stand.drag_kgps * time / mass, _LARGEST_EXPONENT))


@lean
def on_ground(
    stand: Numbers, stems: float, mass: float, speed: float, pull: float
) -> tuple[float, float]:
    """Return the acceleration of a block in a viscous forest (m/s²), and for how long a path (m).

    From v' = p − k v/m, p being the ``pull`` without the forest: exact at the end of the path;
    before it the square of the speed is taken as linear.
    """
    if not brakes(stand, stems):
        return pull, np.inf
    rate = stand.drag_kgps / mass
    steady = pull / rate
    closed = _SHARE_ON_GROUND * max(speed / max(abs(speed - steady), _SLOWEST), 1.0)
    time = -math.log1p(-min(closed, _MOST_CLOSED)) / rate
    time = max(time, _CREEP / max(speed, steady, _SLOWEST))
    if steady < 0.0:
        time = min(time, math.log1p(-speed / steady) / rate)
    path, after = _after(rate, steady, speed, time)
    if path <= 0.0:
        return pull, np.inf
    if after < _SLOWEST and steady <= 0.0:
        after = 0.0
    return 0.5 * (after * after - speed * speed) / path, path


@inlined
def _after(rate: float, steady: float, speed: float, time: float) -> tuple[float, float]:
    """Return path (m) and speed (m/s) after a time in which the steady speed is approached."""
    closed = -math.expm1(-rate * time)
    after = speed + (steady - speed) * closed
    if closed < _HARDLY_CLOSED:
        # The steady speed may be very large: its difference would be rounding only.
        return 0.5 * (speed + after) * time, after
    return steady * time + (speed - steady) * closed / rate, after


@lean
def gain_over(
    stand: Numbers, stems: float, mass: float, speed: float, gain: float, path: float
) -> float:
    """Return, as on_ground, the change of v² of a block that goes on for a path (m), and no stop.

    ``gain`` is that without the forest (m²/s²), taken as even over the path.
    """
    if not brakes(stand, stems) or path <= 0.0:
        return gain
    pull = 0.5 * gain / path
    rate = stand.drag_kgps / mass
    steady = pull / rate
    square = speed * speed + gain - 2.0 * rate * speed * path
    time = 2.0 * path / (speed + math.sqrt(max(square, 0.0)))
    after = speed
    for _ in range(_NEWTON):
        gone, after = _after(rate, steady, speed, time)
        if after <= 0.0:
            return -speed * speed
        time += (path - gone) / after
    return after * after - speed * speed


@lean
def longest_step(stand: Numbers, stems: float, mass: float) -> float:
    """Return the longest time between two turns of the viscous force (s)."""
    if not brakes(stand, stems):
        return np.inf
    return float(max(_SHARE_PER_STEP * mass / stand.drag_kgps, _SHORTEST_STEP_S))


@lean
def time_to_height(
    stand: Numbers, above: float, climb: float, gravity: float
) -> tuple[bool, float]:
    """Return whether a block in flight is below the height of the stems, and when that changes (s).

    ``above`` is the height of its centre above straight ground (m), ``climb`` how fast it grows
    (m/s).
    """
    over = above - stand.height_m
    square = climb * climb + 2.0 * gravity * over
    if over >= 0.0:
        return False, max((climb + math.sqrt(square)) / gravity, _SHORTEST_CUT_S)
    if climb <= 0.0 or square <= 0.0:
        return True, np.inf
    return True, max((climb - math.sqrt(square)) / gravity, _SHORTEST_CUT_S)


@lean
def to_other_forest(stretches: CountedRows, i: int, x: float, direction: int) -> tuple[int, float]:
    """Find the stretch ahead of a block in a direction, and how far its forest goes on (m).

    To the next vertex at most, where the height above the ground changes at another rate.
    """
    i, gap = to_cell_border(stretches, i, x, direction)
    here = stretches.rows[i]
    j = i + direction
    while (
        0 <= j < stretches.n[0]
        and abs(j - i) < _MOST_CELLS
        and stretches.rows[j].segment == here.segment
        and stretches.rows[j].stems == here.stems
        and stretches.rows[j].diameter == here.diameter
    ):
        gap += stretches.rows[j + 1].start - stretches.rows[j].start
        j += direction
    return i, gap


@lean
def before_flight(
    stand: Numbers,
    state: Record,
    block: Block,
    site: Site,
    gravity: float,
    longest: float,
) -> float:
    """Compute the time of flight (s) before the forest changes or a stem is met."""
    direction = 1 if state.vx >= 0.0 else -1
    ahead, gap = to_other_forest(site.stretches, state.stretch, state.x, direction)
    stretch = site.stretches.rows[ahead]
    stems = stretch.stems
    limit = longest
    if stems > 0.0:
        under = site.profile.rows[segment_at(site.profile, state.x, state.segment)]
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
    stand: Numbers, state: Record, block: Block, site: Site, pull: float, ux: float
) -> tuple[float, float]:
    """Return the acceleration on the ground until the forest changes or a stem is met."""
    ahead, gap = to_other_forest(site.stretches, state.stretch, state.x, state.direction)
    stretch = site.stretches.rows[ahead]
    state.stems = stretch.stems
    state.diameter = stretch.diameter
    state.stem_rate = stems_per_metre(stand, stretch.stems, stretch.diameter, 2.0 * block.c)
    state.at_stem = state.stem_rate * gap >= state.to_stem
    if state.at_stem:
        gap = state.to_stem / state.stem_rate
    pull, path = on_ground(stand, stretch.stems, block.mass, state.speed, pull)
    if path * ux < gap:
        state.at_stem = False
        return pull, path
    return pull, gap / ux


@lean
def speed_left_at_stem(stand: Numbers, state: Record, key: np.uint64, energy: float) -> float:
    """Return the share of the speed that a stem leaves of a kinetic energy (J)."""
    taken = stem_loss(stand, key, state.stems_met, state.diameter)
    state.stems_met += 1
    state.to_stem = to_next_stem(key, state.stems_met)
    return math.sqrt(max(1.0 - taken / energy, 0.0)) if energy > 0.0 else 1.0


#: Power of the diameter at breast height with which the energy that a stem takes grows.
ENERGY_EXPONENT = 2.31


@cache
def energy_ratios() -> Mapping[str, float]:
    """Return the ratio by species, from sassgis/data/tree_species.csv, which has the sources."""
    return {row["species"]: float(row["energy_ratio"]) for row in built_in_rows("tree_species")}
