"""Make the sample terrain: ``python sample_dem/generate.py [FOLDER]`` rewrites every file.

Configurations and the table of vulnerability are written by hand, and copied into another FOLDER.

Nothing here was surveyed. The shapes are drawn from the slopes that rockfall ground has (cliff,
talus, foot, valley floor) and from noise; the two profiles are drawn after the words of Bozzolo and
Pamini (1986), not after their figures' curves.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from shapely import LineString, Polygon, box, get_parts, union_all
from shapely.affinity import rotate, translate
from shapely.geometry.base import BaseGeometry

sys.path.insert(0, str(Path(__file__).resolve().parent))
from terrain_kit import (
    FloatArray,
    cell_centres,
    ease,
    noise,
    scatter,
    soft_max,
    soft_min,
    write_dem,
    write_vectors,
)

HERE = Path(__file__).resolve().parent

# --- the valley -------------------------------------------------------------------------------

WEST, SOUTH, WIDTH, HEIGHT, CELL = 2_700_000.0, 1_120_000.0, 1200.0, 900.0, 2.0
TURN = np.radians(
    14.0
)  # strike of the slope against the grid, so that no fall line follows an axis
GULLY_U = 520.0
SCREE_SHARE = 0.80  # of the talus' plan length that is fine scree
BORDER = 24  # cells made beyond the edge, so that no filter bends the border
LARGE_COULOIRS = ((68.0, 9.0), (268.0, 11.0), (391.0, 13.0), (688.0, 12.0), (838.0, 9.0))


def to_slope(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Map coordinates to u (m along the slope, northwards) and v (m down the slope)."""
    dx, dy = x - WEST - WIDTH / 2, y - SOUTH - HEIGHT / 2
    u = dx * np.sin(TURN) + dy * np.cos(TURN) + HEIGHT / 2
    v = dx * np.cos(TURN) - dy * np.sin(TURN) + WIDTH / 2
    return u, v


