"""Geometry and inertia of the ellipse in the plane of motion."""

from __future__ import annotations

import math

from sassgis.model.jit import kernel, lean


@lean
def inertia(a: float, b: float) -> float:
    """Moment of inertia per unit mass about the axis normal to the plane (m²): (a² + b²)/5."""
    return 0.2 * (a * a + b * b)


@lean
def contact_frame(a: float, b: float, theta: float) -> tuple[float, float, float]:
    """Centre as seen from the point of contact, in local axes.

    Parameters
    ----------
    a, b : float
        Semi-axes in the plane, a >= b (m).
    theta : float
        Angle of the major axis, counter-clockwise from the local tangent (rad).

    Returns
    -------
    x, y : float
        Along the tangent and along the outward normal (m). y is the support function of the ellipse
        and x its derivative.
    curvature : float
        Second derivative of y (m).
    """
    return frame_of(a, b, math.sin(theta), math.cos(theta))


@lean
def frame_of(a: float, b: float, s: float, c: float) -> tuple[float, float, float]:
    """As contact_frame, from the sine and cosine of the angle."""
    y = math.sqrt(a * a * s * s + b * b * c * c)
    x = (a * a - b * b) * s * c / y
    curvature = ((a * a - b * b) * (c * c - s * s) - x * x) / y
    return x, y, curvature


@kernel
def mean_radius(a: float, b: float) -> float:
    """Perimeter over 2π (m), by Ramanujan's second formula (1914); exact for a circle."""
    h = ((a - b) / (a + b)) ** 2
    return 0.5 * (a + b) * (1.0 + 3.0 * h / (10.0 + math.sqrt(4.0 - 3.0 * h)))
