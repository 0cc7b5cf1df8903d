"""Bundles of lines that spread laterally from the fall line.

Blocks leave the line of steepest descent. Field tests and models put the width of their spread at
some 10 to 20 per cent of the slope length (P. Azzoni, G. La Barbera, A. Zaninetti, 1995, Analysis
and prediction of rockfalls using a mathematical model, Int. J. Rock Mech. Min. Sci. 32, 709-724;
G. B. Crosta, F. Agliardi, 2004, Parametric evaluation of 3D dispersion of rockfall trajectories,
Nat. Hazards Earth Syst. Sci. 4, 583-598).
"""

from __future__ import annotations

import numpy as np

from sassgis.model import rng
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.profiles import ReleasePoints, TraceSet
from sassgis.model.release_areas import FallLineSettings, SpreadSettings
from sassgis.model.settings import LateralDeflection
from sassgis.terrain.fall_lines import Kicks, trace
from sassgis.terrain.surface import Surface


def fans(settings: SpreadSettings) -> FloatArray:
    """Lateral deviations of the lines of a bundle.

    The width is cut into as many equal parts as there are lines, and each line is the middle of its
    part: lines of equal weight then represent a uniform spread over the whole width.

    Parameters
    ----------
    settings : SpreadSettings

    Returns
    -------
    float64, shape (lines_per_point,)
        Offset over length, from left (negative) to right; exactly symmetric, and exactly 0 in the
        middle of an odd number.
    """
    m = settings.lines_per_point
    steps = 2.0 * np.arange(m, dtype=np.float64) + 1.0 - m
    deviations: FloatArray = steps * (settings.width_percent / 100.0 / (2.0 * m))
    return deviations


def trace_random_paths(
    grid: Grid,
    surface: Surface,
    points: ReleasePoints,
    settings: FallLineSettings,
    lateral: LateralDeflection,
    lines_per_point: int,
    seed: int,
    repetition: int = 0,
) -> TraceSet:
    """Trace paths that leave the fall line at random; see sassgis.model.effects.LateralDeflection.

    Parameters
    ----------
    grid, surface, points, settings
        As for sassgis.terrain.fall_lines.trace.
    lateral : LateralDeflection
    lines_per_point : int
        Paths from each point.
    seed, repetition : int
        Other paths for each.

    Returns
    -------
    TraceSet
        Ordered by point. A path depends on seed, repetition, release point and its number there
        alone.
    """
    member = np.tile(np.arange(lines_per_point, dtype=np.int64), len(points))
    key = rng.combined(np.repeat(points.key, lines_per_point), member)
    key = rng.combined(rng.combined(key, np.full(key.size, repetition)), np.full(key.size, seed))
    if lateral.form == "kicks":
        kicks = Kicks(key, np.zeros(key.size), float(np.radians(lateral.angle_deg)), lateral.hop_m)
    else:
        place = rng.shares(key) - 0.5
        kicks = Kicks(key, place * (lateral.width_percent / 100.0), 0.0, 0.0)
    return trace(grid, surface, points, settings, kicks=kicks)


def trace_bundles(
    grid: Grid,
    surface: Surface,
    points: ReleasePoints,
    settings: FallLineSettings,
    spread: SpreadSettings,
) -> TraceSet:
    """Trace a bundle of lines from each release point.

    A line of fan f heads, everywhere, atan f beside the local steepest descent: on a plane it
    has left the fall line by f times the distance down that line. In a gully the walls hold it near
    the axis, as they would a block. All other rules, and the ends, are those of
    sassgis.terrain.fall_lines.trace.

    Parameters
    ----------
    grid, surface, points, settings
        As for sassgis.terrain.fall_lines.trace.
    spread : SpreadSettings

    Returns
    -------
    TraceSet
        ``lines_per_point`` lines for each point, ordered by point, then from left to right.
    """
    return trace(grid, surface, points, settings, fans(spread))
