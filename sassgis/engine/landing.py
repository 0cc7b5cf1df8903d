"""Contact of a block with the ground: it lands softly or rebounds, then flies, rolls or slides."""

from __future__ import annotations

import math

from sassgis.compiled import rng
from sassgis.compiled.jit import fused, inlined, lean
from sassgis.engine.contact import resting_height
from sassgis.engine.effects import hooks
from sassgis.engine.ellipse import CountedRows, Record, Records, cos_sin, frame_of
from sassgis.engine.impact import RESTITUTION, impact, normal_force, soft_landing
from sassgis.engine.profile import along, foot_segment
from sassgis.engine.rolling import growth, rolling_friction
from sassgis.engine.state import (
    BROKEN,
    FLIGHT,
    ROLLING,
    SLIDING,
    Block,
    Output,
    Physics,
    Site,
    end,
    end_at_rest,
    log_event,
)

#: A flight that begins in contact without a normal speed is checked again after this turn (rad).
FIRST_TURN = 1e-4
# A block that bounces on one spot with less energy than this share of g r is at rest.
_REST_SHARE = 1e-3
_SAME_SPOT = 1e-3
_MOST_ON_SPOT = 20
# Speed along the ground, over that of the surface, below which there is none.
_STOPPED = 1e-9


@lean
def _kinetic(block: Block, vx: float, vz: float, omega: float) -> float:
    """Return the kinetic energy (J/kg)."""
    return 0.5 * (vx * vx + vz * vz + block.inertia * omega * omega)


@lean
def _trembles(state: Record, block: Block, energy: float, gravity: float) -> bool:
    """Return whether contacts on one spot show that a block has come to rest."""
    if abs(state.x - state.spot_x) + abs(state.z - state.spot_z) < _SAME_SPOT * block.radius:
        state.crowded += 1
        return bool(state.crowded > _MOST_ON_SPOT and energy < _REST_SHARE * gravity * block.radius)
    state.crowded = 0
    state.spot_x = state.x
    state.spot_z = state.z
    return False


@lean
def _varied_normal(state: Record, block: Block, site: Site, vt: float) -> tuple[float, float]:
    """Return normal of the ground that an impact meets, with the slope varied on descending ground.

    tan β' = tan β (1 − u), Bozzolo and Pamini (1986), Table 1.
    """
    nx = state.nx
    nz = state.nz
    here = site.profile.rows[state.segment]
    on_segment = abs(nx + here.tz) + abs(nz - here.tx) < 1e-9
    if not (on_segment and vt * -nx < 0.0):
        return nx, nz
    ground = site.grounds[here.ground]
    u = rng.between(block.key, rng.SLOPE, state.slope_draws, ground.dp_min, ground.dp_max)
    state.slope_draws += 1
    p = -nx / nz * (1.0 - u)
    mz = 1.0 / math.sqrt(1.0 + p * p)
    return -p * mz, mz


@lean
def _resistance(block: Block, ground: Record, speed: float, growing: float) -> float:
    """Return (μ_r + μ_v v²/(g d)) (1 + I/r²): energy of rolling over normal force and path."""
    mu_r = rolling_friction(block, ground)
    return float(block.roll_share * (mu_r + growing * speed * speed))


@fused
def _rebound(
    state: Record, block: Block, site: Site, output: Output, physics: Physics,
    effects: hooks.Effects | None, ct: float, st: float, vt: float, energy: float,
    as_circle: bool, round_m: float,
) -> bool:  # fmt: skip
    """Change the velocity by an impact; return whether it breaks the block.

    ``ct`` and ``st`` are cosine and sine of its angle, ``vt`` its velocity along the ground (m/s),
    ``energy`` its kinetic energy before (J/kg). If it is met ``as_circle``, as it rolls, the slope
    is not varied: rolling friction includes the roughness of the ground. ``round_m`` is the radius
    of the circle as which it is met (m), 0 for the ellipse.
    """
    state.impacts += 1
    here = site.profile.rows[state.segment]
    ground = site.grounds[here.ground]
    mx = state.nx
    mz = state.nz
    if physics.slope_variation and not as_circle:
        mx, mz = _varied_normal(state, block, site, vt)
    mx, mz, rule, friction = hooks.on_contact(
        effects, state, block, ground, mx, mz, physics.eta_rule, ground.mu_f
    )
    px, py, _ = frame_of(block.a, block.b, st * mz + ct * mx, ct * mz - st * mx)
    if round_m > 0.0:
        px, py = 0.0, round_m
    log_event(output.log, state, mz, -mx)
    vx = state.vx
    vz = state.vz
    ploughing = 1.0 - ground.eta_max
    growing = growth(block, ground, physics)
    if as_circle:
        # It goes on rolling: the corner costs as much energy as rolling.
        ploughing = _resistance(block, ground, vx * mz - vz * mx, growing)
        growing = 0.0
    wt, wn, omega = impact(
        px, py, block.inertia, vx * mz - vz * mx, vx * mx + vz * mz, state.omega, ground.eta_max,
        rule, friction, ground.restitution, ground.restitution_speed_mps, ploughing, growing
    )  # fmt: skip
    wt, wn, omega = hooks.after_impact(
        effects, state, block, ground, -(vx * mx + vz * mz), wt, wn, omega
    )
    state.vx = wt * mz + wn * mx
    state.vz = wn * mz - wt * mx
    state.omega = omega
    lost = energy - _kinetic(block, state.vx, state.vz, omega)
    return hooks.on_loss(effects, state, block, output.spawned, here, ground, lost)


