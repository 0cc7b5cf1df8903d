"""Rocks in small time steps: flight, contact by penetration and bisection, rolling, sliding.

Position and velocity are in space; the ellipse and its spin stay in the vertical plane of motion.
In flight the step is that of Runge and Kutta (fourth order). The ground is the bilinear surface
of the grid. At each contact the normal impulse turns the path as the terrain leans across it, on
the ground it turns to the descent.
"""

from __future__ import annotations

import math

import numpy as np

from sassgis.gap.check.worlds import contact_laws as laws
from sassgis.gap.check.worlds import motion_state as ms
from sassgis.gap.check.worlds import random_draws as draws
from sassgis.gap.check.worlds.after_contact import (
    land,
    lean,
    loosen,
    meet_obstacles,
    settle,
    shatter,
    turn_back,
    turn_by,
)
from sassgis.gap.check.worlds.forces import (
    Forces,
    acceleration,
    active,
    break_chance,
    cap_tilts,
    drained,
    indent,
    on_ice,
    snow_drag,
    weight_on,
)
from sassgis.gap.check.worlds.slopes import descent, surface_at
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel

_LONGEST_S = 240.0
_SLOW = 0.05
_TRACK_EVERY_S = 0.1
#: Time in which what rolls has turned by most of its angle to the descent.
_TURNS_IN_S = 0.6
# A rolling rock leaves where its free path is above the ground after this time (s).
_LOOK_AHEAD = 0.06


@kernel
def run_rocks(
    f: ms.Field, forces: Forces, starts: FloatArray, keys: ms.KeyArray, dt: float, tables: ms.Tables
) -> None:
    """Release all rocks, with the pieces and loosened blocks that they make."""
    for rock in range(starts.shape[0]):
        states = np.empty((ms.MAX_PIECES, ms.N_STATE))
        waiting = ms.Waiting(states, np.empty(ms.MAX_PIECES, np.uint64), np.array([1, 1]))
        states[0] = starts[rock]
        states[0, ms.NUMBER] = rock
        waiting.keys[0] = keys[rock]
        while waiting.counts[0] > 0:
            waiting.counts[0] -= 1
            k = waiting.counts[0]
            _run_block(f, forces, states[k].copy(), waiting.keys[k], dt, waiting, tables)


@kernel
def _run_block(
    f: ms.Field,
    forces: Forces,
    st: FloatArray,
    key: np.uint64,
    dt: float,
    waiting: ms.Waiting,
    tables: ms.Tables,
) -> None:
    """Simulate one block to its end."""
    n_rows, n_cols = f.z.shape
    last_hit = np.array([-1])
    next_track = st[ms.TIME]
    s = ms.chainage_of(f, st[ms.X], st[ms.Y])
    while True:
        if st[ms.TIME] >= next_track:
            ms.write_track(st, tables)
            next_track += _TRACK_EVERY_S
        if st[ms.MODE] == ms.FLY:
            _fly(f, forces, st, key, dt, waiting, tables)
        else:
            _roll(f, forces, st, dt)
        if st[ms.MODE] == ms.BROKEN:
            return
        if f.obstacles.shape[0] > 0 and st[ms.MODE] != ms.STOPPED:
            meet_obstacles(f, st, last_hit)
        u = (st[ms.X] - f.west) / f.cell
        v = (f.north - st[ms.Y]) / f.cell
        before = s
        s = ms.chainage_of(f, st[ms.X], st[ms.Y])
        for k in range(f.stations.shape[0]):
            if before < f.stations[k] <= s:
                ms.write_passage(f, st, k, tables)
        if st[ms.MODE] == ms.STOPPED or st[ms.TIME] > _LONGEST_S:
            ms.write_track(st, tables)
            ms.write_deposit(f, st, tables)
            return
        if u < 1.5 or v < 1.5 or u > n_cols - 1.5 or v > n_rows - 1.5:
            return


