"""How the heading of a block turns on a path that is followed.

The normal force of the ground has a part across the heading where the ground falls to one side. On
ground of gradient G (m per m) an impact with normal impulse J per unit mass (m/s) in the vertical
plane of the heading, on ground that rises p ahead and q to the right, gives the velocity

    v_r = J (tan τ − q) / √(1 + p²)

to the right; the heading turns by atan(v_r/v_h) and the speed stays, v_h being the horizontal speed
after the impact. τ is the sideways tilt of the spot that is met: drawn for each impact, as Δp is
for the slope ahead. As J grows more slowly than the speed of a block that grazes the ground, the
turn falls with speed. While a block rolls or slides J is g cos β per second, and the angle χ
between heading and descent follows

    dχ/ds = −κ sin χ,  κ = g |G| / ((1 + G²) v_h²),

s being the length in plan; over a step of constant κ, tan(χ/2) falls by exp(−κ s).

A block that is not symmetric about its plane of motion drifts steadily. It sees
the descent turned by an angle that is drawn once for it: its drift.
"""

from __future__ import annotations

import math

import numpy as np

from sassgis.compiled import rng
from sassgis.compiled.jit import fused, inlined, lean
from sassgis.engine.contact import resting_height
from sassgis.engine.effects import hooks
from sassgis.engine.ellipse import CountedRows, Record, cos_sin
from sassgis.engine.ground_ahead import (
    Path,
    begin_profile,
    gradient,
    known_to,
    look_ahead,
    place,
)
from sassgis.engine.ground_behind import keep_behind, sample_behind
from sassgis.engine.profile import segment_at
from sassgis.engine.state import (
    END,
    FLIGHT,
    IMPACT,
    LEFT_PROFILE,
    ROLLING,
    Block,
    Physics,
    Site,
    end,
)
from sassgis.terrain.cells import exact, height_at

# On the ground the heading turns by so much at most before the profile begins anew (rad); κ times
# the length of a step, where that is longer than so many radii.
_TURN = 0.01
_BEND_PER_STEP = 0.5
_SHORTEST_STEP = 0.1
#: Where the slope of the terrain ahead differs by less than _SAME_SLOPE a step is longer, up to so
#: many times a cell, or a block. As far ahead at least, and _FARTHEST at most, the ground is
#: sampled at once: segments end where sampling does.
LONGEST_STEP, _SAME_SLOPE = 8.0, 0.02
_FARTHEST = 32.0
# Below this angle (rad) a half-angle tangent is taken to its third power: right to 1e-10.
_SMALL = 0.02
# Smaller turns by impacts are ignored (rad).
_NO_TURN = 1e-9
# After a larger turn the ground behind the block is no longer that of before (rad).
_FAR_TURN = 0.2
# As its path turns, the ground may rise about a block: it is sunk if it lies deeper by this (m).
_SUNK_M = 1e-3
# The ground under a block is no steeper than this (m per m): 86 degrees.
_STEEPEST = 14.1
# A block that advances by less than this (m) in each of so many stretches is wedged.
_NO_WAY_M = 1e-6
_STUCK = 100
# A block that comes to the edge of the known terrain lies so far before it (m): on the edge it
# would lie in the cell beyond.
_EDGE_M = 0.01


@inlined
def head(state: Record, path: Path, u: float, v: float, hu: float, hv: float) -> None:
    """Set the place (u, v), in cells, and the heading, a unit vector, at the present chainage."""
    state.from_x = state.x
    state.from_u = exact(u)
    state.from_v = exact(v)
    state.du = hu / path.cell_size
    state.dv = hv / path.cell_size


@inlined
def _downhill(state: Record, gu: float, gv: float) -> tuple[float, float]:
    """Return the unit vector of the descent, turned by the drift of the block."""
    per_size = 1.0 / math.sqrt(gu * gu + gv * gv)
    c = state.drift_cos
    s = state.drift_sin
    return -(gu * c - gv * s) * per_size, -(gv * c + gu * s) * per_size


