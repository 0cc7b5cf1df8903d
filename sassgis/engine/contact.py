"""Where a block touches a profile: the first contact of a flight, and where it lies at rest.

A profile is touched on a segment, where the tangent point of the ellipse lies between its ends, or
at a convex vertex, where the normal of the ellipse there lies between the normals of the two
segments. The segments under the flight are checked one by one; ellipse_contact.py solves each.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sassgis.compiled.jit import fused, inlined, lean
from sassgis.engine.ellipse import CountedRows, Record, cos_sin
from sassgis.engine.ellipse_contact import Flying, contact_with_segment, contact_with_vertex
from sassgis.engine.profile import segment_at

#: Relative difference below which two numbers differ by rounding only.
_CANCELS = 1e-10


class Contact(NamedTuple):
    """A contact of a flying block with a profile."""

    t: float  # infinite if there is none (s)
    segment: int  # -1 if there is none; at a vertex the segment on which the block moves on
    nx: float  # normal of the ground
    nz: float
    approach: float  # speed of the centre towards the ground (m/s)
    by_core: bool  # whether only the round core of the block is met


@inlined
def _no_contact(t: float) -> Contact:
    """Return the contact that represents none before a time (s)."""
    return Contact(t, -1, 0.0, 0.0, 0.0, False)


@inlined
def span(profile: CountedRows, j: int) -> float:
    """Return the length of a segment, along its tangent (m)."""
    here = profile.rows[j]
    after = profile.rows[j + 1]
    return float((after.x - here.x) * here.tx + (after.z - here.z) * here.tz)


@inlined
def is_convex(profile: CountedRows, k: int) -> bool:
    """Return whether the ground turns down at vertex k."""
    behind = profile.rows[k - 1]
    here = profile.rows[k]
    return bool(behind.tx * here.tz - behind.tz * here.tx < -1e-12)


@inlined
def _stays_beside(
    flying: Flying, here: Record, length: float, start: float, end: float, tolerance: float
) -> bool:
    """Return whether a block moved along the ground is before or past a segment all the time."""
    if flying.gravity != 0.0:
        return False
    along = (flying.x - here.x) * here.tx + (flying.z - here.z) * here.tz
    rate = flying.vx * here.tx + flying.vz * here.tz
    first = along + rate * start
    last = along + rate * end
    return bool(max(first, last) < -2.0 * tolerance or min(first, last) > length + 2.0 * tolerance)


@inlined
def _vertex_from(
    flying: Flying, here: Record, other: Record, touched: float, tolerance: float
) -> float:
    """Return the earliest time at which a block may touch the vertex between segments (s).

    At a vertex it touches the lines of both segments and approaches at least one of them; it
    touches the line of ``here`` at ``touched`` or later.
    """
    if flying.gravity == 0.0:
        return -np.inf
    rise = flying.vz * here.tx - flying.vx * here.tz
    other_rise = flying.vz * other.tx - flying.vx * other.tz
    early = touched
    if other_rise * here.tx < rise * other.tx:
        # Gravity turns it round towards the other line first.
        if other_rise <= 0.0:
            return -np.inf
        early = other_rise / (flying.gravity * other.tx)
    # In this time it falls by the tolerance.
    return early - math.sqrt(2.0 * tolerance / (flying.gravity * here.tx))


@lean
def _core_contact(
    flying: Flying, core: float, start: float, end: float, tolerance: float, profile: CountedRows,
    j: int, length: float,
) -> tuple[float, float, float, int]:  # fmt: skip
    """Find the first contact of a block's round core (radius m) with segment j or its vertices.

    Returns time, normal and the vertex that is met, -1 for the segment itself.
    """
    ball = Flying(flying.x, flying.z, flying.vx, flying.vz, 0.0, 0.0, core, core, flying.gravity)
    here = profile.rows[j]
    best = touched = np.inf
    if not _stays_beside(flying, here, length, start, end, tolerance):
        best, _, touched = contact_with_segment(ball, start, end, tolerance, here, length)
    nx = -here.tz
    nz = here.tx
    met = -1
    for k in range(max(j, 1), min(j + 1, profile.n[0] - 1) + 1):
        if not is_convex(profile, k):
            continue
        if flying.gravity == 0.0:
            # Moved along the ground, by a unit vector: it passes what lies next to its way.
            vertex = profile.rows[k]
            aside = (vertex.x - flying.x) * flying.vz - (vertex.z - flying.z) * flying.vx
            if abs(aside) > core + 1.5 * tolerance:
                continue
        other = profile.rows[k - 1 if k == j else k]
        if _vertex_from(flying, here, other, touched, tolerance) > min(end, best):
            continue
        t, vertex_nx, vertex_nz = contact_with_vertex(
            ball, start, min(end, best), tolerance, profile.rows[k - 1], profile.rows[k]
        )
        if t < best:
            best = t
            nx = vertex_nx
            nz = vertex_nz
            met = k
    return best, nx, nz, met


@inlined
def _times_over(
    flying: Flying, low: float, high: float, step: int, first: float, last: float
) -> tuple[float, float]:
    """Return part of a time span in which a block that moves is over chainages low to high (m)."""
    rear = low - flying.a
    front = high + flying.a
    if step < 0:
        rear, front = front, rear
    return max(first, (rear - flying.x) / flying.vx), min(last, (front - flying.x) / flying.vx)


@fused
def _within_reach(
    above: float, rate: float, fall: float, reach: float, first: float, last: float
) -> float:
    """Return the earliest time of touching a segment's line: ``first`` or later, or infinite.

    The height of its centre over the line is above + rate t − fall t², a concave parabola and so
    least at an end of the span; nothing touches while it is larger than ``reach``.
    """
    at_first = above + (rate - fall * first) * first - reach
    if at_first <= 0.0:
        return first
    at_last = -1.0
    if last < np.inf:
        at_last = above + (rate - fall * last) * last - reach
    if at_last > 0.0:
        return np.inf
    root = math.sqrt(max(rate * rate + 4.0 * fall * (above - reach), 0.0))
    # After the rebound of a sphere the difference is rounding only.
    if root - rate > _CANCELS * abs(rate):
        first = max(first, 2.0 * (above - reach) / (root - rate))
    return first


@lean
def next_contact(
    flying: Flying, start: float, end: float, tolerance: float, profile: CountedRows, near: int,
    skip_to: int,
) -> Contact:  # fmt: skip
    """Return the first contact of a flying block with a profile: of two at once the faster one.

    Parameters
    ----------
    start, end : float
        Times between which to look (s).
    tolerance : float
        Gap at which block and ground touch (m).
    near : int
        A segment near the centre, to start looking from.
    skip_to : int
        Segments that the block has just left, with their vertices: up to and including ``skip_to``
        if it moves to the right, from it on if it moves to the left; -1 for none. They can stop
        only its round core, of radius b.
    """
    n = profile.n[0]
    vx = flying.vx
    step = 1 if vx >= 0.0 else -1
    still = abs(vx) < 1e-9
    surface = abs(vx) + abs(flying.vz) + abs(flying.omega) * flying.a
    # Contacts closer in time than this are at the same time (s).
    same = (2.0 * tolerance + 1e-9 * flying.a) / surface if surface > 0.0 else 0.0
    # The edge over which it has just gone.
    edge = -1 if skip_to < 0 else skip_to + (1 if step > 0 else 0)
    best = _no_contact(end)
    fresh = True
    # The segment under its rear end.
    j = segment_at(profile, flying.x + flying.vx * start - step * flying.a, near)
    while 0 <= j < n:
        here = profile.rows[j]
        # Of what the block has just left, only its core can be stopped.
        left = skip_to >= 0 and (j <= skip_to if step > 0 else j >= skip_to)
        first = start
        last = best.t + same
        if still:
            if (step > 0 and here.x > flying.x + flying.a) or (
                step < 0 and profile.rows[j + 1].x < flying.x - flying.a
            ):
                break
        else:
            first, last = _times_over(flying, here.x, profile.rows[j + 1].x, step, first, last)
        if first > best.t + same:
            break
        if last >= first:
            above = (flying.x - here.x) * -here.tz + (flying.z - here.z) * here.tx
            rate = vx * -here.tz + flying.vz * here.tx
            fall = 0.5 * flying.gravity * here.tx
            first = _within_reach(above, rate, fall, flying.a + tolerance, first, last)
            if first <= last:
                best = _contact_at(
                    flying, tolerance, profile, j, step, left, fresh, edge, still, same, best,
                    first, last, above, rate, fall
                )  # fmt: skip
        fresh = fresh and left
        j += step
    if best.segment < 0:
        return _no_contact(np.inf)
    return best


@fused
def _contact_at(
    flying: Flying, tolerance: float, profile: CountedRows, j: int, step: int, left: bool,
    fresh: bool, edge: int, still: bool, same: float, best: Contact, first: float, last: float,
    above: float, rate: float, fall: float,
) -> Contact:  # fmt: skip
    """Return the best of the contact so far and those with segment j, its vertices and the core.

    Parameters as the locals of next_contact; ``above``, ``rate`` and ``fall`` as _within_reach.
    """
    n = profile.n[0]
    here = profile.rows[j]
    length = span(profile, j)
    touched = np.inf
    # While it moves away from the line it does not touch the segment.
    if not left and not (fall > 0.0 and rate >= 2.0 * fall * last):
        t, deep, touched = contact_with_segment(flying, first, last, tolerance, here, length)
        if t < np.inf:
            # Of contacts at the same time, that from outside is the one.
            approach = 0.0 if deep else -(rate - 2.0 * fall * t)
            if best.segment < 0 or t < best.t - same or approach > best.approach:
                best = Contact(min(t, best.t), j, -here.tz, here.tx, approach, False)
    # Its vertices; the one behind has been looked at with the segment before.
    for k in range(j, j + 2):
        if left or k in (0, n, edge) or (not fresh and k == (j if step > 0 else j + 1)):
            continue
        if not is_convex(profile, k):
            continue
        vertex = profile.rows[k]
        from_t = first
        to_t = min(last, best.t + same)
        if still:
            if abs(vertex.x - flying.x) > flying.a:
                continue
        else:
            from_t, to_t = _times_over(flying, vertex.x, vertex.x, step, from_t, to_t)
        other = profile.rows[k - 1 if k == j else k]
        if from_t > to_t or _vertex_from(flying, here, other, touched, tolerance) > to_t:
            continue
        t, nx, nz = contact_with_vertex(
            flying, from_t, to_t, tolerance, profile.rows[k - 1], vertex
        )
        if t < np.inf:
            approach = -(flying.vx * nx + (flying.vz - flying.gravity * t) * nz)
            if best.segment < 0 or t < best.t - same or approach > best.approach:
                best = Contact(min(t, best.t), k if step > 0 else k - 1, nx, nz, approach, False)
    # The core of a block whose flank reaches into the ground comes no nearer.
    core = max(flying.b - 2.0 * tolerance, 0.5 * flying.b)
    to_t = min(last, best.t)
    at_end = above + (rate - fall * to_t) * to_t if to_t < np.inf else -1.0
    if at_end < core or above + (rate - fall * first) * first < core:
        t, nx, nz, met = _core_contact(flying, core, first, to_t, tolerance, profile, j, length)
        if t < best.t or (best.segment < 0 and t <= best.t):
            segment = j
            if met >= 0:
                segment = met if step > 0 else met - 1
            approach = -(flying.vx * nx + (flying.vz - flying.gravity * t) * nz)
            best = Contact(t, segment, nx, nz, approach, True)
    return best


@lean
def resting_height(
    x: float,
    theta: float,
    a: float,
    b: float,
    profile: CountedRows,
    near: int,
) -> float:
    """Return the height of the centre of an ellipse that lies on the profile at chainage x (m).

    The largest of the heights at which it touches a segment within its ends, or a vertex; minus
    infinity where there is no ground below. ``theta`` is the angle of the major axis (rad),
    ``near`` a segment near x.
    """
    ct, st = cos_sin(theta)
    reach = math.sqrt(a * a * ct * ct + b * b * st * st)
    height = -np.inf
    n = profile.n[0]
    qa = st * st / (a * a) + ct * ct / (b * b)
    for j in range(segment_at(profile, x - a, near), n):
        here = profile.rows[j]
        if here.x > x + a:
            break
        nx = -here.tz
        nz = here.tx
        s = nx * ct + nz * st
        c = nz * ct - nx * st
        support = math.sqrt(a * a * s * s + b * b * c * c)
        lever = (a * a - b * b) * s * c / support
        z = here.z + (support - (x - here.x) * nx) / nz
        # Foot of the contact along the segment.
        foot = (x - here.x) * here.tx + (z - here.z) * here.tz - lever
        length = span(profile, j)
        if 0.0 <= foot <= length:
            height = max(height, z)
        for i in range(j, j + 2):
            dx = profile.rows[i].x - x
            if abs(dx) >= reach:
                continue
            qb = 2.0 * dx * st * ct * (1.0 / (a * a) - 1.0 / (b * b))
            qc = dx * dx * (ct * ct / (a * a) + st * st / (b * b)) - 1.0
            disc = qb * qb - 4.0 * qa * qc
            if disc >= 0.0:
                height = max(height, profile.rows[i].z + (qb + math.sqrt(disc)) / (2.0 * qa))
    return height
