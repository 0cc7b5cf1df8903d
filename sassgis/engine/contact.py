"""When and where a turning ellipse first touches the ground.

A profile is touched on a segment, where the tangent point of the ellipse lies between its ends, or
at a convex vertex, where the normal of the ellipse there lies between the normals of the two
segments. Along a fixed direction n, from the ground to the rock, the gap is

    g(t) = (C(t) − P)·n − y(θ(t)),    y the support function of the ellipse,

with n the normal of the segment; at a vertex n is the normal of the ellipse scaled up until it
meets the vertex, taken anew at each step. Since y'' <= (a² − b²)/b, the quadratic with g, g' and
g'' >= −(gravity·n_z + ω²(a² − b²)/b) bounds the gap from below. Stepping to the root of that bound
can never pass the first contact, however fast the rock or short the segment, and converges
quadratically.

A contact counts while the *centre* approaches the ground there: the paper's angle of incidence
lies between 0 and 90 degrees (Fig. 9). Just after an impact the flank of the turning rock may reach
into the ground while its centre rises; no impact is made of that. Nor is one made of a gap that is
opening.
"""

from __future__ import annotations

import math

import numpy as np

from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel

_MAX_STEPS = 500
# Deeper than this share of b a contact counts also while it opens.
_DEEP = 1e-3
_TINY = 1e-7
# Step through a contact that does not count, as a share of b over the fastest speed of the surface.
_WAIT = 0.02
_REFINEMENTS = 30


@kernel
def contact_with_segment(
    x: float,
    z: float,
    vx: float,
    vz: float,
    theta: float,
    omega: float,
    a: float,
    b: float,
    gravity: float,
    start: float,
    end: float,
    tolerance: float,
    px: float,
    pz: float,
    tx: float,
    tz: float,
    length: float,
) -> tuple[float, bool]:
    """First time in [start, end] at which a flying rock touches a segment between its ends.

    Parameters
    ----------
    x, z, vx, vz, theta, omega, a, b, gravity, start, end, tolerance
        As for next_contact.
    px, pz, tx, tz, length : float
        Start of the segment (m), its unit tangent and its length (m).

    Returns
    -------
    t : float
        Infinite if there is no contact.
    deep : bool
        Whether the rock already reached far below the line.
    """
    difference = a * a - b * b
    across = (z - pz) * tx - (x - px) * tz
    rise = vz * tx - vx * tz
    along = (x - px) * tx + (z - pz) * tz
    run = vx * tx + vz * tz
    down = gravity * tx
    bound = down + difference / b * omega * omega
    # The tangent point moves no faster than this along the segment, after what gravity adds.
    foot_speed = difference / b * abs(omega)
    # A step that moves nothing by a millionth of the rock.
    surface = abs(vx) + abs(vz) + abs(omega) * a + math.sqrt(gravity * b)
    tiny = _TINY * b / surface if surface > 0.0 else 0.0
    t = start
    for _ in range(_MAX_STEPS):
        approach = rise - down * t
        if approach >= -1e-12:
            # The centre recedes: nothing counts before gravity has turned it round.
            if down <= 0.0:
                return np.inf, False
            t += max(approach, 0.0) / down + tiny
        else:
            angle = theta - omega * t
            ct = math.cos(angle)
            st = math.sin(angle)
            s = tx * st - tz * ct
            c = tx * ct + tz * st
            support = math.sqrt(b * b + difference * s * s)
            lever = difference * s * c / support
            gap = across + (rise - 0.5 * down * t) * t - support
            rate = approach + lever * omega
            if gap < -2.0 * support:
                # The whole rock lies beyond the line: ground that stands above it, as on a riser.
                return np.inf, False
            if gap > tolerance or (rate > 0.0 and gap > -_DEEP * b):
                open_gap = max(gap, 0.0)
                root = math.sqrt(rate * rate + 2.0 * bound * open_gap)
                if rate < 0.0:
                    t += 2.0 * open_gap / (root - rate)
                elif bound > 0.0:
                    t += max((rate + root) / bound, tiny)
                else:
                    return np.inf, False
            else:
                foot = along + (run - 0.5 * gravity * tz * t) * t - lever
                if -tolerance <= foot <= length + tolerance:
                    # Far below the line, the segment may still lie outside the rock.
                    outside = -1.0
                    if gap < -_DEEP * b:
                        outside, rate, bound_there = _outside(
                            along + (run - 0.5 * gravity * tz * t) * t,
                            across + (rise - 0.5 * down * t) * t,
                            c, s, a, b, length, run - gravity * tz * t, approach, omega,
                            gravity, tx, tz,
                        )  # fmt: skip
                    if outside < 0.0:
                        return t, gap < -_DEEP * b
                    if outside <= tolerance:
                        # A rock that only touches the end touches a vertex, which comes first.
                        t += tiny
                        if t > end:
                            return np.inf, False
                        continue
                    root = math.sqrt(rate * rate + 2.0 * bound_there * outside)
                    if rate < 0.0:
                        t += 2.0 * outside / (root - rate)
                    elif bound_there > 0.0:
                        t += max((rate + root) / bound_there, tiny)
                    else:
                        return np.inf, False
                    if t > end:
                        return np.inf, False
                    continue
                # Below the line, but beside the segment: wait until the tangent point comes.
                far = -foot if foot < 0.0 else foot - length
                fastest = abs(run - gravity * tz * t) + foot_speed + math.sqrt(gravity * far)
                if fastest <= 0.0:
                    return np.inf, False
                t += max(far / fastest, tiny)
        if t > end:
            return np.inf, False
    return (t, False) if t <= end else (np.inf, False)


