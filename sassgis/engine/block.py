"""One block from its start to its end: flight, impacts, rolling and sliding in turn."""

from __future__ import annotations

import numpy as np

from sassgis.compiled import rng
from sassgis.compiled.jit import fused, lean
from sassgis.engine import heading
from sassgis.engine.contact import resting_height
from sassgis.engine.effects import hooks
from sassgis.engine.ellipse import Record
from sassgis.engine.flight import flight
from sassgis.engine.ground_ahead import Path, note_passages
from sassgis.engine.ground_motion import ground_motion, tips
from sassgis.engine.landing import land
from sassgis.engine.profile import angle_of, segment_at, stretch_from
from sassgis.engine.rolling import rolling_friction
from sassgis.engine.state import (
    END,
    FLIGHT,
    IMPACT,
    NEVER_STARTED,
    REST,
    ROLLING,
    SLIDING,
    STEP_LIMIT,
    Block,
    Output,
    Physics,
    Site,
    end,
    end_at_rest,
    log_event,
)


@fused
def simulate_block(
    state: Record, block: Block, site: Site, output: Output, physics: Physics,
    effects: hooks.Effects | None, path: Path | None,
) -> None:  # fmt: skip
    """Simulate one block, from the state that start_released or start_spawned has set, to its end.

    ``effects`` is None for the model of 1986 only, ``path`` for a block that stays on the profile.
    """
    hooks.on_start(effects, state, block)
    move(state, block, site, output, physics, effects, path, np.inf)
    if path is not None:
        heading.stays_on_known(state, site)
    if state.reason == REST and not state.moved:
        state.reason = NEVER_STARTED
    state.vx = 0.0
    state.vz = 0.0
    state.omega = 0.0
    log_event(output.log, state, 0.0, 0.0)


@fused
def move(
    state: Record, block: Block, site: Site, output: Output, physics: Physics,
    effects: hooks.Effects | None, path: Path | None, until: float,
) -> None:  # fmt: skip
    """Move a block to its end, or through the event in which it comes to a chainage (m)."""
    while state.phase != END and state.x < until:
        state.events += 1
        if state.events > physics.max_events:
            end(state, STEP_LIMIT)
        elif state.phase == FLIGHT:
            if path is not None and not state.resumed:
                heading.before_flight(state, block, site, path, physics)
            flight(state, block, site, output, physics, effects)
        elif state.phase == IMPACT:
            into = -(state.vx * state.nx + state.vz * state.nz)
            impacts = state.impacts
            spawned = output.spawned.n[0]
            land(state, block, site, output, physics, effects)
            if path is not None:
                heading.stays_on_known(state, site)
                heading.place_spawned(state, output.spawned, spawned)
                hooks.before_turn(effects, state, block)
                heading.after_impact(
                    state, block, site, path, physics, into, state.impacts > impacts
                )
        elif path is not None:
            hooks.before_turn(effects, state, block)
            if not state.resumed:
                heading.before_ground(state, block, site, path, physics)
            if state.phase != FLIGHT:
                ground_motion(state, block, site, output, physics, effects)
                heading.stays_on_known(state, site)
                heading.after_ground(state, physics)
            if heading.wedged(state):
                end_at_rest(state, block)
        else:
            ground_motion(state, block, site, output, physics, effects)
        if path is not None and site.crossings.n[0] > 0:
            note_passages(site, path)
        state.resumed = False


