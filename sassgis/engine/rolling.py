"""How far a rolling rock rolls before something else begins."""

from __future__ import annotations

import math

from sassgis.core.jit import kernel

# What ends a stretch; 0 (end of the segment) and 1 (stop) come from the caller.
TO_SLIDING, LIFT_OFF = 2, 3


@kernel
def lift_off_speed(a, b, inertia, roll_radius, gravity, cos_slope):
    """Rolling speed above which an ellipse leaves the ground as it stands upright (m/s).

    Upright, the normal force is g cos β − ω² (a² − b²)/a. The spin there follows from the rolling
    energy less what lifts the centre from the mean radius to a.
    """
    spin2 = gravity * cos_slope * a / (a * a - b * b)
    energy = 0.5 * spin2 * (inertia + a * a) + gravity * cos_slope * (a - roll_radius)
    return math.sqrt(2.0 * energy / (1.0 + inertia / (roll_radius * roll_radius)))


@kernel
def rolling_stretch(
    a, b, inertia, roll_radius, theta, way, v, pull, gravity, cos_slope, length, what, lift_off,
    end_sliding,
):  # fmt: skip
    """Distance that a rock rolls until the segment ends, it stops, slides or lifts off.

    Parameters
    ----------
    theta : float
        Angle of the major axis to the segment (rad).
    way : int
        1 to the right, -1 to the left.
    v, pull : float
        Speed (m/s) and acceleration (m/s²) along the way.
    length, what
        Distance to, and kind of, what ends the stretch otherwise.
    lift_off, end_sliding : bool
        Which of the two may end it.

    Returns
    -------
    length : float
        (m)
    what : int
    """
    share = 1.0 + inertia / (roll_radius * roll_radius)
    if end_sliding and pull < 0.0:
        # Too slow to lift its centre over the longer axis.
        least = 2.0 * gravity * cos_slope * (a - roll_radius) / share
        reach = max((least - v * v) / (2.0 * pull), 0.0)
        if reach < length:
            length = reach
            what = TO_SLIDING
    if lift_off:
        least = lift_off_speed(a, b, inertia, roll_radius, gravity, cos_slope)
        to_upright = (way * (theta - 0.5 * math.pi)) % math.pi
        if to_upright < 1e-6:
            to_upright += math.pi
        first = roll_radius * to_upright
        gap = least * least - v * v
        if pull > 0.0 and gap > 0.0:
            late = gap / (2.0 * pull) - first
            if late > 0.0:
                first += math.ceil(late / (math.pi * roll_radius)) * math.pi * roll_radius
        if first < length and v * v + 2.0 * pull * first >= least * least * (1.0 + 1e-12):
            length = first
            what = LIFT_OFF
    return length, what
