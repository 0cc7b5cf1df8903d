"""When and where a turning ellipse first touches the ground.

The gap between ellipse and a closed segment is measured along the direction that separates them
best: the segment's normal, or at an end vertex the normal of the ellipse scaled up until it meets
the vertex. Along a fixed direction n the gap is

    g(t) = (C(t) − V)·n − y(θ(t)),    y the support function of the ellipse,

and since y'' <= (a² − b²)/b the quadratic with g, g' and g'' >= −(gravity·n_z + ω²(a² − b²)/b)
bounds it from below. Stepping to the root of that bound can never pass the first contact, however
fast the rock or short the segment, and converges quadratically. A new direction is taken at
each step.

A contact counts while the *centre* approaches the ground there: the paper's angle of incidence
lies between 0 and 90 degrees (Fig. 9). Just after an impact the flank of the turning rock may reach
into the ground while its centre rises; no impact is made of that.
"""

from __future__ import annotations

import math

import numpy as np

from sassgis.core.jit import kernel

_MAX_STEPS = 200


@kernel
def separation(x, z, cos_t, sin_t, a, b, vx0, vz0, vx1, vz1, tx, tz):
    """Direction of least penetration between an ellipse and a closed segment.

    Parameters
    ----------
    x, z : float
        Centre (m).
    cos_t, sin_t : float
        Direction of the major axis.
    a, b : float
        Semi-axes (m).
    vx0, vz0, vx1, vz1 : float
        Ends of the segment (m).
    tx, tz : float
        Its unit tangent.

    Returns
    -------
    gap : float
        Along the direction (m), negative when they overlap.
    nx, nz : float
        The direction, from the ground to the rock.
    lever : float
        Tangential distance of the centre from the point of contact (m).
    """
    # Both ends in the frame of the ellipse, scaled so that the ellipse is the unit circle.
    dx = vx0 - x
    dz = vz0 - z
    p1 = (dx * cos_t + dz * sin_t) / a
    p2 = (dz * cos_t - dx * sin_t) / b
    dx = vx1 - x
    dz = vz1 - z
    q1 = (dx * cos_t + dz * sin_t) / a
    q2 = (dz * cos_t - dx * sin_t) / b
    e1 = q1 - p1
    e2 = q2 - p2
    along = -(p1 * e1 + p2 * e2)
    whole = e1 * e1 + e2 * e2
    if 0.0 < along < whole:
        nx = -tz
        nz = tx
        px = vx0
        pz = vz0
    else:
        if along <= 0.0:
            px = vx0
            pz = vz0
        else:
            p1 = q1
            p2 = q2
            px = vx1
            pz = vz1
        n1 = -p1 / a
        n2 = -p2 / b
        size = math.sqrt(n1 * n1 + n2 * n2)
        if size > 0.0:
            n1 /= size
            n2 /= size
            nx = n1 * cos_t - n2 * sin_t
            nz = n1 * sin_t + n2 * cos_t
        else:
            nx = -tz
            nz = tx
    s = nx * cos_t + nz * sin_t
    c = nz * cos_t - nx * sin_t
    support = math.sqrt(a * a * s * s + b * b * c * c)
    lever = (a * a - b * b) * s * c / support
    return (x - px) * nx + (z - pz) * nz - support, nx, nz, lever


@kernel
def contact_with_line(
    x, z, vx, vz, theta, omega, a, b, gravity, start, end, tolerance, bend, px, pz, tx, tz
):
    """First time in [start, end] at which a flying rock touches a line through (px, pz).

    ``bend`` bounds the second derivative of the support function in time (m/s²). The time is
    infinite if there is no contact.
    """
    difference = a * a - b * b
    above = (z - pz) * tx - (x - px) * tz
    rise = vz * tx - vx * tz
    down = gravity * tx
    bound = down + bend
    t = start
    for _ in range(_MAX_STEPS):
        approach = rise - down * t
        if approach >= -1e-12:
            if down <= 0.0:
                return np.inf
            t += max(approach, 0.0) / down + 1e-9
        else:
            angle = theta - omega * t
            ct = math.cos(angle)
            st = math.sin(angle)
            s = tx * st - tz * ct
            c = tx * ct + tz * st
            support = math.sqrt(b * b + difference * s * s)
            gap = above + (rise - 0.5 * down * t) * t - support
            if gap <= tolerance:
                return t
            rate = approach + difference * s * c / support * omega
            root = math.sqrt(rate * rate + 2.0 * bound * gap)
            if rate < 0.0:
                t += 2.0 * gap / (root - rate)
            elif bound > 0.0:
                t += (rate + root) / bound
            else:
                return np.inf
        if t > end:
            return np.inf
    return t


