"""What an observer records of a motion: with which errors, and what is too light or missed.

Simulated rocks are recorded by the same observer before they are compared with observed ones: in
the calibration, in the diagnosis and under its null hypotheses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sassgis.gap.observations.allowances import stated_or
from sassgis.gap.observations.campaign import (
    Campaign,
    Errors,
    ImpactRows,
    errors_of,
    main_blocks,
    observed_campaign,
)
from sassgis.gap.observations.case import Case
from sassgis.model.grid import FloatArray, IntArray

#: Pairs of contacts from which the shortest time between two is taken; fewer say nothing of it.
_FEWEST_PAIRS = 10


@dataclass(frozen=True, slots=True)
class Observer:
    """How a motion is recorded."""

    errors: Errors
    contact_min_normal_speed_mps: float = 0.0  # lighter ones are not recorded
    contact_min_interval_s: float = 0.0  # sooner than this after one: taken for one with it
    passages_missed_share: float = 0.0  # of those at stations


def observer_of(case: Case) -> Observer:
    """The observer of a case: as its metadata state, else as its tables show."""
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
    soonest = float(apart.min()) if apart.size >= _FEWEST_PAIRS else 0.0
    return Observer(
        errors_of(case),
        stated_or(meta.contact_min_normal_speed_mps, slowest),
        stated_or(meta.contact_min_interval_s, soonest),
        stated_or(meta.passages_missed_share, _missed(case, seen)),
    )


def _times_apart(case: Case, rows: ImpactRows) -> FloatArray:
    """Times between contacts of a rock that follow each other, as flights take them (s)."""
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
    """Share of the passages that lack among rocks that were seen further down, or lie there."""
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
    observer: Observer, rock: IntArray, time_s: FloatArray, into_mps: FloatArray
) -> tuple[IntArray, IntArray]:
    """Contacts that are recorded, and the last of those that each is taken for one with.

    Parameters
    ----------
    rock : int64, shape (n,)
        Contacts of a rock follow each other in time.
    time_s : float64, shape (n,)
    into_mps : float64, shape (n,)
        Speed into the ground.

    Returns
    -------
    first, last : int64
        Rows: the state before is that of the first, the state after that of the last.
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
