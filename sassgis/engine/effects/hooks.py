"""Where effects act on the motion: the only file that the motion calls and that names all effects.

Each hook is given all effects, or None for the model of 1986 only; numba then leaves out what the
hook does. So the motion is compiled at most twice: without effects, and with all of them behind
their forms. Each effect is defined in a separate file.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sassgis.compiled.jit import fused, inlined
from sassgis.engine.draws import changed
from sassgis.engine.effects import (
    air_drag,
    entrainment,
    fragmentation,
    lateral_deflection,
    rock_shape,
    roughness,
    soft_ground,
    trees,
    wind,
)
from sassgis.engine.effects.forms import OFF, Numbers
from sassgis.engine.effects.ground_switch import ground_rows
from sassgis.engine.effects.spawning import MOST_SPAWNED
from sassgis.engine.ellipse import CountedRows, Record, Records, record_type
from sassgis.engine.impact import COULOMB, SCALE
from sassgis.engine.state import STATE_FIELDS, Block, Site
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundTable

#: The state of a block, with what effects remember of it and of the step that it makes.
BLOCK_DTYPE = record_type(
    *STATE_FIELDS,
    ("resistance", np.float64),  # of the air (1/m)
    *trees.MEMORY,
    *wind.MEMORY,
    *lateral_deflection.MEMORY,
    ("x_from", np.float64),  # where the step began (m)
    ("energy_from", np.float64),  # twice the energy per unit mass with which it began, less spin
    ("cut", np.bool_),  # whether an effect has cut the step short
)


class Effects(NamedTuple):
    """Every effect, as forms.kernel_form has its settings."""

    drag: Numbers
    stand: Numbers
    soft: Numbers
    rough: Numbers
    shape: Numbers
    breaking: Numbers
    loose: Numbers
    push: Numbers
    deflection: Numbers


def prepare(settings: EffectSettings, has_stems: bool) -> Effects | None:
    """Return effects for the kernel; None if none is on.

    ``has_stems`` is whether there is any forest on the cells of the chunk.
    """
    if not settings.on:
        return None
    return Effects(
        air_drag.prepare(settings.get(air_drag.AirDrag)),
        trees.prepare(settings.get(trees.Trees), has_stems),
        soft_ground.prepare(settings.get(soft_ground.SoftGround)),
        roughness.prepare(settings.get(roughness.Roughness)),
        rock_shape.prepare(settings.get(rock_shape.RockShape)),
        fragmentation.prepare(settings.get(fragmentation.Fragmentation)),
        entrainment.prepare(settings.get(entrainment.Entrainment)),
        wind.prepare(settings.get(wind.Wind)),
        lateral_deflection.prepare(settings.get(lateral_deflection.LateralDeflection)),
    )


def ground_of(settings: EffectSettings, table: GroundTable) -> Records:
    """List ground classes for the kernel (ground_switch.GROUND_DTYPE), with effects on each."""
    if not settings.on:
        return ground_rows(table, {})
    switched = (
        settings.get(soft_ground.SoftGround),
        settings.get(roughness.Roughness),
        settings.get(entrainment.Entrainment),
    )
    return ground_rows(table, {own.name: own.classes for own in switched if own is not None})


def most_spawned(settings: EffectSettings) -> int:
    """Count the blocks spawned by one released block for which there has to be room."""
    spawning = (fragmentation.Fragmentation, entrainment.Entrainment)
    return MOST_SPAWNED if any(settings.get(kind) for kind in spawning) else 0


@inlined
def on_block(effects: Effects | None, block: Block) -> Block:
    """Return the block as it moves, from the plane ellipse of the model of 1986."""
    if effects is not None and effects.shape.form == rock_shape.MEAN_INERTIA:
        inertia = rock_shape.tumbling_inertia(block.a, block.b, block.c)
        return changed(block, inertia, block.drag)
    return block


@inlined
def on_start(effects: Effects | None, state: Record, block: Block) -> None:
    """Set the memory for a new block."""
    if effects is not None:
        state.resistance = air_drag.resistance(effects.drag, block.a, block.b, block.c, block.mass)
        state.push_before = 0.0
        state.stems_met = 0
        state.to_stem = np.inf
        if effects.stand.form != OFF:
            state.to_stem = trees.to_next_stem(block.key, 0)


@inlined
def on_path(effects: Effects | None, state: Record, block: Block) -> None:
    """Begin a path that is followed, with the angle by which the block drifts off the descent."""
    if effects is not None and effects.deflection.form != OFF:
        lateral_deflection.on_path(effects.deflection, state, block.key)


@inlined
def before_turn(effects: Effects | None, state: Record, block: Block) -> None:
    """Add to the turn that is due at an impact or on the ground, on a path that is followed."""
    if effects is not None and effects.deflection.form == lateral_deflection.KICKS:
        lateral_deflection.before_turn(effects.deflection, state, block.key)


@fused
def before_flight(
    effects: Effects | None,
    state: Record,
    block: Block,
    site: Site,
    gravity: float,
    longest: float,
) -> float:
    """Return the longest time (s) that the step of flight that begins may take.

    Continuous forces act half before the step and half after it: second order.
    """
    limit = longest
    if effects is not None:
        state.x_from = state.x
        state.stem_rate = 0.0
        state.stems = 0.0
        state.at_stem = False
        state.cut = False
        if effects.drag.form != OFF and limit > effects.drag.step_s:
            limit = effects.drag.step_s
            state.cut = True
        if effects.push.form != OFF:
            pushed_after = wind.longest_step(effects.push, state)
            if pushed_after < limit:
                limit = pushed_after
                state.cut = True
        if effects.stand.form != OFF:
            limit = trees.before_flight(effects.stand, state, block, site, gravity, limit)
        if effects.push.form != OFF:
            wind.push_before(effects.push, state, limit)
        state.energy_from = state.vx * state.vx + state.vz * state.vz + 2.0 * gravity * state.z
        _brake(effects, state, block, 0.5 * limit)
    return limit


@inlined
def _brake(effects: Effects, state: Record, block: Block, time: float) -> float:
    """Apply continuous forces to a block in flight; return the share left by trees."""
    vx, vz = air_drag.slowed(state.resistance, state.vx, state.vz, time)
    kept = trees.left_by_viscous(effects.stand, state.stems, block.mass, time)
    state.vx = vx * kept
    state.vz = vz * kept
    return kept


@fused
def after_flight(
    effects: Effects | None, state: Record, block: Block, gravity: float, limit: float,
    until: float, arrived: bool,
) -> bool:  # fmt: skip
    """End a step of flight; whether the same flight goes on.

    ``limit`` and ``until`` are the times that the step might have taken and has taken (s),
    ``arrived`` is whether it ended at the ground or a barrier.
    """
    if effects is not None:
        kept = _brake(effects, state, block, until - 0.5 * limit)
        # Of a step that ends early the drag before it is partly taken back, at a speed that may
        # have grown: energy is not made.
        has = state.vx * state.vx + state.vz * state.vz
        if until < 0.5 * limit and (state.resistance > 0.0 or kept > 1.0) and has > 0.0:
            kept = min(math.sqrt(max(state.energy_from - 2.0 * gravity * state.z, 0.0) / has), 1.0)
            state.vx *= kept
            state.vz *= kept
        goes_on = state.cut and not arrived
        # Not limited above, because the wind adds energy.
        if effects.push.form != OFF:
            wind.push_after(effects.push, state, limit, until, goes_on)
        if effects.stand.form != OFF:
            # A wind may have carried it past the stem.
            path = abs(state.x - state.x_from)
            state.to_stem = max(state.to_stem - state.stem_rate * path, 0.0)
            if state.at_stem and not arrived:
                spin = block.inertia * state.omega * state.omega
                energy = 0.5 * (state.vx * state.vx + state.vz * state.vz + spin) * block.mass
                kept = trees.speed_left_at_stem(effects.stand, state, block.key, energy)
                state.vx *= kept
                state.vz *= kept
                state.omega *= kept
        return goes_on
    return False


@inlined
def before_stretch(
    effects: Effects | None, state: Record, block: Block, site: Site, pull: float, fade: float,
    ux: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Begin a stretch of rolling or sliding on ground of a slope with the cosine ``ux``.

    Takes the acceleration without effects (m/s²) and how it falls (1/m: resistance.py); returns
    both with effects, and the path along which they hold (m).
    """
    longest = np.inf
    if effects is not None and effects.stand.form != OFF:
        state.x_from = state.x
        pull, longest = trees.before_stretch(effects.stand, state, block, site, pull, ux)
        if trees.brakes(effects.stand, state.stems):
            fade = 0.0
    return pull, fade, longest