@inlined
def _clear_path(
    effects: hooks.Effects | None, state: Record, block: Block, site: Site, path: Path
) -> None:
    """Set what a block remembers of its path."""
    state.drift = path.drift * rng.normal(block.key, rng.DRIFT, 0)
    hooks.on_path(effects, state, block)
    state.drift_cos, state.drift_sin = cos_sin(state.drift)
    state.turn = 0.0
    state.phase = IMPACT
    site.crossings.n[0] = 0
    for i in range(path.line_seen.size):
        path.line_seen[i] = False


@lean
def start_path(
    effects: hooks.Effects | None, state: Record, block: Block, site: Site, path: Path,
    u: float, v: float,
) -> bool:  # fmt: skip
    """Start a path down the descent from a place; return whether the terrain is known there.

    On level ground any direction is as likely.
    """
    state.x = 0.0
    _clear_path(effects, state, block, site, path)
    gu, gv, known = gradient(path, u, v, block.radius)
    if known and gu * gu + gv * gv > 1e-12:
        hu, hv = _downhill(state, gu, gv)
    else:
        angle = 2.0 * math.pi * rng.uniform(block.key, rng.HEADING, 0)
        hu = math.cos(angle)
        hv = math.sin(angle)
    return _set_out(state, block, site, path, u, v, hu, hv, gu * hu + gv * hv)


@lean
def continue_path(
    effects: hooks.Effects | None, state: Record, block: Block, site: Site, path: Path,
    spawned: Record,
) -> None:  # fmt: skip
    """Start a path where another block has spawned this one, if the terrain is known there."""
    state.x = spawned.x
    _clear_path(effects, state, block, site, path)
    c = math.cos(spawned.aside)
    s = math.sin(spawned.aside)
    hu = (spawned.du * c - spawned.dv * s) * path.cell_size
    hv = (spawned.dv * c + spawned.du * s) * path.cell_size
    gu, gv, _ = gradient(path, spawned.u, spawned.v, block.radius)
    _set_out(state, block, site, path, spawned.u, spawned.v, hu, hv, gu * hu + gv * hv)


@inlined
def _set_out(
    state: Record, block: Block, site: Site, path: Path, u: float, v: float, hu: float, hv: float,
    slope: float,
) -> bool:  # fmt: skip
    """Begin a path with a unit vector as heading; return whether the terrain is known there."""
    z, ground = _ground_at(path, u, v)
    if ground < 0:
        return False
    head(state, path, u, v, hu, hv)
    begin_profile(state, block, site, path, z, slope, ground, 1.0, 0)
    return True


@inlined
def _ground_at(path: Path, u: float, v: float) -> tuple[float, int]:
    """Return height (m) and ground class of the terrain; class -1 where it is not known."""
    row = int(np.floor(v))
    col = int(np.floor(u))
    if not (0 <= row < path.heights.shape[0] and 0 <= col < path.heights.shape[1]):
        return 0.0, -1
    z = height_at(path.heights, u, v, row, col)
    if math.isnan(z):
        return 0.0, -1
    return z, int(path.ground[row, col])


