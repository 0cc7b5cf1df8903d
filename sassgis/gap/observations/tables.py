"""What was observed on a slope: rocks, stations, passages, impacts, stops, paths.

Every table and every column but the identifiers may be missing. A missing number is NaN; a table
says by ``present`` which of its columns hold any. SI units, in the name of the column.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from sassgis.model.grid import FloatArray, IntArray

TextArray = NDArray[np.str_]
Level = Literal["error", "warning"]
LeftOut = Literal["", "value", "row", "table"]

#: Density where none is observed (kg/m³), to get a size from a mass.
DENSITY_KGM3 = 2700.0


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table of observations.

    Attributes
    ----------
    unit : str
        Empty for texts and pure numbers.
    meaning : str
    text : bool
        Whether it holds text, as identifiers do.
    low, high : float
        Values beyond are no measurements.
    positive : bool
        Whether zero is refused as well.
    aliases : tuple of str
        Other names under which it is read.
    name : str
        That of the field that it is declared with.
    """

    unit: str
    meaning: str
    text: bool = False
    low: float = -math.inf
    high: float = math.inf
    positive: bool = False
    aliases: tuple[str, ...] = ()
    name: str = ""


def _text(meaning: str) -> Column:
    return Column("", meaning, text=True)


def _positive(unit: str, meaning: str) -> Column:
    return Column(unit, meaning, low=0.0, positive=True)


def _coordinate(name: str, what: str, *stems: str) -> Column:
    others = (f"{s}_{name}{end}" for s in stems for end in ("", "_m"))
    meaning = f"{what}: {'height' if name == 'z' else name}"
    return Column("m", meaning, aliases=(f"{name}_m", *others))


_ROCK = _text("name of the rock; R7.2 is a piece of R7")
_MASS = _positive("kg", "mass")
_SPEED = Column("m/s", "speed of the centre", low=0.0)
_ROTATION = Column("1/s", "turns per second, without sign", low=0.0)


#: Keys of ``metadata`` with their units and meaning.
METADATA_KEYS: Mapping[str, tuple[str, str]] = {
    "fps": ("1/s", "pictures per second"),
    "speed_error_rel": ("", "standard error of a speed, as a share of it (0.05: 5 %)"),
    "rotation_error_rel": ("", "standard error of a rotation, as a share of it"),
    "height_error_m": ("m", "standard error of a height of flight"),
    "position_error_m": ("m", "standard error of a position"),
}


# ---------------------------------------------------------------------------------------------
# Tables

T = TypeVar("T", bound="Table")