def to_map(u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slope coordinates to map coordinates: the reverse of ``to_slope``."""
    du, dv = u - HEIGHT / 2, v - WIDTH / 2
    x = du * np.sin(TURN) + dv * np.cos(TURN) + WEST + WIDTH / 2
    y = du * np.cos(TURN) - dv * np.sin(TURN) + SOUTH + HEIGHT / 2
    return x, y


@dataclass(frozen=True, slots=True)
class Edges:
    """Where the units of the slope begin, down each line of equal u (all in m, arrays like u)."""

    top: FloatArray
    cliff_height: FloatArray
    cliff_run: FloatArray
    talus_end: FloatArray
    foot_end: FloatArray
    river: FloatArray
    floor_z: FloatArray
    couloir: FloatArray

    @property
    def toe(self) -> FloatArray:
        """Foot of the cliff."""
        return self.top + self.cliff_run


def couloirs(u: FloatArray) -> FloatArray:
    """How much of a couloir there is at u: 0 on a buttress, 1 in the middle of a couloir."""
    small = np.exp(-np.square((noise(u, 3.3, 46.0, 5) + 0.5 * noise(u, 9.1, 23.0, 6)) / 0.45))
    small *= 0.6 * ease(noise(u, 1.7, 120.0, 4), -1.2, 0.6)
    large = sum(np.exp(-np.square((u - at) / width)) for at, width in LARGE_COULOIRS)
    return np.maximum(small, np.minimum(large, 1.0))


def edges(u: FloatArray) -> Edges:
    """Borders of the units; the cliff edge steps back at couloirs and forward at buttresses."""
    couloir = couloirs(u)
    height = 80.0 + 9.0 * noise(u, 0.0, 260.0, 1) + 4.0 * noise(u, 0.0, 70.0, 2)
    steepness = np.radians(69.5 + 1.8 * noise(u, 0.0, 130.0, 3))
    top = 262.0 + 13.0 * noise(u, 0.0, 310.0, 7) + 5.0 * noise(u, 0.0, 85.0, 8)
    talus_end = 612.0 + 20.0 * noise(u, 0.0, 290.0, 10) + 6.0 * noise(u, 0.0, 90.0, 11)
    foot_end = 674.0 + 12.0 * noise(u, 0.0, 330.0, 12)
    cone = np.exp(-np.square((u - GULLY_U + 15.0) / 170.0))
    return Edges(
        top=top - 15.0 * couloir,
        cliff_height=height,
        cliff_run=height / np.tan(steepness) + 11.0 * couloir,
        talus_end=talus_end,
        foot_end=foot_end,
        river=865.0 + 16.0 * noise(u, 0.0, 240.0, 13) + 34.0 * cone,
        floor_z=1004.0 + 0.012 * u,
        couloir=couloir,
    )


def heights(e: Edges) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Heights of the upper ends of foot, talus and cliff (m)."""
    foot_top = e.floor_z + np.tan(np.radians(17.5)) * (e.foot_end - e.talus_end)
    talus_top = foot_top + np.tan(np.radians(34.3)) * (e.talus_end - e.toe)
    return foot_top, talus_top, talus_top + e.cliff_height


def bare_slope(u: FloatArray, v: FloatArray) -> FloatArray:
    """Heights of plateau, cliff, talus, foot and floor, before gully, cone, roughness and road."""
    e = edges(u)
    # The cliff's relief is a shift of the face, not a rise: a face bulges, it does not gain height.
    on_cliff = ease(v, e.top - 6.0, e.top + 4.0) * (1.0 - ease(v, e.toe - 6.0, e.toe + 8.0))
    relief = 3.2 * noise(u, v, 38.0, 21) + 1.6 * noise(u, v, 16.0, 22) + 0.7 * noise(u, v, 7.0, 23)
    w = v + on_cliff * relief

    foot_top, talus_top, cliff_top = heights(e)
    talus_run = e.talus_end - e.toe

    uphill = np.maximum(e.top - w, 0.0)
    # The edge's ups and downs die out uphill; hollows and knolls of the plateau's own begin.
    rim = gaussian_along(lambda line: heights(edges(line))[2], u, 110.0)
    behind = np.maximum(gaussian_along(lambda line: edges(line).top, u, 110.0) - w, 0.0)
    share = ease(uphill, 0.0, 80.0)
    hummocks = 5.0 * noise(u, v, 150.0, 24) + 2.2 * noise(u, v, 62.0, 27)
    near = cliff_top + 0.20 * uphill
    plateau = near * (1.0 - share) + share * (rim + behind * (0.20 + 0.0006 * behind) + hummocks)
    share = np.clip((w - e.top) / e.cliff_run, 0.0, 1.0)
    # Benches: beds of rock tilted along the face make the fall of the cliff uneven.
    beds = 4.2 * share + 0.006 * u + 0.35 * noise(u, v, 60.0, 25)
    share = share + 0.028 * np.sin(2.0 * np.pi * beds) * np.sin(np.pi * share)
    cliff = cliff_top - e.cliff_height * share

    t = np.clip((w - e.toe) / talus_run, 0.0, 1.0)
    # A talus is a little concave: steeper under the cliff than at its end.
    talus = foot_top + (talus_top - foot_top) * ((1.0 - t) - 0.12 * t * (1.0 - t))
    # Below each couloir it bulges into a scree cone that fades downslope.
    spread = ease(t, 0.0, 0.5)
    bulge = (1.0 - spread) * gaussian_along(couloirs, u, 12.0)
    bulge = bulge + spread * gaussian_along(couloirs, u, 26.0)
    talus = talus + 20.0 * (bulge - 0.2) * ease(t, 0.0, 0.12) * (1.0 - ease(t, 0.12, 0.85))
    f = np.clip((w - e.talus_end) / (e.foot_end - e.talus_end), 0.0, 1.0)
    foot = foot_top - (foot_top - e.floor_z) * (f + 0.10 * f * (1.0 - f))
    floor = e.floor_z - 0.006 * np.maximum(w - e.foot_end, 0.0)
    far = np.maximum(w - 950.0 - 14.0 * noise(u, 5.0, 180.0, 26), 0.0)
    swells = 5.0 * noise(u, v, 130.0, 28) + 2.0 * noise(u, v, 55.0, 29)
    floor = floor + far * np.tan(np.radians(11.0)) + 0.0007 * np.square(far)
    floor = floor + swells * ease(far, 0.0, 90.0)

    z = np.where(w < e.top, plateau, cliff)
    z = np.where(w > e.toe, talus, z)
    z = np.where(w > e.talus_end, foot, z)
    return np.where(w > e.foot_end, floor, z)


def gaussian_along(
    function: Callable[[FloatArray], FloatArray], u: FloatArray, sigma: float
) -> FloatArray:
    """A function of u, smoothed over ``sigma`` metres."""
    line = np.arange(-900.0, 1800.0, 2.0)
    smooth: FloatArray = np.interp(u, line, gaussian_filter1d(function(line), sigma / 2.0))
    return smooth


def gully_axis(v: FloatArray) -> FloatArray:
    """Along-slope place u of the gully's thalweg at v."""
    return GULLY_U + 15.0 * noise(v, 2.0, 130.0, 31) + 5.0 * noise(v, 2.0, 45.0, 32)


def gully_depth(v: FloatArray) -> FloatArray:
    """Depth of the gully below the slope beside it (m): deepest in the cliff, gone at the cone."""
    return (
        24.0
        * ease(v, 60.0, 275.0)
        * (1.0 - 0.66 * ease(v, 280.0, 400.0))
        * (1.0 - ease(v, 430.0, 575.0))
    )


CONE_APEX_V = 545.0
CONE_RADIUS = 205.0


def with_gully_and_cone(u: FloatArray, v: FloatArray, z: FloatArray) -> FloatArray:
    """Cut the gully through plateau, cliff and talus and lay its debris cone at the foot."""
    line = np.arange(-300.0, 620.0, 2.0)
    beside = bare_slope(gully_axis(line), line)
    # Water smooths its bed: in the cliff the thalweg is far less steep than the face.
    bed = gaussian_filter1d(beside, 16.0) - gully_depth(line)
    across = np.abs(u - np.interp(v, line, gully_axis(line)))
    flank = np.tan(np.radians(33.0 + 24.0 * ease(v, 200.0, 270.0) * (1.0 - ease(v, 300.0, 340.0))))
    half_bed = 2.0 + 3.0 * ease(v, 300.0, 480.0)
    # Ribs and side cuts: the flank's distance is stretched, never so much that it falls outwards.
    ragged = 1.0 + np.clip(0.16 * noise(u, v, 42.0, 33) + 0.05 * noise(u, v, 17.0, 34), -0.3, 0.4)
    climb = np.maximum(across * ragged - half_bed, 0.0) * flank
    sides = np.interp(v, line, bed) + climb
    z = np.where(v < 590.0, soft_min(z, sides, 2.5), z)

    apex_u = gully_axis(np.array([CONE_APEX_V]))[0]
    apex_z = float(np.interp(CONE_APEX_V, line, bed)) + 2.0
    radius = np.hypot(u - apex_u, v - CONE_APEX_V)
    lobes = 1.0 * noise(u, v, 75.0, 35) + 0.45 * noise(u, v, 28.0, 36)
    cone = apex_z - 0.375 * radius + 0.00027 * np.square(radius) + lobes * ease(radius, 20.0, 120.0)
    return np.where(v > CONE_APEX_V - 40.0, soft_max(z, cone, 3.0), z)


def roughness(u: FloatArray, v: FloatArray) -> FloatArray:
    """Metre-scale heights by unit: fine under the cliff, coarse at the end of the talus."""
    e = edges(u)
    talus = ease(v, e.toe, e.toe + 10.0) * (1.0 - ease(v, e.talus_end - 5.0, e.talus_end + 25.0))
    down = np.clip((v - e.toe) / (e.talus_end - e.toe), 0.0, 1.0)
    cliff = ease(v, e.top - 4.0, e.top + 4.0) * (1.0 - ease(v, e.toe - 4.0, e.toe + 4.0))
    meadow = 1.0 - np.maximum(talus, cliff)
    floor = ease(v, e.foot_end - 20.0, e.foot_end + 20.0)
    blocky = 0.7 * noise(u, v, 5.2, 41) + 0.7 * noise(u, v, 8.5, 42)
    # Shallow chutes run down the talus: noise drawn out along v.
    chutes = 0.5 * noise(u + 0.12 * v, v / 9.0, 16.0, 43) + 0.3 * noise(u, v / 6.0, 9.0, 44)
    turf = 0.22 * noise(u, v, 27.0, 45) + 0.10 * noise(u, v, 11.0, 46)
    knobs = 0.55 * noise(u, v, 6.0, 47)
    return (
        talus * ((0.08 + 0.34 * down**1.5) * blocky + 0.8 * np.sin(np.pi * down) * chutes)
        + cliff * knobs
        + meadow * turf * (1.0 - 0.6 * floor)
    )


def boulders(u: FloatArray, v: FloatArray) -> FloatArray:
    """Single large blocks, thick at the end of the talus and thin on the foot."""
    z = np.zeros_like(u)
    for a, b, c, d in scatter(230, 51):
        bu = -80.0 + 1100.0 * a
        e = edges(np.array([bu]))
        run = e.talus_end[0] - e.toe[0]
        bv = e.toe[0] + run * (0.45 + 0.72 * np.sqrt(b) if b > 0.12 else 0.2 + b)
        radius, height = 2.2 + 3.2 * c**3, 0.7 + 2.1 * c**2 * d
        near = (np.abs(u - bu) < 2 * radius) & (np.abs(v - bv) < 2 * radius)
        far = np.hypot((u[near] - bu) * (0.8 + 0.4 * d), v[near] - bv) / radius
        z[near] = np.maximum(z[near], height * (1.0 - ease(far, 0.35, 1.1)))
    return z


def road_axis(u: FloatArray) -> FloatArray:
    """Down-slope place v of the road at u: a smooth line along the foot."""
    foot = gaussian_along(lambda line: edges(line).foot_end, u, 60.0)
    return foot + 6.0 + 20.0 * np.exp(-np.square((u - GULLY_U + 5.0) / 130.0))


def talus_edge(u: FloatArray) -> FloatArray:
    """Down-slope place v where the talus ends at u, without its small bays."""
    return gaussian_along(lambda line: edges(line).talus_end, u, 60.0)


def track_axis(u: FloatArray) -> FloatArray:
    """Down-slope place v of the forest track at u: below the talus and round the cone."""
    return talus_edge(u) + 14.0 + 48.0 * np.exp(-np.square((u - GULLY_U + 5.0) / 85.0))


def with_road(u: FloatArray, v: FloatArray, z: FloatArray) -> FloatArray:
    """Bench the road into the foot: flat over its width, banks that run out on both sides."""
    line = np.arange(-200.0, 1200.0, 4.0)
    axis = road_axis(line)
    ground = gaussian_filter(with_gully_and_cone(line, axis, bare_slope(line, axis)), 9.0)
    level = np.interp(u, line, ground)
    off = np.abs(v - road_axis(u))
    keep = ease(off, 4.0, 11.0)
    graded: FloatArray = level * (1.0 - keep) + z * keep
    return graded


def with_river(u: FloatArray, v: FloatArray, z: FloatArray) -> FloatArray:
    """Cut the river's bed and the low terraces beside it."""
    e = edges(u)
    off = np.abs(v - e.river - 3.0 * noise(u, 0.0, 60.0, 61))
    terrace = 1.1 * (
        1.0 - ease(off, 26.0 + 5.0 * noise(u, v, 70.0, 62), 34.0 + 5.0 * noise(u, v, 70.0, 62))
    )
    bed = 2.3 * (1.0 - ease(off, 5.0, 11.0 + 1.5 * noise(u, v, 40.0, 63)))
    return z - terrace - bed


def valley_heights(x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights of the made valley at map coordinates on a grid (m)."""
    x, y = x[0], y[:, 0]
    rim = CELL * np.arange(1, BORDER + 1)
    x = np.concatenate([x[0] - rim[::-1], x, x[-1] + rim])
    y = np.concatenate([y[0] + rim[::-1], y, y[-1] - rim])
    u, v = to_slope(*np.meshgrid(x, y))
    bare = bare_slope(u, v)
    # Edges of the units are sharp at the cliff only; soil and scree round all others.
    e = edges(u)
    hard = ease(v, e.top - 16.0, e.top - 4.0) * (1.0 - ease(v, e.toe + 2.0, e.toe + 14.0))
    bare = hard * gaussian_filter(bare, 0.6) + (1.0 - hard) * gaussian_filter(bare, 4.0)
    z = with_gully_and_cone(u, v, bare)
    z = with_river(u, v, z + roughness(u, v) + boulders(u, v))
    return with_road(u, v, z)[BORDER:-BORDER, BORDER:-BORDER]


def strip(u: FloatArray, near: FloatArray, far: FloatArray) -> Polygon:
    """The map polygon between two lines v = near(u) and v = far(u)."""
    x, y = to_map(np.concatenate([u, u[::-1]]), np.concatenate([near, far[::-1]]))
    return Polygon(np.column_stack([x, y]))


def line_on_map(u: FloatArray, v: FloatArray) -> LineString:
    """The map line through slope coordinates."""
    return LineString(np.column_stack(to_map(u, v)))


def sorting_line(u: FloatArray) -> FloatArray:
    """Down-slope place v where fine scree gives way to coarse blocks."""
    e = edges(u)
    return e.toe + (SCREE_SHARE + 0.03 * noise(u, 4.0, 90.0, 81)) * (e.talus_end - e.toe)


def valley_ground() -> list[dict[str, Any]]:
    """Ground polygons without overlaps; what they leave free is soft meadow."""
    u = np.arange(-330.0, 1240.0, 6.0)
    e = edges(u)
    frame = box(WEST, SOUTH, WEST + WIDTH, SOUTH + HEIGHT)
    rock = strip(u, e.top - 5.0, e.toe + 1.0)
    # Falling rocks sort themselves: fine scree below the cliff, coarse blocks at the talus' end.
    coarse = gaussian_along(sorting_line, u, 30.0)
    scree = strip(u, e.toe + 1.0, coarse)
    talus = strip(u, coarse, e.talus_end + 12.0)
    foot = strip(u, e.talus_end + 12.0, np.full_like(u, 1500.0))
    plateau = strip(u, np.full_like(u, -500.0), e.top - 5.0)
    v = np.arange(110.0, CONE_APEX_V + 12.0, 6.0)
    gully_line = line_on_map(gully_axis(v), v)
    # The bed in the plateau and the talus is debris; where it crosses the cliff it is washed rock.
    gully = gully_line.buffer(11.0).difference(rock)
    apex_u = gully_axis(np.array([CONE_APEX_V]))[0]
    angle = np.radians(np.arange(-62.0, 63.0, 4.0))
    reach = CONE_RADIUS * (0.80 + 0.2 * np.cos(1.4 * angle))
    cone = line_ring(apex_u + reach * np.sin(angle), CONE_APEX_V + reach * np.cos(angle), apex_u)
    road_u = np.arange(-330.0, 1240.0, 10.0)
    road = line_on_map(road_u, road_axis(road_u)).buffer(3.5, cap_style="flat")
    river = line_on_map(u, e.river).buffer(9.0)
    debris = union_all([gully, cone]).difference(union_all([road, river]))
    classes: list[tuple[str, BaseGeometry]] = [
        ("rock", rock),
        ("debris", scree.difference(debris)),
        ("talus", talus.difference(debris)),
        ("debris", debris),
        ("debris", river),
        ("asphalt", road),
        ("soft_meadow", union_all([foot, plateau]).difference(union_all([debris, road, river]))),
    ]
    rows: list[dict[str, Any]] = []
    for name, shape in classes:
        for part in get_parts(shape.intersection(frame)):
            if part.geom_type == "Polygon" and part.area > 1.0:
                rows.append({"class": name, "geometry": part})
    return rows


def line_ring(u: FloatArray, v: FloatArray, apex_u: float) -> Polygon:
    """A fan: its apex and the outer line."""
    x, y = to_map(np.append(u, apex_u), np.append(v, CONE_APEX_V - 8.0))
    return Polygon(np.column_stack([x, y]))


# name, scenario, u from, u to, share of the cliff from, to (0: upper edge, 1: foot)
RELEASES = (
    ("Sued", "rare", 130.0, 235.0, 0.10, 0.55),
    ("Mitte", "frequent", 320.0, 445.0, 0.08, 0.72),
    ("Gully", "frequent", 492.0, 552.0, 0.05, 0.80),
    ("Nord", "rare", 628.0, 742.0, 0.10, 0.66),
)


def valley_releases() -> list[dict[str, Any]]:
    """Release polygons in the cliff."""
    rows = []
    for name, scenario, low, high, upper, lower in RELEASES:
        u = np.linspace(low, high, 25)
        e = edges(u)
        taper = np.sin(np.pi * np.linspace(0.12, 0.88, 25)) ** 0.4
        middle, half = (upper + lower) / 2, (lower - upper) / 2 * taper
        half = half * (1.0 + 0.15 * noise(u, 7.0, 25.0, 71))
        area = strip(
            u, e.top + (middle - half) * e.cliff_run, e.top + (middle + half) * e.cliff_run
        )
        rows.append({"name": name, "scenario": scenario, "geometry": area})
    return rows


# u, offset from the road (v, m), length, width (m), turn (degrees), value (CHF), people, share of
# the time that each of them is there. Like all of the sample, invented.
BUILDINGS = (
    (150.0, 26.0, 18.0, 11.0, 8.0, 750_000.0, 4.0, 0.60),
    (190.0, -62.0, 14.0, 10.0, -12.0, 480_000.0, 2.0, 0.70),
    (228.0, 22.0, 24.0, 12.0, 3.0, 1_400_000.0, 12.0, 0.55),
    (394.0, -52.0, 16.0, 10.0, 20.0, 620_000.0, 3.0, 0.65),
    (650.0, -48.0, 20.0, 12.0, -6.0, 900_000.0, 5.0, 0.60),
    (702.0, -38.0, 12.0, 9.0, 15.0, 90_000.0, 1.0, 0.05),
)


def valley_buildings() -> list[dict[str, Any]]:
    """Two houses by the road; by the track one behind each barrier, one behind none; a barn."""
    rows = []
    for number, (u, off, length, width, turn, value, people, share) in enumerate(
        BUILDINGS, start=1
    ):
        x, y = to_map(np.array([u]), road_axis(np.array([u])) + off)
        house = rotate(box(-width / 2, -length / 2, width / 2, length / 2), turn - np.degrees(TURN))
        kind = "barn" if number == len(BUILDINGS) else "house"
        rows.append(
            {
                "name": f"{kind} {number}",
                "kind": kind,
                "value_chf": value,
                "persons": people,
                "presence": share,
                "geometry": translate(house, float(x[0]), float(y[0])),
            }
        )
    return rows


ROAD_COLUMNS = (
    "name", "width_m", "chf_per_m", "traffic_per_day", "speed_kmh", "vehicle_m",
    "persons_per_vehicle", "vehicle_chf",
)  # fmt: skip
VALLEY_ROAD = ("valley road", 7.0, 2500.0, 1800.0, 60.0, 5.0, 1.5, 25_000.0)
TRACK = ("forest track", 3.0, 300.0, 25.0, 15.0, 5.0, 1.3, 40_000.0)


def valley_lines() -> dict[str, list[dict[str, Any]]]:
    """Road, track, stations and barriers."""
    u = np.arange(-330.0, 1240.0, 15.0)
    frame = box(WEST, SOUTH, WEST + WIDTH, SOUTH + HEIGHT)
    across = np.arange(60.0, 801.0, 15.0)
    upper = gaussian_along(
        lambda line: 0.7 * edges(line).toe + 0.3 * edges(line).talus_end, across, 40.0
    )
    net_u, wall_u = np.arange(310.0, 481.0, 10.0), np.arange(565.0, 691.0, 10.0)
    roads = {}
    for layer, row, v in (("road", VALLEY_ROAD, road_axis(u)), ("track", TRACK, track_axis(u))):
        axis = line_on_map(u, v).intersection(frame)
        roads[layer] = [{**dict(zip(ROAD_COLUMNS, row, strict=True)), "geometry": axis}]
    return {
        **roads,
        "stations": [
            {"name": "upper talus", "geometry": line_on_map(across, upper)},
            {"name": "above the road", "geometry": line_on_map(across, road_axis(across) - 14.0)},
        ],
        "net": [
            {
                "name": "net Mitte",
                "kind": "net",
                "height_m": 4.0,
                "capacity_kj": 2000.0,
                "geometry": line_on_map(net_u, talus_edge(net_u) - 4.0),
            }
        ],
        "wall": [
            {
                "name": "wall Nord",
                "kind": "wall",
                "height_m": 3.0,
                "geometry": line_on_map(wall_u, track_axis(wall_u) - 10.0),
            }
        ],
    }


def make_valley(folder: Path) -> None:
    """Write the valley: heights, polygons, lines."""
    x, y = cell_centres(WEST, SOUTH, WIDTH, HEIGHT, CELL)
    z = valley_heights(x, y)
    write_dem(folder / "dem.tif", z, WEST, SOUTH + HEIGHT, CELL, "LN02")
    write_vectors(folder / "release.gpkg", "release", valley_releases())
    write_vectors(folder / "ground.gpkg", "ground", valley_ground())
    write_vectors(folder / "buildings.gpkg", "buildings", valley_buildings())
    for name, rows in valley_lines().items():
        write_vectors(folder / f"{name}.gpkg", name, rows)


# --- the profiles -----------------------------------------------------------------------------

# Each piece: plan length (m), slope (degrees), ground of the piece.
Pieces = tuple[tuple[float, float, str], ...]

# About 150 m of fall over 170 m of chainage, a thin soft soil broken by ledges of rock, a road near
# the foot. The unstable rock is the first 15 m.
BEDRINA: Pieces = (
    (4.0, 55.0, "rock"),
    (6.0, 66.0, "rock"),
    (5.0, 58.0, "rock"),
    (8.0, 41.5, "debris"),
    (10.0, 36.0, "debris"),
    (7.0, 39.0, "debris"),
    (3.0, 71.0, "rock"),
    (5.0, 33.0, "rock"),
    (11.0, 37.0, "debris"),
    (12.0, 34.5, "debris"),
    (9.0, 38.0, "debris"),
    (3.5, 72.5, "rock"),
    (4.5, 35.0, "rock"),
    (12.0, 35.5, "debris"),
    (13.0, 33.5, "debris"),
    (9.0, 36.0, "debris"),
    (2.5, 70.0, "rock"),
    (10.0, 34.5, "debris"),
    (11.0, 32.5, "debris"),
    (6.0, 30.5, "debris"),
    (2.5, 40.0, "debris"),
    (8.0, 0.0, "asphalt"),
    (8.0, 22.0, "debris"),
)

# About 150 m long with a road bridge at its foot.
PIOTA_NEGRA: Pieces = (
    (3.0, 50.0, "rock"),
    (7.0, 68.0, "rock"),
    (6.0, 57.0, "rock"),
    (8.0, 48.0, "rock"),
    (12.0, 42.0, "debris"),
    (14.0, 39.0, "debris"),
    (4.0, 60.0, "rock"),
    (15.0, 38.0, "debris"),
    (17.0, 36.5, "debris"),
    (16.0, 37.5, "debris"),
    (3.0, 58.0, "rock"),
    (14.0, 36.0, "debris"),
    (13.0, 34.0, "debris"),
    (8.0, 30.0, "debris"),
    (10.0, 24.0, "debris"),
)


def vertices(pieces: Pieces, top: float, foot: float) -> list[tuple[float, float, str]]:
    """Chainage, height and ground of the vertices; falls are scaled so that the ends fit."""
    length = np.array([p[0] for p in pieces])
    fall = length * np.tan(np.radians([p[1] for p in pieces]))
    fall *= (top - foot) / fall.sum()
    s = np.concatenate([[0.0], np.cumsum(length)])
    z = top - np.concatenate([[0.0], np.cumsum(fall)])
    grounds = [p[2] for p in pieces] + [pieces[-1][2]]
    return [(float(a), float(b), c) for a, b, c in zip(s, z, grounds, strict=True)]


def write_profile(path: Path, rows: list[tuple[float, float, str]]) -> None:
    """Write a profile; the ground named at a vertex is that of the stretch below it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ["s_m,z_m,ground", *(f"{s:.2f},{z:.2f},{ground}" for s, z, ground in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


#: Written by hand, in this folder only.
TEXTS = (
    "valley/config.toml", "valley/vulnerability.csv", "bedrina/config_before.toml",
    "bedrina/config_after.toml", "bedrina/config_restart.toml", "piota_negra/config.toml",
)  # fmt: skip


def main(folder: Path) -> None:
    """Write every sample into ``folder``."""
    make_valley(folder / "valley")
    write_profile(folder / "bedrina" / "profile.csv", vertices(BEDRINA, 1800.0, 1650.0))
    write_profile(folder / "piota_negra" / "profile.csv", vertices(PIOTA_NEGRA, 135.0, 0.0))
    if folder.resolve() != HERE:
        for name in TEXTS:
            shutil.copyfile(HERE / name, folder / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
