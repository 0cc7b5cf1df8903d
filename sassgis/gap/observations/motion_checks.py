"""Whether observed motion can be true: impacts, contacts, spins, speeds."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.constants import (
    FAST_ROCKS_SHARE,
    FEWEST_FAST_ROCKS,
    GRAVITY_MPS2,
    HEIGHT_ERROR_M,
    KMH_PER_MPS,
    MILLISECONDS_MPS,
    OTHER_UNIT_SCALE,
    POSITION_ERROR_M,
    RIM_RATIO,
    SCALE_FALL_M,
    SCALE_FLIGHTS,
    SIGMAS,
    SPEED_ERROR_REL,
    USUAL_SCALE,
)
from sassgis.gap.observations.observed import (
    RULES,
    ObservationFinding,
    Observations,
    height_errors_m,
    heights_m,
    rock_masses_kg,
    rock_radii_m,
    stated_or,
    station_heights_m,
    tops_m,
)
from sassgis.gap.observations.projection import contact_order, contacts_of, hops_of
from sassgis.gap.observations.tables import TABLES, Column
from sassgis.grid import FloatArray, Grid, IntArray

#: Rotations in other units, as multiples of turns, and of radians, per second.
_TURNS = {
    "radians per second": 2.0 * math.pi,
    "turns per minute": 60.0,
    "degrees per second": 360.0,
}
_RADIANS = {"turns per minute": 30.0 / math.pi, "degrees per second": 180.0 / math.pi}


def check_impacts(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Check directions, energies and slopes of impacts."""
    impacts = obs.impacts
    inward = impacts.vn_in_mps > 0.0
    known = np.isfinite(impacts.vn_in_mps)
    if inward.any():
        every = bool(inward.sum() > 0.5 * known.sum())
        error = stated_or(obs.metadata.speed_error_rel, SPEED_ERROR_REL)
        within = SIGMAS * error * np.hypot(impacts.vt_in_mps, impacts.vn_in_mps)
        grazing = inward & (impacts.vn_in_mps <= within) & (not every)
        if grazing.any():
            found = f"vn_in = {impacts.vn_in_mps[grazing].max():.3g} m/s"
            yield from RULES["grazing"].at(obs, "impacts", grazing, found)
        yield from RULES["inward"].at(
            obs,
            "impacts",
            inward & ~grazing,
            f"vn_in = {impacts.vn_in_mps[inward].max():.3g} m/s",
            hint=": the normal seems to point into the ground" if every else "",
        )
    yield from _energy_gain(obs, ~inward)
    slopes = np.abs(impacts.slope_deg[np.isfinite(impacts.slope_deg)])
    if slopes.size >= 5 and 0.0 < slopes.max() <= 0.5 * math.pi:
        yield from RULES["radians"].at(
            obs, "impacts", np.isfinite(impacts.slope_deg), f"at most {slopes.max():.3g}"
        )


def _energy_gain(obs: Observations, usable: NDArray[np.bool_]) -> Iterator[ObservationFinding]:
    impacts = obs.impacts
    before = impacts.vt_in_mps**2 + impacts.vn_in_mps**2
    after = impacts.vt_out_mps**2 + impacts.vn_out_mps**2
    rock = obs.rock_of("impacts")
    radius = np.append(rock_radii_m(obs), np.nan)[rock]
    # A fragment is smaller than its rock; of unknown mass, its spin says nothing.
    share = impacts.mass_kg / np.append(rock_masses_kg(obs), np.nan)[rock]
    radius = np.where(obs.is_piece("impacts"), radius * np.cbrt(share), radius)
    # A sphere's 2/5 r²: the rock may turn spin into speed.
    spins = np.isfinite(radius + impacts.omega_in_radps + impacts.omega_out_radps)
    with np.errstate(invalid="ignore"):
        turn = 0.4 * radius**2
        before = np.where(spins, before + turn * impacts.omega_in_radps**2, before)
        after = np.where(spins, after + turn * impacts.omega_out_radps**2, after)
    known = usable & np.isfinite(before) & np.isfinite(after) & (before > 0.0)
    error = stated_or(obs.metadata.speed_error_rel, SPEED_ERROR_REL)
    # Twice the relative error of a speed on each side.
    room = 1.0 + SIGMAS * 2.0 * math.sqrt(2.0) * error
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


