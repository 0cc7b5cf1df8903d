"""Hazard zones, what barriers change in them, and edits of experts, as layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd

from sassgis.files.vector_layer import VectorLayer, described_layer
from sassgis.grid import Grid, IntArray
from sassgis.hazard.assess import Hazard, raster, shares_by
from sassgis.hazard.levels import (
    hazard_level_style,
    level_change_style,
    uncertain_style,
)
from sassgis.hazard.zoning.applied_edits import AppliedEdit, shares_text
from sassgis.hazard.zoning.coverage import Coverage, cell_polygons
from sassgis.inputs.vectors import edit_fields
from sassgis.settings.hazard_rules import NO_LEVEL, HazardPreset
from sassgis.settings.languages import translated
from sassgis.settings.styles import EDIT_STYLE, OPEN_LIMIT_STYLE, REACHED_STYLE, VectorStyle

#: Sources that are named in the table of a zone.
_NAMED_SOURCES = 5


def joined_layers(parts: Sequence[Sequence[VectorLayer]]) -> list[VectorLayer]:
    """Return layers of separate places as layers of all of them; zones are numbered through."""
    out = []
    for layers in zip(*parts, strict=True):
        frame = pd.concat([layer.frame for layer in layers], ignore_index=True)
        if "zone" in frame:
            frame["zone"] = np.arange(1, len(frame) + 1)
        out.append(replace(layers[0], frame=frame))
    return out


def zone_sources(hazard: Hazard) -> pd.DataFrame:
    """Tabulate the share of each source in each zone, a row for each share above 0."""
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
    """Return the largest shares of each zone in words: "Nord 62 %, Gully 38 %"."""
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
    """Return zones of hazard level with what governs them and how sure they are."""
    facts = hazard.facts
    sources = [s.source for s in hazard.sampled]
    levels = [preset.levels[k - 1] for k in hazard.levels.classes]
    columns = {
        "zone": np.arange(1, hazard.levels.polygons.size + 1),
        "hazard_level": [level.code for level in levels],
        "label": [translated(level.label) for level in levels],
        "area_m2": np.round(facts.area_m2, 1),
        "governing_area": [sources[k].area if k >= 0 else "" for k in facts.governing],
        "governing_scenario": [sources[k].scenario if k >= 0 else "" for k in facts.governing],
        "share_by_area": _largest(*shares_by(facts.shares, [s.area for s in sources])),
        "share_by_scenario": _largest(*shares_by(facts.shares, [s.scenario for s in sources])),
        "cells": facts.cells,
        "uncertain_share": np.round(facts.uncertain, 4),
        "edited": [hazard.edits[k].edit.words if k >= 0 else "" for k in facts.edit],
        "limit_moves_m": np.round(facts.moves_m, 2),
        "open_m": np.round(facts.open_m, 1),
        "ref_width_m": np.full(len(levels), ref_width_m),
    }
    return described_layer(
        "hazard_zones",
        columns,
        list(hazard.levels.polygons),
        grid.crs,
        hazard_level_style("hazard_level", preset.levels),
        preset=preset.name,
        ref_width_m=ref_width_m,
        percent=f"{100 * confidence:g} %",
    )


def uncertain_zones(uncertain_cells: np.ndarray, grid: Grid, confidence: float) -> VectorLayer:
    """Return cells whose level another sample of blocks might change."""
    percent = f"{100 * confidence:g} %"
    return _outlined("uncertain", uncertain_cells, grid, uncertain_style(), percent=percent)


def reached_limit(reached: IntArray, grid: Grid) -> VectorLayer:
    """Outline how far simulated blocks came at all, however rarely; ``reached`` are flat cells."""
    return _outlined("reached_limit", reached, grid, REACHED_STYLE)


def _outlined(
    key: str, cells: IntArray, grid: Grid, style: VectorStyle, **words: Any
) -> VectorLayer:
    """Return patches of cells with their areas."""
    shown = cell_polygons(raster(grid, cells, np.ones(cells.size)) > 0, grid)
    columns = {"area_m2": [round(p.area, 1) for p in shown]}
    return described_layer(key, columns, list(shown), grid.crs, style, **words)


def open_limits(hazard: Hazard, preset: HazardPreset, grid: Grid) -> VectorLayer:
    """Map where zones end at the edge of the known terrain, beyond which they go on."""
    limits, length = hazard.facts.open_limit, hazard.facts.open_m
    zone = np.flatnonzero(length > 0.0)
    columns = {
        "zone": zone + 1,
        "hazard_level": [preset.levels[k - 1].code for k in hazard.levels.classes[zone]],
        "length_m": np.round(length[zone], 1),
    }
    return described_layer("open_limits", columns, list(limits[zone]), grid.crs, OPEN_LIMIT_STYLE)


def changes(before: Coverage, after: Coverage) -> gpd.GeoDataFrame:
    """Return parts of two maps of zones with their class before and after (0: no zone)."""
    one = gpd.GeoDataFrame({"before": before.classes}, geometry=list(before.polygons))
    two = gpd.GeoDataFrame({"after": after.classes}, geometry=list(after.polygons))
    both = one.overlay(two, how="union", keep_geom_type=True) if len(one) else two
    both = both.reindex(columns=["before", "after", "geometry"])
    both = both.fillna({"before": 0, "after": 0}).astype({"before": int, "after": int})
    both = gpd.GeoDataFrame(both, geometry="geometry").explode(ignore_index=True)
    return both[both.geometry.area > 0.0].reset_index(drop=True)


def level_changes(
    both: gpd.GeoDataFrame, codes: Sequence[str], crs: str, key: str = "level_changes"
) -> VectorLayer:
    """Return parts of zones from :func:`changes` by change of level; codes from low to high."""
    codes = [NO_LEVEL, *codes]
    before, after = both["before"], both["after"]
    columns = {
        "level_before": [codes[k] for k in before],
        "level_after": [codes[k] for k in after],
        "change": np.select([after < before, after > before], ["lower", "higher"], "same"),
        "area_m2": both.geometry.area.round(1),
    }
    return described_layer(key, columns, list(both.geometry), crs, level_change_style("change"))


def change_table(
    both: gpd.GeoDataFrame, labels: Sequence[str], rows: str = "level_without"
) -> pd.DataFrame:
    """Return the area by level before (rows) and after (columns), m²; ``both`` from changes."""
    labels = ["none", *labels]
    area = np.zeros((len(labels), len(labels)))
    np.add.at(area, (both["before"].to_numpy(), both["after"].to_numpy()), both.geometry.area)
    frame = pd.DataFrame(area.round(1), columns=[f"{v} (m2)" for v in labels])
    frame.insert(0, rows, labels)
    return frame


def without_barriers(layer: VectorLayer) -> VectorLayer:
    """Return the zones of a run without barriers, under a separate name."""
    return replace(layer, name="hazard_zones_without", title="Hazard zones without barriers")


def edits_layer(applied: Sequence[AppliedEdit], preset: HazardPreset, crs: str) -> VectorLayer:
    """Return edits with what was computed at their time; without features if there are none."""
    codes = [NO_LEVEL, *(c.code for c in preset.levels)]
    edits = [a.edit for a in applied]
    columns = {
        "level": [codes[e.level] for e in edits],
        "limit": [e.limit or None for e in edits],
        "author": [e.author for e in edits],
        "date": [e.date for e in edits],
        "reason": [e.reason for e in edits],
        "computed": [shares_text(a.then or a.now) for a in applied],
        "computed_now": [shares_text(a.now) for a in applied],
    }
    frame = pd.DataFrame(columns, dtype="object")
    frame["changed_share"] = np.array([a.changed for a in applied], np.float64).round(3)
    shapes, fields = [e.geometry for e in edits], edit_fields(codes[1:], True)
    return described_layer("edits", frame, shapes, crs, EDIT_STYLE, fields=fields)
