"""The sections of a configuration: their keys, kinds of value, defaults and limits."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationInfo,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from sassgis.model.hazard import OnsetUnit
from sassgis.model.results import ControlLine

# ---------------------------------------------------------------------------------------------
# Kinds of value


def refuse(problem: str, expected: str, *, key: str = "", found: object = None) -> Exception:
    """An error that pydantic carries to the place where it is told in one line."""
    context: dict[str, Any] = {"problem": problem, "expected": expected, "key": key}
    if found is not None:
        context["found"] = str(found)
    return PydanticCustomError("sassgis", "{problem}", context)


def _pair(value: object) -> object:
    """A single number stands for two equal limits."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value)
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        raise refuse("is not a range", "a number, or two numbers [low, high]")
    return tuple(value)


def _ascending(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise refuse("limits are reversed", "[low, high] with the lower number first")
    return value


def between(
    low: float, high: float = math.inf, *, above: bool = False, below: bool = False
) -> AfterValidator:
    """Limits for a number or both ends of a range; ``above`` and ``below`` leave the ends out."""
    text = f"above {low:g}" if above else f"{low:g} or more"
    if math.isfinite(high):
        text = f"{text} and below {high:g}" if below else f"{text} and at most {high:g}"

    def check(value: Any) -> Any:
        for number in value if isinstance(value, tuple) else (value,):
            if (
                number < low
                or number > high
                or (above and number == low)
                or (below and number == high)
            ):
                kind = "numbers" if isinstance(value, tuple) else "a number"
                raise refuse("is out of range", f"{kind} {text}")
        return value

    return AfterValidator(check)


def _clean_name(value: str) -> str:
    name = value.strip()
    if not name or re.search(r"[,;\r\n\t]", name):
        raise refuse("cannot be used as a name", "a text without comma, semicolon or line break")
    return name


def _anchor(value: Path, info: ValidationInfo) -> Path:
    """Paths are relative to the configuration file."""
    if str(value) in ("", "."):
        raise refuse("is empty", "the path of a file", found="''")
    base = (info.context or {}).get("base", Path())
    return Path(base, value.expanduser())


Num = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Int = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Span = Annotated[tuple[Num, Num], BeforeValidator(_pair), AfterValidator(_ascending)]
Name = Annotated[str, AfterValidator(_clean_name)]
FileName = Annotated[Path, AfterValidator(_anchor)]
TableFormat = Literal["none", "csv", "parquet"]


class Section(BaseModel):
    """What all sections share: unknown keys are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    _config_file: Path | None = PrivateAttr(default=None)

    def model_post_init(self, context: Any) -> None:
        """Remember the file, for messages of those who are given the section alone."""
        self._config_file = (context or {}).get("file")

    @property
    def config_file(self) -> Path | None:
        """The configuration file; None for a section that was made in code."""
        return self._config_file


# ---------------------------------------------------------------------------------------------
# Sections


class ProjectSettings(Section):
    """``[project]``."""

    name: str = Field(
        default="rockfall", min_length=1, description="title on maps and in the report"
    )


class TerrainSettings(Section):
    """``[terrain]``: the DEM and how fall lines are traced and flattened."""

    dem: FileName | None = Field(
        default=None, description="terrain model: any raster that GDAL reads, or a folder of tiles"
    )
    crs: str | None = Field(
        default=None,
        min_length=1,
        description="coordinate system where the DEM states none, e.g. EPSG:2056, or 'local'",
    )
    vertical_datum: str | None = Field(
        default=None,
        min_length=1,
        description="name of the height system where the DEM states none",
    )
    smoothing_m: Annotated[Num, between(0, 200)] = Field(
        default=5.0,
        description="scale of the terrain that steers fall lines: Gaussian standard deviation (m)",
    )
    segment_tolerance_m: Annotated[Num, between(0, 100)] = Field(
        default=0.25, description="largest vertical gap between terrain and segments (m)"
    )
    energy_line_angle_deg: Annotated[Num, between(0, 60)] = Field(
        default=20.0,
        description="lines end where they sink below this angle seen from the start (degrees)",
    )
    max_line_length_m: Annotated[Num, between(0, 100_000, above=True)] = Field(
        default=5000.0, description="longest fall line, in plan (m)"
    )
    flat_slope_deg: Annotated[Num, between(0, 30)] = Field(
        default=8.0, description="slope below which a line tends to keep its heading (degrees)"
    )


class ReleaseSettings(Section):
    """``[release]``: where rocks start."""

    file: FileName | None = Field(default=None, description="polygons, lines or points of release")
    layer: str | None = Field(
        default=None, min_length=1, description="layer, where the file has several"
    )
    name_field: str | None = Field(
        default=None,
        min_length=1,
        description="attribute with the names of the areas; else area 1, area 2, ...",
    )
    scenario_field: str | None = Field(
        default=None,
        min_length=1,
        description="attribute naming the block scenarios of an area: a;b for several; empty: all",
    )
    spacing_m: Annotated[Num, between(0, 10_000, above=True)] = Field(
        default=5.0, description="distance between release points (m)"
    )
    placement: Literal["grid", "random"] = Field(
        default="grid", description="how points are laid out"
    )
    rocks_per_point: Annotated[Int, between(1, 1_000_000)] = Field(
        default=50, description="rocks let go at each release point"
    )


class SpreadSettings(Section):
    """``[spread]``: a bundle of lines from each release point."""

    lines_per_point: Annotated[Int, between(1, 1001)] = Field(
        default=1, description="lines traced from each release point"
    )
    width_percent: Annotated[Num, between(0, 100)] = Field(
        default=0.0,
        description="width of the bundle, both sides together, in percent of the length",
    )

    @model_validator(mode="after")
    def _has_width(self) -> SpreadSettings:
        if self.lines_per_point > 1 and self.width_percent == 0.0:
            raise refuse(
                "would trace the same line several times",
                "a width above 0 where lines_per_point is above 1",
                key="width_percent",
                found=self.width_percent,
            )
        return self


def _codes(value: object) -> object:
    """TOML keys are text; raster codes are whole numbers."""
    if not isinstance(value, Mapping):
        raise refuse("is not a table of codes", 'codes and class names, as in {1 = "rock"}')
    try:
        return {int(str(code)): name for code, name in value.items()}
    except ValueError:
        raise refuse(
            "has a code that is no whole number", 'codes and class names, as in {1 = "rock"}'
        ) from None


class GroundSettings(Section):
    """``[ground]``: the kind of ground, cell by cell."""

    default: Name = Field(default="debris", description="class where nothing else is said")
    file: FileName | None = Field(
        default=None, description="polygons or a raster of ground classes"
    )
    layer: str | None = Field(
        default=None, min_length=1, description="layer, where the file has several"
    )
    class_field: str = Field(
        default="class", min_length=1, description="attribute with the class names"
    )
    classes: FileName | None = Field(
        default=None,
        description="own class table (CSV or TOML), added to the built-in one or overriding it",
    )
    raster_classes: Annotated[dict[int, Name], BeforeValidator(_codes)] | None = Field(
        default=None, description="class of each code, where the file is a raster"
    )

    @model_validator(mode="after")
    def _fits_file(self) -> GroundSettings:
        for key in ("layer", "raster_classes"):
            if getattr(self, key) is not None and self.file is None:
                raise refuse("has no file to go with", "ground.file as well", key=key)
        return self


Semiaxis = Annotated[Span, between(0, 10, above=True)]
Proportion = Annotated[Span, between(0, 1, above=True)]


class BlockSettings(Section):
    """``[[blocks]]``: one block scenario; every range may also be a single number."""

    name: Name = Field(description="name of the scenario")
    axis_1_m: Semiaxis | None = Field(
        default=None, description="first SEMI-axis, half the length of the block (m)"
    )
    axis_2_m: Semiaxis | None = Field(default=None, description="second SEMI-axis (m)")
    axis_3_m: Semiaxis | None = Field(default=None, description="third SEMI-axis (m)")
    volume_m3: Annotated[Span, between(0, 1000, above=True)] | None = Field(
        default=None, description="volume of the block, in place of the axes (m3)"
    )
    volume_exponent: Annotated[Num, between(0, 10)] | None = Field(
        default=None,
        description="b of a power law: the frequency of blocks larger than V falls as V^-b between "
        "the limits of volume_m3; without it all volumes between them are equally likely",
    )
    shape: tuple[Proportion, Proportion, Proportion] | None = Field(
        default=None,
        description="with volume_m3: proportions of the three axes, as [1, [0.7, 0.9], 0.6]; "
        "default [1, [0.7, 1], [0.5, 0.8]]",
    )
    onset_frequency: Annotated[Num, between(0, 1e6)] | None = Field(
        default=None, description="how often a block of this scenario is released"
    )
    onset_unit: OnsetUnit = Field(
        default="per_year",
        description="of onset_frequency: per year in each release area, per year and hectare of "
        "it (in plan), or per year and metre of it (release lines)",
    )
    onset_above_m3: Annotated[Num, between(0, 1000, above=True)] | None = Field(
        default=None,
        description="with volume_exponent: onset_frequency is that of blocks larger than this "
        "(m3), from which the power law gives the frequency between the limits of volume_m3",
    )
    density_kgm3: Annotated[Span, between(500, 10_000)] = Field(
        default=(2700.0, 2700.0), description="density of the rock (kg/m3)"
    )
    speed_mps: Annotated[Span, between(0, 150)] = Field(
        default=(0.0, 0.0), description="speed at the start, downhill along the slope (m/s)"
    )
    spin_radps: Annotated[Span, between(-300, 300)] = Field(
        default=(0.0, 0.0),
        description="spin at the start, positive as a rock rolling downhill (rad/s)",
    )
    drop_m: Annotated[Span, between(0, 1000)] = Field(
        default=(0.0, 0.0), description="height above rest from which the rock is let go (m)"
    )
    orientation_rad: Annotated[Span, between(-2.0 * math.pi, 2.0 * math.pi)] = Field(
        default=(0.0, math.pi),
        description="angle of the longest axis to the slope at the start (rad)",
    )

    @model_validator(mode="after")
    def _has_one_size(self) -> BlockSettings:
        axes = [k for k in ("axis_1_m", "axis_2_m", "axis_3_m") if getattr(self, k) is not None]
        if self.volume_m3 is not None and axes:
            raise refuse("has both a volume and axes", "volume_m3 or the three axes", found=axes[0])
        if self.volume_m3 is None:
            for key in ("axis_1_m", "axis_2_m", "axis_3_m"):
                if key not in axes:
                    raise refuse(
                        "missing key", "three SEMI-axis ranges (m), or volume_m3 instead", key=key
                    )
            for key in ("volume_exponent", "shape"):
                if getattr(self, key) is not None:
                    raise refuse("has no volume to go with", "volume_m3 as well", key=key)
        if self.onset_above_m3 is not None and self.volume_exponent is None:
            raise refuse(
                "has no power law to go with", "volume_exponent as well", key="onset_above_m3"
            )
        return self

    @property
    def axes(self) -> dict[str, tuple[float, float]]:
        """The three axes, semi-axes in metres or proportions."""
        shape = self.shape or ((1.0, 1.0), (0.7, 1.0), (0.5, 0.8))
        given = (self.axis_1_m, self.axis_2_m, self.axis_3_m)
        return {f"axis_{i + 1}_m": given[i] or shape[i] for i in range(3)}


class StationSettings(Section):
    """``[[stations]]``: a line on the map, or a chainage, where passing rocks are recorded."""

    name: Name = Field(description="name of the station")
    line: tuple[tuple[Num, Num], ...] | None = Field(
        default=None, min_length=2, description="[[x, y], [x, y], ...] in the DEM's coordinates (m)"
    )
    file: FileName | None = Field(
        default=None, description="layer of lines; each feature is a station"
    )
    layer: str | None = Field(
        default=None, min_length=1, description="layer, where the file has several"
    )
    name_field: str | None = Field(
        default=None,
        min_length=1,
        description="attribute with the names; else the name and a number",
    )
    chainage_m: Num | None = Field(
        default=None, description="chainage along the profile; profile runs only (m)"
    )

    @model_validator(mode="after")
    def _has_one_place(self) -> StationSettings:
        places = [k for k in ("line", "file", "chainage_m") if getattr(self, k) is not None]
        if len(places) != 1:
            raise refuse(
                "must be put in one place",
                "exactly one of line, file, chainage_m",
                found=" and ".join(places) or "none",
            )
        for key in ("layer", "name_field"):
            if getattr(self, key) is not None and self.file is None:
                raise refuse("has no file to go with", "file as well", key=key)
        return self


class BarrierSettings(StationSettings):
    """``[[barriers]]``: a wall or a net; placed as a station is."""

    kind: Literal["wall", "net"] = Field(description="wall or net")
    height_m: Annotated[Num, between(0, 100, above=True)] = Field(
        description="height of the top above the ground, vertical (m)"
    )
    capacity_kj: Annotated[Num, between(0, above=True)] | None = Field(
        default=None,
        description="energy that it takes (kJ); without it every rock that meets it is stopped",
    )

    lets_go: Flag = Field(
        default=False,
        description="whether rocks that it takes move on from zero speed, as nets may let them",
    )

    def control_line(self, name: str) -> ControlLine:
        """Return this barrier under the name of one of its features."""
        capacity = math.inf if self.capacity_kj is None else self.capacity_kj
        return ControlLine(name, self.kind, self.height_m, capacity, self.lets_go)


class ProfileSettings(Section):
    """``[profile]``: a run along a single profile, without a map."""

    file: FileName | None = Field(
        default=None, description="CSV with columns s_m, z_m and, if wanted, ground"
    )
    start_m: Span = Field(default=(0.0, 0.0), description="chainages between which rocks start (m)")
    rocks: Annotated[Int, between(1, 100_000_000)] = Field(
        default=100, description="number of rocks"
    )


class RunSettings(Section):
    """``[run]``."""

    seed: Annotated[Int, between(0, 2**63 - 1)] = Field(
        default=1, description="the same seed gives the same rocks"
    )
    jobs: Annotated[Int, between(0, 4096)] = Field(
        default=0, description="processor cores; 0: all of them"
    )


class OutputSettings(Section):
    """``[output]``."""

    stop_points_max: Annotated[Int, between(0, 100_000_000)] = Field(
        default=100_000, description="most stop points written to the map"
    )
    rock_table: TableFormat = Field(default="none", description="one row per rock")
    passage_table: TableFormat = Field(
        default="none", description="one row per rock and station or barrier"
    )
    energy_classes_kj: tuple[Annotated[Num, between(0, above=True)], ...] = Field(
        default=(30.0, 300.0), min_length=1, description="limits between the energy classes (kJ)"
    )

    @model_validator(mode="after")
    def _limits_rise(self) -> OutputSettings:
        limits = self.energy_classes_kj
        if any(low >= high for low, high in itertools.pairwise(limits)):
            raise refuse(
                "limits do not rise",
                "numbers in ascending order",
                key="energy_classes_kj",
                found=list(limits),
            )
        return self


def _preset(value: object, info: ValidationInfo) -> object:
    """A name of a built-in preset stays as it is; a file is relative to the configuration."""
    if isinstance(value, str) and (value.endswith(".toml") or "/" in value):
        return str(_anchor(Path(value), info))
    return value


class HazardSettings(Section):
    """``[hazard]``: from rocks to intensities and hazard levels (``sassgis zone``)."""

    preset: Annotated[str, BeforeValidator(_preset)] = Field(
        default="ch-federal",
        min_length=1,
        description="rules for intensity and level: a built-in preset, or a TOML file of your own",
    )
    frequencies: FileName | None = Field(
        default=None,
        description="table (CSV) with columns area, scenario, frequency, unit: onset frequencies "
        "of single release areas, in place of onset_frequency and onset_unit of [[blocks]]; "
        "onset_above_m3 holds for them too",
    )
    ref_width_m: Annotated[Num, between(0, 1000, above=True)] | None = Field(
        default=None,
        description="reference width of all frequencies (m): a rock counts for a place if it comes "
        "within half of it, as block plus exposed object; default: one cell",
    )
    confidence: Annotated[Num, between(0.5, 0.9999)] = Field(
        default=0.95, description="of the sampling interval that tells whether a level is decided"
    )
    undecided_share_max: Annotated[Num, between(0, 1, below=True)] | None = Field(
        default=None,
        description="if given, more rounds of rocks are run until no larger share of the reached "
        "cells is undecided",
    )
    rounds_max: Annotated[Int, between(1, 1024)] = Field(
        default=8, description="most rounds of rocks_per_point with undecided_share_max"
    )
    by_source: Flag = Field(
        default=True, description="whether intensities are also written for each release area"
    )
    compare_barriers: Flag = Field(
        default=True,
        description="whether the zones are also made without walls and nets, and compared",
    )
    design_return_periods_years: tuple[Annotated[Num, between(1, 10_000)], ...] = Field(
        default=(30.0, 100.0, 300.0),
        min_length=1,
        description="for the energy and height that a barrier at each station must take",
    )
    canton: str | None = Field(
        default=None,
        pattern=r"^[A-Z]{2}$",
        description="code of the canton that is responsible for the data, as TI (federal model)",
    )


class ZoneSettings(Section):
    """``[zones]``: from cells to polygons."""

    min_area_m2: Annotated[Num, between(0, 1e6)] = Field(
        default=100.0, description="smallest area of a zone (m2)"
    )
    closing_m: Annotated[Num, between(0, 1000)] | None = Field(
        default=None,
        description="gaps between parts of a zone that are closed, up to this width (m); default: "
        "two cells, or release.spacing_m if that is wider",
    )
    min_width_m: Annotated[Num, between(0, 1000)] | None = Field(
        default=None,
        description="threads narrower than this are widened (m); default: three cells",
    )
    tolerance_m: Annotated[Num, between(0, 1000)] | None = Field(
        default=None,
        description="how far a smoothed outline may lie outside its cells (m); default: one and a "
        "half cells",
    )


class RiskSettings(Section):
    """``[risk]``: what hits do to exposed objects."""

    vulnerability: FileName | None = Field(
        default=None,
        description="table (CSV) with columns kind, intensity, vulnerability, lethality, source",
    )
    currency: str = Field(default="CHF", min_length=1, max_length=12, description="of all values")


class ObjectSection(Section):
    """``[[objects]]``: a layer of exposed objects of one kind."""

    name: Name = Field(description="name of the layer, for messages and as a name of its objects")
    kind: Literal["building", "road", "line", "people"] = Field(description="kind of the objects")
    file: FileName = Field(description="polygons, lines or points")
    layer: str | None = Field(
        default=None, min_length=1, description="layer, where the file has several"
    )
    name_field: str | None = Field(
        default=None, min_length=1, description="attribute with the names of the objects"
    )
    segment_m: Annotated[Num, between(1, 100_000)] = Field(
        default=50.0, description="length of the stretches into which roads and lines are cut (m)"
    )
    radius_m: Annotated[Num, between(0, 1000)] = Field(
        default=0.0, description="of the ground that people given as points take up (m)"
    )

    @property
    def defaults(self) -> dict[str, float]:
        """Numbers for features without one of their own."""
        stated = {n: getattr(self, n) for n in OBJECT_NUMBERS}
        return {n: v for n, v in stated.items() if v is not None}

    @property
    def fields(self) -> dict[str, str]:
        """Attributes with the numbers of single features."""
        stated = {n: getattr(self, f"{n}_field") for n in OBJECT_NUMBERS}
        return {n: v for n, v in stated.items() if v is not None}


#: What may be said of an exposed object, as one number for all or as an attribute of each.
OBJECT_NUMBERS: dict[str, str] = {
    "value": "value that a hit of vulnerability 1 destroys; buildings",
    "value_per_m": "value of a metre; roads and lines",
    "damage_length_m": "length that a hit of vulnerability 1 destroys (m); without it the width of "
    "the block; roads and lines",
    "persons": "people who live, work or stay there; buildings and people",
    "presence": "share of the time that each of them is there, 0 to 1",
    "traffic_per_day": "vehicles a day, both directions; roads",
    "speed_kmh": "at which vehicles drive (km/h); roads",
    "vehicle_length_m": "mean length of a vehicle (m); roads",
    "persons_per_vehicle": "mean number of people in a vehicle; roads",
    "vehicle_value": "mean value of a vehicle; roads",
    "trips_per_day": "how often the road user of the individual risk drives by in a day; roads",
}


def _object_model() -> type[ObjectSection]:
    """``[[objects]]`` with a key and a ``_field`` key for each number."""
    keys: dict[str, Any] = {}
    for name, text in OBJECT_NUMBERS.items():
        keys[name] = (Annotated[Num, between(0)] | None, Field(default=None, description=text))
        keys[f"{name}_field"] = (
            str | None,
            Field(default=None, min_length=1, description=f"attribute with {name}"),
        )
    return create_model(
        "ObjectSettings", __base__=ObjectSection, __doc__=ObjectSection.__doc__, **keys
    )


ObjectSettings = _object_model()
