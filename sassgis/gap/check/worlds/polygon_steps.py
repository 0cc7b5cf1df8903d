"""What the check does around a rigid-body library: paths in plan, effects, records.

The library moves blocks in the vertical plane over their fall line. A step here reads where they
are, finds contacts by what no free flight does, applies the effects of nature, and records.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.check.worlds import contact_laws as laws
from sassgis.gap.check.worlds import random_draws as draws
from sassgis.gap.check.worlds.forces import (
    Forces,
    active,
    air_acceleration,
    break_chance,
    drained,
    indent,
    weight_on,
)
from sassgis.gap.check.worlds.law import GRAVITY, kinetic
from sassgis.gap.check.worlds.motion_records import (
    write_deposit,
    write_impact,
    write_passage,
    write_track,
)
from sassgis.gap.check.worlds.motion_state import (
    ASIDE,
    BROKEN,
    COUNT,
    DENSITY,
    HX,
    HY,
    KIND,
    MODE,
    PHI,
    ROCK,
    SPIN,
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
    X,
    Y,
    Z,
    chainage_of,
    law_at,
    mass_of,
)
from sassgis.gap.check.worlds.new_blocks import loosen, shatter
from sassgis.gap.check.worlds.obstacles import meet_obstacles
from sassgis.gap.check.worlds.slopes import descent, height_at
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.jit import kernel

Rides = NDArray[np.void]
#: Distance of the points of a path (m), and points above the start.
PACE_M, BACK = 2.0, 4
#: Paths lie side by side in the plane of the library, this far apart (m).
APART_M = 2000.0
#: What became of a block in a step.
GOES_ON, CHANGED, ENDED = range(3)
_TRACK_EVERY_S = 0.1
#: An impact is over when the block is free again, or after this time (s).
_CONTACT_S = 0.03
#: A block has stopped when its energy was below this (J/kg) for half a second.
_STILL, _STILL_S = 0.02, 0.5
LONGEST_S = 120.0
#: Share of the turning that soft ground takes when it is met, and while it is touched (1/s).
_DENT, _SINK = 0.25, 4.0
#: The heading stays within this angle of the fall line (rad).
_ASIDE_MOST = 1.2
_HALF = 0.5

#: A block on its path: chainage p and height z of the centre, velocity u, w (m/s) and turning
#: omega (rad/s, counter-clockwise) in the plane of the library; the same after the last step;
#: distance to the left of the path, height of the ground there above that of the path, time since
#: a contact began (s, -1 in flight), whether it is still to be recorded, and how it began.
_RIDE = (
    "p z u w omega u_last w_last omega_last side lift since is_open slope ahead hx hy vt vn spin s "
    "next_track still x y"
)
RIDE = np.dtype(
    [("lane", np.int64), ("obstacle", np.int64), *((name, float) for name in _RIDE.split())]
)


class Paths(NamedTuple):
    """Fall lines in plan and the ground under them, a row for each (m)."""

    x: FloatArray
    y: FloatArray
    z: FloatArray


@kernel
def lane_of(f: Field, st: FloatArray, n: int) -> FloatArray:
    """Fall line through a place, with a straight beginning above it: x, y, z of n points (m)."""
    line = np.empty((3, n))
    hx, hy = st[HX], st[HY]
    for k in range(n):
        if k <= BACK:
            line[0, k] = st[X] + (k - BACK) * PACE_M * hx
            line[1, k] = st[Y] + (k - BACK) * PACE_M * hy
        else:
            mx, my = descent(
                f.gx, f.gy, f.west, f.north, f.cell, line[0, k - 1], line[1, k - 1], hx, hy
            )
            hx, hy = descent(
                f.gx, f.gy, f.west, f.north, f.cell,
                line[0, k - 1] + 0.5 * PACE_M * mx, line[1, k - 1] + 0.5 * PACE_M * my, mx, my,
            )  # fmt: skip
            line[0, k] = line[0, k - 1] + PACE_M * hx
            line[1, k] = line[1, k - 1] + PACE_M * hy
        line[2, k] = height_at(f.z, f.west, f.north, f.cell, line[0, k], line[1, k])
    return line


@kernel
def _along(paths: Paths, ride: Any, p: float) -> tuple[int, float, float, float, float]:
    """Point of the path before chainage p, rest (m), direction in plan, dip (rad)."""
    lane = ride.lane
    k = min(max(int(p / PACE_M), 0), paths.x.shape[1] - 2)
    dx = (paths.x[lane, k + 1] - paths.x[lane, k]) / PACE_M
    dy = (paths.y[lane, k + 1] - paths.y[lane, k]) / PACE_M
    dip = math.atan((paths.z[lane, k] - paths.z[lane, k + 1]) / PACE_M)
    return k, p - k * PACE_M, dx, dy, dip


@kernel
def into_space(paths: Paths, ride: Any, st: FloatArray) -> tuple[float, float]:
    """Set place and velocity in space; returns height of the path (m) and dip where it touches.

    The plane of motion is seen with the travel to the right, as in all records.
    """
    k, rest, dx, dy, dip = _along(paths, ride, ride.p)
    z = paths.z[ride.lane, k] - rest * math.tan(dip)
    over = max(ride.z - z, 0.0) * math.cos(dip)
    _, _, _, _, dip = _along(paths, ride, ride.p - over * math.sin(dip))
    ahead = math.copysign(1.0, ride.u)
    c, s = math.cos(st[ASIDE]), math.sin(st[ASIDE])
    speed = abs(ride.u) / c
    st[X] = paths.x[ride.lane, k] + rest * dx - ride.side * dy
    st[Y] = paths.y[ride.lane, k] + rest * dy + ride.side * dx
    st[Z] = ride.z + ride.lift
    st[HX] = ahead * (c * dx - s * dy)
    st[HY] = ahead * (s * dx + c * dy)
    st[VX] = speed * st[HX]
    st[VY] = speed * st[HY]
    st[VZ] = ride.w
    st[SPIN] = -ahead * ride.omega
    return z, ahead * dip


@kernel
def into_plane(paths: Paths, ride: Any, st: FloatArray) -> None:
    """Bring velocity and turning in space back to the plane of the path."""
    _, _, dx, dy, _ = _along(paths, ride, ride.p)
    ahead = math.copysign(1.0, st[HX] * dx + st[HY] * dy)
    ride.u = st[VX] * dx + st[VY] * dy
    across = st[VY] * dx - st[VX] * dy
    ride.w = st[VZ]
    ride.omega = -ahead * st[SPIN]
    if abs(ride.u) > 1e-6:
        aside = math.atan(across / ride.u)
        st[ASIDE] = min(max(aside, -_ASIDE_MOST), _ASIDE_MOST)


@kernel
def _steer(ride: Any, st: FloatArray, aside: float) -> None:
    """Turn the heading; the speed in plan stays."""
    aside = min(max(aside, -_ASIDE_MOST), _ASIDE_MOST)
    ride.u *= math.cos(aside) / math.cos(st[ASIDE])
    st[ASIDE] = aside


@kernel
def watch(
    f: Field,
    forces: Forces,
    paths: Paths,
    moved: FloatArray,
    states: FloatArray,
    rides: Rides,
    keys: KeyArray,
    rocks: IntArray,
    dt: float,
    tables: Tables,
    stack: FloatArray,
    stack_keys: KeyArray,
    parents: IntArray,
    made: IntArray,
    fate: IntArray,
) -> int:
    """Look at all blocks after a step of the library; returns how many new ones wait."""
    waiting = 0
    for i in range(len(states)):
        st, ride = states[i], rides[i]
        ride.p, ride.z, st[PHI] = moved[i, 0] - APART_M * ride.lane, moved[i, 1], moved[i, 2]
        ride.u, ride.w, ride.omega = moved[i, 3], moved[i, 4], moved[i, 5]
        counts = np.array([waiting, made[rocks[i]]])
        fate[i] = _watch_one(
            f, forces, paths, st, ride, keys[i], rocks[i], dt, tables, stack, stack_keys, counts
        )
        parents[waiting : counts[0]] = i
        waiting = counts[0]
        made[rocks[i]] = counts[1]
        ride.u_last, ride.w_last, ride.omega_last = ride.u, ride.w, ride.omega
    return waiting


@kernel
def _watch_one(
    f: Field,
    forces: Forces,
    paths: Paths,
    st: FloatArray,
    ride: Any,
    key: np.uint64,
    rock: int,
    dt: float,
    tables: Tables,
    stack: FloatArray,
    stack_keys: KeyArray,
    counts: IntArray,
) -> int:
    u, w, omega = ride.u, ride.w, ride.omega
    st[TIME] += dt
    ride.side += ride.u * math.tan(st[ASIDE]) * dt
    jump = abs(ride.w - ride.w_last + GRAVITY * dt) + abs(ride.u - ride.u_last)
    touched = jump + st[B] * abs(ride.omega - ride.omega_last) > 1e-6
    if touched and ride.since < 0.0:
        _begin_contact(paths, ride, st, dt)
    height, _ = into_space(paths, ride, st)
    if touched:
        ride.since += dt
        ride.lift = height_at(f.z, f.west, f.north, f.cell, st[X], st[Y]) - height
        _hold(f, ride, st, dt)
    else:
        _push_by_air(forces, paths, ride, st, dt)
    if ride.is_open > 0.0 and (not touched or ride.since > _CONTACT_S):
        ride.is_open = 0.0
        into_space(paths, ride, st)
        _impact(f, forces, paths, ride, st, key, rock, stack, stack_keys, counts, tables)
        if st[MODE] == BROKEN:
            return ENDED
    if not touched:
        ride.since = -1.0
    if f.obstacles.shape[0] > 0:
        _pass_obstacles(f, paths, ride, st)
    changed = u != ride.u or w != ride.w or omega != ride.omega
    if touched or changed:
        into_space(paths, ride, st)
    if _record(f, ride, st, rock, dt, tables):
        return ENDED
    return CHANGED if changed else GOES_ON


@kernel
def _pass_obstacles(f: Field, paths: Paths, ride: Any, st: FloatArray) -> None:
    """Blow against a stem or a lying block."""
    last = np.array([ride.obstacle])
    meet_obstacles(f, st, last)
    if last[0] != ride.obstacle:
        ride.obstacle = last[0]
        into_plane(paths, ride, st)


@kernel
def _begin_contact(paths: Paths, ride: Any, st: FloatArray, dt: float) -> None:
    """Note how a contact begins: the velocity before it, half a step of falling later."""
    u, w, omega = ride.u, ride.w, ride.omega
    ride.u, ride.w, ride.omega = ride.u_last, ride.w_last - 0.5 * GRAVITY * dt, ride.omega_last
    z, ride.slope = into_space(paths, ride, st)
    # The foot of the normal from the centre.
    back = (ride.z - z) * math.cos(ride.slope) * math.sin(ride.slope)
    ride.x, ride.y = st[X] - back * st[HX], st[Y] - back * st[HY]
    ride.ahead = math.copysign(1.0, ride.u)
    ride.vt, ride.vn, ride.spin = _at_ground(ride, st)
    ride.hx, ride.hy = st[HX], st[HY]
    ride.since = 0.0
    ride.is_open = 1.0
    ride.u, ride.w, ride.omega = u, w, omega


@kernel
def _at_ground(ride: Any, st: FloatArray) -> tuple[float, float, float]:
    """Velocity along and away from the ground, and spin, as seen when the contact began."""
    along = ride.ahead * ride.u / math.cos(st[ASIDE])
    vt = along * math.cos(ride.slope) - ride.w * math.sin(ride.slope)
    vn = along * math.sin(ride.slope) + ride.w * math.cos(ride.slope)
    return vt, vn, -ride.ahead * ride.omega


@kernel
def _hold(f: Field, ride: Any, st: FloatArray, dt: float) -> None:
    """What touched ground does besides: soft ground takes turning, deviations fade."""
    if law_at(f, st[X], st[Y])[laws.SOFT] > 1.0:
        ride.omega *= 1.0 - (_DENT if ride.since <= dt else _SINK * dt)
    if ride.is_open == 0.0:
        _steer(ride, st, st[ASIDE] * (1.0 - min(1.0, dt / 0.6)))


@kernel
def _impact(
    f: Field,
    forces: Forces,
    paths: Paths,
    ride: Any,
    st: FloatArray,
    key: np.uint64,
    rock: int,
    stack: FloatArray,
    stack_keys: KeyArray,
    counts: IntArray,
    tables: Tables,
) -> None:
    """Effects at an impact that is over, and its record."""
    soft = law_at(f, st[X], st[Y])[laws.SOFT] * (st[A] * st[B] * st[C]) ** (1.0 / 3.0)
    if ride.vn >= 0.0 or ride.vn * ride.vn < 2.0 * weight_on(ride.slope) * soft:
        return
    st[COUNT] += 1.0
    n = int(st[COUNT])
    s = chainage_of(f, st)
    inertia = (st[A] ** 2 + st[B] ** 2) / 5.0
    radius = math.sqrt(st[A] * st[B])
    vt, vn, spin = _at_ground(ride, st)
    if active(forces.soft, s):
        vt, vn, spin = indent(
            forces.soft, mass_of(st), radius, inertia, ride.vn, ride.spin, vt, vn, spin
        )
    if forces.loss.q > 0.0:
        vt, vn, spin = drained(forces.loss, vt, vn, spin)
    before = kinetic(inertia, ride.vt, ride.vn, ride.spin)
    after = kinetic(inertia, vt, vn, spin)
    tables.gain[rock] = max(tables.gain[rock], (after - before) / before)
    along = vt * math.cos(ride.slope) + vn * math.sin(ride.slope)
    ride.u = ride.ahead * along * math.cos(st[ASIDE])
    ride.w = vn * math.cos(ride.slope) - vt * math.sin(ride.slope)
    ride.omega = -ride.ahead * spin
    aside = _HALF * st[ASIDE]
    if active(forces.facets, s):
        facet = forces.facets.q * draws.laplace(key, draws.LATERAL, n)
        lean = math.sin(min(max(facet, -0.9), 0.9))
        aside += math.atan2((vn - ride.vn) * lean, abs(along) + 0.5)
    _steer(ride, st, aside)
    into_space(paths, ride, st)
    row = np.array([math.degrees(ride.slope), ride.vt, ride.vn, ride.spin, vt, vn, spin])
    write_impact(f, st, rock, ride.x, ride.y, row, ride.hx, ride.hy, tables)
    if active(forces.breaking, s):
        volume = mass_of(st) / st[DENSITY]
        chance = break_chance(forces.breaking, volume, ride.vn)
        if volume > 0.01 and draws.uniform(key, draws.BREAK, n) < chance:
            lost = max(before - after, 0.0)
            shatter(f, st, key, n, lost, stack, stack_keys, counts, tables, rock)
            if st[MODE] == BROKEN:
                return
    if active(forces.loose, s) and st[KIND] == ROCK:
        made = counts[1]
        push = abs(vt - ride.vt)
        loosen(f, forces, st, key, n, push, ride.x, ride.y, stack, stack_keys, counts)
        if counts[1] > made:
            into_plane(paths, ride, st)


@kernel
def _push_by_air(forces: Forces, paths: Paths, ride: Any, st: FloatArray, dt: float) -> None:
    """Air, wind and lift on a block in flight, for one step."""
    if forces.air.q <= 0.0 and forces.wind.q <= 0.0 and forces.magnus.q <= 0.0:
        return
    ax, ay, az = air_acceleration(
        forces, st[A], st[B], st[C], st[DENSITY], st[PHI], st[SPIN], st[VX], st[VY], st[VZ]
    )
    st[VX] += ax * dt
    st[VY] += ay * dt
    st[VZ] += az * dt
    into_plane(paths, ride, st)


@kernel
def _record(f: Field, ride: Any, st: FloatArray, rock: int, dt: float, tables: Tables) -> bool:
    """Tracks, stations and stops; whether the block has ended."""
    if st[TIME] >= ride.next_track:
        write_track(st, rock, tables)
        ride.next_track = st[TIME] + _TRACK_EVERY_S
    before = ride.s
    ride.s = chainage_of(f, st)
    for k in range(f.stations.shape[0]):
        if before < f.stations[k] <= ride.s:
            write_passage(f, st, rock, k, tables)
    inertia = (st[A] ** 2 + st[B] ** 2) / 5.0
    ride.still += dt
    if kinetic(inertia, ride.u, ride.w, ride.omega) > _STILL:
        ride.still = 0.0
    if ride.still > _STILL_S or st[TIME] > LONGEST_S:
        write_track(st, rock, tables)
        write_deposit(f, st, rock, tables)
        return True
    n_rows, n_cols = f.z.shape
    x = (st[X] - f.west) / f.cell
    y = (f.north - st[Y]) / f.cell
    return bool(x < 1.5 or y < 1.5 or x > n_cols - 1.5 or y > n_rows - 1.5)
