"""The Swiss minimal geodata model 166.1: its classes, where it holds, and values as it takes them.

The tables are ``data/federal_model.toml``, which names the source.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import geopandas as gpd
import numpy as np
import pandas as pd
import pyproj
import shapely

from sassgis.errors import InputError
from sassgis.files.plain_file import NO_XML
from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import Bounds, Grid
from sassgis.hazard.levels import opaque, zone_style
from sassgis.hazard.zoning.coverage import cell_polygons, within_terrain
from sassgis.settings.crs import crs_parts, same_crs
from sassgis.settings.hazard_rules import Canton, HazardLevel, HazardPreset, IntensityClass
from sassgis.settings.map_run import Config
from sassgis.settings.styles import ASSESSED_STYLE, FieldInfo, Symbol, VectorStyle

if TYPE_CHECKING:
    from sassgis.hazard.assess import Hazard, Intensities, Rules

MODEL_TITLE = "Swiss federal minimal geodata model 166.1, Hazard Mapping, version 1.3"
MODEL_NAME, MODEL_VERSION = "Hazard_Mapping_LV95_V1_3", "2021-03-01"
MODEL_URI = "https://models.geo.admin.ch/BAFU/"
TOPIC = f"{MODEL_NAME}.hazard_mapping"
#: EPSG code of the model's coordinates: CH1903+ / LV95.
FEDERAL_EPSG = 2056
#: (west, south, east, north) within which coordinates may lie (m).
FEDERAL_EXTENT = (2_460_000.0, 1_045_000.0, 2_870_000.0, 1_310_000.0)
#: Decimals of a coordinate in metres: 1 mm.
DECIMALS = 3
#: Up to this (years) no scenario is extreme, and an intensity is stated in detail.
LONGEST_OF_A_SCENARIO = 300
#: What every delivery holds; the other classes are of the extended model.
MINIMUM_CLASSES = ("assessment_area", "synoptic_intensity", "hazard_area")
RESPONSIBILITY = "data_responsibility"


@dataclass(frozen=True, slots=True)
class Attribute:
    """One attribute of a class of the model: a column of the layer.

    ``codes`` are the values of a "code", ``longest`` the most characters of a "text", ``low`` and
    ``high`` the limits of a number, both allowed, ``decimals`` those of a "number" in the transfer
    file. ``default`` is what the program writes where it knows no better.
    """

    name: str
    alias: str
    kind: str
    required: bool = True
    codes: tuple[str, ...] = ()
    longest: int = 0
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    decimals: int = 0
    default: Any = None

    @property
    def expected(self) -> str:
        """Allowed values, in words."""
        words = {
            "boolean": "true or false",
            "code": f"one of {', '.join(self.codes)}",
            "text": f"a text of at most {self.longest} characters",
            "whole": f"a whole number, {self.low:g} to {self.high:g}",
            "number": f"a number, {self.low:g} to {self.high:g}",
        }
        return words[self.kind]


@dataclass(frozen=True, slots=True)
class FederalClass:
    """One class of the model: the layer of the same name.

    ``geometry`` names the attribute that holds the surface; the others are in the order of the
    transfer, those that are inherited first.
    """

    name: str
    title: str
    description: str
    geometry: str
    attributes: tuple[Attribute, ...]


def _model() -> tuple[dict[str, tuple[str, ...]], dict[str, FederalClass]]:
    file = resources.files("sassgis") / "data" / "federal_model.toml"
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    codes = {name: tuple(entries) for name, entries in table["codes"].items()}
    codes["canton"] = get_args(Canton)  # and Liechtenstein
    attributes = {}
    for name, own in table["attributes"].items():
        kind = "code" if "codes" in own else "text" if "longest" in own else own["kind"]
        listed = codes[own["codes"]] if "codes" in own else ()
        attributes[name] = Attribute(name, **{**own, "kind": kind, "codes": listed})
    classes = {
        name: FederalClass(
            name, **{**own, "attributes": tuple(attributes[a] for a in own["attributes"])}
        )
        for name, own in table["classes"].items()
    }
    return codes, classes


CODES, _CLASSES = _model()
FEDERAL_CLASSES: Mapping[str, FederalClass] = _CLASSES


def is_lv95(crs: pyproj.CRS | str | None) -> bool:
    """Return whether coordinates are CH1903+ / LV95 (EPSG:2056), with or without heights."""
    if crs is None or crs == "":
        return False
    plane, _ = crs_parts(pyproj.CRS.from_user_input(crs))
    return same_crs(plane, pyproj.CRS.from_epsg(FEDERAL_EPSG))


def in_federal_extent(crs: pyproj.CRS | str | None, bounds: Bounds) -> bool:
    """Return whether coordinates and bounds (W, S, E, N; m) are those of the federal model."""
    west, south, east, north = bounds
    low_x, low_y, high_x, high_y = FEDERAL_EXTENT
    inside = low_x <= west <= east <= high_x and low_y <= south <= north <= high_y
    return inside and is_lv95(crs)


def has_federal_codes(preset: HazardPreset) -> bool:
    """Return whether a preset's classes and return periods can be written in federal codes."""
    return (
        all(c.code in CODES["intensity_class"] for c in preset.intensities)
        and all(c.code in CODES["hazard_level"] for c in preset.levels)
        and all(t == int(t) and 1 <= t <= 10_000 for t in preset.return_periods)
    )


