"""When a turning ellipse in flight touches one segment or one vertex.

Along a fixed direction n, from the ground to the block, the gap is

    g(t) = (C(t) − P)·n − y(θ(t)),    y the support function of the ellipse,

with n the normal of the segment; at a vertex n is the normal of the ellipse scaled up until it
meets the vertex, taken anew at each step. Since y'' <= (a² − b²)/b, the quadratic with g, g' and
g'' >= −(gravity·n_z + ω²(a² − b²)/b) bounds the gap from below. Stepping to the root of that bound
can never pass the first contact, however fast the block or short the segment, and converges
quadratically; at a segment, with g'' itself and a bound of the third derivative, cubically.

A contact counts while the *centre* approaches the ground there: the paper's angle of incidence
lies between 0 and 90 degrees (Fig. 9). Just after an impact the flank of the turning block may
reach into the ground while its centre rises; no impact is made of that. Nor is one made of a gap
that is opening, however deep: a block that has rolled as a circle into a corner lies in the ground
as an ellipse, and one impact there must not count again. Its round core is stopped in any case.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sassgis.compiled.jit import inlined, lean
from sassgis.engine.ellipse import Record, cos_sin

_MAX_STEPS = 500
# Deeper than this share of b below a line, the segment may lie outside the block.
_DEEP = 1e-3
_TINY = 1e-7
# Step through a contact that does not count, as a share of b over the fastest speed of the surface.
_WAIT = 0.02
_REFINEMENTS = 30


class Flying(NamedTuple):
    """An ellipse in free flight, from time 0 on.

    With gravity = omega = 0 it moves in a straight line.
    """

    x: float  # centre (m)
    z: float
    vx: float  # (m/s)
    vz: float
    theta: float  # angle of the major axis (rad)
    omega: float  # spin (rad/s)
    a: float  # semi-axes (m)
    b: float
    gravity: float  # (m/s²)


@inlined
def _until_closed(gap: float, rate: float, bend: float) -> float:
    """Return the first time after 0 at which gap + rate t − bend t²/2 is zero, or infinity."""
    root2 = rate * rate + 2.0 * bend * gap
    if root2 < 0.0:
        return np.inf
    if rate < 0.0:
        return 2.0 * gap / (math.sqrt(root2) - rate)
    return (rate + math.sqrt(root2)) / bend if bend > 0.0 else np.inf


@inlined
def _open_for(
    gap: float, rate: float, bend: float, jerk: float, most: float
) -> tuple[float, float]:
    """Return a time for which a gap surely stays open (s, or infinite), and its largest width.

    ``gap``, ``rate`` and ``bend`` are the gap (m), its first and minus its second derivative now;
    ``jerk`` and ``most`` bound the size of its third and minus its second derivative at any time.
    """
    # Until the parabola of now closes the third derivative bends it by so much at most.
    closed = _until_closed(gap, rate, bend)
    extra = jerk * closed / 3.0
    if not bend + extra < most:
        return _until_closed(gap, rate, most), np.inf
    step = _until_closed(gap, rate, bend + extra)
    error = (0.5 * extra + jerk * step / 6.0) * step * step
    return step, error if rate < 0.0 else np.inf


@lean
def contact_with_segment(
    flying: Flying, start: float, end: float, tolerance: float, ground: Record, length: float
) -> tuple[float, bool, float]:
    """Return first time in [start, end] at which a flying block touches a segment between its ends.

    Times and tolerance are as for next_contact, ``ground`` is the segment and ``length`` its
    length.

    Returns
    -------
    t : float
        Infinite if there is no contact.
    deep : bool
        Whether the block already reached far below the line.
    touched : float
        Not before this time (s) is it at the line of the segment, between its ends or not; of a
        flight away from the line, once gravity has turned it round. Infinite if never.
    """
    x, z, vx, vz, theta, omega, a, b, gravity = flying
    px = ground.x
    pz = ground.z
    tx = ground.tx
    tz = ground.tz
    difference = a * a - b * b
    across = (z - pz) * tx - (x - px) * tz
    rise = vz * tx - vx * tz
    along = (x - px) * tx + (z - pz) * tz
    run = vx * tx + vz * tz
    down = gravity * tx
    # The tangent point is no farther along the line from the centre than this.
    widest = a - b + tolerance
    half_pull = 0.5 * gravity * tz
    at_start = along + (run - half_pull * start) * start
    at_end = along + (run - half_pull * end) * end
    sag = 0.25 * abs(half_pull) * (end - start) * (end - start)
    if min(at_start, at_end) - sag > length + widest or max(at_start, at_end) + sag < -widest:
        return np.inf, False, start
    spin2 = omega * omega
    bound = down + difference / b * spin2
    # The third derivative of y is −y' (4 + 3 y''/y), with |y'| <= a − b, |y''| <= (a² − b²)/b.
    jerk = (a - b) * (4.0 + 3.0 * difference / (b * b)) * spin2 * abs(omega)
    # The tangent point moves no faster than this along the segment, after what gravity adds.
    foot_speed = difference / b * abs(omega)
    # A step in which nothing moves by more than a millionth of the block.
    surface = abs(vx) + abs(vz) + abs(omega) * a + math.sqrt(gravity * b)
    tiny = _TINY * b / surface if surface > 0.0 else 0.0
    touched = np.inf
    t = start
    for _ in range(_MAX_STEPS):
        approach = rise - down * t
        if approach >= -1e-12:
            # The centre recedes: nothing counts before gravity has turned it round.
            if down <= 0.0:
                return np.inf, False, touched
            t += max(approach, 0.0) / down + tiny
            # Then it falls freely until it is as near as its longer axis.
            aloft = across + (rise - 0.5 * down * t) * t - a
            if aloft > 0.0:
                t += math.sqrt(2.0 * aloft / down)
        else:
            ct, st = cos_sin(theta - omega * t)
            s = tx * st - tz * ct
            c = tx * ct + tz * st
            support = math.sqrt(b * b + difference * s * s)
            per_support = 1.0 / support
            lever = difference * s * c * per_support
            gap = across + (rise - 0.5 * down * t) * t - support
            rate = approach + lever * omega
            if gap < -2.0 * support:
                # The whole block lies beyond the line: ground that stands above it, as on a riser.
                return np.inf, False, min(touched, t)
            if gap > tolerance or rate > 0.0:
                bend = down + (difference * (c * c - s * s) - lever * lever) * per_support * spin2
                if gap <= tolerance:
                    touched = min(touched, t)
                    # So long it surely goes on opening.
                    root = bend + math.sqrt(max(bend * bend + 2.0 * jerk * rate, 0.0))
                    t += max(2.0 * rate / root if root > 0.0 else np.inf, tiny)
                    if t > end:
                        return np.inf, False, touched
                    continue
                step, error = _open_for(gap, rate, bend, jerk, bound)
                if step == np.inf:
                    return np.inf, False, touched
                t += step if rate < 0.0 else max(step, tiny)
                if error <= tolerance and t <= end:
                    # It touches there; if certainly between the ends, that need not be looked at.
                    foot = along + (run - 0.5 * gravity * tz * t) * t - lever
                    if foot_speed * step <= foot <= length - foot_speed * step:
                        return t, False, min(touched, t)
            else:
                touched = min(touched, t)
                foot = along + (run - 0.5 * gravity * tz * t) * t - lever
                if -tolerance <= foot <= length + tolerance:
                    # Far below the line, the segment may still lie outside the block.
                    outside = -1.0
                    if gap < -_DEEP * b:
                        outside, rate, bound_there = _outside(
                            along + (run - 0.5 * gravity * tz * t) * t,
                            across + (rise - 0.5 * down * t) * t,
                            c, s, a, b, length, run - gravity * tz * t, approach, omega,
                            gravity, tx, tz
                        )  # fmt: skip
                    if outside < 0.0:
                        return t, gap < -_DEEP * b, touched
                    if outside <= tolerance:
                        # A block that only touches the end touches a vertex, which comes first.
                        t += tiny
                        if t > end:
                            return np.inf, False, touched
                        continue
                    root = math.sqrt(rate * rate + 2.0 * bound_there * outside)
                    if rate < 0.0:
                        t += 2.0 * outside / (root - rate)
                    elif bound_there > 0.0:
                        t += max((rate + root) / bound_there, tiny)
                    else:
                        return np.inf, False, touched
                    if t > end:
                        return np.inf, False, touched
                    continue
                # Below the line, but next to the segment: wait until the tangent point comes.
                far = -foot if foot < 0.0 else foot - length
                fastest = abs(run - gravity * tz * t) + foot_speed + math.sqrt(gravity * far)
                if fastest <= 0.0:
                    return np.inf, False, touched
                t += max(far / fastest, tiny)
        if t > end:
            break
    # Surely open up to t, but perhaps by no more than the tolerance.
    return t if t <= end else np.inf, False, min(touched, t)


@lean
def _outside(
    u: float, w: float, c: float, s: float, a: float, b: float, length: float, run: float,
    approach: float, omega: float, gravity: float, tx: float, tz: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the gap (m) between an ellipse and the nearer end of a segment, in the segment's axes.

    Of (u, w) the centre, (c, s) the direction of the major axis, (run, approach) the velocity in
    the same axes; (tx, tz) is their tangent. The gap is -1 if the ellipse meets the segment; with
    it come its rate (m/s) and the bound of its second derivative (m/s²).
    """
    # Ends of the segment in the frame of the ellipse, scaled to the unit circle.
    p1 = (-u * c - w * s) / a
    p2 = (-w * c + u * s) / b
    e1 = length * c / a
    e2 = -length * s / b
    along = -(p1 * e1 + p2 * e2)
    whole = e1 * e1 + e2 * e2
    if 0.0 < along < whole:
        # A chord of the line lies in the block, or the line itself passes it.
        return -1.0, 0.0, 0.0
    end = 0.0 if along <= 0.0 else length
    gap, nu, nw, lever = vertex_gap(u, w, c, s, a, b, end, 0.0)
    if gap <= 0.0:
        return -1.0, 0.0, 0.0
    up = nu * tz + nw * tx
    bound = gravity * max(up, 0.0) + (a * a - b * b) / b * omega * omega
    return gap, run * nu + approach * nw + lever * omega, bound


