"""Whether observations can be true: against themselves, gravity and the terrain."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial

import numpy as np

from sassgis.gap.observations.allowances import POSITION_ERROR_M, stated_or
from sassgis.gap.observations.motion_checks import (
    check_drops,
    check_impacts,
    check_spins,
    check_trajectory_speeds,
)
from sassgis.gap.observations.observation_finding import ObservationFinding
from sassgis.gap.observations.observed import Observations, parent_of, root_of, without
from sassgis.gap.observations.place_checks import (
    check_downhill,
    check_near_stations,
    check_offsets,
    check_on_the_dem,
)
from sassgis.gap.observations.rules import RULES, nearest_of, some_of
from sassgis.gap.observations.size_checks import check_pieces, check_sizes
from sassgis.gap.observations.tables import POINT_TABLES, TABLE_TYPES, TABLES
from sassgis.model.grid import Grid

Check = Callable[[Observations, Grid | None], Iterator[ObservationFinding]]


def check_observations(
    observations: Observations, grid: Grid | None = None, drop_m: float = 0.0
) -> list[ObservationFinding]:
    """Look for what cannot be true.

    Parameters
    ----------
    observations : Observations
        In the coordinates of the grid.
    grid : Grid, optional
        The DEM; without it, nothing is compared with the terrain.
    drop_m : float
        Height above the ground from which blocks were let go, at most.

    Returns
    -------
    list of ObservationFinding
        Errors first. What a finding says is left out is still in ``observations``: see
        ``sassgis.gap.observations.tables.without``.
    """
    found: list[ObservationFinding] = []
    left = observations
    drops: Check = partial(check_drops, drop_m=drop_m)
    for check in (*_CHECKS, drops):
        # What one check leaves out is not found again by the next, under another name.
        new = list(check(left, grid))
        found += new
        left = without(left, new)
    return sorted(found, key=lambda f: f.level != "error")


def _identifiers(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Names that are used twice where they must name one thing."""
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
    """Stops of one name: one entered twice, or pieces without a suffix."""
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
    name = str(deposits.rock_id[pieces][0]) if pieces.any() else ""
    yield from RULES["several stops"].at(obs, "deposits", pieces, repr(name), name=name)


def _belonging(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Rocks and stations that the other tables know nothing of."""
    if len(obs.rocks):
        known = set(obs.rocks.rock_id.tolist())
        for table in (name for name in POINT_TABLES if name != "rocks"):
            lost = obs.rock_of(table) < 0
            if not lost.any():
                continue
            ids: list[str] = obs.tables[table].rock_id[lost].tolist()  # type: ignore[attr-defined]
            missing = list(dict.fromkeys(i for i in ids if i))
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
                nearest = nearest_of(missing[0], names)
                found = some_of([name for name in missing if name]) or "no name"
                yield from RULES[rule].at(obs, "passages", mask, found, nearest=nearest)


def empty_tables(observations: Observations, read: Iterable[str]) -> list[ObservationFinding]:
    """Tables that are there and hold nothing, and none at all that can be used."""
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


#: In this order: names first, then places, then what hangs on them.
_CHECKS: tuple[Check, ...] = (
    _identifiers,
    _same_stop,
    _belonging,
    check_on_the_dem,
    check_offsets,
    check_sizes,
    check_pieces,
    check_near_stations,
    check_downhill,
    check_impacts,
    check_spins,
    check_trajectory_speeds,
)
