"""Figures of hazard zones, hazard curves and risk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from matplotlib.figure import Figure

from sassgis.hazard.assess import Assessment, Hazard, Rules, raster
from sassgis.hazard.curves import source_rate
from sassgis.hazard.levels import hazard_level
from sassgis.model.grid import FloatArray
from sassgis.model.map_run import MapRun
from sassgis.model.results import RasterLayer
from sassgis.report import figures
from sassgis.report.exposed_report import map_objects
from sassgis.report.map_report import map_marks
from sassgis.report.page import ReportFigure, sensible
from sassgis.report.pictures import map_alt, picture


def telling_place(hazard: Hazard) -> int | None:
    """The place whose hazard curve is drawn: reached by the most sources, and then most often.

    Given as its position in ``curves.places``; None if no block arrives anywhere.
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
    out: list[ReportFigure] = []

    def add(name: str, title: str, caption: str, alt: str, figure: Figure) -> None:
        out.append(picture(folder, name, title, caption, figure, alt))

    by_stem = {layer.stem: layer for layer in maps}
    level, unsure = by_stem["hazard_level"], by_stem["confidence"]
    marks = map_marks(run, map_objects(rules.placed))
    width = f"Reference width {rules.ref_width_m:.4g} m."
    rings = [shapely.get_coordinates(r) for r in shapely.get_rings(hazard.levels.polygons)]
    add(
        "hazard_level",
        "Hazard zones",
        f"Preset {rules.preset.name}: {rules.preset.title}. Cells, and the zones drawn around "
        f"them, which are never lower. {width}",
        map_alt(grid, level),
        figures.map_figure(grid, level, replace(marks, zones=rings), note=width),
    )
    intensities = [m for m in maps if m.stem.startswith("intensity")]
    add(
        "intensity",
        "Intensity by return period",
        f"Strongest intensity that is reached at least once in the return period. {width}",
        " ".join(map_alt(grid, layer) for layer in intensities),
        figures.intensity_figure(grid, intensities, marks, width),
    )
    add(
        "confidence",
        "Where the level is statistically uncertain",
        f"Cells whose level changes within the {100 * confidence:g} % interval "
        "of the sampling of blocks. More blocks settle them; other frequencies or ground "
        "values may change any cell.",
        map_alt(grid, unsure),
        figures.confidence_figure(grid, level, unsure.bands[0].values == 1, marks, width),
    )
    if found.without is not None:
        both = []
        for one in (found.without, hazard):
            levels = raster(grid, one.curves.places, hazard_level(one.curves, rules.preset))
            drawn = np.where(levels == 0, np.nan, levels).astype(np.float32)
            both.append(replace(level, bands=(replace(level.bands[0], values=drawn),)))
        add(
            "barriers",
            "What walls and nets change",
            "Hazard level of the cells without and with walls and nets, from the same blocks.",
            f"Without: {map_alt(grid, both[0])} With: {map_alt(grid, both[1])}",
            figures.change_figure(
                grid,
                both[0],
                both[1],
                marks,
                names=("Without walls and nets", "With them"),
                note=width,
            ),
        )
    curves, preset = hazard.curves, rules.preset
    x, y = grid.cell_centres(curves.places[place : place + 1])
    rates = ", ".join(
        f"{sensible(curves.rate[place, curves.column(e)])} of {e:g} kJ and more"
        for e in preset.thresholds_kj
    )
    add(
        "hazard_curve",
        "A hazard curve",
        "At the cell that most sources reach. The level is the highest field that the curve "
        f"crosses. {width}",
        f"Falling curve. Blocks per year: {rates}.",
        figures.hazard_curve_figure(
            curves, place, preset, by_source=curves_at(hazard, place), confidence=confidence,
            note=f"At {x[0]:.0f}, {y[0]:.0f}.",
        ),
    )  # fmt: skip
    for quantity, unit in (("loss", f"{currency}/year"), ("deaths", "1/year")):
        if found.risk is None or not ((values := found.risk.of_object(quantity)) > 0.0).any():
            continue
        names = [o.name for o in found.risk.objects]
        first = [i for i in np.argsort(-values, kind="stable")[:3] if values[i] > 0]
        largest = ", ".join(f"{names[i]} {sensible(values[i])} {unit}" for i in first)
        add(
            f"risk_{quantity}",
            f"Risk: {quantity}",
            "Objects with the largest values, with the 95 % interval of the sampling of "
            "blocks (at most). Values and vulnerability are the user's.",
            f"Bars, the largest first: {largest}.",
            figures.risk_figure(
                names, values, found.risk.standard_error(quantity), quantity=quantity, unit=unit
            ),
        )
    return tuple(out)
