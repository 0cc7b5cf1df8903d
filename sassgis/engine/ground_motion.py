"""A block that rolls or slides along a segment: Bozzolo and Pamini (1986), equations (1), (2)."""

from __future__ import annotations

import math

from sassgis.compiled.jit import fused, inlined, lean
from sassgis.engine import rolling
from sassgis.engine.barriers import (
    Stretch,
    after_barrier,
    control_lines_on_ground,
    no_meeting,
    up_to,
)
from sassgis.engine.contact import next_contact
from sassgis.engine.effects import hooks
from sassgis.engine.ellipse import Record, cos_sin, frame_of
from sassgis.engine.ellipse_contact import Flying
from sassgis.engine.landing import FIRST_TURN, rolling_place
from sassgis.engine.profile import STRAIGHT, along, angle_of, turn
from sassgis.engine.recording import record_ground
from sassgis.engine.resistance import gained, path_to, time_over
from sassgis.engine.state import (
    FLIGHT,
    IMPACT,
    LEFT_PROFILE,
    ROLLING,
    SLIDING,
    Block,
    Output,
    Physics,
    Site,
    end,
    end_at_rest,
    log_event,
    same_event,
)

# Gap at which a block that moves along the ground touches ground ahead of it (m).
_TOUCH = 1e-11


@lean
def tips(block: Block, friction: float) -> bool:
    """Return whether sliding friction turns a block over: μ_f > (a² − b²)/(2 a b).

    About the centre friction has the lever y and the normal force the lever x. The ground holds a
    sliding ellipse where x = μ_f y; x/y is at most (a² − b²)/(2 a b), at tan θ = b/a.
    """
    return friction * 2.0 * block.a * block.b > block.a * block.a - block.b * block.b


@lean
def _tip(state: Record, block: Block, site: Site, gravity: float, down: float) -> float:
    """Let a fast enough sliding block tip over and roll; else return the speed it needs.

    Friction brings it to rolling with its angular momentum about the ground kept: v' = v/(1 + I/r²)
    and the energy v²/2/(1 + I/r²), of which the rise of the centre is taken. Where rolling friction
    exceeds the slope, it also has to turn over its longer axis; where the slope exceeds sliding
    friction, it slides on. Returns -1 once it rolls.
    """
    profile = site.profile
    here = profile.rows[state.segment]
    ground = site.grounds[here.ground]
    radius = block.roll_radius
    u = min(max(along(profile, state.segment, state.x, state.z), 0.0), here.length)
    foot_x = here.x + u * here.tx
    foot_z = here.z + u * here.tz
    needed = gravity * (foot_z + radius * here.tx - state.z)
    mu_r = rolling.rolling_friction(block, ground)
    if down < mu_r * here.tx:
        if down > ground.mu_f * here.tx:
            # It would gain speed sliding and lose it rolling, in an endless cycle.
            return math.inf
        needed += gravity * here.tx * (block.a - radius)
    if 0.5 * state.speed * state.speed < needed * block.roll_share:
        return math.sqrt(2.0 * needed * block.roll_share) * (1.0 + 1e-9)
    x, z = rolling_place(profile, state.segment, foot_x, foot_z, radius)
    left = 0.5 * state.speed * state.speed / block.roll_share + gravity * (state.z - z)
    if left <= 0.0:
        return math.inf
    state.x = x
    state.z = z
    state.speed = math.sqrt(2.0 * left / block.roll_share)
    state.omega = state.direction * state.speed / radius
    state.phase = ROLLING
    return -1.0


@inlined
def _friction(state: Record, block: Block, site: Site) -> float:
    """Return the friction on the segment under a block that rolls or slides."""
    ground = site.grounds[site.profile.rows[state.segment].ground]
    if state.phase == ROLLING:
        return rolling.rolling_friction(block, ground)
    return float(ground.mu_f)


