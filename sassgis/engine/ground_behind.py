"""The ground behind a block whose heading turns: kept, or sampled anew, where it is a wall."""

from __future__ import annotations

import math

from sassgis.compiled.jit import fused, lean
from sassgis.engine.contact import is_convex
from sassgis.engine.ellipse import CountedRows, Record
from sassgis.engine.ground_ahead import BEHIND, Path, add_vertex, place, terrain_height
from sassgis.engine.state import Block, Site

# Of the profile before so much is kept, in longest semi-axes, and so many vertices are sampled.
_KEPT_BEHIND = 2.0
_MOST_BEHIND = 40
# Ground behind that rises from the plane by this share of the shorter semi-axis is a wall.
_LEAST_WALL = 0.5


@lean
def keep_behind(state: Record, block: Block, site: Site, at: int, back: bool, rise: float) -> int:
    """Keep the ground behind a block for the next profile if it is a wall; count its vertices.

    A block between two walls would fall out of its pit if the plane of one went on through the
    other. Where the ground behind rises little above the plane, or falls away from it, the plane
    goes on instead: a block on a slope moves on along it without meeting each small vertex again.

    Parameters
    ----------
    at : int
        Segment under the block, whose plane goes on.
    back : bool
        Whether the block turns about: behind it lies what was ahead.
    rise : float
        By how much the slope of the plane grows (m per m); what is behind turns with it.
    """
    profile = site.profile
    n = profile.n[0]
    far = _KEPT_BEHIND * block.a
    kept = 0
    if back:
        if at + 1 >= n or is_convex(profile, at + 1):
            return 0
        while at + 1 + kept < n and profile.rows[at + 1 + kept].x < state.x + far:
            kept += 1
        first = at + 1
        outer = profile.rows[at + kept]
    else:
        if at == 0 or is_convex(profile, at):
            return 0
        while at - kept > 0 and profile.rows[at - kept].x > state.x - far:
            kept += 1
        first = at - kept + 1
        outer = profile.rows[first - 1]
    here = profile.rows[at]
    slope = here.tz / here.tx
    outer_slope = outer.tz / outer.tx
    end_x = state.x + far if back else state.x - far
    wall = outer.z - here.z + outer_slope * (end_x - outer.x) - slope * (end_x - here.x)
    for j in range(first, first + kept):
        wall = max(wall, profile.rows[j].z - here.z - slope * (profile.rows[j].x - here.x))
    if kept == 0 or wall < _LEAST_WALL * block.b:
        return 0
    outer_ground = outer.ground
    if back:
        outer_slope = -outer_slope
        _mirror_vertices(profile, first, kept, state.x)
    start = profile.rows[0]
    start_x = state.x - BEHIND * block.a
    start_z = profile.rows[first].z + outer_slope * (start_x - profile.rows[first].x)
    # The rows before ``first`` are free, and row i is read before it is written.
    for i in range(1, kept + 1):
        x = profile.rows[first + i - 1].x
        z = profile.rows[first + i - 1].z + rise * (x - state.x)
        ground = profile.rows[first + i - 1].ground
        if i == 1:
            start.x = start_x
            start.z = start_z + rise * (start_x - state.x)
            start.ground = outer_ground
            profile.n[0] = 0
        add_vertex(site, x, z)
        profile.rows[i].ground = ground
    return kept


@lean
def sample_behind(
    state: Record, block: Block, site: Site, path: Path, z: float, slope: float, ground: int
) -> int:
    """Sample the ground behind a block that has turned far; count its vertices.

    Where it lies below the plane through height z (m) the plane goes on instead, as in keep_behind.
    """
    step = 0.5 * path.cell_size
    count = min(int(_KEPT_BEHIND * block.a / step) + 2, _MOST_BEHIND)
    profile = site.profile
    wall = 0.0
    for i in range(count):
        # From the farthest on; the plane begins half a step behind the block.
        x = state.x - (count - i - 0.5) * step
        on_plane = z + slope * (x - state.x)
        u, v = place(state, x)
        known = on_plane if i == count - 1 else terrain_height(path, u, v)
        known = on_plane if math.isnan(known) else max(known, on_plane)
        wall = max(wall, known - on_plane)
        if i == 0:
            profile.rows[0].x = x - BEHIND * block.a
            profile.rows[0].z = known
            profile.rows[0].ground = ground
            profile.n[0] = 0
        add_vertex(site, x, known)
        profile.rows[i + 1].ground = ground
    return count if wall >= _LEAST_WALL * block.b else 0


@fused
def _mirror_vertices(profile: CountedRows, first: int, count: int, x: float) -> None:
    """Turn some vertices about a chainage (m), and the segments between them and before them."""
    for j in range(first + count - 1, first - 1, -1):
        profile.rows[j].ground = profile.rows[j - 1].ground
    for i in range(count):
        profile.rows[first + i].x = 2.0 * x - profile.rows[first + i].x
    for i in range(count // 2):
        here = profile.rows[first + i]
        there = profile.rows[first + count - 1 - i]
        here.x, there.x = there.x, here.x
        here.z, there.z = there.z, here.z
        here.ground, there.ground = there.ground, here.ground
