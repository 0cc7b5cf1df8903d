"""How far a rolling block rolls before something else begins."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sassgis.compiled.jit import inlined, lean
from sassgis.engine.ellipse import Record, cos_sin
from sassgis.engine.impact import RESTITUTION
from sassgis.engine.resistance import gained, path_to
from sassgis.engine.state import Block, Physics

# What ends a stretch of rolling or sliding. TO_SLIDING and LIFT_OFF are computed here; PART is a
# stretch that an effect has cut, after which the motion goes on, TO_ROLLING one of sliding after
# which the block tips over.
SEGMENT_END, STOP, TO_SLIDING, LIFT_OFF, GROUND_AHEAD, PROFILE_END, PART = 0, 1, 2, 3, 4, 5, 6
TO_ROLLING = 7

_WIDEST = 1.5
_SCANS = 24
# The angle at which a block lifts off is computed to this (rad), in so many steps at most.
_ANGLE = 1e-8
_MOST_STEPS = 60


@lean
def rolling_friction(block: Block, ground: Record) -> float:
    """Return μ_r = μ_0 + k d*/d, equation (2), times the factor of the block; d is its diameter."""
    return float(block.drag * (ground.mu_0 + ground.k * ground.d_star_m / (2.0 * block.radius)))


@inlined
def growth(block: Block, ground: Record, physics: Physics) -> float:
    """Return μ_v/(g d) times the factor of the block, the resistance by v² (s²/m²)."""
    if physics.eta_rule != RESTITUTION:
        return 0.0
    return float(block.drag * ground.mu_v / (2.0 * block.radius * physics.gravity))


class Way(NamedTuple):
    """How a block rolls to where its ellipse would stand upright."""

    v: float  # speed (m/s)
    pull: float  # acceleration (m/s²)
    fade: float  # how that falls (1/m): resistance.py
    first: float  # distance to where it would stand upright (m)
    weight: float  # normal force at rest per unit mass (m/s²)
    push: float  # weight along the way, positive if it descends


@lean
def lift_off_speed(block: Block, gravity: float, cos_slope: float) -> float:
    """Return rolling speed above which an ellipse leaves the ground before it stands upright (m/s).

    Upright, the normal force is g cos β − ω² (a² − b²)/a. The spin there follows from the rolling
    energy less what lifts the centre from the mean radius to a.
    """
    a, b = block.a, block.b
    spin2 = gravity * cos_slope * a / (a * a - b * b)
    energy = 0.5 * spin2 * (block.inertia + a * a) + gravity * cos_slope * (a - block.roll_radius)
    return math.sqrt(2.0 * energy / block.roll_share)


@lean
def _force_before_upright(block: Block, way: Way, angle: float) -> tuple[float, float]:
    """Compute the normal force per unit mass (m/s²) and its rate ``angle`` before the upright.

    Its kinetic energy is that of steady rolling at the mean radius, less what has lifted its centre
    above that; the force is impact.normal_force.
    """
    c, s = cos_sin(angle)
    radius = block.roll_radius
    weight = way.weight
    # The frame of ellipse.frame_of, whose derivatives are: y' = x, x' = curvature.
    shape = block.a * block.a - block.b * block.b
    y = math.sqrt(block.a * block.a - shape * s * s)
    x = -shape * c * s / y
    curvature = (shape * (s * s - c * c) - x * x) / y
    curvature_rate = -x * (4.0 + 3.0 * curvature / y)
    per_inertia = 1.0 / (block.inertia + x * x + y * y)
    inertia_rate = 2.0 * x * (curvature + y)
    spin2 = 0.0
    spin2_rate = 0.0
    path = way.first - radius * angle
    speed2 = way.v * way.v + gained(way.pull, way.fade, path)
    twice = block.roll_share * max(speed2, 0.0) - 2.0 * weight * (y - radius)
    if twice > 0.0:
        spin2 = twice * per_inertia
        twice_rate = -2.0 * weight * x
        if speed2 > 0.0:
            pull = way.pull * math.exp(-2.0 * way.fade * path)
            twice_rate -= 2.0 * block.roll_share * radius * pull
        spin2_rate = (twice_rate - spin2 * inertia_rate) * per_inertia
    moment = way.push * y + weight * x + spin2 * x * (y + curvature)
    moment_rate = (
        way.push * x
        + weight * curvature
        + spin2_rate * x * (y + curvature)
        + spin2 * (curvature * (y + curvature) + x * (x + curvature_rate))
    )
    turn = moment * per_inertia
    turn_rate = (moment_rate - turn * inertia_rate) * per_inertia
    force = weight + curvature * spin2 - x * turn
    rate = curvature_rate * spin2 + curvature * spin2_rate - curvature * turn - x * turn_rate
    return force, rate


@lean
def lift_off_angle(block: Block, way: Way) -> float:
    """Return the angle before the upright at which a rolling ellipse leaves the ground (rad)."""
    high = min(_WIDEST, way.first / block.roll_radius)
    at_high, _ = _force_before_upright(block, way, high)
    if at_high <= 0.0:
        return high
    low = 0.0
    at_low, _ = _force_before_upright(block, way, low)
    if at_low > 0.0:
        # It barely reaches the speed: the force may have vanished and returned.
        for i in range(1, _SCANS):
            angle = high * (1.0 - i / _SCANS)
            found, _ = _force_before_upright(block, way, angle)
            if found <= 0.0:
                low, at_low = angle, found
                break
        if at_low > 0.0:
            return 0.0
    return _end_of_force(block, way, low, high, _guess(at_low, way.weight))


@lean
def _guess(upright: float, weight: float) -> float:
    """Guess how long before the upright the force ends (rad), from that upright (m/s²).

    With the spin constant and without what turns the block the force is weight + curvature ω², and
    the curvature about −cos 2α of that upright: sin² α = F/(2 (F − weight)).
    """
    sine2 = 0.5 * upright / (upright - weight)
    return math.sqrt(sine2) * (1.0 + sine2 * (1.0 / 6.0 + 0.075 * sine2))


@lean
def _end_of_force(block: Block, way: Way, low: float, high: float, angle: float) -> float:
    """Find where between two angles (rad) the normal force ends: it is 0 or less at ``low`` only.

    Newton's method from ``angle``; from the second step on the cubic of the angle over the force
    through the last two values and slopes.
    """
    before = force_before = per_rate_before = 0.0
    last = np.inf
    for _ in range(_MOST_STEPS):
        if not low < angle < high:
            angle = 0.5 * (low + high)
            last = np.inf
        force, rate = _force_before_upright(block, way, angle)
        if force <= 0.0:
            low = angle
        else:
            high = angle
        if high - low < _ANGLE:
            break
        per_rate = 1.0 / rate if rate > 0.0 else np.inf
        newton = angle - force * per_rate
        found = newton
        error = (newton - angle) ** 2
        if last < np.inf and force != force_before:
            per_force = 1.0 / (force - force_before)
            chord = (angle - before) * per_force
            bend = (per_rate - chord) * per_force
            twist = (per_rate - 2.0 * chord + per_rate_before) * per_force * per_force
            found = newton + force * force * (bend + twist * (force_before - force - force_before))
            error = 10.0 * abs(found - newton) * last * last
        before, force_before, per_rate_before = angle, force, per_rate
        last = abs(found - angle)
        angle = found
        if error < _ANGLE:
            break
    return min(max(angle, low), high)


@lean
def rolling_stretch(
    block: Block, theta: float, direction: int, v: float, pull: float, fade: float,
    gravity: float, cos_slope: float, down: float, length: float, ends_by: int, as_ellipse: bool,
    end_sliding: bool,
) -> tuple[float, int, float]:  # fmt: skip
    """Return the distance that a block rolls until the segment ends, it stops, slides or lifts off.

    With the kind of its end, and with LIFT_OFF how long before it stands upright (rad).

    Parameters
    ----------
    theta : float
        Angle of the major axis to the segment (rad).
    v, pull, fade : float
        As in Way.
    cos_slope, down : float
        Cosine of the slope; its sine, positive if the path descends.
    length, ends_by
        Distance to, and kind of, what ends the stretch otherwise.
    as_ellipse, end_sliding : bool
        Whether the ellipse may lift off, and whether it may end by sliding.
    """
    a, roll_radius = block.a, block.roll_radius
    angle = 0.0
    if end_sliding and pull < 0.0:
        # Too slow to lift its centre over the longer axis.
        least = 2.0 * gravity * cos_slope * (a - roll_radius) / block.roll_share
        reach = path_to(pull, fade, least - v * v) if v * v > least else 0.0
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
            late = path_to(pull, fade, gap) - first
            if 0.0 < late < math.inf:
                first += math.ceil(late / (math.pi * roll_radius)) * math.pi * roll_radius
        fast = v * v + gained(pull, fade, first) >= least * least * (1.0 + 1e-12)
        if fast and first - roll_radius * _WIDEST < length:
            weight = gravity * cos_slope
            early = lift_off_angle(block, Way(v, pull, fade, first, weight, gravity * down))
            if first - roll_radius * early < length:
                length = max(first - roll_radius * early, 0.0)
                ends_by = LIFT_OFF
                angle = early
    return length, ends_by, angle
