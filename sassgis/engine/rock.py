"""The course of one rock: flight, impact, rolling, sliding, and the switches between them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.barriers import (
    HELD_BY_NET,
    PASSED,
    STOPPED,
    control_lines_in_flight,
    control_lines_on_ground,
)
from sassgis.engine.contact import next_contact, resting_height
from sassgis.engine.effects import (
    air_drag,
    entrainment,
    fragmentation,
    rock_shape,
    roughness,
    soft_ground,
    trees,
)
from sassgis.engine.effects.state import (
    BORN_OMEGA,
    BORN_T,
    BORN_THETA,
    BORN_VX,
    BORN_VZ,
    BORN_X,
    BORN_Z,
    Effects,
    Spawned,
)
from sassgis.engine.ellipse import frame_of, inertia, mean_radius
from sassgis.engine.impact import COULOMB, impact, normal_force, turn_about_contact
from sassgis.engine.recording import CellWork, Pieces, record_flight, record_ground
from sassgis.engine.rolling import (
    GROUND_AHEAD,
    LIFT_OFF,
    PART,
    PROFILE_END,
    SEGMENT_END,
    STOP,
    TO_SLIDING,
    rolling_stretch,
)
from sassgis.engine.state import Block, ControlLines, Course, Physics, Profile
from sassgis.model import rng
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel

# Phases, as they are written to the course of a rock.
FLIGHT, IMPACT, ROLLING, SLIDING, END = 0, 1, 2, 3, 4

# Why a rock ends; the same numbers as core.results.StopReason.
REST, BARRIER, LEFT_PROFILE, STEP_LIMIT, NEVER_STARTED, BROKEN = 0, 1, 2, 3, 4, 5

# Gap at which a rock that moves along the ground touches ground ahead of it (m).
_TOUCH = 1e-11
# Distance from the end of a segment at which a rock counts as past it (m).
_FOOT = 1e-5
# Turns below this angle between two segments are no vertex (rad).
_STRAIGHT = 1e-9
# A flight that begins in contact without a normal speed is looked at again after this turn (rad).
_FIRST_TURN = 1e-4
# A rock that bounces on one spot with less energy than this share of g r is at rest.
_REST_SHARE = 1e-3
_SAME_SPOT = 1e-3
# Shortest way along the ground between two turns of a viscous force (m): at the pace of a crawl.
_CREEP = 0.1
# Effects cut a flight or a stretch of rolling into so many steps at most, on average.
_STEPS_PER_EVENT = 50


@kernel
def _note(
    course: Course,
    phase: int,
    t: float,
    x: float,
    z: float,
    vx: float,
    vz: float,
    theta: float,
    omega: float,
    segment: int,
    ux: float,
    uz: float,
) -> None:
    """Write one event of the course."""
    i = course.filled[0]
    if i < course.rows.shape[0]:
        row = course.rows[i]
        row[0] = phase
        row[1] = t
        row[2] = x
        row[3] = z
        row[4] = vx
        row[5] = vz
        row[6] = theta
        row[7] = omega
        row[8] = segment
        row[9] = ux
        row[10] = uz
        course.filled[0] = i + 1


@kernel
def _segment_at(profile: Profile, x: float, near: int) -> int:
    """The segment under chainage x."""
    j = near
    n = profile.tx.size
    while j > 0 and profile.sx[j] > x:
        j -= 1
    while j < n - 1 and profile.sx[j + 1] < x:
        j += 1
    return j


@kernel
def _foot_segment(profile: Profile, j: int, x: float, z: float, way: int) -> int:
    """The segment along which a rock that touches segment j moves on in direction ``way``."""
    n = profile.tx.size
    while True:
        u = (x - profile.sx[j]) * profile.tx[j] + (z - profile.sz[j]) * profile.tz[j]
        if way > 0 and u >= profile.length[j] - _FOOT and j < n - 1:
            j += 1
        elif way < 0 and u <= _FOOT and j > 0:
            j -= 1
        else:
            break
    # Where only the kind of ground changes, the foot decides also behind.
    while True:
        u = (x - profile.sx[j]) * profile.tx[j] + (z - profile.sz[j]) * profile.tz[j]
        if way > 0 and u < 0.0 and j > 0 and abs(_turn(profile, j, -1)) < _STRAIGHT:
            j -= 1
        elif (
            way < 0
            and u > profile.length[j]
            and j < n - 1
            and abs(_turn(profile, j, 1)) < _STRAIGHT
        ):
            j += 1
        else:
            return j


@kernel
def _turn(profile: Profile, j: int, way: int) -> float:
    """Sine of the turn from segment j to the next in direction ``way``; above 0: convex."""
    k = j + way
    cross = profile.tx[j] * profile.tz[k] - profile.tz[j] * profile.tx[k]
    return float(-way * cross)


@kernel
def _to_border(pieces: Pieces, piece: int, x: float, way: int) -> tuple[int, float]:
    """Cell ahead of a rock that moves in direction ``way``, and the distance to its end."""
    n = pieces.cell.size
    while way > 0 and piece < n - 1 and pieces.border[piece + 1] <= x + _FOOT:
        piece += 1
    while way < 0 and piece > 0 and pieces.border[piece] >= x - _FOOT:
        piece -= 1
    gap = pieces.border[piece + 1] - x if way > 0 else x - pieces.border[piece]
    return pieces.cell[piece], max(gap, _FOOT)


@kernel
def _bear_pieces(
    effects: Effects,
    spawned: Spawned,
    block: Block,
    number: int,
    x: float,
    z: float,
    vx: float,
    vz: float,
    theta: float,
    omega: float,
    t: float,
) -> bool:
    """Break a block in flight into pieces at time t; False if it is too small to break."""
    volume = 4.0 / 3.0 * math.pi * block.a * block.b * block.c
    n = fragmentation.shares(effects.breaking, volume, spawned.share)
    if n < 2:
        return False
    ahead = fragmentation.ways(effects.breaking, block.key, number, n, spawned.share, spawned.side)
    spin = math.sqrt(1.0 - effects.breaking.loss) * omega
    for i in range(n):
        size = spawned.share[i] ** (1.0 / 3.0)
        side = spawned.side[i]
        _bear(
            spawned, x, z, ahead * (vx - side * vz), ahead * (vz + side * vx), theta, spin,
            size * block.a, size * block.b, size * block.c, spawned.share[i] * block.mass, t,
        )  # fmt: skip
    return True


@kernel
def _set_off(
    effects: Effects,
    spawned: Spawned,
    block: Block,
    number: int,
    lost: float,
    x: float,
    way: int,
    theta: float,
    ux: float,
    uz: float,
    t: float,
) -> None:
    """Set blocks of the ground in motion at time t with energy that an impact took (J).

    They leave the ground on which they lie flat, under the rock: without a height they get the one
    at which they rest.
    """
    n = entrainment.blocks_set_off(effects.set_off, block.key, number, lost)
    if n == 0:
        return
    size = effects.set_off.ratio
    mass = block.mass * size**3
    speed = entrainment.speed_of_each(effects.set_off, n, lost, mass)
    for i in range(n):
        angle = entrainment.angle_of(block.key, number, i)
        along = way * speed * math.cos(angle)
        up = speed * math.sin(angle)
        _bear(
            spawned, x, -np.inf, along * ux - up * uz, along * uz + up * ux, theta, 0.0,
            size * block.a, size * block.b, size * block.c, mass, t,
        )  # fmt: skip


@kernel
def _bear(
    spawned: Spawned,
    x: float,
    z: float,
    vx: float,
    vz: float,
    theta: float,
    omega: float,
    a: float,
    b: float,
    c: float,
    mass: float,
    t: float,
) -> None:
    """Add a birth at time t since the release; one without room is counted only."""
    i = spawned.born[0]
    spawned.born[0] = i + 1
    if i < spawned.rows.shape[0]:
        row = spawned.rows[i]
        row[0] = x
        row[1] = z
        row[2] = vx
        row[3] = vz
        row[4] = theta
        row[5] = omega
        row[6] = a
        row[7] = b
        row[8] = c
        row[9] = mass
        row[10] = t


@kernel
def follow(
    block: Block,
    profile: Profile,
    ground_table: FloatArray,
    physics: Physics,
    control_lines: ControlLines,
    seen: NDArray[np.bool_],
    passages: FloatArray,
    pieces: Pieces,
    work: CellWork,
    course: Course,
    start_x: float,
    speed: float,
    spin: float,
    drop: float,
    orientation: float,
    effects: Effects | None,
    birth: FloatArray | None,
    spawned: Spawned | None,
) -> tuple[int, float, float, float, float, int, float, float, float, int, int]:
    """Follow one rock from its release to its end.

    Parameters
    ----------
    effects, birth, births
        None for the model of 1986 alone; numba then leaves out all that is about them. Otherwise
        ``birth`` is a row of ``births`` if the block comes into being in flight, or empty.

    Returns
    -------
    reason : int
    x, z : float
        Where the centre ends (m).
    furthest : float
        Largest chainage that it came to (m).
    t : float
        (s)
    impacts : int
    top_speed, top_height, top_energy : float
        (m/s, m, J per kg)
    n_passages, n_touched : int
        Rows of ``passages`` and cells of ``work`` that were filled.
    """
    a = block.a
    b = block.b
    sx = profile.sx
    sz = profile.sz
    tx = profile.tx
    tz = profile.tz
    n = tx.size
    g = physics.gravity
    inert = inertia(a, b)
    radius = (a * b * block.c) ** (1.0 / 3.0)
    roll_radius = mean_radius(a, b)
    roll_share = 1.0 + inert / (roll_radius * roll_radius)
    round_rock = a - b < 1e-12 * a
    resistance = 0.0
    width = 2.0 * block.c
    to_stem = np.inf
    stems_met = 0
    stem_rate = 0.0
    stem_cell = -1
    at_stem = False
    if effects is not None:
        if effects.shape.form == rock_shape.MEAN_INERTIA:
            inert = rock_shape.tumbling_inertia(a, b, block.c)
            roll_share = 1.0 + inert / (roll_radius * roll_radius)
        resistance = air_drag.resistance(effects.drag, a, b, block.c, block.mass)
        if effects.stand.form != trees.OFF:
            to_stem = trees.to_next_stem(block.key, 0)

    seg = _segment_at(profile, start_x, 0)
    theta = orientation + profile.angle[seg]
    x = start_x
    z = resting_height(x, theta, a, b, sx, sz, tx, tz, seg) + drop
    vx = speed * tx[seg]
    vz = speed * tz[seg]
    omega = spin
    t = 0.0
    began = 0.0
    piece = 0
    while piece < pieces.cell.size - 1 and pieces.border[piece + 1] < x:
        piece += 1
    # A literal 0 would make numba compile what it is passed to once for 0 and once for the rest.
    n_passages = int(np.int64(0))
    n_touched = int(np.int64(0))
    impacts = 0
    slope_draws = 0
    top_speed = 0.0
    top_height = 0.0
    top_energy = 0.0
    furthest = x
    control_lines_from = x
    reason = STEP_LIMIT
    held_at = np.inf
    spot_x = -np.inf
    spot_z = -np.inf
    crowded = 0
    moved = False

    # Start: let fall; or, at rest or pushed without spin, slide; or roll.
    skip_to = int(np.int64(-1))
    clear_from = 0.0
    way = 1
    if drop > 0.0:
        phase = FLIGHT
    else:
        row = ground_table[profile.ground[seg]]
        steep = abs(tz[seg]) / tx[seg]
        if speed == 0.0 and spin == 0.0:
            way = 1 if tz[seg] <= 0.0 else -1
            mu_roll = row[4] + row[5] * row[6] / (2.0 * radius)
            if steep > row[3]:
                phase = SLIDING
            elif steep > mu_roll:
                phase = ROLLING
                z = resting_height(x, 0.0, roll_radius, roll_radius, sx, sz, tx, tz, seg)
            else:
                phase = END
                reason = NEVER_STARTED
        elif spin == 0.0:
            phase = SLIDING
        else:
            phase = IMPACT
    nx = -tz[seg]
    nz = tx[seg]
    v = speed
    if effects is not None and birth is not None and birth.size > 0:
        x = birth[BORN_X]
        seg = _segment_at(profile, x, seg)
        theta = birth[BORN_THETA]
        z = max(birth[BORN_Z], resting_height(x, theta, a, b, sx, sz, tx, tz, seg))
        vx = birth[BORN_VX]
        vz = birth[BORN_VZ]
        omega = birth[BORN_OMEGA]
        began = birth[BORN_T]
        phase = FLIGHT
        reason = STEP_LIMIT
        furthest = x
        control_lines_from = x
        moved = True
        while piece < pieces.cell.size - 1 and pieces.border[piece + 1] < x:
            piece += 1

    # Calls that have nothing to do are left out: passing arrays costs more than most of them.
    noting = course.rows.shape[0] > 0
    guarded = control_lines.x.size > 0
    t_control_line = np.inf
    lift = 0.0
    share = 1.0
    outcome = PASSED
    left = 1.0
    events = 0
    steps = 0
    while phase != END:
        events += 1
        if events > physics.max_events:
            reason = STEP_LIMIT
            break

        if phase == FLIGHT:
            if noting:
                _note(course, FLIGHT, t, x, z, vx, vz, theta, omega, -1, 0.0, 0.0)
            if vx > 1e-9:
                limit = (sx[n] - x) / vx
            elif vx < -1e-9:
                limit = (sx[0] - x) / vx
            else:
                limit = 1e6
            limit = max(limit, 0.0)
            cut = False
            if effects is not None:
                at_stem = False
                stem_rate = 0.0
                if effects.drag.form != air_drag.OFF and effects.drag.step < limit:
                    limit = effects.drag.step
                    cut = True
                if effects.stand.form != trees.OFF:
                    stem_cell, gap = _to_border(pieces, piece, x, 1 if vx >= 0.0 else -1)
                    if trees.stands_on(effects.stand, stem_cell):
                        here = _segment_at(profile, x, seg)
                        slope = tz[here] / tx[here]
                        under, ends = trees.time_to_height(
                            effects.stand, z - sz[here] - (x - sx[here]) * slope, vz - slope * vx, g
                        )
                        if not under:
                            stem_cell = -1
                        ends = min(ends, trees.longest_step(effects.stand, stem_cell, block.mass))
                        if ends < limit:
                            limit = ends
                            cut = True
                        stem_rate = trees.stems_per_metre(effects.stand, stem_cell, width)
                    if stem_rate * gap >= to_stem:
                        gap = to_stem / stem_rate
                        at_stem = True
                    if gap < limit * abs(vx):
                        limit = gap / abs(vx)
                        cut = True
                    else:
                        at_stem = False
                # Half of a drag before the step and the rest after it: second order in its length.
                had = vx * vx + vz * vz + 2.0 * g * z
                vx, vz = air_drag.slowed(resistance, vx, vz, 0.5 * limit)
                kept = trees.left_by_viscous(effects.stand, stem_cell, block.mass, 0.5 * limit)
                vx *= kept
                vz *= kept
            came_from = x
            until, hit, nx, nz = next_contact(
                x, z, vx, vz, theta, omega, a, b, g, clear_from, limit,
                physics.tolerance, sx, sz, tx, tz, seg, skip_to,
            )  # fmt: skip
            if hit < 0:
                until = limit
            control_line = -1
            if guarded:
                n_passages, t_control_line, outcome, left, control_line = control_lines_in_flight(
                    control_lines,
                    seen,
                    passages,
                    n_passages,
                    profile,
                    seg,
                    control_lines_from,
                    x,
                    z,
                    vx,
                    vz,
                    theta,
                    omega,
                    g,
                    until,
                    block,
                    inert,
                )
            spin_energy = 0.5 * inert * omega * omega
            if control_line >= 0:
                until = t_control_line
            n_touched, piece, top = record_flight(
                pieces, work, n_touched, piece, x, z, vx, vz, spin_energy, g, until, began + t,
                b, sx, sz, tx, tz,
            )  # fmt: skip
            top_height = max(top_height, top)
            wz = vz - g * until
            half = 0.5 * (vx * vx + max(vz * vz, wz * wz))
            top_speed = max(top_speed, math.sqrt(2.0 * half))
            top_energy = max(top_energy, half + spin_energy)
            x += vx * until
            z += (vz - 0.5 * g * until) * until
            vz = wz
            theta -= omega * until
            t += until
            if control_line >= 0:
                x = control_lines.x[control_line]
            control_lines_from = x
            furthest = max(furthest, x)
            if until > 0.0:
                moved = True
            if effects is not None:
                vx, vz = air_drag.slowed(resistance, vx, vz, until - 0.5 * limit)
                kept = trees.left_by_viscous(
                    effects.stand, stem_cell, block.mass, until - 0.5 * limit
                )
                vx *= kept
                vz *= kept
                # Of a step that ends early the drag before it is partly taken back, at a speed
                # that may have grown: energy is not made.
                has = vx * vx + vz * vz
                if until < 0.5 * limit and (resistance > 0.0 or kept > 1.0) and has > 0.0:
                    kept = min(math.sqrt(max(had - 2.0 * g * z, 0.0) / has), 1.0)
                    vx *= kept
                    vz *= kept
                if effects.stand.form != trees.OFF:
                    to_stem -= stem_rate * abs(x - came_from)
                    if control_line < 0 and hit < 0 and at_stem:
                        full = 0.5 * (vx * vx + vz * vz + inert * omega * omega) * block.mass
                        taken = trees.stem_loss(effects.stand, block.key, stems_met, stem_cell)
                        stems_met += 1
                        to_stem = trees.to_next_stem(block.key, stems_met)
                        kept = math.sqrt(max(1.0 - taken / full, 0.0)) if full > 0.0 else 1.0
                        vx *= kept
                        vz *= kept
                        omega *= kept
                if cut and control_line < 0 and hit < 0:
                    # The same flight goes on, and is one event.
                    clear_from = max(clear_from - until, 0.0)
                    steps += 1
                    if steps < _STEPS_PER_EVENT * physics.max_events:
                        events -= 1
                    continue
            clear_from = 0.0
            skip_to = int(np.int64(-1))
            if control_line >= 0:
                vx *= left
                vz *= left
                omega *= left
                seg = _segment_at(profile, x, seg)
                if outcome == STOPPED:
                    # It drops to the foot of the wall.
                    z = min(z, control_lines.z[control_line] + b)
                    reason = BARRIER
                    phase = END
                elif outcome == HELD_BY_NET:
                    held_at = x
                continue
            if hit < 0:
                reason = LEFT_PROFILE
                break
            seg = hit
            phase = IMPACT
            continue

        if phase == IMPACT:
            # Contact with ground of normal (nx, nz); the tangent points to the right.
            ux = nz
            uz = -nx
            vt = vx * ux + vz * uz
            vn = vx * nx + vz * nz
            st = math.sin(theta)
            ct = math.cos(theta)
            lever, support, curvature = frame_of(a, b, st * ux - ct * uz, ct * ux + st * uz)
            row = ground_table[profile.ground[seg]]
            energy = 0.5 * (vx * vx + vz * vz + inert * omega * omega)
            # Contacts on one spot: a rock that only trembles has come to rest.
            if abs(x - spot_x) + abs(z - spot_z) < _SAME_SPOT * radius:
                crowded += 1
                if crowded > 20 and energy < _REST_SHARE * g * radius:
                    reason = BARRIER if abs(x - held_at) < a else REST
                    break
            else:
                crowded = 0
                spot_x = x
                spot_z = z
            # A start with spin has a normal speed of rounding only, of either sign.
            soft = (
                vn <= 1e-9 * abs(vt) and vn * vn < 2.0 * g * nz * physics.rolling_threshold * radius
            )
            if soft:
                wt, wn, omega = turn_about_contact(lever, support, inert, vt, vn, omega)
            else:
                impacts += 1
                mx = nx
                mz = nz
                on_segment = abs(nx + tz[seg]) + abs(nz - tx[seg]) < 1e-9
                if physics.slope_variation and on_segment and vt * uz < 0.0:
                    u = rng.between(block.key, rng.SLOPE, slope_draws, row[1], row[2])
                    slope_draws += 1
                    p = uz / ux * (1.0 - u)
                    mz = 1.0 / math.sqrt(1.0 + p * p)
                    mx = -p * mz
                before = energy
                rule = physics.eta_rule
                friction = row[3]
                if effects is not None:
                    kind = profile.ground[seg]
                    if effects.rough.form != roughness.OFF and effects.rough.on[kind]:
                        turn = roughness.tilt(effects.rough, block.key, impacts, radius)
                        # A positive tilt faces the rock, whichever way it comes.
                        turn = turn if vx >= 0.0 else -turn
                        cosine = math.cos(turn)
                        sine = math.sin(turn)
                        rx = cosine * mx - sine * mz
                        rz = cosine * mz + sine * mx
                        if vx * rx + vz * rz < 0.0 and rz > 0.0:
                            mx = rx
                            mz = rz
                    if effects.soft.form == soft_ground.SLIP and effects.soft.on[kind]:
                        rule = COULOMB
                        friction = effects.soft.friction
                px, py, _ = frame_of(a, b, st * mz + ct * mx, ct * mz - st * mx)
                if noting:
                    _note(course, IMPACT, t, x, z, vx, vz, theta, omega, seg, mz, -mx)
                wt, wn, omega = impact(
                    px, py, inert, vx * mz - vz * mx, vx * mx + vz * mz, omega, row[0],
                    rule, friction,
                )  # fmt: skip
                if effects is not None:
                    kind = profile.ground[seg]
                    if effects.soft.on[kind]:
                        into = -(vx * mx + vz * mz)
                        if effects.soft.form == soft_ground.VELOCITY_SCALED and wn > 0.0:
                            wn *= soft_ground.rebound_left(effects.soft, into)
                        elif effects.soft.form == soft_ground.SCAR:
                            kept = math.sqrt(
                                soft_ground.scar_energy_left(effects.soft, block.mass, radius, into)
                            )
                            wt *= kept
                            wn *= kept
                            omega *= kept
                    if rock_shape.lands_flat(effects.shape, block.key, impacts, b, block.c):
                        omega = 0.0
                vx = wt * mz + wn * mx
                vz = wn * mz - wt * mx
                wt = vx * ux + vz * uz
                wn = vx * nx + vz * nz
                if effects is not None and spawned is not None:
                    kind = profile.ground[seg]
                    lost = before - 0.5 * (vx * vx + vz * vz + inert * omega * omega)
                    # Blocks set in motion set off no others: a chain would have no end.
                    first = birth is None or birth.size == 0
                    if (
                        first
                        and effects.set_off.form != entrainment.OFF
                        and effects.set_off.on[kind]
                    ):
                        _set_off(
                            effects, spawned, block, impacts, lost * block.mass, x,
                            1 if vx >= 0.0 else -1, profile.angle[seg], tx[seg], tz[seg], began + t,
                        )  # fmt: skip
                    if (
                        effects.breaking.form != fragmentation.OFF
                        and fragmentation.breaks(effects.breaking, block.key, impacts, lost)
                        and _bear_pieces(
                            effects, spawned, block, impacts, x, z, vx, vz, theta, omega, began + t
                        )
                    ):
                        reason = BROKEN
                        break
                if wn > 1e-12:
                    phase = FLIGHT
                    continue
                force = normal_force(lever, support, curvature, inert, omega, nz, -uz, g)
                if force < 0.0 and curvature * omega * omega < -g * nz:
                    clear_from = _FIRST_TURN / abs(omega)
                    phase = FLIGHT
                    continue
            # The rock stays on the ground and rolls on, all its energy going into rolling, if that
            # lifts its centre to where a rolling rock has it; else it ends by sliding.
            vx = wt * ux + wn * nx
            vz = wt * uz + wn * nz
            way = 1 if (wt > 0.0 or (wt == 0.0 and omega >= 0.0)) else -1
            energy = 0.5 * (wt * wt + wn * wn + inert * omega * omega)
            seg = _foot_segment(profile, seg, x, z, way)
            u = (x - sx[seg]) * tx[seg] + (z - sz[seg]) * tz[seg]
            u = min(max(u, 0.0), profile.length[seg])
            foot_x = sx[seg] + u * tx[seg]
            foot_z = sz[seg] + u * tz[seg]
            # Let down where nothing else is in the way of the rolling rock.
            roll_x = foot_x - roll_radius * tz[seg]
            roll_z = max(
                foot_z + roll_radius * tx[seg],
                resting_height(roll_x, 0.0, roll_radius, roll_radius, sx, sz, tx, tz, seg),
            )
            lifted = energy + g * (z - roll_z)
            if lifted > 0.0:
                v = math.sqrt(2.0 * lifted / roll_share)
                omega = way * v / roll_radius
                x = roll_x
                z = roll_z
                phase = ROLLING
            else:
                # It slides as it lies, if it can: a rock that would have to rise first, and
                # has not the energy, is wedged.
                _, support, _ = frame_of(
                    a, b, st * tx[seg] - ct * tz[seg], ct * tx[seg] + st * tz[seg]
                )
                slide_x = foot_x - support * tz[seg]
                slide_z = max(
                    foot_z + support * tx[seg],
                    resting_height(slide_x, theta, a, b, sx, sz, tx, tz, seg),
                )
                drop_to = z - slide_z
                left_over = 0.5 * wt * wt + g * min(drop_to, 0.0)
                row = ground_table[profile.ground[seg]]
                if left_over <= 0.0 and (drop_to < -1e-9 or abs(tz[seg]) <= row[3] * tx[seg]):
                    reason = BARRIER if abs(x - held_at) < a else REST
                    break
                v = math.sqrt(max(2.0 * left_over, 0.0))
                omega = 0.0
                x = slide_x
                z = slide_z
                phase = SLIDING
            continue

        # Rolling and sliding: along segment seg, in direction way, with speed v.
        row = ground_table[profile.ground[seg]]
        ux = tx[seg]
        uz = tz[seg]
        rolling = phase == ROLLING
        mu = row[4] + row[5] * row[6] / (2.0 * radius) if rolling else row[3]
        down = -uz * way
        if v <= 0.0:
            v = 0.0
            if abs(uz) > mu * ux:
                way = 1 if uz < 0.0 else -1
                down = abs(uz)
            else:
                reason = BARRIER if abs(x - held_at) < a else REST
                break
        pull = g * (down - mu * ux)
        u = (x - sx[seg]) * ux + (z - sz[seg]) * uz
        to_end = profile.length[seg] - u if way > 0 else u
        to_end = max(to_end, 0.0)
        what = SEGMENT_END
        way_len = to_end
        if pull < 0.0 and -v * v / (2.0 * pull) <= way_len:
            way_len = -v * v / (2.0 * pull)
            what = STOP
        if noting:
            _note(
                course, phase, t, x, z, v * way * ux, v * way * uz, theta, omega, seg, way * ux,
                way * uz,
            )  # fmt: skip
        if rolling:
            way_len, what, lift = rolling_stretch(
                a, b, inert, roll_radius, theta - profile.angle[seg], way, v, pull, g, ux, down,
                way_len, what, physics.as_ellipse and not round_rock,
                physics.end_sliding and not round_rock,
            )  # fmt: skip
        # Ground ahead: the rock is moved in a straight line until it touches.
        # A next segment that does not rise can only be met at the end of this one.
        wide = roll_radius if rolling else a
        narrow = roll_radius if rolling else b
        k = seg + way
        passed = k if 0 <= k < n and _turn(profile, seg, way) > -_STRAIGHT else seg
        ahead, hit, hit_nx, hit_nz = next_contact(
            x, z, way * ux, way * uz, theta, 0.0, wide, narrow, 0.0, 0.0, way_len,
            _TOUCH, sx, sz, tx, tz, seg, passed,
        )  # fmt: skip
        if hit >= 0:
            way_len = ahead
            what = GROUND_AHEAD
        end_x = x + way * ux * way_len
        if end_x > sx[n] or end_x < sx[0]:
            way_len = min(max(((sx[n] if way > 0 else sx[0]) - x) / (way * ux), 0.0), way_len)
            end_x = x + way * ux * way_len
            what = PROFILE_END
        if effects is not None and effects.stand.form != trees.OFF:
            stem_cell, gap = _to_border(pieces, piece, x, way)
            stem_rate = trees.stems_per_metre(effects.stand, stem_cell, width)
            at_stem = stem_rate * gap >= to_stem
            if at_stem:
                gap = to_stem / stem_rate
            long = trees.longest_step(effects.stand, stem_cell, block.mass)
            long = max((v + 0.5 * abs(pull) * long) * long, _CREEP) * ux
            if long < gap:
                gap = long
                at_stem = False
            if gap < way_len * ux:
                way_len = gap / ux
                end_x = x + way * gap
                what = PART
            else:
                at_stem = False
            # Half of the force before the stretch and half after it: second order in its length.
            v_kept = trees.left_after_way(effects.stand, stem_cell, block.mass, v, 0.5 * way_len)
            v *= v_kept
            omega *= v_kept
        came_from = x
        v2 = v * v
        dv2 = 2.0 * pull * way_len
        if what == STOP:
            dv2 = -v2
        spin2 = omega * omega
        dspin2 = 0.0
        if rolling:
            # Friction can turn the rock no faster than its work allows.
            target = max(v2 + dv2, 0.0) / (roll_radius * roll_radius)
            dspin2 = min(target - spin2, 2.0 * mu * g * ux * way_len / inert)
        control_line = -1
        if guarded:
            n_passages, share, outcome, left, control_line = control_lines_on_ground(
                control_lines,
                seen,
                passages,
                n_passages,
                control_lines_from,
                x,
                end_x,
                v2,
                dv2,
                spin2,
                dspin2,
                way * ux,
                way * uz,
                way,
                block,
                inert,
            )
        if control_line >= 0:
            way_len *= share
            dv2 *= share
            dspin2 *= share
            end_x = control_lines.x[control_line]
        chord = abs(end_x - x)
        n_touched, piece = record_ground(
            pieces, work, n_touched, piece, x, end_x, v2, dv2, 0.5 * inert * spin2,
            0.5 * inert * dspin2, chord, way_len, began + t,
        )  # fmt: skip
        new_v = math.sqrt(max(v2 + dv2, 0.0))
        fast2 = max(v2, v2 + dv2)
        top_speed = max(top_speed, math.sqrt(fast2))
        top_energy = max(top_energy, 0.5 * fast2 + 0.5 * inert * max(spin2, spin2 + dspin2))
        if v + new_v > 0.0:
            t += 2.0 * way_len / (v + new_v)
        x += way * ux * way_len
        z += way * uz * way_len
        if control_line >= 0:
            x = control_lines.x[control_line]
        control_lines_from = x
        furthest = max(furthest, x)
        if way_len > 0.0:
            moved = True
        if rolling:
            theta -= way * way_len / roll_radius
            omega = way * math.sqrt(max(spin2 + dspin2, 0.0))
        v = new_v
        if effects is not None and effects.stand.form != trees.OFF:
            to_stem -= stem_rate * abs(x - came_from)
            if at_stem and control_line < 0:
                full = 0.5 * (v * v + inert * omega * omega) * block.mass
                taken = trees.stem_loss(effects.stand, block.key, stems_met, stem_cell)
                stems_met += 1
                to_stem = trees.to_next_stem(block.key, stems_met)
                kept = math.sqrt(max(1.0 - taken / full, 0.0)) if full > 0.0 else 1.0
            else:
                kept = trees.left_after_way(effects.stand, stem_cell, block.mass, v, 0.5 * way_len)
            v *= kept
            omega *= kept
        vx = way * v * ux
        vz = way * v * uz
        if control_line >= 0:
            v *= left
            omega *= left
            if outcome == STOPPED:
                reason = BARRIER
                phase = END
            elif outcome == HELD_BY_NET:
                held_at = x
            continue
        if what == PROFILE_END:
            reason = LEFT_PROFILE
            break
        if what == PART:
            steps += 1
            if steps < _STEPS_PER_EVENT * physics.max_events:
                events -= 1
            continue
        if what == GROUND_AHEAD:
            seg = hit
            nx = hit_nx
            nz = hit_nz
            phase = IMPACT
            continue
        if what == TO_SLIDING:
            omega = 0.0
            phase = SLIDING
            continue
        if what == LIFT_OFF:
            # The normal force on the turning ellipse ends; its centre is where it then stands.
            theta = 0.5 * math.pi + way * lift + profile.angle[seg]
            lever, support, _ = frame_of(a, b, math.cos(lift), -way * math.sin(lift))
            # Also where the spin lags behind the speed no energy is made.
            energy = 0.5 * (v * v + inert * omega * omega) - g * ux * (support - roll_radius)
            spin = math.sqrt(2.0 * max(energy, 0.0) / (inert + lever * lever + support * support))
            omega = way * spin
            x += (support - roll_radius) * -uz
            z += (support - roll_radius) * ux
            vx = support * omega * ux + lever * omega * uz
            vz = support * omega * uz - lever * omega * ux
            clear_from = _FIRST_TURN / max(spin, 1e-3)
            phase = FLIGHT
            continue
        if what == SEGMENT_END:
            k = seg + way
            if k < 0 or k >= n:
                reason = LEFT_PROFILE
                break
            turn = _turn(profile, seg, way)
            if turn > _STRAIGHT:
                skip_to = seg
                seg = k
                phase = FLIGHT
            else:
                seg = k
            continue

    if noting:
        _note(course, END, t, x, z, 0.0, 0.0, theta, 0.0, seg, 0.0, 0.0)
    if reason == REST and not moved:
        reason = NEVER_STARTED
    return (
        reason, x, z, furthest, t, impacts, top_speed, top_height, top_energy, n_passages,
        n_touched,
    )  # fmt: skip