@inlined
def gain_over(
    effects: Effects | None, state: Record, block: Block, gain: float, path: float
) -> float:
    """Return the change of v² over a path (m) that a stretch without a stop turned out to take.

    ``gain`` is that without effects (m²/s²).
    """
    if effects is not None:
        return trees.gain_over(effects.stand, state.stems, block.mass, state.speed, gain, path)
    return gain


@inlined
def after_stretch(effects: Effects | None, state: Record, block: Block, arrived: bool) -> None:
    """End a stretch; ``arrived``: before the path that before_stretch returned."""
    if effects is not None and effects.stand.form != OFF:
        state.to_stem -= state.stem_rate * abs(state.x - state.x_from)
        if state.at_stem and not arrived:
            spin = block.inertia * state.omega * state.omega
            energy = 0.5 * (state.speed * state.speed + spin) * block.mass
            kept = trees.speed_left_at_stem(effects.stand, state, block.key, energy)
            state.speed *= kept
            state.omega *= kept


@inlined
def on_contact(
    effects: Effects | None, state: Record, block: Block, ground: Record, nx: float, nz: float,
    rule: int, friction: float,
) -> tuple[float, float, int, float]:  # fmt: skip
    """Return the surface that an impact meets: its normal, the rule of impact and the friction."""
    if effects is not None:
        if effects.rough.form != OFF and ground.roughness:
            nx, nz = roughness.tilted(
                effects.rough, block.key, state.impacts, block.radius, state.vx, state.vz, nx, nz
            )
        if effects.soft.form == soft_ground.SLIP and ground.soft_ground:
            if rule == SCALE:
                rule = COULOMB
            friction = effects.soft.friction
    return nx, nz, rule, friction


