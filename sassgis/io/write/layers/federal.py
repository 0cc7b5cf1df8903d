"""Layers with the names, attributes and codes of the Swiss minimal geodata model 166.1.

The layers are made for results from any country, so that the result of one looks like that of the
other; only those in Switzerland say that they follow the model (``federal_model``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import geopandas as gpd
import pandas as pd
import pyproj

from sassgis.hazard.zone_styles import opaque, zone_style
from sassgis.io.vector_layer import VectorLayer
from sassgis.io.write.layers.federal_model import (
    FEDERAL_CLASSES,
    FEDERAL_EPSG,
    NOT_ASSESSED,
    RESPONSIBILITY,
    ROCK_FALL_STATE,
    ROCK_FALL_SUBPROCESS,
    ROCKFALL,
    STATE_ATTRIBUTES,
    Attribute,
    federal_note,
    is_lv95,
)
from sassgis.io.write.layers.federal_values import (
    check_extent,
    checked_values,
    plain,
    surface_parts,
    unique_short_names,
)
from sassgis.model.errors import InputError
from sassgis.model.hazard import HazardLevel, IntensityClass
from sassgis.model.styles import FieldInfo, Symbol, VectorStyle


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
    subscenario_probability : float
        0 to 1; 1 for a whole scenario.
    scenario_description : str
        At most 400 characters; needed where the probability is not 1.
    """

    source: str
    zones: Sequence[IntensityZones]
    subscenario_probability: float = 1.0
    scenario_description: str = ""


def assessment_area(
    polygons: Sequence[Any],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    canton: str | None,
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
    canton : str or None
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
    values: dict[str, Any] = {a.name: NOT_ASSESSED for a in STATE_ATTRIBUTES}
    values |= {ROCK_FALL_STATE: rock_fall_state, "comments": comments}
    rows = [(polygon, values) for polygon in polygons]
    style = VectorStyle(Symbol("fill", "#ffffff", opacity=0.0, outline="#222222", outline_mm=0.5))
    return _layer("assessment_area", rows, style, crs, federal, canton)


def synoptic_intensity(
    zones: Sequence[IntensityZones],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    canton: str | None,
    process_cantonal_term: str = ROCKFALL,
    sources_complete: str = "to_be_clarified",
    legend: Sequence[IntensityClass] = (),
) -> VectorLayer:
    """Intensity of all sources together, for each return period and the extreme scenario.

    Parameters
    ----------
    zones : sequence of IntensityZones
        Written with the rarest first, so that the more frequent are drawn over them.
    crs, federal, canton
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
    return _layer("synoptic_intensity", rows, _intensity_style(legend), crs, federal, canton)


def intensity_by_source(
    sources: Sequence[SourceZones],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    canton: str | None,
    process_cantonal_term: str = ROCKFALL,
    legend: Sequence[IntensityClass] = (),
) -> VectorLayer:
    """Intensity of each source alone.

    Parameters
    ----------
    sources : sequence of SourceZones
        Their names are cut to 50 characters so that they still differ; a name may come several
        times, with other scenarios.
    crs, federal, canton, process_cantonal_term, legend
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
    return _layer("intensity_by_source", rows, _intensity_style(legend), crs, federal, canton)


def hazard_area(
    polygons: Sequence[Any],
    codes: Sequence[str],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    canton: str | None,
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
    crs, federal, canton
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
    return _layer("hazard_area", rows, _level_style(legend), crs, federal, canton)


def indicative_hazard_area(
    polygons: Sequence[Any],
    *,
    crs: pyproj.CRS | str | None,
    federal: bool,
    canton: str | None,
    hazard_area_existing: bool,
    method: str = "",
) -> VectorLayer:
    """Where a hazard is indicated, without a level.

    Parameters
    ----------
    polygons : sequence of Polygon or MultiPolygon
    crs, federal, canton
        As for :func:`assessment_area`.
    hazard_area_existing : bool
        Whether zones of hazard level cover the polygons.
    method : str
        How the zones were made; at most 400 characters.

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
        "hazard_indication": True,
        "method": method,
        "hazard_area_existing": hazard_area_existing,
    }
    rows = [(polygon, values) for polygon in polygons]
    style = VectorStyle(
        Symbol("fill", "#8c510a", outline="#8c510a", outline_mm=0.3, hatch="horizontal")
    )
    return _layer("indicative_hazard_area", rows, style, crs, federal, canton)


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
    years = plain(zone.return_period)
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
    canton: str | None,
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
        checked_values(
            kind,
            {RESPONSIBILITY: canton, **rows[owner][1]},
            f"polygon {owner + 1}",
            federal,
            optional=(RESPONSIBILITY,),
        )
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
        {a.name: FieldInfo(a.alias, a.unit) for a in kind.attributes},
        style=style,
    )


def _column(attribute: Attribute, values: Sequence[Any]) -> Any:
    """Values in the type that the column has whether there are any or not."""
    types = {"whole": "Int32", "number": "Float64", "boolean": "bool"}
    return pd.Series(list(values), dtype=types.get(attribute.kind, "object"))


# --- styles ----------------------------------------------------------------------------------

_LEVEL_LEGEND = {
    "substantial": ("high hazard (red)", "#e2001a", False),
    "mean": ("moderate hazard (blue)", "#3c78d8", False),
    "slight": ("low hazard (yellow)", "#ffe500", False),
    "residual_hazard": ("residual hazard", "#e6cf00", True),
    "not_in_danger": ("not in danger", "#ffffff", False),
}
#: Violet, so that no map of intensities is taken for one of hazard levels.
_INTENSITY_LEGEND = {
    "high": ("high intensity", "#54278f", False),
    "mean": ("medium intensity", "#9e9ac8", False),
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
    """Entries of a legend from low to high."""
    return [(code, *rest) for code, rest in reversed(list(legend.items()))]
