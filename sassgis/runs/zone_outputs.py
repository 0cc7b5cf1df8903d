"""What zoning adds to the result of a run: maps, layers, sheets, figures and tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import shapely

from sassgis.hazard.design import arrivals, quantile, rocks_beyond, value_at_rate
from sassgis.hazard.risk import risk_totals
from sassgis.hazard.rules import energy_labels, period_labels, preset_unverified
from sassgis.hazard.sources import Sampled
from sassgis.hazard.zoning.generalise import Coverage
from sassgis.io.qgis.layout import PrintLayout
from sassgis.io.qgis.project import LayerEntry, LayerGroup
from sassgis.io.write.geopackage import VectorLayer
from sassgis.io.write.layers.hazard_maps import hazard_layers
from sassgis.io.write.layers.risk_objects import risk_frames, risk_vectors
from sassgis.io.write.layers.zones import (
    change_table,
    changes,
    federal_layers,
    hazard_zones,
    level_changes,
    rounded,
    undecided_zones,
    without_barriers,
    zone_sources,
)
from sassgis.model.grid import Grid
from sassgis.model.hazard import HazardPreset
from sassgis.model.results import RasterLayer
from sassgis.model.run_config import Config
from sassgis.report.page import ReportTable
from sassgis.report.zone_figures import zone_figures
from sassgis.runs.assessment import Assessment, Rules
from sassgis.runs.run import Extras, Simulation

_VECTORS = "hazard.gpkg"


def zone_extras(
    config: Config, rules: Rules, found: Assessment, done: Simulation, figures: Path
) -> Extras:
    """Everything that zoning adds to a result; figures are drawn into the folder ``figures``."""
    grid, preset = done.run.grid, rules.preset
    confidence = config.hazard.confidence
    maps = hazard_layers(
        found.hazard.curves,
        preset,
        grid.shape,
        rules.ref_width_m,
        return_periods=preset.return_periods,
        confidence=confidence,
    )
    zones = hazard_zones(found.hazard, preset, grid, rules.ref_width_m, confidence)
    unsure = found.hazard.curves.places[found.hazard.undecided]
    own = [zones, undecided_zones(unsure, grid, confidence)]
    risk = []
    frames = {"zones": pd.DataFrame(zones.frame.drop(columns="geometry"))}
    frames["zone_sources"] = zone_sources(found.hazard)
    frames["sources"] = source_table(found.hazard.sampled)
    design = design_table(config, found.bare, done)
    if len(design):
        frames["design"] = design
    if found.without is not None:
        before = hazard_zones(found.without, preset, grid, rules.ref_width_m, confidence)
        both = changes(found.without.levels, found.hazard.levels)
        own += [without_barriers(before), level_changes(both, preset, grid)]
        frames["level_changes"] = change_table(both, preset)
    if found.risk is not None:
        risk = risk_vectors(found.risk, rules.placed, grid.crs, config.risk.currency)
        frames |= risk_frames(found.risk, config.risk.currency)
        if found.risk_without is not None:
            without = risk_frames(found.risk_without, config.risk.currency)
            frames |= {f"{name}_without_barriers": frame for name, frame in without.items()}
    federal = federal_layers(config, grid, preset, rules.ref_width_m, found.hazard, found.by_area)
    return Extras(
        layers=maps,
        vectors=(*own, *risk, *federal),
        groups=_groups(maps, own, risk, federal),
        layouts=_layouts(config, preset, rules.ref_width_m, found, done),
        figures=zone_figures(config, rules, found, done, maps, figures),
        key_results=_level_table(preset, found),
        tables=_report_tables(config, rules, found, design),
        facts={
            "preset": f"{preset.name}: {preset.title}",
            "hazard_ref_width_m": rules.ref_width_m,
            "confidence": confidence,
            "undecided_share": round(found.hazard.undecided_share, 4),
            "rounds": done.run.rounds,
        },
        described=_described(config, preset, rules.ref_width_m, found, done),
        frames=frames,
        inputs=_inputs(config),
        warnings=_warnings(config, rules, found, done),
        preset=preset.name,
    )


# ---------------------------------------------------------------------------------------------
# Tables


def source_table(sampled: tuple[Sampled, ...]) -> pd.DataFrame:
    """Release area, scenario, onset frequency and the rocks behind it."""
    return pd.DataFrame(
        {
            "area": [s.source.area for s in sampled],
            "scenario": [s.source.scenario for s in sampled],
            "onset_per_year": [rounded(s.source.frequency, 6) for s in sampled],
            "rocks": [s.source.rocks for s in sampled],
            "per_year_of_one_rock": [rounded(s.source.rate_per_rock, 6) for s in sampled],
        }
    )


def design_table(config: Config, bare: tuple[Sampled, ...], done: Simulation) -> pd.DataFrame:
    """What comes to each station and barrier line if no barrier holds it, by residual frequency."""
    sources = [s.source for s in bare]
    control_lines = [s.control_lines for s in bare]
    rows = []
    for i, (control_line, _) in enumerate(done.run.control_lines):
        energy, height = (arrivals(sources, control_lines, i, q) for q in ("energy_kj", "height_m"))
        row: dict[str, object] = {
            "line": control_line.name,
            "kind": control_line.kind,
            "rocks": int(energy.rocks[0]),
            "arrivals_per_year": rounded(energy.rate[0], 4),
        }
        for name, curve in (("energy", energy), ("height", height)):
            unit = "kj" if name == "energy" else "m"
            for p in (0.95, 0.99):
                row[f"{name}_q{100 * p:.0f}_{unit}"] = rounded(quantile(curve, p), 4)
            for years in config.hazard.design_return_periods_years:
                row[f"{name}_{years:g}y_{unit}"] = rounded(value_at_rate(curve, 1.0 / years), 4)
                row[f"{name}_{years:g}y_rocks_beyond"] = rocks_beyond(curve, 1.0 / years)
        rows.append(row)
    return pd.DataFrame(rows)


def _cells(frame: pd.DataFrame) -> tuple[tuple[object, ...], ...]:
    """Rows of a frame as a report takes them."""
    return tuple(
        tuple(None if isinstance(v, float) and np.isnan(v) else v for v in row)
        for row in frame.itertuples(index=False, name=None)
    )


def _report_tables(
    config: Config, rules: Rules, found: Assessment, design: pd.DataFrame
) -> tuple[ReportTable, ...]:
    preset, hazard = rules.preset, found.hazard
    tables = [_matrix_table(preset)]
    sources = source_table(hazard.sampled)
    tables.append(
        ReportTable(
            "Sources",
            (("release area", ""), ("block scenario", ""), ("onset frequency", "1/year"),
             ("rocks", ""), ("one rock stands for", "1/year")),
            _cells(sources),  # type: ignore[arg-type]
            "Onset frequencies are the user's; the hazard is proportional to them.",
        )
    )  # fmt: skip
    if len(design):
        tables += _design_tables(config, design)
    if found.risk is not None:
        tables += _risk_tables(config, found)
    return tuple(tables)


def _level_table(preset: HazardPreset, found: Assessment) -> ReportTable:
    zones = found.hazard.levels

    def areas(coverage: Coverage) -> list[float]:
        return [
            float(sum(p.area for p in coverage.polygons[coverage.classes == k + 1]))
            for k in range(len(preset.levels))
        ]

    columns = [("hazard level", ""), ("zones", ""), ("area", "m²")]
    now = areas(zones)
    count = [int((zones.classes == k + 1).sum()) for k in range(len(preset.levels))]
    rows: list[list[object]] = [
        [level.label, n, round(a)] for level, n, a in zip(preset.levels, count, now, strict=True)
    ]
    if found.without is not None:
        columns.append(("area without walls and nets", "m²"))
        for row, area in zip(rows, areas(found.without.levels), strict=True):
            row.append(round(area))
    return ReportTable(
        "Hazard zones",
        tuple(columns),
        tuple(tuple(row) for row in reversed(rows)),  # type: ignore[arg-type]
        "Zones are never lower than the cells in them: gaps are closed and small zones enlarged or "
        "raised, so that areas are a little larger than those of the cells.",
    )


def _matrix_table(preset: HazardPreset) -> ReportTable:
    return ReportTable(
        f"Rules: preset {preset.name}",
        (("intensity", ""), ("energy", ""), *((label, "years") for label in
                                              period_labels(preset.return_periods))),
        tuple(
            (c.label, span, *(preset.levels[k].label for k in row))
            for c, span, row in reversed(
                list(zip(preset.intensities, energy_labels(preset), preset.matrix, strict=True))
            )
        ),
        f"{preset.title}. The level of a cell is the worst that its hazard curve crosses.",
    )  # fmt: skip


def _design_tables(config: Config, design: pd.DataFrame) -> list[ReportTable]:
    tables = []
    for name, unit, title in (
        ("energy", "kj", "Energy that comes to stations and barriers"),
        ("height", "m", "Passing height at stations and barriers"),
    ):
        years = [f"{t:g}" for t in config.hazard.design_return_periods_years]
        keys = ["line", "arrivals_per_year", f"{name}_q95_{unit}", f"{name}_q99_{unit}"]
        keys += [f"{name}_{t}y_{unit}" for t in years]
        shown = "kJ" if unit == "kj" else "m"
        tables.append(
            ReportTable(
                title,
                (
                    ("line", ""), ("arrivals", "1/year"), ("95 %", shown), ("99 %", shown),
                    *((f"exceeded once in {t} years", shown) for t in years),
                ),
                _cells(design[keys]),  # type: ignore[arg-type]
                "As if no wall or net held a rock, sources weighted by their onset frequency. 0: "
                "rocks come less often than that. Height of the centre above its resting height: "
                "a barrier needs the block's half height and freeboard on top. How many simulated "
                "rocks lie beyond each value is in tables/design.csv.",
            )
        )  # fmt: skip
    return tables


def _risk_tables(config: Config, found: Assessment) -> list[ReportTable]:
    assert found.risk is not None
    money = f"{config.risk.currency}/year"
    before = None if found.risk_without is None else risk_totals(found.risk_without)
    rows = []
    for total in risk_totals(found.risk):
        row = [
            total.name, total.scope, rounded(total.values["hits"]), rounded(total.values["loss"]),
            rounded(total.standard_error["loss"], 2), rounded(total.values["deaths"]),
            rounded(total.standard_error["deaths"], 2), rounded(total.individual_risk),
        ]  # fmt: skip
        if before is not None:
            same = [b for b in before if (b.scope, b.name) == (total.scope, total.name)]
            row.append(rounded(same[0].values["loss"]) if same else None)
            row.append(rounded(same[0].values["deaths"]) if same else None)
        rows.append(tuple(row))
    columns = [
        ("what", ""), ("sum over", ""), ("hits", "1/year"), ("loss", money),
        ("its standard error, at most", money), ("deaths", "1/year"),
        ("their standard error, at most", "1/year"), ("largest individual risk", "1/year"),
    ]  # fmt: skip
    if before is not None:
        columns += [("loss without walls and nets", money),
                    ("deaths without walls and nets", "1/year")]  # fmt: skip
    return [
        ReportTable(
            "Risk of exposed objects",
            tuple(columns),
            tuple(rows),
            "Values, presence, vulnerability and lethality are the user's. Each object is in "
            "tables/risk_objects.csv, each source in tables/risk_sources.csv. Standard errors are "
            "of the sampling of rocks only.",
        )
    ]


# ---------------------------------------------------------------------------------------------
# Project and sheets


def _groups(
    maps: tuple[RasterLayer, ...],
    own: list[VectorLayer],
    risk: list[VectorLayer],
    federal: list[VectorLayer],
) -> tuple[LayerGroup, ...]:
    def vectors(layers: list[VectorLayer], visible: tuple[str, ...] = ()) -> list[LayerEntry]:
        return [LayerEntry(v, _VECTORS, visible=v.name in visible) for v in layers]

    def rasters(start: str, *more: str) -> tuple[LayerEntry, ...]:
        return tuple(
            LayerEntry(m, f"maps/{m.stem}.tif", visible=False)
            for m in maps
            if m.stem.startswith(start) or m.stem in more
        )

    groups = [
        LayerGroup(
            "Hazard",
            (
                *vectors(own, ("hazard_zones",)),
                LayerGroup("Intensity maps", rasters("intensity"), True, False),
                LayerGroup(
                    "Frequency and confidence",
                    rasters("frequency", "hazard_level", "return_period", "energy_at_return_period",
                            "confidence"),
                    True,
                    False,
                ),
                LayerGroup("Model 166.1", tuple(vectors(federal)), False, False),
            ),
        )
    ]  # fmt: skip
    if risk:
        groups.insert(0, LayerGroup("Risk", tuple(vectors(risk, tuple(v.name for v in risk)))))
    return tuple(groups)


def _extent(zones: Coverage, grid: Grid) -> tuple[float, float, float, float]:
    if not zones.polygons.size:
        return grid.bounds
    west, south, east, north = shapely.total_bounds(zones.polygons)
    margin = 0.04 * max(east - west, north - south)
    return west - margin, south - margin, east + margin, north + margin


def _layouts(
    config: Config,
    preset: HazardPreset,
    ref_width_m: float,
    found: Assessment,
    done: Simulation,
) -> tuple[PrintLayout, ...]:
    grid = done.run.grid
    extent = _extent(found.hazard.intensities[-1].zones, grid)
    barriers = any(g.kind != "station" for g, _ in done.run.control_lines)
    on_top = ("vector_barriers",) if barriers else ()
    facts = (
        ("Model", "SASS (Bozzolo and Pamini, 1986): rocks followed along fall lines"
         + (f"; with {', '.join(done.run.effects.names).replace('_', ' ')}"
            if done.run.effects.names else "")),
        ("Terrain", f"{config.dem_path.name}, cells of {grid.cell_size:.4g} m; heights "
         f"{grid.vertical_datum or 'of an unstated datum'}"),
        ("Release areas", ", ".join(a.name for a in done.run.areas)),
        ("Rocks", f"{int(done.progress.reasons.sum())}"),
        ("Rules", preset.title),
        ("Reference width", f"{ref_width_m:.4g} m"),
    )  # fmt: skip
    notes = (
        "Hazard follows from the onset frequencies that the user stated.",
        *(f"{text[:1].upper()}{text[1:]}" for text in preset_unverified(preset)[:1]),
    )
    name = config.project.name
    middle = preset.return_periods[len(preset.return_periods) // 2]
    stem = f"intensity_{middle:g}"
    return (
        PrintLayout(
            "Hazard level", name, "Hazard zones, rockfall",
            (*on_top, "vector_release_areas", "vector_hazard_zones",
             "raster_terrain"),
            extent, facts, notes,
        ),
        PrintLayout(
            f"Intensity {middle:g} years", name,
            f"Intensity of rockfall, return period {middle:g} years",
            (*on_top, "vector_release_areas", f"raster_{stem}", "raster_terrain"),
            extent, facts, notes,
        ),
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------
# What the user must know


def _described(
    config: Config,
    preset: HazardPreset,
    ref_width_m: float,
    found: Assessment,
    done: Simulation,
) -> tuple[tuple[str, str], ...]:
    share = 100.0 * found.hazard.undecided_share
    return (
        ("Rules", f"{preset.title} ({preset.name})"),
        ("Reference width of all frequencies", f"{ref_width_m:.4g} m"),
        ("Rounds of rocks", str(done.run.rounds)),
        (
            "Undecided",
            f"{share:.1f} % of the cells that rocks reach: their level changes within the "
            f"{100 * config.hazard.confidence:g} % sampling interval",
        ),
    )


def _inputs(config: Config) -> dict[str, Path]:
    files = {"frequencies": config.hazard.frequencies, "vulnerability": config.risk.vulnerability}
    files |= {f"objects {o.name}": o.file for o in config.objects}
    if config.hazard.preset.endswith(".toml"):
        files["preset"] = Path(config.hazard.preset)
    return {role: path for role, path in files.items() if path is not None}


def _warnings(config: Config, rules: Rules, found: Assessment, done: Simulation) -> tuple[str, ...]:
    out = [f"{text[:1].upper()}{text[1:]}" for text in preset_unverified(rules.preset)]
    limit = config.hazard.uncertain_share_max
    if limit is not None and found.hazard.undecided_share > limit:
        out.append(
            f"{100 * found.hazard.undecided_share:.1f} % of the reached cells are still undecided "
            f"after {config.hazard.repetitions_max} rounds of rocks (hazard.uncertain_share_max: "
            f"{100 * limit:g} %)."
        )
    if done.run.lines_per_point == 1:
        out.append(
            "All rocks of a release point keep to one fall line: zones are too narrow where rocks "
            "spread sideways. [spread] or [effects.lateral_deflection] gives them a width."
        )
    idle = [s.source.label for s in found.hazard.sampled if s.source.frequency == 0.0]
    if idle:
        out.append("Onset frequency 0, so without any hazard: " + ", ".join(idle) + ".")
    return tuple(out)