@kernel
def flight_step(forces: Forces, st: FloatArray, h: float) -> None:
    """Advance a flying block by h seconds (Runge-Kutta, fourth order)."""
    vx, vy, vz = st[ms.VX], st[ms.VY], st[ms.VZ]
    if forces.air_drag.q <= 0.0 and forces.wind.q <= 0.0 and forces.magnus.q <= 0.0:
        # The four stages agree under gravity alone: the step is the parabola itself.
        st[ms.X] += h * vx
        st[ms.Y] += h * vy
        st[ms.Z] += h * vz - 0.5 * laws.GRAVITY * h * h
        st[ms.VZ] = vz - laws.GRAVITY * h
        st[ms.PHI] -= h * st[ms.SPIN]
        st[ms.TIME] += h
        return
    half = 0.5 * h
    middle = st[ms.PHI] - half * st[ms.SPIN]
    last = st[ms.PHI] - h * st[ms.SPIN]
    a1, b1, c1 = acceleration(forces, st, st[ms.PHI], vx, vy, vz)
    a2, b2, c2 = acceleration(forces, st, middle, vx + half * a1, vy + half * b1, vz + half * c1)
    a3, b3, c3 = acceleration(forces, st, middle, vx + half * a2, vy + half * b2, vz + half * c2)
    a4, b4, c4 = acceleration(forces, st, last, vx + h * a3, vy + h * b3, vz + h * c3)
    st[ms.X] += h * vx + h * h / 6.0 * (a1 + a2 + a3)
    st[ms.Y] += h * vy + h * h / 6.0 * (b1 + b2 + b3)
    st[ms.Z] += h * vz + h * h / 6.0 * (c1 + c2 + c3)
    st[ms.VX] = vx + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    st[ms.VY] = vy + h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
    st[ms.VZ] = vz + h / 6.0 * (c1 + 2.0 * c2 + 2.0 * c3 + c4)
    st[ms.PHI] = last
    st[ms.TIME] += h
    ms.face_velocity(st)


@kernel
def _gap(f: ms.Field, st: FloatArray) -> tuple[float, float, float, float]:
    """Gap between rock and ground (m), slope there (rad), and the point of contact in plan."""
    px, py = st[ms.X], st[ms.Y]
    slope = 0.0
    gap = 0.0
    drop = 0.0
    for turn in range(3):
        zg, next_slope = ms.slope_at(f, st, px, py)
        if turn > 0:
            gap = (st[ms.Z] + drop - zg) * math.cos(slope)
        slope = next_slope
        if turn < 2:
            x, y = laws.lever(st[ms.A], st[ms.B], st[ms.PHI] + slope)
            ahead, above = ms.rotated(x, y, -slope)
            drop = -above
            px = st[ms.X] - ahead * st[ms.HX]
            py = st[ms.Y] - ahead * st[ms.HY]
    return gap, slope, px, py


@kernel
def _fly(
    f: ms.Field,
    forces: Forces,
    st: FloatArray,
    key: np.uint64,
    dt: float,
    waiting: ms.Waiting,
    tables: ms.Tables,
) -> None:
    """One step of flight, with the contact in it if there is one."""
    start = st.copy()
    flight_step(forces, st, dt)
    if st[ms.Z] - ms.ground_at(f, st[ms.X], st[ms.Y]) > 4.0 * st[ms.A] + 1.0 or not _hits(f, st):
        return
    low = 0.0
    high = dt
    st[:] = start
    # Where it touches already at the start of the step, contacts follow each other step by step.
    turns = 0 if _hits(f, st) else 16
    for _ in range(turns):
        half = 0.5 * (low + high)
        st[:] = start
        flight_step(forces, st, half)
        if _hits(f, st):
            high = half
        else:
            low = half
    st[:] = start
    flight_step(forces, st, high)
    _contact(f, forces, st, key, waiting, tables)


@kernel
def _hits(f: ms.Field, st: FloatArray) -> bool:
    """Whether a rock touches ground that its centre approaches.

    A tip that turns into the ground while the centre leaves does not count, and one that is in it
    only while it goes deeper, or is deep already.
    """
    gap, slope, _, _ = _gap(f, st)
    if gap >= 0.0:
        return False
    _, vn = ms.rotated(ms.along_of(st), st[ms.VZ], slope)
    x, _ = laws.lever(st[ms.A], st[ms.B], st[ms.PHI] + slope)
    # Of the lowest material point too.
    return vn < 0.0 and (vn + st[ms.SPIN] * x <= 0.0 or gap < -1e-3 * st[ms.B])