@fused
def land(
    state: Record,
    block: Block,
    site: Site,
    output: Output,
    physics: Physics,
    effects: hooks.Effects | None,
) -> None:
    """Turn a contact with ground of normal (nx, nz) into flight, motion along the ground or rest.

    A block that reaches the ground slowly lands softly, without an impact: it turns about the point
    of contact, equations (3) to (5) of Bozzolo and Pamini (1986).
    """
    g = physics.gravity
    nx = state.nx
    nz = state.nz
    # The tangent points to the right.
    ux = nz
    uz = -nx
    vt = state.vx * ux + state.vz * uz
    vn = state.vx * nx + state.vz * nz
    ct, st = cos_sin(state.theta)
    lever, support, curvature = frame_of(block.a, block.b, st * ux - ct * uz, ct * ux + st * uz)
    as_circle = state.as_circle
    round_m = _radius_met(state, block)
    state.as_circle = False
    state.by_core = False
    if round_m > 0.0:
        lever, support, curvature = 0.0, round_m, 0.0
    energy = _kinetic(block, state.vx, state.vz, state.omega)
    if _trembles(state, block, energy, g):
        end_at_rest(state, block)
        return
    low = _soft_speed2(state, block, site, g, nz)
    # A start with spin has a normal speed of rounding only, of either sign.
    soft = vn <= 1e-9 * abs(vt) and vn * vn < low
    if soft:
        resistance = 0.0
        if physics.eta_rule == RESTITUTION:
            ground = site.grounds[site.profile.rows[state.segment].ground]
            resistance = _resistance(block, ground, vt, growth(block, ground, physics))
        wt, wn, omega = soft_landing(lever, support, block.inertia, vt, vn, state.omega, resistance)
        if physics.point:
            # Friction takes of its speed along the ground what it holds of that into it.
            friction = site.grounds[site.profile.rows[state.segment].ground].mu_f
            wt = math.copysign(max(abs(vt) - friction * abs(vn), 0.0), vt)
            wn, omega = 0.0, 0.0
        state.omega = omega
    else:
        if _rebound(
            state, block, site, output, physics, effects, ct, st, vt, energy, as_circle, round_m
        ):
            end(state, BROKEN)
            return
        omega = state.omega
        wt = state.vx * ux + state.vz * uz
        wn = state.vx * nx + state.vz * nz
        if _leaves(physics, as_circle, wn, wn + lever * omega, low):
            if as_circle:
                _leave_as_ellipse(state, block)
            state.phase = FLIGHT
            return
        force = normal_force(lever, support, curvature, block.inertia, omega, nz, -uz, g)
        if force < 0.0 and curvature * omega * omega < -g * nz:
            state.clear_from = FIRST_TURN / abs(omega)
            state.phase = FLIGHT
            return
    state.direction = way_on(wt, omega, block.radius)
    state.segment = foot_segment(site.profile, state.segment, state.x, state.z, state.direction)
    # Of a soft landing before it, which lifts the centre of a block that lies across.
    recedes = _recedes(state, block, site, g) and (
        # About an edge the centre turns as about a fixed point; the weight may hold it there.
        normal_force(lever, support, -support, block.inertia, omega, nz, -uz, g) < 0.0
    )
    state.vx = wt * ux + wn * nx
    state.vz = wt * uz + wn * nz
    if recedes:
        if as_circle:
            _leave_as_ellipse(state, block)
        state.skip_to = state.segment - state.direction
        state.clear_from = FIRST_TURN / max(abs(omega), 1e-3)
        state.phase = FLIGHT
        return
    _settle(state, block, site, physics, wt, _kinetic(block, wt, wn, omega))


@lean
def _soft_speed2(state: Record, block: Block, site: Site, gravity: float, nz: float) -> float:
    """Return the squared normal speed below which a segment is reached softly (m²/s²)."""
    threshold = site.grounds[site.profile.rows[state.segment].ground].rolling_threshold
    return float(2.0 * gravity * nz * threshold * block.radius)