@kernel
def contact_with_segment(
    x, z, vx, vz, theta, omega, a, b, gravity, start, end, tolerance, vx0, vz0, vx1, vz1, tx, tz
):
    """First time in [start, end] at which a flying rock touches one closed segment.

    Returns
    -------
    t : float
        Infinite if there is no contact.
    nx, nz : float
        Normal of the ground there.
    """
    bend = (a * a - b * b) / b * omega * omega
    t = start
    # The line of the segment is met no later than the segment, and at less cost.
    t = contact_with_line(
        x, z, vx, vz, theta, omega, a, b, gravity, start, end, tolerance, bend, vx0, vz0, tx, tz
    )
    for _ in range(_MAX_STEPS):
        if t > end:
            return np.inf, 0.0, 0.0
        angle = theta - omega * t
        ct = math.cos(angle)
        st = math.sin(angle)
        cx = x + vx * t
        cz = z + (vz - 0.5 * gravity * t) * t
        wz = vz - gravity * t
        gap, nx, nz, lever = separation(cx, cz, ct, st, a, b, vx0, vz0, vx1, vz1, tx, tz)
        approach = vx * nx + wz * nz
        down = gravity * max(nz, 0.0)
        if approach >= -1e-12:
            # The centre recedes: nothing counts before gravity has turned it round.
            if down <= 0.0:
                return np.inf, 0.0, 0.0
            t += max(approach, 0.0) / down + 1e-9
        elif gap <= tolerance:
            return t, nx, nz
        else:
            rate = approach + lever * omega
            bound = down + bend
            root = math.sqrt(rate * rate + 2.0 * bound * gap)
            if rate < 0.0:
                t += 2.0 * gap / (root - rate)
            elif bound > 0.0:
                t += (rate + root) / bound
            else:
                return np.inf, 0.0, 0.0
    return t, nx, nz


@kernel
def next_contact(
    x, z, vx, vz, theta, omega, a, b, gravity, start, end, tolerance, sx, sz, tx, tz, near, skip_to
):
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
        Segments that cannot be met: up to and including ``skip_to`` for a rock that moves to the
        right, from it on for one that moves to the left; -1 for none.

    Returns
    -------
    t : float
        Infinite if there is none.
    segment : int
        -1 if there is none. Of two contacts at the same time, the one approached faster.
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
        if skip_to >= 0 and j <= skip_to:
            j = skip_to + 1
    else:
        edge = x + vx * start + a
        while j < n - 1 and sx[j + 1] < edge:
            j += 1
        while j > 0 and sx[j] > edge:
            j -= 1
        if skip_to >= 0 and j >= skip_to:
            j = skip_to - 1
    still = abs(vx) < 1e-9
    while 0 <= j < n:
        first = start
        last = best
        if still:
            if (step > 0 and sx[j] > x + a) or (step < 0 and sx[j + 1] < x - a):
                break
        elif step > 0:
            first = max(start, (sx[j] - a - x) / vx)
            last = min(best, (sx[j + 1] + a - x) / vx)
        else:
            first = max(start, (sx[j + 1] + a - x) / vx)
            last = min(best, (sx[j] - a - x) / vx)
        if first > best:
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
                t, cnx, cnz = contact_with_segment(
                    x, z, vx, vz, theta, omega, a, b, gravity, first, last, tolerance,
                    sx[j], sz[j], sx[j + 1], sz[j + 1], tx[j], tz[j],
                )  # fmt: skip
                if t < np.inf:
                    speed = -(vx * cnx + (vz - gravity * t) * cnz)
                    if t < best - 1e-12 or found < 0 or speed > best_speed:
                        best = min(t, best)
                        found = j
                        best_nx = cnx
                        best_nz = cnz
                        best_speed = speed
        j += step
    if found < 0:
        return np.inf, -1, 0.0, 0.0
    return best, found, best_nx, best_nz


@kernel
def resting_height(x, theta, a, b, sx, sz, tx, tz):
    """Height of the centre of an ellipse let down on the profile at chainage x (m).

    The largest of the heights at which it touches a segment within its ends, or a vertex.
    """
    ct = math.cos(theta)
    st = math.sin(theta)
    reach = math.sqrt(a * a * ct * ct + b * b * st * st)
    height = -np.inf
    n = tx.size
    for j in range(n):
        if sx[j] > x + a or sx[j + 1] < x - a:
            continue
        nx = -tz[j]
        nz = tx[j]
        s = nx * ct + nz * st
        c = nz * ct - nx * st
        support = math.sqrt(a * a * s * s + b * b * c * c)
        lever = (a * a - b * b) * s * c / support
        z = sz[j] + (support - (x - sx[j]) * nx) / nz
        # Foot of the contact along the segment.
        foot = (x - sx[j]) * tx[j] + (z - sz[j]) * tz[j] - lever
        length = math.hypot(sx[j + 1] - sx[j], sz[j + 1] - sz[j])
        if 0.0 <= foot <= length:
            height = max(height, z)
    for i in range(n + 1):
        dx = sx[i] - x
        if abs(dx) >= reach:
            continue
        qa = st * st / (a * a) + ct * ct / (b * b)
        qb = 2.0 * dx * st * ct * (1.0 / (a * a) - 1.0 / (b * b))
        qc = dx * dx * (ct * ct / (a * a) + st * st / (b * b)) - 1.0
        disc = qb * qb - 4.0 * qa * qc
        if disc >= 0.0:
            height = max(height, sz[i] + (qb + math.sqrt(disc)) / (2.0 * qa))
    return height