@kernel
def _outside(
    u: float,
    w: float,
    c: float,
    s: float,
    a: float,
    b: float,
    length: float,
    run: float,
    approach: float,
    omega: float,
    gravity: float,
    tx: float,
    tz: float,
) -> tuple[float, float, float]:
    """Gap between an ellipse and the nearer end of a segment, in the axes of the segment.

    Parameters
    ----------
    u, w : float
        Centre along and across the segment (m).
    c, s : float
        Direction of the major axis in the same axes.
    a, b, length : float
        Semi-axes, length of the segment (m).
    run, approach, omega, gravity, tx, tz : float
        Velocity in the same axes, spin, gravity and tangent.

    Returns
    -------
    gap, rate, bound : float
        The gap (m), -1 if the ellipse meets the segment; its rate (m/s) and the bound of its second
        derivative (m/s²).
    """
    # Ends of the segment in the frame of the ellipse, scaled to the unit circle.
    p1 = (-u * c - w * s) / a
    p2 = (-w * c + u * s) / b
    e1 = length * c / a
    e2 = -length * s / b
    along = -(p1 * e1 + p2 * e2)
    whole = e1 * e1 + e2 * e2
    if 0.0 < along < whole:
        # A chord of the line lies in the rock, or the line itself passes it.
        return -1.0, 0.0, 0.0
    end = 0.0 if along <= 0.0 else length
    gap, nu, nw, lever = vertex_gap(u, w, c, s, a, b, end, 0.0)
    if gap <= 0.0:
        return -1.0, 0.0, 0.0
    up = nu * tz + nw * tx
    bound = gravity * max(up, 0.0) + (a * a - b * b) / b * omega * omega
    return gap, run * nu + approach * nw + lever * omega, bound


