"""Answers of the interactive map at places: from the sums of a run and from its zones."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sassgis.hazard.assess import Assessment, Rules
from sassgis.hazard.attribution import governing
from sassgis.hazard.curves import hazard_curves
from sassgis.hazard.design import arrivals, value_at_rate
from sassgis.hazard.risk import RiskTable
from sassgis.hazard.sources import Sampled
from sassgis.hazard.zoning.applied_edits import shares_text
from sassgis.report.map_page import Contribution, MapHazard, PlaceFacts, Rows
from sassgis.report.page import sensible
from sassgis.settings.hazard_rules import LIMIT_TEXT
from sassgis.settings.languages import joined, named, phrase
from sassgis.settings.map_run import MapRun
from sassgis.simulation.accumulators import Progress

#: Points of a curve at a line.
_POINTS = 16


def blocks_by_source(run: MapRun, progress: Progress) -> list[Contribution]:
    """Count the simulated blocks of each source that reach each cell."""
    found: list[Contribution] = []
    for (area, k), tally in sorted(progress.sources.items()):
        own = tally.cells.counts()
        weight = own.count[:, 0].astype(np.float64)
        found.append((run.areas[area].name, run.blocks[k].name, own.places, weight))
    return found


def rates_by_source(sampled: Sequence[Sampled]) -> list[Contribution]:
    """Compute how often blocks of each source reach each cell (1/year)."""
    return [
        (
            s.source.area, s.source.scenario, s.cells.places,
            np.asarray(s.source.rate_per_rock * s.cells.count[:, 0], np.float64),
        )
        for s in sampled
    ]  # fmt: skip


def area_rows(run: MapRun, frequencies: Mapping[tuple[str, str], float]) -> dict[str, Rows]:
    """Describe each release area: its scenarios, with their onset frequencies if known."""
    found: dict[str, Rows] = {}
    for area in run.areas:
        rows = []
        for scenario in area.scenarios:
            frequency = frequencies.get((area.name, scenario))
            text = phrase("")
            if frequency is not None:
                text = phrase("{} blocks a year", sensible(frequency))
            rows.append((named(scenario), text))
        found[area.name] = tuple(rows)
    return found


def map_hazard(rules: Rules, found: Assessment) -> MapHazard:
    """Return curves and zones with what is known of each."""
    facts, levels = found.hazard.facts, found.hazard.levels
    sources = [s.source for s in found.hazard.sampled]
    _, most = governing(facts.shares)
    zones = []
    for k, (polygon, level) in enumerate(zip(levels.polygons, levels.classes, strict=True)):
        rows = [("Area", phrase("{} m²", f"{facts.area_m2[k]:.0f}"))]
        if math.isfinite(facts.uncertain[k]):
            text = phrase("{} % of its cells", f"{100.0 * facts.uncertain[k]:.0f}")
            rows.append(("Statistically uncertain", text))
        source = int(facts.governing[k])
        if source >= 0:
            own = sources[source]
            share = f"{100.0 * most[k]:.0f} %"
            rows.append(("Governed by", phrase("{}, {} ({})", own.area, own.scenario, share)))
        zones.append((int(level) - 1, polygon, tuple(rows)))
    marks: list[tuple[str, str, Any, Rows]] = [
        ("open", f"{facts.open_m[k]:.0f} m", facts.open_limit[k], ())
        for k in np.flatnonzero(facts.open_m > 0.0)
    ]
    labels = [phrase("none"), *(phrase(c.label) for c in rules.preset.levels)]
    for applied in found.hazard.edits:
        edit, limit = applied.edit, phrase(LIMIT_TEXT[applied.edit.limit])
        said = (("Level", joined(" ", filter(None, (limit, labels[edit.level])))),
                ("computed now", named(shares_text(applied.now))))  # fmt: skip
        marks.append(("edit", edit.words, edit.geometry, said))
    return MapHazard(rules.preset, found.hazard.curves, zones, marks, rules.ref_width_m)


def line_facts(
    run: MapRun, without_barriers: Sequence[Sampled], periods_years: Sequence[float]
) -> dict[tuple[str, str], PlaceFacts]:
    """Return the loads at each station and barrier without barriers, by return period."""
    found: dict[tuple[str, str], PlaceFacts] = {}
    for i, (line, _) in enumerate(run.control_lines):
        energy, height = (arrivals(without_barriers, i, q) for q in ("energy_kj", "height_m"))
        rows: list[tuple[str, str]] = []
        if line.kind != "station":
            stated = (("Height", f"{line.height_m:g} m"), ("Capacity", f"{line.capacity_kj:g} kJ"))
            rows += [(key, named(text)) for key, text in stated if "inf" not in text]
        for years in periods_years:
            values = (value_at_rate(own, 1.0 / years) for own in (energy, height))
            texts = ["–" if math.isnan(v) else sensible(v) for v in values]
            rows.append((phrase("{} years", f"{years:g}"), phrase("{} kJ, {} m high", *texts)))
        rows.append(("Blocks that arrive", phrase("{} a year", sensible(float(energy.rate[0])))))
        at = np.unique(np.linspace(0, energy.edges.size - 1, _POINTS * 4).astype(int))
        curve = [(float(energy.edges[k]), float(energy.rate[k])) for k in at if energy.rate[k] > 0]
        found[line.kind, line.name] = (tuple(rows), curve)
    return found


def object_facts(
    risk: RiskTable | None,
    sampled: Sequence[Sampled],
    energies_kj: np.ndarray,
    levels: Mapping[str, str],
    currency: str,
) -> dict[tuple[str, str], PlaceFacts]:
    """Return the hits of each exposed object; the curve of a road is that of its worst stretch."""
    if risk is None:
        return {}
    curves = hazard_curves([s.source for s in sampled], [s.objects for s in sampled], energies_kj)
    row_of = {int(place): row for row, place in enumerate(curves.places)}
    members: dict[str, list[int]] = {}
    for number, thing in enumerate(risk.objects):
        members.setdefault(thing.whole, []).append(number)
    quantity = {name: risk.of_object(name) for name in ("hits", "loss", "deaths")}
    found: dict[tuple[str, str], PlaceFacts] = {}
    for name, own in members.items():
        total = {key: float(values[own].sum()) for key, values in quantity.items()}
        rows: list[tuple[str, str]] = [("Hazard level", phrase(levels.get(name, "none")))]
        if total["hits"] > 0.0:
            rows.append(("Hits", phrase("once in {} years", sensible(1.0 / total["hits"]))))
        if total["loss"] > 0.0:
            rows.append(("Loss", phrase("{} {} a year", sensible(total["loss"]), currency)))
        if total["deaths"] > 0.0:
            rows.append(("Deaths", phrase("{} a year", sensible(total["deaths"]))))
        worst = max(own, key=lambda k: quantity["hits"][k])
        curve: list[tuple[float, float]] = []
        if worst in row_of:
            rates = curves.rate[row_of[worst]]
            curve = [(float(e), float(r)) for e, r in zip(energies_kj, rates, strict=True) if r > 0]
        found["object", name] = (tuple(rows), curve)
    return found
