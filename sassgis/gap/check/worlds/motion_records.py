"""What is recorded of a moving block: deposits, passages, impacts, tracks."""

from __future__ import annotations

import math

from sassgis.gap.check.worlds.motion_state import (
    COUNT,
    DENSITY,
    HX,
    HY,
    KIND,
    PIECE,
    SPIN,
    TIME,
    Field,
    Tables,
    X,
    Y,
    Z,
    mass_of,
    speed_of,
)
from sassgis.gap.check.worlds.slopes import height_at
from sassgis.model.grid import FloatArray
from sassgis.model.jit import kernel


@kernel
def _name_block(row: FloatArray, st: FloatArray, rock: int) -> None:
    row[0] = rock
    row[1] = st[PIECE]
    row[2] = st[KIND]


@kernel
def write_deposit(f: Field, st: FloatArray, rock: int, tables: Tables) -> None:
    """Record where a block stopped."""
    k = tables.used[0]
    tables.used[0] += 1
    if k < tables.deposits.shape[0]:
        row = tables.deposits[k]
        _name_block(row, st, rock)
        row[3] = st[X]
        row[4] = st[Y]
        row[5] = height_at(f.z, f.west, f.north, f.cell, st[X], st[Y])
        row[6] = mass_of(st)
        row[7] = mass_of(st) / st[DENSITY]


@kernel
def write_passage(f: Field, st: FloatArray, rock: int, station: int, tables: Tables) -> None:
    """Record a block at a station."""
    k = tables.used[1]
    tables.used[1] += 1
    if k < tables.passages.shape[0]:
        row = tables.passages[k]
        _name_block(row, st, rock)
        row[3] = station
        row[4] = st[X]
        row[5] = st[Y]
        row[6] = st[Z]
        row[7] = speed_of(st)
        row[8] = abs(st[SPIN]) / (2.0 * math.pi)
        row[9] = st[Z] - height_at(f.z, f.west, f.north, f.cell, st[X], st[Y])
        row[10] = mass_of(st)


@kernel
def write_impact(
    f: Field,
    st: FloatArray,
    rock: int,
    px: float,
    py: float,
    speeds: FloatArray,
    old_hx: float,
    old_hy: float,
    tables: Tables,
) -> None:
    """Record an impact, before and after."""
    k = tables.used[2]
    tables.used[2] += 1
    if k < tables.impacts.shape[0]:
        row = tables.impacts[k]
        _name_block(row, st, rock)
        row[3] = st[COUNT]
        row[4] = px
        row[5] = py
        row[6] = height_at(f.z, f.west, f.north, f.cell, px, py)
        row[7:14] = speeds
        # Azimuths grow clockwise: to the right is positive.
        row[14] = math.degrees(
            math.atan2(old_hy * st[HX] - old_hx * st[HY], old_hx * st[HX] + old_hy * st[HY])
        )
        row[15] = mass_of(st)
        row[16] = st[TIME]


@kernel
def write_track(st: FloatArray, rock: int, tables: Tables) -> None:
    """Record a point along the path."""
    k = tables.used[3]
    tables.used[3] += 1
    if k < tables.tracks.shape[0]:
        row = tables.tracks[k]
        _name_block(row, st, rock)
        row[3] = st[TIME]
        row[4] = st[X]
        row[5] = st[Y]
        row[6] = st[Z]
        row[7] = speed_of(st)
        row[8] = abs(st[SPIN]) / (2.0 * math.pi)
