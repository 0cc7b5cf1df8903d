"""All that was observed on a slope: tables, metadata, and what was found wrong with them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.observations.observation_finding import ObservationFinding
from sassgis.gap.observations.tables import (
    POINT_TABLES,
    TABLES,
    Contacts,
    Deposits,
    Impacts,
    Metadata,
    Passages,
    Rocks,
    Stations,
    Table,
    Trajectories,
)
from sassgis.model.declared import Input
from sassgis.model.grid import BoolArray, FloatArray, IntArray

#: Density where none is observed (kg/m³), to get a size from a mass.
DENSITY_KGM3 = 2700.0


@dataclass(frozen=True, slots=True)
class Observations:
    """All that was observed, in the coordinates of the DEM; tables of length 0 where nothing."""

    rocks: Rocks = field(default_factory=Rocks.of)
    stations: Stations = field(default_factory=Stations.of)
    passages: Passages = field(default_factory=Passages.of)
    impacts: Impacts = field(default_factory=Impacts.of)
    contacts: Contacts = field(default_factory=Contacts.of)
    deposits: Deposits = field(default_factory=Deposits.of)
    trajectories: Trajectories = field(default_factory=Trajectories.of)
    metadata: Metadata = field(default_factory=Metadata)
    #: By table, for messages; empty for observations that come from no file.
    files: Mapping[str, Input] = field(default_factory=dict)
    findings: tuple[ObservationFinding, ...] = ()  # found, and left out, while reading

    @property
    def tables(self) -> Mapping[str, Table]:
        """Tables by name."""
        return {name: getattr(self, name) for name in TABLES}

    @property
    def present(self) -> Mapping[str, frozenset[str]]:
        """Columns of numbers that hold any, by table; tables without rows are not named."""
        return {name: table.present for name, table in self.tables.items() if len(table)}

    @property
    def rock_names(self) -> tuple[str, ...]:
        """Names of the rocks, which are the units of resampling.

        Those of the table of rocks, less the pieces listed there; if there is no such table, all
        that turn up anywhere.
        """
        if len(self.rocks):
            known = set(self.rocks.rock_id.tolist())
            return tuple(n for n in self.rocks.rock_id.tolist() if root_of(n, known) == n)
        tables = (self.tables[name] for name in POINT_TABLES)
        ids = [name for table in tables for name in table.rock_id.tolist() if name]
        known = set(ids)
        return tuple(dict.fromkeys(root_of(name, known) for name in ids))

    def rock_of(self, table: str) -> IntArray:
        """Place in ``rock_names`` of the rock that each row of a table belongs to.

        Pieces belong to the rock they broke from. -1: an unattributed block.
        """
        place = {name: i for i, name in enumerate(self.rock_names)}
        ids = self.tables[table].rock_id.tolist()
        found = {name: place.get(root_of(name, place), -1) for name in set(ids)}
        return np.array([found[name] for name in ids], np.int64)

    def is_piece(self, table: str) -> NDArray[np.bool_]:
        """Whether each row of a table is about a piece of a rock rather than a whole rock."""
        owner = self.rock_of(table)
        # Of an unattributed block the last name is taken, which does not count.
        names = np.array([*self.rock_names, ""])[owner]
        return np.asarray((owner >= 0) & (names != self.tables[table].rock_id), np.bool_)

    def whole_of(self, table: str) -> IntArray:
        """Place in ``rock_names`` of the rock of each row; -1: a piece of one, or unattributed."""
        return np.where(self.is_piece(table), -1, self.rock_of(table))

    def of_rocks(self, values: FloatArray | BoolArray) -> FloatArray:
        """A column of the table of rocks, in the order of ``rock_names``; NaN for other rocks."""
        stated = dict(zip(self.rocks.rock_id.tolist(), values.tolist(), strict=True))
        return np.array([stated.get(name, math.nan) for name in self.rock_names], np.float64)

    def paths_of_rocks(self, needed: FloatArray | float = 0.0) -> dict[int, IntArray]:
        """Rows of ``trajectories`` of each whole rock by time, those with a place and, if
        given, a number in ``needed``.
        """
        track = self.trajectories
        if not len(track):
            return {}
        rock = self.whole_of("trajectories")
        own = (rock >= 0) & np.isfinite(track.t_s + track.x + track.y + track.z + needed)
        order = np.lexsort((track.t_s, rock))
        order = order[own[order]]
        edges = np.flatnonzero(np.diff(rock[order])) + 1
        return {int(rock[rows[0]]): rows for rows in np.split(order, edges) if rows.size}


def parent_of(rock_id: str) -> str | None:
    """Rock that a piece broke from, by its name alone: R7 for R7.2; None without a suffix."""
    stem, dot, suffix = rock_id.rpartition(".")
    return stem if dot and stem and suffix else None


def root_of(rock_id: str, known: Iterable[str]) -> str:
    """The whole rock that a name goes back to: of a piece, or of a piece of a piece (R7.2.1).

    The shortest name in use that is left when suffixes are taken off; the name itself if there is
    none. ``known``: names in use; a set makes it fast.
    """
    found, name = rock_id, rock_id
    while (parent := parent_of(name)) is not None:
        name = parent
        if name in known:
            found = name
    return found


def rock_masses_kg(observations: Observations) -> FloatArray:
    """Mass of each rock of ``rock_names`` (kg): as weighed, else from its volume; NaN unknown."""
    rocks = observations.rocks
    density = np.where(np.isfinite(rocks.density_kgm3), rocks.density_kgm3, DENSITY_KGM3)
    axes = rocks.semi_axis_a_m * rocks.semi_axis_b_m * rocks.semi_axis_c_m
    volume = np.where(np.isfinite(rocks.volume_m3), rocks.volume_m3, 4.0 / 3.0 * math.pi * axes)
    mass = np.where(np.isfinite(rocks.mass_kg), rocks.mass_kg, density * volume)
    return observations.of_rocks(mass)


def deposit_masses_kg(observations: Observations) -> FloatArray:
    """Mass of each deposited block (kg): as weighed, else from its volume; NaN unknown."""
    own = observations.deposits
    return np.where(np.isfinite(own.mass_kg), own.mass_kg, DENSITY_KGM3 * own.volume_m3)


def rock_radii_m(observations: Observations) -> FloatArray:
    """Radius of the sphere of equal mass of each rock of ``rock_names`` (m); NaN unknown."""
    density = observations.of_rocks(observations.rocks.density_kgm3)
    density = np.where(np.isfinite(density), density, DENSITY_KGM3)
    return np.cbrt(3.0 * rock_masses_kg(observations) / (4.0 * math.pi * density))


def without(observations: Observations, findings: Iterable[ObservationFinding]) -> Observations:
    """Leave out what findings say is left out: values, rows or tables.

    The findings are kept with the observations.
    """
    tables: dict[str, Table] = dict(observations.tables)
    new = tuple(f for f in findings if f not in observations.findings)
    for finding in new:
        if finding.table not in tables or not finding.left_out:
            continue
        table = tables[finding.table]
        hit = np.isin(table.row, finding.rows)
        if finding.left_out == "table":
            tables[finding.table] = table.take(np.zeros(len(table), np.bool_))
        elif finding.left_out == "row":
            tables[finding.table] = table.take(~hit)
        else:
            values = {
                c: np.where(hit, np.nan, getattr(table, c)) for c in finding.column.split(", ")
            }
            tables[finding.table] = replace(table, **values)  # type: ignore[type-var]
    return replace(observations, **tables, findings=(*observations.findings, *new))  # type: ignore[arg-type]