@lean
def vertex_gap(
    x: float, z: float, cos_t: float, sin_t: float, a: float, b: float, px: float, pz: float
) -> tuple[float, float, float, float]:
    """Measure the gap from an ellipse to a point along the normal of the ellipse scaled to it.

    Returns the gap (m), negative inside; the direction from the point to the block; and the
    tangential distance of the centre from the point of contact (m).
    """
    dx = px - x
    dz = pz - z
    n1 = -(dx * cos_t + dz * sin_t) / (a * a)
    n2 = -(dz * cos_t - dx * sin_t) / (b * b)
    size = math.sqrt(n1 * n1 + n2 * n2)
    if size == 0.0:
        return -b, 0.0, 1.0, 0.0
    n1 /= size
    n2 /= size
    support = math.sqrt(a * a * n1 * n1 + b * b * n2 * n2)
    lever = (a * a - b * b) * n1 * n2 / support
    nx = n1 * cos_t - n2 * sin_t
    nz = n1 * sin_t + n2 * cos_t
    return -(dx * nx + dz * nz) - support, nx, nz, lever


@lean
def contact_with_vertex(
    flying: Flying, start: float, end: float, tolerance: float, behind: Record, vertex: Record
) -> tuple[float, float, float]:
    """Return the first time in [start, end] at which a flying block touches a convex vertex.

    Infinite if there is none; with it the normal of the ellipse there. Times and tolerance are as
    for next_contact, ``behind`` is the vertex before.
    """
    x, z, vx, vz, theta, omega, a, b, gravity = flying
    px = vertex.x
    pz = vertex.z
    t0x = behind.tx
    t0z = behind.tz
    t1x = vertex.tx
    t1z = vertex.tz
    bend = (a * a - b * b) / b * omega * omega
    t = start
    clear = start
    for _ in range(_MAX_STEPS):
        ct, st = cos_sin(theta - omega * t)
        wz = vz - gravity * t
        gap, nx, nz, lever = vertex_gap(
            x + vx * t, z + (vz - 0.5 * gravity * t) * t, ct, st, a, b, px, pz
        )
        approach = vx * nx + wz * nz
        rate = approach + lever * omega
        if gap > tolerance:
            bound = gravity * max(nz, 0.0) + bend
            root = math.sqrt(rate * rate + 2.0 * bound * gap)
            if rate < 0.0:
                t += 2.0 * gap / (root - rate)
            elif bound > 0.0:
                t += (rate + root) / bound
            else:
                return np.inf, 0.0, 0.0
            clear = t
        elif _vertex_counts(approach, rate, nx, nz, t0x, t0z, t1x, t1z):
            # A contact that began to count between two steps of waiting is looked for there.
            low = clear
            for _ in range(_REFINEMENTS if t > clear else 0):
                middle = 0.5 * (low + t)
                ct, st = cos_sin(theta - omega * middle)
                wz = vz - gravity * middle
                gap, mx, mz, lever = vertex_gap(
                    x + vx * middle, z + (vz - 0.5 * gravity * middle) * middle, ct, st, a, b, px,
                    pz
                )  # fmt: skip
                approach = vx * mx + wz * mz
                rate = approach + lever * omega
                if gap <= tolerance and _vertex_counts(approach, rate, mx, mz, t0x, t0z, t1x, t1z):
                    t, nx, nz = middle, mx, mz
                else:
                    low = middle
            return t, nx, nz
        else:
            clear = t
            fastest = abs(vx) + abs(wz) + abs(omega) * a + math.sqrt(gravity * b)
            if fastest <= 0.0:
                return np.inf, 0.0, 0.0
            t += _WAIT * b / fastest
        if t > end:
            return np.inf, 0.0, 0.0
    return np.inf, 0.0, 0.0


@lean
def _vertex_counts(
    approach: float, rate: float, nx: float, nz: float, t0x: float, t0z: float, t1x: float,
    t1z: float,
) -> bool:  # fmt: skip
    """Return whether a block at a vertex touches it: it comes nearer, and between the segments."""
    if approach >= -1e-12 or rate > 0.0:
        return False
    return nx * t0x + nz * t0z >= -1e-9 and nx * t1x + nz * t1z <= 1e-9
