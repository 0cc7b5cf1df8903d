"""Hazard zones, intensities and what barriers change, as layers of ``hazard.gpkg``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from sassgis.hazard.assess import Hazard, IntensityMap, raster
from sassgis.hazard.attribution import shares_by_area, shares_by_scenario
from sassgis.hazard.zone_styles import hazard_level_style, level_change_style, uncertain_style
from sassgis.hazard.zoning.generalise import Coverage, ZoneSettings, coverage
from sassgis.io.vector_layer import VectorLayer
from sassgis.io.write.layers import federal
from sassgis.io.write.layers.federal_model import has_federal_codes, in_federal_extent
from sassgis.io.write.layers.federal_values import shortened
from sassgis.model.grid import Grid
from sassgis.model.hazard import HazardPreset
from sassgis.model.run_config import Config
from sassgis.model.styles import FieldInfo

#: Sources that are named in the table of a zone.
_NAMED_SOURCES = 5
_NO_LEVEL = "not_in_danger"


def federal_layers(
    config: Config,
    grid: Grid,
    preset: HazardPreset,
    ref_width_m: float,
    hazard: Hazard,
    by_area: Mapping[str, tuple[IntensityMap, ...]],
) -> list[VectorLayer]:
    """The layers of the federal model 166.1, or the same layers without claiming it."""
    crs = grid.crs or None
    claims = in_federal_extent(crs, grid.bounds) and has_federal_codes(preset)
    level_codes = [level.code for level in preset.levels]
    assessed = coverage(
        np.isfinite(grid.values).astype(np.int64),
        grid,
        ZoneSettings(min_area_m2=0.0, tolerance_m=0.0),
    )
    along = "paths that are followed" if config.terrain.path == "followed" else "fall lines"
    method = (
        f"SASS (Bozzolo and Pamini, 1986): blocks simulated along {along}; "
        f"reference width {ref_width_m:.4g} m. Onset frequencies as stated by the user."
    )
    sources = [
        federal.SourceZones(area, _intensity_zones(maps, preset), 1.0, _scenarios(hazard, area))
        for area, maps in by_area.items()
    ]
    where: dict[str, Any] = {"crs": crs, "federal": claims, "canton": config.hazard.canton}
    # Each cell that a block reaches has a level: what is indicated is what the levels cover.
    reached = list(shapely.get_parts(shapely.coverage_union_all(hazard.levels.polygons)))
    layers = [
        federal.hazard_area(
            list(hazard.levels.polygons),
            [level_codes[k - 1] for k in hazard.levels.classes],
            legend=preset.levels, **where,
        ),
        federal.synoptic_intensity(
            _intensity_zones(hazard.intensities, preset), legend=preset.intensities, **where
        ),
        federal.indicative_hazard_area(
            reached, hazard_area_existing=True, method=method, **where
        ),
        federal.assessment_area(list(assessed.polygons), **where),
    ]  # fmt: skip
    if by_area:
        layers.insert(2, federal.intensity_by_source(sources, legend=preset.intensities, **where))
    return layers


def _intensity_zones(
    maps: Sequence[IntensityMap], preset: HazardPreset
) -> list[federal.IntensityZones]:
    codes = [c.code for c in preset.intensities]
    return [
        federal.IntensityZones(
            m.years,
            m.years is None,
            list(m.zones.polygons),
            [codes[k - 1] for k in m.zones.classes],
        )
        for m in maps
    ]


def _scenarios(hazard: Hazard, area: str) -> str:
    """Onset frequencies of an area in words."""
    parts = [
        f"{s.source.scenario}: {s.source.frequency:.3g} blocks a year"
        for s in hazard.sampled
        if s.source.area == area
    ]
    return shortened("; ".join(parts))


def joined_layers(parts: Sequence[Sequence[VectorLayer]]) -> list[VectorLayer]:
    """Layers of separate places as layers of all of them; zones are numbered through."""
    out = []
    for layers in zip(*parts, strict=True):
        frame = pd.concat([layer.frame for layer in layers], ignore_index=True)
        if "zone" in frame:
            frame["zone"] = np.arange(1, len(frame) + 1)
        out.append(replace(layers[0], frame=frame))
    return out


def zone_sources(hazard: Hazard) -> pd.DataFrame:
    """Which source has which share in each zone, a row for each of both that is above 0."""
    facts = hazard.facts
    zone, source = np.nonzero(np.nan_to_num(facts.shares) > 0.0)
    sources = [s.source for s in hazard.sampled]
    return pd.DataFrame(
        {
            "zone": zone + 1,
            "area": [sources[k].area for k in source],
            "scenario": [sources[k].scenario for k in source],
            "share": facts.shares[zone, source],
        }
    )


def _largest(names: Sequence[str], shares: np.ndarray) -> list[str]:
    """The largest shares of each zone in words: "Nord 62 %, Gully 38 %"."""
    out = []
    for row in shares:
        if np.isnan(row).all():
            out.append("none: raised when the zone was drawn")
            continue
        order = np.argsort(-row, kind="stable")[:_NAMED_SOURCES]
        out.append(", ".join(f"{names[k]} {100 * row[k]:.0f} %" for k in order if row[k] > 0.0))
    return out


def hazard_zones(
    hazard: Hazard, preset: HazardPreset, grid: Grid, ref_width_m: float, confidence: float
) -> VectorLayer:
    """Zones of hazard level with what governs them and how sure they are."""
    facts = hazard.facts
    sources = [s.source for s in hazard.sampled]
    frame = gpd.GeoDataFrame(
        {
            "zone": np.arange(1, hazard.levels.polygons.size + 1),
            "hazard_level": [preset.levels[k - 1].code for k in hazard.levels.classes],
            "label": [preset.levels[k - 1].label for k in hazard.levels.classes],
            "area_m2": np.round(facts.area_m2, 1),
            "governing_area": [sources[k].area if k >= 0 else "" for k in facts.governing],
            "governing_scenario": [sources[k].scenario if k >= 0 else "" for k in facts.governing],
            "share_by_area": _largest(*shares_by_area(facts.shares, sources)),
            "share_by_scenario": _largest(*shares_by_scenario(facts.shares, sources)),
            "cells": facts.cells,
            "uncertain_share": np.round(facts.uncertain, 4),
            "ref_width_m": ref_width_m,
        },
        geometry=list(hazard.levels.polygons),
        crs=grid.crs or None,
    )
    return VectorLayer(
        "hazard_zones",
        "Hazard zones",
        f"Hazard levels of preset {preset.name}. Reference width {ref_width_m:.4g} m.",
        frame,
        {
            "zone": FieldInfo("zone"),
            "hazard_level": FieldInfo("hazard level, code"),
            "label": FieldInfo("hazard level"),
            "area_m2": FieldInfo("area", "m²"),
            "governing_area": FieldInfo("governing release area"),
            "governing_scenario": FieldInfo("governing block scenario"),
            "share_by_area": FieldInfo("shares of release areas"),
            "share_by_scenario": FieldInfo("shares of block scenarios"),
            "cells": FieldInfo("cells that blocks reach"),
            "uncertain_share": FieldInfo(
                "statistically uncertain cells",
                "1",
                f"share of cells whose level changes within the {100 * confidence:g} % interval",
            ),
            "ref_width_m": FieldInfo("reference width", "m"),
        },
        style=hazard_level_style("hazard_level", preset.levels),
    )


def uncertain_zones(uncertain_cells: np.ndarray, grid: Grid, confidence: float) -> VectorLayer:
    """Cells whose level another sample of blocks might change."""
    shown = coverage(raster(grid, uncertain_cells, np.ones(uncertain_cells.size)), grid)
    frame = gpd.GeoDataFrame(
        {"area_m2": [round(p.area, 1) for p in shown.polygons]},
        geometry=list(shown.polygons),
        crs=grid.crs or None,
    )
    return VectorLayer(
        "uncertain",
        "Level statistically uncertain",
        f"The level changes within the {100 * confidence:g} % sampling interval of its frequency.",
        frame,
        {"area_m2": FieldInfo("area", "m²")},
        style=uncertain_style(),
    )


def changes(before: Coverage, after: Coverage) -> gpd.GeoDataFrame:
    """Pieces of two maps of zones with their class in both (0: no zone).

    Columns ``before``, ``after``; geometry on the coordinates of the zones.
    """
    one = gpd.GeoDataFrame({"before": before.classes}, geometry=list(before.polygons))
    two = gpd.GeoDataFrame({"after": after.classes}, geometry=list(after.polygons))
    both = one.overlay(two, how="union", keep_geom_type=True) if len(one) else two
    both = both.reindex(columns=["before", "after", "geometry"])
    both = both.fillna({"before": 0, "after": 0}).astype({"before": int, "after": int})
    both = gpd.GeoDataFrame(both, geometry="geometry").explode(ignore_index=True)
    return both[both.geometry.area > 0.0].reset_index(drop=True)


def level_changes(
    both: gpd.GeoDataFrame,
    codes: Sequence[str],
    crs: str,
    title: str = "What walls and nets change",
    description: str = "Hazard level without and with walls and nets, from the same blocks.",
    names: tuple[str, str] = ("level without them", "level with them"),
) -> VectorLayer:
    """Pieces of zones by what becomes of their level.

    Parameters
    ----------
    both : GeoDataFrame
        From :func:`changes`.
    codes : sequence of str
        Of the levels, from low to high.
    crs : str
        Well-known text; empty for local coordinates.
    title, description : str
        Of the layer.
    names : (str, str)
        What the levels before and after are called.
    """
    codes = [_NO_LEVEL, *codes]
    frame = gpd.GeoDataFrame(
        {
            "level_before": [codes[k] for k in both["before"]],
            "level_after": [codes[k] for k in both["after"]],
            "change": np.select(
                [both["after"] < both["before"], both["after"] > both["before"]],
                ["lower", "higher"],
                "same",
            ),
            "area_m2": both.geometry.area.round(1),
        },
        geometry=list(both.geometry),
        crs=crs or None,
    )
    return VectorLayer(
        "level_changes",
        title,
        description,
        frame,
        {
            "level_before": FieldInfo(names[0]),
            "level_after": FieldInfo(names[1]),
            "change": FieldInfo("change"),
            "area_m2": FieldInfo("area", "m²"),
        },
        style=level_change_style("change"),
    )


def change_table(
    both: gpd.GeoDataFrame, labels: Sequence[str], rows: str = "level_without"
) -> pd.DataFrame:
    """Area by level before (rows) and after (columns), m²; ``both`` from changes."""
    labels = ["none", *labels]
    area = np.zeros((len(labels), len(labels)))
    np.add.at(area, (both["before"].to_numpy(), both["after"].to_numpy()), both.geometry.area)
    frame = pd.DataFrame(area.round(1), columns=[f"{v} (m2)" for v in labels])
    frame.insert(0, rows, labels)
    return frame


def without_barriers(layer: VectorLayer) -> VectorLayer:
    """The zones of a run without walls and nets, under a name of their own."""
    return replace(layer, name="hazard_zones_without", title="Hazard zones without walls and nets")
