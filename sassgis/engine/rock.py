"""The course of one rock: flight, impact, rolling, sliding, and the switches between them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sassgis.core.grid import FloatArray
from sassgis.core.jit import kernel
from sassgis.engine import rng
from sassgis.engine.contact import next_contact, resting_height
from sassgis.engine.ellipse import frame_of, inertia, mean_radius
from sassgis.engine.gates import HELD_BY_NET, PASSED, STOPPED, gates_in_flight, gates_on_ground
from sassgis.engine.impact import impact, normal_force, turn_about_contact
from sassgis.engine.recording import CellWork, Pieces, record_flight, record_ground
from sassgis.engine.rolling import (
    GROUND_AHEAD,
    LIFT_OFF,
    PROFILE_END,
    SEGMENT_END,
    STOP,
    TO_SLIDING,
    rolling_stretch,
)
from sassgis.engine.state import Block, Course, Gates, Physics, Profile

# Phases, as they are written to the course of a rock.
FLIGHT, IMPACT, ROLLING, SLIDING, END = 0, 1, 2, 3, 4

# Why a rock ends; the same numbers as core.results.StopReason.
REST, BARRIER, LEFT_PROFILE, STEP_LIMIT, NEVER_STARTED = 0, 1, 2, 3, 4

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
def follow(
    block: Block,
    profile: Profile,
    ground_table: FloatArray,
    physics: Physics,
    gates: Gates,
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
) -> tuple[int, float, float, float, float, int, float, float, float, int, int]:
    """Follow one rock from its release to its end.

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

    seg = _segment_at(profile, start_x, 0)
    theta = orientation + profile.angle[seg]
    x = start_x
    z = resting_height(x, theta, a, b, sx, sz, tx, tz, seg) + drop
    vx = speed * tx[seg]
    vz = speed * tz[seg]
    omega = spin
    t = 0.0
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
    gates_from = x
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

    # Calls that have nothing to do are left out: passing arrays costs more than most of them.
    noting = course.rows.shape[0] > 0
    guarded = gates.x.size > 0
    t_gate = np.inf
    lift = 0.0
    share = 1.0
    outcome = PASSED
    left = 1.0
    events = 0
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
            until, hit, nx, nz = next_contact(
                x, z, vx, vz, theta, omega, a, b, g, clear_from, max(limit, 0.0),
                physics.tolerance, sx, sz, tx, tz, seg, skip_to,
            )  # fmt: skip
            if hit < 0:
                until = max(limit, 0.0)
            gate = -1
            if guarded:
                n_passages, t_gate, outcome, left, gate = gates_in_flight(
                    gates, seen, passages, n_passages, profile, seg, gates_from, x, z, vx, vz,
                    theta, omega, g, until, block, inert,
                )  # fmt: skip
            spin_energy = 0.5 * inert * omega * omega
            if gate >= 0:
                until = t_gate
            n_touched, piece, top = record_flight(
                pieces, work, n_touched, piece, x, z, vx, vz, spin_energy, g, until, b, sx, sz,
                tx, tz,
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
            if gate >= 0:
                x = gates.x[gate]
            gates_from = x
            furthest = max(furthest, x)
            if until > 0.0:
                moved = True
            clear_from = 0.0
            skip_to = int(np.int64(-1))
            if gate >= 0:
                vx *= left
                vz *= left
                omega *= left
                seg = _segment_at(profile, x, seg)
                if outcome == STOPPED:
                    # It drops to the foot of the wall.
                    z = min(z, gates.z[gate] + b)
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
                px, py, _ = frame_of(a, b, st * mz + ct * mx, ct * mz - st * mx)
                if noting:
                    _note(course, IMPACT, t, x, z, vx, vz, theta, omega, seg, mz, -mx)
                wt, wn, omega = impact(
                    px, py, inert, vx * mz - vz * mx, vx * mx + vz * mz, omega, row[0],
                    physics.eta_rule, row[3],
                )  # fmt: skip
                vx = wt * mz + wn * mx
                vz = wn * mz - wt * mx
                wt = vx * ux + vz * uz
                wn = vx * nx + vz * nz
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
        gate = -1
        if guarded:
            n_passages, share, outcome, left, gate = gates_on_ground(
                gates, seen, passages, n_passages, gates_from, x, end_x, v2, dv2, spin2, dspin2,
                way * ux, way * uz, way, block, inert,
            )  # fmt: skip
        if gate >= 0:
            way_len *= share
            dv2 *= share
            dspin2 *= share
            end_x = gates.x[gate]
        chord = abs(end_x - x)
        n_touched, piece = record_ground(
            pieces, work, n_touched, piece, x, end_x, v2, dv2, 0.5 * inert * spin2,
            0.5 * inert * dspin2, chord,
        )  # fmt: skip
        new_v = math.sqrt(max(v2 + dv2, 0.0))
        fast2 = max(v2, v2 + dv2)
        top_speed = max(top_speed, math.sqrt(fast2))
        top_energy = max(top_energy, 0.5 * fast2 + 0.5 * inert * max(spin2, spin2 + dspin2))
        if v + new_v > 0.0:
            t += 2.0 * way_len / (v + new_v)
        x += way * ux * way_len
        z += way * uz * way_len
        if gate >= 0:
            x = gates.x[gate]
        gates_from = x
        furthest = max(furthest, x)
        if way_len > 0.0:
            moved = True
        if rolling:
            theta -= way * way_len / roll_radius
            omega = way * math.sqrt(max(spin2 + dspin2, 0.0))
        v = new_v
        vx = way * v * ux
        vz = way * v * uz
        if gate >= 0:
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