@kernel
def _contact(
    f: ms.Field,
    forces: Forces,
    st: FloatArray,
    key: np.uint64,
    waiting: ms.Waiting,
    tables: ms.Tables,
) -> None:
    """Impact or soft landing; changes the state and may make new blocks."""
    _, slope, px, py = _gap(f, st)
    a, b = st[ms.A], st[ms.B]
    radius = math.sqrt(a * b)
    inertia = (a * a + b * b) / 5.0
    law = f.law[f.ground[ms.cell_of(f, px, py)]]
    s = ms.chainage_of(f, px, py)
    along = ms.along_of(st)
    vt_in, vn_in = ms.rotated(along, st[ms.VZ], slope)
    spin_in = st[ms.SPIN]
    before = laws.kinetic(inertia, vt_in, vn_in, spin_in)
    size = (a * b * st[ms.C]) ** (1.0 / 3.0)
    soft = 2.0 * weight_on(slope) * law[laws.SOFT] * size
    if vn_in * vn_in < soft:
        settle(f, st, law, slope, vt_in, vn_in)
        return
    st[ms.COUNT] += 1.0
    n = int(st[ms.COUNT])
    met = slope
    if slope > 0.0:
        low, high = law[laws.DP_MIN], law[laws.DP_MAX]
        u = low + (high - low) * draws.uniform(key, draws.SLOPE, n)
        met = math.atan(math.tan(slope) * (1.0 - u))
    cross = 0.0
    if active(forces.roughness, s):
        tilt, cross = cap_tilts(forces.roughness, key, n, radius)
        met -= tilt
    vt, vn = ms.rotated(along, st[ms.VZ], met)
    shrunk = 1.0 - forces.wetting.q * (0.3 + 0.7 * st[ms.CAMPAIGN])
    if active(forces.ice, s) and on_ice(forces.ice, px, py):
        # Ice holds nothing along the ground; it returns a little of the normal speed.
        vn = 0.2 * abs(vn)
        spin = spin_in
    else:
        vt, vn, spin = laws.contact(
            f.contact, a, b, st[ms.C], st[ms.PHI] + met, vt, vn, spin_in, law, shrunk
        )
        if active(forces.soft_ground, s):
            vt, vn, spin = indent(
                forces.soft_ground, ms.mass_of(st), radius, inertia, vn_in, spin_in, vt, vn, spin
            )
    if forces.loss.q > 0.0:
        vt, vn, spin = drained(forces.loss, vt, vn, spin)
    if active(forces.rock_shape, s):
        flat = forces.rock_shape.q * (1.0 - st[ms.C] / b)
        if draws.uniform(key, draws.PLATE, 2 * n) < min(0.95, flat):
            # The flat side comes down: the wobble of the plate is lost, and it veers.
            strength = min(1.0, flat)
            vt *= 1.0 - 0.5 * strength
            vn *= 1.0 - 0.5 * strength
            spin *= 1.0 - 0.5 * strength
            cross += st[ms.HAND] * 0.6 * strength * draws.uniform(key, draws.PLATE, 2 * n + 1)
    if active(forces.snow, s):
        held = 1.0 / (1.0 + snow_drag(forces.snow, vt))
        vt *= held
        spin *= held
    if forces.edges.q > 0.0:
        cross += min(max(forces.edges.q * draws.laplace(key, draws.EDGE, n), -0.9), 0.9)
    if active(forces.lateral_deflection, s):
        facet = forces.lateral_deflection.q * draws.laplace(key, draws.LATERAL, n)
        cross += min(max(facet, -0.9), 0.9)

    # Back from the ground that was met to the mean slope.
    v_along, vz = ms.rotated(vt, vn, -met)
    vt_out, vn_out = ms.rotated(v_along, vz, slope)
    # The normal impulse on what leans across the path, terrain or facet, deflects the rock.
    across = min(max(lean(f, st) + cross, -1.2), 1.2)
    turn = math.atan2((vn_out - vn_in) * math.sin(across), abs(v_along) + 0.5)
    old_hx, old_hy = st[ms.HX], st[ms.HY]
    after = laws.kinetic(inertia, vt_out, vn_out, spin)
    rock = int(st[ms.NUMBER])
    tables.gain[rock] = max(tables.gain[rock], (after - before) / before)
    speeds = (math.degrees(slope), vt_in, vn_in, spin_in, vt_out, vn_out, spin)
    st[ms.SPIN] = spin
    if v_along < 0.0:
        turn_back(st)
        slope = -slope
        vt_out = -vt_out
        turn = -turn
    turn_by(st, turn)
    # The path turns about the normal of the ground: the rock does not turn into it or off it.
    _, turned = ms.slope_at(f, st, px, py)
    st[ms.PHI] += slope - turned
    slope = turned
    ms.set_velocity(st, vt_out, vn_out, slope)
    ms.face_velocity(st)
    # Azimuths grow clockwise: to the right is positive.
    to_right = ms.angle_between(st[ms.HX], st[ms.HY], old_hx, old_hy)
    ms.write_impact(f, st, px, py, speeds, to_right, tables)
    if active(forces.fragmentation, s):
        volume = ms.mass_of(st) / st[ms.DENSITY]
        if volume > 0.01 and draws.uniform(key, draws.BREAK, n) < break_chance(
            forces.fragmentation, volume, vn_in
        ):
            shatter(st, key, n, before - after, waiting)
            if st[ms.MODE] == ms.BROKEN:
                return
    if active(forces.entrainment, s) and st[ms.KIND] == ms.ROCK:
        loosen(f, forces, st, key, n, abs(vt_out - vt_in), px, py, waiting)
    theta = st[ms.PHI] + slope
    x, _ = laws.lever(a, b, theta)
    lifted = vn_out + x * st[ms.SPIN]
    flies = vn_out > 0.0 or (lifted > 0.0 and lifted * lifted >= soft)
    # Where P is behind the centre a rock flies only if the ground cannot push it.
    if not (flies or laws.thrown_off(a, b, theta, st[ms.SPIN], slope)):
        land(f, st, slope, vt_out, vn_out, spin)