@kernel
def vertex_gap(
    x: float, z: float, cos_t: float, sin_t: float, a: float, b: float, px: float, pz: float
) -> tuple[float, float, float, float]:
    """Gap between an ellipse and a point, along the normal of the ellipse scaled up to meet it.

    Parameters
    ----------
    x, z : float
        Centre (m).
    cos_t, sin_t : float
        Direction of the major axis.
    a, b : float
        Semi-axes (m).
    px, pz : float
        The point (m).

    Returns
    -------
    gap : float
        (m), negative inside.
    nx, nz : float
        The direction, from the point to the rock.
    lever : float
        Tangential distance of the centre from the point of contact (m).
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


@kernel
def contact_with_vertex(
    x: float,
    z: float,
    vx: float,
    vz: float,
    theta: float,
    omega: float,
    a: float,
    b: float,
    gravity: float,
    start: float,
    end: float,
    tolerance: float,
    px: float,
    pz: float,
    t0x: float,
    t0z: float,
    t1x: float,
    t1z: float,
) -> tuple[float, float, float]:
    """First time in [start, end] at which a flying rock touches a convex vertex.

    Parameters
    ----------
    px, pz : float
        The vertex (m).
    t0x, t0z, t1x, t1z : float
        Unit tangents of the segments that end and start there.

    Returns
    -------
    t : float
        Infinite if there is no contact.
    nx, nz : float
        Normal of the ellipse there.
    """
    bend = (a * a - b * b) / b * omega * omega
    t = start
    clear = start
    for _ in range(_MAX_STEPS):
        angle = theta - omega * t
        wz = vz - gravity * t
        gap, nx, nz, lever = vertex_gap(
            x + vx * t, z + (vz - 0.5 * gravity * t) * t, math.cos(angle), math.sin(angle), a, b,
            px, pz,
        )  # fmt: skip
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
        elif _vertex_counts(approach, rate, gap, b, nx, nz, t0x, t0z, t1x, t1z):
            # A contact that began to count between two steps of waiting is looked for there.
            low = clear
            for _ in range(_REFINEMENTS if t > clear else 0):
                middle = 0.5 * (low + t)
                angle = theta - omega * middle
                wz = vz - gravity * middle
                gap, mx, mz, lever = vertex_gap(
                    x + vx * middle, z + (vz - 0.5 * gravity * middle) * middle, math.cos(angle),
                    math.sin(angle), a, b, px, pz,
                )  # fmt: skip
                approach = vx * mx + wz * mz
                rate = approach + lever * omega
                if gap <= tolerance and _vertex_counts(
                    approach, rate, gap, b, mx, mz, t0x, t0z, t1x, t1z
                ):
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


@kernel
def _vertex_counts(
    approach: float,
    rate: float,
    gap: float,
    b: float,
    nx: float,
    nz: float,
    t0x: float,
    t0z: float,
    t1x: float,
    t1z: float,
) -> bool:
    """Whether a rock that reaches a vertex touches it: approaching, and from outside."""
    if approach >= -1e-12 or (rate > 0.0 and gap > -_DEEP * b):
        return False
    return nx * t0x + nz * t0z >= -1e-9 and nx * t1x + nz * t1z <= 1e-9


@kernel
def _core_contact(
    x: float,
    z: float,
    vx: float,
    vz: float,
    radius: float,
    gravity: float,
    start: float,
    end: float,
    tolerance: float,
    sx: FloatArray,
    sz: FloatArray,
    tx: FloatArray,
    tz: FloatArray,
    j: int,
    length: float,
) -> tuple[float, float, float, int]:
    """First contact of the round core of a rock with segment j or one of its vertices.

    Returns time, normal and the vertex that is met, -1 for the segment itself.
    """
    n = tx.size
    best, _ = contact_with_segment(
        x, z, vx, vz, 0.0, 0.0, radius, radius, gravity, start, end, tolerance,
        sx[j], sz[j], tx[j], tz[j], length,
    )  # fmt: skip
    nx = -tz[j]
    nz = tx[j]
    met = -1
    for k in range(max(j, 1), min(j + 1, n - 1) + 1):
        if tx[k - 1] * tz[k] - tz[k - 1] * tx[k] >= -1e-12:
            continue
        t, cnx, cnz = contact_with_vertex(
            x, z, vx, vz, 0.0, 0.0, radius, radius, gravity, start, min(end, best), tolerance,
            sx[k], sz[k], tx[k - 1], tz[k - 1], tx[k], tz[k],
        )  # fmt: skip
        if t < best:
            best = t
            nx = cnx
            nz = cnz
            met = k
    return best, nx, nz, met


@kernel
def next_contact(
    x: float,
    z: float,
    vx: float,
    vz: float,
    theta: float,
    omega: float,
    a: float,
    b: float,
    gravity: float,
    start: float,
    end: float,
    tolerance: float,
    sx: FloatArray,
    sz: FloatArray,
    tx: FloatArray,
    tz: FloatArray,
    near: int,
    skip_to: int,
) -> tuple[float, int, float, float]:
    """First contact of a flying rock with a profile.

    With gravity = omega = 0 it is the first contact of a rock that is moved in a straight line.

    Parameters
    ----------
    x, z, vx, vz, theta, omega : float
        State at time 0.
    a, b : float
        Semi-axes (m).
    gravity : float
        (m/s²).
    start, end : float
        Times between which to look (s).
    tolerance : float
        Gap at which rock and ground touch (m).
    sx, sz : float64, shape (n + 1,)
        Vertices of the profile (m).
    tx, tz : float64, shape (n,)
        Unit tangents of its segments.
    near : int
        A segment near the centre, to start looking from.
    skip_to : int
        Segments that the rock has just left, with the vertices behind them: up to and including
        ``skip_to`` if it moves to the right, from it on if it moves to the left; -1 for none. They
        can stop only its round core, of radius b.

    Returns
    -------
    t : float
        Infinite if there is none.
    segment : int
        -1 if there is none; at a vertex the segment on which the rock moves on. Of two contacts at
        the same time, the one approached faster.
    nx, nz : float
        Normal of the ground at the contact.
    """
    n = tx.size
    best = end
    found = -1
    best_nx = 0.0
    best_nz = 0.0
    best_speed = 0.0
    step = 1 if vx >= 0.0 else -1
    j = near
    if step > 0:
        edge = x + vx * start - a
        while j > 0 and sx[j] > edge:
            j -= 1
        while j < n - 1 and sx[j + 1] < edge:
            j += 1
    else:
        edge = x + vx * start + a
        while j < n - 1 and sx[j + 1] < edge:
            j += 1
        while j > 0 and sx[j] > edge:
            j -= 1
    # Contacts closer in time than this are at the same time.
    surface = abs(vx) + abs(vz) + abs(omega) * a
    same = (2.0 * tolerance + 1e-9 * a) / surface if surface > 0.0 else 0.0
    still = abs(vx) < 1e-9
    core = b - 2.0 * tolerance
    fresh = True
    while 0 <= j < n:
        # Of what the rock has just left, only its core can be stopped.
        left = skip_to >= 0 and (j <= skip_to if step > 0 else j >= skip_to)
        first = start
        last = best + same
        if still:
            if (step > 0 and sx[j] > x + a) or (step < 0 and sx[j + 1] < x - a):
                break
        elif step > 0:
            first = max(start, (sx[j] - a - x) / vx)
            last = min(last, (sx[j + 1] + a - x) / vx)
        else:
            first = max(start, (sx[j + 1] + a - x) / vx)
            last = min(last, (sx[j] - a - x) / vx)
        if first > best + same:
            break
        if last >= first:
            # Height over the segment's line is a concave parabola: least at an end of the span.
            nx = -tz[j]
            nz = tx[j]
            d0 = (x - sx[j]) * nx + (z - sz[j]) * nz
            rate = vx * nx + vz * nz
            fall = 0.5 * gravity * nz
            reach = a + tolerance
            at_first = d0 + (rate - fall * first) * first - reach
            if at_first > 0.0:
                at_last = -1.0
                if last < np.inf:
                    at_last = d0 + (rate - fall * last) * last - reach
                if at_last <= 0.0:
                    # Nothing can touch before the centre is within the longer axis of the line.
                    root = math.sqrt(max(rate * rate + 4.0 * fall * (d0 - reach), 0.0))
                    if root - rate > 0.0:
                        first = max(first, 2.0 * (d0 - reach) / (root - rate))
                else:
                    first = np.inf
            if first <= last:
                length = (sx[j + 1] - sx[j]) * tx[j] + (sz[j + 1] - sz[j]) * tz[j]
                t = np.inf
                deep = False
                if not left:
                    t, deep = contact_with_segment(
                        x, z, vx, vz, theta, omega, a, b, gravity, first, last, tolerance,
                        sx[j], sz[j], tx[j], tz[j], length,
                    )  # fmt: skip
                if t < np.inf:
                    # Of contacts at the same time, that from outside is the one.
                    speed = 0.0 if deep else -(rate - 2.0 * fall * t)
                    if found < 0 or t < best - same or speed > best_speed:
                        best = min(t, best)
                        found = j
                        best_nx = nx
                        best_nz = nz
                        best_speed = speed
                # Its vertices; the one behind has been looked at with the segment before.
                for k in range(j, j + 2):
                    if left or k == 0 or k == n or (not fresh and k == (j if step > 0 else j + 1)):
                        continue
                    if tx[k - 1] * tz[k] - tz[k - 1] * tx[k] >= -1e-12:
                        continue
                    from_t = first
                    to_t = min(last, best + same)
                    if still:
                        if abs(sx[k] - x) > a:
                            continue
                    elif step > 0:
                        from_t = max(from_t, (sx[k] - a - x) / vx)
                        to_t = min(to_t, (sx[k] + a - x) / vx)
                    else:
                        from_t = max(from_t, (sx[k] + a - x) / vx)
                        to_t = min(to_t, (sx[k] - a - x) / vx)
                    if from_t > to_t:
                        continue
                    t, cnx, cnz = contact_with_vertex(
                        x, z, vx, vz, theta, omega, a, b, gravity, from_t, to_t, tolerance,
                        sx[k], sz[k], tx[k - 1], tz[k - 1], tx[k], tz[k],
                    )  # fmt: skip
                    if t < np.inf:
                        speed = -(vx * cnx + (vz - gravity * t) * cnz)
                        if found < 0 or t < best - same or speed > best_speed:
                            best = min(t, best)
                            found = k if step > 0 else k - 1
                            best_nx = cnx
                            best_nz = cnz
                            best_speed = speed
                # The core of a rock whose flank reaches into the ground comes no nearer.
                to_t = min(last, best)
                at_end = d0 + (rate - fall * to_t) * to_t if to_t < np.inf else -1.0
                if at_end < core or d0 + (rate - fall * first) * first < core:
                    t, cnx, cnz, met = _core_contact(
                        x, z, vx, vz, core, gravity, first, to_t, tolerance, sx, sz, tx, tz, j,
                        length,
                    )  # fmt: skip
                    if t < best or (found < 0 and t <= best):
                        best = t
                        found = j
                        if met >= 0:
                            found = met if step > 0 else met - 1
                        best_nx = cnx
                        best_nz = cnz
                        best_speed = -(vx * cnx + (vz - gravity * t) * cnz)
        fresh = fresh and left
        j += step
    if found < 0:
        return np.inf, -1, 0.0, 0.0
    return best, found, best_nx, best_nz


@kernel
def resting_height(
    x: float,
    theta: float,
    a: float,
    b: float,
    sx: FloatArray,
    sz: FloatArray,
    tx: FloatArray,
    tz: FloatArray,
    near: int,
) -> float:
    """Height of the centre of an ellipse let down on the profile at chainage x (m).

    The largest of the heights at which it touches a segment within its ends, or a vertex.

    Parameters
    ----------
    x, theta, a, b : float
        Chainage (m), angle of the major axis (rad), semi-axes (m).
    sx, sz, tx, tz : float64 arrays
        The profile.
    near : int
        A segment near x, to start looking from.

    Returns
    -------
    float
        Minus infinity where there is no ground below.
    """
    ct = math.cos(theta)
    st = math.sin(theta)
    reach = math.sqrt(a * a * ct * ct + b * b * st * st)
    height = -np.inf
    n = tx.size
    first = near
    while first > 0 and sx[first] > x - a:
        first -= 1
    while first < n - 1 and sx[first + 1] < x - a:
        first += 1
    qa = st * st / (a * a) + ct * ct / (b * b)
    for j in range(first, n):
        if sx[j] > x + a:
            break
        nx = -tz[j]
        nz = tx[j]
        s = nx * ct + nz * st
        c = nz * ct - nx * st
        support = math.sqrt(a * a * s * s + b * b * c * c)
        lever = (a * a - b * b) * s * c / support
        z = sz[j] + (support - (x - sx[j]) * nx) / nz
        # Foot of the contact along the segment.
        foot = (x - sx[j]) * tx[j] + (z - sz[j]) * tz[j] - lever
        length = (sx[j + 1] - sx[j]) * tx[j] + (sz[j + 1] - sz[j]) * tz[j]
        if 0.0 <= foot <= length:
            height = max(height, z)
        for i in range(j, j + 2):
            dx = sx[i] - x
            if abs(dx) >= reach:
                continue
            qb = 2.0 * dx * st * ct * (1.0 / (a * a) - 1.0 / (b * b))
            qc = dx * dx * (ct * ct / (a * a) + st * st / (b * b)) - 1.0
            disc = qb * qb - 4.0 * qa * qc
            if disc >= 0.0:
                height = max(height, sz[i] + (qb + math.sqrt(disc)) / (2.0 * qa))
    return height
