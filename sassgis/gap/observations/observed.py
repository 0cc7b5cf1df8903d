"""All observations on a slope, their errors, and the faults of the tables."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from sassgis.gap.constants import DENSITY_KGM3
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
from sassgis.grid import BoolArray, FloatArray, Grid, IntArray
from sassgis.settings.results import some_of
from sassgis.settings.schema import Input
from sassgis.terrain.cells import heights_at

Level = Literal["error", "warning"]
LeftOut = Literal["", "value", "row", "table"]


@dataclass(frozen=True, slots=True)
class ObservationFinding:
    """Something about the observations that their owner should know."""

    level: Level  # "error": wrong, and to be mended; "warning": usable, to be checked
    problem: str
    # Where; empty where it does not apply.
    file: str = ""
    table: str = ""
    column: str = ""
    #: Rows of the table: lines of a CSV counted with the header, or feature ids.
    rows: tuple[int, ...] = ()
    found: str = ""
    expected: str = ""
    left_out: LeftOut = ""  # what is not used because of it

    def __str__(self) -> str:
        """Return one line that names file, table, column and row."""
        place = ".".join(filter(None, (self.table, self.column)))
        parts = (self.level, self.file, place, _rows(self.rows), self.problem)
        line = ": ".join(filter(None, parts))
        detail = (("found", self.found), ("expected", self.expected))
        if any(text for _, text in detail):
            line += f" ({'; '.join(f'{word} {text}' for word, text in detail if text)})"
        if self.left_out:
            what = self.left_out + ("s" if len(self.rows) > 1 and self.left_out != "table" else "")
            line += f"; {what} left out"
        return " ".join(line.split())


def _rows(rows: Sequence[int]) -> str:
    if not rows:
        return ""
    shown = ", ".join(str(r) for r in rows[:5])
    more = f" and {len(rows) - 5} more" if len(rows) > 5 else ""
    return f"row{'s' if len(rows) > 1 else ''} {shown}{more}"


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

        Those of the table of rocks, less the fragments listed there; without it, all that turn up.
        """
        if len(self.rocks):
            known = set(self.rocks.rock_id.tolist())
            return tuple(n for n in self.rocks.rock_id.tolist() if root_of(n, known) == n)
        tables = (self.tables[name] for name in POINT_TABLES)
        ids = [name for table in tables for name in table.rock_id.tolist() if name]
        known = set(ids)
        return tuple(dict.fromkeys(root_of(name, known) for name in ids))

    def rock_of(self, table: str) -> IntArray:
        """Return the place in ``rock_names`` of each row's rock, also of its fragments; or -1."""
        place = {name: i for i, name in enumerate(self.rock_names)}
        ids = self.tables[table].rock_id.tolist()
        found = {name: place.get(root_of(name, place), -1) for name in set(ids)}
        return np.array([found[name] for name in ids], np.int64)

    def is_piece(self, table: str) -> NDArray[np.bool_]:
        """Return whether each row of a table is about a fragment rather than a whole rock."""
        owner = self.rock_of(table)
        # Of an unattributed block the last name is taken, which does not count.
        names = np.array([*self.rock_names, ""])[owner]
        return np.asarray((owner >= 0) & (names != self.tables[table].rock_id), np.bool_)

    def whole_of(self, table: str) -> IntArray:
        """Return the place in ``rock_names`` of each row's rock; -1: fragment, or unattributed."""
        return np.where(self.is_piece(table), -1, self.rock_of(table))

    def of_rocks(self, values: FloatArray | BoolArray) -> FloatArray:
        """Return a column of the table of rocks by ``rock_names``; NaN for other rocks."""
        stated = dict(zip(self.rocks.rock_id.tolist(), values.tolist(), strict=True))
        return np.array([stated.get(name, math.nan) for name in self.rock_names], np.float64)

    def paths_of_rocks(self, needed: FloatArray | float = 0.0) -> dict[int, IntArray]:
        """Return rows of ``trajectories`` by rock and time with a place, and what is ``needed``."""
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
    """Return the rock that a fragment broke from, by its name: R7 for R7.2; or None."""
    stem, dot, suffix = rock_id.rpartition(".")
    return stem if dot and stem and suffix else None


