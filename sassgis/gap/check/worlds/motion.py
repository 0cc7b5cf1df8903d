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
from sassgis.gap.check.worlds.contact_laws import (
    GRAVITY,
    kinetic,
    lever,
    rolling_friction,
    rolling_radius,
    thrown_off,
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
from sassgis.gap.check.worlds.motion_state import (
    BROKEN,
    CAMPAIGN,
    COUNT,
    DENSITY,
    FLY,
    HAND,
    HX,
    HY,
    KIND,
    MAX_PIECES,
    MODE,
    N_STATE,
    NUMBER,
    PHI,
    ROCK,
    ROLL,
    SLIDE,
    SPIN,
    STOPPED,
    TIME,
    VX,
    VY,
    VZ,
    A,
    B,
    C,
    Field,
    KeyArray,
    Tables,
    Waiting,
    X,
    Y,
    Z,
    along_of,
    angle_between,
    cell_of,
    chainage_of,
    face_velocity,
    ground_at,
    mass_of,
    rotated,
    set_velocity,
    slope_at,
    write_deposit,
    write_impact,
    write_passage,
    write_track,
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
    f: Field, forces: Forces, starts: FloatArray, keys: KeyArray, dt: float, tables: Tables
) -> None:
    """Release all rocks, with the pieces and loosened blocks that they make."""
    for rock in range(starts.shape[0]):
        states = np.empty((MAX_PIECES, N_STATE))
        waiting = Waiting(states, np.empty(MAX_PIECES, np.uint64), np.array([1, 1]))
        states[0] = starts[rock]
        states[0, NUMBER] = rock
        waiting.keys[0] = keys[rock]
        while waiting.counts[0] > 0:
            waiting.counts[0] -= 1
            k = waiting.counts[0]
            _run_block(f, forces, states[k].copy(), waiting.keys[k], dt, waiting, tables)


@kernel
def _run_block(
    f: Field,
    forces: Forces,
    st: FloatArray,
    key: np.uint64,
    dt: float,
    waiting: Waiting,
    tables: Tables,
) -> None:
    """Simulate one block to its end."""
    n_rows, n_cols = f.z.shape
    last_hit = np.array([-1])
    next_track = st[TIME]
    s = chainage_of(f, st[X], st[Y])
    while True:
        if st[TIME] >= next_track:
            write_track(st, tables)
            next_track += _TRACK_EVERY_S
        if st[MODE] == FLY:
            _fly(f, forces, st, key, dt, waiting, tables)
        else:
            _roll(f, forces, st, dt)
        if st[MODE] == BROKEN:
            return
        if f.obstacles.shape[0] > 0 and st[MODE] != STOPPED:
            meet_obstacles(f, st, last_hit)
        u = (st[X] - f.west) / f.cell
        v = (f.north - st[Y]) / f.cell
        before = s
        s = chainage_of(f, st[X], st[Y])
        for k in range(f.stations.shape[0]):
            if before < f.stations[k] <= s:
                write_passage(f, st, k, tables)
        if st[MODE] == STOPPED or st[TIME] > _LONGEST_S:
            write_track(st, tables)
            write_deposit(f, st, tables)
            return
        if u < 1.5 or v < 1.5 or u > n_cols - 1.5 or v > n_rows - 1.5:
            return


@kernel
def flight_step(forces: Forces, st: FloatArray, h: float) -> None:
    """Advance a flying block by h seconds (Runge-Kutta, fourth order)."""
    vx, vy, vz = st[VX], st[VY], st[VZ]
    if forces.air_drag.q <= 0.0 and forces.wind.q <= 0.0 and forces.magnus.q <= 0.0:
        # The four stages agree under gravity alone: the step is the parabola itself.
        st[X] += h * vx
        st[Y] += h * vy
        st[Z] += h * vz - 0.5 * GRAVITY * h * h
        st[VZ] = vz - GRAVITY * h
        st[PHI] -= h * st[SPIN]
        st[TIME] += h
        return
    half = 0.5 * h
    middle = st[PHI] - half * st[SPIN]
    last = st[PHI] - h * st[SPIN]
    a1, b1, c1 = acceleration(forces, st, st[PHI], vx, vy, vz)
    a2, b2, c2 = acceleration(forces, st, middle, vx + half * a1, vy + half * b1, vz + half * c1)
    a3, b3, c3 = acceleration(forces, st, middle, vx + half * a2, vy + half * b2, vz + half * c2)
    a4, b4, c4 = acceleration(forces, st, last, vx + h * a3, vy + h * b3, vz + h * c3)
    st[X] += h * vx + h * h / 6.0 * (a1 + a2 + a3)
    st[Y] += h * vy + h * h / 6.0 * (b1 + b2 + b3)
    st[Z] += h * vz + h * h / 6.0 * (c1 + c2 + c3)
    st[VX] = vx + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    st[VY] = vy + h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
    st[VZ] = vz + h / 6.0 * (c1 + 2.0 * c2 + 2.0 * c3 + c4)
    st[PHI] = last
    st[TIME] += h
    face_velocity(st)


@kernel
def _gap(f: Field, st: FloatArray) -> tuple[float, float, float, float]:
    """Gap between rock and ground (m), slope there (rad), and the point of contact in plan."""
    px, py = st[X], st[Y]
    slope = 0.0
    gap = 0.0
    drop = 0.0
    for turn in range(3):
        zg, next_slope = slope_at(f, st, px, py)
        if turn > 0:
            gap = (st[Z] + drop - zg) * math.cos(slope)
        slope = next_slope
        if turn < 2:
            x, y = lever(st[A], st[B], st[PHI] + slope)
            ahead, above = rotated(x, y, -slope)
            drop = -above
            px = st[X] - ahead * st[HX]
            py = st[Y] - ahead * st[HY]
    return gap, slope, px, py


@kernel
def _fly(
    f: Field,
    forces: Forces,
    st: FloatArray,
    key: np.uint64,
    dt: float,
    waiting: Waiting,
    tables: Tables,
) -> None:
    """One step of flight, with the contact in it if there is one."""
    start = st.copy()
    flight_step(forces, st, dt)
    if st[Z] - ground_at(f, st[X], st[Y]) > 4.0 * st[A] + 1.0 or not _hits(f, st):
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
def _hits(f: Field, st: FloatArray) -> bool:
    """Whether a rock touches ground that its centre approaches.

    A tip that turns into the ground while the centre leaves does not count, and one that is in it
    only while it goes deeper, or is deep already.
    """
    gap, slope, _, _ = _gap(f, st)
    if gap >= 0.0:
        return False
    _, vn = rotated(along_of(st), st[VZ], slope)
    x, _ = lever(st[A], st[B], st[PHI] + slope)
    # Of the lowest material point too.
    return vn < 0.0 and (vn + st[SPIN] * x <= 0.0 or gap < -1e-3 * st[B])


@kernel
def _contact(
    f: Field,
    forces: Forces,
    st: FloatArray,
    key: np.uint64,
    waiting: Waiting,
    tables: Tables,
) -> None:
    """Impact or soft landing; changes the state and may make new blocks."""
    _, slope, px, py = _gap(f, st)
    a, b = st[A], st[B]
    radius = math.sqrt(a * b)
    inertia = (a * a + b * b) / 5.0
    law = f.law[f.ground[cell_of(f, px, py)]]
    s = chainage_of(f, px, py)
    along = along_of(st)
    vt_in, vn_in = rotated(along, st[VZ], slope)
    spin_in = st[SPIN]
    before = kinetic(inertia, vt_in, vn_in, spin_in)
    size = (a * b * st[C]) ** (1.0 / 3.0)
    soft = 2.0 * weight_on(slope) * law[laws.SOFT] * size
    if vn_in * vn_in < soft:
        settle(f, st, law, slope, vt_in, vn_in)
        return
    st[COUNT] += 1.0
    n = int(st[COUNT])
    met = slope
    if slope > 0.0:
        low, high = law[laws.DP_MIN], law[laws.DP_MAX]
        u = low + (high - low) * draws.uniform(key, draws.SLOPE, n)
        met = math.atan(math.tan(slope) * (1.0 - u))
    cross = 0.0
    if active(forces.roughness, s):
        tilt, cross = cap_tilts(forces.roughness, key, n, radius)
        met -= tilt
    vt, vn = rotated(along, st[VZ], met)
    shrunk = 1.0 - forces.wetting.q * (0.3 + 0.7 * st[CAMPAIGN])
    if active(forces.ice, s) and on_ice(forces.ice, px, py):
        # Ice holds nothing along the ground; it returns a little of the normal speed.
        vn = 0.2 * abs(vn)
        spin = spin_in
    else:
        vt, vn, spin = laws.contact(
            f.contact, a, b, st[C], st[PHI] + met, vt, vn, spin_in, law, shrunk
        )
        if active(forces.soft_ground, s):
            vt, vn, spin = indent(
                forces.soft_ground, mass_of(st), radius, inertia, vn_in, spin_in, vt, vn, spin
            )
    if forces.loss.q > 0.0:
        vt, vn, spin = drained(forces.loss, vt, vn, spin)
    if active(forces.rock_shape, s):
        flat = forces.rock_shape.q * (1.0 - st[C] / b)
        if draws.uniform(key, draws.PLATE, 2 * n) < min(0.95, flat):
            # The flat side comes down: the wobble of the plate is lost, and it veers.
            strength = min(1.0, flat)
            vt *= 1.0 - 0.5 * strength
            vn *= 1.0 - 0.5 * strength
            spin *= 1.0 - 0.5 * strength
            cross += st[HAND] * 0.6 * strength * draws.uniform(key, draws.PLATE, 2 * n + 1)
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
    v_along, vz = rotated(vt, vn, -met)
    vt_out, vn_out = rotated(v_along, vz, slope)
    # The normal impulse on what leans across the path, terrain or facet, deflects the rock.
    across = min(max(lean(f, st) + cross, -1.2), 1.2)
    turn = math.atan2((vn_out - vn_in) * math.sin(across), abs(v_along) + 0.5)
    old_hx, old_hy = st[HX], st[HY]
    after = kinetic(inertia, vt_out, vn_out, spin)
    rock = int(st[NUMBER])
    tables.gain[rock] = max(tables.gain[rock], (after - before) / before)
    speeds = (math.degrees(slope), vt_in, vn_in, spin_in, vt_out, vn_out, spin)
    st[SPIN] = spin
    if v_along < 0.0:
        turn_back(st)
        slope = -slope
        vt_out = -vt_out
        turn = -turn
    turn_by(st, turn)
    # The path turns about the normal of the ground: the rock does not turn into it or off it.
    _, turned = slope_at(f, st, px, py)
    st[PHI] += slope - turned
    slope = turned
    set_velocity(st, vt_out, vn_out, slope)
    face_velocity(st)
    # Azimuths grow clockwise: to the right is positive.
    to_right = angle_between(st[HX], st[HY], old_hx, old_hy)
    write_impact(f, st, px, py, speeds, to_right, tables)
    if active(forces.fragmentation, s):
        volume = mass_of(st) / st[DENSITY]
        if volume > 0.01 and draws.uniform(key, draws.BREAK, n) < break_chance(
            forces.fragmentation, volume, vn_in
        ):
            shatter(st, key, n, before - after, waiting)
            if st[MODE] == BROKEN:
                return
    if active(forces.entrainment, s) and st[KIND] == ROCK:
        loosen(f, forces, st, key, n, abs(vt_out - vt_in), px, py, waiting)
    theta = st[PHI] + slope
    x, _ = lever(a, b, theta)
    lifted = vn_out + x * st[SPIN]
    flies = vn_out > 0.0 or (lifted > 0.0 and lifted * lifted >= soft)
    # Where P is behind the centre a rock flies only if the ground cannot push it.
    if not (flies or thrown_off(a, b, theta, st[SPIN], slope)):
        land(f, st, slope, vt_out, vn_out, spin)


@kernel
def _roll(f: Field, forces: Forces, st: FloatArray, dt: float) -> None:
    """One step along the ground, rolling or sliding; may leave the ground or come to rest."""
    a, b = st[A], st[B]
    radius = rolling_radius(a, b)
    size = (a * b * st[C]) ** (1.0 / 3.0)
    law = f.law[f.ground[cell_of(f, st[X], st[Y])]]
    s = chainage_of(f, st[X], st[Y])
    dx, dy = descent(f.gx, f.gy, f.west, f.north, f.cell, st[X], st[Y], st[HX], st[HY])
    if dx * st[HX] + dy * st[HY] < 0.0:
        dx, dy = -dx, -dy
    along = along_of(st)
    v = math.sqrt(along * along + st[VZ] ** 2)
    turn_by(st, angle_between(st[HX], st[HY], dx, dy) * min(1.0, dt / _TURNS_IN_S))
    here, gx, gy = surface_at(f.z, f.west, f.north, f.cell, st[X], st[Y])
    slope = math.atan(-(gx * st[HX] + gy * st[HY]))
    inertia = (a * a + b * b) / 5.0
    # Energy of a rock that rolls, over that of its motion along the ground.
    whole = 1.0 + inertia / (radius * radius)
    turning_over = weight_on(slope) * (a - radius)
    energy = 0.5 * v * v * whole
    held = math.tan(slope) < rolling_friction(law, size)
    if st[MODE] == ROLL and energy < turning_over and held:
        # Too slow to turn over its longer axis.
        st[MODE] = SLIDE
    elif st[MODE] == SLIDE and law[laws.MU_F] * 2.0 * a * b > a * a - b * b:
        # Friction tips it over; it rolls with its angular momentum about the ground kept.
        lies = lever(a, b, st[PHI] + slope)[1]
        left = 0.5 * v * (v / whole) - weight_on(slope) * (radius - lies)
        if left > (turning_over if held else 0.0):
            v = math.sqrt(2.0 * left / whole)
            st[MODE] = ROLL
    friction = law[laws.MU_F]
    if st[MODE] == ROLL:
        friction = rolling_friction(law, size)
        if active(forces.rock_shape, s):
            flat = 1.0 - st[C] / b
            if v < 5.0 * forces.rock_shape.q * flat:
                friction *= 1.0 + min(1.0, forces.rock_shape.q * flat)
    if active(forces.snow, s):
        friction += snow_drag(forces.snow, v)
    if active(forces.ice, s) and on_ice(forces.ice, st[X], st[Y]):
        friction = 0.12
    # A wet block slips on wet ground.
    friction *= 1.0 - 0.4 * forces.wetting.q * (0.3 + 0.7 * st[CAMPAIGN])
    pull = GRAVITY * math.sin(slope) - friction * weight_on(slope)
    v += pull * dt
    st[TIME] += dt
    if v <= _SLOW and pull < 0.0:
        steepest = math.sqrt(gx * gx + gy * gy)
        if steepest > friction + 1e-3 and slope < 0.0:
            turn_back(st)
            set_velocity(st, _SLOW, 0.0, 0.0)
            st[SPIN] = _SLOW / radius
            return
        set_velocity(st, 0.0, 0.0, 0.0)
        st[SPIN] = 0.0
        st[MODE] = STOPPED
        return
    if st[MODE] == ROLL and a > b and _leaves_upright(f, st, v, slope):
        return
    onward = v * math.cos(slope)
    far = onward * _LOOK_AHEAD
    ahead = ground_at(f, st[X] + far * st[HX], st[Y] + far * st[HY])
    free = here - v * math.sin(slope) * _LOOK_AHEAD - 0.5 * GRAVITY * _LOOK_AHEAD**2
    st[X] += onward * dt * st[HX]
    st[Y] += onward * dt * st[HY]
    set_velocity(st, v, 0.0, slope)
    if st[MODE] == ROLL:
        st[SPIN] = v / radius
        st[PHI] -= st[SPIN] * dt
    else:
        st[SPIN] = 0.0
    zg, next_slope = slope_at(f, st, st[X], st[Y])
    # A rock that slides lies as it is turned, one that rolls is the circle of its mean radius.
    rest = radius if st[MODE] == ROLL else lever(a, b, st[PHI] + next_slope)[1]
    st[Z] = zg + rest / math.cos(next_slope)
    if free > ahead:
        st[MODE] = FLY
        return
    bend = slope - next_slope
    if bend > 0.0:
        # A hollow is met as the circle as which the rock rolls.
        hit = v * math.sin(bend)
        if st[MODE] == ROLL:
            vt, vn, spin = laws.contact(
                f.contact, a, b, st[C], 0.0, v * math.cos(bend), -hit, st[SPIN], law, 1.0, True
            )
            if vn * vn > 2.0 * weight_on(next_slope) * law[laws.SOFT] * size:
                set_velocity(st, vt, vn, next_slope)
                st[SPIN] = spin
                st[MODE] = FLY
                return
        v = max(v * math.cos(bend) - friction * hit, 0.0)
    set_velocity(st, v, 0.0, next_slope)


@kernel
def _leaves_upright(f: Field, st: FloatArray, v: float, slope: float) -> bool:
    """Let a rolling ellipse fly where the normal force on it ends, before it stands upright.

    Its energy is that of steady rolling, less what lifts its centre above the mean radius.
    """
    a, b = st[A], st[B]
    radius = rolling_radius(a, b)
    inertia = (a * a + b * b) / 5.0
    theta = st[PHI] + slope
    x, y = lever(a, b, theta)
    energy = 0.5 * v * v * (1.0 + inertia / (radius * radius)) - weight_on(slope) * (y - radius)
    if x > 0.0 or energy <= 0.0:
        # It sinks: past the upright, the ground does not throw it off.
        return False
    spin = math.sqrt(2.0 * energy / (inertia + x * x + y * y))
    if not thrown_off(a, b, theta, spin, slope):
        return False
    st[Z] = ground_at(f, st[X], st[Y]) + y / math.cos(slope)
    set_velocity(st, y * spin, -x * spin, slope)
    st[SPIN] = spin
    st[MODE] = FLY
    return True
