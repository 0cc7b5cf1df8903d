"""Whether observations can be true: against themselves, gravity and the terrain."""

from __future__ import annotations

import difflib
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.gap.observations.rules import RULES
from sassgis.gap.observations.tables import (
    DENSITY_KGM3,
    TABLES,
    ObservationFinding,
    Observations,
    parent_of,
    rock_masses_kg,
    rock_radii_m,
    root_of,
    without,
)
from sassgis.model.grid import FloatArray, Grid, IntArray
from sassgis.terrain.heights import heights_at

BoolArray = NDArray[np.bool_]

_GRAVITY = 9.81
#: Densities that rocks have (kg/m³).
_LIGHTEST_KGM3, _HEAVIEST_KGM3 = 900.0, 5000.0
_KMH = 3.6
#: Room for errors of measurement where none are stated.
_SPEED_ERROR, _HEIGHT_ERROR_M, _POSITION_ERROR_M = 0.05, 0.25, 0.5
#: Errors in units of the standard error that are still put down to the measurement.
_SIGMAS = 3.0
#: Heights of the same ground in two height systems differ by more than this (m).
_OFFSET_M = 1.5
#: Rocks are released up to this high above the ground (m).
_RELEASE_HEIGHT_M = 5.0
#: An ellipsoid fills from half of the box of its axes; rocks lie between. Full axes give 8 times.
_FULL_AXES = 4.0
#: Surface speed of a rock over its own speed: rolling is 1, a median of twice that is another unit.
_SPIN_RATIO = 2.0


def check_observations(
    observations: Observations, grid: Grid | None = None
) -> list[ObservationFinding]:
    """Look for what cannot be true.

    Parameters
    ----------
    observations : Observations
        In the coordinates of the grid.
    grid : Grid, optional
        The DEM; without it, nothing is compared with the terrain.

    Returns
    -------
    list of ObservationFinding
        Errors first. What a finding says is left out is still in ``observations``: see
        ``sassgis.gap.observations.tables.without``.
    """
    found: list[ObservationFinding] = []
    left = observations
    for check in _CHECKS:
        # What one check leaves out is not found again by the next, under another name.
        new = list(check(left, grid))
        found += new
        left = without(left, new)
    return sorted(found, key=lambda f: f.level != "error")


def _or(value: float, otherwise: float) -> float:
    return value if math.isfinite(value) else otherwise


# ---------------------------------------------------------------------------------------------
# Names