def root_of(rock_id: str, known: Iterable[str]) -> str:
    """Return the whole rock that a name goes back to: of a fragment, or a fragment of one (R7.2.1).

    The shortest name in use (``known``) that remains when suffixes are taken off; else the name.
    """
    found, name = rock_id, rock_id
    while (parent := parent_of(name)) is not None:
        name = parent
        if name in known:
            found = name
    return found


def rock_masses_kg(observations: Observations) -> FloatArray:
    """Return masses of ``rock_names`` (kg): as weighed, else from the volume; NaN unknown."""
    rocks = observations.rocks
    density = np.where(np.isfinite(rocks.density_kgm3), rocks.density_kgm3, DENSITY_KGM3)
    axes = rocks.semi_axis_a_m * rocks.semi_axis_b_m * rocks.semi_axis_c_m
    volume = np.where(np.isfinite(rocks.volume_m3), rocks.volume_m3, 4.0 / 3.0 * math.pi * axes)
    mass = np.where(np.isfinite(rocks.mass_kg), rocks.mass_kg, density * volume)
    return observations.of_rocks(mass)


def deposit_masses_kg(observations: Observations) -> FloatArray:
    """Return mass of each deposited block (kg): as weighed, else from its volume; NaN unknown."""
    own = observations.deposits
    return np.where(np.isfinite(own.mass_kg), own.mass_kg, DENSITY_KGM3 * own.volume_m3)


def rock_radii_m(observations: Observations) -> FloatArray:
    """Return radius of the sphere of equal mass of each rock of ``rock_names`` (m); NaN unknown."""
    density = observations.of_rocks(observations.rocks.density_kgm3)
    density = np.where(np.isfinite(density), density, DENSITY_KGM3)
    return np.cbrt(3.0 * rock_masses_kg(observations) / (4.0 * math.pi * density))


def without(observations: Observations, findings: Iterable[ObservationFinding]) -> Observations:
    """Leave out what findings say is left out; the findings are kept with the observations."""
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


@dataclass(frozen=True, slots=True)
class Rule:
    """A kind of fault."""

    level: Level  # "error": wrong, and to be mended; "warning": usable, to be checked
    problem: str  # it and ``expected`` may hold {words} that the check fills in
    column: str = ""  # where the fault is seen, if the check does not say
    expected: str = ""
    left_out: LeftOut = ""  # what is not used because of it: "", "value" or "row"

    def at(
        self,
        observations: Observations,
        table: str,
        which: NDArray[np.bool_] | IntArray,
        found: str = "",
        column: str = "",
        **words: object,
    ) -> Iterator[ObservationFinding]:
        """Yield the finding of this rule for some rows of a table; none for none of them."""
        rows = observations.tables[table].row[which]
        if rows.size:
            yield ObservationFinding(
                level=self.level, problem=self.problem.format(**words),
                file=str(observations.files.get(table, "")), table=table,
                column=column or self.column, rows=tuple(rows.tolist()), found=found,
                expected=self.expected.format(**words), left_out=self.left_out,
            )  # fmt: skip


_AXES = "semi_axis_a_m, semi_axis_b_m, semi_axis_c_m"
_IMPACT_SPEEDS = "vt_in_mps, vn_in_mps, vt_out_mps, vn_out_mps"
_DENSITY = "900 to 5000 kg/m³"

