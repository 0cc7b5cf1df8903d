"""Rows of points, angles, and geometry and inertia of the ellipse, in the plane of motion."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled.jit import fused, kernel, lean

#: A row of a structured array.
Record = Any
Records = NDArray[np.void]


class CountedRows(NamedTuple):
    """Rows of which only the first are valid: a followed path has room for more.

    Of profiles and stretches of cells the segments are counted: one more row ends the last of them.
    """

    rows: Records
    n: NDArray[np.int64]  # (1,) how many of them hold


def record_type(*fields: tuple[str, Any]) -> np.dtype[np.void]:
    """Return a structured dtype whose rows give their fields as attributes."""
    return np.dtype((np.record, list(fields)))


def empty_table(n: int, dtype: np.dtype[np.void]) -> CountedRows:
    """Make an empty table with room for ``n`` rows."""
    return CountedRows(np.zeros(n, dtype), np.zeros(1, np.int64))


@lean
def inertia(a: float, b: float) -> float:
    """Return the moment of inertia per unit mass normal to the plane, (a² + b²)/5 (m²)."""
    return 0.2 * (a * a + b * b)


@lean
def contact_frame(a: float, b: float, theta: float) -> tuple[float, float, float]:
    """Return the centre as seen from the point of contact, in local axes (m).

    Its distance x along the tangent and y along the outward normal, and the curvature: y is the
    support function of the ellipse, x its derivative and the curvature its second derivative.
    ``theta`` is the angle of the major axis, counter-clockwise from the tangent (rad).
    """
    return frame_of(a, b, math.sin(theta), math.cos(theta))


@lean
def frame_of(a: float, b: float, s: float, c: float) -> tuple[float, float, float]:
    """Compute contact_frame from the sine and cosine of the angle."""
    y = math.sqrt(a * a * s * s + b * b * c * c)
    x = (a * a - b * b) * s * c / y
    curvature = ((a * a - b * b) * (c * c - s * s) - x * x) / y
    return x, y, curvature


@kernel
def outlined(a: float, b: float, edges: float, share: float) -> tuple[float, float]:
    """Return the semi-axes of the ellipse that represents a block in the plane (m).

    It has the area of the ellipse of the longer axes a and b, and the ratio 1 + edges + share (a/b
    - 1). Our assumption: blocks with edges do not roll as discs even if these axes are equal, and
    elongated blocks turn about a moving axis, so that their sections in the plane are rounder.
    """
    if edges == 0.0 and share == 1.0:
        return a, b
    size, root = math.sqrt(a * b), math.sqrt(1.0 + edges + share * (a / b - 1.0))
    return size * root, size / root


@kernel
def mean_radius(a: float, b: float) -> float:
    """Return perimeter over 2π (m), by Ramanujan's second formula (1914); exact for a circle."""
    h = ((a - b) / (a + b)) ** 2
    return 0.5 * (a + b) * (1.0 + 3.0 * h / (10.0 + math.sqrt(4.0 - 3.0 * h)))


# Beyond this the reduction loses digits (rad).
_LARGEST = 1e5
_PER_QUARTER = 2.0 / math.pi
# Adding and taking away 1.5 · 2^52 rounds to a whole number.
_ROUNDS = 6755399441055744.0
# π/2 in three parts, of which the first two have few digits, so that multiples of them are exact.
_QUARTER_1 = 1.57079625129699707031
_QUARTER_2 = 7.54978941586159635335e-8
_QUARTER_3 = 5.39030285815811905290e-15


@fused
def cos_sin(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle (rad) together.

    Reduction by multiples of π/2 in three parts (Cody and Waite 1980) and the polynomials of fdlibm
    (k_sin.c, k_cos.c; Sun Microsystems 1993): within 2.3e-16 of the exact values.
    """
    if not abs(angle) < _LARGEST:
        return math.cos(angle), math.sin(angle)
    quarters = (angle * _PER_QUARTER + _ROUNDS) - _ROUNDS
    r = ((angle - quarters * _QUARTER_1) - quarters * _QUARTER_2) - quarters * _QUARTER_3
    z = r * r
    w = z * z
    low = -1.66666666666666324348e-01 + z * 8.33333333332248946124e-03
    middle = -1.98412698298579493134e-04 + z * 2.75573137070700676789e-06
    top = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    s = r + r * z * (low + w * (middle + w * top))
    low = 4.16666666666666019037e-02 - z * 1.38888888888741095749e-03
    middle = 2.48015872894767294178e-05 - z * 2.75573143513906633035e-07
    top = 2.08757232129817482790e-09 - z * 1.13596475577881948265e-11
    c = 1.0 - (0.5 * z - w * (low + w * (middle + w * top)))
    quadrant = int(quarters) & 3
    if quadrant & 1:
        c, s = -s, c
    if quadrant & 2:
        c, s = -c, -s
    return c, s