@fused
def _look_ahead(
    state: Record, block: Block, site: Site, physics: Physics, pull: float, fade: float,
    tips_at: float,
) -> tuple[float, float, int, float, int]:  # fmt: skip
    """Find how far a block rolls or slides before something else begins, and what.

    Returns the length (m), the chainage at its end (m), one of the kinds in rolling.py, with
    LIFT_OFF how long before the ellipse stands upright (rad), the segment that is met or -1.

    ``pull`` is its acceleration (m/s²), ``fade`` how that falls (1/m), ``tips_at`` the speed at
    which it tips over (m/s).
    """
    profile = site.profile
    here = profile.rows[state.segment]
    direction = state.direction
    ux = here.tx
    uz = here.tz
    v = state.speed
    u = along(profile, state.segment, state.x, state.z)
    length = max(here.length - u if direction > 0 else u, 0.0)
    ends_by = rolling.SEGMENT_END
    if state.x + length * ux > state.reach:
        length = max((state.reach - state.x) / ux, 0.0)
        ends_by = rolling.PART
    lift = 0.0
    if pull < 0.0:
        to_stop = path_to(pull, fade, -v * v)
        if to_stop <= length:
            length = to_stop
            ends_by = rolling.STOP
    if pull > 0.0 and tips_at < math.inf:
        to_tip = path_to(pull, fade, tips_at * tips_at - v * v)
        if to_tip < length:
            length = to_tip
            ends_by = rolling.TO_ROLLING
    wide = block.a
    narrow = block.b
    if state.phase == ROLLING:
        wide = block.roll_radius
        narrow = block.roll_radius
        is_round = block.a - block.b < 1e-12 * block.a
        length, ends_by, lift = rolling.rolling_stretch(
            block, state.theta - angle_of(profile, state.segment), direction, v, pull, fade,
            physics.gravity, ux, -uz * direction, length, ends_by,
            physics.as_ellipse and not is_round, physics.end_sliding and not is_round
        )  # fmt: skip
    # Ground ahead: the block is moved in a straight line until it touches.
    # A next segment that does not rise can only be met at the end of this one.
    after = state.segment + direction
    passed = state.segment
    if 0 <= after < profile.n[0] and turn(profile, state.segment, direction) > -STRAIGHT:
        passed = after
    moved = Flying(
        state.x, state.z, direction * ux, direction * uz, state.theta, 0.0, wide, narrow, 0.0
    )
    contact = next_contact(moved, 0.0, length, _TOUCH, profile, state.segment, passed)
    if contact.segment >= 0:
        length = contact.t
        ends_by = rolling.GROUND_AHEAD
        state.nx = contact.nx
        state.nz = contact.nz
    x_end = state.x + direction * ux * length
    first = profile.rows[0].x
    last = profile.rows[profile.n[0]].x
    if x_end > last or x_end < first:
        end_x = last if direction > 0 else first
        length = min(max((end_x - state.x) / (direction * ux), 0.0), length)
        x_end = state.x + direction * ux * length
        ends_by = rolling.PROFILE_END
    return length, x_end, ends_by, lift, contact.segment


@fused
def _advance(
    state: Record, block: Block, site: Site, output: Output, stretch: Stretch, length: float,
    pull: float, fade: float,
) -> None:  # fmt: skip
    """Move a block over a stretch of some length (m), and record what it passes."""
    here = site.profile.rows[state.segment]
    direction = state.direction
    v2, dv2 = stretch.speed2, stretch.gain
    spin2, dspin2 = stretch.spin2, stretch.spin_gain
    steady = pull + fade * v2
    n_touched, number = record_ground(
        site.stretches, output.work, state.n_touched, state.stretch, state.x, stretch.x_end, v2,
        dv2, 0.5 * block.inertia * spin2, 0.5 * block.inertia * dspin2,
        abs(stretch.x_end - state.x), length, state.began + state.t, steady, fade
    )  # fmt: skip
    state.n_touched = n_touched
    state.stretch = number
    speed = math.sqrt(max(v2 + dv2, 0.0))
    fast2 = max(v2, v2 + dv2)
    energy = 0.5 * fast2 + 0.5 * block.inertia * max(spin2, spin2 + dspin2)
    state.top_speed = max(state.top_speed, math.sqrt(fast2))
    state.top_energy = max(state.top_energy, energy)
    state.t += time_over(steady, fade, state.speed, speed, length)
    state.x += direction * here.tx * length
    state.z += direction * here.tz * length
    state.speed = speed
    if state.phase == ROLLING:
        state.theta -= direction * length / block.roll_radius
        state.omega = direction * math.sqrt(max(spin2 + dspin2, 0.0))
    if length > 0.0:
        state.moved = True