#: By name; the checks say which rows break them.
RULES: Mapping[str, Rule] = {
    # Names
    "twice": Rule("error", "is there twice; the first one is taken", "rock_id",
                  "one row for each", "row"),
    "same stop": Rule("error", "the same stop is there twice", "rock_id",
                      "one row for each block", "row"),
    "several stops": Rule("warning", "several stops of one rock are taken to be its pieces",
                          "rock_id", "names with a suffix, such as {name}.1 and {name}.2"),
    "unattributed": Rule("warning", "not in the table of rocks: {taken}", "rock_id", "{nearest}"),
    "piece of none": Rule("warning", "named as a piece of a rock that is not there: taken as a "
                          "rock of its own", "rock_id",
                          "a row for {parent}, or names without a point"),
    "placed elsewhere": Rule("warning", "no such station: the passages are used by their x and y "
                             "alone", "station", "{nearest}"),
    "no station": Rule("error", "no such station", "station", "{nearest}", "row"),
    # Sizes
    "full axes": Rule("error", "look like full axes, not semi-axes", _AXES,
                      "half of length, width and height", "value"),
    "large axes": Rule("warning", "semi-axes do not go with the volume or the mass", _AXES,
                       "half of length, width and height", "value"),
    "small axes": Rule("warning", "semi-axes are too small for the volume or the mass", _AXES,
                       "half of length, width and height in m"),
    "unit of mass": Rule("error", "look like {unit}: mass and volume do not go together",
                         "mass_kg", _DENSITY, "value"),
    "tonnes": Rule("error", "look like tonnes: mass and semi-axes do not go together", "mass_kg",
                   "kg", "value"),
    "unit of axes": Rule("error", "look like {unit}", _AXES, "half of length, width and height in "
                         "m", "value"),
    "mass and volume": Rule("warning", "mass and volume do not go together", "mass_kg", _DENSITY),
    "density": Rule("error", "{problem}", "density_kgm3", _DENSITY, "value"),
    "heavy pieces": Rule("warning", "blocks of {name} are more than the rock itself", "",
                         "{most} at most"),
    # Motion
    "inward": Rule("error", "the rock leaves the ground before it hits it{hint}",
                   "vn_in_mps, vn_out_mps", "below zero: the normal points out of the ground",
                   "value"),
    "grazing": Rule("warning", "within its error the rock does not come down on the ground",
                    "vn_in_mps, vn_out_mps", "below zero", "value"),
    "radians": Rule("error", "look like radians or tangents", "slope_deg", "degrees", "value"),
    "swapped": Rule("error", "before and after look swapped: more energy after the impact than "
                    "before", "vt_out_mps", "at most 1, {room:.2f} with errors of measurement"),
    "energy gain": Rule("warning", "more energy after the impact than before", "vt_out_mps",
                        "at most 1, {room:.2f} with errors of measurement"),
    "spin": Rule("error", "look like {guess}", "", "{unit}", "value"),
    "odd spin": Rule("error", "too fast for the sizes and speeds of the rocks: another unit, or "
                     "full axes?", "", "{unit}", "value"),
    "unit of speed": Rule("error", "look like {unit}", "speed_mps", "m/s, and times in s", "value"),
    "speed and time": Rule("error", "speeds do not go with positions and times", "speed_mps",
                           "m/s, and times in s", "value"),
    "milliseconds": Rule("error", "look like milliseconds", "t_s", "s", "value"),
    "unit of impacts": Rule("error", "look like km/h, or another unit", _IMPACT_SPEEDS, "m/s",
                            "value"),
    "scale": Rule("warning", "speeds are too high for all, by one scale; they are kept",
                  _IMPACT_SPEEDS, "the scale of the film and its frame rate as they were"),
    "km/h": Rule("error", "look like km/h", "", "{fastest:.1f} m/s at most", "value"),
    "mostly too fast": Rule("error", "faster than the drop allows", "",
                            "{fastest:.1f} m/s at most", "value"),
    "start too low": Rule("warning", "faster than the drop from the stated start allows, at "
                          "{rocks} of {all} rocks; they are kept", "",
                          "a start that is at least {more:.1f} m higher, or a right scale"),
    "too fast": Rule("warning", "faster than the drop allows", "",
                     "{fastest:.1f} m/s at most", "value"),
    # Contacts
    "ends early": Rule("error", "ends before it starts", "t_end_s", "t_start_s or later", "value"),
    "overlap": Rule("error", "ends after the next contact of the rock has begun", "t_end_s",
                    "times that rise from contact to contact", "value"),
    "no place": Rule("warning", "no place: time and spin alone are used", "x, y",
                     "centre of the rock at the contact"),
    "too far": Rule("warning", "farther from the contact before than any fall takes the rock in "
                    "that time", "x, y, z", "{fastest:.1f} m/s at most", "value"),
    # Places
    "far from station": Rule("warning", "passages lie away from the station that they name",
                             "x, y", "{room:g} m at most"),
    "above release": Rule("warning", "passages lie above the release of the rock", "station",
                          "stations below the release"),
    "impacts above release": Rule("warning", "impacts lie above the stated release of the rock",
                                  "x, y", "the right place of the release"),
    "climbs": Rule("error", "the rock climbs from one station to the next lower one", "z",
                   "the right station in each row, and z of the rock there", "value"),
    "unordered": Rule("warning", "passages are not listed down the slope: taken in the order of "
                      "the stations' heights", "station"),
    "outside": Rule("warning", "lies outside the DEM", "x, y", "{extent}", "value"),
    "all outside": Rule("error", "no row lies on the DEM{why}", "x, y", "{extent}", "value"),
    "station outside": Rule("error", "station {name} lies outside the DEM{why}", "", "{extent}",
                            "row"),
    "height system": Rule("warning", "heights are offset from the DEM: another height system?",
                          "z", "within {limit:g} m of the ground"),
    "stray height": Rule("warning", "height is far from the DEM", "z",
                         "a height near the ground", "value"),
    "under ground": Rule("warning", "paths run under the ground: another height system?", "z",
                         "at or above the DEM"),
}  # fmt: skip