@lean
def _clear(state: Record, site: Site, x: float, stretch: int) -> None:
    """Clear the state of a block, which gets a chainage (m) only."""
    state.spawned = False
    state.resumed = False
    state.reason = STEP_LIMIT
    state.began = 0.0
    state.t = 0.0
    state.x = x
    state.speed = 0.0
    state.direction = 1
    state.nx = 0.0
    state.nz = 1.0
    state.as_circle = False
    state.by_core = False
    state.skip_to = -1
    state.clear_from = 0.0
    state.spot_x = -np.inf
    state.spot_z = -np.inf
    state.crowded = 0
    state.events = 0
    state.steps = 0
    state.impacts = 0
    state.slope_draws = 0
    state.moved = False
    state.held_x = np.inf
    state.lines_from = x
    state.roof_end = -np.inf
    state.n_passages = 0
    state.n_touched = 0
    state.furthest = x
    state.top_speed = 0.0
    state.top_height = 0.0
    state.top_energy = 0.0
    state.reach = np.inf
    state.stuck_x = np.inf
    state.about = 1.0
    state.stuck = 0
    state.stretch = stretch_from(site.stretches, stretch, x)
    for i in range(site.crossings.n[0]):
        site.crossings.rows[i].seen = False


@lean
def start_released(
    state: Record, block: Block, site: Site, physics: Physics, low: Record, high: Record,
    key: np.uint64, x: float,
) -> None:  # fmt: skip
    """Set the state of a block that is released at chainage x (m), drawn as by draw_block.

    Dropped, it falls. At rest, it slides or rolls where the friction allows, or never starts.
    Pushed without spin it slides; with spin it meets the ground where it lies.
    """
    # Along the slope, positive downhill; positive as a block that rolls downhill; height above its
    # resting position; angle of the major axis to the slope.
    speed = rng.between(key, rng.SPEED, 0, low.speed_mps, high.speed_mps)
    spin = rng.between(key, rng.SPIN, 0, low.spin_radps, high.spin_radps)
    drop = rng.between(key, rng.DROP, 0, low.drop_m, high.drop_m)
    tilt = rng.between(key, rng.ORIENTATION, 0, low.orientation_rad, high.orientation_rad)
    if physics.point:
        spin = 0.0
    profile = site.profile
    _clear(state, site, x, 0)
    segment = segment_at(profile, x, 0)
    here = profile.rows[segment]
    state.segment = segment
    state.theta = tilt + angle_of(profile, segment)
    state.z = resting_height(x, state.theta, block.a, block.b, profile, segment) + drop
    state.vx = speed * here.tx
    state.vz = speed * here.tz
    state.omega = spin
    state.speed = speed
    state.nx = -here.tz
    state.nz = here.tx
    if drop > 0.0:
        state.phase = FLIGHT
    elif spin != 0.0:
        state.phase = IMPACT
    elif speed != 0.0:
        state.phase = SLIDING
    else:
        _start_at_rest(state, block, site, physics)


@lean
def _start_at_rest(state: Record, block: Block, site: Site, physics: Physics) -> None:
    """Let a block that lies still slide or roll if the ground is steep enough.

    One that tips under the friction of sliding rolls from the start.
    """
    here = site.profile.rows[state.segment]
    ground = site.grounds[here.ground]
    steep = abs(here.tz) / here.tx
    state.direction = 1 if here.tz <= 0.0 else -1
    rolls = steep > rolling_friction(block, ground) and not physics.point
    if steep > ground.mu_f and not (rolls and physics.tipping and tips(block, ground.mu_f)):
        state.phase = SLIDING
    elif rolls:
        state.phase = ROLLING
        radius = block.roll_radius
        state.z = resting_height(state.x, 0.0, radius, radius, site.profile, state.segment)
    else:
        end(state, NEVER_STARTED)


@lean
def start_spawned(
    state: Record, block: Block, site: Site, spawned: Record, released_x: float
) -> None:
    """Set the state of a block that another, released at some chainage (m), has spawned."""
    profile = site.profile
    first = stretch_from(site.stretches, 0, released_x)
    _clear(state, site, spawned.x, first)
    state.about = spawned.about
    state.spawned = True
    state.began = spawned.t
    state.moved = True
    state.phase = FLIGHT
    state.segment = segment_at(profile, spawned.x, segment_at(profile, released_x, 0))
    state.theta = spawned.theta
    lies = resting_height(spawned.x, state.theta, block.a, block.b, profile, state.segment)
    state.z = max(spawned.z, lies)
    state.vx = spawned.vx
    state.vz = spawned.vz
    state.omega = spawned.omega
