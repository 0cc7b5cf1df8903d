"""Resistance that grows with the speed, on the ground and at impacts.

Besides friction the ground resists with μ_v v²/(g d) times the normal force, d being the diameter
of the block: ground that is ploughed and thrown sideways takes momentum. With v²/(g d) blocks of
all sizes move alike. Form and values are our assumptions. Speeds are observed to saturate on long
slopes, later for larger blocks (docs/studies/kinematics.md).

Along a path s on straight ground d(v²)/ds = 2 (p − κ v²), κ = μ_v cos β/d: all here is in closed
form, so that nothing depends on how a path is cut. ``pull`` is p − κ v² where a path begins.
"""

from __future__ import annotations

import math

from sassgis.compiled.jit import lean

# Below it a share of a change is itself, to rounding.
_STRAIGHT = 1e-12
# Relative change of the speed below which terms of its square are rounding.
_STEADY = 1e-6


@lean
def gained(pull: float, fade: float, path: float) -> float:
    """Return the change of v² over a path (m²/s²); ``fade`` is κ (1/m)."""
    x = 2.0 * fade * path
    if abs(x) < _STRAIGHT:
        return 2.0 * pull * path
    return pull / fade * -math.expm1(-x)


@lean
def path_to(pull: float, fade: float, change: float) -> float:
    """Return the path over which v² changes by some amount (m), infinite if it never does."""
    x = -fade * change / pull
    if x <= -1.0:
        return math.inf
    if abs(x) < _STRAIGHT:
        return 0.5 * change / pull
    return -0.5 * math.log1p(x) / fade


@lean
def share_gained(share: float, fading: float) -> float:
    """Return the share of the change of v² after a share of a path of the length fading/(2 κ)."""
    if fading < _STRAIGHT:
        return share
    return math.expm1(-fading * share) / math.expm1(-fading)


@lean
def time_over(steady: float, fade: float, before: float, after: float, path: float) -> float:
    """Return the time for a path (s) along which the speed goes from one to another (m/s).

    From dv/dt = p − κ v²; ``steady`` is p (m/s²).
    """
    both = before + after
    gain = after - before
    if fade <= 0.0 or abs(gain) <= _STEADY * both:
        return 2.0 * path / both if both > 0.0 else 0.0
    per_gain = 1.0 / (steady - fade * before * after)
    rate = math.sqrt(abs(steady) * fade)
    x = rate * gain * per_gain
    if abs(x) < _STEADY:
        return gain * per_gain
    return (math.atanh(x) if steady > 0.0 else math.atan(x)) / rate