def nearest_of(name: str, known: Sequence[str]) -> str:
    """State what was expected: known names, and the one most like the given one."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f"one of {some_of(known)}" + (f"; nearest: {close[0]}" if close else "")


def stated_or(value: float, otherwise: float) -> float:
    """Return the value that the metadata state, else a usual or estimated one."""
    return value if math.isfinite(value) else otherwise


def tops_m(obs: Observations, grid: Grid | None, drop_m: float = 0.0) -> FloatArray:
    """Return the height from which each rock came, at most, up to ``drop_m`` above the ground."""
    z = obs.rocks.z
    if grid is not None:
        z = np.fmax(z, heights_at(grid, obs.rocks.x, obs.rocks.y) + drop_m)
    top = np.append(obs.of_rocks(z) + np.nan_to_num(rock_radii_m(obs)), np.nan)
    summit = float(np.nanmax(z)) if np.isfinite(z).any() else math.nan
    if grid is not None and not math.isfinite(summit) and np.isfinite(grid.values).any():
        summit = float(np.nanmax(grid.values))
    if math.isfinite(summit):
        # Blocks torn out of the slope start below the releases.
        top[~np.isfinite(top)] = summit
    return top


def above_release_m(obs: Observations, grid: Grid | None) -> FloatArray:
    """Return height of each impact above the stated release of its rock (m); NaN where unknown."""
    release = np.append(obs.of_rocks(heights_m(obs.rocks, grid)), np.nan)
    found: FloatArray = heights_m(obs.impacts, grid) - release[obs.rock_of("impacts")]
    return found


def heights_m(points: Table, grid: Grid | None) -> FloatArray:
    """Return the height of each point as stated, else of the ground below (m); NaN unknown."""
    own = points.numbers
    if grid is None:
        return own["z"]
    return np.where(np.isfinite(own["z"]), own["z"], heights_at(grid, own["x"], own["y"]))


def height_errors_m(points: Table, grid: Grid | None, position_m: float) -> FloatArray:
    """Return errors of ground heights by that of the place (m); 0 for stated heights."""
    own = points.numbers
    if grid is None:
        return np.zeros(len(points))
    d = grid.cell_size
    rises = [
        (
            heights_at(grid, own["x"] + e, own["y"] + n)
            - heights_at(grid, own["x"] - e, own["y"] - n)
        )
        / (2.0 * d)
        for e, n in ((d, 0.0), (0.0, d))
    ]
    found: FloatArray = np.nan_to_num(position_m * np.hypot(*rises))
    return np.where(np.isfinite(own["z"]), 0.0, found)


def station_lines(obs: Observations) -> dict[str, shapely.LineString]:
    """Return lines of the stations that have one, by name."""
    table = zip(obs.stations.station.tolist(), obs.stations.vertices, strict=True)
    return {name: shapely.LineString(vertices) for name, vertices in table if len(vertices) > 1}


def station_heights_m(obs: Observations, grid: Grid | None, *, lowest: bool) -> FloatArray:
    """Return the ground at the station of each passage: its lowest or middle point."""
    if grid is None:
        return np.full(len(obs.passages), np.nan)
    heights = {}
    at = np.linspace(0.0, 1.0, 21) if lowest else np.array([0.5])
    for name, line in station_lines(obs).items():
        points = shapely.get_coordinates(line.interpolate(at, normalized=True))
        z = heights_at(grid, points[:, 0], points[:, 1])
        if np.isfinite(z).any():
            heights[name] = float(np.nanmin(z))
    return np.array([heights.get(s, math.nan) for s in obs.passages.station.tolist()], np.float64)
