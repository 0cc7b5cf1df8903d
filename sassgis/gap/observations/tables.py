"""Observations on a slope: rocks, stations, passages, impacts, contacts, stops, paths.

Every table and every column but the identifiers may be missing. A missing number is NaN; a table
says by ``present`` which of its columns hold any. SI units, in the name of the column.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, ClassVar, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from sassgis.grid import FloatArray, IntArray

TextArray = NDArray[np.str_]


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table of observations."""

    unit: str  # empty for texts and pure numbers
    meaning: str
    text: bool = False  # whether it holds text, as identifiers do
    low: float = -math.inf  # values beyond are no measurements
    high: float = math.inf
    positive: bool = False  # whether zero is refused as well
    aliases: tuple[str, ...] = ()  # other names under which it is read
    rim_of: str = ""  # of a spin: the speed that a rim of the rock exceeds only in another unit
    #: Of a speed: the columns, with it, whose size no drop of the rock can exceed.
    from_drop: tuple[str, ...] = ()
    name: str = ""  # that of the field that it is declared with


def _text(meaning: str) -> Column:
    return Column("", meaning, text=True)


def _positive(unit: str, meaning: str) -> Column:
    return Column(unit, meaning, low=0.0, positive=True)


def _coordinate(name: str, what: str, *stems: str) -> Column:
    others = (f"{s}_{name}{end}" for s in stems for end in ("", "_m"))
    meaning = f"{what}: {'height' if name == 'z' else name}"
    return Column("m", meaning, aliases=(f"{name}_m", *others))


def _columns_of(declaring: type) -> tuple[Column, ...]:
    """Return columns that the fields of a dataclass are annotated with."""
    return tuple(
        replace(column, name=name)
        for name, hint in get_type_hints(declaring, include_extras=True).items()
        for column in getattr(hint, "__metadata__", ())
        if isinstance(column, Column)
    )


_ROCK = _text("name of the rock; R7.2 is a piece of R7")
_MASS = _positive("kg", "mass")
_SPEED = Column("m/s", "speed of the centre", low=0.0, from_drop=("speed_mps",))


def _turns(when: str, rim_of: str = "") -> Column:
    meaning = "turns per second of the rock about its axis, whichever it is, without sign"
    return Column("1/s", f"{meaning}{when and ', '}{when}", low=0.0, rim_of=rim_of)


_ROTATION = _turns("", rim_of="speed_mps")
T = TypeVar("T", bound="Table")


class Table:
    """Base of the tables; each is a frozen dataclass of arrays of one length.

    Its fields are the schema: name, unit, meaning and limits of each column stand there. Reading,
    template, checks, what is identifiable and ``docs/observations.md`` follow from it.
    """

    __slots__ = ()
    table: ClassVar[str]  # name
    about: ClassVar[str]  # what it holds and how, for its owner
    key: ClassVar[tuple[str, ...]] = ()  # columns that no two rows share
    required: ClassVar[tuple[str, ...]] = ()  # columns without which a row is of no use
    may_be_loose: ClassVar[bool] = False  # whether a row may be of an unattributed block
    by_time: ClassVar[str] = ""  # column by which the rows of a rock follow each other
    #: What it holds where all of some columns have numbers.
    quantities: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    row: IntArray  # shape (n,); places in the file
    rock_id: TextArray  # shape (n,); of all tables but that of the stations

    @classmethod
    def columns(cls) -> tuple[Column, ...]:
        """Return columns of a file of this table, in the order of a template."""
        return _columns_of(cls)

    @classmethod
    def of(cls: type[T], **columns: Any) -> T:
        """Make a table of columns, NaN without. ValueError, TypeError if they do not fit."""
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
        return int(self.row.size)

    @property
    def numbers(self) -> Mapping[str, FloatArray]:
        """Columns of numbers by name."""
        own = (c.name for c in TABLES[self.table] if not c.text and hasattr(self, c.name))
        return {name: getattr(self, name) for name in own}

    @property
    def present(self) -> frozenset[str]:
        """Columns of numbers that hold at least one."""
        return frozenset(k for k, v in self.numbers.items() if bool(np.isfinite(v).any()))

    def take(self: T, which: IntArray | NDArray[np.bool_]) -> T:
        """Return rows by number or mask."""
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
    about: ClassVar[str] = (
        "One row for each rock that was released, or that fell from a known source."
    )
    key: ClassVar[tuple[str, ...]] = ("rock_id",)
    required: ClassVar[tuple[str, ...]] = ("rock_id",)
    quantities: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "release_speed_mps": ("release_speed_mps",)
    }
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
    group: Annotated[
        TextArray, _text("rocks that are not independent: of one block, day or source")
    ]