@kernel
def _roll(f: ms.Field, forces: Forces, st: FloatArray, dt: float) -> None:
    """One step along the ground, rolling or sliding; may leave the ground or come to rest."""
    a, b = st[ms.A], st[ms.B]
    radius = laws.rolling_radius(a, b)
    size = (a * b * st[ms.C]) ** (1.0 / 3.0)
    law = f.law[f.ground[ms.cell_of(f, st[ms.X], st[ms.Y])]]
    s = ms.chainage_of(f, st[ms.X], st[ms.Y])
    dx, dy = descent(f.gx, f.gy, f.west, f.north, f.cell, st[ms.X], st[ms.Y], st[ms.HX], st[ms.HY])
    if dx * st[ms.HX] + dy * st[ms.HY] < 0.0:
        dx, dy = -dx, -dy
    along = ms.along_of(st)
    v = math.sqrt(along * along + st[ms.VZ] ** 2)
    turn_by(st, ms.angle_between(st[ms.HX], st[ms.HY], dx, dy) * min(1.0, dt / _TURNS_IN_S))
    here, gx, gy = surface_at(f.z, f.west, f.north, f.cell, st[ms.X], st[ms.Y])
    slope = math.atan(-(gx * st[ms.HX] + gy * st[ms.HY]))
    inertia = (a * a + b * b) / 5.0
    # Energy of a rock that rolls, over that of its motion along the ground.
    whole = 1.0 + inertia / (radius * radius)
    turning_over = weight_on(slope) * (a - radius)
    energy = 0.5 * v * v * whole
    held = math.tan(slope) < laws.rolling_friction(law, size)
    if st[ms.MODE] == ms.ROLL and energy < turning_over and held:
        # Too slow to turn over its longer axis.
        st[ms.MODE] = ms.SLIDE
    elif st[ms.MODE] == ms.SLIDE and law[laws.MU_F] * 2.0 * a * b > a * a - b * b:
        # Friction tips it over; it rolls with its angular momentum about the ground kept.
        lies = laws.lever(a, b, st[ms.PHI] + slope)[1]
        left = 0.5 * v * (v / whole) - weight_on(slope) * (radius - lies)
        if left > (turning_over if held else 0.0):
            v = math.sqrt(2.0 * left / whole)
            st[ms.MODE] = ms.ROLL
    friction = law[laws.MU_F]
    if st[ms.MODE] == ms.ROLL:
        friction = laws.rolling_friction(law, size)
        if active(forces.rock_shape, s):
            flat = 1.0 - st[ms.C] / b
            if v < 5.0 * forces.rock_shape.q * flat:
                friction *= 1.0 + min(1.0, forces.rock_shape.q * flat)
    if active(forces.snow, s):
        friction += snow_drag(forces.snow, v)
    if active(forces.ice, s) and on_ice(forces.ice, st[ms.X], st[ms.Y]):
        friction = 0.12
    # A wet block slips on wet ground.
    friction *= 1.0 - 0.4 * forces.wetting.q * (0.3 + 0.7 * st[ms.CAMPAIGN])
    pull = laws.GRAVITY * math.sin(slope) - friction * weight_on(slope)
    v += pull * dt
    st[ms.TIME] += dt
    if v <= _SLOW and pull < 0.0:
        steepest = math.sqrt(gx * gx + gy * gy)
        if steepest > friction + 1e-3 and slope < 0.0:
            turn_back(st)
            ms.set_velocity(st, _SLOW, 0.0, 0.0)
            st[ms.SPIN] = _SLOW / radius
            return
        ms.set_velocity(st, 0.0, 0.0, 0.0)
        st[ms.SPIN] = 0.0
        st[ms.MODE] = ms.STOPPED
        return
    if st[ms.MODE] == ms.ROLL and a > b and _leaves_upright(f, st, v, slope):
        return
    onward = v * math.cos(slope)
    far = onward * _LOOK_AHEAD
    ahead = ms.ground_at(f, st[ms.X] + far * st[ms.HX], st[ms.Y] + far * st[ms.HY])
    free = here - v * math.sin(slope) * _LOOK_AHEAD - 0.5 * laws.GRAVITY * _LOOK_AHEAD**2
    st[ms.X] += onward * dt * st[ms.HX]
    st[ms.Y] += onward * dt * st[ms.HY]
    ms.set_velocity(st, v, 0.0, slope)
    if st[ms.MODE] == ms.ROLL:
        st[ms.SPIN] = v / radius
        st[ms.PHI] -= st[ms.SPIN] * dt
    else:
        st[ms.SPIN] = 0.0
    zg, next_slope = ms.slope_at(f, st, st[ms.X], st[ms.Y])
    # A rock that slides lies as it is turned, one that rolls is the circle of its mean radius.
    rest = radius if st[ms.MODE] == ms.ROLL else laws.lever(a, b, st[ms.PHI] + next_slope)[1]
    st[ms.Z] = zg + rest / math.cos(next_slope)
    if free > ahead:
        st[ms.MODE] = ms.FLY
        return
    bend = slope - next_slope
    if bend > 0.0:
        # A hollow is met as the circle as which the rock rolls.
        on, hit = v * math.cos(bend), v * math.sin(bend)
        if st[ms.MODE] == ms.ROLL:
            vt, vn, spin = laws.contact(
                f.contact, a, b, st[ms.C], 0.0, on, -hit, st[ms.SPIN], law, 1.0, True
            )
            if vn * vn > 2.0 * weight_on(next_slope) * law[laws.SOFT] * size:
                ms.set_velocity(st, vt, vn, next_slope)
                st[ms.SPIN] = spin
                st[ms.MODE] = ms.FLY
                return
        v = max(on - friction * hit, 0.0)
    ms.set_velocity(st, v, 0.0, next_slope)


@kernel
def _leaves_upright(f: ms.Field, st: FloatArray, v: float, slope: float) -> bool:
    """Let a rolling ellipse fly where the normal force on it ends, before it stands upright.

    Its energy is that of steady rolling, less what lifts its centre above the mean radius.
    """
    a, b = st[ms.A], st[ms.B]
    radius = laws.rolling_radius(a, b)
    inertia = (a * a + b * b) / 5.0
    theta = st[ms.PHI] + slope
    x, y = laws.lever(a, b, theta)
    energy = 0.5 * v * v * (1.0 + inertia / (radius * radius)) - weight_on(slope) * (y - radius)
    if x > 0.0 or energy <= 0.0:
        # It sinks: past the upright, the ground does not throw it off.
        return False
    spin = math.sqrt(2.0 * energy / (inertia + x * x + y * y))
    if not laws.thrown_off(a, b, theta, spin, slope):
        return False
    st[ms.Z] = ms.ground_at(f, st[ms.X], st[ms.Y]) + y / math.cos(slope)
    ms.set_velocity(st, y * spin, -x * spin, slope)
    st[ms.SPIN] = spin
    st[ms.MODE] = ms.FLY
    return True
