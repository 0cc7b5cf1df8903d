"""Exposed objects that blocks may hit, and what a hit does to them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Literal

from annotated_types import Interval, MaxLen

from sassgis.errors import InputError
from sassgis.settings.schema import Example, FieldName, InputFile, Name, Section, Text, checked

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


Amount = Annotated[float, Interval(ge=0)]
Share = Annotated[float, Interval(ge=0, le=1)]
PerDay = Annotated[float, Interval(ge=0, le=1e6)]
SpeedKmh = Annotated[float, Interval(gt=0, le=400)]
VehicleLength = Annotated[float, Interval(gt=0, le=1000)]
Occupants = Annotated[float, Interval(ge=0, le=2000)]
Trips = Annotated[float, Interval(ge=0, le=1000)]


@checked(frozen=True, slots=True)
class Traffic(Section):
    """Vehicles on a road."""

    traffic_per_day: Annotated[PerDay, "mean number in a day, both directions together"]
    speed_kmh: Annotated[SpeedKmh, "at which they drive (km/h)"]
    vehicle_length_m: Annotated[VehicleLength, "mean length of a vehicle (m)"]
    persons_per_vehicle: Annotated[Occupants, "mean number of people in a vehicle"]
    vehicle_value: Annotated[Amount, "mean value of a vehicle, in the currency of the run"] = 0.0
    trips_per_day: Annotated[
        Trips, "how often the one road user whose individual risk is wanted drives by in a day"
    ] = 2.0

    def _fits_together(self) -> None:
        if self.occupancy > _FULL_ROAD:
            flow = f"{self.traffic_per_day:g} a day at {self.speed_kmh:g} km/h"
            found = f"{flow}: {self.occupancy:.2g} m of vehicles on each metre of road"
            raise InputError(
                "more vehicles than fit on the road", field="traffic_per_day", found=found,
                expected=f"at most {_FULL_ROAD:g}",
            )  # fmt: skip

    @property
    def occupancy(self) -> float:
        """Metres of vehicles on a metre of road, all lanes together, in the mean over a day."""
        return self.traffic_per_day * self.vehicle_length_m / (24_000.0 * self.speed_kmh)


@checked(frozen=True, slots=True)
class ExposedObject(Section):
    """Something that blocks may hit: a building, a stretch of road or of a line, a group of people.

    InputError if a number is out of range or does not go with the kind.
    """

    name: str  # unique in the run
    kind: Annotated[ObjectKind, "kind of the object"]
    # Road or line of which the object is a stretch; empty if it is no part of anything.
    parent: str = ""
    value: Annotated[Amount, "cost of a hit of vulnerability 1, in the currency of the run"] = 0.0
    value_per_m: Annotated[Amount, "value of a metre of a road or line"] = 0.0
    damage_length_m: Annotated[
        Amount, "length of road or line that such a hit destroys (m); 0: the block's width"
    ] = 0.0
    persons: Annotated[Amount, "people who live, work or stay there"] = 0.0
    presence: Annotated[Share, "share of the time that each of them is there"] = 1.0
    length_m: Annotated[Amount, "in plan, of the stretch (m); 0 for what has no length"] = 0.0
    from_m: Annotated[Amount, "chainage at which the stretch begins (m)"] = 0.0
    traffic: Traffic | None = None  # roads only

    def _fits_together(self) -> None:
        stated = {
            "value": self.value,
            "value_per_m": self.value_per_m,
            "damage_length_m": self.damage_length_m,
            "persons": self.persons,
            "traffic_per_day": 0.0 if self.traffic is None else self.traffic.traffic_per_day,
        }
        for name, number in stated.items():
            if number and name not in NUMBERS_OF_KIND[self.kind]:
                problem = f"does not go with a {self.kind}"
                expected = f"one of {', '.join(NUMBERS_OF_KIND[self.kind])}"
                raise InputError(problem, field=name, found=f"{number:g}", expected=expected)

    @property
    def whole(self) -> str:
        """Name of the road or line that the object is a stretch of, or its own."""
        return self.parent or self.name

    def stake(self, block_width_m: float) -> float:
        """Return the cost of a hit of vulnerability 1 by a block of a width (run's currency)."""
        return self.value + self.value_per_m * (self.damage_length_m or block_width_m)


_LINE_NUMBERS = ("value_per_m", "damage_length_m")
#: Numbers of each kind of object.
NUMBERS_OF_KIND: Mapping[str, tuple[str, ...]] = {
    "building": ("value", "persons", "presence"),
    "people": ("persons", "presence"),
    "line": _LINE_NUMBERS,
    "road": (
        *_LINE_NUMBERS, "traffic_per_day", "speed_kmh", "vehicle_length_m", "persons_per_vehicle",
        "vehicle_value", "trips_per_day",
    ),
}  # fmt: skip


@checked(frozen=True, slots=True)
class VulnerabilityRow(Section):
    """What a hit of one intensity does to one kind of object."""

    kind: Annotated[str, "kind of object, or vehicle"]
    intensity: str  # code of the intensity class
    vulnerability: Annotated[Share, "mean share of the value that is lost"]
    # 0 for roads and lines: people on a road sit in vehicles.
    lethality: Annotated[Share, "probability that a person who is there dies"]
    source: str  # where both numbers come from

    def _fits_together(self) -> None:
        for kinds, name, why in (
            (_WITHOUT_PEOPLE, "lethality", f"0: people on a road are in rows of kind {VEHICLE}"),
            (_WITHOUT_VALUE, "vulnerability", "0: people have no value in money"),
        ):
            if self.kind in kinds and (found := getattr(self, name)):
                problem = f"does not go with kind {self.kind}"
                raise InputError(problem, field=name, found=f"{found:g}", expected=why)
        if not self.source.strip():
            expected = "where the numbers of the row come from"
            raise InputError("is empty", field="source", expected=expected)


@dataclass(frozen=True, slots=True)
class Vulnerability:
    """Vulnerability and lethality by kind of object and class of intensity.

    InputError if a row is missing or there twice, or has an unknown intensity.
    """

    intensities: tuple[str, ...]  # codes of the intensity classes, from weak to strong
    rows: tuple[VulnerabilityRow, ...]
    file: str = ""  # where the table was read, for messages

    def __post_init__(self) -> None:
        seen: set[tuple[str, str]] = set()
        for row in self.rows:
            key, known = (row.kind, row.intensity), ", ".join(self.intensities)
            if row.intensity not in self.intensities:
                found = repr(row.intensity)
                raise self._refused(
                    "unknown intensity class", "intensity", found, f"one of {known}"
                )
            if key in seen:
                expected = "each kind and intensity once"
                raise self._refused(
                    "row is there twice", "kind, intensity", ", ".join(key), expected
                )
            seen.add(key)
        for kind in self.kinds:
            missing = [i for i in self.intensities if (kind, i) not in seen]
            if missing:
                found = ", ".join(i for i in self.intensities if i not in missing) or "none"
                expected = f"a row for {', '.join(missing)} as well"
                raise self._refused(f"kind {kind}: row is missing", "intensity", found, expected)

    def _refused(self, problem: str, field: str, found: str, expected: str) -> InputError:
        file = self.file or None
        return InputError(problem, file=file, field=field, found=found, expected=expected)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that have rows, in the order of the table."""
        return tuple(dict.fromkeys(row.kind for row in self.rows))

    def of(self, kind: str) -> tuple[VulnerabilityRow, ...]:
        """Return rows of a kind, from the weakest intensity up; InputError if there are none."""
        if kind not in self.kinds:
            found = ", ".join(self.kinds) or "no rows"
            expected = f"{kind} as well, with a row for {', '.join(self.intensities)}"
            raise self._refused("kind of object has no rows", "kind", found, expected)
        own = {row.intensity: row for row in self.rows if row.kind == kind}
        return tuple(own[i] for i in self.intensities)

    def check_covers(self, objects: Iterable[ExposedObject]) -> None:
        """Raise InputError if a kind of object, or vehicles on a road, have no rows."""
        for thing in objects:
            self.of(thing.kind)
            if thing.traffic is not None:
                self.of(VEHICLE)

    def falling(self) -> list[str]:
        """List where the table falls at a stronger intensity, each as a phrase for a warning."""
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


@dataclass(frozen=True, slots=True)
class PlacedObjects:
    """Exposed objects with their places."""

    objects: tuple[ExposedObject, ...]
    # Tuple of shapely geometry; polygons, line strings or points in the coordinates of the DEM (m),
    # one per object: the ground on which a block meets the object.
    geometries: tuple[Any, ...]

    def __len__(self) -> int:
        return len(self.objects)

    @property
    def wholes(self) -> dict[str, list[int]]:
        """Positions of the objects by the name of what they are: a road as a whole."""
        found: dict[str, list[int]] = {}
        for number, thing in enumerate(self.objects):
            found.setdefault(thing.whole, []).append(number)
        return found


@checked(frozen=True, slots=True)
class RiskSettings(Section):
    """What hits do to exposed objects."""

    vulnerability: Annotated[
        InputFile | None,
        "table (CSV) with columns kind, intensity, vulnerability, lethality, source",
        Example("vulnerability.csv"),
    ] = None
    currency: Annotated[Text, MaxLen(12), "currency of all values"] = "CHF"


@checked(frozen=True, slots=True)
class ObjectSettings(Section):
    """A layer of exposed objects of one kind.

    Each number is one for all features, or an attribute of each (``<number>_field``).
    """

    name: Annotated[
        Name, "name of the layer, for messages and as a name of its objects", Example("houses")
    ]
    kind: Annotated[ObjectKind, "kind of the objects", Example("building")]
    file: Annotated[InputFile, "polygons, lines or points", Example("buildings.gpkg")]
    layer: Annotated[Text | None, "layer, where the file has several", Example("buildings")] = None
    name_field: Annotated[
        Text | None, "attribute with the names of the objects", Example("name")
    ] = None
    segment_m: Annotated[
        float,
        Interval(ge=1, le=100_000),
        "length of the stretches into which roads and lines are cut (m)",
    ] = 50.0
    radius_m: Annotated[
        float,
        Interval(ge=0, le=1000),
        "radius of the ground that people given as points take up (m)",
    ] = 0.0
    value: Annotated[
        Amount | None, "value that a hit of vulnerability 1 destroys; buildings", Example(500000.0)
    ] = None
    value_field: FieldName = None
    value_per_m: Annotated[Amount | None, "value of a metre; roads and lines", Example(1000.0)] = (
        None
    )
    value_per_m_field: FieldName = None
    damage_length_m: Annotated[
        Amount | None,
        "length that a hit of vulnerability 1 destroys (m); without it the width of "
        "the block; roads and lines",
        Example(5.0),
    ] = None
    damage_length_m_field: FieldName = None
    persons: Annotated[
        Amount | None, "people who live, work or stay there; buildings and people", Example(2.0)
    ] = None
    persons_field: FieldName = None
    presence: Annotated[
        Share | None, "share of the time that each of them is there", Example(0.5)
    ] = None
    presence_field: FieldName = None
    traffic_per_day: Annotated[
        PerDay | None, "vehicles a day, both directions; roads", Example(1000.0)
    ] = None
    traffic_per_day_field: FieldName = None
    speed_kmh: Annotated[SpeedKmh | None, "speed of the vehicles (km/h); roads", Example(50.0)] = (
        None
    )
    speed_kmh_field: FieldName = None
    vehicle_length_m: Annotated[
        VehicleLength | None, "mean length of a vehicle (m); roads", Example(5.0)
    ] = None
    vehicle_length_m_field: FieldName = None
    persons_per_vehicle: Annotated[
        Occupants | None, "mean number of people in a vehicle; roads", Example(1.6)
    ] = None
    persons_per_vehicle_field: FieldName = None
    vehicle_value: Annotated[Amount | None, "mean value of a vehicle; roads", Example(20000.0)] = (
        None
    )
    vehicle_value_field: FieldName = None
    trips_per_day: Annotated[
        Trips | None,
        "how often the road user of the individual risk drives by in a day; roads",
        Example(2.0),
    ] = None
    trips_per_day_field: FieldName = None

    @property
    def defaults(self) -> dict[str, float]:
        """Numbers for features without one of their own."""
        return {n: v for n in OBJECT_NUMBERS if (v := getattr(self, n)) is not None}

    @property
    def fields(self) -> dict[str, str]:
        """Attributes with the numbers of single features."""
        return {n: v for n in OBJECT_NUMBERS if (v := getattr(self, f"{n}_field")) is not None}


#: What may be stated of an exposed object, as one number for all or as an attribute of each.
OBJECT_NUMBERS = tuple(
    key.removesuffix("_field")
    for key in ObjectSettings.__annotations__
    if key.endswith("_field") and key != "name_field"
)
