"""Every setting of a run but those of the effects: declared here once, by section."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import field, replace
from datetime import date
from typing import Annotated, Any, Literal

from annotated_types import Interval, MinLen
from pydantic import Strict

from sassgis.errors import ConfigError
from sassgis.settings.hazard_rules import OnsetUnit
from sassgis.settings.languages import Language, phrase
from sassgis.settings.results import ControlLine
from sassgis.settings.schema import (
    Codes,
    ConfigFile,
    Example,
    FieldName,
    File,
    InputFile,
    Name,
    Renamed,
    Section,
    Several,
    Span,
    Text,
    checked,
    declared,
)


@checked(frozen=True, slots=True)
class ProjectSettings(Section):
    """Title of the project and who answers for it, on map sheets and in the report."""

    name: Annotated[Text, "title on maps and in the report"] = "rockfall"
    author: Annotated[Text | None, "who made it", Example("A. Name, Office")] = None
    contact: Annotated[Text | None, "where to ask: an address", Example("office@example.org")] = (
        None
    )
    rights: Annotated[Text | None, "rights and sources of the terrain", Example("© swisstopo")] = (
        None
    )
    date: Annotated[
        Text | None, "date, as 2026-01-31; default: the day of the run", Example("2026-01-31")
    ] = None
    checked_by: Annotated[
        Text | None,
        "who has checked the result; without it sheets and report are marked as a draft",
        Example("B. Name, Office"),
    ] = None
    checked_on: Annotated[Text | None, "date of that check", Example("2026-02-28")] = None
    base_map: Annotated[
        File | None,
        "raster in the coordinates of the terrain model that lies under the zones on map sheets, "
        "in place of the relief",
        Example("base_map.tif"),
    ] = None
    language: Annotated[
        Language,
        ("language of legends, map sheets, figures and report: English, German, French, Italian"),
    ] = "en"

    def _fits_together(self) -> None:
        for key in ("date", "checked_on"):
            day = getattr(self, key)
            try:
                date.fromisoformat(day or "2026-01-31")
            except ValueError:
                raise ConfigError(
                    "is no date", field=key, found=day, expected="year-month-day: 2026-01-31"
                ) from None
        if (self.checked_by is None) != (self.checked_on is None):
            raise ConfigError(
                "is given without the other", field="checked_by, checked_on",
                expected="who has checked the result, and when",
            )  # fmt: skip

    @property
    def status(self) -> str:
        """Whether the result is a draft, or who has checked it and when."""
        if self.checked_by is None:
            return phrase("draft, not checked")
        return phrase("checked by {}, {}", self.checked_by, self.checked_on)


@checked(frozen=True, slots=True)
class TerrainSettings(Section):
    """The DEM, and how fall lines are traced and flattened."""

    dem: Annotated[
        InputFile | None,
        "terrain model: a raster, such as GeoTIFF, or a folder of tiles",
        Example("dem.tif", needed=True),
    ] = None
    crs: Annotated[
        Text | None,
        "coordinate system if the DEM states none, e.g. EPSG:2056, or 'local'",
        Example("EPSG:2056"),
    ] = None
    override_crs: Annotated[bool, "use crs although the DEM states another (wrong) system"] = False
    vertical_datum: Annotated[
        Text | None, "name of the height system if the DEM states none", Example("LN02")
    ] = None
    smoothing_m: Annotated[
        float,
        Interval(ge=0, le=200),
        "smoothing of the terrain for fall lines: Gaussian standard deviation (m)",
    ] = 5.0
    segment_tolerance_m: Annotated[
        float, Interval(ge=0, le=100), "largest vertical gap between terrain and segments (m)"
    ] = 0.05
    block_scale_m: Annotated[
        float | None,
        Interval(ge=0, le=100),
        "size below which terrain counts as roughness: heights on finer cells are averaged over it "
        "before lines are flattened (m); 0: never; default: mean diameter of the smallest block "
        'scenario; with engine.readings = "1986": 0',
        Example(1.0),
    ] = None
    energy_line_angle_deg: Annotated[
        float,
        Interval(ge=0, le=60),
        "lines end where they sink below this angle seen from the start (degrees); choose it lower "
        "than any run-out that you expect",
    ] = 20.0
    max_line_length_m: Annotated[
        float, Interval(ge=1, le=100_000), "longest fall line, in plan (m)"
    ] = 5000.0
    path: Annotated[
        Literal["followed", "fall_line"],
        '"followed": each block changes its direction at impacts and while it rolls; the terrain '
        'is flattened along its path. "fall_line": all blocks of a release point move on its '
        "fall line",
    ] = "followed"
    flat_slope_deg: Annotated[
        float, Interval(ge=0, le=30), "slope below which a line tends to keep its heading (degrees)"
    ] = 8.0

    def _fits_together(self) -> None:
        if self.override_crs and self.crs is None:
            raise ConfigError(
                "has no system to go with", field="override_crs", expected="terrain.crs as well"
            )


@checked(frozen=True, slots=True)
class ReleaseSettings(Section):
    """Where blocks start."""

    file: Annotated[
        InputFile | None,
        "polygons, lines or points of release",
        Example("release.gpkg", needed=True),
    ] = None
    layer: Annotated[Text | None, "layer, where the file has several", Example("release")] = None
    name_field: Annotated[
        Text | None,
        "attribute with the names of the areas; else area 1, area 2 and so on",
        Example("name"),
    ] = None
    scenario_field: Annotated[
        Text | None,
        "attribute naming the block scenarios of an area: a;b for several; empty: all",
        Example("scenario"),
    ] = None
    spacing_m: Annotated[
        float, Interval(gt=0, le=10_000), "distance between release points (m)"
    ] = 5.0
    placement: Annotated[
        Literal["grid", "random"],
        "layout of the points: on a grid, or at random with the same density",
    ] = "grid"
    rocks_per_point: Annotated[
        int, Interval(ge=1, le=1_000_000), "blocks released at each release point"
    ] = 50
    #: The configuration, for messages of those who are given only this section.
    config_file: ConfigFile = field(default=None, compare=False, repr=False)


@checked(frozen=True, slots=True)
class GroundSettings(Section):
    """The kind of ground of each cell."""

    default: Annotated[Name, "ground class outside the polygons or the raster"] = "debris"
    file: Annotated[
        InputFile | None, "polygons or a raster of ground classes", Example("ground.gpkg")
    ] = None
    layer: Annotated[Text | None, "layer, where the file has several", Example("ground")] = None
    class_field: Annotated[Text, "attribute with the class names"] = "class"
    classes: Annotated[
        InputFile | None,
        "table of ground classes (CSV or TOML) that adds to the built-in ones or replaces them",
        Example("classes.csv"),
    ] = None
    ranges: Annotated[
        InputFile | None,
        "table of the spread of ground classes between sites (CSV); replaces built-in values",
        Example("class_spread.csv"),
    ] = None
    raster_classes: Annotated[
        Codes | None,
        "class of each code, where the file is a raster",
        Example({1: "rock", 2: "debris"}),
    ] = None
    #: The configuration, for messages of those who are given only this section.
    config_file: ConfigFile = field(default=None, compare=False, repr=False)

    def _fits_together(self) -> None:
        self._goes_with(("layer", "raster_classes"), "file", "file", "ground.file")


Semiaxis = Span[Annotated[float, Interval(gt=0, le=10)]]
Point = Annotated[tuple[float, float], Strict(False)]
Proportion = Span[Annotated[float, Interval(gt=0, le=1)]]
AXES = ("axis_1_m", "axis_2_m", "axis_3_m")


@checked(frozen=True, slots=True)
class BlockSettings(Section):
    """One block scenario; every range may also be a single number."""

    name: Annotated[Name, "name of the scenario", Example("1 m3", needed=True)]
    axis_1_m: Annotated[
        Semiaxis | None,
        "first SEMI-axis, half the length of the block (m)",
        Example((0.65, 0.85), needed=True),
    ] = None
    axis_2_m: Annotated[
        Semiaxis | None, "second SEMI-axis (m)", Example((0.55, 0.70), needed=True)
    ] = None
    axis_3_m: Annotated[
        Semiaxis | None, "third SEMI-axis (m)", Example((0.45, 0.60), needed=True)
    ] = None
    volume_m3: Annotated[
        Span[Annotated[float, Interval(gt=0, le=1000)]] | None,
        "volume of the block, in place of the axes (m3)",
        Example((0.1, 1.0)),
    ] = None
    volume_exponent: Annotated[
        float | None,
        Interval(ge=0, le=10),
        "b of a power law: the frequency of blocks larger than V falls as V^-b between "
        "the limits of volume_m3; without it all volumes between them are equally likely",
        Example(1.0),
    ] = None
    shape: Annotated[
        Annotated[tuple[Proportion, Proportion, Proportion], Strict(False)] | None,
        "with volume_m3: proportions of the three axes, as [1, [0.7, 0.9], 0.6]; "
        "default [1, [0.7, 1], [0.5, 0.8]]",
        Example((1.0, (0.7, 1.0), (0.5, 0.8))),
    ] = None
    onset_frequency: Annotated[
        float | None,
        Interval(ge=0, le=1e6),
        "onset frequency of blocks of this scenario",
        Example(0.1),
    ] = None
    onset_unit: Annotated[
        OnsetUnit,
        "of onset_frequency: per year in each release area, per year and hectare of "
        "it (in plan), or per year and metre of it (release lines), as far as heights are known",
    ] = "per_year"
    onset_above_m3: Annotated[
        float | None,
        Interval(gt=0, le=1000),
        "with volume_exponent: onset_frequency is that of blocks larger than this "
        "(m3), from which the power law gives the frequency between the limits of volume_m3",
        Example(0.1),
    ] = None
    density_kgm3: Annotated[
        Span[Annotated[float, Interval(ge=500, le=10_000)]], "density of the block (kg/m3)"
    ] = (2700.0, 2700.0)
    speed_mps: Annotated[
        Span[Annotated[float, Interval(ge=0, le=150)]],
        "speed at the start, downhill along the slope (m/s)",
    ] = (0.0, 0.0)
    spin_radps: Annotated[
        Span[Annotated[float, Interval(ge=-300, le=300)]],
        "spin at the start, positive as a block rolling downhill (rad/s)",
    ] = (0.0, 0.0)
    drop_m: Annotated[
        Span[Annotated[float, Interval(ge=0, le=1000)]],
        "height above rest from which the block is released (m)",
    ] = (0.0, 0.0)
    orientation_rad: Annotated[
        Span[Annotated[float, Interval(ge=-2.0 * math.pi, le=2.0 * math.pi)]],
        "angle of the longest axis to the slope at the start (rad)",
    ] = (0.0, math.pi)

    def _fits_together(self) -> None:
        axes = [key for key in AXES if getattr(self, key) is not None]
        if self.volume_m3 is not None and axes:
            raise ConfigError(
                "has both a volume and axes", found=axes[0], expected="volume_m3 or the three axes"
            )
        if self.volume_m3 is None:
            for key in AXES:
                if key not in axes:
                    raise ConfigError(
                        "missing key",
                        field=key,
                        expected="three SEMI-axis ranges (m), or volume_m3 instead",
                    )
        self._goes_with(("volume_exponent", "shape"), "volume_m3", "volume")
        self._goes_with(("onset_above_m3",), "volume_exponent", "power law")

    @property
    def axes(self) -> dict[str, tuple[float, float]]:
        """The three axes, semi-axes in metres or proportions."""
        shape = self.shape or ((1.0, 1.0), (0.7, 1.0), (0.5, 0.8))
        return {key: getattr(self, key) or shape[i] for i, key in enumerate(AXES)}


@checked(frozen=True, slots=True)
class StationSettings(Section):
    """A line on the map, or a chainage, where passing blocks are recorded."""

    name: Annotated[Name, "name of the station or barrier", Example("road")]
    line: Annotated[
        Annotated[Several[Point], MinLen(2)] | None,
        "[[x, y], [x, y], ...] in the DEM's coordinates (m)",
        Example(((2700010.0, 1150000.0), (2700090.0, 1150010.0))),
    ] = None
    file: Annotated[
        InputFile | None,
        "layer of lines; each feature is a station or barrier",
        Example("stations.gpkg"),
    ] = None
    layer: Annotated[Text | None, "layer, where the file has several", Example("stations")] = None
    name_field: Annotated[
        Text | None, "attribute with the names; else the name and a number", Example("name")
    ] = None
    chainage_m: Annotated[
        float | None, "chainage along the profile; profile runs only (m)", Example(120.0)
    ] = None

    def _fits_together(self) -> None:
        places = [k for k in ("line", "file", "chainage_m") if getattr(self, k) is not None]
        if len(places) != 1:
            raise ConfigError(
                "must be put in one place",
                found=" and ".join(places) or "none",
                expected="exactly one of line, file, chainage_m",
            )
        self._goes_with(("layer", "name_field"), "file", "file")


#: Keys of a gallery's roof, and all keys of a barrier that its features may hold.
_ROOF_KEYS = ("width_m", "roof_slope_deg", "cushion_kpa")
_BARRIER_KEYS = ("kind", "height_m", "capacity_kj", *_ROOF_KEYS)


@checked(frozen=True, slots=True)
class BarrierSettings(StationSettings):
    """A wall, a net or a gallery; placed as a station is.

    Values are one for all features, or attributes of each (``<key>_field``).
    """

    kind: Annotated[
        Literal["wall", "net", "gallery"] | None,
        "wall (or dam), net or gallery",
        Example("net"),
    ] = None
    kind_field: FieldName = None
    height_m: Annotated[
        float | None,
        Interval(ge=0, le=100),
        "height of the top above the ground, vertical; of a gallery: of the uphill edge of its "
        "roof, which may be 0 (m)",
        Example(4.0),
    ] = None
    height_m_field: FieldName = None
    capacity_kj: Annotated[
        float | None,
        Interval(gt=0),
        "energy capacity (kJ); without a value the barrier stops every block that hits it",
        Example(2000.0),
    ] = None
    capacity_kj_field: FieldName = None
    width_m: Annotated[
        float | None,
        Interval(gt=0, le=200),
        "galleries: width of the roof downslope of the line, in plan (m)",
        Example(9.0),
    ] = None
    width_m_field: FieldName = None
    roof_slope_deg: Annotated[
        float | None,
        Interval(ge=0, le=60),
        "galleries: slope of the roof downhill (degrees); without a value it is level",
        Example(10.0),
    ] = None
    roof_slope_deg_field: FieldName = None
    cushion_kpa: Annotated[
        float | None,
        Interval(gt=0, le=1e6),
        "galleries: modulus M_E of the cushion on the roof (kPa), from a plate bearing test",
        Example(3200.0),
    ] = None
    cushion_kpa_field: FieldName = None
    restarts_from_rest: Annotated[
        bool,
        "whether stopped blocks start again from rest, as below some nets",
        Renamed("lets_go"),
    ] = False

    def _fits_together(self) -> None:
        StationSettings._fits_together(self)
        self._goes_with((f"{key}_field" for key in _BARRIER_KEYS), "file", "file")
        for key in self.needed:
            if getattr(self, f"{key}_field") is None and getattr(self, key) is None:
                raise ConfigError(
                    "missing key", field=key, expected=declared(BarrierSettings)[key].description
                )
        if self.kind in (None, "gallery"):
            return
        for key in _ROOF_KEYS:
            if (value := getattr(self, key)) is not None:
                raise ConfigError(
                    f"does not go with a {self.kind}", field=key, found=f"{value:g}",
                    expected='a value for galleries (kind = "gallery") only',
                )  # fmt: skip
        if self.height_m == 0.0:
            raise ConfigError(
                f"a {self.kind} needs a height", field="height_m", found="0.0", expected="above 0"
            )

    @property
    def needed(self) -> tuple[str, ...]:
        """Keys that must have a value."""
        of_roof = ("width_m", "cushion_kpa") if self.kind == "gallery" else ()
        return ("kind", "height_m", *of_roof)

    @property
    def fields(self) -> dict[str, str]:
        """Attributes of single features, by key."""
        stated = {key: getattr(self, f"{key}_field") for key in _BARRIER_KEYS}
        return {key: field for key, field in stated.items() if field is not None}

    def control_line(self, name: str) -> ControlLine:
        """Return this barrier under the name of one of its features.

        What is needed must be stated: values of single features are put in by ``replace`` first.
        """
        assert self.kind is not None and self.height_m is not None
        capacity = math.inf if self.capacity_kj is None else self.capacity_kj
        return ControlLine(
            name, self.kind, self.height_m, capacity, self.restarts_from_rest,
            **{key: getattr(self, key) or 0.0 for key in _ROOF_KEYS},
        )  # fmt: skip


#: The named sets of readings; None: as the ground class says.
_READINGS: Mapping[str, Mapping[str, Any]] = {
    "1986": {
        "eta_max_rule": "scale", "rolling": "round", "rolling_threshold": 0.1, "tipping": False,
        "corner": "ellipse", "rolling_friction_sd": 0.0, "outline_edges": 0.0,
        "outline_share": 1.0,
    },
    "hazard": {
        "eta_max_rule": "restitution", "rolling": "ellipse", "rolling_threshold": None,
        "tipping": True, "corner": "circle", "rolling_friction_sd": 0.25, "outline_edges": 0.19,
        "outline_share": 0.33,
    },
}  # fmt: skip


@checked(frozen=True, slots=True)
class EngineSettings(Section):
    """Modelling assumptions where the paper is silent (docs/model.md).

    Keys without a value are as in the named set ``readings``: ``resolved`` fills them in.
    """

    readings: Annotated[
        Literal["hazard", "1986"],
        'named set of modelling assumptions: "hazard" for hazard work, "1986" as in the paper. It '
        "sets eta_max_rule, rolling, rolling_threshold, rolling_friction_sd, outline_edges, "
        "outline_share, tipping and corner, unless you give them",
    ] = "hazard"
    block: Annotated[
        Literal["ellipse", "point"],
        '"point": blocks are mass points, the first model of the authors of 1986: they rebound and '
        "slide with friction μ_f, and neither turn nor roll; it needs another eta_max_rule than "
        '"scale"',
    ] = "ellipse"
    gravity_mps2: Annotated[float, Interval(ge=0.1, le=30.0), "acceleration of gravity (m/s2)"] = (
        9.81
    )
    eta_max_rule: Annotated[
        Literal["scale", "coulomb", "restitution"] | None,
        "the law of impact. "
        '"scale": no velocity is left at the contact, and what keeps more energy than η_max is '
        'scaled down to it. "coulomb": the contact slips where friction μ_f cannot hold it; then '
        'as "scale". "restitution": the contact rebounds with the coefficient of the ground class '
        "and slips with friction μ_f; the ground also brakes the block by the impulse (1 − η_max) "
        '× normal impulse (default: "restitution"; "1986": "scale")',
        Example("restitution"),
    ] = None
    slope_variation: Annotated[
        Literal["per_impact", "off"],
        "whether each impact on descending ground meets it at tan β' = tan β (1 − u)",
    ] = "per_impact"
    rolling_threshold: Annotated[
        float | None,
        Interval(ge=0.0, le=10.0),
        "a block lands softly and rolls when v_n²/(2 g cos β) is below this share of its radius; "
        'default: the column of the ground class; "1986": 0.1',
        Example(0.1),
    ] = None
    rolling: Annotated[
        Literal["round", "ellipse"] | None,
        '"round": dv/dt = g (sin β − μ_r cos β), as in the paper; the block leaves the ground '
        'at convex vertices only. "ellipse": the centre of the turning ellipse rises and falls, '
        "and the block leaves the ground where the normal force on it ends (N <= 0) (default: "
        '"ellipse"; "1986": "round")',
        Example("ellipse"),
    ] = None
    rolling_friction_sd: Annotated[
        float | None,
        Interval(ge=0.0, le=1.0),
        "how much rolling friction and resistance differ from block to block: mu_r and mu_v of "
        "each are multiplied by a factor drawn once, log-normal about 1 with this standard "
        'deviation of its logarithm (default: 0.25; "1986": 0)',
        Example(0.25),
    ] = None
    outline_edges: Annotated[
        float | None,
        Interval(ge=0.0, le=0.5),
        "how far the outline of a block departs from a circle where its two longer axes are equal, "
        "by its edges: the axes in the plane of motion have the ratio 1 + outline_edges + "
        'outline_share × (a/b − 1) (default: 0.19; "1986": 0)',
        Example(0.15),
    ] = None
    outline_share: Annotated[
        float | None,
        Interval(ge=0.0, le=1.0),
        "how much of the difference of the two longer axes acts in the plane of motion: a block "
        'that turns about a moving axis is rounder than its box (default: 0.33; "1986": 1)',
        Example(0.5),
    ] = None
    tipping: Annotated[
        bool | None,
        "whether a sliding block tips over and rolls where the moment of friction about its "
        "centre exceeds the largest that the ground can hold against it (default: true; "
        '"1986": false)',
        Example(True),
    ] = None
    corner: Annotated[
        Literal["ellipse", "circle"] | None,
        'shape with which a rolling block hits ground that rises ahead of it: "ellipse" in its '
        'orientation, or "circle" of its mean radius, so that it loses energy once per corner '
        '(default: "circle"; "1986": "ellipse")',
        Example("circle"),
    ] = None
    end_sliding: Annotated[
        bool, "whether a block too slow to turn over its longer axis ends by sliding"
    ] = True
    contact_tolerance_m: Annotated[
        float, Interval(ge=1e-12, le=1e-2), "gap below which ground and block touch (m)"
    ] = 1e-6
    max_events: Annotated[
        int, Interval(ge=100, le=10_000_000), "contacts after which a block is aborted and reported"
    ] = 20_000
    side_tilt_deg: Annotated[
        float,
        Interval(ge=0, le=45),
        "of followed paths: standard deviation of the lateral tilt of the ground at an impact "
        "(degrees)",
    ] = 7.0
    drift_deg: Annotated[
        float,
        Interval(ge=0, le=30),
        "of followed paths: standard deviation of the angle between the path and the steepest "
        "descent, drawn once for each block (degrees)",
    ] = 5.0

    def _fits_together(self) -> None:
        rule = self.eta_max_rule or _READINGS[self.readings]["eta_max_rule"]
        if self.block == "point" and rule == "scale":
            raise ConfigError(
                "a mass point would stop at its first contact",
                field="eta_max_rule", found="scale",
                expected='"restitution" or "coulomb" with block = "point"',
            )  # fmt: skip

    def resolved(self) -> EngineSettings:
        """Return the same settings with every key of the named set filled in.

        In "hazard" ``rolling_threshold`` stays None: the column of the ground class counts.
        """
        own = {
            key: value for key, value in _READINGS[self.readings].items()
            if getattr(self, key) is None
        }  # fmt: skip
        return replace(self, **own)


@checked(frozen=True, slots=True)
class ProfileSettings(Section):
    """A run along a single profile (sassgis profile), which needs neither terrain nor release."""

    file: Annotated[
        InputFile | None, "CSV with columns s_m, z_m and, if wanted, ground", Example("profile.csv")
    ] = None
    start_m: Annotated[Span[float], "chainages between which blocks start (m)"] = (0.0, 0.0)
    rocks: Annotated[int, Interval(ge=1, le=100_000_000), "number of blocks"] = 100


@checked(frozen=True, slots=True)
class RunSettings(Section):
    """Seed and processor cores."""

    seed: Annotated[
        int,
        Interval(ge=0, le=2**63 - 1),
        "the same seed gives the same blocks with any number of jobs",
    ] = 1
    jobs: Annotated[int, Interval(ge=0, le=4096), "processor cores; 0: all of them"] = 0
    ground_uncertainty: Annotated[
        int,
        Interval(ge=0, le=10_000),
        "of run and zone: number of further simulations of all blocks with values of the ground "
        "classes drawn from their spread between sites; 0: no bands",
    ] = 0


TableFormat = Literal["none", "csv", "parquet"]


#: Limits between the classes of all maps of energies (kJ).
ENERGY_CLASSES_KJ = (30.0, 100.0, 300.0, 1000.0, 3000.0, 10_000.0)


@checked(frozen=True, slots=True)
class OutputSettings(Section):
    """What is written."""

    stop_points_max: Annotated[
        int, Interval(ge=0, le=100_000_000), "most stop points written to the map"
    ] = 100_000
    paths_max: Annotated[
        int, Interval(ge=0, le=10_000), "most paths of single blocks in space, written to the map"
    ] = 100
    rock_table: Annotated[TableFormat, "one row per block"] = "none"
    passage_table: Annotated[TableFormat, "one row per block and station or barrier"] = "none"
    energy_classes_kj: Annotated[
        Several[Annotated[float, Interval(gt=0)]],
        MinLen(1),
        "limits between the energy classes (kJ)",
    ] = ENERGY_CLASSES_KJ

    def _fits_together(self) -> None:
        limits = self.energy_classes_kj
        if any(low >= high for low, high in itertools.pairwise(limits)):
            raise ConfigError(
                "limits do not rise", field="energy_classes_kj", found=list(limits),
                expected="numbers in ascending order",
            )  # fmt: skip
