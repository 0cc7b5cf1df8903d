"""A slow reference for the first contact of a flying ellipse with a profile.

The ground is the closed polyline. In the frame of the ellipse, scaled so that it is the unit
circle, the distance of the origin from a segment tells whether they overlap; that needs no support
function and no bound. Time is stepped finely, then halved down to the contact. Compiled only to
make the fine steps affordable.
"""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit
def overlap(t, seg, rock, g):
    """Scaled distance less 1 (negative: overlap) at time t, and the speed of the centre along the
    normal of the ellipse scaled up until it meets the segment (negative: approach).
    """
    x, z, vx, vz, theta, omega, a, b = rock
    x0, z0, x1, z1 = seg
    cx = x + vx * t
    cz = z + vz * t - 0.5 * g * t * t
    c = math.cos(theta - omega * t)
    s = math.sin(theta - omega * t)
    p1 = ((x0 - cx) * c + (z0 - cz) * s) / a
    p2 = (-(x0 - cx) * s + (z0 - cz) * c) / b
    e1 = ((x1 - x0) * c + (z1 - z0) * s) / a
    e2 = (-(x1 - x0) * s + (z1 - z0) * c) / b
    along = -(p1 * e1 + p2 * e2) / (e1 * e1 + e2 * e2)
    along = min(max(along, 0.0), 1.0)
    p1 += along * e1
    p2 += along * e2
    n1 = -p1 / a
    n2 = -p2 / b
    nx = n1 * c - n2 * s
    nz = n1 * s + n2 * c
    size = max(math.hypot(nx, nz), 1e-300)
    return math.hypot(p1, p2) - 1.0, (vx * nx + (vz - g * t) * nz) / size


@numba.njit
def _counts(t, seg, rock, g):
    gap, speed = overlap(t, seg, rock, g)
    return gap <= 0.0 and speed < 0.0


@numba.njit
def first_contact(rock, g, sx, sz, until, dt=2e-5):
    """First time at which a segment is touched while the centre approaches it.

    Returns (t, segment); (inf, -1) if there is none before ``until``.
    """
    x, z, vx, vz, _theta, _omega, a, _b = rock
    best = until
    found = -1
    slab = 1e-3
    n_slabs = math.ceil(until / slab)
    fastest = math.hypot(vx, abs(vz) + g * until)
    for j in range(sx.size - 1):
        seg = (sx[j], sz[j], sx[j + 1], sz[j + 1])
        ex = seg[2] - seg[0]
        ez = seg[3] - seg[1]
        for k in range(n_slabs):
            t0 = k * slab
            if t0 >= best:
                break
            # Far from the segment for the whole slab: nothing to look at.
            cx = x + vx * t0 - seg[0]
            cz = z + vz * t0 - 0.5 * g * t0 * t0 - seg[1]
            share = min(max((cx * ex + cz * ez) / (ex * ex + ez * ez), 0.0), 1.0)
            if math.hypot(cx - share * ex, cz - share * ez) > a + slab * fastest:
                continue
            steps = math.ceil(slab / dt)
            done = False
            for i in range(steps + 1):
                t = min(t0 + i * dt, until)
                if _counts(t, seg, rock, g):
                    low = max(t - dt, 0.0)
                    high = t
                    for _ in range(60):
                        mid = 0.5 * (low + high)
                        if _counts(mid, seg, rock, g):
                            high = mid
                        else:
                            low = mid
                    if high < best or found < 0:
                        best = high
                        found = j
                    done = True
                    break
            if done:
                break
    if found < 0:
        return np.inf, -1
    return best, found


def tangents(sx, sz):
    """Unit tangents of the segments."""
    length = np.hypot(np.diff(sx), np.diff(sz))
    return np.diff(sx) / length, np.diff(sz) / length
