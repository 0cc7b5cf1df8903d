"""Observed and simulated campaigns in one form: what each rock was seen to do, in its plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.constants import (
    MASS_ERROR_REL,
    PASSING_HEIGHT_ERROR_M,
    POSITION_ERROR_M,
    ROTATION_ERROR_REL,
    SPEED_ERROR_REL,
    TURN_ERROR_DEG,
)
from sassgis.gap.observations.case import Case
from sassgis.gap.observations.hops import ContactRows, contacts_of
from sassgis.gap.observations.observed import deposit_masses_kg, stated_or
from sassgis.grid import FloatArray, IntArray

#: Kinds of block: the rock itself, a fragment of it, a block that belongs to no rock.
WHOLE, PIECE, LOOSE = 0, 1, 2


@dataclass(frozen=True, slots=True)
class PassageRows:
    """Passages at stations, columns of shape (n,); NaN where a number was not measured."""

    rock: IntArray  # -1 for a loose block
    station: IntArray  # position in ``Case.station_names``
    kind: IntArray
    lateral_m: FloatArray
    speed_mps: FloatArray
    rotation_hz: FloatArray
    height_m: FloatArray  # of the centre above the ground
    mass_kg: FloatArray


@dataclass(frozen=True, slots=True)
class DepositRows:
    """Blocks where they lie; columns as in PassageRows, ``s`` the chainage (m)."""

    rock: IntArray
    kind: IntArray
    s: FloatArray
    lateral_m: FloatArray
    mass_kg: FloatArray


@dataclass(frozen=True, slots=True)
class ImpactRows:
    """Impacts of whole rocks in the order of time, before and after; columns of shape (n,)."""

    rock: IntArray
    # Chainage and height of the point or the centre (m).
    s: FloatArray
    z: FloatArray
    # Along the ground and its outward normal (m/s), spin (rad/s).
    vt_in: FloatArray
    vn_in: FloatArray
    spin_in: FloatArray
    vt_out: FloatArray
    vn_out: FloatArray
    spin_out: FloatArray
    turn_deg: FloatArray  # in plan, clockwise; NaN of rocks that tumble on (``Case.turns``)
    slope_deg: FloatArray  # dip of the ground along the travel


@dataclass(frozen=True, slots=True)
class Campaign:
    """One campaign; a table that was not observed is None."""

    n_rocks: int
    passages: PassageRows | None
    deposits: DepositRows | None
    impacts: ImpactRows | None
    contacts: ContactRows | None = None


@dataclass(frozen=True, slots=True)
class Errors:
    """How a motion is recorded: standard errors, stated or usual, and what is not seen."""

    speed_rel: float = SPEED_ERROR_REL
    rotation_rel: float = ROTATION_ERROR_REL
    height_m: float = PASSING_HEIGHT_ERROR_M
    position_m: float = POSITION_ERROR_M
    turn_deg: float = TURN_ERROR_DEG
    mass_rel: float = MASS_ERROR_REL
    stop_m: float = POSITION_ERROR_M  # of the place of a stop; ``position_m``: of any other
    contact_min_normal_speed_mps: float = 0.0  # lighter contacts are not recorded
    contact_min_interval_s: float = 0.0  # sooner than this after one: taken for one with it
    passages_missed_share: float = 0.0  # of those at stations


def errors_of(case: Case) -> Errors:
    """Return errors of measurement of the observations of a case."""
    meta, usual = case.observations.metadata, Errors()
    position_m = stated_or(meta.position_error_m, usual.position_m)
    return Errors(
        stated_or(meta.speed_error_rel, usual.speed_rel),
        stated_or(meta.rotation_error_rel, usual.rotation_rel),
        stated_or(meta.height_error_m, usual.height_m), position_m,
        mass_rel=stated_or(meta.mass_error_rel, usual.mass_rel),
        stop_m=stated_or(meta.stop_error_m, position_m),
    )  # fmt: skip


def observed_campaign(case: Case) -> Campaign:
    """Return the observed campaign of a case."""
    seen = case.observations
    return Campaign(
        case.n_rocks,
        _passages(case) if len(seen.passages) and case.station_names else None,
        _deposits(case) if len(seen.deposits) else None,
        _impacts(case) if len(seen.impacts) else None,
        contacts_of(seen) if len(seen.contacts) else None,
    )


def _kinds(case: Case, table: str) -> tuple[IntArray, IntArray]:
    rock = case.observations.rock_of(table)
    kind = np.where(rock < 0, LOOSE, np.where(case.observations.is_piece(table), PIECE, WHOLE))
    return rock, kind.astype(np.int64)


def _passages(case: Case) -> PassageRows:
    table = case.observations.passages
    rock, kind = _kinds(case, "passages")
    station = case.passed_station
    # A station that the fall line of a rock does not cross has no place on it, here as in replicas.
    known = (station >= 0) & ((rock < 0) | np.isfinite(case.station_s[rock, station]))
    columns: tuple[Any, ...] = (
        rock, station, kind, case.projected["passages"].lateral_m,
        table.speed_mps, table.rotation_hz, table.height_m, table.mass_kg,
    )  # fmt: skip
    return PassageRows(*(values[known] for values in columns))


def _deposits(case: Case) -> DepositRows:
    put = case.projected["deposits"]
    mass_kg = deposit_masses_kg(case.observations)
    return DepositRows(*_kinds(case, "deposits"), put.s, put.lateral_m, mass_kg)


def _impacts(case: Case) -> ImpactRows:
    table = case.observations.impacts
    rock, kind = _kinds(case, "impacts")
    put = case.projected["impacts"]
    order = np.lexsort((table.number, rock))
    order = order[kind[order] == WHOLE]
    turn_deg = case.turns(rock, table.turn_deg, table.vt_out_mps, table.vn_out_mps)
    columns: tuple[Any, ...] = (
        rock, put.s, np.where(np.isfinite(table.z), table.z, put.ground_m),
        table.vt_in_mps, table.vn_in_mps, table.omega_in_radps,
        table.vt_out_mps, table.vn_out_mps, table.omega_out_radps,
        turn_deg, table.slope_deg,
    )  # fmt: skip
    return ImpactRows(*(values[order] for values in columns))


def main_blocks(rows: DepositRows, n_rocks: int) -> NDArray[np.int64]:
    """Return the row of the heaviest block of each rock, of unknown masses the first; or -1."""
    best = np.full(n_rocks, -1, np.int64)
    own = np.flatnonzero(rows.rock >= 0)
    mass = np.where(np.isfinite(rows.mass_kg), rows.mass_kg, 0.0)[own]
    # Written last: the heaviest, and among equals the first row.
    for i in own[np.lexsort((-own, mass))].tolist():
        best[rows.rock[i]] = i
    return best