@inlined
def after_impact(
    effects: Effects | None, state: Record, block: Block, ground: Record, into: float, wt: float,
    wn: float, omega: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Compute velocity and spin after an impact at normal speed ``into`` (m/s) from the others."""
    if effects is not None:
        if ground.soft_ground:
            wt, wn, omega = soft_ground.after_impact(
                effects.soft, block.mass, block.radius, into, wt, wn, omega
            )
        if rock_shape.lands_flat(effects.shape, block.key, state.impacts, block.b, block.c):
            omega = 0.0
    return wt, wn, omega


@inlined
def on_loss(
    effects: Effects | None, state: Record, block: Block, spawned: CountedRows, here: Record,
    ground: Record, lost: float,
) -> bool:  # fmt: skip
    """Spawn blocks where an impact took energy (J/kg); whether the block itself is broken.

    ``state`` is that after the impact; ``here`` and ``ground`` are the segment that was hit and its
    ground class.
    """
    if effects is not None:
        # Spawned blocks entrain no others: a chain would have no end.
        if not state.spawned and effects.loose.form != OFF and ground.entrainment:
            entrainment.entrain(
                effects.loose, spawned, block, state.impacts, lost * block.mass, state, here
            )  # fmt: skip
        if effects.breaking.form != OFF and fragmentation.breaks(
            effects.breaking, block.key, state.impacts, lost
        ):
            return fragmentation.break_up(effects.breaking, spawned, block, state.impacts, state)
    return False