@lean
def turn_heading(
    state: Record, block: Block, site: Site, path: Path, gravity: float, angle: float, gu: float,
    gv: float, known: bool,
) -> None:  # fmt: skip
    """Turn the heading to the right by an angle (rad), with all that is relative to the ground.

    The block keeps its place in plan, its velocity along and off the ground, its spin and its
    orientation to the ground; what its centre is raised or lowered by is taken from its speed. One
    that moves backwards is turned about, so that it always moves ahead. (gu, gv) is the gradient of
    the terrain at the scale of the block, if ``known``; else 0, and the plane stays as steep.
    """
    at = segment_at(site.profile, state.x, state.segment)
    here = site.profile.rows[at]
    slope = here.tz / here.tx
    z0 = here.z + (state.x - here.x) * slope
    ground = here.ground
    rests = _rests_at(state, block, site)
    hu = state.du * path.cell_size
    hv = state.dv * path.cell_size
    back = state.vx < 0.0 if state.phase == FLIGHT else state.direction < 0
    if back:
        slope = -slope
        hu = -hu
        hv = -hv
        _mirror(state)
    c, s = cos_sin(angle)
    to_u = hu * c - hv * s
    to_v = hv * c + hu * s
    # Nothing that rests moves relative to the ground: that is as the terrain is.
    rests_on = known and state.phase != FLIGHT and state.speed <= 0.0
    ahead = slope if rests_on else gu * hu + gv * hv
    after, tilt, c, s = _tilted(slope, ahead, gu * to_u + gv * to_v)
    u, v = place(state, state.x)
    state.theta += tilt
    vx = state.vx * c - state.vz * s
    state.vz = state.vz * c + state.vx * s
    state.vx = vx
    head(state, path, u, v, to_u, to_v)
    if abs(angle) > _FAR_TURN:
        behind = sample_behind(state, block, site, path, z0, after, ground)
    else:
        # The ground behind the block turns with the plane.
        behind = keep_behind(state, block, site, at, back, after - slope)
    if state.skip_to >= 0:
        left = state.skip_to - at
        state.skip_to = max(behind - left if back else behind + left, -1)
    begin_profile(state, block, site, path, z0, after, ground, gravity, behind)
    raised = _rests_at(state, block, site) - rests
    if raised < 0.0 and rests - state.z > _SUNK_M:
        # It already lies lower than it would touch: lowered again, it would fall through.
        raised = min(raised + rests - state.z, 0.0)
    if abs(raised) < block.a:
        paid = min(raised, _kinetic(state, block) / gravity)
        state.z += paid
        _take(state, block, gravity * paid)
        if paid < raised:
            # No block rises without energy: the ground gives way.
            z0 -= raised - paid
            for i in range(behind + 1):
                site.profile.rows[i].z -= raised - paid
            begin_profile(state, block, site, path, z0, after, ground, gravity, behind)
    elif raised < 0.0 and state.phase != FLIGHT:
        # It lay on walls that are not in its way any more: it falls.
        state.vx = state.speed / math.sqrt(1.0 + after * after)
        state.vz = state.vx * after
        state.phase = FLIGHT


@lean
def _tilted(slope: float, before: float, after: float) -> tuple[float, float, float, float]:
    """Return slope of the profile, tilted as the terrain, with angle, cosine and sine of the tilt.

    ``before`` and ``after`` are the slopes of the terrain along the old and the new heading.
    """
    across = 1.0 + before * after
    tangent = (after - before) / across
    rest = 1.0 - slope * tangent
    tilted = (slope + tangent) / rest
    if across > 0.0 and rest > 0.0 and abs(tilted) <= _STEEPEST:
        c = 1.0 / math.sqrt(1.0 + tangent * tangent)
        return tilted, math.atan(tangent), c, tangent * c
    angle = math.atan(slope)
    steep = math.atan(_STEEPEST)
    tilt = min(max(angle + math.atan(after) - math.atan(before), -steep), steep) - angle
    c, s = cos_sin(tilt)
    return math.tan(angle + tilt), tilt, c, s


@inlined
def _rests_at(state: Record, block: Block, site: Site) -> float:
    """Return the height at which the block would touch the ground as it stands (m)."""
    if state.phase == ROLLING:
        radius = block.roll_radius
        return resting_height(state.x, 0.0, radius, radius, site.profile, 0)
    return resting_height(state.x, state.theta, block.a, block.b, site.profile, 0)


@inlined
def _mirror(state: Record) -> None:
    """Turn a block about."""
    state.theta = math.pi - state.theta
    state.omega = -state.omega
    state.vx = -state.vx
    state.about = -state.about
    state.nx = -state.nx
    state.direction = 1


@inlined
def _kinetic(state: Record, block: Block) -> float:
    """Return the kinetic energy per unit mass (J/kg)."""
    twice = block.inertia * state.omega * state.omega
    if state.phase == FLIGHT:
        twice += state.vx * state.vx + state.vz * state.vz
    else:
        twice += state.speed * state.speed
    return float(0.5 * twice)


@inlined
def _take(state: Record, block: Block, work: float) -> None:
    """Take some work from the kinetic energy (J/kg)."""
    own = _kinetic(state, block)
    if own > 0.0:
        left = math.sqrt(max(1.0 - work / own, 0.0))
        state.vx *= left
        state.vz *= left
        state.omega *= left
        state.speed *= left