def federal_note(federal: bool) -> str:
    """Return the note on the federal model for descriptions and metadata."""
    if federal:
        return f"Attributes and codes of the {MODEL_TITLE}."
    return (
        "Not data of a federal geodata model: the result lies outside Switzerland, in other "
        "coordinates, or has other classes."
    )


def checked_values(
    kind: FederalClass,
    values: Mapping[str, Any],
    where: str,
    federal: bool = True,
    optional: tuple[str, ...] = (),
    file: Path | None = None,
) -> dict[str, Any]:
    """Return values of one feature as the model has them: plain str, int, float, bool or None.

    Messages speak of the feature as ``where``, and name ``file``. Those of a ``federal`` layer must
    have the codes of the model; ``optional`` attributes may be empty nevertheless.
    """

    def refused(attribute: str, problem: str, found: object, expected: str) -> InputError:
        place, problem = f"{kind.name}.{attribute}", f"{where}: {problem}"
        return InputError(problem, file=file, field=place, found=found, expected=expected)

    checked: dict[str, Any] = {}
    for attribute in kind.attributes:
        found = plain(values.get(attribute.name))
        value = None if found is None else _of_kind(attribute, found, federal)
        if found is None and attribute.required and attribute.name not in optional:
            raise refused(attribute.name, "value is missing", None, attribute.expected)
        if found is not None and value is None:
            if isinstance(found, str) and attribute.longest:
                found = f"{len(found)} characters"
            raise refused(attribute.name, "value cannot be used", found, attribute.expected)
        checked[attribute.name] = value
    if broken := _broken_rule(checked):
        raise refused(*broken)
    return checked


def _broken_rule(values: Mapping[str, Any]) -> tuple[str, str, object, str] | None:
    """Return attribute, problem, found, expected of a rule that values break; None if none."""
    if "extreme_scenario" in values:
        years, extreme = values["return_period_in_years"], values["extreme_scenario"]
        rare = years is not None and years > LONGEST_OF_A_SCENARIO
        stated = f"a return period of {years} years" if years is not None else "no return period"
        if years is None and not extreme:
            expected = "years, unless the scenario is extreme"
            return "return_period_in_years", "value is missing", None, expected
        if extreme and years is not None and not rare:
            expected = f"none, or more than {LONGEST_OF_A_SCENARIO}"
            return "extreme_scenario", "an extreme scenario is too frequent", stated, expected
        if values["intensity_class"] == "existing_impact" and not rare:
            expected = f"existing_impact with more than {LONGEST_OF_A_SCENARIO} years only"
            return "intensity_class", "an intensity is not stated in detail", stated, expected
    probability = values.get("subscenario_probability")
    if probability is not None and probability != 1.0 and not values["scenario_description"]:
        expected = "a text, unless the probability of the sub-scenario is 1"
        return "scenario_description", "value is missing", None, expected
    return None


