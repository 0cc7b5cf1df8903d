"""Whether observations can be true: names, sizes, places, and all other checks in their order."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial

import numpy as np
import shapely

from sassgis.gap.constants import (
    AXES_UNITS,
    DENSITY_KGM3,
    FULL_AXES_RATIO,
    HEAVIEST_ROCK_KGM3,
    HEIGHT_ERROR_M,
    HEIGHT_OFFSET_M,
    LIGHTEST_ROCK_KGM3,
    MASS_ERROR_REL,
    POSITION_ERROR_M,
    RELEASE_HEIGHT_M,
    SIGMAS,
    TONNE_KG,
    UNIT_FACTOR,
)
from sassgis.gap.observations.motion_checks import (
    check_drops,
    check_impacts,
    check_spins,
    check_times,
    check_trajectory_speeds,
    check_ways,
)
from sassgis.gap.observations.observed import (
    RULES,
    ObservationFinding,
    Observations,
    above_release_m,
    nearest_of,
    parent_of,
    root_of,
    stated_or,
    station_heights_m,
    station_lines,
    tops_m,
    without,
)
from sassgis.gap.observations.tables import POINT_TABLES, TABLE_TYPES, TABLES
from sassgis.grid import FloatArray, Grid
from sassgis.settings.results import some_of
from sassgis.terrain.cells import heights_at

Check = Callable[[Observations, Grid | None], Iterator[ObservationFinding]]


def check_observations(
    observations: Observations,
    grid: Grid | None = None,
    drop_m: float = 0.0,
    density_kgm3: float = DENSITY_KGM3,
) -> list[ObservationFinding]:
    """Look for what cannot be true, in the coordinates of the grid; errors first.

    Without the ``grid`` (DEM) nothing is compared with the terrain. ``drop_m``: height above the
    ground from which blocks were released, at most; ``density_kgm3``: of rocks of which it was not
    observed. What a finding says is left out is still in ``observations``: see ``without``.
    """
    found: list[ObservationFinding] = []
    left = observations
    # Names first, then places, then what hangs on them.
    checks: tuple[Check, ...] = (
        _identifiers,
        _same_stop,
        _belonging,
        check_on_the_dem,
        check_offsets,
        partial(_sizes, density_kgm3=density_kgm3),
        _pieces,
        check_near_stations,
        check_downhill,
        check_impacts,
        check_times,
        partial(check_ways, drop_m=drop_m),
        check_spins,
        check_trajectory_speeds,
        partial(check_drops, drop_m=drop_m),
    )
    for check in checks:
        # A value that one check excludes is not reported again by the next.
        new = list(check(left, grid))
        found += new
        left = without(left, new)
    return sorted(found, key=lambda f: f.level != "error")


def _identifiers(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Yield findings on names that are used twice where they must name one thing."""
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
            yield from RULES["twice"].at(obs, name, again, repr(first), ", ".join(table.key))