class Table:
    """What the tables have in common; each is a frozen dataclass of arrays of one length.

    Their fields are the schema: name, unit, meaning and limits of each column stand there, and
    reading, template, checks and ``docs/observations.md`` follow them.

    Attributes
    ----------
    table : str
        Name.
    key : tuple of str
        Columns that no two rows share.
    required : tuple of str
        Columns without which a row is of no use.
    """

    __slots__ = ()
    table: ClassVar[str]
    key: ClassVar[tuple[str, ...]] = ()
    required: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def columns(cls) -> tuple[Column, ...]:
        """Columns of a file of this table, in the order of a template."""
        declared = get_type_hints(cls, include_extras=True).items()
        return tuple(
            replace(column, name=name)
            for name, hint in declared
            for column in getattr(hint, "__metadata__", ())
            if isinstance(column, Column)
        )

    @classmethod
    def of(cls: type[T], **columns: Any) -> T:
        """Make a table of the columns at hand; numbers that are not given are NaN.

        Raises
        ------
        ValueError
            If the columns differ in length.
        TypeError
            If there is no such column.
        """
        given = {k: v for k, v in columns.items() if v is not None}
        n = max((len(v) for v in given.values()), default=0)
        given.setdefault("row", np.arange(1, n + 1))
        own = {f.name for f in fields(cls)}  # type: ignore[arg-type]
        texts = {c.name for c in TABLES[cls.table] if c.text}
        if unknown := set(given) - own:
            raise TypeError(f"{cls.table}: no such column: {', '.join(sorted(unknown))}")
        made: dict[str, Any] = {}
        for name in own:
            if name == "row":
                made[name] = np.asarray(given[name], np.int64)
            elif name == "vertices":
                made[name] = tuple(np.asarray(v, np.float64) for v in given.get(name, ()))
            elif name in texts:
                made[name] = np.asarray(given.get(name, [""] * n), np.str_)
            else:
                made[name] = np.asarray(given.get(name, np.full(n, np.nan)), np.float64)
            if len(made[name]) != n:
                raise ValueError(f"{cls.table}.{name}: {len(made[name])} values, not {n}")
        return cls(**made)

    def __len__(self) -> int:
        return int(self.row.size)  # type: ignore[attr-defined]

    @property
    def numbers(self) -> Mapping[str, FloatArray]:
        """Columns of numbers by name."""
        own = {f.name for f in fields(self)}  # type: ignore[arg-type]
        return {
            c.name: getattr(self, c.name)
            for c in TABLES[self.table]
            if not c.text and c.name in own
        }

    @property
    def present(self) -> frozenset[str]:
        """Columns of numbers that hold at least one."""
        return frozenset(k for k, v in self.numbers.items() if bool(np.isfinite(v).any()))

    def take(self: T, which: IntArray | NDArray[np.bool_]) -> T:
        """Rows by number or mask."""
        index = np.arange(len(self))[which]
        taken = {
            f.name: tuple(getattr(self, f.name)[i] for i in index)
            if f.name == "vertices"
            else getattr(self, f.name)[index]
            for f in fields(self)  # type: ignore[arg-type]
        }
        return type(self)(**taken)


@dataclass(frozen=True, slots=True)
class Rocks(Table):
    """Released rocks. ``row`` is their place in the file."""

    table: ClassVar[str] = "rocks"
    key: ClassVar[tuple[str, ...]] = ("rock_id",)
    required: ClassVar[tuple[str, ...]] = ("rock_id",)
    row: IntArray
    rock_id: Annotated[TextArray, _ROCK]
    x: Annotated[FloatArray, _coordinate("x", "release point", "release")]
    y: Annotated[FloatArray, _coordinate("y", "release point", "release")]
    z: Annotated[FloatArray, _coordinate("z", "release point", "release")]
    mass_kg: Annotated[FloatArray, _MASS]
    volume_m3: Annotated[FloatArray, _positive("m³", "volume")]
    semi_axis_a_m: Annotated[FloatArray, _positive("m", "longest semi-axis: half of the length")]
    semi_axis_b_m: Annotated[FloatArray, _positive("m", "middle semi-axis")]
    semi_axis_c_m: Annotated[FloatArray, _positive("m", "shortest semi-axis")]
    density_kgm3: Annotated[FloatArray, _positive("kg/m³", "density")]
    release_speed_mps: Annotated[FloatArray, Column("m/s", "speed at the release", low=0.0)]


_END, _OTHER_END = "one end of the line across the slope", "its other end"


@dataclass(frozen=True, slots=True)
class Stations(Table):
    """Lines across the slope at which passing rocks were measured.

    Attributes
    ----------
    row : int64, shape (n,)
    station : str, shape (n,)
    vertices : tuple of float64 arrays, each of shape (k, 2)
        x and y of the vertices (m); a file without geometry has the two ends in columns.
    """

    table: ClassVar[str] = "stations"
    key: ClassVar[tuple[str, ...]] = ("station",)
    required: ClassVar[tuple[str, ...]] = ("station",)
    row: IntArray
    station: Annotated[TextArray, _text("name of the station")]
    vertices: tuple[FloatArray, ...]

    @classmethod
    def columns(cls) -> tuple[Column, ...]:
        """The name, and the ends of the line."""
        return (
            *Table.columns.__func__(cls),  # type: ignore[attr-defined]
            *(
                Column("m", f"{end}: {c}", aliases=(f"{c}{i}_m",), name=f"{c}{i}")
                for i, end in enumerate((_END, _OTHER_END))
                for c in "xy"
            ),
        )