def plain(value: Any) -> Any:
    """Return None for all that means empty; text in single spaces, without what XML cannot hold."""
    if value is None or value is pd.NA or value != value:
        return None
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str):
        return " ".join(NO_XML.sub("", value).split()) or None
    return value


def _of_kind(attribute: Attribute, value: Any, federal: bool) -> Any:
    """Return the value in the kind of the attribute; None where it is not of it."""
    if attribute.kind == "boolean":
        # Where a column has gaps, booleans come as 0 and 1.
        return bool(value) if value in (0, 1) else None
    if attribute.kind in ("whole", "number"):
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        if not attribute.low <= value <= attribute.high:
            return None
        if attribute.kind == "whole" and value != int(value):
            return None
        return int(value) if attribute.kind == "whole" else float(value)
    if not isinstance(value, str):
        return None
    if attribute.kind == "code":
        return value if not federal or value in attribute.codes else None
    return value if len(value) <= attribute.longest else None


def unique_short_names(names: Sequence[str], longest: int = 50) -> dict[str, str]:
    """Cut names so that they are short enough and still differ; those that are short stay."""
    wanted = list(dict.fromkeys(names))
    plain = {name: " ".join(name.split()) for name in wanted}
    if empty := [name for name in wanted if not plain[name]]:
        raise InputError("a source has no name", found=repr(empty[0]), expected="a text")
    taken: set[str] = set()
    short: dict[str, str] = {}
    # Those that need no cut have the first claim to their name.
    for name in sorted(wanted, key=lambda name: len(plain[name]) > longest):
        text, number = plain[name][:longest].rstrip(), 1
        while text in taken:
            number += 1
            end = f"~{number}"
            text = plain[name][: longest - len(end)].rstrip() + end
        taken.add(text)
        short[name] = text
    return {name: short[name] for name in wanted}


def shortened(text: str, longest: int = 400) -> str:
    """Return text cut at a word, with an ellipsis, where it is too long."""
    text = " ".join(text.split())
    if len(text) <= longest:
        return text
    head = text[: longest - 1]
    words = head.rsplit(" ", 1)[0]
    return f"{words.rstrip(' ,;:') or head}…"


def surface_parts(geometry: Any, *, where: str, file: Path | None = None) -> list[Any]:
    """Return single polygons with straight edges, without heights, on coordinates of 1 mm.

    Corners that polygons share stay shared. What vanishes on the grid of 1 mm is left out. Messages
    name ``where`` and ``file``.
    """
    wrong = partial(InputError, file=file)
    if not isinstance(geometry, shapely.Polygon | shapely.MultiPolygon):
        raise wrong(
            f"{where}: cannot be a zone",
            found="nothing" if geometry is None else getattr(geometry, "geom_type", geometry),
            expected="a polygon with straight edges",
        )
    if not np.isfinite(shapely.get_coordinates(geometry)).all():
        raise wrong(f"{where}: a coordinate is no number")
    if not geometry.is_valid:
        raise wrong(f"{where}: the polygon is not valid", found=shapely.is_valid_reason(geometry))
    parts = []
    for part in shapely.get_parts(shapely.force_2d(geometry)).tolist():
        parts += _on_millimetres(part)
    return parts


def _on_millimetres(polygon: Any) -> list[Any]:
    if polygon.is_empty:
        return []
    # Not set_precision at once: it may put corners where the neighbour has none.
    rounded = shapely.transform(polygon, lambda xy: np.round(xy, DECIMALS))
    rounded = shapely.remove_repeated_points(rounded)
    if not rounded.is_valid:
        rounded = shapely.set_precision(polygon, 10.0**-DECIMALS)
        rounded = shapely.transform(rounded, lambda xy: np.round(xy, DECIMALS))
    return [
        part
        for part in shapely.get_parts(rounded).tolist()
        if part.geom_type == "Polygon" and not part.is_empty and part.is_valid
    ]


