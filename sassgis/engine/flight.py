"""A block in flight."""

from __future__ import annotations

import math

from sassgis.compiled.jit import fused, inlined, lean
from sassgis.engine.barriers import (
    ON_ROOF,
    after_barrier,
    control_lines_in_flight,
    no_meeting,
    passing_height,
)
from sassgis.engine.contact import next_contact
from sassgis.engine.effects import hooks
from sassgis.engine.ellipse import CountedRows, Record
from sassgis.engine.ellipse_contact import Flying
from sassgis.engine.profile import segment_at
from sassgis.engine.recording import record_flight
from sassgis.engine.roofs import leave_roof
from sassgis.engine.state import (
    FLIGHT,
    IMPACT,
    LEFT_PROFILE,
    STEP_LIMIT,
    Block,
    Output,
    Physics,
    Site,
    end,
    log_event,
    same_event,
)

#: Length of known ground ahead of a block, beyond its longest semi-axis (m).
MARGIN_M = 0.01
# Look-ahead for a block that moves straight up or down (s).
_LONGEST = 1e6


@inlined
def _time_to_end(state: Record, block: Block, profile: CountedRows) -> float:
    """Return when the centre leaves the profile (s), which must go on under the whole block."""
    if state.vx > 1e-9:
        front = block.a + MARGIN_M if state.open else 0.0
        limit = (profile.rows[profile.n[0]].x - front - state.x) / state.vx
    elif state.vx < -1e-9:
        limit = (profile.rows[0].x - state.x) / state.vx
    else:
        limit = _LONGEST
    return float(max(limit, 0.0))


@inlined
def _is_over_ground(state: Record, profile: CountedRows, gravity: float, until: float) -> bool:
    """Return whether the centre is over the ground at the end (s) of a flight without contact."""
    x = state.x + state.vx * until
    z = state.z + (state.vz - 0.5 * gravity * until) * until
    here = profile.rows[segment_at(profile, x, state.segment)]
    return bool(z >= here.z + (x - here.x) * here.tz / here.tx)


@fused
def _advance(
    state: Record, block: Block, site: Site, output: Output, gravity: float, until: float
) -> None:
    """Move a block along its parabola for a time (s), and record what it passes."""
    vx = state.vx
    vz = state.vz
    spin_energy = 0.5 * block.inertia * state.omega * state.omega
    n_touched, stretch, top = record_flight(
        site.stretches, output.work, state.n_touched, state.stretch, state.x, state.z, vx, vz,
        spin_energy, gravity, until, state.began + state.t, block.b, site.profile
    )  # fmt: skip
    state.n_touched = n_touched
    state.stretch = stretch
    wz = vz - gravity * until
    half = 0.5 * (vx * vx + max(vz * vz, wz * wz))
    state.top_height = max(state.top_height, top)
    state.top_speed = max(state.top_speed, math.sqrt(2.0 * half))
    state.top_energy = max(state.top_energy, half + spin_energy)
    state.x += vx * until
    state.z += (vz - 0.5 * gravity * until) * until
    state.vz = wz
    state.theta -= state.omega * until
    state.t += until
    if until > 0.0:
        state.moved = True


@lean
def _over_roof(state: Record, block: Block, site: Site, output: Output, physics: Physics) -> None:
    """Move a block over the roof of a gallery to its lower edge, or to where the ground ends."""
    to_end = _time_to_end(state, block, site.profile)
    until = min((state.roof_end - state.x) / state.vx, to_end)
    state.x = min(state.x + state.vx * until, state.roof_end)
    state.z += state.vz * until
    state.t += until
    state.lines_from = state.x
    state.furthest = max(state.furthest, state.x)
    if until < to_end:
        leave_roof(state, block, site, output, physics)
    elif state.open:
        same_event(state, physics)
    else:
        end(state, LEFT_PROFILE)


@fused
def flight(
    state: Record,
    block: Block,
    site: Site,
    output: Output,
    physics: Physics,
    effects: hooks.Effects | None,
) -> None:
    """Fly to the next contact, a barrier or the end of the profile."""
    g = physics.gravity
    if state.roof_end > state.x:
        _over_roof(state, block, site, output, physics)
        return
    log_event(output.log, state, 0.0, 0.0)
    limit = hooks.before_flight(
        effects, state, block, site, g, _time_to_end(state, block, site.profile)
    )
    flying = Flying(
        state.x, state.z, state.vx, state.vz, state.theta, state.omega, block.a, block.b, g
    )
    contact = next_contact(
        flying, state.clear_from, limit, physics.tolerance, site.profile, state.segment,
        state.skip_to
    )  # fmt: skip
    until = contact.t if contact.segment >= 0 else limit
    barrier = no_meeting()
    if site.crossings.n[0] > 0:
        barrier = control_lines_in_flight(state, block, site, output, g, until)
    at_barrier = barrier.line >= 0
    if at_barrier:
        until = barrier.when
    elif contact.segment < 0 and not _is_over_ground(state, site.profile, g, until):
        # The ground was missed: any further motion would be wrong.
        end(state, STEP_LIMIT)
        return
    _advance(state, block, site, output, g, until)
    if at_barrier:
        state.x = site.crossings.rows[barrier.line].x
    state.lines_from = state.x
    state.furthest = max(state.furthest, state.x)
    arrived = at_barrier or contact.segment >= 0
    if hooks.after_flight(effects, state, block, g, limit, until, arrived):
        state.clear_from = max(state.clear_from - until, 0.0)
        same_event(state, physics)
        return
    state.clear_from = 0.0
    state.skip_to = -1
    if at_barrier:
        state.vx *= barrier.speed_left
        state.vz *= barrier.speed_left
        state.omega *= barrier.speed_left
        state.segment = segment_at(site.profile, state.x, state.segment)
        crossing = site.crossings.rows[barrier.line]
        height = passing_height(block, site, crossing, state.segment, state.z)
        after_barrier(state, block, site, output, physics, barrier, height)
        if state.phase != FLIGHT:
            # It drops to the foot of the wall, or lies on the roof.
            top = crossing.height if barrier.outcome == ON_ROOF else 0.0
            state.z = min(state.z, crossing.z + top + block.b)
    elif contact.segment < 0:
        if state.open:
            same_event(state, physics)
        else:
            end(state, LEFT_PROFILE)
    else:
        state.segment = contact.segment
        state.nx = contact.nx
        state.nz = contact.nz
        state.by_core = contact.by_core
        state.phase = IMPACT