@dataclass(frozen=True, slots=True)
class Passages(Table):
    """Rocks at stations."""

    table: ClassVar[str] = "passages"
    key: ClassVar[tuple[str, ...]] = ("rock_id", "station")
    row: IntArray
    rock_id: Annotated[TextArray, _ROCK]
    station: Annotated[TextArray, _text("station that the rock passed")]
    x: Annotated[FloatArray, _coordinate("x", "where it passed, centre of the rock")]
    y: Annotated[FloatArray, _coordinate("y", "where it passed, centre of the rock")]
    z: Annotated[FloatArray, _coordinate("z", "where it passed, centre of the rock")]
    speed_mps: Annotated[FloatArray, _SPEED]
    rotation_hz: Annotated[FloatArray, _ROTATION]
    height_m: Annotated[FloatArray, Column("m", "vertical, from the ground to the centre", low=0.0)]
    mass_kg: Annotated[FloatArray, _MASS]


@dataclass(frozen=True, slots=True)
class Impacts(Table):
    """Impacts, before and after."""

    table: ClassVar[str] = "impacts"
    key: ClassVar[tuple[str, ...]] = ("rock_id", "impact")
    row: IntArray
    rock_id: Annotated[TextArray, _ROCK]
    impact: Annotated[TextArray, _text("number or name of the impact of this rock")]
    x: Annotated[FloatArray, _coordinate("x", "point of impact")]
    y: Annotated[FloatArray, _coordinate("y", "point of impact")]
    z: Annotated[FloatArray, _coordinate("z", "point of impact")]
    slope_deg: Annotated[
        FloatArray, Column("°", "dip of the ground along the travel", low=-90, high=90)
    ]
    vt_in_mps: Annotated[FloatArray, Column("m/s", "speed along the ground before")]
    vn_in_mps: Annotated[FloatArray, Column("m/s", "along the outward normal before: below zero")]
    omega_in_radps: Annotated[
        FloatArray, Column("rad/s", "spin before; clockwise positive, travel to the right")
    ]
    vt_out_mps: Annotated[FloatArray, Column("m/s", "speed along the ground after")]
    vn_out_mps: Annotated[FloatArray, Column("m/s", "along the outward normal after")]
    omega_out_radps: Annotated[FloatArray, Column("rad/s", "spin after")]
    turn_deg: Annotated[
        FloatArray, Column("°", "change of the plan azimuth, clockwise", low=-180, high=180)
    ]
    mass_kg: Annotated[FloatArray, _MASS]


@dataclass(frozen=True, slots=True)
class Deposits(Table):
    """Blocks where they lie."""

    table: ClassVar[str] = "deposits"
    row: IntArray
    rock_id: Annotated[TextArray, _ROCK]
    x: Annotated[FloatArray, _coordinate("x", "where it lies")]
    y: Annotated[FloatArray, _coordinate("y", "where it lies")]
    z: Annotated[FloatArray, _coordinate("z", "where it lies")]
    mass_kg: Annotated[FloatArray, _MASS]
    volume_m3: Annotated[FloatArray, _positive("m³", "volume")]


@dataclass(frozen=True, slots=True)
class Trajectories(Table):
    """Points along paths, by rock and time."""

    table: ClassVar[str] = "trajectories"
    key: ClassVar[tuple[str, ...]] = ("rock_id", "t_s")
    required: ClassVar[tuple[str, ...]] = ("rock_id", "t_s")
    row: IntArray
    rock_id: Annotated[TextArray, _ROCK]
    t_s: Annotated[
        FloatArray, Column("s", "time, from any start that is the same for all of a rock")
    ]
    x: Annotated[FloatArray, _coordinate("x", "centre of the rock")]
    y: Annotated[FloatArray, _coordinate("y", "centre of the rock")]
    z: Annotated[FloatArray, _coordinate("z", "centre of the rock")]
    speed_mps: Annotated[FloatArray, _SPEED]
    rotation_hz: Annotated[FloatArray, _ROTATION]