@dataclass(frozen=True, slots=True)
class Stations(Table):
    """Lines across the slope at which passing rocks were measured."""

    table: ClassVar[str] = "stations"
    about: ClassVar[str] = (
        "Lines across the slope at which passing rocks were measured. In a GeoPackage the line may "
        "have any number of vertices, from either end."
    )
    key: ClassVar[tuple[str, ...]] = ("station",)
    required: ClassVar[tuple[str, ...]] = ("station",)
    row: IntArray
    station: Annotated[TextArray, _text("name of the station")]
    #: X and y of the vertices (m), each of shape (k, 2); without geometry, the two ends in columns.
    vertices: tuple[FloatArray, ...]

    @classmethod
    def columns(cls) -> tuple[Column, ...]:
        """Return the name, and the ends of the line."""
        return (
            *_columns_of(cls),
            *(
                Column("m", f"{end}: {c}", aliases=(f"{c}{i}_m",), name=f"{c}{i}")
                for i, end in enumerate(("one end of the line across the slope", "its other end"))
                for c in "xy"
            ),
        )


@dataclass(frozen=True, slots=True)
class Passages(Table):
    """Rocks at stations."""

    table: ClassVar[str] = "passages"
    about: ClassVar[str] = (
        "A row for each rock at each station; one that passed without a measurement has a row "
        "without numbers."
    )
    key: ClassVar[tuple[str, ...]] = ("rock_id", "station")
    may_be_loose: ClassVar[bool] = True
    quantities: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "speed_mps": ("speed_mps",),
        "rotation_hz": ("rotation_hz",),
        "height_m": ("height_m",),
        "lateral_m": ("x", "y"),
    }
    row: IntArray
    rock_id: Annotated[TextArray, _ROCK]
    station: Annotated[TextArray, _text("station that the rock passed")]
    x: Annotated[FloatArray, _coordinate("x", "where it passed, centre of the rock")]
    y: Annotated[FloatArray, _coordinate("y", "where it passed, centre of the rock")]
    z: Annotated[FloatArray, _coordinate("z", "where it passed, centre of the rock")]
    speed_mps: Annotated[FloatArray, _SPEED]
    rotation_hz: Annotated[FloatArray, _ROTATION]
    height_m: Annotated[
        FloatArray,
        Column(
            "m",
            "vertical, from the ground to the centre, not less its resting height; below zero by "
            "an error of measurement alone",
            low=-1.0,
        ),
    ]
    mass_kg: Annotated[FloatArray, _MASS]


def _number(name: str) -> float:
    try:
        return float(name)
    except ValueError:
        return math.nan