def _same_stop(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Yield findings on stops of one name: one entered twice, or fragments without a suffix."""
    deposits = obs.deposits
    first: dict[str, list[int]] = {}
    again, pieces = np.zeros(len(deposits), np.bool_), np.zeros(len(deposits), np.bool_)
    stated = obs.metadata
    near = stated_or(stated.stop_error_m, stated_or(stated.position_error_m, POSITION_ERROR_M))
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
    name = next(iter(deposits.rock_id[pieces].tolist()), "")
    yield from RULES["several stops"].at(obs, "deposits", pieces, repr(name), name=name)


def _belonging(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Yield findings on rocks and stations that the other tables do not name."""
    if len(obs.rocks):
        known = set(obs.rocks.rock_id.tolist())
        for table in (name for name in POINT_TABLES if name != "rocks"):
            lost = obs.rock_of(table) < 0
            if not lost.any():
                continue
            ids = obs.tables[table].rock_id[lost].tolist()
            missing = [name for name in dict.fromkeys(ids) if name]
            yield from RULES["unattributed"].at(
                obs,
                table,
                lost,
                some_of(missing) or "no name",
                taken="taken as unattributed blocks"
                if TABLE_TYPES[table].may_be_loose
                else "mass, size and release are unknown",
                nearest=nearest_of(missing[0], sorted(known)) if missing else "",
            )
        names = obs.rocks.rock_id.tolist()
        orphans = np.array([parent_of(n) and root_of(n, known) == n for n in names], np.bool_)
        name = next(iter(obs.rocks.rock_id[orphans].tolist()), "")
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
                nearest = nearest_of(missing[0], names)
                found = some_of([name for name in missing if name]) or "no name"
                yield from RULES[rule].at(obs, "passages", mask, found, nearest=nearest)


def _sizes(
    obs: Observations, grid: Grid | None, density_kgm3: float
) -> Iterator[ObservationFinding]:
    """Check axes, volumes, masses and densities against each other."""
    rocks = obs.rocks
    axes = 4.0 / 3.0 * math.pi * rocks.semi_axis_a_m * rocks.semi_axis_b_m * rocks.semi_axis_c_m
    density = np.where(np.isfinite(rocks.density_kgm3), rocks.density_kgm3, density_kgm3)
    volume = np.where(np.isfinite(rocks.volume_m3), rocks.volume_m3, rocks.mass_kg / density)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = axes / volume
    known = np.isfinite(ratio)
    full = known & (ratio > FULL_AXES_RATIO)
    middle = float(np.median(ratio[known])) if known.any() else 1.0
    if middle > FULL_AXES_RATIO:
        found = f"ellipsoids of {middle:,.0f} times the volume of the rocks"
        # Also of full axes in that unit.
        unit = next(
            (u for u, f in AXES_UNITS.items() if f / UNIT_FACTOR < middle < 8.0 * UNIT_FACTOR * f),
            "",
        )
        tonnes = TONNE_KG / UNIT_FACTOR < middle < UNIT_FACTOR * TONNE_KG
        by_mass = ~np.isfinite(rocks.volume_m3[known]).any()
        fault = "tonnes" if tonnes and by_mass else "unit of axes" if unit else "full axes"
        yield from RULES[fault].at(obs, "rocks", known, found, unit=unit)
    elif full.any():
        found = f"an ellipsoid of {ratio[full].max():.1f} times the volume of the rock"
        yield from RULES["large axes"].at(obs, "rocks", full, found)
    if (small := known & (ratio < 1.0 / FULL_AXES_RATIO)).any():
        found = f"an ellipsoid of {ratio[small].min():.2g} times the volume of the rock"
        yield from RULES["small axes"].at(obs, "rocks", small, found)
    for name, table in obs.tables.items():
        numbers = table.numbers
        if not {"mass_kg", "volume_m3"} <= numbers.keys():
            continue
        with np.errstate(invalid="ignore", divide="ignore"):
            own = numbers["mass_kg"] / numbers["volume_m3"]
        odd = np.isfinite(own) & ((own < LIGHTEST_ROCK_KGM3) | (own > HEAVIEST_ROCK_KGM3))
        middle = float(np.median(own[odd])) if odd.any() else math.nan
        # In kg/m³ of a rock: between, where tonnes were meant; above, grams or litres.
        unit = "tonnes" if 0.9 <= middle <= 5.0 else "grams or litres" if middle > 1e5 else ""
        rule = RULES["unit of mass" if unit else "mass and volume"]
        yield from rule.at(obs, name, odd, f"{middle:.3g} kg/m³", unit=unit)
    density = rocks.density_kgm3
    odd = np.isfinite(density) & ((density < LIGHTEST_ROCK_KGM3) | (density > HEAVIEST_ROCK_KGM3))
    middle = float(np.median(density[odd])) if odd.any() else math.nan
    problem = "look like g/cm³" if middle < 6.0 else "not the density of a rock"
    yield from RULES["density"].at(obs, "rocks", odd, f"{middle:.4g}", problem=problem)


def _pieces(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Yield findings on fragments that weigh more than their rock."""
    owner, rocks = obs.rock_of("deposits"), np.array(obs.rock_names)
    # Both were weighed.
    error = stated_or(obs.metadata.mass_error_rel, MASS_ERROR_REL)
    room = 1.0 + SIGMAS * math.sqrt(2.0) * error
    for column, unit in (("mass_kg", "kg"), ("volume_m3", "m³")):
        values, whole = obs.deposits.numbers[column], obs.of_rocks(obs.rocks.numbers[column])
        known = np.isfinite(values)
        lying = np.array([values[known & (owner == i)].sum() for i in range(whole.size)])
        heavy = np.flatnonzero(lying > room * whole)
        if heavy.size:
            # Scales are wrong for many at once: that is one thing to say.
            names = rocks[heavy].tolist()
            worst = int(np.argmax(lying[heavy] / whole[heavy]))
            of = f" of {names[worst]}" if len(names) > 1 else ""
            found, most = lying[heavy[worst]], room * whole[heavy[worst]]
            yield from RULES["heavy pieces"].at(
                obs, "deposits", known & np.isin(owner, heavy), f"{found:.4g} {unit}{of}", column,
                name=some_of(names, str), most=f"{most:.4g} {unit}",
            )  # fmt: skip


def empty_tables(observations: Observations, read: Iterable[str]) -> list[ObservationFinding]:
    """Return findings on tables that hold nothing, and on none at all that can be used."""
    found = [
        ObservationFinding(
            "warning", "table has no rows", str(observations.files.get(name, "")), name
        )
        for name in read
        if name in TABLES and not len(observations.tables[name])
    ]
    if not any(len(observations.tables[name]) for name in POINT_TABLES):
        counted = Counter(read)
        found.append(
            ObservationFinding(
                "error",
                "holds no observed rock",
                str(next(iter(observations.files.values()), "")),
                found=", ".join(counted) or "no table",
                expected=f"rows in {', '.join(POINT_TABLES[1:-1])} or {POINT_TABLES[-1]}",
            )
        )
    return found


def check_near_stations(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Yield findings on passages far from the station that they name."""
    passages, lines = obs.passages, station_lines(obs)
    room = max(5.0, SIGMAS * stated_or(obs.metadata.position_error_m, POSITION_ERROR_M))
    far, worst = np.zeros(len(passages), np.bool_), 0.0
    for i, name in enumerate(passages.station.tolist()):
        if name in lines and math.isfinite(passages.x[i] + passages.y[i]):
            away = float(lines[name].distance(shapely.Point(passages.x[i], passages.y[i])))
            far[i] = away > room
            worst = max(worst, away)
    yield from RULES["far from station"].at(obs, "passages", far, f"up to {worst:.1f} m", room=room)


def check_downhill(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Yield findings on passages that climb, lie above the release, or are out of order."""
    passages = obs.passages
    yield from _impacts_above_release(obs, grid)
    if not len(passages):
        return
    own = passages.z - np.nan_to_num(passages.height_m)
    level = own.copy()
    if grid is not None:
        ground = heights_at(grid, passages.x, passages.y)
        level = np.where(np.isfinite(ground), ground, level)
        if len(obs.stations):
            middle = station_heights_m(obs, grid, lowest=False)
            level = np.where(np.isfinite(level), level, middle)
    room = max(2.0, SIGMAS * stated_or(obs.metadata.height_error_m, HEIGHT_ERROR_M))
    owner, rocks = obs.rock_of("passages"), obs.rocks
    # For rocks of unknown release the summit says nothing: only their release counts.
    placed = np.isfinite(rocks.z) | np.isfinite(rocks.x + rocks.y)
    has_release = np.append(obs.of_rocks(placed) == 1.0, False)
    top = tops_m(obs, grid)[owner]
    above = has_release[owner] & (level > top + room)
    if above.any():
        most = np.nanmax((level - top)[above])
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
    names = some_of(passages.station[unordered].tolist())
    yield from RULES["unordered"].at(obs, "passages", unordered, names)


def _impacts_above_release(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    over = above_release_m(obs, grid)
    meta = obs.metadata
    error = stated_or(meta.height_error_m, HEIGHT_ERROR_M)
    error += stated_or(meta.position_error_m, POSITION_ERROR_M)
    above = over > max(2.0, SIGMAS * error)
    if above.any():
        most = f"up to {over[above].max():.1f} m above"
        yield from RULES["impacts above release"].at(obs, "impacts", above, most)


def check_on_the_dem(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Yield findings on places outside the DEM."""
    if grid is None:
        return
    west, south, east, north = grid.bounds
    extent = f"x {west:.0f} to {east:.0f}, y {south:.0f} to {north:.0f}"
    for table in POINT_TABLES:
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
    """Guess how coordinates missed the DEM."""
    if (np.abs(x) <= 180.0).all() and (np.abs(y) <= 90.0).all() and grid.crs:
        return ": the coordinates look like degrees"
    if (grid.cell_of(y, x) >= 0).mean() > 0.5:
        return ": x and y look swapped"
    return ": another coordinate system?"


def check_offsets(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Yield findings on heights in another system than the DEM's, and single heights far off."""
    if grid is None:
        return
    limit = max(
        HEIGHT_OFFSET_M,
        0.5 * grid.cell_size,
        SIGMAS * stated_or(obs.metadata.position_error_m, POSITION_ERROR_M),
    )
    # A rock on its path may fly at any height.
    for table in (name for name in POINT_TABLES if name != "trajectories"):
        numbers = obs.tables[table].numbers
        over = numbers["z"] - heights_at(grid, numbers["x"], numbers["y"])
        if table == "passages":
            over = over - np.nan_to_num(numbers["height_m"])
            # Flying rocks may be high up: only those of known height count.
            over = np.where(np.isfinite(numbers["height_m"]) | (over < 0.0), over, np.nan)
        if table == "rocks":
            # Released from a bucket or a ledge: above the ground is no fault.
            over = np.where((over > 0.0) & (over < RELEASE_HEIGHT_M), 0.0, over)
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