def check_extent(geometries: Sequence[Any], *, field: str, file: Path | None = None) -> None:
    """Raise InputError for coordinates outside the extent of the federal model."""
    if not len(geometries) or shapely.is_empty(geometries).all():
        return
    west, south, east, north = shapely.total_bounds(geometries).tolist()
    low_x, low_y, high_x, high_y = FEDERAL_EXTENT
    if not (low_x <= west and east <= high_x and low_y <= south and north <= high_y):
        found = f"E {west:.10g} to {east:.10g}, N {south:.10g} to {north:.10g}"
        expected = f"E {low_x:.10g} to {high_x:.10g}, N {low_y:.10g} to {high_y:.10g}"
        problem = "zones lie outside the extent of the federal model"
        raise InputError(problem, file=file, field=field, found=found, expected=expected)


#: A polygon with values by attribute; attributes that are not named have their defaults.
Row = tuple[Any, Mapping[str, Any]]

_COLUMN_TYPES = {"whole": "Int32", "number": "Float64", "boolean": "bool"}
#: Of layers without a legend of levels or intensities.
_STYLES = {
    "assessment_area": ASSESSED_STYLE,
    "indicative_hazard_area": VectorStyle(
        Symbol("fill", "#8c510a", outline="#8c510a", outline_mm=0.3, hatch="horizontal")
    ),
}


def federal_layers(
    config: Config,
    grid: Grid,
    rules: Rules,
    hazard: Hazard,
    by_area: Mapping[str, Intensities],
) -> list[VectorLayer]:
    """Return the layers of the federal model 166.1, or the same layers without claiming it."""
    preset, ref_width_m = rules.preset, rules.ref_width_m
    crs = grid.crs or None
    claims = in_federal_extent(crs, grid.bounds) and has_federal_codes(preset)
    level_codes = [level.code for level in preset.levels]
    assessed = cell_polygons(np.isfinite(grid.values), grid)
    complete = {}
    if rules.assessed:
        # Only what somebody draws and vouches for is complete, with all its release areas.
        assessed = np.array(within_terrain(rules.assessed, grid), np.object_)
        state = "not_complete" if rules.some_areas else "complete"
        complete = {"rf_state_rock_fall": f"assessed_and_{state}"}
    along = "a path for each block" if config.terrain.path == "followed" else "fall lines"
    method = (
        f"SASS (Bozzolo and Pamini, 1986): blocks simulated along {along}; "
        f"reference width {ref_width_m:.4g} m. Onset frequencies as stated by the user."
    )
    short = unique_short_names(list(by_area))
    # What is indicated is what the levels cover: beyond, blocks are rarer than any level.
    reached = shapely.get_parts(shapely.coverage_union_all(hazard.levels.polygons))
    rows: dict[str, list[Row]] = {
        "hazard_area": [
            (polygon, {"hazard_level": level_codes[k - 1], "comments": comment})
            for polygon, k, comment in zip(
                hazard.levels.polygons, hazard.levels.classes, _comments(hazard), strict=True
            )
        ],
        "synoptic_intensity": intensity_rows(hazard.intensities, preset),
        "intensity_by_source": [
            (
                polygon,
                {
                    **values,
                    "process_source": short[area],
                    "scenario_description": _scenarios(hazard, area),
                },
            )
            for area, maps in by_area.items()
            for polygon, values in intensity_rows(maps, preset)
        ],
        "indicative_hazard_area": [
            (polygon, {"hazard_area_existing": True, "method": method}) for polygon in reached
        ],
        "assessment_area": [(polygon, complete) for polygon in assessed],
    }
    if rules.assessed:
        # Outside nothing was assessed in detail; an indication goes beyond.
        within = shapely.union_all(assessed)
        beyond = shapely.union_all(reached).difference(within)
        rows["indicative_hazard_area"] = [
            (part, {**values, "hazard_area_existing": inside})
            for inside, area in ((True, within), (False, beyond))
            for part, values in _cut(rows["indicative_hazard_area"], area)
        ]
        for name in ("hazard_area", "synoptic_intensity", "intensity_by_source"):
            rows[name] = _cut(rows[name], within)
    if not by_area:
        del rows["intensity_by_source"]
    where: dict[str, Any] = {"crs": crs, "federal": claims, "canton": config.hazard.canton}
    legends = dict.fromkeys(rows, preset.intensities) | {"hazard_area": preset.levels}
    return [federal_layer(name, own, legend=legends[name], **where) for name, own in rows.items()]