@dataclass(frozen=True, slots=True)
class Metadata:
    """How well was measured; NaN where it is not stated. See ``METADATA_KEYS``.

    ``others`` holds the keys that are only passed on.
    """

    fps: float = math.nan
    speed_error_rel: float = math.nan
    rotation_error_rel: float = math.nan
    height_error_m: float = math.nan
    position_error_m: float = math.nan
    others: Mapping[str, str] = field(default_factory=dict)


TABLE_TYPES: Mapping[str, type[Table]] = {
    t.table: t for t in (Rocks, Stations, Passages, Impacts, Deposits, Trajectories)
}
#: Columns of the tables, in the order of a template.
TABLES: Mapping[str, tuple[Column, ...]] = {
    name: kind.columns() for name, kind in TABLE_TYPES.items()
}


# ---------------------------------------------------------------------------------------------
# Findings


@dataclass(frozen=True, slots=True)
class ObservationFinding:
    """Something about the observations that their owner should know.

    Attributes
    ----------
    level : {"error", "warning"}
        error: wrong, and to be mended; warning: usable, but deserves a look.
    problem : str
    file, table, column : str
        Where; empty where it does not apply.
    rows : tuple of int
        Rows of the table: lines of a CSV counted with the header, or feature ids.
    found, expected : str
    left_out : {"", "value", "row", "table"}
        What is not used because of it.
    """

    level: Level
    problem: str
    file: str = ""
    table: str = ""
    column: str = ""
    rows: tuple[int, ...] = ()
    found: str = ""
    expected: str = ""
    left_out: LeftOut = ""

    def __str__(self) -> str:
        """One line that names file, table, column and row."""
        place = ".".join(part for part in (self.table, self.column) if part)
        where = ": ".join(part for part in (self.file, place, _rows(self.rows)) if part)
        detail = "; ".join(
            part
            for part in (
                f"found {self.found}" if self.found else "",
                f"expected {self.expected}" if self.expected else "",
            )
            if part
        )
        line = (
            f"{self.level}: {where}: {self.problem}" if where else f"{self.level}: {self.problem}"
        )
        if detail:
            line += f" ({detail})"
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


# ---------------------------------------------------------------------------------------------
# All of it


