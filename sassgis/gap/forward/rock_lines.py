"""How the field was observed, and the fall lines of its rocks, made ready for many campaigns.

Simulated rocks are recorded by the same observer before they are compared with observed ones: in
the calibration, in the diagnosis and under its null hypotheses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from sassgis.gap.constants import BESIDE_LINE_M, FEWEST_PAIRS, STRETCH_M
from sassgis.gap.observations.case import (
    Campaign,
    Case,
    Errors,
    ImpactRows,
    errors_of,
    main_blocks,
    observed_campaign,
)
from sassgis.gap.observations.observed import stated_or
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.map_run import Forest
from sassgis.settings.results import ControlLine, ControlLineCrossings, ProfileSet
from sassgis.terrain.release import point_keys


def observer_of(case: Case) -> Errors:
    """Return the observer of a case: as its metadata state, else as its tables show."""
    meta = case.observations.metadata
    seen = observed_campaign(case)
    slowest, apart = 0.0, np.empty(0)
    if seen.impacts is not None:
        into = -seen.impacts.vn_in
        into = into[np.isfinite(into) & (into > 0.0)]
        slowest = float(into.min()) if into.size else 0.0
        apart = _times_apart(case, seen.impacts)
    elif seen.contacts is not None:
        contacts = seen.contacts
        apart = np.diff(contacts.start_s)[np.diff(contacts.rock) == 0]
    soonest = float(apart.min()) if apart.size >= FEWEST_PAIRS else 0.0
    return replace(
        errors_of(case),
        contact_min_normal_speed_mps=stated_or(meta.contact_min_normal_speed_mps, slowest),
        contact_min_interval_s=stated_or(meta.contact_min_interval_s, soonest),
        passages_missed_share=stated_or(meta.passages_missed_share, _missed(case, seen)),
    )


def _times_apart(case: Case, rows: ImpactRows) -> FloatArray:
    """Return times between contacts of a rock that follow each other, as flights take them (s)."""
    first = np.flatnonzero(rows.rock[:-1] == rows.rock[1:])
    _, dip = case.ground_at(rows.rock[first], rows.s[first])
    level = rows.vt_out[first] * np.cos(dip) + rows.vn_out[first] * np.sin(dip)
    way = rows.s[first + 1] - rows.s[first]
    with np.errstate(invalid="ignore", divide="ignore"):
        time = way / level
    # Two places within their error are no distance.
    apart = way > 2.0 * errors_of(case).position_m
    return time[np.isfinite(time) & (time > 0.0) & apart]


def _missed(case: Case, seen: Campaign) -> float:
    """Return the share of missing passages among rocks seen further down or lying there."""
    if seen.passages is None:
        return 0.0
    s = case.station_s
    rows = seen.passages
    own = rows.rock >= 0
    recorded = np.zeros(s.shape, np.bool_)
    recorded[rows.rock[own], rows.station[own]] = True
    furthest = np.where(recorded, s, -np.inf).max(axis=1)
    if seen.deposits is not None:
        main = main_blocks(seen.deposits, case.n_rocks)
        has = main >= 0
        furthest[has] = np.fmax(furthest[has], seen.deposits.s[main[has]])
    tolerance = 2.0 * errors_of(case).stop_m
    with np.errstate(invalid="ignore"):
        passed = (s > case.start[:, 1:2]) & (s < furthest[:, None] - tolerance)
    # A station at which nothing was recorded was not watched.
    passed &= recorded.any(axis=0)
    return float((passed & ~recorded).sum() / max(int(passed.sum()), 1))


def recorded_contacts(
    observer: Errors, rock: IntArray, time_s: FloatArray, into_mps: FloatArray
) -> tuple[IntArray, IntArray]:
    """Return rows of contacts that are recorded, and of the last that each is taken for one with.

    The state before is that of the first, the state after that of the last. Contacts of a rock
    follow each other in ``time_s``; ``into_mps``: speed into the ground; all of shape (n,).
    """
    least = observer.contact_min_normal_speed_mps
    hard = np.flatnonzero((into_mps > 0.0) & (into_mps >= least))
    first: list[int] = []
    last: list[int] = []
    for row in hard.tolist():
        soon = (
            bool(first)
            and rock[row] == rock[first[-1]]
            and time_s[row] - time_s[first[-1]] < observer.contact_min_interval_s
        )
        if soon:
            last[-1] = row
        else:
            first.append(row)
            last.append(row)
    return np.array(first, np.int64), np.array(last, np.int64)


@dataclass(frozen=True, slots=True)
class RockLines:
    """Lines of the rocks of a case, made ready once for many campaigns."""

    # One profile per rock, without stretches and with stretches of STRETCH_M.
    unforested: ProfileSet
    forested: ProfileSet
    wood: Forest | None  # the configured forest on the stretches
    first_m: float  # chainage at which the first stretch begins
    n_stretches: int
    keys: NDArray[np.uint64]  # shape (n_rocks,)
    control_lines: ControlLineCrossings
    #: Where what a rock can reach ends (m), shape (n_rocks,): its profile; followed paths go on.
    end: FloatArray
    #: Where paths are followed: chainage of the nearest fall line at each cell (m), shape
    #: (n_cells,); NaN far away.
    cell_s: FloatArray
    observer: Errors  # of the field


def rock_lines_of(case: Case) -> RockLines:
    """Prepare the lines of the rocks of a case."""
    first = float(np.floor(case.profiles.s.min() / STRETCH_M) * STRETCH_M)
    n_stretches = int(np.ceil((case.profiles.s.max() - first) / STRETCH_M)) + 1
    own = repeated(case.profiles, case.line)
    ends = own.s[np.column_stack([own.offset[:-1], own.offset[1:] - 1])]
    n = case.n_rocks
    # One stretch from end to end, on no cell.
    unforested = replace(
        own, cell_offset=np.arange(n + 1), cell_s=ends.ravel(), cell=np.full(n, -1, np.int64)
    )
    names = case.observations.rock_names
    return RockLines(
        unforested=unforested, forested=_cut_into_stretches(unforested, first),
        wood=_configured_wood(case, first, n_stretches), first_m=first, n_stretches=n_stretches,
        keys=np.concatenate([point_keys(name, 1) for name in names]),
        control_lines=control_lines_of(case),
        end=ends[:, 1] if case.terrain is None else np.full(n, np.inf),
        cell_s=_chainage_of_cells(case), observer=observer_of(case),
    )  # fmt: skip


def _cut_into_stretches(profiles: ProfileSet, first: float) -> ProfileSet:
    """Return profiles with stretches of STRETCH_M for a forest from ``first`` on (m)."""
    borders, cells = [], []
    for i in range(len(profiles)):
        s = profiles.vertices(i)[0]
        low, high = float(s[0]), float(s[-1])
        n0 = int(np.floor((low - first) / STRETCH_M)) + 1
        n1 = int(np.ceil((high - first) / STRETCH_M)) - 1
        inner = first + STRETCH_M * np.arange(n0, n1 + 1)
        inner = inner[(inner > low + 1e-6) & (inner < high - 1e-6)]
        borders.append(np.concatenate([[low], inner, [high]]))
        middle = 0.5 * (borders[-1][1:] + borders[-1][:-1])
        cells.append(np.floor((middle - first) / STRETCH_M).astype(np.int64))
    return replace(
        profiles,
        cell_offset=_offsets([v.size for v in cells]),
        cell_s=np.concatenate(borders),
        cell=np.concatenate(cells),
    )


def _offsets(sizes: ArrayLike) -> IntArray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def _configured_wood(case: Case, first: float, n: int) -> Forest | None:
    """Return the forest of the configuration on the stretches: the mean over the lines."""
    if case.forest is None:
        return None
    source = case.profiles
    # Each profile has one more border than stretches.
    border = np.arange(source.cell.size)
    border += np.repeat(np.arange(len(source)), np.diff(source.cell_offset))
    middle = 0.5 * (source.cell_s[border + 1] + source.cell_s[border])
    known = source.cell >= 0
    k = np.floor((middle[known] - first) / STRETCH_M).astype(np.int64)
    seen = np.maximum(np.bincount(k, minlength=n), 1)
    forest = (case.forest.stems_per_m2, case.forest.diameter_m)
    return Forest(*(np.bincount(k, v[source.cell[known]], minlength=n) / seen for v in forest))


def _chainage_of_cells(case: Case) -> FloatArray:
    """Return the chainage of the nearest vertex of a fall line, of each cell."""
    if case.terrain is None:
        return np.empty(0)
    grid, traces = case.terrain.grid, case.traces
    centres = np.column_stack(grid.cell_centres(np.arange(grid.values.size)))
    tree = cKDTree(np.column_stack([traces.x, traces.y]))
    far, nearest = tree.query(centres, distance_upper_bound=BESIDE_LINE_M)
    return np.append(traces.s, np.nan)[np.where(np.isfinite(far), nearest, -1)]


def gathered(offset: IntArray, which: IntArray) -> tuple[IntArray, IntArray]:
    """Return offsets and entries of some items of a ragged array, each as often as it is named."""
    sizes = np.diff(offset)[which]
    new = _offsets(sizes)
    return new, np.repeat(offset[which] - new[:-1], sizes) + np.arange(new[-1])


def repeated(profiles: ProfileSet, which: IntArray) -> ProfileSet:
    """Return profiles by number, each as often as it is named."""
    offset, vertex = gathered(profiles.offset, which)
    cell_offset, cell = gathered(profiles.cell_offset, which)
    # Borders are one more than stretches on each profile.
    _, border = gathered(profiles.cell_offset + np.arange(profiles.offset.size), which)
    return ProfileSet(
        offset=offset, s=profiles.s[vertex], z=profiles.z[vertex], ground=profiles.ground[vertex],
        cell_offset=cell_offset, cell_s=profiles.cell_s[border], cell=profiles.cell[cell],
    )  # fmt: skip


def control_lines_of(case: Case) -> ControlLineCrossings:
    """Return stations on the line of each rock."""
    order = np.argsort(case.station_s, axis=1, kind="stable")
    s = np.take_along_axis(case.station_s, order, axis=1)
    crossed = np.isfinite(s)
    return ControlLineCrossings(
        tuple(ControlLine(name, "station") for name in case.station_names),
        _offsets(crossed.sum(axis=1)),
        s[crossed],
        order[crossed],
    )


def dips_at(profiles: ProfileSet, profile: IntArray, s: FloatArray) -> FloatArray:
    """Return a profile's dip at a chainage (m), shape (n,), below zero downhill (rad)."""
    k = _segments_at(profiles, profile, s)
    return np.arctan2(profiles.z[k + 1] - profiles.z[k], profiles.s[k + 1] - profiles.s[k])


def heights_at_chainage(profiles: ProfileSet, profile: IntArray, s: FloatArray) -> FloatArray:
    """Return the height of profiles at chainages (m); parameters as ``dips_at``."""
    k = _segments_at(profiles, profile, s)
    share = (np.asarray(s) - profiles.s[k]) / (profiles.s[k + 1] - profiles.s[k])
    return profiles.z[k] + share * (profiles.z[k + 1] - profiles.z[k])


def _segments_at(profiles: ProfileSet, profile: IntArray, s: FloatArray) -> IntArray:
    # All profiles on one axis: each is shifted behind the one before.
    low = float(profiles.s.min()) - 1.0
    span = float(profiles.s.max()) - low + 1.0
    owner = np.repeat(np.arange(len(profiles)), np.diff(profiles.offset))
    axis = profiles.s - low + span * owner
    k = np.searchsorted(axis, np.asarray(s) - low + span * profile, side="right") - 1
    return np.clip(k, profiles.offset[profile], profiles.offset[profile + 1] - 2)