def _identifiers(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Names that are used twice where they stand for one thing."""
    for name, table in obs.tables.items():
        rows = list(zip(*(getattr(table, column).tolist() for column in table.key), strict=True))
        seen: set[object] = set()
        again = np.zeros(len(rows), np.bool_)
        for i, row in enumerate(rows):
            # Blocks without a name and impacts without a number are not the same one.
            if all(part not in ("", None) and part == part for part in row):
                again[i] = row in seen
                seen.add(row)
        if again.any():
            first = " at ".join(str(part) for part in rows[int(np.flatnonzero(again)[0])])
            column = table.key[-1] if name in ("stations", "impacts") else ""
            yield from RULES["twice"].at(obs, name, again, repr(first), column)


def _same_stop(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Stops of one name: one entered twice, or pieces without a suffix."""
    deposits = obs.deposits
    first: dict[str, list[int]] = {}
    again, pieces = np.zeros(len(deposits), np.bool_), np.zeros(len(deposits), np.bool_)
    near = _or(obs.metadata.position_error_m, _POSITION_ERROR_M)
    for i, name in enumerate(deposits.rock_id.tolist()):
        if not name:
            continue
        for j in first.get(name, []):
            apart = math.hypot(deposits.x[i] - deposits.x[j], deposits.y[i] - deposits.y[j])
            mass = (deposits.mass_kg[i], deposits.mass_kg[j])
            if not apart > near and (mass[0] == mass[1] or np.isnan(mass).any()):
                again[i] = True
                break
        else:
            pieces[i] = name in first
            first.setdefault(name, []).append(i)
    yield from RULES["same stop"].at(obs, "deposits", again)
    name = str(deposits.rock_id[pieces][0]) if pieces.any() else ""
    yield from RULES["several stops"].at(obs, "deposits", pieces, repr(name), name=name)


def _belonging(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Rocks and stations that the other tables know nothing of."""
    if len(obs.rocks):
        known = set(obs.rocks.rock_id.tolist())
        for table in ("passages", "impacts", "deposits", "trajectories"):
            lost = obs.rock_of(table) < 0
            if not lost.any():
                continue
            ids: list[str] = obs.tables[table].rock_id[lost].tolist()  # type: ignore[attr-defined]
            missing = list(dict.fromkeys(i for i in ids if i))
            yield from RULES["unattributed"].at(
                obs,
                table,
                lost,
                _some(missing) or "no name",
                taken="taken as unattributed blocks"
                if table in ("passages", "deposits")
                else "mass, size and release are unknown",
                nearest=_nearest(missing[0], sorted(known)) if missing else "",
            )
        orphans = np.array(
            [
                (parent := parent_of(n)) is not None and root_of(n, known) == n and bool(parent)
                for n in obs.rocks.rock_id.tolist()
            ],
            np.bool_,
        )
        name = str(obs.rocks.rock_id[orphans][0]) if orphans.any() else ""
        yield from RULES["piece of none"].at(
            obs, "rocks", orphans, repr(name), parent=parent_of(name)
        )
    if len(obs.stations) and len(obs.passages):
        names = obs.stations.station.tolist()
        passages = obs.passages
        lost = ~np.isin(passages.station, names)
        placed = np.isfinite(passages.x) & np.isfinite(passages.y)
        for rule, mask in (("placed elsewhere", lost & placed), ("no station", lost & ~placed)):
            if mask.any():
                missing = list(dict.fromkeys(passages.station[mask].tolist()))
                nearest = _nearest(missing[0], names)
                yield from RULES[rule].at(obs, "passages", mask, _some(missing), nearest=nearest)


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(repr(n) for n in names[:4])
    return shown + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _nearest(name: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f"one of {_some(known)}" + (f"; nearest: {close[0]}" if close else "")


# ---------------------------------------------------------------------------------------------
# Masses and sizes


def _sizes(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    rocks = obs.rocks
    axes = 4.0 / 3.0 * math.pi * rocks.semi_axis_a_m * rocks.semi_axis_b_m * rocks.semi_axis_c_m
    density = np.where(np.isfinite(rocks.density_kgm3), rocks.density_kgm3, DENSITY_KGM3)
    volume = np.where(np.isfinite(rocks.volume_m3), rocks.volume_m3, rocks.mass_kg / density)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = axes / volume
    known = np.isfinite(ratio)
    full = known & (ratio > _FULL_AXES)
    if known.any() and np.median(ratio[known]) > _FULL_AXES:
        found = f"ellipsoids of {np.median(ratio[known]):.1f} times the volume of the rocks"
        yield from RULES["full axes"].at(obs, "rocks", known, found)
    elif full.any():
        found = f"an ellipsoid of {ratio[full].max():.1f} times the volume of the rock"
        yield from RULES["large axes"].at(obs, "rocks", full, found)
    if (small := known & (ratio < 1.0 / _FULL_AXES)).any():
        found = f"an ellipsoid of {ratio[small].min():.2g} times the volume of the rock"
        yield from RULES["small axes"].at(obs, "rocks", small, found)
    for name in ("rocks", "deposits"):
        numbers = obs.tables[name].numbers
        with np.errstate(invalid="ignore", divide="ignore"):
            own = numbers["mass_kg"] / numbers["volume_m3"]
        odd = np.isfinite(own) & ((own < _LIGHTEST_KGM3) | (own > _HEAVIEST_KGM3))
        middle = float(np.median(own[odd])) if odd.any() else math.nan
        # In kg/m³ of a rock: between, where tonnes were meant; above, grams or litres.
        unit = "tonnes" if 0.9 <= middle <= 5.0 else "grams or litres" if middle > 1e5 else ""
        rule = RULES["unit of mass" if unit else "mass and volume"]
        yield from rule.at(obs, name, odd, f"{middle:.3g} kg/m³", unit=unit)
    density = rocks.density_kgm3
    odd = np.isfinite(density) & ((density < _LIGHTEST_KGM3) | (density > _HEAVIEST_KGM3))
    middle = float(np.median(density[odd])) if odd.any() else math.nan
    problem = "look like g/cm³" if middle < 6.0 else "not the density of a rock"
    yield from RULES["density"].at(obs, "rocks", odd, f"{middle:.4g}", problem=problem)


def _pieces(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Pieces cannot weigh more than their rock."""
    rocks, deposits = obs.rocks, obs.deposits
    if not len(rocks) or not len(deposits):
        return
    owner = obs.rock_of("deposits")
    place = {name: i for i, name in enumerate(rocks.rock_id.tolist())}
    for column, unit in (("mass_kg", "kg"), ("volume_m3", "m³")):
        values = deposits.numbers[column]
        for i, name in enumerate(obs.rock_names):
            own = (owner == i) & np.isfinite(values)
            whole = rocks.numbers[column][place[name]]
            if own.any() and np.isfinite(whole) and values[own].sum() > 1.15 * whole:
                yield from RULES["heavy pieces"].at(
                    obs,
                    "deposits",
                    own,
                    f"{values[own].sum():.4g} {unit}",
                    column,
                    name=name,
                    most=f"{whole:.4g} {unit}",
                )


# ---------------------------------------------------------------------------------------------
# Impacts


def _impacts(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    impacts = obs.impacts
    inward = impacts.vn_in_mps > 0.0
    known = np.isfinite(impacts.vn_in_mps)
    if inward.any():
        every = bool(inward.sum() > 0.5 * known.sum())
        yield from RULES["inward"].at(
            obs,
            "impacts",
            inward,
            f"vn_in = {impacts.vn_in_mps[inward].max():.3g} m/s",
            hint=": the normal seems to point into the ground" if every else "",
        )
    yield from _energy_gain(obs, ~inward)
    slopes = np.abs(impacts.slope_deg[np.isfinite(impacts.slope_deg)])
    if slopes.size >= 5 and 0.0 < slopes.max() <= 0.5 * math.pi:
        yield from RULES["radians"].at(
            obs, "impacts", np.isfinite(impacts.slope_deg), f"at most {slopes.max():.3g}"
        )


def _energy_gain(obs: Observations, usable: BoolArray) -> Iterator[ObservationFinding]:
    impacts = obs.impacts
    before = impacts.vt_in_mps**2 + impacts.vn_in_mps**2
    after = impacts.vt_out_mps**2 + impacts.vn_out_mps**2
    rock = obs.rock_of("impacts")
    radius = np.append(rock_radii_m(obs), np.nan)[rock]
    # A piece is smaller than its rock; of unknown mass, its spin says nothing.
    share = impacts.mass_kg / np.append(rock_masses_kg(obs), np.nan)[rock]
    radius = np.where(obs.is_piece("impacts"), radius * np.cbrt(share), radius)
    # A sphere's 2/5 r²: the rock may turn spin into speed.
    spins = np.isfinite(radius + impacts.omega_in_radps + impacts.omega_out_radps)
    with np.errstate(invalid="ignore"):
        turn = 0.4 * radius**2
        before = np.where(spins, before + turn * impacts.omega_in_radps**2, before)
        after = np.where(spins, after + turn * impacts.omega_out_radps**2, after)
    known = usable & np.isfinite(before) & np.isfinite(after) & (before > 0.0)
    error = _or(obs.metadata.speed_error_rel, _SPEED_ERROR)
    # Twice the relative error of a speed on each side.
    room = 1.0 + _SIGMAS * 2.0 * math.sqrt(2.0) * error
    gain = known & (after > room * before)
    if not gain.any():
        return
    worst = float((after[gain] / before[gain]).max())
    # Without spin, a rock that spins before the impact may go faster after it.
    blind = bool((gain & ~spins).any())
    swapped = gain.sum() > 0.5 * known.sum() and known.sum() >= 3
    yield from RULES["swapped" if swapped else "energy gain"].at(
        obs,
        "impacts",
        gain,
        f"{worst:.2f} times" + (" without the spin, which is not known" if blind else ""),
        room=room,
    )


# ---------------------------------------------------------------------------------------------
# Speeds


def _spins(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    radii = np.append(rock_radii_m(obs), np.nan)
    places = (
        ("passages", "rotation_hz", "speed_mps", 2.0 * math.pi, "turns per second"),
        ("trajectories", "rotation_hz", "speed_mps", 2.0 * math.pi, "turns per second"),
        ("impacts", "omega_in_radps", "vt_in_mps", 1.0, "radians per second"),
        ("impacts", "omega_out_radps", "vt_out_mps", 1.0, "radians per second"),
    )
    for table, column, speed, factor, unit in places:
        numbers = obs.tables[table].numbers
        radius = radii[obs.rock_of(table)] if len(obs.tables[table]) else np.empty(0)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = factor * np.abs(numbers[column]) * radius / np.abs(numbers[speed])
        known = np.isfinite(ratio) & (np.abs(numbers[speed]) > 1.0)
        if known.sum() < 3:
            continue
        middle = float(np.median(ratio[known]))
        if middle <= _SPIN_RATIO:
            continue
        guess = "degrees per second"
        if factor > 1.0 and middle < 30.0:
            guess = "radians per second or turns per minute"
        yield from RULES["spin"].at(
            obs,
            table,
            known,
            f"rims {middle:.1f} times as fast as the rocks",
            column,
            guess=guess,
            unit=unit,
        )


def _trajectory_speeds(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Speeds along a path against the path and the clock."""
    path = obs.trajectories
    # Nearer points are apart by the errors of their positions.
    span = max(2.0, 8.0 * _or(obs.metadata.position_error_m, _POSITION_ERROR_M))
    ratios = []
    known = np.flatnonzero(np.isfinite(path.t_s + path.x + path.y + path.speed_mps))
    _, rock = np.unique(path.rock_id[known], return_inverse=True)
    order = np.lexsort((path.t_s[known], rock))
    borders = np.flatnonzero(np.diff(rock[order])) + 1
    for rows in np.split(known[order], borders):
        if rows.size < 3:
            continue
        z = path.z[rows]
        height = z if np.isfinite(z).all() else np.zeros(rows.size)
        points = np.column_stack([path.x[rows], path.y[rows], height])
        kept = _apart(points, span)
        speed = path.speed_mps[rows]
        steps = np.diff(path.t_s[rows]) * 0.5 * (speed[1:] + speed[:-1])
        stated = np.diff(np.concatenate([[0.0], np.cumsum(steps)])[kept])
        far = np.sqrt((np.diff(points[kept], axis=0) ** 2).sum(axis=1))
        if far.size:
            # One number per rock: errors of single positions cancel along the path.
            ratios.append(float(stated.sum() / far.sum()))
    if not ratios:
        return
    middle = float(np.median(ratios))
    if 0.7 <= middle <= 1.4:
        return
    named = {_KMH: "km/h", 1.0 / 0.3048: "feet per second", 1e-3: "km/s"}
    unit = next((u for f, u in named.items() if 0.93 * f < middle < 1.07 * f), None)
    yield from RULES["unit of speed" if unit else "speed and time"].at(
        obs,
        "trajectories",
        np.isfinite(path.speed_mps),
        f"{middle:.2f} times the distance over the time",
        unit=unit,
    )


def _apart(points: FloatArray, span: float) -> IntArray:
    """Points of a path of which each is ``span`` or more from the one before, with the first."""
    kept = [0]
    for i in range(1, len(points)):
        if ((points[i] - points[kept[-1]]) ** 2).sum() >= span**2:
            kept.append(i)
    return np.array(kept, np.int64)


def _drops(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Speeds that no drop explains."""
    top = _tops(obs, grid)
    start = _start_speeds(obs)
    error = _or(obs.metadata.speed_error_rel, _SPEED_ERROR)
    slack = _SIGMAS * _or(obs.metadata.height_error_m, _HEIGHT_ERROR_M)
    for table, column in (
        ("passages", "speed_mps"),
        ("trajectories", "speed_mps"),
        ("impacts", "vt_in_mps"),
    ):
        data = obs.tables[table]
        if not len(data):
            continue
        numbers = data.numbers
        speed = numbers[column]
        if table == "impacts":
            speed = np.hypot(speed, numbers["vn_in_mps"])
        owner = obs.rock_of(table)
        z = numbers["z"].copy()
        if grid is not None:
            ground = heights_at(grid, numbers["x"], numbers["y"])
            z = np.where(np.isfinite(z), z, ground)
        if table == "passages" and len(obs.stations):
            z = np.where(np.isfinite(z), z, _station_heights(obs, grid, lowest=True))
        drop = np.maximum(top[owner] - z, 0.0) + slack
        fastest = np.sqrt(2.0 * _GRAVITY * drop + start[owner] ** 2)
        ratio = speed / fastest
        known = np.isfinite(ratio)
        too_fast = known & (ratio > 1.0 + _SIGMAS * error)
        if not too_fast.any():
            continue
        worst = int(np.flatnonzero(too_fast)[np.argmax(ratio[too_fast])])
        says = (
            f"{speed[worst]:.1f} m/s after a drop of {drop[worst]:.1f} m"
            f" in row {data.row[worst]}"  # type: ignore[attr-defined]
        )
        many = too_fast.sum() > 0.4 * known.sum() and known.sum() >= 3
        explained = np.mean(ratio[known] / _KMH <= 1.0 + _SIGMAS * error) > 0.9
        if many and explained:
            rule, rows = RULES["km/h"], known
            says = f"median {np.median(speed[known]):.1f}; {says}"
        else:
            rule, rows = RULES["mostly too fast" if many else "too fast"], too_fast
        yield from rule.at(obs, table, rows, says, column, fastest=fastest[worst])


def _tops(obs: Observations, grid: Grid | None) -> FloatArray:
    """Height from which each rock came, at most; the last one for unattributed blocks."""
    n = len(obs.rock_names)
    top = np.full(n + 1, np.nan)
    rocks = obs.rocks
    z = rocks.z
    if grid is not None:
        z = np.fmax(z, heights_at(grid, rocks.x, rocks.y))
    place = {name: i for i, name in enumerate(obs.rock_names)}
    radius = np.nan_to_num(rock_radii_m(obs))
    for name, height in zip(rocks.rock_id.tolist(), z.tolist(), strict=True):
        if name in place:
            top[place[name]] = height + radius[place[name]]
    summit = float(np.nanmax(z)) if np.isfinite(z).any() else math.nan
    if grid is not None and not math.isfinite(summit) and np.isfinite(grid.values).any():
        summit = float(np.nanmax(grid.values))
    if math.isfinite(summit):
        # Blocks torn out of the slope start below the releases.
        top[~np.isfinite(top)] = summit
    return top


def _start_speeds(obs: Observations) -> FloatArray:
    start = np.zeros(len(obs.rock_names) + 1)
    place = {name: i for i, name in enumerate(obs.rock_names)}
    for name, speed in zip(
        obs.rocks.rock_id.tolist(), obs.rocks.release_speed_mps.tolist(), strict=True
    ):
        if name in place and math.isfinite(speed):
            start[place[name]] = speed
    return start


def _station_heights(obs: Observations, grid: Grid | None, *, lowest: bool) -> FloatArray:
    """Ground at the station of each passage: its lowest or middle point."""
    heights = {}
    for name, vertices in zip(obs.stations.station.tolist(), obs.stations.vertices, strict=True):
        if grid is None or vertices.shape[0] < 2:
            continue
        line = shapely.LineString(vertices)
        at = np.linspace(0.0, 1.0, 21) if lowest else np.array([0.5])
        points = shapely.get_coordinates(line.interpolate(at, normalized=True))
        z = heights_at(grid, points[:, 0], points[:, 1])
        if np.isfinite(z).any():
            heights[name] = float(np.nanmin(z))
    return np.array([heights.get(s, math.nan) for s in obs.passages.station.tolist()], np.float64)


# ---------------------------------------------------------------------------------------------
# Places


def _near_stations(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Passages far from the station that they name."""
    passages = obs.passages
    lines = {
        name: shapely.LineString(v)
        for name, v in zip(obs.stations.station.tolist(), obs.stations.vertices, strict=True)
        if v.shape[0] > 1
    }
    room = max(5.0, _SIGMAS * _or(obs.metadata.position_error_m, _POSITION_ERROR_M))
    far, worst = np.zeros(len(passages), np.bool_), 0.0
    for i, name in enumerate(passages.station.tolist()):
        if name in lines and math.isfinite(passages.x[i] + passages.y[i]):
            away = float(lines[name].distance(shapely.Point(passages.x[i], passages.y[i])))
            far[i] = away > room
            worst = max(worst, away)
    yield from RULES["far from station"].at(obs, "passages", far, f"up to {worst:.1f} m", room=room)


def _downhill(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Passages of a rock that climb, lie above its release, or are listed out of order."""
    passages = obs.passages
    if not len(passages):
        return
    own = passages.z - np.nan_to_num(passages.height_m)
    level = own.copy()
    if grid is not None:
        ground = heights_at(grid, passages.x, passages.y)
        level = np.where(np.isfinite(ground), ground, level)
        if len(obs.stations):
            middle = _station_heights(obs, grid, lowest=False)
            level = np.where(np.isfinite(level), level, middle)
    room = max(2.0, _SIGMAS * _or(obs.metadata.height_error_m, _HEIGHT_ERROR_M))
    above = np.zeros(len(passages), np.bool_)
    owner = obs.rock_of("passages")
    # For rocks of unknown release the summit says nothing: only their own release counts.
    has_release = np.append(np.isin(obs.rock_names, _placed_rocks(obs)), False)
    above = has_release[owner] & (level > _tops(obs, grid)[owner] + room)
    if above.any():
        most = np.nanmax((level - _tops(obs, grid)[owner])[above])
        yield from RULES["above release"].at(obs, "passages", above, f"up to {most:.1f} m above")
    # The order of the stations is what most rocks say.
    rank: dict[str, float] = {}
    for name in set(passages.station.tolist()):
        z = level[(passages.station == name) & np.isfinite(level)]
        if name and z.size:
            rank[name] = float(np.median(z))
    height = np.array([rank.get(s, math.nan) for s in passages.station.tolist()], np.float64)
    climbing, unordered = np.zeros((2, len(passages)), np.bool_)
    ids = passages.rock_id
    for name in dict.fromkeys(ids.tolist()):
        rows = np.flatnonzero((ids == name) & np.isfinite(height)) if name else np.empty(0, int)
        if rows.size < 2:
            continue
        unordered[rows[1:]] |= np.diff(height[rows]) > 0.0
        down = rows[np.argsort(-height[rows], kind="stable")]
        climbing[down[1:]] |= np.diff(own[down]) > room
    yield from RULES["climbs"].at(obs, "passages", climbing)
    names = _some(passages.station[unordered].tolist())
    yield from RULES["unordered"].at(obs, "passages", unordered, names)


def _placed_rocks(obs: Observations) -> list[str]:
    known = np.isfinite(obs.rocks.z) | np.isfinite(obs.rocks.x + obs.rocks.y)
    names: list[str] = obs.rocks.rock_id[known].tolist()
    return names


def _on_the_dem(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    if grid is None:
        return
    west, south, east, north = grid.bounds
    extent = f"x {west:.0f} to {east:.0f}, y {south:.0f} to {north:.0f}"
    for table in ("rocks", "passages", "impacts", "deposits", "trajectories"):
        numbers = obs.tables[table].numbers
        x, y = numbers["x"], numbers["y"]
        known = np.isfinite(x) & np.isfinite(y)
        outside = known & (grid.cell_of(x, y) < 0)
        if not outside.any():
            continue
        i = int(np.flatnonzero(outside)[0])
        every = bool(outside[known].all())
        yield from RULES["all outside" if every else "outside"].at(
            obs,
            table,
            outside,
            f"{x[i]:.6g}, {y[i]:.6g}" if abs(x[i]) < 1e4 else f"{x[i]:.1f}, {y[i]:.1f}",
            extent=extent,
            why=_why_outside(x[known], y[known], grid) if every else "",
        )
    dem = shapely.box(west, south, east, north)
    for i, vertices in enumerate(obs.stations.vertices):
        if len(vertices) > 1 and not shapely.LineString(vertices).intersects(dem):
            yield from RULES["station outside"].at(
                obs,
                "stations",
                np.array([i]),
                ", ".join(f"{v:.1f}" for v in vertices[0]),
                name=obs.stations.station[i],
                extent=extent,
                why=_why_outside(vertices[:, 0], vertices[:, 1], grid),
            )


def _why_outside(x: FloatArray, y: FloatArray, grid: Grid) -> str:
    """A guess at how coordinates missed the DEM."""
    if (np.abs(x) <= 180.0).all() and (np.abs(y) <= 90.0).all() and grid.crs:
        return ": the coordinates look like degrees"
    if (grid.cell_of(y, x) >= 0).mean() > 0.5:
        return ": x and y look swapped"
    return ": another coordinate system?"


def _offsets(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Heights in another system than those of the DEM, and single heights far from it."""
    if grid is None:
        return
    limit = max(
        _OFFSET_M,
        0.5 * grid.cell_size,
        _SIGMAS * _or(obs.metadata.position_error_m, _POSITION_ERROR_M),
    )
    for table in ("rocks", "passages", "impacts", "deposits"):
        numbers = obs.tables[table].numbers
        over = numbers["z"] - heights_at(grid, numbers["x"], numbers["y"])
        if table == "passages":
            over = over - np.nan_to_num(numbers["height_m"])
            # Flying rocks may be high up: only those of known height count.
            over = np.where(np.isfinite(numbers["height_m"]) | (over < 0.0), over, np.nan)
        if table == "rocks":
            # Released from a bucket or a ledge: above the ground is no fault.
            over = np.where((over > 0.0) & (over < _RELEASE_HEIGHT_M), 0.0, over)
        known = np.isfinite(over)
        if not known.any():
            continue
        middle = float(np.median(over[known]))
        spread = 1.4826 * float(np.median(np.abs(over[known] - middle)))
        if known.sum() >= 3 and abs(middle) > limit and spread < 0.5 * abs(middle):
            yield from RULES["height system"].at(
                obs,
                table,
                known,
                f"{middle:+.2f} m in the median, scatter {spread:.2f} m",
                limit=limit,
            )
            over = over - middle
        stray = known & (np.abs(over) > max(20.0, 4.0 * limit))
        if stray.any():
            worst = over[stray][np.argmax(np.abs(over[stray]))]
            yield from RULES["stray height"].at(obs, table, stray, f"{worst:+.1f} m")
    path = obs.trajectories
    over = path.z - heights_at(grid, path.x, path.y)
    known = np.isfinite(over)
    if known.any():
        # A rock may fly at any height, but it cannot be under the ground.
        low = float(np.quantile(over[known], 0.05))
        if low < -limit:
            yield from RULES["under ground"].at(
                obs,
                "trajectories",
                known & (over < -limit),
                f"{low:+.2f} m at the lowest twentieth",
            )


def empty_tables(observations: Observations, read: Iterable[str]) -> list[ObservationFinding]:
    """Tables that are there and hold nothing, and none at all that can be used."""
    found = [
        ObservationFinding("warning", "table has no rows", observations.files.get(name, ""), name)
        for name in read
        if name in TABLES and not len(observations.tables[name])
    ]
    if not any(len(t) for name, t in observations.tables.items() if name != "stations"):
        counted = Counter(read)
        found.append(
            ObservationFinding(
                "error",
                "holds no observed rock",
                next(iter(observations.files.values()), ""),
                found=", ".join(counted) or "no table",
                expected="rows in passages, impacts, deposits or trajectories",
            )
        )
    return found


#: In this order: names first, then places, then what hangs on them.
_CHECKS: tuple[Callable[[Observations, Grid | None], Iterator[ObservationFinding]], ...] = (
    _identifiers,
    _same_stop,
    _belonging,
    _on_the_dem,
    _offsets,
    _sizes,
    _pieces,
    _near_stations,
    _downhill,
    _impacts,
    _spins,
    _trajectory_speeds,
    _drops,
)