@dataclass(frozen=True, slots=True)
class Observations:
    """All that was observed, in the coordinates of the DEM.

    Attributes
    ----------
    rocks, stations, passages, impacts, deposits, trajectories
        Tables; of length 0 where there is none.
    metadata : Metadata
    files : mapping of table to file
        For messages; empty for observations that come from no file.
    findings : tuple of ObservationFinding
        What was found, and left out, while reading.
    """

    rocks: Rocks = field(default_factory=Rocks.of)
    stations: Stations = field(default_factory=Stations.of)
    passages: Passages = field(default_factory=Passages.of)
    impacts: Impacts = field(default_factory=Impacts.of)
    deposits: Deposits = field(default_factory=Deposits.of)
    trajectories: Trajectories = field(default_factory=Trajectories.of)
    metadata: Metadata = field(default_factory=Metadata)
    files: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[ObservationFinding, ...] = ()

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
        ids = [
            name
            for table in (self.passages, self.impacts, self.deposits, self.trajectories)
            for name in table.rock_id.tolist()
            if name
        ]
        known = set(ids)
        return tuple(dict.fromkeys(root_of(name, known) for name in ids))

    def rock_of(self, table: str) -> IntArray:
        """Place in ``rock_names`` of the rock that each row of a table belongs to.

        Pieces belong to the rock they broke from. -1: an unattributed block.
        """
        names = self.rock_names
        place = {name: i for i, name in enumerate(names)}
        ids = getattr(self.tables[table], "rock_id", None)
        if ids is None:
            raise ValueError(f"table {table} is not about rocks")
        known = set(names)
        found = {name: place.get(root_of(name, known), -1) for name in set(ids.tolist())}
        return np.array([found[name] for name in ids.tolist()], np.int64)

    def is_piece(self, table: str) -> NDArray[np.bool_]:
        """Whether each row of a table is about a piece of a rock rather than a whole rock."""
        names = self.rock_names
        ids = self.tables[table].rock_id.tolist()  # type: ignore[attr-defined]
        owner = self.rock_of(table)
        return np.array(
            [i >= 0 and names[i] != name for i, name in zip(owner.tolist(), ids, strict=True)],
            np.bool_,
        )

    def units(self, table: str) -> IntArray:
        """Unit of resampling of each row: its rock, or a number of its own for each unattributed
        block (counted on from the number of rocks; rows of one name share it).
        """
        owner = self.rock_of(table)
        ids = self.tables[table].rock_id.tolist()  # type: ignore[attr-defined]
        others: dict[str, int] = {}
        count = len(self.rock_names)
        for i in np.flatnonzero(owner < 0).tolist():
            # Blocks without a name have nothing in common.
            key = ids[i].split(".")[0] or f"\0{i}"
            owner[i] = others.setdefault(key, count + len(others))
        return owner


def parent_of(rock_id: str) -> str | None:
    """Rock that a piece broke from, by its name alone: R7 for R7.2; None without a suffix."""
    stem, dot, suffix = rock_id.rpartition(".")
    return stem if dot and stem and suffix else None


def root_of(rock_id: str, known: Iterable[str]) -> str:
    """The whole rock that a name goes back to.

    Parameters
    ----------
    rock_id
        Of a rock, a piece, or a piece of a piece (R7.2.1).
    known
        Names in use; a set makes it fast.

    Returns
    -------
    str
        The shortest name in use that is left when suffixes are taken off; the name itself if
        there is none.
    """
    found, name = rock_id, rock_id
    while (parent := parent_of(name)) is not None:
        name = parent
        if name in known:
            found = name
    return found


def rock_masses_kg(observations: Observations) -> FloatArray:
    """Mass of each rock of ``rock_names`` (kg): as weighed, else from its volume; NaN unknown."""
    names = observations.rock_names
    rocks = observations.rocks
    if not len(rocks):
        return np.full(len(names), np.nan)
    density = np.where(np.isfinite(rocks.density_kgm3), rocks.density_kgm3, DENSITY_KGM3)
    axes = rocks.semi_axis_a_m * rocks.semi_axis_b_m * rocks.semi_axis_c_m
    volume = np.where(np.isfinite(rocks.volume_m3), rocks.volume_m3, 4.0 / 3.0 * math.pi * axes)
    mass = np.where(np.isfinite(rocks.mass_kg), rocks.mass_kg, density * volume)
    place = {name: i for i, name in enumerate(rocks.rock_id.tolist())}
    return mass[[place[name] for name in names]]


def rock_radii_m(observations: Observations) -> FloatArray:
    """Radius of the sphere of equal mass of each rock of ``rock_names`` (m); NaN unknown."""
    masses = rock_masses_kg(observations)
    rocks = observations.rocks
    density = dict(zip(rocks.rock_id.tolist(), rocks.density_kgm3.tolist(), strict=True))
    own = np.array([density.get(name, math.nan) for name in observations.rock_names], np.float64)
    own = np.where(np.isfinite(own), own, DENSITY_KGM3)
    radii: FloatArray = np.cbrt(3.0 * masses / (4.0 * math.pi * own))
    return radii


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
        hit = np.isin(table.row, finding.rows)  # type: ignore[attr-defined]
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


# ---------------------------------------------------------------------------------------------
# What can be told
