"""How far a rolling block rolls before something else begins."""

from __future__ import annotations

import math

from sassgis.engine.ellipse import frame_of
from sassgis.engine.impact import normal_force
from sassgis.engine.state import Block
from sassgis.model.jit import kernel

# What ends a stretch of rolling or sliding. Only TO_SLIDING and LIFT_OFF are found here; PART is a
# stretch that an effect has cut, after which the motion goes on, TO_ROLLING one of sliding after
# which the block tips over.
SEGMENT_END, STOP, TO_SLIDING, LIFT_OFF, GROUND_AHEAD, PROFILE_END, PART = 0, 1, 2, 3, 4, 5, 6
TO_ROLLING = 7

_WIDEST = 1.5
_SCANS = 24
# The angle at which a block lifts off is found to this (rad), in so many steps at most.
_ANGLE = 1e-10
_MOST_STEPS = 60


@kernel
def rolling_friction(mu_0: float, k: float, d_star: float, radius: float) -> float:
    """μ_r = μ_0 + k d*/d, equation (2); d is the diameter of the block."""
    return mu_0 + k * d_star / (2.0 * radius)


@kernel
def lift_off_speed(block: Block, gravity: float, cos_slope: float) -> float:
    """Rolling speed above which an ellipse leaves the ground before it stands upright (m/s).

    Upright, the normal force is g cos β − ω² (a² − b²)/a. The spin there follows from the rolling
    energy less what lifts the centre from the mean radius to a.
    """
    a, b = block.a, block.b
    spin2 = gravity * cos_slope * a / (a * a - b * b)
    energy = 0.5 * spin2 * (block.inertia + a * a) + gravity * cos_slope * (a - block.roll_radius)
    return math.sqrt(2.0 * energy / block.roll_share)


@kernel
def rolling_spin(block: Block, v: float, angle: float, gravity: float, cos_slope: float) -> float:
    """Spin of the rolling ellipse ``angle`` before it stands upright (rad/s).

    Its kinetic energy is that of steady rolling at the mean radius with speed v, less what has
    lifted its centre above that. 0 where the energy does not suffice.
    """
    x, y, _ = frame_of(block.a, block.b, math.cos(angle), -math.sin(angle))
    energy = 0.5 * block.roll_share * v * v - gravity * cos_slope * (y - block.roll_radius)
    return math.sqrt(max(2.0 * energy / (block.inertia + x * x + y * y), 0.0))


@kernel
def _force_before_upright(
    block: Block,
    v: float,
    pull: float,
    first: float,
    gravity: float,
    cos_slope: float,
    down: float,
    angle: float,
) -> float:
    """Normal force per unit mass ``angle`` before the ellipse stands upright (m/s²)."""
    here = math.sqrt(max(v * v + 2.0 * pull * (first - block.roll_radius * angle), 0.0))
    spin = rolling_spin(block, here, angle, gravity, cos_slope)
    x, y, curvature = frame_of(block.a, block.b, math.cos(angle), -math.sin(angle))
    return normal_force(x, y, curvature, block.inertia, spin, cos_slope, down, gravity)


@kernel
def lift_off_angle(
    block: Block,
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
        Speed (m/s) and acceleration (m/s²) along the path.
    first : float
        Distance to where it would stand upright (m).
    down : float
        Sine of the slope, positive if the path descends.

    Returns
    -------
    float
        The largest angle before the upright at which the normal force ends, 0 if only there.
    """
    high = min(_WIDEST, first / block.roll_radius)
    at_high = _force_before_upright(block, v, pull, first, gravity, cos_slope, down, high)
    if at_high <= 0.0:
        return high
    low = 0.0
    at_low = _force_before_upright(block, v, pull, first, gravity, cos_slope, down, low)
    if at_low > 0.0:
        # It barely reaches the speed: the force may have ended and come back.
        for i in range(1, _SCANS):
            angle = high * (1.0 - i / _SCANS)
            found = _force_before_upright(block, v, pull, first, gravity, cos_slope, down, angle)
            if found <= 0.0:
                low, at_low = angle, found
                break
        if at_low > 0.0:
            return 0.0
    # False position after Dowell and Jarratt (1971, "Illinois"), which keeps the bracket.
    side = 0
    for _ in range(_MOST_STEPS):
        if high - low < _ANGLE:
            break
        angle = low + (high - low) * at_low / (at_low - at_high)
        # Where the ends differ much in size the step must not stall at one of them.
        angle = min(max(angle, low + 0.25 * _ANGLE), high - 0.25 * _ANGLE)
        found = _force_before_upright(block, v, pull, first, gravity, cos_slope, down, angle)
        if found <= 0.0:
            if side < 0:
                at_high *= 0.5
            low, at_low, side = angle, found, -1
        else:
            if side > 0:
                at_low *= 0.5
            high, at_high, side = angle, found, 1
    return low


@kernel
def rolling_stretch(
    block: Block,
    theta: float,
    direction: int,
    v: float,
    pull: float,
    gravity: float,
    cos_slope: float,
    down: float,
    length: float,
    ends_by: int,
    as_ellipse: bool,
    end_sliding: bool,
) -> tuple[float, int, float]:
    """Distance that a block rolls until the segment ends, it stops, slides or lifts off.

    Parameters
    ----------
    theta : float
        Angle of the major axis to the segment (rad).
    direction : int
        1 to the right, -1 to the left.
    v, pull : float
        Speed (m/s) and acceleration (m/s²) along the path.
    cos_slope, down : float
        Cosine of the slope; its sine, positive if the path descends.
    length, ends_by
        Distance to, and kind of, what ends the stretch otherwise.
    as_ellipse, end_sliding : bool
        Whether the ellipse may lift off, and whether it may end by sliding.

    Returns
    -------
    length : float
        (m)
    ends_by : int
    angle : float
        With LIFT_OFF, how long before it stands upright (rad).
    """
    a, roll_radius = block.a, block.roll_radius
    angle = 0.0
    if end_sliding and pull < 0.0:
        # Too slow to lift its centre over the longer axis.
        least = 2.0 * gravity * cos_slope * (a - roll_radius) / block.roll_share
        reach = max((least - v * v) / (2.0 * pull), 0.0)
        if reach < length:
            length = reach
            ends_by = TO_SLIDING
    if as_ellipse:
        least = lift_off_speed(block, gravity, cos_slope)
        to_upright = (direction * (theta - 0.5 * math.pi)) % math.pi
        if to_upright < 1e-6:
            to_upright += math.pi
        first = roll_radius * to_upright
        gap = least * least - v * v
        if pull > 0.0 and gap > 0.0:
            late = gap / (2.0 * pull) - first
            if late > 0.0:
                first += math.ceil(late / (math.pi * roll_radius)) * math.pi * roll_radius
        if v * v + 2.0 * pull * first >= least * least * (1.0 + 1e-12):
            early = lift_off_angle(block, v, pull, first, gravity, cos_slope, down)
            if first - roll_radius * early < length:
                length = max(first - roll_radius * early, 0.0)
                ends_by = LIFT_OFF
                angle = early
    return length, ends_by, angle
