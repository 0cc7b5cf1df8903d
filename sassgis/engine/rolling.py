"""How far a rolling rock rolls before something else begins."""

from __future__ import annotations

import math

from sassgis.engine.ellipse import frame_of
from sassgis.engine.impact import normal_force
from sassgis.model.jit import kernel

# What ends a stretch of rolling or sliding. Only TO_SLIDING and LIFT_OFF are found here; PART is a
# stretch that an effect has cut, after which the motion goes on.
SEGMENT_END, STOP, TO_SLIDING, LIFT_OFF, GROUND_AHEAD, PROFILE_END, PART = range(7)

_WIDEST = 1.5
_SCANS = 24
_BISECTIONS = 40


@kernel
def lift_off_speed(
    a: float, b: float, inertia: float, roll_radius: float, gravity: float, cos_slope: float
) -> float:
    """Rolling speed above which an ellipse leaves the ground before it stands upright (m/s).

    Upright, the normal force is g cos β − ω² (a² − b²)/a. The spin there follows from the rolling
    energy less what lifts the centre from the mean radius to a.
    """
    spin2 = gravity * cos_slope * a / (a * a - b * b)
    energy = 0.5 * spin2 * (inertia + a * a) + gravity * cos_slope * (a - roll_radius)
    return math.sqrt(2.0 * energy / (1.0 + inertia / (roll_radius * roll_radius)))


@kernel
def rolling_spin(
    a: float,
    b: float,
    inertia: float,
    roll_radius: float,
    v: float,
    angle: float,
    gravity: float,
    cos_slope: float,
) -> float:
    """Spin of the rolling ellipse ``angle`` before it stands upright (rad/s).

    Its kinetic energy is that of steady rolling at the mean radius with speed v, less what has
    lifted its centre above that. 0 where the energy does not suffice.
    """
    x, y, _ = frame_of(a, b, math.cos(angle), -math.sin(angle))
    share = 1.0 + inertia / (roll_radius * roll_radius)
    energy = 0.5 * share * v * v - gravity * cos_slope * (y - roll_radius)
    return math.sqrt(max(2.0 * energy / (inertia + x * x + y * y), 0.0))


@kernel
def lift_off_angle(
    a: float,
    b: float,
    inertia: float,
    roll_radius: float,
    v: float,
    pull: float,
    first: float,
    gravity: float,
    cos_slope: float,
    down: float,
) -> float:
    """How long before it stands upright a rolling ellipse leaves the ground (rad).

    Parameters
    ----------
    v, pull : float
        Speed (m/s) and acceleration (m/s²) along the way.
    first : float
        Distance to where it would stand upright (m).
    down : float
        Sine of the slope, positive if the way descends.

    Returns
    -------
    float
        The largest angle before the upright at which the normal force ends, 0 if only there.
    """

    def force(angle: float) -> float:
        here = math.sqrt(max(v * v + 2.0 * pull * (first - roll_radius * angle), 0.0))
        spin = rolling_spin(a, b, inertia, roll_radius, here, angle, gravity, cos_slope)
        x, y, curvature = frame_of(a, b, math.cos(angle), -math.sin(angle))
        return normal_force(x, y, curvature, inertia, spin, cos_slope, down, gravity)

    widest = min(_WIDEST, first / roll_radius)
    if force(widest) <= 0.0:
        return widest
    high = widest
    low = 0.0
    for i in range(1, _SCANS):
        angle = widest * (1.0 - i / _SCANS)
        if force(angle) <= 0.0:
            low = angle
            break
        high = angle
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if force(middle) <= 0.0:
            low = middle
        else:
            high = middle
    return low


@kernel
def rolling_stretch(
    a: float,
    b: float,
    inertia: float,
    roll_radius: float,
    theta: float,
    way: int,
    v: float,
    pull: float,
    gravity: float,
    cos_slope: float,
    down: float,
    length: float,
    what: int,
    as_ellipse: bool,
    end_sliding: bool,
) -> tuple[float, int, float]:
    """Distance that a rock rolls until the segment ends, it stops, slides or lifts off.

    Parameters
    ----------
    theta : float
        Angle of the major axis to the segment (rad).
    way : int
        1 to the right, -1 to the left.
    v, pull : float
        Speed (m/s) and acceleration (m/s²) along the way.
    cos_slope, down : float
        Cosine of the slope; its sine, positive if the way descends.
    length, what
        Distance to, and kind of, what ends the stretch otherwise.
    as_ellipse, end_sliding : bool
        Whether the ellipse may lift off, and whether it may end by sliding.

    Returns
    -------
    length : float
        (m)
    what : int
    angle : float
        With LIFT_OFF, how long before it stands upright (rad).
    """
    share = 1.0 + inertia / (roll_radius * roll_radius)
    angle = 0.0
    if end_sliding and pull < 0.0:
        # Too slow to lift its centre over the longer axis.
        least = 2.0 * gravity * cos_slope * (a - roll_radius) / share
        reach = max((least - v * v) / (2.0 * pull), 0.0)
        if reach < length:
            length = reach
            what = TO_SLIDING
    if as_ellipse:
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
        if v * v + 2.0 * pull * first >= least * least * (1.0 + 1e-12):
            early = lift_off_angle(
                a, b, inertia, roll_radius, v, pull, first, gravity, cos_slope, down
            )
            if first - roll_radius * early < length:
                length = max(first - roll_radius * early, 0.0)
                what = LIFT_OFF
                angle = early
    return length, what, angle
