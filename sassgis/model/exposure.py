"""What blocks may hit, and what a hit does to it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

from sassgis.model.errors import InputError

ObjectKind = Literal["building", "road", "line", "people"]
OBJECT_KINDS: tuple[ObjectKind, ...] = ("building", "road", "line", "people")

#: Kind of the rows that say what a hit does to a vehicle and those in it.
VEHICLE = "vehicle"
VULNERABILITY_KINDS: tuple[str, ...] = (*OBJECT_KINDS, VEHICLE)
#: What stands there without people: those on a road sit in vehicles.
_WITHOUT_PEOPLE = ("road", "line")
#: What has no value in money.
_WITHOUT_VALUE = ("people",)

#: More metres of vehicles than this per metre of road do not fit on two lanes.
_FULL_ROAD = 2.0


def _check(name: str, value: float, low: float, high: float, *, above: bool = False) -> None:
    """Raise InputError unless low <= value <= high (low < value if ``above``)."""
    if math.isfinite(value) and low <= value <= high and not (above and value == low):
        return
    text = f"above {low:g}" if above else f"{low:g} or more"
    if math.isfinite(high):
        text = f"{text} and at most {high:g}"
    raise InputError("is out of range", field=name, found=f"{value:g}", expected=f"a number {text}")


@dataclass(frozen=True, slots=True)
class Traffic:
    """Vehicles on a road.

    Attributes
    ----------
    vehicles_per_day : float
        Mean number in a day, both directions together.
    speed_kmh : float
        At which they drive (km/h).
    vehicle_length_m : float
        Mean length of a vehicle (m).
    persons_per_vehicle : float
        Mean number of people in a vehicle.
    vehicle_value : float
        Mean value of a vehicle, in the currency of the run.
    trips_per_day : float
        How often the one road user whose individual risk is wanted drives by in a day.

    Raises
    ------
    InputError
        If a number is out of range, or more vehicles are stated than fit on a road.
    """

    vehicles_per_day: float
    speed_kmh: float
    vehicle_length_m: float
    persons_per_vehicle: float
    vehicle_value: float = 0.0
    trips_per_day: float = 2.0

    def __post_init__(self) -> None:
        _check("traffic_per_day", self.vehicles_per_day, 0.0, 1e6)
        _check("speed_kmh", self.speed_kmh, 0.0, 400.0, above=True)
        _check("vehicle_length_m", self.vehicle_length_m, 0.0, 1000.0, above=True)
        _check("persons_per_vehicle", self.persons_per_vehicle, 0.0, 2000.0)
        _check("vehicle_value", self.vehicle_value, 0.0, math.inf)
        _check("trips_per_day", self.trips_per_day, 0.0, 1000.0)
        if self.occupancy > _FULL_ROAD:
            raise InputError(
                "more vehicles than fit on the road",
                field="traffic_per_day",
                found=f"{self.vehicles_per_day:g} a day at {self.speed_kmh:g} km/h: "
                f"{self.occupancy:.2g} m of vehicles on each metre of road",
                expected=f"at most {_FULL_ROAD:g}",
            )

    @property
    def occupancy(self) -> float:
        """Metres of vehicles on a metre of road, all lanes together, in the mean over a day."""
        return self.vehicles_per_day * self.vehicle_length_m / (24_000.0 * self.speed_kmh)


@dataclass(frozen=True, slots=True)
class ExposedObject:
    """Something that blocks may hit: a building, a stretch of road or of a line, a group of people.

    Attributes
    ----------
    name : str
        Unique in the run.
    kind : {"building", "road", "line", "people"}
    parent : str
        Road or line of which the object is a stretch; empty if it is no part of anything.
    value : float
        What a hit of vulnerability 1 costs, in the currency of the run; buildings.
    value_per_m : float
        Value of a metre of a road or line.
    damage_length_m : float
        Length of road or line that a hit of vulnerability 1 destroys (m); 0: the block's width.
    persons : float
        People who live, work or stay there: those whom the presence speaks of.
    presence : float
        Share of the time that each of them is there, 0 to 1.
    length_m : float
        Length in plan of the stretch (m); 0 for what has no length.
    from_m : float
        Chainage at which the stretch begins (m).
    traffic : Traffic, optional
        Roads only.

    Raises
    ------
    InputError
        If a number is out of range or does not go with the kind.
    """

    name: str
    kind: ObjectKind
    parent: str = ""
    value: float = 0.0
    value_per_m: float = 0.0
    damage_length_m: float = 0.0
    persons: float = 0.0
    presence: float = 1.0
    length_m: float = 0.0
    from_m: float = 0.0
    traffic: Traffic | None = None

    def __post_init__(self) -> None:
        if self.kind not in OBJECT_KINDS:
            raise InputError(
                "unknown kind of object",
                field="kind",
                found=repr(self.kind),
                expected=f"one of {', '.join(OBJECT_KINDS)}",
            )
        for name in ("value", "value_per_m", "damage_length_m", "persons", "length_m", "from_m"):
            _check(name, getattr(self, name), 0.0, math.inf)
        _check("presence", self.presence, 0.0, 1.0)
        stated = {
            "value": self.value,
            "value_per_m": self.value_per_m,
            "damage_length_m": self.damage_length_m,
            "persons": self.persons,
            "traffic_per_day": 0.0 if self.traffic is None else self.traffic.vehicles_per_day,
        }
        for name, number in stated.items():
            if number and name not in NUMBERS_OF_KIND[self.kind]:
                raise InputError(
                    f"does not go with a {self.kind}",
                    field=name,
                    found=f"{number:g}",
                    expected=f"one of {', '.join(NUMBERS_OF_KIND[self.kind])}",
                )

    @property
    def whole(self) -> str:
        """Name of the road or line that the object is a stretch of, or its own."""
        return self.parent or self.name

    def stake(self, block_width_m: float) -> float:
        """Cost of one hit of vulnerability 1, in the currency of the run.

        Parameters
        ----------
        block_width_m : float
            Width of the block that hits (m).
        """
        return self.value + self.value_per_m * (self.damage_length_m or block_width_m)


_LINE_NUMBERS = ("value_per_m", "damage_length_m")
#: Numbers of each kind of object.
NUMBERS_OF_KIND: Mapping[str, tuple[str, ...]] = {
    "building": ("value", "persons", "presence"),
    "people": ("persons", "presence"),
    "line": _LINE_NUMBERS,
    "road": (
        *_LINE_NUMBERS,
        "traffic_per_day",
        "speed_kmh",
        "vehicle_length_m",
        "persons_per_vehicle",
        "vehicle_value",
        "trips_per_day",
    ),
}


@dataclass(frozen=True, slots=True)
class VulnerabilityRow:
    """What a hit of one intensity does to one kind of object.

    Attributes
    ----------
    kind : str
        A kind of object, or "vehicle".
    intensity : str
        Code of the intensity class.
    vulnerability : float
        Mean share of the value that is lost, 0 to 1.
    lethality : float
        Probability that a person who is there dies, 0 to 1. 0 for roads and lines: people on a
        road sit in vehicles.
    source : str
        Where both numbers come from.
    """

    kind: str
    intensity: str
    vulnerability: float
    lethality: float
    source: str

    def __post_init__(self) -> None:
        if self.kind not in VULNERABILITY_KINDS:
            raise InputError(
                "unknown kind of object",
                field="kind",
                found=repr(self.kind),
                expected=f"one of {', '.join(VULNERABILITY_KINDS)}",
            )
        _check("vulnerability", self.vulnerability, 0.0, 1.0)
        _check("lethality", self.lethality, 0.0, 1.0)
        for kinds, name, why in (
            (_WITHOUT_PEOPLE, "lethality", f"0: people on a road are in rows of kind {VEHICLE}"),
            (_WITHOUT_VALUE, "vulnerability", "0: people have no value in money"),
        ):
            if self.kind in kinds and getattr(self, name):
                raise InputError(
                    f"does not go with kind {self.kind}",
                    field=name,
                    found=f"{getattr(self, name):g}",
                    expected=why,
                )
        if not self.source.strip():
            raise InputError(
                "is empty", field="source", expected="where the numbers of the row come from"
            )


@dataclass(frozen=True, slots=True)
class Vulnerability:
    """Vulnerability and lethality by kind of object and class of intensity.

    Attributes
    ----------
    intensities : tuple of str
        Codes of the intensity classes, from weak to strong.
    rows : tuple of VulnerabilityRow
    file : str
        Where the table was read, for messages.

    Raises
    ------
    InputError
        If a row is missing or there twice, or has an unknown intensity.
    """

    intensities: tuple[str, ...]
    rows: tuple[VulnerabilityRow, ...]
    file: str = ""

    def __post_init__(self) -> None:
        seen: set[tuple[str, str]] = set()
        for row in self.rows:
            if row.intensity not in self.intensities:
                raise InputError(
                    "unknown intensity class",
                    file=self.file or None,
                    field="intensity",
                    found=repr(row.intensity),
                    expected=f"one of {', '.join(self.intensities)}",
                )
            if (row.kind, row.intensity) in seen:
                raise InputError(
                    "row is there twice",
                    file=self.file or None,
                    field="kind, intensity",
                    found=f"{row.kind}, {row.intensity}",
                    expected="each kind and intensity once",
                )
            seen.add((row.kind, row.intensity))
        for kind in self.kinds:
            missing = [i for i in self.intensities if (kind, i) not in seen]
            if missing:
                raise InputError(
                    f"kind {kind}: row is missing",
                    file=self.file or None,
                    field="intensity",
                    found=", ".join(i for i in self.intensities if i not in missing) or "none",
                    expected=f"a row for {', '.join(missing)} as well",
                )

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that have rows, in the order of the table."""
        return tuple(dict.fromkeys(row.kind for row in self.rows))

    def of(self, kind: str) -> tuple[VulnerabilityRow, ...]:
        """Rows of a kind, from the weakest intensity to the strongest.

        Raises
        ------
        InputError
            If the table has no rows of this kind.
        """
        if kind not in self.kinds:
            raise InputError(
                "kind of object has no rows",
                file=self.file or None,
                field="kind",
                found=", ".join(self.kinds) or "no rows",
                expected=f"{kind} as well, with a row for {', '.join(self.intensities)}",
            )
        own = {row.intensity: row for row in self.rows if row.kind == kind}
        return tuple(own[i] for i in self.intensities)

    def check_covers(self, objects: Iterable[ExposedObject]) -> None:
        """Raise InputError if a kind of object, or vehicles on a road, have no rows."""
        for kind in kinds_needed(objects):
            self.of(kind)

    def falling(self) -> list[str]:
        """What the table says less of at a stronger intensity, each as a phrase for a warning."""
        found = []
        for kind in self.kinds:
            for name in ("vulnerability", "lethality"):
                for weak, strong in pairwise(self.of(kind)):
                    low, high = getattr(weak, name), getattr(strong, name)
                    if high < low:
                        found.append(
                            f"{name} of kind {kind} falls from {low:g} at {weak.intensity} "
                            f"to {high:g} at {strong.intensity}"
                        )
        return found


def kinds_needed(objects: Iterable[ExposedObject]) -> tuple[str, ...]:
    """Kinds of which the vulnerability table must have rows."""
    kinds: dict[str, None] = {}
    for thing in objects:
        kinds[thing.kind] = None
        if thing.traffic is not None:
            kinds[VEHICLE] = None
    return tuple(kinds)


@dataclass(frozen=True, slots=True)
class PlacedObjects:
    """Exposed objects with their places.

    Attributes
    ----------
    objects : tuple of ExposedObject
    geometries : tuple of shapely geometry
        Polygons, line strings or points in the coordinates of the DEM (m), one per object: the
        ground on which a block meets the object.
    """

    objects: tuple[ExposedObject, ...]
    geometries: tuple[Any, ...]

    def __len__(self) -> int:
        return len(self.objects)
