"""Additions of zoning to the result of a run: maps, zones, risk, tables, sheets, report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from sassgis.files.vector_layer import VectorLayer
from sassgis.grid import Grid
from sassgis.hazard.assess import Assessment, Hazard, Rules
from sassgis.hazard.risk import RiskTable
from sassgis.hazard.sampling_error import LevelChances
from sassgis.hazard.sources import line_parts
from sassgis.hazard.warnings import (
    assessed_warnings,
    edge_words,
    edit_warnings,
    ground_shares,
    ground_words,
    rule_warnings,
    zone_warnings,
)
from sassgis.hazard.zoning.coverage import within_terrain
from sassgis.outputs.layers import zones as zone_layers
from sassgis.outputs.layers.hazard_maps import hazard_layers
from sassgis.outputs.layers.risk_objects import risk_tables, risk_vectors
from sassgis.outputs.qgis.run_project import onset_words, zone_groups, zone_layouts
from sassgis.outputs.swiss.federal_model import federal_layers
from sassgis.outputs.zone_tables import design_tables, layer_table, protection_table, source_table
from sassgis.report.map_report import zone_lines
from sassgis.report.protection_page import levels_of, protection_sheets
from sassgis.report.zone_report import level_table, zone_facts_of, zone_figures, zone_tables
from sassgis.runs.inputs import zoning_files
from sassgis.runs.publish import (
    Extras,
    line_facts,
    map_hazard,
    object_facts,
    rates_by_source,
    values_at_objects,
)
from sassgis.runs.resumable_run import Simulation
from sassgis.settings.hazard_rules import HazardCurves, HazardPreset
from sassgis.settings.languages import named, phrase
from sassgis.settings.map_run import Config
from sassgis.settings.results import CHANGED_SHARE, RasterLayer
from sassgis.simulation.map_sums import MapSums

#: Layers of a group of areas that make sense for all groups together; the first is a table, too.
_OF_GROUPS = ("hazard_zones", "hazard_area", "synoptic_intensity", "indicative_hazard_area")


def zone_extras(
    rules: Rules, found: Assessment, done: Simulation, at_objects: MapSums, figures: Path
) -> Extras:
    """Make all that zoning adds to a result; its figures go into the folder ``figures``.

    ``at_objects`` are the sums of the cells of exposed objects.
    """
    config, run, preset = done.config, done.run, rules.preset
    grid, confidence, currency = run.grid, config.hazard.confidence, config.risk.currency
    hazard, budget = found.hazard, config.hazard.budget
    outside = assessed_warnings(hazard.levels.polygons, rules.assessed)
    rules = replace(rules, assessed=within_terrain(rules.assessed, grid))
    maps = hazard_maps(rules, hazard.curves, hazard.chances, grid, confidence)
    width = rules.ref_width_m
    zones = zone_layers.hazard_zones(hazard, preset, grid, width, confidence)
    uncertain = hazard.chances.places[hazard.uncertain]
    open_ = zone_layers.open_limits(hazard, preset, grid)
    own = [open_] if len(open_.frame) else []
    own += [
        zones,
        zone_layers.uncertain_zones(uncertain, grid, confidence),
        zone_layers.reached_limit(hazard.curves.places, grid),
    ]
    edits = zone_layers.edits_layer(hazard.edits, preset, grid.crs)
    risk: list[VectorLayer] = []
    sources = source_table(hazard.sampled)
    frames = {
        "zones": layer_table(zones),
        "zone_sources": zone_layers.zone_sources(hazard),
        "sources": sources,
    }
    periods = config.hazard.design_return_periods_years
    lines = [line for line, _ in run.control_lines]
    design, places = design_tables(
        grid, run.control_lines, found.without_barriers, periods, confidence,
        rules.placed.geometries,
    )  # fmt: skip
    protection = protection_table(
        lines, found.without_barriers, hazard.sampled, periods,
        min(b.density_kgm3[0] for b in run.released_blocks), confidence,
    )  # fmt: skip
    if lines:
        frames |= {"design": design, "protection": protection, "protection_places": places}
    without = found.without
    if without is not None:
        before = zone_layers.hazard_zones(without, preset, grid, width, confidence)
        both = zone_layers.changes(without.levels, hazard.computed)
        codes, labels = zip(*((c.code, c.label) for c in preset.levels), strict=True)
        own += [
            zone_layers.without_barriers(before),
            zone_layers.level_changes(both, codes, grid.crs),
        ]
        frames["level_changes"] = zone_layers.change_table(both, labels)
    values = values_at_objects(done, hazard.sampled, periods, at_objects)
    if found.risk is not None:
        bare = None
        if without is not None:
            # Heights are those of the maps, with barriers.
            bare = values_at_objects(done, without.sampled, periods, None)
        risk = risk_vectors(found.risk, rules.placed, grid.crs, currency, values)
        frames |= risk_tables(found.risk, found.risk_without, currency, (values, bare))
    federal = federal_layers(config, grid, rules, hazard, found.by_area)
    levels = level_table(preset, found)
    energies = hazard.curves.energies_kj
    on_objects = levels_of(rules.placed, hazard.levels, preset, hazard.sampled, energies)
    edge = edge_words(run, done.progress, hazard.facts.open_limit)
    ground = ground_words(ground_shares(run, done.progress.sums.cells))
    assumed = (("Onset frequencies", onset_words(rules)), ("Ground classes", ground))
    reused: tuple[tuple[str, str], ...] = ()
    if done.reused_from is not None:
        names = ", ".join(done.reused_areas) or phrase("none")
        text = phrase("{} (from the result {})", names, named(done.reused_from.name))
        reused = (("Release areas that were not simulated again", text),)
    sheets = partial(
        protection_sheets, run.control_lines, found.without_barriers, hazard.sampled,
        (design, protection, places), assumed, figures, confidence,
    )  # fmt: skip
    return Extras(
        layers=maps,
        vectors=(*own, *risk, *federal),
        groups=zone_groups(
            maps, own, risk, federal, preset, edits, assessed=bool(rules.assessed)
        ),
        layouts=lambda words: zone_layouts(words, rules, found, own, risk, grid),
        figures=partial(
            zone_figures, run, rules, found, maps, figures, confidence=confidence,
            currency=currency, history=done.progress.history,
            changed_share_max=0.0 if budget is None else budget.changed_share,
        ),
        sheets=sheets,
        key_results=levels,
        tables=zone_tables(
            preset, found, sources, design, return_periods_years=periods, currency=currency
        ),
        described=(*zone_facts_of(rules), *reused),
        summary=zone_lines(preset, levels, found, edge, confidence, currency),
        hazard=map_hazard(rules, found),
        contributions=rates_by_source(hazard.sampled),
        parts=line_parts(hazard.sampled),
        places=line_facts(run, found.without_barriers, hazard.sampled, periods)
        | object_facts(found.risk, hazard.sampled, energies, on_objects, currency),
        frequencies=rules.frequencies,
        levels=on_objects,
        objects=values,
        facts={
            "preset": f"{preset.name}: {preset.title}",
            "hazard_ref_width_m": width,
            "zones_scale": found.drawing.scale,
            "confidence": confidence,
            "changed_share": round(hazard.changed_share, 4),
            **_changed_by_level(hazard, preset),
            "newly_zoned_share": round(hazard.chances.newly_zoned_share, 4),
            "uncertain_share": round(hazard.uncertain_share, 4),
            "left_terrain_share": round(done.progress.lost_share, 4),
            "repetitions": run.repetitions,
            **({} if done.reused_from is None else {
                "reused_from": done.reused_from.name, "reused_areas": ", ".join(done.reused_areas),
            }),
        },
        frames=frames,
        warnings=(
            *rule_warnings(preset, rules.frequencies),
            *zone_warnings(hazard.chances, preset, budget, done.reused_from is not None),
            *edit_warnings(hazard.edits),
            *outside,
        ),
        placed=rules.placed,
        edits=edits,
        origin=_origin(config, rules),
    )  # fmt: skip


def _changed_by_level(hazard: Hazard, preset: HazardPreset) -> dict[str, float]:
    """Return what another sample would change of each level that has an area, by its code."""
    shares = zip(preset.levels, hazard.chances.changed_by_level.tolist(), strict=True)
    return {f"{CHANGED_SHARE}_{k.code}": round(x, 4) for k, x in shares if not math.isnan(x)}


def hazard_maps(
    rules: Rules, curves: HazardCurves, chances: LevelChances, grid: Grid, confidence: float
) -> tuple[RasterLayer, ...]:
    """Return maps of level, intensity, return period, frequency and confidence."""
    preset = rules.preset
    return hazard_layers(
        curves, chances, preset, grid, rules.ref_width_m, return_periods=preset.return_periods,
        confidence=confidence,
    )  # fmt: skip


def group_zones(config: Config, rules: Rules, grid: Grid, found: Assessment) -> list[VectorLayer]:
    """Return zones of a group of areas, of the layers that make sense for all groups together."""
    width, confidence = rules.ref_width_m, config.hazard.confidence
    zones = zone_layers.hazard_zones(found.hazard, rules.preset, grid, width, confidence)
    federal = federal_layers(config, grid, rules, found.hazard, {})
    return [layer for layer in (zones, *federal) if layer.name in _OF_GROUPS]


def group_extras(
    config: Config,
    rules: Rules,
    grid: Grid,
    maps: Sequence[RasterLayer],
    drawn: Sequence[Sequence[VectorLayer]],
    risks: tuple[RiskTable | None, RiskTable | None],
) -> Extras:
    """Make what zoning adds to a mosaic that is drawn group by group.

    The maps of hazard are written already; ``drawn`` is from group_zones, for each group, ``risks``
    with and without barriers.
    """
    zones = zone_layers.joined_layers(drawn) if drawn else []
    frames = {"zones": layer_table(zones[0])} if zones else {}
    shown: list[VectorLayer] = []
    if risks[0] is not None:
        shown = risk_vectors(risks[0], rules.placed, grid.crs, config.risk.currency)
        frames |= risk_tables(risks[0], risks[1], config.risk.currency)
    return Extras(
        vectors=(*zones, *shown),
        groups=zone_groups(maps, zones[:1], shown, zones[1:], rules.preset),
        frames=frames,
        origin=_origin(config, rules),
    )


def _origin(config: Config, rules: Rules) -> dict[str, Any]:
    """Return the inputs of a zoning besides the run, as arguments of write_origin."""
    return {
        "inputs": zoning_files(config), "preset": rules.preset.name,
        "hazard_width_m": rules.ref_width_m,
    }  # fmt: skip