def check_times(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Yield findings on contacts that end before they start or overlap, and missing places."""
    seen, order = obs.contacts, contact_order(obs)
    early = seen.t_end_s < seen.t_start_s
    if early.any():
        most = float((seen.t_start_s - seen.t_end_s)[early].max())
        yield from RULES["ends early"].at(obs, "contacts", early, f"by up to {most:.3g} s")
    hops = hops_of(contacts_of(obs))
    over = np.zeros(len(seen), np.bool_)
    over[order[hops.first]] = hops.time_s < 0.0
    yield from RULES["overlap"].at(obs, "contacts", over & ~early)
    yield from RULES["no place"].at(obs, "contacts", ~np.isfinite(seen.x + seen.y))


def check_ways(
    obs: Observations, grid: Grid | None, drop_m: float = 0.0
) -> Iterator[ObservationFinding]:
    """Yield findings on ways that no fall covers; blocks were released up to ``drop_m`` above."""
    contacts, order = contacts_of(obs), contact_order(obs)
    hops = hops_of(contacts)
    here, there = hops.first, hops.first + 1
    start = np.nan_to_num(obs.of_rocks(obs.rocks.release_speed_mps))[hops.rock]
    position_m = stated_or(obs.metadata.position_error_m, POSITION_ERROR_M)
    # Two places may be apart by their errors, however short the time.
    error = SIGMAS * math.sqrt(2.0) * position_m
    drop = np.maximum(tops_m(obs, grid, drop_m)[hops.rock] - contacts.z[there], 0.0) + error
    fastest = np.sqrt(2.0 * GRAVITY_MPS2 * drop + start**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = (hops.length_m - error) / hops.between_s
        ratio = speed / fastest
    fast = ratio > 1.0
    if not fast.any():
        return
    # A place that is too far from both neighbours is wrong; else the later one may be.
    sides, far = np.zeros((2, order.size))
    for rows in (here, there):
        sides[rows] += np.isfinite(ratio)
        far[rows] += fast
    wrong = (far > 0.0) & (far == sides)
    wrong[there[fast & ~wrong[here]]] = True
    i = int(np.argmax(np.where(fast, ratio, 0.0)))
    found = f"{hops.length_m[i]:.1f} m in {hops.between_s[i]:.3g} s"
    yield from RULES["too far"].at(obs, "contacts", order[wrong], found, fastest=fastest[i])


def check_spins(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Check spins against speeds: the unit of rotation."""
    radii = np.append(rock_radii_m(obs), np.nan)
    for table, columns in TABLES.items():
        numbers = obs.tables[table].numbers
        for own in (own for own in columns if own.rim_of):
            spin, speed = numbers[own.name], numbers[own.rim_of]
            yield from _odd_spins(obs, table, own, spin, speed, radii[obs.rock_of(table)])
    hops, seen = hops_of(contacts_of(obs)), obs.contacts
    rows = contact_order(obs)[hops.first]
    spin, speed = np.full((2, len(seen)), np.nan)
    spin[rows], speed[rows] = hops.rotation_hz, hops.speed_mps
    both = Column("1/s", "", name="rotation_before_hz, rotation_after_hz")
    yield from _odd_spins(obs, "contacts", both, spin, speed, radii[obs.rock_of("contacts")])


def _odd_spins(
    obs: Observations,
    table: str,
    own: Column,
    spin: FloatArray,
    speed: FloatArray,
    radius: FloatArray,
) -> Iterator[ObservationFinding]:
    """Yield findings on spins that are too fast for the speeds, row by row."""
    turns = own.unit == "1/s"
    factor = 2.0 * math.pi if turns else 1.0
    unit = f"{'turns' if turns else 'radians'} per second"
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = factor * np.abs(spin) * radius / np.abs(speed)
    known = np.isfinite(ratio) & (np.abs(speed) > 1.0)
    if known.sum() < 3:
        return
    middle = float(np.median(ratio[known]))
    if middle <= RIM_RATIO:
        return
    # Rims of rocks move at a third of their speed, or up to a little more than it.
    others = _TURNS if turns else _RADIANS
    guess = next((u for u, f in others.items() if f / 3.0 < middle < 1.2 * f), "")
    found = f"rims {middle:.1f} times as fast as the rocks"
    # Speeds of hops follow from the places: all spins of a table are in one unit.
    rows = known if own.rim_of else np.ones(known.size, np.bool_)
    rule = RULES["spin" if guess else "odd spin"]
    yield from rule.at(obs, table, rows, found, own.name, guess=guess, unit=unit)


def check_trajectory_speeds(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Check speeds along a path against the path and the clock."""
    path = obs.trajectories
    # Nearer points are apart by the errors of their positions.
    span = max(2.0, 8.0 * stated_or(obs.metadata.position_error_m, POSITION_ERROR_M))
    ratios, means = [], []
    known = np.flatnonzero(np.isfinite(path.t_s + path.x + path.y))
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
        far = float(np.sqrt((np.diff(points[kept], axis=0) ** 2).sum(axis=1)).sum())
        if not far:
            continue
        time = path.t_s[rows]
        means.append(far / max(float(time[kept[-1]] - time[0]), 1e-9))
        speed = path.speed_mps[rows]
        timed = np.isfinite(speed)
        if timed.sum() > 0.5 * timed.size:
            # One number per rock: errors of single positions cancel along the path.
            speed = np.interp(time, time[timed], speed[timed])
            steps = np.diff(time) * 0.5 * (speed[1:] + speed[:-1])
            ratios.append(float(steps[: kept[-1]].sum() / far))
    if means and np.median(means) < MILLISECONDS_MPS:
        slow = f"{np.median(means):.3g} m/s along the paths"
        yield from RULES["milliseconds"].at(obs, "trajectories", np.isfinite(path.t_s), slow)
        return
    if not ratios:
        return
    middle = float(np.median(ratios))
    if 0.7 <= middle <= 1.4:
        return
    named = {KMH_PER_MPS: "km/h", 1.0 / 0.3048: "feet per second", 1e-3: "km/s"}
    unit = next((u for f, u in named.items() if 0.93 * f < middle < 1.07 * f), None)
    yield from RULES["unit of speed" if unit else "speed and time"].at(
        obs,
        "trajectories",
        np.isfinite(path.speed_mps),
        f"{middle:.2f} times the distance over the time",
        unit=unit,
    )


def _apart(points: FloatArray, span: float) -> IntArray:
    """Thin a path to points ``span`` or more from the one before, with the first."""
    kept = [0]
    for i in range(1, len(points)):
        if ((points[i] - points[kept[-1]]) ** 2).sum() >= span**2:
            kept.append(i)
    return np.array(kept, np.int64)


def fall_scale(obs: Observations, grid: Grid | None) -> tuple[float, float, int]:
    """Return speeds at impacts over those that the falls between them give: middle, bound, flights.

    Energy gained from one impact to the next over that of the fall is the square of it. Air, stems
    and impacts that were not recorded only take energy, so that a scale above 1 is certain. The
    bound is that of 97.5 %, by order statistics of the flights.
    """
    hit = obs.impacts
    order = np.lexsort((hit.number, hit.rock_id))
    z, rock = heights_m(hit, grid)[order], hit.rock_id[order]
    into = (hit.vt_in_mps**2 + hit.vn_in_mps**2)[order]
    out = (hit.vt_out_mps**2 + hit.vn_out_mps**2)[order]
    fell = 2.0 * GRAVITY_MPS2 * (z[:-1] - z[1:])
    own = (rock[:-1] == rock[1:]) & (fell > 2.0 * GRAVITY_MPS2 * SCALE_FALL_M)
    ratios = (into[1:] - out[:-1])[own] / fell[own]
    known = np.sort(ratios[np.isfinite(ratios)])
    if known.size < SCALE_FLIGHTS:
        return 1.0, 1.0, int(known.size)
    low = max(int(0.5 * known.size - 0.98 * math.sqrt(known.size)), 0)
    middle, bound = np.sqrt(np.maximum([np.median(known), known[low]], 0.0)).tolist()
    return middle, bound, int(known.size)


def check_drops(
    obs: Observations, grid: Grid | None, drop_m: float = 0.0
) -> Iterator[ObservationFinding]:
    """Yield findings on speeds that no drop explains; releases lay up to ``drop_m`` above."""
    top = tops_m(obs, grid, drop_m)
    fast = [(table, own) for table, columns in TABLES.items() for own in columns if own.from_drop]
    scale, certain, flights = fall_scale(obs, grid)
    speeds = np.isfinite(obs.impacts.vt_in_mps)
    if certain >= OTHER_UNIT_SCALE:
        found = f"{scale:.1f} times what the falls between impacts give, {flights} flights"
        yield from RULES["unit of impacts"].at(obs, "impacts", speeds, found)
        fast = [(table, own) for table, own in fast if table != "impacts"]
    elif certain < USUAL_SCALE:
        scale = 1.0
    else:
        yield from RULES["scale"].at(
            obs,
            "impacts",
            speeds,
            f"{100.0 * (scale - 1.0):.0f} % more than the falls between impacts give, at least "
            f"{100.0 * (certain - 1.0):.0f} %, {flights} flights",
        )
    # Unattributed blocks, the last, start at rest, as do rocks of which it is not known.
    start = np.append(obs.of_rocks(obs.rocks.release_speed_mps), 0.0)
    start = np.where(np.isfinite(start), start, 0.0)
    error = stated_or(obs.metadata.speed_error_rel, SPEED_ERROR_REL)
    height_m = stated_or(obs.metadata.height_error_m, HEIGHT_ERROR_M)
    position_m = stated_or(obs.metadata.position_error_m, POSITION_ERROR_M)
    of_top = np.append(obs.of_rocks(height_errors_m(obs.rocks, grid, position_m)), 0.0)
    for table, own in fast:
        data, column = obs.tables[table], own.name
        speed = np.sqrt(sum(data.numbers[name] ** 2 for name in own.from_drop))
        owner = obs.rock_of(table)
        z = heights_m(data, grid)
        if table == "passages" and len(obs.stations):
            z = np.where(np.isfinite(z), z, station_heights_m(obs, grid, lowest=True))
        of_place = np.hypot(height_errors_m(data, grid, position_m), np.nan_to_num(of_top)[owner])
        drop = np.maximum(top[owner] - z, 0.0) + SIGMAS * np.hypot(height_m, of_place)
        fastest = np.sqrt(2.0 * GRAVITY_MPS2 * drop + start[owner] ** 2)
        ratio = speed / fastest
        known = np.isfinite(ratio)
        # Rows that only a wrong scale makes too fast are right but for that.
        room = (scale if table == "impacts" else 1.0) * (1.0 + SIGMAS * error)
        too_fast = known & (ratio > room)
        if not too_fast.any():
            continue
        worst = int(np.flatnonzero(too_fast)[np.argmax(ratio[too_fast])])
        says = (
            f"{speed[worst]:.1f} m/s after a drop of {drop[worst]:.1f} m in row {data.row[worst]}"
        )
        many = too_fast.sum() > 0.4 * known.sum() and known.sum() >= 3
        # By how much each rock would have to start higher for its speeds (m).
        lacking = ((speed / room) ** 2 - fastest**2) / (2.0 * GRAVITY_MPS2)
        attributed = too_fast & (owner >= 0)
        low, at = np.unique(owner[attributed], return_inverse=True)
        missing = np.zeros(low.size)
        np.maximum.at(missing, at, lacking[attributed])
        rocks = np.unique(owner[known & (owner >= 0)]).size
        explained = np.mean(ratio[known] / KMH_PER_MPS <= 1.0 + SIGMAS * error) > 0.9
        if many and explained:
            rule, rows = RULES["km/h"], known
            says = f"median {np.median(speed[known]):.1f}; {says}"
        elif not many and missing.size >= max(FEWEST_FAST_ROCKS, FAST_ROCKS_SHARE * rocks):
            # What is missing at a slow contact says little: those that lack most show the start.
            more = float(np.quantile(missing, 0.9))
            words = {"rocks": missing.size, "all": rocks, "more": more}
            yield from RULES["start too low"].at(obs, table, too_fast, says, column, **words)
            continue
        else:
            rule, rows = RULES["mostly too fast" if many else "too fast"], too_fast
        yield from rule.at(obs, table, rows, says, column, fastest=fastest[worst])