@fused
def after_impact(
    state: Record, block: Block, site: Site, path: Path, physics: Physics, into: float,
    hard: bool,
) -> None:  # fmt: skip
    """Turn the heading as an impact does; ``into`` is the normal speed before it (m/s).

    A soft landing, which is not ``hard``, meets no separate spot.
    """
    if state.phase == END or state.phase == IMPACT:
        return
    u, v = place(state, state.x)
    gu, gv, known = gradient(path, u, v, block.radius)
    angle = state.turn
    state.turn = 0.0
    here = site.profile.rows[state.segment]
    if state.phase == FLIGHT:
        off = state.vx * state.nx + state.vz * state.nz
        ahead = state.vx
    else:
        off = 0.0
        ahead = state.direction * state.speed * here.tx
    if known:
        # As the block drifts, the ground seems turned.
        c = state.drift_cos
        s = state.drift_sin
        su = gu * c - gv * s
        sv = gv * c + gu * s
        hu = state.du * path.cell_size
        hv = state.dv * path.cell_size
        side = su * -hv + sv * hu
        if hard and path.side_tilt > 0.0:
            tilt = path.side_tilt * rng.normal(block.key, rng.SIDE_TILT, state.impacts)
            side -= math.tan(min(max(tilt, -1.2), 1.2))
        push = -max(off + into, 0.0) * side * state.nz
        if ahead < 0.0:
            # To the right of a block that moves backwards lies its left.
            push = -push
        if push != 0.0:
            angle += math.atan2(push, abs(ahead))
    backwards = ahead < 0.0
    if backwards or (state.phase == FLIGHT and abs(angle) > _NO_TURN):
        turn_heading(state, block, site, path, physics.gravity, angle, gu, gv, known)
    else:
        # For motion along the ground before_ground turns the heading: a profile that began anew at
        # a corner just passed would make the block meet the corner again endlessly.
        state.turn = angle


@inlined
def before_flight(state: Record, block: Block, site: Site, path: Path, physics: Physics) -> None:
    """Look ahead to where a flight lands, where the ground below it is not known yet."""
    if state.vx < 0.0:
        # A wind has turned it back.
        turn_heading(state, block, site, path, physics.gravity, 0.0, 0.0, 0.0, False)
    needed = known_to(state, block)
    if state.open and state.sampled < needed:
        look_ahead(state, block, site, path, needed, physics.gravity)


@fused
def before_ground(state: Record, block: Block, site: Site, path: Path, physics: Physics) -> None:
    """Turn the heading as far as is due, and find how far the ground may be followed.

    The slope of the terrain at block scale, and the angle from the heading to the descent, to the
    right (rad), are noted for after_ground. After the turn the block may be in flight.
    """
    u, v = place(state, state.x)
    gu, gv, known = gradient(path, u, v, block.radius)
    steep2 = gu * gu + gv * gv
    state.steep2 = steep2
    step = max(path.cell_size, 2.0 * block.radius)
    descent = _angle_to(state, gu, gv, path.cell_size)
    angle = state.turn
    if state.speed <= 0.0:
        # From rest a block starts down the descent.
        state.direction = 1
        if steep2 > 1e-12:
            angle = descent
            state.turn = angle
    elif steep2 > 1e-12:
        level = state.speed * site.profile.rows[state.segment].tx
        kappa = bending(physics.gravity, steep2, level * level)
        step = min(step, max(_BEND_PER_STEP / kappa, _SHORTEST_STEP * block.radius))
        step = _straight_on(state, block, path, gu, gv, step, kappa, abs(descent - angle))
        # Over the step the block moves as it heads in its middle.
        angle += 0.5 * bent(descent - angle, kappa * step)
    if abs(angle) > _TURN or state.direction < 0 or state.speed <= 0.0:
        state.turn -= angle
        turn_heading(state, block, site, path, physics.gravity, angle, gu, gv, known)
        descent = _angle_to(state, gu, gv, path.cell_size)
        if state.phase == FLIGHT:
            return
    if state.speed <= 0.0 and site.profile.rows[state.segment].tz > 0.0:
        # In a dip the ground under it rises that way: it would start backwards.
        state.direction = -1
        turn_heading(state, block, site, path, physics.gravity, 0.0, gu, gv, known)
        descent = _angle_to(state, gu, gv, path.cell_size)
    state.reach = state.x + step
    needed = state.reach + 2.0 * block.a
    if state.open and state.sampled < needed:
        # As far again as the heading has been kept, so that seldom a segment ends here.
        unit = max(path.cell_size, 2.0 * block.radius)
        ahead = max(LONGEST_STEP * unit, min(state.x - state.from_x, _FARTHEST * unit))
        look_ahead(state, block, site, path, needed + ahead, physics.gravity)
    state.descent = descent
    state.set_out = state.x
    state.level = state.speed * site.profile.rows[state.segment].tx