@lean
def _recedes(state: Record, block: Block, site: Site, gravity: float) -> bool:
    """Return whether a block leaves the segment of its motion, as beyond a convex edge."""
    here = site.profile.rows[state.segment]
    away = state.vz * here.tx - state.vx * here.tz
    low = _soft_speed2(state, block, site, gravity, here.tx)
    return bool(away > 1e-9 * abs(state.vx) and away * away >= low)


@inlined
def _radius_met(state: Record, block: Block) -> float:
    """Return the radius of the circle as which a block meets the ground (m), 0 for its ellipse."""
    if state.as_circle:
        return float(block.roll_radius)
    return float(block.b) if state.by_core else 0.0


@inlined
def _leaves(physics: Physics, as_circle: bool, wn: float, contact: float, low: float) -> bool:
    """Return whether these final normal speeds of centre and contact start a flight (m/s).

    ``low`` is the square of that below which a rebound of only the contact does not count.
    """
    if physics.eta_rule == RESTITUTION and contact > 1e-12 and contact * contact >= low:
        return True
    return wn > 1e-12 and not as_circle


@lean
def _leave_as_ellipse(state: Record, block: Block) -> None:
    """Turn a block that leaves a corner so that its ellipse touches the ground as its circle did.

    Of the two orientations the one whose flank recedes.
    """
    a2 = block.a * block.a
    b2 = block.b * block.b
    if a2 - b2 > 1e-12 * a2:
        sine2 = (block.roll_radius * block.roll_radius - b2) / (a2 - b2)
        lean = math.asin(math.sqrt(min(max(sine2, 0.0), 1.0)))
        state.theta = math.atan2(-state.nx, state.nz) + math.copysign(lean, state.omega)


@inlined
def way_on(wt: float, omega: float, radius: float) -> int:
    """Return the direction along the ground, 1 or -1, of a block with velocity (m/s) and spin.

    A block stopped along the ground goes on in the direction of its spin, not by rounding.
    """
    return 1 if wt + _STOPPED * omega * radius >= 0.0 else -1


@lean
def _settle(
    state: Record, block: Block, site: Site, physics: Physics, wt: float, energy: float
) -> None:
    """Go on along the ground: roll if the energy suffices, else slide, else rest.

    The block rolls, all its energy going into rolling, if that lifts its centre to where a rolling
    block has it; else it ends by sliding.
    """
    profile = site.profile
    direction = state.direction
    segment = state.segment
    here = profile.rows[segment]
    u = min(max(along(profile, segment, state.x, state.z), 0.0), here.length)
    foot_x = here.x + u * here.tx
    foot_z = here.z + u * here.tz
    radius = block.roll_radius
    roll_x, roll_z = rolling_place(profile, segment, foot_x, foot_z, radius)
    gravity = physics.gravity
    lifted = energy + gravity * (state.z - roll_z)
    if lifted > 0.0 and not physics.point:
        state.speed = math.sqrt(2.0 * lifted / block.roll_share)
        state.omega = direction * state.speed / radius
        state.x = roll_x
        state.z = roll_z
        state.phase = ROLLING
    else:
        _slide_or_rest(state, block, site.grounds, profile, gravity, wt, foot_x, foot_z)


@lean
def rolling_place(
    profile: CountedRows, segment: int, foot_x: float, foot_z: float, radius: float
) -> tuple[float, float]:
    """Find the centre of a block that rolls as a circle over a foot without obstacles."""
    here = profile.rows[segment]
    x = foot_x - radius * here.tz
    z = foot_z + radius * here.tx
    return x, max(z, resting_height(x, 0.0, radius, radius, profile, segment))


@lean
def _slide_or_rest(
    state: Record, block: Block, grounds: Records, profile: CountedRows, gravity: float, wt: float,
    foot_x: float, foot_z: float,
) -> None:  # fmt: skip
    """Let a block slide in its orientation; it is wedged if its centre had to rise first."""
    here = profile.rows[state.segment]
    ct, st = cos_sin(state.theta)
    _, support, _ = frame_of(
        block.a, block.b, st * here.tx - ct * here.tz, ct * here.tx + st * here.tz
    )
    slide_x = foot_x - support * here.tz
    slide_z = max(
        foot_z + support * here.tx,
        resting_height(slide_x, state.theta, block.a, block.b, profile, state.segment),
    )
    drop_to = state.z - slide_z
    left_over = 0.5 * wt * wt + gravity * min(drop_to, 0.0)
    friction = grounds[here.ground].mu_f
    if left_over <= 0.0 and (drop_to < -1e-9 or abs(here.tz) <= friction * here.tx):
        end_at_rest(state, block)
        return
    state.speed = math.sqrt(max(2.0 * left_over, 0.0))
    state.omega = 0.0
    state.x = slide_x
    state.z = slide_z
    state.phase = SLIDING