@dataclass(frozen=True, slots=True)
class Impacts(Table):
    """Impacts, before and after."""

    table: ClassVar[str] = "impacts"
    about: ClassVar[str] = (
        "A row for each impact of which the velocities before and after are known: from video, or "
        "from sensors in the rock. Velocities are those of the centre of the rock, in the vertical "
        "plane of motion, along the ground and along the *outward* normal of the ground: an "
        "approaching rock has `vn_in_mps` below zero. Spin is clockwise positive with the motion "
        "to the right, so that a rolling rock has positive spin. Where the path turns, those after "
        "the impact are along the new heading."
    )
    key: ClassVar[tuple[str, ...]] = ("rock_id", "impact")
    quantities: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "energy_kept": ("vt_in_mps", "vn_in_mps", "vt_out_mps", "vn_out_mps"),
        "spin_out_radps": ("omega_in_radps", "omega_out_radps"),
        "turn_deg": ("turn_deg",),
    }
    row: IntArray
    rock_id: Annotated[TextArray, _ROCK]
    impact: Annotated[TextArray, _text("number or name of the impact of this rock")]
    x: Annotated[FloatArray, _coordinate("x", "point of impact")]
    y: Annotated[FloatArray, _coordinate("y", "point of impact")]
    z: Annotated[FloatArray, _coordinate("z", "point of impact")]
    slope_deg: Annotated[
        FloatArray,
        Column(
            "°",
            "dip of the ground along the travel, over a metre or two: not of single bumps",
            low=-90,
            high=90,
        ),
    ]
    vt_in_mps: Annotated[
        FloatArray,
        Column("m/s", "speed along the ground before", from_drop=("vt_in_mps", "vn_in_mps")),
    ]
    vn_in_mps: Annotated[FloatArray, Column("m/s", "along the outward normal before: below zero")]
    omega_in_radps: Annotated[
        FloatArray,
        Column("rad/s", "spin before; clockwise positive, travel to the right", rim_of="vt_in_mps"),
    ]
    vt_out_mps: Annotated[FloatArray, Column("m/s", "speed along the ground after")]
    vn_out_mps: Annotated[FloatArray, Column("m/s", "along the outward normal after")]
    omega_out_radps: Annotated[FloatArray, Column("rad/s", "spin after", rim_of="vt_out_mps")]
    turn_deg: Annotated[
        FloatArray,
        Column(
            "°",
            "change of the plan azimuth, clockwise; not used where the rock leaves slower than "
            "after a fall of its own diameter, and tumbles",
            low=-180,
            high=180,
        ),
    ]
    mass_kg: Annotated[FloatArray, _MASS]

    @property
    def number(self) -> FloatArray:
        """Numbers of the impacts; NaN of those with a name, which are in the order of the rows."""
        return np.array([_number(name) for name in self.impact.tolist()], np.float64)


@dataclass(frozen=True, slots=True)
class Contacts(Table):
    """Contacts with the ground in time and place, by rock and time."""

    table: ClassVar[str] = "contacts"
    about: ClassVar[str] = (
        "A row for each contact with the ground: sensors in the rock tell when it starts and ends "
        "and the spin before and after, a positioning system where it was. Every contact of a rock "
        "has a row, also where its place is not known. Velocities are not needed: hops follow from "
        "the times and places, and passages at the stations where `passages` holds none."
    )
    key: ClassVar[tuple[str, ...]] = ("rock_id", "t_start_s")
    required: ClassVar[tuple[str, ...]] = ("rock_id", "t_start_s")
    by_time: ClassVar[str] = "t_start_s"
    quantities: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "hop_time_s": ("t_start_s", "t_end_s"),
        "path_m": ("t_start_s", "x", "y"),
        "rotation_hz": ("rotation_after_hz",),
    }
    row: IntArray
    rock_id: Annotated[TextArray, _ROCK]
    t_start_s: Annotated[
        FloatArray, Column("s", "time at which it starts, from any start of the clock of a rock")
    ]
    t_end_s: Annotated[FloatArray, Column("s", "time at which it ends")]
    x: Annotated[FloatArray, _coordinate("x", "centre of the rock at the contact")]
    y: Annotated[FloatArray, _coordinate("y", "centre of the rock at the contact")]
    z: Annotated[FloatArray, _coordinate("z", "centre of the rock at the contact")]
    rotation_before_hz: Annotated[FloatArray, _turns("before it")]
    rotation_after_hz: Annotated[FloatArray, _turns("after it")]


