"""Figures of hazard zones, hazard curves and risk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib.figure import Figure

from sassgis.hazard.assess import Assessment, Hazard, Rules, raster
from sassgis.hazard.curves import source_rate
from sassgis.hazard.levels import hazard_level
from sassgis.hazard.risk import RiskTable
from sassgis.hazard.zoning.generalise import Coverage
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.map_run import MapRun
from sassgis.model.results import RasterLayer
from sassgis.report import figures
from sassgis.report.alt_text import map_alt
from sassgis.report.exposed_report import map_objects
from sassgis.report.map_report import release_outlines, save_figure
from sassgis.report.page import ReportFigure, sensible


def rings(coverage: Coverage) -> list[FloatArray]:
    """Outlines of zones, holes included, shape (n, 2) each."""
    return [shapely.get_coordinates(r) for r in shapely.get_rings(coverage.polygons)]


def telling_place(hazard: Hazard) -> int | None:
    """The place whose hazard curve is drawn: reached by the most sources, and then most often.

    Returns
    -------
    int or None
        Position in ``curves.places``; None if no block arrives anywhere.
    """
    curves = hazard.curves
    if not curves.places.size:
        return None
    sources = np.zeros(curves.places.size, np.int64)
    for sampled in hazard.sampled:
        sources[np.searchsorted(curves.places, sampled.cells.places)] += 1
    return int(np.lexsort((curves.places, -curves.rate[:, 0], -sources))[0])


def curves_at(hazard: Hazard, place: int) -> dict[str, FloatArray]:
    """Rate of each source at one place, by its label."""
    out = {}
    cell = hazard.curves.places[place]
    for sampled in hazard.sampled:
        at = int(np.searchsorted(sampled.cells.places, cell))
        if at < sampled.cells.places.size and sampled.cells.places[at] == cell:
            out[sampled.source.label] = source_rate(sampled.source, sampled.cells)[at]
    return out


def _level_layer(like: RasterLayer, hazard: Hazard, rules: Rules, grid: Grid) -> RasterLayer:
    """The map of levels of one of the simulations."""
    level = hazard_level(hazard.curves, rules.preset)
    values = raster(grid, hazard.curves.places, level).astype(np.float32)
    values[values == 0.0] = np.nan
    return replace(like, bands=(replace(like.bands[0], values=values),))


def _where(hazard: Hazard, place: int, grid: Grid) -> str:
    x, y = grid.cell_centres(hazard.curves.places[place : place + 1])
    return f"At {x[0]:.0f}, {y[0]:.0f}."


def zone_figures(
    run: MapRun,
    rules: Rules,
    found: Assessment,
    maps: tuple[RasterLayer, ...],
    folder: Path,
    *,
    confidence: float,
    currency: str,
) -> tuple[ReportFigure, ...]:
    """Draw the figures of a zoning into a folder."""
    hazard, grid = found.hazard, run.grid
    place = telling_place(hazard)
    if place is None:
        return ()
    by_stem = {layer.stem: layer for layer in maps}
    around: dict[str, Any] = {
        "release": release_outlines(run),
        "control_lines": [(line.name, line.kind, trace) for line, trace in run.control_lines],
        "objects": map_objects(rules.placed),
    }
    width = f"Reference width {rules.ref_width_m:.4g} m."
    intensities = [m for m in maps if m.stem.startswith("intensity")]
    drawn: list[tuple[str, str, str, str, Figure]] = [
        (
            "hazard_level",
            "Hazard zones",
            f"Preset {rules.preset.name}: {rules.preset.title}. Cells, and the zones drawn around "
            f"them, which are never lower. {width}",
            map_alt(grid, by_stem["hazard_level"]),
            figures.map_figure(
                grid, by_stem["hazard_level"], zones=rings(hazard.levels), note=width, **around
            ),
        ),
        (
            "intensity",
            "Intensity by return period",
            f"Strongest intensity that is reached at least once in the return period. {width}",
            " ".join(map_alt(grid, layer) for layer in intensities),
            figures.intensity_figure(grid, intensities, note=width, **around),
        ),
        (
            "confidence",
            "Where the level is statistically uncertain",
            f"Cells whose level changes within the {100 * confidence:g} % interval "
            "of the sampling of blocks. More blocks settle them; other frequencies or ground "
            "values may change any cell.",
            map_alt(grid, by_stem["confidence"]),
            figures.confidence_figure(
                grid,
                by_stem["hazard_level"],
                by_stem["confidence"].bands[0].values == 1,
                note=width,
                **around,
            ),
        ),
    ]
    if found.without is not None:
        shown = by_stem["hazard_level"]
        layers = [_level_layer(shown, h, rules, grid) for h in (found.without, hazard)]
        drawn.append(
            (
                "barriers",
                "What walls and nets change",
                "Hazard level of the cells without and with walls and nets, from the same blocks.",
                " ".join(
                    f"{words}: {map_alt(grid, layer)}"
                    for words, layer in zip(("Without", "With"), layers, strict=True)
                ),
                figures.change_figure(
                    grid, *layers, names=("Without walls and nets", "With them"), note=width,
                    **around,
                ),
            )
        )  # fmt: skip
    drawn.append(
        (
            "hazard_curve",
            "A hazard curve",
            "At the cell that most sources reach. The level is the highest field that the curve "
            f"crosses. {width}",
            _curve_alt(hazard, place, rules),
            figures.hazard_curve_figure(
                hazard.curves, place, rules.preset, by_source=curves_at(hazard, place),
                confidence=confidence, note=_where(hazard, place, grid),
            ),
        )
    )  # fmt: skip
    if found.risk is not None:
        for quantity, unit in (("loss", f"{currency}/year"), ("deaths", "1/year")):
            values = found.risk.of_object(quantity)
            if not (values > 0.0).any():
                continue
            drawn.append(
                (
                    f"risk_{quantity}",
                    f"Risk: {quantity}",
                    "Objects with the largest values, with the 95 % interval of the sampling of "
                    "blocks (at most). Values and vulnerability are the user's.",
                    _risk_alt(found.risk, quantity, unit),
                    figures.risk_figure(
                        [o.name for o in found.risk.objects], values,
                        found.risk.standard_error(quantity), quantity=quantity, unit=unit,
                    ),
                )
            )  # fmt: skip
    return tuple(
        ReportFigure(title, caption, save_figure(folder, name, figure), alt)
        for name, title, caption, alt, figure in drawn
    )


def _curve_alt(hazard: Hazard, place: int, rules: Rules) -> str:
    """The rates of a hazard curve at the limits of intensity."""
    curves = hazard.curves
    parts = (
        f"{sensible(curves.rate[place, curves.column(e)])} of {e:g} kJ and more"
        for e in rules.preset.thresholds_kj
    )
    return f"Falling curve. Blocks per year: {', '.join(parts)}."


def _risk_alt(risk: RiskTable, quantity: str, unit: str) -> str:
    """The objects with the largest values."""
    values = risk.of_object(quantity)
    first = np.argsort(-values, kind="stable")[:3]
    parts = (f"{risk.objects[i].name} {sensible(values[i])} {unit}" for i in first if values[i] > 0)
    return f"Bars, the largest first: {', '.join(parts)}."