@lean
def _straight_on(
    state: Record, block: Block, path: Path, gu: float, gv: float, step: float, kappa: float,
    aside: float,
) -> float:  # fmt: skip
    """Return the step on the ground (m), doubled while the slope of the terrain is the same ahead.

    ``aside`` is the angle from the descent (rad).
    """
    same2 = _SAME_SLOPE * _SAME_SLOPE * (gu * gu + gv * gv)
    most = min(LONGEST_STEP * step, min(_BEND_PER_STEP, _TURN / max(aside, 1e-9)) / kappa)
    while 2.0 * step <= most:
        u, v = place(state, state.x + 2.0 * step)
        to_u, to_v, known = gradient(path, u, v, block.radius)
        du = to_u - gu
        dv = to_v - gv
        if not known or du * du + dv * dv > same2:
            break
        step *= 2.0
    return step


@lean
def bending(gravity: float, steep2: float, level2: float) -> float:
    """Return κ (1/m), from the squares of the gradient and of the horizontal speed (m²/s²)."""
    return gravity * math.sqrt(steep2) / ((1.0 + steep2) * max(level2, 1e-9))


@lean
def bent(angle: float, kappa_s: float) -> float:
    """Return by how much an angle to the descent falls over κ times a length (rad).

    The angle may be more than half a turn: the block turns the shorter way.
    """
    angle -= 2.0 * math.pi * np.rint(angle / (2.0 * math.pi))
    left = math.exp(-kappa_s)
    if abs(angle) < _SMALL:
        return angle - left * angle * (1.0 + (1.0 - left * left) * angle * angle / 12.0)
    return angle - 2.0 * math.atan(math.tan(0.5 * angle) * left)


@inlined
def _angle_to(state: Record, gu: float, gv: float, cell_size: float) -> float:
    """Return the angle from the heading to the descent as the block sees it, to the right (rad)."""
    if gu * gu + gv * gv <= 1e-12:
        return 0.0
    tu, tv = _downhill(state, gu, gv)
    hu = state.du * cell_size
    hv = state.dv * cell_size
    return math.atan2(hu * tv - hv * tu, hu * tu + hv * tv)


@inlined
def after_ground(state: Record, physics: Physics) -> None:
    """Let the heading turn towards the descent over a stretch on the ground (before_ground)."""
    # What has moved backwards is turned about before it goes on.
    if state.steep2 > 1e-12 and state.x > state.set_out:
        mean2 = 0.5 * (state.level * state.level + state.vx * state.vx)
        kappa = bending(physics.gravity, state.steep2, mean2)
        state.turn += bent(state.descent - state.turn, kappa * (state.x - state.set_out))


@inlined
def stays_on_known(state: Record, site: Site) -> None:
    """End a block that has come over the edge of the known terrain; it lies before the edge."""
    if state.open:
        return
    edge = site.profile.rows[site.profile.n[0]].x
    if state.x > edge and state.phase != END:
        end(state, LEFT_PROFILE)
    if state.phase == END:
        state.x = min(state.x, max(edge - _EDGE_M, state.from_x))


@inlined
def wedged(state: Record) -> bool:
    """Return whether a block between walls has not advanced for so many stretches."""
    if abs(state.x - state.stuck_x) > _NO_WAY_M:
        state.stuck_x = state.x
        state.stuck = 0
        return False
    state.stuck += 1
    return bool(state.stuck > _STUCK and state.phase != END)


@inlined
def place_spawned(state: Record, spawned: CountedRows, before: int) -> None:
    """Write the places of the blocks that an impact has spawned, from number ``before`` on."""
    for i in range(before, min(spawned.n[0], spawned.rows.size)):
        row = spawned.rows[i]
        row.u, row.v = place(state, row.x)
        row.du = state.du
        row.dv = state.dv
        row.about = state.about
