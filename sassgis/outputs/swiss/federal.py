"""Layers with the names, attributes and codes of the Swiss minimal geodata model 166.1.

The layers are made for results from any country, so that the result of one looks like that of the
other; only those in Switzerland say that they follow the model (``federal_model``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyproj
import shapely

from sassgis.errors import InputError
from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import Grid
from sassgis.hazard.assess import Hazard, Intensities
from sassgis.hazard.zone_styles import opaque, zone_style
from sassgis.hazard.zoning.cell_outlines import cell_polygons
from sassgis.outputs.swiss.federal_model import (
    FEDERAL_CLASSES,
    FEDERAL_EPSG,
    RESPONSIBILITY,
    check_extent,
    checked_values,
    federal_note,
    has_federal_codes,
    in_federal_extent,
    is_lv95,
    shortened,
    surface_parts,
    unique_short_names,
)
from sassgis.settings.hazard_rules import HazardLevel, HazardPreset, IntensityClass
from sassgis.settings.run_config import Config
from sassgis.settings.styles import FieldInfo, Symbol, VectorStyle

#: A polygon with values by attribute; attributes that are not named have their defaults.
Row = tuple[Any, Mapping[str, Any]]

_COLUMN_TYPES = {"whole": "Int32", "number": "Float64", "boolean": "bool"}
#: Of layers without a legend of levels or intensities.
_SYMBOLS = {
    "assessment_area": Symbol("fill", "#ffffff", opacity=0.0, outline="#222222", outline_mm=0.5),
    "indicative_hazard_area": Symbol(
        "fill", "#8c510a", outline="#8c510a", outline_mm=0.3, hatch="horizontal"
    ),
}


def federal_layers(
    config: Config,
    grid: Grid,
    preset: HazardPreset,
    ref_width_m: float,
    hazard: Hazard,
    by_area: Mapping[str, Intensities],
) -> list[VectorLayer]:
    """Return the layers of the federal model 166.1, or the same layers without claiming it."""
    crs = grid.crs or None
    claims = in_federal_extent(crs, grid.bounds) and has_federal_codes(preset)
    level_codes = [level.code for level in preset.levels]
    assessed = cell_polygons(np.isfinite(grid.values), grid)
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
        "assessment_area": [(polygon, {}) for polygon in assessed],
    }
    if not by_area:
        del rows["intensity_by_source"]
    where: dict[str, Any] = {"crs": crs, "federal": claims, "canton": config.hazard.canton}
    legends = dict.fromkeys(rows, preset.intensities) | {"hazard_area": preset.levels}
    return [federal_layer(name, own, legend=legends[name], **where) for name, own in rows.items()]


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
    if name in _SYMBOLS:
        return VectorStyle(_SYMBOLS[name])
    if name == "hazard_area":
        return zone_style(
            "hazard_level",
            [(c.code, c.label, c.colour, isinstance(c, HazardLevel) and c.hatched) for c in legend],
        )
    # Opaque: the zones of several return periods lie over each other, and must not mix.
    entries = [(c.code, c.label, c.colour, False) for c in legend]
    return opaque(zone_style("intensity_class", entries))