@fused
def ground_motion(
    state: Record,
    block: Block,
    site: Site,
    output: Output,
    physics: Physics,
    effects: hooks.Effects | None,
) -> None:
    """Roll or slide along a segment until something else begins."""
    here = site.profile.rows[state.segment]
    ux = here.tx
    uz = here.tz
    g = physics.gravity
    mu = _friction(state, block, site)
    down = -uz * state.direction
    if state.speed <= 0.0:
        state.speed = 0.0
        if abs(uz) <= mu * ux:
            end_at_rest(state, block)
            return
        state.direction = 1 if uz < 0.0 else -1
        down = abs(uz)
    direction = state.direction
    tips_at = math.inf
    if state.phase == SLIDING and physics.tipping and tips(block, mu):
        tips_at = _tip(state, block, site, g, down)
        if state.phase == ROLLING:
            mu = _friction(state, block, site)
            tips_at = math.inf
    own_fade = rolling.growth(block, site.grounds[here.ground], physics) * g * ux
    own_pull = g * (down - mu * ux) - own_fade * state.speed * state.speed
    pull, fade, longest = hooks.before_stretch(effects, state, block, site, own_pull, own_fade, ux)
    state.vx = state.speed * direction * ux
    state.vz = state.speed * direction * uz
    log_event(output.log, state, direction * ux, direction * uz)

    length, x_end, ends_by, lift, met = _look_ahead(
        state, block, site, physics, pull, fade, tips_at
    )
    cut = longest < length
    if cut:
        length = longest
        x_end = state.x + direction * ux * length
        ends_by = rolling.PART
    gain = -state.speed * state.speed
    if ends_by != rolling.STOP:
        gain = hooks.gain_over(effects, state, block, gained(own_pull, own_fade, length), length)
    stretch = _gains(state, block, x_end, gain, length, fade, mu * g * ux)
    barrier = no_meeting()
    if site.crossings.n[0] > 0:
        barrier = control_lines_on_ground(
            state, block, site, output, stretch, direction * ux, direction * uz, g
        )
    at_barrier = barrier.line >= 0
    if at_barrier:
        length *= barrier.when
        stretch = up_to(stretch, site.crossings.rows[barrier.line].x, barrier.when)
    _advance(state, block, site, output, stretch, length, pull, fade)
    if at_barrier:
        state.x = stretch.x_end
    state.lines_from = state.x
    state.furthest = max(state.furthest, state.x)
    hooks.after_stretch(effects, state, block, at_barrier or not cut)
    state.vx = direction * state.speed * ux
    state.vz = direction * state.speed * uz
    if at_barrier:
        state.speed *= barrier.speed_left
        state.omega *= barrier.speed_left
        after_barrier(state, block, site, output, physics, barrier, 0.0)
    elif ends_by == rolling.PART:
        same_event(state, physics)
    else:
        _go_on(state, block, site, physics, ends_by, lift, met)


@inlined
def _gains(
    state: Record, block: Block, x_end: float, dv2: float, length: float, fade: float,
    friction: float,
) -> Stretch:  # fmt: skip
    """Return squares of speed and spin over a stretch; ``friction`` is per unit mass (m/s²)."""
    v2 = state.speed * state.speed
    spin2 = state.omega * state.omega
    dspin2 = 0.0
    if state.phase == ROLLING:
        # Friction can turn the block no faster than its work allows.
        target = max(v2 + dv2, 0.0) / (block.roll_radius * block.roll_radius)
        dspin2 = min(target - spin2, 2.0 * friction * length / block.inertia)
    return Stretch(state.x, x_end, v2, dv2, spin2, dspin2, 2.0 * fade * length)


@fused
def _go_on(
    state: Record, block: Block, site: Site, physics: Physics, what: int, lift: float, met: int
) -> None:
    """Begin what ends a stretch, as _look_ahead has it."""
    if what == rolling.PROFILE_END:
        end(state, LEFT_PROFILE)
    elif what == rolling.GROUND_AHEAD:
        state.segment = met
        state.as_circle = physics.corner_as_circle and state.phase == ROLLING
        state.phase = IMPACT
    elif what == rolling.TO_SLIDING:
        state.omega = 0.0
        state.phase = SLIDING
    elif what == rolling.LIFT_OFF:
        _lift_off(state, block, site, physics.gravity, lift)
    elif what == rolling.SEGMENT_END:
        after = state.segment + state.direction
        if after < 0 or after >= site.profile.n[0]:
            end(state, LEFT_PROFILE)
            return
        if turn(site.profile, state.segment, state.direction) > STRAIGHT:
            state.skip_to = state.segment
            state.phase = FLIGHT
        state.segment = after


@lean
def _lift_off(state: Record, block: Block, site: Site, gravity: float, lift: float) -> None:
    """Let a rolling ellipse leave the ground where the normal force on it ends."""
    here = site.profile.rows[state.segment]
    ux = here.tx
    uz = here.tz
    direction = state.direction
    # Its centre is where it then stands.
    state.theta = 0.5 * math.pi + direction * lift + angle_of(site.profile, state.segment)
    c, s = cos_sin(lift)
    lever, support, _ = frame_of(block.a, block.b, c, -direction * s)
    rise = support - block.roll_radius
    # No energy arises even where the spin lags behind the speed.
    energy = (
        0.5 * (state.speed * state.speed + block.inertia * state.omega * state.omega)
        - gravity * ux * rise
    )
    spin = math.sqrt(2.0 * max(energy, 0.0) / (block.inertia + lever * lever + support * support))
    omega = direction * spin
    state.omega = omega
    state.x += rise * -uz
    state.z += rise * ux
    state.vx = support * omega * ux + lever * omega * uz
    state.vz = support * omega * uz - lever * omega * ux
    state.clear_from = FIRST_TURN / max(spin, 1e-3)
    state.phase = FLIGHT
