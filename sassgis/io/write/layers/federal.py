"""Layers with the names, attributes and codes of the Swiss minimal geodata model 166.1.

Source: Federal Office for the Environment, minimal geodata model *Hazard Mapping* (identifier
166.1), version 1.3. What is known of it from elsewhere than its documentation has ``verified`` set
to false, and the page ``docs/federal_model.md`` calls it unverified.

The layers are made for results from any country, so that the result of one looks like that of the
other; only those in Switzerland say that they follow the model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import geopandas as gpd
import numpy as np
import pandas as pd
import pyproj
import shapely

from sassgis.hazard.zone_styles import opaque, zone_style
from sassgis.io.read.dem import same_crs
from sassgis.io.write.geopackage import VectorLayer
from sassgis.model.errors import InputError
from sassgis.model.hazard import HazardLevel, HazardPreset, IntensityClass
from sassgis.model.styles import FieldInfo, Symbol, VectorStyle

MODEL_TITLE = "Swiss federal minimal geodata model 166.1, Hazard Mapping, version 1.3"
#: EPSG code of the model's coordinates: CH1903+ / LV95.
FEDERAL_EPSG = 2056
#: (west, south, east, north) within which coordinates may lie (m).
FEDERAL_EXTENT = (2_460_000.0, 1_045_000.0, 2_870_000.0, 1_310_000.0)
#: Decimals of a coordinate in metres: 1 mm.
DECIMALS = 3
#: No extreme scenario has a return period up to this (years).
LONGEST_OF_A_SCENARIO = 300

HAZARD_LEVELS = ("not_in_danger", "residual_hazard", "slight", "mean", "substantial")
INTENSITY_CLASSES = ("no_impact", "existing_impact", "low", "mean", "high")
MAIN_PROCESSES = ("water", "landslide", "rockfall", "avalanche")
COMPLETENESS = ("complete", "not_complete", "not_recognizable", "to_be_clarified")
#: The model has more of these than the three that are known here.
STATES = ("not_assessed", "assessment_not_necessary", "assessed_and_complete")
CANTONS = (
    "AG", "AI", "AR", "BE", "BL", "BS", "FR", "GE", "GL", "GR", "JU", "LU", "NE", "NW", "OW", "SG",
    "SH", "SO", "SZ", "TG", "TI", "UR", "VD", "VS", "ZG", "ZH",
)  # fmt: skip

ROCKFALL = "rockfall"
ROCK_FALL_SUBPROCESS = "r_rock_fall"
NOT_ASSESSED = "not_assessed"
#: Code of a hazard that is indicated; not read in the model: unverified.
HAZARD_INDICATED = "indicated"

Kind = Literal["code", "text", "whole", "number", "boolean"]


@dataclass(frozen=True, slots=True)
class Attribute:
    """One attribute of a class of the model.

    Attributes
    ----------
    name : str
        Column of the layer.
    alias : str
        For people.
    kind : {"code", "text", "whole", "number", "boolean"}
    required : bool
        Whether each feature needs a value.
    codes : tuple of str
        Values of a "code"; empty where the model's are not known here.
    longest : int or None
        Most characters of a "text".
    low, high : float
        Limits of a number, both allowed.
    unit : str
    verified : bool
        Whether name and codes were read in the documentation of the model.
    """

    name: str
    alias: str
    kind: Kind
    required: bool = True
    codes: tuple[str, ...] = ()
    longest: int | None = None
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    verified: bool = True


@dataclass(frozen=True, slots=True)
class FederalClass:
    """One class of the model: the layer of the same name.

    Attributes
    ----------
    name, title, description : str
    geometry : str
        Name of the attribute that holds the surface.
    attributes : tuple of Attribute
        In the order of the columns.
    """

    name: str
    title: str
    description: str
    geometry: str
    attributes: tuple[Attribute, ...]


def _state(name: str, process: str, *, verified: bool = False) -> Attribute:
    return Attribute(
        name, f"state of assessment: {process}", "code", codes=STATES, verified=verified
    )


ROCK_FALL_STATE = "rf_state_rock_fall"
_STATE_ATTRIBUTES = (
    _state("fl_state_flooding", "flooding"),
    _state("df_state_debris_flow", "debris flow"),
    _state("be_state_bank_erosion", "bank erosion"),
    _state("pl_state_permanent_landslide", "permanent landslide"),
    _state("sl_state_spontaneous_landslide", "spontaneous landslide"),
    _state("hd_state_hillslope_debris_flow", "hillslope debris flow"),
    _state(ROCK_FALL_STATE, "rockfall", verified=True),
    _state("rs_state_rock_slide_rock_aval", "rock slide and rock avalanche"),
    _state("if_state_ice_fall", "ice fall"),
    _state("sh_state_sinkhole_or_subsidence", "sinkhole or subsidence"),
    _state("fa_state_flowing_avalanche", "flowing avalanche"),
    _state("pa_state_powder_avalanche", "powder avalanche"),
    _state("gs_state_gliding_snow", "gliding snow"),
)
_INTENSITY_ATTRIBUTES = (
    Attribute("intensity_class", "intensity", "code", codes=INTENSITY_CLASSES),
    Attribute("process_cantonal_term", "process, cantonal term", "text", False, longest=50),
    Attribute(
        "return_period_in_years", "return period", "whole", False, low=1, high=10_000, unit="years"
    ),
    Attribute("extreme_scenario", "extreme scenario", "boolean"),
)

FEDERAL_CLASSES: Mapping[str, FederalClass] = {
    entry.name: entry
    for entry in (
        FederalClass(
            "assessment_area",
            "Assessment area",
            "What was assessed, and for which processes.",
            "area",
            (
                Attribute("data_responsibility", "responsible canton", "code", codes=CANTONS),
                *_STATE_ATTRIBUTES,
                Attribute("comments", "comments", "text", False),
            ),
        ),
        FederalClass(
            "synoptic_intensity",
            "Intensity, all sources",
            "Intensity of all sources together, by return period.",
            "impact_zone",
            (
                *_INTENSITY_ATTRIBUTES,
                Attribute(
                    "subproc_synoptic_intensity",
                    "subprocess",
                    "code",
                    codes=(ROCK_FALL_SUBPROCESS,),
                ),
                Attribute(
                    "sources_in_subprocesses_compl",
                    "sources complete",
                    "code",
                    codes=COMPLETENESS,
                ),
            ),
        ),
        FederalClass(
            "intensity_by_source",
            "Intensity by source",
            "Intensity of each source alone, by return period.",
            "impact_zone",
            (
                *_INTENSITY_ATTRIBUTES,
                Attribute("process_source", "source", "text", longest=50),
                Attribute(
                    "subproc_intensity_by_source",
                    "subprocess",
                    "code",
                    codes=(ROCK_FALL_SUBPROCESS,),
                ),
                Attribute(
                    "subscenario_probability",
                    "probability of the sub-scenario",
                    "number",
                    False,
                    low=0.0,
                    high=1.0,
                ),
                Attribute("scenario_description", "scenario", "text", False, longest=400),
            ),
        ),
        FederalClass(
            "hazard_area",
            "Hazard level",
            "Worst hazard level of each place.",
            "impact_zone",
            (
                Attribute("main_process", "main process", "code", codes=MAIN_PROCESSES),
                Attribute("hazard_level", "hazard level", "code", codes=HAZARD_LEVELS),
                Attribute(
                    "subprocesses_complete", "subprocesses complete", "code", codes=COMPLETENESS
                ),
                Attribute("sources_complete", "sources complete", "code", codes=COMPLETENESS),
            ),
        ),
        FederalClass(
            "indicative_hazard_area",
            "Indicative hazard",
            "Where a hazard is indicated, without a level.",
            "impact_zone",
            (
                Attribute("indicative_process", "process", "code", codes=MAIN_PROCESSES),
                Attribute("hazard_indication", "hazard indication", "code", verified=False),
                Attribute("method", "method", "text", False, longest=400),
            ),
        ),
    )
}


# --- where the model holds -------------------------------------------------------------------


def is_lv95(crs: pyproj.CRS | str | None) -> bool:
    """Whether coordinates are CH1903+ / LV95 (EPSG:2056), with a height system or without."""
    if crs is None or crs == "":
        return False
    system = pyproj.CRS.from_user_input(crs)
    if system.is_compound:
        system = system.sub_crs_list[0]
    return same_crs(system, pyproj.CRS.from_epsg(FEDERAL_EPSG))


def in_federal_extent(
    crs: pyproj.CRS | str | None, bounds: tuple[float, float, float, float]
) -> bool:
    """Whether the coordinates are those of the federal model, and within its extent.

    Parameters
    ----------
    crs : CRS, str or None
        Coordinate system; None or empty for local coordinates.
    bounds : tuple of float
        West, south, east, north (m).
    """
    west, south, east, north = bounds
    low_x, low_y, high_x, high_y = FEDERAL_EXTENT
    inside = low_x <= west <= east <= high_x and low_y <= south <= north <= high_y
    return inside and is_lv95(crs)


def has_federal_codes(preset: HazardPreset) -> bool:
    """Whether the classes and return periods of a preset can be told in the federal codes."""
    return (
        all(c.code in INTENSITY_CLASSES for c in preset.intensities)
        and all(c.code in HAZARD_LEVELS for c in preset.levels)
        and all(t == int(t) and 1 <= t <= 10_000 for t in preset.return_periods)
    )


def federal_note(federal: bool) -> str:
    """What descriptions and metadata say of the federal model.

    Parameters
    ----------
    federal : bool
        Whether the result is one that the model is made for: see :func:`in_federal_extent` and
        :func:`has_federal_codes`.
    """
    if federal:
        return f"Attributes and codes of the {MODEL_TITLE}."
    return (
        "Not data of a federal geodata model: the result lies outside Switzerland, in other "
        "coordinates, or has other classes."
    )


# --- layers ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class IntensityZones:
    """Zones of intensity of one return period, or of the extreme scenario.

    Attributes
    ----------
    return_period : int or None
        Years; None only for the extreme scenario.
    extreme : bool
    polygons : sequence of Polygon or MultiPolygon
    codes : sequence of str
        Intensity of each polygon: "low", "mean", "high".
    """

    return_period: float | None
    extreme: bool
    polygons: Sequence[Any]
    codes: Sequence[str]


@dataclass(frozen=True, slots=True)
class SourceZones:
    """Zones of intensity of one source alone.

    Attributes
    ----------
    source : str
        Name of the release area.
    zones : sequence of IntensityZones
    subscenario_probability : float or None
        0 to 1.
    scenario_description : str
        At most 400 characters.
    """

    source: str
    zones: Sequence[IntensityZones]
    subscenario_probability: float | None = None
    scenario_description: str = ""


def assessment_area(
    polygons: Sequence[Any],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    canton: str | None = None,
    rock_fall_state: str = "assessed_and_complete",
    comments: str = "",
) -> VectorLayer:
    """What was assessed. Only rockfall was: all other processes are ``not_assessed``.

    Parameters
    ----------
    polygons : sequence of Polygon or MultiPolygon
        Multiparts become one feature per part.
    crs : CRS, str or None
        Of the polygons.
    federal : bool
        Whether the layer follows the federal model: then it must lie in its extent.
    canton : str, optional
        Who is responsible for the data ("TI"). The model asks for it, so that it has to be filled
        in before an export.
    rock_fall_state : str
        One of :data:`STATES`.
    comments : str

    Returns
    -------
    VectorLayer

    Raises
    ------
    InputError
        If a value or a polygon is not as the model has it.
    """
    values: dict[str, Any] = {a.name: NOT_ASSESSED for a in _STATE_ATTRIBUTES}
    values |= {
        "data_responsibility": canton or None,
        ROCK_FALL_STATE: rock_fall_state,
        "comments": comments,
    }
    rows = [(polygon, values) for polygon in polygons]
    style = VectorStyle(Symbol("fill", "#ffffff", opacity=0.0, outline="#222222", outline_mm=0.5))
    return _layer("assessment_area", rows, style, crs, federal, optional=("data_responsibility",))


def synoptic_intensity(
    zones: Sequence[IntensityZones],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    process_cantonal_term: str = ROCKFALL,
    sources_complete: str = "to_be_clarified",
    legend: Sequence[IntensityClass] = (),
) -> VectorLayer:
    """Intensity of all sources together, for each return period and the extreme scenario.

    Parameters
    ----------
    zones : sequence of IntensityZones
        Written with the rarest first, so that the more frequent are drawn over them.
    crs, federal
        As for :func:`assessment_area`.
    process_cantonal_term : str
        The canton's word for rockfall; at most 50 characters.
    sources_complete : str
        One of :data:`COMPLETENESS`: whether all sources are in it. No program can know.
    legend : sequence of IntensityClass
        Labels and colours; default: those of this module.

    Returns
    -------
    VectorLayer

    Raises
    ------
    InputError
        If a value or a polygon is not as the model has it.
    """
    rows = [
        (
            polygon,
            {
                **values,
                "process_cantonal_term": process_cantonal_term,
                "subproc_synoptic_intensity": ROCK_FALL_SUBPROCESS,
                "sources_in_subprocesses_compl": sources_complete,
            },
        )
        for polygon, values in _intensity_rows("synoptic_intensity", zones)
    ]
    return _layer("synoptic_intensity", rows, _intensity_style(legend), crs, federal)


def intensity_by_source(
    sources: Sequence[SourceZones],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    process_cantonal_term: str = ROCKFALL,
    legend: Sequence[IntensityClass] = (),
) -> VectorLayer:
    """Intensity of each source alone.

    Parameters
    ----------
    sources : sequence of SourceZones
        Their names are cut to 50 characters so that they still differ; a name may come several
        times, with other scenarios.
    crs, federal, process_cantonal_term, legend
        As for :func:`synoptic_intensity`.

    Returns
    -------
    VectorLayer

    Raises
    ------
    InputError
        If a value or a polygon is not as the model has it.
    """
    short = unique_short_names([s.source for s in sources])
    rows = [
        (
            polygon,
            {
                **values,
                "process_cantonal_term": process_cantonal_term,
                "process_source": short[source.source],
                "subproc_intensity_by_source": ROCK_FALL_SUBPROCESS,
                "subscenario_probability": source.subscenario_probability,
                "scenario_description": source.scenario_description,
            },
        )
        for source in sources
        for polygon, values in _intensity_rows("intensity_by_source", source.zones)
    ]
    return _layer("intensity_by_source", rows, _intensity_style(legend), crs, federal)


def hazard_area(
    polygons: Sequence[Any],
    codes: Sequence[str],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    subprocesses_complete: str = "not_complete",
    sources_complete: str = "to_be_clarified",
    legend: Sequence[HazardLevel] = (),
) -> VectorLayer:
    """Zones of hazard level.

    Parameters
    ----------
    polygons : sequence of Polygon or MultiPolygon
    codes : sequence of str
        Level of each polygon: "residual_hazard", "slight", "mean", "substantial".
    crs, federal
        As for :func:`assessment_area`.
    subprocesses_complete, sources_complete : str
        One of :data:`COMPLETENESS`. Of the sub-processes of rockfall (rock slides, ice fall) only
        the fall of single rocks is simulated.
    legend : sequence of HazardLevel
        Labels and colours; default: those of this module.

    Returns
    -------
    VectorLayer

    Raises
    ------
    InputError
        If a value or a polygon is not as the model has it.
    """
    _same_length("hazard_area", polygons, codes)
    rows = [
        (
            polygon,
            {
                "main_process": ROCKFALL,
                "hazard_level": code,
                "subprocesses_complete": subprocesses_complete,
                "sources_complete": sources_complete,
            },
        )
        for polygon, code in zip(polygons, codes, strict=True)
    ]
    return _layer("hazard_area", rows, _level_style(legend), crs, federal)


def indicative_hazard_area(
    polygons: Sequence[Any],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    method: str = "",
    hazard_indication: str = HAZARD_INDICATED,
) -> VectorLayer:
    """Where a hazard is indicated, without a level.

    Parameters
    ----------
    polygons : sequence of Polygon or MultiPolygon
    crs, federal
        As for :func:`assessment_area`.
    method : str
        How the zones came about; at most 400 characters.
    hazard_indication : str
        A code of the model; its codes are not known here, so that the default is unverified.

    Returns
    -------
    VectorLayer

    Raises
    ------
    InputError
        If a value or a polygon is not as the model has it.
    """
    values = {
        "indicative_process": ROCKFALL,
        "hazard_indication": hazard_indication,
        "method": method,
    }
    rows = [(polygon, values) for polygon in polygons]
    style = VectorStyle(
        Symbol("fill", "#8c510a", outline="#8c510a", outline_mm=0.3, hatch="horizontal")
    )
    return _layer("indicative_hazard_area", rows, style, crs, federal)


def _intensity_rows(
    layer: str, zones: Sequence[IntensityZones]
) -> list[tuple[Any, dict[str, Any]]]:
    rows = []
    # The extreme scenario, then from rare to frequent.
    for zone in sorted(zones, key=lambda zone: (not zone.extreme, -_years(zone))):
        _same_length(layer, zone.polygons, zone.codes)
        for polygon, code in zip(zone.polygons, zone.codes, strict=True):
            values = {
                "intensity_class": code,
                "return_period_in_years": zone.return_period,
                "extreme_scenario": zone.extreme,
            }
            rows.append((polygon, values))
    return rows


def _years(zone: IntensityZones) -> float:
    years = _plain(zone.return_period)
    return years if isinstance(years, int | float) else math.inf


def _same_length(layer: str, polygons: Sequence[Any], codes: Sequence[str]) -> None:
    if len(polygons) != len(codes):
        raise InputError(
            "each polygon needs a code",
            field=layer,
            found=f"{len(codes)} codes",
            expected=f"{len(polygons)}",
        )


def _layer(
    name: str,
    rows: Sequence[tuple[Any, Mapping[str, Any]]],
    style: VectorStyle,
    crs: pyproj.CRS | str | None,
    federal: bool,
    optional: tuple[str, ...] = (),
) -> VectorLayer:
    kind = FEDERAL_CLASSES[name]
    if federal and not is_lv95(crs):
        raise InputError(
            "the federal model is for other coordinates",
            field=name,
            found="local coordinates" if not crs else pyproj.CRS.from_user_input(crs).name,
            expected=f"EPSG:{FEDERAL_EPSG}",
        )
    parts: list[Any] = []
    owners: list[int] = []
    for number, (polygon, _) in enumerate(rows):
        for part in surface_parts(polygon, where=f"{name}, polygon {number + 1}"):
            parts.append(part)
            owners.append(number)
    values = [
        checked_values(kind, rows[owner][1], f"polygon {owner + 1}", federal, optional)
        for owner in owners
    ]
    columns = {a.name: _column(a, [v[a.name] for v in values]) for a in kind.attributes}
    frame = gpd.GeoDataFrame(columns, geometry=gpd.GeoSeries(parts, crs=crs or None))
    if federal:
        check_extent(frame.geometry.to_numpy(), field=name)
    return VectorLayer(
        name,
        kind.title,
        f"{kind.description} {federal_note(federal)}",
        frame,
        {
            a.name: FieldInfo(
                a.alias, a.unit, "" if a.verified or not federal else "not verified in the model"
            )
            for a in kind.attributes
        },
        style=style,
    )


def _column(attribute: Attribute, values: Sequence[Any]) -> Any:
    """Values in the type that the column has whether there are any or not."""
    types = {"whole": "Int32", "number": "Float64", "boolean": "bool"}
    return pd.Series(list(values), dtype=types.get(attribute.kind, "object"))


# --- values ----------------------------------------------------------------------------------


def checked_values(
    kind: FederalClass,
    values: Mapping[str, Any],
    where: str,
    federal: bool = True,
    optional: tuple[str, ...] = (),
    file: Path | None = None,
) -> dict[str, Any]:
    """Values of one feature as the model has them.

    Parameters
    ----------
    kind : FederalClass
    values : mapping of str to object
        By attribute.
    where : str
        How messages speak of the feature.
    federal : bool
        Whether codes must be those of the model.
    optional : tuple of str
        Attributes that may be empty nevertheless.
    file : Path, optional
        Named by messages.

    Returns
    -------
    dict of str to object
        Plain str, int, float, bool or None.

    Raises
    ------
    InputError
        If a value is missing, of the wrong kind, out of range, too long or no code of the model; if
        there is no return period though the scenario is not extreme; or an extreme one is frequent.
    """

    def refused(attribute: str, problem: str, found: object, expected: str) -> InputError:
        return InputError(
            f"{where}: {problem}",
            file=file,
            field=f"{kind.name}.{attribute}",
            found=found,
            expected=expected,
        )

    checked: dict[str, Any] = {}
    for attribute in kind.attributes:
        value = _plain(values.get(attribute.name))
        if value is None:
            if attribute.required and attribute.name not in optional:
                raise refused(attribute.name, "value is missing", None, _expected(attribute))
        else:
            value = _of_kind(attribute, value, federal)
            if value is None:
                found = _plain(values.get(attribute.name))
                if isinstance(found, str) and attribute.longest is not None:
                    found = f"{len(found)} characters"
                raise refused(attribute.name, "value cannot be used", found, _expected(attribute))
        checked[attribute.name] = value
    if "extreme_scenario" in checked:
        years, extreme = checked["return_period_in_years"], checked["extreme_scenario"]
        if years is None and not extreme:
            raise refused(
                "return_period_in_years",
                "value is missing",
                None,
                "years, unless the scenario is extreme",
            )
        if extreme and years is not None and years <= LONGEST_OF_A_SCENARIO:
            raise refused(
                "extreme_scenario",
                "an extreme scenario is too frequent",
                f"a return period of {years} years",
                f"none, or more than {LONGEST_OF_A_SCENARIO}",
            )
    return checked


def _plain(value: Any) -> Any:
    """None for all that means empty; text in single spaces."""
    if value is None or value is pd.NA or value != value:
        return None
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str):
        return " ".join(value.split()) or None
    return value


def _of_kind(attribute: Attribute, value: Any, federal: bool) -> Any:
    """The value in the kind of the attribute; None where it is not of it."""
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
        return value if not federal or not attribute.codes or value in attribute.codes else None
    return value if attribute.longest is None or len(value) <= attribute.longest else None


def _expected(attribute: Attribute) -> str:
    if attribute.kind == "boolean":
        return "true or false"
    if attribute.kind == "code":
        return f"one of {', '.join(attribute.codes)}" if attribute.codes else "a code"
    if attribute.kind == "text":
        return "a text" + (
            f" of at most {attribute.longest} characters" if attribute.longest else ""
        )
    words = "a whole number" if attribute.kind == "whole" else "a number"
    return f"{words}, {attribute.low:g} to {attribute.high:g}"


def unique_short_names(names: Sequence[str], longest: int = 50) -> dict[str, str]:
    """Cut names so that they are short enough and still differ.

    Parameters
    ----------
    names : sequence of str
        May repeat.
    longest : int
        Most characters.

    Returns
    -------
    dict of str to str
        Short name of each. Names that are short enough stay as they are.

    Raises
    ------
    InputError
        If a name is empty.
    """
    wanted = list(dict.fromkeys(names))
    plain = {name: " ".join(name.split()) for name in wanted}
    if empty := [name for name in wanted if not plain[name]]:
        raise InputError("a source has no name", found=repr(empty[0]), expected="a text")
    taken: set[str] = set()
    short: dict[str, str] = {}
    # Those that need no cut have the first claim to their own name.
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
    """Text cut at a word, with an ellipsis, where it is too long."""
    text = " ".join(text.split())
    if len(text) <= longest:
        return text
    head = text[: longest - 1]
    words = head.rsplit(" ", 1)[0]
    return f"{words.rstrip(' ,;:') or head}…"


# --- geometry --------------------------------------------------------------------------------


def surface_parts(
    geometry: Any, *, where: str, file: Path | None = None, decimals: int = DECIMALS
) -> list[Any]:
    """Single polygons with straight edges, without heights, on coordinates of 1 mm.

    Corners that polygons share stay shared. What vanishes on the grid of 1 mm is left out.

    Parameters
    ----------
    geometry : Polygon or MultiPolygon
    where : str
        How messages speak of it.
    file : Path, optional
        Named by messages.
    decimals : int
        Of a coordinate (m).

    Returns
    -------
    list of Polygon
        Valid, not empty.

    Raises
    ------
    InputError
        If it is no polygon, or crosses itself.
    """
    if not isinstance(geometry, shapely.Polygon | shapely.MultiPolygon):
        raise InputError(
            f"{where}: cannot be a zone",
            file=file,
            found="nothing" if geometry is None else getattr(geometry, "geom_type", geometry),
            expected="a polygon with straight edges",
        )
    if not np.isfinite(shapely.get_coordinates(geometry)).all():
        raise InputError(f"{where}: a coordinate is no number", file=file)
    if not geometry.is_valid:
        raise InputError(
            f"{where}: the polygon is not valid", file=file, found=shapely.is_valid_reason(geometry)
        )
    parts = []
    for part in shapely.get_parts(shapely.force_2d(geometry)).tolist():
        parts += _on_millimetres(part, decimals)
    return parts


def _on_millimetres(polygon: Any, decimals: int) -> list[Any]:
    if polygon.is_empty:
        return []
    # Not set_precision at once: it may put corners where the neighbour has none.
    rounded = shapely.transform(polygon, lambda xy: np.round(xy, decimals))
    rounded = shapely.remove_repeated_points(rounded)
    if not rounded.is_valid:
        rounded = shapely.set_precision(polygon, 10.0**-decimals)
        rounded = shapely.transform(rounded, lambda xy: np.round(xy, decimals))
    return [
        part
        for part in shapely.get_parts(rounded).tolist()
        if part.geom_type == "Polygon" and not part.is_empty and part.is_valid
    ]


def check_extent(geometries: Sequence[Any], *, field: str, file: Path | None = None) -> None:
    """Refuse coordinates outside the extent of the federal model.

    Raises
    ------
    InputError
    """
    if not len(geometries) or shapely.is_empty(geometries).all():
        return
    west, south, east, north = shapely.total_bounds(geometries).tolist()
    low_x, low_y, high_x, high_y = FEDERAL_EXTENT
    if not (low_x <= west and east <= high_x and low_y <= south and north <= high_y):
        raise InputError(
            "zones lie outside the extent of the federal model",
            file=file,
            field=field,
            found=f"E {west:.10g} to {east:.10g}, N {south:.10g} to {north:.10g}",
            expected=f"E {low_x:.10g} to {high_x:.10g}, N {low_y:.10g} to {high_y:.10g}",
        )


# --- styles ----------------------------------------------------------------------------------

_LEVEL_LEGEND = {
    "substantial": ("substantial hazard", "#e2001a", False),
    "mean": ("mean hazard", "#3c78d8", False),
    "slight": ("slight hazard", "#ffe500", False),
    "residual_hazard": ("residual hazard", "#e6cf00", True),
    "not_in_danger": ("not in danger", "#ffffff", False),
}
#: Violet, so that no map of intensities is taken for one of hazard levels.
_INTENSITY_LEGEND = {
    "high": ("high intensity", "#54278f", False),
    "mean": ("mean intensity", "#9e9ac8", False),
    "low": ("low intensity", "#dadaeb", False),
    "existing_impact": ("some intensity", "#f2d9ec", False),
    "no_impact": ("no impact", "#ffffff", False),
}


def _level_style(legend: Sequence[HazardLevel]) -> VectorStyle:
    entries = [(c.code, c.label, c.colour, c.hatched) for c in legend]
    return zone_style("hazard_level", entries or _entries(_LEVEL_LEGEND))


def _intensity_style(legend: Sequence[IntensityClass]) -> VectorStyle:
    entries = [(c.code, c.label, c.colour, False) for c in legend]
    # Opaque: the zones of several return periods lie over each other, and must not mix.
    return opaque(zone_style("intensity_class", entries or _entries(_INTENSITY_LEGEND)))


def _entries(
    legend: Mapping[str, tuple[str, str, bool]],
) -> list[tuple[str, str, str, bool]]:
    """Entries of a legend from slight to severe."""
    return [(code, *rest) for code, rest in reversed(list(legend.items()))]