def _cut(rows: Sequence[Row], area: Any) -> list[Row]:
    """Return rows with the parts of their polygons in an area; those without any are left out."""
    cut = ((shapely.get_parts(polygon.intersection(area)), values) for polygon, values in rows)
    polygons = (([p for p in parts if p.geom_type == "Polygon"], own) for parts, own in cut)
    return [(shapely.MultiPolygon(parts), own) for parts, own in polygons if parts]


def _comments(hazard: Hazard) -> list[str | None]:
    """Return the comment on each zone: who edited it by hand, when and why."""
    longest = next(
        a.longest for a in FEDERAL_CLASSES["hazard_area"].attributes if a.name == "comments"
    )
    words = [shortened(f"edited by hand: {a.edit.words}", longest) for a in hazard.edits]
    return [words[k] if k >= 0 else None for k in hazard.facts.edit]


def _scenarios(hazard: Hazard, area: str) -> str:
    """Return onset frequencies of an area in words."""
    parts = [
        f"{s.source.scenario}: {s.source.frequency:.3g} blocks a year"
        for s in hazard.sampled
        if s.source.area == area
    ]
    return shortened("; ".join(parts))


def intensity_rows(maps: Intensities, preset: HazardPreset) -> list[Row]:
    """Sort rows of a layer of intensity, the rarest first: the others are drawn over them."""
    rows: list[Row] = []
    for years in sorted(maps, key=lambda t: -(math.inf if t is None else t)):
        when = {"return_period_in_years": years, "extreme_scenario": years is None}
        for polygon, k in zip(maps[years].polygons, maps[years].classes, strict=True):
            rows.append((polygon, {"intensity_class": preset.intensities[k - 1].code, **when}))
    return rows


def federal_layer(
    name: str,
    rows: Sequence[Row],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    canton: str | None,
    legend: Sequence[HazardLevel] | Sequence[IntensityClass] = (),
) -> VectorLayer:
    """Return a layer of the model; rows with several parts become one feature per part.

    A layer that follows the ``federal`` model must lie in its extent. The canton ("TI") is
    responsible for the data; without it the model's export needs it filled in. The legend is from
    low to high.
    """
    kind = FEDERAL_CLASSES[name]
    if federal and not is_lv95(crs):
        found = "local coordinates" if not crs else pyproj.CRS.from_user_input(crs).name
        problem, expected = "the federal model is for other coordinates", f"EPSG:{FEDERAL_EPSG}"
        raise InputError(problem, field=name, found=found, expected=expected)
    common = {a.name: a.default for a in kind.attributes} | {RESPONSIBILITY: canton}
    parts: list[Any] = []
    values: list[dict[str, Any]] = []
    for number, (polygon, own) in enumerate(rows, start=1):
        pieces = surface_parts(polygon, where=f"{name}, polygon {number}")
        where = f"polygon {number}"
        checked = checked_values(kind, {**common, **own}, where, federal, (RESPONSIBILITY,))
        parts += pieces
        values += [checked] * len(pieces)
    columns = {
        a.name: pd.Series([v[a.name] for v in values], dtype=_COLUMN_TYPES.get(a.kind, "object"))
        for a in kind.attributes
    }
    frame = gpd.GeoDataFrame(columns, geometry=gpd.GeoSeries(parts, crs=crs or None))
    if federal:
        check_extent(frame.geometry.to_numpy(), field=name)
    return VectorLayer(
        name,
        kind.title,
        f"{kind.description} {federal_note(federal)}",
        frame,
        {a.name: FieldInfo(a.alias, a.unit) for a in kind.attributes},
        style=_style(name, legend),
    )


def _style(name: str, legend: Sequence[HazardLevel] | Sequence[IntensityClass]) -> VectorStyle:
    if name in _STYLES:
        return _STYLES[name]
    if name == "hazard_area":
        return zone_style(
            "hazard_level",
            [(c.code, c.label, c.colour, isinstance(c, HazardLevel) and c.hatched) for c in legend],
        )
    # Opaque: the zones of several return periods lie over each other, and must not mix.
    entries = [(c.code, c.label, c.colour, False) for c in legend]
    return opaque(zone_style("intensity_class", entries))