@dataclass(frozen=True, slots=True)
class Deposits(Table):
    """Blocks where they lie."""

    table: ClassVar[str] = "deposits"
    about: ClassVar[str] = (
        "A row for each deposited block, fragments included. A rock that broke has rows for its "
        "pieces, which also passed the stations below under their own names, and none for itself."
    )
    may_be_loose: ClassVar[bool] = True
    quantities: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "runout_m": ("x", "y"),
        "lateral_m": ("x", "y"),
        "block_mass_kg": ("mass_kg",),
        "block_volume_m3": ("volume_m3",),
    }
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
    about: ClassVar[str] = "Points along paths: a row for each rock and time."
    key: ClassVar[tuple[str, ...]] = ("rock_id", "t_s")
    required: ClassVar[tuple[str, ...]] = ("rock_id", "t_s")
    by_time: ClassVar[str] = "t_s"
    quantities: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "path_m": ("t_s", "x", "y"),
        "flight_fit": ("t_s", "x", "y", "z"),
        "speed_mps": ("speed_mps",),
        "rotation_hz": ("rotation_hz",),
    }
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


TABLE_TYPES: Mapping[str, type[Table]] = {
    t.table: t for t in (Rocks, Stations, Passages, Impacts, Contacts, Deposits, Trajectories)
}
#: Columns of the tables, in the order of a template.
TABLES: Mapping[str, tuple[Column, ...]] = {
    name: kind.columns() for name, kind in TABLE_TYPES.items()
}
#: Tables of which each row is a point of a rock.
POINT_TABLES: tuple[str, ...] = tuple(
    name for name, columns in TABLES.items() if {"rock_id", "x"} <= {c.name for c in columns}
)


@dataclass(frozen=True, slots=True)
class Metadata:
    """How well was measured; NaN where it is not stated.

    Every key is 0 or more; a share is below 1. ``others`` holds the keys that are only passed on.
    """

    fps: Annotated[float, Column("1/s", "pictures per second")] = math.nan
    speed_error_rel: Annotated[
        float,
        Column(
            "",
            "standard error of a speed, as a share of it (0.05: 5 %); at impacts of the "
            "whole speed, both components alike",
        ),
    ] = math.nan
    rotation_error_rel: Annotated[
        float, Column("", "standard error of a rotation, as a share of it")
    ] = math.nan
    height_error_m: Annotated[float, Column("m", "standard error of a height of flight")] = math.nan
    position_error_m: Annotated[float, Column("m", "standard error of a position")] = math.nan
    stop_error_m: Annotated[
        float, Column("m", "standard error of the place of a stop; without it, of any position")
    ] = math.nan
    mass_error_rel: Annotated[float, Column("", "standard error of a mass, as a share of it")] = (
        math.nan
    )
    contact_min_normal_speed_mps: Annotated[
        float, Column("m/s", "speed into the ground below which a contact is not recorded")
    ] = math.nan
    contact_min_interval_s: Annotated[
        float,
        Column(
            "s",
            "time after a contact within which another one is taken for one with it: "
            "velocities before the first and after the last",
        ),
    ] = math.nan
    passages_missed_share: Annotated[
        float, Column("", "share of the passages at stations that were missed")
    ] = math.nan
    others: Mapping[str, str] = field(default_factory=dict)


#: Keys of ``metadata``.
METADATA_KEYS: Mapping[str, Column] = {own.name: own for own in _columns_of(Metadata)}
#: Keys of ``metadata`` that hold words for whoever uses the site later; they are passed on.
METADATA_TEXTS: Mapping[str, Column] = {
    name: replace(_text(meaning), name=name)
    for name, meaning in (
        ("terrain_survey", "date, means and cell size of the terrain model: before the releases"),
        ("ground", "ground by stretch: kind, depth, moisture, diameter of blocks that lie on it"),
        ("start", "how rocks were started: pushed, dropped from a height, rolled, blasted"),
        ("film_scale", "known length in the pictures and where it lies; place of the camera"),
        ("stops", "whether every rock has its stop; which left the survey; what held some"),
    )
}
